"""The time of a log, from the stamps of its frames: does it continue, was there a silence, did it step back?

The many decide. A frame whose stamp is away from the log's time is called stray: it does not change that
time, is not used and is counted with its sender. The log's time jumps only when such frames outnumber the
others.

Each of several buses may have a clock of its own. If the stamps of one stay away from the log's time by the
same amount while others go on, they are aligned by the order of the frames in the log. Where the order is not
that of arrival, nothing here can tell.
"""

from dataclasses import dataclass, field, replace
from typing import Final

from tilth.estimator.tuning import tuned
from tilth.schemas.flow import EventKind, Frame
from tilth.schemas.notices import Notice, NoticeCode, notice
from tilth.schemas.pgn_table import DAY_NS


@dataclass(frozen=True, slots=True)
class LogTimeTuning:
    """When stamps of frames tell of a silence, of a step of a clock, or of a bus with a clock of its own."""

    out_of_order_ns: int = tuned(500_000_000, "ns", "stamps that differ by less are only out of order")
    silence_ns: int = tuned(10_000_000_000, "ns", "no frame for so long: nothing continues across")
    earlier_lasts_ns: int = tuned(
        1_500_000_000, "ns", "for which most frames have an earlier time until it counts"
    )
    """A device that sends once a second on the old clock would have sent by then."""
    later_lasts_ns: int = tuned(500_000_000, "ns", "same for a later time: longer than one long message")
    longest_interval_ns: int = tuned(200_000_000, "ns", "a longer time between frames counts as this")
    lone_frame_ns: int = tuned(1_000_000_000, "ns", "a larger gap of two stray frames: the first was alone")
    gap_lasts_ns: int = tuned(10_000_000_000, "ns", "in which the longest usual gap of frames is forgotten")
    established: int = tuned(16, "frames", "that agree on a time; fewer may be the exception themselves")
    certain: int = tuned(24, "frames", "of two senders in excess of all others: no accident")
    lag_ns: int = tuned(200_000_000, "ns", "a bus that is always further ahead or behind has its own clock")
    """What is only out of order is sometimes beside them."""
    most_lag_ns: int = tuned(1_500_000_000, "ns", "a larger lag shows by other signs")
    apart_varies_ns: int = tuned(100_000_000, "ns", "by which the lag of a bus may vary")
    apart_lasts_ns: int = tuned(1_000_000_000, "ns", "for which it lasts before the bus is aligned")
    slew_ns: int = tuned(1_000_000, "ns", "by which one frame may change the alignment of a bus")
    coarse_ns: int = tuned(100_000_000, "ns", "steps of stamps that are all as long as this align nothing")
    coarse_after: int = tuned(400, "frames", "after which it is known how long the steps are")


LOG_TIME: Final = LogTimeTuning()


@dataclass(slots=True)
class Strays:
    """Stray frames of one sender."""

    frames: int
    least_ns: int  # how far they were ahead of the log's time
    most_ns: int


@dataclass(slots=True)
class OffTimeFrames:
    """Frames of one bus at another time than the log's, which may turn out to be right. Times in ns."""

    from_ns: int  # the log's time before them
    since_ns: int  # stamp of the first of them
    latest_ns: int  # their greatest stamp
    last_ns: int  # stamp of the last of them
    needed_ns: int  # how long they must last to be accepted
    passed_ns: int  # LogTime.passed_ns before them
    lasted_ns: int = 0  # how long they have lasted
    votes: int = 0  # how many there are in excess of frames at other times
    strays: dict[str, Strays] = field(default_factory=dict)  # they themselves, by sender, if they are strays
    others: int = 0  # frames of other buses at the log's time since they began
    ahead_ns: int = 0  # of the log's time: the least since `aligned_ns` counts
    aligned_ns: int = 0  # how long they have been ahead by the same


