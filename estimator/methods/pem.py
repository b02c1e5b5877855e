"""Prediction error minimisation over windows of driving: all six parameters by maximum likelihood.

A window is driving with steering, up to 30 s (record/windows.py). When it is complete, a fit is requested
(`request_fit`). It is computed elsewhere (`fit`, a pure function) and adopted `latency_ns` of the log's time
later, or when it is ready if that is later still; the next window waits for it. The posterior of one window,
drifted over the distance since then, is the prior of the next. So each window enters once, with its full
likelihood.

A number stays until drift over distance has made it too uncertain, however long ago the last window was:
along a row there is nothing to learn, and nothing to contradict what the last headland told. It is stale
after STALE_S without sound data, since something may have changed that nobody measured, until a window is
fitted.
"""

import math
from dataclasses import dataclass, field, replace
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.filters import fit_covariance, scoring, soil_change, unknowns
from tilth.estimator.filters.contrast import Contrast, joined
from tilth.estimator.filters.drift import retained_share
from tilth.estimator.filters.rig_setup import RigSetup, rig_setup
from tilth.estimator.filters.soil_change import SOIL_CHANGE
from tilth.estimator.filters.soil_field import Told, told
from tilth.estimator.filters.soil_within import for_patches
from tilth.estimator.filters.unknowns import AT, NAMES, NOISE, SIX
from tilth.estimator.methods import fitted
from tilth.estimator.methods.fitted import FittedState
from tilth.estimator.models.load import by_another_load
from tilth.estimator.record.record import Record, Segment, U
from tilth.estimator.record.windows import close_window, collect
from tilth.estimator.results import advice, method_state
from tilth.estimator.results.advice import Advisor
from tilth.estimator.results.reporting import REPORTING, six_parameter_estimate
from tilth.estimator.tuning import tuned
from tilth.schemas.flow import PARAMETERS, Estimate, EventKind, Pose
from tilth.schemas.machine import Machine
from tilth.schemas.notices import Notice, NoticeCode, notice
from tilth.schemas.reasons import Code
from tilth.schemas.spread import interval

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PemTuning:
    """When a window is fitted, and what contradicts what was learned."""

    known_factor_sd: float = tuned(0.25, "1", "of a logarithm: a change known worse is not told as a factor")
    latency_ns: int = tuned(3_000_000_000, "ns", "after a window closes, at which its fit is adopted")
    least_steering: float = tuned(math.radians(1.0), "rad", "least sd of the wheel angle in a window")
    """With less steering the apparent information comes from the ground's forces, whose spectrum the model
    does not have: intervals from automatically steered rows held the true value in 85 % of runs."""
    noise_sd: float = tuned(0.4, "1", "prior sd of noise levels in each window: ground, satellites change")
    change_chi_square: float = tuned(33.1, "chi^2", "of six, 1e-5: the window contradicts what was learned")
    suspect_chi_square: float = tuned(16.8, "chi^2", "1e-2: a fit with the six of the file is tried beside")
    change_ratio: float = tuned(100.0, "chi^2", "twice the nats that such a fit explains more at a change")
    """Other unknowns, the tyres' curve above all, give way before the six do: of twice the stiffness, known
    to 3 %, chi-square was 31 to 44, this 440 to 680."""
    least_share: float = tuned(0.25, "1", "of the prior variance, that a window removes along any direction")
    """In the test for a contradiction. If it removed next to nothing, the search's residual error alone would
    look like a contradiction."""


PEM: Final = PemTuning()

METHOD = "pem"
OF_MASSES = ((AT["C_af"], AT["C_ar"]), (AT["C_ai"],))
"""Stiffnesses that are learned over each of unknowns.MASSES."""


@dataclass(frozen=True, slots=True)
class Job:
    """A fit to compute. With the machine file it is all that `fit` needs."""

    asked_ns: int  # t_ns of the frame at which it was requested
    closed_ns: int  # instant of its last tick
    record: Record
    mean: Array
    covariance: Array
    contrast: Contrast = field(default_factory=Contrast)  # of the windows before


