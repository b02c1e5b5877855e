"""One-step prediction errors of a record at given unknowns: the likelihood that pem maximises.

States x, shape (15,): v, r_t, r_i, alpha_f, alpha_r, alpha_i (as models.relaxation), psi_t, psi_i (rad, not
wrapped); how the ground pushes across the tractor and across the implement, at their CGs as gravity does
(m/s^2), and what it adds to r_t' (rad/s^2), three first-order Gauss-Markov processes of one memory; north and
east of the tractor's CG (m); the slow heading error of each antenna pair (rad).

Between two ticks the relaxation model is integrated exactly for the inputs' mean; with `planar` what the
nonlinear model has beyond it (large angles, tyre curve, load transfer) is added, found in the middle of two
ticks, so that both models stand in one place each. A measurement between two ticks sees the line between
their states. Measurements are taken one by one, so that the likelihood is a sum over scalars:
log L = -1/2 sum (e^2 / S + log S).
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.compiled import kernel
from tilth.estimator.models.nonlinear import rates
from tilth.estimator.models.parameters import Rig
from tilth.estimator.models.relaxation import input_matrix, system_matrix

Array = NDArray[np.float64]

DT: Final = 0.02  # s, of a tick
N_STATES: Final = 15
PUSHED, PLACED, PAIRED = 8, 11, 13  # the first of the states of the ground, of the place and of the pairs
GRAVITY: Final = 9.80665  # m/s^2
PAIR_MEMORY_S: Final = 20.0
FADE: Final = math.exp(-DT / PAIR_MEMORY_S)
SAME_SPEED: Final = 0.03  # m/s: one transition matrix serves speeds this near
ALONG: Final = 0.01  # m per sqrt(s), what the speed's error adds to the way
ACROSS: Final = 0.003  # m per sqrt(s), the slow error that all receivers share
START: Final = (0.4, 0.1, 0.1, 0.1, 0.1, 0.1, 0.05, 0.05)  # sds of the first eight states
START_PLACE: Final = 1.0  # m

# Places in unknowns.NAMES; a test holds them equal to unknowns.AT.
ZERO, GAIN, LATENCY, PAIR, LEVER, ASIDE, CG, ROLLING, CURVATURE, Q, MEMORY, S_YAW, S_VELOCITY, S_POSITION = (
    6, 7, 8, 9, 11, 13, 14, 16, 17, 18, 21, 22, 23, 24,
)  # fmt: skip

FULL, KEEP, FOLLOW = 0, 1, 2
"""How the gains of a point are found: its own; its own, kept for others; those that were kept."""


@kernel
def transition(
    u: float, geometry: Array, theta: Array, rolling: float, heights: Array, f: Array, g: Array,
    pushed: Array, a: Array, b: Array,
) -> None:  # fmt: skip
    """Fill f (8, 8), g (8, 3) and pushed (8, 3): the step over DT of the first eight states for themselves,
    for the inputs and for the ground's pushes, both held; and a (8, 8), b (8, 3)."""
    whole = system_matrix(u, geometry, theta, rolling, (heights[0], heights[1]))
    drive = input_matrix(u, geometry, theta, rolling, (heights[0], heights[1]))
    for i in range(8):
        row = i if i < 6 else i + 1
        for j in range(8):
            a[i, j] = whole[row, j if j < 6 else j + 1]
        for j in range(3):
            b[i, j] = drive[row, j]
    f[:] = np.eye(8)
    held = DT * np.eye(8)
    power = np.eye(8)
    factor = 1.0
    for order in range(1, 6):
        power = power @ a
        factor *= DT / order
        f += factor * power
        held += (factor * DT / (order + 1)) * power
    g[:] = held @ b
    pushed[:, :2] = g[:, 1:]
    pushed[:, 2] = held[:, 1]


@kernel
def reading_at(ticks: Array, k: int, behind: float) -> float:
    """The wheel's reading `behind` seconds before tick k (linear between ticks, held at the ends)."""
    n = ticks.shape[0]
    at = k - behind / DT
    if at <= 0.0:
        return float(ticks[0, 0])
    if at >= n - 1:
        return float(ticks[n - 1, 0])
    low = int(at)
    share = at - low
    return float(ticks[low, 0] * (1.0 - share) + ticks[low + 1, 0] * share)


