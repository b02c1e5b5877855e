"""The virtual tractor's CAN traffic: bit-exact frames, as a recorder on its buses would take them.

Who sends on the packaged machine's one bus, frames/s:

    StarFire-like receiver, two   102   65267, 65256, 65254, 65535/0xE1, 65535/0x53 and five further
                                        selectors at 5 Hz, 0xE0 at 1 Hz, one clump for each epoch
    NMEA 2000 receiver, two       116   129025, 129026, 127250, 127251, 127257 at 10 Hz; 129029 (seven
                                        frames) and 126992 at 1 Hz
    wheel-angle sensor            100
    tractor ECU                    30   65096, 65097, 44032 at 10 Hz
    all others                    452   engine, transmission, valves, virtual terminal, task controller,
                                        guidance: see other_traffic.ROWS
    together                      800   42 % of a bus of 250 kbit/s

Every frame waits for the bus and for what has a lower identifier, so frames never overlap, and a clump of ten
takes 10 to 30 ms.
"""

import heapq
import math
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Final

from tilth.schemas.decode import claim, encode, frames_of
from tilth.schemas.flow import Frame, Mount, Word
from tilth.schemas.machine import Bus, Machine, Receiver
from tilth.schemas.wheel_angle import compile_sensor
from tilth.simulator.drive import drive
from tilth.simulator.other_traffic import DEVICES, Sent, other_frames
from tilth.simulator.receivers import FIRST_EPOCH_S, Report, reports, star_fire_like, wheel_readings
from tilth.simulator.scenario import Scenario
from tilth.simulator.tractor import Setting, Truth
from tilth.simulator.wheel_speed import wheel_speeds

PREFERRED: Final = {True: 28, False: 70}  # source address: StarFire-like, NMEA 2000
DYNAMIC: Final = range(128, 248)  # where those go who lose their preferred address
CLUMP_GAP_S: Final = {True: 0.0012, False: 0.0006}  # between a receiver's own frames
SELECTORS: Final = (0x51, 0x52, 0x54, 0xA0, 0xE3)  # of 65535, content unknown: nobody here reads them
ALTITUDE_M: Final = 301.0
QUARTER_NS: Final = 250_000_000

Sources = Mapping[Mount, list[tuple[float, int]]]
"""(s since the start, source address) of each receiver, ascending"""

Contents = tuple[int, bytes, int]
"""(PGN, payload, fast-packet sequence)"""


def simulate(
    machine: Machine, seed: int, seconds: float, scenario: Scenario | None = None
) -> Iterator[Frame]:
    """Frames of a simulated run; its truth is `drive` of the same arguments."""
    return traffic(machine, drive(machine, seed, seconds, scenario))


def traffic(machine: Machine, truth: Truth) -> Iterator[Frame]:
    """Frames of all buses in the order of their arrival, which is both t_ns and rx_ns."""
    queues = _queues(machine, truth)
    buses = (_on_the_bus(machine, truth, bus, heapq.merge(*streams)) for bus, streams in queues.items())
    return heapq.merge(*buses, key=lambda frame: frame.t_ns)


def host_clock(run: Truth | Setting) -> Callable[[float], int]:
    """Of seconds of UTC since the start the recording computer's clock, ns: the stamps of its frames."""
    offset_s, rate = run.nuisances["clock_offset"], 1.0 + run.nuisances["clock_skew"]
    start_ns = run.scenario.utc_start_ns
    return lambda at_s: start_ns + int(1e9 * (offset_s + rate * at_s))


def _queues(machine: Machine, truth: Truth) -> dict[str, list[Iterable[Sent]]]:
    """What is to be sent on each bus, in streams of ascending time."""
    scenario = truth.scenario
    queues: dict[str, list[Iterable[Sent]]] = {bus.name: [] for bus in machine.bus}
    first_bus = queues[machine.bus[0].name]
    claims, sources = claims_of(machine, scenario)
    for bus, sent in claims:
        queues[bus].append([sent])
    for receiver in machine.receiver:
        rows = reports(machine, truth, receiver, FIRST_EPOCH_S)
        queues[receiver.bus].append(receiver_frames(receiver, rows, sources[receiver.mount], scenario))
    if scenario.wheel_sensor:
        queues[machine.wheel_angle.bus].append(_wheel_frames(machine, truth))
    if scenario.other_traffic:
        first_bus += [_tractor_ecu(truth), other_frames(truth)]
    return queues


def _on_the_bus(machine: Machine, truth: Truth, bus: str, queue: Iterable[Sent]) -> Iterator[Frame]:
    arbiter = Arbiter(next(b for b in machine.bus if b.name == bus), truth)
    for sent in queue:
        yield from arbiter.take(sent)
    yield from arbiter.until(math.inf)


