"""The fold: one frame in, publications out. Live operation and replay are two short loops around `step`.

Nothing here may depend on whether it runs live: the result is a function of the machine file and of the
frames in their order.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

from tilth.estimator import warm_start
from tilth.estimator.methods import consistency
from tilth.estimator.methods.consistency import Consistency
from tilth.estimator.methods.estimators import FITTED, ROW, Estimator, rows_for
from tilth.estimator.pose import aligner, lateness, log_time, receiver_checks, recognition, standing
from tilth.estimator.pose.aligner import Aligner
from tilth.estimator.pose.body_frames import body_frames, drawing
from tilth.estimator.pose.geometry import to_degrees
from tilth.estimator.pose.log_time import LogTime
from tilth.estimator.pose.pose import poses
from tilth.estimator.pose.receiver_checks import ReceiverChecks
from tilth.estimator.pose.recognition import Recognition
from tilth.estimator.pose.standing import StandingCheck
from tilth.estimator.record import record_builder
from tilth.estimator.record.record import Segment
from tilth.estimator.record.record_builder import RecordState
from tilth.estimator.record.windows import AWAITED, DROPPED, TAKEN
from tilth.estimator.results.flag_events import flag_events
from tilth.estimator.results.recommend import PREFERRED, disagreement, recommend
from tilth.estimator.results.recommend import RECOMMENDED as RECOMMENDED
from tilth.estimator.results.reporting import take_events
from tilth.estimator.tuning import tuned
from tilth.estimator.warm_start import SavedPosterior
from tilth.estimator.watch import watch, wheel_speed
from tilth.estimator.watch.accepted import acceptance, corrected
from tilth.estimator.watch.watch import Moved, WatchState
from tilth.schemas.channels import TOPIC_OF
from tilth.schemas.decode import Decoder
from tilth.schemas.flow import (
    Accepted,
    Estimate,
    Event,
    EventKind,
    FitOutcome,
    Flag,
    FlagKind,
    Frame,
    Measurement,
    Pose,
    Position,
    Publication,
)
from tilth.schemas.identity import KnownAddress
from tilth.schemas.machine import Machine
from tilth.schemas.reasons import Code
from tilth.schemas.sentences import sentence


@dataclass(frozen=True, slots=True)
class FoldTuning:
    """What the fold publishes of itself."""

    poses_per_drawing: int = tuned(
        20, "poses", "between two drawings, 4 s: viewers that come late soon have them"
    )


FOLD: Final = FoldTuning()


@dataclass(slots=True)
class State:
    """The whole state of the fold. `step` changes it in place; nothing else does."""

    machine: Machine
    decoder: Decoder
    aligner: Aligner
    record: RecordState
    consistency: Consistency  # of the data with the machine file
    estimators: dict[str, Any]  # method -> state of that row of ESTIMATORS
    checks: ReceiverChecks = field(default_factory=ReceiverChecks)
    watch: WatchState = field(default_factory=WatchState)  # of what may be moved while driving
    accepted: list[Accepted] = field(default_factory=list)  # values in `machine` that its file does not have
    previous_run: dict[str, SavedPosterior] = field(default_factory=dict)
    """Method -> what the run before had learned, from which this run has started."""
    previous_run_ns: int = 0  # when that run had saved them
    frames: int = 0
    measurements: int = 0
    poses: int = 0
    standing: StandingCheck = field(default_factory=StandingCheck)  # sensors that have failed
    ready: bool = True  # whether the estimators run; poses do not wait for kernels to be compiled
    clock_steps: int = 0
    not_numbers: int = 0  # measurements refused because a value is not finite
    time: LogTime = field(default_factory=LogTime)  # of the log
    recognition: Recognition = field(default_factory=Recognition)  # of receivers that claim no address
    flags: tuple[Flag, ...] = ()  # of the last pose
    flag_times: dict[str, int] = field(default_factory=dict)  # flag -> how often it has begun, of OFTEN
    place: tuple[float, float, float, float] | None = None
    """At the last pose: latitude and longitude of the origin, deg, and x and y of the tractor, m."""
    disagree: bool = False  # whether the methods disagree
    segments: list[Segment | None] = field(default_factory=list)
    """What each pose of the last frame completed; for who analyses a drive afterwards."""
    estimates: dict[str, Estimate] = field(default_factory=dict)  # method -> latest estimate, as published

    @property
    def latest_ns(self) -> int:
        """Greatest t_ns since the last step back of the log's clock."""
        return self.time.latest_ns

    @property
    def rejected(self) -> dict[str, int]:
        """Reason -> count, of frames and measurements that were not used."""
        counts = self.decoder.rejected | self.aligner.screens.rejected
        if self.aligner.lateness.late:
            counts["late"] = self.aligner.lateness.late
        if self.clock_steps:
            counts["clock_step"] = self.clock_steps
        if self.time.stray:
            counts["other_time"] = self.time.stray
        if self.not_numbers:
            counts["not_a_number"] = self.not_numbers
        return counts


