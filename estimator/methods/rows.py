"""Straight rows under automatic steering: the six parameters by what the steering does of its own.

Rows are collected into blocks of up to ten minutes (record/straight_rows.py). A block is fitted after two
minutes, after five and when it is full, always as a whole from the posterior of the block before, drifted
over the distance since (filters/row_fit.py). A second informs once. The fit is computed elsewhere (`fit`, a
pure function) and adopted as one of pem is.

Steering that only answers the ground tells nothing reliable: as long as its own share of the wheel angle is
small, a block is not used, and the estimate says so with the share.
"""

from dataclasses import dataclass, field, replace
from typing import Annotated, Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.filters import row_fit, unknowns
from tilth.estimator.filters.drift import drift, retained_share
from tilth.estimator.filters.rig_setup import rig_setup
from tilth.estimator.filters.unknowns import AT, SIX, Matrix, Vector
from tilth.estimator.methods import pem
from tilth.estimator.record import straight_rows
from tilth.estimator.record.record import Record, Segment
from tilth.estimator.record.record_builder import WAYS_OF_DRIVING
from tilth.estimator.record.straight_rows import Block
from tilth.estimator.record.windows import OPEN, late_reason
from tilth.estimator.results.reporting import REPORTING, age_s, six_parameter_estimate, stale_reason
from tilth.estimator.state_json import Shape
from tilth.estimator.tuning import tuned
from tilth.schemas.flow import Estimate, EventKind, OwnSteering, Pose
from tilth.schemas.machine import Machine
from tilth.schemas.notices import Notice, reasoned
from tilth.schemas.reasons import Code, Reason

Array = NDArray[np.float64]

METHOD: Final = "rows"
ROLL_STIFFNESSES: Final = [AT["roll_k_t"], AT["roll_k_i"]]


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
    """In rows bodies sway by hundredths of a degree, where axles stick and tyres are stiffer. A rig that did not
    sway at all, which 22 % exclude, moved C_ar by 39 % in ten minutes; with this 2 %, at the same sds."""
    change_chi_square: float = tuned(33.1, "chi^2", "of six, 1e-5: the block contradicts what was learned")


TUNING: Final = RowsTuning()


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
    refused: Code | None  # why it must not be used


@dataclass(slots=True)
class RowsState:
    """Arrays in the order of unknowns.NAMES; times ns, distances m."""

    mean: Vector
    covariance: Matrix
    prior_mean: Vector
    prior_sd: Vector
    before_mean: Vector  # the same before the present block
    before_covariance: Matrix
    before_m: float = 0.0  # distance since the block before
    before_s: float = 0.0  # window_s before the present block
    model_sd: Annotated[Array, Shape((6,))] = field(default_factory=lambda: np.full(6, TUNING.model_sd))
    block: Block = field(default_factory=Block)
    job: Job | None = None  # requested, not adopted yet
    decided: int = OPEN  # state of the job: see windows.OPEN
    late_ns: int = 0  # by how much the last decided fit was late
    distance: float = 0.0  # m, since the last fit
    last_pose_ns: int = 0
    informed_ns: int = 0
    sound_ns: int = 0  # until when data have been sound, without a silence of STALE_S since the last fit
    published_ns: int = 0
    window_s: float = 0.0
    fits: int = 0
    late: int = 0
    changes: int = 0
    refused: dict[Code, int] = field(default_factory=dict)  # reason -> fits
    has_number: list[bool] = field(default_factory=lambda: [False] * 6)
    last: Fit | None = None
    reason: Code | None = None
    events: list[tuple[str, Notice]] = field(default_factory=list)  # with kinds, not taken yet


def prior(machine: Machine) -> tuple[Array, Array]:
    """(mean, sd), (n,), of unknowns.NAMES by the machine file, with the bodies' roll stiffnesses wider."""
    mean, sd = unknowns.prior(machine)
    sd = sd.copy()
    sd[ROLL_STIFFNESSES] = np.maximum(sd[ROLL_STIFFNESSES], TUNING.roll_sd)
    return mean, sd


def initial(machine: Machine) -> RowsState:
    """The state before any data, at the priors of the machine file."""
    mean, sd = prior(machine)
    return RowsState(mean.copy(), np.diag(sd**2), mean, sd, mean.copy(), np.diag(sd**2))


def take(state: RowsState, machine: Machine, pose: Pose, segment: Segment | None) -> Estimate | None:
    """Take one segment; an estimate each REPORTING.publish_ns."""
    seconds = (pose.t_ns - state.last_pose_ns) * 1e-9 if state.last_pose_ns else 0.0
    state.last_pose_ns = pose.t_ns
    driven = min(seconds, 3600.0) * abs(pose.tractor.forward_velocity or 0.0)
    state.distance += driven
    state.before_m += driven
    if segment is not None and segment.reason in WAYS_OF_DRIVING and _stale(state, pose.t_ns) is None:
        state.sound_ns = pose.t_ns
    straight_rows.observe(state.block, segment)
    refused = state.last.refused if state.last else None
    state.reason = state.block.reason or refused
    if pose.t_ns - state.published_ns < REPORTING.publish_ns:
        return None
    state.published_ns = pose.t_ns
    return estimate(state, machine, pose.t_ns)


