"""Do the data contradict the machine file? While they do, no estimate is published.

Each check compares the data with one part of the file: positions of receivers, their roll correction, the
wheel angle against the yaw rate; and, by the open tracker (open_tracker.py), lengths, wheel angle, latency
and inertias. A failed check names the key of the file (findings.py). Before the driving was such that a gross
error would have shown, no estimate is published either: a wrong file must never lead to a number.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.methods import open_tracker
from tilth.estimator.methods.findings import (
    KEYS,
    describe,
    implausible_stiffness,
    latencies,
    misplaced_receivers,
    parked_errors,
)
from tilth.estimator.methods.open_tracker import Misfit
from tilth.estimator.methods.tracker import TrackerState
from tilth.estimator.pose import motion_check, receiver_checks, wheel_check
from tilth.estimator.pose.aligner import Aligner
from tilth.estimator.pose.motion_check import MotionCheck
from tilth.estimator.pose.receiver_checks import ReceiverChecks
from tilth.estimator.pose.wheel_check import WheelCheck
from tilth.estimator.record.record import Segment
from tilth.schemas.flow import Estimate, Flag, FlagKind, ParameterEstimate, Pose, Status
from tilth.schemas.machine import Machine
from tilth.schemas.reasons import Code, Reason

Array = NDArray[np.float64]

CONTRADICTION: Final = FlagKind.CONTRADICTION
BEGINS: Final = 22.0  # chi-square of one open number, with all others within what the file allows
BEGINS_TOTAL: Final = 90.0  # chi-square of all open numbers
ENDS: Final = 0.4  # factor on these limits for the end of a contradiction
POSES_TO_CONFIRM: Final = 40  # poses (8 s) in a row without doubt before the file counts as confirmed
POSES_TO_DOUBT: Final = 60  # poses (12 s) in a row with doubt before it is not confirmed any more
LEAST_POSES: Final = 5  # poses (1 s) in a row before a finding becomes active
LEAST_POSES_OPEN: Final = 40  # poses (8 s), of the open tracker: for seconds, other soil has the same effect
POSES_TO_END: Final = 50  # poses (10 s) in a row without a finding before it ends
POSES_TO_FORGET: Final = 25  # poses (5 s): what was learned during a longer contradiction is discarded
RIVAL_SHARE: Final = 0.6  # an explanation with this share of the best one's chi-square is named as well
OUTLIER_SHARE: Final = 0.25  # largest share of outliers among the rows of the last OUTLIER_SEGMENTS
OUTLIER_SEGMENTS: Final = 100
LEAST_SEGMENTS: Final = 40  # segments (8 s) from which the open tracker has learned before it is used
NOT_DRIVEN: Final = Reason(Code.NOT_DRIVEN)
NUISANCE_SDS: Final = 6.0  # sds by which a nuisance of a method may differ from a right file

_ROLL: Final = frozenset({receiver_checks.TWICE, receiver_checks.NOT, receiver_checks.UNCLEAR})


@dataclass(slots=True)
class Finding:
    """One key of the machine file that the data contradict."""

    key: str
    text: str
    poses: int = 0  # poses in a row in which it was found
    absent: int = 0  # poses in a row in which it was not found
    active: bool = False  # it has lasted long enough to withhold estimates
    by_method: bool = False  # found in a method's estimate; then learning continues, so that it can end
    active_poses: int = 0  # poses since it became active


@dataclass(slots=True)
class Consistency:
    """State of all checks."""

    open: TrackerState  # the open tracker
    wheel: WheelCheck = field(default_factory=WheelCheck)
    motion: MotionCheck = field(default_factory=MotionCheck)
    findings: dict[str, Finding] = field(default_factory=dict)  # by key
    confirmed: bool = False
    was_confirmed: bool = False  # at some time of this run
    pairs_known: bool = (
        False  # it was, and since then a receiver is left out: one alone shows no yaw of a pair
    )
    missing: Reason = NOT_DRIVEN  # why the file is not confirmed
    agreed: int = 0  # poses in a row in which the open tracker agrees with the file; below 0: does not agree
    rates_known: bool = False  # the lag of turn rates is known: smoothed ones would make lengths look wrong
    rows: list[tuple[float, float]] = field(default_factory=list)  # (outliers, all) after the last segments
    learned: int = 0  # segments from which the open tracker has learned
    methods: dict[str, dict[str, str]] = field(default_factory=dict)
    """Method -> key -> what is wrong with its latest estimate."""
    # after its first finding the open tracker was restarted; the next one counts
    open_restarted: bool = False
    sensor_fault: Code | None = None  # of a sensor that all numbers rest on
    must_forget: bool = False  # what was learned during a contradiction has to be discarded


def initial(machine: Machine) -> Consistency:
    """The state before any driving."""
    return Consistency(open_tracker.initial(machine))


def observe(
    state: Consistency, machine: Machine, aligner: Aligner, checks: ReceiverChecks, pose: Pose,
    segment: Segment | None, moved: Mapping[str, str],
) -> list[tuple[str, str]]:  # fmt: skip
    """Take one pose and the segment that is complete with it. Returns (kind, text) of the events.

    moved: key -> message, of what the watch has found moved.
    """
    # What is found now would be found of the sensor or of the computer, not of the file.
    if aligner.wheel_stands() or aligner.lateness.doubts(pose.t_ns):
        return []
    wheel_check.observe(state.wheel, machine, pose)
    motion_check.observe(state.motion, pose)
    if segment is not None:
        learned = open_tracker.take(state.open, machine, segment)
        state.learned += learned
        if learned or state.open.reason is Code.HELD:
            state.rows = [*state.rows, open_tracker.rejected_rows(state.open)][-OUTLIER_SEGMENTS:]
    state.was_confirmed |= state.confirmed
    state.rates_known |= receiver_checks.turn_rates_known(checks)
    found = moved or _findings_at_pose(state, machine, aligner, checks, pose)
    by_method = {key: text for wrong in state.methods.values() for key, text in wrong.items()}
    if found and not any(key in state.findings for key in by_method):
        by_method = {}  # a consequence of what the other checks have found
    return _update_findings(state, machine, found, by_method)


def check_estimate(state: Consistency, machine: Machine, estimate: Estimate) -> None:
    """Check the nuisances and stiffnesses of a method's estimate, before anything of it is withheld."""
    found = implausible_stiffness(machine, estimate)
    limits = dict(zip(open_tracker.NAMES, NUISANCE_SDS * open_tracker.allowed(machine), strict=True))
    for name, (value, sd) in estimate.nuisances.items():
        if abs(value) > limits.get(name, math.inf):
            found[KEYS[name]] = f"{estimate.method} finds {describe(name, value, sd)}: {KEYS[name]}?"
    state.methods[estimate.method] = found


