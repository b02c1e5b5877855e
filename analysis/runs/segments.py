"""Finds what was driven in a run: steps, chirps, random steering, turns, headland turns, rows.

Found from poses alone: the wheel angle, how long it is held, how far the heading goes round. Standstill,
reversing and poses with receivers that do not fit are left out.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from tilth.analysis.runs.table import Table
from tilth.estimator.driving import DRIVING
from tilth.estimator.models.family import MODELS
from tilth.estimator.models.identifiability import DISTURBANCES, SENSOR_SETS, cramer_rao
from tilth.estimator.models.parameters import rig_of
from tilth.estimator.record.windows import WINDOWS
from tilth.schemas.flow import MISPLACED, PARAMETERS, WITHOUT_RTK
from tilth.schemas.machine import Machine
from tilth.schemas.spread import share

Floats = NDArray[np.float64]

STEP, STEADY_TURN, CHIRP, RANDOM, HEADLAND, TURN, ROW, MARKED, GIVEN = (
    "step", "steady_turn", "chirp", "random", "headland_turn", "turn", "row", "marked", "given",
)  # fmt: skip
KINDS: Final = (STEP, STEADY_TURN, CHIRP, RANDOM, HEADLAND, TURN, MARKED)  # that steer
LEAD_S: Final = 2.0  # of straight driving that belong to a segment before the wheels turn
QUIET_S: Final = 3.0  # and after
PAUSE_S: Final = 4.0  # wheels that are straight for less do not end a manoeuvre
LONGEST_GAP_S: Final = 0.5  # between poses
SHORTEST_S: Final = 6.0
SHORTEST_ROW_S: Final = 20.0
LONGEST_ROW_S: Final = 120.0  # a longer one is cut: its parts tell alike
HEADLAND_ANGLE: Final = math.radians(12.0)  # of the wheels
HEADLAND_HEADING: Final = math.radians(100.0)  # that the tractor goes round, net
HELD: Final = math.radians(1.0)  # an angle that stays within this of its median is held
HELD_SHARE: Final = 0.75  # of the time with turned wheels
SHORTEST_HOLD_S: Final = 1.5  # of a step among others
LONG_HOLD_S: Final = 40.0  # a longer hold is no step but a steady turn
LEAST_CROSSINGS: Final = 4  # of a chirp or of random steering
TRENDING: Final = 0.75  # rank correlation of the half periods of a chirp with time
TELLING: Final = 0.5  # largest sd of a logarithm that is worth telling, over the prior's


@dataclass(frozen=True, slots=True)
class DrivenSegment:
    """A stretch of driving. Times s since the run began."""

    kind: str  # step, steady_turn, chirp, random, headland_turn, turn, row, marked, given
    start_s: float
    end_s: float
    speed: float  # mean, m/s
    largest_angle: float  # of the wheels, rad, with its sign
    name: str = ""  # of a mark

    @property
    def seconds(self) -> float:
        return self.end_s - self.start_s

    @property
    def steers(self) -> bool:
        """Whether it has steering, as rows have not."""
        return self.kind != ROW


def find(poses: Table) -> tuple[DrivenSegment, ...]:
    """All segments in the order of time."""
    return tuple(
        sorted(
            (segment for rows in stretches(poses) for segment in _of_stretch(poses, rows)),
            key=lambda segment: segment.start_s,
        )
    )


def between(poses: Table, start_s: float, end_s: float, kind: str = GIVEN, name: str = "") -> DrivenSegment:
    """The segment of given times. Raises ValueError where the run has no poses there."""
    rows = np.flatnonzero((poses.t_s >= start_s) & (poses.t_s <= end_s))
    if rows.size < 2:
        last = f"; there are some from {poses.t_s[0]:.1f} to {poses.t_s[-1]:.1f} s" if poses.rows else ""
        raise ValueError(f"no poses between {start_s:g} and {end_s:g} s of the run{last}")
    return _segment(poses, rows, kind, start_s, end_s, name)


def marked(poses: Table, marks: Table) -> tuple[DrivenSegment, ...]:
    """Segments between operator marks "… start" and "… end" (or "stop"), of one name or without any.

    A run of an experiment that was disturbed, which a mark after it says, was driven again.
    """
    begun: dict[str, float] = {}
    found: list[DrivenSegment] = []
    for t_s, text in zip(marks.t_s.tolist(), marks["text"], strict=True):
        words = str(text).split()
        last = words[-1].lower() if words else ""
        name = " ".join(words[:-1])
        if last in ("start", "begin"):
            begun[name] = t_s
        elif last in ("end", "stop") and name in begun:
            try:
                found.append(between(poses, begun.pop(name), t_s, MARKED, name))
            except ValueError:
                continue
    texts = [str(text) for text in marks["text"]]
    spoilt = {one.name: (f"{one.name} disturbed (", f"{one.name} aborted (") for one in found}
    return tuple(one for one in found if not any(text.startswith(spoilt[one.name]) for text in texts))


def all_segments(poses: Table, marks: Table) -> tuple[DrivenSegment, ...]:
    """Those between operator marks, else all found. Wherever segments are numbered, it is by this order."""
    return marked(poses, marks) or find(poses)


def stretches(poses: Table) -> Iterator[NDArray[np.intp]]:
    """Rows of poses that follow each other, driven forward, with receivers that fit, for SHORTEST_S."""
    if not poses.rows:
        return
    unsound = {str(kind) for kind in (*MISPLACED, *WITHOUT_RTK)}
    flags = {
        text: any(flag.partition(":")[0] in unsound for flag in str(text).split(", "))
        for text in set(poses["flags"])
    }
    sound = np.array([not flags[text] for text in poses["flags"]])
    speed, angle = poses["tractor_forward_velocity_mps"], poses["wheel_angle_rad"]
    with np.errstate(invalid="ignore"):
        good = sound & (poses["direction"] == 1) & (speed >= DRIVING.under_way) & np.isfinite(angle)
    good &= np.isfinite(poses["tractor_yaw_rate_radps"]) & np.isfinite(poses["tractor_heading_rad"])
    breaks = np.flatnonzero(np.diff(poses.t_s) > LONGEST_GAP_S) + 1
    edges = np.flatnonzero(np.diff(good.astype(np.int8))) + 1
    for rows in np.split(np.arange(poses.rows), np.unique(np.concatenate([breaks, edges]))):
        if good[rows[0]] and poses.t_s[rows[-1]] - poses.t_s[rows[0]] >= SHORTEST_S:
            yield rows


def _of_stretch(poses: Table, rows: NDArray[np.intp]) -> Iterator[DrivenSegment]:
    t, angle = poses.t_s[rows], poses["wheel_angle_rad"][rows]
    turned = np.abs(angle - _zero(poses, rows)) > WINDOWS.turned
    for first, last in _active(t, turned):
        start = np.searchsorted(t, t[first] - LEAD_S)
        end = min(int(np.searchsorted(t, t[last] + QUIET_S)), len(t) - 1)
        if t[end] - t[start] >= SHORTEST_S:
            kind = _kind(poses, rows[first : last + 1], rows)
            yield _segment(poses, rows[start : end + 1], kind)
        turned[start : end + 1] = True
    for first, last in _runs_of(~turned):
        while t[last] - t[first] >= SHORTEST_ROW_S:
            end = min(int(np.searchsorted(t, t[first] + LONGEST_ROW_S)), last)
            yield _segment(poses, rows[first : end + 1], ROW)
            first = end


def _zero(poses: Table, rows: NDArray[np.intp]) -> float:
    """Reading of the wheel angle when the tractor drives straight, rad; 0 where it never does."""
    angle, speed = poses["wheel_angle_rad"][rows], poses["tractor_forward_velocity_mps"][rows]
    straight = np.abs(poses["tractor_yaw_rate_radps"][rows]) < 0.01 * speed
    return float(np.median(angle[straight])) if np.count_nonzero(straight) > 10 else 0.0


def _runs_of(chosen: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and last row of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], chosen, [False]]).astype(np.int8)))
    return [(int(a), int(b) - 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _active(t: Floats, turned: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and last row of each stretch of steering: wheels straight for less than PAUSE_S do not end it."""
    found: list[tuple[int, int]] = []
    for first, last in _runs_of(turned):
        if found and t[first] - t[found[-1][1]] < PAUSE_S:
            found[-1] = found[-1][0], last
        else:
            found.append((first, last))
    return found


