"""Which address is whose, where no address claim was heard: by what was known before, and by where they are.

Devices claim their address when they are switched on. A program that begins to listen later, or is restarted
while driving, hears no claim. What it knew before holds for as long as the devices have not been switched
off; after that, receivers that are alike may have exchanged addresses. Then nothing is taken for granted:
every assignment of the addresses that send positions to the receivers of the machine file is compared with
the rig over some metres of travel, and the first pose waits for it.

Each assignment has a log-likelihood: of both pairs' lengths and the gap at the hitch, of the turn rate that
the wheel angle makes, and of the direction that the vehicle reports. A rig that is seen in reverse, front for
rear and tractor for implement, has almost the same lengths: only steering, the vehicle's direction or a long
way tell it apart.
"""

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import permutations
from typing import Final

from tilth.estimator.pose import plausibility
from tilth.estimator.pose.aligner import ALIGNMENT, Aligner
from tilth.estimator.pose.geometry import to_plane
from tilth.estimator.pose.receiver_track import RECEIVER_TRACK, sample_at
from tilth.estimator.rig.geometry import Vector, between, direction, wrap
from tilth.estimator.rig.residuals import pair_of
from tilth.estimator.tuning import tuned
from tilth.schemas.flow import EventKind, Mount, Position
from tilth.schemas.identity import KnownAddress
from tilth.schemas.machine import Machine
from tilth.schemas.notices import Notice, NoticeCode, notice


@dataclass(frozen=True, slots=True)
class RecognitionTuning:
    """How receivers that claim no name are told apart by how they move."""

    travel: float = tuned(5.0, "m", "driven before anything is decided")
    hopeless: float = tuned(
        60.0, "m", "driven, after which it is said that nothing fits or it cannot be told"
    )
    chunk: float = tuned(0.4, "m", "between two comparisons: at rest the same errors would count again")
    step_ns: int = tuned(200_000_000, "ns", "between two instants that may be compared")
    lag_ns: int = tuned(1_200_000_000, "ns", "after an instant, until its positions are there, also at 1 Hz")
    most_candidates: int = tuned(6, "senders", "with more, only those that were heard first are tried")
    misfit_sd: float = tuned(0.2, "m", "of latency, roll and survey together")
    correlated: float = tuned(2.0, "comparisons", "whose errors count as one")
    worst: float = tuned(4.0, "nat", "that one comparison may cost: a single wrong position decides nothing")
    latency_sd: float = tuned(0.03, "s", "by which a point may be ahead of or behind its place on the path")
    turn_ns: int = tuned(1_000_000_000, "ns", "over which heading is compared with the wheel angle")
    turn_sd: float = tuned(0.06, "rad", "sd of the change of heading in that time")
    turn_share: float = tuned(0.3, "1", "of the expected turn, by which it may be wrong: slip, wheel angle")
    reported_ns: int = tuned(3_000_000_000, "ns", "largest age of the direction that the vehicle reports")
    against: float = tuned(2.0, "nat", "that a comparison costs where the reported direction is the opposite")
    before: float = tuned(6.0, "nat", "in favour of every receiver being where it was before")
    forward: float = tuned(0.5, "nat", "of a metre forwards")
    most_forward: float = tuned(10.0, "nat", "of all metres forwards")
    clear: float = tuned(8.0, "nat", "by which an assignment must be better than any other")


RECOGNITION: Final = RecognitionTuning()


EVENT: Final = EventKind.ADDRESSES
Place = tuple[str, int]  # bus, source


@dataclass(slots=True)
class HeardSource:
    """Positions from one address: arrival, ns, and m north and east of the plane's origin."""

    bus: str
    source: int
    mount: Mount | None  # None: not known
    pgn: int
    positions: deque[tuple[int, float, float]] = field(default_factory=lambda: deque(maxlen=48))


@dataclass(slots=True)
class Assignment:
    """One way in which the candidates may be the receivers whose address is not known."""

    slots: list[int]  # for each of those receivers the candidate's index, or -1
    likelihood: float = 0.0  # logarithm
    squares: float = 0.0  # sum of squared misfits, m^2
    forward: float = 0.0  # m travelled forwards, less those in reverse
    turn: tuple[float, float] | None = None  # heading of the tractor, rad, and `forward` some time ago


