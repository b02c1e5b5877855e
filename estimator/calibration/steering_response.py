"""How the front wheels follow an automatic steering: dead time, time constant, rate limit, from a drive.

The model is first order behind a dead time, and no faster than a limit:

    y'(t) = clip((v(t) - y(t)) / T, -R, R),    v(t) = z + g u(t - L)

u is the commanded wheel angle, held until the next command; y is the wheel angle as it is measured. Gain g
and zero z are found along: commands may be made with other lengths than the machine file's, and with another
sign. Fitted by least squares of y over stretches in which the system steers. Its covariance is a jackknife
over blocks that are longer than the noise lasts.

It is the whole way from a command on the bus to the wheels: computing, valve, oil and linkage. Play, a dead
band of the valve and overshoot are not in the model; they widen what is said. L holds what the file's
`wheel_angle.delay` is wrong by.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import t as student

from tilth.estimator.tuning import tuned
from tilth.schemas.spread import WITHIN, plus_minus

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SteeringResponseTuning:
    """How the wheels' answer to an automatic steering is found."""

    silent_s: float = tuned(0.5, "s", "without a command, or without a wheel angle: a stretch ends")
    most_dead_time_s: float = tuned(1.0, "s", "longest dead time")
    most_early_s: float = tuned(0.2, "s", "the same, below zero: noise may put it there")
    shortest_s: float = tuned(4.0, "s", "of a stretch, after `most_dead_time_s`")
    least_s: float = tuned(40.0, "s", "of all stretches")
    block_s: float = tuned(8.0, "s", "wheels that take a second remember that long what has gone wrong")
    moves: float = tuned(math.radians(1.0), "rad", "sd of the commands in a stretch, at least")
    apart_s: float = tuned(0.0195, "s", "between the wheel angles that are used")
    begins_s: float = tuned(0.05, "s", "on either side of the beginning, whose wheel angle is a mean")
    follows: float = tuned(0.7, "1", "of the wheels' motion that the commands explain, at least")
    slow_times: tuple[float, ...] = tuned((0.05, 0.15, 0.4, 1.0), "s", "time constants where a search begins")
    dead_times: tuple[float, ...] = tuned((0.0, 0.15, 0.3, 0.5), "s", "dead times where a search begins")
    shares: tuple[float, ...] = tuned(
        (0.95, 0.9, 0.8, 0.7, 0.6, 0.5, 0.4), "1", "of the largest rate without a limit: limits to try"
    )
    limited: float = tuned(12.0, "chi^2", "by so much more likely there is a limit")
    lags_seen: int = tuned(12, "samples", "by these noise that lasts is told from what a limit does")
    excluded: float = tuned(4.0, "chi^2", "by so much less likely there is none")
    told_s: float = tuned(0.2, "s", "half-width of 95 %, of dead time and time constant")
    stamped_s: float = tuned(0.003, "s", "least sd of dead time and time constant: as stamps are")
    at_once_s: float = tuned(0.04, "s", "dead time and time constant: no wheels can")
    ridge: float = tuned(1e-4, "1", "keeps the search from a division by zero")
    steps: tuple[float, ...] = tuned((1e-3, 1e-3, 1e-3, 1e-4, 1e-3), "s, s, 1, rad, rad/s", "of derivatives")


STEERING_RESPONSE: Final = SteeringResponseTuning()

LOW: Final = (-STEERING_RESPONSE.most_early_s, 0.01, -10.0, -1.0, 0.005)  # of L, T, g, z, R
HIGH: Final = (STEERING_RESPONSE.most_dead_time_s, 5.0, 10.0, 1.0, 10.0)
NO_LIMIT: Final = np.zeros(0)

