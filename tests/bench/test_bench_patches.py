"""Fields in patches: what is drawn, and what the table makes of numbers that hold and of others."""

import json
from typing import Any

import numpy as np
import patches
import pytest
from circle import demo_machine

from tilth.estimator.models.parameters import rig_of
from tilth.schemas.flow import PARAMETERS
from tilth.simulator import ground
from tilth.simulator.scenario import Soil


def test_fields_differ_as_they_are_meant_to() -> None:
    drawn = [patches.scenario_for(k, 8.0) for k in range(40)]
    assert drawn[3] == patches.scenario_for(3, 8.0)
    for name, low, high in (("patch_length", 20, 60), ("patch_log_sd", 0.1, 0.3), ("patch_common", 0.3, 1.0)):
        values = [getattr(one.soil, name) for one in drawn]
        assert low <= min(values) < max(values) <= high and np.std(values) > 0.15 * (high - low)
    assert {one.steering.turns[0].spacing for one in drawn} == {6.1, 12.2}  # type: ignore[union-attr, index]


def _made(z: float) -> list[dict[str, Any]]:
    """A field with errors of z sds everywhere, times a normal number, in two passes and between them."""
    rng, n = np.random.default_rng(1), 900
    told = {
        "error": (0.2 * z * rng.standard_normal((n, 6))).tolist(), "sd": [[0.2] * 6] * n,
        "turn": [k % 300 > 250 for k in range(n)], "pass": [k // 300 for k in range(n)],
        "stretch": [float(k % 300 // 50) for k in range(n)],
    }  # fmt: skip
    methods = {"place": told, "pem": told, "oracle": {**told, "sd": [[0.2 * z] * 6] * n}}
    made = [{"row": "patches", "seed": 0, "first": 0, "scale": 8.0, "methods": methods,
             "ahead": [[0.1 * z, 0.1, 0.05 * z, 0.05]] * 5, "changes": [60.0]}]  # fmt: skip
    return json.loads(json.dumps(made))  # type: ignore[no-any-return]


@pytest.mark.parametrize(("z", "held"), [(0.8, True), (1.6, False)])
def test_the_table_tells_right_numbers_from_wrong_ones(z: float, held: bool) -> None:
    made = _made(z)
    made[0]["methods"]["recommended"] = {key: [] for key in made[0]["methods"]["pem"]}
    lines = {line.figure: line for line in patches.lines_of(made)}
    of_rows = next(line for figure, line in lines.items() if figure.startswith("place, rows: 95 %"))
    assert of_rows.held is held and len(of_rows.values) == 6
    assert any(figure.startswith("place, turns: 95 %") for figure in lines)
    assert lines["recommended, rows"].reached == "no number was given"
    score = lines["place, rows: mean interval score of C over the oracle's"]
    assert score.held is held and 1.0 < score.values[0] < 1.6  # the oracle's sds are those of the errors
    assert lines["soil_change was told, in each field"].reached == "1"
    assert lines["wet end: intervals hold"].held
    assert lines["the same of the oracle"].reached.startswith("10")


@pytest.mark.parametrize("shift", [-1.0, 0.5])
def test_a_shift_in_all_fields_is_told_from_width(shift: float) -> None:
    """Errors in sds, of two fields: with the shift, and with three times the spread in the second."""
    made = [*_made(0.8), *_made(2.4)]
    for one in made:
        told = one["methods"]["place"]
        told["error"] = (np.array(told["error"]) + 0.2 * shift).tolist()
        one["methods"] = {**one["methods"], "recommended": told}
    lines = {line.figure: line.values for line in patches.lines_of(made)}
    assert lines["place, rows: mean error over sd, by fields"] == pytest.approx([shift] * 6, abs=0.2)
    assert lines["pem, rows: mean error over sd, by fields"] == pytest.approx([0.0] * 6, abs=0.2)
    assert min(lines["place, rows: standard error of that, by fields"]) > 0.05
    assert not any("standard error" in line.figure for line in patches.lines_of(made[:1]))


def test_the_oracle_knows_the_covariance_that_a_field_was_drawn_with() -> None:
    """Of many fields drawn alike, at two places 15 m apart."""
    soil = Soil(patch_log_sd=0.2, patch_length=30.0, patch_across=1.5, patch_common=0.6)
    rng, rig, states = np.random.default_rng(0), rig_of(demo_machine()), np.zeros((2, 13))
    states[1, :2] = 9.0, 12.0
    axles = ground.axles_of(rig, states)
    apart = (axles[:, :, None, None, None, None] - axles[None, None, None, :, :, None]).transpose(
        6, *range(6)
    )
    told = patches.variogram(soil, 100.0).correlation(apart, 0.0)
    drawn = (ground.field(soil, dict.fromkeys(PARAMETERS, 1.0), rig, rng) for _ in range(2000))
    logs = [np.log(field.at(0.0, states))[:, :3].ravel() for field in drawn]
    assert np.cov(np.array(logs).T) == pytest.approx(told, abs=0.004)
