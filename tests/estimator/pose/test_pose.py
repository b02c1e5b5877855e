"""Poses against a rig whose motion is trigonometry: every receiver, every loss, every exchange."""

import math
from dataclasses import replace

import pytest
from circle import ORIGIN_DEG, START_NS, Circle, demo_machine

from tilth.estimator.pose import aligner
from tilth.estimator.pose.aligner import Aligner
from tilth.estimator.pose.geometry import to_plane
from tilth.estimator.pose.pose import poses
from tilth.estimator.pose.roll_pitch import roll_pitch_at
from tilth.estimator.rig.geometry import wrap
from tilth.schemas.flow import (
    Attitude,
    Fix,
    FixType,
    Flag,
    FlagKind,
    Measurement,
    Mount,
    Pose,
    Position,
    VehicleSpeed,
)

ALL = tuple(Mount)
LATE = {ALL[0]: 0.05, ALL[1]: 0.15, ALL[2]: 0.12, ALL[3]: 0.07}  # s; the machine file says 0.10 for each


def run(
    circle: Circle, seconds: float = 20.0, absent: frozenset[Mount] = frozenset()
) -> tuple[Aligner, list[Pose]]:
    state = aligner.initial(circle.machine)
    return state, feed(state, list(circle.measurements(seconds, absent)))


def feed(state: Aligner, measurements: list[Measurement]) -> list[Pose]:
    out: list[Pose] = []
    for measurement in measurements:
        aligner.take(state, measurement)
        out += poses(state, measurement.rx_ns)
    return out


def errors(circle: Circle, pose: Pose, body: int, late_s: float = 0.0) -> tuple[float, float]:
    """(distance of the CG, heading error) from the truth, m and rad."""
    t = (pose.t_ns - START_NS) * 1e-9 - late_s
    north, east = to_plane(ORIGIN_DEG, pose.origin_latitude_deg, pose.origin_longitude_deg)
    one = (pose.tractor, pose.implement)[body]
    assert one.x is not None and one.y is not None and one.heading is not None
    true = circle.cg(t, body)
    return math.hypot(one.x + north - true[0], one.y + east - true[1]), wrap(
        one.heading - circle.heading(t, body)
    )


@pytest.mark.parametrize(
    "circle",
    [
        Circle(),
        Circle(yaw_rate=-0.2, articulation=-0.19, lateral_velocity=-0.1),
        Circle(yaw_rate=0.0, articulation=0.0, lateral_velocity=0.0),
        Circle(roll=0.05),
        Circle(roll=-0.08, yaw_rate=0.0, articulation=0.0),
        Circle(period_s={ALL[2]: 0.1, ALL[3]: 0.1}),
    ],
    ids=["right", "left", "straight", "slope", "slope_straight", "10_and_5_hz"],
)
def test_poses_without_noise_are_exact(circle: Circle) -> None:
    _, out = run(circle)
    assert len(out) >= 90
    for pose in out[10:]:
        for body in (0, 1):
            distance, heading = errors(circle, pose, body)
            assert distance < 0.004
            assert abs(heading) < 5e-4
        assert pose.articulation is not None
        assert abs(pose.articulation - circle.articulation) < 5e-4
        assert pose.tractor.forward_velocity == pytest.approx(circle.speed, abs=2e-3)
        assert pose.tractor.lateral_velocity == pytest.approx(circle.lateral_velocity, abs=5e-3)
        assert pose.tractor.yaw_rate == pytest.approx(circle.yaw_rate, abs=1e-6)
        assert pose.wheel_angle == pytest.approx(0.1)
        assert pose.direction == 1
        assert pose.flags == ()


