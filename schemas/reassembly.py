"""Messages of more than eight bytes, put together from their frames by listening only.

NMEA 2000 fast packet: byte 0 is sequence(3) | frame index(5); frame 0 has the length and 6 bytes, the others
7. ISO 11783-3 transport protocol: TP.CM (60416) announces, TP.DT (60160) carries 7 bytes a frame; BAM to
everybody, RTS/CTS to one. A message is stamped with its first frame. Frames must come in their order: one
that is lost or out of order spoils the message, never its bytes; an exact echo of the frame before is left
out. Time is the frames' own.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from tilth.schemas.can_id import CanId
from tilth.schemas.flow import Frame
from tilth.schemas.rejections import Rejection, count

TP_CONTROL = 60416
TP_DATA = 60160

FAST_TIMEOUT_NS = 750_000_000  # between frames (AgIsoStack nmea2000_fast_packet_protocol.hpp)
BAM_TIMEOUT_NS = 750_000_000  # T1 of ISO 11783-3
RTS_TIMEOUT_NS = 1_250_000_000  # T2, T3: the receiver's answer or a packet that it asked for
FAST, TRANSPORT = "fast_packet", "transport"
SLOTS = 256  # open at once, over all buses; the oldest goes first

_FAST_LONGEST = 6 + 31 * 7
_TP_LONGEST = 1785
_RTS, _CTS, _END, _BAM, _ABORT = 16, 17, 19, 32, 255


class Assembled(NamedTuple):
    """A whole message, stamped with its first frame."""

    pgn: int
    payload: bytes
    t_ns: int
    rx_ns: int


@dataclass(slots=True)
class _Slot:
    """A message on its way. A closed slot swallows what still comes of a message that was spoilt, is complete
    or interests nobody, so that it is counted once."""

    kind: str  # fast_packet | transport
    pgn: int
    length: int
    t_ns: int
    rx_ns: int
    last_ns: int
    timeout_ns: int
    expected: int  # index of the next frame
    open: bool = True
    data: bytearray = field(default_factory=bytearray)
    latest: bytes = b""  # the frame before: the same again is an echo of the wire, no error


Key = tuple[str, int, int, int, int]  # bus, source, destination, PGN (0: transport protocol), sequence


class Assembler:
    """All messages on their way."""

    __slots__ = ("_rejected", "_slots", "_wanted", "unwanted")

    def __init__(self, wanted: frozenset[int], rejected: dict[str, int]) -> None:
        """wanted: PGNs to put together; rejected: counts to add to."""
        self._wanted = wanted
        self._rejected = rejected
        self._slots: dict[Key, _Slot] = {}
        self.unwanted: dict[tuple[str, int, int], int] = {}  # frames by bus, source, PGN announced

    def fast(self, frame: Frame, can_id: CanId) -> Assembled | None:
        """The message that this fast-packet frame completes, if it does."""
        data = frame.data
        if len(data) < 2:
            count(self._rejected, Rejection.SHORT_FRAME)
            return None
        key = (frame.bus, can_id.source, can_id.destination, can_id.pgn, data[0] >> 5)
        index = data[0] & 31
        slot = self._fresh(key, frame.t_ns)
        if slot is not None and data == slot.latest:
            count(self._rejected, Rejection.DUPLICATE_FRAME)
            return None
        if index == 0:
            if slot is not None and slot.open:
                count(self._rejected, Rejection.BROKEN_FAST_PACKET)
            slot = self._open(key, frame, FAST, can_id.pgn, data[1], FAST_TIMEOUT_NS)
            if data[1] > _FAST_LONGEST:
                self._spoil(slot)
            return self._append(slot, frame, data[2:])
        if slot is None:
            slot = self._open(key, frame, FAST, can_id.pgn, 0, FAST_TIMEOUT_NS)
            self._spoil(slot)
        elif slot.open and index != slot.expected:
            self._spoil(slot)
        return self._append(slot, frame, data[1:])

    def control(self, frame: Frame, can_id: CanId) -> None:
        """A TP.CM frame: announcement, request, end or abort of a transfer."""
        data = frame.data
        if len(data) < 8:
            count(self._rejected, Rejection.SHORT_FRAME)
            return
        control = data[0]
        pgn = int.from_bytes(data[5:8], "little") & 0x3FFFF
        sent = (frame.bus, can_id.source, can_id.destination, 0, 0)
        answered = (frame.bus, can_id.destination, can_id.source, 0, 0)
        if control in (_BAM, _RTS):
            self._announce(sent, frame, pgn)
        elif control == _CTS:
            self._ask(answered, frame)
        elif control in (_END, _ABORT):
            for key in (sent, answered):
                slot = self._fresh(key, frame.t_ns)
                if slot is not None and slot.pgn == pgn:
                    if slot.open:
                        self._spoil(slot)
                    del self._slots[key]

    def transfer(self, frame: Frame, can_id: CanId) -> Assembled | None:
        """The message that this TP.DT frame completes, if it does."""
        data = frame.data
        key = (frame.bus, can_id.source, can_id.destination, 0, 0)
        slot = self._fresh(key, frame.t_ns)
        if slot is None or len(data) < 2:  # its announcement was not heard: nobody knows what it is
            return None
        if data == slot.latest:
            if slot.open:
                count(self._rejected, Rejection.DUPLICATE_FRAME)
            return None
        if slot.open and data[0] != slot.expected:
            self._spoil(slot)
        return self._append(slot, frame, data[1:])

    def _announce(self, key: Key, frame: Frame, pgn: int) -> None:
        data = frame.data
        length, packets = data[1] | data[2] << 8, data[3]
        before = self._fresh(key, frame.t_ns)
        if before is not None and before.open:
            if data == before.latest:
                count(self._rejected, Rejection.DUPLICATE_FRAME)
                return
            count(self._rejected, Rejection.BROKEN_TRANSPORT)
        timeout_ns = BAM_TIMEOUT_NS if data[0] == _BAM else RTS_TIMEOUT_NS
        slot = self._open(key, frame, TRANSPORT, pgn, length, timeout_ns)
        slot.expected, slot.latest = 1, data
        if pgn not in self._wanted:
            slot.open = False
            sent = (key[0], key[1], pgn)
            self.unwanted[sent] = self.unwanted.get(sent, 0) + 1 + packets
        elif not 8 < length <= _TP_LONGEST or packets != (length + 6) // 7:
            self._spoil(slot)

    def _ask(self, key: Key, frame: Frame) -> None:
        """The receiver asks for packets from a number on: again, where it missed some."""
        slot = self._fresh(key, frame.t_ns)
        if slot is None:
            return
        slot.last_ns = frame.t_ns
        amount, first = frame.data[1], frame.data[2]
        if slot.open and amount > 0 and 1 <= first < slot.expected:
            slot.expected, slot.latest = first, b""
            del slot.data[7 * (first - 1) :]

    def _fresh(self, key: Key, t_ns: int) -> _Slot | None:
        """The slot of a key, unless its time is over (or the clock stepped back)."""
        slot = self._slots.get(key)
        if slot is None or abs(t_ns - slot.last_ns) <= slot.timeout_ns:
            return slot
        if slot.open:
            count(self._rejected, Rejection(f"stale_{slot.kind}"))
        del self._slots[key]
        return None

    def _open(self, key: Key, frame: Frame, kind: str, pgn: int, length: int, timeout_ns: int) -> _Slot:
        self._slots.pop(key, None)  # so that the oldest stands first
        while len(self._slots) >= SLOTS:
            oldest = self._slots.pop(next(iter(self._slots)))
            if oldest.open:
                count(self._rejected, Rejection(f"stale_{oldest.kind}"))
        slot = _Slot(kind, pgn, length, frame.t_ns, frame.rx_ns, frame.t_ns, timeout_ns, 0)
        self._slots[key] = slot
        return slot

    def _spoil(self, slot: _Slot) -> None:
        slot.open = False
        slot.data.clear()
        count(self._rejected, Rejection(f"broken_{slot.kind}"))

    def _append(self, slot: _Slot, frame: Frame, data: bytes) -> Assembled | None:
        slot.last_ns = frame.t_ns
        slot.latest = frame.data
        if not slot.open:
            return None
        slot.expected += 1
        slot.data += data
        if len(slot.data) < slot.length:
            if len(frame.data) < 8:  # only the last one may be short
                self._spoil(slot)
            return None
        slot.open = False
        payload = bytes(slot.data[: slot.length])
        slot.data.clear()
        return Assembled(slot.pgn, payload, slot.t_ns, slot.rx_ns)

    def dump(self) -> list[dict[str, object]]:
        """What is on its way, for JSON."""
        return [
            {
                "key": list(key), "kind": slot.kind, "pgn": slot.pgn, "length": slot.length,
                "t_ns": slot.t_ns, "rx_ns": slot.rx_ns, "last_ns": slot.last_ns,
                "timeout_ns": slot.timeout_ns, "expected": slot.expected, "open": slot.open,
                "data": slot.data.hex(), "latest": slot.latest.hex(),
            }
            for key, slot in self._slots.items()
        ]  # fmt: skip

    def load(self, state: list[Mapping[str, Any]]) -> None:
        """Go on from what `dump` gave."""
        self._slots.clear()
        for row in state:
            bus, source, destination, pgn, sequence = row["key"]
            self._slots[(bus, source, destination, pgn, sequence)] = _Slot(
                row["kind"], row["pgn"], row["length"], row["t_ns"], row["rx_ns"], row["last_ns"],
                row["timeout_ns"], row["expected"], row["open"],
                bytearray.fromhex(row["data"]), bytes.fromhex(row["latest"]),
            )  # fmt: skip


def split_fast(payload: bytes, sequence: int) -> list[bytes]:
    """Frames of a fast packet, filled up with 0xFF. Raises ValueError above 223 bytes."""
    if len(payload) > _FAST_LONGEST:
        raise ValueError(f"a fast packet holds at most {_FAST_LONGEST} bytes, not {len(payload)}")
    head = (sequence & 7) << 5
    frames = [bytes([head, len(payload)]) + payload[:6].ljust(6, b"\xff")]
    for index, at in enumerate(range(6, len(payload), 7), start=1):
        frames.append(bytes([head | index]) + payload[at : at + 7].ljust(7, b"\xff"))
    return frames


def frames_in_fast(payload: bytes) -> int:
    """How many frames a fast packet takes."""
    return 1 + len(payload) // 7
