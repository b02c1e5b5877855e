"""The likelihood of one record over the unknowns, and its derivatives.

The cost of a point is 1/2 sum(e^2/S + log S) over the record's innovations (predictor.py) plus 1/2 (p - p0)'
P0^-1 (p - p0) of the prior. Derivatives of e by what the motion depends on come from the filter's own run,
with the gains held; those of e and S by noise levels from companions of the run. The Fisher information is
sum(de de'/S + 1/2 dS dS'/S^2).
"""

from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.filters.predictor import Innovations, Measured, Varied, run_filter
from tilth.estimator.filters.rig_setup import RigSetup
from tilth.estimator.filters.states import N_STATES, X_POSITION, X_PSI, X_R, Places
from tilth.estimator.filters.unknowns import AT, NAMES, NOISES
from tilth.estimator.record.record import (
    EAST,
    KIND,
    NORTH,
    PLACE,
    PSI,
    TICK,
    VALUE,
    R,
    Record,
)
from tilth.estimator.tuning import tuned

Array = NDArray[np.float64]

ROLL_MODES: Final = [AT[f"roll_{of}_{body}"] for of in "kdj" for body in "ti"]  # stiffness, damping, inertia


@dataclass(frozen=True, slots=True)
class LikelihoodTuning:
    """Numerics of the likelihood of a record."""

    difference_step: float = tuned(1e-3, "sd", "of the prior: step of the differences")
    step_limit: float = tuned(1e-4, "by unknown", "largest step of the differences, in its own unit")
    noise_trust: float = tuned(0.6, "1", "by which a noise level's logarithm moves until slopes are renewed")
    """The perturbed filters are half the cost of a run."""
    six_trust: float = tuned(1.5, "sd", "that unknowns move until what gains do is renewed, for the six")
    """Over moves of 0.8 sd it has changed by 0.1 to 0.2 sd of the six; over 2.4 sd by up to 0.5."""
    roll_trust: float = tuned(0.1, "sd", "the same for roll modes, of which it is the larger part")
    settling_ticks: int = tuned(50, "ticks", "at the beginning whose rows only initialise the state")
    """The initial covariance must allow any manoeuvre; if the first rows counted with it, straight driving
    would make the tyres look softer than they are, by 0.2 sd per window."""
    other_tyres_sd: Array = tuned(
        np.array([0.3, 0.3, 0.3, 0.3, 0.3, 0.6]),
        "1",
        "sds of the six logarithms as the ground's shaking alone seems to tell them, less the true ones",
    )
    """Errors of the model of the ground. The implement's wheels follow the tractor's over the same
    unevenness, so what disturbs the implement has been in the tractor's motion before, and the model takes
    one for the cause of the other: of three steps of 30 s the maximum of the likelihood alone has sigma_i 35
    % long (16 runs of the planar plant), 7 % where the implement meets other ground; at 3 m/s in space C_ar
    is 9, sigma_r 12 and sigma_i 15 % off."""
    run_away: float = tuned(1e4, "m, m/s, rad, rad/s", "over a logarithm: no rig that is steered answers so")


LIKELIHOOD: Final = LikelihoodTuning()


NOTHING: Final = np.zeros(0, dtype=np.int64)  # no unknowns
NO_READINGS: Final = np.zeros((0, 0))
NO_POINTS: Final = np.zeros((0, len(NAMES)))
NOWHERE: Final = np.full(len(NAMES), np.inf)


class OfGains(NamedTuple):
    """What the change of the filter's gains adds to derivatives with gains held."""

    points: Array  # (a, n), where each of them was taken; infinite if never
    de: Array  # (a, m)
    dS: Array  # (a, m)


@dataclass(slots=True)
class Search:
    """The problem: a record, a prior, and which rows are used."""

    record: Record
    setup: RigSetup
    start: Array  # (30,), first state of the filter
    used: Array  # (m,), 0.0 for a row that is left out
    prior_mean: Array  # [n]
    prior_information: Array  # (a, a), of the active ones
    prior_sd: Array  # (a,), with all others unknown
    active: NDArray[np.int64]  # (a,), indices of the unknowns that are not fixed
    outliers_chosen: bool = False  # whether `used` stays as it is
    steering: Array | None = None  # (m, a), as `once_for_a_search` keeps it
    of_motion: NDArray[np.bool_] = field(init=False)  # (a,), whether an active unknown is no noise level
    of_roll: NDArray[np.bool_] = field(init=False)  # (a,), whether it is of how a body swings on its tyres

    def __post_init__(self) -> None:
        self.of_motion = np.array([NAMES[k] not in NOISES for k in self.active])
        self.of_roll = np.isin(self.active, ROLL_MODES)

    @property
    def scored(self) -> Array:
        """(m,), 1.0 for a row whose innovation counts in the likelihood."""
        return np.where(self.record.rows[:, TICK] >= LIKELIHOOD.settling_ticks, self.used, 0.0)