@dataclass(slots=True)
class Recognition:
    """State of the search."""

    before: list[KnownAddress] = field(default_factory=list)  # from an earlier run, not decided on
    heard: list[HeardSource] = field(default_factory=list)
    origin_deg: tuple[float, float] | None = None
    candidates: list[tuple[str, int]] = field(default_factory=list)
    mounts: list[Mount] = field(default_factory=list)  # that are looked for
    assignments: list[Assignment] = field(default_factory=list)
    compared: int = 0
    next_ns: int = 0
    turn_ns: int = 0
    travel: float = 0.0  # m
    last: list[tuple[float, float]] = field(default_factory=list)  # the candidates at the last comparison
    last_ns: int = 0
    hopeless: bool = False  # which has been said


def first_of_bus(state: Recognition, machine: Machine, bus: str, t_ns: int) -> list[KnownAddress]:
    """Who has which address, known from before, on the first frame of a bus: if it has been silent for less
    than ignition off, nobody was switched off. Otherwise that is an assumption, to be examined."""
    limit_ns = machine.log.ignition_off_s * 1e9
    sure = [k for k in state.before if k.bus == bus and k.last_ns and 0 <= t_ns - k.last_ns < limit_ns]
    state.before = [
        known if known.bus != bus else replace(known, last_ns=0)
        for known in state.before
        if known not in sure
    ]
    return sure


def restart(state: Recognition) -> Recognition:
    """Search from the beginning; what was known before stays an assumption."""
    return Recognition(before=state.before)


def take(state: Recognition, position: Position) -> None:
    """Store a position of a candidate, or of a receiver that is known."""
    origin = position.origin
    heard = next((one for one in state.heard if (one.bus, one.source) == (origin.bus, origin.source)), None)
    if heard is None:
        heard = HeardSource(origin.bus, origin.source, origin.mount, position.pgn)
        state.heard.append(heard)
    if position.pgn > heard.pgn:  # the same position in a rarer message
        return
    heard.pgn, heard.mount = position.pgn, origin.mount
    here = position.latitude_deg, position.longitude_deg
    state.origin_deg = state.origin_deg or here
    at = to_plane(state.origin_deg, *here)
    before = heard.positions[-1] if heard.positions else None
    if before is None or (position.rx_ns > before[0] and before[1:] != at):  # sent again: interpolated
        heard.positions.append((position.rx_ns, *at))


def search(
    state: Recognition, aligner: Aligner, unplaced: frozenset[Mount], now_ns: int
) -> tuple[list[KnownAddress], Notice | None]:
    """Who the candidates are, and what is told of it; ([], None) while it is not known.

    A notice alone says that it cannot be found out.
    """
    if not state.next_ns <= now_ns <= state.next_ns + 2 * RECOGNITION.lag_ns:
        state.next_ns = now_ns
    if now_ns < state.next_ns + RECOGNITION.lag_ns:
        return [], None
    t_ns, state.next_ns = state.next_ns, state.next_ns + RECOGNITION.step_ns
    found = [(one, at) for one in state.heard if (at := _at(one, t_ns)) is not None]
    fixed = {one.mount: at for one, at in found if one.mount is not None}
    points = {(one.bus, one.source): at for one, at in found if one.mount is None}
    candidates, mounts = sorted(points)[: RECOGNITION.most_candidates], [m for m in Mount if m in unplaced]
    if not candidates or not mounts:
        return [], None
    if (state.candidates, state.mounts) != (candidates, mounts):
        _begin(state, aligner.machine, candidates, mounts)
    if not _moved_on(state, [points[place] for place in candidates], t_ns):
        return [], None
    _compare(state, aligner, [points[place] for place in candidates], fixed, t_ns)
    return _decide(state, aligner.machine)


def _at(heard: HeardSource, t_ns: int) -> Vector | None:
    """Where it was at t, if positions lie around."""
    after = None
    for sample in reversed(heard.positions):
        if sample[0] <= t_ns:
            if after is None or after[0] - sample[0] > RECEIVER_TRACK.longest_interpolated_ns:
                return None
            share = (t_ns - sample[0]) / (after[0] - sample[0])
            return sample[1] + share * (after[1] - sample[1]), sample[2] + share * (after[2] - sample[2])
        after = sample
    return None


