"""Which of the methods' estimates should a controller use? One rule; each recommendation says how it was
chosen."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from tilth.estimator.diagnosis.widening import OfEvenGround, widened
from tilth.estimator.ties import exceeds, within
from tilth.estimator.tuning import tuned
from tilth.schemas.flow import Estimate, ParameterEstimate, Status
from tilth.schemas.reasons import Code, Reason

RECOMMENDED: Final = "recommended"
PREFERRED: Final = ("pem", "tracker", "steady_state")
"""Best first: pem uses every sample of a window, tracker follows changes at once, steady_state is for driving
from which neither can learn. No other method is recommended, but for PLACE and ROWS."""
PLACE: Final = "place"
"""Before all others once a field has shown that its soil differs from place to place."""
ROWS: Final = "rows"
"""Before PREFERRED where it knows more than the best of them: it learns from driving that tells them
nothing, and at the angles at which a controller works."""
OFFERED: Final = (PLACE, ROWS, *PREFERRED)


@dataclass(frozen=True, slots=True)
class RecommendationTuning:
    """Which method's estimate is recommended."""

    patchy: float = tuned(
        0.5, "1", "probability that soil differs from place to place, above which `place` is better"
    )
    fresh_s: float = tuned(120.0, "s", "if the window of pem is older, tracker is better")
    disagree_above: Mapping[int, float] = tuned(
        {1: 10.8, 2: 13.8, 3: 16.3, 4: 18.5, 5: 20.5, 6: 22.5},
        "chi^2",
        "by the number of parameters, 0.1 %: above, two methods disagree",
    )
    """Chi-square of so many parameters, 0.1 %."""
    agree_below: Mapping[int, float] = tuned(
        {1: 3.8, 2: 6.0, 3: 7.8, 4: 9.5, 5: 11.1, 6: 12.6},
        "chi^2",
        "5 %: a disagreement ends later than it begins",
    )


RECOMMENDATION: Final = RecommendationTuning()

SINCE_CHANGE: Final = "since_soil_change_s"  # key in `excitation` of a method that detects changes at once
PATCHY: Final = "patchy"
"""Key in `excitation` of the method place: how probable it is that soil differs from place to place."""
LEANS: Final = ("lean_tractor_deg", "lean_implement_deg", "cross_slope_deg")
"""Keys in tracker's `excitation`: how far the bodies lean on their tyres, and the ground under the tractor,
right side down; the recommended estimate has them whichever method it is of."""


def recommend(estimates: Mapping[str, Estimate], t_ns: int, disagree: bool = False) -> Estimate:
    """The best estimate with numbers, also while methods disagree: then the others are named with it.

    estimates: method -> latest. disagree: whether `disagreement` found one. `rule` of the result says why it
    was chosen. Values with status INVALID are removed.
    """
    usable = list(_usable(estimates))
    if not usable:
        preferred = [
            estimates[m] for m in PREFERRED if m in estimates and not (m == "pem" and _outdated(estimates))
        ]
        first = (preferred or [e for m, e in estimates.items() if m != RECOMMENDED])[0]
        return _copy_as_recommended(first, estimates, t_ns, Reason(Code.NO_METHOD))
    best, rule = usable[0]
    if disagree and best.method in PREFERRED:  # it is among these that methods disagree
        others = dict.fromkeys(e.method for e, _ in usable if e.method != best.method)
        rule = Reason(Code.KNOWS_MORE, (best.method, *others))
    return _copy_as_recommended(best, estimates, t_ns, rule)


def disagreement(estimates: Mapping[str, Estimate], before: bool) -> Reason | None:
    """The methods which disagree beyond their covariances, if any do.

    before: whether some disagreed at the last call.
    """
    limits = RECOMMENDATION.agree_below if before else RECOMMENDATION.disagree_above
    candidates = [
        e
        for e in (estimates[m] for m in PREFERRED if m in estimates)
        if _usable_parameters(e, Status.ESTIMATED)
    ]
    for k, one in enumerate(candidates):
        for other in candidates[k + 1 :]:
            distance, shared = _distance(one, other)
            if shared and not within(distance, limits[shared]):  # nan counts as disagreement
                numbers = (distance, float(shared), RECOMMENDATION.disagree_above[shared])
                return Reason(Code.DISAGREE, (one.method, other.method), numbers)
    return None


