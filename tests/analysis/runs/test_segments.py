"""What was driven, found from poses: each manoeuvre by its name, and nothing in standstill or reverse."""

import math

import numpy as np
import pytest
from logs import MACHINE
from numpy.typing import NDArray
from recorded import MARKS, marked, recorded, shared_cache

import tilth.analysis
from tilth.analysis.runs import segments
from tilth.analysis.runs.segments import DrivenSegment
from tilth.analysis.runs.table import Table
from tilth.estimator.models.manoeuvres import manoeuvre_named

Floats = NDArray[np.float64]
LEAD, TAIL = 8.0, 8.0
STEP_S = 0.2
BASE = 4.0  # m, of a kinematic rig: enough for headings


def poses(wheel_deg: Floats, speed: float = 4.5, flags: str = "") -> Table:
    """Poses of a rig that follows its front wheels, 5 Hz."""
    t = np.arange(len(wheel_deg)) * STEP_S
    angle = np.radians(wheel_deg)
    yaw_rate = speed / BASE * np.tan(angle)
    n = len(t)
    texts = np.full(n, flags, object)
    return Table(
        {
            "t_s": t, "utc_s": t, "flags": texts, "direction": np.full(n, 1 if speed > 0 else -1),
            "tractor_forward_velocity_mps": np.full(n, speed), "wheel_angle_rad": angle,
            "tractor_yaw_rate_radps": yaw_rate, "tractor_heading_rad": np.cumsum(yaw_rate) * STEP_S,
        }
    )  # fmt: skip


def within(seconds: float, angle: Floats) -> Floats:
    """A manoeuvre between straight driving; the angle is sampled over `seconds`."""
    count = round(seconds / STEP_S)
    sampled: Floats = np.interp(np.linspace(0.0, 1.0, count), np.linspace(0.0, 1.0, len(angle)), angle)
    return np.concatenate([np.zeros(round(LEAD / STEP_S)), sampled, np.zeros(round(TAIL / STEP_S))])


def of_manoeuvre(name: str, seconds: float, degrees: float) -> Floats:
    time = np.arange(round(seconds / 0.02), dtype=np.float64) * 0.02
    drawn = manoeuvre_named(name).wheel_angle(time, math.radians(degrees), np.random.default_rng(2))
    return np.asarray(np.degrees(within(seconds, drawn)), np.float64)


def of_steps(levels: list[float], hold_s: float, ramp_s: float = 1.0) -> Floats:
    """One level after the other, each held."""
    hold, ramp = round(hold_s / STEP_S), round(ramp_s / STEP_S)
    parts = [np.zeros(round(LEAD / STEP_S))]
    for level in (*levels, 0.0):
        parts += [np.linspace(parts[-1][-1], level, ramp + 1)[1:], np.full(hold, level)]
    return np.concatenate([*parts, np.zeros(round(TAIL / STEP_S))])


CASES: list[tuple[str, Floats, float]] = [
    (segments.STEP, of_steps([6.0, -6.0, 4.0, -4.0, 8.0, -8.0, 6.0], 5.0), 42.0),
    (segments.STEP, of_steps([6.0, -4.0, 3.0, -3.0, 8.0, -8.0], 3.0, 0.6), 21.6),
    (segments.STEP, within(25.0, np.full(9, 6.0)), 25.0),
    (segments.STEADY_TURN, within(60.0, np.full(9, 6.0)), 60.0),
    (segments.CHIRP, of_manoeuvre("chirp", 30.0, 6.0), 30.0),
    (segments.RANDOM, of_manoeuvre("random", 30.0, 9.0), 30.0),
    (segments.HEADLAND, within(16.0, 25.0 * np.sin(np.linspace(0.0, np.pi, 80))), 16.0),
    (segments.TURN, within(9.0, 5.0 * np.sin(np.linspace(0.0, np.pi, 45))), 9.0),
]


@pytest.mark.parametrize(
    ("kind", "wheel_deg", "seconds"), CASES, ids=[f"{case[0]}-{k}" for k, case in enumerate(CASES)]
)
def test_each_manoeuvre_is_found_by_its_name(kind: str, wheel_deg: Floats, seconds: float) -> None:
    steering = [segment for segment in segments.find(poses(wheel_deg)) if segment.steers]
    assert [segment.kind for segment in steering] == [kind]
    (found,) = steering
    assert found.start_s == pytest.approx(LEAD - segments.LEAD_S, abs=2.5)
    assert found.end_s == pytest.approx(LEAD + seconds + segments.QUIET_S, abs=3.5)
    assert abs(found.largest_angle) == pytest.approx(np.radians(np.abs(wheel_deg).max()), rel=1e-6)


