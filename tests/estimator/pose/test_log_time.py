"""A log's time follows all later frames, not a single one: steps, silences, stray stamps."""

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np
import pytest
from circle import demo_machine
from paths import shared

from tilth.estimator.fold import initial, step
from tilth.estimator.pose.log_time import LogTime, continues, on_log_clock, stray_senders, take_stamp
from tilth.replay.readers.any_log import open_log
from tilth.schemas.flow import Event, Frame
from tilth.schemas.sentences import event_sentence, notice_sentence
from tilth.simulator.scenario import Scenario
from tilth.simulator.traffic import simulate

START = 1_700_000_000.0
Stamps = list[tuple[float, str]]  # s since the start, bus


def times(until_s: float, each_s: float, from_s: float = 0.0) -> list[float]:
    return [from_s + i * each_s for i in range(round((until_s - from_s) / each_s))]


def moves(stamps: Iterable[tuple[float, str]]) -> tuple[list[float], LogTime]:
    """The jumps, s, that frames with these stamps cause; but for that from a wrong beginning."""
    time, jumps = LogTime(), []
    for at, bus in stamps:
        t_ns = round((START + at) * 1e9)
        jump_ns = take_stamp(time, Frame(t_ns, t_ns, bus, 0, True, False, b""))
        jumps += [jump_ns * 1e-9] if jump_ns and not time.misled else []
    return jumps, time


def passed(time: LogTime) -> float:
    return time.passed_ns * 1e-9


@pytest.mark.parametrize("back", [0.8, 1.0, 2.0, 7.456, 60.0, 3600.0])
@pytest.mark.parametrize("each", [0.005, 0.05])
def test_a_step_is_reported_once_with_its_size(back: float, each: float) -> None:
    before, after = times(30.0, each), times(60.0, each, 30.0)
    jumps, time = moves([(t, "can0") for t in before] + [(t - back, "can0") for t in after])
    assert jumps == [pytest.approx(-back, abs=2 * each)]
    assert passed(time) == pytest.approx(60.0, abs=0.2) and time.stray == 0


@pytest.mark.parametrize("seed", range(40))
def test_a_step_among_late_frames_is_reported_once(seed: int) -> None:
    """Up to one frame of fifty late by up to eight seconds, all a little out of order, on one bus or two."""
    draw = np.random.default_rng(seed)
    each, back = float(draw.choice([0.004, 0.01, 0.05])), float(draw.choice([0.9, 3.0, 30.0, 10_000.0]))
    at = draw.uniform(10.0, 30.0)
    stamps = []
    for t in times(40.0, each):
        late = draw.uniform(0.0, 8.0) if draw.random() < 0.02 else draw.uniform(0.0, 2 * each)
        stamps.append((t - late - back * (t >= at), f"can{draw.integers(1 + seed % 2)}"))
    jumps, time = moves(stamps)
    assert jumps == [pytest.approx(-back, abs=1.1)]
    assert passed(time) == pytest.approx(40.0, abs=1.2)


def test_each_of_several_steps_is_reported() -> None:
    stamps = [(t - 100.0 * k, "can0") for k in range(5) for t in times(10.0, 0.01)]
    jumps, time = moves(stamps)
    assert jumps == [pytest.approx(-110.0, abs=0.1)] * 4
    assert passed(time) == pytest.approx(50.0, abs=0.2)


@pytest.mark.parametrize("apart", [0.6, 1.0, 7.456, 3600.0])
@pytest.mark.parametrize("buses", [("can0", "can0"), ("can0", "can1")])
@pytest.mark.parametrize("first", [0, 1])
@pytest.mark.parametrize("each", [(0.01, 0.01), (0.087, 0.011), (1.0, 0.1), (0.1, 1.0)])
def test_two_clocks_in_one_log_are_no_steps(
    apart: float, buses: tuple[str, str], first: int, each: tuple[float, float]
) -> None:
    """Whichever comes first, on one bus or on two, and whichever speaks more often."""
    rows = [(t, t, buses[0]) for t in times(62.6, each[0])] + [
        (t + 0.004, t - apart, buses[1]) for t in times(62.6, each[1])
    ]
    rows.sort()
    beginning = next(i for i, row in enumerate(rows) if (row[0] != row[1]) == bool(first))
    jumps, time = moves([(stamp, bus) for _, stamp, bus in rows[beginning:]])
    # A clock that came first and speaks less often gives way to the other, once.
    few_first = beginning == 0 and each[first] > each[1 - first]
    assert len([move for move in jumps if move < 0]) <= few_first
    assert len(jumps) <= 1  # that of the second clock is far ahead of the first: a silence, once
    assert passed(time) == pytest.approx(62.6, abs=apart + 1.5 if apart < 10 else 3.0)


def assembled() -> Stamps:
    """A message now and then that took so long to come and bears the time of its first frame."""
    rows = [(t, t) for t in times(120.0, 0.01)]
    rows += [(t + 0.001, t - t % 12.0) for t in times(120.0, 0.7, 12.0)]
    return [(stamp, "can0") for _, stamp in sorted(rows)]


