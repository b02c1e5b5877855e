"""Straight rows under automatic steering: the six parameters by what the steering does of its own.

Rows are collected into blocks of up to ten minutes (record/straight_rows.py). A block is fitted after two
minutes, after five and when it is full, always as a whole from the posterior of the block before, drifted
over the distance since (filters/row_fit.py). A second informs once. A stop in which the load may have changed
ends a block: then it is fitted as it is. The fit is computed elsewhere (`fit`, a pure function) and adopted
as one of pem is.

Steering that only answers the ground tells nothing reliable: as long as its own share of the wheel angle is
small, a block is not used, and the estimate says so with the share.
"""

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.diagnosis.open_numbers import Misfit
from tilth.estimator.filters import row_fit, unknowns
from tilth.estimator.filters.rig_setup import rig_setup
from tilth.estimator.filters.soil_field import ROWS, Told, told
from tilth.estimator.filters.unknowns import AT, SIX, Matrix, Vector
from tilth.estimator.methods import fitted, open_tracker, pem
from tilth.estimator.methods.fitted import FittedState
from tilth.estimator.record import straight_rows
from tilth.estimator.record.record import Record, Segment
from tilth.estimator.record.straight_rows import Block
from tilth.estimator.results.method_state import drifted, is_due
from tilth.estimator.results.reporting import REPORTING, six_parameter_estimate
from tilth.estimator.tuning import tuned
from tilth.schemas.flow import Estimate, OwnSteering, Pose
from tilth.schemas.machine import Machine
from tilth.schemas.reasons import Code

Array = NDArray[np.float64]

METHOD: Final = ROWS
ROLL_STIFFNESSES: Final = [AT["roll_k_t"], AT["roll_k_i"]]
FRONT: Final = AT["roll_front"]


@dataclass(frozen=True, slots=True)
class RowsTuning:
    """When what rows tell is used, and what errors of the model leave in it."""

    latency_ns: int = tuned(10_000_000_000, "ns", "after a request, at which a fit is adopted")
    least_share: float = tuned(0.5, "1", "of the wheel angle, that is the steering's own; less is not used")
    """Of 35 rows of a fleet with shares of 0.25 to 1 194 of 210 intervals held; only above 0.9 were there
    more."""
    least_rms: float = tuned(np.radians(0.2), "rad", "of the wheel angle that is the steering's own")
    model_sd: float = tuned(0.1, "1", "of the six logarithms, by errors of the response to steering")
    """The likeliest in 52 rows of two and ten minutes; 0.07 to 0.135 are likely. Published beside what noise
    leaves, once: more rows do not take it away."""
    roll_sd: float = tuned(1.0, "1", "least prior sd of the logarithm of either body's roll stiffness")
    """In rows bodies sway by hundredths of a degree, where axles stick and tyres are stiffer. On a rig that
    did not sway at all, which 22 % exclude, ten minutes had C_ar 39 % off; with this 2 %, at the same sds."""
    front_stiffer: float = tuned(0.7, "1", "median logarithm of the front axle's stiffness about its pin")
    front_sd: float = tuned(0.7, "1", "of it, beside the sd by the machine file")
    """Pushed aside, an axle tips by its tyres' stiffness, or not at all, as on plants in the plane. It is one
    spring in a row with the carcass's, so a row tells the sum alone: taken for as soft as its tyres make it,
    sigma_f of axles that do not tip came out 44 to 97 % short. This is half as soft, and no more than the
    tyres' nor less than nothing is within 1 sd."""
    change_chi_square: float = tuned(33.1, "chi^2", "of six, 1e-5: the block contradicts what was learned")


TUNING: Final = RowsTuning()


@dataclass(frozen=True, slots=True)
class ToldPiece:
    """What a piece of a row tells of the six."""

    begin_ns: int
    end_ns: int
    told: Told


