"""The offline driver: frames from logs, the same guarded fold as live, results to where they are wanted.

records of a log ─► fold ─► OUT.mcap, Zenoh, comparison with what was logged live
"""

import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tilth.estimator import ties
from tilth.estimator.methods.estimators import ROW
from tilth.estimator.pose import log_time, receiver_checks
from tilth.estimator.pose.log_time import LogTime
from tilth.estimator.pose.usual_frames import usual
from tilth.estimator.snapshot import NotRestorable, restore_decoder
from tilth.logger.fitting import ReplayedFits
from tilth.logger.guarded_fold import GuardedFold, HearFit, HearPose
from tilth.logger.log.mcap_log import LogWriter
from tilth.replay.compare import COMPARED, Comparison
from tilth.replay.readers.any_log import metadata, open_log, place
from tilth.replay.readers.log import EmptyLog, Gap, Logged, OpenLog, RunPlace
from tilth.replay.readers.rig import Say, on_buses_of
from tilth.schemas.channels import (
    ACCEPTED_TOPIC,
    ADDRESSES_TOPIC,
    FIT_TOPIC,
    LOAD_TOPIC,
    READY_TOPIC,
    TIE_TOPIC,
    decode_addresses,
    decode_carried,
    decode_outcome,
    decode_tie,
    payload,
)
from tilth.schemas.flow import Accepted, Estimate, Event, EventKind, Frame, Origin, Pose, Publication, Tie
from tilth.schemas.machine_toml import MachineFile
from tilth.schemas.notices import NoticeCode, notice
from tilth.schemas.proto import tilth_pb2 as pb
from tilth.schemas.proto.tilth_pb2 import Ready, Snapshot
from tilth.schemas.sentences import event_sentence, notice_sentence

LONGEST_WAIT_S = 5.0  # a longer gap in a log is not waited for
INPUTS = frozenset({FIT_TOPIC, READY_TOPIC, ACCEPTED_TOPIC, LOAD_TOPIC, ADDRESSES_TOPIC})
"""What enters the fold besides frames and stored states."""
WITH_RESULTS = COMPARED | INPUTS
BLOCK = 256  # frames that are taken at once
PROGRESS_FRAMES = 4096  # frames between two looks of the progress bar
REPORTED_KINDS = frozenset(
    {EventKind.FAULT, EventKind.CLOCK_STEP, EventKind.OTHER_CLOCK, *receiver_checks.KINDS}
)  # kinds of events that are printed in a replay


@dataclass(slots=True)
class Flagged:
    """Poses that carried a flag."""

    poses: int
    first_ns: int
    last_ns: int


@dataclass(slots=True)
class ReplaySummary:
    """What a replay did."""

    frames: int = 0
    measurements: int = 0
    poses: int = 0
    rejected: dict[str, int] = field(default_factory=dict)  # reason -> count, of the readers and of the fold
    duration_ns: int = 0  # that passed in the logs: gaps between them and steps of their clocks left out,
    # and of logs that others wrote also silences, which nobody can tell from a clock that was set ahead
    truncated: bool = False
    faults: int = 0  # of the fold
    estimates: dict[str, Estimate] = field(default_factory=dict)  # method -> the last
    events: list[Event] = field(default_factory=list)
    flags: dict[str, Flagged] = field(default_factory=dict)
    unknown: dict[Origin, int] = field(default_factory=dict)  # of rejected["unknown_source"]
    left_out: list[str] = field(default_factory=list)  # of rejected["other_time"]: whose frames, in words
    confirmed: bool = False  # whether the data confirm the machine file, at the end
    by_file: dict[str, NDArray[np.float64]] = field(default_factory=dict)  # as of GuardedFold, at the end
    contradicted: list[str] = field(default_factory=list)  # what of it they contradict then, in sentences
    moved: list[str] = field(default_factory=list)  # what has moved and was neither accepted nor put back


