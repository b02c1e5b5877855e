"""Maximum a posteriori of the unknowns over one record: Fisher scoring with a safe step.

Minimised: 1/2 sum(e^2/S + log S) over the record's prediction errors (predictor.py), plus the prior's
1/2 (p - p0)' P0^-1 (p - p0). Slopes of e and S are differences of whole filter runs, so that the gradient is
the exact likelihood's, with what the gains contribute. Information: sum(de de'/S + 1/2 dS dS'/S^2).
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator import unknowns
from tilth.estimator.models.parameters import Rig, rig_of
from tilth.estimator.predictor import DT, FOLLOW, FULL, KEEP, N_STATES, PLACED, innovations
from tilth.estimator.record import EAST, NORTH, Record
from tilth.estimator.unknowns import AT, NAMES, NOISES
from tilth.schemas.flow import PARAMETERS
from tilth.schemas.machine import Machine

Array = NDArray[np.float64]

SLOW_SHARE: Final = 0.3  # of a position's sd that is slow and each receiver's own
STEPS: Final = 1e-3  # of the differences, in prior sds, at most STEP_LIMIT
STEP_LIMIT: Final = 1e-4
MOST_ITERATIONS: Final = 25
CLOSE: Final = 0.03  # of a posterior sd: a step this small ends the search
SLACK: Final = 0.2  # nats that a step may cost: slopes of what follows others' gains are not exact
ROUGH: Final = 1.5
"""Of a disturbance's logarithm that is not known to one: a search that begins with rough ground finds no
false bottom."""
_RESTLESS: Final = slice(AT["push_t"], AT["push_yaw"] + 1)
_SIX: Final = np.arange(6)
FLAT: Final = 0.05  # nats
SETTLED: Final = 0.1  # of a posterior sd of the six
NEAR: Final = 0.3  # of a posterior sd: where a search that can go no further has arrived
OUTLIER: Final = 5.0  # sds: such a row is left out, from the third iteration on
LONGEST_STEP: Final = 0.7  # of a logarithm in one iteration
_GAINS: Final = frozenset({*PARAMETERS, *NOISES})
"""What moves the filter's gains and so the variances. All else moves them little or not at all."""
TRUST: Final = (0.03, 0.3)
"""How far any of the six logarithms and any noise level may move before the slopes are taken again, which is
nine tenths of a fit's cost."""
COLOUR: Final = 1.0
"""By how much of the innovations' autocorrelation the sds of the six grow: what is left of a ground that is
no Gauss-Markov process and of slow errors of receivers. From Monte Carlo; nothing where they are white."""
MODEL_SD: Final = 0.03
"""Of the six logarithms with `planar`: tyre curve and load transfer are another rig's than the file's. On
soil of grip 0.7 that is what is left after 30 s of strong steering; more data do not make it less."""
BIN_S: Final = 0.1
LAGS: Final = 12  # bins over which scores may be correlated: waves of the ground, slow errors of receivers


@dataclass(frozen=True, slots=True)
class Rigging:
    """What a machine file says that a fit needs. Shapes as in predictor.filtered."""

    geometry: Array
    levers: Array
    middles: Array
    sds: Array
    rig: Rig
    planar: bool = True


def rigging(machine: Machine, planar: bool = True) -> Rigging:
    """planar: False for the relaxation model alone, without what the nonlinear model has beyond it."""
    rates = [r.position_sd for r in machine.receiver]
    middles = unknowns.pair_middles(machine)
    places = unknowns.levers(machine)
    sds = [np.radians(machine.wheel_angle.sd) / np.sqrt(2.0)]
    for body in range(2):
        length = float(np.hypot(*(places[2 * body] - places[2 * body + 1])))
        sds.append(SLOW_SHARE * np.sqrt(2.0) * float(np.mean(rates)) / length if length > 0.1 else 0.0)
    return Rigging(unknowns.base_geometry(machine), places, middles, np.array(sds), rig_of(machine), planar)


