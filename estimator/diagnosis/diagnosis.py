"""Is the machine file right, and is the rig still as it says? One answer, for the fold and all who publish.

It looks at each pose three times: at the sensors before the pose is published, at what has been moved before
the record takes it, and at the file when the open tracker has taken it. What follows is a `Directive`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

from tilth.estimator.diagnosis import consistency, watch, wheel_speed
from tilth.estimator.diagnosis.consistency import Consistency
from tilth.estimator.diagnosis.directive import Directive
from tilth.estimator.diagnosis.open_numbers import Misfit, OpenEvidence
from tilth.estimator.diagnosis.watch import Moved, WatchState
from tilth.estimator.diagnosis.widening import SEGMENT_S
from tilth.estimator.pose import aligner as aligners
from tilth.estimator.pose import receiver_checks, standing
from tilth.estimator.pose.aligner import Aligner
from tilth.estimator.pose.receiver_checks import ReceiverChecks
from tilth.estimator.pose.standing import StandingCheck
from tilth.schemas.diagnosis import Diagnosis, DiagnosisState
from tilth.schemas.flow import Accepted, Estimate, EventKind, Flag, Pose
from tilth.schemas.machine import Machine
from tilth.schemas.notices import Notice, NoticeCode, reasoned
from tilth.schemas.reasons import Code


@dataclass(slots=True)
class RigDiagnosis:
    """Plain data."""

    consistency: Consistency = field(default_factory=Consistency)  # of the data with the machine file
    checks: ReceiverChecks = field(default_factory=ReceiverChecks)
    standing: StandingCheck = field(default_factory=StandingCheck)  # sensors that have failed
    watch: WatchState = field(default_factory=WatchState)  # of what may be moved while driving

    @property
    def confirmed(self) -> bool:
        """Whether driving has shown that the machine file is right."""
        return self.consistency.confirmed


def look_at_sensors(state: RigDiagnosis, aligner: Aligner, pose: Pose) -> Directive:
    """Sensors that stand still, receivers with wrong settings."""
    if not aligner.lateness.doubts(pose.t_ns):
        receiver_checks.observe(state.checks, aligner, pose)
    events = standing.observe(state.standing, aligner, pose)
    screen = aligner.screens.by.get(aligners.WHEEL_NAME)
    directive = Directive()
    if screen is not None:  # without the wheel angle there are no numbers
        fault = Code.WHEEL_ANGLE_STANDS if screen.failed else None
        directive = consistency.sensor_failed(state.consistency, fault, screen.stands)
    begun = receiver_checks.begun(state.checks)
    directive.events += [*events, *((flag.kind, reasoned(one.reason)) for flag, one in begun)]
    directive.lagging = receiver_checks.lagging(state.checks)
    if any(flag.kind is receiver_checks.SMOOTHED for flag, _ in begun):
        consistency.discard_findings(state.consistency)
        directive.reset = directive.reset_open = True
    return directive


def flags(state: RigDiagnosis) -> list[Flag]:
    """Of a pose: all that is wrong now."""
    return [
        *receiver_checks.flags(state.checks), *consistency.flags(state.consistency),
        *standing.flags(state.standing),
    ]  # fmt: skip


def look_at_places(state: RigDiagnosis, aligner: Aligner, pose: Pose, t_ns: int) -> Directive:
    """What has been moved: it is left out, and what was learned with it. t_ns: now."""
    directive = Directive()
    if aligner.lateness.doubts(pose.t_ns):
        return directive
    if found := watch.observe(state.watch, aligner, pose):
        consistency.left_out(state.consistency)
        directive = Directive(exclude=watch.left_out(state.watch), reset=True, reset_open=True)
    tyres = wheel_speed.observe(state.watch.wheel_speed, aligner, pose)  # no estimate uses the wheels' speed
    for one in (*found, *([tyres] if tyres else [])):
        directive.events.append((EventKind.MOVED, _moved(one, t_ns)))
    return directive


def _moved(one: Diagnosis, t_ns: int) -> Notice:
    """That it has been moved, or is back. t_ns: now."""
    reason, back = one.reason, one.state is DiagnosisState.CLEARED
    if one.code is Code.TYRES_CHANGED:
        if back:
            return reasoned(reason, NoticeCode.TYRES_BACK, key=one.key)
        return reasoned(reason, NoticeCode.TYRES_CHANGED)
    if back:
        return reasoned(reason, NoticeCode.MOVED_BACK, what=one.of[0])
    return reasoned(reason, NoticeCode.MOVED, ago_min=max(t_ns - one.since_ns, 0) * 1e-9 / 60.0)


def look_at_file(
    state: RigDiagnosis, aligner: Aligner, pose: Pose, evidence: OpenEvidence | None
) -> Directive:
    """Whether the data contradict the machine file. evidence: of the open tracker; None where nothing is
    judged."""
    if evidence is None:
        return Directive(withhold=consistency.stops_learning(state.consistency))
    moved = watch.contradictions(state.watch)
    return consistency.observe(state.consistency, aligner, state.checks, pose, moved, evidence)


def fit_tells(state: RigDiagnosis, method: str, misfit: Misfit, seconds: float) -> None:
    """Take what a method's fit has found of the file. seconds: of driving that it is of."""
    evidence = OpenEvidence(misfit, misfit, round(seconds / SEGMENT_S), 0.0, rough=False)
    consistency.fit_tells(state.consistency, method, evidence)


