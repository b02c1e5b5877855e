"""The virtual tractor moves as its model and plain geometry say."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tilth.estimator.geometry import to_plane
from tilth.estimator.models.relaxation import geometry_of, input_matrix, system_matrix
from tilth.replay import tractor
from tilth.replay.receivers import ORIGIN_DEG, Report, reports
from tilth.replay.tractor import STEP_S, Fault, Scenario, Track, Truth, drive
from tilth.schemas.flow import PARAMETERS, FixType, Mount
from tilth.schemas.machine import Machine, parse_machine

MACHINE = Path(__file__).resolve().parents[1] / "deploy" / "machines" / "jd7930-parker500.toml"
QUIET = Scenario(speed_sd=0.0, noise=0.0, steering=((2.0, 0.0), (12.0, 8.0), (3.0, -5.0)))


@pytest.fixture(scope="module")
def machine() -> Machine:
    return parse_machine(MACHINE.read_text())


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
    drawn = np.array([list(drive(machine, seed, 0.1).parameters.values()) for seed in range(150)]) / priors
    assert drawn.min() + 1e-12 >= 0.65
    assert drawn.max() <= 1.35 + 1e-12
    assert abs(np.log(drawn).mean()) < 0.03
    assert np.log(drawn).std() == pytest.approx(0.2, abs=0.03)


def test_states_are_those_of_the_model(machine: Machine, quiet: Truth) -> None:
    """Against a general integrator of the same equations with the same wheel angles."""
    geometry = geometry_of(machine)
    theta = np.array([quiet.parameters[name] for name in PARAMETERS])
    a, b = system_matrix(4.5, geometry, theta), input_matrix(4.5, geometry, theta)[:, 0]
    corners = np.flatnonzero(np.abs(np.diff(quiet.wheel_angle, 2)) > 1e-6) + 1
    state, start = np.zeros(9), 0
    for end in [*corners, len(quiet.time) - 1]:
        if end == start:
            continue
        solved = solve_ivp(
            lambda t, x: a @ x + b * np.interp(t, quiet.time, quiet.wheel_angle),
            (quiet.time[start], quiet.time[end]),
            state,
            rtol=1e-9,
            atol=1e-12,
        )
        state, start = solved.y[:, -1], end
    last = (quiet.tractor.lateral_velocity[-1], quiet.tractor.yaw_rate[-1], quiet.implement.yaw_rate[-1])
    np.testing.assert_allclose(last, state[:3], rtol=1e-6)
    assert quiet.tractor.heading[-1] == pytest.approx(state[7], rel=1e-6)
    assert quiet.implement.heading[-1] == pytest.approx(state[8], rel=1e-6)


def _velocity(track: Track) -> tuple[np.ndarray, np.ndarray]:
    """North and east by differences of position, at the middle samples."""
    return (track.x[2:] - track.x[:-2]) / (2 * STEP_S), (track.y[2:] - track.y[:-2]) / (2 * STEP_S)


@pytest.mark.parametrize("body", ["tractor", "implement"])
def test_positions_and_velocities_agree(quiet: Truth, body: str) -> None:
    track: Track = getattr(quiet, body)
    north, east = _velocity(track)
    cosine, sine = np.cos(track.heading[1:-1]), np.sin(track.heading[1:-1])
    np.testing.assert_allclose(north * cosine + east * sine, track.forward_velocity[1:-1], atol=2e-3)
    np.testing.assert_allclose(east * cosine - north * sine, track.lateral_velocity[1:-1], atol=2e-3)
    np.testing.assert_allclose(np.diff(track.heading) / STEP_S, track.yaw_rate[1:], atol=8e-3)


def test_the_hitch_holds(machine: Machine, quiet: Truth) -> None:
    t, i = quiet.tractor, quiet.implement
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
    turns = [degrees[(a + b) // 2] for a, b in stretches if abs(degrees[(a + b) // 2]) > 5.9]
    assert len(turns) >= 6
    assert min(sum(turn > 0 for turn in turns), sum(turn < 0 for turn in turns)) >= 3
    assert np.count_nonzero(np.abs(degrees) < 1e-9) > 1000  # ten seconds of straight driving


def test_a_side_slope_pulls_downhill(machine: Machine) -> None:
    scenario = Scenario(speed_sd=0.0, noise=0.0, steering=((1.0, 0.0),), roll_deg=(3.0, 3.0))
    truth = drive(machine, 1, 8.0, scenario)
    assert truth.tractor.y[-1] > 0.05  # right side down: it drifts to the right
    np.testing.assert_allclose(np.degrees(truth.tractor.roll), 3.0)


def _plane(rows: list[Report]) -> np.ndarray:
    """North and east of the reported positions, m, shape (n, 2)."""
    return np.array([to_plane(ORIGIN_DEG, row.latitude_deg, row.longitude_deg) for row in rows])


@pytest.mark.parametrize(
    ("mount", "corrected", "aside"),
    [
        # Antenna 2.9 or 3.1 m up, CG 1.1 or 1.2 m: on a slope of 5 degrees the antenna is to the right of the
        # CG by their difference leaning over, the point on the ground to its left by the CG's height.
        (Mount.TRACTOR_FRONT, True, -1.1 * np.sin(np.radians(5))),
        (Mount.IMPLEMENT_REAR, False, (3.1 - 1.2) * np.sin(np.radians(5))),
    ],
)
def test_receivers_report_their_point(machine: Machine, mount: Mount, corrected: bool, aside: float) -> None:
    scenario = Scenario(speed_sd=0.0, noise=0.0, steering=((1.0, 0.0), (9.0, 6.0)), roll_deg=(5.0, 5.0))
    truth = drive(machine, 1, 8.0, scenario)
    body = truth.tractor if mount.startswith("tractor") else truth.implement
    receiver = next(r for r in machine.receiver if r.mount == mount)
    assert receiver.roll_corrected is corrected
    forward = receiver.position[0]
    cosine, sine = np.cos(body.heading), np.sin(body.heading)
    place = np.column_stack(
        [body.x + forward * cosine - aside * sine, body.y + forward * sine + aside * cosine]
    )
    rows = reports(machine, truth, receiver, 0.5)
    at = np.round([row.epoch_s / STEP_S for row in rows]).astype(int)
    assert np.abs(_plane(rows) - place[at]).max() < 1e-6


def test_reported_velocity_is_that_of_the_reported_point(machine: Machine) -> None:
    scenario = Scenario(speed_sd=0.0, noise=0.0, steering=((2.0, 0.0), (10.0, -8.0)), roll_deg=(6.0, 6.0))
    truth = drive(machine, 1, 12.0, scenario)
    for receiver in machine.receiver:
        rows = reports(machine, truth, receiver, 0.5)
        place = _plane(rows)
        north, east = ((place[2:] - place[:-2]) / (rows[2].epoch_s - rows[0].epoch_s)).T
        said = np.array([(row.course, row.speed, row.epoch_s) for row in rows])[1:-1]
        steady = said[:, 2] > 5.0  # where differences are derivatives
        off = (np.arctan2(east, north) - said[:, 0] + np.pi) % (2 * np.pi) - np.pi
        assert np.abs(off[steady]).max() < 0.003
        assert np.abs(np.hypot(north, east) - said[:, 1])[steady].max() < 0.01


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
    kinds = ["silent", "not_available", "repeat", "late", "moved", "rtk_float"]
    faults = tuple(Fault(mount, 2.0 + 2 * i, 3.0 + 2 * i, kind) for i, kind in enumerate(kinds))
    receiver = next(r for r in machine.receiver if r.mount == mount)
    plain = Scenario(noise=0.0, steering=((1.0, 0.0),))
    spoilt = Scenario(noise=0.0, steering=((1.0, 0.0),), faults=faults)
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


def test_what_the_machine_file_is_sure_of_is_exact(machine: Machine) -> None:
    truth = drive(machine, 5, 0.1)
    nominal = geometry_of(machine)
    assert (truth.geometry != nominal).tolist() == [False] * 6 + [True] + [False] * 2  # the implement's mass
    assert abs(truth.geometry[6] - nominal[6]) <= 1.5 * 200.0


def test_an_hour_is_driven_in_seconds_and_stays_finite(machine: Machine) -> None:
    truth = drive(machine, 1, 600.0)
    assert len(truth.time) == 60_001
    assert np.isfinite(truth.implement.x).all()
    assert pytest.approx(truth.time[-1]) == tractor.STEP_S * 60_000
