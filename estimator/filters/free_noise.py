"""A likelihood with a noise model of its own: innovations regressed on their past, whatever they are made of.

Behind a nominal filter innovations e(theta), (n, c), are not white, since the ground is not as the filter
has it: one rut meets the axles one after the other, and under feedback the steering answers it. They follow
their own past,

    e_k = A_1 e_k-1 + ... + A_m e_k-m + w_k,

all outputs together (Ljung's direct method, with a high-order vector autoregression behind the filter). The
slopes of the white rest w are psi_k = S_k - A_1 S_k-1 - ... with the same A. Information is the part of psi
that the past cannot explain, so what the ground made the steering do counts for nothing.

The coefficients of lag j have a prior of sd `spread` / j about zero: with it the order hardly matters. A
narrow one is paid for where steering answers the past: what large coefficients alone could explain counts as
the steering's own, and pulls theta to where the coefficients are small.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from tilth.estimator.tuning import tuned

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class FreeNoiseTuning:
    """Of the regression on the past."""

    spread: float = tuned(1.0, "1", "prior sd of a coefficient of lag 1; over the lag of the others")
    """Under 0.3, which the likelihood prefers, 128 of 144 intervals of 24 rows held, under 1 131; C_ai was
    0.9 and 0.5 sd low on average."""


FREE_NOISE: Final = FreeNoiseTuning()


@dataclass(frozen=True, slots=True)
class FreeNoise:
    """The regression of innovations on their past."""

    order: int
    past: Array  # (n, p), lag 1 first, each of c outputs
    inverse: Array  # (p, p), of the lower root of the normal equations: past' past and the prior
    coefficients: Array  # (p, c)
    rest: Array  # (n, c), w
    freedom: float  # n less the effective number of coefficients of an output
    covariance: Array  # (c, c), of w

    @property
    def cost(self) -> float:
        """Negative log-likelihood with the covariance of w maximised out, nats, up to a constant."""
        sign, log = np.linalg.slogdet(self.covariance)
        return 0.5 * self.freedom * float(log) if sign > 0 else np.inf

    def share_of_own(self, values: Array) -> float:
        """Of the variance of a value at each epoch, (n,), that the past does not explain: 1 less the adjusted
        R^2."""
        values = values - values.mean()
        seen = self.inverse @ (self.past.T @ values)
        total = float(values @ values)
        unexplained = (total - float(seen @ seen)) / self.freedom * len(values)
        return min(unexplained / total, 1.0) if total > 0.0 else 0.0


def lagged(stretches: Sequence[Array], order: int) -> Array:
    """The past of each epoch but the first `order` of each stretch, (n, order c), lag 1 first.

    stretches: (n_i, c) each, epochs without a gap.
    """
    return np.concatenate([
        np.concatenate([e[order - j : len(e) - j] for j in range(1, order + 1)], axis=1) for e in stretches
    ])  # fmt: skip


def regress(stretches: Sequence[Array], order: int, spread: float | None = None) -> FreeNoise:
    """Regress innovations, (n_i, c) of each stretch, on their past. Each stretch is longer than `order`.

    spread: that of the coefficients; None: FREE_NOISE's.
    """
    past, outputs = lagged(stretches, order), stretches[0].shape[1]
    now = np.concatenate([e[order:] for e in stretches])
    prior = np.repeat((np.arange(1, order + 1) / (spread or FREE_NOISE.spread)) ** 2, outputs)
    gram = past.T @ past
    root = np.linalg.cholesky(gram + np.diag(prior))
    inverse = np.asarray(solve_triangular(root, np.eye(len(root)), lower=True, check_finite=False))
    coefficients = inverse.T @ (inverse @ (past.T @ now))
    rest = now - past @ coefficients
    freedom = len(now) - len(root) + float(np.sum(inverse**2 * prior))
    covariance = (rest.T @ rest + coefficients.T @ (prior[:, None] * coefficients)) / freedom
    return FreeNoise(order, past, inverse, coefficients, rest, freedom, covariance)


def gradient_and_information(noise: FreeNoise, stretches: Sequence[Array]) -> tuple[Array, Array]:
    """(gradient (a,), information (a, a)) of the cost.

    stretches: slopes of the innovations, (n_i, c, a) each.
    """
    psi, weight = _white_slopes(noise, stretches)
    unknowns = psi.shape[2]
    flat = psi.reshape(-1, unknowns)
    shared = noise.past.T @ psi.reshape(len(psi), -1)
    explained = (noise.inverse @ shared).reshape(-1, unknowns)
    return (noise.rest @ weight).ravel() @ flat, flat.T @ flat - explained.T @ explained


def of_pieces(noise: FreeNoise, stretches: Sequence[Array], pieces: Sequence[slice]) -> tuple[Array, Array]:
    """The same of each piece, (k, a) and (k, a, a), by what the past of all cannot explain. pieces: of the
    epochs of all stretches but the first `order` of each."""
    psi, weight = _white_slopes(noise, stretches)
    n, _, unknowns = psi.shape
    seen = noise.inverse.T @ (noise.inverse @ (noise.past.T @ psi.reshape(n, -1)))
    own = psi - (noise.past @ seen).reshape(psi.shape)
    rest, flat = noise.rest @ weight, [own[piece].reshape(-1, unknowns) for piece in pieces]
    gradients = [rest[piece].ravel() @ each for piece, each in zip(pieces, flat, strict=True)]
    return np.array(gradients), np.array([each.T @ each for each in flat])


def _white_slopes(noise: FreeNoise, stretches: Sequence[Array]) -> tuple[Array, Array]:
    """(slopes of the rest (n, c, a), of outputs that are independent and of variance 1; by which weights
    (c, c) the rest becomes so)."""
    order, outputs, unknowns = noise.order, stretches[0].shape[1], stretches[0].shape[2]
    weight: Array = np.asarray(np.linalg.cholesky(np.linalg.inv(noise.covariance)), np.float64)
    of_lags = noise.coefficients.reshape(order, outputs, outputs)[::-1].reshape(-1, outputs)  # oldest first
    whitening = np.ascontiguousarray((np.concatenate([-of_lags, np.eye(outputs)]) @ weight).T)
    parts = []
    for S in stretches:
        each = np.ascontiguousarray(S)
        size, (by_epoch, _, by_unknown) = (order + 1) * outputs, each.strides
        windows = as_strided(  # of an epoch with its past, without a copy
            each, (len(each) - order, size, unknowns), (by_epoch, unknowns * by_unknown, by_unknown)
        )
        parts.append(np.matmul(whitening, windows))
    return np.concatenate(parts), weight