@dataclass(frozen=True, slots=True)
class Job:
    """A fit to compute. With the machine file it is all that `fit` needs."""

    asked_ns: int  # t_ns of the frame at which it was requested
    closed_ns: int  # instant of its last tick
    rows: list[Record]
    full: bool  # whether it is the last fit of its block
    mean: Array  # [n], before the block
    covariance: Array  # [n, n]


@dataclass(frozen=True, slots=True)
class Fit:
    """The result of a job."""

    mean: Array  # [n] of unknowns.NAMES
    covariance: Array  # [n, n]
    own_share: float
    own_rms: float  # rad
    seconds: float  # of rows
    steps: int
    cost: float
    changed: bool  # the block contradicted what was known
    tie: bool  # as fitted.Fit
    refused: Code | None  # why it must not be used
    told: Told | None = None  # what the block alone tells of the six
    of_file: Misfit | None = None  # what all rows so far tell of the machine file; not with a short block
    pieces: tuple[ToldPiece, ...] = ()  # what pieces of the rows tell; together as `told`


@dataclass(slots=True)
class RowsState(FittedState):
    """`distance` is since the last fit."""

    before_mean: Vector  # as `mean`, before the present block
    before_covariance: Matrix
    _: KW_ONLY
    before_m: float = 0.0  # distance since the block before
    before_s: float = 0.0  # window_s before the present block
    block: Block = field(default_factory=Block)
    ended_ns: int = 0  # when the rig had stood: a block of before has ended
    job: Job | None = None  # requested, not adopted yet
    last: Fit | None = None


def prior(machine: Machine) -> tuple[Array, Array]:
    """(mean, sd), (n,), of unknowns.NAMES by the machine file, with the bodies' roll stiffnesses wider, and
    that of the front axle about its pin from soft to rigid."""
    mean, sd = unknowns.prior(machine)
    sd[ROLL_STIFFNESSES] = np.maximum(sd[ROLL_STIFFNESSES], TUNING.roll_sd)
    mean[FRONT] += TUNING.front_stiffer
    sd[FRONT] = np.hypot(sd[FRONT], TUNING.front_sd)
    return mean, sd


def initial(machine: Machine) -> RowsState:
    """The state before any data, at the priors of the machine file."""
    mean, sd = prior(machine)
    before = (mean.copy(), np.diag(sd**2))
    return RowsState(mean.copy(), np.diag(sd**2), mean, sd, *before, model_sd=np.full(6, TUNING.model_sd))


def take(state: RowsState, machine: Machine, pose: Pose, segment: Segment | None) -> Estimate | None:
    """Take one segment; an estimate each REPORTING.publish_ns."""
    state.before_m += fitted.drive_on(state, pose, segment)
    straight_rows.observe(state.block, segment)
    refused = state.last.refused if state.last else None
    state.reason = state.block.reason or refused
    return estimate(state, machine, pose.t_ns) if is_due(state, pose.t_ns, REPORTING.publish_ns) else None


def stood(state: RowsState) -> None:
    """As of estimators.Estimator: the present block ends. What a fit that is late by now did not have is
    lost."""
    state.stops, state.ended_ns = state.stops + 1, state.last_pose_ns
    if state.job is not None:
        straight_rows.end_row(state.block)
        straight_rows.forget(state.block)
        return
    straight_rows.end(state.block)
    if not state.block.ended:
        _begin_block(state)


def finish(state: RowsState) -> None:
    """No more driving follows: what of a block is not fitted yet stays so."""
    straight_rows.end_row(state.block)


def request_fit(state: RowsState, t_ns: int) -> Job | None:
    """The fit to request at the frame of t_ns: of a block that is long enough, if no other is pending."""
    if state.job is not None or not straight_rows.is_due(state.block):
        return None
    records, full = straight_rows.rows_to_fit(state.block)
    covariance = drifted(state, state.before_covariance, state.before_m)
    state.job = Job(t_ns, records[-1].end_ns, records, full, state.before_mean.copy(), covariance)
    return state.job


