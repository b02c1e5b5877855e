"""Which of the six parameters do the data determine, which not, and which manoeuvre would help?

The value of a manoeuvre is predicted before it is driven: the predictor runs over a simulated drive. The
derivatives of its innovations over all unknowns, whitened, give the information that the drive would add (as
identifiability.cramer_rao, with an unknown first state and all nuisances). Only the information from the
known steering counts, not that from the spectrum of the disturbances; so a real drive gives a little more.
"""

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple, cast

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from tilth.estimator.driving import DRIVING
from tilth.estimator.filters import fit_covariance, likelihood, unknowns
from tilth.estimator.filters.rig_setup import rig_setup
from tilth.estimator.filters.states import DT, N_STATES
from tilth.estimator.filters.unknowns import AT, NAMES, NOISE, SIX
from tilth.estimator.models import identifiability
from tilth.estimator.models.manoeuvres import MANOEUVRE, manoeuvre_named
from tilth.estimator.record.record import (
    EAST,
    HEADING,
    INPUTS,
    KIND,
    NORTH,
    PLACE,
    PSI,
    ROLL_ANGLE,
    ROWS,
    SD,
    TICK,
    VALUE,
    VELOCITY,
    WHEEL_ANGLE,
    YAW_RATE,
    R,
    Record,
    U,
)
from tilth.estimator.tuning import tuned
from tilth.schemas.flow import PARAMETERS, Mount
from tilth.schemas.machine import Machine
from tilth.schemas.reasons import Advice, AdviceKind, Combination

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class AdviceTuning:
    """Which manoeuvre is advised."""

    supported: float = tuned(0.5, "1", "largest posterior over prior sd of what counts as determined")
    pair_preference: float = tuned(2.0, "1", "a pair is preferred unless a direction is known so much better")
    least_information: float = tuned(1e-3, "1", "over the prior's: directions with less count as unobserved")
    seconds: float = tuned(10.0, "s", "duration of a manoeuvre")
    target: float = tuned(0.10, "1", "sd of a logarithm that is good enough: nothing sharper is advised")
    worthwhile: float = tuned(0.85, "1", "share of the present sd below which a manoeuvre must bring it")
    largest_acceleration: float = tuned(2.0, "m/s^2", "lateral, of an advised manoeuvre")
    receiver_rate: float = tuned(5.0, "1/s", "assumed of a receiver")
    every_ns: int = tuned(10_000_000_000, "ns", "between two looks at what to advise")
    rebuild_change: float = tuned(0.15, "1", "of a logarithm, or the speed, after which the table is renewed")
    turn_speed: float = tuned(2.0, "m/s", "headland turns are driven no faster")


ADVICE: Final = AdviceTuning()


class Candidate(NamedTuple):
    manoeuvre: str  # a row of manoeuvres.MANOEUVRES
    degrees: float  # of the wheels


TURN: Final = Candidate("turn", 25.0)
CANDIDATES: Final = (
    TURN,  # is driven anyway
    *(Candidate(name, degrees) for degrees in (3.0, 5.0, 8.0) for name in ("step", "steps", "chirp")),
)
NO_ERROR: Final = np.zeros(len(PARAMETERS))
# the candidates draw no random numbers: a driver could not follow those
NO_DRAW: Final = cast(Generator, None)


# What is determined.


def information_of(covariance: Array, prior_sd: Array) -> Array:
    """Information of the data without the prior, (n, n), positive semidefinite. covariance: (n, n),
    posterior."""
    scale = np.outer(prior_sd, prior_sd)
    scaled = np.linalg.inv(covariance / scale) - np.eye(len(prior_sd))
    values, vectors = np.linalg.eigh((scaled + scaled.T) / 2)
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T / scale)


def eigenvalues(information: Array, prior_sd: Array) -> tuple[float, ...]:
    """Eigenvalues of the information (n, n) relative to the prior's, largest first. prior_sd: (n,)."""
    values = np.linalg.eigvalsh(information * np.outer(prior_sd, prior_sd))
    return tuple(float(max(value, 0.0)) for value in values[::-1])


