"""How the tracker's filter moves mean and covariance."""

import math

import numpy as np
import pytest
from scipy.linalg import expm
from stretches import ACTIVE, READINGS, SETUP, Array, half_a_stretch, moved, somewhere

from tilth.estimator.filters import unknowns
from tilth.estimator.filters.propagation import (
    set_bank,
)
from tilth.estimator.filters.states import (
    BANK_LENGTH,
    BANK_STATES,
    DT,
    N_STATES,
    X_ALPHA,
    X_BANK,
    X_BANK_RATE,
    X_DISTURBANCE,
    X_PAIR,
    X_POSITION,
    X_PSI,
    X_R,
    X_ROLL,
    X_UNEVEN,
    X_V,
)
from tilth.estimator.filters.tracker_kernel import JointEstimate, pack_covariance, unpack_covariance
from tilth.estimator.filters.transition import empty_transition
from tilth.estimator.filters.unknowns import AT, N_UNKNOWNS, SIX
from tilth.estimator.models import nonlinear
from tilth.estimator.models.parameters import GEOMETRY

PLANAR = [X_V, X_R, X_R + 1, X_ALPHA, X_ALPHA + 1, X_ALPHA + 2, X_PSI, X_PSI + 1, X_POSITION, X_POSITION + 1]
"""The states that the planar model has too, in its order of `simulated`."""
LOW = SETUP._replace(
    rig=SETUP.rig._replace(h_t=0.0, h_i=0.0, h_h=0.0), roll=SETUP.roll._replace(pivot_height=0.0, k_f=1e30)
)
"""Everything at the ground: then no force leans a body."""
HEIGHTS = [AT[name] for name in ("roll_pin", "roll_hitch", "roll_cg_t", "roll_cg_i", "camber", "shrink")]


def at_the_ground(point: Array) -> Array:
    out = point.copy()
    out[HEIGHTS] = 0.0
    return out


def bank_matrix(speed: float) -> Array:
    """(4, 4): d/dt of both cross slopes and their rates. Both are critically damped, the tractor's to nothing
    over BANK_LENGTH, the implement's to the tractor's over half of the way from CG to axle each time."""
    c, d, e = LOW.geometry[2:5]
    own, behind = speed / BANK_LENGTH, 2.0 * speed / (c + d + e)
    return np.array([
        [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0],
        [-(own**2), 0.0, -2.0 * own, 0.0], [behind**2, -(behind**2), 0.0, -2.0 * behind],
    ])  # fmt: skip


def test_the_joint_covariance_comes_back_as_it_was_and_leaves_alone_what_is_not_active() -> None:
    rng, n = np.random.default_rng(1), N_STATES + N_UNKNOWNS
    root = rng.normal(size=(n, n))
    whole, x, unknown = root @ root.T, slice(0, N_STATES), slice(N_STATES, n)
    blocks = (whole[x, x].copy(), whole[x, unknown].copy(), whole[unknown, unknown].copy())
    estimate = JointEstimate(np.zeros(N_STATES), np.zeros(N_UNKNOWNS), *blocks, np.zeros(N_STATES))
    places = np.array([0, 5, 41, N_UNKNOWNS - 1])
    at = np.concatenate([np.arange(N_STATES), N_STATES + places])
    P = np.zeros((len(at), len(at)))
    pack_covariance.interpreted()(estimate, places, P)
    assert np.array_equal(P, whole[np.ix_(at, at)])
    skew = np.triu(rng.normal(size=P.shape), 1)  # what rounding leaves: halved on both sides
    unpack_covariance.interpreted()(P + skew, places, estimate)
    whole[np.ix_(at, at)] = 0.5 * ((P + skew) + (P + skew).T)
    assert np.array_equal(estimate.P_xx, whole[x, x])
    assert np.array_equal(estimate.P_xtheta, whole[x, unknown])
    assert np.array_equal(estimate.P_theta, whole[unknown, unknown])


def test_the_implement_meets_the_cross_slope_of_the_tractor_where_its_wheels_come_to_it() -> None:
    step = empty_transition(0, 0, 1)
    c, d, e = LOW.geometry[2:5]
    for speed in (1.5, 2.0, 4.5):
        set_bank.interpreted()(speed, LOW, step)
        np.testing.assert_allclose(step.bank, expm(DT * bank_matrix(speed)), atol=1e-6)
        followed = np.array([0.0, 0.0, 0.0, 0.0])
        late = 0.0
        for _ in range(round(60.0 / speed / DT)):
            followed[[0, 2]] = 1.0, 0.0  # from here on the tractor is on a slope
            late += (1.0 - followed[1]) * DT * speed
            followed = step.bank @ followed
        assert late == pytest.approx(c + d + e, rel=0.03)  # m, the mean delay of a step


