"""Do the positions fit the surveyed rig? Catches receivers that were swapped or moved.

Each arrangement of the receivers over the mounts is scored by how far the two baselines are off their
surveyed lengths and how far the two bodies miss each other at the hitch. Lengths alone would not see a front
and rear receiver exchanged on one body; the hitch does.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import permutations

from tilth.estimator.geometry import Vector, rotate
from tilth.schemas.flow import Mount

MISFIT = 0.6  # m: above, the arrangement is doubted
SMEAR = 3.0  # and as many sd of what timing may still shift a point
PERSISTENCE = 3  # poses in a row before anything is said

PAIRS = ((Mount.TRACTOR_FRONT, Mount.TRACTOR_REAR), (Mount.IMPLEMENT_FRONT, Mount.IMPLEMENT_REAR))


@dataclass(slots=True)
class Suspicion:
    """What has looked wrong for how many poses in a row."""

    verdict: tuple[str, ...] = ()
    streak: int = 0

    def judge(self, found: tuple[str, ...]) -> tuple[str, ...]:
        """The flags to raise, once the same finding has persisted."""
        self.streak = self.streak + 1 if found == self.verdict else 1
        self.verdict = found
        return found if self.streak >= PERSISTENCE else ()


def misfit(points: Mapping[Mount, Vector], levers: Mapping[Mount, Vector], c: float, d: float) -> float:
    """Root of the summed squares of baseline errors and hitch gap, m, of the mounts there are."""
    total = 0.0
    hitches: list[Vector] = []
    for (front, rear), to_hitch in zip(PAIRS, (-c, d), strict=True):
        if front not in points or rear not in points:
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
    if len(hitches) == 2:
        total += math.dist(*hitches) ** 2
    return math.sqrt(total)


def examine(
    points: Mapping[Mount, Vector], levers: Mapping[Mount, Vector], c: float, d: float, sd_timing: float
) -> tuple[str, ...]:
    """Flags for one instant: (), ("swapped:…", …) or ("moved:…", …). sd_timing: of a point, m."""
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
        return tuple(f"swapped:{m.value}" for m, o in zip(mounts, arrangement, strict=True) if m != o)
    return tuple(f"moved:{m.value}" for m in _culprits(points, levers, c, d, tolerance))


def _culprits(
    points: Mapping[Mount, Vector], levers: Mapping[Mount, Vector], c: float, d: float, tolerance: float
) -> list[Mount]:
    """The mounts whose absence mends the fit; all of them where none does alone."""
    mending = [
        m for m in points if misfit({k: v for k, v in points.items() if k != m}, levers, c, d) < tolerance
    ]
    # Without one receiver its body gives no hitch, so the other one of a wrong pair mends it as well.
    return mending or list(points)