def _begin(state: Recognition, machine: Machine, candidates: list[Place], mounts: list[Mount]) -> None:
    """Begin anew with these candidates for these receivers."""
    bus_of = {receiver.mount: receiver.bus for receiver in machine.receiver}
    n, k = len(candidates), len(mounts)
    if n >= k:
        ways = [list(way) for way in permutations(range(n), k)]
    else:
        ways = []
        for chosen in permutations(range(k), n):
            way = [-1] * k
            for candidate, mount in enumerate(chosen):
                way[mount] = candidate
            ways.append(way)
    state.assignments = [
        Assignment(way)
        for way in ways
        if all(i < 0 or candidates[i][0] == bus_of[m] for i, m in zip(way, mounts, strict=True))
    ]
    state.candidates, state.mounts, state.last = candidates, mounts, []
    state.compared, state.travel, state.turn_ns = 0, 0.0, 0
    expected = _before(state, machine)
    for assignment in state.assignments:
        slots = dict(zip(mounts, assignment.slots, strict=True))
        if expected and all(slots.get(mount, -1) == i for mount, i in expected.items()):
            assignment.likelihood = RECOGNITION.before


def _before(state: Recognition, machine: Machine) -> dict[Mount, int]:
    """Receiver -> index of the candidate that it was before."""
    by_name = {(r.bus, r.name): r.mount for r in machine.receiver}
    expected = {}
    for known in state.before:
        mount = known.mount if known.name is None else by_name.get((known.bus, known.name), known.mount)
        if mount is not None and mount in state.mounts and (known.bus, known.source) in state.candidates:
            expected[mount] = state.candidates.index((known.bus, known.source))
    return expected


def _moved_on(state: Recognition, points: list[Vector], t_ns: int) -> bool:
    """Whether all have moved on since the last comparison; then this is the next one."""
    if not state.last or t_ns - state.last_ns > 10 * RECOGNITION.turn_ns:
        state.last, state.last_ns = points, t_ns
        return False
    moved = min(math.dist(one, other) for one, other in zip(points, state.last, strict=True))
    if moved < RECOGNITION.chunk:
        return False
    state.travel += moved
    return True


