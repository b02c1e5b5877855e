"""Readings that stand still although the rig moves as it could not with them: the sensor has failed.

A reading that repeats proves nothing by itself: on a straight line the wheels stand still, and a coarse
sensor says the same for seconds. So a run of equal readings is compared with what the rig did in it, as
others measure it: the wheels' angle with the path's, a turn rate with the heading, a velocity with heading
and speed, a reported heading with the turn rate, a roll with the acceleration in a turn.
"""

import math
from dataclasses import dataclass, field
from typing import Final

from tilth.estimator.driving import DRIVING
from tilth.estimator.pose.aligner import ALIGNMENT, Aligner
from tilth.estimator.pose.screen import SensorScreen
from tilth.estimator.rig.geometry import wrap
from tilth.estimator.rig.residuals import path_angle
from tilth.estimator.tuning import tuned
from tilth.schemas.flow import Flag, FlagKind, Pose
from tilth.schemas.notices import Notice, NoticeCode, notice

STANDS: Final = FlagKind.STANDS_STILL


@dataclass(frozen=True, slots=True)
class StandingTuning:
    """What contradicts a reading that stands still."""

    most_poses: int = tuned(50, "poses", "that are compared, 10 s")
    settled_m: float = tuned(5.0, "m", "driven after the wheels stand, until the path no longer changes")
    settled_ns: int = tuned(1_000_000_000, "ns", "that must have passed as well")
    """Half of both where a run is unusual for the sensor."""
    least_path_angle: float = tuned(math.radians(2.5), "rad", "of the path, contradicts wheels that stand")
    slip_share: float = tuned(0.35, "1", "of an angle, by which slip changes it with speed, ground and slope")
    smoothing: int = tuned(3, "poses", "in a mean of the path's angle")
    least_turn: float = tuned(0.1, "rad", "between a heading and another measure of it")
    least_change: float = tuned(0.3, "m/s", "of the rig's speed")
    least_lean: float = tuned(0.8, "m/s^2", "lateral, at which every body leans by a tenth of a degree")


STANDING: Final = StandingTuning()


@dataclass(frozen=True, slots=True)
class MotionAtPose:
    """What the rig did at a pose."""

    t_ns: int
    speed: float  # m/s
    way: float  # m, driven since the first of these poses
    path_angle: float  # rad, of wheels that would roll along the path without slip
    lateral: float  # m/s^2
    heading: tuple[float, float]  # of tractor and implement, rad, not wrapped; nan: unknown
    turned: tuple[float, float]  # integral of their turn rates since the first of these poses, rad


@dataclass(slots=True)
class StandingCheck:
    """State of the check."""

    poses: list[MotionAtPose] = field(default_factory=list)  # in a row, under way
    reported: list[str] = field(default_factory=list)  # names of the screens that are told to stand still


def observe(state: StandingCheck, aligner: Aligner, pose: Pose) -> list[tuple[str, Notice]]:
    """Take one pose. Returns (kind, notice) of what begins to stand still, or is over."""
    _add(state, aligner, pose)
    for name, screen in aligner.screens.by.items():
        if not screen.failed and screen.run > 1 and _contradicts(state.poses, name, screen):
            screen.failed = True
    failed = [name for name, screen in aligner.screens.by.items() if screen.failed]
    begun = [name for name in failed if name not in state.reported]
    over = [name for name in state.reported if name not in failed]
    state.reported = failed
    return [
        *((STANDS, stands_still(aligner, name, pose.t_ns)) for name in begun),
        *((STANDS, notice(NoticeCode.MOVES_AGAIN, **_subject(name))) for name in over),
    ]


def flags(state: StandingCheck) -> list[Flag]:
    """A flag for each sensor of which something stands still."""
    return sorted({Flag(STANDS, name.partition(" ")[0]) for name in state.reported})


def stands_still(aligner: Aligner, name: str, t_ns: int) -> Notice:
    """What stands still, and for how long."""
    still_s = (t_ns - aligner.screens.by[name].run_ns) * 1e-9
    return notice(NoticeCode.STANDS_STILL, **_subject(name), still_s=still_s)


def _subject(name: str) -> dict[str, str]:
    """Whose quantity the name of a screen is."""
    who, _, quantity = name.partition(" ")
    return {"of": who, "quantity": quantity}


