"""Scenarios on the spatial plant: the planar one is its limit, sensors are where they are, draws are kept."""

import importlib.util
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from paths import MACHINE_FILE, ROOT
from scipy.spatial.transform import Rotation

from tilth.cli import main
from tilth.estimator.pose.geometry import to_plane
from tilth.schemas.machine import Machine
from tilth.schemas.machine_toml import parse_machine
from tilth.simulator.demo import SPATIAL
from tilth.simulator.drive import drive
from tilth.simulator.receivers import Report, reports
from tilth.simulator.scenario import (
    ORIGIN_DEG,
    Fieldwork,
    Ground,
    LoadChange,
    RollSensor,
    RowSteering,
    Scenario,
    Soil,
    SoilChange,
    Spatial,
    as_json,
    from_json,
    parse_scenario,
)
from tilth.simulator.spatial.engine import NotInstalled, check_installed
from tilth.simulator.spatial.forces import TYRE_COLUMNS
from tilth.simulator.spatial.vehicle import Vehicle, static_loads
from tilth.simulator.spatial_run import vehicle_in
from tilth.simulator.tractor import Truth, draw, setting_of

TEXT = MACHINE_FILE.read_text()
STEERING = ((2.0, 0.0), (5.0, 5.0), (5.0, -3.0))
QUIET = Scenario(speed_sd=0.0, noise=0.0, steering=STEERING)
SPACE = replace(QUIET, plant="spatial")
FILE = ROOT / "examples" / "scenarios" / "spatial.toml"
needs_engine = pytest.mark.skipif(
    importlib.util.find_spec("mujoco") is None, reason="needs the extra `spatial`"
)


@pytest.fixture(scope="module")
def machine() -> Machine:
    return parse_machine(TEXT)


@pytest.fixture(scope="module")
def rough(machine: Machine) -> Truth:
    """Side slope, uneven ground, turns."""
    return drive(machine, 3, 12.0, replace(SPACE, ground=Ground(slope_deg=5.0, rms=0.02)))


def test_the_machine_file_describes_the_rig_where_the_scenario_does_not() -> None:
    text = TEXT.replace(
        "[tractor]\n", "[tractor]\nfront_axle_mass = 900\nhitch_height = 0.62\npivot_height = 0.7\n"
    )
    for axle, track in (("front", 1.8), ("rear", 1.9), ("implement", 2.3)):
        described = f"[tyres.{axle}]\ntrack = {track}\ndeflection = 0.08\n"
        text = text.replace(f"[tyres.{axle}]\n", described)
    described_rig = parse_machine(text)

    def made(machine: Machine, spatial: Spatial) -> Vehicle:
        return vehicle_in(setting_of(machine, 1, 1.0, replace(SPACE, spatial=spatial)))

    for draws in (False, True):
        one = made(described_rig, Spatial(draw=draws, hitch_height=0.5))
        assert (one.beam_mass, one.hitch_height, one.pin_height) == (900.0, 0.5, 0.7)
        assert one.track == pytest.approx((1.8, 1.9, 2.3))
        assert np.array(one.stiffness) * 2 * 0.08 == pytest.approx(static_loads(one), rel=0.02)
    plain = parse_machine(TEXT)
    assert made(plain, Spatial()).beam_mass == pytest.approx(0.07 * plain.tractor.mass.value)


@needs_engine
def test_stiff_tyres_and_a_low_cg_give_the_planar_plant() -> None:
    low = parse_machine(
        TEXT.replace("cg_height = 1.1", "cg_height = 0.3").replace("cg_height = 1.2", "cg_height = 0.3")
    )
    soil = Soil(grip=1000.0, rolling=0.0)
    stiff = Spatial(
        vertical_stiffness=(12e6, 17e6, 15e6), vertical_damping=(20e3, 30e3, 20e3), pin_height=0.1,
        hitch_height=0.1, ackermann=0.0, track=(1.93, 1.93, 2.5), step=0.0005,
    )  # fmt: skip
    planar = drive(low, 1, 12.0, replace(QUIET, soil=soil))
    space = drive(low, 1, 12.0, replace(SPACE, soil=soil, spatial=stiff))
    for body in ("tractor", "implement"):
        wanted, got = getattr(planar, body).yaw_rate, getattr(space, body).yaw_rate
        assert np.sqrt(np.mean((got - wanted) ** 2)) < 0.003 * np.sqrt(np.mean(wanted**2)), body
        np.testing.assert_allclose(got, wanted, atol=0.004 * np.abs(wanted).max())
    assert np.abs(space.tractor.roll).max() < 2e-4


