"""Warm start: each method's posterior (mean and covariance) is saved and serves as the next run's prior.

It fades towards the machine file's prior over the time between the runs. With w the share that remains, the
new information matrix is w times the saved one plus (1 − w) times the prior's; the information vector is
mixed in the same way. The result is positive definite because both matrices are.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.filters.soil_field import KeptSoil
from tilth.estimator.methods.estimators import Memory, rows_for
from tilth.estimator.methods.learned import Learned
from tilth.estimator.state_json import Shape
from tilth.estimator.tuning import tuned
from tilth.schemas.machine import Machine
from tilth.schemas.reasons import Code

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class WarmStartTuning:
    """How what was learned fades from run to run."""

    doubles_s: float = tuned(86_400.0, "s", "in which the sd of a well-known number doubles")


WARM_START: Final = WarmStartTuning()


def share_left(elapsed_s: float) -> float:
    """Of the information that a run had, so much later."""
    return float(4.0 ** (-elapsed_s / WARM_START.doubles_s))


@dataclass(frozen=True, slots=True)
class SavedPosterior:
    """What one method had learned when a run ended."""

    names: tuple[str, ...]  # [n], of the entries of the mean
    mean: Annotated[Array, Shape((-1,))]
    covariance: Annotated[Array, Shape((-1, -1))]
    age_s: float  # time from the last data that it learned from to the moment of saving
    counts: dict[str, float]  # counters that continue, by name
    soil: KeptSoil | None = None  # of the method place


def save_learned(machine: Machine, estimators: Mapping[str, Any], t_ns: int) -> dict[str, SavedPosterior]:
    """Method -> what it has learned by t_ns; only methods that have learned something.

    estimators: method -> its state.
    """
    saved = {}
    for row in rows_for(machine):
        memory, method_state = row.memory, estimators[row.method]
        if memory is None or not method_state.informed_ns:
            continue
        learned = memory.learned(method_state)
        age_s = max(t_ns - method_state.informed_ns, 0) * 1e-9
        saved[row.method] = SavedPosterior(
            memory.names, learned.mean, learned.covariance, age_s, dict(learned.counts), learned.soil
        )
    return saved


def resume(
    machine: Machine,
    estimators: Mapping[str, Any],
    saved: Mapping[str, SavedPosterior],
    elapsed_s: float,
    t_ns: int,
) -> dict[str, Code | None]:
    """Start fresh method states from what was saved elapsed_s before t_ns.

    Returns method -> why its saved posterior is not used, None where it is used.
    """
    refusals: dict[str, Code | None] = {}
    for row in rows_for(machine):
        before = saved.get(row.method)
        if row.memory is None or before is None:
            continue
        method_state = estimators[row.method]
        fresh = row.memory.learned(method_state)
        refusal = refusals[row.method] = _refusal(row.memory, fresh, before)
        if refusal is None:
            method_state.informed_ns = t_ns - round((before.age_s + elapsed_s) * 1e9)
            row.memory.resume(method_state, _faded(row.memory, fresh, before, elapsed_s))
    return refusals


def _refusal(memory: Memory, fresh: Learned, saved: SavedPosterior) -> Code | None:
    """Why a saved posterior cannot be used."""
    prior = fresh.covariance
    active = np.diag(prior) > 0.0
    expected = (memory.names, prior.shape[:1], prior.shape)
    if (saved.names, saved.mean.shape, saved.covariance.shape) != expected:
        return Code.SAVED_BY_ANOTHER_VERSION
    finite = np.all(np.isfinite(saved.mean)) and np.all(np.isfinite(saved.covariance))
    if not finite or not (saved.soil is None or saved.soil.finite):
        return Code.SAVED_NOT_FINITE
    block = saved.covariance[np.ix_(active, active)]
    if not np.allclose(block, block.T, atol=1e-9) or np.linalg.eigvalsh(block)[0] <= 0.0:
        return Code.SAVED_WITHOUT_COVARIANCE
    if any(name not in saved.counts for name in fresh.counts) or not saved.age_s >= 0.0:
        return Code.SAVED_INCOMPLETE
    return None


def _faded(memory: Memory, fresh: Learned, saved: SavedPosterior, elapsed_s: float) -> Learned:
    """The saved posterior after elapsed_s: nearer to the prior, which is the mean and covariance of
    `fresh`."""
    prior_mean, prior = fresh.mean, fresh.covariance
    active = np.flatnonzero(np.diag(prior) > 0.0)
    mean, covariance = saved.mean.copy(), saved.covariance.copy()
    for name in memory.per_run:
        k = memory.names.index(name)
        mean[k] = prior_mean[k]
        covariance[k, :] = covariance[:, k] = 0.0
        covariance[k, k] = prior[k, k]
    block = np.ix_(active, active)
    share = share_left(elapsed_s)
    saved_information, prior_information = np.linalg.inv(covariance[block]), np.linalg.inv(prior[block])
    information = share * saved_information + (1.0 - share) * prior_information
    vector = share * saved_information @ mean[active] + (1.0 - share) * prior_information @ prior_mean[active]
    faded = np.linalg.inv(information)
    new_mean, new = prior_mean.copy(), prior.copy()
    new_mean[active] = faded @ vector
    new[block] = (faded + faded.T) / 2.0
    return Learned(new_mean, new, saved.counts, saved.soil)
