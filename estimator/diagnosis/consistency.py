"""Do the data contradict the machine file? While they do, no estimate is published.

Each check compares the data with one part of the file: positions of receivers, their roll correction, the
wheel angle against the yaw rate; and, by the open tracker (methods/open_tracker.py), lengths, wheel angle,
latency and inertias. A failed check names the key of the file (findings.py). What the file may still be wrong
by makes the numbers wider, or withholds them (widening.py).
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from tilth.estimator.diagnosis import findings, open_numbers
from tilth.estimator.diagnosis.directive import Directive
from tilth.estimator.diagnosis.open_numbers import NAMES, Misfit, OpenEvidence
from tilth.estimator.diagnosis.widening import SEGMENT_S, WIDENING, Widening, widened, widening_of
from tilth.estimator.pose import motion_check, receiver_checks, wheel_check
from tilth.estimator.pose.aligner import Aligner
from tilth.estimator.pose.motion_check import MotionCheck
from tilth.estimator.pose.receiver_checks import ReceiverChecks
from tilth.estimator.pose.wheel_check import WheelCheck
from tilth.estimator.rig.lifecycle import FaultCase, Persistence
from tilth.estimator.rig.numbers import NUMBER
from tilth.estimator.ties import exceeds
from tilth.estimator.tuning import tuned
from tilth.schemas.diagnosis import Diagnosis
from tilth.schemas.flow import Estimate, Flag, FlagKind, ParameterEstimate, Pose, Status
from tilth.schemas.machine import Machine
from tilth.schemas.notices import NoticeCode, reasoned
from tilth.schemas.reasons import Code, Reason

CONTRADICTION: Final = FlagKind.CONTRADICTION


@dataclass(frozen=True, slots=True)
class ConsistencyTuning:
    """When a file is contradicted, and when it is confirmed. A pose is 0.2 s."""

    begins: float = tuned(22.0, "chi^2", "of one open number, with all others within what the file allows")
    begins_total: float = tuned(90.0, "chi^2", "of all open numbers")
    ends: float = tuned(0.4, "1", "factor on these limits for the end of a contradiction")
    poses_to_confirm: int = tuned(
        40, "poses", "in a row without doubt (8 s) before the file counts as confirmed"
    )
    poses_to_doubt: int = tuned(60, "poses", "in a row with doubt before it is not confirmed any more")
    least_poses: int = tuned(5, "poses", "in a row before a finding is isolated")
    least_poses_open: int = tuned(
        40, "poses", "same of the open tracker (8 s): other soil looks the same for seconds"
    )
    poses_to_end: int = tuned(50, "poses", "in a row without a finding before it ends")
    poses_to_forget: int = tuned(25, "poses", "what was learned during a longer contradiction is discarded")
    rival_share: float = tuned(0.6, "1", "of the best chi-square: what explains so much is named as well")
    rivals: int = tuned(2, "explanations", "that are named beside the best")
    outlier_share: float = tuned(
        0.25, "1", "largest share of outliers among what the open tracker took lately"
    )
    least_segments: int = tuned(
        40, "segments", "8 s, from which the open tracker has learned before it is used"
    )
    least_after_restart: int = tuned(
        100,
        "segments",
        "same (20 s) after it began anew for what it had found",
    )
    nuisance_sds: float = tuned(6.0, "sd", "by which a nuisance of a method may differ from a right file")


CONSISTENCY: Final = ConsistencyTuning()
NOT_DRIVEN: Final = Reason(Code.NOT_DRIVEN)
BY_METHOD: Final = frozenset({Code.METHOD_FINDS, Code.NO_TYRE})
"""Found in a method's estimate: learning goes on, so that it can end."""
OF_OPEN_NUMBERS: Final = frozenset({Code.DRIVING_FINDS, Code.METHOD_FINDS})
WITNESSES: Final = ("pem", "tracker")
"""Methods that have all numbers of a file for unknowns."""


@dataclass(slots=True)
class Consistency:
    """State of all checks."""

    wheel: WheelCheck = field(default_factory=WheelCheck)
    motion: MotionCheck = field(default_factory=MotionCheck)
    cases: dict[str, FaultCase] = field(default_factory=dict)  # by key
    confirmed: bool = False  # no error of the file that driving has not excluded would matter
    judged: bool = False  # it is known what such errors add
    widening: Widening = field(default_factory=Widening)
    own: dict[str, Widening] = field(default_factory=dict)  # method -> the same of its numbers, by its fit
    fit: Misfit | None = None  # what fits of whole windows find of the file
    given: dict[str, list[bool]] = field(default_factory=dict)  # method -> which of the six had a number
    was_confirmed: bool = False  # at some time of this run
    pairs_known: bool = (
        False  # it was, and since then a receiver is left out: one alone shows no yaw of a pair
    )
    missing: Reason = NOT_DRIVEN  # why that is not known
    agrees: Persistence = field(default_factory=Persistence)  # poses in which the open tracker does
    rates_known: bool = False  # the lag of turn rates is known: smoothed ones would make lengths look wrong
    methods: dict[str, list[Diagnosis]] = field(default_factory=dict)  # of their latest estimates
    # after its first finding the open tracker was restarted; the next one counts
    open_restarted: bool = False
    sensor_fault: Code | None = None  # of a sensor that all numbers rest on