def jittered() -> Stamps:
    return [(t - 0.1 * (i * 7919 % 5), "can0") for i, t in enumerate(times(120.0, 0.01))]


def in_blocks() -> Stamps:
    """A recorder that writes three seconds of one bus, then the same three seconds of the other."""
    return [(t + 3.0 * k, bus) for k in range(40) for bus in ("can0", "can1") for t in times(3.0, 0.01)]


def gone_wrong() -> Stamps:
    """Bursts of a few frames whose stamps are an hour ahead, or zero."""
    wrong = {5: 3600.0, 6: 3600.01, 7: 3600.02, 400: -START, 401: -START, 9000: 7200.0}
    return [(wrong.get(i, t), "can0") for i, t in enumerate(times(120.0, 0.01))]


@pytest.mark.parametrize("stamps", [assembled, jittered, in_blocks, gone_wrong])
def test_stamps_out_of_order_are_neither_steps_nor_time(stamps: Callable[[], Stamps]) -> None:
    jumps, time = moves(stamps())
    assert jumps == []
    assert passed(time) == pytest.approx(120.0, abs=0.5)


def test_a_silence_is_reported_once_and_a_busy_loop_is_none() -> None:
    jumps, time = moves([(t, "can0") for t in [*times(30.0, 0.01), *times(75.0, 0.01, 45.0)]])
    assert jumps == [pytest.approx(15.0, abs=0.02)] and time.stray == 0
    assert passed(time) == pytest.approx(60.0, abs=0.1) and time.silent_ns == pytest.approx(15e9, rel=0.01)
    jumps, _ = moves([(t, "can0") for t in times(200.0, 15.0)])
    assert (
        jumps == [pytest.approx(15.0)] * len(jumps) and len(jumps) > 2
    )  # a bus that wakes for a frame now and then
    waited = LogTime()
    for at, taken in ((0.0, 0.0), (0.1, 20.0), (0.2, 20.0), (20.1, 20.1)):
        frame = Frame(round((START + taken) * 1e9), round((START + at) * 1e9), "can0", 0, True, False, b"")
        assert take_stamp(waited, frame) == 0


def test_a_second_clock_costs_no_pose_and_is_counted() -> None:
    """Messages that are not used, of a clock 7.5 s behind, among those of a rig."""
    machine = demo_machine()
    given = list(simulate(machine, 3, 9.0, Scenario(other_traffic=False)))
    late = [
        replace(frame, t_ns=frame.t_ns - 7_456_000_000, rx_ns=frame.rx_ns - 7_456_000_000, can_id=0x18FF0001)
        for frame in given[::9]
    ]
    mixed = sorted(
        [*((f.t_ns, 0, f) for f in given), *((f.t_ns + 7_456_000_000, 1, f) for f in late)],
        key=lambda row: row[:2],
    )
    alone, among = initial(machine), initial(machine)
    out = [p for f in given for p in step(alone, f)]
    mixed_out = [p for _, _, f in mixed for p in step(among, f)]
    told = [p.value for p in mixed_out if isinstance(p.value, Event) and p.value.kind == "other_time"]
    assert [p for p in mixed_out if p.value not in told] == out
    assert event_sentence(told[0]) == "1 frame of source 1 on can0 is stamped 7.5 s behind the rest: left out"
    assert among.rejected["other_time"] == len(late) and "clock_step" not in among.rejected
    assert alone.poses == among.poses > 20 and alone.rejected.get("other_time") is None
    assert not [p for p in out if isinstance(p.value, Event) and p.value.kind in ("gap", "clock_step")]


# ---- the many decide ----

RATE = 500  # frames a second
WRONG = [-1e9, -259_200.0, -6.0, -1.0, 1.0, 2.0, 6.0, 259_200.0, "zero"]


def counted(stamps: Iterable[tuple[float, str, int]]) -> tuple[int, list[float], LogTime]:
    """How many frames are used, the jumps that are reported, and the time, of (stamp, bus, sender)."""
    time, used, jumps = LogTime(), 0, []
    for at, bus, sender in stamps:
        t_ns = max(0, round((START + at) * 1e9))
        jump_ns = take_stamp(time, Frame(t_ns, t_ns, bus, 0x18FF0000 | sender, True, False, b""))
        used += jump_ns is not None
        jumps += [jump_ns * 1e-9] if jump_ns and not time.misled else []
    return used, jumps, time