@needs_engine
def test_antennas_are_where_they_are_in_space(machine: Machine, rough: Truth) -> None:
    """Of two on one body at other heights: what a receiver reports is the body's own axes times its place."""
    assert rough.space is not None
    for receiver in machine.receiver:
        body, row = (rough.tractor, 0) if "tractor" in receiver.mount else (rough.implement, 1)
        got = reports(machine, rough, receiver, 2.0)
        k = np.round(np.array([one.epoch_s for one in got]) / 0.01).astype(int)
        roll, pitch, psi = body.roll[k], body.pitch[k], body.heading[k]
        height = 0.0 if receiver.roll_corrected else receiver.position[2]
        up = height - (rough.rig.h_t if row == 0 else rough.rig.h_i)
        turns = Rotation.from_euler("ZYX", np.column_stack([psi, pitch, roll]))
        north, east, _ = turns.apply([receiver.position[0], receiver.position[1], -up]).T
        metres = np.array([_metres(one) for one in got])
        np.testing.assert_allclose(metres[:, 0], body.x[k] + north, atol=2e-3)
        np.testing.assert_allclose(metres[:, 1], body.y[k] + east, atol=2e-3)
        assert body.gyro is not None
        np.testing.assert_allclose([one.yaw_rate for one in got], body.gyro[k])


def _metres(report: Report) -> tuple[float, float]:
    return to_plane(ORIGIN_DEG, report.latitude_deg, report.longitude_deg)


@needs_engine
def test_the_track_is_that_of_a_moving_body(rough: Truth) -> None:
    for track in (rough.tractor, rough.implement):
        north = track.forward_velocity * np.cos(track.heading) - track.lateral_velocity * np.sin(
            track.heading
        )
        east = track.forward_velocity * np.sin(track.heading) + track.lateral_velocity * np.cos(track.heading)
        np.testing.assert_allclose(np.gradient(track.x, 0.01)[20:-20], north[20:-20], atol=0.01)
        np.testing.assert_allclose(np.gradient(track.y, 0.01)[20:-20], east[20:-20], atol=0.01)
        np.testing.assert_allclose(
            np.gradient(track.heading, 0.01)[20:-20], track.yaw_rate[20:-20], atol=0.005
        )


@needs_engine
def test_the_hitch_holds(rough: Truth) -> None:
    """Both bodies' own ends of the drawbar are one point."""
    assert rough.space is not None
    masses, hitch = rough.space.vehicle.masses, rough.space.vehicle.hitch_height
    ends = []
    for track, along, up in (
        (rough.tractor, -masses.c, hitch - masses.h_t),
        (rough.implement, masses.d, hitch - masses.h_i),
    ):
        back, side = np.cos(track.roll) * np.sin(track.pitch), np.sin(track.roll)
        ahead, lateral_offset = along * np.cos(track.pitch) - up * back, up * side
        cosine, sine = np.cos(track.heading), np.sin(track.heading)
        ends.append(
            (
                track.x + ahead * cosine - lateral_offset * sine,
                track.y + ahead * sine + lateral_offset * cosine,
            )
        )
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-6)


