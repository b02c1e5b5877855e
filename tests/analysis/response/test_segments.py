"""Segments lie between gaps; their spectra are those of SciPy; overlap counts as Welch says."""

import numpy as np
import pytest
from scipy import signal

from tilth.analysis.response.segments import SegmentPlan, plan_segments, segment_spectra, stretches


def test_spectra_are_those_of_scipy() -> None:
    rng = np.random.default_rng(1)
    values = rng.normal(size=(2400, 2)) + 3.0
    plan = plan_segments(np.ones(2400, np.bool_), 0.05)
    assert plan is not None
    u, y = np.moveaxis(segment_spectra(values, plan), 2, 0)
    hz, wanted = signal.csd(values[:, 0], values[:, 1], 20.0, "hann", plan.length, detrend="constant")
    assert np.allclose(plan.hz, hz[1:])
    assert np.allclose((u.conj() * y).mean(axis=0)[:-1], wanted[1:-1])  # Nyquist's line has no second half


def test_segments_avoid_gaps() -> None:
    usable = np.ones(4000, np.bool_)
    usable[[700, 1800, 1801]] = False
    plan = plan_segments(usable, 0.05)
    assert plan is not None
    assert all(usable[start : start + plan.length].all() for start in plan.starts.tolist())
    assert stretches(usable) == [(0, 700), (701, 1800), (1802, 4000)]
    assert stretches(np.zeros(3, np.bool_)) == []


@pytest.mark.parametrize(
    ("seconds", "length_s"),
    [(20.0, None), (21.0, 6.0), (40.0, 6.0), (65.0, 8.0), (160.0, 20.0), (900.0, 20.0)],
)
def test_the_length_grows_with_the_record(seconds: float, length_s: float | None) -> None:
    plan = plan_segments(np.ones(int(seconds / 0.1), np.bool_), 0.1)
    assert (None if plan is None else plan.length * plan.dt) == (
        pytest.approx(length_s) if length_s else None
    )


def test_a_clock_too_slow_for_segments_gives_none() -> None:
    assert plan_segments(np.ones(1000, np.bool_), 10.0) is None


def test_the_equivalent_number_is_that_of_the_spread_of_spectra() -> None:
    """Variance over squared mean of a density of white noise is 1 / L."""
    plan = SegmentPlan(np.arange(0, 1200, 60), 120, 1.0)
    rng = np.random.default_rng(2)
    densities = np.array(
        [
            np.mean(np.abs(segment_spectra(rng.normal(size=(1260, 1)), plan)) ** 2, axis=0)[5:50, 0]
            for _ in range(300)
        ]
    )
    spread = densities.var(axis=0).mean() / densities.mean() ** 2
    assert 1.0 / spread == pytest.approx(plan.independent, rel=0.06)
    assert plan.independent == pytest.approx(20 / (1 + 2 * 19 / 20 / 36), rel=1e-6)
    assert SegmentPlan(np.arange(0, 1200, 120), 120, 1.0).independent == 10
