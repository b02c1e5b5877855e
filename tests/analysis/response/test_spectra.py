"""Coherence of what is independent, and bands of what is known, over many draws."""

import numpy as np
from scipy import stats

from tilth.analysis.response.segments import SegmentPlan, segment_spectra
from tilth.analysis.response.spectra import band, combined_p_value, transfer

PLAN = SegmentPlan(np.arange(0, 1200, 120), 120, 1.0)  # without an overlap
HALF = SegmentPlan(np.arange(0, 1140, 60), 120, 1.0)


def independent(plan: SegmentPlan, draws: int, steps: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """(coherence, p-values) of noise and an input that is white, or one tone: the worst for an overlap."""
    rng = np.random.default_rng(7)
    found = []
    for _ in range(draws):
        u = np.sin(2 * np.pi * 0.1 * np.arange(1200)) if steps else rng.normal(size=1200)
        spectra = segment_spectra(np.column_stack([u, rng.normal(size=1200)]), plan)
        got = transfer(spectra[:, :, 0], spectra[:, :, 1:], plan)
        at = slice(11, 12) if steps else slice(3, 50, 4)
        found.append((got.coherence[at, 0], got.p_value[at, 0]))
    return np.concatenate([one for one, _ in found]), np.concatenate([one for _, one in found])


def test_coherence_of_independent_signals_is_beta() -> None:
    coherence, p_value = independent(PLAN, 200)
    assert stats.kstest(coherence, stats.beta(1, PLAN.independent - 1).cdf).pvalue > 0.01
    assert np.allclose(p_value, (1.0 - coherence) ** (PLAN.independent - 1))


def test_p_values_are_uniform_with_overlap() -> None:
    for steps in (False, True):
        _, p_value = independent(HALF, 1500 if steps else 200, steps)
        assert abs(np.mean(p_value < 0.05) - 0.05) < 0.015, steps
        assert abs(np.mean(p_value < 0.5) - 0.5) < 0.04, steps


def test_bands_hold_gain_and_phase_down_to_no_response() -> None:
    rng, m = np.random.default_rng(3), 14.0
    for gain in (0.0, 0.7, 2.0, 5.0):
        value = gain + rng.normal(size=(20000, 1)) + 1j * rng.normal(size=(20000, 1))
        found = band(value, 2 * rng.chisquare(2 * m, (20000, 1)) / (2 * m), m)
        assert abs(np.mean(np.abs(value - gain) <= found.radius) - 0.95) < 0.006
        held = np.mean((found.gain_low <= gain) & (gain <= found.gain_high))
        assert 0.93 < held < 0.97, gain
        assert 0.94 < np.mean(np.abs(np.angle(value)) <= found.phase_half) <= 0.98, gain


def test_an_input_of_nothing_tells_nothing() -> None:
    noise = segment_spectra(np.random.default_rng(1).normal(size=(1200, 1)), PLAN)
    found = transfer(np.zeros(noise.shape[:2], np.complex128), noise, PLAN)
    assert np.isinf(found.variance).all() and (found.p_value == 1.0).all() and (found.value == 0).all()
    assert (band(found.value, found.variance, found.freedom).phase_half == np.pi).all()


def test_combined_p_values() -> None:
    p_value = np.random.default_rng(4).uniform(size=(60, 500))
    whole = combined_p_value(p_value, np.ones(60, np.bool_))
    assert stats.kstest(whole, "uniform").pvalue > 0.01
    assert (combined_p_value(p_value, np.zeros(60, np.bool_)) == 1.0).all()
