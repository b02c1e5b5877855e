"""Residuals and frequency response of what was fitted: right parameters pass, wrong ones are told."""

import numpy as np
import pytest
from logs import MACHINE
from recorded import recorded, shared_cache

import tilth.analysis
from tilth.analysis.fit.fitting import Fitted, choose, fit_all
from tilth.analysis.runs import segments
from tilth.analysis.validation import validate
from tilth.estimator.models.parameters import rig_of


@pytest.fixture(scope="module")
def fitted() -> Fitted:
    (run,) = tilth.analysis.open(recorded().parts)
    return fit_all(choose([run]), jobs=2, cache=shared_cache())


def test_residuals_of_each_segment_and_output(fitted: Fitted) -> None:
    found = validate.residual_tests(fitted)
    assert {row.segment for row in found} == {wanted.id for wanted in fitted.wanted}
    yaw = [row for row in found if row.output.startswith("yaw rate")]
    assert len(yaw) == 4 and all(row.size.mean == pytest.approx(1.0, abs=0.35) for row in yaw)
    assert sum(row.by_wheel.outcome == "failed" for row in found) <= len(found) // 4
    for row in found:
        told = (row.white.sentence, row.by_wheel.sentence, row.size.sentence)
        assert all(f"{row.output} in segment {row.segment}" in sentence for sentence in told)


def test_the_estimate_is_nearer_to_the_measured_response_than_the_machine_file(fitted: Fitted) -> None:
    (found,) = validate.responses(fitted).values()
    assert not found.reason and [curve.name for curve in found.curves] == ["machine file", "estimated"]
    low = found.excited & (found.hz < 0.5)
    assert np.count_nonzero(low) >= 2
    off = [
        np.abs(np.log(np.abs(curve.response[low, 0] / found.value[low, 0]))).max() for curve in found.curves
    ]
    assert off[1] < off[0]


def test_earlier_parameters_have_a_curve(fitted: Fitted) -> None:
    assert fitted.joint is not None
    (found,) = validate.responses(fitted, fitted.fits[0].mean).values()
    assert [curve.name for curve in found.curves][-1] == "previous"


def test_driving_that_tells_nothing_gives_the_reason() -> None:
    (run,) = tilth.analysis.open(recorded().parts)
    straight = segments.between(run.poses, 1.0, 5.0)
    found = validate.response(run, [straight], {"machine file": rig_of(MACHINE)})
    assert found.reason and validate.responses(Fitted((), (), (), None, None)) == {}
