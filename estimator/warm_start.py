"""What methods have learned, kept from one run to the next: mean and covariance, older by the time between.

Information fades towards the machine file's prior: with w the share that is left, the new information matrix
is (1 − w) times the prior's and w times what was kept, and the information vector alike. That is positive
definite since both are, and goes from the one to the other.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.methods.estimators import Memory, rows_for
from tilth.estimator.methods.learned import Learned
from tilth.estimator.state_json import Stored, to_plain
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

    def to_json(self) -> dict[str, Any]:
        """For the file between two runs."""
        return {
            "names": list(self.names),
            "mean": to_plain(self.mean),
            "covariance": to_plain(self.covariance),
            "age_s": self.age_s,
            "counts": self.counts,
        }

    @classmethod
    def from_json(cls, plain: Any) -> "Kept":
        """What `to_json` gave. Raises ValueError."""
        stored = Stored(plain, "what was stored")
        kept = cls(
            tuple(stored.value(list[str], "names")),
            stored.array("mean", -1),
            stored.array("covariance", -1, -1),
            stored.value(float, "age_s"),
            stored.value(dict[str, float], "counts"),
        )
        stored.end()
        return kept


def keep(machine: Machine, estimators: Mapping[str, Any], t_ns: int) -> dict[str, Kept]:
    """Method -> what it has learned by t_ns; only methods that have learned something.

    estimators: method -> its state, of a machine's rows.
    """
    kept = {}
    for row in rows_for(machine):
        memory, method_state = row.memory, estimators[row.method]
        if memory is None or not method_state.informed_ns:
            continue
        learned = memory.learned(method_state)
        age_s = max(t_ns - method_state.informed_ns, 0) * 1e-9
        kept[row.method] = Kept(memory.names, learned.mean, learned.covariance, age_s, dict(learned.counts))
    return kept


def resume(
    machine: Machine, estimators: Mapping[str, Any], kept: Mapping[str, Kept], elapsed_s: float, t_ns: int
) -> dict[str, str]:
    """Let fresh methods go on from what was kept elapsed_s before t_ns.

    Method -> why it could not be used, "" where it is.
    """
    refusals = {}
    for row in rows_for(machine):
        before = kept.get(row.method)
        if row.memory is None or before is None:
            continue
        method_state = estimators[row.method]
        fresh = row.memory.learned(method_state)
        refusals[row.method] = _why_not(row.memory, fresh, before)
        if not refusals[row.method]:
            row.memory.resume(method_state, _faded(row.memory, fresh, before, elapsed_s))
            method_state.informed_ns = t_ns - round((before.age_s + elapsed_s) * 1e9)
    return refusals


def _why_not(memory: Memory, fresh: Learned, kept: Kept) -> str:
    prior = fresh.covariance
    active = np.diag(prior) > 0.0
    if (kept.names, kept.mean.shape, kept.covariance.shape) != (memory.names, prior.shape[:1], prior.shape):
        return "it is of another version"
    if not (np.all(np.isfinite(kept.mean)) and np.all(np.isfinite(kept.covariance))):
        return "it holds what is no number"
    block = kept.covariance[np.ix_(active, active)]
    if not np.allclose(block, block.T, atol=1e-9) or np.linalg.eigvalsh(block)[0] <= 0.0:
        return "its covariance is none"
    if any(name not in kept.counts for name in fresh.counts) or not kept.age_s >= 0.0:
        return "a part of it is missing"
    return ""


def _faded(memory: Memory, fresh: Learned, kept: Kept, elapsed_s: float) -> Learned:
    """What was kept, elapsed_s older: nearer to the prior, which a fresh state holds."""
    prior_mean, prior = fresh.mean, fresh.covariance
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
    return Learned(new_mean, new, kept.counts)
