"""How far errors of the machine file that driving has not excluded may have moved the six parameters.

A file is right, or one of its numbers is wrong by as much as people are wrong in it: hypotheses of which one
holds. Driving weighs them (the evidence of the open tracker for each), and tells how large an error is if it
is there. The slopes of the six by the errors make variances of that, which are added to those of every
method, each by the probability of its hypothesis. So a number is published as soon as no error that may still
be in the file makes it useless, and it is as wide as the file may be wrong.

What no single error explains is an error of the model: what is found is as much less certain as that misfit
is too large (Birge's ratio). A method's own sd stays: its noise is as large as the data are off already.

Soil that may be otherwise here than where a method has learned widens in the same way what is recommended.
"""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.diagnosis.open_numbers import BY_FIT, HYPOTHESES, NAMES, Misfit, OpenEvidence
from tilth.estimator.filters import unknowns
from tilth.estimator.pose.aligner import ALIGNMENT
from tilth.estimator.rig.numbers import NUMBER
from tilth.estimator.state_json import Shape
from tilth.estimator.ties import exceeds, within
from tilth.estimator.tuning import tuned
from tilth.schemas.flow import Estimate, ParameterEstimate, Status
from tilth.schemas.reasons import Code, Combination, Reason

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class WideningTuning:
    """What is added to the published variances for the machine file."""

    wrong: float = tuned(2 / 3, "1", "probability that a file has a wrong number, before driving")
    """Then a number that is the only one of which driving tells nothing is wrong with 1 in 11, so that any
    error of it is within 4 of the published sds."""
    widest: float = tuned(0.3, "1", "sd of a logarithm above which a number is not given for the file's sake")
    least: float = tuned(1.1, "1", "factor by which the file must widen a number before it is not given")
    withdrawn: float = tuned(1.2, "1", "factor on that limit for a number that was given before")
    said: float = tuned(1.2, "1", "factor from which the reason says by what a number is widened")
    elsewhere: float = tuned(
        0.42, "1", "sd of a logarithm above which a number of other soil is not given, nor by `place`"
    )
    confirmed: float = tuned(
        0.2, "1", "largest sd of C_af, C_ar and C_ai by the file with which it is confirmed"
    )
    shortest_s: float = tuned(10.0, "s", "shortest time of steering that is asked for")
    longest_s: float = tuned(120.0, "s", "longest time of steering that is asked for")


WIDENING: Final = WideningTuning()
SEGMENT_S: Final = ALIGNMENT.pose_ns * 1e-9
_WRONG_BY: Final = np.array([row.open_sd**2 for row in HYPOTHESES])
_UNEVEN: Final = np.array([row.uneven_sd for row in HYPOTHESES])
_OFTEN: Final = np.array(
    [0.0 if row.name in [unknowns.NAMES[k] for k in unknowns.MASSES] else row.often for row in HYPOTHESES]
)
"""How often each is the wrong one. Never the implement's mass: the methods do not learn it either, and have
the file's sd of it."""


def _largest(widest: float, own: float) -> float:
    """Largest sd of a logarithm that is given: never less than a share of the method's own."""
    return max(widest, WIDENING.least * own)


@dataclass(slots=True)
class Widening:
    """What errors of the file do to the covariance of the six logarithms."""

    covariance: Annotated[Array, Shape((6, 6))] = field(default_factory=lambda: np.zeros((6, 6)))  # added
    by: list[str] = field(default_factory=lambda: [NAMES[0]] * 6)  # of each: the number that adds most
    doubted: list[bool] = field(default_factory=lambda: [False] * 6)  # that is off, not only unknown yet
    learned_s: float = 0.0  # of driving, from which this is known

    @property
    def confirms(self) -> bool:
        """Whether no error that may still be in the file moves a stiffness by much."""
        return within(float(np.sqrt(np.diag(self.covariance)[:3]).max()), WIDENING.confirmed)

    def limit(self, own: float, had: bool = False) -> float:
        """Largest sd of a logarithm that is given. own: by the method; had: it was given before."""
        return _largest(WIDENING.widest, own) * (WIDENING.withdrawn if had else 1.0)

    def reason(self, k: int, own: float, limit: float) -> Reason | None:
        """Why parameter k is wide, or not given; None where nothing is to be said."""
        added, key = math.sqrt(self.covariance[k, k]), NUMBER[self.by[k]].key
        total = math.hypot(own, added)
        if within(total, limit):
            return Reason(Code.WIDENED, (key,), (added,)) if exceeds(total, WIDENING.said * own) else None
        if self.doubted[k]:
            return Reason(Code.DOUBTED, (key,))
        seconds = self.learned_s * (added**2 / (limit**2 - own**2) - 1.0)  # variances fall with the time
        seconds = min(max(seconds, WIDENING.shortest_s), WIDENING.longest_s)
        return Reason(Code.NOT_EXCLUDED, (key,), (total, seconds))


@dataclass(frozen=True, slots=True)
class OfSoil:
    """What other soil here than where a method has learned does to the six, as `Widening` of the file."""

    covariance: Array  # (6, 6), of logarithms

    def limit(self, own: float, had: bool = False) -> float:
        """As of `Widening`; what was given before is given no longer."""
        return _largest(WIDENING.elsewhere, own)

    def reason(self, k: int, own: float, limit: float) -> Reason | None:
        """As of `Widening`."""
        total = math.hypot(own, math.sqrt(self.covariance[k, k]))
        if within(total, WIDENING.said * own):
            return None
        return Reason(Code.OTHER_SOIL if within(total, limit) else Code.NOT_KNOWN_HERE, numbers=(total,))