@dataclass(frozen=True, slots=True)
class Fit:
    """The result of a job."""

    mean: Array  # [n] of unknowns.NAMES
    covariance: Array  # [n, n]
    told: Told | None  # what the window alone tells of the six
    gain: float  # nats by which the posterior before explains the window better than the machine file does
    whiteness: float
    cost: float
    iterations: int
    rows: int
    changed: bool  # the window contradicted what was known
    tie: bool  # as fitted.Fit
    refused: Code | None  # why it must not be used
    contrast: Contrast = field(default_factory=Contrast)  # of the windows so far, with this one if it is used


@dataclass(slots=True)
class PemState(FittedState):
    """`distance` is since the last window. What errors of the model leave is in `covariance`, too, but for
    the excess of `last.contrast`."""

    window: list[Segment] = field(default_factory=list)
    closed: Record | None = None  # a complete window whose fit is not requested yet
    soon: bool = False  # whether the load may have changed since the last window: the next one is awaited
    job: Job | None = None  # requested, not adopted yet
    last: Fit | None = None
    advisor: Advisor = field(default_factory=Advisor)


def initial(machine: Machine) -> PemState:
    """The state before any data, at the priors of the machine file."""
    mean, sd = unknowns.prior(machine)
    return PemState(mean.copy(), np.diag(sd**2), mean, sd)


def take(state: PemState, machine: Machine, pose: Pose, segment: Segment | None) -> Estimate | None:
    """Take one segment; an estimate each REPORTING.publish_ns."""
    fitted.drive_on(state, pose, segment)
    zero, before = _wheel_zero(state), state.closed
    due = collect(state, pose.t_ns, segment, REPORTING.publish_ns, PEM.least_steering, zero, state.soon)
    state.soon &= state.closed is before
    if not due:
        return None
    if state.fits:
        speed = abs(pose.tractor.forward_velocity or 0.0)
        _advise(state, machine, speed, pose.t_ns)
    return estimate(state, machine, pose.t_ns)


def _advise(state: PemState, machine: Machine, speed: float, t_ns: int) -> None:
    kept = state.model_sd
    advice.renew(state.advisor, machine, state.mean, state.covariance, speed, t_ns, kept=kept)


def finish(state: PemState) -> None:
    """No more driving follows: close the present window, as a gap would."""
    close_window(state, PEM.least_steering, _wheel_zero(state))


def stood(state: PemState) -> None:
    """As of estimators.Estimator: the present window ends."""
    state.stops += 1
    finish(state)


def _wheel_zero(state: PemState) -> float:
    return float(state.mean[AT["wheel_zero"]])


def request_fit(state: PemState, t_ns: int) -> Job | None:
    """The fit to request at the frame of t_ns: of a complete window, if no other fit is pending; else
    None."""
    if state.closed is None or state.job is not None:
        return None
    record, state.closed = state.closed, None
    share = retained_share(state.distance)
    state.model_sd = state.model_sd * share
    state.covariance, state.distance = drifted(state), 0.0
    covariance = state.covariance.copy()
    covariance[SIX, SIX] -= np.diag(_errors_in_common(state, record, state.mean) ** 2)
    # Noise levels start again.
    covariance[NOISE, :] = 0.0
    covariance[:, NOISE] = 0.0
    noise_sd = np.full(NOISE.stop - NOISE.start, PEM.noise_sd) if state.fits else state.prior_sd[NOISE]
    covariance[NOISE, NOISE] = np.diag(noise_sd**2)
    contrast = state.last.contrast.faded(share**2) if state.last else Contrast()
    state.job = Job(t_ns, record.end_ns, record, state.mean.copy(), covariance, contrast)
    return state.job


def _errors_in_common(state: PemState, record: Record, point: Array) -> Array:
    """Sds of the six, (6,), from errors of the model that are the same in what was learned before and in a
    window: no reason to give the window more weight. point: (n,), as `fit_covariance.model_sd_of`."""
    return np.minimum(state.model_sd, fit_covariance.model_sd_of(record, point))


def drifted(state: PemState) -> Array:
    """The covariance, (n, n), after the distance since the last window."""
    return method_state.drifted(state, state.covariance, state.distance)