def test_roll_sensors_have_their_noise_zero_and_delay(machine: Machine) -> None:
    """On the planar plant too: with sudden roll of the ground it is seen when it comes."""
    ground, steering = Ground(roll_sd_deg=2.0), ((1.0, 0.0),)
    plain = Scenario(noise=0.0, steering=steering, ground=ground)
    late = replace(plain, roll_sensor=RollSensor(zero_deg=0.7, delay=0.1))
    one, other = (
        reports(machine, drive(machine, 1, 25.0, s), machine.receiver[0], 1.0) for s in (plain, late)
    )
    truth = drive(machine, 1, 25.0, plain)
    k = np.round(np.array([r.epoch_s for r in one]) / 0.01).astype(int)
    np.testing.assert_allclose([r.roll for r in one], truth.tractor.roll[k])
    np.testing.assert_allclose([r.roll for r in other], truth.tractor.roll[k - 10] + np.radians(0.7))
    noisy = replace(plain, noise=1.0, roll_sensor=RollSensor(sd_deg=0.5))
    found = reports(machine, drive(machine, 1, 60.0, noisy), machine.receiver[0], 1.0)
    flat = drive(machine, 1, 60.0, noisy)
    k = np.round(np.array([r.epoch_s for r in found]) / 0.01).astype(int)
    assert np.std([r.roll for r in found] - flat.tractor.roll[k]) == pytest.approx(np.radians(0.5), rel=0.12)


def test_roll_sensors_are_drawn_for_each_receiver(machine: Machine) -> None:
    seen: dict[str, list[float]] = {"sd": [], "zero": [], "delay": []}
    for seed in range(30):
        found = drive(machine, seed, 0.1, Scenario(roll_sensor=RollSensor(draw=True))).nuisances
        for what, values in seen.items():
            values += [found[f"roll_{what}_{r.mount}"] for r in machine.receiver]
    assert len(set(seen["zero"])) == 120
    for what, low, high in (("sd", 0.2, 0.5), ("zero", -1.0, 1.0)):
        degrees = np.degrees(seen[what])
        assert low <= degrees.min() < low + 0.05 * 2 and high - 0.05 * 2 < degrees.max() <= high
    assert min(seen["delay"]) >= 0.0 and 0.08 < max(seen["delay"]) <= 0.1


@needs_engine
def test_the_same_seed_drives_the_same_and_parameters_are_those_of_the_planar_plant(machine: Machine) -> None:
    drawn = Scenario(plant="spatial", spatial=Spatial(draw=True), roll_sensor=RollSensor(draw=True))
    one, again, other = (drive(machine, seed, 2.0, drawn) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one.states, again.states)
    assert one.space is not None and other.space is not None
    assert one.space.vehicle != other.space.vehicle
    assert one.parameters == draw(machine, 1, Scenario())
    assert one.rig.grip_f == one.space.vehicle.grip


@needs_engine
def test_soil_changes_are_met_axle_by_axle(machine: Machine) -> None:
    soil = Soil(changes=(SoilChange(north=20.0, east=0.0, C_af=0.5, C_ar=0.5, C_ai=0.5),))
    truth = drive(machine, 1, 10.0, replace(SPACE, steering=((1.0, 0.0),), soil=soil))
    changed = np.argmax(truth.soil[:, :3] < 0.7 * truth.soil[0, :3], axis=0) * 0.01 * 4.5
    np.testing.assert_allclose(np.diff(changed), [2.9, 4.62], atol=0.15)


@needs_engine
@pytest.mark.parametrize("stiffer", [0.0, 0.7])
def test_an_implement_is_unloaded_on_its_way(machine: Machine, stiffer: float) -> None:
    """Its tyres carry what is there, and slip as their stiffness then is: over the mass, by m^(n - 1)."""
    spatial = Spatial(load_exponent=stiffer, camber_thrust=0.0)
    loads = (LoadChange(0.0, 3.0), LoadChange(7.0, 1.0 / 3.0, over=1.0))
    turn = replace(SPACE, steering=((20.0, 4.0),), spatial=spatial, loads=loads, speed_sd=0.0)
    truth = drive(machine, 1, 14.0, turn)
    assert truth.space is not None
    tyres = truth.space.motion.tyres[[650, 1350], 4:]
    carried = tyres[:, :, TYRE_COLUMNS.index("load")].sum(axis=1)
    empty = static_loads(truth.space.vehicle)[2]
    assert carried == pytest.approx([3.0 * empty, empty], rel=0.03)
    slip = tyres[:, :, TYRE_COLUMNS.index("slip")].mean(axis=1)
    assert slip[0] / slip[1] == pytest.approx(3.0 ** (1.0 - stiffer), rel=0.1)
    assert truth.soil[650, 2] / truth.soil[1350, 2] == pytest.approx(3.0**stiffer)


