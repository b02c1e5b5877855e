"""One stretch of the record through an extended Kalman filter whose states include what nobody knows.

The joint state is that of tracker_model.py. Measurements come one by one, at their own instants between two
ticks, and each is gated.
"""

import math
from typing import Final

import numpy as np

from tilth.estimator.compiled import kernel
from tilth.estimator.filters.predictor import (
    ASIDE,
    CG,
    CURVATURE,
    DT,
    FADE,
    GAIN,
    GRAVITY,
    LATENCY,
    LEVER,
    PAIR,
    PAIRED,
    PLACED,
    PUSHED,
    ROLLING,
    ZERO,
    expected,
    noise_factor,
    reading_at,
    rig_at,
    strays,
)
from tilth.estimator.filters.tracker_model import (
    N_X,
    NUDGE,
    SLOW_ASIDE,
    Array,
    Places,
    aimed,
    held_over,
    motion,
    moved,
    slopes,
    spread,
)
from tilth.estimator.filters.unknowns import geometry as geometry_at
from tilth.estimator.models.parameters import Rig

EVERY: Final = 5  # ticks that one set of slopes serves
GATE: Final = 5.0  # sds
USED, GATED, BAD = 0, 1, 2  # places in `counts`


@kernel
def grow(p: Array, t: Array, turned: Array, q: Array, psi: float, middle: Array) -> None:
    """p (n, n), the joint covariance, one tick later. q: (16,) variances that a tick adds to x.

    Slow errors of antennas and all unknowns move by nothing else. Rows are added to rows: wide instructions.
    """
    n = p.shape[0]
    middle[:PAIRED] = 0.0
    for i in range(PAIRED):
        for k in range(n):
            if t[i, k] != 0.0:
                for j in range(n):
                    middle[i, j] += t[i, k] * p[k, j]
    for i in range(PAIRED, N_X):
        for j in range(PAIRED, n):
            left = t[i, i] * (t[j, j] if j < N_X else 1.0)
            p[i, j] *= left
            if j >= N_X:
                p[j, i] = p[i, j]
    for i in range(PAIRED):
        for j in range(PAIRED):
            p[i, j] = 0.0
        for k in range(n):
            if k < PAIRED or turned[k, 0] != 0.0 or turned[k, 1] != 0.0:
                for j in range(PAIRED):
                    p[i, j] += middle[i, k] * turned[k, j]
        for j in range(PAIRED, n):
            p[i, j] = middle[i, j] * (t[j, j] if j < N_X else 1.0)
            p[j, i] = p[i, j]
    for i in range(N_X):
        p[i, i] += q[i]
    strays(p, psi)


@kernel
def arms(x: Array, kind: float, body: int, psi_ref: float) -> tuple[float, float, float]:
    """By how much what a receiver shows changes per metre: of it further forward, of the hitch further back
    from the tractor's CG, of it further right."""
    if kind == 1.0:
        cosine = math.cos(x[6] - psi_ref)
        return (x[1] * cosine, 0.0, 0.0) if body == 0 else (x[2], -x[1] * cosine, 0.0)
    sine, cosine = math.sin(x[6 + body]), math.cos(x[6 + body])
    if kind == 2.0:
        return cosine, 0.0 if body == 0 else -math.cos(x[6]), -sine
    return sine, 0.0 if body == 0 else -math.sin(x[6]), cosine


@kernel
def seen(
    x: Array, kind: float, place: int, u: float, psi_ref: float, geometry: Array, point: Array,
    active: Places, shapes: Array, levers: Array, middles: Array, h: Array,
) -> float:  # fmt: skip
    """What a measurement shows; fills h (n,), its slope over the joint state."""
    value: float = expected(x, kind, place, u, psi_ref, geometry, point, levers, middles, h)
    if kind == 0.0 or kind == 4.0:
        return value
    body = 0 if place < 2 else 1
    ahead, back, aside = arms(x, kind, body, psi_ref)
    if body == 1:
        h[SLOW_ASIDE] = aside
        value += aside * x[SLOW_ASIDE]
    for j in range(active.shape[0]):
        name = active[j]
        if name == LEVER + body:
            h[N_X + j] = ahead
        elif name == CG and body == 0:
            h[N_X + j] = -ahead
        elif name == PAIR + body:
            h[N_X + j] = h[PAIRED + body]
        elif name == ASIDE and body == 1:
            h[N_X + j] = aside
        elif body == 1 and name != CG + 1:  # that moves d and the receivers alike
            h[N_X + j] = back * shapes[j, 2] - ahead * shapes[j, 3]
    return value