NO_COMMANDS: Final = "No commands of an automatic steering in this log: nothing to tell of the actuator."
NEVER_STEERED: Final = "The automatic steering never steered in this log: nothing to tell of the actuator."
TOO_SHORT: Final = (
    "The automatic steering steered too briefly to tell how the wheels follow it: let it steer for a minute, "
    f"{STEERING_RESPONSE.shortest_s + STEERING_RESPONSE.most_dead_time_s:.0f} s or more at a time."
)
TOO_GENTLE: Final = (
    "The automatic steering moved the wheels too little to tell how they follow it: "
    "let it steer where it has to turn, such as onto a row from the side or round a bend."
)
NOT_FOLLOWED: Final = (
    "The wheels did not do what the automatic steering asked for: it was not obeyed, or somebody steered "
    "by hand."
)
AFTERWARDS: Final = (
    "What looks like commands of an automatic steering follows the wheels, and not the wheels it: nothing "
    "to tell of the actuator."
)


@dataclass(frozen=True, slots=True)
class SteeringOrders:
    """Of one sender, n of them."""

    t: Array  # s, (n,), ascending, on the clock of the wheel angles
    angle: Array  # rad, (n,), of the wheels
    steers: NDArray[np.bool_]  # (n,)


@dataclass(frozen=True, slots=True)
class SteeringResponse:
    """How the wheels follow. Sds are of the errors, coloured noise among them."""

    dead_time: float  # s
    dead_time_sd: float
    time_constant: float  # s
    time_constant_sd: float
    rate: float  # rad/s, the largest that was seen
    rate_sd: float
    limited: bool  # whether that is the steering's limit
    gain: float  # measured over commanded angle
    seconds: float  # of driving that tells it
    explained: float  # share of the wheels' motion

    @property
    def words(self) -> str:
        """For a driver."""
        dead_time = plus_minus(max(self.dead_time, 0.0), self.dead_time_sd, "s", bare=True)
        slow = plus_minus(self.time_constant, self.time_constant_sd, "s", bare=True)
        rate = plus_minus(math.degrees(self.rate), math.degrees(self.rate_sd), "°/s", bare=True)
        most = f"at most {rate}" if self.limited else f"fastest seen {rate}"
        turned = "" if self.gain > 0.0 else " Its commands and the wheel angle have opposite signs."
        return (
            f"Steering follows its commands after {dead_time}, time constant {slow}, {most} (95 %).{turned}"
        )


@dataclass(frozen=True, slots=True)
class _Stretch:
    """In which the system steers. Times s from its beginning."""

    order_t: Array  # (m,)
    order: Array  # rad, (m,)
    t: Array  # (n,), of the wheel angles from `most_dead_time_s` on
    y: Array  # rad, (n,)
    y0: float  # at `most_dead_time_s`


def respond(orders: SteeringOrders, wheel_t: Array, wheel: Array, delay: float) -> SteeringResponse | str:
    """How the wheels follow, or why nothing can be told, as a sentence.

    wheel_t: (n,), s, ascending, when a frame with the wheel angle came. wheel: (n,), rad. delay: s, from
    measurement to frame.
    """
    if not len(orders.t):
        return NO_COMMANDS
    if not orders.steers.any():
        return NEVER_STEERED
    found = _stretches(orders, wheel_t - delay, wheel)
    if sum(map(_seconds, found)) < STEERING_RESPONSE.least_s:
        return TOO_SHORT
    found = [one for one in found if float(np.std(one.order)) > STEERING_RESPONSE.moves]
    if sum(map(_seconds, found)) < STEERING_RESPONSE.least_s:
        return TOO_GENTLE
    at = _fitted(found, _start(found))
    followed = [one for one in found if _explained([one], at) > STEERING_RESPONSE.follows]
    if sum(map(_seconds, followed)) < STEERING_RESPONSE.least_s:
        return NOT_FOLLOWED
    if len(followed) < len(found):
        at = _fitted(followed, at)
    return _told(followed, at)


