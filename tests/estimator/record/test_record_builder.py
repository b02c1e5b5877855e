"""Records against the truth of a driven rig: every row at its own instant, and what must not be learned
from."""

import json
import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from circle import ORIGIN_DEG as CIRCLE_ORIGIN_DEG
from circle import START_NS, Circle, demo_machine
from numpy.typing import NDArray

from tilth.estimator.models import nonlinear
from tilth.estimator.pose import aligner
from tilth.estimator.pose.aligner import Aligner
from tilth.estimator.pose.geometry import to_plane
from tilth.estimator.pose.pose import poses
from tilth.estimator.record import record_builder
from tilth.estimator.record.record import (
    EAST,
    HEADING,
    NORTH,
    ROLL_ANGLE,
    SD,
    TICK_NS,
    VALUE,
    VELOCITY,
    YAW_RATE,
    Segment,
)
from tilth.estimator.record.record_builder import RecordState
from tilth.estimator.rig.geometry import rotate
from tilth.estimator.state_json import from_json_data, to_json_data
from tilth.schemas.flow import (
    Attitude,
    Fix,
    FixType,
    Flag,
    Heading,
    Measurement,
    Mount,
    Origin,
    Pose,
    Position,
    Velocity,
    WheelAngle,
    YawRate,
    known_flags,
)
from tilth.schemas.machine import Machine, Receiver
from tilth.schemas.reasons import Code
from tilth.simulator.drive import drive
from tilth.simulator.receivers import reports, wheel_readings
from tilth.simulator.scenario import ORIGIN_DEG, Ground, Scenario, SurveyErrors
from tilth.simulator.tractor import AT, Truth

Array = NDArray[np.float64]
Change = Callable[[Pose], Pose]
ALL = tuple(Mount)
SECONDS = 19.0
SURE = "latency = { value = 0.1, sd = 0 }\n"  # so that nothing is to be learned of it
KNOWN = demo_machine(**{f"{end}]\n": f"{end}]\n{SURE}" for end in ("2.9", "3.1")})
EVEN = Ground()


def measurements(machine: Machine, truth: Truth) -> list[Measurement]:
    """What the sensors of a driven rig say, each 0.1 s after it was measured, with nothing rounded."""
    start = truth.scenario.utc_start_ns
    out: list[Measurement] = []
    for number, receiver in enumerate(machine.receiver):
        origin = Origin("can0", 28 + number, receiver.name, receiver.mount)
        for row in reports(machine, truth, receiver, 0.0):
            rx = start + round((row.epoch_s + 0.1) * 1e9)
            head = (rx, rx, origin)
            out += [
                Position(*head, 129025, None, row.latitude_deg, row.longitude_deg, receiver.position_sd),
                Velocity(*head, 129026, None, row.course, row.speed, receiver.velocity_sd),
                YawRate(*head, 127251, None, row.yaw_rate, 0.005),
                Attitude(*head, 127257, None, row.roll, row.pitch, 0.009),
                Heading(*head, 127250, None, row.heading, 0.009),
                Fix(*head, 129029, None, FixType.RTK_FIXED),
            ]
    delay = round(machine.wheel_angle.delay * 1e9)
    for t, angle in zip(truth.time.tolist(), wheel_readings(truth).tolist(), strict=True):
        rx = start + round(t * 1e9) + delay
        out.append(WheelAngle(rx, rx, Origin("can0", 0x15), 65291, None, angle, 0.002))
    return sorted(out, key=lambda m: m.rx_ns)


def posed(machine: Machine, measurements: list[Measurement]) -> Iterator[tuple[Aligner, Pose]]:
    state = aligner.initial(machine)
    for measurement in measurements:
        aligner.take(state, measurement)
        for pose in poses(state, measurement.rx_ns):
            yield state, pose