@kernel
def advance(
    x: Array, u: float, inputs: Array, f: Array, g: Array, pushed: Array, beyond: Array, lasts: float,
    out: Array,
) -> None:  # fmt: skip
    """Fill out (15,), the state one tick later.

    inputs: (3,), as relaxation.INPUTS. beyond: (6,), what `bend` found. lasts: what is left of the ground's
    push after a tick.
    """
    for i in range(8):
        total = 0.0
        for j in range(3):
            total += g[i, j] * inputs[j] + pushed[i, j] * x[PUSHED + j]
        for j in range(8):
            total += f[i, j] * x[j]
        out[i] = total
    for i in range(6):
        out[i] += DT * beyond[i]
    for i in range(2):  # r' acts on the heading within the tick too
        out[6 + i] += 0.5 * DT * DT * beyond[1 + i]
    for i in range(PUSHED, PLACED):
        out[i] = lasts * x[i]
    psi, v = 0.5 * (x[6] + out[6]), 0.5 * (x[0] + out[0])
    sine, cosine = math.sin(psi), math.cos(psi)
    out[PLACED] = x[PLACED] + DT * (u * cosine - v * sine)
    out[PLACED + 1] = x[PLACED + 1] + DT * (u * sine + v * cosine)
    for i in range(PAIRED, N_STATES):
        out[i] = FADE * x[i]


@kernel
def bend(
    x: Array, u: float, inputs: Array, a: Array, b: Array, theta: Array, rig: Rig, work: Array, forces: Array,
    bent: Array, beyond: Array,
) -> None:  # fmt: skip
    """Fill beyond (6,): rates of the nonlinear model less those of the relaxation model at state x.

    work: (22,), forces: (6, 3), bent: (13,), all overwritten.
    """
    still, w = work[:13], work[13:]
    still[:] = 0.0
    still[2], still[3], still[4] = x[6], x[7], u
    for i in range(6):
        still[5 + i] = x[i]
    w[:] = 0.0
    w[0], w[1], w[2], w[3] = inputs[0], inputs[1], inputs[2], u
    rates(still, w, theta, rig, (0.0, 0.0), forces, bent)
    for i in range(6):
        straight = 0.0
        for j in range(3):
            straight += b[i, j] * inputs[j]
        for j in range(8):
            straight += a[i, j] * x[j]
        beyond[i] = bent[5 + i] - straight


@kernel
def spread(x: Array, u: float, f: Array, pushed: Array, lasts: float, phi: Array, turned: Array) -> None:
    """Fill phi (15, 15), how a small change of the state goes on over one tick, and turned, its transpose.

    Only what `grow` and `carried` read of them, which is what is not zero.
    """
    for i in range(8):
        for j in range(8):
            phi[i, j] = turned[j, i] = f[i, j]
        for j in range(3):
            phi[i, PUSHED + j] = turned[PUSHED + j, i] = pushed[i, j]
    sine, cosine = math.sin(x[6]), math.cos(x[6])
    north = -u * sine - x[0] * cosine
    east = u * cosine - x[0] * sine
    for j in range(8):
        half_v = 0.5 * DT * (f[0, j] + (1.0 if j == 0 else 0.0))
        half_psi = 0.5 * DT * (f[6, j] + (1.0 if j == 6 else 0.0))
        phi[PLACED, j] = turned[j, PLACED] = -sine * half_v + north * half_psi
        phi[PLACED + 1, j] = turned[j, PLACED + 1] = cosine * half_v + east * half_psi
    for i in range(PUSHED, N_STATES):
        phi[i, i] = turned[i, i] = lasts if i < PLACED else (1.0 if i < PAIRED else FADE)


