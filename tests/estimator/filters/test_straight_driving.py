"""The rig about straight driving: the product's own motion model and sensors, in proportion to the wheel."""

import numpy as np
import pytest
from circle import demo_machine
from numpy.typing import NDArray
from straight_row import RESPONDING, raw_response, weaving

from tilth.estimator.filters import unknowns
from tilth.estimator.filters.likelihood import innovations
from tilth.estimator.filters.rig_setup import rig_setup
from tilth.estimator.filters.states import N_STATES
from tilth.estimator.filters.unknowns import AT
from tilth.estimator.record.record import (
    EAST,
    KIND,
    NORTH,
    ROLL_ANGLE,
    VELOCITY,
    WHEEL_ANGLE,
    YAW_RATE,
    Record,
)

Array = NDArray[np.float64]

MACHINE = demo_machine()
MEAN, SD = unknowns.prior(MACHINE)
SETUP = rig_setup(MACHINE)
SCALE = 1e-5


def open_loop(record: Record, point: Array) -> Array:
    """Readings of the filters' own model without measurements, (m,), for a small wheel angle."""
    ticks = record.ticks.copy()
    ticks[:, WHEEL_ANGLE] = SCALE * (ticks[:, WHEEL_ANGLE] - ticks[:, WHEEL_ANGLE].mean())
    rows = record.rows.copy()
    rows[:, 4] = 0.0

    def readings(ticks: Array) -> Array:
        made = innovations(Record(0, ticks, rows), SETUP, np.zeros(N_STATES), point, closed=False)
        return -made.e

    still = ticks.copy()
    still[:, WHEEL_ANGLE] = 0.0
    return np.asarray((readings(ticks) - readings(still)) / SCALE)


@pytest.mark.parametrize(
    "changed", [{}, {"C_af": 0.5, "sigma_i": -0.4, "latency": 0.04, "rate_late_t": 0.05}]
)
def test_the_response_is_that_of_the_filters(changed: dict[str, float]) -> None:
    record, point = weaving(20.0, speeds=(3.6, 4.6)), MEAN.copy()
    for name, by in changed.items():
        point[AT[name]] += by
    ours, theirs = raw_response(record, point, SETUP)[:, 0], open_loop(record, point)
    for kind in (YAW_RATE, VELOCITY, EAST, ROLL_ANGLE):
        of_kind = record.rows[:, KIND] == kind
        constant = ours[of_kind][0] - theirs[of_kind][0] if kind != EAST else 0.0
        off = np.abs(ours - constant - theirs)[of_kind].max()
        assert off < 0.02 * np.abs(theirs[of_kind]).max(), kind


@pytest.mark.parametrize("name", RESPONDING)
def test_slopes_are_those_of_differences(name: str) -> None:
    """Also by what an unknown changes of the exponential step. The wheel angle has a kink at each tick."""
    record = weaving(20.0, speeds=(3.6, 4.6))
    place, step = np.array([AT[name]]), 1e-4 * np.eye(len(MEAN))[AT[name]]
    slopes = raw_response(record, MEAN, SETUP, place)[:, 1]
    ahead, behind = (raw_response(record, MEAN + way * step, SETUP)[:, 0] for way in (1.0, -1.0))
    differences = (ahead - behind) / 2e-4
    across = record.rows[:, KIND] != NORTH
    off = (1e-2 if name == "latency" else 2e-3) * np.abs(differences).max()
    np.testing.assert_allclose(slopes[across], differences[across], atol=off)
