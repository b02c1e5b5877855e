"""Frames taken many at a time leave what they leave one by one, however they come."""

from copy import deepcopy

from circle import demo_machine
from hypothesis import given
from hypothesis import strategies as st

from tilth.estimator.pose import lateness, log_time
from tilth.estimator.pose.lateness import Lateness
from tilth.estimator.pose.log_time import LogTime
from tilth.estimator.pose.usual_frames import usual
from tilth.logger.fitting import InPlace
from tilth.logger.guarded_fold import GuardedFold
from tilth.schemas.flow import Frame
from tilth.simulator.traffic import simulate

MACHINE = demo_machine()
MS = 1_000_000
GAPS = st.sampled_from([0, 1, MS // 10, MS // 2, 5 * MS, 40 * MS, 600 * MS, 11_000 * MS, -MS, -3_000 * MS])
BUSES = ("can0", "can1")
READ, UNREAD = 0x18FF0B15, 0x18FF0C15
ROUTES = {(bus, UNREAD, True): None for bus in BUSES} | {("can0", READ, True): READ}
ROWS = st.lists(st.tuples(GAPS, GAPS, st.sampled_from(BUSES), st.booleans(), st.integers(1, 30)), max_size=40)


def frames_of(rows: list[tuple[int, int, str, bool, int]]) -> list[Frame]:
    """Each row so often, with gaps of half a millisecond behind the first."""
    out, t_ns = [], 10**18
    for gap, queued, bus, read, times in rows:
        for n in range(times):
            t_ns += gap if n == 0 else MS // 2
            rx_ns = t_ns - (max(queued, 0) if n == 0 else 0)
            out.append(Frame(t_ns, rx_ns, bus, READ if read else UNREAD, True, n == 7, b""))
    return out


@given(ROWS)
def test_stamps_are_taken_as_one_by_one(rows: list[tuple[int, int, str, bool, int]]) -> None:
    given_frames = frames_of(rows)
    singly, many = (LogTime(), Lateness()), (LogTime(), Lateness())
    seen: list[tuple[LogTime, Lateness]] = []
    for frame in given_frames:
        if log_time.take_stamp(singly[0], frame) is not None:
            lateness.take_frame(singly[1], MACHINE, frame)
        seen.append(deepcopy(singly))
    k = 0
    while k < len(given_frames):
        end = len(given_frames)
        for at, stamped in usual(many[0], given_frames, k, many[1], ROUTES):
            if stamped:
                assert many == seen[at]
            else:
                end = at
        if end < len(given_frames):
            frame = given_frames[end]
            if log_time.take_stamp(many[0], frame) is not None:
                lateness.take_frame(many[1], MACHINE, frame)
            assert many == seen[end]
        k = end + 1
    assert many == singly


def test_a_drive_gives_the_same_in_blocks() -> None:
    class NoFits(InPlace):
        def made(self, method: str, job: object) -> None:
            return None

    drive = list(simulate(MACHINE, 1, 6.0))
    del drive[2000:2400]  # half a second is missing
    one, other = (GuardedFold(MACHINE, fitter=NoFits(MACHINE)) for _ in range(2))
    singly = [given for frame in drive for given in one.take(frame)]
    many = [given for k in range(0, len(drive), 77) for given in other.take_all(drive[k : k + 77])]
    assert singly == many and one.renew() == other.renew()
