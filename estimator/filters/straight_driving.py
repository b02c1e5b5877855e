"""The rig about straight driving, where all that it does is in proportion to the wheel angle.

The motion model of rolling.py and the readings of the sensors, linearised about straight driving at a speed:
matrices over a tick, exact, with their exact slopes by the unknowns, those of the exponential step too. They
are tabulated at a few speeds, between which they are linear to a thousandth.

Steering moves the state z, (13,): that of states.py before X_DISTURBANCE, and how far the tractor's CG is to
the east of the row, which goes north. Behind it the filter has what the ground does and the receivers' slow
errors: KEPT of its states, (25,), those that are across the row.
"""

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.compiled import kernel
from tilth.estimator.filters.measurement_model import predict_measurement
from tilth.estimator.filters.propagation import (
    empty_plant,
    first_covariance,
    ground_at,
    rate_jacobians,
    rates_by_unknown,
    set_bank,
    set_plant,
    set_processes,
    state_rates,
)
from tilth.estimator.filters.rig_setup import RigSetup
from tilth.estimator.filters.sensors.observation import Observation
from tilth.estimator.filters.sensors.wheel_angle import DriveInputs, set_wheel_noise
from tilth.estimator.filters.states import (
    ACROSS,
    BANK_STATES,
    DT,
    N_STATES,
    STATES,
    X_DISTURBANCE,
    X_POSITION,
    X_PSI,
    X_V,
    Places,
)
from tilth.estimator.filters.transition import empty_transition
from tilth.estimator.filters.unknowns import N_UNKNOWNS
from tilth.estimator.models.rolling import rates_by_parameter
from tilth.estimator.record.record import HEADING, ROLL_ANGLE, YAW_RATE, U
from tilth.estimator.tuning import tuned

Array = NDArray[np.float64]

N_STRAIGHT: Final = X_DISTURBANCE + 1
EAST_OF_ROW: Final = X_DISTURBANCE  # index of the last state
PLACES: Final = 4  # of a kind of measurement, at most
N_SENSORS: Final = (ROLL_ANGLE + 1) * PLACES  # by kind and place
KEPT: Final = [k for k, name in enumerate(STATES) if "north" not in name and name != "speed"]
RESPONDING: Final = [*range(X_DISTURBANCE), X_POSITION + 1]
NOBODY: Final = np.zeros(0, np.int64)


@dataclass(frozen=True, slots=True)
class StraightTuning:
    """Numerics of the model about straight driving."""

    small: float = tuned(1e-4, "rad, m/s", "state at which slopes by unknowns are taken, in proportion to it")
    spacing: float = tuned(0.25, "m/s", "between tabulated speeds")
    most_ticks: int = tuned(10, "ticks", "that are gone in one step: those of an epoch of 5 Hz")
    terms: int = tuned(10, "1", "terms of the exponential's series")


STRAIGHT: Final = StraightTuning()
SMALL: Final = STRAIGHT.small  # kernels read globals; a record is none for them


class StraightRates(NamedTuple):
    """At one speed."""

    rates_x: Array  # (12, 22), as Transition.rates_x
    A: Array  # (13, 14), rates by the state and the true wheel angle
    A_unknowns: Array  # (a, 13, 14), their slopes
    H: Array  # (24, 30), readings by the filter's state
    H_unknowns: Array  # (a, 24, 13), slopes of those by the state
    rest: Array  # (24,), readings of a rig that goes straight
    offsets: Array  # (a, 24), their slopes


class StraightModel(NamedTuple):
    """At the tabulated speeds, (s,), in order."""

    speeds: Array  # m/s
    step: Array  # (t, s, 13, 13 + t), the state 1 to t ticks later by the state and each tick's wheel angle
    step_unknowns: Array  # (t, s, 13, 13 + t, a)
    H: Array  # (s, 24, 13)
    H_unknowns: Array  # (s, 24, 13, a)
    acting: Array  # (24, 13), 0.0 where all of these are
    rest: Array  # (s, 24)
    offsets: Array  # (s, 24, a)


class FilterModel(NamedTuple):
    """The filter at the tabulated speeds, (s,), in order; of KEPT."""

    speeds: Array  # m/s
    F: Array  # (t, s, 25, 25), over 1 to t ticks
    Q: Array  # (t, s, 25, 25), covariance of their noise
    H: Array  # (s, 24, 25)
    start: Array  # (25, 25), covariance of the first state


