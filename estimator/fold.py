"""The fold: one frame in, publications out. Live operation and replay are two short loops around `step`.

Nothing here may depend on whether it runs live: the result is a function of the machine file and of the
frames in their order.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

from tilth.estimator import implement_load, ties, warm_start
from tilth.estimator.diagnosis import diagnosis, strange_implement
from tilth.estimator.diagnosis.accepted import acceptance, corrected
from tilth.estimator.diagnosis.diagnosis import RigDiagnosis
from tilth.estimator.diagnosis.directive import Directive
from tilth.estimator.diagnosis.watch import Moved
from tilth.estimator.diagnosis.widening import OfSoil, widened
from tilth.estimator.fits import decide as decide
from tilth.estimator.fits import finish as finish
from tilth.estimator.fits import pending as pending
from tilth.estimator.fits import request_fits as request_fits
from tilth.estimator.methods import open_tracker, pem, place, tracker
from tilth.estimator.methods.estimators import ROW, Estimator, rows_for
from tilth.estimator.models.load import laden, of_nobody
from tilth.estimator.pose import aligner, lateness, log_time, recognition
from tilth.estimator.pose.body_frames import body_frames, drawing
from tilth.estimator.pose.geometry import to_degrees
from tilth.estimator.pose.pose import poses
from tilth.estimator.pose.recognition import Recognition
from tilth.estimator.pose.usual_frames import usual
from tilth.estimator.record import record_builder
from tilth.estimator.results.flag_events import flag_events
from tilth.estimator.results.method_state import SixState, take_events
from tilth.estimator.results.recommend import OFFERED, beside_better, disagreement, recommend
from tilth.estimator.results.recommend import RECOMMENDED as RECOMMENDED
from tilth.estimator.state import State as State
from tilth.estimator.state import WaitingPose
from tilth.estimator.tuning import tuned
from tilth.estimator.warm_start import SavedPosterior
from tilth.schemas.channels import TIE_TOPIC, TOPIC_OF
from tilth.schemas.decode import Decoder
from tilth.schemas.flow import (
    Accepted,
    Carried,
    Estimate,
    Event,
    EventKind,
    FlagKind,
    Frame,
    Measurement,
    Pose,
    Position,
    Publication,
    Weight,
)
from tilth.schemas.identity import KnownAddress
from tilth.schemas.machine import Machine
from tilth.schemas.notices import Notice, NoticeCode, notice, reasoned
from tilth.schemas.reasons import Code


@dataclass(frozen=True, slots=True)
class FoldTuning:
    """What the fold publishes of itself."""

    poses_per_drawing: int = tuned(
        20, "poses", "between two drawings, 4 s: viewers that come late soon have them"
    )
    poses_per_place: int = tuned(5, "poses", "between two looks at the map of the field, 1 s")
    poses_waiting: int = tuned(450, "poses", "of driving, 90 s, that are kept until the estimators are ready")
    poses_at_once: int = tuned(30, "poses", "taken with each new one then: within 3 s they have caught up")


FOLD: Final = FoldTuning()


def initial(machine: Machine, accepted: Sequence[Accepted] = (), carried: Carried | None = None) -> State:
    """The state before the first frame. accepted: values in place of those of the machine file. carried: by
    the implement, as far as somebody has said it."""
    empty = file = corrected(machine, accepted)
    carried = carried or of_nobody(empty, 0)
    machine = laden(empty, carried)
    estimators = {row.method: row.initial(machine) for row in rows_for(machine)}
    state = State(
        machine, empty, file, Decoder(machine), aligner.initial(machine), record_builder.initial(machine),
        open_tracker.initial(machine), estimators,
    )  # fmt: skip
    state.accepted, state.carried = list(accepted), carried
    state.estimates = estimates_now(state)
    return state


def save_learned(state: State, t_ns: int) -> dict[str, SavedPosterior]:
    """Method -> what it has learned by t_ns, for the next run; empty while the machine file is not
    confirmed."""
    if not state.diagnosis.confirmed or not state.machine.implement.described:  # another one may follow
        return {}
    return warm_start.save_learned(state.machine, state.estimators, t_ns)


def resume(
    state: State, previous_run: Mapping[str, SavedPosterior], elapsed_s: float, t_ns: int
) -> dict[str, Code | None]:
    """Start from what was saved elapsed_s before t_ns; call it before the first frame.

    Returns method -> why its saved posterior is not used, None where it is used.
    """
    refusals = warm_start.resume(state.machine, state.estimators, previous_run, elapsed_s, t_ns)
    state.time.latest_ns = t_ns
    used = {method for method, refusal in refusals.items() if refusal is None}
    state.previous_run = {method: before for method, before in previous_run.items() if method in used}
    implement_load.resumed(state, elapsed_s)
    diagnosis.resumed(state.diagnosis, bool(state.previous_run))
    state.previous_run_ns = t_ns - round(elapsed_s * 1e9)
    return refusals


def use_map(state: State, saved: SavedPosterior, elapsed_s: float, t_ns: int) -> Code | None:
    """Before the first frame, after `resume`: what a season has told of a field, saved elapsed_s before t_ns.
    Returns why it is not used, None where it is."""
    fresh = {row.method: row.initial(state.machine) for row in rows_for(state.machine)}
    refused = warm_start.resume(state.machine, fresh, {place.METHOD: saved}, elapsed_s, t_ns)[place.METHOD]
    if refused is None:
        place.add(state.estimators[place.METHOD], fresh[place.METHOD])
        state.time.latest_ns = t_ns
    return refused


def carry(state: State, moved: Sequence[Moved]) -> None:
    """Before the first frame, after `resume`: what has been found moved before, and neither accepted nor put
    back."""
    _apply(state, diagnosis.carry(state.diagnosis, state.machine, moved), state.latest_ns, [])


def recall(state: State, known: Sequence[KnownAddress]) -> None:
    """Before the first frame: who had which address, as was logged, or kept by an earlier run."""
    state.recognition.before = list(known)


def _apply(state: State, directive: Directive, t_ns: int, out: list[Publication]) -> None:
    """Do what the diagnosis says: the one place where it acts on receivers and methods."""
    for kind, text in directive.events:
        _publish_event(state, t_ns, kind, text, out)
    if directive.exclude is not None:
        aligner.leave_out(state.aligner, directive.exclude)
    if directive.lagging is not None:
        aligner.leave_out_turn_rates(state.aligner, directive.lagging)
    if directive.reset_open:
        state.open = open_tracker.initial(state.machine)
    if directive.reset:  # to the beginning of the run
        state.estimators = {row.method: row.initial(state.machine) for row in rows_for(state.machine)}
        elapsed_s = max(0, t_ns - state.previous_run_ns) * 1e-9
        warm_start.resume(state.machine, state.estimators, state.previous_run, elapsed_s, t_ns)
        implement_load.resumed(state, elapsed_s)
        state.estimates = estimates_now(state)


def estimates_now(state: State) -> dict[str, Estimate]:
    """Method -> its estimate at this moment, and the recommended one under "recommended"."""
    now = {
        row.method: diagnosis.withheld(
            state.diagnosis,
            _now(state, row.estimate(state.estimators[row.method], state.machine, state.latest_ns)),
        )
        for row in rows_for(state.machine)
    }
    shown = _shown(now)
    return {**shown, RECOMMENDED: _recommended(state, shown, state.latest_ns)}


def _shown(estimates: Mapping[str, Estimate]) -> dict[str, Estimate]:
    """As they may be published, and recommended, beside each other."""
    return {method: beside_better(estimate, estimates) for method, estimate in estimates.items()}


def _now(state: State, made: Estimate) -> Estimate:
    return implement_load.known_now(state, state.latest_ns, made)


def _recommended(state: State, estimates: Mapping[str, Estimate], t_ns: int) -> Estimate:
    """The recommended one, as wide as soil may be otherwise here than where its method has learned."""
    best = recommend(estimates, t_ns, state.disagree)
    if best.rule is not None and best.rule.code is Code.IN_PATCHES:
        return best
    return widened(OfSoil(place.elsewhere(state.estimators[place.METHOD])), best)


def estimate_at(state: State, x: float, y: float) -> Estimate:
    """What the memory by place says of where the rig is not, as it may be published. Changes nothing; any
    thread. x, y: north and east of the tractor's rear axle, m, in the plane of the poses; the bodies in line
    as they head now."""
    memory = state.estimators[place.METHOD]
    axles = place.axles_ahead(memory, state.machine, x, y)
    made = place.estimate_at(memory, state.machine, state.latest_ns, axles, list(memory.has_number))
    return diagnosis.withheld(state.diagnosis, _now(state, made))


def usual_frames(
    state: State, frames: Sequence[Frame], first: int, before_ns: int | None
) -> Iterator[tuple[int, bool]]:
    """As `step`, of frames that come as usual, up to the next pose: gives (index, True) of each that `use` is
    to take next, and (index, False) of the one that `step` is to take, which ends it. before_ns: a t_ns that
    does so."""
    book, due_ns = state.decoder.addresses, state.aligner.due_ns
    if state.recognition.before or (book.unplaced and state.recognition.heard):
        return iter([(first, False)])
    deadline_ns = due_ns + aligner.ALIGNMENT.deadline_ns if due_ns else None
    late, routes = state.aligner.lateness, state.decoder.routes
    return usual(state.time, frames, first, late, routes, before_ns, deadline_ns)


def step(state: State, frame: Frame) -> list[Publication]:
    """Take one frame: change the state in place and return the publications, in order."""
    out: list[Publication] = []
    state.segments.clear()
    state.frames += 1
    time = state.time
    jump_ns = log_time.take_stamp(time, frame)
    if time.offset_ns:
        frame = log_time.on_log_clock(time, frame)
    if time.news:
        _publish_news(state, time.news, out)
    if jump_ns is None:  # a stray frame: only address claims are taken from it, no measurement
        now_ns = state.latest_ns
        state.decoder.measurements(replace(frame, t_ns=now_ns, rx_ns=now_ns))
        return out
    if jump_ns < 0 or (jump_ns > 0 and time.misled):
        _clock_stepped(state, frame.t_ns, jump_ns, out)
    elif jump_ns >= log_time.LOG_TIME.silence_ns:
        silence = notice(NoticeCode.SILENCE, silence_s=jump_ns * 1e-9)
        out.append(Publication(frame.t_ns, "/event", Event(frame.t_ns, EventKind.GAP, silence)))
    lateness.take_frame(state.aligner.lateness, state.machine, frame)
    return [*out, *use(state, frame)] if out else use(state, frame)


def use(state: State, frame: Frame) -> list[Publication]:
    """What `step` does with a frame when its stamp was taken."""
    out: list[Publication] = []
    state.segments.clear()
    book = state.decoder.addresses
    now_ns = frame.rx_ns if frame.rx_ns < frame.t_ns else frame.t_ns  # not received after the loop took it
    if state.recognition.before:
        _recall_addresses(state, frame, out)
    position_taken = False
    measurements = state.decoder.measurements(frame)
    if mistaken := book.mistaken:
        aligner.forget(state.aligner, mistaken)
        mistaken.clear()
    for measurement in measurements:
        position_taken |= _take_measurement(state, frame.t_ns, measurement, out)
    if book.unplaced:
        _recognise(state, frame.t_ns, now_ns, measurements, out)
    if book.news:
        _publish_news(state, book.news, out)
    due_ns = state.aligner.due_ns
    if due_ns and (position_taken or now_ns >= due_ns + aligner.ALIGNMENT.deadline_ns):
        ties.begin(frame.t_ns)
        for pose in poses(state.aligner, now_ns):
            _publish_pose(state, frame.t_ns, pose, out)
        _publish_ties(frame.t_ns, out)
    return out


def _publish_news(state: State, news: list[tuple[str, Notice]], out: list[Publication]) -> None:
    """Report what the log's time or the addresses have told."""
    out += [Publication(state.latest_ns, "/event", Event(state.latest_ns, kind, told)) for kind, told in news]
    news.clear()


