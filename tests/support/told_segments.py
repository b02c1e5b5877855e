"""Made-up segments for the join: what each tells of the unknowns, with white noise."""

import numpy as np
from logs import MACHINE as PACKAGED
from logs import with_exact_lengths
from numpy.typing import NDArray

from tilth.analysis.fit.joint import Linearised
from tilth.analysis.fit.window_terms import SegmentTerms, Terms, places
from tilth.estimator.filters import unknowns

Floats = NDArray[np.float64]
MACHINE = with_exact_lengths(PACKAGED)
MEAN, SD = unknowns.prior(MACHINE)
NO_MODEL = np.full(6, 1e-6)
LEARNED = places(MACHINE)


def told(change: Floats, root: Floats, rng: np.random.Generator, model_sd: Floats = NO_MODEL) -> SegmentTerms:
    """What a segment says that measures root (rows, learned) @ unknowns with white noise of sd 1, around the
    prior's mean. change: (learned,), the truth less the prior's mean."""
    observed = root @ change + rng.normal(size=len(root))
    information = root.T @ root
    gradient = -root.T @ observed
    return (Terms(gradient, information, information, 0.0, model_sd),)


def around(segments: list[SegmentTerms], between_m: float = 0.0) -> Linearised:
    count = len(segments)
    return Linearised(MEAN, tuple(segments), (between_m,) * (count - 1), (30.0,) * count)


def root_of(rng: np.random.Generator, rows: int = 40, scale: float = 3.0) -> Floats:
    root: Floats = rng.normal(size=(rows, len(LEARNED))) * scale / np.sqrt(rows) / SD[LEARNED]
    return root


def drawn(rng: np.random.Generator) -> Floats:
    return np.asarray(SD[LEARNED] * rng.normal(size=len(LEARNED)))


def masses() -> Floats:
    """What the masses add to the covariance of the unknowns learned."""
    added = np.zeros((len(LEARNED), len(LEARNED)))
    m_t, m_i = (SD[k] ** 2 for k in unknowns.MASSES)
    added[:2, :2], added[2, 2] = m_t, m_i
    return added
