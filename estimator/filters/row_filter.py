"""A straight row through a filter, with gains that stay: what steering changes of the readings, whitened.

The filter is that of predictor.py about straight driving. It runs once over a row and leaves its gains. From
then on it is one linear map: the readings that the rig of straight_driving.py would give, and their slopes by
the unknowns, pass through it together, as columns, in the same kernel that makes them.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.compiled import inline_kernel, inner_kernel
from tilth.estimator.filters.gates import GATES, UNLIMITED
from tilth.estimator.filters.joint_update import JointState, UpdateWork, correct, empty_work
from tilth.estimator.filters.measurement_model import between, noise_factor
from tilth.estimator.filters.record_loop import over_ticks
from tilth.estimator.filters.sensors.wheel_angle import drive_at, driven_by, set_wheel_slopes
from tilth.estimator.filters.states import DT, Places
from tilth.estimator.filters.straight_driving import (
    KEPT,
    N_SENSORS,
    N_STRAIGHT,
    PLACES,
    FilterModel,
    StraightModel,
)
from tilth.estimator.filters.transition import multiply
from tilth.estimator.filters.unknowns import AT, AT_LATENCY, AT_YAW_RATE_DELAY, N_UNKNOWNS
from tilth.estimator.record.record import KIND, OFFSET, PLACE, SD, YAW_RATE

Array = NDArray[np.float64]


# Unknowns of rows alone, behind those of unknowns.NAMES.
AT_PLAY: Final = N_UNKNOWNS  # half the play of the wheel sensor, rad of its reading
AT_RATE_SCALE: Final = N_UNKNOWNS + 1  # logarithm: turn rates over true; the tractor's, the implement's
N_ROW_UNKNOWNS: Final = N_UNKNOWNS + 3
ZERO: Final = AT["wheel_zero"]


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
    flanks: Array  # (n,), of the wheel sensor's play, as wheel_play.flanks


class RowSpeed(NamedTuple):
    """Where a speed is among the tabulated ones."""

    low: int  # the next lower one
    share: float  # of the way to the next, 0 to 1


@inner_kernel
def find_speed(u: float, speeds: Array) -> RowSpeed:
    """Of u, m/s. speeds: (s,), evenly apart."""
    spacing, nodes = speeds[1] - speeds[0], speeds.shape[0]
    low = min(max(int((u - speeds[0]) / spacing), 0), nodes - 2)
    return RowSpeed(low, (u - speeds[low]) / spacing)


@inner_kernel
def mix(table: Array, at: RowSpeed, out: Array) -> None:
    """Fill out with what a table has at a speed."""
    low, share = at
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = (1.0 - share) * table[low, i, j] + share * table[low + 1, i, j]


@inner_kernel
def instant_of(row: Array, unknowns: Array) -> float:
    """Time of a measurement since the tick before it, in ticks."""
    late = unknowns[AT_YAW_RATE_DELAY + int(row[PLACE])] if row[KIND] == YAW_RATE else 0.0
    return float((row[OFFSET] - late) / DT)


class GainRun(NamedTuple):
    """What the run works with that leaves the gains."""

    ticks: Array  # (n, 8)
    rows: Array  # (m, 6)
    readings: Array  # (m,)
    model: FilterModel
    settling: int  # ticks in which nothing is an outlier
    out: KeptGains
    state: JointState  # of 25 states
    F: Array  # (25, 25), at the present speed, as Q and sensors
    Q: Array  # (25, 25)
    sensors: Array  # (24, 25)
    H: Array  # (25,), of a reading
    error: Array  # (1,), innovation
    variance: Array  # (1,), of its noise, then of it
    work: UpdateWork
    F_P: Array  # (25, 25), overwritten
    F_T: Array  # (25, 25), overwritten


@inline_kernel
def begin_gains(k: int, on: GainRun) -> None:
    """The filter at the speed of tick k."""
    model = on.model
    at = find_speed(drive_at(on.ticks, k, on.state.unknowns).u, model.speeds)
    mix(model.F, at, on.F)
    mix(model.Q, at, on.Q)
    mix(model.H, at, on.sensors)


@inline_kernel
def take_gain(i: int, k: int, none: None, on: GainRun) -> None:
    """Update the filter with a row, but if it is an outlier, and keep its gain."""
    row, state, out, error, H = on.rows[i], on.state, on.out, on.error, on.H
    if out.used[i] == 0.0:
        return
    kind = int(row[KIND])
    between(instant_of(row, state.unknowns), on.sensors[kind * PLACES + int(row[PLACE])], on.F, H)
    error[0], on.variance[0] = on.readings[i], (row[SD] * noise_factor(kind, state.unknowns)) ** 2
    for j in range(H.shape[0]):
        error[0] -= H[j] * state.x[j]
    gate = GATES[kind] if k >= on.settling else UNLIMITED
    if not correct(error, on.variance, H, state, gate, on.work):
        out.used[i] = 0.0
        return
    out.e[i], out.S[i] = error[0], on.variance[0]
    for j in range(H.shape[0]):
        out.H[i, j], out.K[i, j] = H[j], on.work.gain[0, j]
        state.x[j] += on.work.gain[0, j] * error[0]


@inline_kernel
def end_gains(none: None, on: GainRun) -> None:
    """Propagate state and covariance."""
    x, following, P, F = on.state.x, on.state.following, on.state.P[0], on.F
    multiply(F, x, following)
    multiply(F, P, on.F_P)
    for i in range(x.shape[0]):
        x[i] = following[i]
        for j in range(x.shape[0]):
            on.F_T[j, i] = F[i, j]
    multiply(on.F_P, on.F_T, P)
    for i in range(x.shape[0]):
        for j in range(i + 1):
            P[i, j] = P[j, i] = 0.5 * (P[i, j] + P[j, i]) + on.Q[i, j]


run_gains = over_ticks.with_steps(begin_tick=begin_gains, take_row=take_gain, end_tick=end_gains)


def set_gains(
    ticks: Array, rows: Array, readings: Array, unknowns: Array, model: FilterModel, settling: int,
    out: KeptGains,
) -> None:  # fmt: skip
    """Run the filter over what is left of the readings, (m,), without steering, and fill out. settling:
    ticks in which nothing is an outlier."""
    n = model.start.shape[0]
    out.e[:], out.S[:], out.K[:], out.H[:] = 0.0, 1.0, 0.0, 0.0
    P = model.start.copy().reshape(1, n, n)
    state = JointState(np.zeros(n), np.zeros(n), unknowns, np.zeros(0, np.int64), np.zeros(n), P)
    on = GainRun(
        ticks, rows, readings, model, settling, out, state, np.zeros((n, n)), np.zeros((n, n)),
        np.zeros(model.H.shape[1:]), np.zeros(n), np.zeros(1), np.zeros(1), empty_work(1, n),
        np.zeros((n, n)), np.zeros((n, n)),
    )  # fmt: skip
    run_gains(ticks.shape[0], rows, on)


@inner_kernel
def step_columns(table: Array, at: RowSpeed, z: Array, following: Array) -> None:
    """Fill following, (n, c), from the columns z, (m, c), of states and perhaps inputs, a tick before.
    table: (s, n, m), of transitions at the tabulated speeds."""
    low, share = at
    following[:] = 0.0
    for i in range(table.shape[1]):
        for k in range(table.shape[2]):
            factor = (1.0 - share) * table[low, i, k] + share * table[low + 1, i, k]
            if factor != 0.0:
                for j in range(z.shape[1]):
                    following[i, j] += factor * z[k, j]


@inline_kernel
def step_response(at: RowSpeed, model: StraightModel, z: Array, following: Array) -> None:
    """Fill following, (13, 1 + a): state, and its slopes, one tick after z, (14, 1 + a), whose last row is
    the wheel angle."""
    low, share = at
    step_columns(model.step, at, z, following)
    slopes = model.step_unknowns
    for i in range(slopes.shape[1]):
        for k in range(slopes.shape[2]):
            for j in range(slopes.shape[3]):
                following[i, 1 + j] += (
                    (1.0 - share) * slopes[low, i, k, j] + share * slopes[low + 1, i, k, j]
                ) * z[k, 0]


@inline_kernel
def read_response(
    code: int, late: float, at: RowSpeed, model: StraightModel, z: Array, following: Array, out: Array
) -> None:
    """Fill out, (1 + a,): a reading, and its slopes, `late` ticks after z. The model has slopes of the
    first ones only; on the others it does not depend."""
    low, share = at
    na, upper = model.offsets.shape[2], low + 1
    out[:] = 0.0
    out[0] = (1.0 - share) * model.rest[low, code] + share * model.rest[upper, code]
    for j in range(na):
        out[1 + j] = (1.0 - share) * model.offsets[low, code, j] + share * model.offsets[upper, code, j]
    for i in range(N_STRAIGHT):
        h = (1.0 - share) * model.H[low, code, i] + share * model.H[upper, code, i]
        if h != 0.0:
            for j in range(out.shape[0]):
                out[j] += h * (z[i, j] + late * (following[i, j] - z[i, j]))
        by = z[i, 0] + late * (following[i, 0] - z[i, 0])
        for j in range(na):
            out[1 + j] += by * (
                (1.0 - share) * model.H_unknowns[low, code, i, j]
                + share * model.H_unknowns[upper, code, i, j]
            )


class ResponseRun(NamedTuple):
    """What the response to steering works with. Each array has a column of values, then of slopes."""

    row: Whitened
    model: StraightModel
    unknowns: Array  # (N_ROW_UNKNOWNS,)
    places: Places  # (a,)
    out: Array  # (slots, 1 + a)
    z: Array  # (14, 1 + a), the state, then the wheel angle
    following: Array  # (13, 1 + a), one tick later
    D: Array  # (25, 1 + a), the filter's state
    D_following: Array  # (25, 1 + a), overwritten
    reading: Array  # (1 + a,)
    wheel_slopes: Array  # (N_ROW_UNKNOWNS,)


@inline_kernel
def begin_response(k: int, on: ResponseRun) -> RowSpeed:
    """The rig one tick later."""
    unknowns, now = on.unknowns, drive_at(on.row.ticks, k, on.unknowns)
    flank = on.row.flanks[min(max(int(k + 0.5 - unknowns[AT_LATENCY] / DT), 0), on.row.flanks.shape[0] - 1)]
    reading = now.reading - on.row.mean_reading[0] + unknowns[AT_PLAY] * flank
    drive = driven_by(now.u, 0.0, reading, now.reading_rate, unknowns)
    at = find_speed(now.u, on.model.speeds)
    set_wheel_slopes(drive, unknowns, on.wheel_slopes)
    on.wheel_slopes[AT_PLAY] = -on.wheel_slopes[ZERO] * flank
    on.z[N_STRAIGHT, 0] = drive.wheel
    for j in range(on.places.shape[0]):
        on.z[N_STRAIGHT, 1 + j] = on.wheel_slopes[on.places[j]]
    step_response(at, on.model, on.z, on.following)
    return at


@inline_kernel
def take_response(i: int, k: int, at: RowSpeed, on: ResponseRun) -> None:
    """What the rig gives in the place of a row, through the filter."""
    row, gains, places, reading, D = on.row.rows[i], on.row.gains, on.places, on.reading, on.D
    if gains.used[i] == 0.0:
        return
    na, n, kind, place = places.shape[0], D.shape[0], int(row[KIND]), int(row[PLACE])
    code = kind * PLACES + place
    read_response(code, instant_of(row, on.unknowns), at, on.model, on.z, on.following, reading)
    if kind == YAW_RATE:
        for j in range(na):
            if places[j] == AT_YAW_RATE_DELAY + place:
                for m in range(N_STRAIGHT):
                    h = on.model.H[at.low, code, m]
                    reading[1 + j] -= h * (on.following[m, 0] - on.z[m, 0]) / DT
        reading *= math.exp(on.unknowns[AT_RATE_SCALE + place])
        for j in range(na):
            if places[j] == AT_RATE_SCALE + place:
                reading[1 + j] += reading[0]
    for m in range(n):
        h = gains.H[i, m]
        if h != 0.0:
            for j in range(1 + na):
                reading[j] -= h * D[m, j]
    for m in range(n):
        for j in range(1 + na):
            D[m, j] += gains.K[i, m] * reading[j]
    slot = on.row.slots[i]
    if slot >= 0:
        for j in range(1 + na):
            on.out[slot, j] += on.row.scales[i] * reading[j]


@inline_kernel
def end_response(at: RowSpeed, on: ResponseRun) -> None:
    """On to the next tick."""
    step_columns(on.row.filter.F, at, on.D, on.D_following)
    for j in range(on.z.shape[1]):
        for i in range(N_STRAIGHT):
            on.z[i, j] = on.following[i, j]
        for i in range(on.D.shape[0]):
            on.D[i, j] = on.D_following[i, j]


run_response = over_ticks.with_steps(begin_tick=begin_response, take_row=take_response, end_tick=end_response)


def respond(row: Whitened, model: StraightModel, unknowns: Array, places: Places, out: Array) -> None:
    """Fill out, (slots, 1 + a): the whitened response to the wheel angle less its mean, and its slopes.

    unknowns: (N_ROW_UNKNOWNS,), the point that `model` is of, with the wheel's zero less that mean. places:
    those of rows alone come last; `model` is of the others.
    """
    out[:] = 0.0
    columns, n = 1 + places.shape[0], row.gains.H.shape[1]
    on = ResponseRun(
        row, model, unknowns, places, out,
        np.zeros((N_STRAIGHT + 1, columns)), np.zeros((N_STRAIGHT, columns)),
        np.zeros((n, columns)), np.zeros((n, columns)), np.zeros(columns), np.zeros(N_ROW_UNKNOWNS),
    )  # fmt: skip
    run_response(row.ticks.shape[0], row.rows, on)


def rehearse() -> None:
    """Compile the filter's loop, by a run over one tick without a row. It calls nothing of the rig's motion.

    Not that of the response as well: then who compiles the rig's motion meanwhile comes to the loop of a fit
    too, before this process has compiled it.
    """
    n, ticks, rows = len(KEPT), np.zeros((1, 8)), np.zeros((0, 6))
    of_all = np.zeros((2, n, n))
    model = FilterModel(np.arange(2.0), of_all, of_all, np.zeros((2, N_SENSORS, n)), np.eye(n))
    gains = KeptGains(rows[:, 0].copy(), rows[:, 0].copy(), np.zeros((0, n)), np.zeros((0, n)), np.zeros(0))
    set_gains(ticks, rows, np.zeros(0), np.zeros(N_UNKNOWNS), model, 0, gains)
