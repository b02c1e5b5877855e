"""One-step prediction errors of a record at given unknowns, and their derivatives: the likelihood that pem
maximises.

It is a Kalman filter over the states of states.py; propagation.py propagates them. Between two ticks the
state is taken as linear in time. Measurements are scalar and are processed one by one, so the log-likelihood
is log L = -1/2 sum (e^2 / S + log S), with innovation e and its variance S. The derivatives of e over the
unknowns, with the gains held, are propagated beside the state by the same Jacobians; so is what a change of
the readings makes of e, and so are companions with other noise levels (perturbed_filters.py).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.compiled import inline_kernel
from tilth.estimator.filters.gates import UNLIMITED
from tilth.estimator.filters.joint_update import (
    JointState,
    UpdateWork,
    empty_work,
    propagate_covariances,
    update,
)
from tilth.estimator.filters.measurement_model import Expected, innovation, observation
from tilth.estimator.filters.perturbed_filters import (
    Filters,
    advance,
    deviate,
    filters,
    first_covariances,
    set_all_noise,
    set_innovations,
)
from tilth.estimator.filters.propagation import (
    EVERY,
    Plant,
    empty_plant,
    linearise,
    propagate,
    set_plant,
)
from tilth.estimator.filters.record_loop import over_ticks
from tilth.estimator.filters.rig_setup import RigSetup
from tilth.estimator.filters.sensors.wheel_angle import drive_at, set_wheel_noise
from tilth.estimator.filters.states import N_STATES, Places
from tilth.estimator.filters.transition import (
    D_POSITION,
    N_COUPLED,
    POSITION_LATER,
    Transition,
    decay_rows,
    empty_transition,
    multiply,
)
from tilth.estimator.filters.unknowns import N_UNKNOWNS
from tilth.estimator.record.record import SD, U

Array = NDArray[np.float64]


class Measured(NamedTuple):
    """The data of a filter run."""

    ticks: Array  # [n, 8], as record.Record
    rows: Array  # [m, 6], as record.Record; the values in it are not used
    readings: Array  # (m,), the values
    used: Array  # (m,), 0.0 for a row that is left out
    closed: bool  # whether measurements update the state; False: the open loop


class Varied(NamedTuple):
    """What is varied beside a filter run."""

    places: Places  # (a,), the unknowns to differentiate by
    instruments: Array  # (m, a), changes of the readings; or (0, a)
    responding: NDArray[
        np.bool_
    ]  # (a,), whose derivatives are the response to `instruments`, not to the unknown
    nearby: Array  # (q, n), points that differ in noise levels


class Innovations(NamedTuple):
    """Result of a filter run."""

    e: Array  # (m,), innovations (prediction errors)
    S: Array  # (m,), their variances
    de: Array  # (m, a), derivatives of e over the active unknowns, with the gains held
    e_nearby: Array  # (m, q), innovations with other noise levels
    S_nearby: Array  # (m, q), their variances


class Sensitivities(NamedTuple):
    """Derivatives over the active unknowns, with the gains held."""

    D: Array  # (30, a), of the state
    coupled: Array  # (14, a), of the coupled states one tick later, overwritten
    d: Array  # (a,), of the present innovation


@inline_kernel
def row_sensitivities(
    H: Array, H_unknowns: Array, row: int, varied: Varied, sensitivities: Sensitivities
) -> None:
    """Fill the derivatives of the innovation of a row. H: (30,), its prediction's Jacobian at the tick;
    H_unknowns: (a,), of what else changes with the unknowns."""
    D, _, d = sensitivities
    for j in range(d.shape[0]):
        d[j] = varied.instruments[row, j] if varied.responding[j] else -H_unknowns[j]
    for i in range(N_STATES):
        if H[i] != 0.0:
            for j in range(d.shape[0]):
                d[j] -= H[i] * D[i, j]


@inline_kernel
def update_sensitivities(gain: Array, sensitivities: Sensitivities) -> None:
    """Add a measurement's part to the derivatives. gain: (30,)."""
    D, _, d = sensitivities
    for i in range(N_STATES):
        for j in range(d.shape[0]):
            D[i, j] += gain[i] * d[j]


@inline_kernel
def propagate_sensitivities(sensitivities: Sensitivities, step: Transition) -> None:
    """Propagate the derivatives over a tick."""
    D, coupled, d = sensitivities
    if d.shape[0] == 0:
        return
    multiply(step.F_coupled, D, coupled)
    decay_rows(D, 0, step.decay[0], step.bank)
    for k in range(N_COUPLED):
        i = k if k < D_POSITION else k + POSITION_LATER
        for j in range(d.shape[0]):
            D[i, j] = coupled[k, j] + step.F_unknowns[k, j]


