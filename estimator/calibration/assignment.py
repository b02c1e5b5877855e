"""Which receiver stands where: two on one rigid body keep their distance, the tractor goes ahead."""

from dataclasses import dataclass
from itertools import combinations
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.calibration.drive import MOUNTS, DriveGrid
from tilth.estimator.calibration.least_squares import solve
from tilth.estimator.tuning import tuned
from tilth.schemas.machine import Machine

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class AssignmentTuning:
    """Which receivers are on one body."""

    moving: float = tuned(0.8, "m/s", "from here on distances tell")
    clearly: float = tuned(1.7, "1", "times less rigid than the best another pairing must be")
    fewest: int = tuned(100, "instants", "20 s")
    distance_sd: Array = tuned(
        np.array([30.0, 0.5]), "m, s", "priors of the distance and the difference of latency of two receivers"
    )


ASSIGNMENT: Final = AssignmentTuning()

PAIRINGS: Final = (((0, 1), (2, 3)), ((0, 2), (1, 3)), ((0, 3), (1, 2)))


class MotionAssignment(NamedTuple):
    """Where receivers stand by their motion."""

    assignment: tuple[int, ...]  # receiver of the file at each place
    sure: bool  # whether the drive tells it; else as the file says
    reason: str  # why not


def assign(drive: DriveGrid, machine: Machine) -> MotionAssignment:
    """By distances and by who goes ahead."""
    same = (0, 1, 2, 3)
    moving = drive.complete & (_speed(drive) > ASSIGNMENT.moving)
    if np.count_nonzero(moving) < ASSIGNMENT.fewest:
        return MotionAssignment(
            same, False, "the four receivers were hardly heard together while the rig moved"
        )
    at, velocity = drive.at[moving], drive.velocity[moving]
    spread = {pair: _spread(at, velocity, pair) for pair in combinations(range(4), 2)}
    totals = [float(np.hypot(spread[a], spread[b])) for a, b in PAIRINGS]
    best = int(np.argmin(totals))
    others = [total for k, total in enumerate(totals) if k != best]
    if min(others) < ASSIGNMENT.clearly * totals[best]:
        return MotionAssignment(
            same, False, "without turns nobody can tell which two receivers are on one body"
        )
    ahead = velocity.mean(axis=1)
    ahead = ahead / np.linalg.norm(ahead, axis=1, keepdims=True)
    one, other = PAIRINGS[best]
    lead = ((at[:, one].mean(axis=1) - at[:, other].mean(axis=1)) * ahead).sum(axis=1)
    tractor, implement = (one, other) if np.median(lead) > 0.0 else (other, one)
    assignment = [*_turned(machine, at, ahead, tractor, 0), *_turned(machine, at, ahead, implement, 2)]
    return MotionAssignment(tuple(assignment), True, "")


def _speed(drive: DriveGrid) -> Array:
    mean = drive.velocity.mean(axis=1)
    return np.asarray(np.nan_to_num(np.hypot(mean[:, 0], mean[:, 1])), np.float64)


def _spread(at: Array, velocity: Array, pair: tuple[int, int]) -> float:
    """How far the distance of two receivers is not constant but for latency, m."""
    apart = at[:, pair[0]] - at[:, pair[1]]
    distance = np.hypot(apart[:, 0], apart[:, 1])
    closing = (apart * velocity[:, list(pair)].mean(axis=1)).sum(axis=1) / np.maximum(distance, 1e-3)
    design = np.column_stack([np.ones(len(distance)), closing])
    found = solve(design, distance, ASSIGNMENT.distance_sd, 0.003)
    left = distance - design @ found.value
    return float(np.sqrt(np.mean(np.minimum(left**2, (5.0 * found.sd) ** 2 + 1.0))))


def _turned(machine: Machine, at: Array, ahead: Array, pair: tuple[int, int], first: int) -> tuple[int, int]:
    """A body's receivers in the order of its places, front and rear."""
    by_mount = {r.mount: r.position for r in machine.receiver}
    arm = np.subtract(by_mount[MOUNTS[first]][:2], by_mount[MOUNTS[first + 1]][:2])
    apart = at[:, pair[0]] - at[:, pair[1]]
    right = np.column_stack([-ahead[:, 1], ahead[:, 0]])
    seen = np.median((apart * ahead).sum(axis=1)), np.median((apart * right).sum(axis=1))
    return pair if float(np.dot(arm, seen)) > 0.0 else (pair[1], pair[0])