def observe(
    state: Consistency, aligner: Aligner, checks: ReceiverChecks, pose: Pose, moved: Iterable[Diagnosis],
    evidence: OpenEvidence,
) -> Directive:  # fmt: skip
    """Take one pose. moved: what the watch has found moved. evidence: of the open tracker."""
    machine = aligner.machine
    wheel_check.observe(state.wheel, machine, pose)
    motion_check.observe(state.motion, pose)
    state.was_confirmed |= state.confirmed
    state.rates_known |= receiver_checks.turn_rates_known(checks)
    found = _by_key(moved) or _found_at_pose(state, aligner, checks, pose, evidence)
    by_method = _by_methods(state)
    if found and not any(key in state.cases for key in by_method):
        by_method = {}  # a consequence of what the other checks have found
    return _update(state, {**found, **by_method}, evidence, pose.t_ns)


def check_estimate(state: Consistency, machine: Machine, estimate: Estimate) -> None:
    """Check the nuisances and stiffnesses of a method's estimate, before anything of it is withheld."""
    found = findings.implausible_stiffness(machine, estimate)
    sds = np.hypot(open_numbers.allowed(machine), [row.uneven_sd for row in open_numbers.OPEN])
    limits = dict(zip(NAMES, CONSISTENCY.nuisance_sds * sds, strict=True))
    for name, (value, sd) in estimate.nuisances.items():
        if abs(value) > limits.get(name, math.inf):
            of = (name, estimate.method)
            found.append(Diagnosis(Code.METHOD_FINDS, NUMBER[name].key, of, (name,), (value,), (sd,)))
    state.methods[estimate.method] = found


def contradictions(state: Consistency) -> list[Diagnosis]:
    """Why no estimate may be published; none without a contradiction."""
    return [case.diagnosis for case in state.cases.values() if case.isolated]


def stops_learning(state: Consistency) -> bool:
    """Whether nothing may be learned from the present measurements."""
    return any(case.isolated and case.latest.code not in BY_METHOD for case in state.cases.values())


def flags(state: Consistency) -> list[Flag]:
    """One flag for each key that is contradicted now."""
    return [Flag(CONTRADICTION, one.key) for one in contradictions(state)]


def withheld(state: Consistency, estimate: Estimate) -> Estimate:
    """The estimate as it may be published: no numbers while the file is contradicted or not confirmed."""
    if state.sensor_fault is not None:
        return _without_numbers(estimate, Status.INVALID, Reason(state.sensor_fault))
    if why := contradictions(state) or state.methods.get(estimate.method, []):
        reason = Reason(Code.CONTRADICTED, because=tuple(one.reason for one in why))
        return _without_numbers(estimate, Status.INVALID, reason)
    of_file = widening_by_file(state, estimate.method)
    if of_file is None:
        return _without_numbers(estimate, Status.UNESTIMATED, state.missing)
    return widened(of_file, estimate, state.given.get(estimate.method, ()))


def widening_by_file(state: Consistency, method: str) -> Widening | None:
    """What errors that may still be in the file do to a method's numbers; None while that is not known."""
    own = state.own.get(method) if _sensors_known(state) else None
    return own or (state.widening if state.judged or state.confirmed else None)


def _without_numbers(estimate: Estimate, status: Status, reason: Reason) -> Estimate:
    usable = (Status.ESTIMATED, Status.STALE)
    if estimate.of_place is not None:
        estimate = replace(estimate, of_place=replace(estimate.of_place, log_mean=()))
    if status is Status.UNESTIMATED and all(p.status not in usable for p in estimate.parameters):
        return estimate  # it has no numbers, and its own reasons
    parameters = tuple(ParameterEstimate(None, None, status, reason, p.age_s) for p in estimate.parameters)
    return replace(
        estimate, parameters=parameters, per_mass=(None,) * 3, per_mass_sd=(), determined=(), bound=()
    )