def initial(machine: Machine, accepted: Sequence[Accepted] = ()) -> State:
    """The state before the first frame. accepted: values in place of those of the machine file."""
    machine = corrected(machine, accepted)
    estimators = {row.method: row.initial(machine) for row in rows_for(machine)}
    state = State(
        machine, Decoder(machine), aligner.initial(machine), record_builder.initial(machine),
        consistency.initial(machine), estimators,
    )  # fmt: skip
    state.accepted = list(accepted)
    state.estimates = estimates_now(state)
    return state


def save_learned(state: State, t_ns: int) -> dict[str, SavedPosterior]:
    """Method -> what it has learned by t_ns, for the next run; empty while the machine file is not
    confirmed."""
    if not state.consistency.confirmed:
        return {}
    return warm_start.save_learned(state.machine, state.estimators, t_ns)


def resume(
    state: State, previous_run: Mapping[str, SavedPosterior], elapsed_s: float, t_ns: int
) -> dict[str, str]:
    """Start from what was saved elapsed_s before t_ns; call it before the first frame.

    Returns method -> why its saved posterior is not used, "" where it is used.
    """
    refusals = warm_start.resume(state.machine, state.estimators, previous_run, elapsed_s, t_ns)
    state.time.latest_ns = t_ns
    state.previous_run = {
        method: before for method, before in previous_run.items() if refusals.get(method) == ""
    }
    state.consistency.confirmed = bool(state.previous_run)  # it was saved only because the file was confirmed
    state.previous_run_ns = t_ns - round(elapsed_s * 1e9)
    return refusals


def carry(state: State, moved: Sequence[Moved]) -> None:
    """Before the first frame, after `resume`: what has been found moved before, and neither accepted nor put
    back."""
    state.watch.moved = [watch.carried(state.machine, one) for one in moved]
    if left_out := watch.left_out(state.watch):
        aligner.leave_out(state.aligner, left_out)
        state.consistency.pairs_known = state.consistency.confirmed


def recall(state: State, known: Sequence[KnownAddress]) -> None:
    """Before the first frame: who had which address, as was logged, or kept by an earlier run."""
    state.recognition.before = list(known)


def _reset_estimators(state: State, t_ns: int) -> None:
    """Put the methods back to the beginning of the run: they have learned from wrong measurements."""
    state.estimators = {row.method: row.initial(state.machine) for row in rows_for(state.machine)}
    elapsed_s = max(0, t_ns - state.previous_run_ns) * 1e-9
    warm_start.resume(state.machine, state.estimators, state.previous_run, elapsed_s, t_ns)
    state.estimates = estimates_now(state)


def estimates_now(state: State) -> dict[str, Estimate]:
    """Method -> its estimate at this moment, and the recommended one under "recommended"."""
    now = {
        row.method: consistency.withheld(
            state.consistency, row.estimate(state.estimators[row.method], state.machine, state.latest_ns)
        )
        for row in rows_for(state.machine)
    }
    return {**now, RECOMMENDED: recommend(now, state.latest_ns, state.disagree)}


