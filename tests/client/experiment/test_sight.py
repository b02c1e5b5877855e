"""What a prompter sees: places in the field, and poses that nothing can be learned from."""

import math

import numpy as np
import pytest
from logs import MACHINE
from stage import Point, pose

from tilth.client.experiment.sight import (
    FieldPlace,
    abort_reason,
    corner_of,
    in_field,
    in_plane,
    place_of,
    room_left,
    seen_of,
)
from tilth.client.received import pose_of
from tilth.estimator import fold
from tilth.estimator.pose.geometry import to_degrees
from tilth.schemas.channels import CHANNEL
from tilth.schemas.experiment import DrivingLimits, Rectangle
from tilth.schemas.flow import Mount, Pose
from tilth.schemas.sentences import notice_sentence
from tilth.simulator.scenario import Fault, FaultKind, Scenario
from tilth.simulator.traffic import simulate

FIELD = Rectangle(length=200, width=60)
AT = Point(10.0, 20.0, 0.3, 0.01, 0.3)


def test_a_pose_is_seen_as_it_is() -> None:
    seen = seen_of(pose(5_000_000_000, AT, ""))
    assert (seen.t_s, seen.north, seen.east, seen.heading) == (5.0, 10.0, 20.0, 0.3)
    assert seen.trouble is None


@pytest.mark.parametrize(
    ("lost", "flag", "words"),
    [
        ("tractor_front", "", "tractor front"),
        ("", "floating:implement_rear", "RTK is lost at implement rear"),
        ("", "no_rtk:tractor_rear", "RTK is lost at tractor rear"),
        ("", "swapped:rig", "do not fit"),
    ],
)
def test_what_cannot_be_learned_from_is_said(lost: str, flag: str, words: str) -> None:
    trouble = seen_of(pose(1, AT, lost, flag)).trouble
    assert trouble is not None and words in notice_sentence(trouble)


@pytest.mark.parametrize("kind", ["rtk_float", "dgnss"])
def test_a_receiver_that_loses_rtk_on_the_bus_is_lost_in_the_poses_that_are_published(
    kind: FaultKind,
) -> None:
    scenario = Scenario(other_traffic=False, faults=(Fault(Mount.TRACTOR_REAR, 5.0, 7.0, kind),))
    state, channel = fold.initial(MACHINE), CHANNEL["/pose"]
    found = [
        seen_of(pose_of(channel.encode(made.value), channel.encoding))
        for frame in simulate(MACHINE, 3, 9.0, scenario)
        for made in fold.step(state, frame)
        if isinstance(made.value, Pose)
    ]
    began_s = found[-1].t_s - 9.0
    troubles = {round(one.t_s - began_s, 1): one.trouble and notice_sentence(one.trouble) for one in found}
    during = {trouble for at, trouble in troubles.items() if 5.5 < at < 6.8}
    assert during == {"RTK is lost at tractor rear"}
    assert {trouble for at, trouble in troubles.items() if 3.5 < at < 4.8} == {None}
    assert troubles[max(troubles)] is None


def test_a_place_stays_where_it_is_when_the_plane_is_another() -> None:
    here = seen_of(pose(1, AT, ""))
    place = place_of(FIELD, here)
    other = to_degrees(here.origin_deg, 250.0, -80.0)
    moved = in_plane(place, other)
    assert (moved.north, moved.east) == pytest.approx((place.north - 250.0, place.east + 80.0), abs=1e-2)
    assert moved.origin_deg == other and in_plane(place, here.origin_deg) is place
    assert in_plane(moved, here.origin_deg)[:2] == pytest.approx(place[:2], abs=1e-6)


def test_the_field_lies_by_its_corner_or_about_the_tractor() -> None:
    seen = seen_of(pose(1, AT, ""))
    corner = to_degrees(seen.origin_deg, 100.0, -50.0)
    place = place_of(FIELD.model_copy(update={"corner": corner, "heading_deg": 90.0}), seen)
    assert (place.north, place.east) == pytest.approx((100.0, -50.0), abs=1e-6)
    assert place.heading == pytest.approx(math.pi / 2)
    here = place_of(FIELD, seen)
    along, across = in_field(here, seen, np.zeros(1), np.zeros(1))
    assert (along[0], across[0]) == pytest.approx((20.0, 30.0), abs=1e-9)


@pytest.mark.parametrize("heading_deg", [0.0, 123.4, 359.9])
def test_a_field_that_was_begun_lies_where_it_was_by_its_corner(heading_deg: float) -> None:
    """Also in another plane, as its corner is written."""
    seen = seen_of(pose(1, AT, ""))._replace(heading=math.radians(heading_deg - 360.0))
    place = place_of(FIELD, seen)
    north_east = [float(number) for number in corner_of(place).text.split(",")]
    told = FIELD.model_copy(update={"corner": tuple(north_east[:2]), "heading_deg": north_east[2]})
    other = seen._replace(origin_deg=to_degrees(seen.origin_deg, 250.0, -80.0))
    again = in_plane(place_of(told, other), seen.origin_deg)
    assert again[:2] == pytest.approx(place[:2], abs=0.02)
    assert math.remainder(again.heading - place.heading, math.tau) == pytest.approx(0.0, abs=2e-5)


def test_room_is_counted_from_where_the_tractor_stands_and_faces() -> None:
    place = FieldPlace(0.0, 0.0, 0.0)
    seen = seen_of(pose(1, Point(50.0, 30.0, 0.0, 0.0, 0.0), ""))
    ahead = np.linspace(0.0, 100.0, 11)
    assert room_left(FIELD, place, seen, ahead, np.zeros(11), False) == pytest.approx(25.0)
    back = seen._replace(heading=math.pi)
    assert room_left(FIELD, place, back, ahead, np.zeros(11), False) == pytest.approx(-70.0)
    right = room_left(FIELD, place, seen, np.zeros(1), np.array([28.0]), False)
    assert right == pytest.approx(-3.0)


def test_steady_driving_is_no_reason_to_break_off() -> None:
    track = tuple(seen_of(pose(int(k * 2e8), AT, "")) for k in range(10))
    assert abort_reason(DrivingLimits(), FIELD, None, track) is None
