"""Frames of both bodies for a viewer."""

from dataclasses import replace

import pytest
from logs import MACHINE
from loopback import START_NS

from tilth.estimator.pose.body_frames import body_frames
from tilth.schemas.flow import BodyPose, Pose

NOWHERE = BodyPose(*[None] * 13)


@pytest.mark.parametrize(
    ("tractor", "implement", "frames"),
    [
        (True, True, ["tractor", "implement", "tractor_front_left", "tractor_front_right"]),
        (True, False, ["tractor", "tractor_front_left", "tractor_front_right"]),
        (False, True, ["implement"]),
        (False, False, None),
    ],
)
def test_a_body_whose_place_is_not_known_is_nowhere(
    tractor: bool, implement: bool, frames: list[str] | None
) -> None:
    somewhere = replace(NOWHERE, x=1.0, y=2.0, heading=0.3)
    first, second = (somewhere if known else NOWHERE for known in (tractor, implement))
    pose = Pose(START_NS, 43.5, -83.4, first, second, None, None, 0.1, 0.01, 1, None, 0.0, 4, ())
    given = body_frames(MACHINE, pose)
    assert (given and [one.child for one in given.transforms]) == frames