@dataclass(frozen=True, slots=True)
class OfEvenGround:
    """What taking the ground for even leaves out of the uncertainty of the six."""

    covariance: Array  # (6, 6), of logarithms

    def limit(self, own: float, had: bool = False) -> float:
        """As of `Widening`; what was given before is given no longer."""
        return _largest(WIDENING.widest, own)

    def reason(self, k: int, own: float, limit: float) -> Reason | None:
        """As of `Widening`."""
        total = math.hypot(own, math.sqrt(self.covariance[k, k]))
        return None if within(total, limit) else Reason(Code.WIDE, numbers=(total,))


@dataclass(frozen=True, slots=True)
class OfLoad:
    """What is not known of the implement's load does to the six."""

    covariance: Array  # (6, 6), of logarithms
    over_mass: float  # of the covariance, what is of C_ai over the mass

    def limit(self, own: float, had: bool = False) -> float:
        """As of `Widening`; what was given before is given no longer."""
        return _largest(WIDENING.widest, own)

    def reason(self, k: int, own: float, limit: float) -> Reason | None:
        """As of `Widening`."""
        added = math.sqrt(self.covariance[k, k])
        if math.hypot(own, added) <= limit:
            return None
        return Reason(Code.OF_THE_MASS, ("implement.mass",), (added, own))


_Wider = Widening | OfSoil | OfLoad | OfEvenGround


def widening_of(evidence: OpenEvidence, known: Collection[str] = (), fit: Misfit | None = None) -> Widening:
    """known: numbers that need no proof any more. fit: what fits of whole windows have found: of BY_FIT they
    know more, and their misfit elsewhere is of other numbers."""
    misfit, found = evidence.misfit, evidence.misfit.found
    birge = max((misfit.total - float(((found / misfit.alone) ** 2).max())) / (len(NAMES) - 1), 1.0)
    noise = birge * misfit.alone**2 + (evidence.uneven * _UNEVEN) ** 2
    if fit is not None:
        found, noise = np.where(BY_FIT, fit.found, found), np.where(BY_FIT, fit.alone**2, noise)
    share = _WRONG_BY / (_WRONG_BY + noise)  # of what is found that is no noise
    log_factors = 0.5 * (share * found**2 / noise - np.log1p(_WRONG_BY / noise))
    often = np.where([row.name in known for row in HYPOTHESES], 0.0, _OFTEN) if known else _OFTEN
    of_noise, error = share * noise, (share * found) ** 2
    parts = misfit.moves * np.sqrt(_probabilities(log_factors, often) * (of_noise + error))
    by = np.argmax(np.abs(parts), axis=1)
    return Widening(
        parts @ parts.T, [HYPOTHESES[k].name for k in by], (error > of_noise)[by].tolist(),
        evidence.learned * SEGMENT_S,
    )  # fmt: skip


def _probabilities(log_factors: Array, often: Array) -> Array:
    """That each of HYPOTHESES is the wrong one, [n + 1]; what is missing to 1: that none is.

    log_factors: Bayes' factors against a right file. often: weights of each before driving.
    """
    top = max(float(log_factors.max()), 0.0)  # so that nothing overflows
    wrong = WIDENING.wrong * often / _OFTEN.sum() * np.exp(log_factors - top)
    return np.asarray(wrong / ((1.0 - WIDENING.wrong) * math.exp(-top) + wrong.sum()), np.float64)


def widened(widening: _Wider, estimate: Estimate, had: Sequence[bool] = ()) -> Estimate:
    """An estimate as wide as file or soil may be otherwise; without the numbers that this leaves useless.
    had: which of the six it had before; these are withdrawn later than new ones are given."""
    if not estimate.log_covariance or not widening.covariance.any():
        return estimate
    covariance = np.reshape(estimate.log_covariance, (6, 6)) + widening.covariance
    parameters = tuple(
        _parameter(widening, k, p, had=k < len(had) and had[k]) for k, p in enumerate(estimate.parameters)
    )
    over = np.diag(widening.covariance)[:3].copy()
    if isinstance(widening, OfLoad):
        over[2] = widening.over_mass
    masses = [_over_mass(widening, estimate, k, over[k], had=k < len(had) and had[k]) for k in range(3)]
    determined = tuple(
        replace(one, log_sd=total)
        for one in estimate.determined
        if (total := _of_combination(widening, one)) <= widening.limit(one.log_sd)
    )
    return replace(
        estimate, parameters=parameters, log_covariance=tuple(covariance.ravel().tolist()),
        per_mass=tuple(value for value, _ in masses), per_mass_sd=tuple(sd for _, sd in masses),
        determined=determined,
    )  # fmt: skip


def _over_mass(
    widening: _Wider, estimate: Estimate, k: int, added: float, had: bool
) -> tuple[float | None, float | None]:
    """(value, sd) of a stiffness over the mass, which errors of the mass do not widen. added: variance."""
    if k >= len(estimate.per_mass_sd):
        return None, None
    value, sd = estimate.per_mass[k], estimate.per_mass_sd[k]
    if value is None or sd is None:
        return None, None
    total = math.hypot(sd / value, math.sqrt(added))
    return (value, value * total) if total <= widening.limit(sd / value, had) else (None, None)


def _parameter(widening: _Wider, k: int, given: ParameterEstimate, had: bool) -> ParameterEstimate:
    if given.value is None or given.sd is None:
        return given
    own = given.sd / given.value
    total, limit = math.hypot(own, math.sqrt(widening.covariance[k, k])), widening.limit(own, had)
    reason = widening.reason(k, own, limit)
    if total <= limit:
        return replace(given, sd=given.value * total, reason=given.reason or reason)
    return replace(given, value=None, sd=None, status=Status.UNESTIMATED, reason=reason)


def _of_combination(widening: _Wider, one: Combination) -> float:
    weights = np.array(one.exponents)
    return math.sqrt(one.log_sd**2 + float(weights @ widening.covariance @ weights))
