"""How the tracker's states move over one tick, and how small changes of them do.

States x, shape (16,): the fifteen of predictor.py and the slow sideways error of the implement's antennas
against the tractor's (m). Together with the `active` ones of unknowns.NAMES, which stand still, they are the
joint state, shape (n,).

The model is the nonlinear one. With its slopes, which are taken anew now and then, the mean takes one step
per tick that is exact where the model is linear.
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.compiled import kernel
from tilth.estimator.filters.predictor import (
    CG,
    CURVATURE,
    DT,
    GAIN,
    LATENCY,
    N_STATES,
    PLACED,
    PUSHED,
    ROLLING,
    ZERO,
    rig_at,
)
from tilth.estimator.filters.unknowns import AT
from tilth.estimator.models.nonlinear import rates
from tilth.estimator.models.parameters import Rig

Array = NDArray[np.float64]
Places = NDArray[np.int64]

N_X: Final = N_STATES + 1
SLOW_ASIDE: Final = N_STATES
SHAPE: Final = AT["a"]  # the first of nine
NUDGE: Final = 1e-5  # of the differences, in each one's own unit


@kernel
def motion(
    x: Array, u: float, drive: Array, theta: Array, here: Rig, work: Array, w: Array, forces: Array,
    bent: Array, out: Array,
) -> None:  # fmt: skip
    """Fill out (8,), the rates of the first eight states.

    drive: (3,), wheel angle (rad) and gravity on both bodies (m/s^2). Overwritten: work (13,), w (9,),
    forces (6, 3), bent (13,).
    """
    work[2], work[3], work[4] = x[6], x[7], u
    for i in range(6):
        work[5 + i] = x[i]
    w[0], w[1], w[2], w[3] = drive[0], drive[1] + x[PUSHED], drive[2] + x[PUSHED + 1], u
    rates(work, w, theta, here, (0.0, 0.0), forces, bent)
    for i in range(6):
        out[i] = bent[5 + i]
    out[1] += x[PUSHED + 2]
    out[6], out[7] = x[1], x[2]


@kernel
def slopes(
    x: Array, u: float, drive: Array, point: Array, theta: Array, geometry: Array, here: Rig, rig: Rig,
    active: Places, shapes: Array, work: Array, w: Array, forces: Array, bent: Array, base: Array,
    near: Array, jx: Array, jd: Array, jp: Array,
) -> None:  # fmt: skip
    """Fill jx (8, 11), jd (8,) and jp (8, a): rates over states, wheel angle and active unknowns.

    shapes: (a, 9), how the geometry changes with each unknown. base, near: (8,), overwritten.
    """
    motion(x, u, drive, theta, here, work, w, forces, bent, base)
    at = x.copy()
    for j in range(PUSHED + 2):
        if j == 7:
            continue  # of the headings only the difference matters
        at[j] += NUDGE
        motion(at, u, drive, theta, here, work, w, forces, bent, near)
        at[j] = x[j]
        for i in range(8):
            jx[i, j] = (near[i] - base[i]) / NUDGE
    for i in range(8):
        jx[i, 7] = -jx[i, 6]
        jx[i, PUSHED + 2] = 1.0 if i == 1 else 0.0
    turned = drive[0]
    drive[0] = turned + NUDGE
    motion(x, u, drive, theta, here, work, w, forces, bent, near)
    drive[0] = turned
    for i in range(8):
        jd[i] = (near[i] - base[i]) / NUDGE
    other, shape = theta.copy(), geometry.copy()
    for j in range(active.shape[0]):
        name = active[j]
        there, moves = here, True
        if name < 6:
            other[name] = theta[name] * (1.0 + NUDGE)
        elif name == ROLLING:
            there = rig_at(rig, geometry, point[ROLLING] + NUDGE, point[CURVATURE])
        elif name == CURVATURE:
            there = rig_at(rig, geometry, point[ROLLING], point[CURVATURE] + NUDGE)
        elif name >= SHAPE or name == CG or name == CG + 1:
            for i in range(9):
                shape[i] = geometry[i] + NUDGE * shapes[j, i]
            there = rig_at(rig, shape, point[ROLLING], point[CURVATURE])
        else:
            moves = False
        if moves:
            motion(x, u, drive, other, there, work, w, forces, bent, near)
        for i in range(8):
            jp[i, j] = (near[i] - base[i]) / NUDGE if moves else 0.0
        if name < 6:
            other[name] = theta[name]


@kernel
def held_over(jx: Array, held: Array) -> None:
    """Fill held (8, 8): what a rate that is held adds over DT, the integral of the exponential of jx."""
    own = jx[:, :8].copy()
    power, factor = np.eye(8), DT
    held[:] = DT * power
    for order in range(2, 5):
        power = power @ own
        factor *= DT / order
        held += factor * power


@kernel
def spread(
    held: Array, jx: Array, jd: Array, jp: Array, active: Places, fades: Array, steered: Array, t: Array
) -> None:
    """Fill t (16, n), how a small change of the joint state changes x one tick later, all but what `aimed`
    completes; and steered (8,), how one rad of wheel angle does."""
    t[:, :] = 0.0
    for i in range(8):
        for j in range(PLACED):
            total = 1.0 if i == j else 0.0
            for k in range(8):
                total += held[i, k] * jx[k, j]
            t[i, j] = total
        steered[i] = 0.0
        for k in range(8):
            steered[i] += held[i, k] * jd[k]
        for j in range(active.shape[0]):
            for k in range(6):
                t[i, N_X + j] += held[i, k] * jp[k, j]
    for i in range(PUSHED, N_X):
        t[i, i] = fades[i - PUSHED]


@kernel
def aimed(
    x: Array, after: Array, u: float, steered: Array, active: Places, delta: float, bend: float, scale: float,
    t: Array, turned: Array,
) -> None:  # fmt: skip
    """Complete t (16, n) for one tick: rows of the position, columns of zero, gain and latency; turned: t'.

    steered: (8,), by rad of true wheel angle. delta: that angle; bend: its rate, rad/s; scale: of true angle
    over reading.
    """
    for j in range(active.shape[0]):
        name = active[j]
        if ZERO <= name <= LATENCY:
            factor = -scale if name == ZERO else (-delta if name == GAIN else -bend)
            for i in range(8):
                t[i, N_X + j] = factor * steered[i]
    psi, v = 0.5 * (x[6] + after[6]), 0.5 * (x[0] + after[0])
    sine, cosine = math.sin(psi), math.cos(psi)
    north, east = -u * sine - v * cosine, u * cosine - v * sine
    for j in range(t.shape[1]):
        half_v = 0.5 * DT * (t[0, j] + (1.0 if j == 0 else 0.0))
        half_psi = 0.5 * DT * (t[6, j] + (1.0 if j == 6 else 0.0))
        t[PLACED, j] = -sine * half_v + north * half_psi
        t[PLACED + 1, j] = cosine * half_v + east * half_psi
    t[PLACED, PLACED] = t[PLACED + 1, PLACED + 1] = 1.0
    for i in range(N_X):
        for j in range(t.shape[1]):
            turned[j, i] = t[i, j]


@kernel
def moved(x: Array, u: float, rate: Array, held: Array, fades: Array, out: Array) -> None:
    """Fill out (16,), the state one tick later. fades: (8,), what a tick leaves of the last eight."""
    for i in range(8):
        total = x[i]
        for j in range(8):
            total += held[i, j] * rate[j]
        out[i] = total
    psi, v = 0.5 * (x[6] + out[6]), 0.5 * (x[0] + out[0])
    for i in range(PUSHED, N_X):
        out[i] = fades[i - PUSHED] * x[i]
    out[PLACED] += DT * (u * math.cos(psi) - v * math.sin(psi))
    out[PLACED + 1] += DT * (u * math.sin(psi) + v * math.cos(psi))
