"""What the implement carries: said by the operator or a scale, or by nobody; replayed, stored, resumed."""

import math
from dataclasses import replace

import numpy as np
import pytest
from logs import MACHINE, MACHINE_TEXT
from numpy.typing import NDArray

from tilth.estimator import fold, implement_load
from tilth.estimator.filters import soil_change, unknowns
from tilth.estimator.filters.unknowns import AT
from tilth.estimator.methods.carrying import open_up
from tilth.estimator.models.load import aged, by_another_load, laden, of_nobody, of_scale
from tilth.estimator.models.parameters import rig_of, static_loads
from tilth.estimator.snapshot import restore, snapshot
from tilth.schemas.can_id import join
from tilth.schemas.carried import said_of_load
from tilth.schemas.flow import Carried, Event, EventKind, Frame, LoadSource, Weight
from tilth.schemas.machine import Machine, MachineError
from tilth.schemas.machine_toml import parse_machine
from tilth.schemas.pgn_table import row

S = 1_000_000_000
CART = "\n[implement.load]\nmass = 6000\nahead_of_axle = 0.1\nheight = 1.2\nlength = 5.3\nwidth = 2.8\n"
FULL = Carried(1, 6000.0, 300.0, LoadSource.OPERATOR)
EMPTY = Carried(1, 0.0, 60.0, LoadSource.OPERATOR)


@pytest.fixture(scope="module")
def cart() -> Machine:
    return parse_machine(TEXT + CART)


TEXT = MACHINE_TEXT


def weight(t_ns: int, carried: float | None, whole: float | None = None) -> Frame:
    said = {"carried_mass_kg": carried, "whole_mass_kg": whole}
    data = row(65258).encode({key: value for key, value in said.items() if value is not None})
    return Frame(t_ns, t_ns, "can0", join(7, 65258, 0x40), True, False, data)


def test_the_laden_rig_is_heavier_and_its_tyres_follow(cart: Machine) -> None:
    full = laden(cart, FULL)
    own = cart.implement.mass.value
    assert full.implement.mass.value == pytest.approx(own + 6000.0)
    assert full.implement.yaw_inertia.value > cart.implement.yaw_inertia.value
    heavier = np.divide(static_loads(rig_of(full)), static_loads(rig_of(cart)))
    for axle, factor in zip(("front", "rear", "implement"), heavier, strict=True):
        before, after = (getattr(m.tyres, axle).cornering_stiffness for m in (cart, full))
        assert after == pytest.approx(before * factor**0.8)
    assert laden(MACHINE, FULL) is MACHINE  # its file knows of no load


@pytest.mark.parametrize(
    ("text", "mass"),
    [
        ("full", 6000.0),
        ("empty", 0.0),
        ("half", 3000.0),
        ("6.2 t", 6200.0),
        ("5,5t", 5500.0),
        ("900 kg", 900.0),
    ],
)
def test_what_an_operator_says(cart: Machine, text: str, mass: float) -> None:
    said = said_of_load(cart, text, 7)
    assert isinstance(said, Carried)
    assert (said.t_ns, said.mass, said.source) == (
        7,
        pytest.approx(mass),
        LoadSource.OPERATOR,
    ) and said.sd > 0.0


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("8.2 t", "8.2 t is more than it carries when it is full (6.0 t), and than its tyres are meant for"),
        ("6200", "6200 is no load: say full, half, empty, unknown, or a mass with its unit"),
        ("-1 t", "-1 t is no load"), ("nan t", "nan t is no load"), ("1e9 kg", "1e9 kg is no load"),
    ],
)  # fmt: skip
def test_what_cannot_be_a_load(cart: Machine, text: str, words: str) -> None:
    said = said_of_load(cart, text, 1)
    assert isinstance(said, str) and words in said