def excess(state: PemState) -> Array:
    """Sds of the six, (6,), from what is wrong with the model of the ground: filters/contrast.py. It widens
    what is published; the next window is fitted as if there were none."""
    return state.last.contrast.excess if state.last else np.zeros(6)


def fit(machine: Machine, job: Job) -> Fit:
    """The result of a job, a pure function of its arguments."""
    setup = rig_setup(machine)
    prior_mean, prior_sd = unknowns.prior(machine)
    mean, covariance = job.mean, job.covariance
    found = _posterior(job.record, setup, mean, covariance, prior_mean)
    change = found.mean[SIX] - mean[SIX]
    chi_square, changed, tie = 0.0, False, False
    if np.all(np.isfinite(found.covariance)):
        errors = fit_covariance.model_sd_of(job.record, found.mean)
        after = found.covariance[SIX, SIX] - np.diag(errors**2)
        chi_square = contradiction(change, covariance[SIX, SIX], after, errors)
        tie = fitted.is_tie((chi_square, PEM.suspect_chi_square))
    if chi_square > PEM.suspect_chi_square:
        other = of_other_tyres(mean, covariance, prior_mean, prior_sd)
        anew = _posterior(job.record, setup, *other)
        ratio = 2.0 * (found.cost - anew.cost) * found.rows
        changed = chi_square > PEM.change_chi_square or ratio > PEM.change_ratio
        tie |= chi_square <= PEM.change_chi_square and fitted.is_tie((ratio, PEM.change_ratio))
        tie |= ratio <= PEM.change_ratio and fitted.is_tie((chi_square, PEM.change_chi_square))
        if changed:
            found, (mean, covariance) = scoring.with_gain(anew, found.gain), other
    refused = refusal(found, prior_mean, prior_sd) or (Code.TWO_PLACES if found.two_places else None)
    alone, contrast, prior = None, job.contrast, (prior_mean, prior_sd)
    if refused is None and found.contrast is not None:
        contrast = joined(
            Contrast() if changed else contrast, found.contrast, prior, (found.mean, found.covariance)
        )
        alone = _told(job.record, mean, covariance, found, prior, contrast.excess)
    return Fit(
        found.mean, found.covariance, alone, found.gain, found.whiteness, found.cost,
        found.iterations, found.rows, changed, tie, refused, contrast,
    )  # fmt: skip


def _told(
    record: Record,
    mean: Array,
    covariance: Array,
    found: scoring.Posterior,
    prior: tuple[Array, Array],
    excess: Array,
) -> Told:
    """What a window alone tells. mean, covariance: before it, (n,) and (n, n). prior: as of unknowns.prior.
    excess: (6,).

    Its information is as much less than the likelihood's as the published sds are wider than those by it: for
    coloured noise and the ground, and without errors of the model, which windows have in common.
    """
    errors, known = fit_covariance.model_sd_of(record, found.mean), with_known_masses(covariance)
    active = np.flatnonzero(np.diag(known) > 0.0)
    at = np.ix_(active, active)
    by_noise = np.diag(np.linalg.inv(np.linalg.inv(known[at]) + found.information[at]))[active < 6]
    six = active[active < 6]
    published = np.diag(found.covariance - of_masses(covariance))[six] - errors[six] ** 2
    wider = np.ones(6)
    wider[six] = np.sqrt(np.maximum(published / by_noise, 1.0))
    whole = told(
        mean, known, found.likeliest, found.information, prior, wider, np.hypot(errors, excess), of_file=True
    )
    if found.pieces is None:
        return whole
    return replace(whole, patches=for_patches(found.pieces, wider, prior[1]))


def _posterior(
    record: Record, setup: RigSetup, mean: Array, covariance: Array, reference: Array | None = None
) -> scoring.Posterior:
    """As scoring.maximise_posterior, with the masses of the file: they are considered (unknowns.MASSES).

    A stiffness is as uncertain as the mass that it is learned over, and errs with it.
    """
    known = with_known_masses(covariance)
    found = scoring.maximise_posterior(record, setup, mean, known, reference, contrast=True)
    return replace(found, covariance=found.covariance + of_masses(covariance))


