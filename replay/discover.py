"""Surveys the frames of buses: the devices, possible receivers, and signals that may be the wheel angle.

Nothing is ever sent. `machine_draft.py` makes a machine file of the findings.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

from tilth.logger.can.lean_can import import_can
from tilth.logger.clock import Clock
from tilth.replay.mount_order import MountOrder
from tilth.replay.turn_rates import TurnRates
from tilth.replay.wheel_search import PROPRIETARY, WheelCandidate, candidates, may_hold_it
from tilth.schemas.can_id import NULL_ADDRESS, split
from tilth.schemas.decode import Decoder
from tilth.schemas.device_names import name_parts, name_words
from tilth.schemas.flow import Frame, Message
from tilth.schemas.machine import Bus
from tilth.schemas.notices import Report
from tilth.schemas.pgn_table import PGNS
from tilth.schemas.pgn_titles import title_of

CLAIM: Final = 60928
MOST_SAMPLES: Final = 12_000  # of one identifier: two minutes at 100 Hz
_SELECTED: Final = frozenset(known.pgn for known in PGNS if known.selector is not None)
_FAST: Final = frozenset(known.pgn for known in PGNS if known.fast)
_POSITIONS: Final = frozenset(known.pgn for known in PGNS if "latitude_deg" in known.signals)


@dataclass(frozen=True, slots=True)
class SentMessage:
    pgn: int
    selector: int | None  # byte 0 of 65535
    title: str
    count: int
    per_s: float  # 0: an event


@dataclass(frozen=True, slots=True)
class BusDevice:
    """The device that sends from one address of one bus."""

    bus: str
    source: int
    name: int | None
    manufacturer: int | None
    function: int | None
    messages: tuple[SentMessage, ...]
    positions: int  # position messages that hold one
    empty_positions: int  # position messages that say "not available"
    turn_rate_lag: tuple[float, float] | None = None  # s, and its sd: of one that is smoothed
    shares_name: bool = False  # another device has the same NAME
    moved: bool = False  # its NAME is at another address by now

    @property
    def manufacturer_name(self) -> str:
        return "" if self.name is None else name_words(self.name).get("manufacturer_name", "")

    @property
    def function_name(self) -> str:
        return "" if self.name is None else name_words(self.name).get("function_name", "")

    @property
    def sends_positions(self) -> bool:
        return self.positions + self.empty_positions > 0


@dataclass(frozen=True, slots=True)
class Findings:
    frames: int
    seconds: float
    buses: tuple[str, ...]
    sources: tuple[BusDevice, ...]
    wheel_angles: tuple[WheelCandidate, ...]  # the likeliest first
    front_to_rear: tuple[tuple[str, int], ...] = ()  # bus, address of receivers as they follow each other

    @property
    def receivers(self) -> tuple[BusDevice, ...]:
        return tuple(source for source in self.sources if source.sends_positions and not source.moved)


@dataclass(slots=True)
class _Times:
    """When a message came."""

    first_ns: int
    last_ns: int
    count: int = 0

    @property
    def per_s(self) -> float:
        """1/s; 0 for a message that came a few times within a second: an event has no rate."""
        seconds = (self.last_ns - self.first_ns) * 1e-9
        return (self.count - 1) / seconds if seconds > 1.0 else 0.0


@dataclass(slots=True)
class _Speaker:
    name: int | None = None
    messages: dict[tuple[int, int | None], _Times] = field(default_factory=dict)
    positions: int = 0
    empty_positions: int = 0


@dataclass(slots=True)
class _Identifier:
    times_ns: list[int] = field(default_factory=list)
    data: list[bytes] = field(default_factory=list)


def listen(
    configs: Sequence[Bus], seconds: float, report: Report, stop: Callable[[], bool]
) -> Iterator[Frame]:
    """Frames of these buses for so long, or until `stop()`. `report`: takes a problem with a bus.

    Raises MachineError where a bus names an interface that python-can does not know.
    """
    import_can()  # here, since who looks into a log needs none of it
    from tilth.logger.can.buses import Buses

    clock = Clock()
    buses = Buses(configs, clock, report)
    end_ns = clock.t_ns() + int(seconds * 1e9)
    try:
        while clock.t_ns() < end_ns and not stop():
            yield from buses.read(0.1)
    finally:
        buses.close()


class BusSurvey:
    """`take` every frame in its order, then ask for `findings`."""

    def __init__(self) -> None:
        self._decoder = Decoder()
        self._frames = 0
        self._first_ns: int | None = None
        self._last_ns = 0
        self._buses: dict[str, None] = {}
        self._speakers: dict[tuple[str, int], _Speaker] = {}
        self._identifiers: dict[tuple[str, int, bool], _Identifier] = {}
        self._yaw: dict[tuple[str, int], list[tuple[int, float]]] = {}
        self._turn_rates = TurnRates()
        self._order = MountOrder()

    def take(self, frame: Frame) -> None:
        """Take a frame; error frames do not count."""
        self._frames += 1
        self._last_ns = frame.rx_ns
        if self._first_ns is None:
            self._first_ns = frame.rx_ns
        self._buses[frame.bus] = None
        if frame.error:
            return
        self._count(frame)
        for message in self._decoder.messages(frame):
            self._take_message(message)

    def findings(self) -> Findings:
        """All devices, and the candidates for the wheel angle, the best first."""
        seconds = (self._last_ns - (self._first_ns or 0)) * 1e-9
        lags = self._turn_rates.smoothed()
        return Findings(
            self._frames,
            seconds,
            tuple(self._buses),
            tuple(
                self._named(_source(bus, source, speaker, lags.get((bus, source))))
                for (bus, source), speaker in sorted(self._speakers.items())
                if source != NULL_ADDRESS
            ),
            tuple(sorted(self._wheel_angles(), key=lambda candidate: candidate.score, reverse=True)),
            self._order.front_to_rear(),
        )

    def _named(self, device: BusDevice) -> BusDevice:
        """With what is known by now of its NAME."""
        if device.name is None:
            return device
        held = self._decoder.origin(device.bus, device.source).name == device.name
        shares = (device.bus, device.name) in self._decoder.addresses.twins
        elsewhere = any(
            known.bus == device.bus and known.name == device.name and known.source != device.source
            for known in self._decoder.addresses.known()
        )
        return replace(device, shares_name=shares, moved=not held and not shares and elsewhere)

    def _count(self, frame: Frame) -> None:
        pgn = None
        if frame.extended:
            can_id = split(frame.can_id)
            pgn = can_id.pgn
            selector = frame.data[0] if pgn in _SELECTED and frame.data else None
            if pgn not in _FAST or (frame.data and frame.data[0] & 0x1F == 0):
                times = self._speaker(frame.bus, can_id.source).messages.setdefault(
                    (pgn, selector), _Times(frame.rx_ns, frame.rx_ns)
                )
                times.count += 1
                times.last_ns = frame.rx_ns
        if not may_hold_it(frame.can_id, frame.extended):
            return
        key = (frame.bus, frame.can_id, frame.extended)
        identifier = self._identifiers.setdefault(key, _Identifier())
        if len(identifier.data) < MOST_SAMPLES:
            identifier.times_ns.append(frame.rx_ns)
            identifier.data.append(frame.data)

    def _take_message(self, message: Message) -> None:
        self._turn_rates.take(message)
        self._order.take(message)
        origin = message.origin
        speaker = self._speaker(origin.bus, origin.source)
        if origin.name is not None:
            speaker.name = origin.name
        if message.pgn in _POSITIONS:
            held = "latitude_deg" in message.values
            speaker.positions += held
            speaker.empty_positions += not held
        yaw_rate = message.values.get("yaw_rate_radps")
        if yaw_rate is not None:
            series = self._yaw.setdefault((origin.bus, origin.source), [])
            series.append((message.rx_ns, float(yaw_rate)))

    def _speaker(self, bus: str, source: int) -> _Speaker:
        return self._speakers.setdefault((bus, source), _Speaker())

    def _wheel_angles(self) -> Iterator[WheelCandidate]:
        yaw = max(self._yaw.values(), key=len, default=[])
        for (bus, can_id, extended), identifier in self._identifiers.items():
            words = candidates(bus, can_id, extended, identifier.times_ns, identifier.data, yaw)
            best = max(words, key=lambda word: word.score, default=None)
            if best is not None:
                yield best


def _source(bus: str, source: int, speaker: _Speaker, lag: tuple[float, float] | None) -> BusDevice:
    parts = name_parts(speaker.name) if speaker.name is not None else {}
    manufacturer = parts.get("manufacturer")
    messages = tuple(
        SentMessage(pgn, selector, _title(pgn, selector, manufacturer), times.count, times.per_s)
        for (pgn, selector), times in sorted(
            speaker.messages.items(), key=lambda item: (item[0][0], item[0][1] or 0)
        )
    )
    return BusDevice(
        bus,
        source,
        speaker.name,
        manufacturer,
        parts.get("function"),
        messages,
        speaker.positions,
        speaker.empty_positions,
        lag,
    )


def _title(pgn: int, selector: int | None, manufacturer: int | None) -> str:
    for known in PGNS:
        if known.pgn == pgn and known.selector == selector and known.manufacturer in (None, manufacturer):
            return known.title
    return "proprietary" if pgn in PROPRIETARY else title_of(pgn)
