"""Binds source addresses to NAMEs and NAMEs to the receivers of the machine file.

A source address is no identity: identical receivers all prefer the same one and settle it by address claims
(SAE J1939-81, ISO 11783-5), differently at every key-on. The 64-bit NAME is one. Where no claim is heard, the
machine file may say whose an address is.

Rules, per bus:
- A claim binds its address to its NAME and frees the address that the NAME had.
- Of two NAMEs on one address the lower keeps it; the other is unbound until it claims anew. Until the holder
  has answered a higher NAME's claim, or the challenger has gone elsewhere, frames from that address are in
  quarantine: both may be sending. After CONTENTION_NS without either, the holder keeps it if it was heard
  lately; else it is gone and the challenger has it.
- A claim from 254 says "cannot claim": the NAME has no address.
- A receiver given by `source` alone takes the NAME of the first fitting claim for that address, and keeps it.
- Where an address goes on speaking after its NAME has gone elsewhere, two devices have that NAME. It
  identifies neither: a receiver given by `source` stays with its address.
- Devices claim when they are switched on, not when we begin to listen. Who stands where may be known
  otherwise (`place`): from before, or by where they are. It holds until a claim says another thing.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

from tilth.schemas.can_id import NULL_ADDRESS
from tilth.schemas.fields import DEG
from tilth.schemas.flow import EventKind, Mount, Origin
from tilth.schemas.machine import Receiver
from tilth.schemas.notices import Notice, NoticeCode, notice
from tilth.schemas.rejections import Rejection

CONTENTION_NS = 250_000_000  # a holder answers within this (SAE J1939-81, 4.2.2)
LATELY_NS = 5_000_000_000
NO_NAME = (1 << 64) - 1


class Name(NamedTuple):
    """The parts of a 64-bit NAME that tell two receivers apart."""

    identity: int
    manufacturer: int


def split_name(name: int) -> Name:
    """Identity number (bits 0 to 20) and manufacturer code (bits 21 to 31) of a NAME (SAE J1939-81)."""
    return Name(name & 0x1FFFFF, name >> 21 & 0x7FF)


class Deviation(NamedTuple):
    """Standard deviations of what a receiver reports, SI and radians."""

    position: float
    velocity: float
    yaw_rate: float
    heading: float
    roll: float


@dataclass(slots=True)
class Sender:
    """What is known of one source address; kept current by the AddressBook."""

    bus: str
    source: int
    origin: Origin
    manufacturer: int | None = None
    sd: Deviation | None = None  # of the receiver that it is; None: it is none of the machine file
    reason: Rejection = Rejection.UNKNOWN_SOURCE  # why it is none
    unknown: int = 0  # messages that made no measurement for that reason
    received_ns: int = 0  # the latest message or claim from it
    contested: bool = False  # two NAMEs claim it, or its NAME has left: ask `settle` whether that is over
    positions: dict[int, bytes] = field(default_factory=dict)  # by PGN: raw latitude and longitude before


@dataclass(slots=True)
class _Contest:
    challenger: int
    until_ns: int
    alive: bool  # the holder was heard from lately


@dataclass(frozen=True, slots=True)
class KnownAddress:
    """Who has an address, for the next run and for who begins to listen later."""

    bus: str
    source: int
    name: int | None  # as claimed
    mount: Mount | None  # the receiver of the machine file that it is
    last_ns: int = 0  # when its bus was last heard before; 0: not known on this clock


@dataclass(slots=True)
class _Left:
    """A NAME has gone from an address to another one."""

    name: int
    to: int
    at_ns: int
    sure: bool = False  # it would have been heard again by now


@dataclass(slots=True)
class _Bus:
    holder: dict[int, int] = field(default_factory=dict)  # source -> NAME
    contests: dict[int, _Contest] = field(default_factory=dict)  # by source
    claimed: set[int] = field(default_factory=set)  # sources that any claim was heard for
    ours: set[int] = field(default_factory=set)  # sources that were a receiver's of the machine file
    adopted: dict[int, Mount] = field(default_factory=dict)  # NAME -> receiver given by source alone
    known: set[Mount] = field(default_factory=set)  # receivers whose claim was heard
    left: dict[int, _Left] = field(default_factory=dict)  # by source, until somebody claims it
    twins: set[int] = field(default_factory=set)  # NAMEs that two devices have
    placed: dict[int, KnownAddress] = field(default_factory=dict)  # by source: known without a claim


class AddressBook:
    """Claims heard so far, on every bus."""

    __slots__ = (
        "_buses",
        "_by_name",
        "_by_source",
        "_receivers",
        "_sd",
        "_senders",
        "mistaken",
        "news",
        "unplaced",
    )

    def __init__(self, receivers: Sequence[Receiver]) -> None:
        self._receivers = {receiver.mount: receiver for receiver in receivers}
        self._sd = {receiver.mount: _deviation(receiver) for receiver in receivers}
        names = [(r.bus, r.name) for r in receivers]
        self._by_name = {
            (r.bus, r.name): r.mount
            for r in receivers
            if r.name is not None and names.count((r.bus, r.name)) == 1
        }
        sources = [(r.bus, r.source) for r in receivers]
        self._by_source = {
            (r.bus, r.source): r.mount
            for r in receivers
            if r.source is not None and sources.count((r.bus, r.source)) == 1
        }
        self._buses: dict[str, _Bus] = {}
        self._senders: dict[tuple[str, int], Sender] = {}
        self.news: list[tuple[str, Notice]] = []  # kinds of events, and what they tell
        self.mistaken: set[Mount] = set()  # what they have sent may have been another's; until it is taken
        self.unplaced = self._unplaced()

    def sender(self, bus: str, source: int) -> Sender:
        """The one record of a source address."""
        sender = self._senders.get((bus, source))
        if sender is None:
            sender = Sender(bus, source, Origin(bus, source))
            self._senders[bus, source] = sender
            self._refresh(sender)
        return sender

    @property
    def unknown(self) -> dict[Origin, int]:
        """Counts of measurement messages from senders that are no receiver of the machine file."""
        return {s.origin: s.unknown for s in self._senders.values() if s.unknown}

    @property
    def twins(self) -> frozenset[tuple[str, int]]:
        """(bus, NAME) of the NAMEs that two devices have."""
        return frozenset((bus, name) for bus, book in self._buses.items() for name in book.twins)

    def mount_of(self, bus: str, name: int) -> Mount | None:
        """The receiver of the machine file with that NAME, if it is one device's."""
        if name in self._bus(bus).twins:
            return None
        return self._by_name.get((bus, name)) or self._bus(bus).adopted.get(name)

    def claim(self, bus: str, source: int, name: int, t_ns: int) -> Rejection | None:
        """Take an address claim. Returns a reason to count where it is contested or invalid."""
        if name == NO_NAME or source > NULL_ADDRESS:
            return Rejection.NOT_AVAILABLE
        book = self._bus(bus)
        self._settle_due(book, bus, t_ns)
        if name not in book.twins:
            self._leave(book, bus, name, source, t_ns)
            self._outdate(book, bus, name, source)
        book.left.pop(source, None)
        contested = None
        if source != NULL_ADDRESS:
            holder = book.holder.get(source)
            if holder is None or name <= holder:
                book.contests.pop(source, None)
                self._bind(book, bus, source, name)
            elif source not in book.contests:
                alive = t_ns - self.sender(bus, source).received_ns <= LATELY_NS
                book.contests[source] = _Contest(name, t_ns + CONTENTION_NS, alive)
            book.claimed.add(source)
            self.sender(bus, source).received_ns = t_ns
            if holder is not None and holder != name:
                contested = Rejection.ADDRESS_CONFLICT
        self._refresh_bus(bus)
        return contested

    def settle(self, sender: Sender, t_ns: int) -> None:
        """End the contests on that bus whose time is over."""
        book = self._bus(sender.bus)
        if self._settle_due(book, sender.bus, t_ns) | self._find_twin(book, sender, t_ns):
            self._refresh_bus(sender.bus)

    def _find_twin(self, book: _Bus, sender: Sender, t_ns: int) -> bool:
        """See what a message from a contested address tells of a NAME that has gone. Whether that settles it.

        A device that goes to another address is silent on the one before.
        """
        settled = False
        for source, left in list(book.left.items()):
            age_ns = t_ns - left.at_ns
            if 0 <= age_ns <= CONTENTION_NS:  # frames of before may still be on their way
                continue
            settled |= not left.sure
            left.sure = True
            if not 0 <= age_ns <= LATELY_NS:
                del book.left[source]
            elif source == sender.source:
                del book.left[source]
                self._found_twins(book, sender.bus, source, left)
                settled = True
        return settled

    def _found_twins(self, book: _Bus, bus: str, source: int, left: _Left) -> None:
        book.twins.add(left.name)
        book.holder[source] = left.name
        known = {book.adopted.pop(left.name, None), self._by_name.get((bus, left.name))}
        mounts = {mount for mount in known if mount is not None}
        book.known -= mounts
        self.mistaken |= mounts
        told = notice(NoticeCode.TWIN_NAME, name=f"{left.name:016X}", source=source, other=left.to, bus=bus)
        self.news.append((EventKind.TWIN_NAME, told))

    def _outdate(self, book: _Bus, bus: str, name: int, source: int) -> None:
        """A claim wins over what is known otherwise."""
        mount = self.mount_of(bus, name)
        for at, known in list(book.placed.items()):
            if at == source or known.name == name or (mount is not None and known.mount == mount):
                del book.placed[at]

    def _settle_due(self, book: _Bus, bus: str, t_ns: int) -> bool:
        settled = False
        for source, contest in list(book.contests.items()):
            if not 0 < contest.until_ns - t_ns <= CONTENTION_NS:  # over, or the clock stepped back
                del book.contests[source]
                if not contest.alive:
                    self._bind(book, bus, source, contest.challenger)
                settled = True
        return settled

    def _leave(self, book: _Bus, bus: str, name: int, source: int, t_ns: int) -> None:
        """A NAME that claims one address has left every other, and what it contested."""
        for at, contest in list(book.contests.items()):
            if contest.challenger == name and at != source:
                del book.contests[at]
        for at in [at for at, holder in book.holder.items() if holder == name and at != source]:
            del book.holder[at]
            if at in book.contests:
                self._bind(book, bus, at, book.contests.pop(at).challenger)
            elif source != NULL_ADDRESS:
                book.left[at] = _Left(name, source, t_ns)

    def _bind(self, book: _Bus, bus: str, source: int, name: int) -> None:
        book.holder[source] = name
        mount = self.mount_of(bus, name)
        if mount is None and name in book.twins:
            return
        if mount is None:
            mount = self._by_source.get((bus, source))
            if mount is None or mount in book.known or not _fits(self._receivers[mount], name):
                return
            book.adopted[name] = mount
        book.known.add(mount)
        book.ours.add(source)

    def _bus(self, bus: str) -> _Bus:
        book = self._buses.get(bus)
        if book is None:
            book = self._buses[bus] = _Bus(ours={s for b, s in self._by_source if b == bus and s is not None})
        return book

    def _refresh_bus(self, bus: str) -> None:
        for sender in self._senders.values():
            if sender.bus == bus:
                self._refresh(sender)
        self.unplaced = self._unplaced()

    def place(self, known: KnownAddress) -> None:
        """Take it that an address is a receiver's, until a claim says another thing; in place of where that
        receiver was placed before."""
        book = self._bus(known.bus)
        for at, before in list(book.placed.items()):
            if known.mount is not None and before.mount == known.mount:
                del book.placed[at]
        book.placed[known.source] = known
        self._refresh_bus(known.bus)

    def recall(self, known: KnownAddress) -> Mount | None:
        """Take it that an address is whose it was before, unless a claim says another thing. Returns the
        receiver that it is, if any."""
        book = self._bus(known.bus)
        mount = known.mount
        if known.name is not None:
            mount = self.mount_of(known.bus, known.name) or mount
        receiver = self._receivers.get(mount) if mount is not None else None
        if receiver is None or receiver.bus != known.bus:
            mount = None
        if known.source in book.claimed or mount in book.known or (mount is None and known.name is None):
            return None
        self.place(replace(known, mount=mount))
        return mount

    def displace(self) -> list[Mount]:
        """Forget what is only known from before. Returns the receivers that stood there."""
        out = []
        for bus, book in self._buses.items():
            for source, known in list(book.placed.items()):
                if known.last_ns and known.mount is not None:
                    del book.placed[source]
                    out.append(known.mount)
            self._refresh_bus(bus)
        return out

    def candidate(self, sender: Sender) -> bool:
        """Whether a sender may be a receiver whose address is not known: nobody else's name stands there."""
        if sender.origin.mount is not None or not self.unplaced:
            return False
        book = self._bus(sender.bus)
        name = self._who(book, sender.bus, sender.source)[0]
        return sender.source not in book.contests and (name is None or name in book.twins)

    def known(self) -> list[KnownAddress]:
        """Who has which address, as far as known."""
        out = []
        for bus, book in sorted(self._buses.items()):
            for source in sorted({*book.holder, *book.placed}):
                name, mount = self._who(book, bus, source)
                if source not in book.contests:
                    out.append(KnownAddress(bus, source, None if name in book.twins else name, mount))
        return out

    def _unplaced(self) -> frozenset[Mount]:
        """Receivers of the machine file of which nobody knows the address."""
        placed = set()
        for bus in {receiver.bus for receiver in self._receivers.values()}:
            book = self._bus(bus)
            declared = {source for b, source in self._by_source if b == bus and source is not None}
            for source in {*book.holder, *book.placed, *declared}:
                placed.add(self._who(book, bus, source)[1])
        return frozenset(mount for mount in self._receivers if mount not in placed)

    def _refresh(self, sender: Sender) -> None:
        book = self._bus(sender.bus)
        contest = book.contests.get(sender.source)
        moved = sender.source in book.left or any(left.to == sender.source for left in book.left.values())
        sender.contested = contest is not None or moved
        name, mount = self._who(book, sender.bus, sender.source)
        origin = Origin(sender.bus, sender.source, name, mount)
        if origin != sender.origin:
            sender.origin = origin
        sender.sd = self._sd[mount] if mount is not None else None
        sender.manufacturer = None
        if name is not None:
            sender.manufacturer = split_name(name).manufacturer
        elif mount is not None:
            sender.manufacturer = _manufacturer(self._receivers[mount])
        sender.reason = Rejection.UNKNOWN_SOURCE
        if name in book.twins:
            sender.reason = Rejection.TWIN_NAME
        elif contest or sender.source in book.ours:
            sender.reason = Rejection.QUARANTINE

    def _who(self, book: _Bus, bus: str, source: int) -> tuple[int | None, Mount | None]:
        """NAME and receiver of an address, as far as known."""
        if source in book.contests or self._arriving(book, bus, source):
            return None, None
        known = book.placed.get(source)
        if known is not None:
            return known.name, known.mount
        name = book.holder.get(source)
        mount = self._by_source.get((bus, source))
        if name in book.twins:
            right = mount is not None and self._receivers[mount].name in (None, name)
            return name, mount if right else None
        if name is not None:
            return name, self.mount_of(bus, name)
        elsewhere = any(placed.mount == mount for placed in book.placed.values())
        if source in book.claimed or mount in book.known or elsewhere:
            return None, None
        return None, mount

    def _arriving(self, book: _Bus, bus: str, source: int) -> bool:
        """Whether a NAME has just come to an address that the machine file gives to another receiver: its
        device may have gone there, or another one may have the same NAME."""
        for left in book.left.values():
            if left.to == source and not left.sure:
                return self._by_source.get((bus, source)) not in (None, self.mount_of(bus, left.name))
        return False

    def dump(self) -> dict[str, object]:
        """Claims and what depends on them, for JSON."""
        return {
            "buses": {bus: _dump_bus(book) for bus, book in self._buses.items()},
            "senders": [
                [
                    s.bus,
                    s.source,
                    s.received_ns,
                    {str(pgn): raw.hex() for pgn, raw in s.positions.items()},
                    s.unknown,
                ]
                for s in self._senders.values()
            ],
        }

    def load(self, state: Mapping[str, Any]) -> None:
        """Go on from what `dump` gave. Senders handed out before stay valid."""
        self._buses = {bus: _load_bus(bus, book) for bus, book in state["buses"].items()}
        for sender in self._senders.values():
            sender.received_ns, sender.positions, sender.unknown = 0, {}, 0
        for bus, source, received_ns, positions, *unknown in state["senders"]:
            sender = self.sender(bus, source)
            sender.received_ns = received_ns
            sender.unknown = sum(unknown)  # logs from before it was counted have none
            sender.positions = {int(pgn): bytes.fromhex(raw) for pgn, raw in positions.items()}
        for sender in self._senders.values():
            self._refresh(sender)
        self.unplaced = self._unplaced()