@dataclass(frozen=True, slots=True)
class Found:
    """What a record says with a prior."""

    mean: Array  # [n] of unknowns.NAMES
    covariance: Array  # [n, n]
    information: Array  # [n, n] of the record alone
    cost: float  # minimised, per row
    gain: float  # log-likelihood of the record at the prior's mean over that at `reference`, nats
    iterations: int
    rows: int
    outliers: int
    whiteness: float  # autocorrelation of the normalised innovations at one step, mean over the kinds
    converged: bool


@dataclass(slots=True)
class Search:
    """A record with a prior, and the rows that are used of it."""

    record: Record
    rigging: Rigging
    start: Array
    used: Array
    prior_mean: Array
    prior_information: Array  # of the active ones
    active: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Slopes:
    """Prediction errors at a point, shape (m,), and their slopes over the active unknowns, shape (a, m), at
    one nearby."""

    e: Array
    s: Array
    de: Array
    ds: Array
    taken: Array  # [n], the point of the slopes


def first_state(record: Record, rigging: Rigging) -> Array:
    """Where the filter starts, shape (15,): headings and yaw rates of the first tick, the first position."""
    x = np.zeros(N_STATES)
    first = record.ticks[0]
    x[6:8], x[1:3] = first[2:4], first[4:6]
    heading_t, heading_i = (np.array([np.cos(psi), np.sin(psi)]) for psi in first[2:4])
    for kind, column in ((NORTH, 0), (EAST, 1)):
        found = record.rows[record.rows[:, 2] == kind]
        if len(found):
            place = int(found[0, 3])
            ahead = rigging.levers[place, 0]
            arm = ahead * heading_t
            if place >= 2:
                arm = -rigging.geometry[2] * heading_t + (ahead - rigging.geometry[3]) * heading_i
            x[PLACED + column] = found[0, 4] - arm[column]
    return x


def errors(search: Search, points: Array, modes: Array) -> tuple[Array, Array]:
    """(e, S), each shape (q, m), at points, shape (q, n)."""
    geometries = np.array([unknowns.geometry(search.rigging.geometry, p) for p in points])
    thetas = np.exp(points[:, unknowns.SIX])
    shape = (len(points), len(search.record.rows))
    e, s = np.zeros(shape), np.ones(shape)
    told = search.rigging
    innovations(
        search.record.ticks, search.record.rows, search.used, search.start, points, thetas, geometries, modes,
        told.rig, told.levers, told.middles, told.sds, told.planar, e, s,
    )  # fmt: skip
    return e, s


def _cost(search: Search, point: Array, e: Array, s: Array) -> float:
    off = (point - search.prior_mean)[search.active]
    with np.errstate(all="ignore"):  # a step too far is no number, and is not taken
        fit = 0.5 * np.sum(e * e / s + np.log(s))
        return float(fit + 0.5 * off @ search.prior_information @ off)


def search_of(record: Record, rigging: Rigging, mean: Array, covariance: Array) -> Search:
    """What a fit starts from; arguments as of `find`."""
    active = np.flatnonzero(np.diag(covariance) > 0.0)
    sound = np.all(np.isfinite(record.rows), axis=1)
    prior = _inverse(covariance[np.ix_(active, active)])
    return Search(
        record, rigging, first_state(record, rigging), sound.astype(np.float64), mean, prior, active
    )