def _recall_addresses(state: State, frame: Frame, out: list[Publication]) -> None:
    """With the first frame of a bus: use what was known of it, if its devices have not been switched off."""
    sure = recognition.first_of_bus(state.recognition, state.machine, frame.bus, frame.t_ns)
    book = state.decoder.addresses
    used = [(mount, known) for known in sure if (mount := book.recall(known)) is not None]
    if used:
        places = (recognition.receiver_at(replace(known, mount=mount)) for mount, known in used)
        silence_s = (frame.t_ns - used[0][1].last_ns) * 1e-9
        kept = notice(NoticeCode.ADDRESSES_KEPT, *places, bus=frame.bus, silence_s=silence_s)
        out.append(Publication(frame.t_ns, "/event", Event(frame.t_ns, recognition.EVENT, kept)))


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
    found, told = recognition.search(state.recognition, state.aligner, book.unplaced, now_ns)
    for known in found:
        book.place(known)
    if found:
        state.recognition = Recognition()
    if told is not None:
        _publish_event(state, t_ns, recognition.EVENT, told, out)


def _doubt_addresses(state: State, t_ns: int, out: list[Publication]) -> None:
    """Receivers that were taken to be where they were before do not fit the rig: look who they are."""
    mounts = state.decoder.addresses.displace()
    if mounts:
        aligner.forget(state.aligner, mounts)
        state.recognition = recognition.restart(state.recognition)
        _publish_event(state, t_ns, recognition.EVENT, notice(NoticeCode.ADDRESSES_DOUBTED), out)


