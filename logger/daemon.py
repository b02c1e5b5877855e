"""The live driver: buses in, log and Zenoh out, the fold between.

    read frames ─► log each raw ─► fold ─► log what it gives ─► publish it

One loop, one clock. Frames are recorded from the first second; estimates follow when what they call has been
compiled. Every failure is published, displayed and logged as an event; frames are recorded until the end.
"""

import contextlib
import gc
from collections import deque
from collections.abc import Callable
from pathlib import Path

from tilth.estimator.fold import RECOMMENDED
from tilth.logger.address_memory import AddressMemory
from tilth.logger.can.bus_opening import open_port
from tilth.logger.can.buses import Buses
from tilth.logger.can.port_threads import Opener
from tilth.logger.clock import Clock
from tilth.logger.display import Display, NoDisplay
from tilth.logger.fold_orders import of_accepting, of_loads
from tilth.logger.hitched import Hitched, Rigs
from tilth.logger.keeping import Keeping
from tilth.logger.live_estimation import LiveEstimation
from tilth.logger.log.mcap_log import ClockReason
from tilth.logger.log.run_log import Recording
from tilth.logger.mark_log import MarkLog
from tilth.logger.outlets import Events, Outlets
from tilth.logger.run_parts import RunParts, build_status, summary_of
from tilth.logger.run_report import RunReport
from tilth.logger.run_summary import LoopCounts, RunSummary
from tilth.logger.status_line import plain_line
from tilth.logger.supervisor import Supervisor
from tilth.logger.update_news import UpdateNews, installed
from tilth.logger.zenoh import place_ahead
from tilth.logger.zenoh.liveness import Sensors
from tilth.logger.zenoh.place_ahead import PlaceAhead
from tilth.logger.zenoh.sink import SIMULATED_SUFFIX, ZenohSink
from tilth.schemas.channels import CHANNEL, READY_TOPIC
from tilth.schemas.flow import AddressClaim, Event, EventKind, Frame, Measurement, Ready, UtcTime
from tilth.schemas.machine_toml import MachineFile
from tilth.schemas.notices import Notice, NoticeCode, in_words, notice
from tilth.schemas.plausible import unusual
from tilth.schemas.proto import tilth_pb2 as pb

TURN_S = 0.1  # longest wait for a frame: a stop is noticed in that time
SECOND_NS = 1_000_000_000
SHOW_NS = 500_000_000