class Runner(NamedTuple):
    """What a filter run works with."""

    measured: Measured
    setup: RigSetup
    state: JointState
    run: Filters
    varied: Varied
    sensitivities: Sensitivities
    plant: Plant
    step: Transition
    work: UpdateWork
    at: Expected
    out: Innovations


def runner(
    measured: Measured, x: Array, unknowns: Array, setup: RigSetup, varied: Varied, out: Innovations
) -> Runner:
    """At the first tick of a run. The arguments are those of `run_filter`."""
    out.e[:], out.S[:], out.de[:], out.e_nearby[:], out.S_nearby[:] = 0.0, 1.0, 0.0, 0.0, 1.0
    places, run = varied.places, filters(unknowns, varied.nearby)
    na, learned = places.shape[0], places[:0]
    plant = empty_plant(setup, na)
    set_plant(plant, unknowns, setup, places)
    P = first_covariances(measured.ticks[0, U], run, setup)
    step, work = empty_transition(na, learned.shape[0], P.shape[0]), empty_work(P.shape[0], P.shape[1])
    state = JointState(x, np.zeros(N_STATES), unknowns, learned, np.zeros(N_STATES), P)
    sensitivities = Sensitivities(np.zeros((N_STATES, na)), np.zeros((N_COUPLED, na)), np.zeros(na))
    at = Expected(np.zeros(N_STATES), np.zeros(N_STATES + N_UNKNOWNS), np.zeros(N_STATES), np.zeros(na))
    return Runner(measured, setup, state, run, varied, sensitivities, plant, step, work, at, out)


@inline_kernel
def begin_tick(k: int, on: Runner) -> float:
    """Propagate the state from tick k to the next; the measured speed between them, m/s."""
    x, unknowns, step, ticks = on.state.x, on.state.unknowns, on.step, on.measured.ticks
    drive = drive_at(ticks, k, unknowns)
    if k % EVERY == 0:
        set_all_noise(drive.u, on.run, on.setup, step)
        set_wheel_noise(drive.u, unknowns, on.setup.sds, step)
        linearise(x, ticks, k, unknowns, on.plant, step)
    propagate(x, drive, unknowns, on.plant, on.varied.places, step, on.state.following)
    for j in range(on.varied.responding.shape[0]):
        if on.varied.responding[j]:
            step.F_unknowns[:, j] = 0.0
    return drive.u


@inline_kernel
def end_tick(u: float, on: Runner) -> None:
    """Propagate all else."""
    state, step = on.state, on.step
    if on.measured.closed:
        propagate_covariances(state, step)
        advance(on.run, state.x, step)
    for i in range(N_STATES):
        state.x[i] = state.following[i]
    propagate_sensitivities(on.sensitivities, step)


@inline_kernel
def take_row(row: int, k: int, u: float, on: Runner) -> None:
    """Update all filters with a row of the record, after tick k at speed u, m/s; fill its row of out."""
    measured, state, at, sensitivities, out = on.measured, on.state, on.at, on.sensitivities, on.out
    if measured.used[row] == 0.0:
        return
    obs = observation(measured.ticks, measured.rows[row], k, u, state.x, state.following, state.unknowns)
    error = innovation(measured.readings[row], obs, state, on.varied.places, on.setup, on.step, at)
    row_sensitivities(at.H, at.H_unknowns, row, on.varied, sensitivities)
    out.e[row] = error
    for j in range(sensitivities.d.shape[0]):
        out.de[row, j] = sensitivities.d[j]
    if not measured.closed:
        return
    errors, variances = on.run.errors, on.run.variances
    set_innovations(error, measured.rows[row, SD], obs.kind, at.H, on.run)
    update(errors, variances, at.H, state, on.step, UNLIMITED, on.work)
    update_sensitivities(on.work.gain[0], sensitivities)
    deviate(on.run, on.work)
    out.S[row] = variances[0]
    for q in range(errors.shape[0] - 1):
        out.e_nearby[row, q], out.S_nearby[row, q] = errors[1 + q], variances[1 + q]


run_ticks = over_ticks.with_steps(begin_tick=begin_tick, take_row=take_row, end_tick=end_tick)


def run_filter(
    measured: Measured, x: Array, unknowns: Array, setup: RigSetup, varied: Varied, out: Innovations
) -> None:
    """Fill out: innovation, its variance and its derivatives, of each row, at one point of the unknowns.

    unknowns: (n,). x: (30,), the first state, overwritten with the last.
    """
    run_ticks(len(measured.ticks), measured.rows, runner(measured, x, unknowns, setup, varied, out))
