"""A straight row through a filter, with gains that stay: what steering changes of the readings, whitened.

The filter is that of predictor.py about straight driving. It runs once over a row and leaves its gains. From
then on it is one linear map: the readings that the rig of straight_driving.py would give, and their slopes by
the unknowns, pass through it together, as columns, in the same kernel that makes them. From one tick with
measurements (a stop) to the next all goes in one step, at the speed in the middle between them.
"""

import math
from itertools import pairwise
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
    STRAIGHT,
    FilterModel,
    StraightModel,
)
from tilth.estimator.filters.transition import multiply
from tilth.estimator.filters.unknowns import AT, AT_LATENCY, AT_YAW_RATE_DELAY, N_UNKNOWNS
from tilth.estimator.record.record import KIND, OFFSET, PLACE, SD, TICK, YAW_RATE

Array = NDArray[np.float64]


# Unknowns of rows alone, behind those of unknowns.NAMES.
AT_PLAY: Final = N_UNKNOWNS  # half the play of the wheel sensor, rad of its reading
AT_RATE_SCALE: Final = N_UNKNOWNS + 1  # logarithm: turn rates over true; the tractor's, the implement's
N_ROW_UNKNOWNS: Final = N_UNKNOWNS + 3
ZERO: Final = AT["wheel_zero"]
OF_WHEEL: Final = [ZERO, AT["wheel_gain"], AT_LATENCY, AT_PLAY]  # that change the true wheel angle


class KeptGains(NamedTuple):
    """What a run of the filter leaves, for each row of a record."""

    e: Array  # (m,), innovations
    S: Array  # (m,), their variances
    H: Array  # (m, 25), of the prediction by the state at the tick
    K: Array  # (m, 25), by which the state follows an innovation
    F: Array  # (stops, 25, 25), from a stop to the next
    used: Array  # (m,), 0.0 of a row that is left out


class Stops(NamedTuple):
    """Ticks at which there is something to do, no further apart than StraightTuning.most_ticks."""

    ticks: NDArray[np.int64]  # (stops + 1,), in order; the last is the end
    of_tick: NDArray[np.int64]  # (n,), which stop it is; -1 of none


def stops_of(rows: Array, n: int) -> Stops:
    """Of a record's rows, (m, 6), that are used, over n ticks."""
    at = np.unique(np.concatenate([[0, n], np.clip(rows[:, TICK], 0, n - 1)])).astype(np.int64)
    ticks = np.concatenate([*(np.arange(*two, STRAIGHT.most_ticks) for two in pairwise(at)), at[-1:]])
    of_tick = np.full(n, -1)
    of_tick[ticks[:-1]] = np.arange(len(ticks) - 1)
    return Stops(ticks, of_tick)


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
    stops: Stops


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
    stops: Stops
    state: JointState  # of 25 states
    F: Array  # (25, 25), of a tick at the present speed, as sensors
    Q: Array  # (25, 25), to the next stop
    sensors: Array  # (24, 25)
    H: Array  # (25,), of a reading
    error: Array  # (1,), innovation
    variance: Array  # (1,), of its noise, then of it
    work: UpdateWork
    F_P: Array  # (25, 25), overwritten
    F_T: Array  # (25, 25), overwritten


@inline_kernel
def begin_gains(k: int, on: GainRun) -> int:
    """Which stop tick k is, with the filter at its speed."""
    stop = int(on.stops.of_tick[k])
    if stop >= 0:
        at = find_speed(drive_at(on.ticks, k, on.state.unknowns).u, on.model.speeds)
        mix(on.model.F[0], at, on.F)
        mix(on.model.H, at, on.sensors)
    return stop


