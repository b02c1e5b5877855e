"""Frames that come as frames usually do, many at a time.

Such a frame changes nothing but the log's time and when its bus was heard last, unless somebody reads it, and
`log_time.take_stamp` and `lateness.take_frame` come to the few lines here. Any other is left to them.
"""

from collections.abc import Iterator, Mapping, Sequence

from tilth.estimator.pose.lateness import Arrivals, Lateness
from tilth.estimator.pose.log_time import LOG_TIME, LogTime
from tilth.schemas.flow import Frame

Routes = Mapping[tuple[str, int, bool], object]
"""Bus, identifier and whether it has 29 bits: None where nobody reads it."""


def usual(
    time: LogTime, frames: Sequence[Frame], first: int, late: Lateness | None = None,
    routes: Routes | None = None, before_ns: int | None = None, now_before_ns: int | None = None,
) -> Iterator[tuple[int, bool]]:  # fmt: skip
    """Take the stamps of frames from the first on. Gives (index, True) of each that somebody reads, its stamp
    taken, and (index, False) of the first that does not come as usual, its stamp not taken, which ends it.

    late: takes the stamps too. routes: nobody reads anything without. before_ns: a t_ns that ends it;
    now_before_ns: the same of when a frame was received. Whoever changes `time` meanwhile begins anew.
    """
    if time.offset_ns or time.off_time or not time.begun or time.step_ns >= LOG_TIME.coarse_ns or time.news:
        if first < len(frames):
            yield first, False
        return
    latest_ns, step_ns, gap_ns, bus_ns = time.latest_ns, time.step_ns, time.gap_ns, time.bus_ns
    passed_ns, bus, since, k = 0, time.last_bus, first, first
    buses: dict[str, tuple[Arrivals, int]] = {}
    for k in range(first, len(frames)):
        frame = frames[k]
        t_ns, rx_ns, of = frame.t_ns, frame.rx_ns, frame.bus
        if (known := buses.get(of)) is None:
            arrivals = late.buses.get(of) if late is not None else Arrivals()
            if arrivals is None or not _is_near(time, of):
                break
            known = buses[of] = arrivals, round(arrivals.usual_ns)
        advance_ns = t_ns - latest_ns
        if (
            not 0 <= advance_ns <= LOG_TIME.out_of_order_ns
            or (before_ns is not None and t_ns >= before_ns)
            or frame.error
        ):
            break
        if late is not None:
            arrivals, closest_ns = known
            interval_ns = rx_ns - arrivals.last_ns
            if interval_ns < closest_ns or interval_ns <= 0:
                break
            if now_before_ns is not None and (rx_ns if rx_ns < t_ns else t_ns) >= now_before_ns:
                break
            arrivals.last_ns, arrivals.idle_ns, arrivals.waited_ns, arrivals.heap = rx_ns, interval_ns, 0.0, 0
        bus = of
        if advance_ns:
            step_ns = advance_ns if advance_ns < step_ns or not step_ns else step_ns
            passed_ns += advance_ns
            kept_ns = gap_ns - gap_ns * advance_ns // LOG_TIME.gap_lasts_ns
            gap_ns = advance_ns if advance_ns > kept_ns else kept_ns
            latest_ns = t_ns
        if t_ns > bus_ns[of]:
            bus_ns[of] = t_ns
        if routes is not None and routes.get((of, frame.can_id, frame.extended), of) is not None:
            _set(time, latest_ns, step_ns, gap_ns, bus, passed_ns, k + 1 - since)
            passed_ns, since = 0, k + 1
            yield k, True
    else:
        k = len(frames)
    _set(time, latest_ns, step_ns, gap_ns, bus, passed_ns, k - since)
    if k < len(frames):
        yield k, False


def _is_near(time: LogTime, bus: str) -> bool:
    """Whether it is known that a bus is on the log's clock."""
    near = time.near.get(bus)
    return near is not None and bus in time.bus_ns and (near >= LOG_TIME.certain or len(time.bus_ns) == 1)


def _set(
    time: LogTime, latest_ns: int, step_ns: int, gap_ns: int, bus: str, passed_ns: int, frames: int
) -> None:
    """Of so many frames, which took passed_ns."""
    time.latest_ns, time.step_ns, time.gap_ns, time.last_bus = latest_ns, step_ns, gap_ns, bus
    time.passed_ns += passed_ns
    time.in_time += frames