@kernel
def corrected(
    error: float, variance: float, shown: Array, p: Array, keep: Array, x: Array, after: Array, point: Array,
    active: Places, turned: Array, cross: Array, gain: Array, slope: Array,
) -> float:  # fmt: skip
    """Take one measurement into x, after, point and p; what is in `keep` (1.0) stays as it is.

    The variance with which it was expected; negative where it is beyond GATE and nothing was taken.
    """
    n = p.shape[0]
    cross[:] = 0.0
    for k in range(n):
        if shown[k] != 0.0:
            for i in range(n):
                cross[i] += shown[k] * p[k, i]
    for i in range(n):
        variance += shown[i] * cross[i]
    if error * error > GATE * GATE * variance:
        return -variance
    inverse = 1.0 / variance
    slope[:] = 0.0
    for i in range(n):
        gain[i] = cross[i] * inverse
        if keep[i] == 0.0:
            for j in range(n):
                p[i, j] -= gain[i] * cross[j]
            for j in range(N_X):
                slope[j] += gain[i] * turned[i, j]
        else:  # consider: its own variance stays, the correlation with what was corrected is known
            for j in range(n):
                p[i, j] -= (1.0 - keep[j]) * gain[i] * cross[j]
            gain[i] = 0.0
    for i in range(N_X):
        x[i] += gain[i] * error
        after[i] += slope[i] * error
    for j in range(active.shape[0]):
        point[active[j]] += gain[N_X + j] * error
    return variance


@kernel
def joined(point: Array, covariance: Array, own: Array, between: Array, active: Places) -> Array:
    """The joint covariance, shape (n, n)."""
    na = active.shape[0]
    p = np.zeros((N_X + na, N_X + na))
    p[:N_X, :N_X] = own
    for j in range(na):
        for i in range(N_X):
            p[i, N_X + j] = p[N_X + j, i] = between[i, active[j]]
        for i in range(na):
            p[N_X + i, N_X + j] = covariance[active[i], active[j]]
    return p


@kernel
def parted(p: Array, covariance: Array, own: Array, between: Array, active: Places) -> None:
    """The reverse of `joined`, made symmetric."""
    na = active.shape[0]
    for i in range(N_X):
        for j in range(N_X):
            own[i, j] = 0.5 * (p[i, j] + p[j, i])
        for j in range(na):
            between[i, active[j]] = 0.5 * (p[i, N_X + j] + p[N_X + j, i])
    for i in range(na):
        for j in range(na):
            covariance[active[i], active[j]] = 0.5 * (p[N_X + i, N_X + j] + p[N_X + j, N_X + i])


@kernel
def driven(ticks: Array, k: int, point: Array, drive: Array) -> tuple[float, float]:
    """Fill drive (3,), what drives the rig in the middle of tick k; (speed, rate of the true wheel angle)."""
    k = min(k, ticks.shape[0] - 1)
    nxt = min(k + 1, ticks.shape[0] - 1)
    scale = math.exp(-point[GAIN])
    early, late = reading_at(ticks, k, point[LATENCY]), reading_at(ticks, nxt, point[LATENCY])
    drive[0] = (0.5 * (early + late) - point[ZERO]) * scale
    drive[1] = GRAVITY * math.sin(0.5 * (ticks[k, 6] + ticks[nxt, 6]))
    drive[2] = GRAVITY * math.sin(0.5 * (ticks[k, 7] + ticks[nxt, 7]))
    return 0.5 * (ticks[k, 1] + ticks[nxt, 1]), (late - early) / DT * scale