def record(machine: Machine, measurements: list[Measurement]) -> tuple[RecordState, list[Segment]]:
    state, out = record_builder.initial(machine), []
    for aligned, pose in posed(machine, measurements):
        segment = record_builder.observe(state, aligned, pose)
        if segment is not None:
            out.append(segment)
    return state, out


@cache
def driven(ground: Ground = EVEN, noise: float = 0.0) -> Truth:
    scenario = Scenario(
        noise=noise, ground=ground, survey=SurveyErrors(0.0, 0.0, 0.0), clock_offset_s=0.0,
        latency_s=dict.fromkeys(ALL, 0.1), steering=((3.0, 0.0), (5.0, 7.0), (4.0, -6.0), (3.0, 3.0)),
    )  # fmt: skip
    return drive(KNOWN, 3, SECONDS, scenario)


def errors(machine: Machine, truth: Truth, segments: list[Segment]) -> Array:
    """[n, 4]: kind, place, error, sd of every row. The truth is that of the points that the receivers report,
    which roll takes along and which pitch does not."""
    cart = nonlinear.implement(truth.rig, truth.states)
    columns = {name: truth.states[:, k] for name, k in AT.items()}
    ways = (
        [columns[name] for name in ("x_t", "y_t", "u", "v", "psi_t", "r_t")],
        [*(cart[:, k] for k in range(4)), columns["psi_i"], columns["r_i"]],
    )
    origin = to_plane(_origin(machine, truth), *ORIGIN_DEG)
    places = {ALL.index(r.mount): _reported(r) for r in machine.receiver}
    rolls = (truth.tractor.roll, truth.implement.roll)
    leans = [np.sin(roll) for roll in rolls]
    sways = [np.gradient(lean, truth.time) for lean in leans]
    out = []
    for segment in segments:
        whole = segment.record
        base = (whole.t_ns - truth.scenario.utc_start_ns) * 1e-9
        for tick, offset, kind, place, value, sd in whole.rows.tolist():
            body = int(place) if kind in (YAW_RATE, HEADING) else int(place) // 2
            t = base + tick * TICK_NS * 1e-9 + offset
            x, y, u, v, psi, r = (float(np.interp(t, truth.time, column)) for column in ways[body])
            near = whole.ticks[:, 2 + body]
            psi_ref = near[int(tick)] + offset / (TICK_NS * 1e-9) * (near[-1] - near[-2])
            if kind in (YAW_RATE, HEADING, ROLL_ANGLE):
                roll = float(np.interp(t, truth.time, rolls[body]))
                true = {YAW_RATE: r, HEADING: psi, ROLL_ANGLE: roll}[kind]
                out.append((kind, place, math.remainder(value - true, math.tau), sd))
                continue
            forward, right, height = places[int(place)]
            right += height * float(np.interp(t, truth.time, leans[body]))
            sway = height * float(np.interp(t, truth.time, sways[body]))
            arm = rotate((forward, right), psi)
            _, across = rotate((u - r * right, v + r * forward + sway), psi - psi_ref)
            true = {VELOCITY: across, NORTH: x + arm[0] + origin[0], EAST: y + arm[1] + origin[1]}[kind]
            out.append((kind, place, value - true, sd))
    return np.array(out)


def _reported(receiver: Receiver) -> tuple[float, float, float]:
    """Forward and right of its body's CG, and above the ground, of the point that it reports, m."""
    forward, right, height = receiver.position
    return forward, right, 0.0 if receiver.roll_corrected else height


def _origin(machine: Machine, truth: Truth) -> tuple[float, float]:
    _, pose = next(posed(machine, measurements(machine, truth)[:2000]))
    return pose.origin_latitude_deg, pose.origin_longitude_deg


def of(table: Array, kind: float, *places: int) -> Array:
    return np.asarray(table[(table[:, 0] == kind) & np.isin(table[:, 1], places)])