def beside_better(estimate: Estimate, estimates: Mapping[str, Estimate]) -> Estimate:
    """An estimate of steady_state beside those of PREFERRED that come before it, which have used the same
    driving and more: no surer than the surest of them, since it takes the ground for even where they do not;
    and without its numbers where one of them disagrees with them. All other estimates stay as they are."""
    if estimate.method != PREFERRED[-1] or not estimate.log_covariance:
        return estimate
    better = [m for m in PREFERRED[:-1] if m in estimates and not (m == "pem" and _outdated(estimates))]
    for other in (estimates[m] for m in better):
        distance, shared = _distance(other, estimate)
        if shared and not within(distance, limit := RECOMMENDATION.disagree_above[shared]):
            reason = Reason(Code.DISAGREE, (other.method, estimate.method), (distance, float(shared), limit))
            parameters = tuple(
                one if one.value is None else ParameterEstimate(None, None, Status.INVALID, reason, one.age_s)
                for one in estimate.parameters
            )
            unknown = (None,) * len(parameters)
            return replace(estimate, parameters=parameters, per_mass=unknown, per_mass_sd=unknown)
    added, own = np.zeros(6), np.diag(np.reshape(estimate.log_covariance, (6, 6)))
    for k in range(6):
        told = [
            float(np.reshape(one.log_covariance, (6, 6))[k, k])
            for one in (estimates[m] for m in better)
            if one.log_covariance and one.parameters[k].age_s is not None
        ]
        if told:
            added[k] = max(min(told) - own[k], 0.0)
    return widened(OfEvenGround(np.diag(added)), estimate)


def _usable(estimates: Mapping[str, Estimate]) -> Iterator[tuple[Estimate, Reason]]:
    """(estimate, rule by which it is chosen), best first; one method may come twice."""
    of_place = estimates.get(PLACE)
    if of_place is not None and _is_finite(of_place) and _usable_parameters(of_place, Status.ESTIMATED):
        patchy = of_place.excitation.get(PATCHY, 0.0)
        if exceeds(patchy, RECOMMENDATION.patchy):
            if "pem" in estimates:  # which it rests on, for the rig and for what to drive
                rig = estimates["pem"]
                of_place = replace(of_place, nuisances=rig.nuisances, advice=rig.advice)
            yield of_place, Reason(Code.IN_PATCHES, (of_place.method,), (patchy,))
    others, rows = list(_of_preferred(estimates)), estimates.get(ROWS)
    rule = None if rows is None else _before_others(rows, others[0][0] if others else None, estimates)
    if rows is not None and rule is not None:
        yield rows, rule
    yield from others


def _before_others(
    rows: Estimate, other: Estimate | None, estimates: Mapping[str, Estimate]
) -> Reason | None:
    """Why `rows` comes before the best other estimate; None where it does not.

    It has all numbers that the other one has, and knows them better on average. Of steady_state the first is
    enough.
    """
    known = _usable_parameters(rows, Status.ESTIMATED)
    if not known or not _is_finite(rows) or _since_change(estimates) < _age(rows):
        return None
    told = set() if other is None else _usable_parameters(other, Status.ESTIMATED)
    if other is None or not told or (other.method == PREFERRED[-1] and known >= told):
        return Reason(Code.ROWS_ALONE, (rows.method,))
    sd, of_other = _mean_sd(rows, told), _mean_sd(other, told)
    if known >= told and exceeds(of_other, sd):
        return Reason(Code.ROWS_KNOW_MORE, (rows.method, other.method), (sd, of_other))
    return None


def _mean_sd(estimate: Estimate, parameters: set[int]) -> float:
    """Geometric mean of the sds of the logarithms of some of the six."""
    variances = np.diag(np.reshape(estimate.log_covariance, (6, 6)))[sorted(parameters)]
    return float(np.exp(0.5 * np.mean(np.log(variances))))


