"""Uncertainty of outputs: the first order is the limit of small sds, shares add up, what is wanted is got."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from logs import MACHINE
from report_run import VALUES, WrittenRun, write_run
from sampled import sampled

import tilth.analysis
from tilth.analysis.sensitivity.knowledge import Knowledge, given, of_machine, of_run
from tilth.analysis.sensitivity.local import response_slope
from tilth.analysis.sensitivity.outputs import NAMES, case_of, products
from tilth.analysis.sensitivity.propagation import (
    Asked,
    UncertaintyQuestion,
    outputs_of,
    per_unit,
    uncertainty_answer,
    wanted,
    within,
)
from tilth.analysis.sensitivity.slopes import VARIED
from tilth.estimator.models.family import model_named
from tilth.estimator.models.parameters import TABLE_7_2
from tilth.schemas.flow import PARAMETERS

RELAXATION = model_named("relaxation")
BASE = Knowledge("a test", TABLE_7_2, (), np.zeros((0, 0)))
SCALARS = ("psi_t", "psi_i", "steady_v", "steady_r", "steady_articulation", "off_tracking", "cross_track")


def asked(known: Knowledge, draws: int = 600) -> Any:
    question = UncertaintyQuestion((RELAXATION,), (4.5,), (6.0,), draws=draws)
    (entry,) = uncertainty_answer(known, question)["speeds"]
    assert entry["unstable_share"] == 0.0
    return entry["outputs"]


CORRELATED = [("C_af", "C_ar", 0.8), ("C_ai", "sigma_i", -0.6)]


@pytest.mark.parametrize("correlations", sampled([[], CORRELATED], [CORRELATED]))
def test_small_uncertainties_are_those_of_the_first_order(correlations: list[tuple[str, str, float]]) -> None:
    outputs = asked(given(BASE, dict.fromkeys(VARIED, 0.02), correlations))
    for name in SCALARS:  # normal in the limit; of 600 draws half an interval is known to 4 %
        assert outputs[name]["half"] == pytest.approx(outputs[name]["first_order"], rel=0.13), name
    for name, one in outputs.items():
        shares = [row["share"] for row in one["parameters"].values()]
        assert sum(shares) == pytest.approx(1.0), name


@pytest.mark.parametrize("steering", ["step", "chirp"])
def test_products_are_squares_of_what_a_change_does(steering: str) -> None:
    """Through the whole model: a small change of each parameter in both directions."""
    case = case_of(RELAXATION, TABLE_7_2, 4.5, 6.0, steering=steering)
    changes = [response_slope(case, TABLE_7_2, name) for name in VARIED]
    squares = np.diagonal(products(case, changes), axis1=1, axis2=2) * per_unit(case, TABLE_7_2)[:, None] ** 2
    step = 1e-4
    values = np.array([getattr(TABLE_7_2, name) for name in VARIED])
    found = outputs_of(Asked(case, TABLE_7_2, VARIED), values * (1.0 + step * np.eye(len(VARIED))))
    np.testing.assert_allclose(np.abs(found.T) / step, np.sqrt(squares), rtol=2e-3, atol=1e-7)


def test_one_parameter_alone_is_its_own_interval() -> None:
    outputs = asked(given(BASE, {"C_ai": 0.1, "sigma_f": 0.1}), draws=200)
    row = outputs["off_tracking"]["parameters"]
    assert row["sigma_f"] == {"low": 0.0, "high": 0.0, "share": pytest.approx(0.0, abs=1e-12)}
    assert row["C_ai"]["share"] == pytest.approx(1.0)
    assert row["C_ai"]["low"] < 0 < row["C_ai"]["high"]


def test_what_is_wanted_is_got() -> None:
    """The covariance, changed as it says, gives the variance that was asked for."""
    rng = np.random.default_rng(4)
    slopes = rng.normal(size=3)
    known = given(BASE, {"C_af": 0.1, "C_ar": 0.2, "C_ai": 0.3}, [("C_af", "C_ar", 0.5)])
    terms = np.outer(slopes, slopes) * known.log_covariance
    half = 0.9 * 1.959964 * np.sqrt(terms.sum())
    found = wanted(float(half), known, terms)
    assert found["factor"] == pytest.approx(0.9, rel=1e-4)
    reached = 0
    for k, name in enumerate(known.names):
        if found["alone"][name] is not None:
            factors = np.ones(3)
            factors[k] = found["alone"][name] / known.log_sd[k]
            total = float((terms * np.outer(factors, factors)).sum())
            assert 1.959964 * np.sqrt(total) == pytest.approx(half, rel=1e-4)
            reached += 1
        only = found["only"][name]
        assert 1.959964 * abs(slopes[k]) * only == pytest.approx(half, rel=1e-4)
    assert reached
    assert set(wanted(float(0.01 * half), known, terms)["alone"].values()) == {None}


def test_unstable_rigs_are_counted_apart() -> None:
    """At 7.5 m/s with little known of the rear axle."""
    known = given(BASE, {"C_ar": 1.2})
    question = UncertaintyQuestion((RELAXATION,), (7.5,), (3.0,), draws=300, outputs=("r_t",))
    (entry,) = uncertainty_answer(known, question)["speeds"]
    assert 0.02 < entry["unstable_share"] < 0.5 and entry["outputs"]["r_t"]["half"] is not None


def test_the_same_question_has_the_same_answer() -> None:
    known = given(BASE, {"C_af": 0.2, "sigma_r": 0.4})
    assert asked(known, 150) == asked(known, 150)


def test_what_the_machine_file_knows() -> None:
    known = of_machine(MACHINE)
    assert set(PARAMETERS) <= set(known.names) and np.all(known.log_sd > 0)
    np.testing.assert_allclose(known.log_sd[:6], [MACHINE.tyres.front.log_sd] * 6)


def test_what_a_log_knows(tmp_path: Path) -> None:
    path = write_run(tmp_path / "a.mcap")
    (run,) = tilth.analysis.open([path])
    known = of_run(run)
    np.testing.assert_allclose(known.median[:6], VALUES, rtol=1e-6)
    np.testing.assert_allclose(known.log_sd[:6], 0.06, rtol=1e-4)
    other = write_run(tmp_path / "b.mcap", replace(WrittenRun(), undetermined=("sigma_i",)))
    (run,) = tilth.analysis.open([other])
    with pytest.raises(ValueError, match="no estimate of sigma_i that may be used"):
        of_run(run)


def test_correlations_that_do_not_fit_together() -> None:
    rows = [("C_af", "C_ar", 0.9), ("C_ar", "C_ai", 0.9), ("C_af", "C_ai", -0.9)]
    with pytest.raises(ValueError, match="not positive definite"):
        given(BASE, dict.fromkeys(PARAMETERS[:3], 0.1), rows)


def test_too_few_values_have_no_interval() -> None:
    assert np.isnan(within(np.array([1.0, np.nan] * 10))).all() and set(NAMES) > set(SCALARS)