def _compare(
    state: Recognition, aligner: Aligner, points: list[Vector], fixed: dict[Mount, Vector], t_ns: int
) -> None:
    """Add what this instant tells of each assignment."""
    machine = aligner.machine
    levers = {receiver.mount: receiver.position[:2] for receiver in machine.receiver}
    c, d = machine.tractor.c.value, machine.implement.d.value
    moved = [(p[0] - q[0], p[1] - q[1]) for p, q in zip(points, state.last, strict=True)]
    way = sum(m[0] for m in moved) / len(moved), sum(m[1] for m in moved) / len(moved)
    speed = math.hypot(*way) / max((t_ns - state.last_ns) * 1e-9, 0.1)
    sd = math.hypot(RECOGNITION.misfit_sd, RECOGNITION.latency_sd * speed)
    reported = aligner.direction if abs(t_ns - aligner.direction_ns) < RECOGNITION.reported_ns else 0
    turned = t_ns - state.turn_ns >= RECOGNITION.turn_ns
    in_time = t_ns - state.turn_ns <= 2 * RECOGNITION.turn_ns
    wheel = [
        sample_at(aligner.wheel, at, ALIGNMENT.wheel_hold_ns)
        for at in (state.turn_ns, (state.turn_ns + t_ns) // 2, t_ns)
    ]
    angles = [sample[0] for sample in wheel if sample is not None]
    for one in state.assignments:
        at = {m: points[i] for m, i in zip(state.mounts, one.slots, strict=True) if i >= 0} | fixed
        misfit = plausibility.misfit(at, levers, c, d)
        one.squares += misfit**2
        one.likelihood -= min(misfit**2 / (2.0 * sd**2 * RECOGNITION.correlated), RECOGNITION.worst)
        heading = _heading(at, levers)
        if heading is None:
            continue
        ahead = way[0] * math.cos(heading) + way[1] * math.sin(heading)
        one.forward += ahead
        one.likelihood -= RECOGNITION.against if ahead * reported < 0 else 0.0
        if not turned:
            continue
        if (
            one.turn is not None
            and in_time
            and len(angles) == len(wheel)
            and _pair(at, plausibility.PAIRS[0])
        ):
            length = machine.tractor.wheelbase
            expected = (one.forward - one.turn[1]) * math.tan(sum(angles) / len(angles)) / length
            error = wrap(heading - one.turn[0] - expected)
            likely = error**2 / (RECOGNITION.turn_sd + RECOGNITION.turn_share * abs(expected)) ** 2 / 2.0
            one.likelihood -= min(likely, RECOGNITION.worst)
        one.turn = heading, one.forward
    if turned:
        state.turn_ns = t_ns
    state.compared += 1
    state.last, state.last_ns = points, t_ns


def _pair(at: Mapping[Mount, Vector], pair: tuple[Mount, Mount]) -> bool:
    return pair[0] in at and pair[1] in at


def _heading(at: Mapping[Mount, Vector], levers: Mapping[Mount, Vector]) -> float | None:
    """Of the tractor, rad; else about, of the implement, or from one body to the other."""
    for front, rear in plausibility.PAIRS:
        if front in at and rear in at:
            return pair_of(at[front], at[rear], levers[front], levers[rear]).heading
    tractor = next((at[m] for m in plausibility.PAIRS[0] if m in at), None)
    implement = next((at[m] for m in plausibility.PAIRS[1] if m in at), None)
    if tractor is None or implement is None:
        return None
    return direction(between(tractor, implement))


def _decide(state: Recognition, machine: Machine) -> tuple[list[KnownAddress], Notice | None]:
    if state.travel < RECOGNITION.travel or not state.assignments:
        return [], None
    scores = sorted(
        ((one.likelihood + _forwards(one), index) for index, one in enumerate(state.assignments)),
        reverse=True,
    )
    best = state.assignments[scores[0][1]]
    speed_smear = (
        plausibility.PLAUSIBILITY.smear
        * RECOGNITION.latency_sd
        * state.travel
        / max(state.compared, 1)
        / (RECOGNITION.step_ns * 1e-9)
    )
    fits = math.sqrt(best.squares / state.compared) < plausibility.PLAUSIBILITY.misfit + speed_smear
    if fits and (len(scores) == 1 or scores[0][0] - scores[1][0] > RECOGNITION.clear):
        return _found(state, machine, best)
    if state.travel < RECOGNITION.hopeless or state.hopeless:
        return [], None
    state.hopeless = True
    places = (notice(NoticeCode.ADDRESS, bus=bus, source=source) for bus, source in state.candidates)
    return [], notice(NoticeCode.SEVERAL_FIT if fits else NoticeCode.NONE_FITS, *places)


def _forwards(one: Assignment) -> float:
    """Log-likelihood of the direction of travel: most ways are driven forwards."""
    return max(-RECOGNITION.most_forward, min(RECOGNITION.forward * one.forward, RECOGNITION.most_forward))


def _found(state: Recognition, machine: Machine, best: Assignment) -> tuple[list[KnownAddress], Notice]:
    names = {receiver.mount: receiver.name for receiver in machine.receiver}
    rows = [
        KnownAddress(*state.candidates[i], names[m], m)
        for m, i in zip(state.mounts, best.slots, strict=True)
        if i >= 0
    ]
    expected = _before(state, machine)
    slots = dict(zip(state.mounts, best.slots, strict=True))
    code = NoticeCode.RECOGNISED
    if expected:
        as_before = all(slots.get(mount) == index for mount, index in expected.items())
        code = NoticeCode.ADDRESSES_CONFIRMED if as_before else NoticeCode.ADDRESSES_CHANGED
    return rows, notice(code, *map(receiver_at, rows), travel=state.travel)


def receiver_at(known: KnownAddress) -> Notice:
    """Where a receiver of the machine file is, as part of a notice."""
    return notice(NoticeCode.RECEIVER_AT, mount=str(known.mount), source=known.source)
