"""Indices beside SALib's, which has the published functions, and OpenTURNS's for correlated inputs."""

from collections.abc import Callable
from typing import Any

import numpy as np
import openturns as ot
import pytest
import SALib.analyze.dgsm
import SALib.analyze.sobol
import SALib.sample.finite_diff
import SALib.sample.sobol
from numpy.typing import NDArray
from SALib.test_functions import Ishigami, Sobol_G
from sampled import sampled

from tilth.analysis.sensitivity.inputs import Inputs, of_covariance
from tilth.analysis.sensitivity.screening import dgsm
from tilth.analysis.sensitivity.sobol import sobol

Array = NDArray[np.float64]

G_VALUES = np.array([0.0, 1.0, 4.5, 9.0, 99.0, 99.0, 99.0, 99.0])
PUBLISHED_ISHIGAMI = (
    [0.3139, 0.4424, 0.0],
    [0.5576, 0.4424, 0.2437],
)  # Ishigami and Homma (1990), a = 7, b = 0.1
FUNCTIONS: dict[str, tuple[Callable[[Array], Array], list[list[float]], tuple[Any, Any]]] = {
    "Ishigami": (lambda x: np.asarray(Ishigami.evaluate(x)), [[-np.pi, np.pi]] * 3, PUBLISHED_ISHIGAMI),
    "g-function": (
        lambda x: np.asarray(Sobol_G.evaluate(x, G_VALUES)),
        [[0.0, 1.0]] * 8,
        (Sobol_G.sensitivity_index(G_VALUES), Sobol_G.total_sensitivity_index(G_VALUES)),
    ),
}


def _inputs(bounds: list[list[float]]) -> tuple[Inputs, dict[str, Any]]:
    """(ours, SALib's)."""
    names = [f"x{k}" for k in range(len(bounds))]
    low, high = zip(*bounds, strict=True)
    return Inputs(tuple(names), low, high), {"num_vars": len(names), "names": names, "bounds": bounds}


@pytest.mark.parametrize("name", sampled(FUNCTIONS, ["Ishigami"]))
def test_indices_are_those_that_salib_publishes_and_finds(name: str) -> None:
    """As many points for both: 16 scrambles of 1024 beside 16384."""
    function, bounds, (first, total) = FUNCTIONS[name]
    inputs, problem = _inputs(bounds)
    ours = sobol(lambda x: function(x)[:, None], inputs, points=1024)
    points = SALib.sample.sobol.sample(problem, 16384, calc_second_order=False, seed=1)
    theirs = SALib.analyze.sobol.analyze(problem, function(points), calc_second_order=False, seed=1)
    for value, half, key, known in (
        (ours.first, ours.first_half, "S1", first),
        (ours.total, ours.total_half, "ST", total),
    ):
        np.testing.assert_allclose(value[:, 0], known, atol=0.015)
        assert np.all(np.abs(value[:, 0] - known) <= 2 * half[:, 0] + 1e-4)
        assert np.all(np.abs(value[:, 0] - theirs[key]) <= half[:, 0] + theirs[f"{key}_conf"] + 1e-4)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_squares_of_derivatives_are_those_that_salib_finds(name: str) -> None:
    """Theirs by the unit of an input, ours by its range."""
    function, bounds, _ = FUNCTIONS[name]
    inputs, problem = _inputs(bounds)
    ours = dgsm(lambda x: function(x)[:, None], inputs, points=2048)[1][:, 0]
    points = SALib.sample.finite_diff.sample(problem, 4096, delta=1e-4, seed=1)
    theirs = SALib.analyze.dgsm.analyze(problem, points, function(points), seed=1)
    widths = np.array([high - low for low, high in bounds])
    np.testing.assert_allclose(ours, theirs["vi"] * widths**2, rtol=0.05, atol=1e-3)


def _by_nested_draws(function: Callable[[Array], Array], covariance: Array, variance: float) -> Array:
    """Total indices of normal logarithms: the mean variance given all others, of conditional laws."""
    k = len(covariance)
    joint = ot.Normal([0.0] * k, ot.CovarianceMatrix(covariance.tolist()))
    rows = np.array(joint.getSample(200))
    found = []
    for j in range(k):
        rest = [i for i in range(k) if i != j]
        inner = []
        for row in rows:
            given = ot.PointConditionalDistribution(joint, rest, row[rest].tolist())
            points = np.tile(row, (200, 1))
            points[:, j] = np.array(given.getSample(200))[:, 0]
            inner.append(function(np.exp(points)).var(ddof=1))
        found.append(np.mean(inner) / variance)
    return np.array(found)


def test_indices_of_correlated_inputs_are_those_of_openturns() -> None:
    """A function that is neither linear nor additive. First order: its estimator by ranks, which holds for
    inputs of any joint law; total: nested draws."""
    ot.RandomGenerator.SetSeed(1)
    covariance = np.array([[0.16, 0.08, 0.0], [0.08, 0.25, -0.05], [0.0, -0.05, 0.09]])

    def function(x: Array) -> Array:
        return np.asarray(x[:, 0] * x[:, 1] + np.sin(3 * x[:, 2]) + x[:, 2] * x[:, 0] ** 2)

    inputs = of_covariance(("a", "b", "c"), (1.0, 1.0, 1.0), covariance)
    ours = sobol(lambda x: function(x)[:, None], inputs, points=512)
    sample = ot.Normal([0.0] * 3, ot.CovarianceMatrix(covariance.tolist())).getSample(60_000)
    points = np.exp(np.array(sample))
    values = function(points)
    ranked = ot.RankSobolSensitivityAlgorithm(ot.Sample(points.tolist()), ot.Sample(values[:, None].tolist()))
    np.testing.assert_allclose(ours.first[:, 0], list(ranked.getFirstOrderIndices()), atol=0.03)
    nested = _by_nested_draws(function, covariance, float(values.var()))
    np.testing.assert_allclose(ours.total[:, 0], nested, atol=0.04)
