"""A straight row through a filter, with gains that stay: what steering changes of the readings, whitened.

The filter is that of predictor.py about straight driving. It runs once over a row and leaves its gains. From
then on it is one linear map: the readings that the rig of straight_driving.py would give, and their slopes by
the unknowns, pass through it together, as columns, in the same kernel that makes them.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.compiled import inner_kernel, kernel
from tilth.estimator.filters.gates import GATES
from tilth.estimator.filters.measurement_model import noise_factor
from tilth.estimator.filters.sensors.wheel_angle import driven_by, set_wheel_slopes, wheel_angle_at
from tilth.estimator.filters.states import DT, Places
from tilth.estimator.filters.straight_driving import N_STRAIGHT, PLACES, FilterModel, StraightModel
from tilth.estimator.filters.transition import multiply
from tilth.estimator.filters.unknowns import AT_LATENCY, AT_YAW_RATE_DELAY, N_UNKNOWNS
from tilth.estimator.models.generated.observation_kernels import WHEEL_ANGLE_UNKNOWNS
from tilth.estimator.record.record import KIND, OFFSET, PLACE, SD, TICK, YAW_RATE, U

Array = NDArray[np.float64]

OF_KINDS: Final = np.array(GATES)


class KeptGains(NamedTuple):
    """What a run of the filter leaves, for each row of a record."""

    e: Array  # (m,), innovations
    S: Array  # (m,), their variances
    H: Array  # (m, 25), of the prediction by the state at the tick
    K: Array  # (m, 25), by which the state follows an innovation
    used: Array  # (m,), 0.0 of a row that is left out


class Whitened(NamedTuple):
    """A row as outputs of epochs, and the filter that makes them."""

    ticks: Array  # (n, 8)
    rows: Array  # (m, 6)
    gains: KeptGains
    filter: FilterModel
    slots: NDArray[np.int64]  # (m,), of which output of which epoch a row is part; -1 of none
    scales: Array  # (m,), on what belongs there
    mean_reading: Array  # (1,), of the wheel angle, rad


@inner_kernel
def mix(table: Array, low: int, share: float, out: Array) -> None:
    """Fill out with what a table has at a speed, `share` of the way from one tabulated to the next."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = (1.0 - share) * table[low, i, j] + share * table[low + 1, i, j]


@inner_kernel
def instant_of(row: Array, unknowns: Array) -> float:
    """Time of a measurement since the tick before it, in ticks."""
    late = unknowns[AT_YAW_RATE_DELAY + int(row[PLACE])] if row[KIND] == YAW_RATE else 0.0
    return float((row[OFFSET] - late) / DT)


@kernel
def set_gains(
    ticks: Array,
    rows: Array,
    readings: Array,
    unknowns: Array,
    model: FilterModel,
    settling: int,
    out: KeptGains,
) -> None:
    """Run the filter over what is left of the readings, (m,), without steering, and fill out. settling:
    ticks in which nothing is an outlier."""
    n, at = model.start.shape[0], 0
    x, P, F, Q, H = np.zeros(n), model.start.copy(), np.zeros((n, n)), np.zeros((n, n)), np.zeros(n)
    sensors, F_P, F_T, P_H = np.zeros(model.H.shape[1:]), np.zeros((n, n)), np.zeros((n, n)), np.zeros(n)
    out.e[:], out.S[:], out.K[:], out.H[:] = 0.0, 1.0, 0.0, 0.0
    spacing, nodes = model.speeds[1] - model.speeds[0], model.speeds.shape[0]
    for k in range(ticks.shape[0]):
        u = 0.5 * (ticks[k, U] + ticks[min(k + 1, ticks.shape[0] - 1), U])
        low = min(max(int((u - model.speeds[0]) / spacing), 0), nodes - 2)
        share = (u - model.speeds[low]) / spacing
        mix(model.F, low, share, F)
        mix(model.Q, low, share, Q)
        mix(model.H, low, share, sensors)
        while at < rows.shape[0] and rows[at, TICK] <= k:
            if out.used[at] != 0.0:
                kind = int(rows[at, KIND])
                code, later = kind * PLACES + int(rows[at, PLACE]), instant_of(rows[at], unknowns)
                error, variance = readings[at], (rows[at, SD] * noise_factor(kind, unknowns)) ** 2
                for j in range(n):
                    H[j] = (1.0 - later) * sensors[code, j]
                    for i in range(n):
                        H[j] += later * sensors[code, i] * F[i, j]
                for i in range(n):
                    P_H[i] = 0.0
                    for j in range(n):
                        P_H[i] += P[i, j] * H[j]
                for i in range(n):
                    error -= H[i] * x[i]
                    variance += H[i] * P_H[i]
                if k >= settling and error * error > OF_KINDS[kind] ** 2 * variance:
                    out.used[at] = 0.0
                else:
                    out.e[at], out.S[at] = error, variance
                    for i in range(n):
                        out.H[at, i], out.K[at, i] = H[i], P_H[i] / variance
                        x[i] += out.K[at, i] * error
                        for j in range(n):
                            P[i, j] -= out.K[at, i] * P_H[j]
            at += 1
        x[:] = np.dot(F, x)
        multiply(F, P, F_P)
        F_T[:] = F.T
        multiply(F_P, F_T, P)
        for i in range(n):
            for j in range(i + 1):
                P[i, j] = P[j, i] = 0.5 * (P[i, j] + P[j, i]) + Q[i, j]


@inner_kernel
def add_scaled(A: Array, row: int, factor: float, B: Array, other: int) -> None:
    """Add a row of B to one of A."""
    for j in range(A.shape[1]):
        A[row, j] += factor * B[other, j]


