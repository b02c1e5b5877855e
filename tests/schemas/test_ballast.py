"""Ballast of the machine file: counted in once, by moments and Steiner's theorem, and taken out again."""

import tomllib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from logs import MACHINE, MACHINE_TEXT

from tilth.estimator.filters.unknowns import AT, prior
from tilth.estimator.models.parameters import rig_of, static_loads
from tilth.estimator.models.roll_stiffness import nominal_roll
from tilth.schemas.axle_loads import axle_loads
from tilth.schemas.ballast import as_driven, as_told
from tilth.schemas.machine import Ballast, Machine, MachineError, Quantity
from tilth.schemas.machine_difference import differing_keys
from tilth.schemas.machine_toml import parse_machine
from tilth.schemas.plausible import GRAVITY, unusual
from tilth.simulator.scenario import Scenario
from tilth.simulator.tractor import setting_of

FRONT = "[[tractor.ballast]]\nmass = 600\nahead_of_axle = 4.1\nheight = 0.9\n"
TANK = """
[[implement.ballast]]
mass = { value = 6000, sd = 600 }
ahead_of_axle = 0.3
height = 1.8
length = 3.5
width = 2.0
"""


def told(*ballast: str) -> Machine:
    return parse_machine("\n".join([MACHINE_TEXT, *ballast]))


masses = st.floats(0.0, 3000.0)
lists = st.lists(
    st.builds(
        lambda mass, sd, ahead, ahead_sd, height, length: Ballast(
            mass=Quantity(value=mass, sd=sd * mass), ahead_of_axle=Quantity(value=ahead, sd=ahead_sd),
            height=Quantity(value=height, sd=0.05), length=length,
        ),
        masses, st.floats(0.0, 0.5), st.floats(-1.0, 4.0), st.floats(0.0, 0.3), st.floats(0.3, 2.0),
        st.floats(0.0, 4.0),
    ),
    max_size=3,
)  # fmt: skip


def carrying(tractor: list[Ballast], implement: list[Ballast]) -> Machine:
    return MACHINE.model_copy(
        update={
            "tractor": MACHINE.tractor.model_copy(update={"ballast": tractor}),
            "implement": MACHINE.implement.model_copy(update={"ballast": implement}),
        }
    )


@given(lists, lists)
def test_what_was_told_comes_back(tractor: list[Ballast], implement: list[Ballast]) -> None:
    machine = carrying(tractor, implement)
    assert as_told(as_driven(machine)) == machine


@given(lists, lists)
def test_every_ballast_stands_on_the_axles_by_its_lever(
    tractor: list[Ballast], implement: list[Ballast]
) -> None:
    machine = as_driven(carrying(tractor, implement))
    t, i, bare = machine.tractor, machine.implement, MACHINE
    length = i.d.value + i.e.value
    axle = GRAVITY * bare.implement.mass.value * bare.implement.d.value / length
    tongue = GRAVITY * bare.implement.mass.value * bare.implement.e.value / length
    for each in implement:
        tongue += GRAVITY * each.mass.value * each.ahead_of_axle.value / length
        axle += GRAVITY * each.mass.value * (1.0 - each.ahead_of_axle.value / length)
    front = bare.tractor.b.value * bare.tractor.mass.value * GRAVITY
    front += sum(GRAVITY * each.mass.value * each.ahead_of_axle.value for each in tractor)
    front = (front - (bare.tractor.c.value - bare.tractor.b.value) * tongue) / bare.tractor.wheelbase
    loads = axle_loads(
        t.a.value, t.b.value, t.c.value, i.d.value, i.e.value, t.mass.value, i.mass.value, GRAVITY
    )
    assert (loads[0], loads[2]) == pytest.approx((front, axle))
    assert t.wheelbase == pytest.approx(bare.tractor.wheelbase)
    for receiver, before in zip(machine.receiver, bare.receiver, strict=True):  # bolted to the body
        forward, up = receiver.position[0], receiver.position[2]
        if receiver.mount.body == "tractor":
            assert forward + t.b.value == pytest.approx(before.position[0] + bare.tractor.b.value)
        else:
            assert forward + i.e.value == pytest.approx(before.position[0] + bare.implement.e.value)
        assert up == before.position[2]


