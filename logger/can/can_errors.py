"""Reads the error frames of a CAN controller: error classes of linux/can/error.h.

`ERRORS` has one row per thing that can go wrong; one error frame may report several.
"""

from collections import Counter
from dataclasses import dataclass, field
from enum import StrEnum

AGAIN_NS = 10_000_000_000  # the same error is reported again after this, with its count
HEALTHY_NS = 10_000_000_000  # traffic for so long without any error: the controller counts as recovered
BACK_NS = 500_000_000  # traffic so long after bus-off: it is over
WHOLE = -1  # the class alone tells it


class ControllerState(StrEnum):
    """enum can_state of linux/can/netlink.h, in its order; the words are those of tilth.BusStatus."""

    ACTIVE = "active"  # all is well
    WARNING = "warning"
    PASSIVE = "passive"
    BUS_OFF = "bus_off"
    STOPPED = "stopped"
    SLEEPING = "sleeping"


@dataclass(frozen=True, slots=True)
class Error:
    """A row: identifier bits, which byte, which of its bits, what it is called, and what to do."""

    bits: int
    byte: int
    mask: int
    name: str
    words: str
    state: ControllerState | None = None  # of the controller from then on; None: it stays as it is


CONTROLLER, PROTOCOL, TRANSCEIVER = 0x04, 0x08, 0x10
_LOOK = "check bit rate, termination, plugs"
ERRORS: tuple[Error, ...] = (
    Error(0x40, WHOLE, 0, "bus_off", "bus-off, the controller has left the bus; check bit rate and wiring, "
          "and bring it up with restart-ms 100", ControllerState.BUS_OFF),
    Error(0x100, WHOLE, 0, "restarted", "the controller was restarted", ControllerState.ACTIVE),
    Error(CONTROLLER, 1, 0x01, "overrun", "overrun, the controller had no room for frames and lost some"),
    Error(CONTROLLER, 1, 0x02, "transmit_overrun", "the controller's transmit buffer overflowed"),
    Error(CONTROLLER, 1, 0x0C, "warning", f"many errors; {_LOOK}", ControllerState.WARNING),
    Error(CONTROLLER, 1, 0x30, "passive", f"error-passive, very many errors; {_LOOK}",
          ControllerState.PASSIVE),
    Error(CONTROLLER, 1, 0x40, "recovered", "the controller is error-active again",
          ControllerState.ACTIVE),
    Error(PROTOCOL, WHOLE, 0, "protocol", f"damaged frames on the bus; {_LOOK}"),
    Error(TRANSCEIVER, 4, 0x0F, "can_high", "CAN high is broken or shorted; check the wire"),
    Error(TRANSCEIVER, 4, 0xF0, "can_low", "CAN low is broken or shorted; check the wire"),
    Error(0x80, WHOLE, 0, "bus_error", f"bus errors; {_LOOK}"),
    Error(0x02, WHOLE, 0, "arbitration", "arbitration lost"),
    Error(0x20, WHOLE, 0, "no_acknowledge", "nobody acknowledges; is anything else on the bus?"),
    Error(0x01, WHOLE, 0, "transmit_timeout", "the driver could not send"),
)  # fmt: skip
STATES = tuple(ControllerState)  # by their number in the kernel
UNKNOWN = Error(0, WHOLE, 0, "unknown", "an error of an unknown kind")
_BY_NAME = {row.name: row for row in (*ERRORS, UNKNOWN)}
_OF_STATE = {row.state: row for row in ERRORS if row.state is not None}  # the last row of each


def errors_of(can_id: int, data: bytes) -> list[Error]:
    """The rows of ERRORS that an error frame reports; never empty. can_id: without the error flag."""
    found = [
        row
        for row in ERRORS
        if can_id & row.bits and (row.byte == WHOLE or (row.byte < len(data) and data[row.byte] & row.mask))
    ]
    return found or [UNKNOWN]


@dataclass(slots=True)
class Health:
    """The errors of one controller: its state, counts by row, and which counts have been reported."""

    counts: Counter[str] = field(default_factory=Counter)
    state: ControllerState = ControllerState.ACTIVE
    _reported_ns: dict[str, int] = field(default_factory=dict)  # name -> when it was last reported
    _reported: Counter[str] = field(default_factory=Counter)  # counts at that time
    _latest_ns: int = 0

    def hear(self, t_ns: int, can_id: int, data: bytes) -> None:
        """Take an error frame."""
        self._latest_ns = t_ns
        for row in errors_of(can_id, data):
            self.count(t_ns, row)

    def set_state(self, t_ns: int, state: ControllerState | None) -> None:
        """Take the state that the interface reports; it overrides what error frames reported.

        None, and a state that no row of ERRORS has: nothing changes.
        """
        row = _OF_STATE.get(state) if state is not None else None
        if row is not None and state is not self.state:
            self.count(t_ns, row)

    def count(self, t_ns: int, row: Error) -> None:
        """Count one occurrence of this error."""
        self._latest_ns = t_ns
        self.counts[row.name] += 1
        self.state = row.state or self.state

    @property
    def problem(self) -> str:
        """What is wrong at the moment; "" where nothing is."""
        if self.state is ControllerState.ACTIVE:
            return ""
        return _OF_STATE[self.state].words

    def news(self, t_ns: int, traffic: bool) -> list[str]:
        """Texts of the errors to report now, with their counts; each error at most once in AGAIN_NS.

        traffic: whether frames have come since the last look, other than error frames.
        """
        needed_ns = BACK_NS if self.state is ControllerState.BUS_OFF else HEALTHY_NS
        if traffic and self.state is not ControllerState.ACTIVE and t_ns - self._latest_ns > needed_ns:
            self.count(t_ns, _OF_STATE[ControllerState.ACTIVE])
        news_texts = []
        for name, count in self.counts.items():
            new = count - self._reported[name]
            if new and t_ns - self._reported_ns.get(name, -AGAIN_NS) >= AGAIN_NS:
                self._reported_ns[name] = t_ns
                self._reported[name] = count
                news_texts.append(f"{_BY_NAME[name].words} ({new} times, {count} in all)")
        return news_texts