def instants(segments: list[Segment], kind: float, place: int) -> Array:
    """s since START_NS."""
    out: list[float] = []
    for segment in segments:
        rows = segment.record.rows
        chosen = rows[(rows[:, 2] == kind) & (rows[:, 3] == place)]
        base = (segment.record.t_ns - START_NS) * 1e-9
        out += (base + chosen[:, 0] * TICK_NS * 1e-9 + chosen[:, 1]).tolist()
    return np.array(out)


@pytest.mark.parametrize(
    ("ground", "velocity", "position"),
    [(EVEN, 1e-4, 1e-4), (Ground(slope_deg=5.0, downhill_deg=60.0), 0.01, 0.004)],
    ids=["flat", "slope"],
)
def test_rows_and_inputs_are_true_at_their_instants(ground: Ground, velocity: float, position: float) -> None:
    truth = driven(ground)
    state, out = record(KNOWN, measurements(KNOWN, truth))
    table = errors(KNOWN, truth, out)
    assert np.abs(of(table, YAW_RATE, 0, 1)[:, 2]).max() < 1e-3
    assert np.abs(of(table, VELOCITY, 0, 1, 2, 3)[:, 2]).max() < velocity
    assert np.abs(table[np.isin(table[:, 0], (NORTH, EAST))][:, 2]).max() < position
    assert not len(of(table, HEADING, 0, 1))
    for segment in out:
        ticks, base = segment.record.ticks, (segment.record.t_ns - truth.scenario.utc_start_ns) * 1e-9
        t = base + np.arange(10) * 0.02
        states = truth.states[np.round(t / 0.01).astype(int)]
        assert np.abs(ticks[:, 0] - states[:, AT["delta"]]).max() < 0.003
        assert np.abs(ticks[:, 1] - states[:, AT["u"]]).max() < 0.05
        away = ticks[:, 2:4] - states[:, [AT["psi_t"], AT["psi_i"]]]
        assert np.abs((away + np.pi) % (2 * np.pi) - np.pi).max() < 0.01
        roll = np.interp(t, truth.time, truth.implement.roll)
        assert np.abs(ticks[:, 7] - roll).max() < 2e-3
    assert state.used.late == 0 and set(state.refused) <= {Code.SETTLING, Code.NO_HEADING}
    assert sum(len(s.record.rows) for s in out if not s.reason) == state.samples > 1000


def test_the_rate_of_the_speed_is_the_rigs_and_not_the_receivers_noise() -> None:
    """It is an input of the motion: with its noise a folded rig looks heavy, and its tyres soft."""
    scenario = replace(driven().scenario, noise=1.0, speed_sd=0.1)
    truth = drive(KNOWN, 3, SECONDS, scenario)
    start, messages = truth.scenario.utc_start_ns, measurements(KNOWN, truth)
    by_poses = {p.t_ns: p.tractor.forward_velocity for _, p in posed(KNOWN, messages)}
    records = [segment.record for segment in record(KNOWN, messages)[1] if not segment.reason]
    errors, of_poses = [], []
    for one in records:
        ends = (one.t_ns, one.end_ns)
        low, high = (float(np.interp((t - start) * 1e-9, truth.time, truth.states[:, AT["u"]])) for t in ends)
        first, last = (by_poses[t] for t in ends)
        assert first is not None and last is not None
        errors.append((one.ticks[-1, 1] - one.ticks[-2, 1]) / 0.02 - (high - low) / 0.2)
        of_poses.append((last - first - high + low) / 0.2)
    assert len(errors) > 50 and np.std(errors) < 0.5 * np.std(of_poses)
    for one, following in pairwise(records):
        if following.t_ns == one.end_ns:
            at_end = 2 * one.ticks[-1, 1] - one.ticks[-2, 1]
            assert following.ticks[0, 1] == pytest.approx(at_end, abs=1e-9)


