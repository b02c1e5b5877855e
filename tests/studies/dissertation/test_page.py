"""docs/dissertation.md is what the code says, its figures are there, and the studies behind it hold."""

import math
import re
from xml.etree import ElementTree

import numpy as np
import pytest

from studies.dissertation import closed_loop, errata, open_loop
from studies.dissertation.closed_loop import (
    HEADING,
    SPEED,
    WIRINGS,
    as_printed,
    read_off,
    relaxation_gain,
    run,
    wired_poles,
    wired_run,
)
from studies.dissertation.compared import ComparedFigure, claim, figures, number, verdict
from studies.dissertation.figures import DRAWINGS
from studies.dissertation.page import COMMAND, DOCS, page, sections
from tilth.estimator.models.actuator import BOSSERD
from tilth.estimator.models.linear_analysis import dominant, steady_gains

NUMBER = re.compile(r"−?\d+(?:\.\d+)?(?:e-?\d+)?")


def differences(retained: str, made: str) -> list[str]:
    """Lines whose words differ, or a number by more than one in its last place."""
    found = []
    if retained.count("\n") != made.count("\n"):
        return ["another number of lines"]
    for one, two in zip(retained.splitlines(), made.splitlines(), strict=True):
        same = NUMBER.split(one) == NUMBER.split(two)
        pairs = zip(NUMBER.findall(one), NUMBER.findall(two), strict=False)
        if not same or not all(near(*pair) for pair in pairs):
            found.append(f"kept: {one}\nmade: {two}")
    return found


def near(one: str, two: str) -> bool:
    decimals = len(one.partition(".")[2])
    values = [float(text.replace("−", "-")) for text in (one, two)]
    return abs(values[0] - values[1]) <= 1.01 * 10.0**-decimals


def test_the_page_is_up_to_date() -> None:
    retained = (DOCS / "dissertation.md").read_text(encoding="utf-8")
    found = differences(retained, page())
    assert not found, f"run `{COMMAND}` after an intended change:\n" + "\n".join(found)


@pytest.mark.parametrize(
    ("one", "two", "same"),
    [
        ("a −1.20 b", "a −1.20 b", True),
        ("a −1.20 b", "a −1.21 b", True),
        ("a −1.20 b", "a −1.22 b", False),
        ("a −1.20 b", "a 1.20 b", False),
        ("a 3 b", "a 3 c", False),
        ("agrees", "**differs**", False),
        ("a", "a\nb", False),
    ],
)
def test_the_comparison_sees_what_it_is_for(one: str, two: str, same: bool) -> None:
    assert (differences(one, two) == []) == same


def test_the_figures_are_there() -> None:
    text = (DOCS / "dissertation.md").read_text(encoding="utf-8")
    named = re.findall(r"\]\(figures/(.+?)\)", text)
    assert sorted(named) == sorted(f"{name}.svg" for name in DRAWINGS)
    assert {path.name for path in (DOCS / "figures").glob("figure-*")} == set(named)
    for name in named:
        path = DOCS / "figures" / name
        assert path.stat().st_size < 100_000
        ElementTree.parse(path)
        assert "<dc:date>" not in path.read_text()


def test_what_differs_is_known() -> None:
    lines = [line for section in sections().values() for line in section]
    differing = {line.what for line in lines if not line.agrees}
    assert differing == {
        "dynamic, 7.5 m/s: dominant pair",
        "DC gain at 1.0, 2.5, 4.5 m/s, dB: kinematic",
        "dynamic, tractor: cut-off frequency",
        "relaxation: resonance of the implement",
        "relaxation, implement, 4.5 m/s: lag while the gain is above 0 dB",
        "kinematic: dominant real part at 1.0, 4.5, 7.5 m/s",
        "from 3 m and 10°: largest ψ_t, ψ_i, δ",
        "overall sensitivity to C_af, C_ar at 7.5 m/s",
        "largest to C_af, C_ar, C_ai (ours: v at 7.5, v at 7.5, r_i at 1 m/s)",
        "mean over the box at 1 m/s: C_af, C_ar, sigma_r, I_i",
        "mean over the box at 4.5 m/s: C_af, C_ar, sigma_r, I_i",
        "mean over the box at 7.5 m/s: C_af, sigma_r, I_i",
        "the least influential",
        "% of change by 10 % of the stiffnesses at 1 m/s",
        "% of change by 50 % at 4.5 m/s",
        "% of change by 50 % at 7.5 m/s",
        "for 5 % of change, stiffnesses known to, %: 1.0, 4.5, 7.5 m/s",
    }
    assert len(lines) >= 45


def test_a_difference_needs_a_reason() -> None:
    assert verdict(ComparedFigure("1", "x", "1", "2", False, "a slip")) == "**differs**: a slip"
    with pytest.raises(ValueError, match="nothing says why"):
        verdict(claim("1", "x", "1", "2", False))