def test_antenna_and_ground_reporting_receivers_mix_on_a_slope() -> None:
    """The packaged rig's tractor reports ground points, its implement antennas; a wrong setting shows."""
    circle = Circle(roll=0.087, yaw_rate=0.0, articulation=0.0, lateral_velocity=0.0)
    _, out = run(circle)
    assert errors(circle, out[-1], 0)[0] < 0.004
    wrong = demo_machine(**{"roll_corrected = true\n": "roll_corrected = false\n"})
    state = aligner.initial(wrong)
    (*_, pose) = feed(state, list(circle.measurements(20.0)))
    assert errors(circle, pose, 0)[0] == pytest.approx(2.9 * math.sin(0.087), abs=0.01)


def test_a_receiver_at_1_hz_is_extrapolated_and_flagged_late() -> None:
    circle = Circle(period_s={ALL[1]: 1.0})
    _, out = run(circle)
    assert any(Flag.parse("late:tractor_rear") in pose.flags for pose in out)
    for pose in out[10:]:
        if pose.tractor.x is not None:
            assert errors(circle, pose, 0)[0] < 0.05


def test_differences_of_latency_are_found_from_the_rigid_bodies() -> None:
    circle = Circle(latency_s=LATE)
    state, out = run(circle)
    mean = sum(LATE.values()) / 4 - 0.10
    for index, mount in enumerate(ALL):
        assert state.latency.tau[index] == pytest.approx(LATE[mount] - 0.10 - mean, abs=5e-3)
    distance, heading = errors(circle, out[-1], 0, late_s=mean)
    assert distance < 0.03
    assert abs(heading) < 1e-3
    assert out[-1].articulation == pytest.approx(circle.articulation, abs=1e-3)
    stubborn = aligner.initial(circle.machine)
    stubborn.latency.covariance[:] = 0.0
    by_nominal = feed(stubborn, list(circle.measurements(20.0)))[20]
    not_looking = errors(circle, by_nominal, 0, late_s=mean)[1]
    assert abs(not_looking) > max(2e-3, 3 * abs(heading))


def test_a_common_latency_is_not_observable_and_stays_in_the_sd() -> None:
    _, out = run(Circle(latency_s={m: 0.15 for m in ALL}))
    assert out[-1].tractor.sd_position is not None
    assert out[-1].sd_time == pytest.approx(0.05 * math.sqrt((1 + 3 * 0.5) / 4), abs=0.003)
    assert out[-1].tractor.sd_position > 4.5 * out[-1].sd_time


def test_published_sd_covers_the_noise() -> None:
    inside = total = 0
    for seed in range(4):
        circle = Circle(noise_m=0.025, jitter_s=0.02, seed=seed)
        _, out = run(circle)
        for pose in out[20:]:
            for body, one in enumerate((pose.tractor, pose.implement)):
                assert one.sd_heading is not None
                inside += abs(errors(circle, pose, body)[1]) < 1.96 * one.sd_heading
                total += 1
    assert 0.93 <= inside / total <= 1.0


@pytest.mark.parametrize(
    ("absent", "given", "flags"),
    [
        ({ALL[3]}, "both", {"waiting:implement_rear", "heading_by_hitch:implement"}),
        ({ALL[2]}, "both", {"waiting:implement_front", "heading_by_hitch:implement"}),
        ({ALL[0]}, "both", {"waiting:tractor_front", "heading_by_hitch:tractor"}),
        ({ALL[1]}, "both", {"waiting:tractor_rear", "heading_by_hitch:tractor"}),
        ({ALL[2], ALL[3]}, "tractor", {"missing:implement"}),
        ({ALL[0], ALL[1]}, "implement", {"missing:tractor"}),
        ({ALL[0], ALL[2]}, "neither", {"no_heading:tractor", "no_heading:implement"}),
    ],
)
def test_what_can_still_be_given_is_given(absent: set[Mount], given: str, flags: set[str]) -> None:
    circle = Circle()
    _, out = run(circle, absent=frozenset(absent))
    pose = out[-1]
    assert flags <= set(map(str, pose.flags))
    for body, name in enumerate(("tractor", "implement")):
        if given in (name, "both"):
            distance, heading = errors(circle, pose, body)
            assert distance < 0.02
            assert abs(heading) < 5e-3
        else:
            assert (pose.tractor, pose.implement)[body].heading is None
    assert (pose.articulation is not None) == (given == "both")
    assert pose.receivers == 4 - len(absent)


