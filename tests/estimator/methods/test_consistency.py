"""A machine file that the data contradict gives no number, and says which key to look at."""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import wrong_files
from circle import demo_machine
from estimation_study import STEPS

from tilth.estimator import fold
from tilth.estimator.filters import unknowns
from tilth.estimator.methods import consistency, open_tracker
from tilth.estimator.methods.consistency import CONTRADICTION, Finding
from tilth.estimator.methods.findings import KEYS
from tilth.estimator.methods.tracker import TrackerState
from tilth.estimator.models.parameters import rig_of, static_loads
from tilth.estimator.pose import motion_check, wheel_check
from tilth.estimator.pose.motion_check import MotionCheck
from tilth.estimator.pose.wheel_check import WheelCheck
from tilth.schemas.decode import Decoder
from tilth.schemas.flow import (
    Attitude,
    BodyPose,
    Estimate,
    Event,
    Frame,
    Measurement,
    Mount,
    ParameterEstimate,
    Pose,
    Publication,
    Status,
    Velocity,
)
from tilth.schemas.machine import Machine
from tilth.schemas.machine_toml import parse_machine
from tilth.schemas.plausible import COEFFICIENT
from tilth.simulator.scenario import Fault, Ground, Scenario
from tilth.simulator.tractor import draw
from tilth.simulator.traffic import simulate

SECONDS = 55.0
RANDOM = replace(wrong_files.DRIVES["random"], speed=4.5, seconds=SECONDS)
LONG = replace(RANDOM, seconds=200.0)
THREE_STEPS = replace(STEPS.scenario, ground=Ground())


def run(machine: Machine, frames: list[Frame]) -> tuple[fold.State, list[Publication]]:
    """Through the fold; no fit is ever ready."""
    state, out = fold.initial(machine), list[Publication]()
    for frame in frames:
        for method, _, _ in fold.pending(state):
            out += fold.adopt(state, frame.t_ns, method, None)
        out += fold.step(state, frame)
        fold.request_fits(state, frame.t_ns)
    return state, out


@cache
def frames(scenario: Scenario = RANDOM) -> list[Frame]:
    return list(simulate(demo_machine(), 2, scenario.seconds, scenario))


class Changed(Decoder):
    """A decoder whose measurements are changed: receivers that go wrong."""

    def __init__(self, machine: Machine, change: Callable[[Measurement], Measurement]) -> None:
        super().__init__(machine)
        self._change = change

    def measurements(self, frame: Frame) -> list[Measurement]:
        return [self._change(one) for one in super().measurements(frame)]


def given(out: list[Publication]) -> Iterator[tuple[int, Estimate]]:
    """(t_ns, estimate) wherever a number is usable."""
    for publication in out:
        value = publication.value
        if isinstance(value, Estimate) and any(p.status is Status.ESTIMATED for p in value.parameters):
            yield publication.t_ns, value


def contradictions(out: list[Publication]) -> list[str]:
    return [p.value.text for p in out if isinstance(p.value, Event) and p.value.kind == CONTRADICTION]


def test_a_right_file_is_confirmed_and_raises_nothing() -> None:
    state, out = run(demo_machine(), frames())
    assert state.consistency.confirmed and contradictions(out) == []
    truth = draw(demo_machine(), 2, RANDOM)
    last = state.estimates["recommended"]
    assert sum(p.status is Status.ESTIMATED for p in last.parameters) >= 5
    for p, name in zip(last.parameters, truth, strict=False):
        if p.value and p.sd:
            assert abs(math.log(p.value / truth[name])) < 3.5 * p.sd / p.value, name


def test_long_circles_do_not_make_a_right_file_look_wrong() -> None:
    """Three steps of 30 s, as the dissertation ran them: for most of them the wheels are held."""
    heard = list(simulate(demo_machine(), 2, THREE_STEPS.seconds, THREE_STEPS))
    state, out = run(demo_machine(), heard)
    assert state.consistency.confirmed and contradictions(out) == []
    assert state.consistency.open.refused["wheels held at one angle"] > 300
    misfit = open_tracker.misfit(state.consistency.open, demo_machine())
    assert misfit.by_name.max() < 6.0 and misfit.total < 15.0  # 12 and 30 where it learned all the time
    first, *_, last = (t_ns for t_ns, _ in given(out))
    assert first < heard[0].t_ns + 60e9 and last > heard[-1].t_ns - 2e9


