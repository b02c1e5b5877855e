"""Each sensor's noise level and gate, as the filters find them by the kind of a row."""

import math

import numpy as np
import pytest

from tilth.estimator.filters.gates import GATE, GATES, outliers
from tilth.estimator.filters.measurement_model import NOISE_LEVELS, noise_factor
from tilth.estimator.filters.unknowns import NAMES
from tilth.estimator.record.record import EAST, HEADING, NORTH, ROLL_ANGLE, VELOCITY, YAW_RATE

SENSORS = {
    YAW_RATE: (GATE.yaw_rate, "s_yaw_rate"),
    VELOCITY: (GATE.velocity, "s_velocity"),
    NORTH: (GATE.position, "s_position"),
    EAST: (GATE.position, "s_position"),
    HEADING: (GATE.heading, "s_position"),
    ROLL_ANGLE: (GATE.roll, "s_roll"),
}


@pytest.mark.parametrize("kind", SENSORS)
def test_a_row_finds_the_noise_level_and_the_gate_of_its_sensor(kind: int) -> None:
    gate, level = SENSORS[kind]
    assert NAMES[NOISE_LEVELS[kind]] == level and GATES[kind] == gate
    unknowns = np.linspace(0.0, 0.5, len(NAMES), dtype=np.float64)
    assert noise_factor.interpreted()(kind, unknowns) == math.exp(unknowns[NAMES.index(level)])


@pytest.mark.parametrize("kind", SENSORS)
def test_an_outlier_is_beyond_the_gate_of_its_own_sensor(kind: int, monkeypatch: pytest.MonkeyPatch) -> None:
    narrow = tuple(1.0 if k == kind else 9.0 for k in range(len(GATES)))
    monkeypatch.setattr("tilth.estimator.filters.gates.GATES", narrow)
    rows = np.zeros((len(GATES), 6))
    rows[:, 2] = range(len(GATES))
    e, S = np.full(len(GATES), -4.0), np.full(len(GATES), 4.0)  # all off by two sds
    assert outliers(rows, e, S).tolist() == [k == kind for k in range(len(GATES))]