def test_a_receiver_that_falls_silent_is_late_then_lost_and_back_again() -> None:
    circle = Circle()
    gone = (START_NS + 8 * 10**9, START_NS + 12 * 10**9)
    measurements = [
        m
        for m in circle.measurements(20.0)
        if m.origin.mount is not ALL[1] or not gone[0] < m.rx_ns < gone[1]
    ]
    out = feed(aligner.initial(circle.machine), measurements)
    flags = {round((p.t_ns - START_NS) * 1e-9, 1): set(map(str, p.flags)) for p in out}
    assert flags[7.6] == set()
    assert "late:tractor_rear" in flags[8.2]
    assert {"lost:tractor_rear", "heading_by_hitch:tractor"} <= flags[9.6]
    assert flags[13.0] == set()


@pytest.mark.parametrize(
    "pair",
    [(ALL[0], ALL[1]), (ALL[2], ALL[3]), (ALL[0], ALL[2]), (ALL[1], ALL[3]), (ALL[0], ALL[3])],
    ids=lambda p: f"{p[0]}-{p[1]}",
)
@pytest.mark.parametrize("circle", [Circle(), Circle(yaw_rate=0.0, articulation=0.0, lateral_velocity=0.0)])
def test_two_swapped_receivers_are_named_and_withheld(pair: tuple[Mount, Mount], circle: Circle) -> None:
    other = {pair[0]: pair[1], pair[1]: pair[0]}
    measurements = [
        replace(m, origin=replace(m.origin, mount=other.get(m.origin.mount, m.origin.mount)))
        if m.origin.mount is not None
        else m
        for m in circle.measurements(10.0)
    ]
    pose = feed(aligner.initial(circle.machine), measurements)[-1]
    assert {Flag(FlagKind.SWAPPED, m.value) for m in pair} <= set(pose.flags)
    for mount in pair:
        body = pose.tractor if mount.value.startswith("tractor") else pose.implement
        assert body.heading is None


def test_a_receiver_that_was_moved_is_flagged_and_withheld() -> None:
    circle = Circle()
    elsewhere = demo_machine(**{"position = [1.60, 0.0, 2.9]": "position = [3.60, 1.0, 2.9]"})
    pose = feed(aligner.initial(elsewhere), list(circle.measurements(10.0)))[-1]
    assert Flag.parse("moved:tractor_front") in pose.flags
    assert pose.tractor.heading is None or Flag.parse("heading_by_hitch:tractor") in pose.flags


@pytest.mark.parametrize(
    ("fix", "flag"),
    [(FixType.RTK_FLOAT, "floating"), (FixType.DGNSS, "no_rtk"), (FixType.NONE, "no_fix")],
)
def test_a_worse_fix_is_flagged_and_widens_the_sd(fix: FixType, flag: str) -> None:
    _, good = run(Circle(), 6.0)
    _, out = run(Circle(fix=fix), 6.0)
    assert Flag.parse(f"{flag}:tractor_front") in out[-1].flags
    sd = out[-1].tractor.sd_position
    assert sd is None or (good[-1].tractor.sd_position or 0) < sd
    assert (sd is None) == (fix is FixType.NONE)