@dataclass(frozen=True, slots=True)
class Iterate:
    """A point of a search."""

    point: Array  # [n]
    e: Array  # (m,), innovations
    S: Array  # (m,), their variances
    de: Array  # (a, m), derivatives of the innovations over the active unknowns
    dS: Array  # (a, m), of their variances
    cost: float
    noise_point: Array  # [n], where the derivatives over the noise levels were taken
    instrument_response: (
        Array  # (s, m), response of the innovations to `instruments`, for `apart_from_ground`
    )
    of_gains: OfGains | None = None  # of a point nearby
    summed: bool = False  # whether the derivatives have it in them


def first_state(record: Record, setup: RigSetup) -> Array:
    """First state of the filter, (30,): headings and yaw rates of the first tick, and the first position."""
    x = np.zeros(N_STATES)
    first = record.ticks[0]
    x[X_PSI : X_PSI + 2], x[X_R : X_R + 2] = first[PSI : PSI + 2], first[R : R + 2]
    heading_t, heading_i = (np.array([np.cos(psi), np.sin(psi)]) for psi in first[PSI : PSI + 2])
    for kind, column in ((NORTH, 0), (EAST, 1)):
        found = record.rows[record.rows[:, KIND] == kind]
        if len(found):
            place = int(found[0, PLACE])
            ahead = setup.levers[place, 0]
            arm = ahead * heading_t
            if place >= 2:
                arm = -setup.geometry[2] * heading_t + (ahead - setup.geometry[3]) * heading_i
            x[X_POSITION + column] = found[0, VALUE] - arm[column]
    return x


def innovations(
    record: Record, setup: RigSetup, start: Array, point: Array, places: Places = NOTHING, *,
    used: Array | None = None, closed: bool = True, instruments: Array = NO_READINGS,
    responding: NDArray[np.bool_] | None = None, nearby: Array = NO_POINTS,
) -> Innovations:  # fmt: skip
    """The filter over a record at a point, (n,), of the unknowns: `predictor.run_filter`.

    start: (30,). places: (a,), of the unknowns to differentiate by. used: (m,), 0.0 for a row that is left
    out. closed: False for the open loop. instruments: (m, a), changes of the readings; responding: (a,), for
    which
    places the response to these is asked, all if None. nearby: (q, n), points that differ in noise levels,
    which are tried beside.
    """
    rows = np.ascontiguousarray(record.rows)
    m, q = len(rows), len(nearby)
    out = Innovations(
        np.empty(m), np.empty(m), np.empty((m, len(places))), np.empty((m, q)), np.empty((m, q))
    )
    measured = Measured(
        np.ascontiguousarray(record.ticks), rows, rows[:, VALUE].copy(),
        np.ones(m) if used is None else used, closed,
    )  # fmt: skip
    if responding is None:
        responding = np.full(len(places), len(instruments) > 0)
    run_filter(
        measured, start.copy(), point.copy(), setup, Varied(places, instruments, responding, nearby), out
    )
    return out


def _run(
    search: Search, point: Array, places: Places = NOTHING, *, closed: bool = True,
    instruments: Array = NO_READINGS, responding: NDArray[np.bool_] | None = None, nearby: Array = NO_POINTS,
) -> Innovations:  # fmt: skip
    return innovations(
        search.record, search.setup, search.start, point, places, used=search.used, closed=closed,
        instruments=instruments, responding=responding, nearby=nearby,
    )  # fmt: skip


def negative_log_likelihood(search: Search, e: Array, S: Array) -> float:
    """Negative log-likelihood of a record, nats, up to a constant."""
    return float(0.5 * np.sum(search.scored * (e * e / S + np.log(S))))


def likelihood_at(search: Search, point: Array) -> float:
    """`negative_log_likelihood` at a point, [n]."""
    made = _run(search, point)
    return negative_log_likelihood(search, made.e, made.S)


def _cost(search: Search, point: Array, e: Array, S: Array) -> float:
    deviation = (point - search.prior_mean)[search.active]
    with np.errstate(all="ignore"):  # after a step that is too long the cost is not finite; it is rejected
        return negative_log_likelihood(search, e, S) + float(
            0.5 * deviation @ search.prior_information @ deviation
        )


def posterior_cost(search: Search, point: Array) -> float:
    """Of record and prior at a point, [n], nats, up to a constant."""
    made = _run(search, point)
    return _cost(search, point, made.e, made.S)


