"""The virtual tractor moves as its model and plain geometry say, and its receivers report where they are."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from logs import with_exact_lengths
from scipy.integrate import solve_ivp

from tilth.estimator.models import nonlinear
from tilth.estimator.models.parameters import geometry_of, rig_of
from tilth.estimator.pose.geometry import to_plane
from tilth.estimator.rig.geometry import lever
from tilth.schemas.flow import PARAMETERS, FixType, Mount
from tilth.schemas.machine import Machine
from tilth.simulator import tractor
from tilth.simulator.drive import drive
from tilth.simulator.receivers import Report, reports, wheel_readings
from tilth.simulator.scenario import (
    ORIGIN_DEG,
    STEP_S,
    Fault,
    FaultKind,
    Ground,
    ReceiverLink,
    RollSensor,
    Scenario,
    Soil,
    SurveyErrors,
    Wheel,
)
from tilth.simulator.tractor import BodyTrack, Truth, draw

QUIET = Scenario(speed_sd=0.0, noise=0.0, steering=((2.0, 0.0), (12.0, 8.0), (3.0, -5.0)))
STRAIGHT = ((1.0, 0.0),)


@pytest.fixture(scope="module")
def quiet(machine: Machine) -> Truth:
    return drive(machine, 3, 17.0, QUIET)


def test_the_same_seed_drives_the_same(machine: Machine) -> None:
    one, again, other = (drive(machine, seed, 5.0) for seed in (1, 1, 2))
    assert one.parameters == again.parameters != other.parameters
    np.testing.assert_array_equal(one.tractor.x, again.tractor.x)
    longer = drive(machine, 1, 9.0)
    np.testing.assert_allclose(longer.wheel_angle[: len(one.time)], one.wheel_angle)


def test_parameters_are_drawn_about_the_priors(machine: Machine) -> None:
    tyres = (machine.tyres.front, machine.tyres.rear, machine.tyres.implement)
    priors = np.array([t.cornering_stiffness for t in tyres] + [t.relaxation_length for t in tyres])
    drawn = np.array([list(draw(machine, seed, QUIET).values()) for seed in range(150)]) / priors
    assert drawn.min() + 1e-12 >= 0.65
    assert drawn.max() <= 1.35 + 1e-12
    assert abs(np.log(drawn).mean()) < 0.03
    assert np.log(drawn).std() == pytest.approx(0.2, abs=0.03)


def test_given_parameters_are_taken(machine: Machine) -> None:
    truth = drive(machine, 1, 0.1, Scenario(soil=Soil(parameters={"C_ar": 400e3, "sigma_i": 0.9})))
    assert (truth.parameters["C_ar"], truth.parameters["sigma_i"]) == (400e3, 0.9)
    assert truth.parameters["C_af"] == drive(machine, 1, 0.1).parameters["C_af"]


def test_runs_of_one_rig_differ_in_drive_and_noise_only(machine: Machine) -> None:
    scenario = Scenario(rig_seed=9, roll_sensor=RollSensor(draw=True))
    one, other = (drive(machine, seed, 5.0, scenario) for seed in (1, 2))
    assert one.rig == other.rig and one.nuisances == other.nuisances and one.parameters == other.parameters
    assert one.parameters == draw(machine, 9, Scenario())  # as of a run with that seed
    assert not np.array_equal(one.tractor.forward_velocity, other.tractor.forward_velocity)
    first, second = (_plane(reports(machine, truth, machine.receiver[0], 0.1)) for truth in (one, other))
    assert not np.array_equal(first, second)
    assert drive(machine, 1, 5.0, replace(scenario, rig_seed=None)).rig != one.rig


def test_true_stiffness_is_the_slope_at_zero_slip_under_the_static_load(quiet: Truth) -> None:
    rig = quiet.rig._replace(grip_f=0.7, grip_r=0.7, grip_i=0.7)
    for k, name in enumerate(PARAMETERS[:3]):
        sideways = []
        for alpha in (-1e-5, 1e-5):
            state = nonlinear.running(0.0, **{("alpha_f", "alpha_r", "alpha_i")[k]: alpha})
            across = nonlinear.wheels(rig, state, nonlinear.inputs_of(1)[0])[2 * k : 2 * k + 2, 2]
            sideways.append(across.sum())
        assert -(sideways[1] - sideways[0]) / 2e-5 == pytest.approx(quiet.parameters[name], rel=1e-3)


def test_grip_and_rolling_resistance_reach_the_model(machine: Machine) -> None:
    def slip(soil: Soil) -> float:
        return abs(float(drive(machine, 1, 12.0, replace(QUIET, soil=soil)).states[1100, 8]))  # alpha_f

    free = slip(Soil(grip=1000.0, rolling=0.0))
    assert 1.03 < slip(Soil(grip=0.5, rolling=0.0)) / free < 1.5
    assert 1.03 < slip(Soil(grip=1000.0, rolling=0.06)) / free < 1.5


def test_what_no_machine_file_tells_of_the_rig_reaches_the_model(machine: Machine) -> None:
    given = drive(machine, 1, 0.1, Scenario(planar={"w_r": 2.6, "h_h": 0.8, "load_exponent": 0.5})).rig
    assert (given.w_r, given.h_h, given.load_exponent) == (2.6, 0.8, 0.5)
    plain = drive(machine, 1, 0.1, Scenario()).rig
    assert given == plain._replace(w_r=2.6, h_h=0.8, load_exponent=0.5)


def test_states_are_those_of_the_model(machine: Machine) -> None:
    """Against a general integrator of the model's derivative with the same wheel angles."""
    truth = drive(machine, 3, 4.0, replace(QUIET, steering=((0.5, 0.0), (2.0, 8.0), (3.0, -5.0))))

    def slope(t: float, x: np.ndarray) -> np.ndarray:
        delta = float(np.interp(t, truth.time, truth.wheel_angle))
        return nonlinear.derivative(truth.rig, x, nonlinear.inputs_of(1, delta=delta, speed=4.5)[0])

    corners: list[int] = (np.flatnonzero(np.abs(np.diff(truth.wheel_angle, 2)) > 1e-6) + 1).tolist()
    state = nonlinear.running(4.5)
    for start, end in pairwise([0, *corners, len(truth.time) - 1]):
        if end > start:
            span = (truth.time[start], truth.time[end])
            state = solve_ivp(slope, span, state, rtol=1e-6, atol=1e-9).y[:, -1]
    np.testing.assert_allclose(truth.states[-1, :11], state[:11], rtol=1e-4, atol=1e-6)


