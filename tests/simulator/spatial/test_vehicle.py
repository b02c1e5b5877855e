"""What the rig in space is made of: as given, nominal or drawn."""

import numpy as np
import pytest

from tilth.schemas.axle_loads import axle_loads
from tilth.simulator.scenario import CannotBeDriven, Scenario, Spatial, parse_scenario
from tilth.simulator.spatial import vehicle as v

RIG = v.Masses(1.7, 1.2, 2.1, 3.62, 0.1, 9391.0, 2127.0, 35709.0, 6402.0, 1.1, 1.2)


def made(spatial: Spatial, seed: int = 1) -> v.Vehicle:
    return v.vehicle_of(RIG, Scenario(plant="spatial", spatial=spatial), np.random.default_rng(seed))


def test_nothing_told_is_nominal() -> None:
    one = made(Spatial())
    assert (one.stiffness, one.pin_height, one.track) == (v.STIFFNESS, 0.75, v.TRACK)
    assert (one.tyre, one.relaxation, one.camber_thrust, one.rms) == ("exponential", "first_order", 0.0, 0.0)
    assert one == made(Spatial(), seed=2)
    assert one.grip == Scenario().soil.grip


def test_draws_are_of_the_seed_and_within_their_ends() -> None:
    many = [made(Spatial(draw=True), seed) for seed in range(40)]
    assert many[3] == made(Spatial(draw=True), 3) != many[4]
    assert {one.tyre for one in many} == {"exponential", "tanh", "brush", "magic"}
    assert {one.relaxation for one in many} == {"first_order", "string"}
    for name in ("pin_height", "hitch_height", "load_exponent", "camber_thrust", "grip", "rms"):
        low, high = v.DRAWN[name]
        values = [getattr(one, name) for one in many]
        assert (
            low <= min(values) < low + 0.2 * (high - low) and high - 0.2 * (high - low) < max(values) <= high
        )
    factors = [one.stiffness[1] / v.STIFFNESS[1] for one in many]
    assert 0.7 <= min(factors) < 0.9 and 1.3 < max(factors) <= 1.5
    # Front and implement tyres are others than the rear ones.
    low, high = v.OWN_STIFFNESS
    for k in (0, 2):
        own = [one.stiffness[k] / v.STIFFNESS[k] / factor for one, factor in zip(many, factors, strict=True)]
        assert low <= min(own) < 0.85 and 1.2 < max(own) <= high


def test_what_is_told_is_not_drawn_and_changes_no_other_draw() -> None:
    given = parse_scenario(
        'plant = "spatial"\nground = { rms = 0.0 }\n[spatial]\ndraw = true\npin_height = 0.3\ntyre = "brush"'
    )
    one, other = (
        v.vehicle_of(RIG, s, np.random.default_rng(5))
        for s in (given, Scenario(plant="spatial", spatial=Spatial(draw=True)))
    )
    assert (one.pin_height, one.tyre, one.rms) == (0.3, "brush", 0.0)
    assert one._replace(pin_height=other.pin_height, tyre=other.tyre, rms=other.rms) == other


def test_static_loads_are_those_of_the_layer_below() -> None:
    given = axle_loads(*RIG[:7], v.GRAVITY)
    assert v.static_loads(made(Spatial())) == pytest.approx(given)
    assert sum(v.static_loads(made(Spatial()))) == pytest.approx(v.GRAVITY * (RIG.m_t + RIG.m_i))


def test_drawn_rigs_stand_and_their_steps_are_short_enough() -> None:
    for seed in range(200):
        v.check_tyres(made(Spatial(draw=True), seed), 0.0025)


@pytest.mark.parametrize(
    ("spatial", "step", "told"),
    [
        (
            Spatial(vertical_stiffness=(20e3, 20e3, 20e3)),
            0.002,
            r"vertical_stiffness\[2\] = 20000 N/m .*40000",
        ),
        (Spatial(vertical_stiffness=(1e5, 1e5, 20e3), track=(2, 2, 1)), 0.002, r"\[3\] .* the implement"),
        (
            Spatial(vertical_stiffness=(5e6, 5e6, 5e6)),
            0.002,
            r"front tyres .* spatial\.step = 0\.00091, or smaller",
        ),
        (
            Spatial(vertical_stiffness=(20e6, 20e6, 20e6), vertical_damping=(2e6, 0, 0)),
            0.0002,
            "0002 s; give smaller",
        ),
        (Spatial(vertical_damping=(0, 0, 2e5)), 0.002, r"implement's tyres .*vertical_damping\[3\]"),
    ],
)
def test_tyres_that_do_not_hold_the_rig_are_refused(spatial: Spatial, step: float, told: str) -> None:
    with pytest.raises(CannotBeDriven, match=told):
        v.check_tyres(made(spatial), step)


def test_tyres_axle_and_suspension_are_as_told() -> None:
    one = made(Spatial(radius=(0.5, 0.8, 0.6), axle_mass=700.0, suspension=(250e3, 9e3)))
    assert (one.radius, one.beam_mass, one.suspension) == ((0.5, 0.8, 0.6), 700.0, (250e3, 9e3))
    assert v.wheel_places(one)[:, 2] == pytest.approx(np.repeat([0.6, 0.3, 0.6], 2))
    plain = made(Spatial())
    assert (plain.radius, plain.suspension) == (v.RADIUS, (0.0, 0.0))
    assert plain.beam_mass == pytest.approx(0.07 * RIG.m_t)
