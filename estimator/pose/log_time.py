"""The time of a log, from the stamps of its frames: whether it goes on, was silent, or stepped back.

A frame with another time than those before it may be alone with it: a message that was assembled over
seconds and bears the time of its first frame, one of a second clock in the same log, a stamp gone wrong. Such
a frame is astray and moves nothing. The log's time moves when no frame keeps to it for a while.
"""

from dataclasses import dataclass, field

from tilth.schemas.flow import Frame

BACK_NS = 500_000_000  # stamps that run back by less are out of order, no more
SILENCE_NS = 10_000_000_000  # nobody spoke, or the stamps were set ahead: nothing goes on over this
STAYS_NS = 1_500_000_000  # all frames at an earlier time for so long: a device on another clock that speaks
# once a second would have spoken
RESUMES_NS = 500_000_000  # the same of a later time: longer than the burst of one message
EVEN_NS = 200_000_000  # from a frame to the next: more counts as no more, for it may be late by any time
LATE_NS = 1_000_000_000  # from one to the next: more tells that the first was alone, not where the row begins


@dataclass(slots=True)
class Row:
    """Frames one after another that all bear another time than the log's. Times in ns."""

    from_ns: int  # the log's time before them
    since_ns: int  # of the first of them
    latest_ns: int  # the greatest of theirs
    last_ns: int  # of the last
    needed_ns: int  # how long they must last
    passed_ns: int  # of the log, before them
    lasted_ns: int = 0  # how long they have
    astray: int = 0  # how many were not used


@dataclass(slots=True)
class LogTime:
    """What is known of a log's time. All times in ns on the clock of Frame.t_ns."""

    latest_ns: int = 0  # greatest stamp since the last step back; 0 before the first
    passed_ns: int = 0  # while frames came: silences and steps are left out
    silent_ns: int = 0  # of the silences
    astray: int = 0  # frames with another time than the log's before and after them
    bus_ns: dict[str, int] = field(default_factory=dict)  # bus -> its greatest stamp since the time moved
    row: Row | None = None  # of frames that may yet turn out to be right


def follow(time: LogTime, frame: Frame) -> int | None:
    """Take the stamp of a frame. 0: the log's time goes on; None: this frame is astray.

    Less than 0: the log's time has stepped, by so many ns; more: there was a silence of so many ns.
    """
    t_ns, latest_ns = frame.t_ns, time.latest_ns
    now_ns = min(frame.rx_ns, t_ns)  # a frame that only waited tells of no silence
    heard_ns = time.bus_ns.get(frame.bus, 0)
    if latest_ns:
        if t_ns < latest_ns - BACK_NS:
            of_its_own = t_ns >= heard_ns - BACK_NS  # a bus that is in order, on another clock
            return _other(time, frame, t_ns, SILENCE_NS if of_its_own else STAYS_NS)
        if now_ns > latest_ns + SILENCE_NS:
            return _other(time, frame, now_ns, RESUMES_NS)
        time.passed_ns += max(0, t_ns - latest_ns)
    time.bus_ns[frame.bus] = max(t_ns, heard_ns)
    time.latest_ns = max(t_ns, latest_ns)
    return 0 if time.row is None else _in_time_again(time, time.row, frame)


def _other(time: LogTime, frame: Frame, at_ns: int, needed_ns: int) -> int | None:
    """A frame with another time: alone, or one of all those since the log's time was last borne by one."""
    row = time.row
    if row is None or (row.since_ns < row.from_ns) != (at_ns < row.from_ns):
        row = time.row = Row(time.latest_ns, at_ns, at_ns, at_ns, needed_ns, time.passed_ns)
    row.needed_ns = min(needed_ns, row.needed_ns)
    if _goes_on(row, at_ns):
        return _moved(time, row, frame)
    row.astray += 1
    time.astray += 1
    return None


def _goes_on(row: Row, at_ns: int) -> bool:
    """Take one more of them. Whether they have lasted long enough."""
    if at_ns < row.from_ns and (
        at_ns > row.latest_ns + LATE_NS or (not row.lasted_ns and at_ns < row.latest_ns - LATE_NS)
    ):
        row.since_ns = row.latest_ns = at_ns
    row.lasted_ns += min(max(0, at_ns - row.last_ns), EVEN_NS)
    row.latest_ns = max(at_ns, row.latest_ns)
    row.last_ns = at_ns
    return row.lasted_ns >= row.needed_ns


def _in_time_again(time: LogTime, row: Row, frame: Frame) -> int:
    """A frame in the log's time after others that were not: they were astray, unless it follows them evenly;
    then the log has stepped back by little, and they have caught up."""
    by_ns = row.since_ns - row.from_ns
    if by_ns > 0 or frame.t_ns - row.latest_ns > min(EVEN_NS, -by_ns // 2):
        time.row = None
    elif _goes_on(row, frame.t_ns):
        return _moved(time, row, frame)
    return 0


def _moved(time: LogTime, row: Row, frame: Frame) -> int:
    by_ns = row.since_ns - row.from_ns
    time.passed_ns = row.passed_ns + row.latest_ns - row.since_ns
    time.silent_ns += max(0, by_ns)
    time.astray -= row.astray  # these had the right time before all others
    time.latest_ns = max(frame.t_ns, row.latest_ns)
    time.bus_ns = {frame.bus: time.latest_ns}
    time.row = None
    return by_ns
