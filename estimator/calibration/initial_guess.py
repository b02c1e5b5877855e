"""First values in closed form: where receivers stand, what the wheel says, how late all is.

No tyre is involved but in small terms. The likelihood (joint.py) starts here and gives the numbers; only what
it has no unknown for comes from here: roll zeros (roll.py), the length of each pair and what stands aside on
the tractor.
"""

import math
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.calibration.drive import DRIVE, MOUNTS, DriveGrid
from tilth.estimator.calibration.least_squares import Solved, solve
from tilth.estimator.driving import DRIVING
from tilth.estimator.rig.geometry import length, rotate, rotation
from tilth.estimator.rig.residuals import gap_by_place, pair_of, path_angle, sideways_slopes, wheel_slopes
from tilth.estimator.tuning import tuned
from tilth.schemas.machine import Machine

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class InitialGuessTuning:
    """What the first look at a drive takes for straight, slow or turned, and what it tries."""

    straight: float = tuned(0.012, "rad/s", "turn rates of straight driving")
    folded: float = tuned(math.radians(20.0), "rad", "of the hitch: less hardly tells it from the drawbar")
    weaving: float = tuned(0.05, "rad/s", "more than corrections along a row")
    moving: float = tuned(0.8, "m/s", "from here on paths tell of a drive")
    least_driven_s: float = tuned(60.0, "s", "of moving: less tells nothing")
    slow: float = tuned(2.6, "m/s", "below, slip is small")
    hardly: float = tuned(0.5, "1", "sd of the wheels in slow driving over all of it: less is mostly noise")
    jumps: float = tuned(math.radians(0.1), "rad", "between instants; 0.01° is usual, 0.5° by wrong bytes")
    smooth: int = tuned(5, "instants", "1 s, over which headings are differentiated")
    noise_m: float = tuned(0.01, "m", "of a position")
    lags: tuple[int, ...] = tuned((0, 1, 2, 3), "instants", "by which the tractor may turn after its wheels")
    wheel_delay_s: Array = tuned(np.arange(-0.25, 0.2501, 0.01), "s", "delays of the wheels that are tried")
    relaxations_m: tuple[float, ...] = tuned(
        (0.0, 0.3, 0.7, 1.1, 1.6), "m", "tried, of the yaw rate behind the wheel"
    )
    usual: tuple[tuple[float, float], tuple[float, float]] = tuned(
        ((0.0, 0.1), (0.8, 0.4)), "s, m", "delay and relaxation with their sds: they look much alike"
    )
    unusual: float = tuned(0.03, "1", "share by which one sd from what is usual makes a fit worse")
    slow_m: float = tuned(0.01, "m", "size of errors of positions that last")
    slow_s: float = tuned(60.0, "s", "how long they last")
    identified_delay_sd: float = tuned(0.01, "s", "sd of the delay between two, from which on it is used")
    delay_sd: float = tuned(0.05, "s", "of the same where a drive does not tell it")
    hitch_block: int = tuned(400, "rows", "that may err together: 40 s of two coordinates")


INITIAL_GUESS: Final = InitialGuessTuning()


@dataclass(frozen=True, slots=True)
class Pairs:
    """Both bodies by their pairs of receivers. Bodies tractor first."""

    t: Array  # s, (n,)
    heading: Array  # rad, (n, 2), not wrapped; by the places of the file
    middle: Array  # m north and east, of the points on the ground below the middles, (n, 2, 2)
    along: Array  # m/s, of the middles, (n, 2)
    across: Array  # m/s, to the right, (n, 2)
    rate: Array  # rad/s, of the headings, (n, 2)
    longer: Array  # m, of the pairs than by the places of the file, (n, 2)
    wheel: Array  # rad, (n,)
    gyro: Array  # rad/s, (n, 4)

    @property
    def known(self) -> Mask:
        """(n,): where both bodies are seen."""
        return np.asarray(np.isfinite(self.heading).all(1) & np.isfinite(self.along).all(1))


