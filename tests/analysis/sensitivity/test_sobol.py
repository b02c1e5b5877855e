"""Functions whose indices are known: Ishigami, Sobol's g-function, linear ones with correlation."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from tilth.analysis.sensitivity.inputs import Inputs, of_covariance
from tilth.analysis.sensitivity.screening import dgsm, morris
from tilth.analysis.sensitivity.sobol import sobol

Array = NDArray[np.float64]

ISHIGAMI = Inputs(("x1", "x2", "x3"), (-np.pi,) * 3, (np.pi,) * 3)
G_WEIGHTS = np.array([0.0, 1.0, 4.5, 9.0, 99.0])
G_INPUTS = Inputs(("a", "b", "c", "d", "e"), (0.0,) * 5, (1.0,) * 5)


def ishigami(x: Array) -> Array:
    """a = 7, b = 0.1."""
    y = np.sin(x[:, 0]) + 7.0 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0])
    return np.asarray(y[:, None])


def known_ishigami() -> tuple[Array, Array]:
    """Closed form: of the variances of its parts."""
    one = 0.5 * (1 + 0.1 * np.pi**4 / 5) ** 2
    two, both = 49 / 8, 0.01 * np.pi**8 * (1 / 18 - 1 / 50)
    whole = one + two + both
    return np.array([one, two, 0.0]) / whole, np.array([one + both, two, both]) / whole


def g_function(x: Array) -> Array:
    return np.asarray(np.prod((np.abs(4 * x - 2) + G_WEIGHTS) / (1 + G_WEIGHTS), axis=1)[:, None])


def known_g() -> tuple[Array, Array]:
    alone = 1 / (3 * (1 + G_WEIGHTS) ** 2)
    whole = np.prod(1 + alone) - 1
    return alone / whole, alone * (np.prod(1 + alone) / (1 + alone)) / whole


@pytest.mark.parametrize(
    ("function", "inputs", "known"),
    [(ishigami, ISHIGAMI, known_ishigami()), (g_function, G_INPUTS, known_g())],
)
def test_published_functions(
    function: Callable[[Array], Array], inputs: Inputs, known: tuple[Array, Array]
) -> None:
    found = sobol(function, inputs, points=2048)
    np.testing.assert_allclose(found.first[:, 0], known[0], atol=0.02)
    np.testing.assert_allclose(found.total[:, 0], known[1], atol=0.02)
    assert found.lost == 0.0 and np.all(found.first_half < 0.03)


def test_the_closed_form_is_the_published_one() -> None:
    np.testing.assert_allclose(np.round(known_ishigami()[0], 4), [0.3139, 0.4424, 0.0])
    np.testing.assert_allclose(np.round(known_ishigami()[1], 4), [0.5576, 0.4424, 0.2437])


@pytest.mark.parametrize("rho", [0.0, 0.6, -0.5])
def test_correlated_inputs_of_a_linear_function(rho: float) -> None:
    """Y = sum of a_i ln x_i: first (cov(Y, ln x_i))^2 / (V_i V), total what is left given all others."""
    weights, sds = np.array([1.0, 2.0, 0.5]), np.array([0.3, 0.2, 0.4])
    correlation = np.array([[1.0, rho, 0.0], [rho, 1.0, 0.3], [0.0, 0.3, 1.0]])
    covariance = correlation * np.outer(sds, sds)
    inputs = of_covariance(("a", "b", "c"), (1.0, 1.0, 1.0), covariance)
    assert inputs.correlation is not None
    found = sobol(lambda x: (np.log(x) @ weights)[:, None], inputs, points=512)
    whole = weights @ covariance @ weights
    first = (covariance @ weights) ** 2 / np.diag(covariance) / whole
    total = weights**2 / np.diag(np.linalg.inv(covariance)) / whole
    np.testing.assert_allclose(found.first[:, 0], first, atol=0.02)
    np.testing.assert_allclose(found.total[:, 0], total, atol=0.02)


def test_inputs_without_correlation_need_fewer_points() -> None:
    """The same indices by either way."""
    covariance = np.diag([0.09, 0.04])
    apart = of_covariance(("a", "b"), (1.0, 1.0), covariance)
    assert apart.correlation is None
    together = apart._replace(correlation=((1.0, 0.0), (0.0, 1.0)))

    def outputs(x: Array) -> Array:
        return np.asarray((x[:, 0] * x[:, 1] ** 2)[:, None])

    one, two = sobol(outputs, apart, points=512), sobol(outputs, together, points=512)
    np.testing.assert_allclose(one.first, two.first, atol=0.03)
    np.testing.assert_allclose(one.total, two.total, atol=0.03)


def test_intervals_hold_what_they_say() -> None:
    """Of 60 seeds, all inputs of both functions; 95 % is promised, 960 are looked at."""
    held, seen = 0, 0
    for function, inputs, known in (
        (ishigami, ISHIGAMI, known_ishigami()),
        (g_function, G_INPUTS, known_g()),
    ):
        for seed in range(60):
            found = sobol(function, inputs, points=128, seed=seed)
            for value, half, truth in (
                (found.first, found.first_half, known[0]), (found.total, found.total_half, known[1])
            ):  # fmt: skip
                held += int(np.sum(np.abs(value[:, 0] - truth) <= half[:, 0]))
                seen += len(truth)
    assert seen == 960 and 0.92 < held / seen < 0.98


def test_rows_without_an_answer_are_left_out_and_counted() -> None:
    def broken(x: Array) -> Array:
        y = ishigami(x)
        y[x[:, 2] > 3.0] = np.nan
        return y

    found = sobol(broken, ISHIGAMI, points=256)
    assert 0.03 < found.lost < 0.2 and np.isfinite(found.first).all()


def test_morris_and_derivatives_put_inputs_in_their_order() -> None:
    found = morris(g_function, G_INPUTS, paths=64)
    assert np.all(np.diff(found.size[:, 0]) < 0) and found.size[0, 0] > 20 * found.size[4, 0]
    bound, _ = dgsm(g_function, G_INPUTS, points=1024)
    assert np.all(bound[:, 0] >= known_g()[1]) and np.all(np.diff(bound[:, 0]) < 0)


def test_effects_of_a_linear_function_are_its_slopes() -> None:
    inputs = Inputs(("a", "b"), (1.0, 10.0), (3.0, 20.0))
    found = morris(lambda x: (5.0 * x[:, 0] - 0.2 * x[:, 1])[:, None], inputs, paths=8)
    np.testing.assert_allclose(found.size[:, 0], [10.0, 2.0])
    np.testing.assert_allclose(found.spread[:, 0], 0.0, atol=1e-12)


def test_a_covariance_that_is_none_is_refused() -> None:
    with pytest.raises(ValueError, match="not positive definite"):
        of_covariance(("a", "b"), (1.0, 1.0), np.array([[1.0, 2.0], [2.0, 1.0]]))
