"""What is wrong with a machine file at one instant, in words: key of the file -> message.

Whether it lasts long enough to withhold the estimates is decided in consistency.py.
"""

import math
from typing import Final

import numpy as np

from tilth.estimator.models.parameters import rig_of, static_loads
from tilth.estimator.pose import latency
from tilth.estimator.pose.aligner import MOUNTS, Aligner
from tilth.estimator.pose.plausibility import SURVEY_SDS, pair_limits
from tilth.estimator.rig.numbers import NUMBERS
from tilth.schemas.flow import WITHOUT_RTK, Estimate, FlagKind, Pose, Status
from tilth.schemas.machine import Machine
from tilth.schemas.plausible import COEFFICIENT
from tilth.schemas.spread import interval, plus_minus

LATENCY_CHI_SQUARE: Final = 30.0  # of up to three differences of latency
PARKED_LIMIT: Final = 0.2  # m, largest error of the hitch while the rig stands or creeps, or SURVEY_SDS
PARKED_POSES: Final = 10  # poses (2 s) in that mean; there are no more if the receiver becomes doubtful

KEYS: Final = {row.name: row.key for row in NUMBERS if row.open_sd}
_PAIR: Final = "length of the {}'s pair"
_OFFSETS: Final = (_PAIR.format("tractor"), _PAIR.format("implement"), "hitch, along", "hitch, across")
_BODY: Final = {"pair_t": "tractor", "pair_i": "implement"}


def misplaced_receivers(pose: Pose) -> dict[str, str]:
    """Findings from the flags of a pose: receivers that are misplaced, swapped or late, if all have RTK."""
    if any(flag.kind in WITHOUT_RTK for flag in pose.flags):
        return {}
    found = {}
    for flag in pose.flags:
        kind, mount = flag.kind, flag.of
        if kind is FlagKind.MOVED:
            text = f"{mount} is not where the machine file says: its position, or the lengths to the hitch?"
            found[f"receiver.{mount}.position"] = text
        elif kind is FlagKind.SWAPPED:
            text = f"{mount} stands in another's place: are names or sources exchanged?"
            found[f"receiver.{mount}.name"] = text
        elif kind is FlagKind.LATENCY:
            text = f"{mount} seems to report at another time than the file allows: its latency or position?"
            found[f"receiver.{mount}.latency"] = text
    return found


def parked_errors(machine: Machine, aligner: Aligner) -> dict[str, str]:
    """Findings from distances while the rig stands or creeps, when latency has no effect on them."""
    keys = ("receiver.position on the tractor", "receiver.position on the implement",
            "tractor.c or implement.d", "receiver.position (right)")  # fmt: skip
    sds = (machine.tractor.c.sd, machine.implement.d.sd, *(r.survey_sd for r in machine.receiver))
    hitch = max(PARKED_LIMIT, SURVEY_SDS * math.hypot(*sds))
    limits = (*pair_limits(machine), hitch, hitch)
    return {
        key: f"{what} is off by {mean.value:+.2f} m where the rig stands still: {key}?"
        for key, what, limit, mean in zip(keys, _OFFSETS, limits, aligner.long_term.parked, strict=True)
        if mean.count >= PARKED_POSES and abs(mean.value) > limit
    }


def latencies(machine: Machine, aligner: Aligner) -> dict[str, str]:
    """A finding if the latencies that would explain the distances are implausibly different."""
    by_mount = {r.mount: r.latency.sd for r in machine.receiver}
    present = [k for k, mount in enumerate(MOUNTS) if by_mount.get(mount, 0.0) > 0.0]
    if len(present) < 2:
        return {}
    prior = latency.prior([by_mount.get(mount, 0.0) for mount in MOUNTS]).covariance
    differences = np.eye(len(present))[1:] - np.eye(len(present))[0]
    off = differences @ aligner.latency.tau[present]
    covariance = differences @ prior[np.ix_(present, present)] @ differences.T
    if float(off @ np.linalg.solve(covariance, off)) < LATENCY_CHI_SQUARE:
        return {}
    key = "receiver.position (forward), tractor.c, implement.d or receiver.latency"
    return {key: f"distances between the receivers fit no likely latency: {key}?"}


def describe(name: str, off: float, sd: float) -> str:
    """How far what was found of a number is from the file. name: of KEYS; off, sd: as in open_tracker.NAMES
    (rad, s, m; else a logarithm)."""
    if name in ("wheel_zero", "pair_t", "pair_i"):
        what = "wheels' zero" if name == "wheel_zero" else f"pair on the {_BODY[name]}"
        return f"the {what} off by {plus_minus(math.degrees(off), math.degrees(sd), '°')}"
    if name == "latency":
        return f"a latency of {plus_minus(off, sd, 's')} beyond the file's"
    if name in ("aside_i", "e"):
        what = "implement's receivers" if name == "aside_i" else "implement's axle"
        return f"the {what} off by {plus_minus(off, sd, 'm')}"
    low, high = interval(math.exp(min(off, 5.0)), min(sd, 5.0))
    what = "reading of the wheels' angle" if name == "wheel_gain" else KEYS[name].partition(" or ")[0]
    return f"{what} {low:.2f} to {high:.2f} times what the file says (95 %)"


def implausible_stiffness(machine: Machine, estimate: Estimate) -> dict[str, str]:
    """A finding if an estimated stiffness is impossible for a tyre with that static load."""
    loads = static_loads(rig_of(machine))
    for name, load, given in zip(("front", "rear", "implement"), loads, estimate.parameters, strict=False):
        if given.value is None or given.status is not Status.ESTIMATED:
            continue
        if not COEFFICIENT[0] <= given.value / load <= COEFFICIENT[1]:
            key = "masses, lengths or wheel_angle"
            size = f"a stiffness of {given.value / load:.2g} times its load per rad"
            return {key: f"{size} is no tyre's ({name}): {key}?"}
    return {}
