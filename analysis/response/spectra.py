"""Transfer of one input to several outputs by segment spectra: value, coherence, 95 % region, independence.

Source: Bendat and Piersol, Random Data, on the random errors of frequency response estimates, for segments
that overlap. The region holds given the input: of the noise it wants a spectrum that is smooth over
one line, of the input nothing, so that steps and chirps may be used too.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, stdtrit

from tilth.analysis.response.segments import Array, Complex, SegmentPlan, overlap_correlation

OUTSIDE: Final = 0.05  # probability that the truth lies outside of a band


@dataclass(frozen=True, slots=True)
class Transfer:
    """Estimated at f frequencies for p outputs. Units are those of output per input."""

    value: Complex  # (f, p), S_uy / S_uu
    variance: Array  # (f, p), expected square of the distance from the true response in the complex plane
    coherence: Array  # (f, p), gamma² of input and output
    p_value: Array  # (f, p), probability of so much coherence or more if output and input are independent
    input_density: Array  # (f,), S_uu, unit²/Hz
    freedom: float  # L - 1, pairs of degrees of freedom of the noise


@dataclass(frozen=True, slots=True)
class Band:
    """95 % bands, each by itself, shapes (f, p)."""

    radius: Array  # of the circle in the complex plane
    gain_low: Array
    gain_high: Array
    phase_half: Array  # rad, up to pi: then the phase is unknown


def transfer(u: Complex, y: Complex, plan: SegmentPlan) -> Transfer:
    """The transfer from u, shape (k, f), to y, shape (k, f, p), spectra of plan's segments.

    An input that is zero at a frequency gives zero there, with an infinite variance.
    """
    k = len(plan.starts)
    powered = np.sum(np.abs(u) ** 2, axis=0)
    safe = np.where(powered > 0.0, powered, 1.0)
    cross = np.einsum("kf,kfp->fp", u.conj(), y)
    total = np.sum(np.abs(y) ** 2, axis=0)
    explained = np.abs(cross) ** 2 / safe[:, None]
    # Noise of neighbours is correlated by the overlap. How far their errors add up depends on the input's
    # phases in both: with this input, the explained share of the noise is `shared` times its density.
    pairs = np.einsum("kf,kf,k->f", u[:-1].conj(), u[1:], overlap_correlation(plan)).real
    shared = np.where(powered > 0.0, 1.0 + 2.0 * pairs / safe, 1.0)[:, None]
    freedom = plan.independent - 1.0
    noise = np.maximum(total - explained, 0.0) / (k - shared)
    least = np.finfo(np.float64).tiny
    variance = np.where(powered[:, None] > 0.0, np.maximum(noise * shared, least) / safe[:, None], np.inf)
    value = cross / safe[:, None]
    ratio = np.abs(value) ** 2 / variance
    return Transfer(
        value=value,
        variance=variance,
        coherence=np.divide(explained, total, out=np.zeros_like(total), where=total > 0.0),
        # gamma² ~ Beta(1, L - 1), written for the ratio ~ F(2, 2 L - 2).
        p_value=(1.0 + ratio / freedom) ** -freedom,
        input_density=powered / k,
        freedom=freedom,
    )


def band(value: Complex, variance: Array, freedom: float) -> Band:
    """95 % bands of a response. value, variance: (f, p); freedom: as of `Transfer`.

    The circle by F(2, 2 L - 2); gain and phase, each alone, by Student's t, since only the error along the
    response changes its gain. Where the circle holds zero, the gain may be zero and the phase anything.
    """
    radius = np.sqrt(variance * freedom * (OUTSIDE ** (-1.0 / freedom) - 1.0))
    half = float(stdtrit(2.0 * freedom, 1.0 - OUTSIDE / 2.0)) * np.sqrt(variance / 2.0)
    gain = np.abs(value)
    lost = gain <= radius
    sine = np.divide(half, gain, out=np.ones_like(gain), where=~lost)
    return Band(
        radius=radius,
        gain_low=np.where(lost, 0.0, gain - half),
        gain_high=gain + half,
        phase_half=np.where(lost, np.pi, np.arcsin(np.minimum(sine, 1.0))),
    )


def combined_p_value(p_value: Array, chosen: NDArray[np.bool_]) -> Array:
    """One probability for each output, shape (p,), by Fisher's method over the chosen frequencies.

    p_value: (f, p), chosen: (f,). Every second line only: Hann's window ties neighbours together. 1 where
    nothing is chosen.
    """
    lines = p_value[chosen][::2]
    if len(lines) == 0:
        return np.ones(p_value.shape[1])
    logs = np.log(np.maximum(lines, np.finfo(np.float64).tiny))
    return np.asarray(chdtrc(2.0 * len(lines), -2.0 * logs.sum(axis=0)), dtype=np.float64)
