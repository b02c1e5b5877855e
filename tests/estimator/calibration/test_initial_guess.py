"""The first look finds what is wrong with a file, on a rig that does not slip."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from kinematic_drive import GUIDED, MACHINE, ONE_SIDE, ONE_SPEED, ROWS, Plan, measurements

from tilth.estimator.calibration import calibrate as calibrating
from tilth.estimator.calibration import drive as drives
from tilth.estimator.calibration import faults as finding
from tilth.estimator.calibration import initial_guess
from tilth.estimator.calibration.assignment import assign
from tilth.estimator.calibration.calibrate import CannotCalibrate
from tilth.estimator.calibration.changes import Changes, applied, heard_after
from tilth.estimator.calibration.drive import MOUNTS
from tilth.estimator.calibration.verdict import _not_covered
from tilth.schemas.flow import FixType, Measurement, Mount, Position, WheelAngle
from tilth.schemas.machine import Machine


@pytest.fixture(scope="module")
def heard() -> list[Measurement]:
    return measurements(GUIDED)


def _drive(machine: Machine, made: list[Measurement]) -> drives.DriveGrid:
    found = drives.MeasuredLists()
    for measurement in made:
        drives.take(found, measurement)
    return drives.drive_of(found, machine)


def test_where_the_better_of_two_messages_falls_silent_the_other_counts(heard: list[Measurement]) -> None:
    made = [m for m in heard if isinstance(m, Position) and m.origin.mount is Mount.TRACTOR_FRONT][:100]
    found = drives.MeasuredLists()
    for k, position in enumerate(made):
        if k < 40 or k >= 80:  # and comes back
            drives.take(found, replace(position, pgn=129025))
        drives.take(found, replace(position, pgn=129029))
    times = np.array([row[0] for row in found.positions[0]])
    assert np.max(np.diff(times)) < drives.DRIVE.silent_s + 0.5 and np.min(np.diff(times)) > 0.0


def _look(bad: Changes, made: list[Measurement]) -> tuple[Machine, list[finding.RigFault]]:
    """The machine file after the first look, and the faults."""
    wrong = applied(MACHINE, bad)
    drive = _drive(wrong, [heard_after(m, bad) for m in made])
    changes, faults, _, _ = calibrating._initial_guess(wrong, drive)
    return applied(wrong, changes), faults


def test_values_are_found(heard: list[Measurement]) -> None:
    """Wrong by what people are wrong by, all at once."""
    bad = Changes(
        delay=np.array([0.07, 0.05, -0.02, -0.04]), forward=np.array([0.15, -0.2]),
        lateral_offset=np.array([-0.1, 0.12]), pair=np.radians([2.0, -3.0]), hitch=np.array([0.2, -0.15]),
        wheel_zero=math.radians(4.0), wheel_gain=1.12,
        roll_zero=np.radians([2.0, -1.0, 3.0, 0.5]),
    )  # fmt: skip
    found, faults = _look(bad, heard)
    assert faults == []
    for right, now in zip(MACHINE.receiver, found.receiver, strict=True):
        assert now.position[:2] == pytest.approx(right.position[:2], abs=0.04)
        assert now.latency.value == pytest.approx(
            right.latency.value, abs=0.12
        )  # tyres that do not slip are not what the search takes for usual
        assert now.roll_zero is not None
        assert now.roll_zero.value == pytest.approx(0.0, abs=0.15)
    assert found.tractor.c.value == pytest.approx(MACHINE.tractor.c.value, abs=0.04)
    assert found.implement.d.value == pytest.approx(MACHINE.implement.d.value, abs=0.04)
    assert found.wheel_angle.scale == pytest.approx(MACHINE.wheel_angle.scale, rel=0.02)
    assert found.wheel_angle.zero.value == pytest.approx(0.0, abs=0.1)


@pytest.mark.parametrize("slope", [(0.0, 0.0), (0.1, 0.0), (-0.03, 0.04)])
def test_uphill_and_down_neither_hitch_nor_receivers_seem_to_move(slope: tuple[float, float]) -> None:
    """An antenna 3 m up goes back by 30 cm where it climbs 6 degrees, and forward on the way down."""
    bad = Changes(delay=np.array([0.03, 0.01, -0.02, -0.04]), hitch=np.array([0.1, -0.1]))
    found, _ = _look(bad, measurements(GUIDED, slope=slope))
    delay = [
        now.latency.value - right.latency.value
        for right, now in zip(MACHINE.receiver, found.receiver, strict=True)
    ]
    assert np.ptp(delay) < 0.004
    assert found.tractor.c.value == pytest.approx(MACHINE.tractor.c.value, abs=0.015)
    assert _reach(found) == pytest.approx(_reach(MACHINE), abs=0.01)


def _reach(machine: Machine) -> float:
    """m, from the middle of the implement's receivers to the hitch."""
    return machine.implement.d.value - float(np.mean([r.position[0] for r in machine.receiver[2:]]))


@pytest.mark.parametrize(("plan", "told"), [(GUIDED, True), (ONE_SPEED, False)])
def test_how_late_receivers_are_apart_is_told_by_two_speeds(plan: Plan, told: bool) -> None:
    """At one speed what is late looks like what stands further back, and nothing of it is taken."""
    delay = np.array([0.03, -0.04, 0.02, -0.01])
    wrong = applied(MACHINE, Changes(delay=delay))
    made = [m for m in measurements(plan, slope=(0.0, 0.0)) if m.rx_ns * 1e-9 > 1020.0 or told]
    drive = _drive(wrong, made)
    changes, _, view, _ = calibrating._initial_guess(wrong, drive)
    found, sds = initial_guess.latency_differences(drive, view)
    between = float(initial_guess.hitch(view).sds[4])
    most = float(max(*sds, between))
    assert (most < initial_guess.INITIAL_GUESS.identified_delay_sd) == told
    apart = changes.delay - changes.delay.mean()
    expected = delay.mean() - delay if told else np.zeros(4)
    assert apart == pytest.approx(expected, abs=0.004)
    assert told or (found == 0.0).all()