def fit(machine: Machine, job: Job) -> Fit:
    """The result of a job, a pure function of its arguments."""
    prior_mean, prior_sd = unknowns.prior(machine)
    found, changed = _posterior(machine, job, job.mean, job.covariance), False
    if found is None:
        return Fit(
            job.mean, job.covariance, 0.0, 0.0, 0.0, 0, 0.0, False, False, Code.OUTPUTS_NOT_MEASURED
        )  # fmt: skip
    known, start = job.covariance, job.mean
    before, after = known[SIX, SIX], found.covariance[SIX, SIX]
    moved, errors = (found.mean - job.mean)[SIX], np.full(6, TUNING.model_sd)
    chi_square = pem.contradiction(moved, before, after, errors)
    if chi_square > TUNING.change_chi_square:
        start, known = pem.of_other_tyres(job.mean, job.covariance, prior_mean, prior_sd)
        changed = True
        found = _posterior(machine, job, start, known) or found
    own = float(found.wheel_rms * np.sqrt(found.own_share))
    little = own < TUNING.least_rms or found.own_share < TUNING.least_share
    shares = (own, TUNING.least_rms), (found.own_share, TUNING.least_share)
    tie = fitted.is_tie((chi_square, TUNING.change_chi_square), *shares)
    refused = Code.LITTLE_OWN_STEERING if little else pem.refusal(found, prior_mean, prior_sd)
    alone = None if refused else _told(start, known, found, (prior_mean, prior_sd))
    of_file = None
    if not refused and straight_rows.is_long(job.rows):
        of_file = open_tracker.of_fit(machine, found.mean, found.covariance, prior(machine))
    return Fit(
        found.mean, found.covariance, found.own_share, own, found.seconds, found.steps, found.cost, changed,
        tie, refused, alone, of_file,
        _by_piece(job.rows, alone, found.pieces) if alone else (),
    )  # fmt: skip


def tells_of_file(made: Fit) -> tuple[Misfit, float] | None:
    """What a fit tells of the machine file, and s of driving that this is of."""
    return None if made.of_file is None else (made.of_file, made.seconds)


def _told(mean: Array, covariance: Array, found: row_fit.RowPosterior, prior: tuple[Array, Array]) -> Told:
    """What a block alone tells. mean, covariance: before it, (n,) and (n, n). prior: as of unknowns.prior."""
    known, after = pem.with_known_masses(covariance), found.covariance - pem.of_masses(covariance)
    active = np.flatnonzero(np.diag(known) > 0.0)
    at, added = np.ix_(active, active), np.zeros_like(known)
    added[at] = open_tracker.added(known[at], after[at])
    return told(mean, known, found.mean, added, prior, np.ones(6), np.full(6, TUNING.model_sd))


def _by_piece(
    records: Sequence[Record], whole: Told, pieces: Sequence[row_fit.RowPiece]
) -> tuple[ToldPiece, ...]:
    """What a block tells, shared out to pieces of its rows.

    The fit has one value of each of the six for all of them. What a piece says is off that by its gradient
    there, as far as gradients of all pieces do not cancel (soil_within.py); its information is so much less
    than by its slopes as the block's is: for what else the block had to find, and where it is widened.
    """
    every = np.sum([one.information for one in pieces], axis=0)
    at = np.flatnonzero(np.diag(every) > 0.0)
    root = _root(every[np.ix_(at, at)])
    less = np.zeros((6, 6))
    less[np.ix_(at, at)] = np.linalg.solve(
        root, np.linalg.solve(root, _root(root @ whole.information[np.ix_(at, at)] @ root)).T
    )
    common = np.linalg.pinv(every, hermitian=True) @ np.sum([one.gradient for one in pieces], axis=0)
    value = np.linalg.pinv(whole.information, hermitian=True) @ whole.vector
    told = []
    for one in pieces:
        information = less @ one.information @ less.T
        vector = information @ value + less @ (one.gradient - one.information @ common)
        begin_ns, end_ns = (records[one.row].t_ns + round(at_s * 1e9) for at_s in (one.begin_s, one.end_s))
        told.append(ToldPiece(begin_ns, end_ns, Told(information, vector, whole.model_sd)))
    return tuple(told)