def test_an_implement_that_carries_nothing(cart: Machine) -> None:
    said = said_of_load(MACHINE, "full", 1)
    assert isinstance(said, str) and "add [implement.load] with mass" in said
    assert fold.initial(MACHINE).carried is None
    assert not by_another_load(MACHINE).any()


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("mass", "0", "give what it carries when it is full"),
        ("mass", "-3", "give what it carries when it is full"),
        ("exponent", "3", "tyres have 0.6 to 1"),
    ],
)
def test_files_that_cannot_be(key: str, value: str, words: str) -> None:
    lines = [line for line in CART.splitlines() if not line.startswith(key)]
    with pytest.raises(MachineError, match=words):
        parse_machine(TEXT + "\n".join([*lines, f"{key} = {value}"]))


def test_a_word_ages_until_all_is_possible(cart: Machine) -> None:
    own = cart.implement.mass.value
    sds = [aged(cart, FULL, seconds).sd / (own + 6000.0) for seconds in (0.0, 60.0, 600.0, 6e5)]
    assert sds == sorted(sds) and sds[0] == pytest.approx(300.0 / (own + 6000.0))
    widest = math.log1p(6000.0 / own)
    assert sds[-1] == pytest.approx(widest / math.sqrt(3.0))  # of anything up to it, about the full one
    nobody = of_nobody(cart, 1)
    assert nobody is not None
    assert aged(cart, nobody, 6e5).sd == pytest.approx(nobody.sd)  # was as wide as can be


@pytest.mark.parametrize(
    ("whole", "content", "mass"),
    [(None, 3000.0, 3000.0), (5127.0, None, 3000.0), (9000.0, 2500.0, 2500.0), (2100.0, None, 0.0),
     (1000.0, None, None), (None, 9000.0, None), (None, None, None)],
)  # fmt: skip
def test_a_scale(cart: Machine, whole: float | None, content: float | None, mass: float | None) -> None:
    assert of_scale(cart, whole, content) == (mass if mass is None else pytest.approx(mass))


def known(state: fold.State, name: str) -> NDArray[np.float64]:
    """Puts in that a method knows C_ai well; its mean."""
    method = state.estimators[name]
    method.mean[2] += 0.3
    method.covariance[2, :] = method.covariance[:, 2] = 0.0
    method.covariance[2, 2] = 0.08**2
    return np.array(method.mean)


@pytest.mark.parametrize("name", ["tracker", "pem", "rows"])
def test_what_was_learned_moves_with_the_load(cart: Machine, name: str) -> None:
    state = fold.initial(cart, (), FULL)
    before, method = known(state, name), state.estimators[name]
    fold.carry_load(state, replace(EMPTY, t_ns=S))
    moved = method.mean - before
    loads = np.log(static_loads(rig_of(state.machine))) - np.log(static_loads(rig_of(laden(cart, FULL))))
    np.testing.assert_allclose(moved[:3], 0.8 * loads, atol=1e-9)
    of_mass = (
        0.0
        if name == "tracker"
        else (state.machine.implement.mass.sd / state.machine.implement.mass.value) ** 2
    )
    sd = math.sqrt(method.covariance[2, 2] - of_mass)
    assert sd == pytest.approx(math.hypot(0.08, 0.15 * loads[2]), rel=0.02)
    np.testing.assert_array_equal(method.prior_mean, unknowns.prior(state.machine)[0])
    assert np.linalg.eigvalsh(method.covariance)[0] > -1e-12
    assert method.covariance[AT["roll_k_i"], AT["roll_k_i"]] == pytest.approx(
        method.prior_sd[AT["roll_k_i"]] ** 2
    )


def test_nobody_knows_c_ai_but_c_ai_over_the_mass(cart: Machine) -> None:
    state = fold.initial(cart)
    for name in ("tracker", "pem"):
        known(state, name)
        state.estimators[name].informed_ns = S
    state.diagnosis.consistency.confirmed = True
    made = implement_load.known_now(
        state, 2 * S, fold.ROW["tracker"].estimate(state.estimators["tracker"], state.machine, 2 * S)
    )
    assert made.per_mass[2] is not None and made.per_mass_sd[2] is not None
    assert made.per_mass_sd[2] / made.per_mass[2] < 0.25
    assert made.parameters[2].value is None
    assert made.parameters[2].reason is not None and made.parameters[2].reason.code == "of_the_mass"


