"""Tests of residuals: false alarms at their level, and the alarms that a wrong model must raise."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from statsmodels.stats.diagnostic import acorr_ljungbox
from steered_drives import TRUE, Steering, coloured, open_loop, planned

from tilth.analysis.response.response import OUTPUTS, DriveSamples
from tilth.analysis.response.simulated import model_of, residuals
from tilth.analysis.validation.residuals import (
    FEWEST,
    InputTest,
    innovation_size,
    input_independence,
    whiteness,
)
from tilth.estimator.models.parameters import Rig

Array = NDArray[np.float64]

N, DT, SEEDS = 1200, 0.1, 300
NEAR = (0.025, 0.085)  # of 300 with a probability of 0.05: 3 standard deviations, rounded


def white(rng: np.random.Generator) -> Array:
    return rng.normal(size=N)


def slow(rng: np.random.Generator) -> Array:
    return coloured(rng, N, DT, 0.5)


def steered(rng: np.random.Generator) -> Array:
    return planned(rng, N, DT, "random")


def test_white_residuals_fail_as_often_as_the_level_says() -> None:
    found = [whiteness(white(np.random.default_rng(seed)), DT, "r_t") for seed in range(SEEDS)]
    assert NEAR[0] < np.mean([one.outcome == "failed" for one in found]) < NEAR[1]
    assert np.mean([np.abs(one.correlation) <= one.bound for one in found]) == pytest.approx(0.95, abs=0.01)
    strict = [whiteness(white(np.random.default_rng(seed)), DT, "r_t", level=0.2) for seed in range(SEEDS)]
    assert 0.13 < np.mean([one.outcome == "failed" for one in strict]) < 0.27


def test_gaps_do_not_change_the_rate() -> None:
    failed = 0
    for seed in range(SEEDS):
        rng = np.random.default_rng(seed)
        e = white(rng)
        e[rng.uniform(size=N) < 0.2] = np.nan
        e[200:320] = np.nan
        failed += whiteness(e, DT, "r_t").outcome == "failed"
    assert NEAR[0] < failed / SEEDS < NEAR[1]


def test_the_statistic_is_that_of_statsmodels() -> None:
    e = slow(np.random.default_rng(1))
    found = whiteness(e, DT, "r_t", fitted=2)
    wanted = acorr_ljungbox(e, lags=[20], model_df=2)
    assert found.statistic == pytest.approx(float(wanted["lb_stat"].iloc[0]))
    assert found.p_value == pytest.approx(float(wanted["lb_pvalue"].iloc[0]))


@pytest.mark.parametrize(
    ("made", "words"),
    [
        (slow, "process noise is too small"),
        (lambda rng: np.diff(rng.normal(size=N + 1)), "too closely"),
        (lambda rng: (lambda e: e[4:] + 0.6 * e[:-4])(rng.normal(size=N)), "latency"),
    ],
    ids=["slow", "differenced", "echo"],
)
def test_what_is_not_white_fails_and_says_what_that_means(
    made: Callable[[np.random.Generator], Array], words: str
) -> None:
    found = [whiteness(made(np.random.default_rng(seed)), DT, "yaw rate") for seed in range(20)]
    assert all(one.outcome == "failed" and words in one.sentence for one in found)
    assert all(one.sentence.startswith("Residuals of yaw rate repeat") for one in found)


@pytest.mark.parametrize("of_residuals", [white, slow])
@pytest.mark.parametrize("of_wheels", [white, steered])
def test_independent_residuals_fail_as_often_as_the_level_says(
    of_residuals: Callable[[np.random.Generator], Array], of_wheels: Callable[[np.random.Generator], Array]
) -> None:
    found: list[InputTest] = []
    for seed in range(SEEDS):
        rng = np.random.default_rng(seed)
        found.append(input_independence(of_residuals(rng), of_wheels(rng), DT, "r_t"))
    assert NEAR[0] < np.mean([one.outcome == "failed" for one in found]) < NEAR[1]
    assert np.mean([np.abs(one.correlation) <= one.bound for one in found]) == pytest.approx(0.95, abs=0.02)


def test_bounds_of_white_noise_would_be_too_narrow_for_slow_residuals() -> None:
    rng = np.random.default_rng(1)
    found = input_independence(slow(rng), steered(rng), DT, "r_t")
    assert float(np.median(found.bound)) > 1.3 * 1.96 / np.sqrt(N)


def simulated_residuals(drive: DriveSamples, rig: Rig) -> Array:
    """Of the three outputs, (n, 3), NaN while the model settles."""
    y = np.column_stack([drive.outputs[name] for name in OUTPUTS])
    present = np.ones(len(y), np.bool_)
    model = model_of(rig, 4.5, OUTPUTS)
    return residuals(rig, model, drive.wheel_angle, y, present, np.arange(len(y)) > 100, drive.dt)


def late(drive: DriveSamples, samples: int) -> DriveSamples:
    return replace(drive, outputs={name: np.roll(y, samples) for name, y in drive.outputs.items()})


@pytest.mark.parametrize(
    ("rig", "delay", "steering", "words"),
    [
        (TRUE, 4, "random", "latency or the relaxation length"),
        (TRUE._replace(C_af=1.3 * TRUE.C_af, C_ar=0.8 * TRUE.C_ar), 0, "steps", "cornering stiffness"),
    ],
    ids=["0.2 s late", "stiffness"],
)
def test_a_wrong_model_is_found_and_named(rig: Rig, delay: int, steering: Steering, words: str) -> None:
    failed = named = 0
    for seed in range(20):
        drive = late(open_loop(seed, seconds=120.0, steering=steering), delay)
        found = input_independence(
            simulated_residuals(drive, rig)[:, 0], drive.wheel_angle, drive.dt, "yaw rate"
        )
        failed += found.outcome == "failed"
        named += words in found.sentence and "yaw rate follow the wheel angle" in found.sentence
    assert failed >= 17 and named >= 16


def test_the_right_model_passes() -> None:
    failed = 0
    for seed in range(40):
        drive = open_loop(seed, seconds=120.0)
        e = simulated_residuals(drive, TRUE)
        failed += input_independence(e[:, 0], drive.wheel_angle, drive.dt, "yaw rate").outcome == "failed"
    assert failed <= 6  # 40 × 0.05, and 3 standard deviations


def test_steering_that_follows_residuals_is_named() -> None:
    rng = np.random.default_rng(1)
    e = white(rng)
    found = input_independence(e, np.roll(e, 5) + white(rng), DT, "yaw rate")
    assert found.outcome == "failed" and found.sentence.startswith(
        "The wheel angle follows residuals of yaw rate by 0.5 s"
    )


def test_innovations_of_the_right_size() -> None:
    outcomes = []
    for seed in range(SEEDS):
        rng = np.random.default_rng(seed)
        s = rng.uniform(0.5, 2.0, N)
        found = innovation_size(np.sqrt(s) * white(rng), s, "r_t")
        assert (found.outcome == "failed") == (found.p_value < 0.05) and found.low < 1.0 < found.high
        outcomes.append(found.outcome == "failed")
    assert NEAR[0] < np.mean(outcomes) < NEAR[1]


@pytest.mark.parametrize(("sd", "words"), [(1.12, "too small"), (0.89, "too large")])
def test_innovations_of_the_wrong_size(sd: float, words: str) -> None:
    for seed in range(20):
        found = innovation_size(sd * white(np.random.default_rng(seed)), np.ones(N), "r_t")
        assert found.outcome == "failed" and words in found.sentence


def test_what_cannot_be_tested_is_undecided() -> None:
    short, still = np.arange(FEWEST - 1.0), np.full(N, 0.3)
    rng = np.random.default_rng(1)
    assert "too few" in whiteness(short, DT, "r_t").sentence
    assert "does not vary" in whiteness(still, DT, "r_t").sentence
    assert "more fitted" in whiteness(white(rng), DT, "r_t", fitted=20).sentence
    for found in (
        whiteness(still, DT, "r_t"),
        input_independence(white(rng), still, DT, "r_t"),
        input_independence(np.full(N, np.nan), white(rng), DT, "r_t"),
        innovation_size(short, np.ones(len(short)), "r_t"),
    ):
        assert found.outcome == "undecided" and np.isnan(found.p_value)


def test_what_is_no_series_is_refused() -> None:
    ok = white(np.random.default_rng(1))
    for wrong in (np.full(N, np.inf), np.zeros((N, 2))):
        with pytest.raises(ValueError, match="one series"):
            whiteness(wrong, DT, "r_t")
    with pytest.raises(ValueError, match="apart"):
        whiteness(ok, 0.0, "r_t")
    with pytest.raises(ValueError, match="do not fit"):
        input_independence(ok, ok[:-1], DT, "r_t")
    with pytest.raises(ValueError, match="variance above zero"):
        innovation_size(ok, np.zeros(N), "r_t")
