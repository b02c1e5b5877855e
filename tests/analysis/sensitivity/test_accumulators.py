"""Streams against whole arrays."""

import numpy as np

from tilth.analysis.sensitivity.accumulators import mean, merged, nothing, of, quantile, spread


def test_what_is_kept_of_a_stream_is_that_of_the_whole() -> None:
    values = np.exp(np.random.default_rng(5).normal(-1, 2, (20_000, 2)))
    kept = nothing(2)
    for part in np.array_split(values, 7):
        kept = merged(kept, of(part))
    np.testing.assert_allclose(mean(kept), values.mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(spread(kept), values.std(axis=0), rtol=1e-9)
    for share in (0.05, 0.5, 0.95):
        np.testing.assert_allclose(quantile(kept, share), np.quantile(values, share, axis=0), rtol=0.012)


def test_bins_do_not_depend_on_the_order() -> None:
    values = np.random.default_rng(5).random((1000, 1))
    a, b = of(values[:300]), of(values[300:])
    np.testing.assert_array_equal(merged(a, b).bins, merged(b, a).bins)
    np.testing.assert_array_equal(merged(a, b).bins, of(values).bins)


def test_what_is_no_number_is_counted_and_left_out() -> None:
    kept = of(np.array([[1.0], [np.inf], [np.nan], [3.0], [0.0]]))
    assert (kept.counted[0], kept.lost[0], kept.bins.sum()) == (3, 2, 3)
    assert mean(kept)[0] == 4 / 3
    assert np.isnan(mean(nothing(1))[0]) and np.isnan(quantile(nothing(1), 0.5)[0])
