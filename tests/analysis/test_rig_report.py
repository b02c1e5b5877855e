"""The report on a rig: speeds, steady turns, what a drive can reveal."""

from typing import Any

import numpy as np
import pytest

from tilth.analysis.rig_report import SAMPLE_S, Drive, rig_report, speed_key
from tilth.estimator.models.family import MODELS, model_named
from tilth.estimator.models.identifiability import DISTURBANCES, SENSOR_SETS, cramer_rao
from tilth.estimator.models.linear_analysis import steady_gains
from tilth.estimator.models.parameters import TABLE_5_1, TABLE_7_2
from tilth.schemas.flow import PARAMETERS


@pytest.mark.parametrize(
    ("speed", "key"), [(4.5, "4.5"), (1, "1.0"), (0.1, "0.1"), (30, "30.0"), (2.25, "2.25")]
)
def test_speeds_are_plain_decimal_text(speed: float, key: str) -> None:
    assert speed_key(speed) == key


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.name)
def test_every_model_at_the_ends_of_the_range(model: Any) -> None:
    drive = Drive(seconds=2.0)
    output: Any = rig_report(TABLE_7_2, [model], (0.1, 30.0), drive)["models"][model.name]
    for at in output.values():
        assert at["stable"] and at["observability"]["rank"] == len(at["states"])
        for design in at["lqr"].values():
            assert design["stable"] and max(re for re, _ in design["eigenvalues"]) < 0
        assert (at["bound"] is None) == (not model.parameters)


@pytest.mark.parametrize("name", ["dynamic", "relaxation"])
def test_the_steady_turn_is_the_closed_form(name: str) -> None:
    output: Any = rig_report(TABLE_7_2, [model_named(name)], (1.0, 7.5), Drive(seconds=2.0))["models"][name]
    for speed, at in output.items():
        turn = at["steady_turn_per_rad"]
        values = [turn[key] for key in ("lateral_velocity", "yaw_rate", "articulation")]
        np.testing.assert_allclose(values, steady_gains(TABLE_7_2, float(speed)), rtol=1e-9)


def test_the_wheel_angle_ratio_is_that_of_the_steady_turn() -> None:
    output: Any = rig_report(TABLE_5_1, [model_named("dynamic")], (7.5,), Drive(seconds=2.0))
    yaw = output["models"]["dynamic"]["7.5"]["steady_turn_per_rad"]["yaw_rate"]
    assert output["understeer"]["wheel_angle_ratio"]["7.5"] == pytest.approx(7.5 / 2.9 / yaw)


@pytest.mark.parametrize("sensors", SENSOR_SETS)
def test_the_bound_is_that_of_the_drive(sensors: str) -> None:
    drive, model = Drive(sensors=sensors, seconds=6.0), model_named("relaxation")
    output: Any = rig_report(TABLE_7_2, [model], (4.5,), drive)["models"]["relaxation"]["4.5"]["bound"]
    expected = cramer_rao(
        model, TABLE_7_2, 4.5, drive.wheel_angle(), SAMPLE_S, SENSOR_SETS[sensors], disturbances=DISTURBANCES
    )
    assert output["sd"] == pytest.approx(dict(zip(PARAMETERS, expected.sd.tolist(), strict=True)), rel=1e-6)
    assert (output["rank"], output["of"]) == (6, 6)
    assert all(output["sd_zero_unknown"][name] >= 0.999999 * output["sd"][name] for name in PARAMETERS)