class Daemon:
    """One run. `turn` it until it is time to `close`."""

    def __init__(
        self,
        machine_file: MachineFile,
        folder: Path,
        suffix: str | None,
        display: Display,
        *,
        rigs: Rigs | None = None,
        keep: bool = False,
        fresh: bool = False,
        note: str = "",
        simulated: str = "",
        supervisor: Supervisor | None = None,
        opener: Opener = open_port,
        events: Events | None = None,
    ) -> None:
        """rigs: of a tractor with several implements, machine_file's among them. suffix: of the Zenoh
        prefix, None to publish nothing. keep: go on from what earlier runs in that folder learned, unless
        `fresh`, and keep it for later ones. note, simulated: for the log, as of RunPart. supervisor: is
        notified that the loop lives. opener: opens a bus. events: (kind, notice) that is put in here is
        logged, published and shown like what the daemon notices itself.

        Raises MachineError for a wheel-angle sensor or a bus interface that cannot work.
        """
        self._events: Events = deque() if events is None else events
        machine = machine_file.machine
        self._events.extend((EventKind.MACHINE_FILE, in_words(text)) for text in unusual(machine))
        supervisor = Supervisor({}) if supervisor is None else supervisor
        estimation = LiveEstimation(machine, self._report)
        fold = estimation.fold
        clock = Clock()
        counts = LoopCounts(started_ns=clock.t_ns())
        buses = Buses(machine.bus, clock, self._report, opener)
        self._keeping = Keeping(folder, machine, fold, clock, self._report) if keep else None
        self._addresses = AddressMemory(folder, machine_file, fold, clock, self._report) if keep else None
        warmed = False
        if self._keeping is not None and not fresh:
            warmed = self._keeping.take_up(counts.started_ns)
        if self._addresses is not None:
            warmed |= self._addresses.take_up()
        recording = Recording(
            folder, machine_file, clock, self._report, fold.renew,
            addresses=lambda: fold.known_addresses, with_state=warmed, note=note, simulated=simulated,
        )  # fmt: skip
        outlets = Outlets(recording, display, self._events, clock)
        self._news = UpdateNews(installed() if keep else None, folder, self._report, recording)
        run_report = RunReport(outlets, clock, self._report, machine.log.keep_free_megabytes * 1e6)
        self.parts = RunParts(
            clock, supervisor, estimation, buses, outlets, MarkLog(fold, clock, outlets),
            of_accepting(fold, clock, outlets), of_loads(fold, clock, outlets), Hitched(rigs, machine_file,
            folder, clock, outlets), run_report, Sensors(machine), counts,
        )  # fmt: skip
        if not fold.ready:
            self._log_ready(estimation.preparing.text)
        if suffix is not None:
            answers = {**self.parts.answers, place_ahead.KEY: PlaceAhead(fold.estimate_at).take}
            outlets.open_zenoh(lambda: ZenohSink(machine, suffix, answers=answers))
        self._status = pb.Status()  # the last
        self._next_second_ns = counts.started_ns
        self._next_show_ns = counts.started_ns

    @property
    def uptime_s(self) -> float:
        """Since the start of the run, s."""
        return (self.parts.clock.t_ns() - self.parts.counts.started_ns) * 1e-9

    def turn(self, timeout_s: float = TURN_S) -> int:
        """Wait for frames and take them, then do what is due. Returns the number of frames."""
        parts = self.parts
        if parts.estimation.can_begin():
            parts.estimation.begin()
            self._log_ready("")
        frames = parts.buses.read(timeout_s)
        began_ns = parts.clock.t_ns()
        for frame in frames:
            self.take(frame)
        parts.counts.took(frames)
        t_ns = parts.clock.t_ns()
        if t_ns >= self._next_second_ns:
            self._second(t_ns)
        parts.outlets.recording.tick(t_ns)
        if t_ns >= self._next_show_ns:
            self._next_show_ns = t_ns + SHOW_NS
            parts.outlets.show(self._status, parts.estimation.fold.estimates[RECOMMENDED])
        parts.outlets.put_events()
        parts.marks.turn()
        parts.accepts.turn()
        parts.loads.turn()
        parts.hitched.turn()
        parts.run_report.turn()
        ended_ns = parts.clock.t_ns()
        parts.counts.turned(ended_ns - began_ns)
        parts.supervisor.turned(ended_ns)
        return len(frames)

    @property
    def following(self) -> MachineFile | None:
        """The rig of the run that is to begin now, where another implement has been hitched on."""
        hitched = self.parts.hitched
        return hitched.rigs[hitched.following] if hitched.following else None

    def close(self) -> RunSummary:
        """Take what the buses have still got, finish the log, end the session."""
        parts = self.parts
        if self.following is None:
            parts.supervisor.stopping()
        deadline_ns = parts.clock.t_ns() + SECOND_NS
        # Each of these, whatever happens to the others; the lowest first.
        with contextlib.ExitStack() as last:
            if self.following is None:
                last.callback(parts.supervisor.close)
            last.callback(parts.outlets.close)
            last.callback(parts.outlets.put_events)
            last.callback(parts.marks.turn)
            last.callback(parts.accepts.turn)
            last.callback(parts.loads.turn)
            last.callback(parts.hitched.turn)
            last.callback(parts.outlets.recording.close)
            last.callback(parts.run_report.close)
            last.callback(parts.estimation.worker.close)
            last.callback(parts.estimation.preparing.close)
            last.callback(parts.outlets.put_events)
            last.callback(parts.buses.close)
            while self.turn(0.0) and parts.clock.t_ns() < deadline_ns:
                continue
            self._second(parts.clock.t_ns())
            if self._keeping is not None:
                self._keeping.keep(parts.clock.t_ns(), parts.outlets.recording)
        return summary_of(parts, self._status)

    def take(self, frame: Frame) -> None:
        """Raw first: whatever happens after, the frame is in the log."""
        parts = self.parts
        parts.outlets.recording.frame(frame)
        for publication, data in parts.estimation.fold.take(frame):
            parts.outlets.put(publication.topic, publication.t_ns, data)
            value = publication.value
            if isinstance(value, Measurement):
                parts.sensors.take(value)
                if isinstance(value, AddressClaim):
                    parts.hitched.heard(value.origin.name)
                if isinstance(value, UtcTime):
                    parts.clock.add_gnss_time(value.rx_ns, value.utc_ns)
            elif isinstance(value, Event):
                parts.outlets.show_event(value)

    def _second(self, t_ns: int) -> None:
        """What is due once a second."""
        self._next_second_ns = t_ns + SECOND_NS
        parts = self.parts
        self._watch_clock()
        self._news.turn()
        parts.estimation.start_worker()
        if self._keeping is not None and self._keeping.is_due(t_ns):
            self._keeping.keep(t_ns, parts.outlets.recording)
        if self._addresses is not None:
            self._addresses.turn(t_ns, parts.outlets.recording)
        self._status = build_status(parts, t_ns)
        parts.outlets.put("/status", t_ns, CHANNEL["/status"].encode(self._status))
        parts.supervisor.status(plain_line(self._status, parts.estimation.fold.estimates[RECOMMENDED]))

    def _log_ready(self, text: str) -> None:
        """Whether the estimators run with what follows; text: what they wait for."""
        ready = Ready(self.parts.clock.t_ns(), self.parts.estimation.fold.ready, text)
        self.parts.outlets.recording.message(READY_TOPIC, ready.t_ns, CHANNEL[READY_TOPIC].encode(ready))

    def _watch_clock(self) -> None:
        clock = self.parts.clock
        step_ns = clock.step_ns(clock.relation())
        if step_ns:
            self.parts.counts.clock_steps += 1
            self._report(EventKind.CLOCK, notice(NoticeCode.CLOCK_SET, by_s=step_ns * 1e-9))
            self.parts.outlets.recording.clocks(ClockReason.STEP)

    def _report(self, kind: str, told: Notice) -> None:
        self._events.append((kind, told))


