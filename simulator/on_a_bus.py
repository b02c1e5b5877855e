"""A scenario on somebody's bus, in real time, as the virtual tractor's devices would send it.

Whoever steers by the positions on a bus must never take these for real ones: before the first frame and all
the time while it sends, this listens, and it sends nothing more once another device is heard that tells a
position, or that has an address, a NAME or an identifier of the scenario's.
"""

import ipaddress
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from itertools import takewhile
from typing import Any, Final

import can

from tilth.logger.can import can_link
from tilth.logger.can.bus_opening import check_interface, why_not
from tilth.logger.clock import Clock
from tilth.schemas.can_id import NULL_ADDRESS, split
from tilth.schemas.flow import Frame
from tilth.schemas.machine import Bus, Machine
from tilth.schemas.pgn_table import PGNS
from tilth.simulator.tractor import Truth
from tilth.simulator.traffic import traffic

LISTEN_S: Final = {True: 1.5, False: 6.0}  # before sending: here, and on a wire; some send each 5 s only
LEAD_NS: Final = 400_000_000  # from the decision to send to the first frame
FIRST_S: Final = 2.0  # of the run, in which every device of it has sent
TICK_S: Final = 0.002
ECHO_NS: Final = 3_000_000_000  # a frame heard so soon after the same one was sent may be that itself
LATE_NS: Final = 200_000_000

CLAIM: Final = 60928
POSITIONS: Final = {row.pgn: row.title for row in PGNS if {"latitude_deg", "fix"} & set(row.signals)}


class CannotSend(Exception):
    """Why nothing, or nothing more, is sent; one sentence."""


def stays_here(bus: Bus) -> bool:
    """Whether what is sent there reaches programs of this computer only."""
    if bus.interface == "virtual":
        return True
    if bus.interface == "udp_multicast":
        return bus.options.get("hop_limit") == 0 and ipaddress.ip_address(str(bus.channel)).is_multicast
    return bus.interface == "socketcan" and can_link.is_virtual(str(bus.channel))


def opened(bus: Bus) -> can.BusABC:
    """Open for sending and listening. Raises MachineError, CannotSend."""
    check_interface(bus)
    arguments: dict[str, Any] = {"bitrate": bus.bitrate, **bus.options}
    try:
        return can.Bus(channel=bus.channel, interface=bus.interface, ignore_config=True, **arguments)
    except Exception as error:  # a driver may raise anything
        raise CannotSend(why_not(error, bus)) from None


_Key = tuple[str, int, bytes]
"""Bus, identifier, data."""


@dataclass(slots=True)
class Watch:
    """Tells the frames of others from our own, and what of them forbids to send."""

    addresses: set[tuple[str, int]]  # bus, source address
    identifiers: set[tuple[str, int]]  # bus, 11-bit identifier
    names: set[bytes]
    _sent: deque[tuple[int, _Key]] = field(default_factory=deque)
    _echoes: dict[_Key, deque[int]] = field(default_factory=dict)  # when sent, not yet heard

    def sent(self, t_ns: int, frame: Frame) -> None:
        """Note a frame that was sent at t_ns: the bus may echo it."""
        key = (frame.bus, frame.can_id, frame.data)
        self._sent.append((t_ns, key))
        self._echoes.setdefault(key, deque()).append(t_ns)
        while self._sent[0][0] < t_ns - ECHO_NS:
            self._forget(*self._sent.popleft())

    def _forget(self, t_ns: int, key: _Key) -> None:
        times = self._echoes.get(key, ())
        if times and times[0] <= t_ns:
            self._echoes[key].popleft()
        if not times:
            self._echoes.pop(key, None)

    def forbids(self, bus: str, can_id: int, extended: bool, data: bytes) -> str:
        """Why this frame of a bus forbids to send, "" where it does not."""
        times = self._echoes.get((bus, can_id, data))
        if times:
            times.popleft()
            return ""
        if not extended:
            taken = (bus, can_id) in self.identifiers
            return f"another device sends the identifier 0x{can_id:03X} of the scenario" if taken else ""
        parts = split(can_id)
        if parts.pgn in POSITIONS:
            return f"a receiver is heard: address {parts.source} sends {parts.pgn} ({POSITIONS[parts.pgn]})"
        if parts.pgn == CLAIM and data in self.names:
            return f"address {parts.source} claims the NAME of a device of the scenario"
        if (bus, parts.source) in self.addresses:
            return f"another device has address {parts.source}, which the scenario uses"
        return ""