def finish(state: RowsState) -> None:
    """No more driving follows: what of a block is not fitted yet stays so."""
    straight_rows.end_row(state.block)


def request_fit(state: RowsState, t_ns: int) -> Job | None:
    """The fit to request at the frame of t_ns: of a block that is long enough, if no other is pending."""
    if state.job is not None or not straight_rows.is_due(state.block):
        return None
    records, full = straight_rows.rows_to_fit(state.block)
    covariance = _drifted(state, state.before_covariance, state.before_m)
    state.job = Job(t_ns, records[-1].end_ns, records, full, state.before_mean.copy(), covariance)
    return state.job


def _drifted(state: RowsState, covariance: Array, metres: float) -> Array:
    """A covariance, (n, n), so many metres later."""
    covariance = covariance.copy()
    drift(covariance, np.arange(6), retained_share(metres), state.prior_sd)
    return covariance


def fit(machine: Machine, job: Job) -> Fit:
    """The result of a job, a pure function of its arguments."""
    prior_mean, prior_sd = unknowns.prior(machine)
    found, changed = _posterior(machine, job, job.mean, job.covariance), False
    if found is None:
        return Fit(
            job.mean, job.covariance, 0.0, 0.0, 0.0, 0, 0.0, False, Code.OUTPUTS_NOT_MEASURED
        )  # fmt: skip
    before, after = job.covariance[SIX, SIX], found.covariance[SIX, SIX]
    if pem.contradiction((found.mean - job.mean)[SIX], before, after, np.full(6, TUNING.model_sd)) > (
        TUNING.change_chi_square
    ):
        mean, covariance = pem.of_other_tyres(job.mean, job.covariance, prior_mean, prior_sd)
        changed = True
        found = _posterior(machine, job, mean, covariance) or found
    own = float(found.wheel_rms * np.sqrt(found.own_share))
    little = own < TUNING.least_rms or found.own_share < TUNING.least_share
    refused = Code.LITTLE_OWN_STEERING if little else pem.refusal(found, prior_mean, prior_sd)
    return Fit(
        found.mean, found.covariance, found.own_share, own, found.seconds, found.steps, found.cost, changed,
        refused,
    )  # fmt: skip


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
    job, state.job, state.decided = state.job, None, OPEN
    if made is None or job is None or state.late_ns:
        state.late += 1
        used = made is not None and job is not None
        state.events.append((EventKind.FIT, reasoned(late_reason(state.late_ns, used))))
    if made is not None and job is not None:
        _use(state, job, made)
    if job is not None and job.full:  # also where its last fit failed: an earlier one of it counts
        _begin_block(state)
    return estimate(state, machine, t_ns)


def _use(state: RowsState, job: Job, made: Fit) -> None:
    state.last = made
    if made.refused:
        state.refused[made.refused] = state.refused.get(made.refused, 0) + 1
        state.events.append((EventKind.FIT, reasoned(Reason(made.refused))))
        return
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
    state.job, state.decided = None, OPEN
    state.last_pose_ns = state.published_ns = 0
    state.informed_ns += by_ns if state.informed_ns else 0
    state.sound_ns += by_ns if state.sound_ns else 0


def _stale(state: RowsState, t_ns: int) -> Reason | None:
    """Why numbers are stale."""
    return stale_reason(Code.NO_SOUND_DATA_FOR, age_s(max(state.informed_ns, state.sound_ns), t_ns))


def published_covariance(state: RowsState) -> Array:
    """Of the six, (6, 6), now, with errors of the model."""
    return _drifted(state, state.covariance, state.distance)[SIX, SIX] + np.diag(state.model_sd**2)


def learned_covariance(state: RowsState) -> Array:
    """(n, n), now, without errors of the model."""
    return _drifted(state, state.covariance, state.distance)


def estimate(state: RowsState, machine: Machine, t_ns: int) -> Estimate:
    """The estimate at t_ns."""
    last = state.last
    excitation = {
        "fits": float(state.fits),
        "late": float(state.late),
        "soil_changes": float(state.changes),
        "rows_s": straight_rows.seconds(state.block),
        "cost": last.cost if last else 0.0,
        "iterations": float(last.steps) if last else 0.0,
    }
    if state.late_ns:
        excitation["late_s"] = state.late_ns * 1e-9
    made = six_parameter_estimate(
        state, machine, t_ns, METHOD, published_covariance(state), Code.NO_ROWS_YET, excitation, None,
        _stale(state, t_ns),
    )  # fmt: skip
    own = OwnSteering(last.own_share, last.own_rms, last.seconds) if last else None
    return replace(made, own_steering=own)
