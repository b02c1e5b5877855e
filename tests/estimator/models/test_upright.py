"""How a rig stands on its tyres: what is told is used, what is not has an sd as wide as rigs are."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from logs import MACHINE, MACHINE_TEXT

from tilth.estimator.filters import priors, unknowns
from tilth.estimator.filters.rig_setup import rig_setup
from tilth.estimator.filters.unknowns import AT
from tilth.estimator.models.parameters import TABLE_5_1, rig_of, static_loads, upright_axles
from tilth.estimator.models.roll_stiffness import nominal_roll
from tilth.schemas.machine import Machine
from tilth.schemas.machine_toml import parse_machine


def told(front: str = "", rear: str = "", implement: str = "", tractor: str = "") -> Machine:
    """The packaged machine file with further lines in its sections."""
    text = MACHINE_TEXT
    for section, more in (
        ("tyres.front", front), ("tyres.rear", rear), ("tyres.implement", implement), ("tractor", tractor)
    ):  # fmt: skip
        text = text.replace(f"[{section}]\n", f"[{section}]\n{more}\n")
    return parse_machine(text)


def sd(machine: Machine, name: str) -> float:
    return float(unknowns.prior(machine)[1][AT[name]])


def test_deflection_and_track_are_the_roll_stiffness() -> None:
    machine = told(rear="track = 1.6\ndeflection = { value = 0.09, sd = 0.009 }", implement="track = 2.1")
    rig, loads = rig_of(machine), static_loads(rig_of(machine))
    assert (rig.w_r, rig.w_i, rig.w_f) == (1.6, 2.1, TABLE_5_1.w_f)
    expected = loads[1] / 0.09 * 0.8**2 - rig.g * rig.m_t * rig.h_t + 0.7 * loads[0]
    assert nominal_roll(machine).k_t == pytest.approx(expected, rel=1e-4)


def test_what_is_told_is_known_better() -> None:
    usual, exact = MACHINE, told("track = 1.9\ndeflection = 0.06", "track = 1.9\ndeflection = 0.06")
    by_size = told(rear='track = 1.9\nsize = "520/85R42"\npressure = 1.2')
    assert sd(usual, "roll_k_t") > 0.45 and sd(usual, "roll_front") > 0.45
    assert sd(exact, "roll_k_t") < sd(by_size, "roll_k_t") < 0.3
    assert sd(exact, "roll_front") < 0.3 and sd(exact, "roll_k_i") == sd(usual, "roll_k_i")
    heights = told(tractor="hitch_height = 0.62\npivot_height = { value = 0.8, sd = 0.01 }")
    assert (sd(heights, "roll_hitch"), sd(heights, "roll_pin")) == (0.03, 0.01)
    assert (rig_setup(heights).rig.h_h, rig_setup(heights).roll.pivot_height) == (0.62, 0.8)
    springs = told(tractor="suspended_front_axle = true")
    assert sd(springs, "roll_pin") > 2 * sd(usual, "roll_pin") and sd(springs, "roll_front") > 0.8
    lower = told(tractor="").tractor.cg_height
    assert lower.sd == 0.0 and sd(usual, "roll_cg_t") == priors.PRIOR.cg_height_sd


def test_dual_wheels_hold_more_of_the_roll() -> None:
    line = 'track = 1.9\nsize = "480/80R42"\npressure = 1.0\n'
    single, dual = (upright_axles(told(rear=more))[1] for more in (line, line + "dual_track = 3.1"))
    assert dual.track == pytest.approx(np.sqrt((1.9**2 + 3.1**2) / 2))
    assert dual.roll_stiffness == pytest.approx(single.roll_stiffness * (1.9**2 + 3.1**2) / 1.9**2)
    pressed = [upright_axles(told(rear=more))[1] for more in (
        "track = 1.9\ndeflection = 0.05", "track = 1.9\ndual_track = 3.1\ndeflection = 0.05"
    )]  # fmt: skip
    assert pressed[0].stiffness == pressed[1].stiffness  # the load over the deflection, on however many


@settings(max_examples=40)
@given(st.floats(0.04, 0.11), st.floats(1.5, 2.5), st.floats(0.03, 0.09), st.floats(1.6, 2.6))
def test_rigs_of_all_kinds_are_within_the_prior_of_a_file_that_tells_nothing(
    rear: float, track: float, towed: float, width: float
) -> None:
    like = told(
        rear=f"track = {track}\ndeflection = {rear}", implement=f"track = {width}\ndeflection = {towed}"
    )
    for name, key in (("roll_k_t", "k_t"), ("roll_k_i", "k_i")):
        away = np.log(getattr(nominal_roll(like), key) / getattr(nominal_roll(MACHINE), key))
        assert abs(away) < 3.0 * sd(MACHINE, name)
    assert nominal_roll(like).k_t > 0.0


def test_a_body_that_its_tyres_hardly_hold_still_has_a_stiffness() -> None:
    modes = nominal_roll(
        told(rear="track = 0.8\ndeflection = 0.3", implement="track = 0.8\ndeflection = 0.3")
    )
    assert modes.k_t > 0.0 and modes.k_i > 0.0 and np.isfinite(list(modes)).all()


def test_a_smaller_tractor_is_narrower() -> None:
    small = parse_machine(MACHINE_TEXT.replace("a = 1.7", "a = 1.1").replace("b = 1.2", "b = 0.9"))
    assert rig_of(small).w_r == pytest.approx(TABLE_5_1.w_r * np.sqrt(2.0 / 2.9))
    assert rig_of(small).w_i == TABLE_5_1.w_i