def seen(drive: DriveGrid, machine: Machine, roll: Array, delay: Array) -> Pairs:
    """roll: rad, (n, 2), of both bodies, 0 where unknown. delay: s, (4,), beyond the file's latencies."""
    by_mount = {r.mount: r for r in machine.receiver}
    pitch = np.column_stack([mean_of_known(drive.pitch[:, k : k + 2]) for k in (0, 2)])
    at = drive.at + drive.velocity * delay[:, None]
    moving = _later(drive, delay)
    heading, middle = np.full((len(drive.t), 2), np.nan), np.full((len(drive.t), 2, 2), np.nan)
    along, across, longer = (np.full((len(drive.t), 2), np.nan) for _ in range(3))
    for body, (front, rear) in enumerate(((0, 1), (2, 3))):
        pair = [by_mount[MOUNTS[k]] for k in (front, rear)]
        arms = [np.array(receiver.position) for receiver in pair]
        seen = pair_of(
            *((at[:, k, 0], at[:, k, 1]) for k in (front, rear)), *((arm[0], arm[1]) for arm in arms)
        )
        longer[:, body], psi = seen.excess, seen.heading
        good = np.isfinite(psi)
        psi[good] = np.unwrap(psi[good])
        heading[:, body] = psi
        ahead, right = np.moveaxis(rotation(psi), 2, 0)
        heights = [0.0 if r.roll_corrected else r.position[2] for r in pair]
        lean, back = (float(np.mean(heights)) * np.sin(tilt[:, body]) for tilt in (roll, pitch))
        middle[:, body] = at[:, [front, rear]].mean(axis=1) - lean[:, None] * right + back[:, None] * ahead
        velocity = moving[:, [front, rear]].mean(axis=1)
        along[:, body], across[:, body] = rotate((velocity[:, 0], velocity[:, 1]), -psi)
    return Pairs(drive.t, heading, middle, along, across, _rate(heading), longer, drive.wheel, drive.yaw_rate)


def mean_of_known(angles: Array) -> Array:
    """Of each row, 0 where nothing is known, (n,)."""
    known = np.isfinite(angles)
    return np.asarray(np.where(known, angles, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1))


def _later(drive: DriveGrid, delay: Array) -> Array:
    """Velocities of receivers that report so much later than the grid takes for granted, (n, 4, 2)."""
    found = drive.velocity.copy()
    for k, by in enumerate(delay):
        for axis in range(2):
            if len(drive.t):
                found[:, k, axis] = np.interp(drive.t + by, drive.t, drive.velocity[:, k, axis])
    return found


def _rate(heading: Array) -> Array:
    """Slope of a line through `smooth` instants, not a number where one of them is none."""
    half = INITIAL_GUESS.smooth // 2
    weights = np.arange(-half, half + 1) / (DRIVE.step_s * np.sum(np.arange(-half, half + 1) ** 2.0))
    found = np.full(heading.shape, np.nan)
    if len(heading) > 2 * half:
        windows = np.lib.stride_tricks.sliding_window_view(heading, INITIAL_GUESS.smooth, axis=0)
        found[half:-half] = windows @ weights
    return found


def latency_differences(drive: DriveGrid, view: Pairs) -> tuple[Array, Array]:
    """By how much each receiver is later than the mean of its body's, s, (4,), and the sds of how much later
    one of a pair is than the other, s, (2,): so much longer is the pair the faster it drives. In turns, too:
    along a body all points are equally fast, but for what stands aside. What is not told is 0."""
    delay, sds = np.zeros(4), np.full(2, INITIAL_GUESS.delay_sd)
    for body, (front, rear) in enumerate(((0, 1), (2, 3))):
        rows = view.known & np.isfinite(drive.at[:, [front, rear]]).all((1, 2))
        u = view.along[rows, body]
        north, east = (drive.at[rows, front] - drive.at[rows, rear]).T
        found = solve(
            np.column_stack([np.ones(len(u)), -u]),
            length((north, east)),
            np.array([30.0, 0.15]),
            INITIAL_GUESS.noise_m,
        )
        sd = math.hypot(float(found.sds[1]), _slow_error(u))
        if sd < INITIAL_GUESS.identified_delay_sd:
            delay[front], delay[rear], sds[body] = found.value[1] / 2, -found.value[1] / 2, sd
    return delay, sds