@needs_engine
def test_a_pilot_keeps_a_row_and_turns_at_its_end(machine: Machine) -> None:
    row = replace(SPACE, steering=RowSteering(offset=1.0), ground=Ground(rms=0.01))
    assert np.abs(drive(machine, 1, 25.0, row).states[2000:, 1] - 1.0).max() < 0.25
    field = replace(SPACE, steering=Fieldwork(length=25.0, spacing=16.0), speed=3.0)
    truth = drive(machine, 1, 30.0, field)
    assert truth.states[:, 0].max() < 40.0
    assert abs(abs(truth.states[-1, 2]) - np.pi) < 0.2  # it comes back


@needs_engine
def test_runs_of_one_rig_have_one_vehicle_and_each_its_ground(machine: Machine) -> None:
    drawn = replace(SPACE, rig_seed=9, spatial=Spatial(draw=True))
    one, other = (drive(machine, seed, 2.0, drawn).space for seed in (1, 2))
    assert one is not None and other is not None and one.vehicle == other.vehicle
    assert not np.array_equal(one.motion.tyres, other.motion.tyres)


def test_scenarios_go_through_json() -> None:
    for scenario in (SPATIAL, parse_scenario(FILE.read_text())):
        assert from_json(as_json(scenario)) == scenario


@needs_engine
def test_simulate_writes_a_log_and_what_is_true(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "run.mcap"
    drawn = ROOT / "examples" / "scenarios" / "spatial_drawn.toml"
    assert main(["simulate", str(drawn), "--out", str(log), "--seconds", "3", "--json"]) == 0
    capsys.readouterr()
    truth: dict[str, Any] = json.loads(Path(f"{log}.truth.json").read_text())
    header, *rows = Path(f"{log}.truth.csv").read_text().splitlines()
    assert header.split(",") == list(truth["table"]["columns"])
    table = dict(zip(header.split(","), np.array([row.split(",") for row in rows], float).T, strict=True))
    loads = sum(
        table[f"load_{axle}_{side}"] for axle in ("front", "rear", "implement") for side in ("left", "right")
    )
    masses = truth["vehicle"]["masses"]
    assert np.mean(loads) == pytest.approx(9.80665 * (masses["m_t"] + masses["m_i"]), rel=0.03)
    assert truth["vehicle"]["tyre"] in ("exponential", "tanh", "brush", "magic")
    assert {f"roll_zero_{m}" for m in ("tractor_front", "implement_rear")} <= set(truth["nuisances"])
    assert main(["replay", str(log), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["poses"] > 5


@pytest.mark.parametrize(
    "words", [["simulate", str(FILE), "--out", "{new}"], ["demo", "--spatial", "--no-page", "--log", "{new}"]]
)
def test_without_the_package_it_says_what_to_install(
    words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    find = importlib.util.find_spec

    def absent(name: str, package: str | None = None) -> Any:
        return None if name == "mujoco" else find(name, package)

    monkeypatch.setattr(importlib.util, "find_spec", absent)
    with pytest.raises(NotInstalled, match=r"one package more: .*spatial"):
        check_installed()
    try:
        status: object = main([word.format(new=tmp_path / "run.mcap") for word in words])
    except SystemExit as left:
        status = left.code
    captured = capsys.readouterr()
    assert (status, captured.out) == (2, "")
    assert "tilth[spatial]" in captured.err or "--extra spatial" in captured.err
    assert list(tmp_path.iterdir()) == []


def test_the_demo_is_not_guided_in_space(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demo", "--spatial", "--guidance"]) == 2
    assert "leave out --spatial" in capsys.readouterr().err