def test_a_load_that_nobody_says_opens_up(cart: Machine) -> None:
    state = fold.initial(cart, (), FULL)
    for name in ("tracker", "pem", "rows"):
        known(state, name)
        before = state.estimators[name].covariance.copy()
        open_up(state.estimators[name], state.machine, 0.5)
        grown = state.estimators[name].covariance - before
        assert grown[2, 2] > 0.02 and abs(grown[:2, :2]).max() < 1e-9
        assert np.diag(state.estimators[name].covariance)[:6].max() < 0.8


def test_a_scale_is_used_when_it_says_another_load(cart: Machine) -> None:
    state = fold.initial(cart)
    first = fold.step(state, weight(S, 6000.0))
    assert [p.value.notice.code for p in first if isinstance(p.value, Event)] == ["load_told"]
    assert state.carried is not None and state.carried.source is LoadSource.SCALE
    assert any(isinstance(p.value, Weight) for p in first)
    quiet = fold.step(state, weight(2 * S, 5950.0))
    assert not [p for p in quiet if isinstance(p.value, Event)]
    masses = []
    for k in range(70):
        fold.step(state, weight((3 + k) * S, max(6000.0 - 400.0 * k, 0.0)))
        masses.append(state.machine.implement.mass.value)
    assert masses[-1] == pytest.approx(cart.implement.mass.value, rel=0.06) and masses == sorted(
        masses, reverse=True
    )
    fold.step(state, weight(73 * S, None, 1000.0))  # less than the empty implement
    assert state.rejected["out_of_range"] == 1


def test_stored_state_goes_on(cart: Machine) -> None:
    state = fold.initial(cart)
    fold.carry_load(state, replace(FULL, t_ns=S))
    fold.step(state, weight(2 * S, 5000.0))
    again = restore(cart, snapshot(state))
    assert again.machine == state.machine and again.carried == state.carried and again.empty == state.empty
    assert snapshot(again) == snapshot(state)


def test_another_load_is_told_from_other_soil(cart: Machine) -> None:
    known_before = np.diag([0.08, 0.08, 0.08, 0.2, 0.2, 0.2]) ** 2
    after, none = known_before / 4.0, np.zeros((6, 6))
    by_load = by_another_load(laden(cart, FULL))
    sure = soil_change.SOIL_CHANGE.sure
    for moved, side in (([0.0, 0.0, 0.4], 0), ([0.35, 0.4, 0.4], -1), ([-0.5, -0.5, -0.45], -1)):
        mean = np.array([*moved, 0.0, 0.0, 0.0]) * 0.75
        found = soil_change.odds((np.zeros(6), known_before), (mean, after), by_load, none)
        assert max(found) > soil_change.SOIL_CHANGE.loaded
        assert (found.of_load < -sure) == (side < 0)
        assert found.of_load < sure  # the implement may stand on other soil alone: then both stay open
    still = soil_change.odds((np.zeros(6), known_before), (np.full(6, 0.02), after), by_load, none)
    assert max(still) < 0.0


def test_a_run_that_comes_back_later_knows_less(cart: Machine) -> None:
    soon, late = (implement_load.later(cart, FULL, seconds, 9 * S) for seconds in (10.0, 7 * 86_400.0))
    assert soon is not None and late is not None
    assert soon.mass == late.mass == 6000.0 and soon.t_ns == 9 * S and soon.sd < 900.0 < late.sd
    assert implement_load.later(MACHINE, FULL, 1.0, 1) is None


def test_an_event_of_the_load_is_one(cart: Machine) -> None:
    out = fold.carry_load(fold.initial(cart), replace(FULL, t_ns=S))
    (event,) = (p.value for p in out if isinstance(p.value, Event))
    assert event.kind == EventKind.LOAD and event.notice.values["mass_t"] == 6.0