def with_known_masses(covariance: Array) -> Array:
    """A covariance, (n, n), of all else where the masses are as the file says."""
    known = covariance.copy()
    for mass in unknowns.MASSES:
        if known[mass, mass] > 0.0:
            known -= np.outer(known[:, mass], known[mass]) / known[mass, mass]
        known[mass, :] = known[:, mass] = 0.0
    return known


def of_masses(covariance: Array) -> Array:
    """What the uncertainty of the masses adds to a covariance, (n, n), in which they were taken as known.

    covariance: (n, n), of which the variances of the masses are used.
    """
    added = np.zeros_like(covariance)
    for mass, stiffnesses in zip(unknowns.MASSES, OF_MASSES, strict=True):
        effect = np.zeros(len(NAMES))
        effect[[mass, *stiffnesses]] = 1.0
        added += covariance[mass, mass] * np.outer(effect, effect)
    return added


def contradiction(change: Array, before: Array, after: Array, model_sd: Array) -> float:
    """Chi-square, 6 degrees of freedom, of a window's change of the six.

    The covariance of the change is before - after, and the part that a window has in it of what the model has
    wrong, in the window and in what was learned before. Along directions in which that is less than
    `least_share` of the variance before, this share is used.
    change: (6,). before, after: covariances, (6, 6), without errors of the model. model_sd: (6,), these.
    """
    root = np.linalg.inv(np.linalg.cholesky(before))
    taken = np.eye(len(change)) - root @ after @ root.T
    wrong = taken @ root * model_sd
    variances, directions = np.linalg.eigh(taken + 2.0 * wrong @ wrong.T)
    return float(np.sum((directions.T @ root @ change) ** 2 / np.maximum(variances, PEM.least_share)))


def of_other_tyres(mean: Array, covariance: Array, prior_mean: Array, prior_sd: Array) -> tuple[Array, Array]:
    """What was learned, (n,) and (n, n), without what was learned of the six."""
    covariance = covariance.copy()
    covariance[SIX, :] = covariance[:, SIX] = 0.0
    covariance[SIX, SIX] = np.diag(prior_sd[SIX] ** 2)
    return np.concatenate([prior_mean[SIX], mean[6:]]), covariance


def rehearse(machine: Machine) -> None:
    """A fit of two seconds of straight driving, which compiles all that a fit needs."""
    mean, sd = unknowns.prior(machine)
    ticks = np.tile([0.0, 4.0, *[0.0] * 6], (100, 1))
    rows = np.array([[k, 0.0, 0.0, k % 2, 0.0, 0.01] for k in range(100)], dtype=np.float64)
    fit(machine, Job(0, 0, Record(0, ticks, rows), mean, np.diag(sd**2)))


class Found(Protocol):
    """What a fit ends with."""

    @property
    def mean(self) -> Array: ...
    @property
    def covariance(self) -> Array: ...
    @property
    def converged(self) -> bool: ...


def refusal(found: Found, prior_mean: Array, prior_sd: Array) -> Code | None:
    """Why a fit must not be used."""
    if not (np.all(np.isfinite(found.mean)) and np.all(np.isfinite(found.covariance))):
        return Code.RESULT_NOT_FINITE
    if not found.converged:
        return Code.NOT_CONVERGED
    if np.any(np.abs(found.mean - prior_mean)[SIX] > REPORTING.largest_deviation * prior_sd[SIX]):
        return Code.BEYOND_TYRES
    return None


def adopt(state: PemState, machine: Machine, made: Fit | None, t_ns: int) -> Estimate:
    """Adopt the result of the pending job; made: None if there is none. Returns the estimate after it."""
    job, state.job = state.job, None
    made = made if job else None
    used, state.last = fitted.is_used(state, made), made or state.last
    if job is None or made is None or not used:
        return estimate(state, machine, t_ns)
    loaded = _another_load(machine, job, made)
    if loaded is not None:
        state.events.append((EventKind.LOAD, notice(loaded)))
    if made.changed:
        state.changes += 1
        state.window_s = 0.0
        if loaded is None:
            state.events.append((EventKind.SOIL_CHANGE, _soil_changed(job, made)))
    state.model_sd, state.covariance = _learned_with(state, job, made)
    state.mean = made.mean
    state.informed_ns = job.closed_ns
    state.window_s += len(job.record.ticks) * 0.02
    state.fits += 1
    speed, state.advisor.renewed_ns = float(np.mean(job.record.ticks[:, U])), 0  # what it said is past
    _advise(state, machine, speed, t_ns)
    return estimate(state, machine, t_ns)


