"""What must be so before a run begins: speed reached and steady, straight, room ahead, receivers well."""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

from tilth.client.experiment.sight import FieldPlace, Seen, room_left
from tilth.estimator.models.planned_run import Way
from tilth.schemas.experiment import AnyRun, ExperimentPlan

STEADY_S: Final = 2.0  # so long
SPEED_SHARE: Final = 0.07  # of the speed wanted, at least SPEED_LEAST
SPEED_LEAST: Final = 0.25  # m/s
WANDER: Final = 0.5  # m/s, largest less smallest within STEADY_S
BEND: Final = 0.008  # 1/m: of 125 m radius
FRESH_S: Final = 1.0  # a pose older than that says nothing
SLOWEST_SHARE: Final = 0.75  # of the speed wanted, in a run
FASTEST_SHARE: Final = 1.25


class Condition(NamedTuple):
    """One of them, in words that say what is and what is wanted."""

    name: str
    met: bool
    text: str


def of(
    track: Sequence[Seen], now_s: float, run: AnyRun, way: Way, plan: ExperimentPlan,
    place: FieldPlace | None, slack: float = 0.0,
) -> tuple[Condition, ...]:  # fmt: skip
    """track: poses lately, the last one now. slack: m of room that may be missing."""
    if not track or now_s - track[-1].t_s > FRESH_S:
        return (Condition("receivers", False, "no pose is heard"),)
    now = track[-1]
    lately, long = _lately(track)
    return (
        Condition("receivers", not now.trouble, now.trouble or "receivers are well"),
        _speed(lately, run, long),
        _straight(drives_straight(track)),
        _room(now, run, way, plan, place, slack),
    )


def _speed(lately: Sequence[Seen], run: AnyRun, long: bool) -> Condition:
    speeds = [one.speed for one in lately]
    near = abs(speeds[-1] - run.speed) <= max(SPEED_SHARE * run.speed, SPEED_LEAST)
    steady = max(speeds) - min(speeds) <= WANDER
    kmh = f"{3.6 * speeds[-1]:.1f} of {3.6 * run.speed:.1f} km/h"
    met = near and steady and long
    return Condition("speed", met, kmh if met else f"{kmh}: hold this speed")


def _lately(track: Sequence[Seen]) -> tuple[list[Seen], bool]:
    """Poses within STEADY_S, and whether they are as long."""
    now = track[-1]
    return [one for one in track if now.t_s - one.t_s <= STEADY_S], now.t_s - track[0].t_s >= STEADY_S - 0.3


def drives_straight(track: Sequence[Seen]) -> bool:
    """For STEADY_S, or stands."""
    lately, long = _lately(track)
    return long and max(abs(one.yaw_rate) / max(one.speed, 0.5) for one in lately) <= BEND


def _straight(straight: bool) -> Condition:
    return Condition("straight", straight, "straight" if straight else "drive straight")


def _room(
    now: Seen, run: AnyRun, way: Way, plan: ExperimentPlan, place: FieldPlace | None, slack: float
) -> Condition:
    if place is None:
        return Condition("room", True, "the field will begin where you arm this run")
    lead, turning = max(now.speed, 0.0) * (plan.countdown_s + 1.0), run.kind == "turn"
    left = room_left(plan.field, place, now, way.ahead + lead, way.lateral_offset, turning)
    if math.isnan(left):
        return Condition("room", False, "where the tractor stands is not known")
    if left < -slack:
        text = f"{-left:.0f} m of room are missing: turn round, or start further back"
        if room_left(plan.field, place, now, way.ahead + lead - left, way.lateral_offset, turning) >= 0.0:
            text = f"drive on for {-left:.0f} m, past the headland"
        return Condition("room", False, text)
    return Condition("room", True, f"room ahead, {max(left, 0.0):.0f} m to spare")


def speed_fault(speed: float, wanted: float) -> str:
    """Why a run cannot go on at this speed, "" where it can."""
    if not speed >= SLOWEST_SHARE * wanted:
        return f"only {3.6 * speed:.1f} km/h, the run is driven at {3.6 * wanted:.1f}"
    if speed > FASTEST_SHARE * wanted:
        return f"{3.6 * speed:.1f} km/h, the run is driven at {3.6 * wanted:.1f}"
    return ""