@kernel
def straight_rates(u: float, unknowns: Array, setup: RigSetup, places: Places) -> StraightRates:
    """At speed u, m/s, and a point of the unknowns, (n,), with slopes by those at places, (a,)."""
    na = places.shape[0]
    plant, step = empty_plant(setup, na), empty_transition(na, 0, 1)
    set_plant(plant, unknowns, setup, places)
    x, none = np.zeros(N_STATES), np.zeros(N_STATES)
    rate_jacobians(x, DriveInputs(u, 0.0, 0.0, 0.0, 0.0), plant, step)
    A, A_unknowns = np.zeros((N_STRAIGHT, N_STRAIGHT + 1)), np.zeros((na, N_STRAIGHT, N_STRAIGHT + 1))
    for i in range(X_DISTURBANCE):  # one by one: numba takes three seconds to compile the copy of an array
        A[i, N_STRAIGHT] = step.rates_wheel[i]
        for j in range(X_DISTURBANCE):
            A[i, j] = step.rates_x[i, j]
    A[EAST_OF_ROW, X_V], A[EAST_OF_ROW, X_PSI] = 1.0, u
    H, H_unknowns = np.zeros((N_SENSORS, N_STATES)), np.zeros((na, N_SENSORS, N_STRAIGHT))
    rest, offsets = np.zeros(N_SENSORS), np.zeros((na, N_SENSORS))
    slopes = np.zeros(N_STATES + N_UNKNOWNS)
    for i in range(N_STRAIGHT + 1):
        x[:] = 0.0
        if i < X_DISTURBANCE:
            x[i] = SMALL
        wheel = SMALL if i == N_STRAIGHT else 0.0
        if na > 0 and i != EAST_OF_ROW:
            state_rates(x, DriveInputs(u, 0.0, wheel, wheel, 0.0), plant, step.rates)
            rates_by_parameter(plant.x, plant.w, plant.p, plant.motion)
            step.rates_unknowns[:] = 0.0
            rates_by_unknown(plant, step.rates_unknowns)
            for j in range(na):
                for k in range(X_DISTURBANCE):
                    A_unknowns[j, k, i] = step.rates_unknowns[k, j] / SMALL
    for code in range(N_SENSORS):
        kind, place = code // PLACES, code % PLACES
        if kind in (YAW_RATE, HEADING) and place > 1:  # of bodies
            continue
        obs = Observation(kind, place, 0.0, u, 0.0, 0.0)
        rest[code] = predict_measurement(none, obs, unknowns, setup, slopes)
        for i in range(N_STATES):
            H[code, i] = slopes[i]
        for j in range(na):
            offsets[j, code] = slopes[N_STATES + places[j]]
        for i in range(X_DISTURBANCE if na > 0 else 0):
            x[:] = 0.0
            x[i] = SMALL
            predict_measurement(x, obs, unknowns, setup, slopes)
            for j in range(na):
                H_unknowns[j, code, i] = (slopes[N_STATES + places[j]] - offsets[j, code]) / SMALL
    return StraightRates(step.rates_x, A, A_unknowns, H, H_unknowns, rest, offsets)


class Processes(NamedTuple):
    """What the filter's states from X_DISTURBANCE on do over a tick at one speed, and the noise of all."""

    decay: Array  # (30,)
    bank: Array  # (4, 4), of BANK_STATES
    q: Array  # (30,), variances, without that of the position
    bank_noise: Array  # (4, 4)


@kernel
def processes_at(u: float, unknowns: Array, setup: RigSetup) -> Processes:
    """At speed u, m/s, and a point of the unknowns, (n,)."""
    step = empty_transition(0, 0, 1)
    set_bank(u, setup, step)
    set_processes(u, ground_at(unknowns), setup, step, 0)
    set_wheel_noise(u, unknowns, setup.sds, step)
    return Processes(step.decay[0].copy(), step.bank.copy(), step.q[0].copy(), step.bank_noise.copy())


@kernel
def variances_at_first(u: float, unknowns: Array, setup: RigSetup) -> Array:
    """Covariance of the filter's first state at speed u, m/s, (30, 30)."""
    return first_covariance(u, ground_at(unknowns), setup)


def tabulated(ticks: Array) -> Array:
    """Speeds, (s,), m/s, that go with the ticks of records, (n, 8) as record.Record; two or more."""
    low, high = float(ticks[:, U].min()), float(ticks[:, U].max())
    return np.linspace(low, max(high, low + STRAIGHT.spacing / 2), 2 + int((high - low) / STRAIGHT.spacing))


def straight_model(speeds: Array, unknowns: Array, setup: RigSetup, places: Places) -> StraightModel:
    """The model at speeds, (s,), m/s, and a point of the unknowns, (n,), with slopes by those at places."""
    made = [straight_rates(float(u), unknowns, setup, places) for u in speeds]
    count, n, na = STRAIGHT.most_ticks, N_STRAIGHT, len(places)
    steps = np.zeros((count, len(speeds), n, n + count))
    slopes = np.zeros((*steps.shape, na))
    for k, rates in enumerate(made):
        _over_ticks(*_over_a_tick(rates.A, rates.A_unknowns), steps[:, k], slopes[:, k])
    H_unknowns = np.ascontiguousarray(np.moveaxis(np.stack([rates.H_unknowns for rates in made]), 1, -1))
    return StraightModel(
        speeds, steps, slopes,
        np.ascontiguousarray(np.stack([rates.H[:, RESPONDING] for rates in made])),
        H_unknowns, np.any(H_unknowns != 0.0, axis=(0, 3)).astype(np.float64),
        np.stack([rates.rest for rates in made]),
        np.ascontiguousarray(np.moveaxis(np.stack([rates.offsets for rates in made]), 1, -1)),
    )  # fmt: skip