def _take_measurement(state: State, t_ns: int, measurement: Measurement, out: list[Publication]) -> bool:
    """Publish one measurement and give it to the aligner.

    Returns whether it was a position of a mounted receiver, which may make a pose due.
    """
    if not aligner.is_number(measurement):
        state.not_numbers += 1
        return False
    state.measurements += 1
    out.append(Publication(t_ns, TOPIC_OF[type(measurement)], measurement))
    if isinstance(measurement, Weight):
        if (weighed := implement_load.weigh(state, t_ns, measurement)) is not None:
            out += carry_load(state, weighed)
        return False
    aligner.take(state.aligner, measurement)
    if not isinstance(measurement, Position) or measurement.origin.mount is None:
        return False
    out.append(Publication(t_ns, f"/gnss/{measurement.origin.mount.value}", measurement))
    return True


def _publish_pose(state: State, t_ns: int, pose: Pose, out: list[Publication]) -> None:
    state.poses += 1
    of_sensors = diagnosis.look_at_sensors(state.diagnosis, state.aligner, pose)
    found = [*diagnosis.flags(state.diagnosis), *state.aligner.screens.flags()]
    if found:
        pose = replace(pose, flags=tuple(sorted({*pose.flags, *found})))
    out.append(Publication(t_ns, "/pose", pose))
    _publish_drawing(state, t_ns, pose, out)
    for kind, told in flag_events(state.flags, pose.flags, state.flag_times):
        out.append(Publication(t_ns, "/event", Event(t_ns, kind, told)))
    state.flags = pose.flags
    if any(flag.kind in (FlagKind.SWAPPED, FlagKind.MOVED) for flag in pose.flags):
        _doubt_addresses(state, t_ns, out)
    if pose.tractor.x is not None and pose.tractor.y is not None:
        origin_deg = pose.origin_latitude_deg, pose.origin_longitude_deg
        state.place = (*origin_deg, pose.tractor.x, pose.tractor.y)
    for kind, told in aligner.news(state.aligner):
        _publish_event(state, t_ns, kind, told, out)
    _apply(state, of_sensors, t_ns, out)
    of_places = diagnosis.look_at_places(state.diagnosis, state.aligner, pose, t_ns)
    _apply(state, of_places, t_ns, out)
    if of_sensors.reset or of_places.reset:
        state.waiting.clear()
    segment = record_builder.observe(state.record, state.aligner, pose)
    state.segments.append(segment)
    if not _lengths_known(state, t_ns, pose, out):
        return
    state.waiting.append(WaitingPose(pose, segment, diagnosis.is_judged(state.aligner, pose)))
    if not state.ready:
        del state.waiting[: -FOLD.poses_waiting]
        return
    for _ in range(min(len(state.waiting), FOLD.poses_at_once)):
        if state.waiting:  # else one of them began anew
            _estimate(state, t_ns, state.waiting.pop(0), out)