def step(state: State, frame: Frame) -> list[Publication]:
    """Take one frame: change the state in place and return the publications, in order."""
    out: list[Publication] = []
    state.segments.clear()
    state.frames += 1
    jump_ns = log_time.take_stamp(state.time, frame)
    frame = log_time.on_log_clock(state.time, frame)
    if state.time.news:
        _publish_news(state, state.time.news, out)
    if jump_ns is None:  # a stray frame: only address claims are taken from it, no measurement
        now_ns = state.latest_ns
        state.decoder.measurements(replace(frame, t_ns=now_ns, rx_ns=now_ns))
        return out
    if jump_ns < 0 or (jump_ns > 0 and state.time.misled):
        _clock_stepped(state, frame.t_ns, jump_ns, out)
    elif jump_ns >= log_time.LOG_TIME.silence_ns:
        text = f"no frame for {jump_ns * 1e-9:.1f} s"
        out.append(Publication(frame.t_ns, "/event", Event(frame.t_ns, EventKind.GAP, text)))
    lateness.take_frame(state.aligner.lateness, state.machine, frame)
    now_ns = min(frame.rx_ns, frame.t_ns)  # a frame cannot be received after the loop took it
    if state.recognition.before:
        _recall_addresses(state, frame, out)
    position_taken = False
    measurements = state.decoder.measurements(frame)
    if mistaken := state.decoder.addresses.mistaken:
        aligner.forget(state.aligner, mistaken)
        mistaken.clear()
    for measurement in measurements:
        position_taken |= _take_measurement(state, frame.t_ns, measurement, out)
    if state.decoder.addresses.unplaced:
        _recognise(state, frame.t_ns, now_ns, measurements, out)
    if state.decoder.addresses.news:
        _publish_news(state, state.decoder.addresses.news, out)
    due_ns = state.aligner.due_ns
    if due_ns and (position_taken or now_ns >= due_ns + aligner.ALIGNMENT.deadline_ns):
        for pose in poses(state.aligner, now_ns):
            _publish_pose(state, frame.t_ns, pose, out)
    return out


def _publish_news(state: State, news: list[tuple[str, str]], out: list[Publication]) -> None:
    """Report what the log's time or the addresses have told."""
    out += [Publication(state.latest_ns, "/event", Event(state.latest_ns, kind, text)) for kind, text in news]
    news.clear()


def _recall_addresses(state: State, frame: Frame, out: list[Publication]) -> None:
    """With the first frame of a bus: use what was known of it, if its devices have not been switched off."""
    sure = recognition.first_of_bus(state.recognition, state.machine, frame.bus, frame.t_ns)
    book = state.decoder.addresses
    used = [(mount, known) for known in sure if (mount := book.recall(known)) is not None]
    if used:
        where = ", ".join(f"{mount} at address {known.source}" for mount, known in used)
        ago_s = (frame.t_ns - used[0][1].last_ns) * 1e-9
        text = (
            f"{frame.bus} was silent for {ago_s:.0f} s: receivers have the addresses that they had: {where}"
        )
        out.append(Publication(frame.t_ns, "/event", Event(frame.t_ns, recognition.EVENT, text)))


def _recognise(
    state: State, t_ns: int, now_ns: int, measurements: Sequence[Measurement], out: list[Publication]
) -> None:
    """Look for receivers whose address is not known."""
    book, heard = state.decoder.addresses, state.decoder.heard
    if not heard and not state.recognition.heard:
        return
    for position in (*heard, *(m for m in measurements if isinstance(m, Position))):
        recognition.take(state.recognition, position)
    heard.clear()
    found, text = recognition.search(state.recognition, state.aligner, book.unplaced, now_ns)
    for known in found:
        book.place(known)
    if found:
        state.recognition = Recognition()
    if text:
        _publish_event(state, t_ns, recognition.EVENT, text, out)


def _doubt_addresses(state: State, t_ns: int, out: list[Publication]) -> None:
    """Receivers that were taken to be where they were before do not fit the rig: look who they are."""
    mounts = state.decoder.addresses.displace()
    if mounts:
        aligner.forget(state.aligner, mounts)
        state.recognition = recognition.restart(state.recognition)
        text = "receivers may not have the addresses that they had: they are looked for by where they are"
        _publish_event(state, t_ns, recognition.EVENT, text, out)