def _slow_error(u: Array) -> float:
    """Sd, s, of what is late by positions at speeds u, m/s, (n,), from errors of positions that last. At one
    speed they are all that there is: what is late moves a receiver by one distance."""
    spread = float(np.std(u)) if len(u) else 0.0
    return (
        INITIAL_GUESS.slow_m
        / max(spread, 1e-6)
        / math.sqrt(max(len(u) * DRIVE.step_s / INITIAL_GUESS.slow_s, 1.0))
    )


def hitch(view: Pairs) -> Solved:
    """(forward, right) of the hitch from the tractor's middle and from the implement's, m, and by how much
    the implement's receivers are later than the tractor's, s: (5,). p_t + R_t h_t = p_i + R_i h_i."""
    rows = view.known
    rows = rows & np.isfinite(view.middle).all((1, 2))
    apart = view.middle[rows, 1] - view.middle[rows, 0]
    psi, u = view.heading[rows], view.along[rows, 1]
    by_place = gap_by_place(psi[:, 0], psi[:, 1])
    delay = u[:, None] * by_place[:, :, 2]  # so far behind are the implement's points
    design = np.concatenate([by_place, delay[:, :, None]], axis=2).reshape(-1, 5)
    found = solve(
        design,
        apart.reshape(-1),
        np.array([6.0, 1.0, 10.0, 1.0, 0.15]),
        INITIAL_GUESS.noise_m,
        INITIAL_GUESS.hitch_block,
    )
    further = np.diag([0.0, 0.0, 0.0, 0.0, _slow_error(u) ** 2])
    return found._replace(covariance=found.covariance + further)


def crab(view: Pairs, body: int) -> Solved:
    """(heading by the pair less direction of travel, rad; m that the middle is ahead of the axle; slip; what
    gravity does along a plane's two slopes): (5,)."""
    rows = view.known & (view.along[:, body] > INITIAL_GUESS.moving) & np.isfinite(view.rate[:, body])
    u, r = view.along[rows, body], view.rate[rows, body]
    psi = view.heading[rows, body]
    slopes = sideways_slopes(u, r)
    columns = [-slopes[:, 0], slopes[:, 1], -u * u * r, u * np.cos(psi), u * np.sin(psi)]
    prior = np.array([0.2, 3.0, 0.03, 0.02, 0.02])
    return solve(np.column_stack(columns), view.across[rows, body], prior, 0.02)


def wheel(view: Pairs, wheelbase: float, rate: Array) -> Solved:
    """(reading when straight, rad; reading over true angle; understeer, s^2/m times the gain): (3,).

    rate: rad/s, (n,), the tractor's. tan(true angle) = wheelbase r / u, and more where tyres slip.
    """
    rows = _steered(view, rate)
    return solve(_of_wheel(view, wheelbase, rate, rows), view.wheel[rows], np.array([0.5, 20.0, 0.05]), 0.002)


def _steered(view: Pairs, rate: Array) -> Mask:
    """(n,): where the wheel angle can be compared with the path."""
    known = (
        view.known & (view.along[:, 0] > INITIAL_GUESS.moving) & np.isfinite(view.wheel) & np.isfinite(rate)
    )
    return np.asarray(known)


def _of_wheel(view: Pairs, wheelbase: float, rate: Array, rows: Mask) -> Array:
    """Slopes of the wheel angle over what `wheel` finds."""
    u, r = view.along[rows, 0], rate[rows]
    return wheel_slopes(path_angle(wheelbase, u, r), r * u)


def wheel_by_the_way(view: Pairs, wheelbase: float, rate: Array) -> tuple[Solved, float]:
    """`wheel` and `explained`, with the wheel as much earlier as goes with the way best: weaving quickly, a
    tractor turns up to half a second after its wheels."""
    tried = []
    for delay in INITIAL_GUESS.lags:
        then = np.concatenate([np.full(delay, np.nan), view.wheel[: len(view.wheel) - delay]])
        earlier = replace(view, wheel=then)
        found = wheel(earlier, wheelbase, rate)
        tried.append((found, explained(earlier, wheelbase, rate, found)))
    return max(tried, key=lambda one: one[1])


