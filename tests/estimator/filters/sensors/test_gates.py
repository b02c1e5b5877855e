"""Each sensor's noise level and gate, as the filters find them by the kind of a row."""

import math

import numpy as np
import pytest

from tilth.estimator.filters.measurement_model import GATES, NOISE_LEVELS, noise_factor, outliers
from tilth.estimator.filters.sensors import heading, position, roll, velocity, yaw_rate
from tilth.estimator.filters.unknowns import NAMES
from tilth.estimator.record.record import EAST, HEADING, NORTH, ROLL_ANGLE, VELOCITY, YAW_RATE

SENSORS = {
    YAW_RATE: (yaw_rate, "s_yaw_rate"),
    VELOCITY: (velocity, "s_velocity"),
    NORTH: (position, "s_position"),
    EAST: (position, "s_position"),
    HEADING: (heading, "s_position"),
    ROLL_ANGLE: (roll, "s_roll"),
}


@pytest.mark.parametrize("kind", SENSORS)
def test_a_row_finds_the_noise_level_and_the_gate_of_its_sensor(kind: int) -> None:
    sensor, level = SENSORS[kind]
    assert NAMES[NOISE_LEVELS[kind]] == level and GATES[kind] == sensor.SENSOR.gate
    unknowns = np.linspace(0.0, 0.5, len(NAMES), dtype=np.float64)
    assert noise_factor.interpreted()(kind, unknowns) == math.exp(unknowns[NAMES.index(level)])


@pytest.mark.parametrize("kind", SENSORS)
def test_an_outlier_is_beyond_the_gate_of_its_own_sensor(kind: int, monkeypatch: pytest.MonkeyPatch) -> None:
    narrow = tuple(1.0 if k == kind else 9.0 for k in range(len(GATES)))
    monkeypatch.setattr("tilth.estimator.filters.measurement_model.GATES", narrow)
    rows = np.zeros((len(GATES), 6))
    rows[:, 2] = range(len(GATES))
    e, S = np.full(len(GATES), -4.0), np.full(len(GATES), 4.0)  # all off by two sds
    assert outliers(rows, e, S).tolist() == [k == kind for k in range(len(GATES))]