def _kind(poses: Table, rows: NDArray[np.intp], stretch: NDArray[np.intp]) -> str:
    """What a stretch of steering is."""
    t = poses.t_s[rows]
    angle = poses["wheel_angle_rad"][rows] - _zero(poses, stretch)
    heading = np.unwrap(poses["tractor_heading_rad"][rows])
    halves = _half_periods(t, angle)
    middle = float(np.median(angle))
    held = float(np.mean(np.abs(angle - middle) < HELD))
    if len(halves) >= LEAST_CROSSINGS and _held(t, angle) < HELD_SHARE:
        trend = np.corrcoef(np.argsort(np.argsort(halves)), np.arange(len(halves)))[0, 1]
        return CHIRP if abs(trend) > TRENDING else RANDOM
    if len(halves) >= LEAST_CROSSINGS:  # steps to both sides, one after the other
        return STEP
    if held >= HELD_SHARE and abs(middle) > WINDOWS.turned:
        return STEADY_TURN if t[-1] - t[0] > LONG_HOLD_S else STEP
    if np.max(np.abs(angle)) > HEADLAND_ANGLE and abs(heading[-1] - heading[0]) > HEADLAND_HEADING:
        return HEADLAND
    return TURN


def _held(t: Floats, angle: Floats) -> float:
    """Share of the time in holds: SHORTEST_HOLD_S or longer, within HELD of their middle."""
    first, whole = 0, 0.0
    for k in range(1, len(t) + 1):
        if k < len(t) and np.ptp(angle[first : k + 1]) <= 2 * HELD:
            continue
        lasted = float(t[k - 1] - t[first])
        whole += lasted if lasted >= SHORTEST_HOLD_S else 0.0
        first = k
    return whole / max(float(t[-1] - t[0]), SHORTEST_HOLD_S)


