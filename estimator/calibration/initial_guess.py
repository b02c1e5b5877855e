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
from tilth.schemas.machine import Machine

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

STRAIGHT: Final = 0.012  # rad/s
CRUISE: Final = 1.5  # m/s
FOLDED: Final = math.radians(20.0)  # articulation: less hardly tells hitch and drawbar apart
WEAVING: Final = 0.05  # rad/s: more than corrections along a row
MOVING: Final = 0.8  # m/s
LEAST_DRIVEN_S: Final = 60.0  # of moving: less tells nothing
SLOW: Final = 2.6  # m/s: below, slip is small
HARDLY: Final = 0.5  # sd of the wheel angle in slow driving over that in all of it: less is mostly noise
JUMPS: Final = math.radians(0.1)  # of the wheels between instants; 0.01 degrees are usual, 0.5 by wrong bytes
SMOOTH: Final = 5  # instants: 1 s, over which headings are differentiated
NOISE_M: Final = 0.01  # of a position
LAGS: Final = range(4)  # instants by which the tractor may turn after its wheels
WHEEL_DELAY_S: Final = np.arange(-0.25, 0.2501, 0.01)  # that are tried
RELAXATIONS_M: Final = (0.0, 0.3, 0.7, 1.1, 1.6)  # that are tried with each, of the yaw rate behind the wheel
USUAL: Final = ((0.0, 0.1), (0.8, 0.4))  # s and m, with their sds, of both: they look much alike
UNUSUAL: Final = 0.03  # share by which one sd from what is usual makes a fit worse
SLOW_M, SLOW_S = 0.01, 60.0  # errors of positions that last: how large, how long
IDENTIFIED_DELAY_SD: Final = 0.01  # s: sd of how much later one is than another, from which on it is used
DELAY_SD: Final = 0.05  # s, of the same where a drive does not tell it
HITCH_BLOCK: Final = 400  # rows that may err together: 40 s of two coordinates


@dataclass(frozen=True, slots=True)
class Pairs:
    """Both bodies by their pairs of receivers. Bodies tractor first."""

    t: Array  # s, (n,)
    heading: Array  # rad, (n, 2), not wrapped; by the places of the file
    middle: Array  # m north and east, of the points on the ground below the middles, (n, 2, 2)
    along: Array  # m/s, of the middles, (n, 2)
    across: Array  # m/s, to the right, (n, 2)
    rate: Array  # rad/s, of the headings, (n, 2)
    lengths: Array  # m, of the pairs, (n, 2)
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
    along, across, lengths = (np.full((len(drive.t), 2), np.nan) for _ in range(3))
    for body, (front, rear) in enumerate(((0, 1), (2, 3))):
        pair = [by_mount[MOUNTS[k]] for k in (front, rear)]
        arm = np.subtract(pair[0].position[:2], pair[1].position[:2])
        apart = at[:, front] - at[:, rear]
        lengths[:, body] = np.hypot(apart[:, 0], apart[:, 1])
        psi = np.arctan2(apart[:, 1], apart[:, 0]) - np.arctan2(arm[1], arm[0])
        good = np.isfinite(psi)
        psi[good] = np.unwrap(psi[good])
        heading[:, body] = psi
        ahead = np.column_stack([np.cos(psi), np.sin(psi)])
        right = np.column_stack([-np.sin(psi), np.cos(psi)])
        heights = [0.0 if r.roll_corrected else r.position[2] for r in pair]
        lean, back = (float(np.mean(heights)) * np.sin(tilt[:, body]) for tilt in (roll, pitch))
        middle[:, body] = at[:, [front, rear]].mean(axis=1) - lean[:, None] * right + back[:, None] * ahead
        velocity = moving[:, [front, rear]].mean(axis=1)
        along[:, body] = velocity[:, 0] * np.cos(psi) + velocity[:, 1] * np.sin(psi)
        across[:, body] = (velocity * right).sum(axis=1)
    return Pairs(
        drive.t, heading, middle, along, across, _rate(heading), lengths, drive.wheel, drive.yaw_rate
    )


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
    """Slope of a line through SMOOTH instants, not a number where one of them is none."""
    half = SMOOTH // 2
    weights = np.arange(-half, half + 1) / (DRIVE.step_s * np.sum(np.arange(-half, half + 1) ** 2.0))
    found = np.full(heading.shape, np.nan)
    if len(heading) > 2 * half:
        windows = np.lib.stride_tricks.sliding_window_view(heading, SMOOTH, axis=0)
        found[half:-half] = windows @ weights
    return found