@dataclass(frozen=True, slots=True)
class ReplayOutputs:
    """Where frames and results go besides the summary; None: nowhere."""

    writer: LogWriter | None = None
    publish: Callable[[str, bytes], None] | None = None  # topic, payload
    comparison: Comparison | None = None
    pace: Callable[[int], None] | None = None  # waits for a time of the log, ns
    progress: Callable[[int], None] | None = None  # takes the number of bytes read so far
    fit: HearFit | None = None  # told of each fit before it is used
    pose: HearPose | None = None  # told of each pose


class Pace:
    """Waits so that frames pass `rate` times as fast as they were recorded."""

    def __init__(
        self,
        rate: float,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._rate = rate
        self._clock = clock
        self._sleep = sleep
        self._last_ns = 0
        self._zero_ns = 0
        self._zero_s: float | None = None  # on the clock, of _zero_ns in the log

    def __call__(self, t_ns: int) -> None:
        step_ns = t_ns - self._last_ns
        self._last_ns = t_ns
        now = self._clock()
        if self._zero_s is None or not 0 <= step_ns <= LONGEST_WAIT_S * 1e9:
            self._zero_ns, self._zero_s = t_ns, now
        wait = self._zero_s + (t_ns - self._zero_ns) * 1e-9 / self._rate - now
        if wait > 0:
            self._sleep(wait)


def replay(
    paths: Sequence[Path],
    machine_file: MachineFile,
    *,
    buses: Mapping[str, str] | None = None,
    outputs: ReplayOutputs | None = None,
    say: Say = lambda text: None,
) -> ReplaySummary:
    """Feed logs, in the order given, through the fold.

    Parts of a run go on from one another, and so do logs that others wrote, which tell of no run. A log of
    another run, or out of order, begins with a new fold: its counts are added up, the estimates are those of
    the last run. A state stored in a log is taken up where the log was recorded with this machine file, as
    the daemon did when it wrote it: a file of a run replays alone, and several give what the run gave.
    `buses` maps names of the logs to names of the machine file. `say` takes sentences for the user.
    Raises LogError; EmptyLog only if no log has a frame. OSError where a file cannot be read or written.
    """
    run = _Run(machine_file, outputs or ReplayOutputs(), say)
    empty: EmptyLog | None = None
    for path in paths:
        try:
            run.log(path, buses or {})
        except EmptyLog as error:
            empty = error
            if len(paths) > 1:
                say(str(error))
    run.finish()
    run.close_counts()
    if not run.summary.frames and not run.summary.truncated:
        raise empty or EmptyLog(f"{paths[0]}: no frame is in it")
    return run.summary


class _Run:
    """The fold and what has come of it so far."""

    def __init__(self, machine_file: MachineFile, outputs: ReplayOutputs, say: Say) -> None:
        self.summary = ReplaySummary()
        self._machine = machine = machine_file.machine
        self._sha256 = machine_file.sha256
        self._outputs = outputs
        self._say = say
        self._read_bytes = 0
        self._reported_other_machine = False
        self._waited = 0  # frames for which the estimators were not ready
        self._place: RunPlace | None = None  # of the last log
        self._anew = False  # the next record is not of the run that the fold knows
        self._counts: Counter[tuple[str, str]] = Counter()
        self._unknown: Counter[tuple[str, int]] = Counter()  # by bus and source
        self._left_out: list[str] = []  # of the folds before
        self._origins: dict[tuple[str, int], Origin] = {}  # as they were last known
        self.fitter = ReplayedFits(machine, lambda kind, told: say(notice_sentence(told)))
        out = self._outputs
        self._encoded = bool(out.writer or out.publish or out.comparison)
        self._ties = ties.use()
        self._fold = self._new_fold()
        self._before = _counts(self._fold)
        self._unknown_before = self._unknown_now()

    def _new_fold(self, state_json: str | None = None) -> GuardedFold:
        return GuardedFold(
            self._machine, state_json, self.fitter,
            encoded=self._encoded, hear_fit=self._outputs.fit, hear_pose=self._outputs.pose,
        )  # fmt: skip

    def log(self, path: Path, buses: Mapping[str, str]) -> None:
        comparison = self._outputs.comparison
        log = open_log(path, WITH_RESULTS if comparison else INPUTS)
        try:
            by = metadata(log).get("tilth", {})
            self.fitter.recorded_by(by, verified=comparison is not None)
            verified_elsewhere = False
            if comparison is not None:
                verified_elsewhere = comparison.recorded_by(by)
            self._ties = ties.use(_ties(path) if verified_elsewhere else ())
            self._follow(log)
            self._records(log, buses)
        finally:
            log.file.close()
            self._read_bytes += log.size
        self._ended(log)

    def _follow(self, log: OpenLog) -> None:
        """See whether a log goes on where the one before it ended, and say so where it does not."""
        last, self._place = self._place, place(log)
        self.fitter.holds_outcomes = self._place.run != ("", "")
        if last is None:
            return
        self._anew |= not self._place.goes_on_from(last)
        gap = self._place.gap_after(last)
        if gap:
            self._say(f"{log.path}: {gap}")

    def _records(self, log: OpenLog, buses: Mapping[str, str]) -> None:
        summary, progress = self.summary, self._outputs.progress
        at_once = self._outputs.writer is None and self._outputs.pace is None
        time, before_ns, told = LogTime(), summary.duration_ns, summary.frames
        frames: list[Frame] = []
        for record in on_buses_of(self._machine, log, buses, self._say):
            if self._anew and not isinstance(record, Gap):
                self._start_anew(record.t_ns)
            if isinstance(record, Frame):
                frames.append(record)
                if at_once and len(frames) < BLOCK:
                    continue
            self._frames(frames, time, before_ns)
            frames.clear()
            if not isinstance(record, Frame):
                self._logged(log, record, buses)
            if progress is not None and summary.frames - told >= PROGRESS_FRAMES:
                told = summary.frames
                progress(self._read_bytes + log.position())
        self._frames(frames, time, before_ns)

    def _frames(self, frames: Sequence[Frame], time: LogTime, before_ns: int) -> None:
        """Take frames between which nothing else enters the fold: one alone where each is waited for, or
        written before its results. time: of this log. before_ns: how long those before it lasted."""
        writer, pace, k = self._outputs.writer, self._outputs.pace, 0
        while k < len(frames):
            k = next((index for index, _ in usual(time, frames, k)), len(frames))
            if k < len(frames):
                log_time.take_stamp(time, frames[k])
                k += 1
        silent_ns = time.silent_ns if self.fitter.holds_outcomes else 0  # a clock of tilth's is never set
        self.summary.duration_ns = before_ns + time.passed_ns + silent_ns
        self.summary.frames += len(frames)
        self._waited += 0 if self._fold.state.ready else len(frames)
        for frame in frames if pace or writer else ():
            if pace is not None:
                pace(time.latest_ns)
            if writer is not None:
                writer.frame(frame)
        self._put(self._fold.take_all(frames))

    def _logged(self, log: OpenLog, record: Snapshot | Gap | Logged, buses: Mapping[str, str]) -> None:
        """What else stands in a log than frames."""
        comparison = self._outputs.comparison
        if isinstance(record, Snapshot):
            self._snapshot(log, record)
        elif isinstance(record, Gap):
            self._gap(log, record)
        elif record.topic == READY_TOPIC:
            self._ready(log, record)
        elif record.topic == ACCEPTED_TOPIC:
            self._accept(record)
        elif record.topic == LOAD_TOPIC:
            self._load(record)
        elif record.topic == ADDRESSES_TOPIC:
            self._recall(record, buses)
        else:
            if comparison is not None:
                comparison.logged(record)
            if record.topic == FIT_TOPIC:
                self._fit(record)

    def _gap(self, log: OpenLog, gap: Gap) -> None:
        """Messages are missing: what the fold was live from here on, the next stored state tells."""
        event = Publication(
            gap.t_ns,
            "/event",
            Event(
                gap.t_ns,
                EventKind.GAP,
                notice(NoticeCode.MESSAGES_MISSING, file=log.path.name, why=gap.text),
            ),
        )
        if self._outputs.comparison is not None:
            self._outputs.comparison.lose_track()
        self._put([(event, payload(event))])
        self._fold.ready = True  # that they became so may be what is missing

    def _fit(self, record: Logged) -> None:
        """Take the logged outcome of a fit: the fit is used at the next frame, as it was live."""
        outcome = decode_outcome(record.data)
        fitting = ROW[outcome.method].fitting if outcome.method in ROW else None
        if fitting is not None and outcome.t_ns < outcome.asked_ns + fitting.latency_ns:
            self.finish()  # as the program did that wrote the log
            return
        self.fitter.add_outcome(outcome)
        self._put([(p, payload(p)) for p in self._fold.decided(outcome.t_ns)])

    def finish(self) -> None:
        """The last log has ended: what the driving up to there gives."""
        self._put(self._fold.finish())

    def _ready(self, log: OpenLog, record: Logged) -> None:
        """From here on the estimators take part, or do not, as they did live."""
        ready = Ready.FromString(record.data)
        if ready.ready and not self._fold.ready and self._waited:
            self._say(
                f"{log.path}: {self._waited} frames came before the estimators were ready; estimates follow "
                "after them, as they did live"
            )
        self._waited = 0
        self._fold.ready = ready.ready
        if self._outputs.writer is not None:
            self._outputs.writer.message(READY_TOPIC, record.t_ns, record.data)

    def _recall(self, record: Logged, buses: Mapping[str, str]) -> None:
        """Take who has which address from the head of a file, where no earlier part has told it."""
        if self._outputs.writer is not None:
            self._outputs.writer.message(ADDRESSES_TOPIC, record.t_ns, record.data)
        if not self._fold.state.frames:
            known = decode_addresses(record.data, self._sha256)
            self._fold.recall([replace(one, bus=buses.get(one.bus, one.bus)) for one in known])

    def _accept(self, record: Logged) -> None:
        """Use a value that the operator accepted, as the daemon did."""
        said = pb.Accepted.FromString(record.data)
        if self._outputs.writer is not None:
            self._outputs.writer.message(ACCEPTED_TOPIC, record.t_ns, record.data)
        accepted = Accepted(said.t_ns, said.what, tuple(said.amounts), tuple(said.sds))
        self._put(self._fold.accept(accepted))

    def _load(self, record: Logged) -> None:
        """Use what the operator said of the implement's load, as the daemon did."""
        if self._outputs.writer is not None:
            self._outputs.writer.message(LOAD_TOPIC, record.t_ns, record.data)
        self._put(self._fold.carry_load(decode_carried(record.data)))

    def _put(self, publications: list[tuple[Publication, bytes]]) -> None:
        writer, publish = self._outputs.writer, self._outputs.publish
        comparison = self._outputs.comparison
        for publication, data in publications:
            topic, value = publication.topic, publication.value
            if isinstance(value, Pose):
                self._flag(value)
            elif isinstance(value, Event):
                self.summary.events.append(value)
                if value.kind in REPORTED_KINDS:
                    self._say(event_sentence(value))
            if writer is not None:
                writer.message(topic, publication.t_ns, data)
            if publish is not None:
                publish(topic, data)
            if comparison is not None:
                comparison.recomputed(topic, publication.t_ns, data)

    def _flag(self, pose: Pose) -> None:
        for flag in pose.flags:
            flagged = self.summary.flags.setdefault(str(flag), Flagged(0, pose.t_ns, pose.t_ns))
            flagged.poses += 1
            flagged.last_ns = pose.t_ns

    def _start_anew(self, t_ns: int) -> None:
        self._anew = False
        self._left_out += map(notice_sentence, log_time.stray_senders(self._fold.state.time))
        self.fitter.forget()
        fold = self._new_fold()
        self._go_on_with(fold, t_ns, fold.renew())

    def _snapshot(self, log: OpenLog, stored: Snapshot) -> None:
        """Go on from a stored state, as the daemon did that stored it."""
        if stored.machine_sha256 != self._sha256:
            if not self._reported_other_machine:
                self._refuse(log, stored, "it is of another machine file")
            self._reported_other_machine = True
            return
        try:
            fold = self._new_fold(stored.state_json)
        except NotRestorable as why_not:
            self._refuse(log, stored, str(why_not))
            self._take_addresses(stored)
            return
        self._go_on_with(fold, stored.t_ns, stored.state_json)
        if self._outputs.comparison is not None:
            self._outputs.comparison.find_track()

    def _refuse(self, log: OpenLog, stored: Snapshot, reason: str) -> None:
        """Go on without a stored state, and say so: to the person here, and among the events."""
        self._say(notice_sentence(notice(NoticeCode.STORED_STATE_REFUSED, file=str(log.path), why=reason)))
        refused = notice(NoticeCode.STORED_STATE_REFUSED, file=log.path.name, why=reason)
        event = Publication(stored.t_ns, "/event", Event(stored.t_ns, EventKind.STORED_STATE, refused))
        self._put([(event, payload(event))])

    def _take_addresses(self, stored: Snapshot) -> None:
        """Take the addresses from a refused state, where no earlier part gave them.

        Receivers claim them only when they start: without them a later part of a run would give no pose.
        """
        if self._fold.state.frames:
            return
        try:
            decoder = restore_decoder(self._machine, stored.state_json)
        except NotRestorable:
            return
        fold = self._new_fold()
        fold.state.decoder, fold.ready = decoder, self._fold.ready
        fold.state.recognition = self._fold.state.recognition
        self._go_on_with(fold, stored.t_ns, fold.renew())

    def _go_on_with(self, fold: GuardedFold, t_ns: int, state_json: str) -> None:
        self.close_counts()
        self._fold = fold
        if self._outputs.writer is not None:
            self._outputs.writer.snapshot(t_ns, state_json)
        self._before = _counts(fold)
        self._unknown_before = self._unknown_now()

    def close_counts(self) -> None:
        """Add to the summary what the fold has counted since it was started or its state taken from a log."""
        self.summary.estimates = dict(self._fold.estimates)
        now = _counts(self._fold)
        self._counts.update(now)
        self._counts.subtract(self._before)
        self._before = now
        self._unknown.update(self._unknown_now())
        self._unknown.subtract(self._unknown_before)
        self._unknown_before = self._unknown_now()
        self.summary.unknown = {self._origins[key]: n for key, n in self._unknown.most_common() if n > 0}
        strays = log_time.stray_senders(self._fold.state.time)
        self.summary.left_out = [*self._left_out, *map(notice_sentence, strays)]
        self.summary.measurements = self._counts["measurements", ""]
        self.summary.poses = self._counts["poses", ""]
        for (kind, reason), count in self._counts.items():
            if kind == "rejected" and count > 0:
                self.summary.rejected[reason] = count
        self.summary.confirmed = self._fold.confirmed
        self.summary.by_file = self._fold.by_file
        self.summary.contradicted = self._fold.contradicted
        self.summary.moved = [text for _, text in self._fold.moved]
        self.summary.faults += self._fold.faults
        self._fold.faults = 0

    def _unknown_now(self) -> Counter[tuple[str, int]]:
        unknown = self._fold.unknown
        self._origins |= {(origin.bus, origin.source): origin for origin in unknown}
        return Counter({(origin.bus, origin.source): number for origin, number in unknown.items()})

    def _ended(self, log: OpenLog) -> None:
        for reason, count in log.skipped.items():
            self._counts["rejected", reason] += count
        if self._outputs.comparison is not None:
            self._outputs.comparison.finish(log.truncated)
            self._outputs.comparison.ties = self.fitter.ties
            self._outputs.comparison.turned += self._ties.turned
        if not self._fold.ready:
            self._say(f"{log.path}: it ends before the estimators were ready; nothing is estimated, as live")
        self.summary.truncated = self.summary.truncated or log.truncated
        for text in log.lacks():
            self._say(f"{log.path}: {text}")


def _ties(path: Path) -> list[Tie]:
    """The decisions that were logged as ties."""
    log = open_log(path, {TIE_TOPIC})
    with log.file:
        return [decode_tie(record.data) for record in log.records if isinstance(record, Logged)]


def _counts(fold: GuardedFold) -> Counter[tuple[str, str]]:
    rejected = {("rejected", reason): count for reason, count in fold.rejected.items()}
    return Counter({("measurements", ""): fold.measurements, ("poses", ""): fold.poses, **rejected})
