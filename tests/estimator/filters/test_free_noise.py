"""The regression of innovations on their past, on series whose parameters are known."""

import numpy as np
import pytest
from numpy.typing import NDArray

from tilth.estimator.filters.free_noise import gradient_and_information, of_pieces, regress

Array = NDArray[np.float64]

ORDER = 6


def coloured(rng: np.random.Generator, n: int, outputs: int) -> Array:
    """One disturbance that meets the outputs one after the other, and white noise: no filter's model."""
    rut = np.convolve(rng.standard_normal(n + 40), np.hanning(9), "same")
    return np.stack([rut[20 - 3 * k : 20 - 3 * k + n] for k in range(outputs)], axis=1) + rng.standard_normal(
        (n, outputs)
    )


def test_the_rest_is_white() -> None:
    noise = regress([coloured(np.random.default_rng(1), 2000, 3)], ORDER)
    rest = noise.rest
    for lag in range(1, 4):
        across = rest[lag:].T @ rest[:-lag] / len(rest)
        assert np.abs(across).max() < 0.12 * np.diag(noise.covariance).max()


@pytest.mark.parametrize("seed", range(3))
def test_gradients_are_those_of_differences(seed: int) -> None:
    """Of the cost with the coefficients of the past maximised out, over two stretches."""
    rng = np.random.default_rng(seed)
    stretches = [coloured(rng, n, 2) for n in (300, 200)]
    slopes = [rng.standard_normal((len(e), 2, 3)) for e in stretches]

    def cost(theta: Array) -> float:
        return regress([e + S @ theta for e, S in zip(stretches, slopes, strict=True)], ORDER).cost

    noise = regress(stretches, ORDER)
    gradient, information = gradient_and_information(noise, slopes)
    steps = 1e-5 * np.eye(3)
    differences = [(cost(step) - cost(-step)) / 2e-5 for step in steps]
    np.testing.assert_allclose(gradient, differences, rtol=0.02, atol=0.02 * np.abs(gradient).max())
    assert np.all(np.linalg.eigvalsh(information) > 0.0)


def test_pieces_tell_together_what_all_tell_and_apart_what_changed() -> None:
    """A factor on a response that is another one from the second piece on."""
    factors = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        e, S = coloured(rng, 900, 2), rng.standard_normal((900, 2, 1))
        e[ORDER + 300 :] += 0.2 * S[ORDER + 300 :, :, 0]
        noise, parts = regress([e], ORDER), [slice(k, k + 300) for k in (0, 300, 600)]
        gradients, informations = of_pieces(noise, [S], [*parts[:2], slice(600, 900 - ORDER)])
        gradient, information = gradient_and_information(noise, [S])
        np.testing.assert_allclose(gradients.sum(axis=0), gradient, rtol=0.05)
        np.testing.assert_allclose(informations.sum(axis=0), information, rtol=0.02)
        factors.append(gradients[:, 0] / informations[:, 0, 0])
    sd = np.std(factors, axis=0) / np.sqrt(len(factors))
    np.testing.assert_allclose(np.mean(factors, axis=0), [0.0, 0.2, 0.2], atol=4.0 * sd.max())
    assert sd.max() < 0.02


@pytest.mark.parametrize("feedback", [False, True])
def test_intervals_hold_where_the_ground_moves_what_is_regressed_on(feedback: bool) -> None:
    """A response known up to a factor, in noise that the regressor answers with a delay."""
    held = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        e = coloured(rng, 600, 2)
        slope = rng.standard_normal(600)
        if feedback:
            slope[1:] += 0.8 * e[:-1, 0]
        S = np.zeros((600, 2, 1))
        S[1:, 0, 0], S[2:, 1, 0] = slope[:-1], 0.5 * slope[:-2]
        noise = regress([e], ORDER)  # at the true factor, so that the step is the error
        gradient, information = gradient_and_information(noise, [S])
        held += abs(gradient[0]) < 1.96 * np.sqrt(information[0, 0])
    assert 53 <= held <= 60