@kernel
def tracked(
    ticks: Array, first: int, count: int, rows: Array, keep: Array, point: Array, covariance: Array, x: Array,
    own: Array, between: Array, active: Places, surveyed: Array, rig: Rig, levers: Array, middles: Array,
    sds: Array, noise: Array, counts: Array, sums: Array,
) -> None:  # fmt: skip
    """Take ticks `first` to `first + count` of ticks and the rows among them, whose ticks count from `first`.

    Overwritten: point (n,) and covariance (n, n) of unknowns.NAMES, x (16,), own (16, 16), its covariance,
    and between (16, n), that of x with the unknowns. keep: (16 + a,), 1.0 for what may not be learned.
    noise: (5,), sds of the ground's pushes (3), their memory (s), sd of the slow sideways error (m).
    counts: (3,), added to. sums: (6, 2), added to: of yaw rates, velocities and positions the squares of what
    is left over the stated sds, and their number; of the pushes their squares and what was expected of those.
    """
    na, last = active.shape[0], ticks.shape[0] - 1
    p = joined(point, covariance, own, between, active)
    n = p.shape[0]
    shapes = np.zeros((na, 9))
    geometry = geometry_at(surveyed, point)
    here = rig_at(rig, geometry, point[ROLLING], point[CURVATURE])
    for j in range(na):
        before = point[active[j]]
        point[active[j]] += NUDGE
        shapes[j] = (geometry_at(surveyed, point) - geometry) / NUDGE
        point[active[j]] = before
    theta, drive, rate, near = np.zeros(6), np.zeros(3), np.zeros(8), np.zeros(8)
    work, w, bent, forces = np.zeros(13), np.zeros(9), np.zeros(13), np.zeros((6, 3))
    jx, jd, jp = np.zeros((8, PLACED)), np.zeros(8), np.zeros((8, na))
    held, steered, t, turned = np.zeros((8, 8)), np.zeros(8), np.zeros((N_X, n)), np.zeros((n, N_X))
    middle, after, x_at = np.zeros((N_X, n)), np.zeros(N_X), np.zeros(N_X)
    h, shown, cross, gain, slope = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(N_X)
    q, fades = np.zeros(N_X), np.ones(N_X - PUSHED)
    for i in range(3):
        fades[i], fades[PAIRED - PUSHED + i] = math.exp(-DT / noise[3]), FADE
        q[PUSHED + i] = (1.0 - fades[i] ** 2) * noise[i] ** 2
        q[PAIRED + i] = (1.0 - FADE**2) * (sds[1 + i] if i < 2 else noise[4]) ** 2
    row, m = 0, rows.shape[0]
    for k in range(first, first + count):
        nxt = min(k + 1, last)
        for i in range(6):
            theta[i] = math.exp(point[i])
        if (k - first) % EVERY == 0:
            geometry = geometry_at(surveyed, point)
            here = rig_at(rig, geometry, point[ROLLING], point[CURVATURE])
            u, _ = driven(ticks, k, point, drive)
            motion(x, u, drive, theta, here, work, w, forces, bent, rate)
            x_at[:] = x
            for i in range(8):  # about where x is in the middle of these ticks
                x_at[i] += 0.5 * EVERY * DT * rate[i]
            u, _ = driven(ticks, k + EVERY // 2, point, drive)
            slopes(
                x_at, u, drive, point, theta, geometry, here, rig, active, shapes, work, w, forces, bent,
                rate, near, jx, jd, jp,
            )  # fmt: skip
            held_over(jx, held)
            spread(held, jx, jd, jp, active, fades, steered, t)
        u, bend = driven(ticks, k, point, drive)
        motion(x, u, drive, theta, here, work, w, forces, bent, rate)
        moved(x, u, rate, held, fades, after)
        aimed(x, after, u, steered, active, drive[0], bend, math.exp(-point[GAIN]), t, turned)
        while row < m and rows[row, 0] <= k - first:
            kind, place, share = rows[row, 2], int(rows[row, 3]), rows[row, 1] / DT
            body = place if kind == 0.0 or kind == 4.0 else (0 if place < 2 else 1)
            psi_ref = ticks[k, 2 + body] + share * (ticks[nxt, 2 + body] - ticks[k, 2 + body])
            for i in range(N_X):
                x_at[i] = x[i] + share * (after[i] - x[i])
            value = seen(x_at, kind, place, u, psi_ref, geometry, point, active, shapes, levers, middles, h)
            error = rows[row, 4] - value
            noisy = (rows[row, 5] * noise_factor(kind, point)) ** 2
            row += 1
            if not (math.isfinite(error) and math.isfinite(noisy)):
                counts[BAD] += 1.0
                continue
            for j in range(n):
                shown[j] = (1.0 - share) * h[j] if j < N_X else h[j]
            for i in range(N_X):
                if h[i] != 0.0:
                    for j in range(n):
                        shown[j] += share * h[i] * t[i, j]
            variance = corrected(
                error, noisy, shown, p, keep, x, after, point, active, turned, cross, gain, slope
            )
            if variance < 0.0:
                counts[GATED] += 1.0
                continue
            counts[USED] += 1.0
            told = 0 if kind == 0.0 else (1 if kind == 1.0 else 2)
            left = noisy / variance
            sums[told, 0] += (left * left * error * error + (1.0 - left) * noisy) / rows[row - 1, 5] ** 2
            sums[told, 1] += 1.0
        q[3] = (u / theta[3] * sds[0] * DT) ** 2
        for i in range(3):
            sums[3 + i, 0] += x[PUSHED + i] ** 2
            sums[3 + i, 1] += noise[i] ** 2 - p[PUSHED + i, PUSHED + i]
        grow(p, t, turned, q, x[6], middle)
        x[:] = after
    parted(p, covariance, own, between, active)