def _told(found: Sequence[_Stretch], free: Array) -> SteeringResponse | str:
    """free: the fit without a limit."""
    limit, lowest = _limit(found, free)
    at = free if limit is None else limit
    covariance = _covariance(found, at)
    sds = np.sqrt(np.diag(covariance))
    dead_time, slow = float(at[0]), float(at[1])
    if dead_time > 0.99 * HIGH[0] or slow > 0.99 * HIGH[1]:
        return NOT_FOLLOWED
    if dead_time + 3.0 * float(sds[0]) < 0.0 or dead_time + slow < STEERING_RESPONSE.at_once_s:
        return AFTERWARDS
    if WITHIN * float(max(sds[0], sds[1])) > STEERING_RESPONSE.told_s:
        return TOO_GENTLE
    if limit is not None:
        rate, rate_sd = float(at[4]), float(sds[4])
    else:
        slope = _slopes(lambda x: np.array([_fastest(found, x)]), at)[0]
        fastest = _fastest(found, at)
        apart = (fastest - lowest) / 2  # a limit may be there that shows too little
        rate, rate_sd = fastest - apart, math.hypot(math.sqrt(float(slope @ covariance @ slope)), apart)
    return SteeringResponse(
        dead_time, float(sds[0]), slow, float(sds[1]), rate, rate_sd, limit is not None, float(at[2]),
        sum(map(_seconds, found)), _explained(found, at),
    )  # fmt: skip


def _stretches(orders: SteeringOrders, wheel_t: Array, wheel: Array) -> list[_Stretch]:
    breaks = np.flatnonzero(
        (np.diff(orders.t) > STEERING_RESPONSE.silent_s) | np.diff(orders.steers.astype(np.int8)).astype(bool)
    )
    edges = [0, *(breaks + 1).tolist(), len(orders.t)]
    found = list[_Stretch]()
    for first, end in pairwise(edges):
        if not orders.steers[first]:
            continue
        t, u = orders.t[first:end], orders.angle[first:end]
        heard = (wheel_t > t[0]) & (wheel_t < t[-1] + STEERING_RESPONSE.apart_s)
        gaps = np.flatnonzero(np.diff(wheel_t[heard]) > STEERING_RESPONSE.silent_s) + 1
        for at, y in zip(np.split(wheel_t[heard], gaps), np.split(wheel[heard], gaps), strict=True):
            found += _stretch(t, u, at, y)
    return found


def _stretch(t: Array, u: Array, at: Array, y: Array) -> list[_Stretch]:
    """None or one. t, u: commands. at, y: wheel angles, without gaps."""
    if len(at) < 2:
        return []
    begins = max(float(at[0]) + STEERING_RESPONSE.begins_s, float(t[0]) + STEERING_RESPONSE.most_dead_time_s)
    used = (at >= begins) & (at <= float(t[-1]) - STEERING_RESPONSE.most_early_s)
    if np.count_nonzero(used) < 2:
        return []
    near = np.abs(at - begins) <= STEERING_RESPONSE.begins_s  # of a slow sensor none may be
    y0 = float(np.mean(y[near])) if near.any() else float(np.interp(begins, at, y))
    at_used, y_used = at[used] - begins, y[used]
    step = max(round(STEERING_RESPONSE.apart_s / max(float(np.median(np.diff(at_used))), 1e-6)), 1)
    one = _Stretch(t - begins, u, at_used[::step], y_used[::step], y0)
    return [one] if _seconds(one) >= STEERING_RESPONSE.shortest_s else []


def _seconds(one: _Stretch) -> float:
    return float(one.t[-1] - one.t[0]) if len(one.t) else 0.0


