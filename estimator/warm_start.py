"""What methods have learned, kept from one run to the next: mean and covariance, older by the time between.

Information fades towards the machine file's prior: with w the share that is left, the new information matrix
is (1 − w) times the prior's and w times what was kept, and the information vector alike. That is positive
definite since both are, and goes from the one to the other.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.methods.estimators import Memory, rows_for
from tilth.schemas.machine import Machine

Array = NDArray[np.float64]

DOUBLES_S: Final = 86_400.0  # in which time the sd of what is well known doubles


@dataclass(frozen=True, slots=True)
class Kept:
    """What one method has learned. Plain data."""

    names: tuple[str, ...]  # of what the vector holds
    mean: Array  # [n]
    covariance: Array  # [n, n]
    age_s: float  # since data last informed it, when it was kept
    counts: dict[str, float]


def keep(machine: Machine, estimators: Mapping[str, Any], t_ns: int) -> dict[str, Kept]:
    """Method -> what it has learned by t_ns; only methods that have learned something.

    estimators: method -> its state, of a machine's rows.
    """
    kept = {}
    for row in rows_for(machine):
        memory, own = row.memory, estimators[row.method]
        if memory is None or not own.informed_ns:
            continue
        kept[row.method] = Kept(
            memory.names,
            getattr(own, memory.mean).copy(),
            getattr(own, memory.covariance).copy(),
            max(t_ns - own.informed_ns, 0) * 1e-9,
            {name: float(getattr(own, name)) for name in memory.counts},
        )
    return kept


def warm(
    machine: Machine, estimators: Mapping[str, Any], kept: Mapping[str, Kept], elapsed_s: float, t_ns: int
) -> dict[str, str]:
    """Let fresh methods go on from what was kept elapsed_s before t_ns.

    Method -> why it could not be used, "" where it is.
    """
    told = {}
    for row in rows_for(machine):
        before = kept.get(row.method)
        if row.memory is None or before is None:
            continue
        own = estimators[row.method]
        told[row.method] = _why_not(row.memory, own, before)
        if not told[row.method]:
            _take(row.memory, own, before, elapsed_s)
            own.informed_ns = t_ns - round((before.age_s + elapsed_s) * 1e9)
    return told


def _why_not(memory: Memory, own: Any, kept: Kept) -> str:
    prior = getattr(own, memory.covariance)
    active = np.diag(prior) > 0.0
    if (kept.names, kept.mean.shape, kept.covariance.shape) != (memory.names, prior.shape[:1], prior.shape):
        return "it is of another version"
    if not (np.all(np.isfinite(kept.mean)) and np.all(np.isfinite(kept.covariance))):
        return "it holds what is no number"
    block = kept.covariance[np.ix_(active, active)]
    if not np.allclose(block, block.T, atol=1e-9) or np.linalg.eigvalsh(block)[0] <= 0.0:
        return "its covariance is none"
    if any(name not in kept.counts for name in memory.counts) or not kept.age_s >= 0.0:
        return "a part of it is missing"
    return ""


def _take(memory: Memory, own: Any, kept: Kept, elapsed_s: float) -> None:
    """Fade what was kept towards the prior, which the fresh state holds, and put it in the prior's place."""
    prior_mean, prior = getattr(own, memory.mean), getattr(own, memory.covariance)
    active = np.flatnonzero(np.diag(prior) > 0.0)
    mean, covariance = kept.mean.copy(), kept.covariance.copy()
    for name in memory.passing:
        k = memory.names.index(name)
        mean[k] = prior_mean[k]
        covariance[k, :] = covariance[:, k] = 0.0
        covariance[k, k] = prior[k, k]
    at = np.ix_(active, active)
    left = 4.0 ** (-elapsed_s / DOUBLES_S)
    was, base = np.linalg.inv(covariance[at]), np.linalg.inv(prior[at])
    information = left * was + (1.0 - left) * base
    vector = left * was @ mean[active] + (1.0 - left) * base @ prior_mean[active]
    faded = np.linalg.inv(information)
    new_mean, new = prior_mean.copy(), prior.copy()
    new_mean[active] = faded @ vector
    new[at] = (faded + faded.T) / 2.0
    setattr(own, memory.mean, new_mean)
    setattr(own, memory.covariance, new)
    for name in memory.counts:
        kind = type(getattr(own, name))
        setattr(own, name, kind(kept.counts[name]) if math.isfinite(kept.counts[name]) else kind())