class Arbiter:
    """Arbitration: whenever the bus is free, the lowest identifier that waits goes next."""

    def __init__(self, bus: Bus, run: Truth | Setting) -> None:
        self._bus = bus.name
        self._bit_s = 1.0 / bus.bitrate
        self._t_ns_at = host_clock(run)
        self._waiting: list[tuple[int, int, int, bool, bytes]] = []
        self._free_s = 0.0
        self._order = 0

    def take(self, sent: Sent) -> Iterator[Frame]:
        """What goes before this is sent; its time is not before the last one's."""
        sent_s, can_id, extended, data = sent
        yield from self.until(sent_s)
        self._free_s = max(self._free_s, sent_s)
        self._order += 1
        arbitrated = can_id if extended else can_id << 18
        heapq.heappush(self._waiting, (arbitrated, self._order, can_id, extended, data))

    def until(self, at_s: float) -> Iterator[Frame]:
        """What begins before at_s, s."""
        while self._waiting and self._free_s < at_s:
            _, _, sent_id, extended, data = heapq.heappop(self._waiting)
            self._free_s += self._bit_s * ((67 if extended else 47) + 8 * len(data))  # with interframe space
            t_ns = self._t_ns_at(self._free_s)
            yield Frame(t_ns, t_ns, self._bus, sent_id, extended, False, data)


def claims_of(machine: Machine, scenario: Scenario) -> tuple[list[tuple[str, Sent]], Sources]:
    """Address claims of the whole run as (bus, what is sent), and who uses which source address when."""
    claims: list[tuple[str, float, int, int]] = []
    holders: dict[tuple[str, int], Receiver] = {}
    sources: dict[Mount, list[tuple[float, int]]] = {}
    for i, receiver in enumerate(machine.receiver):
        wanted = PREFERRED[star_fire_like(receiver)] if receiver.source is None else receiver.source
        for bus, at_s, who, source in _negotiate(receiver, wanted, 0.05 + 0.06 * i, holders):
            claims.append((bus, at_s, who.name or 0, source))
            sources.setdefault(who.mount, []).append((at_s, source))
    by_mount = {receiver.mount: receiver for receiver in machine.receiver}
    for reclaim in scenario.reclaims:
        receiver = by_mount[reclaim.mount]
        claims.append((receiver.bus, reclaim.at_s, receiver.name or 0, reclaim.source))
        sources[reclaim.mount].append((reclaim.at_s, reclaim.source))
        holder = holders.get((receiver.bus, reclaim.source))
        if holder not in (None, receiver):  # defends what it holds
            claims.append((receiver.bus, reclaim.at_s + 0.005, holder.name or 0, reclaim.source))
        holders.setdefault((receiver.bus, reclaim.source), receiver)
    if scenario.other_traffic:
        claims += [(machine.bus[0].name, 0.01 + 0.004 * k, n, s) for k, (s, n) in enumerate(DEVICES.items())]
    sent = [(bus, (at_s, *_claim_frame(name, s))) for bus, at_s, name, s in sorted(claims) if name]
    return (sent if scenario.claims else []), sources


def _negotiate(
    newcomer: Receiver, wanted: int, at_s: float, holders: dict[tuple[str, int], Receiver]
) -> list[tuple[str, float, Receiver, int]]:
    """Claims that follow when a receiver wants an address: the lower NAME has it, the other one moves."""
    bus = newcomer.bus
    holder = holders.get((bus, wanted))
    first = [(bus, at_s, newcomer, wanted)]
    if holder is None:
        holders[bus, wanted] = newcomer
        return first
    winner, loser = sorted((holder, newcomer), key=lambda receiver: receiver.name or 0)
    free = next(address for address in DYNAMIC if (bus, address) not in holders and address not in DEVICES)
    holders[bus, wanted], holders[bus, free] = winner, loser
    return [*first, (bus, at_s + 0.008, winner, wanted), (bus, at_s + 0.015, loser, free)]


def _claim_frame(name: int, source: int) -> tuple[int, bool, bytes]:
    ((can_id, data),) = frames_of(60928, claim(name), source)
    return can_id, True, data


def _source_at(sources: list[tuple[float, int]], at_s: float) -> int:
    return sources[max(0, bisect_right(sources, (at_s, 255)) - 1)][1]


def receiver_frames(
    receiver: Receiver, rows: list[Report], sources: list[tuple[float, int]], scenario: Scenario
) -> Iterator[Sent]:
    """Clumps of reports, each frame after the one before."""
    star_fire = star_fire_like(receiver)
    clump: Callable[[Report, int], list[Contents]] = _star_fire_clump if star_fire else _nmea2000_clump
    gap_s = CLUMP_GAP_S[star_fire]
    at_s = 0.0
    for row in rows:
        if not row.effect.sends:
            continue
        at_s = max(at_s, row.sent_s)
        utc_ns = scenario.utc_start_ns + round(row.epoch_s * 1000) * 1_000_000
        source = _source_at(sources, at_s)
        for pgn, payload, sequence in clump(row, utc_ns):
            for can_id, data in frames_of(pgn, payload, source, sequence=sequence):
                yield at_s, can_id, True, data.ljust(8, b"\xff")
                at_s += gap_s