def _estimate(state: State, t_ns: int, driven: WaitingPose, out: list[Publication]) -> None:
    """Give one pose to the estimators. What they estimate is published as soon as none is waiting."""
    pose, segment, evidence = driven.pose, driven.segment, None
    if driven.judged:
        believing = state.estimators[tracker.METHOD]
        evidence = open_tracker.observe(state.open, state.machine, segment, believing)
    of_file = diagnosis.look_at_file(state.diagnosis, state.aligner, pose, evidence)
    _apply(state, of_file, t_ns, out)
    if of_file.withhold and segment is not None:
        segment = replace(segment, follows=False, reason=Code.CONTRADICTED)
    implement_load.walk(state, t_ns, pose)
    estimates = []
    if state.machine.estimation.field_map is not None:
        memory, ours = state.estimators[place.METHOD], state.estimators[tracker.METHOD]
        look = ours.map_mean is None or state.poses % FOLD.poses_per_place == 0
        earlier = place.by_earlier_runs(memory, pose.t_ns) if look else None
        if earlier is not None:
            tracker.expect(ours, earlier, memory.map_ns)
    for row in rows_for(state.machine):
        method_state = state.estimators[row.method]
        estimate = row.take(method_state, state.machine, pose, segment)
        if estimate is not None:
            estimates.append(estimate)
        _publish_events(state, t_ns, row, out)
    if estimates and not state.waiting:
        _publish_estimates(state, t_ns, estimates, out)