def test_what_a_swaying_body_does_to_its_antennas_stays_in_the_rows() -> None:
    """The cart's antennas are 3.1 m high; the tractor's receivers report points on the ground. Roll is
    for the filters: the rows say where an antenna is."""
    truth = driven(Ground(roll_sd_deg=1.5, band=(0.6, 6.0)))
    _, out = record(KNOWN, measurements(KNOWN, truth))
    table = errors(KNOWN, truth, out)
    roll_rate_squares = 3.1 * np.gradient(truth.implement.roll, truth.time)
    assert roll_rate_squares.std() > 0.25
    assert of(table, VELOCITY, 2, 3)[:, 2].std() < 0.02 * roll_rate_squares.std()
    assert np.abs(of(table, VELOCITY, 0, 1)[:, 2]).max() < 0.01
    sway = 3.1 * truth.implement.roll
    off = table[np.isin(table[:, 0], (NORTH, EAST)) & (table[:, 1] >= 2)][:, 2]
    assert off.std() < 0.02 * sway.std()
    assert np.abs(of(table, ROLL_ANGLE, 0, 1, 2, 3)[:, 2]).max() < 2e-4


def test_rolls_are_rows_of_their_receivers_as_they_were_measured() -> None:
    truth = driven(Ground(roll_sd_deg=1.5, band=(0.6, 6.0)))
    sent, start = measurements(KNOWN, truth), truth.scenario.utc_start_ns
    marked = []
    for m in sent:  # each receiver has its own zero error and says its own sd
        if isinstance(m, Attitude) and m.roll is not None and m.origin.mount is not None:
            place = ALL.index(m.origin.mount)
            m = replace(m, roll=m.roll + 0.003 * place, sd=0.004 + 0.001 * place)
        marked.append(m)
    _, out = record(KNOWN, marked)
    # Learned latencies move an instant by some hundredths of a ms: from end to end but for the last few.
    first, last = out[0].record.t_ns - 100_000, out[-1].record.end_ns - 50_000_000
    for place, mount in enumerate(ALL):
        expected = np.array([
            (m.rx_ns - 100_000_000 - start, m.roll, m.sd)
            for m in marked
            if isinstance(m, Attitude) and m.origin.mount is mount and first <= m.rx_ns - 100_000_000 < last
        ])  # fmt: skip
        rows = np.concatenate([segment.record.rows for segment in out])
        rows = rows[(rows[:, 2] == ROLL_ANGLE) & (rows[:, 3] == place)]
        at = instants(out, ROLL_ANGLE, place) * 1e9 + START_NS - start
        chosen = at < last - start
        np.testing.assert_allclose(at[chosen], expected[:, 0], atol=1e5)
        assert rows[chosen, VALUE].tolist() == expected[:, 1].tolist()
        assert rows[chosen, SD].tolist() == expected[:, 2].tolist()


def test_noise_of_roll_is_not_taken_for_swaying() -> None:
    even = driven(noise=1.0)
    table = errors(KNOWN, even, record(KNOWN, measurements(KNOWN, even))[1][40:])
    assert of(table, VELOCITY, 2, 3)[:, 2].std() < 1.2 * of(table, VELOCITY, 0, 1)[:, 2].std()
    rough = driven(Ground(roll_sd_deg=1.5), noise=1.0)
    table = of(errors(KNOWN, rough, record(KNOWN, measurements(KNOWN, rough))[1][40:]), VELOCITY, 2, 3)
    assert table[:, 2].std() < 0.1
    assert table[:, 2].std() < 1.6 * table[:, 3].mean()  # what the sd says of it


def test_a_lone_receiver_gives_its_heading() -> None:
    text = KNOWN.model_copy(update={"receiver": [r for r in KNOWN.receiver if r.mount is not ALL[3]]})
    truth = driven()
    _, out = record(text, measurements(text, truth))
    table = errors(text, truth, out)
    assert len(of(table, HEADING, 1)) > 100 and not len(of(table, HEADING, 0))
    assert np.abs(of(table, HEADING, 1)[:, 2]).max() < 2e-3


