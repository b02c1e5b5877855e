"""The recommended estimate as MAVLink messages, for an autopilot, its scripts and its ground station.

A number is there only while it may be used, else it is NaN; status and age say why and since when.
"""

import math
import socket
from typing import Final

from pymavlink.dialects.v20 import common

from tilth.client.latest import Latest
from tilth.schemas.flow import PARAMETERS, Status
from tilth.schemas.mavlink import UdpAddress

ARRAY: Final = b"tilth"  # name of the DEBUG_FLOAT_ARRAY
AGE: Final = "est_age"  # of the estimate itself, s
# After the name of a parameter: itself (N/rad or m), its sd, its status, s since data informed it. A name has
# ten characters at most.
SUFFIXES: Final = ("", "_sd", "_st", "_ag")


def numbers(latest: Latest) -> dict[str, float]:
    """All that is sent, by name, in the order of the array: AGE, then four of each of PARAMETERS."""
    named = {AGE: latest.age_s if math.isfinite(latest.age_s) else math.nan}
    for name, row in zip(PARAMETERS, _rows(latest), strict=True):
        named |= {name + suffix: number for suffix, number in zip(SUFFIXES, row, strict=True)}
    return named


def _rows(latest: Latest) -> list[tuple[float, float, float, float]]:
    if latest.estimate is None:
        return [(math.nan, math.nan, float(Status.UNESTIMATED), math.nan)] * len(PARAMETERS)
    rows = []
    for one, refusal in zip(latest.estimate.parameters, latest.refusals, strict=True):
        status = Status.STALE if refusal and one.status is Status.ESTIMATED else one.status
        is_estimated = status is Status.ESTIMATED
        value = one.value if is_estimated and one.value is not None else math.nan
        sd = one.sd if is_estimated and one.sd is not None else math.nan
        rows.append((value, sd, float(status), math.nan if one.age_s is None else one.age_s + latest.age_s))
    return rows


class MavlinkSender:
    """Sends to one peer, and hears nothing."""

    def __init__(self, to: UdpAddress, system: int, component: int) -> None:
        """Raises OSError: no such host."""
        family, kind, _, _, address = socket.getaddrinfo(to.host, to.port, type=socket.SOCK_DGRAM)[0]
        self._socket = socket.socket(family, kind)
        self._socket.connect(address)
        self._mav = common.MAVLink(self, system, component)
        self.sent = 0  # messages
        self.unsent = 0  # of them: the network did not take them, or nobody listens there
        self.reason = ""  # why the last one was not

    def write(self, packed: bytes) -> None:
        """What the codec calls."""
        self.sent += 1
        try:
            self._socket.send(packed)
        except OSError as error:  # an autopilot that is off now may be on again
            self.unsent += 1
            self.reason = error.strerror or str(error)

    def send(self, latest: Latest, running_ms: int) -> None:
        """A heartbeat and all numbers, as DEBUG_FLOAT_ARRAY and each as NAMED_VALUE_FLOAT."""
        mav, named = self._mav, numbers(latest)
        mav.heartbeat_send(
            common.MAV_TYPE_ONBOARD_CONTROLLER, common.MAV_AUTOPILOT_INVALID, 0, 0, common.MAV_STATE_ACTIVE
        )
        t_us = 0 if latest.estimate is None else latest.estimate.t_ns // 1000
        array = [*named.values()]
        mav.debug_float_array_send(t_us, ARRAY, 0, array + [0.0] * (58 - len(array)))
        for name, number in named.items():
            mav.named_value_float_send(running_ms & 0xFFFF_FFFF, name.encode(), number)

    def close(self) -> None:
        self._socket.close()