def _take_measurement(state: State, t_ns: int, measurement: Measurement, out: list[Publication]) -> bool:
    """Publish one measurement and give it to the aligner.

    Returns whether it was a position of a mounted receiver, which may make a pose due.
    """
    if not aligner.is_number(measurement):
        state.not_numbers += 1
        return False
    state.measurements += 1
    out.append(Publication(t_ns, TOPIC_OF[type(measurement)], measurement))
    aligner.take(state.aligner, measurement)
    if not isinstance(measurement, Position) or measurement.origin.mount is None:
        return False
    out.append(Publication(t_ns, f"/gnss/{measurement.origin.mount.value}", measurement))
    return True


def _publish_pose(state: State, t_ns: int, pose: Pose, out: list[Publication]) -> None:
    state.poses += 1
    late = state.aligner.lateness.doubts(pose.t_ns)
    if not late:
        receiver_checks.observe(state.checks, state.aligner, pose)
    stopped = standing.observe(state.standing, state.aligner, pose)
    found = [
        *receiver_checks.flags(state.checks), *consistency.flags(state.consistency),
        *standing.flags(state.standing), *state.aligner.screens.flags(),
    ]  # fmt: skip
    if found:
        pose = replace(pose, flags=tuple(sorted({*pose.flags, *found})))
    out.append(Publication(t_ns, "/pose", pose))
    _publish_drawing(state, t_ns, pose, out)
    for kind, text in flag_events(state.flags, pose.flags, state.flag_times):
        out.append(Publication(t_ns, "/event", Event(t_ns, kind, text)))
    state.flags = pose.flags
    if any(flag.kind in (FlagKind.SWAPPED, FlagKind.MOVED) for flag in pose.flags):
        _doubt_addresses(state, t_ns, out)
    if pose.tractor.x is not None and pose.tractor.y is not None:
        origin_deg = pose.origin_latitude_deg, pose.origin_longitude_deg
        state.place = (*origin_deg, pose.tractor.x, pose.tractor.y)
    for kind, text in aligner.news(state.aligner):
        _publish_event(state, t_ns, kind, text, out)
    _act_on_stopped(state, t_ns, stopped, out)
    _act_on_checks(state, t_ns, out)
    if not late:
        _watch(state, t_ns, pose, out)
    segment = record_builder.observe(state.record, state.aligner, pose)
    state.segments.append(segment)
    if not state.ready:
        return
    doubtful = _check_consistency(state, t_ns, pose, segment, out)
    if doubtful and segment is not None:
        segment = replace(segment, follows=False, reason=Code.CONTRADICTED)
    estimates = []
    for row in rows_for(state.machine):
        method_state = state.estimators[row.method]
        estimate = row.take(method_state, state.machine, pose, segment)
        if estimate is not None:
            estimates.append(estimate)
        _publish_events(state, t_ns, row, out)
    if estimates:
        _publish_estimates(state, t_ns, estimates, out)


def _check_consistency(
    state: State, t_ns: int, pose: Pose, segment: Segment | None, out: list[Publication]
) -> bool:
    """Check the data against the machine file. Returns whether they contradict it, so that nothing is
    learned."""
    moved = watch.contradictions(state.watch)
    events = consistency.observe(
        state.consistency, state.machine, state.aligner, state.checks, pose, segment, moved
    )
    for kind, text in events:
        _publish_event(state, t_ns, kind, text, out)
    if state.consistency.must_forget:
        state.consistency.must_forget = False
        _reset_estimators(state, t_ns)
    return consistency.stops_learning(state.consistency)


def _publish_drawing(state: State, t_ns: int, pose: Pose, out: list[Publication]) -> None:
    """For viewers: the frames of both bodies at this pose and, seldom (`poses_per_drawing`), their shapes."""
    frames = body_frames(state.machine, pose)
    if frames is not None:
        out.append(Publication(t_ns, "/drawing/frames", frames))
    if state.poses % FOLD.poses_per_drawing == 1:
        out.append(Publication(t_ns, "/drawing/bodies", drawing(state.machine, t_ns)))