def _add(state: StandingCheck, aligner: Aligner, pose: Pose) -> None:
    u, r = pose.tractor.forward_velocity, pose.tractor.yaw_rate
    if u is None or r is None or abs(u) < DRIVING.under_way:
        state.poses.clear()
        return
    before = state.poses[-1] if state.poses else None
    if before is not None and pose.t_ns - before.t_ns != ALIGNMENT.pose_ns:
        state.poses.clear()
        before = None
    seconds = ALIGNMENT.pose_ns * 1e-9 if before else 0.0
    rates = r, r if pose.implement.yaw_rate is None else pose.implement.yaw_rate
    headings = pose.tractor.heading, pose.implement.heading
    past = before or MotionAtPose(pose.t_ns, u, 0.0, 0.0, 0.0, (math.nan, math.nan), (0.0, 0.0))
    tractor, implement = headings
    turned = past.turned[0] + rates[0] * seconds, past.turned[1] + rates[1] * seconds
    state.poses.append(
        MotionAtPose(
            pose.t_ns, u, past.way + abs(u) * seconds,
            path_angle(aligner.machine.tractor.wheelbase, u, r), u * r,
            (_unwrapped(tractor, past.heading[0]), _unwrapped(implement, past.heading[1])), turned,
        )
    )  # fmt: skip
    del state.poses[: -STANDING.most_poses]


def _unwrapped(heading: float | None, before: float) -> float:
    if heading is None:
        return math.nan
    return heading if math.isnan(before) else before + wrap(heading - before)


def _contradicts(poses: list[MotionAtPose], name: str, screen: SensorScreen) -> bool:
    """Whether the rig has moved, since a run of equal readings began, as it could not with them."""
    who, _, quantity = name.partition(" ")
    during = [pose for pose in poses if pose.t_ns >= screen.run_ns]
    if len(during) < STANDING.smoothing:
        return False
    body = int(who.startswith("implement"))
    match quantity:
        case "wheel_angle":
            return _path_left(during, screen)
        case "wheel_speed":
            return _range([pose.speed for pose in during]) > STANDING.least_change
        case "velocity":
            turned = _range([pose.heading[body] for pose in during]) > STANDING.least_turn
            return turned or _range([pose.speed for pose in during]) > STANDING.least_change
        case "yaw_rate":
            return _bend([pose.heading[body] for pose in during]) > STANDING.least_turn
        case "heading":
            return _range([pose.turned[body] for pose in during]) > STANDING.least_turn
        case "roll":  # a receiver that never measured it says 0 for ever
            return screen.stands and _range([pose.lateral for pose in during]) > STANDING.least_lean
    return False


def _path_left(during: list[MotionAtPose], screen: SensorScreen) -> bool:
    """Whether the path has changed by more than it does while the wheels stand still; of a sensor that never
    said the same for so long, also whether the path is not that of its reading."""
    first, share = during[0], 0.5 if screen.stands else 1.0
    settled = [
        pose.path_angle
        for pose in during
        if pose.way - first.way >= share * STANDING.settled_m
        and pose.t_ns - first.t_ns >= share * STANDING.settled_ns
    ]
    means = [
        sum(settled[k : k + STANDING.smoothing]) / STANDING.smoothing
        for k in range(len(settled) - STANDING.smoothing + 1)
    ]
    if not means:
        return False
    largest = max(abs(mean) for mean in means)
    off = _range(means)
    if screen.stands and screen.raw is not None:
        largest = max(largest, abs(screen.raw[0]))
        off = max(off, *(abs(mean - screen.raw[0]) for mean in means))
    return off > STANDING.least_path_angle + STANDING.slip_share * largest


def _bend(headings: list[float]) -> float:
    """How far headings are from a steady turn, which a reading that is off by a constant may show."""
    known = [heading for heading in headings if not math.isnan(heading)]
    steps = max(len(known) - 1, 1)
    return _range([heading - (known[-1] - known[0]) * k / steps for k, heading in enumerate(known)])


def _range(values: list[float]) -> float:
    known = [value for value in values if not math.isnan(value)]
    return max(known) - min(known) if known else 0.0