def _root(squared: Array) -> Array:
    """The symmetric square root, (a, a)."""
    sizes, axes = np.linalg.eigh(squared)
    return np.asarray((axes * np.sqrt(np.maximum(sizes, 0.0))) @ axes.T)


def _posterior(machine: Machine, job: Job, mean: Array, covariance: Array) -> row_fit.RowPosterior | None:
    """With the masses of the file, as pem's. None where too little is measured."""
    known = pem.with_known_masses(covariance)
    found = row_fit.fitted(job.rows, rig_setup(machine), mean, known)
    return found and found._replace(covariance=found.covariance + pem.of_masses(covariance))


def rehearse(machine: Machine) -> None:
    """A fit of a minute of straight driving, which compiles all that a fit needs."""
    mean, sd = unknowns.prior(machine)
    epochs = np.arange(300)
    ticks = np.zeros((len(epochs) * 10, 8))
    ticks[:, 0], ticks[:, 1] = 0.01 * np.sin(0.05 * np.arange(len(ticks))), 4.0
    kinds = [(0, 0), (0, 1), (1, 0), (1, 2), *((kind, place) for kind in (2, 3) for place in range(4))]
    rows = np.array([[10.0 * k, 0.0, *kind, 0.01 * np.sin(k * (1.0 + i)), 0.02]
                     for k in epochs for i, kind in enumerate(kinds)])  # fmt: skip
    fit(machine, Job(0, 0, [Record(0, ticks, rows)], False, mean, np.diag(sd**2)))


def adopt(state: RowsState, machine: Machine, made: Fit | None, t_ns: int) -> Estimate:
    """Adopt the result of the pending job; made: None if there is none. Returns the estimate after it."""
    job, state.job = state.job, None
    made = made if job else None
    used = fitted.is_used(state, made)
    state.last = replace(made, pieces=()) if made else state.last  # the memory by place has them
    if job is not None and made is not None and used:
        _use(state, job, made)
    ended = job is not None and (job.full or job.closed_ns <= state.ended_ns)
    if ended:  # also where its last fit failed: an earlier one of it counts
        _begin_block(state)
    return estimate(state, machine, t_ns)


def _use(state: RowsState, job: Job, made: Fit) -> None:
    state.mean, state.covariance, state.distance = made.mean, made.covariance, 0.0
    state.changes += made.changed
    state.informed_ns = job.closed_ns
    state.window_s = made.seconds + (0.0 if made.changed else state.before_s)
    state.fits += 1


def _begin_block(state: RowsState) -> None:
    """The next block begins with what is known now."""
    state.before_mean, state.before_covariance = state.mean.copy(), state.covariance.copy()
    state.before_m, state.before_s = state.distance, state.window_s


def clock_stepped(state: RowsState, by_ns: int) -> None:
    """The log's clock stepped back: discard the block and the pending fit, keep the posterior and its age."""
    straight_rows.forget(state.block)
    _begin_block(state)
    state.job, state.ended_ns = None, 0
    fitted.clock_stepped(state, by_ns)


def published_covariance(state: RowsState) -> Array:
    """Of the six, (6, 6), now, with errors of the model."""
    return learned_covariance(state)[SIX, SIX] + np.diag(state.model_sd**2)


def learned_covariance(state: RowsState) -> Array:
    """(n, n), now, without errors of the model."""
    return drifted(state, state.covariance, state.distance)


def estimate(state: RowsState, machine: Machine, t_ns: int) -> Estimate:
    """The estimate at t_ns."""
    last = state.last
    own_s = {"rows_s": straight_rows.seconds(state.block)}
    made = six_parameter_estimate(
        state, machine, t_ns, METHOD, published_covariance(state), Code.NO_ROWS_YET,
        fitted.excitation(state, own_s, last, last.steps if last else 0), None, fitted.stale(state, t_ns),
    )  # fmt: skip
    own = OwnSteering(last.own_share, last.own_rms, last.seconds) if last else None
    return replace(made, own_steering=own)