def run_daemon(
    machine_file: MachineFile,
    *,
    rigs: Rigs | None = None,
    log_folder: Path | None = None,
    zenoh: bool = True,
    simulated: str = "",
    seconds: float | None = None,
    status: Display | None = None,
    stop: Callable[[], bool] = lambda: False,
    keep: bool = False,
    fresh: bool = False,
    note: str = "",
    supervisor: Supervisor | None = None,
    events: Events | None = None,
) -> RunSummary:
    """Run until `stop()` or for so many seconds; the log file is whole in any case. With another implement a
    run ends and one begins.

    log_folder: instead of the machine file's. zenoh: whether to publish. simulated: the command that drives
    instead of a tractor, for the log; what is published is under the replay prefix then. status: where to
    show, if anywhere. rigs, keep, fresh, note, supervisor, events: as of Daemon. Raises MachineError,
    as Daemon does.
    """
    folder = Path(machine_file.machine.log.folder) if log_folder is None else log_folder
    suffix = (SIMULATED_SUFFIX if simulated else "") if zenoh else None
    display = status or NoDisplay()
    summary: RunSummary | None = None
    following: MachineFile | None = machine_file
    while following is not None:
        daemon = Daemon(
            following, folder, suffix, display, rigs=rigs,
            keep=keep, fresh=fresh, note=note, simulated=simulated, supervisor=supervisor, events=events,
        )  # fmt: skip
        # What exists by now stays: the collector need not look at it again and again.
        gc.collect()
        gc.freeze()
        before_s = 0.0 if summary is None else summary.seconds
        try:
            while (
                daemon.following is None
                and not stop()
                and (seconds is None or before_s + daemon.uptime_s < seconds)
            ):
                daemon.turn()
            following = daemon.following  # what is asked for while it closes is for the next start
        finally:  # also of an error nobody foresaw: the log is whole
            ended = daemon.close()
            summary = ended if summary is None else ended.after(summary)
        fresh, events = False, None
    assert summary is not None
    return summary