def _response(one: _Stretch, at: Array) -> tuple[Array, float]:
    """(wheel angles at one.t, (n,); largest rate, rad/s). at: L, T, g, z and R, if there is a limit.

    Exact: between two commands they turn at the limit until what is missing is T R, and then exponentially.
    """
    dead_time, slow, gain, zero = at[:4].tolist()
    limit = float(at[4]) if len(at) > 4 else math.inf
    first = max(int(np.searchsorted(one.order_t, -dead_time, "right")) - 1, 0)
    starts = np.maximum(one.order_t[first:] + dead_time, 0.0)
    wanted = zero + gain * one.order[first:]
    missing, y, near = np.empty(len(starts)), one.y0, slow * limit
    for i, (target, lasts) in enumerate(zip(wanted.tolist(), [*np.diff(starts).tolist(), 0.0], strict=True)):
        e = y - target
        missing[i] = e
        size = abs(e)
        if size > near:
            until = (size - near) / limit
            size = size - limit * lasts if lasts < until else near * math.exp((until - lasts) / slow)
        else:
            size *= math.exp(-lasts / slow)
        y = target + math.copysign(size, e)
    k = np.maximum(np.searchsorted(starts, one.t, "right") - 1, 0)
    since, sizes = one.t - starts[k], np.abs(missing[k])
    left = np.minimum(sizes, near) * np.exp(-since / slow)
    if math.isfinite(limit):
        ends = np.maximum((sizes - near) / limit, 0.0)  # of turning at the limit
        left = np.minimum(sizes, near) * np.exp(-np.maximum(since - ends, 0.0) / slow)
        left = np.where(since < ends, sizes - limit * since, left)
    fastest = min(float(np.max(np.abs(missing))) / slow, limit)
    return wanted[k] + np.copysign(left, missing[k]), fastest


def _left(found: Sequence[_Stretch], at: Array) -> Array:
    return np.concatenate([_response(one, at)[0] - one.y for one in found])


def _fastest(found: Sequence[_Stretch], at: Array) -> float:
    return max(_response(one, at)[1] for one in found)


def _explained(found: Sequence[_Stretch], at: Array) -> float:
    whole = sum(float(np.sum((one.y - np.mean(one.y)) ** 2)) for one in found)
    return 1.0 - float(np.sum(_left(found, at) ** 2)) / max(whole, 1e-12)


def _start(found: Sequence[_Stretch]) -> Array:
    """L, T, g and z, coarsely."""
    y = np.concatenate([one.y for one in found])
    best, least = np.array([0.1, 0.3, 1.0, 0.0]), math.inf
    for dead_time in STEERING_RESPONSE.dead_times:
        for slow in STEERING_RESPONSE.slow_times:
            plain = np.array([dead_time, slow, 1.0, 0.0])
            shape = np.concatenate(
                [_response(replace(one, y0=float(one.order[0])), plain)[0] for one in found]
            )
            design = np.column_stack([shape, np.ones(len(y))])
            told = np.linalg.lstsq(design, y, rcond=None)[0]
            size = float(np.sum((design @ told - y) ** 2))
            if size < least:
                best, least = np.array([dead_time, slow, *told.tolist()]), size
    return best


def _fitted(
    found: Sequence[_Stretch], start: Array, limit: Array = NO_LIMIT, lasting: Array = NO_LIMIT
) -> Array:
    """What start has of L, T, g, z and R. limit: (1,) or (0,), R if held. lasting: of `_whitened`."""
    n = len(start)
    low, high = np.array(LOW[:n]), np.array(HIGH[:n])

    def left(at: Array) -> Array:
        return _whitened(found, _left(found, np.append(at, limit)), lasting)

    jac: Any = lambda at: _slopes(left, at)  # scipy's types know its names only  # noqa: E731
    made = least_squares(
        left, np.clip(start, low + 2e-3, high - 2e-3), jac, (low, high),
        x_scale=np.array([0.05, 0.05, 0.1, 0.01, 0.1])[:n], max_nfev=60, xtol=1e-6, ftol=1e-7,
    )  # fmt: skip
    return np.asarray(made.x, np.float64)


def _slopes(of: Callable[[Array], Array], at: Array) -> Array:
    """Of a function of L, T, g, z and R, (m,), by them, (m, n), by differences."""
    steps = np.diag(STEERING_RESPONSE.steps[: len(at)])
    return np.column_stack([(of(at + step) - of(at - step)) / (2.0 * step.sum()) for step in steps])