@inline_kernel
def take_gain(i: int, k: int, stop: int, on: GainRun) -> None:
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
def end_gains(stop: int, on: GainRun) -> None:
    """Propagate state and covariance to the next stop."""
    if stop < 0:
        return
    x, following, P, F = on.state.x, on.state.following, on.state.P[0], on.out.F[stop]
    first, ticks = on.stops.ticks[stop], on.stops.ticks[stop + 1] - on.stops.ticks[stop]
    at = find_speed(drive_at(on.ticks, int(first + ticks // 2), on.state.unknowns).u, on.model.speeds)
    mix(on.model.F[ticks - 1], at, F)
    mix(on.model.Q[ticks - 1], at, on.Q)
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
    stops: Stops, out: KeptGains,
) -> None:  # fmt: skip
    """Run the filter over what is left of the readings, (m,), without steering, and fill out. settling:
    ticks in which nothing is an outlier."""
    n = model.start.shape[0]
    out.e[:], out.S[:], out.K[:], out.H[:], out.F[:] = 0.0, 1.0, 0.0, 0.0, 0.0
    P = model.start.copy().reshape(1, n, n)
    state = JointState(np.zeros(n), np.zeros(n), unknowns, np.zeros(0, np.int64), np.zeros(n), P)
    on = GainRun(
        ticks, rows, readings, model, settling, out, stops, state, np.zeros((n, n)), np.zeros((n, n)),
        np.zeros(model.H.shape[1:]), np.zeros(n), np.zeros(1), np.zeros(1), empty_work(1, n),
        np.zeros((n, n)), np.zeros((n, n)),
    )  # fmt: skip
    run_gains(ticks.shape[0], rows, on)


@inner_kernel
def step_response(k: int, ticks: int, at: RowSpeed, on: "ResponseRun", z: Array, following: Array) -> None:
    """Fill following, (13, 1 + a): state, and its slopes, so many ticks after z, which is of tick k."""
    model, wheel, of_wheel, (low, share) = on.model, on.wheel, on.of_wheel, at
    step, slopes, na = model.step[ticks - 1], model.step_unknowns[ticks - 1], model.step_unknowns.shape[4]
    following[:] = 0.0
    for i in range(N_STRAIGHT):
        for m in range(N_STRAIGHT + ticks):
            factor = (1.0 - share) * step[low, i, m] + share * step[low + 1, i, m]
            if m < N_STRAIGHT:
                by = z[m, 0]
                if factor != 0.0:
                    for j in range(z.shape[1]):
                        following[i, j] += factor * z[m, j]
            else:
                by = wheel[k + m - N_STRAIGHT, 0]
                following[i, 0] += factor * by
                for j in range(of_wheel.shape[0]):
                    following[i, of_wheel[j]] += factor * wheel[k + m - N_STRAIGHT, 1 + j]
            lower, upper = (1.0 - share) * by, share * by
            for j in range(na):
                following[i, 1 + j] += lower * slopes[low, i, m, j] + upper * slopes[low + 1, i, m, j]


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
        for j in range(na if model.acting[code, i] != 0.0 else 0):
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
    wheel: Array  # (n, 1 + w), true wheel angle in each tick, and its slopes
    of_wheel: Places  # (w,), columns that these are of
    z: Array  # (13, 1 + a), the state
    following: Array  # (13, 1 + a), one tick later
    D: Array  # (25, 1 + a), the filter's state
    D_following: Array  # (25, 1 + a), overwritten
    reading: Array  # (1 + a,)
    wheel_slopes: Array  # (N_ROW_UNKNOWNS,)


@inner_kernel
def steer(on: ResponseRun) -> None:
    """Fill the wheel angles."""
    row, unknowns, slopes, n = on.row, on.unknowns, on.wheel_slopes, on.wheel.shape[0]
    for k in range(n):
        now = drive_at(row.ticks, k, unknowns)
        flank = row.flanks[min(max(int(k + 0.5 - unknowns[AT_LATENCY] / DT), 0), n - 1)]
        reading = now.reading - row.mean_reading[0] + unknowns[AT_PLAY] * flank
        drive = driven_by(now.u, 0.0, reading, now.reading_rate, unknowns)
        on.wheel[k, 0] = drive.wheel
        if on.of_wheel.shape[0] > 0:
            set_wheel_slopes(drive, unknowns, slopes)
            slopes[AT_PLAY] = -slopes[ZERO] * flank
            for j in range(on.of_wheel.shape[0]):
                on.wheel[k, 1 + j] = slopes[on.places[on.of_wheel[j] - 1]]


@inline_kernel
def begin_response(k: int, on: ResponseRun) -> tuple[int, RowSpeed]:
    """Which stop tick k is, and its speed, with the rig one tick later."""
    stop = int(on.row.stops.of_tick[k])
    at = find_speed(drive_at(on.row.ticks, k, on.unknowns).u if stop >= 0 else 0.0, on.model.speeds)
    if stop >= 0:
        step_response(k, 1, at, on, on.z, on.following)
    return stop, at


@inline_kernel
def take_response(i: int, k: int, stop_at: tuple[int, RowSpeed], on: ResponseRun) -> None:
    """What the rig gives in the place of a row, through the filter."""
    row, gains, places, reading, D = on.row.rows[i], on.row.gains, on.places, on.reading, on.D
    if gains.used[i] == 0.0:
        return
    na, n, kind, place = places.shape[0], D.shape[0], int(row[KIND]), int(row[PLACE])
    code = kind * PLACES + place
    at = stop_at[1]
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
def end_response(stop_at: tuple[int, RowSpeed], on: ResponseRun) -> None:
    """On to the next stop."""
    stop = stop_at[0]
    if stop < 0:
        return
    first, ticks = int(on.row.stops.ticks[stop]), int(on.row.stops.ticks[stop + 1] - on.row.stops.ticks[stop])
    if ticks > 1:
        at = find_speed(drive_at(on.row.ticks, first + ticks // 2, on.unknowns).u, on.model.speeds)
        step_response(first + 1, ticks - 1, at, on, on.following, on.z)
    F, D, following = on.row.gains.F[stop], on.D, on.D_following
    following[:] = 0.0
    for i in range(D.shape[0]):
        for m in range(D.shape[0]):
            if F[i, m] != 0.0:
                for j in range(D.shape[1]):
                    following[i, j] += F[i, m] * D[m, j]
    for j in range(D.shape[1]):
        for i in range(N_STRAIGHT if ticks == 1 else 0):
            on.z[i, j] = on.following[i, j]
        for i in range(D.shape[0]):
            D[i, j] = following[i, j]


run_response = over_ticks.with_steps(begin_tick=begin_response, take_row=take_response, end_tick=end_response)


def respond(row: Whitened, model: StraightModel, unknowns: Array, places: Places, out: Array) -> None:
    """Fill out, (slots, 1 + a): the whitened response to the wheel angle less its mean, and its slopes.

    unknowns: (N_ROW_UNKNOWNS,), the point that `model` is of, with the wheel's zero less that mean. places:
    those of rows alone come last; `model` is of the others.
    """
    out[:] = 0.0
    columns, n = 1 + places.shape[0], row.gains.H.shape[1]
    of_wheel = 1 + np.flatnonzero(np.isin(places, OF_WHEEL))
    on = ResponseRun(
        row, model, unknowns, places, out, np.zeros((row.ticks.shape[0], 1 + len(of_wheel))), of_wheel,
        np.zeros((N_STRAIGHT, columns)), np.zeros((N_STRAIGHT, columns)),
        np.zeros((n, columns)), np.zeros((n, columns)), np.zeros(columns), np.zeros(N_ROW_UNKNOWNS),
    )  # fmt: skip
    steer(on)
    run_response(row.ticks.shape[0], row.rows, on)


def rehearse() -> None:
    """Compile both loops, by runs over one tick without a row. They call nothing of the rig's motion."""
    n, outputs, speeds, ticks, rows = len(KEPT), N_SENSORS, np.arange(2.0), np.zeros((1, 8)), np.zeros((0, 6))
    of_all, unknowns, places = np.zeros((1, 2, n, n)), np.zeros(N_UNKNOWNS), np.zeros(1, np.int64)
    model = FilterModel(speeds, of_all, of_all, np.zeros((2, outputs, n)), np.eye(n))
    of_rows, of_row, stops = np.zeros((0, n)), np.zeros(0), stops_of(rows, 1)
    gains = KeptGains(of_row, of_row, of_rows, of_rows, np.zeros((1, n, n)), of_row)
    set_gains(ticks, rows, np.zeros(0), unknowns, model, 0, stops, gains)
    shape, step = (2, outputs, N_STRAIGHT), (1, 2, N_STRAIGHT, N_STRAIGHT + 1)
    straight = StraightModel(
        speeds, np.zeros(step), np.zeros((*step, 1)),
        np.zeros(shape), np.zeros((*shape, 1)), np.zeros(shape[1:]), np.zeros(shape[:2]),
        np.zeros((*shape[:2], 1)),
    )  # fmt: skip
    row = Whitened(
        ticks, rows, gains, model, np.zeros(0, np.int64), np.zeros(0), np.zeros(1), np.zeros(1), stops
    )  # fmt: skip
    respond(row, straight, np.zeros(N_ROW_UNKNOWNS), places, np.zeros((0, 2)))