@dataclass(slots=True)
class ApartBus:
    """A bus whose stamps are apart from the others' by nearly the same. Its frames are not used until it is
    aligned. Times ns."""

    since_ns: int  # its stamp when that began
    least_ns: int  # by which it is ahead
    most_ns: int
    frames: int = 0
    strays: dict[str, Strays] = field(default_factory=dict)  # these, by sender


@dataclass(slots=True)
class LogTime:
    """State of a log's time. All times in ns on the clock of Frame.t_ns, of the bus that was heard first."""

    latest_ns: int = 0  # greatest stamp since the last step back; 0 before the first
    passed_ns: int = 0  # time during which frames came, without silences and steps
    silent_ns: int = 0  # sum of the silences
    stray: int = 0  # stray frames: the log's time before and after them was another
    bus_ns: dict[str, int] = field(default_factory=dict)  # bus -> its greatest stamp since the last jump
    off_time: dict[str, OffTimeFrames] = field(default_factory=dict)  # by bus
    apart: dict[str, ApartBus] = field(default_factory=dict)  # by bus, of those that may have another clock
    near: dict[str, int] = field(
        default_factory=dict
    )  # bus -> frames beside those of others, up to `certain`
    last_bus: str = ""  # of the frame before
    coarse: bool = False  # which has been reported
    step_ns: int = 0  # shortest time between two different stamps; 0 before there were two
    gap_ns: int = 0  # longest time between two frames lately
    in_time: int = 0  # frames at this time since the last jump
    first: dict[str, int] = field(default_factory=dict)  # sender -> frames, of the first `established`
    begun: bool = False  # the log's time has been established, or has jumped
    offset_ns: dict[str, int] = field(default_factory=dict)  # bus of another clock -> what its stamps lack
    strays: dict[str, Strays] = field(default_factory=dict)  # by sender
    told: dict[str, int] = field(default_factory=dict)  # sender -> how many strays are worth the next event
    news: list[tuple[str, Notice]] = field(default_factory=list)  # kinds of events, and what they tell
    misled: bool = False  # the last jump corrects a beginning of which the stamps were wrong


def take_stamp(time: LogTime, frame: Frame) -> int | None:
    """Take the stamp of a frame. Returns 0 if the log's time continues, None if this frame is stray.

    A value below 0 is a step back of the log's time by so many ns, above 0 a silence of so many ns.
    """
    bus, t_ns = frame.bus, frame.t_ns
    near, advance_ns = time.near.get(bus), t_ns - time.latest_ns
    alone = near is not None and (
        near >= LOG_TIME.certain or (len(time.bus_ns) == 1 and bus in time.bus_ns)
    )  # or beside the others for long: nearly all frames are of such a bus
    if time.offset_ns or not alone:
        frame = on_log_clock(time, frame)
        is_apart, time.last_bus = _is_apart(time, frame), bus
        if is_apart:
            return None
        t_ns = frame.t_ns
        advance_ns = t_ns - time.latest_ns
    time.last_bus = bus
    if not 0 <= advance_ns <= LOG_TIME.out_of_order_ns and (side := _side(time, frame)):
        return _off_time_frame(time, frame, side)
    if advance_ns > 0:
        if time.latest_ns:
            _pass(time, advance_ns)
        time.latest_ns = t_ns
    if t_ns > time.bus_ns.get(bus, -1):
        time.bus_ns[bus] = t_ns
    elif bus not in time.bus_ns:
        time.bus_ns[bus] = 0
    if time.begun and time.step_ns < LOG_TIME.coarse_ns:
        time.in_time += 1
    else:
        _support(time, frame)
    if time.offset_ns:
        _follow(time, frame)
    return _in_time_again(time, frame) if time.off_time else 0