@kernel
def expected(
    x: Array, kind: float, place: int, u: float, psi_ref: float, geometry: Array, point: Array, levers: Array,
    middles: Array, h: Array,
) -> float:  # fmt: skip
    """What a measurement shows at state x; fills h (15,), its slope. psi_ref: of the body, see record."""
    h[:] = 0.0
    if kind == 0.0:  # yaw rate
        h[1 + place] = 1.0
        return float(x[1 + place])
    if kind == 4.0:  # heading
        h[6 + place] = 1.0
        return float(x[6 + place])
    body = 0 if place < 2 else 1
    c, d = geometry[2], geometry[3]
    ahead = levers[place, 0] + point[LEVER + body] - point[CG + body]
    if kind == 1.0:  # velocity across the reference heading
        angle = x[6] - psi_ref
        sine, cosine = math.sin(angle), math.cos(angle)
        h[0] = cosine
        if body == 0:
            h[1] = ahead * cosine
            side = x[0] + x[1] * ahead
            h[6] = u * cosine - side * sine
            return float(u * sine + side * cosine)
        side = x[0] - c * x[1]
        h[1] = -c * cosine
        h[2] = ahead - d
        h[6] = u * cosine - side * sine
        return float(u * sine + side * cosine + (ahead - d) * x[2])
    arm = levers[place, 0] - middles[body, 0]
    aside = levers[place, 1] + (point[PAIR + body] + x[PAIRED + body]) * arm
    if body == 1:
        aside += point[ASIDE]
    psi = x[6 + body]
    sine, cosine = math.sin(psi), math.cos(psi)
    sine_t, cosine_t = math.sin(x[6]), math.cos(x[6])
    reach = ahead if body == 0 else ahead - d
    hitch = 0.0 if body == 0 else c
    if kind == 2.0:  # north
        h[PLACED] = 1.0
        h[6 + body] = -reach * sine - aside * cosine
        h[PAIRED + body] = -arm * sine
        if body == 1:
            h[6] = hitch * sine_t
        return float(x[PLACED] - hitch * cosine_t + reach * cosine - aside * sine)
    h[PLACED + 1] = 1.0
    h[6 + body] = reach * cosine - aside * sine
    h[PAIRED + body] = arm * cosine
    if body == 1:
        h[6] = -hitch * cosine_t
    return float(x[PLACED + 1] - hitch * sine_t + reach * sine + aside * cosine)


@kernel
def noise_factor(kind: float, point: Array) -> float:
    """By what the stated sd of a measurement is multiplied."""
    if kind == 0.0:
        return math.exp(point[S_YAW])
    if kind == 1.0:
        return math.exp(point[S_VELOCITY])
    return math.exp(point[S_POSITION])


@kernel
def carried(change: Array, turned: Array, out: Array) -> None:
    """Fill out (15,): what a small change of the state (15,) has become a tick later."""
    for j in range(8):
        out[j] = 0.0
    for k in range(PLACED):
        part = change[k]
        for j in range(8):
            out[j] += part * turned[k, j]
    for j in range(PUSHED, N_STATES):
        out[j] = change[j] * turned[j, j]
    for j in range(PLACED, PAIRED):
        for k in range(8):
            out[j] += change[k] * turned[k, j]


@kernel
def strays(p: Array, psi: float) -> None:
    """Add to a covariance p what a tick adds to that of the place, along and across the heading psi."""
    sine, cosine = math.sin(psi), math.cos(psi)
    along, across = ALONG * ALONG * DT, ACROSS * ACROSS * DT
    p[PLACED, PLACED] += along * cosine * cosine + across * sine * sine
    p[PLACED + 1, PLACED + 1] += along * sine * sine + across * cosine * cosine
    cross = (along - across) * sine * cosine
    p[PLACED, PLACED + 1] += cross
    p[PLACED + 1, PLACED] += cross


@kernel
def grow(p: Array, phi: Array, turned: Array, q: Array, psi: float, middle: Array) -> None:
    """p (15, 15) one tick later. q: (6,), variances that a tick adds to alpha_f, the pushes and both pairs.

    Rows are added to rows and zeros are not touched, three times as fast as two products of matrices.
    """
    for i in range(8):
        for j in range(N_STATES):
            middle[i, j] = phi[i, 0] * p[0, j]
        for k in range(1, PLACED):
            part = phi[i, k]
            for j in range(N_STATES):
                middle[i, j] += part * p[k, j]
    for i in range(PUSHED, N_STATES):
        part = phi[i, i]
        for j in range(N_STATES):
            middle[i, j] = part * p[i, j]
    for i in range(PLACED, PAIRED):
        for k in range(8):
            part = phi[i, k]
            for j in range(N_STATES):
                middle[i, j] += part * p[k, j]
    for i in range(N_STATES):
        carried(middle[i], turned, p[i])
    p[3, 3] += q[0]
    for i in range(3):
        p[PUSHED + i, PUSHED + i] += q[1 + i]
    for i in range(2):
        p[PAIRED + i, PAIRED + i] += q[4 + i]
    strays(p, psi)