def watch_of(frames: list[Frame]) -> Watch:
    """What others may not have, by what the scenario sends."""
    addresses, identifiers, names = set(), set(), set()
    for frame in frames:
        if not frame.extended:
            identifiers.add((frame.bus, frame.can_id))
            continue
        parts = split(frame.can_id)
        if parts.source != NULL_ADDRESS:
            addresses.add((frame.bus, parts.source))
        if parts.pgn == CLAIM:
            names.add(frame.data)
    return Watch(addresses, identifiers, names)


@dataclass(slots=True)
class Sent:
    frames: int = 0
    late: int = 0  # of them behind the clock
    stopped: str = ""  # why before the end


def send(machine: Machine, truth: Truth, places: Mapping[str, Bus], say: Callable[[str], None]) -> Sent:
    """Put a run on buses: {bus of the machine file: where}. Blocks until its end.

    Raises MachineError, CannotSend before the first frame.
    """
    clock = Clock()
    with ExitStack() as stack:
        buses = {name: stack.enter_context(opened(place)) for name, place in places.items()}
        first = list(
            takewhile(lambda f: f.t_ns < truth.scenario.utc_start_ns + FIRST_S * 1e9, traffic(machine, truth))
        )
        watch = watch_of(first)
        seconds = LISTEN_S[all(map(stays_here, places.values()))]
        say(f"listening for {seconds:g} s")
        until_ns = clock.t_ns() + int(seconds * 1e9)
        while clock.t_ns() < until_ns:
            reason = _stop_reason(buses, watch, TICK_S)
            if reason:
                raise CannotSend(f"{reason}; nothing was sent")
        start_ns = (clock.t_ns() + LEAD_NS) // 10_000_000 * 10_000_000
        begun = replace(truth, scenario=replace(truth.scenario, utc_start_ns=start_ns))
        say("sending")
        return play(traffic(machine, begun), buses, watch, clock, places)


def play(
    frames: Iterator[Frame],
    buses: Mapping[str, can.BusABC],
    watch: Watch,
    clock: Clock,
    places: Mapping[str, Bus],
) -> Sent:
    """Send each frame when its t_ns has come, until there are no more or somebody is heard."""
    done = Sent()
    for frame in frames:
        while True:
            remaining_s = (frame.t_ns - clock.t_ns()) * 1e-9
            done.stopped = _stop_reason(buses, watch, min(max(remaining_s, 0.0), TICK_S))
            if done.stopped:
                return done
            if remaining_s <= 0.0:
                break
        t_ns = clock.t_ns()
        done.late += t_ns - frame.t_ns > LATE_NS
        watch.sent(t_ns, frame)
        try:
            buses[frame.bus].send(
                can.Message(arbitration_id=frame.can_id, is_extended_id=frame.extended, data=frame.data), 1.0
            )
        except Exception as error:  # a driver may raise anything
            done.stopped = why_not(error, places[frame.bus])
            return done
        done.frames += 1
    return done


def _stop_reason(buses: Mapping[str, can.BusABC], watch: Watch, timeout_s: float) -> str:
    """Take what others have sent; why it forbids to send, "" where it does not."""
    share_s = timeout_s / len(buses)
    for name, bus in buses.items():
        message = bus.recv(share_s)
        while message is not None:
            if not (message.is_error_frame or message.is_remote_frame):
                reason = watch.forbids(
                    name, message.arbitration_id, message.is_extended_id, bytes(message.data)
                )
                if reason:
                    return f"{name}: {reason}"
            message = bus.recv(0)
    return ""