def contradicted(state: Consistency) -> list[str]:
    """Why no estimate may be published, with the keys; none without a contradiction."""
    return [finding.text for finding in state.findings.values() if finding.active]


def stops_learning(state: Consistency) -> bool:
    """Whether nothing may be learned from the present measurements."""
    return any(finding.active and not finding.by_method for finding in state.findings.values())


def flags(state: Consistency) -> list[Flag]:
    """One flag for each key that is contradicted now."""
    return [Flag(CONTRADICTION, finding.key) for finding in state.findings.values() if finding.active]


def withheld(state: Consistency, estimate: Estimate) -> Estimate:
    """The estimate as it may be published: no numbers while the file is contradicted or not confirmed."""
    if state.sensor_fault is not None:
        return _without_numbers(estimate, Status.INVALID, Reason(state.sensor_fault))
    if why := contradicted(state) or list(state.methods.get(estimate.method, {}).values()):
        reason = Reason(Code.CONTRADICTED, because=tuple(Reason(Code.TEXT, (text,)) for text in why))
        return _without_numbers(estimate, Status.INVALID, reason)
    if not state.confirmed:
        return _without_numbers(estimate, Status.UNESTIMATED, state.missing)
    return estimate


def _without_numbers(estimate: Estimate, status: Status, reason: Reason) -> Estimate:
    usable = (Status.ESTIMATED, Status.STALE)
    if status is Status.UNESTIMATED and all(p.status not in usable for p in estimate.parameters):
        return estimate  # it has no numbers, and its own reasons
    parameters = tuple(ParameterEstimate(None, None, status, reason, p.age_s) for p in estimate.parameters)
    return replace(estimate, parameters=parameters, per_mass=(None,) * 3, determined=(), bound=())


