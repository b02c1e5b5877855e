"""The virtual fleet: rigs as farms have them, files as a careful owner writes them, and that they drive."""

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from typing import Literal

import numpy as np
import pytest

from tilth.estimator.models.parameters import rig_of
from tilth.schemas.machine import Machine, Quantity
from tilth.schemas.machine_toml import parse_machine
from tilth.schemas.plausible import unusual
from tilth.simulator import fleet
from tilth.simulator.drive import drive
from tilth.simulator.fleet import FleetRig, drawn, ground_of, scenario_of
from tilth.simulator.fleet_files import NMEA_2000, owners_text, true_machine
from tilth.simulator.fleet_ranges import CHANCES, IMPLEMENTS, RANGES, TRACTORS
from tilth.simulator.receivers import star_fire_like
from tilth.simulator.scenario import DrivenManoeuvre, Scenario, as_json, from_json
from tilth.simulator.spatial.engine import check_inertia
from tilth.simulator.spatial.vehicle import GRAVITY, check_tyres, static_loads, vehicle_of

MANY = [drawn(seed) for seed in range(150)]
RANDOM = Scenario(steering=DrivenManoeuvre("random", 6.0), other_traffic=False)


def test_every_range_is_one_with_a_source() -> None:
    for row in (*RANGES, *CHANCES):
        assert row.low <= row.high and row.unit and row.source, row
    names = [(row.of, row.name) for row in (*RANGES, *CHANCES)]
    assert len(set(names)) == len(names)
    assert all(row.low < row.high for row in RANGES)
    assert all(0.0 <= row.low == row.high <= 1.0 for row in CHANCES)


def test_a_seed_is_one_rig() -> None:
    assert drawn(3) == MANY[3] != MANY[4]
    assert owners_text(drawn(3)) == owners_text(MANY[3])


def test_the_fleet_has_all_kinds_and_sizes() -> None:
    kinds = Counter((rig.tractor.kind, rig.implement.kind) for rig in MANY)
    assert len(kinds) == len(TRACTORS) * len(IMPLEMENTS)
    masses, towed = (np.array([getattr(rig, body).mass for rig in MANY]) for body in ("tractor", "implement"))
    assert 3e3 <= masses.min() < 3.6e3 and 13e3 < masses.max() < 15e3
    assert 1e3 <= towed.min() < 1.6e3 and 9e3 < towed.max() <= 12e3
    for having in (
        lambda rig: rig.tyres[1].twin_spacing > 0.0,
        lambda rig: rig.tractor.suspension is not None,
        lambda rig: rig.tractor.ballast[0] > 0.0,
        lambda rig: rig.implement.fill == 0.0,
        lambda rig: rig.implement.fill == 1.0,
    ):
        assert 8 < sum(map(having, MANY)) < 100


@pytest.mark.parametrize("rig", MANY[:60], ids=lambda rig: str(rig.seed))
def test_a_rig_stands_and_can_be_built(rig: FleetRig) -> None:
    vehicle = vehicle_of(rig.masses, scenario_of(rig, Scenario(plant="spatial")), np.random.default_rng(1))
    check_inertia(vehicle)
    check_tyres(vehicle, 0.002)
    loads = static_loads(vehicle)
    assert loads == pytest.approx([tyre.load for tyre in rig.tyres])
    assert loads[0] >= fleet.LEAST_FRONT * rig.tractor.mass * GRAVITY
    deflections = np.array(loads) / 2 / vehicle.stiffness
    assert deflections == pytest.approx([tyre.deflection for tyre in rig.tyres])
    coefficients = np.array([dict(rig.parameters)[name] for name in ("C_af", "C_ar", "C_ai")]) / loads
    assert coefficients.min() > 1.5 and coefficients.max() < 14.0


def test_ballast_ahead_moves_the_cg_forward_and_adds_yaw_inertia() -> None:
    for rig in MANY:
        t = rig.tractor
        weights, ahead = t.ballast
        if weights:
            bare = t.mass - weights
            moment = t.mass * t.b - weights * (t.a + t.b + ahead)
            assert 0.355 < moment / bare / (t.a + t.b) < 0.445  # the bare tractor's share in front
            radius = math.sqrt(t.yaw_inertia / t.mass) / (t.a + t.b)
            assert radius > 0.55


def _owner(rig: FleetRig) -> Machine:
    return parse_machine(owners_text(rig))