def _pass(time: LogTime, advance_ns: int) -> None:
    """The log's time goes on."""
    if advance_ns < time.step_ns or not time.step_ns:
        time.step_ns = advance_ns
    time.passed_ns += advance_ns
    fades_ns = advance_ns if advance_ns < LOG_TIME.gap_lasts_ns else LOG_TIME.gap_lasts_ns
    kept_ns = time.gap_ns - time.gap_ns * fades_ns // LOG_TIME.gap_lasts_ns
    gap_ns = advance_ns if advance_ns < LOG_TIME.silence_ns else LOG_TIME.silence_ns
    time.gap_ns = gap_ns if gap_ns > kept_ns else kept_ns


def on_log_clock(time: LogTime, frame: Frame) -> Frame:
    """The frame with its stamps on the log's clock, as far as the offset of its bus is known."""
    offset_ns = time.offset_ns.get(frame.bus, 0)
    if not offset_ns:
        return frame
    return replace(frame, t_ns=frame.t_ns + offset_ns, rx_ns=frame.rx_ns + offset_ns)


def continues(time: LogTime, frame: Frame) -> bool:
    """Whether a frame that has not been taken yet is at the log's time."""
    return not _side(time, on_log_clock(time, frame))


def stray_senders(time: LogTime) -> list[Notice]:
    """Who sent the stray frames of this log."""
    return [stray_notice(sender, strays) for sender, strays in _all_strays(time).items()]


def stray_notice(sender: str, strays: Strays) -> Notice:
    """What is known of one sender's stray frames."""
    bus, _, who = sender.rpartition(" ")
    of: dict[str, float | str] = {"identifier": who} if who.startswith("0x") else {"source": int(who)}
    return notice(
        NoticeCode.STRAY_FRAMES, **of, bus=bus, frames=strays.frames,
        least_s=strays.least_ns * 1e-9, most_s=strays.most_ns * 1e-9,
    )  # fmt: skip


def _side(time: LogTime, frame: Frame) -> int:
    """Where the frame is: 0 at the log's time, -1 before it, 1 after it."""
    if not time.latest_ns:
        return 0
    t_ns, rx_ns, latest_ns, usual_ns = frame.t_ns, frame.rx_ns, time.latest_ns, LOG_TIME.out_of_order_ns
    if t_ns < latest_ns - usual_ns:
        return -1
    # A frame that waited in a queue is no sign of a silence. No usual gap is below what is out of order.
    late_ns = (rx_ns if rx_ns < t_ns else t_ns) - latest_ns
    return 1 if late_ns > usual_ns and late_ns > _usual_gap_ns(time) else 0


def _is_apart(time: LogTime, frame: Frame) -> bool:
    """Whether the frame is of a bus that has been apart from the others by nearly the same since it was first
    heard beside them. When that has lasted, the bus is aligned."""
    bus = frame.bus
    if bus not in time.near:
        time.near = dict.fromkeys((*time.near, bus), 0)  # what was heard before it was beside nobody
    if time.near[bus] >= LOG_TIME.certain or len(time.bus_ns) <= (bus in time.bus_ns):
        return False
    others = [ns for name, ns in time.bus_ns.items() if name != bus]
    off_ns, apart = frame.t_ns - max(others), time.apart.get(bus)
    if not LOG_TIME.lag_ns < abs(off_ns) < LOG_TIME.most_lag_ns or (apart is None and time.last_bus == bus):
        time.near[bus] += abs(off_ns) <= LOG_TIME.lag_ns
        if apart is not None:  # it was only out of order, or alone for a while
            del time.apart[bus]
            time.strays = _sum(time.strays, apart.strays)
        return False
    if apart is None:
        apart = time.apart[bus] = ApartBus(frame.t_ns, off_ns, off_ns)
    apart.least_ns, apart.most_ns = min(off_ns, apart.least_ns), max(off_ns, apart.most_ns)
    if apart.most_ns - apart.least_ns > LOG_TIME.apart_varies_ns:
        apart.since_ns, apart.frames, apart.least_ns, apart.most_ns = frame.t_ns, 0, off_ns, off_ns
    apart.frames += 1
    time.stray += 1
    _count(apart.strays, frame, off_ns)
    if apart.frames >= LOG_TIME.established and frame.t_ns - apart.since_ns >= LOG_TIME.apart_lasts_ns:
        by_ns = -apart.least_ns if apart.least_ns > 0 else -apart.most_ns
        time.offset_ns[bus] = time.offset_ns.get(bus, 0) + by_ns
        time.strays = _sum(time.strays, apart.strays)
        time.near[bus] = LOG_TIME.certain
        del time.apart[bus]
        _tell_aligned(time, bus, time.offset_ns[bus])
    return True


