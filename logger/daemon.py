"""The live driver: buses in, log and Zenoh out, the fold between.

    read frames ─► log each raw ─► fold ─► log what it gives ─► publish it

One loop, one clock. Frames are recorded from the first second; estimates follow when what they call has been
compiled. Whatever fails is said, shown and logged as an event; frames are recorded until the end.
"""

import contextlib
import gc
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from zenoh import ZError

from tilth.estimator.fold import RECOMMENDED
from tilth.logger import warm_start_file
from tilth.logger.can.bus_opening import open_port
from tilth.logger.can.buses import Buses
from tilth.logger.can.port_threads import Opener
from tilth.logger.clock import Clock
from tilth.logger.display import Display, NoDisplay
from tilth.logger.fitting import Worker
from tilth.logger.guarded_fold import GuardedFold
from tilth.logger.log.marks import KIND, Marks
from tilth.logger.log.mcap_log import software
from tilth.logger.log.run_log import Recording
from tilth.logger.preparing import Preparing
from tilth.logger.status import bus_status, health_of, problems_of, rejected, tell_of_log
from tilth.logger.status_line import plain_line
from tilth.logger.supervisor import Supervisor
from tilth.logger.zenoh.liveness import Sensors
from tilth.logger.zenoh.session import why
from tilth.logger.zenoh.sink import ZenohSink
from tilth.schemas.channels import CHANNEL, READY_TOPIC
from tilth.schemas.flow import Estimate, Event, Frame, Measurement, Ready, UtcTime
from tilth.schemas.machine import Machine
from tilth.schemas.proto import tilth_pb2 as pb

TURN_S = 0.1  # longest wait for a frame: a stop is noticed in that time
SECOND_NS = 1_000_000_000
SHOW_NS = 500_000_000
KEEP_NS = 60_000_000_000


@dataclass(frozen=True, slots=True)
class Summary:
    """What a run did."""

    started_ns: int
    ended_ns: int
    first_frame_ns: int | None
    last_frame_ns: int | None
    frames: int
    measurements: int
    poses: int
    rejected: dict[str, int]
    estimates: dict[str, Estimate]  # method -> the last
    log_files: tuple[Path, ...]
    recorded: int  # frames in the log
    not_recorded: int  # frames that came while the log could not be written
    lost: int  # frames that the kernel dropped, as far as it says
    bad_stamps: int
    faults: int  # of the estimators
    problems: tuple[str, ...]  # at the end