def test_rows_are_found_and_cut() -> None:
    found = segments.find(poses(np.zeros(1500)))  # 300 s
    assert [segment.kind for segment in found] == [segments.ROW] * 3
    assert all(segment.seconds <= segments.LONGEST_ROW_S + STEP_S for segment in found)
    assert found[0].start_s == 0.0 and found[-1].end_s > 295.0


@pytest.mark.parametrize("speed", [0.0, 0.5, -2.0])
def test_standstill_creeping_and_reverse_are_left_out(speed: float) -> None:
    assert segments.find(poses(within(25.0, np.full(9, 6.0)), speed)) == ()


@pytest.mark.parametrize(("flags", "count"), [("no_rtk:tractor_front", 0), ("swapped:tractor_front", 0),
                                              ("heading_by_hitch:implement", 1)])  # fmt: skip
def test_receivers_that_do_not_fit_end_a_segment(flags: str, count: int) -> None:
    found = segments.find(poses(within(25.0, np.full(9, 6.0)), flags=flags))
    assert sum(segment.steers for segment in found) == count


def test_a_gap_parts_two_segments() -> None:
    table = poses(np.concatenate([within(15.0, np.full(9, 6.0))] * 2))
    kept = np.abs(table.t_s - 15.0) > 2.0
    starts = [segment.start_s for segment in segments.find(table.where(kept)) if segment.steers]
    assert len(starts) >= 2 and starts[1] > 17.0


def test_a_wheel_zero_is_no_steering() -> None:
    table = poses(np.zeros(300))
    offset = Table({**table.columns, "wheel_angle_rad": table["wheel_angle_rad"] + math.radians(2.5)})
    assert [segment.kind for segment in segments.find(offset)] == [segments.ROW]


def test_steps_of_a_recorded_drive() -> None:
    (run,) = tilth.analysis.open(recorded().parts)
    found = [segment for segment in segments.find(run.poses) if segment.steers]
    assert [segment.kind for segment in found] == [segments.STEP, segments.STEP]
    told = segments.tells(found[0], run.poses, MACHINE)
    assert any(text.startswith("C_af") for text in told)
    row = DrivenSegment(segments.ROW, 0.0, 5.0, 4.5, 0.0)
    assert len(segments.tells(row, run.poses, MACHINE)) < len(told)


def test_marks_name_a_segment() -> None:
    (run,) = tilth.analysis.open(marked(), cache=shared_cache())
    (found,) = segments.marked(run.poses, run.marks)
    assert found.name == "west step" and found.kind == segments.MARKED
    assert (found.start_s, found.end_s) == pytest.approx([at_s for at_s, _ in MARKS], abs=0.01)


@pytest.mark.parametrize(
    ("after", "found"),
    [
        ("", True),
        ("wet hollow", True),
        ("NAME 2 disturbed (of another try)", True),
        ("NAME disturbed (the end is not in the log)", False),
        ("NAME aborted (stopped by the driver)", False),
    ],
)
def test_a_run_that_a_later_mark_calls_spoilt_is_not_found(after: str, found: bool) -> None:
    """Its end mark may come late, after the driver has been told to drive it again."""
    name = "experiment p run 1 step replicate 1 of 1 try 1"
    texts = [
        f"{name} start",
        f"{name} end",
        after.replace("NAME", name),
        f"{name[:-1]}2 start",
        f"{name[:-1]}2 end",
    ]
    marks = Table({"t_s": np.array([2.0, 10.0, 11.0, 20.0, 30.0]), "text": np.array(texts, object)})
    names = [one.name for one in segments.marked(poses(np.zeros(200)), marks)]
    assert names == ([name] if found else []) + [f"{name[:-1]}2"]


def test_given_times_outside_of_the_run() -> None:
    table = poses(np.zeros(100))
    assert segments.between(table, 2.0, 8.0).seconds == 6.0
    with pytest.raises(
        ValueError, match=r"no poses between 50 and 60 s of the run; there are some from 0.0 to"
    ):
        segments.between(table, 50.0, 60.0)