def explained(view: Pairs, wheelbase: float, rate: Array, found: Solved) -> float:
    """Share of the wheel angle's variance that the way explains; 0 without driving.

    In slow driving, where there is some in which the wheels are turned: on one circle they stand still, and
    only noise varies. Then in all driving, unless the reading jumps as one in the wrong byte order does: few
    angles go with the way by chance.
    """
    rows = _steered(view, rate)
    slow = rows & (view.along[:, 0] < INITIAL_GUESS.slow)
    still = np.std(view.wheel[slow]) < INITIAL_GUESS.hardly * np.std(view.wheel[rows]) if slow.any() else True
    jumps = _jumps(view.wheel[rows]) > INITIAL_GUESS.jumps * abs(float(found.value[1]))
    if np.count_nonzero(slow) > 200 and (jumps or not still):
        rows = slow
    if np.count_nonzero(rows) < 50:
        return 0.0
    left = view.wheel[rows] - _of_wheel(view, wheelbase, rate, rows) @ found.value
    return 1.0 - float(np.var(left)) / max(float(np.var(view.wheel[rows])), 1e-12)


def _jumps(angle: Array) -> float:
    """How far an instant is usually from the middle between those beside it, rad."""
    if len(angle) < 3:
        return 0.0
    return float(np.median(np.abs(angle[1:-1] - (angle[:-2] + angle[2:]) / 2)))


def common_latency(view: Pairs, wheelbase: float, found: Solved) -> float:
    """By how much the yaw rate by positions is later than the wheel says, s: the best of `wheel_delay_s`.
    Tyres that build up their force over a way are tried with it: what is late grows less with speed."""
    rows = (
        view.known
        & (view.along[:, 0] > INITIAL_GUESS.moving)
        & np.isfinite(view.rate[:, 0])
        & np.isfinite(view.wheel)
    )
    if np.count_nonzero(rows) < 50:
        return 0.0
    good = np.isfinite(view.wheel)
    t, u, r = view.t[rows], view.along[rows, 0], view.rate[rows, 0]
    zero, gain, under = found.value
    best = (math.inf, 0.0)
    for relaxation in INITIAL_GUESS.relaxations_m:
        for delay in INITIAL_GUESS.wheel_delay_s:
            then = t - delay - relaxation / u
            angle = (np.interp(then, view.t[good], view.wheel[good]) - zero) / gain
            left = np.tan(angle) * u / (wheelbase + under / gain * u * u) - r
            away = sum(
                ((x - m) / sd) ** 2
                for x, (m, sd) in zip((float(delay), relaxation), INITIAL_GUESS.usual, strict=True)
            )
            size = float(np.mean(np.abs(left[INITIAL_GUESS.smooth : -INITIAL_GUESS.smooth]))) * (
                1.0 + INITIAL_GUESS.unusual * away
            )
            best = min(best, (size, float(delay)))
    return best[1]


@dataclass(frozen=True, slots=True)
class DrivingCoverage:
    """How much of what is needed was driven, s."""

    directions: Array = field(default_factory=lambda: np.zeros(8))  # straight driving, by eighths of north
    left: float = 0.0  # turning
    right: float = 0.0
    folded: float = 0.0  # articulation beyond `folded`
    weaved: float = 0.0  # with the wheels turned, faster than `slow`


def coverage(view: Pairs) -> DrivingCoverage:
    """Of a drive."""
    known, u = view.known, view.along[:, 0]
    rate = np.nan_to_num(view.rate[:, 0])
    straight = known & (np.abs(rate) < INITIAL_GUESS.straight) & (u > DRIVING.cruise)
    eighths = np.floor(view.heading[straight, 0] / (2 * np.pi) * 8).astype(np.int64) % 8
    folded = np.abs(np.nan_to_num(view.heading[:, 0] - view.heading[:, 1])) > INITIAL_GUESS.folded
    return DrivingCoverage(
        np.bincount(eighths, minlength=8).astype(np.float64) * DRIVE.step_s,
        float(np.count_nonzero(known & (rate < -0.05) & (u > INITIAL_GUESS.moving))) * DRIVE.step_s,
        float(np.count_nonzero(known & (rate > 0.05) & (u > INITIAL_GUESS.moving))) * DRIVE.step_s,
        float(np.count_nonzero(known & folded)) * DRIVE.step_s,
        float(np.count_nonzero(known & (np.abs(rate) > INITIAL_GUESS.weaving) & (u > INITIAL_GUESS.slow)))
        * DRIVE.step_s,
    )