def search_of(record: Record, setup: RigSetup, mean: Array, covariance: Array) -> Search:
    """The problem of a fit; arguments as of `scoring.maximise_posterior`."""
    active = np.flatnonzero(np.diag(covariance) > 0.0)
    sound = np.all(np.isfinite(record.rows), axis=1)
    prior, sd = inverse(covariance[np.ix_(active, active)]), np.sqrt(np.diag(covariance)[active])
    start = first_state(record, setup)
    return Search(record, setup, start, sound.astype(np.float64), mean, prior, sd, active)


def inverse(matrix: Array) -> Array:
    """Of a symmetric matrix."""
    found: Array = np.asarray(np.linalg.inv(matrix), np.float64)
    return (found + found.T) / 2


def evaluate(
    search: Search,
    point: Array,
    before: Iterate | None = None,
    instruments: Array = NO_READINGS,
    *,
    levels: bool = False,
) -> Iterate:
    """A point of a search. Derivatives over noise levels are those of `before`, or 0 without.

    instruments: as `response_to_steering` gives it, if `apart_from_ground` is to follow; those by the six
    are used. levels: whether the derivatives over noise levels are renewed, unless they are of a point
    nearby.
    """
    of_motion, many = (
        search.active[search.of_motion],
        min(instruments.shape[1], int(np.sum(search.active < 6))),
    )
    places = np.concatenate([of_motion, search.active[:many]])  # the six come first
    responding = np.arange(len(places)) >= len(of_motion)
    readings = np.zeros((len(instruments), len(places)))
    readings[:, responding] = instruments[:, :many]
    noise_point = NOWHERE if before is None else before.noise_point
    steps, nearby = _levels_nearby(search, point, noise_point) if levels else (np.zeros(0), NO_POINTS)
    made = _run(search, point, places, instruments=readings, responding=responding, nearby=nearby)
    cost, none = _cost(search, point, made.e, made.S), np.zeros((len(search.active), len(made.e)))
    de, dS = (none, none.copy()) if before is None else (before.de.copy(), before.dS.copy())
    of_unknowns = made.de.T
    de[search.of_motion], dS[search.of_motion] = of_unknowns[~responding], 0.0
    if len(nearby):
        de[~search.of_motion] = ((made.e_nearby - made.e[:, None]) / steps).T
        dS[~search.of_motion] = ((made.S_nearby - made.S[:, None]) / steps).T
        noise_point = point
    of_gains = None if before is None else before.of_gains
    return Iterate(point, made.e, made.S, de, dS, cost, noise_point, of_unknowns[responding], of_gains)


def _levels_nearby(search: Search, point: Array, noise_point: Array) -> tuple[Array, Array]:
    """(steps of the noise levels (q,), points that are off by them (q, n)); none where slopes are of a point
    nearby."""
    levels = search.active[~search.of_motion]
    if len(levels) == 0 or float(np.max(np.abs(point - noise_point)[levels])) < LIKELIHOOD.noise_trust:
        return np.zeros(0), NO_POINTS
    steps = np.minimum(LIKELIHOOD.difference_step * search.prior_sd[~search.of_motion], LIKELIHOOD.step_limit)
    nearby = np.tile(point, (len(levels), 1))
    nearby[np.arange(len(levels)), levels] += steps
    return steps, nearby


def with_gains(search: Search, at: Iterate, six: bool = True) -> Iterate:
    """The derivatives over stiffness, damping and inertia of the roll modes, and over the six, with what the
    change of the gains does in them: there the gradient is that of the likelihood. It is known by differences
    of runs, renewed unless it is of a point nearby."""
    if at.summed:
        return at
    of, known = search.of_roll | (six & (search.active < 6)), at.of_gains
    if known is None:
        zeros = np.zeros_like(at.de)
        known = OfGains(np.full((len(of), len(at.point)), np.inf), zeros, zeros)
    of &= _moved_far(search, at, known)
    points, de, dS = known.points.copy(), known.de.copy(), known.dS.copy()
    steps = np.minimum(LIKELIHOOD.difference_step * search.prior_sd, LIKELIHOOD.step_limit)
    for k in np.flatnonzero(of):
        there = _run(search, at.point + steps[k] * np.eye(len(at.point))[search.active[k]])
        points[k] = at.point
        de[k] = (there.e - at.e) / steps[k] - at.de[k]
        dS[k] = (there.S - at.S) / steps[k] - at.dS[k]
    return replace(at, de=at.de + de, dS=at.dS + dS, of_gains=OfGains(points, de, dS), summed=True)


def _moved_far(search: Search, at: Iterate, known: OfGains) -> NDArray[np.bool_]:
    """Which rows of `known` are to be renewed, (a,): in sds of the posterior, the unknowns of motion have
    moved far."""
    there = replace(at, de=at.de + known.de, dS=at.dS + known.dS)
    _, information = gradient_and_information(search, there, scores_at(search, there))
    sds = np.sqrt(np.diag(inverse(information)))
    away = np.abs(at.point - known.points)[:, search.active] / sds
    trust = np.where(search.active < 6, LIKELIHOOD.six_trust, LIKELIHOOD.roll_trust)
    return np.asarray(np.max(away[:, search.of_motion], axis=1) > trust, np.bool_)