def bound(information: Array, prior_sd: Array) -> tuple[float | None, ...]:
    """Cramér-Rao bound: smallest sd of each parameter by the data alone; None if they do not determine it."""
    values, vectors = np.linalg.eigh(information * np.outer(prior_sd, prior_sd))
    rows = np.sqrt(np.where(values > ADVICE.least_information, values, 0.0))[:, None] * vectors.T
    if not rows.any():
        return (None,) * len(prior_sd)
    found = identifiability.bound(rows, [str(k) for k in range(len(prior_sd))]).sd * prior_sd
    return tuple(float(sd) if math.isfinite(sd) else None for sd in found)


def determined(information: Array, prior_sd: Array) -> tuple[Combination, ...]:
    """Each parameter that data and prior determine; for the others, the ratios, products or further
    combinations that are determined. information: (n, n); prior_sd: (n,); of the first n parameters."""
    n = len(prior_sd)
    prior: Array = np.diag(prior_sd**2)
    posterior: Array = np.asarray(np.linalg.inv(np.diag(prior_sd**-2.0) + information), np.float64)
    sd = np.sqrt(np.diag(posterior))
    single = [k for k in range(n) if sd[k] <= ADVICE.supported * prior_sd[k]]
    found = [_combination(np.eye(n)[k], float(sd[k])) for k in single]
    rest = [k for k in range(n) if k not in single]
    if len(rest) < 2:
        return tuple(found)
    here: Array = posterior[np.ix_(rest, rest)]
    prior_variance: Array = prior[np.ix_(rest, rest)]
    for _ in range(len(rest) - 1):
        weights = _best(here, prior_variance)
        if weights is None:
            break
        exponents = np.zeros(n)
        exponents[rest] = weights
        found.append(_combination(exponents, math.sqrt(exponents @ posterior @ exponents)))
        # Condition on it, so that the next combination is another one.
        here, prior_variance = _conditioned(here, weights), _conditioned(prior_variance, weights)
    return tuple(found)


def _combination(exponents: Array, log_sd: float) -> Combination:
    return Combination((*exponents.tolist(), *[0.0] * (len(PARAMETERS) - len(exponents))), log_sd)


def _best(posterior: Array, prior: Array) -> Array | None:
    """Weights (n,) of the combination that is known best relative to the prior: a ratio or product of two,
    or, if none is good enough, the best direction, with weights rounded to one decimal. None if nothing is
    determined."""
    n = len(posterior)
    pairs = []
    for i, j in itertools.combinations(range(n), 2):
        for sign in (-1.0, 1.0):
            weights = np.zeros(n)
            weights[i], weights[j] = 1.0, sign
            pairs.append(weights)
    values, vectors = np.linalg.eigh(prior)
    positive = values > 1e-9 * values[-1]
    root = vectors[:, positive] / np.sqrt(values[positive])
    _, directions = np.linalg.eigh(root.T @ posterior @ root)
    general = root @ directions[:, 0]
    general = np.round(general / np.abs(general).max(), 1)
    general *= np.sign(general[np.argmax(np.abs(general))])
    scores = [_sd_ratio(pair, posterior, prior) for pair in pairs]
    score, best = min(scores), _sd_ratio(general, posterior, prior)
    if score <= min(ADVICE.supported, ADVICE.pair_preference * best):
        # Where soil ties the axles alike, ratios are known alike: the last digit must not choose.
        return next(pair for pair, one in zip(pairs, scores, strict=True) if one <= score * (1.0 + 1e-6))
    return np.asarray(general) if best <= ADVICE.supported else None


def _sd_ratio(weights: Array, posterior: Array, prior: Array) -> float:
    """Posterior over prior sd of a combination; 1 if the prior knows it already."""
    prior_variance = float(weights @ prior @ weights)
    if prior_variance < 1e-3 * float(weights @ weights) * float(np.trace(prior)):
        return 1.0
    return math.sqrt(max(float(weights @ posterior @ weights), 0.0) / prior_variance)


