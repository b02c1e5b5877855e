"""The fold with the one exception handler around it: an error in the numerics does not stop the logging.

Live and replay both drive this, so that a replay fails where the live run failed and goes on as it did.
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from tilth.estimator import implement_load
from tilth.estimator.diagnosis import diagnosis, watch
from tilth.estimator.diagnosis.consistency import widening_by_file
from tilth.estimator.diagnosis.watch import Moved
from tilth.estimator.fold import (
    RECOMMENDED,
    State,
    accept,
    adopt,
    carry,
    carry_load,
    decide,
    estimate_at,
    finish,
    initial,
    pending,
    recall,
    request_fits,
    resume,
    save_learned,
    step,
    use,
    use_map,
    usual_frames,
)
from tilth.estimator.pose import log_time
from tilth.estimator.pose.geometry import to_degrees
from tilth.estimator.record.record import Segment
from tilth.estimator.record.windows import AWAITED, OPEN, TAKEN
from tilth.estimator.snapshot import restore, snapshot
from tilth.estimator.warm_start import SavedPosterior
from tilth.logger.fit_worker import as_text, job_sha256, of_text
from tilth.logger.fitting import LATE, UNDECIDED, Fitter, InPlace
from tilth.schemas.channels import CHANNELS, FIT_TOPIC, payload
from tilth.schemas.flow import (
    PARAMETERS,
    Accepted,
    Carried,
    Estimate,
    Event,
    EventKind,
    FitOutcome,
    Frame,
    Origin,
    ParameterEstimate,
    Pose,
    Publication,
    Status,
)
from tilth.schemas.identity import KnownAddress
from tilth.schemas.machine import Machine
from tilth.schemas.notices import reasoned
from tilth.schemas.reasons import Code, Reason, text_reason
from tilth.schemas.sentences import sentence

FIELD_MAP = "field_map"
GIVE_UP_NS = 300_000_000_000  # a fit that is so late is given up: what it learned would be stale
PAUSE_NS = 1_000_000_000  # of the frames' clock: a fault at every frame must not cost a new start at each
HearFit = Callable[[State, str, Any], None]
"""Takes the state, in which the job of the fit is pending still; its method; its result, None if there is
none."""
HearPose = Callable[[State, Pose, Segment | None], None]
"""Takes the state, a pose, and the segment of the record that it completed."""
_METHOD_OF = {  # topic -> method, of all channels that carry estimates
    channel.topic: channel.topic.removeprefix("/soil_tire").removeprefix("/") or RECOMMENDED
    for channel in CHANNELS
    if channel.topic.startswith("/soil_tire")
}


class GuardedFold:
    """`take` never raises. After a fault the estimates are published as invalid and the state starts anew."""

    def __init__(
        self,
        machine: Machine,
        state_json: str | None = None,
        fitter: Fitter | None = None,
        *,
        encoded: bool = True,
        hear_fit: HearFit | None = None,
        hear_pose: HearPose | None = None,
    ) -> None:
        """The fold before the first frame, or as `renew` wrote it. Raises NotRestorable for another's text.

        fitter: makes the fits that are asked for; None: at once, here. encoded: False where nobody reads the
        bytes of what it gives; they are empty then. hear_fit: told of each fit before it is used. hear_pose:
        told of each pose.
        """
        # For good: a sum that is split among threads is rounded otherwise, and waiting threads take a core.
        threadpool_limits(1)
        self._payload: Callable[[Publication], bytes] = payload if encoded else lambda publication: b""
        self.state: State = initial(machine) if state_json is None else restore(machine, state_json)
        self.faults = 0
        self.estimates = dict(self.state.estimates)  # method -> the last, also of a fault
        self._machine = machine
        self._fitter = fitter or InPlace(machine)
        self._hear_fit = hear_fit
        self._hear_pose = hear_pose
        self._rig = machine  # that the fitter knows
        if self.state.machine is not machine:
            self._use_rig()
        self._decided: list[tuple[FitOutcome, object]] = []  # outcomes to be used at the next frame
        for method, job, due_ns in pending(self.state):
            decided = self.state.estimators[method].decided
            if decided in (OPEN, AWAITED, TAKEN):
                self._fitter.ask(method, job)
            if decided not in (OPEN, AWAITED):  # between its outcome and the next frame
                taken = decided == TAKEN
                made = self._fitter.made(method, job) if taken else None
                made = made and of_text(method, as_text(made))
                self._decided.append((FitOutcome(due_ns, method, job.asked_ns, taken), made))
        self._due_ns = self._first_due_ns()
        self._resume_ns = 0
        self._counted = Counter[str]()  # of states given up
        self._rejected = Counter[str]()

    @property
    def place_deg(self) -> tuple[float | None, float | None]:
        """Latitude and longitude of the tractor's centre of gravity at the last pose that had a position."""
        place = self.state.place
        return (None, None) if place is None else to_degrees(place[:2], *place[2:])

    def estimate_at(self, x: float, y: float) -> Estimate:
        """As `fold.estimate_at`, of the state that there is now."""
        return estimate_at(self.state, x, y)

    @property
    def ready(self) -> bool:
        """Whether the estimators run with the next frame. The caller logs a change before making it."""
        return self.state.ready

    @ready.setter
    def ready(self, ready: bool) -> None:
        self.state.ready = ready

    @property
    def accepted(self) -> list[Accepted]:
        """Values that the operator has accepted, in place of those of the machine file."""
        return list(self.state.accepted)

    @property
    def empty(self) -> Machine:
        """The rig, accepted values and all, without what its implement carries."""
        return self.state.empty

    @property
    def full_load(self) -> float:
        """kg that its implement carries when it is full; 0 where it carries nothing."""
        load = self.state.empty.implement.load
        return 0.0 if load is None else load.mass.value

    def carried(self, t_ns: int) -> Carried | None:
        """What its implement carries, as sure as that is at a time; None where it carries nothing."""
        return implement_load.carried_now(self.state, t_ns)

    @property
    def moved(self) -> list[tuple[list[str], str]]:
        """(names by which it may be accepted, what and by how much) of what has been found moved."""
        return [(list(one.of), sentence(one.reason)) for one in watch.found_now(self.state.diagnosis.watch)]

    def proposal(self, what: str, t_ns: int) -> Accepted | None:
        """The value that may be accepted by that name now; None if there is none."""
        return watch.proposal(self.state.diagnosis.watch, self.state.machine, what, t_ns)

    def accept(self, accepted: Accepted) -> list[tuple[Publication, bytes]]:
        """Use a value that the operator has accepted, which the caller has logged."""
        try:
            publications = accept(self.state, accepted)
        except Exception as error:  # the same edge as in `take`
            publications = self._start_anew(accepted.t_ns, error)
        return self._with_another_rig(publications)

    def carry_load(self, carried: Carried) -> list[tuple[Publication, bytes]]:
        """Use what the operator has said of the implement's load, which the caller has logged."""
        try:
            publications = carry_load(self.state, carried)
        except Exception as error:  # the same edge as in `take`
            publications = self._start_anew(carried.t_ns, error)
        return self._with_another_rig(publications)

    def _use_rig(self) -> None:
        self._rig = self.state.machine
        self._fitter.use(self._rig)

    def _with_another_rig(self, publications: list[Publication]) -> list[tuple[Publication, bytes]]:
        self._use_rig()
        self._decided.clear()
        self._due_ns = self._first_due_ns()
        self.estimates = dict(self.state.estimates)
        return [(publication, self._payload(publication)) for publication in publications]

    @property
    def measurements(self) -> int:
        """Count since the start."""
        return self._counted["measurements"] + self.state.measurements

    @property
    def poses(self) -> int:
        """Count since the start."""
        return self._counted["poses"] + self.state.poses

    @property
    def rejected(self) -> dict[str, int]:
        """Reason -> count, of what was not used."""
        return dict(self._rejected + Counter(self.state.rejected))

    @property
    def unknown(self) -> dict[Origin, int]:
        """Senders of the messages counted as "unknown_source", with their counts since the last fault."""
        return self.state.decoder.unknown

    def recall(self, known: Sequence[KnownAddress]) -> None:
        """Before the first frame: who had which address, as far as known from before."""
        recall(self.state, known)

    @property
    def known_addresses(self) -> list[KnownAddress]:
        """Who has which address now, with the time at which its bus was heard last."""
        book, bus_ns = self.state.decoder.addresses, self.state.time.bus_ns
        now = [replace(known, last_ns=bus_ns.get(known.bus, 0)) for known in book.known()]
        held = {(known.bus, known.source) for known in now}
        return now + [k for k in self.state.recognition.before if (k.bus, k.source) not in held]

    def take_all(self, frames: Sequence[Frame]) -> list[tuple[Publication, bytes]]:
        """As `take` of one after the other; the stamps of those that come as usual in one go."""
        out: list[tuple[Publication, bytes]] = []
        k = 0
        while k < len(frames):
            if self._decided or frames[k].t_ns < self._resume_ns:
                out += self.take(frames[k])
                k += 1
            else:
                k = self._take_usual(frames, k, out)
        return out

    def _take_usual(self, frames: Sequence[Frame], first: int, out: list[tuple[Publication, bytes]]) -> int:
        """Take frames from the first on up to a pose, or to one that does not come as usual; the index of the
        one after it."""
        state, poses, rig = self.state, self.state.poses, self.state.machine
        for k, stamped in usual_frames(state, frames, first, self._due_ns):
            if not stamped:
                state.frames += k - first
                out += self.take(frames[k])
                return k + 1
            out += self._taken(frames[k], use)
            if self.state is not state or state.poses != poses or state.machine is not rig:
                state.frames += k + 1 - first
                return k + 1
        state.frames += len(frames) - first
        return len(frames)

    def take(self, frame: Frame) -> list[tuple[Publication, bytes]]:
        """The publications that a frame causes, each with its bytes as logged and published."""
        resume_ns = self._resume_ns
        if frame.t_ns < resume_ns and frame.t_ns >= resume_ns - PAUSE_NS:  # not of a clock that stepped back
            return []
        return self._taken(frame, step)

    def _taken(
        self, frame: Frame, take: Callable[[State, Frame], list[Publication]]
    ) -> list[tuple[Publication, bytes]]:
        try:
            publications = []
            if self._decided and log_time.continues(self.state.time, frame):
                publications = self._adopt(log_time.on_log_clock(self.state.time, frame).t_ns)
            poses = self.state.poses
            publications += take(self.state, frame)
            if self.state.machine is not self._rig:  # a scale has told of another load
                self._use_rig()
                self._decided.clear()
                self._due_ns = self._first_due_ns()
            if self.state.poses != poses:
                self._tell_poses(publications)
                self._ask(frame.t_ns)
            if self._due_ns is not None:
                publications += self.decided(self.state.latest_ns)
            if not publications:  # of most frames
                return []
            encoded = [(publication, self._payload(publication)) for publication in publications]
        except Exception as error:  # the one edge where the fold's errors are caught
            publications = self._start_anew(frame.t_ns, error)
            encoded = [(publication, self._payload(publication)) for publication in publications]
        for publication in publications:
            if isinstance(publication.value, Estimate):
                self.estimates[publication.value.method] = publication.value
        return encoded

    def _tell_poses(self, publications: Sequence[Publication]) -> None:
        """publications: of the last frame."""
        if self._hear_pose is not None:
            poses = [one.value for one in publications if isinstance(one.value, Pose)]
            for pose, segment in zip(poses, self.state.segments, strict=True):
                self._hear_pose(self.state, pose, segment)

    def decided(self, t_ns: int) -> list[Publication]:
        """What becomes of the fits that are due: logged now, used at the next frame. One that is not ready
        is awaited from frame to frame; meanwhile no other of its method is asked for."""
        out: list[Publication] = []
        if self._due_ns is None or t_ns < self._due_ns:
            return out
        for method, job, due_ns in pending(self.state):
            waits = any((o.method, o.asked_ns) == (method, job.asked_ns) for o, _ in self._decided)
            if t_ns < due_ns or waits:
                continue
            awaited = self.state.estimators[method].decided == AWAITED
            late_ns = t_ns - due_ns if awaited else 0
            made = self._fitter.outcome(method, job, t_ns, awaited)
            if made is LATE and late_ns > GIVE_UP_NS:
                made = None
            if made is UNDECIDED or (made is LATE and awaited):
                continue
            late = made is LATE
            outcome = FitOutcome(t_ns, method, job.asked_ns, not (late or made is None), late, late_ns)
            if outcome.adopted:
                outcome, made = self._with_result(outcome, job, made)
            if not late:
                self._decided.append((outcome, made))
            decide(self.state, outcome)
            out.append(Publication(t_ns, FIT_TOPIC, outcome))
        return out

    def finish(self) -> list[tuple[Publication, bytes]]:
        """No frame follows. What the driving up to the end of a log gives: fits of it are made and used now.

        Their outcomes come before they would be due, by which a replay knows that the log has ended there. A
        second call gives nothing.
        """
        t_ns = self.state.latest_ns
        try:
            publications = self._adopt(t_ns) + self._fit_now(t_ns)
            finish(self.state)
            publications += self._fit_now(t_ns)
        except Exception as error:  # the same edge as in `take`
            publications = self._start_anew(t_ns, error)
        for publication in publications:
            if isinstance(publication.value, Estimate):
                self.estimates[publication.value.method] = publication.value
        return [(publication, self._payload(publication)) for publication in publications]

    def _fit_now(self, t_ns: int) -> list[Publication]:
        """Make and use all fits that wait, without the time that they are given while driving."""
        out: list[Publication] = []
        self._ask(t_ns)
        while waiting := pending(self.state):
            for method, job, _ in waiting:
                made = self._fitter.made(method, job)
                outcome = FitOutcome(t_ns, method, job.asked_ns, made is not None)
                if outcome.adopted:
                    outcome, made = self._with_result(outcome, job, made)
                out += [Publication(t_ns, FIT_TOPIC, outcome), *self._use(t_ns, method, made)]
            self._ask(t_ns)
        return out

    def _with_result(self, outcome: FitOutcome, job: Any, made: Any) -> tuple[FitOutcome, Any]:
        """The outcome as it is logged, and the result as it is read from there: live is replay by
        construction."""
        text = as_text(made)
        logged = replace(outcome, result=text, job_sha256=job_sha256(self.state.machine, job))
        return logged, of_text(outcome.method, text)

    def _ask(self, t_ns: int) -> None:
        for method, job in request_fits(self.state, t_ns):
            self._fitter.ask(method, job)
        self._due_ns = self._first_due_ns()

    def _first_due_ns(self) -> int | None:
        return min((due_ns for _, _, due_ns in pending(self.state)), default=None)

    def _adopt(self, t_ns: int) -> list[Publication]:
        decided, self._decided = self._decided, []
        out: list[Publication] = []
        for outcome, made in decided:
            waiting = {method: job for method, job, _ in pending(self.state)}
            if outcome.method in waiting and waiting[outcome.method].asked_ns == outcome.asked_ns:
                out += self._use(t_ns, outcome.method, made)
        self._due_ns = self._first_due_ns()
        return out

    def _use(self, t_ns: int, method: str, made: Any) -> list[Publication]:
        """Use the result of a method's pending fit; made: None if there is none."""
        if self._hear_fit is not None:
            self._hear_fit(self.state, method, made)
        return adopt(self.state, t_ns, method, made)

    def keep(self, t_ns: int) -> dict[str, SavedPosterior]:
        """Method -> what it has learned, for the next run."""
        return save_learned(self.state, t_ns)

    @property
    def unsettled(self) -> list[Moved]:
        """What has been found moved and neither accepted nor put back, for the next run."""
        return list(self.state.diagnosis.watch.moved)

    @property
    def confirmed(self) -> bool:
        """Whether the data have confirmed the machine file."""
        return self.state.diagnosis.confirmed

    @property
    def by_file(self) -> dict[str, NDArray[np.float64]]:
        """Method -> covariance of the six logarithms, (6, 6), that errors which may still be in the machine
        file add to its own; without methods of which that is not known yet."""
        known = self.state.diagnosis.consistency
        widenings = {method: widening_by_file(known, method) for method in self.state.estimators}
        return {method: one.covariance for method, one in widenings.items() if one is not None}

    @property
    def contradicted(self) -> list[str]:
        """What the data contradict of the machine file now, in sentences."""
        return [sentence(one.reason) for one in diagnosis.contradictions(self.state.diagnosis)]

    def warm(
        self,
        learned: Mapping[str, SavedPosterior],
        elapsed_s: float,
        t_ns: int,
        accepted: Sequence[Accepted] = (),
        moved: Sequence[Moved] = (),
        field_map: tuple[SavedPosterior, float] | None = None,
        carried: Carried | None = None,
    ) -> dict[str, Reason | None]:
        """Before the first frame: start from what was learned elapsed_s ago. Method -> why not, or None.

        accepted: by the operator in earlier runs. moved: found by them, and not accepted. field_map: what a
        season has told of a field, and the seconds since; FIELD_MAP in what is returned. carried: by the
        implement then, as sure as it was then."""
        try:
            if accepted or carried:
                carried = implement_load.later(self._machine, carried, elapsed_s, t_ns)
                ready, self.state = self.state.ready, initial(self._machine, accepted, carried)
                self.state.ready = ready
                self._use_rig()
            refusals = resume(self.state, learned, elapsed_s, t_ns)
            if field_map is not None:
                refusals[FIELD_MAP] = use_map(self.state, *field_map, t_ns)
            carry(self.state, moved)
        except Exception as error:  # the same edge: a run begins, whatever the file holds
            self.state = self._initial()
            return dict.fromkeys(learned, text_reason(f"{type(error).__name__}: {error}"))
        self.renew()
        self.estimates = dict(self.state.estimates)
        return {method: Reason(code) if code else None for method, code in refusals.items()}

    def renew(self) -> str:
        """The state as text; the fold goes on from just that text, so that live is replay by construction."""
        self._resume_ns = 0
        try:
            text = snapshot(self.state)
            self.state = restore(self._machine, text)
            self._rig = self.state.machine  # the same, made anew
        except Exception:  # the same edge: beginning a log file must not end the run; `faults` is shown
            self._give_up()
            text = snapshot(self.state)
        return text

    def _give_up(self) -> None:
        self.faults += 1
        self._counted.update(measurements=self.state.measurements, poses=self.state.poses)
        self._rejected.update(self.state.rejected)
        self.state = self._initial()
        self._decided.clear()
        self._due_ns = None

    def _initial(self) -> State:
        state = initial(self._machine, self.state.accepted, self.state.carried)
        state.ready = self.state.ready
        carry(state, self.state.diagnosis.watch.moved)
        recall(state, self.known_addresses)  # nobody claims anew because of a fault here
        return state

    def _start_anew(self, t_ns: int, error: Exception) -> list[Publication]:
        self._give_up()
        self._resume_ns = t_ns + PAUSE_NS
        failed = Reason(Code.ESTIMATORS_FAILED, (type(error).__name__, str(error)))
        none = tuple(ParameterEstimate(None, None, Status.INVALID, failed) for _ in PARAMETERS)
        publications = [Publication(t_ns, "/event", Event(t_ns, EventKind.FAULT, reasoned(failed)))]
        for topic, method in _METHOD_OF.items():
            if method in self.estimates:
                publications.append(Publication(t_ns, topic, Estimate(t_ns, method, "", none, (), ())))
        return publications