def _deviation(receiver: Receiver) -> Deviation:
    return Deviation(
        receiver.position_sd,
        receiver.velocity_sd,
        receiver.yaw_rate_sd * DEG,
        receiver.heading_sd * DEG,
        receiver.roll_sd * DEG,
    )


def _manufacturer(receiver: Receiver) -> int | None:
    if receiver.manufacturer is None and receiver.name is not None:
        return split_name(receiver.name).manufacturer
    return receiver.manufacturer


def _fits(receiver: Receiver, name: int) -> bool:
    """May a receiver of the machine file, given by source alone, be the one with this NAME?"""
    return receiver.name is None and receiver.manufacturer in (None, split_name(name).manufacturer)


def _dump_bus(book: _Bus) -> dict[str, object]:
    return {
        "holder": {str(source): f"{name:016X}" for source, name in book.holder.items()},
        "contests": {
            str(source): [f"{contest.challenger:016X}", contest.until_ns, contest.alive]
            for source, contest in book.contests.items()
        },
        "claimed": sorted(book.claimed),
        "ours": sorted(book.ours),
        "adopted": {f"{name:016X}": mount.value for name, mount in book.adopted.items()},
        "known": sorted(mount.value for mount in book.known),
        "left": {
            str(at): [f"{left.name:016X}", left.to, left.at_ns, left.sure] for at, left in book.left.items()
        },
        "twins": [f"{name:016X}" for name in sorted(book.twins)],
        "placed": [
            [known.source, known.name and f"{known.name:016X}", known.mount, known.last_ns]
            for known in book.placed.values()
        ],
    }


def _load_bus(bus: str, state: Mapping[str, Any]) -> _Bus:
    return _Bus(
        {int(source): int(name, 16) for source, name in state["holder"].items()},
        {
            int(source): _Contest(int(challenger, 16), until_ns, alive)
            for source, (challenger, until_ns, alive) in state["contests"].items()
        },
        set(state["claimed"]),
        set(state["ours"]),
        {int(name, 16): Mount(mount) for name, mount in state["adopted"].items()},
        {Mount(mount) for mount in state["known"]},
        # Logs from before these were known have none.
        {int(at): _Left(int(row[0], 16), *row[1:]) for at, row in state.get("left", {}).items()},
        {int(name, 16) for name in state.get("twins", ())},
        {
            source: KnownAddress(bus, source, name and int(name, 16), mount and Mount(mount), last_ns)
            for source, name, mount, last_ns in state.get("placed", ())
        },
    )