@pytest.mark.parametrize(
    ("printed", "ours", "digits", "within", "agrees"),
    [
        (-1.4, -1.366, 1, None, True),
        (-1.4, -1.34, 1, None, False),
        (-0.35, -0.354, 2, None, True),
        (24, 25.3, 0, 1.5, True),
        (24, 25.6, 0, 1.5, False),
    ],
)
def test_agreement(printed: float, ours: float, digits: int, within: float | None, agrees: bool) -> None:
    assert figures("1", "x", [printed], [ours], digits=digits, within=within).agrees == agrees


@pytest.mark.parametrize(
    ("value", "digits", "text"), [(-1.26, 1, "−1.3"), (-0.001, 2, "0.00"), (2.0, 0, "2")]
)
def test_numbers(value: float, digits: int, text: str) -> None:
    assert number(value, digits) == text


@pytest.mark.parametrize(
    ("wiring", "real"),
    list(zip(WIRINGS, (0.23, -0.39, None, -0.31), strict=True)),
    ids=lambda x: getattr(x, "name", ""),
)
def test_the_wirings_on_the_relaxation_model(wiring: closed_loop.Wiring, real: float | None) -> None:
    found = dominant(wired_poles(wiring, SPEED)).real
    if real is not None:
        assert found == pytest.approx(real, abs=0.0051)
    made = wired_run(wiring)
    assert math.isinf(closed_loop.invalid_from(made)) == (found < 0)
    assert math.isfinite(read_off(made).settling[0]) == (found < 0)


def test_the_nonlinear_plant_grows_as_the_linear_one() -> None:
    """Two routes to one number: an eigenvalue, and peaks of a simulation without small angles."""
    first = WIRINGS[0]
    assert closed_loop.growth(first) == pytest.approx(dominant(wired_poles(first, SPEED)).real, rel=0.01)


def test_no_tyre_takes_part_in_the_instability() -> None:
    assert all(dominant(wired_poles(WIRINGS[0], u, "kinematic")).real > 0 for u in (0.5, 1.0, 4.5, 10.0))


def test_the_relaxation_design_settles() -> None:
    found = read_off(run(as_printed(), relaxation_gain(), BOSSERD))
    assert 10.0 < found.settling[0] < found.settling[1] < found.settling[2] < 14.5
    assert 0.08 < found.overshoot < 0.13
    assert found.steering == pytest.approx(11.5, abs=1.0)
    # No detail of the plant matters much, as the page says.
    for variant in closed_loop.variants()[1:6]:
        other = read_off(run(variant.plant, relaxation_gain(variant.rig), BOSSERD))
        assert abs(other.heading_t - found.heading_t) < 0.4 and abs(other.heading_i - found.heading_i) < 0.4


def test_the_control_period_does_not_matter() -> None:
    coarse, fine = (
        read_off(run(as_printed(), relaxation_gain(), BOSSERD, seconds=16.0, period=period))
        for period in (0.02, 0.005)
    )
    np.testing.assert_allclose(fine.settling, coarse.settling, atol=0.06)
    assert fine.overshoot == pytest.approx(coarse.overshoot, abs=0.002)
    assert fine.heading_t == pytest.approx(coarse.heading_t, abs=0.1)


def test_left_and_right_are_alike() -> None:
    one = run(as_printed(), relaxation_gain(), BOSSERD, 5.0, HEADING, 8.0)
    other = run(as_printed(), relaxation_gain(), BOSSERD, -5.0, -HEADING, 8.0)
    np.testing.assert_allclose(one.of("y_t"), -other.of("y_t"), atol=1e-9)


@pytest.mark.parametrize(
    ("error", "settles"),
    [([5, 1, 0.1, 0.3, 0.1], 4.0), ([0, 0, 0, 0, 0], 0.0), ([5, 1, 0.1, 0.1, 0.3], math.inf)],
)
def test_settling(error: list[float], settles: float) -> None:
    assert closed_loop.settled(np.arange(5.0), np.array(error, float), 0.25) == settles


def test_the_circle_is_that_of_the_steady_turn() -> None:
    """Three routes: a circle through positions, the closed form, and the nonlinear model when slow."""
    for speed in open_loop.SPEEDS:
        v, r, _ = steady_gains(open_loop.RIG, speed) * open_loop.STEP_ANGLE
        assert open_loop.radius(speed, False) == pytest.approx(math.hypot(speed, v) / r, rel=1e-3)
    assert open_loop.radius(1.0, True) == pytest.approx(open_loop.radius(1.0, False), rel=0.02)


def test_the_printed_forms_are_wrong_and_ours_right() -> None:
    """The nonlinear model, which none of the equations in question went into, decides."""
    held = errata.simulated_yaw()
    assert held == pytest.approx(errata.steady_yaw(*errata.dynamic_with(1, 1, 0.0)), rel=1e-4)
    rig = errata.RIG
    printed = errata.steady_yaw(*errata.dynamic_with(1, 1, rig.m_i * rig.c * (1.0 - errata.SPEED)))
    assert abs(printed / held - 1.0) > 0.02
    assert abs(errata.relaxation_yaw(errata.printed_3_121()) / held - 1.0) > 0.01