@given(lists)
def test_in_parts_or_at_once_is_the_same(tractor: list[Ballast]) -> None:
    machine = as_driven(carrying(tractor, []))
    for each in tractor:
        one = as_driven(carrying([each], []))
        rest = as_driven(
            one.model_copy(
                update={
                    "tractor": one.tractor.model_copy(
                        update={"ballast": [other for other in tractor if other is not each]}
                    )
                }
            )
        )
        for key in ("mass", "a", "b", "c", "cg_height", "yaw_inertia"):
            assert getattr(rest.tractor, key).value == pytest.approx(getattr(machine.tractor, key).value)


def test_a_dumb_bell() -> None:
    """Two equal masses 2 m apart and 1 m above each other: by hand."""
    mass = MACHINE.tractor.mass.value
    ballast = Ballast.model_validate(
        {
            "mass": {"value": mass, "sd": 0.1 * mass},
            "ahead_of_axle": {"value": MACHINE.tractor.b.value + 2.0, "sd": 0.4},
            "height": MACHINE.tractor.cg_height.value + 1.0,
        }
    )
    t = as_driven(carrying([ballast], [])).tractor
    assert (t.mass.value, t.mass.sd) == pytest.approx((2 * mass, 0.1 * mass))
    assert t.b.value == pytest.approx(MACHINE.tractor.b.value + 1.0)
    assert t.cg_height.value == pytest.approx(MACHINE.tractor.cg_height.value + 0.5)
    assert t.yaw_inertia.value == pytest.approx(MACHINE.tractor.yaw_inertia.value + 2 * mass)
    # half of 0.4 m, half of the file's own, and a tenth of half of the metre to the common CG
    assert t.cg_sd == pytest.approx(np.hypot(np.hypot(0.2, MACHINE.tractor.cg_sd / 2), 0.05))


def test_sds_are_those_of_draws() -> None:
    """Of a tank that nobody has weighed, on a cart that nobody has either: against a thousand draws."""
    rng = np.random.default_rng(1)
    text = TANK.replace("sd = 600", "sd = 900").replace("= 0.3", "= { value = 0.8, sd = 0.2 }")
    raw = tomllib.loads("\n".join([MACHINE_TEXT, text]))
    raw["implement"]["mass"] = {"value": 2000.0, "sd": 400.0}
    raw["implement"]["cg_sd"] = 0.1
    machine = Machine.model_validate(raw)
    total, cart, tank = as_driven(machine).implement, machine.implement, machine.implement.ballast[0]

    def draw(told: Quantity) -> Quantity:
        return Quantity(value=told.value + told.sd * rng.standard_normal())

    found = []
    for _ in range(2000):
        e = Quantity(value=cart.e.value + cart.cg_sd * rng.standard_normal())
        drawn = tank.model_copy(
            update={"mass": draw(tank.mass), "ahead_of_axle": draw(tank.ahead_of_axle), "height": tank.height}
        )
        own = {"mass": draw(cart.mass), "e": e, "yaw_inertia": draw(cart.yaw_inertia), "ballast": [drawn]}
        one = as_driven(machine.model_copy(update={"implement": cart.model_copy(update=own)})).implement
        found.append((one.mass.value, one.e.value, one.yaw_inertia.value))
    sd = np.std(found, axis=0)
    assert sd == pytest.approx([total.mass.sd, total.cg_sd, total.yaw_inertia.sd], rel=0.1)


