"""One-step prediction errors of a record at given unknowns: the likelihood that pem maximises.

States x, shape (12,): v, r_t, r_i, alpha_f, alpha_r, alpha_i (as models.relaxation), psi_t, psi_i (rad, not
wrapped), north and east of the tractor's CG (m), and the slow heading error of each antenna pair (rad).

Between two ticks the relaxation model is integrated exactly for the inputs' mean; with `planar` what the
nonlinear model has beyond it (large angles, tyre curve, load transfer) is added at the middle of the tick, so
that both models stand in one place each. A measurement between two ticks sees the line between their states.
Measurements are taken one by one, so that the likelihood is a sum over scalars:
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
N_STATES: Final = 12
GRAVITY: Final = 9.80665  # m/s^2
PAIR_MEMORY_S: Final = 20.0
SAME_SPEED: Final = 0.03  # m/s: one transition matrix serves speeds this near
ALONG: Final = 0.01  # m per sqrt(s), what the speed's error adds to the way
ACROSS: Final = 0.003  # m per sqrt(s), the slow error that all receivers share
START: Final = (0.4, 0.1, 0.1, 0.1, 0.1, 0.1, 0.05, 0.05, 1.0, 1.0)  # sds of the first state

# Places in unknowns.NAMES; a test holds them equal to unknowns.AT.
ZERO, GAIN, LATENCY, PAIR, LEVER, ASIDE, CG, ROLLING, CURVATURE, Q, S_YAW, S_VELOCITY, S_POSITION = (
    6, 7, 8, 9, 11, 13, 14, 16, 17, 18, 21, 22, 23,
)  # fmt: skip

FULL, KEEP, FOLLOW = 0, 1, 2
"""How the gains of a point are found: its own; its own, kept for others; those that were kept."""


@kernel
def transition(
    u: float, geometry: Array, theta: Array, rolling: float, heights: Array, f: Array, g: Array, a: Array,
    b: Array,
) -> None:  # fmt: skip
    """Fill f (8, 8) and g (8, 3), the step over DT of the first eight states, and a (8, 8), b (8, 3)."""
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
    x: Array, u: float, delta: float, gravity_t: float, gravity_i: float, f: Array, g: Array, a: Array,
    b: Array, theta: Array, rig: Rig, planar: bool, out: Array, work: Array, forces: Array, bent: Array,
) -> None:  # fmt: skip
    """Fill out (12,), the state one tick later. work: (13,), bent: (13,), forces: (6, 3), all overwritten."""
    for i in range(8):
        total = g[i, 0] * delta + g[i, 1] * gravity_t + g[i, 2] * gravity_i
        for j in range(8):
            total += f[i, j] * x[j]
        out[i] = total
    if planar:
        work[:] = 0.0
        work[2], work[3] = 0.5 * (x[6] + out[6]), 0.5 * (x[7] + out[7])
        work[4] = u
        for i in range(6):
            work[5 + i] = 0.5 * (x[i] + out[i])
        w = np.zeros(9)
        w[0], w[1], w[2], w[3] = delta, gravity_t, gravity_i, u
        rates(work, w, theta, rig, (0.0, 0.0), forces, bent)
        for i in range(6):
            straight = b[i, 0] * delta + b[i, 1] * gravity_t + b[i, 2] * gravity_i
            for j in range(6):
                straight += a[i, j] * work[5 + j]
            straight += a[i, 6] * work[2] + a[i, 7] * work[3]
            out[i] += DT * (bent[5 + i] - straight)
        for i in range(2):  # r' acts on the heading within the tick too
            out[6 + i] += (
                0.5 * DT * DT * (bent[6 + i] - _linear_rate(a, b, 1 + i, work, delta, gravity_t, gravity_i))
            )
    psi, v = 0.5 * (x[6] + out[6]), 0.5 * (x[0] + out[0])
    out[8] = x[8] + DT * (u * math.cos(psi) - v * math.sin(psi))
    out[9] = x[9] + DT * (u * math.sin(psi) + v * math.cos(psi))
    fade = math.exp(-DT / PAIR_MEMORY_S)
    out[10], out[11] = fade * x[10], fade * x[11]


@kernel
def _linear_rate(
    a: Array, b: Array, i: int, work: Array, delta: float, gravity_t: float, gravity_i: float
) -> float:
    total = b[i, 0] * delta + b[i, 1] * gravity_t + b[i, 2] * gravity_i
    for j in range(6):
        total += a[i, j] * work[5 + j]
    return float(total + a[i, 6] * work[2] + a[i, 7] * work[3])


@kernel
def spread(x: Array, u: float, f: Array, phi: Array) -> None:
    """Fill phi (12, 12): how a small change of the state goes on over one tick."""
    phi[:] = 0.0
    phi[:8, :8] = f
    sine, cosine = math.sin(x[6]), math.cos(x[6])
    north = -u * sine - x[0] * cosine
    east = u * cosine - x[0] * sine
    for j in range(8):
        half_v = 0.5 * DT * (f[0, j] + (1.0 if j == 0 else 0.0))
        half_psi = 0.5 * DT * (f[6, j] + (1.0 if j == 6 else 0.0))
        phi[8, j] = -sine * half_v + north * half_psi
        phi[9, j] = cosine * half_v + east * half_psi
    phi[8, 8] = phi[9, 9] = 1.0
    phi[10, 10] = phi[11, 11] = math.exp(-DT / PAIR_MEMORY_S)


@kernel
def expected(
    x: Array, kind: float, place: int, u: float, psi_ref: float, geometry: Array, point: Array, levers: Array,
    middles: Array, h: Array,
) -> float:  # fmt: skip
    """What a measurement shows at state x; fills h (12,), its slope. psi_ref: of the body, see record."""
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
    aside = levers[place, 1] + (point[PAIR + body] + x[10 + body]) * arm
    if body == 1:
        aside += point[ASIDE]
    psi = x[6 + body]
    sine, cosine = math.sin(psi), math.cos(psi)
    sine_t, cosine_t = math.sin(x[6]), math.cos(x[6])
    reach = ahead if body == 0 else ahead - d
    hitch = 0.0 if body == 0 else c
    if kind == 2.0:  # north
        h[8] = 1.0
        h[6 + body] = -reach * sine - aside * cosine
        h[10 + body] = -arm * sine
        if body == 1:
            h[6] = hitch * sine_t
        return float(x[8] - hitch * cosine_t + reach * cosine - aside * sine)
    h[9] = 1.0
    h[6 + body] = reach * cosine - aside * sine
    h[10 + body] = arm * cosine
    if body == 1:
        h[6] = -hitch * cosine_t
    return float(x[9] - hitch * sine_t + reach * sine + aside * cosine)


@kernel
def noise_factor(kind: float, point: Array) -> float:
    """By what the stated sd of a measurement is multiplied."""
    if kind == 0.0:
        return math.exp(point[S_YAW])
    if kind == 1.0:
        return math.exp(point[S_VELOCITY])
    return math.exp(point[S_POSITION])


@kernel
def grow(p: Array, phi: Array, q: Array, psi: float, middle: Array) -> None:
    """p (12, 12) one tick later. q: (6,) variances a tick adds: v, r_t, r_i, alpha_f, pair_t, pair_i."""
    for i in range(N_STATES):
        for j in range(N_STATES):
            total = 0.0
            if i < 10:
                for k in range(8):
                    total += phi[i, k] * p[k, j]
                if i >= 8:
                    total += p[i, j]
            else:
                total = phi[i, i] * p[i, j]
            middle[i, j] = total
    for i in range(N_STATES):
        for j in range(i + 1):
            total = 0.0
            if j < 10:
                for k in range(8):
                    total += middle[i, k] * phi[j, k]
                if j >= 8:
                    total += middle[i, j]
            else:
                total = phi[j, j] * middle[i, j]
            p[i, j] = total
            p[j, i] = total
    for i in range(4):
        p[i, i] += q[i]
    p[10, 10] += q[4]
    p[11, 11] += q[5]
    sine, cosine = math.sin(psi), math.cos(psi)
    along, across = ALONG * ALONG * DT, ACROSS * ACROSS * DT
    p[8, 8] += along * cosine * cosine + across * sine * sine
    p[9, 9] += along * sine * sine + across * cosine * cosine
    cross = (along - across) * sine * cosine
    p[8, 9] += cross
    p[9, 8] += cross


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
    ticks: Array, rows: Array, used: Array, x: Array, point: Array, theta: Array, geometry: Array, rig: Rig,
    levers: Array, middles: Array, sds: Array, planar: bool, mode: int, gains: Array, e: Array, s: Array,
) -> None:  # fmt: skip
    """Fill e and s (m,): prediction error and its variance of each row at one point of the unknowns.

    x: (12,), the first state, overwritten with the last. used: (m,), 0.0 for a row to leave out. sds: (3,) of
    the wheel angle of a tick (rad) and of both pairs' slow errors (rad). gains: (m, 24), see FULL.
    """
    n = ticks.shape[0]
    heights = np.array([rig.h_t, rig.h_i])
    f, g, a, b = np.zeros((8, 8)), np.zeros((8, 3)), np.zeros((8, 8)), np.zeros((8, 3))
    phi, p, between = np.zeros((12, 12)), np.zeros((12, 12)), np.zeros((12, 12))
    after, work, bent, forces = np.zeros(12), np.zeros(13), np.zeros(13), np.zeros((6, 3))
    h, slope, cross, gain = np.zeros(12), np.zeros(12), np.zeros(12), np.zeros(12)
    shown, unused = np.zeros(12), np.zeros(12)
    q = np.zeros(6)
    for i in range(10):
        p[i, i] = START[i] * START[i]
    fade = math.exp(-DT / PAIR_MEMORY_S)
    for i in range(3):
        q[i] = (math.exp(point[Q + i]) * DT) ** 2
    for i in range(2):
        p[10 + i, 10 + i] = sds[1 + i] * sds[1 + i]
        q[4 + i] = (1.0 - fade * fade) * sds[1 + i] * sds[1 + i]
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
            transition(u, geometry, theta, rolling, heights, f, g, a, b)
            known_u = u
            q[3] = (u / theta[3] * sds[0] * DT) ** 2
        delta = 0.5 * (reading_at(ticks, k, point[LATENCY]) + reading_at(ticks, nxt, point[LATENCY]))
        delta = (delta - point[ZERO]) * scale
        gravity_t = GRAVITY * math.sin(0.5 * (ticks[k, 6] + ticks[nxt, 6]))
        gravity_i = GRAVITY * math.sin(0.5 * (ticks[k, 7] + ticks[nxt, 7]))
        advance(x, u, delta, gravity_t, gravity_i, f, g, a, b, theta, here, planar, after, work, forces, bent)
        spread(x, u, f, phi)
        while row < m and rows[row, 0] <= k:
            if used[row] == 0.0:
                e[row], s[row] = 0.0, 1.0
                row += 1
                continue
            share = rows[row, 1] / DT
            kind, place = rows[row, 2], int(rows[row, 3])
            body = place if kind == 0.0 or kind == 4.0 else (0 if place < 2 else 1)
            psi_ref = ticks[k, 2 + body] + share * (ticks[nxt, 2 + body] - ticks[k, 2 + body])
            value = expected(x, kind, place, u, psi_ref, geometry, point, levers, middles, h)
            later = expected(after, kind, place, u, psi_ref, geometry, point, levers, middles, unused)
            error = rows[row, 4] - (value + share * (later - value))
            if mode == FOLLOW:
                for i in range(12):
                    x[i] += gains[row, i] * error
                    after[i] += gains[row, 12 + i] * error
                e[row] = error
                row += 1
                continue
            for j in range(12):
                shown[j] = (1.0 - share) * h[j]
            for i in range(12):
                if h[i] != 0.0:
                    for j in range(12):
                        shown[j] += share * h[i] * phi[i, j]
            variance = (rows[row, 5] * noise_factor(kind, point)) ** 2
            for i in range(12):
                total = 0.0
                for j in range(12):
                    total += p[i, j] * shown[j]
                cross[i] = total
            for i in range(12):
                variance += shown[i] * cross[i]
            inverse = 1.0 / variance
            for i in range(12):
                gain[i] = cross[i] * inverse
            for i in range(12):
                for j in range(i + 1):
                    p[i, j] -= gain[i] * cross[j]
                    p[j, i] = p[i, j]
            for i in range(10):
                total = gain[i] if i >= 8 else 0.0
                for j in range(8):
                    total += phi[i, j] * gain[j]
                slope[i] = total
            slope[10], slope[11] = fade * gain[10], fade * gain[11]
            for i in range(12):
                x[i] += gain[i] * error
                after[i] += slope[i] * error
            if mode == KEEP:
                gains[row, :12] = gain
                gains[row, 12:] = slope
            e[row], s[row] = error, variance
            row += 1
        if not last:
            if mode != FOLLOW:
                grow(p, phi, q, x[6], between)
            x[:] = after
    while row < m:
        e[row], s[row] = 0.0, 1.0
        row += 1


@kernel
def innovations(
    ticks: Array, rows: Array, used: Array, start: Array, points: Array, thetas: Array, geometries: Array,
    modes: Array, rig: Rig, levers: Array, middles: Array, sds: Array, planar: bool, e: Array, s: Array,
) -> None:  # fmt: skip
    """Fill e and s, shape (q, m), at each of the points, shape (q, n of unknowns.NAMES).

    thetas: (q, 6), geometries: (q, 9), both of the points. modes: (q,), FULL, KEEP or FOLLOW as float; what
    follows has the variances of the first point.
    """
    gains = np.zeros((rows.shape[0], 24))
    for i in range(points.shape[0]):
        x = start.copy()
        mode = int(modes[i])
        if mode == FOLLOW:
            s[i] = s[0]
        filtered(
            ticks, rows, used, x, points[i], thetas[i], geometries[i], rig, levers, middles, sds, planar,
            mode, gains, e[i], s[i],
        )  # fmt: skip
