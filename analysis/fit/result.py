"""What `tilth fit` gives, as one plain object that becomes JSON as it stands. SI."""

import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import NotRequired, TypedDict, cast

import numpy as np
from numpy.typing import NDArray

from tilth.analysis.fit.fitting import Fitted, Wanted
from tilth.analysis.fit.joint import Joint
from tilth.analysis.fit.segment_fit import METHODS, TWO_STEP, SegmentFit
from tilth.estimator.filters.unknowns import NAMES, NOISES, SIX
from tilth.estimator.methods import pem
from tilth.estimator.results.reporting import is_supported, nuisance_sd
from tilth.replay.estimates_json import NuisanceEntry, ParameterEntry, estimates_and_nuisances
from tilth.schemas.flow import PARAMETERS, Status
from tilth.schemas.reasons import Code, Reason
from tilth.schemas.sentences import combination_words, sentence

Array = NDArray[np.float64]


class RunAnswer(TypedDict):
    """Of one segment. filter, steady_state: parameters by other methods. determined: combinations, in words.
    refused: stretches of which nothing was learned, by reason."""

    id: str
    log: int
    segment: int
    kind: str
    name: str
    start_s: float
    end_s: float
    speed: float
    largest_angle: float
    fitted_s: float
    parameters: dict[str, ParameterEntry]
    log_covariance: list[list[float]] | None
    determined: list[str]
    nuisances: dict[str, NuisanceEntry]
    filter: dict[str, ParameterEntry]
    steady_state: dict[str, ParameterEntry]
    refused: dict[str, int]
    two_step: NotRequired[dict[str, ParameterEntry]]


class JointAnswer(TypedDict):
    """Of several segments together. between_sd: of the logarithms, from segment to segment; new_segment_sd:
    for a segment that was not among them."""

    parameters: dict[str, ParameterEntry]
    between_sd: dict[str, float]
    new_segment_sd: dict[str, float]
    log_covariance: list[list[float]]
    nuisances: dict[str, NuisanceEntry]
    fitted_s: float


class AgreementAnswer(TypedDict):
    """agreement.Agreement."""

    chi2: float
    dof: int
    p: float
    sentence: str


class GroupAnswer(JointAnswer):
    """Of segments that agree among themselves."""

    segments: list[str]
    name: str
    agreement: AgreementAnswer


class FitAnswer(TypedDict):
    """joint, agreement: None where nothing was told. groups: none where the segments agree. simulated: no
    tractor drove. notes: of a report."""

    runs: list[RunAnswer]
    joint: JointAnswer | None
    simulated: bool
    agreement: AgreementAnswer | None
    groups: list[GroupAnswer]
    notes: NotRequired[list[str]]


def as_json(fitted: Fitted) -> FitAnswer:
    """All of it."""
    joint, ids = fitted.joint, [one.id for one in fitted.wanted]
    apart = "; ".join(_listed(ids, rows) for rows, _ in fitted.groups)
    return {
        "runs": [_run(one, fit) for one, fit in zip(fitted.wanted, fitted.fits, strict=True)],
        "joint": None if joint is None else _joint(joint, apart),
        "simulated": any(one.run.simulated for one in fitted.wanted),
        "agreement": None if joint is None else _agreement(joint),
        "groups": [
            {
                "segments": [ids[k] for k in rows],
                "name": _listed(ids, rows),
                **_joint(one, ""),
                "agreement": _agreement(one),
            }
            for rows, one in fitted.groups
        ],
    }


def _agreement(joint: Joint) -> AgreementAnswer:
    return cast("AgreementAnswer", asdict(joint.agreement))


def _listed(ids: Sequence[str], rows: Sequence[int]) -> str:
    """Segments in words, such as: 1.1, 2.3 to 2.7."""
    stretches: list[list[int]] = []
    for k in rows:
        if stretches and k == stretches[-1][-1] + 1:
            stretches[-1].append(k)
        else:
            stretches.append([k])
    return ", ".join(
        ids[one[0]] if len(one) == 1 else f"{ids[one[0]]} to {ids[one[-1]]}" for one in stretches
    )


def _run(one: Wanted, fit: SegmentFit) -> RunAnswer:
    said = estimates_and_nuisances(fit.estimates)
    estimates = said["estimates"]
    best = fit.estimates[pem.METHOD]
    answer: RunAnswer = {
        "id": one.id,
        "log": one.log,
        "segment": one.number,
        "kind": one.segment.kind,
        "name": one.segment.name,
        "start_s": one.segment.start_s,
        "end_s": one.segment.end_s,
        "speed": one.segment.speed,
        "largest_angle": one.segment.largest_angle,
        "fitted_s": fit.seconds,
        "parameters": estimates[pem.METHOD],
        "log_covariance": _square(best.log_covariance),
        "determined": [combination_words(one) for one in best.determined],
        "nuisances": said["nuisances"][pem.METHOD],
        "filter": estimates[METHODS[1]],
        "steady_state": estimates[METHODS[2]],
        "refused": {sentence(Reason(code)): count for code, count in fit.refused.items()},
    }
    if TWO_STEP in estimates:
        answer["two_step"] = estimates[TWO_STEP]
    return answer


def _square(numbers: Sequence[float]) -> list[list[float]] | None:
    return np.array(numbers).reshape(6, 6).tolist() if numbers else None


def _joint(joint: Joint, apart: str) -> JointAnswer:
    """apart: names of the groups that agree, where not all do."""
    none = "the segments do not agree, so no one number holds for all"
    if apart:
        none += f"; those that agree among themselves: {apart}"
    variances, moved = np.diag(joint.covariance).tolist(), (joint.mean - joint.prior_mean).tolist()
    sds = np.sqrt(variances)
    return {
        "parameters": {
            name: _parameter(
                float(joint.mean[k]),
                float(sds[k]),
                float(joint.prior_sd[k]),
                none if joint.refused[k] else "",
            )
            for k, name in enumerate(PARAMETERS)
        },
        "between_sd": dict(zip(PARAMETERS, joint.between_sd.tolist(), strict=True)),
        "new_segment_sd": dict(zip(PARAMETERS, joint.new_segment_sd.tolist(), strict=True)),
        "log_covariance": joint.covariance[SIX, SIX].tolist(),
        "nuisances": {
            name: {
                "value": float(joint.mean[k]),
                "sd": nuisance_sd(name, variances[k], float(joint.prior_sd[k]), moved[k]),
            }
            for k, name in enumerate(NAMES)
            if k > 5 and joint.prior_sd[k] > 0.0 and name not in NOISES
        },
        "fitted_s": joint.seconds,
    }


def _parameter(log: float, sd: float, prior_sd: float, refused: str) -> ParameterEntry:
    """As of an estimate: without a number where the data leave too much, or where it is refused."""
    if refused or not is_supported(False, sd, prior_sd):
        reason = refused or sentence(Reason(Code.WIDE, numbers=(sd,)))
        return {"value": None, "sd": None, "status": Status.UNESTIMATED.name.lower(), "reason": reason}
    value = math.exp(log)
    return {"value": value, "sd": value * sd, "status": Status.ESTIMATED.name.lower(), "reason": ""}
