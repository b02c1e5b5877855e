"""Runs of a plan: angles within the limits, an order that is random and complete, room that is checked."""

import math

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.typing import NDArray
from paths import ROOT

from tilth.estimator.models.manoeuvres import MANOEUVRE, multisine, rate_limited
from tilth.estimator.models.parameters import TABLE_5_1
from tilth.estimator.models.planned_run import (
    DT,
    PLANNED_RUN,
    Scheduled,
    check,
    drives,
    needed,
    room,
    schedule,
    way,
    wheel_angle,
)
from tilth.schemas.experiment import KINDS, DrivingLimits, ExperimentPlan, PlanError, parse_plan

TEXT = (ROOT / "examples/experiments.toml").read_text(encoding="utf-8")
HEAD = TEXT[: TEXT.index("[[run]]")]


def plan_of(kind: str, **fields: float | str) -> ExperimentPlan:
    run = {"kind": kind, "speed": 4.5, "amplitude_deg": 6, "seconds": 12} | fields
    lines = [f"{key} = {value!r}" for key, value in run.items()]
    return parse_plan("\n".join([HEAD, "[[run]]", *lines]))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(3))
def test_angles_stay_within_the_amplitude_and_no_driver_must_turn_faster_than_he_can(
    kind: str, seed: int
) -> None:
    plan = plan_of(kind, seconds=15)
    one = Scheduled(1, 1 + seed, plan.run[0])
    angles = wheel_angle(one, plan.limits, default_rng(seed))
    assert len(angles) == round((MANOEUVRE.start_s + 15) / DT) + 1
    assert np.abs(angles).max() <= math.radians(6) + 1e-12
    assert np.abs(angles).max() > math.radians(2)
    assert np.all(angles[: round(MANOEUVRE.start_s / DT)] == 0.0)
    assert np.abs(np.diff(angles)).max() <= math.radians(plan.limits.wheel_rate_degps) * DT + 1e-12


def test_replicates_begin_to_either_side_in_turn() -> None:
    plan = plan_of("step")
    first, second = (wheel_angle(Scheduled(1, k, plan.run[0]), plan.limits, default_rng(0)) for k in (1, 2))
    assert np.allclose(first, -second)
    assert first[-1] > 0
    left = plan_of("step", side="left")
    assert wheel_angle(Scheduled(1, 1, left.run[0]), left.limits, default_rng(0))[-1] < 0


def test_every_replicate_is_driven_once_in_blocks_whose_order_is_the_seeds() -> None:
    plan = parse_plan(TEXT)
    orders = [schedule(plan, default_rng(seed)) for seed in range(20)]
    for order in orders:
        assert sorted((one.number, one.replicate) for one in order) == [
            (number, replicate) for number in (1, 2, 3) for replicate in (1, 2, 3)
        ]
        assert [one.replicate for one in order] == [1, 1, 1, 2, 2, 2, 3, 3, 3]
    assert schedule(plan, default_rng(4)) == orders[4]
    assert len({tuple(one.number for one in order) for order in orders}) > 10


def test_who_plans_prompts_and_simulates_has_the_same_runs() -> None:
    plan = plan_of("random")
    once, again = drives(plan, default_rng), drives(plan, default_rng)
    for (one, angles), (other, others) in zip(once, again, strict=True):
        assert one == other
        assert np.array_equal(angles, others)
    first, second = (angles for _, angles in once[:2])
    assert not np.allclose(np.abs(first), np.abs(second))  # replicates are drawn anew


def test_a_multisine_has_the_lines_that_were_asked_for_and_a_low_peak() -> None:
    seconds, dt = 20.0, 0.02
    time: NDArray[np.float64] = (
        np.arange(round((MANOEUVRE.start_s + seconds) / dt) + 1, dtype=np.float64) * dt
    )
    waves = multisine(time, 1.0, default_rng(0), 0.1, 0.5)
    assert np.abs(waves).max() == pytest.approx(1.0)
    steered = waves[time >= MANOEUVRE.start_s + MANOEUVRE.fade_s]
    assert np.abs(steered).max() / np.sqrt(np.mean(np.square(steered))) < 2.2
    spectrum = np.abs(np.fft.rfft(waves[time >= MANOEUVRE.start_s][:-1]))
    frequencies = np.fft.rfftfreq(len(waves[time >= MANOEUVRE.start_s]) - 1, dt)
    inside = (frequencies > 0.08) & (frequencies < 0.52)
    assert np.sum(spectrum[inside] ** 2) > 0.9 * np.sum(spectrum**2)


def test_a_limited_rate_reaches_its_target() -> None:
    limited = rate_limited(np.full(50, 1.0), 0.1)
    assert limited[:10] == pytest.approx(np.arange(1, 11) * 0.1)
    assert np.all(limited[10:] == 1.0)


def test_the_way_of_straight_wheels_is_straight_and_a_held_angle_goes_round() -> None:
    straight = way(TABLE_5_1, 4.0, np.zeros(501))
    assert straight.ahead[-1] == pytest.approx(40.0, rel=0.01)
    assert np.abs(straight.lateral_offset).max() == 0.0
    held = way(TABLE_5_1, 3.0, np.full(4001, math.radians(8)))
    radius = (held.lateral_offset.max() - held.lateral_offset.min()) / 2
    assert radius == pytest.approx(TABLE_5_1.wheelbase / math.tan(math.radians(8)), rel=0.15)
    assert held.lateral_acceleration[-1] == pytest.approx(9.0 / radius, rel=0.05)


def test_the_room_is_that_to_the_nearest_edge() -> None:
    field = parse_plan(TEXT).field
    along, across = np.array([100.0, 200.0]), np.array([40.0, 30.0])
    assert room(field, along, across, False) == pytest.approx(30.0 - PLANNED_RUN.beside_m)
    assert room(field, np.array([30.0]), np.array([40.0]), False) == pytest.approx(10.0)
    assert room(field, np.array([10.0]), np.array([40.0]), False) == pytest.approx(-10.0)
    assert room(field, np.array([10.0]), np.array([40.0]), True) == pytest.approx(10.0)


@pytest.mark.parametrize(
    ("plan", "words"),
    [
        (plan_of("step", amplitude_deg=12, speed=8), ("run[1], step", "m/s^2", "allows 2.5", "at most")),
        (
            plan_of("chirp", seconds=60, speed=9, amplitude_deg=2),
            ("run[1], chirp", "m of length", "360 m"),
        ),
        (plan_of("step", amplitude_deg=3), ("run[1], step", "m of width", "80 m", "shorter or slower")),
    ],
)
def test_what_has_no_room_or_is_too_hard_says_what_to_change(
    plan: ExperimentPlan, words: tuple[str, ...]
) -> None:
    field = plan.field if "width" not in words[1] else plan.field.model_copy(update={"width": 20.0})
    plan = plan.model_copy(update={"field": field})
    with pytest.raises(PlanError) as refused:
        check(plan, TABLE_5_1, drives(plan, default_rng))
    for word in words:
        assert word.replace("80 m", "20 m") in str(refused.value)


def test_the_example_has_room() -> None:
    plan = parse_plan(TEXT)
    check(plan, TABLE_5_1, drives(plan, default_rng))
    for one, angles in drives(plan, default_rng):
        long, wide = needed(one.run, way(TABLE_5_1, one.run.speed, angles))
        assert 15 * 4.5 < long < 360 and wide < 80


def test_limits_have_defaults_below_what_costs_the_model() -> None:
    assert DrivingLimits().wheel_angle_deg < 15
