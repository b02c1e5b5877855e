"""Who is ahead of whom, by the way they drive."""

import math

import pytest

from tilth.replay.mount_order import FEWEST, METRES, MountOrder
from tilth.schemas.flow import Message, Origin

STEP_NS = 100_000_000
PLACES = {1: 2.0, 2: -1.0, 3: -6.0}  # address -> m ahead of something


def driven(course: float, speed: float, steps: int) -> MountOrder:
    """Each tells position and course ten times a second, one after another."""
    order = MountOrder()
    for step in range(steps):
        for i, (source, ahead) in enumerate(PLACES.items()):
            t_ns = step * STEP_NS + i * STEP_NS // 4
            way = ahead + speed * t_ns * 1e-9
            latitude = 50.0 + way * math.cos(course) / METRES
            longitude = 9.0 + way * math.sin(course) / (METRES * math.cos(math.radians(50.0)))
            place = {"latitude_deg": latitude, "longitude_deg": longitude}
            values = place | {"course_rad": course, "speed_mps": speed}
            order.take(Message(t_ns, t_ns, Origin("can0", source, None), 129029, None, values))
    return order


@pytest.mark.parametrize("course", [0.0, 0.7, 2.0, 3.1, 4.7, 6.2])
def test_whatever_the_way_the_foremost_comes_first(course: float) -> None:
    assert driven(course, 3.0, FEWEST).front_to_rear() == (("can0", 1), ("can0", 2), ("can0", 3))


@pytest.mark.parametrize(("speed", "steps"), [(0.5, 200), (3.0, 2)])
def test_who_hardly_moves_is_not_put_in_order(speed: float, steps: int) -> None:
    assert driven(1.0, speed, steps).front_to_rear() == ()


def test_side_by_side_is_no_order(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(PLACES, 2, 1.9)
    assert driven(1.0, 3.0, 100).front_to_rear() == ()


def test_nobody_is_no_order() -> None:
    assert MountOrder().front_to_rear() == ()
