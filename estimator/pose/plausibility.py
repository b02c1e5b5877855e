"""Do the positions fit the surveyed rig? Catches receivers that were swapped or moved.

Each arrangement of the receivers over the mounts is scored by how far the two baselines are off their
surveyed lengths and how far the two bodies miss each other at the hitch. Lengths alone would not see a front
and rear receiver exchanged on one body; the hitch does. A body with one receiver is scored by that one's
distance to the hitch of the other.

One instant shows gross errors only. Means over seconds show the small ones: baselines that stay too long or
too short, and a body that seems to travel sideways while it goes straight.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import permutations

from tilth.estimator.pose.geometry import Vector, rotate
from tilth.schemas.flow import Flag, FlagKind, Mount

MISFIT = 0.6  # m: above, the arrangement is doubted
SMEAR = 3.0  # and as many sd of what timing may still shift a point
PERSISTENCE = 3  # poses in a row before anything is said
MEMORY = 40.0  # poses (8 s) of the means
SETTLED = 60  # poses in a mean before it is believed
SOON = 15  # poses at the least
LASTING = 0.15  # m: a mean beyond is no survey's error
SIDEWAYS = 0.07  # rad: no slope of 5 degrees makes a body crab as much

PAIRS = ((Mount.TRACTOR_FRONT, Mount.TRACTOR_REAR), (Mount.IMPLEMENT_FRONT, Mount.IMPLEMENT_REAR))


@dataclass(slots=True)
class Mean:
    """Mean over the last MEMORY poses."""

    value: float = 0.0
    count: int = 0

    def add(self, value: float) -> None:
        self.count += 1
        self.value += (value - self.value) / min(self.count, MEMORY)

    def beyond(self, limit: float) -> bool:
        """Whether it is, for sure: what is far beyond needs fewer poses."""
        size = abs(self.value)
        return size > limit and self.count >= max(SOON, SETTLED * limit / size)


@dataclass(slots=True)
class Lasting:
    """What stays wrong by little: per body the baseline's excess (m) and the sideways course (rad)."""

    excess: list[Mean] = field(default_factory=lambda: [Mean(), Mean()])
    sideways: list[Mean] = field(default_factory=lambda: [Mean(), Mean()])
    parked: list[Mean] = field(default_factory=lambda: [Mean(), Mean(), Mean(), Mean()])
    """While the rig stands or creeps: both bodies' excess, and how far the tractor's hitch is ahead of the
    implement's and to its right, m."""

    def bodies(self, sd_timing: float) -> list[int]:
        """Indices of the bodies whose receivers are not where the survey says."""
        limit = LASTING + SMEAR * sd_timing
        return [i for i in (0, 1) if self.excess[i].beyond(limit) or self.sideways[i].beyond(SIDEWAYS)]


@dataclass(slots=True)
class Suspicion:
    """What has looked wrong for how many poses in a row."""

    verdict: tuple[Flag, ...] = ()
    streak: int = 0

    def judge(self, found: tuple[Flag, ...]) -> tuple[Flag, ...]:
        """The flags to raise, once the same finding has persisted."""
        self.streak = self.streak + 1 if found == self.verdict else 1
        self.verdict = found
        return found if self.streak >= PERSISTENCE else ()


def misfit(points: Mapping[Mount, Vector], levers: Mapping[Mount, Vector], c: float, d: float) -> float:
    """Root of the summed squares of baseline errors and hitch gap, m, of the mounts there are."""
    total = 0.0
    hitches: list[Vector | None] = []
    for (front, rear), to_hitch in zip(PAIRS, (-c, d), strict=True):
        if front not in points or rear not in points:
            hitches.append(None)
            continue
        north, east = points[front][0] - points[rear][0], points[front][1] - points[rear][1]
        forward, right = levers[front][0] - levers[rear][0], levers[front][1] - levers[rear][1]
        total += (math.hypot(north, east) - math.hypot(forward, right)) ** 2
        heading = math.atan2(east, north) - math.atan2(right, forward)
        middle = ((levers[front][0] + levers[rear][0]) / 2, (levers[front][1] + levers[rear][1]) / 2)
        arm = rotate((to_hitch - middle[0], -middle[1]), heading)
        hitches.append(
            (
                (points[front][0] + points[rear][0]) / 2 + arm[0],
                (points[front][1] + points[rear][1]) / 2 + arm[1],
            )
        )
    tractor, implement = hitches
    if tractor is not None and implement is not None:
        total += math.dist(tractor, implement) ** 2
    for hitch, pair, to_hitch in ((tractor, PAIRS[1], d), (implement, PAIRS[0], -c)):
        single = [mount for mount in pair if mount in points]
        if hitch is not None and len(single) == 1:
            surveyed = math.dist(levers[single[0]], (to_hitch, 0.0))
            total += (math.dist(points[single[0]], hitch) - surveyed) ** 2
    return math.sqrt(total)


def examine(
    points: Mapping[Mount, Vector], levers: Mapping[Mount, Vector], c: float, d: float, sd_timing: float
) -> tuple[Flag, ...]:
    """Flags for one instant: none, all of kind SWAPPED, or all MOVED. sd_timing: of a point, m."""
    tolerance = MISFIT + SMEAR * sd_timing
    if misfit(points, levers, c, d) < tolerance:
        return ()
    mounts = list(points)
    best, arrangement = math.inf, mounts
    for order in permutations(mounts):
        score = misfit({m: points[o] for m, o in zip(mounts, order, strict=True)}, levers, c, d)
        if score < best:
            best, arrangement = score, list(order)
    if best < tolerance / 2:
        return tuple(
            Flag(FlagKind.SWAPPED, m.value) for m, o in zip(mounts, arrangement, strict=True) if m != o
        )
    return tuple(Flag(FlagKind.MOVED, m.value) for m in _culprits(points, levers, c, d, tolerance))


def _culprits(
    points: Mapping[Mount, Vector], levers: Mapping[Mount, Vector], c: float, d: float, tolerance: float
) -> list[Mount]:
    """The mounts whose absence mends the fit; all of them where none does alone."""
    mending = [
        m for m in points if misfit({k: v for k, v in points.items() if k != m}, levers, c, d) < tolerance
    ]
    # Without one receiver its body gives no hitch, so the other one of a wrong pair mends it as well.
    return mending or list(points)