def _act_on_checks(state: State, t_ns: int, out: list[Publication]) -> None:
    """Report the faults found in receivers; exclude smoothed turn rates, and what was learned with them."""
    events = receiver_checks.events(state.checks)
    for kind, text in events:
        _publish_event(state, t_ns, kind, text, out)
    _exclude_smoothed_turn_rates(state)
    if any(kind == receiver_checks.SMOOTHED for kind, _ in events):
        consistency.discard_findings(state.consistency, state.machine)
        _reset_estimators(state, t_ns)


def _act_on_stopped(state: State, t_ns: int, events: list[tuple[str, str]], out: list[Publication]) -> None:
    """Report sensors that stand still; without the wheel angle there are no numbers."""
    for kind, text in events:
        _publish_event(state, t_ns, kind, text, out)
    screen = state.aligner.screens.by.get(aligner.WHEEL_NAME)
    if screen is not None:
        fault = Code.WHEEL_ANGLE_STANDS if screen.failed else None
        consistency.sensor_failed(state.consistency, state.machine, fault, screen.stands)


def _watch(state: State, t_ns: int, pose: Pose, out: list[Publication]) -> None:
    """Report what has been moved; leave it out, and what was learned with it."""
    for one in (found := watch.observe(state.watch, state.aligner, pose)):
        _publish_event(state, t_ns, watch.EVENT, watch.message(one, t_ns), out)
    if found:
        aligner.leave_out(state.aligner, watch.left_out(state.watch))
        consistency.left_out(state.consistency, state.machine)
        _reset_estimators(state, t_ns)
    tyres = wheel_speed.observe(state.watch.wheel_speed, state.aligner, pose)
    if tyres is not None:  # no estimate uses the wheels' speed
        _publish_event(state, t_ns, watch.EVENT, wheel_speed.message(tyres), out)


def accept(state: State, accepted: Accepted) -> list[Publication]:
    """Use a value that the watch has found and the operator accepted; the caller has logged it.

    What was learned by then fits the value before, also that of the run before: its wheel zero and its yaw of
    pairs are far surer than the new value. Resumed, its tyres would take the error, or be given up as other
    soil. So the methods begin from the machine file's priors.
    """
    out, t_ns, machine = list[Publication](), accepted.t_ns, corrected(state.machine, [accepted])
    watch.accept(state.watch, state.machine, accepted)
    state.accepted.append(accepted)
    state.machine = machine
    before, state.decoder = state.decoder, Decoder(state.machine)
    state.decoder.load(before.dump())
    aligner.use(state.aligner, machine)
    aligner.leave_out(state.aligner, watch.left_out(state.watch))
    record_builder.clock_stepped(state.record)  # poses and wheel angles so far have the value before
    state.consistency = consistency.initial(state.machine)
    state.previous_run = {}
    _reset_estimators(state, t_ns)
    _publish_event(state, t_ns, EventKind.ACCEPTED, acceptance(machine, accepted), out)
    return out


def _exclude_smoothed_turn_rates(state: State) -> None:
    usable = receiver_checks.usable_yaw_rates(state.checks)
    for mount, track in state.aligner.tracks.items():
        track.smoothed = mount not in usable


def _publish_event(state: State, t_ns: int, kind: str, text: str, out: list[Publication]) -> None:
    """Publish an event of a check or a method, with the position of the tractor."""
    event = Event(t_ns, kind, text)
    if state.place is not None:
        latitude, longitude = to_degrees(state.place[:2], *state.place[2:])
        text = f"{text} (at {latitude:.6f}, {longitude:.6f})"
        event = Event(t_ns, kind, text, latitude, longitude)
    out.append(Publication(t_ns, "/event", event))


def _publish_events(state: State, t_ns: int, row: Estimator, out: list[Publication]) -> None:
    """Publish the events of a method since the last call."""
    for kind, text in take_events(state.estimators[row.method]):
        if (
            state.consistency.confirmed or kind != EventKind.SOIL_CHANGE
        ):  # before that, the file may be the cause
            _publish_event(state, t_ns, kind, text, out)
            if kind == EventKind.SOIL_CHANGE:
                consistency.soil_changed(state.consistency, state.machine)