LENGTHS: dict[str, tuple[Callable[[Machine], Quantity], float]] = {
    "a": (lambda m: m.tractor.a, 0.01),
    "e": (lambda m: m.implement.e, 0.01),
    "h_i": (lambda m: m.implement.cg_height, 0.04),
}
SHARES: dict[str, tuple[Callable[[Machine], Quantity], float, float]] = {
    "m_t": (lambda m: m.tractor.mass, 0.01, 0.01),
    "m_i": (lambda m: m.implement.mass, 0.04, 0.05),
    "I_i": (lambda m: m.implement.yaw_inertia, 0.05, 0.05),
}
"""Of each number of the file: errors, and shares of it with what is told."""


def test_the_owner_errs_by_what_he_tells() -> None:
    off: dict[str, list[float]] = {}
    for rig in MANY:
        true, told = true_machine(rig), _owner(rig)
        assert not [text for text in unusual(told) if not text.startswith("tyres.implement")]  # empty ones
        for name, (of, sd) in LENGTHS.items():
            off.setdefault(name, []).append((of(told).value - of(true).value) / sd)
            assert (of(told).sd, of(true).sd) == (sd, 0.0)
        for name, (of, is_, said) in SHARES.items():
            off.setdefault(name, []).append((of(told).value / of(true).value - 1) / is_)
            assert of(told).sd == pytest.approx(said * of(told).value, rel=1e-3)
        places = np.subtract([r.position for r in told.receiver], [r.position for r in true.receiver])
        off.setdefault("places", []).extend((places / 0.01).ravel().tolist())
    for name, errors in off.items():
        assert np.std(errors) == pytest.approx(1.0, abs=0.15), name
        assert abs(np.mean(errors)) < 0.3, name


def test_an_exact_file_has_the_true_numbers_and_the_owners_sds() -> None:
    rig = MANY[5]
    exact, true, told = parse_machine(owners_text(rig, exact=True)), true_machine(rig), _owner(rig)
    assert exact.tractor.a.value == true.tractor.a.value != told.tractor.a.value
    assert exact.tractor.a.sd == told.tractor.a.sd > 0.0
    assert [r.position for r in exact.receiver] == [r.position for r in true.receiver]


def test_the_driven_machine_is_the_true_one_and_the_file_has_no_draw_left() -> None:
    rig = MANY[5]
    scenario = scenario_of(rig, RANDOM)
    truth = drive(true_machine(rig), 1, 0.5, scenario)
    assert truth.geometry == pytest.approx(rig_of(true_machine(rig)).geometry, rel=1e-12)
    assert truth.parameters == pytest.approx(rig.parameters)
    told = truth.nuisances
    assert told["wheel_zero"] == pytest.approx(math.radians(rig.wheel.zero_deg or 0.0))
    assert {told[key] for key in told if key.startswith(("pair", "cg", "forward", "right"))} == {0.0}
    assert truth.rig.w_r == pytest.approx(rig.tyres[1].spring_track)


def test_receivers_are_of_the_make_asked_for() -> None:
    assert all(star_fire_like(r) for r in true_machine(MANY[0]).receiver)
    assert not any(star_fire_like(r) for r in true_machine(MANY[0], NMEA_2000).receiver)


def test_dual_wheels_hold_a_body_as_their_four_springs_do() -> None:
    tyre = next(rig.tyres[1] for rig in MANY if rig.tyres[1].twin_spacing)
    each = tyre.stiffness / 2
    places = np.array([tyre.track / 2, tyre.track / 2 + tyre.twin_spacing])
    assert 2 * each * (places**2).sum() == pytest.approx(tyre.stiffness * tyre.spring_track**2 / 2)


@pytest.mark.parametrize("seed", [0, 7])
@pytest.mark.parametrize("plant", ["planar", "spatial"])
def test_a_rig_of_the_fleet_can_be_driven(plant: Literal["planar", "spatial"], seed: int) -> None:
    if plant == "spatial":
        pytest.importorskip("mujoco", reason="needs the extra `spatial`")
    rig = MANY[seed]
    base = replace(RANDOM, plant=plant, ground=ground_of(plant, 0.01, 3.0), speed=rig.speed)
    scenario = scenario_of(rig, base)
    assert from_json(as_json(scenario)) == scenario
    truth = drive(true_machine(rig), seed, 8.0, scenario)
    assert np.abs(truth.tractor.roll).max() < math.radians(10.0)
    assert truth.tractor.forward_velocity.mean() == pytest.approx(rig.speed, rel=0.1)


def test_every_other_owner_tells_what_a_file_need_not_have() -> None:
    """As far as the machine file has keys for it; what else he tells is the same."""
    for rig in MANY[:40]:
        machine = parse_machine(owners_text(rig))
        for tyre, true in zip((machine.tyres.front, machine.tyres.rear), rig.tyres, strict=False):
            for key in ("track", "deflection"):
                told = getattr(tyre, key, None)
                assert told is None or told.value == pytest.approx(getattr(true, key), abs=0.03)