def _of_preferred(estimates: Mapping[str, Estimate]) -> Iterator[tuple[Estimate, Reason]]:
    """The same of PREFERRED."""
    sound = [estimates[m] for m in PREFERRED if m in estimates and _is_finite(estimates[m])]
    by_method = {e.method: e for e in sound}
    pem, tracker = by_method.get("pem"), by_method.get("tracker")
    if tracker is not None and pem is not None and _usable_parameters(tracker, Status.ESTIMATED):
        age, change = _age(pem), _since_change(estimates)
        if change < age:
            yield tracker, Reason(Code.SOIL_CHANGED_SINCE, (tracker.method,), (change,))
        elif age > RECOMMENDATION.fresh_s:
            old = Reason(Code.WINDOW_OLD, (tracker.method,), (age,))
            yield tracker, old if math.isfinite(age) else Reason(Code.NO_WINDOW, (tracker.method,))
    if _outdated(estimates):
        sound = [e for e in sound if e is not pem]
    for estimate in sound:
        if _usable_parameters(estimate, Status.ESTIMATED):
            yield estimate, Reason(Code.FIRST_WITH_NUMBERS, (estimate.method, *(e.method for e in sound)))
    for estimate in sound:
        if _usable_parameters(estimate):
            yield estimate, Reason(Code.FIRST_THOUGH_OLD, (estimate.method, *(e.method for e in sound)))


def _since_change(estimates: Mapping[str, Estimate]) -> float:
    """Time since tracker found that the soil had changed, s; infinite if it never did."""
    return estimates["tracker"].excitation.get(SINCE_CHANGE, math.inf) if "tracker" in estimates else math.inf


def _outdated(estimates: Mapping[str, Estimate]) -> bool:
    """Whether pem's last window is older than a change of soil, which pem itself sees only with the next."""
    return "pem" in estimates and _since_change(estimates) < _age(estimates["pem"]) < math.inf


def _copy_as_recommended(
    estimate: Estimate, estimates: Mapping[str, Estimate], t_ns: int, rule: Reason
) -> Estimate:
    parameters = tuple(
        replace(p, value=None, sd=None) if p.status is Status.INVALID else p for p in estimate.parameters
    )
    known = estimates["tracker"].excitation if "tracker" in estimates else {}
    excitation = {**estimate.excitation, **{name: known[name] for name in LEANS if name in known}}
    return replace(
        estimate, method=RECOMMENDED, t_ns=t_ns, rule=rule, parameters=parameters, excitation=excitation
    )


def _usable_parameters(estimate: Estimate, status: Status | None = None) -> set[int]:
    """Indices of the parameters with a number and this status; None: ESTIMATED or STALE."""
    statuses = (Status.ESTIMATED, Status.STALE) if status is None else (status,)
    return {k for k, p in enumerate(estimate.parameters) if p.value is not None and p.status in statuses}


def _is_finite(estimate: Estimate) -> bool:
    """Whether all numbers are finite and values positive: others must not reach a controller."""
    values = [p.value for p in estimate.parameters if p.value is not None]
    return all(0.0 < v < math.inf for v in values) and all(map(math.isfinite, estimate.log_covariance))


def _age(estimate: Estimate) -> float:
    """Greatest age of its usable parameters, s; infinite without one."""
    return max((estimate.parameters[k].age_s or 0.0 for k in _usable_parameters(estimate)), default=math.inf)


def _distance(one: Estimate, other: Estimate) -> tuple[float, int]:
    """(squared Mahalanobis distance of the logarithms, with the sum of the covariances; number of
    parameters)."""
    shared = sorted(_usable_parameters(one, Status.ESTIMATED) & _usable_parameters(other, Status.ESTIMATED))
    if not shared:
        return 0.0, 0
    logs = [np.log([e.parameters[k].value or 1.0 for k in shared]) for e in (one, other)]
    covariance = sum(np.reshape(e.log_covariance, (6, 6))[np.ix_(shared, shared)] for e in (one, other))
    off = logs[0] - logs[1]
    try:
        return float(off @ np.linalg.solve(covariance, off)), len(shared)
    except np.linalg.LinAlgError:
        return math.nan, len(shared)