def _conditioned(covariance: Array, weights: Array) -> Array:
    """The covariance conditioned on that combination, as if it were known exactly."""
    cross = covariance @ weights
    return np.asarray(covariance - np.outer(cross, cross) / max(float(weights @ cross), 1e-12))


# What would help.


def information(
    machine: Machine,
    point: Array,
    speed: float,
    candidate: Candidate,
    hertz: Sequence[float] = (ADVICE.receiver_rate,) * 4,
    linear: bool = False,
) -> Array:
    """Predicted information of `seconds` of a manoeuvre on unknowns.NAMES, (n, n).

    point: (n,), where it is linearised. speed: m/s. hertz: rate of each receiver, in the order of flow.Mount.
    linear: as rig_setup.
    """
    speed = _speed_of(candidate, speed)
    record, setup = planned(machine, point, speed, candidate, hertz, linear), rig_setup(machine, linear)
    _, prior_sd = unknowns.prior(machine)
    active = np.array([k for k in range(len(NAMES)) if prior_sd[k] > 0 and not NOISE.start <= k < NOISE.stop])
    found = likelihood.innovations(record, setup, np.zeros(N_STATES), point, active)
    information_matrix = np.zeros((len(NAMES), len(NAMES)))
    if not (np.all(found.S > 0.0) and np.isfinite(found.de).all()):
        return information_matrix  # a rig that runs away in it: nobody should drive that to learn
    whitened = found.de / np.sqrt(found.S)[:, None]
    information_matrix[np.ix_(active, active)] = whitened.T @ whitened
    return information_matrix


def planned(
    machine: Machine, point: Array, speed: float, candidate: Candidate, hertz: Sequence[float], linear: bool
) -> Record:
    """The record of a candidate as it is expected, without noise. Arguments as of `information`."""
    time: Array = np.arange(round((ADVICE.seconds + MANOEUVRE.start_s) / DT) + 1, dtype=np.float64) * DT
    steering = manoeuvre_named(candidate.manoeuvre).wheel_angle
    angles = steering(time, math.radians(candidate.degrees), NO_DRAW)
    rows = planned_rows(machine, len(angles), hertz)
    return expected(machine, point, speed, angles, rows, linear)


def expected(
    machine: Machine, point: Array, speed: float, angles: Array, rows: Array, linear: bool = False
) -> Record:
    """The record of a drive as it is expected, without noise. angles: of the wheels at each tick, rad, (n,).
    rows: what will be measured, (m, 6); their values are set."""
    count = len(angles)
    ticks = np.zeros((count, len(INPUTS)))
    ticks[:, WHEEL_ANGLE] = angles
    ticks[:, U] = speed
    start, setup = np.zeros(N_STATES), rig_setup(machine, linear)
    headings = np.zeros((2 * count, len(ROWS)))
    headings[:, TICK], headings[:, PLACE] = np.repeat(np.arange(count), 2), np.tile([0, 1], count)
    headings[:, KIND], headings[:, SD] = HEADING, 1.0
    open_loop = likelihood.innovations(Record(0, ticks, headings), setup, start, point, closed=False)
    ticks[:, PSI : PSI + 2] = -open_loop.e.reshape(count, 2)
    ticks[:, R : R + 2] = np.gradient(np.unwrap(ticks[:, PSI : PSI + 2], axis=0), DT, axis=0)
    rows = rows.copy()
    rows[:, VALUE] = 0.0
    rows[:, VALUE] = -likelihood.innovations(Record(0, ticks, rows), setup, start, point, closed=False).e
    return Record(0, ticks, rows)


