"""Lengths that were wrong in the machine file from the start, found by driving alone.

At one speed, straight ahead, a receiver that is further forward looks like a late one. Another speed tells
them apart, and so does a turn: a late body lags along the path of its hitch, which is no longer along the
body. So the samples of the watch (information.py) are judged as for what has been moved; what is known before
any sample is the file, with its sds of lengths and latencies.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.diagnosis.hypotheses import Explanation, judge
from tilth.estimator.diagnosis.information import (
    AT,
    CONSTANTS,
    DELAY,
    InformationForm,
    N,
    drift,
    lengths,
)
from tilth.estimator.once import once_for_a_machine
from tilth.estimator.pose import latency
from tilth.estimator.pose.aligner import MOUNTS
from tilth.estimator.rig.numbers import BODIES, DRAWBAR, HYPOTHESIS
from tilth.estimator.ties import exceeds
from tilth.estimator.tuning import tuned
from tilth.schemas.diagnosis import Diagnosis
from tilth.schemas.flow import Mount
from tilth.schemas.machine import Machine
from tilth.schemas.reasons import Code

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class AgainstFileTuning:
    """When lengths of a machine file are wrong."""

    begins: float = tuned(
        8.0, "1", "logarithm of a likelihood ratio, 4 sds: 1 right file in 16,000 for each suspect and look"
    )
    ends: float = tuned(0.4, "1", "factor on that")
    rival: float = tuned(0.01, "1", "of the best likelihood: what explains so much is named as well")
    model_sd: float = tuned(0.02, "m", "of a length, by what samples leave out: pitch, lean, a pin's play")
    model_yaw_sd: float = tuned(0.01, "rad", "the same of a pair's yaw")


AGAINST_FILE: Final = AgainstFileTuning()
_LENGTHS: Final = (*(mount.value for mount in Mount), DRAWBAR)
"""Of HYPOTHESES. The others, turned pairs and the wheels' zero, are rivals only: other checks find them."""


def found(machine: Machine, evidence: InformationForm, wrong: bool) -> list[Diagnosis]:
    """What explains all samples so far so much better than the file that it is wrong; none, or one.

    wrong: whether it was at the last look.
    """
    judged = judge(machine, np.zeros(N), _by_file(machine) - drift(), evidence)  # which adds the drift
    explanations = [one for one in judged if not HYPOTHESIS[one.name].absorbed]
    best = explanations[0]
    least = AGAINST_FILE.begins * (AGAINST_FILE.ends if wrong else 1.0)
    if best.name not in _LENGTHS or not exceeds(_along(best), least):
        return []
    nearly = best.log_ratio + math.log(AGAINST_FILE.rival)
    return [_diagnosis(best, [one.name for one in explanations[1:] if exceeds(one.log_ratio, nearly)])]


def _along(one: Explanation) -> float:
    """The part of its log ratio that is of the length: what is aside, a wrong roll looks like as well."""
    return float(one.amounts[0] ** 2 / one.covariance[0, 0]) / 2.0


def _diagnosis(best: Explanation, rivals: list[str]) -> Diagnosis:
    row, sds = HYPOTHESIS[best.name], np.sqrt(np.diag(best.covariance))
    code = Code.DRAWBAR_OFF if best.name == DRAWBAR else Code.RECEIVER_OFF
    others = dict.fromkeys(HYPOTHESIS[name].key for name in rivals)
    return Diagnosis(
        code, row.key, (best.name, *others), row.numbers, tuple(best.amounts.tolist()), tuple(sds.tolist())
    )


@once_for_a_machine
def _by_file(machine: Machine) -> Array:
    """(N, N): covariance of the constants before any sample, by the sds that the file tells."""
    sd = np.array([sd for sd, _ in CONSTANTS.values()])
    by_mount = {receiver.mount: receiver for receiver in machine.receiver}
    for k, (body, of) in enumerate(zip(BODIES, (machine.tractor.c, machine.implement.d), strict=True)):
        survey = max(r.survey_sd for r in machine.receiver if r.mount.body == body)
        apart, model = survey * math.sqrt(2.0), AGAINST_FILE.model_sd
        yaw = apart / float(lengths(machine).pairs.span[k, 0])
        told = {
            f"longer_{body[0]}": math.hypot(model, apart), f"aside_{body[0]}": math.hypot(model, survey),
            "cd"[k]: math.hypot(model, survey, of.sd),
            f"pair_{body[0]}": math.hypot(AGAINST_FILE.model_yaw_sd, yaw),
        }  # fmt: skip
        sd[[AT[name] for name in told]] = list(told.values())
    covariance = np.diag(sd**2)
    late = latency.prior([by_mount[mount].latency.sd for mount in MOUNTS]).covariance
    covariance[np.ix_(DELAY, DELAY)] = late + np.diag(sd[DELAY] ** 2 * 1e-6)  # one may be told as exact
    return covariance