def response_to_steering(search: Search, point: Array, places: Places | None = None) -> Array:
    """Derivatives of the open-loop response to the known wheel angles, without measurements, by unknowns at
    `places`, those of the six that are active if None: (m, s). 0 where the open loop runs away, as it may in
    a sharp turn: such a record tells of tyres by `other_tyres_sd` alone."""
    asked = search.active[search.active < 6] if places is None else places
    instruments = _run(search, point, asked, closed=False).de
    return (
        instruments if bool(np.all(np.abs(instruments) < LIKELIHOOD.run_away)) else np.zeros_like(instruments)
    )


def once_for_a_search(search: Search, point: Array) -> Array:
    """`response_to_steering` by all active unknowns of the motion, the six first, at the first point where it
    is asked for: a search asks near its end, where all points are near."""
    if search.steering is None:
        search.steering = response_to_steering(search, point, search.active[search.of_motion])
    return search.steering


def whitened_by_steering(
    search: Search, point: Array, places: Places, instruments: Array | None = None
) -> tuple[Array, Array]:
    """(innovations (m,) over their sds, their derivatives (m, s) by the unknowns at `places` along the path
    that the steering alone gives), in the order of the record's rows, for a stage behind the filter.

    The slopes are those of `response_to_steering`, passed through the gains at the point: nothing that the
    ground has done is in them. Rows of one tick are updated one after the other, so their innovations are
    uncorrelated, too: this is the tick's innovation vector times the inverse of a Cholesky factor of its
    covariance. A row that `search` leaves out is 0, as are those by which the state only settles.
    instruments: (m, s), that response at a point nearby; None: it is made.
    """
    instruments = response_to_steering(search, point, places) if instruments is None else instruments
    made = _run(search, point, places, instruments=instruments, responding=np.ones(len(places), np.bool_))
    weights = search.scored / np.sqrt(made.S)
    return made.e * weights, made.de * weights[:, None]


def apart_from_ground(search: Search, here: Iterate) -> tuple[Iterate, Array]:
    """(a point with the derivatives of e that are left, the information (a, a) that is left with the prior)
    where the ground's shaking may tell of other tyres than steering does.

    here: evaluated with `response_to_steering`, which may be that at a point nearby. It is taken as changes
    of the readings, which pass through the filter at the point; what remains of the derivatives by the six is
    the rig's response to the ground. Its tyres differ from the true ones by errors of the model of the
    ground, another six unknowns with `other_tyres_sd`. They are eliminated (variable projection: Golub and
    Pereyra 1973), so they take their share of the information but none of what steering tells.
    """
    six = search.active < 6
    sd = LIKELIHOOD.other_tyres_sd[search.active[six]]
    shaken = here.de[six] - here.instrument_response
    weight = search.scored / here.S
    shared = (here.de * weight) @ shaken.T
    inside = inverse((shaken * weight) @ shaken.T + np.diag(sd**-2.0))
    _, information = gradient_and_information(search, here, scores_at(search, here))
    told = (shaken * weight) @ here.e
    left = replace(
        here, de=here.de - shared @ inside @ shaken, cost=here.cost - float(told @ inside @ told) / 2.0
    )
    return left, information - shared @ inside @ shared.T


def scores_at(search: Search, at: Iterate) -> Array:
    """Derivative of each row's negative log-likelihood, shape (a, m)."""
    scored, moving = search.scored, np.flatnonzero(at.dS.any(axis=1))
    ratio = at.e / at.S
    scores: Array = at.de * (scored * ratio)
    scores[moving] += at.dS[moving] * (scored * 0.5 * (1.0 - at.e * ratio) / at.S)
    return scores


def gradient_and_information(search: Search, at: Iterate, scores: Array) -> tuple[Array, Array]:
    """(gradient (a,), information (a, a)) of the cost, including the prior."""
    scored = search.scored
    whitened, moving = at.de * (scored / np.sqrt(at.S)), np.flatnonzero(at.dS.any(axis=1))
    relative = at.dS[moving] * (scored / at.S)
    information = whitened @ whitened.T + search.prior_information
    information[np.ix_(moving, moving)] += 0.5 * relative @ relative.T
    return gradient(search, at, scores), information


def gradient(search: Search, at: Iterate, scores: Array) -> Array:
    """Gradient (a,) of the cost, including the prior."""
    deviation = (at.point - search.prior_mean)[search.active]
    return np.asarray(scores.sum(axis=1) + search.prior_information @ deviation, np.float64)
