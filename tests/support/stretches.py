"""A stretch of the tracker's filter from somewhere, without a measurement."""

import numpy as np
from logs import MACHINE
from numpy.typing import NDArray

from tilth.estimator.filters import unknowns
from tilth.estimator.filters.propagation import (
    GroundNoise,
)
from tilth.estimator.filters.rig_setup import RigSetup, rig_setup
from tilth.estimator.filters.states import (
    N_STATES,
    X_BANK,
    X_BANK_RATE,
    X_DISTURBANCE,
    X_PAIR,
    X_POSITION,
    X_UNEVEN,
)
from tilth.estimator.filters.tracker_kernel import (
    GROUND,
    SENSORS,
    JointEstimate,
    RowTally,
    SegmentArrays,
    track_segment,
)
from tilth.estimator.methods import tracker

Array = NDArray[np.float64]
SETUP = rig_setup(MACHINE)
ACTIVE = np.flatnonzero(np.diag(tracker.initial(MACHINE).covariance) > 0.0)
READINGS = 0.1 + 0.0003 * np.arange(30.0)  # of the wheel, rad, at the ticks
BANK_STATES = 4.0, -2.0  # m/s^2


def somewhere(seed: int) -> tuple[Array, Array]:
    """(x, point): in a turn, all unknowns off their means."""
    rng = np.random.default_rng(seed)
    mean, sd = unknowns.prior(MACHINE)
    point = mean.copy()
    for k in ACTIVE:  # each from a stream of its own: another unknown moves none of these
        point[k] += 0.3 * sd[k] * np.random.default_rng([seed, *unknowns.NAMES[k].encode()]).normal()
    x = np.zeros(N_STATES)
    x[X_BANK:X_UNEVEN] = BANK_STATES  # at first; what they do to the lean has settled by the end
    x = moved(x, point, np.full(600, READINGS[20]), 0, 600)
    x[X_POSITION : X_POSITION + 2] = 30.0, -20.0
    x[X_DISTURBANCE:X_BANK] = rng.normal(size=3) * [1e-3, 1e-3, 5e-4]
    x[X_UNEVEN:X_BANK_RATE] = rng.normal(size=2) * 5e-5
    x[X_PAIR:] = rng.normal(size=6) * [2e-3, 2e-3, 2e-3, 2e-3, 1e-4, 1e-4]
    return x, point


def half_a_stretch(
    x: Array, point: Array, covariance: Array, P_xx: Array,
    readings: Array = READINGS, first: int = 20, size: int = 5, setup: RigSetup = SETUP,
    instrument: Array | None = None,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """(x, its covariance, that with the unknowns) after `size` ticks of turning without a measurement. Slopes
    are by steering alone where it is said where that would lead."""
    ticks = np.zeros((len(readings), 8))
    ticks[:, 0], ticks[:, 1] = readings, 4.5
    x, point, P_xx = x.copy(), point.copy(), P_xx.copy()
    P_xtheta = np.zeros((N_STATES, len(point)))
    track_segment(
        SegmentArrays(ticks, first, size, np.zeros((0, 6))),
        JointEstimate(x, point, P_xx, P_xtheta, covariance, (x if instrument is None else instrument).copy()),
        setup._replace(sds=np.zeros(4)), ACTIVE, np.zeros(N_STATES + len(ACTIVE)),
        GroundNoise(np.zeros(3), 0.25, 0.0), RowTally(np.zeros(3), np.zeros((SENSORS + GROUND, 2))),
        instrument is not None,
    )  # fmt: skip
    return x, P_xx, P_xtheta


def moved(
    x: Array, point: Array, readings: Array = READINGS, first: int = 20, size: int = 5,
    setup: RigSetup = SETUP,
) -> Array:  # fmt: skip
    n = len(point)
    nothing = np.zeros((n, n)), np.zeros((N_STATES, N_STATES))
    return half_a_stretch(x, point, *nothing, readings, first, size, setup)[0]