def test_what_is_compiled_and_what_is_interpreted_agree(
    machine: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    rough = Scenario(ground=Ground(slope_deg=4.0, roll_sd_deg=1.0, force_sd=0.02))
    plain = drive(machine, 1, 3.0, rough)
    monkeypatch.setattr(tractor, "COMPILED_FROM", 0)
    np.testing.assert_allclose(drive(machine, 1, 3.0, rough).states, plain.states, rtol=1e-9, atol=1e-12)


def _velocity(track: BodyTrack) -> tuple[np.ndarray, np.ndarray]:
    """North and east by differences of position, at the middle samples."""
    return (track.x[2:] - track.x[:-2]) / (2 * STEP_S), (track.y[2:] - track.y[:-2]) / (2 * STEP_S)


@pytest.mark.parametrize("body", ["tractor", "implement"])
def test_positions_and_velocities_agree(quiet: Truth, body: str) -> None:
    track: BodyTrack = getattr(quiet, body)
    north, east = _velocity(track)
    cosine, sine = np.cos(track.heading[1:-1]), np.sin(track.heading[1:-1])
    np.testing.assert_allclose(north * cosine + east * sine, track.forward_velocity[1:-1], atol=2e-3)
    np.testing.assert_allclose(east * cosine - north * sine, track.lateral_velocity[1:-1], atol=2e-3)
    np.testing.assert_allclose(np.diff(track.heading) / STEP_S, track.yaw_rate[1:], atol=8e-3)


def test_the_hitch_holds(machine: Machine, quiet: Truth) -> None:
    t, i = quiet.tractor, quiet.implement  # on level ground the CGs do not sway
    c, d = machine.tractor.c.value, machine.implement.d.value
    hitch = t.x - c * np.cos(t.heading), t.y - c * np.sin(t.heading)
    np.testing.assert_allclose(i.x + d * np.cos(i.heading), hitch[0], atol=1e-9)
    np.testing.assert_allclose(i.y + d * np.sin(i.heading), hitch[1], atol=1e-9)


def test_steering_is_what_was_asked_for_and_no_faster(quiet: Truth, machine: Machine) -> None:
    degrees = np.degrees(quiet.wheel_angle)
    assert degrees[100] == 0.0
    assert degrees[1300] == pytest.approx(8.0)
    assert degrees[1650] == pytest.approx(-5.0)
    assert np.abs(np.diff(degrees)).max() <= 25.0 * STEP_S + 1e-9
    assert quiet.tractor.yaw_rate[1300] > 0  # right turns are positive
    wild = drive(machine, 1, 30.0, Scenario(steering=((30.0, None),)))
    assert np.abs(np.diff(np.degrees(wild.wheel_angle))).max() <= 25.0 * STEP_S + 1e-9
    assert np.degrees(wild.wheel_angle).std() > 2.0


@pytest.mark.parametrize("seed", range(8))
def test_the_default_drive_has_six_steady_turns_to_both_sides(machine: Machine, seed: int) -> None:
    degrees = np.degrees(drive(machine, seed, 90.0).wheel_angle)
    held = np.flatnonzero(np.abs(np.diff(degrees)) > 1e-9)
    stretches = [(a, b) for a, b in pairwise(held) if b - a > 900]
    turns = [degrees[(a + b) // 2] for a, b in stretches if abs(degrees[(a + b) // 2]) > 4.9]
    assert len(turns) >= 6
    assert min(sum(turn > 0 for turn in turns), sum(turn < 0 for turn in turns)) >= 3
    assert np.count_nonzero(np.abs(degrees) < 1e-9) > 1000  # ten seconds of straight driving


def test_a_side_slope_pulls_downhill(machine: Machine) -> None:
    scenario = Scenario(speed_sd=0.0, noise=0.0, steering=STRAIGHT, roll_deg=(3.0, 3.0))
    truth = drive(machine, 1, 8.0, scenario)
    assert truth.tractor.y[-1] - truth.tractor.y[0] > 0.05  # right side down: it drifts to the right
    np.testing.assert_allclose(np.degrees(truth.tractor.roll), 3.0)
    plane = replace(scenario, roll_deg=(0.0, 0.0), ground=Ground(slope_deg=3.0, downhill_deg=90.0))
    same = drive(machine, 1, 8.0, plane)
    np.testing.assert_allclose(same.tractor.y, truth.tractor.y, atol=0.01)


def test_on_a_plane_roll_and_pitch_follow_the_heading(machine: Machine) -> None:
    scenario = replace(QUIET, steering=((60.0, 12.0),), ground=Ground(slope_deg=5.0, downhill_deg=40.0))
    body = drive(machine, 1, 40.0, scenario).tractor
    assert np.ptp(body.heading) > 2 * np.pi
    down = np.radians([np.cos(np.radians(40.0)), np.sin(np.radians(40.0))]) * 5.0
    right = np.column_stack([-np.sin(body.heading), np.cos(body.heading)])
    ahead = np.column_stack([np.cos(body.heading), np.sin(body.heading)])
    np.testing.assert_allclose(body.roll, right @ down, atol=2e-4)
    np.testing.assert_allclose(body.pitch, -(ahead @ down), atol=2e-4)
    assert np.abs(body.forward_velocity - 4.5).max() < 0.3  # it holds its speed up and down


def test_speed_wanders_and_follows_what_is_asked(machine: Machine) -> None:
    wild = drive(machine, 1, 200.0, Scenario(steering=STRAIGHT, speed_sd=0.1)).tractor.forward_velocity
    assert wild.mean() == pytest.approx(4.5, abs=0.1)
    assert wild.std() == pytest.approx(0.1, rel=0.4)
    rows = Scenario(steering=STRAIGHT, speed=((10.0, 3.0), (10.0, 0.0), (10.0, -1.0)), noise=0.0)
    u = drive(machine, 1, 30.0, rows).tractor.forward_velocity
    assert u[900] == pytest.approx(3.0, abs=0.2)
    assert abs(u[1900]) < 0.05  # it stands
    assert u[2900] == pytest.approx(-1.0, abs=0.2)


def test_a_field_keeps_its_patches_and_its_place_from_day_to_day(machine: Machine) -> None:
    soil = Soil(patch_log_sd=0.2, patch_seed=5)
    field = Scenario(
        steering=STRAIGHT, speed_sd=0.0, noise=0.0, rig_seed=1, soil=soil, origin_deg=(-33.0, 151.0)
    )
    monday, friday = (drive(machine, seed, 5.0, field) for seed in (1, 2))
    np.testing.assert_allclose(monday.soil, friday.soil, rtol=1e-3)
    other = drive(machine, 2, 5.0, replace(field, soil=replace(soil, patch_seed=6)))
    assert np.abs(np.log(other.soil / friday.soil)).max() > 0.05
    (first, *_) = reports(machine, monday, machine.receiver[0], 0.5)
    assert np.hypot(*to_plane((-33.0, 151.0), first.latitude_deg, first.longitude_deg)) < 20.0


def _plane(rows: list[Report]) -> np.ndarray:
    """North and east of the reported positions, m, shape (n, 2)."""
    return np.array([to_plane(ORIGIN_DEG, row.latitude_deg, row.longitude_deg) for row in rows])


@pytest.mark.parametrize("mount", list(Mount))
def test_receivers_report_their_point(machine: Machine, mount: Mount) -> None:
    """On a slope that is steep in both directions, against the geometry that estimators use."""
    ground = Ground(slope_deg=5.0, downhill_deg=60.0)
    scenario = Scenario(speed_sd=0.0, noise=0.0, steering=((1.0, 0.0), (9.0, 6.0)), ground=ground)
    truth = drive(machine, 1, 8.0, scenario)
    body = truth.tractor if mount.startswith("tractor") else truth.implement
    section = machine.tractor if mount.startswith("tractor") else machine.implement
    receiver = next(r for r in machine.receiver if r.mount == mount)
    rows = reports(machine, truth, receiver, 0.5)
    for row, place in zip(rows, _plane(rows), strict=True):
        k = round(row.epoch_s / STEP_S)
        arm = lever(
            receiver.position, section.cg_height.value, receiver.roll_corrected, body.roll[k], body.pitch[k]
        )
        cosine, sine = np.cos(body.heading[k]), np.sin(body.heading[k])
        north = body.x[k] + arm[0] * cosine - arm[1] * sine
        east = body.y[k] + arm[0] * sine + arm[1] * cosine
        assert np.hypot(place[0] - north, place[1] - east) < 1e-4
        assert (row.roll, row.pitch) == pytest.approx((body.roll[k], body.pitch[k]))


@pytest.mark.parametrize("rough", [0.0, 1.0], ids=["even", "rough"])
def test_reported_velocity_is_that_of_the_reported_point(machine: Machine, rough: float) -> None:
    ground = Ground(slope_deg=5.0, downhill_deg=20.0, roll_sd_deg=rough, band=(15.0, 40.0))
    scenario = Scenario(
        speed_sd=0.0, noise=0.0, steering=((2.0, 0.0), (10.0, -8.0)), roll_deg=(1.0, 1.0), ground=ground
    )
    truth = drive(machine, 1, 12.0, scenario)
    for receiver in machine.receiver:
        rows = reports(machine, truth, receiver, 0.5)
        place = _plane(rows)
        north, east = ((place[2:] - place[:-2]) / (rows[2].epoch_s - rows[0].epoch_s)).T
        output = np.array([(row.course, row.speed, row.epoch_s) for row in rows])[1:-1]
        steady = output[:, 2] > 5.0  # where differences are derivatives
        off = (np.arctan2(east, north) - output[:, 0] + np.pi) % (2 * np.pi) - np.pi
        assert np.abs(off[steady]).max() < 0.003 + 0.004 * rough
        assert np.abs(np.hypot(north, east) - output[:, 1])[steady].max() < 0.01 + 0.01 * rough


def test_survey_errors_are_within_what_the_scenario_says(machine: Machine) -> None:
    scenario = Scenario(survey=SurveyErrors(cg_sd=0.03, lever_sd=0.02, pair_sd_deg=0.3))
    collected = [drive(machine, seed, 0.05, scenario) for seed in range(40)]
    for key, sd in (("cg_forward_tractor", 0.03), ("right_implement_rear", 0.02)):
        drawn = np.array([truth.nuisances[key] for truth in collected])
        assert drawn.std() == pytest.approx(sd, rel=0.35)
        assert np.abs(drawn).max() <= 1.5 * sd
    pairs = np.degrees(
        [[truth.nuisances[f"pair_{b}"] for b in ("tractor", "implement")] for truth in collected]
    )
    assert 0.29 < np.abs(pairs).max() <= 0.3 + 1e-12
    assert np.abs(pairs).mean() > 0.1


def test_a_cg_that_is_elsewhere_moves_the_axles_and_the_receivers_with_it(machine: Machine) -> None:
    """The receivers stay where they are on the machine: the same distance from its axles."""
    machine = with_exact_lengths(machine)
    off = drive(machine, 3, 2.0, Scenario(survey=SurveyErrors(cg_sd=0.05, lever_sd=0.0, pair_sd_deg=0.0)))
    shift = off.nuisances["cg_forward_tractor"]
    assert abs(shift) > 0.005
    nominal = rig_of(machine)
    assert (off.rig.a, off.rig.b, off.rig.c) == pytest.approx(
        (nominal.a - shift, nominal.b + shift, nominal.c + shift)
    )
    calm = Scenario(survey=SurveyErrors(cg_sd=0.05, lever_sd=0.0, pair_sd_deg=0.0), steering=STRAIGHT)
    truth = drive(machine, 3, 2.0, calm)
    receiver = machine.receiver[0]
    rows = reports(machine, truth, receiver, 0.5)
    k = np.round([row.epoch_s / STEP_S for row in rows]).astype(int)
    front_axle = truth.tractor.x[k] + truth.rig.a
    ahead = _plane(rows)[:, 0] - front_axle
    assert ahead.mean() == pytest.approx(receiver.position[0] - machine.tractor.a.value, abs=0.03)


def test_the_wheel_sensor_has_its_errors(machine: Machine) -> None:
    wheel = Wheel(zero_deg=0.5, gain=1.1, dead_band_deg=1.0)
    steering = ((2.0, 0.0), (4.0, 5.0), (4.0, -5.0))
    truth = drive(machine, 1, 12.0, Scenario(wheel=wheel, noise=0.0, steering=steering))
    output, is_ = np.degrees(wheel_readings(truth)), np.degrees(truth.wheel_angle)
    assert (output[100], is_[100]) == pytest.approx((0.5, 0.0))  # in the middle of its play
    assert (output[500], is_[500]) == pytest.approx((1.1 * 4.5 + 0.5, 5.0))  # on the one flank
    assert (output[900], is_[900]) == pytest.approx((-1.1 * 4.5 + 0.5, -5.0))  # and on the other


def test_the_gain_of_the_wheel_sensor_bends_alike_to_both_sides(machine: Machine) -> None:
    steering = ((2.0, 0.0), (4.0, 15.0), (6.0, -30.0))
    truth = drive(
        machine, 1, 12.0, Scenario(wheel=Wheel(zero_deg=0.0, bend=0.02), noise=0.0, steering=steering)
    )
    ratio = wheel_readings(truth)[[500, 1100]] / truth.wheel_angle[[500, 1100]]
    assert ratio == pytest.approx([1.01, 1.02])


def test_the_base_moves_all_positions_at_once(machine: Machine) -> None:
    still, moved = (
        drive(machine, 4, 300.0, Scenario(steering=((1.0, 0.0),), link=ReceiverLink(base_jump=jump)))
        for jump in (0.0, 0.03)
    )
    off = []
    for receiver in machine.receiver[:2]:
        rows = [_plane(reports(machine, truth, receiver, 0.5)) for truth in (still, moved)]
        off.append(rows[1] - rows[0])
    np.testing.assert_allclose(off[0], off[1], atol=1e-6)
    far = np.hypot(*off[0].T)
    assert far[0] == pytest.approx(0.0, abs=1e-6) and far.max() == pytest.approx(0.03, abs=1e-6)
    jumps = np.abs(np.diff(off[0], axis=0)).max(axis=1) > 1e-3
    assert 1 <= jumps.sum() <= 8


def test_noise_has_the_stated_size(machine: Machine) -> None:
    receiver = machine.receiver[2]
    straight = Scenario(steering=((1.0, 0.0),), latency_s={receiver.mount: 0.1})
    rows = reports(machine, drive(machine, 1, 200.0, straight), receiver, 0.5)
    exact = reports(
        machine, drive(machine, 1, 200.0, Scenario(steering=((1.0, 0.0),), noise=0.0)), receiver, 0.5
    )
    north = (np.array([r.latitude_deg for r in rows]) - [r.latitude_deg for r in exact]) * 111_132.0
    assert np.diff(north).std() / np.sqrt(2) == pytest.approx(0.008, rel=0.1)  # the white part
    assert 0.008 < north.std() < 0.04
    for key, sd in (("yaw_rate", np.radians(0.18)), ("heading", np.radians(0.3)), ("roll", np.radians(0.2))):
        off = np.array([getattr(r, key) - getattr(e, key) for r, e in zip(rows, exact, strict=True)])
        off = (off + np.pi) % (2 * np.pi) - np.pi
        assert off.std() == pytest.approx(sd, rel=0.1), key
    late = np.array([r.sent_s - r.epoch_s for r in rows])
    assert late.min() >= 0.1
    assert late.mean() == pytest.approx(0.1015, abs=0.0005)


def test_faults(machine: Machine) -> None:
    mount = Mount.TRACTOR_REAR
    kinds: list[FaultKind] = ["silent", "not_available", "repeat", "late", "moved", "rtk_float"]
    faults = tuple(Fault(mount, 2.0 + 2 * i, 3.0 + 2 * i, kind) for i, kind in enumerate(kinds))
    receiver = next(r for r in machine.receiver if r.mount == mount)
    plain = Scenario(noise=0.0, steering=((1.0, 0.0),))
    spoilt = replace(plain, faults=faults)
    good = {r.epoch_s: r for r in reports(machine, drive(machine, 1, 16.0, plain), receiver, 0.5)}
    bad = {r.epoch_s: r for r in reports(machine, drive(machine, 1, 16.0, spoilt), receiver, 0.5)}
    during = {
        kind: [t for t in good if f.start_s <= t < f.end_s] for kind, f in zip(kinds, faults, strict=True)
    }
    outside = [t for t in good if not any(t in times for times in during.values())]
    assert all(bad[t].latitude_deg == good[t].latitude_deg and bad[t].effect.sends for t in outside)
    assert all(len(times) == 5 for times in during.values())
    assert not any(bad[t].effect.sends for t in during["silent"])
    assert not any(bad[t].effect.available for t in during["not_available"])
    assert len({bad[t].latitude_deg for t in during["repeat"]}) == 1
    assert all(bad[t].sent_s - good[t].sent_s == pytest.approx(0.3) for t in during["late"])
    moved = [(bad[t].longitude_deg - good[t].longitude_deg) * 82_800 for t in during["moved"]]
    assert moved == pytest.approx([0.4] * 5, abs=0.01)
    assert all(bad[t].effect.fix is FixType.RTK_FLOAT for t in during["rtk_float"])
    assert max(abs(bad[t].latitude_deg - good[t].latitude_deg) * 111_132 for t in during["rtk_float"]) > 0.03


def test_reports_drop_out_and_jitter_as_the_link_does(machine: Machine) -> None:
    receiver = machine.receiver[3]
    latency = {receiver.mount: 0.1}
    scenario = Scenario(steering=STRAIGHT, latency_s=latency, link=ReceiverLink(jitter=0.02, drop_out=0.2))
    rows = reports(machine, drive(machine, 1, 100.0, scenario), receiver, 0.5)
    assert np.mean([row.effect.sends for row in rows]) == pytest.approx(0.8, abs=0.05)
    late = np.array([row.sent_s - row.epoch_s for row in rows]) - 0.1
    assert late.min() >= 0.0
    assert late.mean() == pytest.approx(0.02, rel=0.1)


def test_what_the_machine_file_is_sure_of_is_exact(machine: Machine) -> None:
    truth = drive(machine, 5, 0.1, Scenario(survey=SurveyErrors(cg_sd=0.0)))
    nominal = geometry_of(machine)
    drawn = (truth.geometry != nominal).tolist()  # all but a, b and the tractor's mass
    assert drawn == [False] * 2 + [True] * 3 + [False] + [True] * 3
    assert np.abs(truth.geometry[2:5] - nominal[2:5]).max() <= 1.5 * 0.02
    assert np.abs(truth.geometry[7:] / nominal[7:] - 1.0).max() <= 1.5 * 0.05
    assert abs(truth.geometry[6] - nominal[6]) <= 1.5 * 200.0


def test_ten_minutes_are_driven_at_once_and_stay_finite(machine: Machine) -> None:
    truth = drive(machine, 1, 600.0)
    assert len(truth.time) == 60_001
    assert np.isfinite(truth.implement.x).all()
    assert pytest.approx(truth.time[-1]) == STEP_S * 60_000