def test_repeated_positions_are_no_news_while_moving_and_hold_at_standstill() -> None:
    for speed, flag in ((4.5, "repeating:tractor_front"), (0.0, "")):
        circle = Circle(speed=speed, yaw_rate=0.0, lateral_velocity=0.0, articulation=0.0)
        state = aligner.initial(circle.machine)
        old: Position | None = None
        measurements: list[Measurement] = []
        for m in circle.measurements(8.0):
            if isinstance(m, Position) and m.origin.mount is ALL[0] and m.rx_ns > START_NS + 4 * 10**9:
                assert old is not None
                m = replace(m, latitude_deg=old.latitude_deg, longitude_deg=old.longitude_deg, repeat=True)
            elif isinstance(m, Position) and m.origin.mount is ALL[0]:
                old = m
            measurements.append(m)
        pose = feed(state, measurements)[-1]
        assert (Flag.parse(flag) in pose.flags) if flag else pose.flags == ()


def test_a_receiver_that_is_left_out_leans_no_body() -> None:
    """A branch has tilted it; the other on the body tells its roll."""
    circle = Circle()
    state = aligner.initial(demo_machine())
    for measurement in circle.measurements(4.0):
        if isinstance(measurement, Attitude) and measurement.origin.mount is Mount.TRACTOR_REAR:
            measurement = replace(measurement, roll=math.radians(5.0), pitch=math.radians(5.0))
        aligner.take(state, measurement)
    t_ns = START_NS + 3_000_000_000
    tilted = roll_pitch_at(state, 0, t_ns)
    aligner.leave_out(state, {Mount.TRACTOR_REAR.value})
    told = roll_pitch_at(state, 0, t_ns)
    assert abs(told.roll) < math.radians(0.5) < abs(tilted.roll - told.roll)


def test_a_long_slow_bend_is_no_pair_that_points_aside() -> None:
    """The axle goes where the body points; the CG, well ahead of it, goes outwards by the yaw rate."""
    machine = demo_machine(**{"b = 1.2\n": "b = 2.5\n"})
    circle = Circle(machine, speed=1.55, yaw_rate=0.049, lateral_velocity=0.049 * 2.5, articulation=0.105)
    state, out = run(circle, 30.0)
    assert abs(state.long_term.crab_angle[0].value) < 0.005
    assert not any(flag.kind in {FlagKind.MOVED, FlagKind.DOUBTFUL} for pose in out for flag in pose.flags)


def test_standstill_and_reverse_are_recognised() -> None:
    still = Circle(speed=0.0, yaw_rate=0.0, lateral_velocity=0.0, articulation=0.0)
    assert run(still, 5.0)[1][-1].direction == 0
    back = Circle(speed=-1.5, yaw_rate=0.02, articulation=0.0, lateral_velocity=0.0)
    assert run(back, 5.0)[1][-1].direction == -1


@pytest.mark.parametrize("sideways", [0.3, 0.5, 0.8, 1.2, 2.0])
@pytest.mark.parametrize(
    ("body", "lever"), [("tractor", "[1.60, 0.0, 2.9]"), ("implement", "[1.30, 0.0, 3.1]")]
)
def test_an_antenna_moved_sideways_is_found_on_straight_driving(
    sideways: float, body: str, lever: str
) -> None:
    circle = Circle(yaw_rate=0.0, lateral_velocity=0.0, articulation=0.0, noise_m=0.01)
    wrong_machine = demo_machine(
        **{f"position = {lever}": f"position = {lever.replace('0.0', f'{sideways}', 1)}"}
    )
    out = feed(aligner.initial(wrong_machine), list(circle.measurements(30.0)))
    assert Flag.parse(f"moved:{body}_front") in out[-1].flags
    assert (out[-1].tractor if body == "tractor" else out[-1].implement).heading is None


@pytest.mark.parametrize(
    "circle", [Circle(noise_m=0.02), Circle(yaw_rate=0.0, noise_m=0.02, articulation=0.0)]
)
def test_a_rig_as_surveyed_raises_no_doubt_in_a_minute(circle: Circle) -> None:
    _, out = run(circle, 60.0)
    assert {flag for pose in out[10:] for flag in pose.flags} == set()


