"""Frames in, messages and measurements out.

A frame is looked up by (bus, identifier): nobody wants most of them. What is wanted is put together where it
takes several frames, read by its row of the table, and told as signals (`messages`) or as measurements of the
machine's receivers and wheel-angle sensor (`measurements`). What cannot be used is counted by reason.
"""

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from tilth.schemas.can_id import BROADCAST, CanId, join, split
from tilth.schemas.can_signal import CanSignal
from tilth.schemas.fields import Rows
from tilth.schemas.flow import (
    AddressClaim,
    Frame,
    Measurement,
    Message,
    Origin,
    Position,
    Weight,
    WheelAngle,
    Word,
)
from tilth.schemas.identity import AddressBook, Sender, split_name
from tilth.schemas.machine import Machine
from tilth.schemas.measures import Head, Made, makers_of
from tilth.schemas.pgn_table import PGNS, Pgn, row
from tilth.schemas.reassembly import TP_CONTROL, TP_DATA, Assembled, Assembler, frames_in_fast, split_fast
from tilth.schemas.rejections import Rejection, count
from tilth.schemas.weighing import compile_weighing
from tilth.schemas.wheel_angle import RUDDER, WheelAngleSensor, compile_sensor

_CLAIM, _RUDDER, _WEIGHT = row(60928), row(RUDDER), row(65258)
_PLAIN = {row.pgn: row for row in PGNS if row.manufacturer is None}
_PROPRIETARY = {
    (row.manufacturer, row.pgn, row.selector): row for row in PGNS if row.manufacturer is not None
}
_NAMING = frozenset(row.pgn for row in PGNS if row.manufacturer is not None and row.selector is None)
_FAST = frozenset(row.pgn for row in PGNS if row.fast)
_WANTED = frozenset(row.pgn for row in PGNS)
_MEASURED = frozenset(row.pgn for row in PGNS if not row.decode_only)
_OF_RECEIVERS = {(row.pgn, row.selector): makers_of(row, anyone=False) for row in PGNS}
_OF_ANYONE = {(row.pgn, row.selector): makers_of(row, anyone=True) for row in PGNS}

ROUTES = 8192  # identifiers remembered; beyond them the memory starts anew

Unread = tuple[str, int, int]
"""Bus, source and PGN; for frames of 11 bits -1 and the identifier."""

_Arrival = tuple[Pgn, bytes, int, int]
"""A whole message of the table: row, payload, t_ns and rx_ns of its first frame."""


@dataclass(slots=True)
class _Route:
    """What is to be done with the frames of one identifier on one bus."""

    can_id: CanId
    sender: Sender
    read: Callable[["_Route", Frame], _Arrival | None] | None
    row: Pgn | None  # None: depends on who sends, or on the announcement
    sensor: WheelAngleSensor | None
    weighing: CanSignal | None