@inner_kernel
def step_response(
    low: int, share: float, wheel: float, wheel_slopes: Array, places: Places, model: StraightModel, z: Array,
    following: Array,
) -> None:  # fmt: skip
    """Fill following, (13, 1 + a), from z: the state, and its slopes, one tick later."""
    na = places.shape[0]
    following[:] = 0.0
    for i in range(N_STRAIGHT):
        for k in range(N_STRAIGHT + 1):
            here, there = (1.0 - share) * model.step[low, i, k], share * model.step[low + 1, i, k]
            if k < N_STRAIGHT and here + there != 0.0:
                add_scaled(following, i, here + there, z, k)
            elif k == N_STRAIGHT:
                following[i, 0] += (here + there) * wheel
                for j in range(na):
                    if places[j] in WHEEL_ANGLE_UNKNOWNS:
                        following[i, 1 + j] += (here + there) * wheel_slopes[places[j]]
            by = z[k, 0] if k < N_STRAIGHT else wheel
            for j in range(na):
                following[i, 1 + j] += (
                    (1.0 - share) * model.step_unknowns[low, i, k, j]
                    + share * model.step_unknowns[low + 1, i, k, j]
                ) * by


@inner_kernel
def read_response(
    code: int, late: float, low: int, share: float, model: StraightModel, z: Array, following: Array,
    out: Array,
) -> None:  # fmt: skip
    """Fill out, (1 + a,): a reading, and its slopes, `late` ticks after z."""
    na, upper = out.shape[0] - 1, low + 1
    out[0] = (1.0 - share) * model.rest[low, code] + share * model.rest[upper, code]
    for j in range(na):
        out[1 + j] = (1.0 - share) * model.offsets[low, code, j] + share * model.offsets[upper, code, j]
    for i in range(N_STRAIGHT):
        h = (1.0 - share) * model.H[low, code, i] + share * model.H[upper, code, i]
        if h != 0.0:
            for j in range(1 + na):
                out[j] += h * (z[i, j] + late * (following[i, j] - z[i, j]))
        by = z[i, 0] + late * (following[i, 0] - z[i, 0])
        for j in range(na):
            out[1 + j] += by * (
                (1.0 - share) * model.H_unknowns[low, code, i, j]
                + share * model.H_unknowns[upper, code, i, j]
            )


@inner_kernel
def step_filter(low: int, share: float, F: Array, D: Array, following: Array) -> None:
    """Propagate D, (25, c), the filter's state of each column. F: (s, 25, 25)."""
    following[:] = 0.0
    for i in range(F.shape[1]):
        for k in range(F.shape[1]):
            factor = (1.0 - share) * F[low, i, k] + share * F[low + 1, i, k]
            if factor != 0.0:
                add_scaled(following, i, factor, D, k)
    for i in range(D.shape[0]):
        for j in range(D.shape[1]):
            D[i, j] = following[i, j]


@kernel
def respond(row: Whitened, model: StraightModel, unknowns: Array, places: Places, out: Array) -> None:
    """Fill out, (slots, 1 + a): the whitened response to the wheel angle less its mean, and its slopes.

    unknowns: (n,), the point that `model` is of, with the wheel's zero less that mean.
    """
    ticks, rows, gains = row.ticks, row.rows, row.gains
    na, at = places.shape[0], 0
    z, following = np.zeros((N_STRAIGHT, 1 + na)), np.zeros((N_STRAIGHT, 1 + na))
    n = gains.H.shape[1]
    D, D_following = np.zeros((n, 1 + na)), np.zeros((n, 1 + na))
    reading, wheel_slopes = np.zeros(1 + na), np.zeros(N_UNKNOWNS)
    out[:] = 0.0
    nodes, behind, mean = model.speeds.shape[0], unknowns[AT_LATENCY], row.mean_reading[0]
    spacing = model.speeds[1] - model.speeds[0]
    early = wheel_angle_at(ticks, 0, behind)
    for k in range(ticks.shape[0]):
        after = min(k + 1, ticks.shape[0] - 1)
        late, u = wheel_angle_at(ticks, after, behind), 0.5 * (ticks[k, U] + ticks[after, U])
        drive = driven_by(u, 0.0, 0.5 * (early + late) - mean, (late - early) / DT, unknowns)
        early = late
        low = min(max(int((u - model.speeds[0]) / spacing), 0), nodes - 2)
        share = (u - model.speeds[low]) / spacing
        set_wheel_slopes(drive, unknowns, wheel_slopes)
        step_response(low, share, drive.wheel, wheel_slopes, places, model, z, following)
        while at < rows.shape[0] and rows[at, TICK] <= k:
            if gains.used[at] != 0.0:
                kind, place = int(rows[at, KIND]), int(rows[at, PLACE])
                code, later = kind * PLACES + place, instant_of(rows[at], unknowns)
                read_response(code, later, low, share, model, z, following, reading)
                if kind == YAW_RATE:
                    for j in range(na):
                        if places[j] == AT_YAW_RATE_DELAY + place:
                            for i in range(N_STRAIGHT):
                                h = model.H[low, code, i]
                                reading[1 + j] -= h * (following[i, 0] - z[i, 0]) / DT
                for i in range(n):
                    h = gains.H[at, i]
                    if h != 0.0:
                        for j in range(1 + na):
                            reading[j] -= h * D[i, j]
                for i in range(n):
                    for j in range(1 + na):
                        D[i, j] += gains.K[at, i] * reading[j]
                slot = row.slots[at]
                if slot >= 0:
                    for j in range(1 + na):
                        out[slot, j] += row.scales[at] * reading[j]
            at += 1
        z[:] = following
        step_filter(low, share, row.filter.F, D, D_following)
