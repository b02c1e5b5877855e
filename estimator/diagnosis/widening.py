"""How far errors of the machine file that driving has not excluded may have moved the six parameters.

Each number that the open tracker leaves open is either right or wrong, by as much as people are wrong in it.
Driving weighs the two (Bayes' factor of one number free against none), and tells how large the error is if
it is there. The slopes of the six by the numbers make variances of that, which are added to those of every
method. Where the data do not fit the file as a whole, whichever number is to blame, the method's own
variances grow by the same factor as the misfit is too large (Birge's ratio). So a number is published as soon
as no error that may still be in the file makes it useless, and it is as wide as the file may be wrong.
"""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.diagnosis.open_numbers import NAMES, OPEN, OpenEvidence
from tilth.estimator.filters import unknowns
from tilth.estimator.pose.aligner import ALIGNMENT
from tilth.estimator.rig.numbers import NUMBER
from tilth.estimator.state_json import Shape
from tilth.estimator.tuning import tuned
from tilth.schemas.flow import PARAMETERS, Estimate, ParameterEstimate, Status
from tilth.schemas.reasons import Code, Combination, Reason

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class WideningTuning:
    """What is added to the published variances for the machine file."""

    odds: float = tuned(0.3, "1", "that a number of a file is wrong over that it is right, before driving")
    """With that an error as large as the sd by which people are wrong is within 4 of the published sds, also
    where driving has told nothing of it."""
    widest: float = tuned(0.3, "1", "sd of a logarithm above which a number is not given for the file's sake")
    least: float = tuned(1.1, "1", "factor by which the file must widen a number before it is not given")
    withdrawn: float = tuned(1.2, "1", "factor on that limit for a number that was given before")
    said: float = tuned(1.2, "1", "factor from which the reason says by what a number is widened")
    confirmed: float = tuned(
        0.2, "1", "largest sd of C_af, C_ar and C_ai by the file with which it is confirmed"
    )
    shortest_s: float = tuned(10.0, "s", "shortest time of steering that is asked for")
    longest_s: float = tuned(120.0, "s", "longest time of steering that is asked for")


WIDENING: Final = WideningTuning()
SEGMENT_S: Final = ALIGNMENT.pose_ns * 1e-9
_OPEN_VARIANCE: Final = np.array([row.open_sd**2 for row in OPEN])
_CONSIDERED: Final = [unknowns.NAMES[k] for k in unknowns.MASSES]
"""The methods do not learn these either: what the file says of them, with its sd, is in their covariances."""
_MASS_INSTEAD: Final = np.array([name in ("C_af", "C_ar") for name in PARAMETERS], dtype=np.float64)
"""What looks like another inertia of the tractor may be its mass: then C_af and C_ar are off by as much."""
_NUMBER_OF_PART: Final = np.array([*range(len(NAMES)), NAMES.index("I_t")])


@dataclass(slots=True)
class Widening:
    """What errors of the file do to the covariance of the six logarithms."""

    factor: float = 1.0  # on a method's own
    covariance: Annotated[Array, Shape((6, 6))] = field(default_factory=lambda: np.zeros((6, 6)))  # added
    by: list[str] = field(default_factory=lambda: [NAMES[0]] * 6)  # of each: the number that adds most
    doubted: list[bool] = field(default_factory=lambda: [False] * 6)  # that is off, not only unknown yet
    worst: str = NAMES[0]  # the number that agrees least
    learned_s: float = 0.0  # of driving, from which this is known

    @property
    def confirms(self) -> bool:
        """Whether no error that may still be in the file moves a stiffness by much."""
        return bool(np.sqrt(np.diag(self.covariance)[:3]).max() <= WIDENING.confirmed)