@pytest.mark.parametrize("assignment", [(1, 0, 2, 3), (0, 1, 3, 2), (2, 3, 0, 1), (2, 1, 0, 3), (3, 1, 0, 2)])
def test_who_stands_where(assignment: tuple[int, ...], heard: list[Measurement]) -> None:
    found, faults = _look(Changes(assignment=assignment), heard)
    assert {fault.kind for fault in faults} <= {finding.REVERSED, finding.SWAPPED} and faults
    assert {r.name: r.mount for r in found.receiver} == {r.name: r.mount for r in MACHINE.receiver}


@pytest.mark.parametrize(
    ("bad", "kind"),
    [
        (Changes(wheel_sign=-1), finding.WHEEL_SIGN),
        (Changes(wheel_gain=10.0), finding.WHEEL_SCALE),
        (Changes(yaw_rate_sign=(1, -1, 1, 1)), finding.YAW_SIGN),
        (Changes(yaw_rate_sign=(1, 1, 1, -1)), finding.YAW_SIGN),
        (Changes(roll_sign=(1, 1, -1, 1)), finding.ROLL_SIGN),
        (Changes(roll_sign=(-1, 1, 1, 1)), finding.ROLL_SIGN),
        (Changes(), ""),
    ],
)
def test_structure(bad: Changes, kind: str, heard: list[Measurement]) -> None:
    """Found, and nothing beside it; the file is right after it."""
    found, faults = _look(bad, heard)
    assert [fault.kind for fault in faults] == ([kind] if kind else [])
    for right, now in zip(MACHINE.receiver, found.receiver, strict=True):
        assert (now.roll_sign, now.yaw_rate_sign) == (right.roll_sign, right.yaw_rate_sign)
    assert found.wheel_angle.sign == 1


def test_what_is_no_wheel_angle(heard: list[Measurement]) -> None:
    """An angle that does not go with the way is said, with what else was found."""
    rng = np.random.default_rng(3)
    other = [
        replace(m, angle=float(rng.uniform(-0.5, 0.5))) if isinstance(m, WheelAngle) else m for m in heard
    ]
    with pytest.raises(CannotCalibrate, match="byte order") as caught:
        calibrating._initial_guess(MACHINE, _drive(MACHINE, other))
    assert [fault.kind for fault in caught.value.faults] == [finding.WHEEL_UNREAD]


@pytest.mark.parametrize(("way_sd", "jumps", "is_read"), [(0.025, 0.0, True), (0.025, 0.01, False)])
def test_one_circle_at_one_angle_shows_that_the_wheel_is_read(
    way_sd: float, jumps: float, is_read: bool
) -> None:
    """Slowly the wheels stand still there, and what is not known of the way is most of what varies. A reading
    that jumps is one in the wrong byte order. Both rad."""
    made = measurements([(20, 0.0, 0), (60, 3.0, 0), (70, 1.4, -15)])
    view, rng = calibrating._initial_guess(MACHINE, _drive(MACHINE, made))[2], np.random.default_rng(3)
    base = MACHINE.tractor.wheelbase
    view = replace(view, wheel=view.wheel + rng.choice([-jumps, jumps], view.wheel.shape))
    rate = view.rate[:, 0] + way_sd / base * view.along[:, 0] * rng.normal(size=view.wheel.shape)
    faults = finding.wheel_faults(*initial_guess.wheel_by_the_way(view, base, rate))
    assert [fault.kind for fault in faults] == ([] if is_read else [finding.WHEEL_UNREAD])


def test_rows_alone_do_not_tell_who_is_who() -> None:
    """Nothing is claimed of bodies, and the drive is refused with what to drive."""
    made = measurements(ROWS)
    assert not assign(_drive(MACHINE, made), MACHINE).sure
    with pytest.raises(CannotCalibrate, match="rows only"):
        calibrating.look(MACHINE, made)


@pytest.mark.parametrize(("sign", "missing"), [(1, "left"), (-1, "right")])
def test_circles_to_one_side_are_taken_and_said(sign: int, missing: str) -> None:
    """What they tell is used; which side is missing, and what for, is said."""
    made = measurements([(seconds, speed, sign * angle) for seconds, speed, angle in ONE_SIDE])
    changes, _, view, _ = calibrating._initial_guess(MACHINE, _drive(MACHINE, made))
    assert changes.wheel_gain == pytest.approx(1.0, abs=0.1)
    said = list(_not_covered(initial_guess.coverage(view), np.zeros(3)))
    assert said[0].startswith(f"Hardly a turn to the {missing}: zero and scale of the wheel are told less")
    assert "circles to both sides" in said[0]


@pytest.mark.parametrize(
    ("made", "match"),
    [
        (lambda: measurements(ONE_SIDE[:1]), "less than a minute"),
        (lambda: measurements(ONE_SIDE, fix=FixType.GNSS), "no RTK fix"),
        (lambda: [m for m in measurements(ONE_SIDE) if m.origin.mount is not MOUNTS[2]], "implement_front"),
        (lambda: [m for m in measurements(ONE_SIDE) if m.origin.mount is not None], "no wheel angle"),
        (lambda: [], "none of the receivers of the machine file"),
    ],
)
def test_refusals(made: Callable[[], list[Measurement]], match: str) -> None:
    with pytest.raises(CannotCalibrate, match=match):
        calibrating.look(MACHINE, made())