def _publish_estimates(state: State, t_ns: int, estimates: list[Estimate], out: list[Publication]) -> None:
    """Publish the estimates that are due at an instant, and then, once, the recommended one."""
    for estimate in estimates:
        consistency.check_estimate(state.consistency, state.machine, estimate)
        estimate = consistency.withheld(state.consistency, estimate)
        state.estimates[estimate.method] = estimate
        out.append(Publication(t_ns, f"/soil_tire/{estimate.method}", estimate))
    if not any(estimate.method in PREFERRED for estimate in estimates):
        return  # other methods are there for comparison only and change no recommendation
    found = disagreement(state.estimates, state.disagree)
    if found and not state.disagree:
        _publish_event(state, t_ns, EventKind.DISAGREEMENT, sentence(found), out)
    state.disagree = bool(found)
    best = state.estimates[RECOMMENDED] = recommend(state.estimates, t_ns, state.disagree)
    out.append(Publication(t_ns, "/soil_tire", best))


def finish(state: State) -> None:
    """No frame follows: the windows of driving that are open now are complete, and fits may be requested."""
    for method, fitting in FITTED:
        if method in state.estimators:
            fitting.finish(state.estimators[method])


def request_fits(state: State, t_ns: int) -> list[tuple[str, Any]]:
    """(method, job) of the fits that are requested after the frame of t_ns; `ROW[method].fitting` makes
    them."""
    jobs = []
    for method, fitting in FITTED:  # at every frame: those that are not enabled have no state
        method_state = state.estimators.get(method)
        job = fitting.request_fit(method_state, t_ns) if method_state is not None else None
        if job is not None:
            jobs.append((method, job))
    return jobs


def pending(state: State) -> list[tuple[str, Any, int]]:
    """(method, job, t_ns at which its result is due) of the fits that were requested and not adopted yet."""
    return [
        (method, method_state.job, method_state.job.asked_ns + fitting.latency_ns)
        for method, fitting in FITTED
        if (method_state := state.estimators.get(method)) is not None and method_state.job is not None
    ]


def decide(state: State, outcome: FitOutcome) -> None:
    """Store the outcome of a method's pending fit, for a program that restores the state before the fit is
    used."""
    method_state = state.estimators[outcome.method]
    method_state.decided = TAKEN if outcome.adopted else AWAITED if outcome.awaited else DROPPED
    method_state.late_ns = outcome.late_ns


def adopt(state: State, t_ns: int, method: str, made: Any) -> list[Publication]:
    """Take the result of a method's pending fit; made: None if there is no result."""
    row, out = ROW[method], list[Publication]()
    if row.fitting is None:
        return out
    method_state = state.estimators[method]
    estimate = row.fitting.adopt(method_state, state.machine, made, t_ns)
    _publish_events(state, t_ns, row, out)
    _publish_estimates(state, t_ns, [estimate], out)
    return out


def _clock_stepped(state: State, t_ns: int, by_ns: int, out: list[Publication]) -> None:
    """The log's clock stepped back: stored measurements have wrong instants. What was learned of the soil
    stays. Also where the log's first stamps were wrong."""
    screens, late = state.aligner.screens, state.aligner.lateness
    state.aligner = aligner.initial(state.machine)
    state.aligner.screens, state.aligner.lateness = screens, late
    screens.clock_stepped()
    late.clock_stepped()
    aligner.leave_out(state.aligner, watch.left_out(state.watch))
    _exclude_smoothed_turn_rates(state)
    state.recognition = recognition.restart(state.recognition)
    receiver_checks.clock_stepped(state.checks)
    record_builder.clock_stepped(state.record)
    consistency.clock_stepped(state.consistency)
    state.place = None
    state.previous_run_ns += by_ns
    for row in rows_for(state.machine):
        row.clock_stepped(state.estimators[row.method], by_ns)
    if state.time.misled:  # which is reported as what it is
        return
    state.clock_steps += 1
    text = f"the clock of the log stepped back by {-by_ns * 1e-9:.1f} s; positions are aligned anew"
    out.append(Publication(t_ns, "/event", Event(t_ns, EventKind.CLOCK_STEP, text)))