def _publish_ties(t_ns: int, out: list[Publication]) -> None:
    """What another kind of processor may have decided otherwise since `ties.begin`."""
    out += (Publication(t_ns, TIE_TOPIC, tie) for tie in ties.found())


def _publish_drawing(state: State, t_ns: int, pose: Pose, out: list[Publication]) -> None:
    """For viewers: the frames of both bodies at this pose and, each `poses_per_drawing`-th, their shapes."""
    frames = body_frames(state.machine, pose)
    if frames is not None:
        out.append(Publication(t_ns, "/drawing/frames", frames))
    if state.poses % FOLD.poses_per_drawing == 1:
        out.append(Publication(t_ns, "/drawing/bodies", drawing(state.machine, t_ns)))


def accept(state: State, accepted: Accepted) -> list[Publication]:
    """Use a value that the watch has found and the operator accepted; the caller has logged it.

    What was learned by then fits the value before, also that of the run before: its wheel zero and its yaw of
    pairs are far surer than the new value. Resumed, its tyres would take the error, or be given up as other
    soil. So the methods begin from the machine file's priors.
    """
    out, t_ns = list[Publication](), accepted.t_ns
    file = corrected(state.file, [accepted])
    directive = diagnosis.accept(state.diagnosis, state.machine, accepted)
    state.accepted.append(accepted)
    state.file = file
    _use_file(state, strange_implement.with_found(file, state.strange.used))
    _apply(state, directive, t_ns, out)
    _publish_event(state, t_ns, EventKind.ACCEPTED, acceptance(state.machine, accepted), out)
    return out


