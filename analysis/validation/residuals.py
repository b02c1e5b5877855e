"""Tests of residuals: white, independent of the wheel angle, as large as their filter says.

Residuals of a one-step prediction pass all three where model and noise are right. Residuals of a simulation
are not white; the test against the wheel angle holds for them too. NaN is a gap.

Sources: Ljung and Box (1978); Bartlett's variance of a cross-correlation, with both autocorrelations;
Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation, on normalised
innovations squared.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, chdtri

from tilth.schemas.spread import WITHIN

Array = NDArray[np.float64]
Outcome = Literal["passed", "failed", "undecided"]

LEVEL: Final = 0.05  # of false alarms, unless another is asked for
FEWEST: Final = 50  # samples: with fewer, correlations are not normal yet
LAG_S: Final = 2.0  # what a rig and its sensors do to residuals, they do within this time
MOST_LAGS: Final = 40
KEPT: Final = 0.02  # of the largest eigenvalue: smaller ones of a correlation's covariance are not known
STEADY: Final = 0.8  # of the correlations in size: so much in sum means that they have one sign
SMALL: Final = 1e-12  # sd over largest value, of what does not vary


@dataclass(frozen=True, slots=True)
class WhitenessTest:
    """Ljung and Box: do residuals repeat what was in earlier ones?"""

    output: str
    outcome: Outcome
    p_value: float  # NaN if undecided
    statistic: float  # chi-square with as many degrees of freedom as lags
    lags_s: Array  # (k,), s, above zero
    correlation: Array  # (k,), autocorrelation
    bound: Array  # (k,), 95 % of white residuals lie within ± this, lag by lag
    sentence: str


@dataclass(frozen=True, slots=True)
class InputTest:
    """Do residuals follow the wheel angle?"""

    output: str
    outcome: Outcome
    p_value: float  # NaN if undecided
    statistic: float  # chi-square
    freedom: int  # its degrees of freedom
    lags_s: Array  # (k,), s; positive: residuals after the wheel angle
    correlation: Array  # (k,), with the wheel angle
    bound: Array  # (k,), 95 % of independent residuals lie within ± this, lag by lag
    sentence: str


@dataclass(frozen=True, slots=True)
class SizeTest:
    """Mean of the normalised innovations squared (NIS): 1 if they are as large as their filter says."""

    output: str
    outcome: Outcome
    p_value: float  # NaN if undecided
    mean: float
    low: float  # of the interval in which it lies if the filter is right
    high: float
    sentence: str


def together(p_values: Sequence[float]) -> Array:
    """Of several tests, each p-value as it counts among all of them: below a level with that probability if
    every residual is right. NaN: undecided, not counted. Source: Holm (1979), A simple sequentially rejective
    multiple test procedure."""
    found = np.asarray(p_values, np.float64)
    order = np.argsort(found)[: np.count_nonzero(np.isfinite(found))]
    weights = len(order) - np.arange(len(order))
    counted = found.copy()
    counted[order] = np.minimum(np.maximum.accumulate(weights * found[order]), 1.0)
    return counted


def whiteness(
    residuals: Array, dt: float, output: str, *, level: float = LEVEL, fitted: int = 0
) -> WhitenessTest:
    """Autocorrelation of residuals, (n,), dt seconds apart, tested at that level.

    fitted: how many parameters were fitted to these residuals; the statistic has so many degrees fewer.
    Raises ValueError for what is no series.
    """
    e = _series(residuals, dt, output)
    lags = np.arange(1, _most_lag(e, dt) + 1)
    empty = np.zeros(0)
    why = _useless(e, output)
    if why or len(lags) <= fitted:
        sentence = why or f"Residuals of {output}: more fitted parameters than lags."
        return WhitenessTest(output, "undecided", np.nan, np.nan, empty, empty, empty, sentence)
    lags_s = np.asarray(lags * dt, dtype=np.float64)
    correlation, pairs = _correlation(e, e, lags)
    n = int(np.isfinite(e).sum())
    # Where nothing is missing, pairs = n - lag, and this is Ljung's and Box's variance.
    variance = pairs / (n * (n + 2.0))
    seen = pairs > 0
    statistic = float(np.sum(correlation[seen] ** 2 / variance[seen]))
    p_value = float(chdtrc(int(seen.sum()) - fitted, statistic))
    bound = np.asarray(WITHIN * np.sqrt(variance), dtype=np.float64)
    outcome: Outcome = "failed" if p_value < level else "passed"
    sentence = _of_whiteness(output, outcome, lags_s, correlation, bound)
    return WhitenessTest(output, outcome, p_value, statistic, lags_s, correlation, bound, sentence)


def input_independence(
    residuals: Array, wheel_angle: Array, dt: float, output: str, *, level: float = LEVEL
) -> InputTest:
    """Cross-correlation of residuals and wheel angle, both (n,), dt seconds apart, tested at that level.

    Its bounds and its test hold for residuals and wheel angles that are autocorrelated. Raises ValueError for
    what are no two series of one length.
    """
    e, u = _series(residuals, dt, output), _series(wheel_angle, dt, "wheel angle")
    if e.shape != u.shape:
        raise ValueError(f"{len(e)} residuals of {output} do not fit {len(u)} wheel angles")
    e, u = np.where(np.isfinite(u), e, np.nan), np.where(np.isfinite(e), u, np.nan)
    empty = np.zeros(0)
    why = _useless(e, output) or _useless(u, "the wheel angle")
    if why:
        return InputTest(output, "undecided", np.nan, np.nan, 0, empty, empty, empty, why)
    most = _most_lag(e, dt)
    step = max(1, -(-2 * most // MOST_LAGS))
    lags = np.arange(-most // step, most // step + 1) * step
    lags_s = np.asarray(lags * dt, dtype=np.float64)
    correlation, pairs = _correlation(u, e, lags)
    n = int(np.isfinite(e).sum())
    # r is the sum over the pairs of a lag, divided by n: fewer pairs, less variance.
    share = np.sqrt(np.maximum(pairs, 1) / n)
    covariance = _bartlett(e, u, lags) / n * share[:, None] * share
    statistic, freedom = _quadratic(correlation, covariance)
    p_value = float(chdtrc(freedom, statistic))
    bound = np.asarray(WITHIN * np.sqrt(np.diag(covariance)), dtype=np.float64)
    outcome: Outcome = "failed" if p_value < level else "passed"
    sentence = _of_input(output, outcome, lags_s, correlation, bound)
    return InputTest(output, outcome, p_value, statistic, freedom, lags_s, correlation, bound, sentence)


def innovation_size(innovations: Array, variances: Array, output: str, *, level: float = LEVEL) -> SizeTest:
    """Mean of e²/S of innovations and their variances, both (n,), tested at that level from both sides.

    The interval is that of independent innovations: see `whiteness` first. Raises ValueError for what does
    not fit, and for a variance that is not positive.
    """
    e, s = _series(innovations, 1.0, output), _series(variances, 1.0, "variance")
    if e.shape != s.shape or (s[np.isfinite(s)] <= 0.0).any():
        raise ValueError(f"{output}: each innovation needs a variance above zero")
    squared = (e**2 / s)[np.isfinite(e) & np.isfinite(s)]
    n = len(squared)
    if n < FEWEST:
        sentence = f"Innovations of {output}: {n} are too few, {FEWEST} are wanted."
        return SizeTest(output, "undecided", np.nan, np.nan, np.nan, np.nan, sentence)
    total, mean = float(squared.sum()), float(squared.mean())
    low, high = float(chdtri(n, 1.0 - level / 2.0)) / n, float(chdtri(n, level / 2.0)) / n
    above = float(chdtrc(n, total))
    p_value = 2.0 * min(above, 1.0 - above)
    outcome: Outcome = "passed" if low <= mean <= high else "failed"
    sentence = _of_size(output, mean, low, high)
    return SizeTest(output, outcome, p_value, mean, low, high, sentence)


def _of_whiteness(output: str, outcome: Outcome, lags_s: Array, correlation: Array, bound: Array) -> str:
    if outcome == "passed":
        return f"Residuals of {output} are white: nothing in them could have been predicted."
    worst = int(np.argmax(np.abs(correlation) / np.maximum(bound, SMALL)))
    if correlation[worst] < 0.0:
        usual = "the filter follows its measurements too closely, or the sensor smooths or differentiates"
    elif correlation[0] > 0.5 * correlation[worst]:
        usual = (
            "the model lacks something slow, such as the ground's forces, or its process noise is too small"
        )
    else:
        usual = "something swings or comes late at this interval, such as a sensor's latency"
    return (
        f"Residuals of {output} repeat what was {lags_s[worst]:.2g} s before (correlation "
        f"{correlation[worst]:+.2f}): {usual}."
    )


def _of_input(output: str, outcome: Outcome, lags_s: Array, correlation: Array, bound: Array) -> str:
    if outcome == "passed":
        return (
            f"Residuals of {output} do not follow the wheel angle: the model has taken from it what there is."
        )
    worst = int(np.argmax(np.abs(correlation) / np.maximum(bound, SMALL)))
    at, after = float(lags_s[worst]), lags_s >= 0.0
    if at < 0.0 and np.abs(correlation[after]).max() < 0.5 * abs(correlation[worst]):
        return (
            f"The wheel angle follows residuals of {output} by {-at:.2g} s: somebody or something steered by "
            "what the rig did."
        )
    # An error of the gain leaves residuals like the output, with one sign; an error in time leaves its
    # derivative, with both. Quick steering does not tell a stiffness from the others: it changes both.
    if abs(float(correlation.sum())) > STEADY * float(np.abs(correlation).sum()):
        usual = "the gain is wrong, by a cornering stiffness, a mass or the scale of the wheel angle"
    else:
        usual = (
            "latency or the relaxation length is wrong, or a stiffness that changes how soon the rig answers"
        )
    when = f"at {at:.2g} s" if at >= 0.0 else "at once"
    size = f"correlation {correlation[worst]:+.2f}"
    return f"Residuals of {output} follow the wheel angle {when} ({size}): {usual}."


def _of_size(output: str, mean: float, low: float, high: float) -> str:
    found = f"Innovations of {output}: NIS {mean:.2f}, expected {low:.2f} to {high:.2f}"
    if mean > high:
        return f"{found}: larger than the filter says: its noise is set too small, or the model is wrong."
    if mean < low:
        return (
            f"{found}: smaller than the filter says: its noise is set too large, and intervals are too wide."
        )
    return f"{found}: as large as the filter says."


def _series(values: Array, dt: float, what: str) -> Array:
    found = np.asarray(values, np.float64)
    if found.ndim != 1 or np.isinf(found).any():
        raise ValueError(f"{what}: one series is wanted, finite, with NaN for what was not measured")
    if not (np.isfinite(dt) and dt > 0.0):
        raise ValueError(f"samples cannot be {dt} s apart")
    return found


def _useless(values: Array, what: str) -> str:
    """Why no test is possible, or ""."""
    present = values[np.isfinite(values)]
    if len(present) < FEWEST:
        return f"{what}: {len(present)} samples are too few, {FEWEST} are wanted."
    if present.std() <= SMALL * np.abs(present).max():
        return f"{what} does not vary."
    return ""


def _most_lag(values: Array, dt: float) -> int:
    """Samples: those of LAG_S, but no more than a quarter of the series."""
    return max(1, min(round(LAG_S / dt), int(np.isfinite(values).sum()) // 4))


def _centred(values: Array) -> Array:
    """Less its mean, over its sd, zero in gaps."""
    present = np.isfinite(values)
    kept = values[present]
    return np.where(present, (values - kept.mean()) / kept.std(), 0.0)


def _correlation(first: Array, second: Array, lags: NDArray[np.int64]) -> tuple[Array, Array]:
    """(correlation of first with second `lags` samples later, number of pairs), both (k,), for lags (k,)."""
    pairs = _products(np.isfinite(first).astype(np.float64), np.isfinite(second).astype(np.float64))
    sums = _products(_centred(first), _centred(second))
    n = float(np.isfinite(first).sum())
    return sums[lags] / n, np.round(pairs[lags])


def _products(first: Array, second: Array) -> Array:
    """Sum over t of first(t) second(t + lag), shape (m,); negative lags stand at the end."""
    m = 2 * len(first)
    return np.asarray(
        np.fft.irfft(np.fft.rfft(first, m).conj() * np.fft.rfft(second, m), m), dtype=np.float64
    )


def _bartlett(e: Array, u: Array, lags: NDArray[np.int64]) -> Array:
    """n × covariance of the cross-correlations of independent e and u at lags (k,), shape (k, k).

    Sum over m of rho_e(m) rho_u(m + difference of lags), with estimated autocorrelations. These are tapered,
    since the sum of their errors over all lags would not become small.
    """
    n = int(np.isfinite(e).sum())
    reach = n // 10
    m = np.arange(-reach, reach + 1)
    rho_e = _correlation(e, e, m)[0] * (1.0 - np.abs(m) / (reach + 1.0))
    offsets = np.arange(int(lags[-1] - lags[0]) + 1)
    rho_u = _correlation(u, u, np.arange(-reach - int(offsets[-1]), reach + int(offsets[-1]) + 1))[0]
    by_offset = np.array([rho_e @ rho_u[offsets[-1] + k : offsets[-1] + k + len(m)] for k in offsets])
    return np.asarray(by_offset[np.abs(lags[:, None] - lags)], dtype=np.float64)


def _quadratic(values: Array, covariance: Array) -> tuple[float, int]:
    """(values' covariance⁻¹ values, its degrees of freedom) without directions that hardly vary."""
    sizes, directions = np.linalg.eigh(covariance)
    kept = sizes > KEPT * sizes[-1]
    return float(np.sum((directions.T @ values)[kept] ** 2 / sizes[kept])), int(kept.sum())
