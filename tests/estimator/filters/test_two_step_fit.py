"""The dissertation's two-step fit of one window, and its merging."""

import math

import numpy as np
import pytest
from step_runs import MACHINE, STEP_AT, TICKS, TRUTH, Array, record_of, step_run

from tilth.estimator.filters import two_step_fit, unknowns
from tilth.estimator.filters.two_step_fit import Window, identify, merge_scalar
from tilth.estimator.models.parameters import geometry_of
from tilth.estimator.record.record import EAST, NORTH, YAW_RATE, Record
from tilth.schemas.reasons import Code


def window(record: Record, start: Array) -> Window:
    return Window(record, geometry_of(MACHINE), start, unknowns.levers(MACHINE))


def test_merging_gives_the_dissertations_table() -> None:
    """Table 7.5: relaxation lengths of the first two trials, to the digits that are printed."""
    trials = {
        (1.5, 0.4, 1.0, 0.8): (1.4, 0.4),
        (2.1, 0.4, 2.6, 0.7): (2.2, 0.3),
        (1.3, 0.9, 1.7, 1.0): (1.5, 0.7),
    }
    for (one, sd_one, other, sd_other), (mean, sd) in trials.items():
        found = merge_scalar([one, other], [sd_one, sd_other])
        assert (round(found[0], 1), round(found[1], 1)) == (mean, sd)
    # In whatever order; and as inverse variances.
    values, sds = [600.0, 550.0, 560.0], [40.0, 70.0, 40.0]
    weights = np.array(sds) ** -2
    expected = float(np.average(values, weights=weights)), float(weights.sum() ** -0.5)
    assert merge_scalar(values, sds) == pytest.approx(expected)
    assert merge_scalar(values[::-1], sds[::-1]) == pytest.approx(expected)
    with pytest.raises(ValueError, match="no estimate"):
        merge_scalar([], [])


def test_scalar_merging_leans_low_as_its_docstring_says() -> None:
    """The sd of a stiffness goes with its value, so low estimates weigh more."""
    rng = np.random.default_rng(3)
    merged = []
    for _ in range(200):
        values = np.exp(rng.normal(0.0, 0.3, 6))
        merged.append(merge_scalar(list(values), list(0.3 * values))[0])
    assert np.mean(merged) < 0.93


def test_relaxation_lengths_are_found_where_the_stiffnesses_are_right() -> None:
    start = TRUTH * np.array([1.0, 1.0, 1.0, 1.4, 0.7, 1.5])
    found = identify(window(record_of(step_run()), start))
    assert found.found == (True, True) and found.reason is None
    assert found.values[:3] == pytest.approx(TRUTH[:3], rel=0.02)
    assert found.values[3:] == pytest.approx(TRUTH[3:], rel=0.03)


@pytest.mark.long
def test_with_a_free_gain_the_intervals_are_too_narrow() -> None:
    """With the stiffnesses given, sensor noise alone, and 12 runs of steps."""
    wheel = np.repeat(np.radians([0.0, 8.0, -8.0, 4.0, -6.0]), TICKS // 5)
    inside = []
    for seed in range(12):
        outputs = two_step_fit._outputs(window(record_of(wheel, 1.0, seed=seed), TRUTH))
        assert outputs is not None
        lengths, sds, within = two_step_fit._relaxation_lengths(outputs, geometry_of(MACHINE), TRUTH)
        assert within
        inside += (np.abs(lengths - TRUTH[3:]) < 1.96 * sds).tolist()
    assert 0.35 < np.mean(inside) < 0.9


def test_two_outputs_leave_the_stiffnesses_on_a_line_and_it_says_so() -> None:
    record = record_of(step_run(), noise=1.0)
    ends = []
    for factors in ((0.7, 0.6, 0.6), (1.4, 1.7, 1.6)):
        start = TRUTH * np.array([*factors, 1.0, 1.0, 1.0])
        found = identify(window(record, start))
        assert found.rank == 2
        ends.append(found)
    one, other = (np.log(found.values[:3] / TRUTH[:3]) for found in ends)
    assert np.abs(one - other).max() > 0.3  # where it began decides where it ends
    # Its own sds admit it.
    assert min((found.sds[:3] / found.values[:3]).min() for found in ends) > 0.5


def test_the_zero_of_the_wheel_angle_is_taken_off_where_it_goes_straight() -> None:
    found = identify(window(record_of(step_run(), zero=math.radians(0.3)), TRUTH))
    assert found.zero == pytest.approx(math.radians(0.3), abs=1e-4)
    assert found.straight_s == pytest.approx(STEP_AT * 0.02, abs=0.3)
    assert found.values[3:] == pytest.approx(TRUTH[3:], rel=0.05)


@pytest.mark.parametrize(
    ("wheel", "drop", "reason"),
    [
        (np.zeros(TICKS), None, Code.NO_STEADY_TURN),
        (0.1 * np.sin(np.arange(TICKS) * 0.02), None, Code.NO_STEADY_TURN),
        (step_run(), YAW_RATE, Code.OUTPUTS_NOT_MEASURED),
    ],
    ids=["straight", "weaving", "no yaw rate"],
)
def test_a_run_that_cannot_tell_gives_a_reason(wheel: Array, drop: float | None, reason: Code) -> None:
    record = record_of(wheel)
    record.rows = record.rows[record.rows[:, 2] != drop]
    found = identify(window(record, TRUTH))
    assert found.reason == reason and found.found == (False, False)


def test_headings_come_from_two_antennas_whatever_their_places() -> None:
    levers = np.array([[1.6, 0.2], [-1.1, -0.3], [1.3, 0.0], [-1.3, 0.0]])
    heading = np.linspace(3.0, 3.5, 50)  # across the wrap
    rows = []
    for k, psi in enumerate(heading):
        for place in range(4):
            forward, right = levers[place]
            north = forward * math.cos(psi) - right * math.sin(psi)
            east = forward * math.sin(psi) + right * math.cos(psi)
            rows += [(k * 10, 0.0, NORTH, place, north, 0.02), (k * 10, 0.0, EAST, place, east, 0.02)]
    at = np.arange(0, 500, 10)
    for body in (0, 1):
        found = two_step_fit._heading(np.array(rows), body, at, levers, heading + 0.02)
        assert found == pytest.approx(heading, abs=1e-9)
