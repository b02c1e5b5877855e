"""Do the positions fit the surveyed rig? Finds receivers that were swapped or moved.

Each assignment of the receivers to the mounts has a score: the errors of the two baselines against their
surveyed lengths, and the distance between the hitch as seen from either body. Lengths alone would not show a
front and rear receiver exchanged on one body; the hitch does. For a body with one receiver, the score uses
the distance of this receiver to the hitch of the other body.

One instant shows gross errors only. Means over seconds show small ones: a baseline that stays too long or too
short, and a body that seems to move sideways (to crab) while it goes straight.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import permutations
from typing import Final

from tilth.estimator.once import once_for_a_machine
from tilth.estimator.rig.geometry import Vector
from tilth.estimator.rig.lifecycle import Persistence
from tilth.estimator.rig.residuals import pair_of, seen_hitch
from tilth.estimator.tuning import tuned
from tilth.schemas.flow import Flag, FlagKind, Mount
from tilth.schemas.machine import Machine


@dataclass(frozen=True, slots=True)
class PlausibilityTuning:
    """Which receivers are where the machine file has them."""

    misfit: float = tuned(0.6, "m", "largest score of a right assignment, at rest")
    smear: float = tuned(3.0, "sd", "of the timing error of a point, as a distance, that are added to it")
    persistence: int = tuned(3, "poses", "in a row before a flag is raised")
    memory: float = tuned(40.0, "poses", "8 s of the means")
    poses_to_decide: int = tuned(60, "poses", "in a mean just above its limit before it counts")
    least_poses: int = tuned(15, "poses", "but never fewer than these")
    largest_excess: float = tuned(0.15, "m", "a larger mean is no error of a survey, unless the file has one")
    least_limit: float = tuned(0.12, "m", "of the error of a pair's length, if `survey_sds` allow less")
    survey_sds: float = tuned(4.0, "sd", "of what the file says of survey and receivers")
    pitch: float = tuned(0.1, "rad", "by which a pair of unequal heights may be pitched")
    largest_crab_angle: float = tuned(0.07, "rad", "on a slope of 5° a body crabs by less")


PLAUSIBILITY: Final = PlausibilityTuning()


PAIRS = ((Mount.TRACTOR_FRONT, Mount.TRACTOR_REAR), (Mount.IMPLEMENT_FRONT, Mount.IMPLEMENT_REAR))


@dataclass(slots=True)
class Mean:
    """Mean over the last `memory` poses."""

    value: float = 0.0
    count: int = 0

    def add(self, value: float) -> None:
        self.count += 1
        self.value += (value - self.value) / min(self.count, PLAUSIBILITY.memory)

    def exceeds(self, limit: float) -> bool:
        """Whether its size is certainly above the limit; far above, fewer poses suffice."""
        size = abs(self.value)
        return size > limit and self.count >= max(
            PLAUSIBILITY.least_poses, PLAUSIBILITY.poses_to_decide * limit / size
        )


@dataclass(slots=True)
class LongTermMeans:
    """Means that show small lasting errors: of each body the baseline's excess, m, and the crab angle,
    rad."""

    excess: list[Mean] = field(default_factory=lambda: [Mean(), Mean()])
    crab_angle: list[Mean] = field(default_factory=lambda: [Mean(), Mean()])
    parked: list[Mean] = field(default_factory=lambda: [Mean(), Mean(), Mean(), Mean()])
    """While the rig stands or creeps, m: both bodies' excess, and how far the hitch as seen from the tractor
    is ahead and to the right of the hitch as seen from the implement."""

    def bodies(self, machine: Machine, sd_timing: float) -> list[int]:
        """Indices of the bodies whose receivers are not where the survey says."""
        return [
            i
            for i, limit in enumerate(pair_limits(machine))
            if self.excess[i].exceeds(
                max(PLAUSIBILITY.largest_excess, limit) + PLAUSIBILITY.smear * sd_timing
            )
            or self.crab_angle[i].exceeds(PLAUSIBILITY.largest_crab_angle)
        ]


@dataclass(slots=True)
class Suspicion:
    """The latest finding, and for how many poses in a row it has been the same."""

    verdict: tuple[Flag, ...] = ()
    same: Persistence = field(default_factory=Persistence)

    def judge(self, found: tuple[Flag, ...]) -> tuple[Flag, ...]:
        """Take the finding of one pose. Returns it if it has persisted, else ()."""
        if found != self.verdict:
            self.verdict, self.same = found, Persistence()
        self.same.look(True)
        return found if self.same.seen >= PLAUSIBILITY.persistence else ()


@once_for_a_machine
def pair_limits(machine: Machine) -> tuple[float, float]:
    """Largest error of the length of the tractor's and of the implement's pair that the file allows, m. Slow
    errors of positions are half of their noise."""
    limits = []
    for body in ("tractor", "implement"):
        pair = [r for r in machine.receiver if r.mount.body == body]
        sd = math.hypot(*(math.hypot(r.survey_sd, 0.5 * r.position_sd) for r in pair))
        heights = [r.position[2] for r in pair] or [0.0]
        limits.append(
            max(PLAUSIBILITY.least_limit, PLAUSIBILITY.survey_sds * sd)
            + PLAUSIBILITY.pitch * (max(heights) - min(heights))
        )
    return limits[0], limits[1]


def misfit(points: Mapping[Mount, Vector], levers: Mapping[Mount, Vector], c: float, d: float) -> float:
    """Score of an assignment, m: root of the sum of squares of baseline errors and hitch gap.

    points: north, east, m, of the mounts with a receiver; levers: forward, right, m. c, d: tractor's CG to
    the hitch, hitch to the implement's CG, m.
    """
    total = 0.0
    hitches: list[Vector | None] = []
    for (front, rear), to_hitch in zip(PAIRS, (-c, d), strict=True):
        if front not in points or rear not in points:
            hitches.append(None)
            continue
        ends = points[front], points[rear], levers[front], levers[rear]
        seen = pair_of(*ends)
        total += seen.excess**2
        hitches.append(seen_hitch(*ends, seen.heading, to_hitch))
    tractor, implement = hitches
    if tractor is not None and implement is not None:
        total += math.dist(tractor, implement) ** 2
    for hitch, pair, to_hitch in ((tractor, PAIRS[1], d), (implement, PAIRS[0], -c)):
        single = [mount for mount in pair if mount in points]
        if hitch is not None and len(single) == 1:
            surveyed = math.dist(levers[single[0]], (to_hitch, 0.0))
            total += (math.dist(points[single[0]], hitch) - surveyed) ** 2
    return math.sqrt(total)


def check_instant(
    points: Mapping[Mount, Vector], levers: Mapping[Mount, Vector], c: float, d: float, sd_timing: float
) -> tuple[Flag, ...]:
    """Flags of one instant: none, all SWAPPED, or all MOVED.

    sd_timing: sd of a point from timing errors, m. Others: as `misfit`.
    """
    tolerance = PLAUSIBILITY.misfit + PLAUSIBILITY.smear * sd_timing
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
    return tuple(Flag(FlagKind.MOVED, m.value) for m in _moved_mounts(points, levers, c, d, tolerance))


def _moved_mounts(
    points: Mapping[Mount, Vector], levers: Mapping[Mount, Vector], c: float, d: float, tolerance: float
) -> list[Mount]:
    """The mounts of which each one, when left out, makes the rest fit; all mounts if there is no such one."""
    sufficient = [
        m for m in points if misfit({k: v for k, v in points.items() if k != m}, levers, c, d) < tolerance
    ]
    # Without one receiver its body gives no hitch, so leaving out the other one of a wrong pair works as
    # well.
    return sufficient or list(points)