def _limit(found: Sequence[_Stretch], free: Array) -> tuple[Array | None, float]:
    """(The fit with a limit, None where none shows; the lowest limit that cannot be excluded, rad/s).

    free: the fit without one. A limit that is held goes down from the fastest that this one turns. Noise that
    lasts would hide what a limit changes, so it is taken out of what is compared.
    """
    lasting = _lasting(found, _left(found, free))
    white = _fitted(found, free, lasting=lasting)
    fastest = lowest = _fastest(found, white)
    before = _whitened(found, _left(found, white), lasting)
    best, least = white, float(before @ before)
    per = least / len(before)
    for share in STEERING_RESPONSE.shares:
        limit = np.array([share * fastest])
        held = np.append(_fitted(found, white, limit, lasting), limit)
        left = _whitened(found, _left(found, held), lasting)
        if (size := float(left @ left)) < least:
            best, least = held, size
        if size < float(before @ before) + STEERING_RESPONSE.excluded * per:
            lowest = float(limit[0])
    if (float(before @ before) - least) * len(before) / least < STEERING_RESPONSE.limited:
        return None, lowest
    made = _fitted(found, best)
    return made if float(made[4]) < 0.99 * _fastest(found, made[:4]) else best, lowest


def _lasting(found: Sequence[_Stretch], left: Array) -> Array:
    """Weights, (`lags_seen`,), by which what is left goes on in the next sample."""
    rows = np.concatenate([_past(part) for part in _parts(found, left)])
    return np.asarray(np.linalg.lstsq(rows[:, 1:], rows[:, 0], rcond=None)[0], np.float64)


def _whitened(found: Sequence[_Stretch], left: Array, lasting: Array) -> Array:
    """What is left, (n,), without what goes on. lasting: (k,); each stretch loses its first k."""
    if not len(lasting):
        return left
    rows = np.concatenate([_past(part) for part in _parts(found, left)])
    return np.asarray(rows[:, 0] - rows[:, 1:] @ lasting, np.float64)


def _parts(found: Sequence[_Stretch], left: Array) -> list[Array]:
    return np.split(left, np.cumsum([len(one.t) for one in found])[:-1])


def _past(part: Array) -> Array:
    """Each sample and those before it, (n - `lags_seen`, `lags_seen` + 1)."""
    return np.lib.stride_tricks.sliding_window_view(part, STEERING_RESPONSE.lags_seen + 1)[:, ::-1]


def _blocks(found: Sequence[_Stretch]) -> NDArray[np.int64]:
    """Where blocks of about `block_s` begin, in all samples."""
    starts, before = list[int](), 0
    for one in found:
        count = max(int(_seconds(one) / STEERING_RESPONSE.block_s), 1)
        starts += [before + round(k * len(one.t) / count) for k in range(count)]
        before += len(one.t)
    return np.array(starts, np.int64)


def _covariance(found: Sequence[_Stretch], at: Array) -> Array:
    """By the jackknife that leaves out one block after the other, linearised, wide enough for few blocks."""
    jacobian, left, starts = _slopes(lambda x: _left(found, x), at), _left(found, at), _blocks(found)
    whole = jacobian.T @ jacobian
    ridge = np.diag(STEERING_RESPONSE.ridge * np.diag(whole))  # where one block alone tells a limit
    moved = np.array([
        np.linalg.solve(whole + ridge - part.T @ part, part.T @ rest)
        for part, rest in zip(np.split(jacobian, starts[1:]), np.split(left, starts[1:]), strict=True)
    ])  # fmt: skip
    blocks = len(starts)
    few = float(student.ppf(0.975, max(blocks - len(at), 1))) / WITHIN
    stamped = np.zeros((len(at), len(at)))
    stamped[[0, 1], [0, 1]] = STEERING_RESPONSE.stamped_s**2
    return np.asarray(few**2 * (blocks - 1) / blocks * (moved.T @ moved) + stamped, np.float64)