def latency_differences(drive: DriveGrid, view: Pairs) -> tuple[Array, Array]:
    """By how much each receiver is later than the mean of its body's, s, (4,), and the sds of how much later
    one of a pair is than the other, s, (2,): so much longer is the pair the faster it drives. In turns, too:
    along a body all points are equally fast, but for what stands aside. What is not told is 0."""
    delay, sds = np.zeros(4), np.full(2, DELAY_SD)
    for body, (front, rear) in enumerate(((0, 1), (2, 3))):
        rows = view.known & np.isfinite(drive.at[:, [front, rear]]).all((1, 2))
        u = view.along[rows, body]
        ahead = np.column_stack([np.cos(view.heading[rows, body]), np.sin(view.heading[rows, body])])
        apart = ((drive.at[rows, front] - drive.at[rows, rear]) * ahead).sum(axis=1)
        found = solve(np.column_stack([np.ones(len(u)), -u]), apart, np.array([30.0, 0.15]), NOISE_M)
        sd = math.hypot(float(found.sds[1]), _slow_error(u))
        if sd < IDENTIFIED_DELAY_SD:
            delay[front], delay[rear], sds[body] = found.value[1] / 2, -found.value[1] / 2, sd
    return delay, sds


def _slow_error(u: Array) -> float:
    """Sd, s, of what is late by positions at speeds u, m/s, (n,), from errors of positions that last. At one
    speed they are all that there is: what is late moves a receiver by one distance."""
    spread = float(np.std(u)) if len(u) else 0.0
    return SLOW_M / max(spread, 1e-6) / math.sqrt(max(len(u) * DRIVE.step_s / SLOW_S, 1.0))


def hitch(view: Pairs) -> Solved:
    """(forward, right) of the hitch from the tractor's middle and from the implement's, m, and by how much
    the implement's receivers are later than the tractor's, s: (5,). p_t + R_t h_t = p_i + R_i h_i."""
    rows = view.known
    rows = rows & np.isfinite(view.middle).all((1, 2))
    apart = view.middle[rows, 1] - view.middle[rows, 0]
    psi, u = view.heading[rows], view.along[rows, 1]
    blocks = []
    for axis in range(2):
        forward, right = (np.cos, np.sin)[axis], (lambda a: -np.sin(a), np.cos)[axis]
        columns = [forward(psi[:, 0]), right(psi[:, 0]), -forward(psi[:, 1]), -right(psi[:, 1])]
        blocks.append(np.column_stack([*columns, -u * forward(psi[:, 1])]))
    design = np.stack(blocks, axis=1).reshape(-1, 5)
    found = solve(design, apart.reshape(-1), np.array([6.0, 1.0, 10.0, 1.0, 0.15]), NOISE_M, HITCH_BLOCK)
    further = np.diag([0.0, 0.0, 0.0, 0.0, _slow_error(u) ** 2])
    return found._replace(covariance=found.covariance + further)


def crab(view: Pairs, body: int) -> Solved:
    """(heading by the pair less direction of travel, rad; m that the middle is ahead of the axle; slip; what
    gravity does along a plane's two slopes): (5,)."""
    rows = view.known & (view.along[:, body] > MOVING) & np.isfinite(view.rate[:, body])
    u, r = view.along[rows, body], view.rate[rows, body]
    psi = view.heading[rows, body]
    columns = [-u, r, -u * u * r, u * np.cos(psi), u * np.sin(psi)]
    prior = np.array([0.2, 3.0, 0.03, 0.02, 0.02])
    return solve(np.column_stack(columns), view.across[rows, body], prior, 0.02)


def wheel(view: Pairs, wheelbase: float, rate: Array) -> Solved:
    """(reading when straight, rad; reading over true angle; understeer, s^2/m times the gain): (3,).

    rate: rad/s, (n,), the tractor's. tan(true angle) = wheelbase r / u, and more where tyres slip.
    """
    rows = view.known & (view.along[:, 0] > MOVING) & np.isfinite(view.wheel) & np.isfinite(rate)
    u, r = view.along[rows, 0], rate[rows]
    design = np.column_stack([np.ones(len(u)), np.arctan(wheelbase * r / u), r * u])
    return solve(design, view.wheel[rows], np.array([0.5, 20.0, 0.05]), 0.002)


