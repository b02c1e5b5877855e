"""The time of a log, from the stamps of its frames: does it continue, was there a silence, did it step back?

A single frame may have a stamp far from those before it: a message that was assembled over seconds and has
the time of its first frame, a frame of a second clock in the same log, or a wrong stamp. Such a frame is
called stray; it does not change the log's time. The log's time jumps only when for a while no frame has had a
stamp near it.
"""

from dataclasses import dataclass, field

from tilth.schemas.flow import Frame

OUT_OF_ORDER_NS = 500_000_000  # stamps that go back by less than this are only out of order
SILENCE_NS = 10_000_000_000  # no frame for so long, or stamps that jump ahead by it: nothing continues across
EARLIER_LASTS_NS = 1_500_000_000
"""How long all frames must have an earlier time before it is accepted: a device that sends once a second on
the old clock would have sent by then."""
LATER_LASTS_NS = 500_000_000  # the same for a later time: longer than the frames of one long message
LONGEST_INTERVAL_NS = 200_000_000  # a longer time between frames counts as this: the frame may be delayed
LONE_FRAME_NS = 1_000_000_000  # a larger gap between two stray frames shows that the first one was alone


@dataclass(slots=True)
class OffTimeFrames:
    """Consecutive frames whose stamps all differ from the log's time. Times in ns."""

    from_ns: int  # the log's time before them
    since_ns: int  # stamp of the first of them
    latest_ns: int  # their greatest stamp
    last_ns: int  # stamp of the last of them
    needed_ns: int  # how long they must last to be accepted
    passed_ns: int  # LogTime.passed_ns before them
    lasted_ns: int = 0  # how long they have lasted
    stray: int = 0  # how many of them were not used


@dataclass(slots=True)
class LogTime:
    """State of a log's time. All times in ns on the clock of Frame.t_ns."""

    latest_ns: int = 0  # greatest stamp since the last step back; 0 before the first
    passed_ns: int = 0  # time during which frames came, without silences and steps
    silent_ns: int = 0  # sum of the silences
    stray: int = 0  # stray frames: the log's time before and after them was another
    bus_ns: dict[str, int] = field(default_factory=dict)  # bus -> its greatest stamp since the last jump
    off_time: OffTimeFrames | None = None  # frames at another time that may turn out to be right


def take_stamp(time: LogTime, frame: Frame) -> int | None:
    """Take the stamp of a frame. Returns 0 if the log's time continues, None if this frame is stray.

    A value below 0 is a step back of the log's time by so many ns, above 0 a silence of so many ns.
    """
    t_ns, latest_ns = frame.t_ns, time.latest_ns
    now_ns = min(frame.rx_ns, t_ns)  # a frame that waited in a queue is no sign of a silence
    bus_latest_ns = time.bus_ns.get(frame.bus, 0)
    if latest_ns:
        if t_ns < latest_ns - OUT_OF_ORDER_NS:
            bus_in_order = t_ns >= bus_latest_ns - OUT_OF_ORDER_NS  # then this bus has another clock
            return _off_time_frame(time, frame, t_ns, SILENCE_NS if bus_in_order else EARLIER_LASTS_NS)
        if now_ns > latest_ns + SILENCE_NS:
            return _off_time_frame(time, frame, now_ns, LATER_LASTS_NS)
        time.passed_ns += max(0, t_ns - latest_ns)
    time.bus_ns[frame.bus] = max(t_ns, bus_latest_ns)
    time.latest_ns = max(t_ns, latest_ns)
    return 0 if time.off_time is None else _in_time_again(time, time.off_time, frame)


def _off_time_frame(time: LogTime, frame: Frame, at_ns: int, needed_ns: int) -> int | None:
    """Take a frame at another time: a stray one, or one more of a series. Returns as `take_stamp`."""
    off_time = time.off_time
    if off_time is None or (off_time.since_ns < off_time.from_ns) != (at_ns < off_time.from_ns):
        off_time = time.off_time = OffTimeFrames(
            time.latest_ns, at_ns, at_ns, at_ns, needed_ns, time.passed_ns
        )
    off_time.needed_ns = min(needed_ns, off_time.needed_ns)
    if _extend(off_time, at_ns):
        return _accept_jump(time, off_time, frame)
    off_time.stray += 1
    time.stray += 1
    return None


def _extend(off_time: OffTimeFrames, at_ns: int) -> bool:
    """Add one more frame to the series. Returns whether it has lasted long enough to be accepted."""
    if at_ns < off_time.from_ns and (
        at_ns > off_time.latest_ns + LONE_FRAME_NS
        or (not off_time.lasted_ns and at_ns < off_time.latest_ns - LONE_FRAME_NS)
    ):
        off_time.since_ns = off_time.latest_ns = at_ns
    off_time.lasted_ns += min(max(0, at_ns - off_time.last_ns), LONGEST_INTERVAL_NS)
    off_time.latest_ns = max(at_ns, off_time.latest_ns)
    off_time.last_ns = at_ns
    return off_time.lasted_ns >= off_time.needed_ns


def _in_time_again(time: LogTime, off_time: OffTimeFrames, frame: Frame) -> int:
    """Take a frame at the log's time after frames at another time. Returns as `take_stamp`.

    Those were stray, unless this frame continues them without a gap: then the log has stepped back by little,
    and their stamps have caught up with its time before the step.
    """
    by_ns = off_time.since_ns - off_time.from_ns
    if by_ns > 0 or frame.t_ns - off_time.latest_ns > min(LONGEST_INTERVAL_NS, -by_ns // 2):
        time.off_time = None
    elif _extend(off_time, frame.t_ns):
        return _accept_jump(time, off_time, frame)
    return 0


def _accept_jump(time: LogTime, off_time: OffTimeFrames, frame: Frame) -> int:
    """Set the log's time to that of the series. Returns the jump, ns."""
    by_ns = off_time.since_ns - off_time.from_ns
    time.passed_ns = off_time.passed_ns + off_time.latest_ns - off_time.since_ns
    time.silent_ns += max(0, by_ns)
    time.stray -= off_time.stray  # they were not stray: they were the first with the new time
    time.latest_ns = max(frame.t_ns, off_time.latest_ns)
    time.bus_ns = {frame.bus: time.latest_ns}
    time.off_time = None
    return by_ns