def soil_changed(state: Consistency, machine: Machine) -> None:
    """Restart the open tracker after a change of soil: it takes seconds to tell other soil from another
    rig."""
    if state.confirmed:
        discard_findings(state, machine, confirmed=True)


def sensor_failed(state: Consistency, machine: Machine, fault: Code | None, seen_at_once: bool) -> None:
    """A sensor that all numbers rest on has failed, or works again (None). seen_at_once: nothing was learned
    with its wrong readings."""
    begins = fault is not None and state.sensor_fault is None
    state.sensor_fault = fault
    if begins and not seen_at_once:
        state.wheel, state.must_forget = WheelCheck(), True
        _begin_open_tracker(state, machine)


def discard_findings(state: Consistency, machine: Machine, confirmed: bool = False) -> None:
    """Discard what was found with wrong measurements. confirmed: whether the rest of the file is."""
    _begin_open_tracker(state, machine)
    state.findings = {k: f for k, f in state.findings.items() if f.key not in KEYS.values()}
    state.methods, state.confirmed = {}, confirmed


def left_out(state: Consistency, machine: Machine) -> None:
    """Something was moved and is not used from here on: all else of the file is as it was confirmed. That a
    receiver is not in its place was found of just that, perhaps sooner."""
    state.findings = {k: f for k, f in state.findings.items() if not _of_a_place(f.key)}
    state.pairs_known = state.was_confirmed and not contradicted(state)
    discard_findings(state, machine, state.pairs_known)
    state.agreed = 0


def _of_a_place(key: str) -> bool:
    return key.startswith("receiver.") and "position" in key


def clock_stepped(state: Consistency) -> None:
    """The log's clock stepped back: the motion state is discarded; findings stay."""
    state.open.pending, state.open.running = None, False
    state.open.ticks_before = np.zeros((0, 8))


# The findings of one pose: key of the machine file -> message.


def _findings_at_pose(
    state: Consistency, machine: Machine, aligner: Aligner, checks: ReceiverChecks, pose: Pose
) -> dict[str, str]:
    found = {**misplaced_receivers(pose), **parked_errors(machine, aligner), **latencies(machine, aligner)}
    found |= {
        f"receiver.{flag.of}.roll_corrected": receiver_checks.describe(checks, flag)
        for flag in receiver_checks.flags(checks)
        if flag.kind in _ROLL
    }
    key, text = wheel_check.verdict(state.wheel)
    found |= motion_check.found(state.motion)
    if key:
        return found | {key: text}
    if not found and state.rates_known:
        found |= _open_tracker_findings(state, machine) or _outliers(state)
    return found


def _open_tracker_findings(state: Consistency, machine: Machine) -> dict[str, str]:
    """The finding of the open tracker, or none."""
    if state.learned < LEAST_SEGMENTS:
        return {}
    misfit = open_tracker.misfit(state.open, machine)
    decided = any(key in state.findings and state.findings[key].active for key in KEYS.values())
    share = ENDS if decided else 1.0
    best = float(misfit.by_name.max())
    if best < share * BEGINS and misfit.total < share * BEGINS_TOTAL:
        return {}
    if decided:  # it keeps its key for as long as it lasts
        return {f.key: f.text for f in state.findings.values() if f.active and f.key in KEYS.values()}
    order = np.argsort(-misfit.by_name)
    names = [open_tracker.NAMES[k] for k in order if misfit.by_name[k] >= RIVAL_SHARE * best]
    others = "".join(f", or {KEYS[name]}" for name in names[1:3])
    k = order[0]
    words = describe(names[0], float(misfit.off[k]), float(misfit.sd[k]))
    return {KEYS[names[0]]: f"driving finds {words}: {KEYS[names[0]]}{others}?"}


def _outliers(state: Consistency) -> dict[str, str]:
    """A finding if many of the recent measurements are outliers of the open tracker."""
    if len(state.rows) < OUTLIER_SEGMENTS // 2:
        return {}
    refused, rows = (state.rows[-1][k] - state.rows[0][k] for k in (0, 1))
    if rows <= 0 or refused < OUTLIER_SHARE * rows:
        return {}
    share = f"{100 * refused / rows:.0f} %"
    text = f"{share} of what the receivers say fits no rig like this: receiver, tractor or implement?"
    return {"receiver": text}