@pytest.mark.parametrize("jitter", [0.0, 0.02])
def test_every_sample_is_there_once(jitter: float) -> None:
    circle = Circle(period_s={ALL[2]: 0.1, ALL[3]: 0.1}, jitter_s=jitter)
    state, out = record(circle.machine, list(circle.measurements(20.0)))
    for before, after in pairwise(out):
        assert after.record.t_ns == before.record.end_ns and len(before.record.ticks) == 10
    for place, period in enumerate((0.2, 0.2, 0.1, 0.1)):
        for kind in (VELOCITY, NORTH, EAST):
            steps = np.diff(instants(out, kind, place)[5:])
            assert len(steps) > 80 and np.abs(steps - period).max() < 0.01 + jitter
        assert len(instants(out, NORTH, place)) == len(instants(out, EAST, place))
    for segment in out:
        rows = segment.record.rows
        order = rows[:, 0] * TICK_NS * 1e-9 + rows[:, 1]
        assert (np.diff(order) >= 0).all()
        assert (rows[:, 1] >= 0).all() and (rows[:, 1] < 0.02).all() and (rows[:, 0] < 10).all()
    assert state.used.late == 0


def test_learned_latencies_are_taken_out() -> None:
    late = {ALL[0]: 0.05, ALL[1]: 0.15, ALL[2]: 0.12, ALL[3]: 0.07}
    circle = Circle(latency_s=late)
    machine = circle.machine
    _, out = record(machine, list(circle.measurements(30.0)))
    mean = sum(late.values()) / 4 - 0.1
    *_, (_, pose) = posed(machine, list(circle.measurements(3.0)))
    origin = to_plane(CIRCLE_ORIGIN_DEG, pose.origin_latitude_deg, pose.origin_longitude_deg)
    for receiver in machine.receiver:
        place = ALL.index(receiver.mount)
        for segment in out[-20:]:
            rows = segment.record.rows
            at = {kind: rows[(rows[:, 2] == kind) & (rows[:, 3] == place)] for kind in (NORTH, EAST)}
            for north, east in zip(at[NORTH], at[EAST], strict=True):
                t = (segment.record.t_ns - START_NS) * 1e-9 + north[0] * 0.02 + north[1] - mean
                true = circle.reported(receiver, t)
                apart = math.hypot(north[4] + origin[0] - true[0], east[4] + origin[1] - true[1])
                assert apart < 0.04  # 5 ms at 4.5 m/s and the cubic of the poses


# What must not be learned from.


def edited(changes: Mapping[int, Change]) -> tuple[RecordState, list[Segment]]:
    """Of a circle whose poses of these numbers are changed."""
    circle = Circle()
    state, out = record_builder.initial(circle.machine), []
    for number, (aligned, pose) in enumerate(posed(circle.machine, list(circle.measurements(12.0)))):
        change = changes.get(number)
        segment = record_builder.observe(state, aligned, change(pose) if change else pose)
        if segment is not None:
            out.append(segment)
    return state, out[:50]


def tractor(**changes: float | None) -> Change:
    return lambda pose: replace(pose, tractor=replace(pose.tractor, **changes))