@pytest.mark.parametrize("wrong", WRONG, ids=str)
@pytest.mark.parametrize(("share", "first"), [(0.002, False), (0.002, True), (0.05, False), (0.2, False)])
def test_a_minoritys_stamps_are_left_out_and_named(wrong: float | str, share: float, first: bool) -> None:
    draw = np.random.default_rng(7)
    off = -START if wrong == "zero" else float(wrong)
    rows, few = [], 0
    for i, t in enumerate(times(40.0, 1 / RATE)):
        is_wrong = draw.random() < share if i else first
        few += is_wrong
        stamp = (-START if wrong == "zero" else t + off) if is_wrong else t
        rows.append((stamp, "can0", 28 if is_wrong else i % 5))
    used, jumps, time = counted(rows)
    assert jumps == []
    lost = len(rows) - few - used
    assert lost < (0.3 * RATE if first else 5), "the rest is used"
    assert few - first <= time.stray <= few  # a stamp of zero at the very beginning is no time yet
    strays = list(map(notice_sentence, stray_senders(time)))
    (mine,) = (text for text in strays if "source 28 on can0" in text)
    if not first:
        assert mine.startswith(f"{few} frame{'s' * (few > 1)} of source 28 on can0 ") and len(strays) == 1
        assert mine.endswith("the rest: left out") and ("behind" if off < 0 else "ahead of") in mine
        if abs(off) < 10:
            assert f"{abs(off):.1f} s" in mine
    assert time.news and time.news[0][0] == "other_time"


@pytest.mark.parametrize("apart", [-3600.0, -100.0, -5.0, -1.0, -0.5, -0.3, 0.3, 0.5, 1.0, 5.0, 100.0])
@pytest.mark.parametrize("ppm", [0.0, 100.0])
def test_two_buses_with_clocks_apart_are_aligned_by_the_order_of_the_frames(apart: float, ppm: float) -> None:
    time, worst = LogTime(), 0.0
    for i, t in enumerate(times(60.0, 1 / RATE)):
        second = i % 3 == 2
        stamp = t * (1 + ppm * 1e-6) + apart if second else t
        t_ns = round((START + stamp) * 1e9)
        frame = Frame(t_ns, t_ns, "can1" if second else "can0", 0x18FF0000, True, False, b"")
        assert take_stamp(time, frame) in (0, None)
        if t > 8.0:
            worst = max(worst, abs(on_log_clock(time, frame).t_ns * 1e-9 - START - t))
            assert continues(time, frame)
    assert worst < 0.01
    ((_, apart_by),) = [row for row in time.news if row[0] == "other_clock"]
    assert f"can1 is {abs(apart):.1f} s {'ahead of' if apart > 0 else 'behind'}" in notice_sentence(apart_by)


@pytest.mark.parametrize("each", [0.1, 1.0])
def test_stamps_that_are_too_coarse_are_said(each: float) -> None:
    rows = [(int(t / each + 1e-6) * each, "can0", i % 5) for i, t in enumerate(times(20.0, 1 / RATE))]
    used, jumps, time = counted(rows)
    assert used > 0.98 * len(rows) and jumps == [pytest.approx(1.0)] * len(jumps)
    (coarse,) = [told for kind, told in time.news if kind == "coarse_stamps"]
    assert ("whole seconds" if each == 1.0 else "steps of 0.1 s") in notice_sentence(coarse)


def test_of_the_drive_with_sixty_frames_ahead_all_others_are_used() -> None:
    log = shared("data/strangers/second/02-one-frame-a-second-6s-ahead.log.gz")
    state = initial(demo_machine())
    state.ready = False
    for record in open_log(log).records:
        if isinstance(record, Frame):
            step(state, record)
    assert state.poses == 296 and state.rejected["other_time"] == 60
    assert list(map(notice_sentence, stray_senders(state.time))) == [
        "60 frames of source 0 on can0 are stamped 6.0 s ahead of the rest: left out"
    ]


def test_clocks_apart_in_a_log_that_was_sorted_are_said() -> None:
    """By what both heard: the UTC of their receivers."""
    text = {
        'bus = "can0"\nname = "C0': 'bus = "can1"\nname = "C0',
        '[[receiver]]\nmount = "tractor_front"': '[[bus]]\nname = "can1"\ninterface = "virtual"\n'
        'channel = "x"\n\n[[receiver]]\nmount = "tractor_front"',
    }
    told = {}
    for apart_ns in (0, 5_000_000_000):
        state, out = initial(demo_machine(**text)), []
        state.ready = False
        frames = []
        for frame in simulate(demo_machine(), 3, 20.0, Scenario(other_traffic=False)):
            second = frame.extended and frame.can_id & 0xFF in (70, 129)
            t_ns = frame.t_ns + apart_ns * second
            frames.append(replace(frame, t_ns=t_ns, rx_ns=t_ns, bus="can1" if second else "can0"))
        for frame in sorted(frames, key=lambda f: f.t_ns):
            out += [p.value for p in step(state, frame) if isinstance(p.value, Event)]
        told[apart_ns] = [event_sentence(event) for event in out if event.kind == "other_clock"]
    assert told[0] == []
    (text_,) = told[5_000_000_000]
    assert text_.startswith("by the UTC of the receivers the clock of can1 is ")