def _usual_gap_ns(time: LogTime) -> int:
    """How much later than the one before a frame may be."""
    if time.in_time < 2:
        return LOG_TIME.silence_ns
    return min(LOG_TIME.silence_ns, max(LOG_TIME.out_of_order_ns, 2 * time.gap_ns))


def _support(time: LogTime, frame: Frame) -> None:
    """Count a frame at the log's time."""
    if time.in_time < LOG_TIME.established and not time.begun:
        sender = _sender(frame)
        time.first[sender] = time.first.get(sender, 0) + 1
    time.in_time += 1
    if time.in_time % LOG_TIME.coarse_after == 0 and time.step_ns >= LOG_TIME.coarse_ns and not time.coarse:
        time.coarse = True
        coarse = notice(NoticeCode.COARSE_STAMPS, step_s=time.step_ns / 1e9)
        time.news.append((EventKind.COARSE_STAMPS, coarse))
    if time.in_time == LOG_TIME.established:
        time.begun = True
        time.first.clear()


def _sender(frame: Frame) -> str:
    """Bus and J1939 source address, or a hexadecimal identifier of 11 bits."""
    return f"{frame.bus} {frame.can_id & 0xFF}" if frame.extended else f"{frame.bus} 0x{frame.can_id:X}"


def _off_time_frame(time: LogTime, frame: Frame, side: int) -> int | None:
    """Take a frame at another time: a stray one, or one more of a series. Returns as `take_stamp`."""
    at_ns = frame.t_ns if side < 0 else min(frame.rx_ns, frame.t_ns)
    off_time = time.off_time.get(frame.bus)
    if off_time is not None and not _belongs(off_time, at_ns, side):
        off_time.votes -= 1
        if off_time.votes > 0:
            _count(time.strays, frame, at_ns - time.latest_ns)
            time.stray += 1
            return None
        _drop(time, frame.bus)
        off_time = None
    if off_time is None:
        off_time = time.off_time[frame.bus] = OffTimeFrames(
            time.latest_ns,
            at_ns,
            at_ns,
            at_ns,
            LOG_TIME.silence_ns,
            time.passed_ns,
            ahead_ns=at_ns - time.latest_ns,
        )
    # If its bus goes on in order, that bus has another clock.
    in_order = at_ns >= time.bus_ns.get(frame.bus, 0) - LOG_TIME.out_of_order_ns
    needed_ns = (
        LOG_TIME.later_lasts_ns
        if side > 0
        else LOG_TIME.silence_ns
        if in_order
        else LOG_TIME.earlier_lasts_ns
    )
    off_time.needed_ns = min(needed_ns, off_time.needed_ns)
    interval_ns = _extend(off_time, at_ns)
    _count(off_time.strays, frame, at_ns - time.latest_ns)
    time.stray += 1
    if _others_go_on(off_time):
        _align(time, off_time, frame, at_ns - time.latest_ns, interval_ns)
        return None
    return _accept_jump(time, off_time, frame) if _outnumber(time, off_time) else None


def _belongs(off_time: OffTimeFrames, at_ns: int, side: int) -> bool:
    """Whether a frame goes on from a series of frames at another time. Later ones may be rare."""
    later = off_time.since_ns > off_time.from_ns
    if later != (side > 0) or at_ns < off_time.latest_ns - LOG_TIME.out_of_order_ns:
        return False
    return later or at_ns <= off_time.latest_ns + LOG_TIME.lone_frame_ns