REFUSED: list[tuple[Change, str]] = [
    (lambda p: replace(p, flags=(Flag.parse("swapped:tractor_front"),)), Code.RECEIVERS_MISPLACED),
    (lambda p: replace(p, flags=(Flag.parse("moved:implement_rear"),)), Code.RECEIVERS_MISPLACED),
    (lambda p: replace(p, flags=(Flag.parse("doubtful:implement_rear"),)), Code.RECEIVERS_MISPLACED),
    (lambda p: replace(p, flags=(Flag.parse("latency:implement_rear"),)), Code.RECEIVERS_MISPLACED),
    (lambda p: replace(p, flags=(Flag.parse("floating:tractor_rear"),)), Code.NO_RTK),
    (lambda p: replace(p, flags=(Flag.parse("no_rtk:tractor_rear"),)), Code.NO_RTK),
    (lambda p: replace(p, flags=(Flag.parse("no_fix:tractor_rear"),)), Code.NO_RTK),
    (lambda p: replace(p, flags=(Flag.parse("fix_unknown:tractor_rear"),)), Code.NO_RTK),
    (lambda p: replace(p, flags=(Flag.parse("no_roll:implement"),)), Code.NO_ROLL),
    (lambda p: replace(p, direction=-1), Code.REVERSE),
    (tractor(forward_velocity=0.9), Code.TOO_SLOW),
    (tractor(heading=None, sd_heading=None), Code.NO_HEADING),
    (tractor(sd_heading=math.radians(2.1)), Code.NO_HEADING),
    (lambda p: replace(p, implement=replace(p.implement, sd_heading=None)), Code.NO_HEADING),
    (tractor(forward_velocity=None), Code.POSE_INCOMPLETE),
    (tractor(yaw_rate=None), Code.POSE_INCOMPLETE),
    (lambda p: replace(p, articulation=math.radians(-63)), Code.BEYOND_ARTICULATION),
]


@pytest.mark.parametrize(("change", "reason"), REFUSED, ids=[f"{k}-{r[1]}" for k, r in enumerate(REFUSED)])
def test_a_refusal_holds_for_neighbouring_poses_and_two_seconds(change: Change, reason: Code) -> None:
    state, out = edited({30: change})
    expected_reasons = [Code.SETTLING] * 10 + [None] * 18 + [reason] * 3 + [Code.SETTLING] * 10
    assert [s.reason for s in out[:41]] == expected_reasons
    assert {s.reason for s in out[41:]} == {None}
    assert [s.follows for s in out[:12]] == [False] * 11 + [True]
    assert [s.follows for s in out[27:43]] == [True] + [False] * 14 + [True]
    assert state.refused == {Code.SETTLING: 20, reason: 3}


@pytest.mark.parametrize(
    "flags",
    [
        ("late:tractor_rear",),
        ("lost:implement_rear", "fix_unknown:implement_rear", "heading_by_hitch:implement"),
    ],
)
def test_a_receiver_that_is_late_or_lost_refuses_nothing(flags: tuple[str, ...]) -> None:
    _, out = edited({30: lambda p: replace(p, flags=known_flags(flags))})
    assert {s.reason for s in out[10:]} == {None}


def test_a_new_origin_and_a_gap_are_no_stretch() -> None:
    new_origin = {k: lambda p: replace(p, origin_latitude_deg=43.0) for k in range(30, 100)}
    _, out = edited(new_origin)
    assert Counter(s.reason for s in out[28:41]) == {Code.NEW_ORIGIN: 2, Code.SETTLING: 10, None: 1}
    circle = Circle()
    state, out = record_builder.initial(circle.machine), []
    for number, (aligned, pose) in enumerate(posed(circle.machine, list(circle.measurements(12.0)))):
        segment = None if 20 <= number < 25 else record_builder.observe(state, aligned, pose)
        if segment is not None:
            out.append(segment)
    assert [s.reason for s in out[18:31]] == [Code.POSE_GAP] * 2 + [Code.SETTLING] * 10 + [None]
    assert not any(len(s.record.ticks) for s in out[18:20])
    assert state.used.late == 0


def test_a_silent_wheel_sensor_and_a_large_wheel_angle() -> None:
    circle = Circle()
    for first, last, angle, reason in (
        (6.0, 6.12, None, None),
        (6.0, 6.4, None, Code.NO_WHEEL_ANGLE),
        (6.0, 6.4, 0.66, Code.BEYOND_WHEEL_ANGLE),
    ):
        received: list[Measurement] = []
        for m in circle.measurements(12.0):
            if isinstance(m, WheelAngle) and first <= (m.rx_ns - START_NS) * 1e-9 < last:
                if angle is None:
                    continue
                m = replace(m, angle=angle)
            received.append(m)
        state, out = record(circle.machine, received)
        assert set(state.refused) == {Code.SETTLING, *([reason] if reason else [])}
        if reason:
            shut = [(s.record.t_ns - START_NS) * 1e-9 for s in out if s.reason == reason]
            assert 5.7 < shut[0] < 6.01 and 6.1 < shut[-1] < 6.41