def _learned_with(state: PemState, job: Job, made: Fit) -> tuple[Array, Array]:
    """(model_sd, covariance) after a fit. Errors of the model are as `fit_covariance.mixed` says."""
    errors = fit_covariance.model_sd_of(job.record, made.mean)
    masses = np.diag(of_masses(job.covariance))[SIX]
    before, after = (np.diag(covariance)[SIX] - masses for covariance in (job.covariance, made.covariance))
    kept = errors if made.changed else _errors_in_common(state, job.record, job.mean)
    model_sd = fit_covariance.mixed(kept, errors, before, after - errors**2)
    covariance = made.covariance.copy()
    covariance[SIX, SIX] += np.diag(np.where(before > 0.0, model_sd**2 - errors**2, 0.0))
    return model_sd, covariance


def _another_load(machine: Machine, job: Job, made: Fit) -> NoticeCode | None:
    """Whether a window shows another load of the implement; None: no, or it is the soil."""
    if machine.implement.load is None:
        return None
    masses = of_masses(job.covariance)
    before, after = (c[SIX, SIX] for c in (with_known_masses(job.covariance), made.covariance - masses))
    errors = fit_covariance.model_sd_of(job.record, made.mean)
    after = after - np.diag(errors**2)
    if made.changed:  # the window alone, from the prior
        after, besides = np.zeros((6, 6)), after
    else:
        besides = np.zeros((6, 6))
    found = soil_change.odds(
        (job.mean[SIX], before), (made.mean[SIX], after), by_another_load(machine),
        besides + np.diag(2.0 * errors**2),
    )  # fmt: skip
    if found.of_load < -SOIL_CHANGE.sure or not (made.changed or found.load > SOIL_CHANGE.loaded):
        return None
    return NoticeCode.LOAD_CHANGED if found.of_load > SOIL_CHANGE.sure else NoticeCode.LOAD_OR_SOIL


def _soil_changed(job: Job, made: Fit) -> Notice:
    variances = np.diag(made.covariance)[SIX] + np.diag(job.covariance)[SIX]
    return soil_changed(made.mean[SIX] - job.mean[SIX], np.sqrt(variances))


def soil_changed(logs: Array, sds: Array) -> Notice:
    """The factors by which the six have changed, of those that are known, with their intervals; (6,) each."""
    factors = [
        notice(NoticeCode.FACTOR, parameter=name, low=low, high=high)
        for name, log, sd in zip(PARAMETERS, logs.tolist(), sds.tolist(), strict=True)
        if sd < PEM.known_factor_sd
        for low, high in [interval(math.exp(log), sd)]
    ]
    return notice(NoticeCode.SOIL_CHANGED, *factors)


def clock_stepped(state: PemState, by_ns: int) -> None:
    """The log's clock stepped back: discard the window and the pending fit, keep the posterior and its
    age."""
    state.window.clear()
    state.closed = state.job = None
    fitted.clock_stepped(state, by_ns)


def estimate(state: PemState, machine: Machine, t_ns: int) -> Estimate:
    """The estimate at t_ns."""
    last = state.last
    own = {"held_out_gain": last.gain if last else 0.0, "whiteness": last.whiteness if last else 0.0}
    covariance = drifted(state)[SIX, SIX] + np.diag(excess(state) ** 2)
    return six_parameter_estimate(
        state, machine, t_ns, METHOD, covariance, Code.NOTHING_FITTED,
        fitted.excitation(state, own, last, last.iterations if last else 0), state.advisor.advice,
        fitted.stale(state, t_ns),
    )  # fmt: skip


assert NAMES[:6] == PARAMETERS