def find(
    record: Record, rigging: Rigging, mean: Array, covariance: Array, reference: Array | None = None
) -> Found:
    """The fit. mean, covariance: the prior over unknowns.NAMES; zero variance holds one fixed.

    reference: a point to compare the prior's mean with on this record, which neither has seen.
    """
    search = search_of(record, rigging, mean, covariance)
    active = search.active
    point, gained = mean.copy(), 0.0
    point[_RESTLESS] += np.where(np.diag(covariance)[_RESTLESS] > 1.0, ROUGH, 0.0)
    if reference is not None:
        e, s = errors(search, np.array([mean, reference]), np.array([FULL, FULL], dtype=float))
        gained = float(0.5 * np.sum(e[1] ** 2 / s[1] + np.log(s[1]) - e[0] ** 2 / s[0] - np.log(s[0])))
    damping, converged, done = 1e-3, False, 0
    slopes = _slopes(search, point, None)
    cost = _cost(search, point, slopes.e, slopes.s)
    for done in range(1, MOST_ITERATIONS + 1):
        gradient, information = _scores(search, point, slopes)
        step, tried, found = _step(search, point, gradient, information, damping, cost)
        if found is None:
            break
        damping = max(damping * 0.2, 1e-6) if tried == 1 else damping * 4.0 ** (tried - 1)
        point = point.copy()
        point[active] += step
        close = bool(np.max(np.abs(step) / _sds(information)) < CLOSE)
        if done == 2:
            _leave_out(search, point)
        before = cost
        slopes = _slopes(search, point, slopes)
        cost = _cost(search, point, slopes.e, slopes.s)
        six = np.abs(step / _sds(information))[active < 6]
        # A noise level may go to and fro where nothing depends on it.
        settled = abs(cost - before) < FLAT and bool(np.max(six, initial=0.0) < SETTLED)
        if done > 2 and (close or settled):
            converged = True
            break
    gradient, information = _scores(search, point, slopes)
    left = np.abs(np.linalg.solve(information, gradient)) / _sds(information)
    converged = converged or bool(np.max(left[active < 6], initial=0.0) < NEAR)
    whole = np.zeros((len(NAMES), len(NAMES)))
    whole[np.ix_(active, active)] = _honest(search, _inverse(information), slopes)
    colour = whiteness(record.rows, search.used, slopes.e, slopes.s)
    wider = np.ones(len(NAMES))
    wider[unknowns.SIX] = 1.0 + COLOUR * max(colour, 0.0)
    whole *= np.outer(wider, wider)
    if rigging.planar:
        whole[_SIX, _SIX] += MODEL_SD**2 * (np.diag(covariance)[_SIX] > 0.0)
    own = np.zeros_like(whole)
    own[np.ix_(active, active)] = information - search.prior_information
    return Found(
        point, (whole + whole.T) / 2, own, cost / max(len(record.rows), 1), gained, done, len(record.rows),
        int(np.sum(search.used == 0.0)), colour, converged,
    )  # fmt: skip


def _slopes(search: Search, point: Array, before: Slopes | None) -> Slopes:
    """At the point. before: slopes of another, which serve as far as TRUST says."""
    if before is not None:
        moved = np.abs(point - before.taken)
        if np.max(moved[unknowns.SIX]) < TRUST[0] and np.max(moved[unknowns.NOISE]) < TRUST[1]:
            e, s = errors(search, point[None], np.array([FULL], dtype=float))
            return replace(before, e=e[0], s=s[0])
    nudges = np.minimum(STEPS * np.sqrt(1.0 / np.diag(search.prior_information)), STEP_LIMIT)
    points = np.tile(point, (len(nudges) + 1, 1))
    points[np.arange(1, len(points)), search.active] += nudges
    modes = [KEEP, *(FULL if NAMES[k] in _GAINS else FOLLOW for k in search.active)]
    e, s = errors(search, points, np.array(modes, dtype=float))
    return Slopes(e[0], s[0], (e[1:] - e[0]) / nudges[:, None], (s[1:] - s[0]) / nudges[:, None], point)


def _scores(search: Search, point: Array, slopes: Slopes) -> tuple[Array, Array]:
    """(gradient, information) of the cost, with the prior's."""
    e, s, de, ds = slopes.e, slopes.s, slopes.de * search.used, slopes.ds * search.used
    ratio = e / s
    gradient = de @ ratio + 0.5 * ds @ ((1.0 - e * ratio) / s)
    white, wide = de / np.sqrt(s), ds / s
    information = white @ white.T + 0.5 * wide @ wide.T + search.prior_information
    off = (point - search.prior_mean)[search.active]
    return gradient + search.prior_information @ off, information