def test_long_driving_on_uneven_ground_does_not_make_a_right_file_look_wrong() -> None:
    state, out = run(demo_machine(), frames(LONG))
    assert state.consistency.confirmed and contradictions(out) == []
    misfit = open_tracker.misfit(state.consistency.open, demo_machine())
    assert misfit.by_name.max() < 8.0 and misfit.total < 20.0  # else 188 and 371
    assert list(given(out))[-1][0] > frames(LONG)[-1].t_ns - 2e9


def test_no_number_before_a_gross_error_would_have_shown() -> None:
    state, out = run(demo_machine(), frames()[: len(frames()) // 8])
    assert not state.consistency.confirmed and not list(given(out))
    reasons = {e.value.parameters[0].reason for e in out if isinstance(e.value, Estimate)}
    assert any("steer" in reason or "yet" in reason for reason in reasons)


WRONG = {
    "an antenna 0.8 m aside": ("receiver.0.position.1", 0.8, "position"),
    "two antennas of a pair exchanged": ("receiver.0.name <> receiver.1.name", None, "another's place"),
    "one antenna of each body exchanged": ("receiver.1.name <> receiver.2.name", None, "another's place"),
    "the wheels' sign": ("wheel_angle.sign x -1", None, "wheel_angle.sign"),
    "twice the wheels' scale": ("wheel_angle.scale x 2", None, "wheel_angle.scale"),
    "half the wheelbase in front": ("tractor.a x 0.5", None, "tractor.a"),
    "the rear axle": ("tractor.b + 1 m", None, "tractor.b"),
    "the drawbar": ("implement.d x 0.5", None, "lengths to the hitch"),
    "the implement's axle": ("implement.e + 1 m", None, "implement.e"),
    "yaw inertia": ("tractor.yaw_inertia x 2", None, "yaw_inertia"),
}
"""What is wrong: (change of wrong_files, or path and m), a part of the reason. A sample of the bench."""


@pytest.mark.parametrize("wrong", WRONG)
def test_a_wrong_file_gives_no_number_and_names_the_key(wrong: str) -> None:
    name, metres, part = WRONG[wrong]
    raw = wrong_files.packaged()
    if metres is not None:
        raw["receiver"][0]["position"][1] += metres
    else:
        next(c for c in wrong_files.changes() if c.name == name).apply(raw)
    state, out = run(parse_machine(wrong_files.text_of(raw)), frames())
    assert any(part in text for text in contradictions(out)), contradictions(out)
    assert not list(given(out))
    for estimate in state.estimates.values():
        assert all(p.status is Status.INVALID and p.value is None for p in estimate.parameters)
        assert part in estimate.parameters[0].reason
    poses = [p.value for p in out if isinstance(p.value, Pose)]
    assert any(flag.kind is CONTRADICTION for flag in poses[-1].flags)


def test_numbers_come_back_when_the_contradiction_is_gone() -> None:
    moved_receiver = Fault(Mount.TRACTOR_FRONT, 45.0, 75.0, "moved")
    scenario = replace(RANDOM, seconds=115.0, faults=(moved_receiver,))
    _, out = run(demo_machine(), frames(scenario))
    start_ns = frames(scenario)[0].t_ns
    events_text = contradictions(out)
    assert "tractor" in events_text[0] and "over" in events_text[-1], events_text
    times = [(t_ns - start_ns) * 1e-9 for t_ns, e in given(out) if e.method == "recommended"]
    assert any(t < 45.0 for t in times)
    assert not any(62.0 < t < 75.0 for t in times)
    assert any(t > 100.0 for t in times)


# One check at a time.


def pose_of(u: float, r: float, wheel: float | None) -> Pose:
    body = BodyPose(0.0, 0.0, 0.02, 0.0, 0.003, u, 0.0, 0.03, 0.03, r, 0.005, 0.0, 0.01)
    return Pose(0, 43.5, -83.4, body, body, 0.0, 0.004, wheel, 0.002, 1, None, 0.01, 4, ())


@pytest.mark.parametrize(
    ("factor", "key"),
    [
        (1.0, ""), (0.5, ""), (2.0, ""), (-1.0, "wheel_angle.sign"), (-0.5, "wheel_angle.sign"),
        (4.0, "wheel_angle.scale"), (57.3, "wheel_angle.scale"), (0.3, "wheel_angle.scale"),
        (1 / 57.3, "wheel_angle.scale"), (0.0, "wheel_angle.scale"),
    ],
)  # fmt: skip
def test_wheel_angle_against_yaw_rate(factor: float, key: str) -> None:
    machine, state = demo_machine(), WheelCheck()
    rng = np.random.default_rng(1)
    for k in range(150):
        r = 0.2 * math.sin(0.2 * k)
        angle = factor * math.atan(2.9 * r / 4.0) + rng.normal(0.0, 0.002)
        wheel_check.observe(state, machine, pose_of(4.0, r, angle))
    assert wheel_check.verdict(state)[0] == key
    assert ("radians" in wheel_check.verdict(state)[1]) == (factor in (57.3, 1 / 57.3))


@pytest.mark.parametrize("lag_s", [0.0, 0.15, 0.3])
def test_a_chirp_in_which_the_yaw_rate_lags_accuses_nobody(lag_s: float) -> None:
    """From 0.1 to 1.2 Hz in 40 s, as drivers are asked for."""
    machine, state = demo_machine(), WheelCheck()
    rng = np.random.default_rng(3)

    def angle(t: float) -> float:
        return 0.09 * math.sin(2 * math.pi * (0.1 + 1.1 * t / 80.0) * t)

    for k in range(200):
        t = 0.2 * k
        rate = 4.0 * math.tan(angle(max(t - lag_s, 0.0))) / 2.9 + rng.normal(0.0, 0.002)
        wheel_check.observe(state, machine, pose_of(4.0, rate, angle(t)))
        assert wheel_check.verdict(state) == ("", "")


def test_the_wheels_say_nothing_on_straight_rows_at_standstill_and_in_reverse() -> None:
    machine, state = demo_machine(), WheelCheck()
    for u, r, wheel in ((4.0, 0.001, -0.001), (0.2, 0.2, -0.3), (-2.0, 0.2, 0.3), (4.0, 0.1, None)):
        for _ in range(100):
            wheel_check.observe(state, machine, pose_of(u, r, wheel))
    assert wheel_check.verdict(state) == ("", "")


def on_a_slope(speed: float = 1.0, gradient: float = 0.013, lean_i: float = 0.05) -> Iterator[Pose]:
    """Two minutes of turns at 4 m/s: the way over the speed, roll per m/s^2, the implement's roll."""
    rng = np.random.default_rng(2)
    x = y = psi = 0.0
    for k in range(600):
        r = 0.35 * math.sin(0.05 * k)
        psi += 0.2 * r
        x, y = x + 0.2 * 4.0 * speed * math.cos(psi), y + 0.2 * 4.0 * speed * math.sin(psi)
        pose = pose_of(4.0, r, None)
        tractor = replace(
            pose.tractor, x=x + rng.normal(0.0, 0.02), y=y + rng.normal(0.0, 0.02), heading=psi,
            roll=0.05 + gradient * 4.0 * r + rng.normal(0.0, 0.01),
        )  # fmt: skip
        implement = replace(tractor, roll=lean_i + rng.normal(0.0, 0.01))
        yield replace(pose, t_ns=k * motion_check.STEP_NS, tractor=tractor, implement=implement)


@pytest.mark.parametrize(
    ("wrong", "texts"),
    [
        ({}, ()), ({"speed": 1.06}, ()), ({"speed": 1.3}, ("1.30 times as far",) * 2),
        ({"speed": 0.5}, ("0.50 times as far",) * 2), ({"gradient": 0.03}, ()),
        ({"gradient": 0.1}, ("roll follows its turns",)), ({"gradient": -0.1}, ("as no vehicle leans",)),
        ({"lean_i": 0.15}, ()), ({"lean_i": -0.2}, ("lean apart by +14°",)),
    ],
)  # fmt: skip
def test_ways_and_speeds_rolls_and_turns(wrong: dict[str, float], texts: tuple[str, ...]) -> None:
    state = MotionCheck()
    for pose in on_a_slope(**wrong):
        motion_check.observe(state, pose)
    found = list(motion_check.found(state).values())
    assert len(found) == len(texts)
    assert all(part in text for part, text in zip(texts, found, strict=True)), found


@pytest.mark.parametrize("slope_deg", [3.0, -5.0])
def test_a_slope_that_is_turned_round_on_is_no_lean(slope_deg: float) -> None:
    """Straight up a field and back: only the turn goes across the slope, and only it has side force."""
    state, psi = MotionCheck(), 0.0
    for k in range(225):
        r = math.pi / 12.0 if 125 <= k < 185 else 0.0  # 180 degrees in 12 s
        psi += 0.2 * r
        pose = pose_of(2.5, r, None)
        roll = math.radians(slope_deg) * math.sin(psi)
        bodies = (replace(body, heading=psi, roll=roll) for body in (pose.tractor, pose.implement))
        tractor, implement = bodies
        pose = replace(pose, t_ns=k * motion_check.STEP_NS, tractor=tractor, implement=implement)
        motion_check.observe(state, pose)
        assert not any("follows its turns" in text for text in motion_check.found(state).values())


def wrongly(what: str) -> Callable[[Measurement], Measurement]:
    def change(one: Measurement) -> Measurement:
        on_tractor = one.origin.mount in (Mount.TRACTOR_FRONT, Mount.TRACTOR_REAR)
        if what == "speed" and isinstance(one, Velocity) and on_tractor:
            return replace(one, speed=1.3 * one.speed)
        if what == "roll" and isinstance(one, Attitude) and one.roll is not None and on_tractor:
            return replace(one, roll=one.roll + math.radians(14.0))
        return one

    return change


@pytest.mark.parametrize(("what", "texts"), [("speed", "receivers' speed"), ("roll", "lean apart")])
def test_a_receiver_that_contradicts_itself_gives_no_number(what: str, texts: str) -> None:
    state = fold.initial(demo_machine())
    state.decoder = Changed(demo_machine(), wrongly(what))
    out = [p for frame in frames() for p in fold.step(state, frame)]
    assert any(texts in text for text in contradictions(out)), contradictions(out)
    assert not list(given(out))


def estimate_of(values: tuple[float, ...]) -> Estimate:
    rows = tuple(ParameterEstimate(v, 0.1 * v, Status.ESTIMATED, "") for v in values)
    return Estimate(0, "pem", "relaxation", rows, (0.0,) * 36, (None,) * 3)


@pytest.mark.parametrize("coefficient", [0.01, 0.29, 0.31, 5.0, 39.0, 41.0, 1000.0])
def test_a_stiffness_that_no_tyre_has_is_not_given(coefficient: float) -> None:
    machine = demo_machine()
    state = consistency.initial(machine)
    state.confirmed = True
    loads = static_loads(rig_of(machine))
    fine = [5.0 * load for load in loads]
    given = estimate_of((*fine[:2], coefficient * loads[2], 1.0, 1.0, 1.0))
    consistency.check_estimate(state, machine, given)
    checked = consistency.withheld(state, given)
    is_tyre = COEFFICIENT[0] < coefficient < COEFFICIENT[1]
    assert all((p.value is not None) == is_tyre for p in checked.parameters)
    assert is_tyre or "no tyre" in checked.parameters[0].reason


@pytest.mark.parametrize(
    ("key", "known"),
    [
        ("receiver.position on the tractor", True),  # by standing, before the watch knows which one
        ("receiver.tractor_front.position", True),
        ("receiver.tractor_front.roll_corrected", False),
        ("wheel_angle.scale or gain", False),
    ],
)
def test_a_receiver_that_is_left_out_takes_along_what_was_found_of_its_place(key: str, known: bool) -> None:
    machine = demo_machine()
    state = consistency.initial(machine)
    state.was_confirmed = True
    state.findings[key] = Finding(key, f"{key}?", active=True)
    consistency.left_out(state, machine)
    assert (state.confirmed, state.pairs_known) == (known, known)
    assert not known or consistency.contradicted(state) == ""


@pytest.mark.parametrize(
    ("name", "off", "words"),
    [
        ("I_t", math.log(0.5), "tractor.yaw_inertia 0.48 to 0.52 times what the file says"),
        ("wheel_gain", math.log(2.0), "reading of the wheels' angle 1.92 to 2.08 times"),
        ("wheel_zero", math.radians(30.0), "the wheels' zero off by 30.0 ±"),
        ("latency", 0.9, "a latency of 0.900 ± 0.039 s (95 %) beyond"),
        ("e", -3.0, "the implement's axle off by -3.000 ± 0.039 m"),
    ],
)
def test_a_method_that_leaves_the_file_says_how_far_in_people_s_units(
    name: str, off: float, words: str
) -> None:
    machine = demo_machine()
    state = consistency.initial(machine)
    loads = static_loads(rig_of(machine))
    given = estimate_of((*(5.0 * load for load in loads), 1.0, 1.0, 1.0))
    consistency.check_estimate(state, machine, replace(given, nuisances={name: (off, 0.02)}))
    (text,) = state.methods["pem"].values()
    assert f"pem finds {words}" in text and text.endswith(f"{KEYS[name]}?")


@pytest.mark.parametrize("name", open_tracker.GROSS)
@pytest.mark.parametrize(("sds_off", "sds_to_gross", "known"), [(0.0, 2.5, True), (0.0, 2.2, False),
    (1.0, 3.4, True), (1.0, 3.2, False), (3.0, 5.0, False)])  # fmt: skip
def test_a_file_is_confirmed_when_its_gross_errors_can_be_ruled_out(
    name: str, sds_off: float, sds_to_gross: float, known: bool
) -> None:
    machine, n = demo_machine(), len(open_tracker.NAMES)
    size = math.log1p(1.0 / machine.tractor.a.value) if name == "a" else math.log(2.0)
    k, alone, by_name = open_tracker.NAMES.index(name), np.full(n, 0.01), np.zeros(n)
    alone[k], by_name[k] = size / sds_to_gross, sds_off**2
    now = open_tracker.Misfit(0.0, by_name, np.zeros(n), np.full(n, 0.01), alone)
    assert open_tracker.unconfirmed(now, machine) == ([] if known else [name])


def test_a_mass_that_only_small_forces_tell_is_no_doubt() -> None:
    """As it came out in fields with headland turns, with right files. Five times the mass would be one."""
    machine = demo_machine()
    state = open_tracker.initial(machine)
    m_i = unknowns.AT["m_i"]
    state.covariance[m_i, m_i] = 0.22**2
    for off, doubted in ((-0.9, False), (math.log(0.2), True)):
        state.mean[m_i] = state.prior_mean[m_i] + off
        now = open_tracker.misfit(state, machine)
        assert (now.by_name.max() > consistency.ENDS * consistency.BEGINS) == doubted
    assert not state.by_steering


def test_open_tracker_starts_at_the_file_with_wide_priors() -> None:
    machine = demo_machine()
    state = open_tracker.initial(machine)
    now = open_tracker.misfit(state, machine)
    assert now.total == 0.0 and not now.by_name.any()
    assert set(open_tracker.unconfirmed(now, machine)) == set(open_tracker.CONFIRMING_SD)
    narrow = open_tracker.allowed(machine) < 0.5 * np.array(list(open_tracker.OPEN_SD.values()))
    assert [name for name, so in zip(open_tracker.NAMES, narrow, strict=True) if not so] == ["m_i"]


@pytest.mark.parametrize("uneven", [0.005, 0.012])
def test_on_rough_ground_what_the_open_tracker_finds_accuses_no_file(
    uneven: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """There it may have diverged: it begins again each time, and agrees with any file for a while; the
    file does not stay confirmed for that."""
    machine = demo_machine()
    state, out = run(machine, frames())
    pose = next(one.value for one in reversed(out) if isinstance(one.value, Pose))
    n, begun, poses = len(open_tracker.NAMES), list[TrackerState](), list[int]()
    far = open_tracker.Misfit(1e3, np.full(n, 1e3), np.ones(n), np.full(n, 0.1), np.full(n, 0.1))
    near = far._replace(total=0.0, by_name=np.zeros(n), off=np.zeros(n))

    def misfit(tracker: TrackerState, machine: Machine) -> open_tracker.Misfit:
        if not begun or begun[-1] is not tracker:
            begun.append(tracker)
            poses.clear()
        poses.append(1)
        return far if len(poses) > 20 else near

    monkeypatch.setattr(open_tracker, "misfit", misfit)
    checks, events = state.consistency, list[tuple[str, str]]()
    checks.confirmed = True
    for _ in range(200):  # poses, 40 s
        checks.learned, checks.rates_known, checks.open.push[3] = 100, True, uneven**2
        events += consistency.observe(checks, machine, state.aligner, state.checks, pose, None, {})
    accused = [kind for kind, _ in events]
    assert accused == ([CONTRADICTION] if uneven < open_tracker.ROUGH else [])
    assert not checks.confirmed