class Daemon:
    """Everything that one run holds open. `turn` it until it is time to `close`."""

    def __init__(
        self,
        machine: Machine,
        machine_text: str,
        folder: Path,
        suffix: str | None,
        display: Display,
        *,
        keep: bool = False,
        fresh: bool = False,
        note: str = "",
        supervisor: Supervisor | None = None,
        opener: Opener = open_port,
        events: deque[tuple[str, str]] | None = None,
    ) -> None:
        """suffix: of the Zenoh prefix, None to publish nothing. keep: go on from what earlier runs in that
        folder learned, unless `fresh`, and keep it for later ones. note: of the operator, for the log.
        supervisor: is told that the loop lives. opener: opens a bus. events: (kind, text) that is put
        in here is logged, published and shown like what the daemon notices itself.

        Raises MachineError where the wheel-angle sensor or the interface of a bus makes no sense.
        """
        self._machine = machine
        self._display = display
        self._events = deque[tuple[str, str]]() if events is None else events
        self._supervisor = Supervisor({}) if supervisor is None else supervisor
        self._worker = Worker(machine, self._report)
        self._fold = GuardedFold(machine, fitter=self._worker)
        self._preparing = Preparing(machine, self._report)
        self._fold.ready = self._preparing.ready  # until then its poses need nothing that is compiled
        self._clock = Clock()
        self._started_ns = self._clock.t_ns()
        self._buses = Buses(machine.bus, self._clock, self._report, opener)
        self._warm_path = warm_start_file.path_of(folder, machine) if keep else None
        warmed = False
        if self._warm_path is not None and not fresh:
            warmed = warm_start_file.take_up(
                self._warm_path, machine, self._started_ns, self._fold.warm, self._report
            )
        self._recording = Recording(
            folder,
            machine,
            machine_text,
            self._clock,
            self._report,
            self._fold.renew,
            with_state=warmed,
            note=note,
        )
        if not self._fold.ready:
            self._say_ready(self._preparing.text)
        self._marks = Marks()
        self._no_zenoh = ""  # why there is no session although one is wanted
        self._sink = self._open_zenoh(suffix) if suffix is not None else None
        self._sensors = Sensors(machine)
        self._version = software()["version"]
        self._status = pb.Status()
        self._first_frame_ns: int | None = None
        self._last_frame_ns: int | None = None
        self._frames = 0
        self._clock_steps = 0
        self._longest_turn_ns = 0
        self._next_second_ns = self._started_ns
        self._next_show_ns = self._started_ns
        self._next_keep_ns = self._started_ns + KEEP_NS

    @property
    def uptime_s(self) -> float:
        return (self._clock.t_ns() - self._started_ns) * 1e-9

    def turn(self, timeout_s: float = TURN_S) -> int:
        """Wait for frames and take them, then do what is due. Returns the number of frames."""
        if self._preparing.ready and not self._fold.ready:
            self._begin_estimating()
        frames = self._buses.read(timeout_s)
        began_ns = self._clock.t_ns()
        for frame in frames:
            self.take(frame)
        if frames:
            self._frames += len(frames)
            self._last_frame_ns = frames[-1].t_ns
            if self._first_frame_ns is None:
                self._first_frame_ns = frames[0].t_ns
        t_ns = self._clock.t_ns()
        if t_ns >= self._next_second_ns:
            self._second(t_ns)
        self._recording.tick(t_ns)
        if t_ns >= self._next_show_ns:
            self._show(t_ns)
        self._publish_events()
        self._note_marks()
        ended_ns = self._clock.t_ns()
        self._longest_turn_ns = max(self._longest_turn_ns, ended_ns - began_ns)
        self._supervisor.turned(ended_ns)
        return len(frames)

    def close(self) -> Summary:
        """Take what the buses have still got, finish the log, end the session."""
        self._supervisor.stopping()
        deadline_ns = self._clock.t_ns() + SECOND_NS
        with (
            contextlib.ExitStack() as last
        ):  # each of these, whatever happens to the others; the lowest first
            last.callback(self._supervisor.close)
            if self._sink is not None:
                last.callback(self._sink.close)
            last.callback(self._publish_events)
            last.callback(self._note_marks)
            last.callback(self._recording.close)
            last.callback(self._worker.close)
            last.callback(self._preparing.close)
            last.callback(self._publish_events)
            last.callback(self._buses.close)
            while self.turn(0.0) and self._clock.t_ns() < deadline_ns:
                continue
            self._second(self._clock.t_ns())
            self._keep(self._clock.t_ns())
        return self._summary()

    def take(self, frame: Frame) -> None:
        """Raw first: whatever happens after, the frame is in the log."""
        self._recording.frame(frame)
        for publication, data in self._fold.take(frame):
            self._put(publication.topic, publication.t_ns, data)
            value = publication.value
            if isinstance(value, Measurement):
                self._sensors.heard(value)
                if isinstance(value, UtcTime):
                    self._clock.told(value.rx_ns, value.utc_ns)
            elif isinstance(value, Event):
                self._tell(value)

    def _put(self, topic: str, t_ns: int, data: bytes) -> None:
        self._recording.message(topic, t_ns, data)
        if self._sink is not None:
            self._sink.put(topic, data)

    def _second(self, t_ns: int) -> None:
        self._next_second_ns = t_ns + SECOND_NS
        self._watch_clock()
        if (
            self._fold.ready and self._fold.poses
        ):  # a fit may be asked for soon; loading and compiling takes longer than one
            self._worker.start()
        if t_ns >= self._next_keep_ns:
            self._keep(t_ns)
        self._status = self._build_status(t_ns)
        self._put("/status", t_ns, CHANNEL["/status"].encode(self._status))
        self._supervisor.status(plain_line(self._status, self._fold.estimates[RECOMMENDED]))

    def _begin_estimating(self) -> None:
        """With the next frame, which the log says before."""
        if seconds := self._preparing.seconds:
            text = f"kernels were compiled for {seconds:.0f} s while frames were recorded; estimates begin"
            self._report("compiled", text)
        self._fold.ready = True
        self._say_ready("")
        gc.freeze()  # what was compiled or loaded stays

    def _say_ready(self, text: str) -> None:
        told = Ready(self._clock.t_ns(), self._fold.ready, text)
        self._recording.message(READY_TOPIC, told.t_ns, CHANNEL[READY_TOPIC].encode(told))

    def _keep(self, t_ns: int) -> None:
        """Store what has been learned, for the next run."""
        self._next_keep_ns = t_ns + KEEP_NS
        path, kept = self._warm_path, self._fold.keep(t_ns)
        if path is not None and kept:
            text = warm_start_file.text_of(self._machine, kept, t_ns)
            self._recording.beside(lambda: warm_start_file.write(path, text))

    def _show(self, t_ns: int) -> None:
        self._next_show_ns = t_ns + SHOW_NS
        try:
            self._display.show(self._status, self._fold.estimates[RECOMMENDED])
        except OSError:  # the terminal is gone; the log goes on
            self._display = NoDisplay()

    def _tell(self, event: Event) -> None:
        try:
            self._display.event(event)
        except OSError:
            self._display = NoDisplay()

    def _watch_clock(self) -> None:
        relation = self._clock.relation()
        step_ns = self._clock.step_ns(relation)
        if step_ns:
            self._clock_steps += 1
            text = (
                f"the computer's clock was set by {step_ns * 1e-9:+.3f} s; the log's own clock goes on evenly"
            )
            self._report("clock", text)
            self._recording.clocks("step")

    def _report(self, kind: str, text: str) -> None:
        # Kept until the frames of this turn are in the log: the file's times never run back.
        self._events.append((kind, text))

    def _publish_events(self) -> None:
        while self._events:
            event = Event(self._clock.t_ns(), *self._events.popleft())
            self._put("/event", event.t_ns, CHANNEL["/event"].encode(event))
            self._tell(event)

    def _note_marks(self) -> None:
        """Log what an operator asked to be noted; publish and answer when it is on the disk, not before."""
        for mark in self._marks.asked():
            t_ns = self._clock.t_ns()
            event = Event(t_ns, KIND, mark.text, *self._fold.place_deg, self._clock.utc_ns(t_ns))
            self._recording.message("/event", event.t_ns, CHANNEL["/event"].encode(event))
            self._recording.settle(partial(self._marks.settle, mark, event))
        for mark, event, refusal in self._marks.settled():
            if not refusal:
                if self._sink is not None:
                    self._sink.put("/event", CHANNEL["/event"].encode(event))
                self._tell(event)
            mark.answer(event, refusal)

    def _open_zenoh(self, suffix: str) -> ZenohSink | None:
        try:
            sink = ZenohSink(self._machine, suffix, mark=self._marks.take)
        except ZError as error:
            self._no_zenoh = f"nothing is published: {why(error)}; correct [zenoh] in the machine file"
            self._report("zenoh", self._no_zenoh)
            return None
        if sink.note:
            self._report("zenoh", sink.note)
        return sink

    def _build_status(self, t_ns: int) -> pb.Status:
        recording = self._recording
        status = pb.Status(
            t_ns=t_ns,
            run=recording.run_id,
            version=self._version,
            uptime_s=(t_ns - self._started_ns) * 1e-9,
            frames=self._frames,
            measurements=self._fold.measurements,
            poses=self._fold.poses,
            buses=[bus_status(bus, t_ns) for bus in self._buses.live_buses],
            receivers=self._sensors.receivers(t_ns),
            wheel_angle=self._sensors.wheel_angle(t_ns),
            rejected=[pb.Count(reason=reason, count=count) for reason, count in self._rejected().items()],
            preparing=self._preparing.text,
            ready_in_s=self._preparing.left_s,
        )
        tell_of_log(status, recording)
        if self._worker.seconds is not None:
            status.fit_s = self._worker.seconds
        zenoh = self._no_zenoh if self._sink is None else self._sink.problem
        status.problems.extend(problems_of(status, self._buses.live_buses, recording, zenoh))
        status.health = health_of(status)
        status.faults.extend(pb.Count(reason=reason, count=n) for reason, n in self._faults().items() if n)
        status.longest_turn_s = self._longest_turn_ns * 1e-9
        self._longest_turn_ns = 0
        return status

    def _faults(self) -> dict[str, int]:
        return {
            "not_recorded": self._recording.missed,  # frames
            "not_published": 0 if self._sink is None else self._sink.failures,  # values
            "estimators_failed": self._fold.faults,
            "clock_stepped": self._clock_steps,
            "not_notified": self._supervisor.failures,  # systemd
        }

    def _rejected(self) -> dict[str, int]:
        other = {"stamp": self._clock.bad_stamps, "mark": self._marks.refused}
        return rejected(self._fold.rejected, self._buses.live_buses, other)

    def _summary(self) -> Summary:
        return Summary(
            started_ns=self._started_ns,
            ended_ns=self._clock.t_ns(),
            first_frame_ns=self._first_frame_ns,
            last_frame_ns=self._last_frame_ns,
            frames=self._frames,
            measurements=self._fold.measurements,
            poses=self._fold.poses,
            rejected=self._rejected(),
            estimates=dict(self._fold.estimates),
            log_files=tuple(self._recording.files),
            recorded=self._recording.frames,
            not_recorded=self._recording.missed,
            lost=sum(bus.traffic.lost for bus in self._buses.live_buses),
            bad_stamps=self._clock.bad_stamps,
            faults=self._fold.faults,
            problems=tuple(self._status.problems),
        )