def _sds(information: Array) -> Array:
    """Posterior sds, shape (a,)."""
    return np.asarray(np.sqrt(np.diag(_inverse(information))), np.float64)


def _inverse(matrix: Array) -> Array:
    inverse: Array = np.asarray(np.linalg.inv(matrix), np.float64)
    return (inverse + inverse.T) / 2


def with_gain(found: Found, gain: float) -> Found:
    """The same with another comparison."""
    return replace(found, gain=gain)


def _honest(search: Search, covariance: Array, slopes: Slopes) -> Array:
    """The covariance, made larger where the scores are correlated over time, as coloured noise makes them.

    Newey-West estimate of the scores' covariance between inverse informations (the sandwich of quasi maximum
    likelihood). It only widens: a short record may by chance look better than white.
    """
    e, s, de, ds = slopes.e, slopes.s, slopes.de * search.used, slopes.ds * search.used
    ratio = e / s
    scores = de * ratio + 0.5 * ds * ((1.0 - e * ratio) / s)
    bins = (search.record.rows[:, 0] * DT / BIN_S).astype(np.int64)
    sums = np.zeros((len(scores), int(bins[-1]) + 1))
    for row, into in zip(scores, sums, strict=True):
        into += np.bincount(bins, row, minlength=len(into))
    sums = np.asarray(sums - sums.mean(axis=1, keepdims=True), np.float64)
    spread: Array = sums @ sums.T
    for lag in range(1, LAGS + 1):
        later = sums[:, lag:] @ sums[:, :-lag].T
        spread = spread + (1.0 - lag / (LAGS + 1)) * (later + later.T)
    robust = covariance @ (spread + search.prior_information) @ covariance
    wider = np.sqrt(np.maximum(np.diag(robust) / np.diag(covariance), 1.0))
    honest: Array = covariance * np.outer(wider, wider)
    return honest


def _step(
    search: Search, point: Array, gradient: Array, information: Array, damping: float, cost: float
) -> tuple[Array, int, float | None]:
    """(step, tries, cost after it); None where no step lowers the cost."""
    for tried in range(1, 8):
        damped = information + damping * 4.0 ** (tried - 1) * np.diag(np.diag(information))
        step: Array = -np.asarray(np.linalg.solve(damped, gradient), np.float64)
        logs = step[search.active < 6]
        longest = float(np.max(np.abs(logs))) if len(logs) else 0.0
        step = step * min(1.0, LONGEST_STEP / max(longest, 1e-12)) / (1.0 if tried < 5 else 4.0)
        trial = point.copy()
        trial[search.active] += step
        e, s = errors(search, trial[None], np.array([FULL], dtype=float))
        after = _cost(search, trial, e[0], s[0])
        if np.isfinite(after) and after <= cost + SLACK:
            return step, tried, after
    return np.zeros(len(search.active)), 8, None


def _leave_out(search: Search, point: Array) -> None:
    """Rows that are beyond belief at this point, once and for all of this fit."""
    e, s = errors(search, point[None], np.array([FULL], dtype=float))
    search.used = np.where(np.abs(e[0]) > OUTLIER * np.sqrt(s[0]), 0.0, search.used)


def whiteness(rows: Array, used: Array, e: Array, s: Array) -> float:
    """Mean autocorrelation at one step of the normalised innovations of each kind and place."""
    found, weights = [], []
    for kind, place in {(float(k), float(p)) for k, p in rows[:, 2:4]}:
        own = (rows[:, 2] == kind) & (rows[:, 3] == place) & (used > 0.0)
        z = (e / np.sqrt(s))[own]
        if len(z) > 20 and z @ z > 0.0:
            found.append(float(z[1:] @ z[:-1] / (z @ z)))
            weights.append(len(z))
    return float(np.average(found, weights=weights)) if found else 0.0


assert AT["pair_t"] == 9