def widening_of(evidence: OpenEvidence, known: Collection[str] = ()) -> Widening:
    """known: numbers that need no proof any more."""
    misfit = evidence.misfit
    variance = misfit.alone**2
    share = _OPEN_VARIANCE / (_OPEN_VARIANCE + variance)  # of what is found that is no noise
    log_factor = 0.5 * (share * misfit.by_name - np.log1p(_OPEN_VARIANCE / variance))
    wrong = 1.0 / (1.0 + np.exp(np.clip(-log_factor, -50.0, 50.0)) / WIDENING.odds)
    wrong[[k for k, name in enumerate(NAMES) if name in (*known, *_CONSIDERED)]] = 0.0
    noise, error = share * variance, (share * misfit.found) ** 2
    sds = np.sqrt(wrong * (noise + error))
    parts = np.column_stack([misfit.moves, _MASS_INSTEAD]) * sds[_NUMBER_OF_PART]
    by = _NUMBER_OF_PART[np.argmax(np.abs(parts), axis=1)]
    return Widening(
        max(misfit.total / len(NAMES), 1.0), parts @ parts.T, [NAMES[k] for k in by],
        (error > noise)[by].tolist(), NAMES[int(np.argmax(misfit.by_name))], evidence.learned * SEGMENT_S,
    )  # fmt: skip


def widened(widening: Widening, estimate: Estimate, had: Sequence[bool] = ()) -> Estimate:
    """An estimate as wide as the file may be wrong; without the numbers that this leaves useless. had: which
    of the six it had before; these are withdrawn later than new ones are given."""
    if not estimate.log_covariance or (widening.factor == 1.0 and not widening.covariance.any()):
        return estimate
    own = np.reshape(estimate.log_covariance, (6, 6))
    covariance = widening.factor * own + widening.covariance
    parameters = tuple(
        _parameter(widening, k, p, had=k < len(had) and had[k]) for k, p in enumerate(estimate.parameters)
    )
    masses = [_over_mass(widening, estimate, k, had=k < len(had) and had[k]) for k in range(3)]
    determined = tuple(
        replace(one, log_sd=total)
        for one in estimate.determined
        if (total := _of_combination(widening, one)) <= _limit(one.log_sd)
    )
    return replace(
        estimate, parameters=parameters, log_covariance=tuple(covariance.ravel().tolist()),
        per_mass=tuple(value for value, _ in masses), per_mass_sd=tuple(sd for _, sd in masses),
        determined=determined,
    )  # fmt: skip


def _over_mass(
    widening: Widening, estimate: Estimate, k: int, had: bool
) -> tuple[float | None, float | None]:
    """(value, sd) of a stiffness over the mass, which errors of the mass do not widen."""
    if k >= len(estimate.per_mass_sd):
        return None, None
    value, sd = estimate.per_mass[k], estimate.per_mass_sd[k]
    if value is None or sd is None:
        return None, None
    total = math.hypot(sd / value * math.sqrt(widening.factor), math.sqrt(widening.covariance[k, k]))
    return (value, value * total) if total <= _limit(sd / value, had) else (None, None)


def _parameter(widening: Widening, k: int, given: ParameterEstimate, had: bool) -> ParameterEstimate:
    if given.value is None or given.sd is None:
        return given
    added, own = math.sqrt(widening.covariance[k, k]), given.sd / given.value
    misfit = own * math.sqrt(widening.factor - 1.0)
    total = math.hypot(own, misfit, added)
    key = NUMBER[widening.by[k] if added > misfit else widening.worst].key
    limit = _limit(own, had)
    if total <= limit:
        by_file = math.hypot(misfit, added)
        reason = Reason(Code.WIDENED, (key,), (by_file,)) if total > WIDENING.said * own else None
        return replace(given, sd=given.value * total, reason=given.reason or reason)
    room = limit**2 - own**2 - misfit**2
    if widening.doubted[k] or room <= 0.0:
        reason = Reason(Code.DOUBTED, (key,))
    else:  # variances fall with the time driven
        seconds = widening.learned_s * (added**2 / room - 1.0)
        seconds = min(max(seconds, WIDENING.shortest_s), WIDENING.longest_s)
        reason = Reason(Code.NOT_EXCLUDED, (key,), (total, seconds))
    return replace(given, value=None, sd=None, status=Status.UNESTIMATED, reason=reason)


def _of_combination(widening: Widening, one: Combination) -> float:
    weights = np.array(one.exponents)
    return math.sqrt(widening.factor * one.log_sd**2 + float(weights @ widening.covariance @ weights))


def _limit(own: float, had: bool = False) -> float:
    return max(WIDENING.widest, WIDENING.least * own) * (WIDENING.withdrawn if had else 1.0)
