"""A changed file reads what the file before it read, as `heard_after` says."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from kinematic_drive import MACHINE

from tilth.estimator.calibration.changes import (
    Changes,
    applied,
    further_wheel,
    heard_after,
    linkage_of,
    not_early,
)
from tilth.estimator.calibration.drive import MOUNTS
from tilth.schemas.flow import Origin, Position, WheelAngle
from tilth.schemas.wheel_angle import compile_sensor

ANGLES = st.floats(-0.3, 0.3)


@given(st.sampled_from([1, -1]), st.floats(-0.08, 0.08), st.floats(0.8, 1.25), ANGLES)
@settings(max_examples=60, deadline=None)
def test_a_wheel_angle_is_read_by_the_changed_file(sign: int, zero: float, gain: float, angle: float) -> None:
    changes = Changes(wheel_sign=sign, wheel_zero=zero, wheel_gain=gain)
    data = compile_sensor(MACHINE).data(angle)
    before = compile_sensor(MACHINE).read(data)
    assert isinstance(before, float)
    after = compile_sensor(applied(MACHINE, changes)).read(data)
    told = heard_after(WheelAngle(0, 0, Origin("can0", 11), 65291, None, before, 1e-3), changes)
    assert isinstance(told, WheelAngle)
    assert after == pytest.approx(told.angle, abs=1e-12)


LINKAGES = st.tuples(st.sampled_from(["mean", "left", "right"]), st.floats(-0.15, 0.15))


@given(LINKAGES, LINKAGES, st.floats(-0.08, 0.08), st.floats(0.8, 1.25), ANGLES)
@settings(max_examples=60, deadline=None)
def test_a_linkage_is_read_by_the_changed_file(
    before: tuple[str, float], after: tuple[str, float], zero: float, gain: float, angle: float
) -> None:
    """Whatever kingpin and curvature the file had, and has."""
    first = applied(MACHINE, Changes(linkage=linkage_of(MACHINE, before[0])._replace(curve=before[1])))
    own = linkage_of(first)
    changes = Changes(
        wheel_zero=zero, wheel_gain=gain, linkage_before=own,
        linkage=linkage_of(first, after[0])._replace(curve=after[1]),
    )  # fmt: skip
    sensor = compile_sensor(first)
    data = sensor.data(angle)
    was = sensor.read(data)
    assert isinstance(was, float) and was == pytest.approx(angle, abs=2e-4)
    now = compile_sensor(applied(first, changes)).read(data)
    told = heard_after(WheelAngle(0, 0, Origin("can0", 11), 65291, None, was, 1e-3), changes)
    assert isinstance(told, WheelAngle) and now == pytest.approx(told.angle, abs=1e-12)


@given(st.sampled_from([1, -1]), st.floats(-0.08, 0.08), st.floats(0.8, 1.25), ANGLES, ANGLES)
@settings(max_examples=60, deadline=None)
def test_what_is_left_of_the_wheel_adds_up(
    sign: int, zero: float, gain: float, angle: float, left: float
) -> None:
    """further_wheel: the same as reading by the changes, then taking off what is left."""
    changes, log_gain = Changes(wheel_sign=sign, wheel_zero=zero, wheel_gain=gain), left / 2
    measured = WheelAngle(0, 0, Origin("can0", 11), 65291, None, angle, 1e-3)
    first = heard_after(measured, changes)
    both = heard_after(measured, further_wheel(changes, left, log_gain))
    assert isinstance(first, WheelAngle) and isinstance(both, WheelAngle)
    assert both.angle == pytest.approx((first.angle - left) / math.exp(log_gain), abs=1e-12)


def test_receivers_keep_what_is_theirs() -> None:
    """Exchanged receivers take places and mounts, not each other's settings."""
    changed = applied(MACHINE, Changes(assignment=(2, 1, 0, 3), delay=np.array([0.01, 0.0, 0.0, 0.0])))
    before = {r.mount: r for r in MACHINE.receiver}
    after = {r.mount: r for r in changed.receiver}
    assert after[MOUNTS[0]].name == before[MOUNTS[2]].name
    assert after[MOUNTS[0]].position == before[MOUNTS[0]].position
    assert after[MOUNTS[0]].roll_corrected == before[MOUNTS[2]].roll_corrected
    assert after[MOUNTS[0]].latency.value == pytest.approx(before[MOUNTS[2]].latency.value + 0.01)
    told = Position(0, 0, Origin("can0", 1, 5, MOUNTS[2]), 129025, None, 52.0, 11.0, 0.02)
    assert heard_after(told, Changes(assignment=(2, 1, 0, 3))).origin.mount is MOUNTS[0]


@pytest.mark.parametrize("k", [0, 1])
def test_pairs_turn_and_stretch_about_their_middle(k: int) -> None:
    by = np.eye(2)[k]
    changed = applied(MACHINE, Changes(pair=np.radians(3.0) * by, longer=0.1 * by))
    pairs = [
        np.array([r.position[:2] for r in machine.receiver if r.mount.body == ("tractor", "implement")[k]])
        for machine in (MACHINE, changed)
    ]
    assert pairs[1].mean(axis=0) == pytest.approx(pairs[0].mean(axis=0))
    arms = [pair[0] - pair[1] for pair in pairs]
    assert np.hypot(*arms[1]) == pytest.approx(np.hypot(*arms[0]) + 0.1)
    assert math.atan2(arms[1][1], arms[1][0]) == pytest.approx(math.radians(3.0))


@pytest.mark.parametrize("early_s", [0.0, 0.03, 0.3])
@pytest.mark.parametrize("assignment", [(0, 1, 2, 3), (2, 1, 0, 3)])
def test_latencies_keep_their_differences_where_one_would_be_too_short(
    early_s: float, assignment: tuple[int, ...]
) -> None:
    """A file 0.1 s wrong for all was refused: what differs between its receivers had been cut off."""
    wanted = np.array([0.01, -0.02, -early_s, 0.03])
    stated = {r.mount: r.latency.value for r in MACHINE.receiver}
    changed = applied(MACHINE, Changes(assignment=assignment, delay=not_early(MACHINE, assignment, wanted)))
    moved = [r.latency.value - stated[MOUNTS[assignment[MOUNTS.index(r.mount)]]] for r in changed.receiver]
    by = np.array(moved)[[[r.mount for r in changed.receiver].index(mount) for mount in MOUNTS]] - wanted
    assert np.ptp(by) < 1e-9 and by[0] >= -1e-9
    assert min(r.latency.value for r in changed.receiver) >= 0.0
    assert by[0] < 1e-9 or min(r.latency.value for r in changed.receiver) < 1e-9
