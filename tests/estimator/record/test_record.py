"""Records put together, and the wheel angle at their ticks."""

from collections import deque

import numpy as np
import pytest

from tilth.estimator.record.record import INPUTS, ROWS, TICK_NS, Record, Segment, U, concatenate
from tilth.estimator.record.record_builder import wheel_angles


def segment(number: int) -> Segment:
    """The one of that number of a run, with two rows; its ticks hold its number."""
    rows = np.zeros((2, len(ROWS)))
    rows[:, 0], rows[:, 4] = (3, 9), number
    return Segment(
        Record(7 + number * 10 * TICK_NS, np.full((10, len(INPUTS)), float(number)), rows), True, None
    )


def test_stretches_put_together_are_one_record() -> None:
    parts = [segment(k) for k in range(4)]
    whole = concatenate(parts)
    assert whole.t_ns == 7 and whole.end_ns == 7 + 40 * TICK_NS
    assert whole.ticks[:, 0].tolist() == [float(k) for k in range(4) for _ in range(10)]
    assert whole.rows[:, 0].tolist() == [3, 9, 13, 19, 23, 29, 33, 39]
    assert whole.rows[:, 4].tolist() == [0, 0, 1, 1, 2, 2, 3, 3]
    assert parts[1].record.rows[:, 0].tolist() == [3, 9]  # left as it was
    with pytest.raises(ValueError, match=r"0\.2 s after"):
        concatenate([parts[0], parts[2]])
    with pytest.raises(ValueError, match="no segment"):
        concatenate([])
    assert Record(5).end_ns == 5


def test_a_record_keeps_accelerations_and_loses_the_noise_of_the_speed() -> None:
    at_poses = np.arange(101) * 0.2
    speeds = {
        "even": 2.0 + 0.5 * at_poses,
        "noise": np.random.default_rng(5).normal(0.0, 0.02, len(at_poses)),
    }
    rates = {}
    for name, speed in speeds.items():
        parts = [segment(k) for k in range(100)]
        for k, part in enumerate(parts):
            part.record.ticks[:, U] = np.interp(np.arange(10), [0.0, 10.0], speed[k : k + 2])
        assert concatenate(parts[:1]).ticks[:, U] == pytest.approx(parts[0].record.ticks[:, U], abs=1e-12)
        rates[name] = np.diff(concatenate(parts).ticks[:, U]) / 0.02
    assert rates["even"] == pytest.approx(0.5, abs=1e-9)
    assert np.std(rates["noise"]) < 0.2 * np.std(np.diff(speeds["noise"]) / 0.2)


@pytest.mark.parametrize("period_ms", [5, 10, 20, 100])
@pytest.mark.parametrize("phase_ms", [0, 3, 9])
def test_a_turning_wheel_is_met_at_the_tick_whatever_the_sensors_phase(period_ms: int, phase_ms: int) -> None:
    stamps = [(k * period_ms + phase_ms) * 1_000_000 for k in range(-400 // period_ms, 700 // period_ms)]
    samples = deque([(t, 0.4 * t * 1e-9, 0.002) for t in stamps], maxlen=256)
    found = wheel_angles(samples, 0)
    assert found == pytest.approx([0.4 * 0.02 * k for k in range(10)], abs=1e-9)


def test_a_wheel_sensor_that_was_silent_for_too_long_gives_no_angle() -> None:
    samples = [(k * 10_000_000, 0.1, 0.002) for k in range(-40, 40)]
    for silence_ms, given in ((130, True), (160, False)):
        received = deque(s for s in samples if not 20 <= s[0] // 1_000_000 < 20 + silence_ms)
        assert (wheel_angles(received, 0) is not None) == given
    assert wheel_angles(deque(s for s in samples if s[0] < 150_000_000), 0) is None
    assert wheel_angles(deque(), 0) is None