def _extend(off_time: OffTimeFrames, at_ns: int) -> int:
    """Add one more frame to the series. Returns by how much longer it has lasted, ns."""
    interval_ns = min(max(0, at_ns - off_time.last_ns), LOG_TIME.longest_interval_ns)
    off_time.lasted_ns += interval_ns
    off_time.latest_ns = max(at_ns, off_time.latest_ns)
    off_time.last_ns = at_ns
    off_time.votes += 1
    return interval_ns


def _others_go_on(off_time: OffTimeFrames) -> bool:
    """Whether other buses are at the log's time; single frames may have been late."""
    return off_time.others > max(2, off_time.votes // 50)


def _outnumber(time: LogTime, off_time: OffTimeFrames) -> bool:
    """Whether the frames at another time are the many, and no other bus goes on at the log's time."""
    if _others_go_on(off_time):
        return False
    later = off_time.since_ns > off_time.from_ns
    certain = off_time.votes >= LOG_TIME.certain and len(off_time.strays) > 1
    if time.in_time < LOG_TIME.established:
        lasted = off_time.lasted_ns >= LOG_TIME.later_lasts_ns
        return off_time.votes > time.in_time and (certain or lasted)
    if later and certain:
        return True
    return off_time.votes >= LOG_TIME.established and off_time.lasted_ns >= off_time.needed_ns


def _in_time_again(time: LogTime, frame: Frame) -> int:
    """Take a frame at the log's time after frames at another time. Returns as `take_stamp`.

    It speaks against those, unless it continues them without a gap: then the log has stepped back by little,
    and their stamps have caught up with its time before the step.
    """
    own = time.off_time.get(frame.bus)
    if own is not None:
        by_ns, latest_ns = own.since_ns - own.from_ns, max(one.latest_ns for one in time.off_time.values())
        if by_ns < 0 and frame.t_ns - latest_ns <= min(LOG_TIME.longest_interval_ns, -by_ns // 2):
            _extend(own, frame.t_ns)
            return _accept_jump(time, own, frame) if _outnumber(time, own) else 0
        own.votes -= 1
        if own.votes <= 0:
            _drop(time, frame.bus)
    for off_time in time.off_time.values():
        off_time.others += off_time is not own
    return 0


def _align(time: LogTime, off_time: OffTimeFrames, frame: Frame, ahead_ns: int, interval_ns: int) -> None:
    """See whether a bus stays away from the log's time by the same amount; then it has another clock.

    ahead_ns: how far this frame is ahead of the log's time. interval_ns: time from the frame before it.
    """
    off_time.aligned_ns += interval_ns
    if abs(ahead_ns - off_time.ahead_ns) > LOG_TIME.out_of_order_ns:
        off_time.ahead_ns, off_time.aligned_ns = ahead_ns, 0
    off_time.ahead_ns = min(ahead_ns, off_time.ahead_ns)
    enough = off_time.votes >= LOG_TIME.established and off_time.others >= LOG_TIME.established
    if not enough or off_time.aligned_ns < LOG_TIME.earlier_lasts_ns:
        return
    before_ns = time.offset_ns.get(frame.bus, 0)
    offset_ns = time.offset_ns[frame.bus] = before_ns - off_time.ahead_ns
    time.bus_ns[frame.bus] = off_time.latest_ns - off_time.ahead_ns
    del time.off_time[frame.bus]
    _merge(time, off_time)
    _tell_aligned(time, frame.bus, offset_ns)


def _tell_aligned(time: LogTime, bus: str, offset_ns: int) -> None:
    apart = notice(NoticeCode.BUS_CLOCK_APART, bus=bus, behind_s=offset_ns * 1e-9)
    time.news.append((EventKind.OTHER_CLOCK, apart))


def _follow(time: LogTime, frame: Frame) -> None:
    """Follow the drift of buses with another clock: in the log, no frame comes before an earlier one."""
    others = [ns for bus, ns in time.bus_ns.items() if bus != frame.bus]
    if frame.bus in time.offset_ns:
        behind_ns = max(others, default=0) - frame.t_ns
        time.offset_ns[frame.bus] += min(max(behind_ns, 0), LOG_TIME.slew_ns)
        return
    for bus in time.offset_ns:
        ahead_ns = time.bus_ns.get(bus, 0) - frame.t_ns
        time.offset_ns[bus] -= min(max(ahead_ns, 0), LOG_TIME.slew_ns)


def _accept_jump(time: LogTime, off_time: OffTimeFrames, frame: Frame) -> int:
    """Set the log's time to that of the series. Returns the jump, ns."""
    by_ns = off_time.since_ns - off_time.from_ns
    lasted_ns = off_time.latest_ns - off_time.since_ns
    time.misled = not time.begun and (by_ns < 0 or by_ns > DAY_NS)
    if time.misled:  # what came first was the exception
        for sender, frames in time.first.items():
            time.strays[sender] = Strays(frames, -by_ns, -by_ns)
            time.stray += frames
            _tell(time, sender)
        time.passed_ns = lasted_ns
    else:
        silent = by_ns >= LOG_TIME.silence_ns
        time.passed_ns = off_time.passed_ns + lasted_ns + (by_ns if by_ns > 0 and not silent else 0)
        time.silent_ns += by_ns if silent else 0
    time.latest_ns = max(frame.t_ns, off_time.latest_ns)
    time.bus_ns = {frame.bus: time.latest_ns}
    if by_ns > 0:
        time.step_ns = min(time.step_ns or by_ns, by_ns)
    time.gap_ns = by_ns if 0 < by_ns < LOG_TIME.silence_ns else 0
    time.in_time, time.begun = off_time.votes if off_time.votes >= LOG_TIME.established else 1, True
    time.first.clear()
    for bus, other in list(
        time.off_time.items()
    ):  # they were not stray: they were the first with the new time
        if other is off_time or abs(other.latest_ns - time.latest_ns) <= LOG_TIME.out_of_order_ns:
            time.stray -= sum(strays.frames for strays in other.strays.values())
            del time.off_time[bus]
        else:
            _drop(time, bus)
    return by_ns


def _count(strays: dict[str, Strays], frame: Frame, ahead_ns: int) -> None:
    one = strays.setdefault(_sender(frame), Strays(0, ahead_ns, ahead_ns))
    one.frames += 1
    one.least_ns, one.most_ns = min(ahead_ns, one.least_ns), max(ahead_ns, one.most_ns)


def _drop(time: LogTime, bus: str) -> None:
    """The frames of a series were stray."""
    off_time = time.off_time.pop(bus)
    _merge(time, off_time)
    for sender in off_time.strays:
        _tell(time, sender)


def _merge(time: LogTime, off_time: OffTimeFrames) -> None:
    time.strays = _sum(time.strays, off_time.strays)


def _sum(one: dict[str, Strays], other: dict[str, Strays]) -> dict[str, Strays]:
    out = dict(one)
    for sender, strays in other.items():
        known = out.get(sender, Strays(0, strays.least_ns, strays.most_ns))
        out[sender] = Strays(
            known.frames + strays.frames,
            min(known.least_ns, strays.least_ns),
            max(known.most_ns, strays.most_ns),
        )
    return out


def _all_strays(time: LogTime) -> dict[str, Strays]:
    strays = time.strays
    for off_time in time.off_time.values():
        strays = _sum(strays, off_time.strays)
    return strays


def _tell(time: LogTime, sender: str) -> None:
    """An event for the first stray frames of a sender, and whenever they have become ten times as many."""
    strays = time.strays[sender]
    if strays.frames >= time.told.get(sender, 1):
        time.told[sender] = 10 * strays.frames
        time.news.append((EventKind.OTHER_TIME, stray_notice(sender, strays)))