def test_a_receiver_without_a_fix_or_silent_gives_no_rows() -> None:
    circle = Circle(noise_m=0.005)
    received = [
        m
        for m in circle.measurements(20.0)
        if m.origin.mount is not ALL[3] or not 8.0 < (m.rx_ns - START_NS) * 1e-9 < 12.0
    ]
    _, out = record(circle.machine, received)
    times = instants(out, VELOCITY, 3)
    assert not ((times > 8.0) & (times < 11.8)).any()
    assert ((times > 12.2) & (times < 19.0)).sum() > 30
    # Until the receiver counts as lost its body's heading comes by the hitch: the rest goes on teaching.
    usable = [s for s in out if 9.2e9 < s.record.t_ns - START_NS < 11.5e9]
    assert usable and all(not s.reason for s in usable)
    assert all((s.record.rows[:, 3] != 3).all() and len(s.record.rows) for s in usable)


def test_a_repeating_receiver_gives_no_rows() -> None:
    _, out = edited(
        {k: lambda p: replace(p, flags=(Flag.parse("repeating:tractor_rear"),)) for k in range(30, 33)}
    )
    for number in (29, 30, 31, 32):
        rows = out[number].record.rows
        assert not ((rows[:, 3] == 1) & (rows[:, 2] != YAW_RATE)).any()
        assert ((rows[:, 3] == 0) & (rows[:, 2] == VELOCITY)).any()


def test_a_sample_that_comes_after_its_stretch_was_cut_is_dropped_and_counted_once() -> None:
    circle = Circle()
    state, out = record_builder.initial(circle.machine), []
    for number, (aligned, pose) in enumerate(posed(circle.machine, list(circle.measurements(12.0)))):
        if number == 30:  # its yaw rates of the last second come only now
            held = list(aligned.tracks["tractor_rear"].yaw_rates)[-8:]
            state.used.newest_ns[1][2] = held[0][0] - 1
        out.append(record_builder.observe(state, aligned, pose))
    assert 3 <= state.used.late <= 7
    assert len([s for s in out if s]) == len(out) - 2


def test_time_that_runs_back_starts_anew() -> None:
    circle = Circle()
    state, out = record(circle.machine, list(circle.measurements(6.0)))
    usable = state.segments
    for aligned, pose in posed(circle.machine, list(circle.measurements(6.0))):
        segment = record_builder.observe(state, aligned, pose)
        if segment is not None:
            out.append(segment)
    assert state.segments == 2 * usable and state.refused == {Code.SETTLING: 20} and state.used.late == 0


def test_a_stored_state_continues_exactly() -> None:
    circle = Circle(noise_m=0.01, jitter_s=0.01)
    state, other, same = record_builder.initial(circle.machine), None, 0
    for number, (aligned, pose) in enumerate(posed(circle.machine, list(circle.measurements(8.0)))):
        if number == 20:
            other = from_json_data(RecordState, json.loads(json.dumps(to_json_data(state))))
            assert to_json_data(other) == to_json_data(state)
        one = record_builder.observe(state, aligned, pose)
        if other is not None:
            two = record_builder.observe(other, aligned, pose)
            assert one is not None and two is not None
            assert one.record.rows.tobytes() == two.record.rows.tobytes()
            assert one.record.ticks.tobytes() == two.record.ticks.tobytes()
            assert (one.follows, one.reason) == (two.follows, two.reason)
            same += 1
    assert same > 10