def _use_file(state: State, empty: Machine) -> None:
    """Go on with a machine file that has other values. The caller begins what is learned anew."""
    state.empty = empty
    state.machine = laden(empty, state.carried)
    before, state.decoder = state.decoder, Decoder(state.machine)
    state.decoder.load(before.dump())
    aligner.use(state.aligner, state.machine)
    _record_anew(state)  # poses and wheel angles so far have the values before
    state.previous_run = {}


def _lengths_known(state: State, t_ns: int, pose: Pose, out: list[Publication]) -> bool:
    """Whether estimators may take a pose: of an implement that nobody has described, driving tells where it
    stands behind the tractor first."""
    if state.machine.implement.described:
        return True
    found = strange_implement.observe(state.strange, state.file, state.aligner, pose)
    if found is not None:
        _use_file(state, strange_implement.with_found(state.file, found))
        state.diagnosis = RigDiagnosis()
        _apply(state, Directive(reset=True, reset_open=True), t_ns, out)
        _publish_event(state, t_ns, EventKind.IMPLEMENT, strange_implement.told(state.file, found), out)
    return state.strange.used is not None and found is None


def carry_load(state: State, carried: Carried) -> list[Publication]:
    """Use what somebody has said of the implement's load; an operator's word the caller has logged."""
    out = list[Publication]()
    implement_load.use(state, carried)
    _other_load(state, carried.t_ns, out)
    _publish_event(state, carried.t_ns, EventKind.LOAD, implement_load.told(carried), out)
    return out


def _other_load(state: State, t_ns: int, out: list[Publication]) -> None:
    """The rig is another one: poses and wheel angles so far are of the CG before."""
    aligner.use(state.aligner, state.machine)
    _record_anew(state)
    state.previous_run = {}  # which was with the load before
    if state.diagnosis.confirmed:
        _apply(state, diagnosis.soil_changed(state.diagnosis), t_ns, out)
    else:
        state.open = open_tracker.initial(state.machine)
    state.estimates = estimates_now(state)


def _publish_event(state: State, t_ns: int, kind: str, told: Notice, out: list[Publication]) -> None:
    """Publish an event of a check or a method, with the position of the tractor."""
    at = (None, None) if state.place is None else to_degrees(state.place[:2], *state.place[2:])
    out.append(Publication(t_ns, "/event", Event(t_ns, kind, told, *at)))


def _publish_events(
    state: State, t_ns: int, row: Estimator, out: list[Publication], foreseen: bool | None = None
) -> None:
    """Publish the events of a method since the last call. foreseen: whether the memory by place knew of a
    change of soil that a fit has found; None: ask it."""
    for kind, told in take_events(state.estimators[row.method]):
        if kind == EventKind.LOAD:
            implement_load.changed(state, t_ns)
            _other_load(state, t_ns, out)
        if kind != EventKind.SOIL_CHANGE:
            _publish_event(state, t_ns, kind, told, out)
        elif state.diagnosis.confirmed:  # before that, the file may be the cause
            if foreseen is None:
                foreseen = _expected(state, row)
            if not foreseen:
                _publish_event(state, t_ns, kind, told, out)
            _apply(state, diagnosis.soil_changed(state.diagnosis), t_ns, out)


def _expected(state: State, row: Estimator) -> bool:
    """Whether the soil that a method finds here is as the memory by place knows it."""
    found = state.estimators[row.method]
    return isinstance(found, SixState) and place.expects(state.estimators[place.METHOD], found.mean)