class Decoder:
    """Decodes the frames of a machine's buses. One Decoder takes every frame of a log in its order, by
    `messages` or by `measurements`."""

    def __init__(self, machine: Machine | None = None) -> None:
        """machine: whose receivers and wheel-angle sensor make measurements; None: messages only.

        Raises MachineError where a DBC file does not give the signal that it is named for.
        """
        self.rejected: dict[str, int] = {}
        self.heard: list[Position] = []  # of who may be a receiver; whoever reads them clears them
        self._faults: dict[str, int] = {}  # of the message in hand
        self._passed: dict[tuple[str, int, bool], int] = {}  # frames of identifiers that nobody reads
        self._foreign: dict[Unread, int] = {}  # frames of manufacturers' own messages that no row reads
        self._addresses = AddressBook(machine.receiver if machine is not None else ())
        self._assembler = Assembler(_WANTED - {_CLAIM.pgn}, self.rejected)
        self._sensor = compile_sensor(machine) if machine is not None else None
        self._weighing = compile_weighing(machine) if machine is not None else None
        self._weighs_whole = (
            machine is not None and machine.weighing is not None and machine.weighing.weighs == "whole"
        )
        self._routes: dict[tuple[str, int, bool], _Route | None] = {}

    @property
    def unread(self) -> dict[Unread, int]:
        """How many of the frames given to `messages` the table does not read."""
        counts = Counter(self._foreign) + Counter(self._assembler.unwanted)
        for (bus, can_id, extended), number in self._passed.items():
            head = split(can_id)
            counts[(bus, head.source, head.pgn) if extended else (bus, -1, can_id)] += number
        return dict(counts)

    @property
    def unknown(self) -> dict[Origin, int]:
        """Senders of the messages counted as "unknown_source", with their counts."""
        return self._addresses.unknown

    @property
    def addresses(self) -> AddressBook:
        """Who has which address."""
        return self._addresses

    @property
    def routes(self) -> Mapping[tuple[str, int, bool], object]:
        """By bus, identifier and whether it has 29 bits, of frames so far: None where nobody reads it."""
        return self._routes

    def origin(self, bus: str, source: int) -> Origin:
        """The device that has an address, as far as known."""
        return self._addresses.sender(bus, source).origin

    def messages(self, frame: Frame) -> list[Message]:
        """Messages that this frame completes; none for a frame that nobody wants. Never raises."""
        route = self._route_of(frame, _WANTED)
        if route is None:
            if not frame.error:
                key = (frame.bus, frame.can_id, frame.extended)
                self._passed[key] = self._passed.get(key, 0) + 1
            return []
        messages: list[Message] = []
        if route.sensor is not None and route.row is not _RUDDER:
            read = route.sensor.read(frame.data)
            messages.append(self._own_message(route, frame, "wheel_angle_rad", read, "wheel-angle sensor"))
        if route.weighing is not None:
            read = route.weighing.reading(frame.data)
            told = "whole_mass_kg" if self._weighs_whole else "carried_mass_kg"
            messages.append(self._own_message(route, frame, told, read, "scale"))
        arrival = route.read(route, frame) if route.read is not None else None
        if arrival is not None:
            messages.append(self._message_of(route, arrival))
        return messages

    def _own_message(
        self, route: _Route, frame: Frame, key: str, read: float | Rejection, title: str
    ) -> Message:
        """Of what the machine file describes."""
        reason = read if isinstance(read, Rejection) else None
        if reason is not None:
            count(self.rejected, reason)
        return Message(
            frame.t_ns, frame.rx_ns, route.sender.origin, route.can_id.pgn, None,
            {} if reason is not None else {key: read},
            title=title, priority=route.can_id.priority,
            destination=route.can_id.destination, reason=reason,
        )  # fmt: skip

    def _message_of(self, route: _Route, arrival: _Arrival) -> Message:
        known, payload, _, _ = arrival
        faults = self._faults
        dropped: dict[str, Word] = {}
        values = known.layout.decode(payload, faults, dropped)
        groups = known.layout.groups(payload, faults) if known.groups else {}
        reason = next(iter(faults)) if faults else None
        head, repeat, _ = self._head(route.sender, arrival, values)
        if reason is None and known.telling.isdisjoint(values):
            reason = Rejection.NOT_AVAILABLE
            count(self.rejected, reason)
        return Message(
            *head, values, repeat, known.title, route.can_id.priority, route.can_id.destination,
            groups, dropped, reason,
        )  # fmt: skip

    def measurements(self, frame: Frame) -> list[Measurement]:
        """Measurements of the messages that this frame completes. Never raises."""
        route = self._route_of(frame, _MEASURED)
        if route is None:
            return []
        found: list[Measurement] = []
        if route.sensor is not None:
            self._measure_wheel(route, route.sensor, frame, found)
        if route.weighing is not None:
            self._measure_weight(route, route.weighing, frame, found)
        arrival = route.read(route, frame) if route.read is not None else None
        if arrival is not None:
            if arrival[0] is _CLAIM:
                self._measure_claim(route.sender, arrival, found)
            elif arrival[0] is not _WEIGHT or self._weighing is None:  # the file says which scale is meant
                self._measure(route, arrival, found)
        return found

    def _route_of(self, frame: Frame, wanted: frozenset[int]) -> _Route | None:
        if frame.error:
            count(self.rejected, Rejection.ERROR_FRAME)
            return None
        key = (frame.bus, frame.can_id, frame.extended)
        try:
            route = self._routes[key]
        except KeyError:
            if len(self._routes) >= ROUTES:
                self._routes.clear()
            route = self._routes[key] = self._new_route(frame, wanted)
        if route is not None and route.row is not _CLAIM:
            sender = route.sender
            if sender.contested:
                self._addresses.settle(sender, frame.t_ns)
            sender.received_ns = frame.t_ns
        return route

    def _new_route(self, frame: Frame, wanted: frozenset[int]) -> _Route | None:
        sensor = self._sensor if self._sensor is not None and self._sensor.hears(frame) else None
        weighing = self._weighing if self._weighing is not None and self._weighing.hears(frame) else None
        if not frame.extended:
            if sensor is None and weighing is None:
                return None
            nobody = self._addresses.sender(frame.bus, -1)
            return _Route(CanId(0, 0, -1, BROADCAST), nobody, None, None, sensor, weighing)
        can_id = split(frame.can_id)
        known = _PLAIN.get(can_id.pgn)
        read: Callable[[_Route, Frame], _Arrival | None] | None = None
        if can_id.pgn == TP_CONTROL:
            read = self._control
        elif can_id.pgn == TP_DATA:
            read = self._transfer
        elif can_id.pgn == _CLAIM.pgn:
            read = self._claimed
        elif can_id.pgn in wanted:
            read = self._fast if can_id.pgn in _FAST else self._single
        if read is None and sensor is None and weighing is None:
            return None
        return _Route(can_id, self._addresses.sender(frame.bus, can_id.source), read, known, sensor, weighing)

    def _single(self, route: _Route, frame: Frame) -> _Arrival | None:
        found = route.row
        if found is None:
            found = self._proprietary_row(route.sender, route.can_id.pgn, frame.data, 1)
        return (found, frame.data, frame.t_ns, frame.rx_ns) if found is not None else None

    def _fast(self, route: _Route, frame: Frame) -> _Arrival | None:
        if len(frame.data) > 8:  # a log that holds it assembled
            return self._single(route, frame)
        whole = self._assembler.fast(frame, route.can_id)
        return None if whole is None else self._put_together(route, whole, frames_in_fast(whole.payload))

    def _control(self, route: _Route, frame: Frame) -> None:
        self._assembler.control(frame, route.can_id)

    def _transfer(self, route: _Route, frame: Frame) -> _Arrival | None:
        whole = self._assembler.transfer(frame, route.can_id)
        return None if whole is None else self._put_together(route, whole, 1 + (len(whole.payload) + 6) // 7)

    def _put_together(self, route: _Route, whole: Assembled, frames: int) -> _Arrival | None:
        found = _PLAIN.get(whole.pgn)
        if found is None:
            found = self._proprietary_row(route.sender, whole.pgn, whole.payload, frames)
        return (found, whole.payload, whole.t_ns, whole.rx_ns) if found is not None else None

    def _claimed(self, route: _Route, frame: Frame) -> _Arrival | None:
        if len(frame.data) < 8:
            count(self.rejected, Rejection.SHORT_FRAME)
            return None
        name = int.from_bytes(frame.data[:8], "little")
        reason = self._addresses.claim(frame.bus, route.can_id.source, name, frame.t_ns)
        if reason is not None:
            count(self.rejected, reason)
        if reason == Rejection.NOT_AVAILABLE:
            return None
        return (_CLAIM, frame.data, frame.t_ns, frame.rx_ns)

    def _proprietary_row(self, sender: Sender, pgn: int, payload: bytes, frames: int) -> Pgn | None:
        """The row of a proprietary message, by its manufacturer: from its first two bytes or its sender."""
        found = None
        if pgn in _NAMING:
            if len(payload) >= 2:
                found = _PROPRIETARY.get((int.from_bytes(payload[:2], "little") & 0x7FF, pgn, None))
        elif sender.manufacturer is None:
            count(self.rejected, Rejection.UNIDENTIFIED)
        elif payload:
            found = _PROPRIETARY.get((sender.manufacturer, pgn, payload[0]))
        if found is None:
            key = (sender.bus, sender.source, pgn)
            self._foreign[key] = self._foreign.get(key, 0) + frames
        return found

    def _head(self, sender: Sender, arrival: _Arrival, values: Mapping[str, Word]) -> tuple[Head, bool, bool]:
        """Head, whether the position repeats the one before, whether a fault was counted."""
        known, payload, t_ns, rx_ns = arrival
        faults = self._faults
        faulty = bool(faults)
        if faulty:
            for reason, number in faults.items():
                count(self.rejected, reason, number)
            faults.clear()
        repeat = False
        if known.position is not None and "latitude_deg" in values and "longitude_deg" in values:
            raw = payload[known.position]
            repeat = sender.positions.get(known.pgn) == raw
            sender.positions[known.pgn] = raw
        origin = sender.origin if known is not _CLAIM else self._claimant(sender, payload)
        # 253 to 255 are no identifiers but NMEA 2000's "reserved", "out of range" and "not available".
        sid = payload[0] if known.has_sid and payload and payload[0] < 253 else None
        return (t_ns, rx_ns, origin, known.pgn, sid), repeat, faulty

    def _claimant(self, sender: Sender, payload: bytes) -> Origin:
        name = int.from_bytes(payload[:8], "little")
        return Origin(sender.bus, sender.source, name, self._addresses.mount_of(sender.bus, name))

    def _measure(self, route: _Route, arrival: _Arrival, found: list[Measurement]) -> None:
        key = (arrival[0].pgn, arrival[0].selector)
        sender = route.sender
        makes: tuple[Callable[..., Made], ...] = _OF_ANYONE[key]
        if sender.sd is not None:
            makes = makes + _OF_RECEIVERS[key] if makes else _OF_RECEIVERS[key]
        if not makes:
            if arrival[0].wish or arrival[0].decode_only:
                return
            if route.sensor is None:
                self._refuse(sender)
            if arrival[0].position is not None and self._addresses.candidate(sender):
                self._hear(sender, arrival)
            return
        values = arrival[0].layout.measured(arrival[1], self._faults)
        head, repeat, faulty = self._head(sender, arrival, values)
        nothing = not faulty
        for make in makes:
            made = make(head, values, sender.sd, repeat)
            if made is None:
                continue
            nothing = False
            if isinstance(made, Rejection):
                count(self.rejected, made)
            else:
                found.append(made)
        if repeat:
            count(self.rejected, Rejection.REPEAT)
        elif nothing:
            count(self.rejected, Rejection.NOT_AVAILABLE)

    def _hear(self, sender: Sender, arrival: _Arrival) -> None:
        """Keep a position of a sender that may be a receiver whose address is not known."""
        values = arrival[0].layout.measured(arrival[1], {})
        if "latitude_deg" in values and "longitude_deg" in values:
            at = float(values["latitude_deg"]), float(values["longitude_deg"])
            head = (arrival[2], arrival[3], sender.origin, arrival[0].pgn, None)
            self.heard.append(Position(*head, *at, 0.0))

    def _refuse(self, sender: Sender) -> None:
        """Count a message that would make a measurement if it came from a receiver of the machine file."""
        reason = sender.reason if sender.sd is None else Rejection.UNKNOWN_SOURCE
        count(self.rejected, reason)
        if reason == Rejection.UNKNOWN_SOURCE:
            sender.unknown += 1

    def _measure_wheel(
        self, route: _Route, sensor: WheelAngleSensor, frame: Frame, found: list[Measurement]
    ) -> None:
        angle = sensor.read(frame.data)
        if isinstance(angle, Rejection):
            count(self.rejected, angle)
            return
        head = (frame.t_ns, frame.rx_ns, route.sender.origin, route.can_id.pgn, None)
        found.append(WheelAngle(*head, angle, sensor.sd))

    def _measure_weight(
        self, route: _Route, weighing: CanSignal, frame: Frame, found: list[Measurement]
    ) -> None:
        mass = weighing.reading(frame.data)
        if isinstance(mass, Rejection):
            count(self.rejected, mass)
            return
        head = (frame.t_ns, frame.rx_ns, route.sender.origin, route.can_id.pgn, None)
        found.append(Weight(*head, *((mass, None) if self._weighs_whole else (None, mass))))

    def _measure_claim(self, sender: Sender, arrival: _Arrival, found: list[Measurement]) -> None:
        _, payload, t_ns, rx_ns = arrival
        identity, manufacturer = split_name(int.from_bytes(payload[:8], "little"))
        head = (t_ns, rx_ns, self._claimant(sender, payload), _CLAIM.pgn, None)
        found.append(AddressClaim(*head, manufacturer, identity))

    def dump(self) -> dict[str, object]:
        """Everything that later frames' decoding depends on, ready for JSON."""
        return {
            "rejected": dict(self.rejected),
            "addresses": self._addresses.dump(),
            "assembler": self._assembler.dump(),
        }

    def load(self, state: Mapping[str, Any]) -> None:
        """Go on from what `dump` gave; the machine file must be the same."""
        self.rejected.clear()
        self.rejected.update(state["rejected"])
        self._addresses.load(state["addresses"])
        self._assembler.load(state["assembler"])


def encode(
    pgn: int,
    values: Mapping[str, Word],
    *,
    selector: int | None = None,
    sid: int | None = None,
    groups: Mapping[str, Rows] | None = None,
) -> bytes:
    """Payload of a message of the table, from signals (or any further field of its row, by its key) and what
    it repeats; what is absent is written as not available.

    Raises ValueError where the table has no such message or a value does not fit.
    """
    return row(pgn, selector).encode(values if sid is None else {**values, "sid": sid}, groups)


def frames_of(
    pgn: int,
    payload: bytes,
    source: int,
    destination: int = BROADCAST,
    sequence: int = 0,
) -> list[tuple[int, bytes]]:
    """[(29-bit identifier, data)] of a payload: one frame, or a fast packet with this sequence (0 to 7).

    Raises ValueError where the table has no such message or the payload is too long for it.
    """
    known = next((row for row in PGNS if row.pgn == pgn), None)
    if known is None:
        raise ValueError(f"the table has no PGN {pgn}; add a row to PGNS")
    can_id = join(known.priority, pgn, source, destination)
    if known.fast:
        return [(can_id, data) for data in split_fast(payload, sequence)]
    if len(payload) > 8:
        raise ValueError(f"PGN {pgn} is a single frame of 8 bytes, not {len(payload)}")
    return [(can_id, payload)]


def claim(name: int) -> bytes:
    """Payload of an address claim, PGN 60928."""
    return name.to_bytes(8, "little")
