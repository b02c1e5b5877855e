"""A likelihood with a noise model of its own: innovations regressed on their past, whatever they are made of.

Behind a nominal filter innovations e(theta), (n, c), are not white, since the ground is not as the filter
has it: one rut meets the axles one after the other, and under feedback the steering answers it. They follow
their own past,

    e_k = A_1 e_k-1 + ... + A_m e_k-m + w_k,

all outputs together (Ljung's direct method, with a high-order vector autoregression behind the filter). The
slopes of the white rest w are psi_k = S_k - A_1 S_k-1 - ... with the same A. Information is the part of psi
that the past cannot explain, so what the ground made the steering do counts for nothing.

The coefficients of lag j have a prior of sd SPREAD / j about zero: with it the order hardly matters.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SPREAD: Final = 0.3  # prior sd of a coefficient of lag 1


@dataclass(frozen=True, slots=True)
class FreeNoise:
    """The regression of innovations on their past."""

    order: int
    starts: tuple[int, ...]  # of each stretch among the epochs, and the end of the last
    basis: Array  # (n + p, p), orthonormal, of the past; the last p rows are those of the prior
    coefficients: Array  # (p, c), of lag 1 first
    rest: Array  # (n + p, c), w; the last p rows are those of the prior
    freedom: float  # n less the effective number of coefficients of an output

    @property
    def cost(self) -> float:
        """Negative log-likelihood with the covariance of w maximised out, nats, up to a constant."""
        sign, log = np.linalg.slogdet(self.covariance)
        return 0.5 * self.freedom * float(log) if sign > 0 else np.inf

    @property
    def covariance(self) -> Array:
        """Of w, (c, c)."""
        return np.asarray(self.rest.T @ self.rest / self.freedom)

    def explained(self, values: Array) -> Array:
        """What the past explains of a value at each epoch, (n,)."""
        basis = self.basis[: len(values)]
        return np.asarray(basis @ (basis.T @ values))


def lagged(stretches: Sequence[Array], order: int) -> Array:
    """The past of each epoch but the first `order` of each stretch, (n, order c), lag 1 first.

    stretches: (n_i, c) each, epochs without a gap.
    """
    return np.concatenate([
        np.concatenate([e[order - j : len(e) - j] for j in range(1, order + 1)], axis=1) for e in stretches
    ])  # fmt: skip


def regress(stretches: Sequence[Array], order: int) -> FreeNoise:
    """Regress innovations, (n_i, c) of each stretch, on their past. Each stretch is longer than `order`."""
    past = lagged(stretches, order)
    outputs = stretches[0].shape[1]
    prior = np.diag(np.repeat(np.arange(1, order + 1), outputs) / SPREAD)
    now = np.concatenate([*(e[order:] for e in stretches), np.zeros((len(prior), outputs))])
    basis, triangle = np.linalg.qr(np.concatenate([past, prior]))
    coefficients = np.asarray(np.linalg.solve(triangle, basis.T @ now), np.float64)
    rest = now - basis @ (basis.T @ now)
    n = len(past)
    starts = np.cumsum([0, *(len(e) - order for e in stretches)])
    freedom = n - float(np.sum(basis[:n] ** 2))
    return FreeNoise(order, tuple(starts.tolist()), basis, coefficients, rest, freedom)


def slopes_left(noise: FreeNoise, stretches: Sequence[Array]) -> Array:
    """Slopes of the rest w that the past cannot explain, (n + p, c, a).

    stretches: slopes of the innovations, (n_i, c, a) each.
    """
    order, (_, outputs, unknowns) = noise.order, stretches[0].shape
    blocks = noise.coefficients.reshape(order, outputs, outputs)
    left = []
    for S in stretches:
        psi = S[order:].copy()
        for j in range(1, order + 1):
            psi -= np.einsum("nia,io->noa", S[order - j : len(S) - j], blocks[j - 1])
        left.append(psi)
    psi = np.concatenate([*left, np.zeros((len(noise.coefficients), outputs, unknowns))])
    flat = psi.reshape(len(psi), -1)
    return np.asarray((flat - noise.basis @ (noise.basis.T @ flat)).reshape(psi.shape))


def gradient_and_information(noise: FreeNoise, left: Array) -> tuple[Array, Array]:
    """(gradient (a,), information (a, a)) of the cost. left: as of `slopes_left`."""
    root = np.linalg.cholesky(np.linalg.inv(noise.covariance))
    weighted = np.einsum("noa,oi->nia", left, root).reshape(-1, left.shape[2])
    return weighted.T @ (noise.rest @ root).reshape(-1), weighted.T @ weighted