def _star_fire_clump(row: Report, utc_ns: int) -> list[Contents]:
    """One epoch; the only time it tells is a quarter of a second's."""
    fix = {"fix": row.effect.fix.value}
    position: dict[str, Word] = {}
    direction: dict[str, Word] = {"pitch_rad": row.pitch}
    if row.effect.available:
        position = {"latitude_deg": row.latitude_deg, "longitude_deg": row.longitude_deg}
        direction |= {"course_rad": row.course, "speed_mps": row.speed, "altitude_m": ALTITUDE_M}
    tilt = {"roll_rad": row.roll, "yaw_rate_radps": row.yaw_rate}
    result = [
        (65267, encode(65267, position), 0),
        (65256, encode(65256, direction), 0),
        (65254, encode(65254, {"utc_ns": utc_ns // QUARTER_NS * QUARTER_NS}), 0),
        (65535, encode(65535, tilt, selector=0xE1), 0),
        (65535, encode(65535, fix, selector=0x53), 0),
    ]
    selectors = SELECTORS if utc_ns % 1_000_000_000 else (*SELECTORS, 0xE0)
    return result + [
        (65535, bytes((selector, 1, 0, 0, selector ^ 0x5A, 0, 255, 255)), 0) for selector in selectors
    ]


def _nmea2000_clump(row: Report, utc_ns: int) -> list[Contents]:
    """One epoch, tied together by its SID; with position data and time at each whole second."""
    count = utc_ns // 100_000_000
    sid = count % 253
    position: dict[str, Word] = {}
    velocity: dict[str, Word] = {}
    if row.effect.available:
        position = {"latitude_deg": row.latitude_deg, "longitude_deg": row.longitude_deg}
        velocity = {"course_rad": row.course, "speed_mps": row.speed, "heading_reference": "true"}
    result = [
        (129025, encode(129025, position), 0),
        (129026, encode(129026, velocity, sid=sid), 0),
        (127250, encode(127250, {"heading_rad": row.heading, "heading_reference": "true"}, sid=sid), 0),
        (127251, encode(127251, {"yaw_rate_radps": row.yaw_rate}, sid=sid), 0),
        (127257, encode(127257, {"roll_rad": row.roll, "pitch_rad": row.pitch}, sid=sid), 0),
    ]
    if utc_ns % 1_000_000_000:
        return result
    quality: dict[str, Word] = {"fix": row.effect.fix.value, "utc_ns": utc_ns}
    if row.effect.available:
        quality |= position | {"altitude_m": ALTITUDE_M - 30.0, "satellites": 19, "hdop": 0.7}
    sequence = count // 10 % 8
    return [
        *result,
        (129029, encode(129029, quality, sid=sid), sequence),
        (126992, encode(126992, {"utc_ns": utc_ns}, sid=sid), 0),
    ]


def _wheel_frames(machine: Machine, truth: Truth) -> Iterator[Sent]:
    """100 a second, each the machine file's delay after it was measured."""
    sensor = compile_sensor(machine)
    delay_s = machine.wheel_angle.delay + truth.nuisances["wheel_delay"]
    for measured_s, angle in zip(truth.time.tolist(), wheel_readings(truth).tolist(), strict=True):
        yield measured_s + delay_s, sensor.can_id, sensor.extended, sensor.data(angle)


def _tractor_ecu(truth: Truth) -> Iterator[Sent]:
    speeds, wheels, rates = truth.tractor.forward_velocity, wheel_speeds(truth), truth.tractor.yaw_rate
    for k in range(3, len(truth.time), 10):
        yield from ecu_frames(float(truth.time[k]), float(speeds[k]), float(wheels[k]), float(rates[k]))


def ecu_frames(at_s: float, velocity: float, wheels: float, yaw_rate: float) -> Iterator[Sent]:
    """Speed over the wheels and over ground, and the guidance system's curvature, at one instant."""
    speed, direction = abs(velocity), "reverse" if velocity < 0.0 else "forward"
    turning: dict[str, Word] = {"speed_mps": abs(wheels), "direction": direction}
    ground: dict[str, Word] = {"speed_mps": speed, "direction": direction}
    path: dict[str, Word] = {"curvature_per_m": yaw_rate / max(speed, 0.5)}
    for pgn, words, destination in ((65096, turning, 255), (65097, ground, 255), (44032, path, 28)):
        for can_id, data in frames_of(pgn, encode(pgn, words), 0xF0, destination):
            yield at_s + 0.004, can_id, True, data