def filter_model(speeds: Array, unknowns: Array, setup: RigSetup) -> FilterModel:
    """The filter at speeds, (s,), m/s, and a point of the unknowns, (n,)."""
    steps, noises, sensors = [], [], []
    for u in map(float, speeds):
        rates, processes = straight_rates(u, unknowns, setup, NOBODY), processes_at(u, unknowns, setup)
        steps.append(_filter_step(u, rates.rates_x, processes)[np.ix_(KEPT, KEPT)])
        noise = np.diag(processes.q)
        noise[np.ix_(BANK_STATES, BANK_STATES)] += processes.bank_noise
        noise[X_POSITION + 1, X_POSITION + 1] += ACROSS**2 * DT
        noises.append(noise[np.ix_(KEPT, KEPT)])
        sensors.append(rates.H[:, KEPT])
    start = variances_at_first(float(speeds.mean()), unknowns, setup)[np.ix_(KEPT, KEPT)]
    F, Q, H = (np.stack(each) for each in (steps, noises, sensors))
    over, added = [F], [Q]
    for _ in range(STRAIGHT.most_ticks - 1):
        added.append(F @ added[-1] @ F.swapaxes(1, 2) + Q)
        over.append(F @ over[-1])
    return FilterModel(speeds, np.stack(over), np.stack(added), H, np.ascontiguousarray(start))


def _filter_step(u: float, rates_x: Array, processes: Processes) -> Array:
    """Jacobian of the filter's state over a tick, (30, 30), at speed u, m/s. rates_x: (12, 22)."""
    F = np.diag(processes.decay)
    F[:X_DISTURBANCE, :X_DISTURBANCE] = F[X_POSITION + 1, X_POSITION + 1] = 0.0
    F[np.ix_(BANK_STATES, BANK_STATES)] = processes.bank
    later, _ = _over_a_tick(rates_x, np.zeros((0, *rates_x.shape)))
    F[:X_DISTURBANCE, : rates_x.shape[1]] = later
    twice = np.eye(*rates_x.shape) + later
    F[X_POSITION + 1, : rates_x.shape[1]] = 0.5 * DT * (twice[X_V] + u * twice[X_PSI])
    F[X_POSITION + 1, X_POSITION + 1] = 1.0
    return F


def _over_ticks(tick: Array, tick_unknowns: Array, out: Array, slopes: Array) -> None:
    """Fill out, (t, n, n + t), and slopes, (t, n, n + t, a): the state 1 to t ticks later, by the state and
    by the input of each of these ticks. tick: (n, n + 1), of one, with its slopes (a, n, n + 1)."""
    n, na = len(tick), len(tick_unknowns)
    F, by_input = tick[:, :n], tick[:, n]
    F_slopes = np.ascontiguousarray(np.moveaxis(tick_unknowns, 0, 1))  # (n, a, n + 1)
    out[0, :, : n + 1], slopes[0, :, : n + 1] = tick, F_slopes.swapaxes(1, 2)
    for k in range(1, len(out)):
        before, width = out[k - 1, :, : n + k], n + k
        of_before = F_slopes[:, :, :n].reshape(n * na, n) @ before
        total = of_before.reshape(n, na, width).swapaxes(1, 2)
        total = total + (F @ slopes[k - 1, :, :width].reshape(n, -1)).reshape(n, width, na)
        out[k, :, :width], slopes[k, :, :width] = F @ before, total
        out[k, :, width], slopes[k, :, width] = by_input, F_slopes[:, :, n]


def _over_a_tick(A: Array, A_unknowns: Array) -> tuple[Array, Array]:
    """(n states after a tick by those before and by inputs that are held (n, m), its slopes (a, n, m)): the
    exponential of the rates A, (n, m), and its derivative along A_unknowns, (a, n, m).

    The filters' own, `transition.integrate_exponential`, is a kernel of fewer terms, as each third tick of a
    run needs it, and has no slopes.
    """
    n, size = A.shape
    acting = np.flatnonzero(np.any(A_unknowns != 0.0, axis=(1, 2)))
    M, dM = np.zeros((size, size)), np.zeros((len(acting), size, size))
    M[:n], dM[:, :n] = DT * A, DT * A_unknowns[acting]
    power, found = np.eye(size), np.eye(size)
    slope, total = np.zeros_like(dM), np.zeros_like(dM)
    for order in range(1, STRAIGHT.terms + 1):
        slope = (slope @ M + power @ dM) / order
        power = power @ M / order
        found, total = found + power, total + slope
    slopes = np.zeros_like(A_unknowns)
    slopes[acting] = total[:, :n]
    return found[:n], slopes