def _half_periods(t: Floats, angle: Floats) -> Floats:
    """s between changes of the side to which the wheels are turned."""
    side = np.sign(angle) * (np.abs(angle) > WINDOWS.turned)
    rows = np.flatnonzero(side)
    crossings = rows[1:][np.diff(side[rows]) != 0]
    return np.diff(t[crossings]) if crossings.size > 1 else np.zeros(0)


def _segment(
    poses: Table, rows: NDArray[np.intp], kind: str,
    start_s: float | None = None, end_s: float | None = None, name: str = "",
) -> DrivenSegment:  # fmt: skip
    t = poses.t_s[rows]
    speed = poses["tractor_forward_velocity_mps"][rows]
    angle = poses["wheel_angle_rad"][rows]
    known = angle[np.isfinite(angle)]
    largest = float(known[np.argmax(np.abs(known))]) if known.size else 0.0
    mean = float(np.mean(speed[np.isfinite(speed)])) if np.any(np.isfinite(speed)) else 0.0
    begin, end = (float(t[0]) if start_s is None else start_s), (float(t[-1]) if end_s is None else end_s)
    return DrivenSegment(kind, begin, end, mean, largest, name)


def tells(segment: DrivenSegment, poses: Table, machine: Machine) -> tuple[str, ...]:
    """Which of the six the driving can tell, with the 95 % range that its steering allows at best.

    The Cramér-Rao bound of the linear model with relaxation at the machine file's values, with receivers of
    5 Hz and uneven ground; nuisances of the rig widen what a fit then gives.
    """
    there = poses.between(segment.start_s, segment.end_s)
    angle, t = there["wheel_angle_rad"], there.t_s
    known = np.isfinite(angle)
    if np.count_nonzero(known) < 3 or segment.speed < DRIVING.under_way or segment.kind == ROW:
        return ()  # of a row the bound is never near, and costs most as rows are long
    steps = np.arange(t[known][0], t[known][-1], _STEP_S)
    wheel: Floats = np.interp(steps, t[known], angle[known])
    found = cramer_rao(
        _MODEL, rig_of(machine), segment.speed, wheel, _STEP_S, SENSOR_SETS["positions_5hz"],
        names=PARAMETERS, disturbances=DISTURBANCES,
    )  # fmt: skip
    axles = (machine.tyres.front, machine.tyres.rear, machine.tyres.implement) * 2
    return tuple(
        f"{name} {share(sd)}"
        for name, sd, axle in zip(PARAMETERS, found.sd.tolist(), axles, strict=True)
        if sd < TELLING * axle.log_sd
    )


_STEP_S: Final = 0.02
_MODEL: Final[Any] = next(model for model in MODELS if model.name == "relaxation")