def run_daemon(
    machine: Machine,
    machine_text: str,
    *,
    log_folder: Path | None = None,
    zenoh: bool = True,
    prefix_suffix: str = "",
    seconds: float | None = None,
    status: Display | None = None,
    stop: Callable[[], bool] = lambda: False,
    keep: bool = False,
    fresh: bool = False,
    note: str = "",
    supervisor: Supervisor | None = None,
    events: deque[tuple[str, str]] | None = None,
) -> Summary:
    """Run until `stop()` or for so many seconds; the log file is whole in any case.

    log_folder: instead of the machine file's. zenoh: whether to publish; prefix_suffix: "replay" where the
    buses carry a simulation. status: where to show, if anywhere. keep, fresh, note, supervisor, events:
    as of Daemon. Raises MachineError as Daemon does.
    """
    folder = Path(machine.log.folder) if log_folder is None else log_folder
    suffix = prefix_suffix if zenoh else None
    shown = status or NoDisplay()
    daemon = Daemon(
        machine, machine_text, folder, suffix, shown,
        keep=keep, fresh=fresh, note=note, supervisor=supervisor, events=events,
    )  # fmt: skip
    # What exists by now stays: the collector need not look at it again and again.
    gc.collect()
    gc.freeze()
    try:
        while not stop() and (seconds is None or daemon.uptime_s < seconds):
            daemon.turn()
    finally:  # also of an error nobody foresaw: the log is whole
        summary = daemon.close()
    return summary
