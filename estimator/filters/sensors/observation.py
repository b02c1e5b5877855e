"""One measurement as its sensor's model takes it."""

from typing import NamedTuple

from tilth.estimator.compiled import inner_kernel
from tilth.estimator.record.record import HEADING, YAW_RATE


class Observation(NamedTuple):
    """One measurement without its value: kind, place, when it is of, and the point of linearisation."""

    kind: int  # record.YAW_RATE to ROLL_ANGLE
    place: int  # as record.PLACE
    share: float  # time since the tick before, in ticks, [0, 1); below 0 for a turn rate that is late
    u: float  # m/s
    psi_ref: float  # rad, heading of the body in `ticks` at the instant
    faster: float  # rad/s^2: how fast the turn rate that it measures grows, 0.0 of other kinds


@inner_kernel
def body_of(kind: int, place: int) -> int:
    """0 for the tractor, 1 for the implement."""
    if kind in (YAW_RATE, HEADING):
        return place
    return 0 if place < 2 else 1