def simulated(x: Array, point: Array, readings: Array) -> Array:
    """x[PLANAR] after as many ticks, less one, by the nonlinear model at 4.5 m/s with LOW's heights."""
    geometry = unknowns.geometry(LOW.geometry, point)
    changes = dict(zip(GEOMETRY, geometry, strict=True)) | dict.fromkeys(
        ("roll_f", "roll_r", "roll_i"), point[AT["rolling"]]
    )
    grips = dict.fromkeys(("grip_f", "grip_r", "grip_i"), 1.0 / point[AT["curvature"]])
    rig = LOW.rig._replace(**changes, **grips)
    time = DT * np.arange(len(readings))
    slopes = np.array([expm(t * bank_matrix(4.5)) @ x[list(BANK_STATES)] for t in time]).T
    inputs = nonlinear.inputs_of(
        len(readings),
        delta=(readings - point[AT["wheel_zero"]]) * math.exp(-point[AT["wheel_gain"]]),
        speed=4.5,
        gravity_t=slopes[0],
        gravity_i=slopes[1],
    )
    start = nonlinear.running(4.5)
    start[:4], start[5:11] = x[[X_POSITION, X_POSITION + 1, X_PSI, X_PSI + 1]], x[PLANAR[:6]]
    held = rig._replace(drive_gain=2e6, drive_limit=1e9)  # the speed stays, by whatever force that takes
    states = nonlinear.simulate(held, inputs, start, DT, soil=np.exp(point[SIX]), linear=True)
    return np.asarray(states[-1, [5, 6, 7, 8, 9, 10, 2, 3, 0, 1]], np.float64)


def test_with_everything_at_the_ground_the_mean_moves_as_the_nonlinear_model_does() -> None:
    x, point = somewhere(1)
    x[X_ROLL:X_PSI] = x[X_DISTURBANCE:X_BANK] = x[X_UNEVEN:X_BANK_RATE] = 0.0
    point = at_the_ground(point)
    after = moved(x, point, READINGS, 20, 5, LOW)
    late = point[AT["latency"]] / DT * (READINGS[1] - READINGS[0])
    true = simulated(x, point, READINGS[20:26] - late)
    assert np.max(np.abs(true - x[PLANAR])) > 0.01
    np.testing.assert_allclose(after[PLANAR[:8]], true[:8], atol=2e-4)
    np.testing.assert_allclose(after[X_POSITION : X_POSITION + 2], true[8:], atol=2e-3)
    np.testing.assert_allclose(after[X_ROLL:X_PSI], 0.0, atol=1e-12)


def test_the_covariance_moves_as_small_changes_do() -> None:
    x, point = somewhere(2)
    n = len(point)
    covariance = np.zeros((n, n))
    covariance[ACTIVE, ACTIVE] = 1.0
    after, P_xx, P_xtheta = half_a_stretch(x, point, covariance, np.eye(N_STATES))
    by_x, by_point = np.zeros((N_STATES, N_STATES)), np.zeros((N_STATES, n))
    for j in range(N_STATES):
        nudge = 1e-6 * np.eye(N_STATES)[j]
        by_x[:, j] = (moved(x + nudge, point) - after) / 1e-6
    for k in ACTIVE:
        nudge = 1e-6 * np.eye(n)[k]
        by_point[:, k] = (moved(x, point + nudge) - after) / 1e-6
    scale = np.abs(by_point).max(axis=0) + 1e-3
    # One set of slopes serves three ticks: what relaxation lengths do while slip grows is right to an eighth.
    np.testing.assert_allclose(P_xtheta / scale, by_point / scale, atol=0.12)
    whole = by_x @ by_x.T + by_point @ by_point.T
    sd = np.sqrt(np.diag(whole))
    np.testing.assert_allclose(P_xx / np.outer(sd, sd), whole / np.outer(sd, sd), atol=0.1)


def test_what_the_ground_does_is_not_in_slopes_by_steering() -> None:
    far = []
    for seed in range(12):
        x, point = somewhere(seed)
        covariance, P_xx = np.diag(np.isin(np.arange(len(point)), ACTIVE).astype(float)), np.eye(N_STATES)
        instrument = x.copy()
        instrument[X_ALPHA:X_ROLL] += 0.02  # as the ground has pushed the rig elsewhere
        instrument[X_DISTURBANCE:X_PAIR] = 0.0
        own = half_a_stretch(x, point, covariance, P_xx, size=1)[2][:X_DISTURBANCE, SIX]
        by_steering = half_a_stretch(x, point, covariance, P_xx, size=1, instrument=instrument)[2][
            :X_DISTURBANCE, SIX
        ]
        there = half_a_stretch(instrument, point, covariance, P_xx, size=1)[2][:X_DISTURBANCE, SIX]
        scale = np.abs(there).max(axis=0)
        far.append(np.abs((by_steering - there) / scale).max())
        assert np.all(np.abs((by_steering - own) / scale).max(axis=0) > 0.5)
    # They are of the steered state but for where the Jacobian over the state was taken, which is once.
    assert np.median(far) < 0.15 and max(far) < 0.4
