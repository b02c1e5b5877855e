"""A season of one tractor with one implement, put together: a second fold over what stretches told.

As the daemon does it from run to run: information adds up, the six drift over the distance driven
(filters/drift.py), what was learned fades over the time between two runs (warm_start.py), a stretch that
contradicts what was known begins anew, and errors of the model do not average out
(fit_covariance.mixed), nor do those of the machine file (widening.py). Then smoothed backwards over the whole
season (fixed interval; Rauch, Tung and Striebel 1965), so that a stretch of spring knows what summer told.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tilth.analysis.season.identified import Stretch
from tilth.estimator.filters import fit_covariance, unknowns
from tilth.estimator.filters.drift import added_covariance, retained_share
from tilth.estimator.filters.unknowns import SIX
from tilth.estimator.methods import pem
from tilth.estimator.warm_start import share_left
from tilth.schemas.machine import Machine

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SixKnown:
    """Of the six logarithms."""

    mean: Array  # (6,)
    covariance: Array  # (6, 6), with errors of the machine file and of the model


@dataclass(frozen=True, slots=True)
class MergedStretch:
    """What is known of the soil of one stretch."""

    alone: SixKnown  # by the machine file and it
    forward: SixKnown  # by all up to it
    smoothed: SixKnown  # by the whole season


@dataclass(frozen=True, slots=True)
class _DriftStep:
    """From what was known at the stretch before to what is thought before this one: x' = F x + noise."""

    transition: Array  # (6, 6)
    noise: Array  # (6, 6)


def merged(machine: Machine, stretches: Sequence[Stretch], pauses_s: Sequence[float]) -> list[MergedStretch]:
    """In the order of driving. pauses_s: of each, the time since the run before where it is the first of its
    run, else 0."""
    if not stretches:
        return []
    from filterpy.kalman import rts_smoother  # takes matplotlib with it

    mean, sd = (part[SIX] for part in unknowns.prior(machine))
    free = np.flatnonzero(sd > 0.0)
    prior = np.diag(sd[free] ** 2)
    masses = pem.of_masses(np.diag(unknowns.prior(machine)[1] ** 2))[SIX, SIX]

    def known(one: Stretch, state: Array, covariance: Array, errors: Array) -> SixKnown:
        whole_mean = mean.copy()
        whole = masses + (0.0 if one.by_file is None else one.by_file)  # the same file in all, so it stays
        whole_mean[free] += state
        whole[np.ix_(free, free)] += covariance + np.diag(errors[free] ** 2)
        return SixKnown(whole_mean, (whole + whole.T) / 2.0)

    state, covariance, errors = np.zeros(len(free)), prior, np.zeros(6)
    alone, means, covariances, model_sds, steps = [], [], [], [], list[_DriftStep]()
    for one, pause_s in zip(stretches, pauses_s, strict=True):
        information, vector = one.information[np.ix_(free, free)], one.vector[free]
        alone.append(known(one, *_updated(np.zeros(len(free)), prior, information, vector), one.model_sd))
        step = _step(covariance, prior, one, pause_s)
        common = np.zeros(6) if one.changed else np.minimum(errors, one.model_sd)
        given_up = np.zeros(6) if one.changed else errors**2 - common**2
        step = _DriftStep(step.transition, step.noise + np.diag(given_up[free]))
        steps.append(step)
        state = step.transition @ state
        covariance = step.transition @ covariance @ step.transition.T + step.noise
        before = _spread(covariance, free)
        state, covariance = _updated(state, covariance, information, vector)
        errors = fit_covariance.mixed(common, one.model_sd, before, _spread(covariance, free))
        means.append(state)
        covariances.append(covariance)
        model_sds.append(errors)
    moved = [*steps[1:], _DriftStep(np.eye(len(free)), prior)]  # the last is not used
    smooth = rts_smoother(
        np.array(means), np.array(covariances),
        [step.transition for step in moved], [step.noise for step in moved],
    )  # fmt: skip
    smooth_sds = [model_sds[-1]]
    for k in range(len(stretches) - 2, -1, -1):  # of what came before, and of what came after
        before, after = _spread(covariances[k], free), _spread(smooth[1][k], free)
        smooth_sds.insert(0, fit_covariance.mixed(model_sds[k], smooth_sds[0], before, after))
    return [
        MergedStretch(by_it, known(one, m, p, e), known(one, sm, sp, se))
        for one, by_it, m, p, e, sm, sp, se in zip(
            stretches, alone, means, covariances, model_sds, smooth[0], smooth[1], smooth_sds, strict=True
        )
    ]


def _step(covariance: Array, prior: Array, one: Stretch, pause_s: float) -> _DriftStep:
    size = len(prior)
    if one.changed:  # all that was known is given up
        return _DriftStep(np.zeros((size, size)), prior)
    if pause_s > 0.0:
        return _faded(covariance, prior, share_left(pause_s))
    share = retained_share(one.metres)
    return _DriftStep(share * np.eye(size), added_covariance(share, np.sqrt(np.diag(prior))))


def _faded(covariance: Array, prior: Array, share: float) -> _DriftStep:
    """What the warm start does with what was learned, as a step of a linear system: of the information that
    was there a share is left, and the prior's is the rest. Both give the same mean and covariance."""
    before, of_prior = np.linalg.inv(covariance), np.linalg.inv(prior)
    after = np.linalg.inv(share * before + (1.0 - share) * of_prior)
    noise = after @ (share * (1.0 - share) * before + (1.0 - share) * of_prior) @ after
    return _DriftStep(share * after @ before, (noise + noise.T) / 2.0)


def _updated(state: Array, covariance: Array, information: Array, vector: Array) -> tuple[Array, Array]:
    before = np.linalg.inv(covariance)
    after = np.linalg.inv(before + information)
    after = (after + after.T) / 2.0
    return after @ (before @ state + vector), after


def _spread(covariance: Array, free: NDArray[np.int64]) -> Array:
    """Variances of the six, (6,): 0 of what is fixed."""
    variances = np.zeros(6)
    variances[free] = np.diag(covariance)
    return variances