def wheel_by_the_way(view: Pairs, wheelbase: float, rate: Array) -> tuple[Solved, float]:
    """`wheel` and `explained`, with the wheel as much earlier as goes with the way best: weaving quickly, a
    tractor turns up to half a second after its wheels."""
    tried = []
    for delay in LAGS:
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
    rows = view.known & (view.along[:, 0] > MOVING) & np.isfinite(view.wheel) & np.isfinite(rate)
    slow = rows & (view.along[:, 0] < SLOW)
    still = np.std(view.wheel[slow]) < HARDLY * np.std(view.wheel[rows]) if slow.any() else True
    jumps = _jumps(view.wheel[rows]) > JUMPS * abs(float(found.value[1]))
    if np.count_nonzero(slow) > 200 and (jumps or not still):
        rows = slow
    if np.count_nonzero(rows) < 50:
        return 0.0
    u, r = view.along[rows, 0], rate[rows]
    design = np.column_stack([np.ones(len(u)), np.arctan(wheelbase * r / u), r * u])
    left = view.wheel[rows] - design @ found.value
    return 1.0 - float(np.var(left)) / max(float(np.var(view.wheel[rows])), 1e-12)


def _jumps(angle: Array) -> float:
    """How far an instant is usually from the middle between those beside it, rad."""
    if len(angle) < 3:
        return 0.0
    return float(np.median(np.abs(angle[1:-1] - (angle[:-2] + angle[2:]) / 2)))


def common_latency(view: Pairs, wheelbase: float, found: Solved) -> float:
    """By how much the yaw rate by positions is later than the wheel says, s: the best of WHEEL_DELAY_S. Tyres
    that build up their force over a way are tried with it: what is late grows less with speed."""
    rows = view.known & (view.along[:, 0] > MOVING) & np.isfinite(view.rate[:, 0]) & np.isfinite(view.wheel)
    if np.count_nonzero(rows) < 50:
        return 0.0
    good = np.isfinite(view.wheel)
    t, u, r = view.t[rows], view.along[rows, 0], view.rate[rows, 0]
    zero, gain, under = found.value
    best = (math.inf, 0.0)
    for relaxation in RELAXATIONS_M:
        for delay in WHEEL_DELAY_S:
            then = t - delay - relaxation / u
            angle = (np.interp(then, view.t[good], view.wheel[good]) - zero) / gain
            left = np.tan(angle) * u / (wheelbase + under / gain * u * u) - r
            away = sum(
                ((x - m) / sd) ** 2 for x, (m, sd) in zip((float(delay), relaxation), USUAL, strict=True)
            )
            size = float(np.mean(np.abs(left[SMOOTH:-SMOOTH]))) * (1.0 + UNUSUAL * away)
            best = min(best, (size, float(delay)))
    return best[1]


@dataclass(frozen=True, slots=True)
class DrivingCoverage:
    """How much of what is needed was driven, s."""

    directions: Array = field(default_factory=lambda: np.zeros(8))  # straight driving, by eighths of north
    left: float = 0.0  # turning
    right: float = 0.0
    folded: float = 0.0  # articulation beyond FOLDED
    weaved: float = 0.0  # with the wheels turned, faster than SLOW


def coverage(view: Pairs) -> DrivingCoverage:
    """Of a drive."""
    known, u = view.known, view.along[:, 0]
    rate = np.nan_to_num(view.rate[:, 0])
    straight = known & (np.abs(rate) < STRAIGHT) & (u > CRUISE)
    eighths = np.floor(view.heading[straight, 0] / (2 * np.pi) * 8).astype(np.int64) % 8
    folded = np.abs(np.nan_to_num(view.heading[:, 0] - view.heading[:, 1])) > FOLDED
    return DrivingCoverage(
        np.bincount(eighths, minlength=8).astype(np.float64) * DRIVE.step_s,
        float(np.count_nonzero(known & (rate < -0.05) & (u > MOVING))) * DRIVE.step_s,
        float(np.count_nonzero(known & (rate > 0.05) & (u > MOVING))) * DRIVE.step_s,
        float(np.count_nonzero(known & folded)) * DRIVE.step_s,
        float(np.count_nonzero(known & (np.abs(rate) > WEAVING) & (u > SLOW))) * DRIVE.step_s,
    )
