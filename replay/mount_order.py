"""Tells which receiver is ahead of which: by where they are along the way while the rig drives."""

import math
from itertools import pairwise
from typing import Final

from tilth.schemas.flow import Message

SLOWEST: Final = 1.0  # m/s: below, the course says little
LONGEST_NS: Final = 500_000_000  # a position that is older is not moved along
FEWEST: Final = 20  # instants
APART: Final = 0.3  # m: nearer ones are not told apart
METRES: Final = 111_320.0  # of a degree of latitude

_Sender = tuple[str, int]
"""Bus, address."""


class MountOrder:
    """`take` every message in its order, then ask for the order."""

    def __init__(self) -> None:
        self._positions: dict[_Sender, tuple[int, float, float]] = {}  # ns, latitude, longitude in degrees
        self._ahead: dict[_Sender, float] = {}  # sum of m ahead of their middle
        self._instants = 0

    def take(self, message: Message) -> None:
        """A position is kept; a course with a speed tells how they follow each other."""
        values, sender = message.values, (message.origin.bus, message.origin.source)
        if "latitude_deg" in values and "longitude_deg" in values:
            if sender not in self._positions:  # who comes later would be compared over another time
                self._ahead, self._instants = {}, 0
            at = float(values["latitude_deg"]), float(values["longitude_deg"])
            self._positions[sender] = (message.rx_ns, *at)
        course, speed = values.get("course_rad"), values.get("speed_mps")
        if sender in self._positions and course is not None and speed is not None and float(speed) > SLOWEST:
            self._compare(message.rx_ns, float(course), float(speed))

    def _compare(self, now_ns: int, course: float, speed: float) -> None:
        ages = [now_ns - then_ns for then_ns, _, _ in self._positions.values()]
        if len(ages) < 2 or not 0 <= min(ages) <= max(ages) <= LONGEST_NS:
            return
        _, latitude, longitude = next(iter(self._positions.values()))
        north, east = math.cos(course), math.sin(course) * math.cos(math.radians(latitude))
        along = [
            METRES * ((lat - latitude) * north + (lon - longitude) * east) + speed * age * 1e-9
            for (_, lat, lon), age in zip(self._positions.values(), ages, strict=True)
        ]
        middle = sum(along) / len(along)
        for sender, place in zip(self._positions, along, strict=True):
            self._ahead[sender] = self._ahead.get(sender, 0.0) + place - middle
        self._instants += 1

    def front_to_rear(self) -> tuple[_Sender, ...]:
        """The foremost first; () where they have not driven enough to be told apart."""
        found = sorted(self._ahead, key=self._ahead.__getitem__, reverse=True)
        means = [self._ahead[sender] / max(self._instants, 1) for sender in found]
        apart = all(one - next_one >= APART for one, next_one in pairwise(means))
        return tuple(found) if self._instants >= FEWEST and apart else ()