def windows_tell(state: RigDiagnosis, misfit: Misfit) -> None:
    """Take what fits of whole windows have found of the file."""
    state.consistency.fit = misfit


def soil_changed(state: RigDiagnosis) -> Directive:
    """Other soil: it takes the open tracker seconds to tell it from another rig, so it begins anew."""
    if not state.confirmed:
        return Directive()
    consistency.discard_findings(state.consistency, confirmed=True)
    return Directive(reset_open=True)


def clock_stepped(state: RigDiagnosis) -> Directive:
    """The log's clock stepped back. What was found stays."""
    receiver_checks.clock_stepped(state.checks)
    return Directive(exclude=watch.left_out(state.watch), lagging=receiver_checks.lagging(state.checks))


def resumed(state: RigDiagnosis, learned: bool) -> None:
    """A run before has saved what it had learned, only because the file was confirmed."""
    state.consistency.confirmed = learned


def carry(state: RigDiagnosis, machine: Machine, moved: Sequence[Moved]) -> Directive:
    """Found moved by runs before, and neither accepted nor put back."""
    state.watch.moved = [watch.carried(machine, one) for one in moved]
    excluded = watch.left_out(state.watch)
    state.consistency.pairs_known |= bool(excluded) and state.confirmed
    return Directive(exclude=excluded or None)


def accept(state: RigDiagnosis, machine: Machine, accepted: Accepted) -> Directive:
    """The machine file has the accepted value from now on; machine: without it."""
    watch.accept(state.watch, machine, accepted)
    state.consistency = Consistency()
    return Directive(exclude=watch.left_out(state.watch), reset=True, reset_open=True)


def is_judged(aligner: Aligner, pose: Pose) -> bool:
    """Else what is found would be found of the sensor or of the computer, not of the file."""
    return not (aligner.wheel_stands() or aligner.lateness.doubts(pose.t_ns))


def withheld(state: RigDiagnosis, estimate: Estimate) -> Estimate:
    """An estimate as it may be published."""
    return consistency.withheld(state.consistency, estimate)


def checked(state: RigDiagnosis, machine: Machine, estimate: Estimate) -> Estimate:
    """A method's new estimate, as it may be published."""
    consistency.check_estimate(state.consistency, machine, estimate)
    published = consistency.withheld(state.consistency, estimate)
    state.consistency.given[estimate.method] = [p.value is not None for p in published.parameters]
    return published


def contradictions(state: RigDiagnosis) -> list[Diagnosis]:
    """What the data contradict now."""
    return consistency.contradictions(state.consistency)