@kernel
def rig_at(rig: Rig, geometry: Array, rolling: float, curvature: float) -> Rig:
    """The rig with this geometry, rolling resistance and tyre curve."""
    grip = 1.0 / max(curvature, 1e-3)
    return Rig(
        geometry[0], geometry[1], geometry[2], geometry[3], geometry[4], geometry[5], geometry[6],
        geometry[7], geometry[8], rig.C_af, rig.C_ar, rig.C_ai, rig.sigma_f, rig.sigma_r, rig.sigma_i,
        rig.h_t, rig.h_i, rig.h_h, rig.w_f, rig.w_r, rig.w_i, rig.roll_share_f, grip, grip, grip,
        rig.load_exponent, rolling, rolling, rolling, rig.front_drive, rig.drive_gain, rig.drive_limit, rig.g,
    )  # fmt: skip


@kernel
def filtered(
    ticks: Array, rows: Array, readings: Array, used: Array, x: Array, point: Array, theta: Array,
    geometry: Array, rig: Rig, levers: Array, middles: Array, sds: Array, planar: bool, mode: int,
    gains: Array, e: Array, s: Array,
) -> None:  # fmt: skip
    """Fill e and s (m,): prediction error and its variance of each row at one point of the unknowns.

    readings: (m,), what was measured. x: (15,), the first state, overwritten with the last. used: (m,), 0.0
    for a row to leave out. sds: (3,) of the wheel angle of a tick (rad) and of both pairs' slow errors (rad).
    gains: (m, 30), see FULL.
    """
    n = ticks.shape[0]
    heights = np.array([rig.h_t, rig.h_i])
    f, g, pushed = np.zeros((8, 8)), np.zeros((8, 3)), np.zeros((8, 3))
    a, b = np.zeros((8, 8)), np.zeros((8, 3))
    shape = (N_STATES, N_STATES)
    phi, turned, p, middle = np.zeros(shape), np.zeros(shape), np.zeros(shape), np.zeros(shape)
    after, between = np.zeros(N_STATES), np.zeros(N_STATES)
    inputs, beyond = np.zeros(3), np.zeros(6)
    work, bent, forces = np.zeros(22), np.zeros(13), np.zeros((6, 3))
    h, slope, cross, gain = np.zeros(N_STATES), np.zeros(N_STATES), np.zeros(N_STATES), np.zeros(N_STATES)
    shown = np.zeros(N_STATES)
    q = np.zeros(6)
    for i in range(8):
        p[i, i] = START[i] * START[i]
    lasts = math.exp(-DT / math.exp(point[MEMORY]))
    for i in range(3):
        variance = math.exp(2.0 * point[Q + i])
        p[PUSHED + i, PUSHED + i] = variance
        q[1 + i] = (1.0 - lasts * lasts) * variance
    for i in range(2):
        p[PLACED + i, PLACED + i] = START_PLACE * START_PLACE
        p[PAIRED + i, PAIRED + i] = sds[1 + i] * sds[1 + i]
        q[4 + i] = (1.0 - FADE * FADE) * sds[1 + i] * sds[1 + i]
    rolling = point[ROLLING]
    here = rig_at(rig, geometry, rolling, point[CURVATURE])
    scale = math.exp(-point[GAIN])
    known_u = -1e9
    m, row = rows.shape[0], 0
    for k in range(n):
        last = k == n - 1
        nxt = k if last else k + 1
        u = 0.5 * (ticks[k, 1] + ticks[nxt, 1])
        if abs(u - known_u) > SAME_SPEED:
            transition(u, geometry, theta, rolling, heights, f, g, pushed, a, b)
            known_u = u
            q[0] = (u / theta[3] * sds[0] * DT) ** 2
        delta = 0.5 * (reading_at(ticks, k, point[LATENCY]) + reading_at(ticks, nxt, point[LATENCY]))
        inputs[0] = (delta - point[ZERO]) * scale
        for i in range(2):
            inputs[1 + i] = GRAVITY * math.sin(0.5 * (ticks[k, 6 + i] + ticks[nxt, 6 + i]))
        advance(x, u, inputs, f, g, pushed, beyond, lasts, after)
        if planar and k % 2 == 0:
            bend(after, u, inputs, a, b, theta, here, work, forces, bent, beyond)
            advance(x, u, inputs, f, g, pushed, beyond, lasts, after)
        if mode != FOLLOW:
            spread(x, u, f, pushed, lasts, phi, turned)
        while row < m and rows[row, 0] <= k:
            if used[row] == 0.0:
                e[row], s[row] = 0.0, 1.0
                row += 1
                continue
            share = rows[row, 1] / DT
            kind, place = rows[row, 2], int(rows[row, 3])
            body = place if kind == 0.0 or kind == 4.0 else (0 if place < 2 else 1)
            psi_ref = ticks[k, 2 + body] + share * (ticks[nxt, 2 + body] - ticks[k, 2 + body])
            for j in range(N_STATES):
                between[j] = x[j] + share * (after[j] - x[j])
            error = readings[row] - expected(
                between, kind, place, u, psi_ref, geometry, point, levers, middles, h
            )
            if mode != FOLLOW:
                for j in range(N_STATES):
                    shown[j] = (1.0 - share) * h[j]
                for i in range(N_STATES):
                    if h[i] != 0.0:
                        for j in range(N_STATES):
                            shown[j] += share * h[i] * phi[i, j]
                cross[:] = 0.0
                for j in range(N_STATES):
                    part = shown[j]
                    if part != 0.0:
                        for i in range(N_STATES):
                            cross[i] += part * p[j, i]
                variance = (rows[row, 5] * noise_factor(kind, point)) ** 2
                for i in range(N_STATES):
                    variance += shown[i] * cross[i]
                for i in range(N_STATES):
                    gain[i] = cross[i] / variance
                    part = gain[i]
                    for j in range(N_STATES):
                        p[i, j] -= part * cross[j]
                carried(gain, turned, slope)
                s[row] = variance
                if mode == KEEP:
                    gains[row, :N_STATES] = gain
                    gains[row, N_STATES:] = slope
            else:
                gain = gains[row, :N_STATES]
                slope = gains[row, N_STATES:]
            for i in range(N_STATES):
                x[i] += gain[i] * error
                after[i] += slope[i] * error
            e[row] = error
            row += 1
        if not last:
            if mode != FOLLOW:
                grow(p, phi, turned, q, x[6], middle)
            x[:] = after
    while row < m:
        e[row], s[row] = 0.0, 1.0
        row += 1


@kernel
def innovations(
    ticks: Array, rows: Array, readings: Array, used: Array, start: Array, points: Array, thetas: Array,
    geometries: Array, modes: Array, rig: Rig, levers: Array, middles: Array, sds: Array, planar: bool,
    e: Array, s: Array,
) -> None:  # fmt: skip
    """Fill e and s, shape (q, m), at each of the points, shape (q, n of unknowns.NAMES).

    readings: (q, m), what was measured, as each point is told. thetas: (q, 6), geometries: (q, 9), both of
    the points. modes: (q,), FULL, KEEP or FOLLOW as float; what follows has the variances of the first point,
    and where none is kept before it corrects nothing: the open loop.
    """
    gains = np.zeros((rows.shape[0], 2 * N_STATES))
    for i in range(points.shape[0]):
        x = start.copy()
        mode = int(modes[i])
        if mode == FOLLOW:
            s[i] = s[0]
        filtered(
            ticks, rows, readings[i], used, x, points[i], thetas[i], geometries[i], rig, levers, middles,
            sds, planar, mode, gains, e[i], s[i],
        )  # fmt: skip
