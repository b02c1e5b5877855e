"""What is wrong with a machine file at one instant.

Whether it lasts long enough to withhold the estimates is decided in consistency.py.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.models.parameters import rig_of, static_loads
from tilth.estimator.once import once_for_a_machine
from tilth.estimator.pose import latency, receiver_checks
from tilth.estimator.pose.aligner import MOUNTS, Aligner
from tilth.estimator.pose.plausibility import PLAUSIBILITY, pair_limits
from tilth.estimator.pose.receiver_checks import ReceiverChecks
from tilth.estimator.rig.numbers import NUMBER
from tilth.estimator.tuning import tuned
from tilth.schemas.diagnosis import Diagnosis
from tilth.schemas.flow import WITHOUT_RTK, Estimate, FlagKind, Pose, Status
from tilth.schemas.machine import Machine
from tilth.schemas.plausible import COEFFICIENT
from tilth.schemas.reasons import Code

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class FindingTuning:
    """When one instant shows something wrong."""

    latency_chi_square: float = tuned(30.0, "chi^2", "of up to three differences of latency")
    parked_limit: float = tuned(
        0.2, "m", "of the hitch's error at rest or creeping, if the survey's sds allow less"
    )
    parked_poses: int = tuned(10, "poses", "in that mean (2 s); no more if the receiver becomes doubtful")


FINDINGS: Final = FindingTuning()
_OF_FLAG: Final = {
    FlagKind.MOVED: (Code.RECEIVER_NOT_THERE, "position", ("forward", "right")),
    FlagKind.SWAPPED: (Code.RECEIVER_EXCHANGED, "name", ()),
    FlagKind.LATENCY: (Code.RECEIVER_AT_ANOTHER_TIME, "latency", ("latency", "forward")),
}
_PARKED: Final = (("longer_t",), ("longer_i",), ("c", "d"), ("aside_i", "aside_t"))
_ROLL: Final = frozenset({receiver_checks.TWICE, receiver_checks.NOT, receiver_checks.UNCLEAR})
_LATENCIES: Final = "receiver.position (forward), tractor.c, implement.d or receiver.latency"


def misplaced_receivers(pose: Pose) -> list[Diagnosis]:
    """From the flags of a pose: receivers that are misplaced, swapped or late, if all have RTK."""
    if any(flag.kind in WITHOUT_RTK for flag in pose.flags):
        return []
    found = []
    for flag in pose.flags:
        if flag.kind in _OF_FLAG:
            code, key, numbers = _OF_FLAG[flag.kind]
            names = tuple(f"{number}_{flag.of}" for number in numbers)
            found.append(Diagnosis(code, f"receiver.{flag.of}.{key}", (flag.of,), names))
    return found


def wrong_rolls(checks: ReceiverChecks) -> list[Diagnosis]:
    """Receivers whose roll_corrected is not as the file says."""
    return [
        receiver_checks.diagnosis(checks, flag)
        for flag in receiver_checks.flags(checks)
        if flag.kind in _ROLL
    ]


def parked_errors(machine: Machine, aligner: Aligner) -> list[Diagnosis]:
    """From distances while the rig stands or creeps, when latency has no effect on them."""
    return [
        Diagnosis(
            Code.OFF_WHERE_PARKED, " or ".join(dict.fromkeys(NUMBER[name].key for name in names)),
            names[:1], names, (float(mean.value),),
        )
        for names, limit, mean in zip(_PARKED, _parked_limits(machine), aligner.long_term.parked, strict=True)
        if mean.count >= FINDINGS.parked_poses and abs(mean.value) > limit
    ]  # fmt: skip


@once_for_a_machine
def _parked_limits(machine: Machine) -> tuple[float, ...]:
    """Of each of _PARKED, m."""
    sds = (machine.tractor.c.sd, machine.implement.d.sd, *(r.survey_sd for r in machine.receiver))
    hitch = max(FINDINGS.parked_limit, PLAUSIBILITY.survey_sds * math.hypot(*sds))
    return *pair_limits(machine), hitch, hitch


def latencies(machine: Machine, aligner: Aligner) -> list[Diagnosis]:
    """Whether the latencies that would explain the distances are implausibly different."""
    present, differences, inverse = _of_latencies(machine)
    if len(present) < 2:
        return []
    off = differences @ aligner.latency.tau[present]
    if float(off @ inverse @ off) < FINDINGS.latency_chi_square:
        return []
    return [
        Diagnosis(Code.NO_LIKELY_LATENCY, _LATENCIES, numbers=("lever_t", "lever_i", "c", "d", "latency"))
    ]


@once_for_a_machine
def _of_latencies(machine: Machine) -> tuple[list[int], Array, Array]:
    """(indices into MOUNTS of the n receivers whose latency is uncertain, (n - 1, n) of what makes their
    differences, (n - 1, n - 1) inverse of the covariance of these by the file)."""
    by_mount = {r.mount: r.latency.sd for r in machine.receiver}
    present = [k for k, mount in enumerate(MOUNTS) if by_mount.get(mount, 0.0) > 0.0]
    prior = latency.prior([by_mount.get(mount, 0.0) for mount in MOUNTS]).covariance
    differences = np.eye(len(present))[1:] - np.eye(len(present))[:1]
    covariance = differences @ prior[np.ix_(present, present)] @ differences.T
    return present, differences, np.asarray(np.linalg.inv(covariance), np.float64)


@once_for_a_machine
def _loads(machine: Machine) -> tuple[float, ...]:
    return tuple(map(float, static_loads(rig_of(machine))))


def implausible_stiffness(machine: Machine, estimate: Estimate) -> list[Diagnosis]:
    """Whether an estimated stiffness is impossible for a tyre with that static load."""
    loads = _loads(machine)
    for name, load, given in zip(("front", "rear", "implement"), loads, estimate.parameters, strict=False):
        if given.value is None or given.status is not Status.ESTIMATED:
            continue
        share = float(given.value / load)
        if not COEFFICIENT[0] <= share <= COEFFICIENT[1]:
            return [Diagnosis(Code.NO_TYRE, "masses, lengths or wheel_angle", (name,), amounts=(share,))]
    return []