def planned_rows(machine: Machine, count: int, hertz: Sequence[float]) -> Array:
    """The rows that the receivers would measure, (m, 6), with the machine file's sds; values are zero."""
    by_mount = {receiver.mount: receiver for receiver in machine.receiver}
    made = []
    for place, mount in enumerate(Mount):
        if mount not in by_mount:
            continue
        r = by_mount[mount]
        ticks = np.arange(0, count - 1, max(round(1.0 / hertz[place] / DT), 1))
        of_one = [
            (NORTH, place, r.position_sd),
            (EAST, place, r.position_sd),
            (VELOCITY, place, r.velocity_sd),
            (YAW_RATE, place // 2, math.radians(r.yaw_rate_sd)),
            (ROLL_ANGLE, place, math.radians(r.roll_sd)),
        ]
        rows = np.zeros((len(ticks), len(of_one), len(ROWS)))
        rows[:, :, TICK] = ticks[:, None]
        rows[:, :, [KIND, PLACE, SD]] = of_one
        made.append(rows.reshape(-1, len(ROWS)))
    every = np.concatenate(made)
    return np.asarray(every[np.argsort(every[:, TICK], kind="stable")])


def predicted(
    covariance: Array, information: Array, model_sd: Array = NO_ERROR, kept: Array = NO_ERROR
) -> Array:
    """Sds of the six logarithms, (6,), after the information is added. Both arguments (n, n), over NAMES.

    model_sd: (6,), by which the model itself errs in what brings the information. kept: (6,), how much of
    such errors is in the covariance (pem.PemState.model_sd).
    """
    known = np.flatnonzero((np.diag(covariance) > 0) & ~_is_noise())
    prior = covariance[np.ix_(known, known)].copy()
    common = np.minimum(kept, model_sd)
    prior[SIX, SIX] -= np.diag(common**2)
    scale = np.sqrt(np.diag(prior))
    added = information[np.ix_(known, known)] * np.outer(scale, scale)
    total = np.linalg.inv(prior / np.outer(scale, scale)) + added
    after = np.asarray(np.diag(np.linalg.inv((total + total.T) / 2)) * scale**2, np.float64)[SIX]
    errors = fit_covariance.mixed(common, model_sd, np.diag(prior)[SIX], after)
    return np.asarray(np.sqrt(after + errors**2))


def _is_noise() -> NDArray[np.bool_]:
    found = np.zeros(len(NAMES), dtype=bool)
    found[NOISE] = True
    return found


def _speed_of(candidate: Candidate, speed: float) -> float:
    return min(speed, ADVICE.turn_speed) if candidate == TURN else speed


def _effort(candidate: Candidate) -> float:
    return 0.0 if candidate == TURN else candidate.degrees


def gentle(machine: Machine, speed: float, turns: bool = True) -> tuple[Candidate, ...]:
    """The candidates within `largest_acceleration` at a speed, m/s, mildest first. turns: with TURN."""
    wheelbase = machine.tractor.wheelbase
    limit = ADVICE.largest_acceleration * wheelbase
    return tuple(
        c
        for c in CANDIDATES
        if (turns or c != TURN) and math.radians(c.degrees) * max(_speed_of(c, speed), 0.1) ** 2 <= limit
    )


def advise(
    machine: Machine,
    mean: Array,
    covariance: Array,
    speed: float,
    table: Mapping[Candidate, Array],
    kept: Array = NO_ERROR,
) -> Advice:
    """What is not determined, and which manoeuvre would help most, by how much.

    mean (n,), covariance (n, n): over unknowns.NAMES. table: candidate -> its `information`, as far as
    computed. kept: as of `predicted`.
    """
    if speed < DRIVING.cruise:
        return Advice(AdviceKind.TOO_SLOW, speed=DRIVING.cruise)
    now, prior_sd = np.sqrt(np.diag(covariance)[SIX]), unknowns.prior(machine)[1][SIX]
    undetermined = [k for k in range(len(PARAMETERS)) if now[k] > ADVICE.supported * prior_sd[k]]
    known = not undetermined
    if known:
        undetermined = [int(np.argmax(now))]
    start = Advice(
        AdviceKind.NOT_AT_THIS_SPEED, tuple(PARAMETERS[k] for k in undetermined),
        tuple(now[undetermined].tolist()), known,
    )  # fmt: skip
    uneven = math.exp(mean[AT["uneven"]])
    wheelbase = machine.tractor.wheelbase
    after = {}
    for candidate, brought in table.items():
        angle = math.radians(candidate.degrees)
        lateral = angle * _speed_of(candidate, speed) ** 2 / wheelbase / math.sqrt(2.0)
        held = 0.0 if candidate.manoeuvre == "chirp" else 1.0
        tight = angle > fit_covariance.FIT_COVARIANCE.tight
        errors = fit_covariance.model_sd(tight, lateral, uneven, mean[SIX], held=held)
        after[candidate] = predicted(covariance, brought, errors, kept)
    chosen = _choose({c: sd[undetermined] for c, sd in after.items()}, now[undetermined])
    if not after:
        return start
    advised = replace(start, kind=AdviceKind.NOTHING_HELPS, seconds=ADVICE.seconds)
    if chosen is not None:
        advised = replace(
            advised, kind=AdviceKind.MANOEUVRE, manoeuvre=chosen.manoeuvre, degrees=chosen.degrees,
            after=tuple(after[chosen][undetermined].tolist()),
        )  # fmt: skip
    return _with_next_turn(advised, now, after[TURN]) if TURN in after and chosen != TURN else advised


def _with_next_turn(advised: Advice, now: Array, after: Array) -> Advice:
    """With what the headland turn that comes anyway would bring: of the parameter, of six, that it tells most
    of."""
    k = int(np.argmin(after / now))
    if after[k] > ADVICE.worthwhile * now[k]:
        return advised
    return replace(advised, turn_tells=PARAMETERS[k], turn_after=float(after[k]))


def _choose(after: Mapping[Candidate, Array], now: Array) -> Candidate | None:
    """The mildest candidate whose largest sd reaches `target` or nearly the best of all; None if none is
    worthwhile.

    after: sds of the k undetermined parameters after each candidate, (k,), as `now`.
    """
    worth = {c: float(sd.max()) for c, sd in after.items() if np.any(sd < ADVICE.worthwhile * now)}
    if not worth:
        return None
    enough = max(ADVICE.target, 1.1 * min(worth.values()))
    mildest = min(_effort(c) for c, worst in worth.items() if worst <= enough)
    return min((c for c in worth if _effort(c) == mildest), key=lambda c: worth[c])


@dataclass(slots=True)
class Advisor:
    """Advice in a running estimator: it computes the information of one candidate at a time."""

    advice: Advice | None = None
    renewed_ns: int = 0
    point: Array = field(default_factory=lambda: np.zeros(len(NAMES)))  # of the table
    speed: float = 0.0  # m/s, of the table
    table: list[Array] = field(default_factory=list)  # informations of `gentle`, reversed, as far as computed


_READ: Final[ContextVar[bool]] = ContextVar("advice is read", default=True)


@contextmanager
def unread() -> Iterator[None]:
    """Nobody reads the advice of folds that this thread runs meanwhile, nor what their data determine and at
    best allow, so none of it is made: 8 % of a replay. Nothing is learned from it."""
    before = _READ.set(False)
    try:
        yield
    finally:
        _READ.reset(before)


def is_read() -> bool:
    """Whether somebody reads what `unread` names."""
    return _READ.get()


def renew(
    state: Advisor, machine: Machine, mean: Array, covariance: Array, speed: float, t_ns: int,
    turns: bool = True, kept: Array = NO_ERROR,
) -> Advice | None:  # fmt: skip
    """The present advice; each `every_ns` it is renewed with one more candidate. turns: whether the estimator
    learns tyres from headland turns. Other arguments as `advise`."""
    if not is_read():
        return None
    if state.renewed_ns and state.renewed_ns <= t_ns < state.renewed_ns + ADVICE.every_ns:
        return state.advice
    state.renewed_ns = t_ns
    if speed < DRIVING.cruise:
        return state.advice
    far = (
        np.abs(mean - state.point)[SIX].max() > ADVICE.rebuild_change
        or abs(speed - state.speed) > ADVICE.rebuild_change * speed
    )
    if not state.table or far:
        state.point, state.speed, state.table = mean.copy(), speed, []
    candidates = gentle(machine, state.speed, turns)[::-1]  # the most informative first
    if len(state.table) < len(candidates):
        state.table.append(information(machine, state.point, state.speed, candidates[len(state.table)]))
    table = dict(zip(candidates, state.table, strict=False))
    state.advice = advise(machine, mean, covariance, speed, table, kept)
    return state.advice
