"""What follows from scale and tape, beside rigs whose numbers are known."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tilth.schemas.axle_loads import axle_loads
from tilth.schemas.machine import Implement, Tractor
from tilth.schemas.rule_of_thumb import (
    DRAWING,
    IMPLEMENT_SHARE,
    TRACTOR_SHARE,
    Lengths,
    Weights,
    by_scale,
    yaw_inertia,
)
from tilth.schemas.spread import WITHIN
from tilth.simulator.fleet import drawn

LONG = st.floats(1.0, 6.0)
G = 9.81
SECTIONS = {"tractor": Tractor, "implement": Implement}


@given(a=LONG, b=LONG, behind=st.floats(0.3, 1.5), d=LONG, e=st.floats(0.05, 0.9), tons=LONG)
def test_a_scale_and_a_tape_give_the_rig_back(
    a: float, b: float, behind: float, d: float, e: float, tons: float
) -> None:
    mass_t, mass_i = 2000 * tons, 1500 * tons
    front, rear, _ = axle_loads(a, b, b + behind, d, e, mass_t, 1e-9, G)
    *_, axle = axle_loads(a, b, b + behind, d, e, mass_t, mass_i, G)
    weights = Weights(front / G, rear / G, axle / G, mass_i - axle / G)
    found = by_scale(weights, Lengths(a + b, behind, d + e))
    wanted = {
        "tractor": {"a": a, "b": b, "c": b + behind, "mass": mass_t},
        "implement": {"d": d, "e": e, "mass": mass_i},
    }
    for section, keys in wanted.items():
        for key, value in keys.items():
            assert found[section][key].value == pytest.approx(value, rel=2e-3, abs=2e-3), key
            assert found[section][key].sd > 0.0
            assert key in SECTIONS[section].model_fields  # of the machine file


def test_the_rule_holds_for_the_fleet_that_tests_are_drawn_from() -> None:
    """95 % intervals, of tractors and towed bodies."""
    inside = []
    for rig in map(drawn, range(100)):
        tractor, implement = rig.tractor, rig.implement
        bodies = (
            (tractor.mass, tractor.a + tractor.b, TRACTOR_SHARE, tractor.yaw_inertia),
            (implement.mass, implement.d + implement.e, IMPLEMENT_SHARE, implement.yaw_inertia),
        )
        for mass, length, share, truth in bodies:
            rule = yaw_inertia(mass, length, share)
            inside.append(abs(rule.value - truth) < WITHIN * rule.sd)
    assert sum(inside) > 0.9 * len(inside)


def test_the_drawing_names_every_length() -> None:
    assert all(f" {name} " in DRAWING for name in "abcd") and "-e-" in DRAWING
    assert max(map(len, DRAWING.splitlines())) < 78
