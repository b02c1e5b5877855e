"""Checks whether the receivers, the wheel-angle sensor and the scale of the machine file are on the buses."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from tilth.logger.checks.finding import CheckFinding, Level
from tilth.schemas.can_id import CanId, split
from tilth.schemas.can_signal import CanSignal
from tilth.schemas.decode import Decoder
from tilth.schemas.device_names import manufacturer_name
from tilth.schemas.flow import Frame, Mount, Position, Weight, WheelAngle
from tilth.schemas.identity import split_name
from tilth.schemas.machine import Bus, Machine, Receiver
from tilth.schemas.pgn_table import PGNS
from tilth.schemas.sentences import notice_sentence
from tilth.schemas.weighing import compile_weighing
from tilth.schemas.wheel_angle import RUDDER, compile_sensor

MOST_CANDIDATES: Final = 3  # candidates
_POSITIONS: Final = frozenset(row.pgn for row in PGNS if "latitude_deg" in row.signals)
_PROPRIETARY_PGNS: Final = (
    range(0xFF00, 0x10000),
    range(0xEF00, 0xF000),
)  # PGNs of proprietary messages
_TELLING: Final = (range(126720, 126721), range(130816, 131072))  # NMEA 2000: their first bytes say whose
_MARINE: Final = 0b10011  # of those bytes, above the manufacturer: reserved ones and the industry group
_GROUP: Final = 60  # bit of a NAME


@dataclass(slots=True)
class _BusAddress:
    """What came from one address of one bus."""

    bus: str
    source: int
    frames: int = 0
    name: int | None = None
    maker: int | None = None  # manufacturer code
    group: int | None = None  # industry group, which says whose codes these are
    positions: int = 0
    empty_positions: int = 0  # "not available"

    def __str__(self) -> str:
        who = f" ({_maker(self.maker, self.group)})" if self.maker is not None else ""
        named = f", NAME {self.name:016X}" if self.name is not None else ""
        return f"address {self.source} on {self.bus}{who}{named}"


class Devices:
    """`take` every frame in its order, then ask for `findings`."""

    def __init__(self, machine: Machine) -> None:
        """Raises MachineError where a DBC file does not give the signal that it is named for."""
        self._machine = machine
        self._sensor, self._weighing = compile_sensor(machine), compile_weighing(machine)
        self._measurement_decoder, self._message_decoder = Decoder(machine), Decoder()
        self._senders: dict[tuple[str, int], _BusAddress] = {}
        self._identifiers: Counter[tuple[str, int, bool]] = Counter()
        self._used: Counter[Mount] = Counter()  # positions of the machine file's receivers
        self._angles = 0
        self._wheel_frames = 0
        self._weights = 0
        self._weighing_frames = 0

    def take(self, frame: Frame) -> None:
        """Take a frame; error frames do not count."""
        if frame.error:
            return
        self._identifiers[frame.bus, frame.can_id, frame.extended] += 1
        self._wheel_frames += self._sensor.hears(frame)
        self._weighing_frames += self._weighing is not None and self._weighing.hears(frame)
        for measurement in self._measurement_decoder.measurements(frame):
            if isinstance(measurement, Position) and measurement.origin.mount is not None:
                self._used[measurement.origin.mount] += 1
            self._angles += isinstance(measurement, WheelAngle)
            self._weights += isinstance(measurement, Weight)
        if frame.extended:
            self._note(frame, split(frame.can_id))

    def _note(self, frame: Frame, can_id: CanId) -> None:
        sender = self._sender(frame.bus, can_id.source)
        sender.frames += 1
        if sender.maker is None and any(can_id.pgn in pgns for pgns in _TELLING):
            first = int.from_bytes(frame.data[2:4], "little")  # after the counters of a fast packet
            if len(frame.data) == 8 and frame.data[0] & 0x1F == 0 and first >> 11 == _MARINE:
                sender.maker, sender.group = first & 0x7FF, _MARINE >> 2
        for message in self._message_decoder.messages(frame):
            sender = self._sender(message.origin.bus, message.origin.source)
            if message.origin.name is not None:
                sender.name = message.origin.name
                sender.maker, sender.group = split_name(sender.name).manufacturer, sender.name >> _GROUP & 7
            if message.pgn in _POSITIONS:
                held = "latitude_deg" in message.values
                sender.positions += held
                sender.empty_positions += not held

    def _sender(self, bus: str, source: int) -> _BusAddress:
        return self._senders.setdefault((bus, source), _BusAddress(bus, source))

    def findings(self) -> Iterator[CheckFinding]:
        """One finding per receiver and sensor of the machine file, then those on other devices."""
        for receiver in self._machine.receiver:
            yield self._receiver(receiver)
        yield self._wheel()
        if self._weighing is not None:
            yield self._scale(self._weighing)
        for _, told in self._measurement_decoder.addresses.news:
            yield CheckFinding("device names", Level.PROBLEM, notice_sentence(told))
        silent = sorted({bus.name for bus in self._machine.bus if self._unclaimed(bus)})
        if silent:
            hint = (
                "set request_claims = true in its [[bus]], and they are asked (one frame when it is opened)"
            )
            text = (
                f"no address claim is heard on {', '.join(silent)}: devices claim when they are switched on"
            )
            yield CheckFinding("device names", Level.NOTE, f"{text}; {hint}")
        for sender in self._strangers():
            if sender.positions:
                text = f"{sender} sends positions and is none of the file's receivers"
                yield CheckFinding("other receiver", Level.NOTE, text)

    def _unclaimed(self, bus: Bus) -> bool:
        """Whether a receiver is looked for by NAME on a bus on which nobody tells one, nor is asked."""
        named = any(r.bus == bus.name and r.name is not None for r in self._machine.receiver)
        told = any(s.bus == bus.name and s.name is not None for s in self._senders.values())
        heard = any(s.bus == bus.name and s.frames for s in self._senders.values())
        return named and heard and not told and not bus.request_claims

    def _receiver(self, receiver: Receiver) -> CheckFinding:
        what, maker = f"receiver {receiver.mount}", receiver.manufacturer
        sender = self._of(receiver)
        if sender is None:
            return CheckFinding(
                what, Level.WARNING, f"{_wanted(receiver)} is not heard{self._instead(receiver)}"
            )
        if maker is not None and receiver.name is None and sender.maker not in (None, maker):
            text = f"address {sender.source} is {_maker(sender.maker, sender.group)}, the file says {maker}"
            return CheckFinding(what, Level.PROBLEM, f"{text}; correct its manufacturer or source")
        if self._used[receiver.mount]:
            return CheckFinding(what, Level.OK, f"{self._used[receiver.mount]} positions")
        if sender.bus != receiver.bus:
            text = f"{_wanted(receiver)} is heard on {sender.bus}"
            return CheckFinding(what, Level.PROBLEM, f"{text}; correct its bus")
        if sender.positions or sender.empty_positions:
            why = "no fix yet, or its antenna is not connected"
            return CheckFinding(what, Level.WARNING, f"{sender} sends positions without a value: {why}")
        return CheckFinding(what, Level.WARNING, f"{sender} sends no positions{self._instead(receiver)}")

    def _of(self, receiver: Receiver) -> _BusAddress | None:
        """The sender that is this receiver, on its configured bus if it is there; None: it is silent."""
        found = [
            sender
            for sender in self._senders.values()
            if sender.frames
            and (
                sender.name == receiver.name
                if receiver.name is not None
                else sender.source == receiver.source
            )
            and (receiver.name is not None or sender.bus == receiver.bus or sender in self._strangers())
        ]
        return min(found, key=lambda s: (s.bus != receiver.bus, not s.positions), default=None)

    def _instead(self, receiver: Receiver) -> str:
        """End of a sentence: senders of positions that may be the receiver meant."""
        others = [s for s in self._strangers() if s.positions or s.empty_positions]
        others.sort(key=lambda s: (s.bus != receiver.bus, not s.positions, _distance(receiver, s)))
        if others:
            candidates = "; ".join(str(sender) for sender in others[:MOST_CANDIDATES])
            hint = ""
            if receiver.name is not None and any(sender.name is None for sender in others):
                hint = " (devices claim their address when they are switched on: do so, or give source)"
            return f"; positions come from {candidates}{hint}"
        return "; nobody else sends positions: is it switched on?"

    def _strangers(self) -> list[_BusAddress]:
        """Senders that are none of the file's receivers."""
        known = {(r.bus, r.source) for r in self._machine.receiver if r.name is None}
        names = {r.name for r in self._machine.receiver if r.name is not None}
        return [
            sender
            for place, sender in sorted(self._senders.items())
            if place not in known and (sender.name is None or sender.name not in names)
        ]

    def _wheel(self) -> CheckFinding:
        what, given = "wheel angle", self._machine.wheel_angle
        if self._angles:
            return CheckFinding(what, Level.OK, f"{self._angles} angles")
        sensor = self._sensor
        wanted = f"0x{sensor.can_id:X}" if given.pgn is None else f"PGN {RUDDER} from address {given.source}"
        if self._wheel_frames:
            text = f"{self._wheel_frames} frames of {wanted}, none with an angle"
            text += "; check bits, scale, not_available"
            return CheckFinding(what, Level.WARNING, text)
        near = sorted(filter(self._may_be_wheel, self._identifiers), key=self._apart)
        alike = [key for key in near if not self._apart(key)[0]]  # the same message, from elsewhere
        near = alike or near
        candidates = ", ".join(f"0x{can_id:X} on {bus}" for bus, can_id, _ in near[:MOST_CANDIDATES])
        hint = f"; the nearest that are heard: {candidates}" if near else "; is the sensor switched on?"
        return CheckFinding(what, Level.WARNING, f"no frame {wanted} is heard on {sensor.bus}{hint}")

    def _scale(self, signal: CanSignal) -> CheckFinding:
        wanted = f"0x{signal.can_id:X}"
        if self._weights:
            return CheckFinding("scale", Level.OK, f"{self._weights} weights")
        if self._weighing_frames:
            text = f"{self._weighing_frames} frames of {wanted}, none with a weight; check not_available"
            return CheckFinding("scale", Level.WARNING, text)
        text = f"no frame {wanted} is heard on {signal.bus}; is the scale switched on?"
        return CheckFinding("scale", Level.WARNING, text)

    def _may_be_wheel(self, key: tuple[str, int, bool]) -> bool:
        _, can_id, extended = key
        if not extended or not self._sensor.extended:
            return extended == self._sensor.extended
        pgn = split(can_id).pgn
        return pgn == split(self._sensor.can_id).pgn or any(pgn in pgns for pgns in _PROPRIETARY_PGNS)

    def _apart(self, key: tuple[str, int, bool]) -> tuple[bool, bool, bool, int]:
        bus, can_id, extended = key
        ours, theirs = split(self._sensor.can_id), split(can_id)
        alike = extended and self._sensor.extended
        return (
            not (alike and theirs.pgn == ours.pgn),
            not (alike and theirs.source == ours.source),
            bus != self._sensor.bus,
            abs(can_id - self._sensor.can_id),
        )


def _maker(code: int | None, group: int | None) -> str:
    if code is None:
        return "of an unknown manufacturer"
    return f"{manufacturer_name(code, group) or 'manufacturer'} ({code})"


def _wanted(receiver: Receiver) -> str:
    return f"NAME {receiver.name:016X}" if receiver.name is not None else f"address {receiver.source}"


def _distance(receiver: Receiver, sender: _BusAddress) -> int:
    """How unlike a sender and a receiver are: bits of the NAME that differ, or the distance of addresses."""
    if receiver.name is not None:
        return (receiver.name ^ sender.name).bit_count() if sender.name is not None else 64
    return abs((receiver.source or 0) - sender.source)
