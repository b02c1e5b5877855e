"""What a window of driving says of the unknowns near a common point: the terms that add up over windows.

As in pem, the ground's shaking may tell of other tyres than steering does (likelihood.apart_from_ground).
Noise levels stay as each window's own fit has them.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tilth.analysis.fit.segment_fit import FittedWindow
from tilth.estimator.filters import fit_covariance, likelihood, scoring, unknowns
from tilth.estimator.filters.rig_setup import rig_setup
from tilth.estimator.filters.unknowns import NOISE
from tilth.schemas.machine import Machine

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Terms:
    """Of one window, over the a unknowns of `places`, at a point; without the prior."""

    gradient: Array  # (a,), of the cost
    information: Array  # (a, a)
    scores: Array  # (a, a), covariance of the gradient with its correlation over time
    whiteness: float
    model_sd: Array  # (6,)


SegmentTerms = tuple[Terms, ...]  # of the windows of one segment


def places(machine: Machine) -> NDArray[np.int64]:
    """The unknowns that windows have in common: (a,), indices of unknowns.NAMES. Masses are considered, as in
    pem, and noise levels each window's own."""
    free = unknowns.prior(machine)[1] > 0.0
    free[NOISE] = False
    free[list(unknowns.MASSES)] = False
    return np.flatnonzero(free)


def terms_at(machine: Machine, window: FittedWindow, point: Array) -> Terms:
    """point: [n] of unknowns.NAMES; its noise levels are not used."""
    mean, sd = unknowns.prior(machine)
    shared = places(machine)
    free = np.zeros(len(sd))
    free[shared] = sd[shared] ** 2
    here = point.copy()
    here[NOISE] = window.noise
    search = likelihood.search_of(window.record, rig_setup(machine), mean, np.diag(free))
    scoring.leave_out_outliers(search, here)
    at = likelihood.evaluate(search, here, instruments=likelihood.response_to_steering(search, here))
    known, information = likelihood.apart_from_ground(search, at)
    scores = likelihood.scores_at(search, known)
    gradient, _ = likelihood.gradient_and_information(search, known, scores)
    away = (here - mean)[shared]
    return Terms(
        gradient - search.prior_information @ away,
        information - search.prior_information,
        fit_covariance.scores_covariance(search, scores),
        fit_covariance.whiteness(search.record.rows, search.scored, at.e, at.S),
        fit_covariance.model_sd_of(window.record, here),
    )