def fit_tells(state: Consistency, method: str, evidence: OpenEvidence) -> None:
    """Take what a method's fit has found of the file, for its own numbers. It confirms nothing: of errors as
    large as 0.5 m or 30 % a row's tyres can make up for more than its slopes tell."""
    if contradictions(state) or not _fits(evidence, CONSISTENCY.ends):
        state.own.pop(method, None)
    else:
        state.own[method] = widening_of(evidence)


def _sensors_known(state: Consistency) -> bool:
    return state.rates_known and not motion_check.roll_check_pending(state.motion)


def sensor_failed(state: Consistency, fault: Code | None, seen_at_once: bool) -> Directive:
    """A sensor that all numbers rest on has failed, or works again (None). seen_at_once: nothing was learned
    with its wrong readings."""
    begins = fault is not None and state.sensor_fault is None
    state.sensor_fault = fault
    learned = begins and not seen_at_once
    if learned:
        state.wheel, state.fit = WheelCheck(), None
    return Directive(reset=learned, reset_open=learned)


def discard_findings(state: Consistency, confirmed: bool = False) -> None:
    """Discard what was found with wrong measurements. confirmed: whether the rest of the file is."""
    state.cases = {
        key: case for key, case in state.cases.items() if case.latest.code not in OF_OPEN_NUMBERS
    }  # fmt: skip
    state.methods, state.confirmed, state.judged = {}, confirmed, confirmed
    state.own, state.fit = (state.own, state.fit) if confirmed else ({}, None)


def left_out(state: Consistency) -> None:
    """Something was moved and is not used from here on: all else of the file is as it was confirmed. That a
    receiver is not in its place was found of just that, perhaps sooner."""
    state.cases = {key: case for key, case in state.cases.items() if not _of_a_place(case.latest)}
    state.pairs_known = state.was_confirmed and not contradictions(state)
    discard_findings(state, state.pairs_known)
    state.agrees, state.fit = Persistence(), None  # methods begin anew


def _of_a_place(one: Diagnosis) -> bool:
    return bool(one.numbers) and NUMBER[one.numbers[0]].place


def _by_methods(state: Consistency) -> dict[str, Diagnosis]:
    """What methods find of the file. What a witness does not find that gives numbers, the other has by losing
    its way: then only what that one says itself is withheld."""
    witnesses = [
        {one.key for one in state.methods[method]}
        for method in WITNESSES if method in state.methods and any(state.given.get(method, []))
    ]  # fmt: skip
    found = _by_key(one for wrong in state.methods.values() for one in wrong)
    return {key: one for key, one in found.items() if all(key in keys for keys in witnesses)}


def _by_key(found: Iterable[Diagnosis]) -> dict[str, Diagnosis]:
    return {one.key: one for one in found}


# The findings of one pose.


def _found_at_pose(
    state: Consistency, aligner: Aligner, checks: ReceiverChecks, pose: Pose, evidence: OpenEvidence
) -> dict[str, Diagnosis]:
    machine = aligner.machine
    found = [
        *findings.misplaced_receivers(pose), *findings.parked_errors(machine, aligner),
        *findings.latencies(machine, aligner), *findings.wrong_rolls(checks),
        *motion_check.found(state.motion),
    ]  # fmt: skip
    wheel = wheel_check.verdict(state.wheel)
    if wheel is not None:
        found.append(wheel)
    elif not found and state.rates_known:
        found = _by_driving(state, evidence) or _rejected(evidence)
    return _by_key(found)


def _by_driving(state: Consistency, evidence: OpenEvidence) -> list[Diagnosis]:
    """What the open tracker finds."""
    if evidence.learned < CONSISTENCY.least_segments:
        return []
    misfit = evidence.misfit
    decided = [one for one in contradictions(state) if one.code is Code.DRIVING_FINDS]
    best = float(misfit.by_name.max())
    if _fits(evidence, CONSISTENCY.ends if decided else 1.0):
        return []
    if decided:  # it keeps its key for as long as it lasts
        return decided
    if _agreeing(state) is not None:
        return []
    order = np.argsort(-misfit.by_name)
    names = [NAMES[k] for k in order if misfit.by_name[k] >= CONSISTENCY.rival_share * best]
    names = names[: CONSISTENCY.rivals + 1]
    keys, k = [NUMBER[name].key for name in names], order[0]
    of, off, sd = (names[0], *keys[1:]), float(misfit.off[k]), float(misfit.sd[k])
    return [Diagnosis(Code.DRIVING_FINDS, keys[0], of, tuple(names), (off,), (sd,))]


def _fits(evidence: OpenEvidence, share: float) -> bool:
    """Whether what the open tracker finds is within a share of the limits."""
    return _is_near(evidence.misfit, share)


def _agreeing(state: Consistency) -> Misfit | None:
    """What fits of whole windows find, if it is that the file is right: they are rarely lost, a tracker is,
    in fast chirps."""
    return state.fit if state.fit is not None and _is_near(state.fit, CONSISTENCY.ends) else None