# The findings over time.


def _update_findings(
    state: Consistency, machine: Machine, found: Mapping[str, str], by_method: Mapping[str, str]
) -> list[tuple[str, str]]:
    """Update the findings with those of one pose. Returns (kind, text) of those that begin or end."""
    events: list[tuple[str, str]] = []
    found = {**by_method, **found}
    for key, text in list(found.items()):
        finding = state.findings.setdefault(key, Finding(key, text))
        finding.by_method = key in by_method
        finding.poses, finding.absent = finding.poses + 1, 0
        if not finding.active:
            finding.text = text
        opened = key in KEYS.values() and key not in by_method
        may_diverge = not state.open_restarted or open_tracker.is_rough(state.open)
        if opened and not finding.active and finding.poses == LEAST_POSES_OPEN and may_diverge:
            _restart_open_tracker(state, machine, key)
            continue
        if finding.poses >= (LEAST_POSES_OPEN if opened else LEAST_POSES) and not finding.active:
            finding.active = True
            state.confirmed = False
            stop = "" if text.endswith((".", "?", "!")) else "."
            events.append((CONTRADICTION, f"{text}{stop} Until this is over no number is given"))
    for key, finding in list(state.findings.items()):
        finding.active_poses += finding.active
        if key in found:
            continue
        finding.poses, finding.absent = 0, finding.absent + 1
        if not finding.active or finding.absent >= POSES_TO_END:
            del state.findings[key]
            if finding.active:
                events.append((CONTRADICTION, f"{key}: over; the data fit the machine file again"))
                must_forget = finding.active_poses - POSES_TO_END >= POSES_TO_FORGET
                state.must_forget |= must_forget
                if must_forget and key not in KEYS.values():
                    _begin_open_tracker(state, machine)  # it has learned of it as well
    if not any(f.active for f in state.findings.values()):
        _update_confirmation(state, machine)
    return events


def _begin_open_tracker(state: Consistency, machine: Machine) -> None:
    state.open, state.rows, state.learned = open_tracker.initial(machine), [], 0


def _restart_open_tracker(state: Consistency, machine: Machine, key: str) -> None:
    """Restart the open tracker and drop its finding: it may diverge from a distant start, but hardly
    twice, except on rough ground. There a file is not accused, but from the second time on it is not
    confirmed either: a restarted one agrees with any file until it has learned."""
    state.confirmed &= not state.open_restarted
    state.open_restarted = True
    _begin_open_tracker(state, machine)
    del state.findings[key]


def _update_confirmation(state: Consistency, machine: Machine) -> None:
    """Decide whether driving has confirmed the file; after a long doubt the confirmation is withdrawn."""
    misfit = open_tracker.misfit(state.open, machine)
    fits = float(misfit.by_name.max()) < ENDS * BEGINS and misfit.total < ENDS * BEGINS_TOTAL
    state.agreed = max(state.agreed, 0) + 1 if fits else min(state.agreed, 0) - 1
    if state.confirmed:
        state.confirmed = state.agreed > -POSES_TO_DOUBT
        state.missing = _doubt_reason(misfit)
        return
    known = open_tracker.OF_PAIRS if state.pairs_known else ()
    unconfirmed_names = [name for name in open_tracker.unconfirmed(misfit, machine) if name not in known]
    decided = state.rates_known and not motion_check.roll_check_pending(state.motion)
    long_enough = state.agreed >= POSES_TO_CONFIRM and state.learned >= LEAST_SEGMENTS
    state.confirmed = not unconfirmed_names and long_enough and decided
    state.open_restarted &= not state.confirmed
    if not unconfirmed_names and not fits:
        state.missing = _doubt_reason(misfit)
        return
    keys = tuple(KEYS[name] for name in unconfirmed_names[:2])
    if not keys and not decided:
        keys = ("turn rates and rolls",)
    state.missing = Reason(Code.NOT_CONFIRMED, keys)


def _doubt_reason(misfit: Misfit) -> Reason:
    return Reason(Code.DOUBTED, (KEYS[open_tracker.NAMES[int(np.argmax(misfit.by_name))]],))