def test_all_that_computes_has_the_totals() -> None:
    plain, machine = MACHINE, told(FRONT, TANK)
    rig, before = rig_of(machine), rig_of(plain)
    assert (rig.m_t, rig.m_i) == (before.m_t + 600, before.m_i + 6000)
    assert static_loads(rig)[0] > static_loads(before)[0] and rig.I_t > before.I_t + 600 * 2.6**2
    assert rig.h_i > before.h_i and nominal_roll(machine).j_i > nominal_roll(plain).j_i
    assert prior(machine)[1][AT["m_i"]] > 0.05
    # Nobody has told how high the CG is: what is known of the weights' height does not tell it.
    assert prior(machine)[1][AT["roll_cg_t"]] == prior(plain)[1][AT["roll_cg_t"]]
    driven = setting_of(machine, 1, 1.0, Scenario()).rig
    assert driven.m_i == pytest.approx(rig.m_i, rel=0.3) and driven.m_i > 2 * before.m_i


def test_a_file_without_ballast_is_as_it_was() -> None:
    assert as_driven(MACHINE) is MACHINE and as_told(MACHINE) is MACHINE


def test_a_change_of_the_ballast_is_the_one_key_that_differs() -> None:
    assert differing_keys(told(FRONT), told(FRONT.replace("0.9", "0.8"))) == ("tractor.ballast[1].height",)


@pytest.mark.parametrize(
    ("ballast", "words"),
    [
        (FRONT.replace("600", "-600"), ("tractor.ballast[1].mass = -600 kg", "not below zero")),
        (FRONT.replace("600", "12000"), ("12000 kg in all", "tractor.mass = 9391 kg", "at most 1 times")),
        (FRONT.replace("4.1", "4100"), ("tractor.ballast[1].ahead_of_axle", "4.1 (4100 mm)")),
        (FRONT.replace("4.1", "-9"), ("tractor.ballast[1].ahead_of_axle = -9 m", "must be from")),
        (FRONT.replace("0.9", "90"), ("tractor.ballast[1].height = 90 m", "0.9 (90 cm)")),
        (TANK.replace("6000", "49000"), ("implement.ballast", "49000 kg in all", "at most 20 times")),
        (FRONT.replace("600", "6000").replace("4.1", "-3.4"), ("front axle", "off the ground", "ballast")),
        (FRONT.replace("height = 0.9", ""), ("tractor.ballast[1].height: missing", "above the ground")),
        (FRONT.replace("ahead_of_axle", "position"), ("tractor.ballast[1].position: no such key",)),
        (FRONT.replace("[[tractor.ballast]]", "[tractor.ballast]"), ("give [[tractor.ballast]]",)),
    ],
)  # fmt: skip
def test_what_cannot_be_is_said(ballast: str, words: tuple[str, ...]) -> None:
    with pytest.raises(MachineError) as error:
        told(ballast)
    for word in words:
        assert word in str(error.value), error.value


@pytest.mark.parametrize(
    ("ballast", "words"),
    [
        ("", ()),
        (FRONT, ()),
        (FRONT.replace("600", "0"), ()),  # nobody has hung any on
        (
            FRONT + FRONT.replace("600", "4500").replace("4.1", "1.0"),
            ("tractor.ballast: 5100 kg in all, to",),
        ),
        (FRONT.replace("4.1", "6.0"), ("tractor.ballast[1].ahead_of_axle = 6 m: rare",)),
    ],
)
def test_what_is_rare_is_said(ballast: str, words: tuple[str, ...]) -> None:
    found = unusual(told(ballast))
    assert len(found) == len(words)
    for text, word in zip(found, words, strict=True):
        assert text.startswith(word)


def test_the_front_axle_does_not_roll_with_the_tractor() -> None:
    def rolled(line: str) -> float:
        return nominal_roll(parse_machine(MACHINE_TEXT.replace("[tractor]\n", f"[tractor]\n{line}\n"))).j_t

    usual = 0.07 * MACHINE.tractor.mass.value
    assert rolled(f"front_axle_mass = {usual}") == pytest.approx(nominal_roll(MACHINE).j_t)
    heavy = rolled(f"front_axle_mass = {2 * usual}")
    assert 0.93 < heavy / nominal_roll(MACHINE).j_t < 0.97
    with pytest.raises(MachineError, match=r"front_axle_mass = 5000 kg: that is 0.53 of the tractor's mass"):
        rolled("front_axle_mass = 5000")