def _is_near(misfit: Misfit, share: float) -> bool:
    return exceeds(share * CONSISTENCY.begins, float(misfit.by_name.max())) and exceeds(
        share * CONSISTENCY.begins_total, misfit.total
    )


def _rejected(evidence: OpenEvidence) -> list[Diagnosis]:
    """Whether many of the recent measurements are outliers of the open tracker."""
    if exceeds(CONSISTENCY.outlier_share, evidence.rejected):
        return []
    return [Diagnosis(Code.MOST_REJECTED, "receiver", amounts=(evidence.rejected,))]


# The findings over time.


def _update(
    state: Consistency, found: Mapping[str, Diagnosis], evidence: OpenEvidence, t_ns: int
) -> Directive:
    """Update the cases with the findings of one pose."""
    directive = Directive()
    for key, one in found.items():
        case = state.cases.setdefault(key, FaultCase(replace(one, since_ns=t_ns), one))
        opened = one.code is Code.DRIVING_FINDS
        if not case.found(one, CONSISTENCY.least_poses_open if opened else CONSISTENCY.least_poses):
            continue
        if opened and (not state.open_restarted or (evidence.rough and not NUMBER[one.numbers[0]].in_rows)):
            evidence = _restart_open(state, directive, evidence)
            del state.cases[key]
            continue
        state.confirmed, state.judged, state.own = False, False, {}
        directive.events.append((CONTRADICTION, reasoned(one.reason, NoticeCode.CONTRADICTED)))
    for key, case in list(state.cases.items()):
        if key in found or not case.missing(CONSISTENCY.poses_to_end):
            continue
        del state.cases[key]
        if not case.isolated:
            continue
        over = reasoned(case.diagnosis.reason, NoticeCode.FITS_AGAIN, key=case.diagnosis.key)
        directive.events.append((CONTRADICTION, over))
        if case.lasted - CONSISTENCY.poses_to_end >= CONSISTENCY.poses_to_forget:
            directive.reset, state.fit = True, None
            if case.latest.code not in OF_OPEN_NUMBERS:  # it has learned of it as well
                directive.reset_open, evidence = True, evidence.restarted()
    if not contradictions(state):
        _update_confirmation(state, evidence)
    directive.withhold = stops_learning(state)
    return directive


def _restart_open(state: Consistency, directive: Directive, evidence: OpenEvidence) -> OpenEvidence:
    """Restart the open tracker and drop its finding: it may diverge from a distant start, but hardly
    twice, except on rough ground. There a file is accused of what straight driving tells too, and of nothing
    else, but from the second time on it is not confirmed either: a restarted one agrees with any file until
    it has learned."""
    state.confirmed &= not state.open_restarted
    state.open_restarted = directive.reset_open = True
    return evidence.restarted()


def _update_confirmation(state: Consistency, evidence: OpenEvidence) -> None:
    """What the file may still be wrong by. A confirmation is withdrawn after a long doubt."""
    agreeing = _agreeing(state)
    if agreeing is not None and not _fits(evidence, CONSISTENCY.ends):
        evidence = replace(evidence, misfit=agreeing)  # that tracker has lost its way
    state.agrees.look(_fits(evidence, CONSISTENCY.ends))
    doubt = None if _fits(evidence, 1.0) else NUMBER[NAMES[int(evidence.misfit.by_name.argmax())]].key
    decided = _sensors_known(state)
    least = CONSISTENCY.least_after_restart if state.open_restarted else CONSISTENCY.least_segments
    learned = evidence.learned >= least
    if not learned and state.fit is not None and (evidence.rough or not state.judged):
        evidence, learned = replace(evidence, misfit=state.fit), True  # on rough ground it may never have
    if not decided or not learned:  # what was known before holds
        keys = () if decided else ("turn rates and rolls",)
        seconds = max((least - evidence.learned) * SEGMENT_S, 0.0 if decided else WIDENING.shortest_s)
        state.missing = Reason(Code.NOT_CONFIRMED, keys, (seconds,))
        return
    if doubt and not state.judged:  # slopes do not say what so large an error would do
        state.missing = Reason(Code.DOUBTED, (doubt,))
        return
    state.judged = True
    state.widening = widening_of(evidence, open_numbers.OF_PAIRS if state.pairs_known else (), state.fit)
    if evidence.learned < least:
        return
    if state.confirmed:
        state.confirmed = state.agrees.absent < CONSISTENCY.poses_to_doubt
    else:
        state.confirmed = state.widening.confirms and state.agrees.seen >= CONSISTENCY.poses_to_confirm
        state.open_restarted &= not state.confirmed