def test_a_latency_that_no_receiver_has_is_flagged() -> None:
    _, out = run(Circle(latency_s={ALL[0]: 0.32}), 30.0)
    assert out[-1].flags and {flag.kind for flag in out[-1].flags} <= {
        FlagKind.LATENCY,
        FlagKind.MOVED,
        FlagKind.DOUBTFUL,
    }


@pytest.mark.parametrize("pair", [(ALL[0], ALL[1]), (ALL[2], ALL[3])], ids=lambda p: str(p[0]))
def test_a_swapped_pair_is_found_with_one_receiver_of_the_other_body(pair: tuple[Mount, Mount]) -> None:
    circle = Circle()
    gone = ALL[3] if pair[0] is ALL[0] else ALL[1]
    other = {pair[0]: pair[1], pair[1]: pair[0]}
    measurements = [
        replace(m, origin=replace(m.origin, mount=other.get(m.origin.mount, m.origin.mount)))
        if m.origin.mount is not None
        else m
        for m in circle.measurements(10.0, frozenset({gone}))
    ]
    pose = feed(aligner.initial(circle.machine), measurements)[-1]
    assert any(flag.kind is FlagKind.SWAPPED for flag in pose.flags)


def test_a_tractor_that_seems_to_go_backwards_while_it_says_forward_is_doubted() -> None:
    circle = Circle()
    other = {ALL[0]: ALL[1], ALL[1]: ALL[0]}
    measurements: list[Measurement] = []
    for m in circle.measurements(10.0, frozenset({ALL[2], ALL[3]})):
        mount = m.origin.mount
        measurements.append(m if mount is None else replace(m, origin=replace(m.origin, mount=other[mount])))
        measurements.append(
            VehicleSpeed(m.t_ns, m.rx_ns, replace(m.origin, mount=None), 65096, None, 4.5, "forward")
        )
    pose = feed(aligner.initial(circle.machine), measurements)[-1]
    assert Flag.parse("moved:tractor_front") in pose.flags
    assert pose.tractor.heading is None


def test_one_wild_first_position_does_not_become_the_origin() -> None:
    circle = Circle()
    measurements = list(circle.measurements(10.0))
    first = next(i for i, m in enumerate(measurements) if isinstance(m, Position))
    wild = replace(measurements[first], latitude_deg=0.0, longitude_deg=0.0)  # type: ignore[call-arg]
    out = feed(aligner.initial(circle.machine), [*measurements[:first], wild, *measurements[first:]])
    assert out[-1].flags == ()
    assert abs(out[-1].origin_latitude_deg - ORIGIN_DEG[0]) < 0.01


def test_an_old_fix_counts_as_unknown() -> None:
    circle = Circle()
    measurements = [
        m for m in circle.measurements(20.0) if not isinstance(m, Fix) or m.rx_ns < START_NS + 5 * 10**9
    ]
    out = feed(aligner.initial(circle.machine), measurements)
    assert Flag.parse("fix_unknown:tractor_front") in out[-1].flags
    assert not any(flag.kind is FlagKind.FIX_UNKNOWN for flag in out[20].flags)


def test_receivers_abreast_give_a_heading_too() -> None:
    machine = demo_machine(
        **{
            "position = [1.60, 0.0, 2.9]": "position = [0.3, -1.0, 2.9]",
            "position = [-1.10, 0.0, 2.9]": "position = [0.3, 1.0, 2.9]",
        }
    )
    circle = Circle(machine=machine)
    _, out = run(circle)
    distance, heading = errors(circle, out[-1], 0)
    assert distance < 0.01 and abs(heading) < 1e-3
    assert out[-1].tractor.sd_position is not None


def test_the_origin_moves_along_on_a_long_way() -> None:
    circle = Circle(yaw_rate=0.0, articulation=0.0, lateral_velocity=0.0, speed=300.0)
    _, out = run(circle, 30.0)
    assert max(math.hypot(p.tractor.x or 0.0, p.tractor.y or 0.0) for p in out) < 5_500.0
    assert len({p.origin_latitude_deg for p in out}) == 2