def _publish_estimates(state: State, t_ns: int, estimates: list[Estimate], out: list[Publication]) -> None:
    """Publish the estimates that are due at an instant, and then, once, the recommended one."""
    for estimate in estimates:
        estimate = diagnosis.checked(state.diagnosis, state.machine, _now(state, estimate))
        state.estimates[estimate.method] = estimate
        shown = beside_better(estimate, state.estimates)
        out.append(Publication(t_ns, f"/soil_tire/{estimate.method}", shown))
    if not any(estimate.method in OFFERED for estimate in estimates):
        return  # other methods are there for comparison only and change no recommendation
    found = disagreement(state.estimates, state.disagree)
    if found and not state.disagree:
        _publish_event(state, t_ns, EventKind.DISAGREEMENT, reasoned(found), out)
    state.disagree = bool(found)
    best = state.estimates[RECOMMENDED] = _recommended(state, _shown(state.estimates), t_ns)
    out.append(Publication(t_ns, "/soil_tire", best))


def adopt(state: State, t_ns: int, method: str, made: Any) -> list[Publication]:
    """Take the result of a method's pending fit; made: None if there is no result."""
    row, out = ROW[method], list[Publication]()
    if row.fitting is None:
        return out
    ties.begin(t_ns)
    method_state = state.estimators[method]
    job, known = method_state.job, state.estimators[place.METHOD].windows
    foreseen, learners = False, []
    if made is not None and job is not None:
        learners = [other for other in rows_for(state.machine) if other.learn is not None]
        for other in learners:
            assert other.learn is not None
            foreseen |= other.learn(state.estimators[other.method], job, made)
        of_file = row.fitting.of_file(made)
        if of_file is not None:
            diagnosis.fit_tells(state.diagnosis, method, *of_file)
    learns = isinstance(made, pem.Fit) and made.refused is None and job is not None
    estimate = row.fitting.adopt(method_state, state.machine, made, t_ns)
    if job is not None and implement_load.fitted_after_stop(state, method, job.closed_ns, known):
        estimate = row.estimate(method_state, state.machine, t_ns)
    if learns:
        diagnosis.windows_tell(state.diagnosis, open_tracker.of_windows(state.machine, method_state))
    machine, by_load = state.machine, any(kind == EventKind.LOAD for kind, _ in method_state.events)
    for other in learners:
        events = state.estimators[other.method].events
        events[:] = [] if by_load else implement_load.in_doubt(state, events)
        _publish_events(state, t_ns, other, out, foreseen=False)
    _publish_events(state, t_ns, row, out, foreseen)
    if state.machine is not machine:
        estimate = row.estimate(state.estimators[row.method], state.machine, t_ns)
    _publish_estimates(state, t_ns, [estimate], out)
    _publish_ties(t_ns, out)
    return out


def _record_anew(state: State) -> None:
    """What follows does not go on from what was driven so far."""
    record_builder.clock_stepped(state.record)
    state.waiting.clear()


def _clock_stepped(state: State, t_ns: int, by_ns: int, out: list[Publication]) -> None:
    """The log's clock stepped back: stored measurements have wrong instants. What was learned of the soil
    stays. Also where the log's first stamps were wrong."""
    screens, late = state.aligner.screens, state.aligner.lateness
    state.aligner = aligner.initial(state.machine)
    state.aligner.screens, state.aligner.lateness = screens, late
    screens.clock_stepped()
    late.clock_stepped()
    _apply(state, diagnosis.clock_stepped(state.diagnosis), t_ns, out)
    state.recognition = recognition.restart(state.recognition)
    _record_anew(state)
    open_tracker.clock_stepped(state.open)
    state.place = None
    state.previous_run_ns += by_ns
    state.drove_ns += by_ns if state.drove_ns else 0
    state.stood_ns += by_ns if state.stood_ns else 0
    for row in rows_for(state.machine):
        row.clock_stepped(state.estimators[row.method], by_ns)
    if state.time.misled:  # which is reported as what it is
        return
    state.clock_steps += 1
    back = notice(NoticeCode.STEPPED_BACK, by_s=-by_ns * 1e-9)
    out.append(Publication(t_ns, "/event", Event(t_ns, EventKind.CLOCK_STEP, back)))
