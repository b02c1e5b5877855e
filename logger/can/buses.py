"""Reads CAN buses: several, in one loop, listening only.

A bus that fails is closed and opened again with back-off while the others go on. Opening and closing may take
seconds (a serial adapter, a dead server) or never end, so they happen in threads of their own. Nothing here
rests on python-can's Notifier: its thread ends at the first error.
"""

import logging
import selectors
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from queue import Empty, SimpleQueue

from tilth.logger.can.bus_opening import check_interface, open_port, why_not
from tilth.logger.can.port import COMPUTER, STAMPED, Port, Tally
from tilth.logger.clock import Clock
from tilth.schemas.flow import Frame
from tilth.schemas.machine import Bus

BATCH = 32  # frames taken from one bus before the others have their turn
# After frames that were stamped on arrival others are let come: a wake-up costs as much as three of them.
REST_S = 0.004
POLL_S = 0.002  # for interfaces without a descriptor
WATCH_NS = 250_000_000
ASK_NS = 1_000_000_000
SILENT_NS = 1_500_000_000  # the slowest devices send once a second
RENEW_NS = 10_000_000_000  # a silent bus is opened afresh after this: some die without an error
RENEW_MOST_NS = 60_000_000_000
WORKED_NS = 1_000_000_000  # open for so long, it has worked: what fails it now is another failure
BACK_OFF_NS = 500_000_000
BACK_OFF_MOST_NS = 5_000_000_000
SLOW_NS = 5_000_000_000  # an opening that takes so long is said
GIVE_UP_NS = 30_000_000_000  # and after this another one is begun beside it
HANGING = 4  # openings of one bus that may hang at a time
EMPTY_READS = 200  # readable, but nothing to read: the far side is gone
NOT_YET = "not open yet"
SLOW = "opening it does not end; the far side or the driver hangs: restart it"
LOST = {"mavlink": "messages of the autopilot lost on the way; give its link more bit rate, or less to do"}
LEAVE_S = 2.0  # how long the end of a run waits for buses that are just being opened or closed

Report = Callable[[str, str], None]  # kind and text of an event
Opener = Callable[[Bus, Clock, Tally], Port]


@dataclass(slots=True)
class Source:
    """One bus as it is at the moment."""

    config: Bus
    tally: Tally = field(default_factory=Tally)
    state: str = "failed"  # open | silent | failed
    reason: str = NOT_YET
    port: Port | None = None
    descriptor: int | None = None  # that the selector waits for
    opening: bool = False
    asked_ns: int = 0  # when the opening began
    attempt: int = 0
    frames: int = 0
    frames_per_s: float = 0.0
    stamp: str = ""  # who stamped the frames that came last
    lost: int = 0  # dropped by the kernel, as far as it says
    opened: int = 0
    opened_ns: int = 0
    failures: int = 0
    failing: bool = False  # one is counted and said; until frames come, or it has been open for WORKED_NS
    silences: int = 0
    down_ns: int = 0  # when frames ended because it failed; 0 while they come
    heard_ns: int = 0  # last frame of any kind, or opening
    usable_ns: int = 0  # last frame that is taken, or opening
    retry_ns: int = 0
    back_off_ns: int = BACK_OFF_NS
    renew_ns: int = RENEW_NS
    empty_reads: int = 0
    lost_before: int = 0  # by sockets closed since
    frames_before: int = 0  # when the rate was last counted
    watched_frames: int = 0  # without error frames, at the last watch
    reported: str = ""
    noted: set[str] = field(default_factory=set)
    threads: list[threading.Thread] = field(default_factory=list)

    @property
    def name(self) -> str:
        return self.config.name

    @property
    def unusable(self) -> str:
        """What kinds of frame came that are not taken, and what to do; "" where none did."""
        tally = self.tally
        kinds = [name for name, n in (("CAN FD", tally.fd_frames), ("remote", tally.remote_frames)) if n]
        return f"only {' and '.join(kinds)} frames, which are not read; check the channel" if kinds else ""

    @property
    def problem(self) -> str:
        """What a person should know or do, the worst; "" where all is well."""
        if self.port is None:
            return self.reason
        return self.tally.health.problem or self.port.problem or self.reason


class Buses:
    """Call `read` all the time; it returns at once where there is something."""

    def __init__(
        self, configs: Sequence[Bus], clock: Clock, report: Report, opener: Opener = open_port
    ) -> None:
        """Raises MachineError where python-can does not know an interface."""
        for config in configs:
            check_interface(config)
        # What goes wrong comes as an exception as well and is reported from here, in a person's words.
        logging.getLogger("can").setLevel(logging.CRITICAL)
        self.sources = [Source(config) for config in configs]
        self._clock = clock
        self._report = report
        self._opener = opener
        self._selector = selectors.DefaultSelector()
        self._unread: list[Source] = []  # had more than a batch
        self._busy = False
        self._opened: SimpleQueue[tuple[Source, int, Port | BaseException]] = SimpleQueue()
        self._said: SimpleQueue[str] = SimpleQueue()  # by the threads
        self._watched_ns = self._asked_ns = clock.t_ns()
        for source in self.sources:
            self._start_opening(source)

    def read(self, timeout_s: float) -> list[Frame]:
        """Frames in the order taken, at most a batch of each bus; [] after timeout_s without any."""
        self._adopt()
        polled = [s for s in self.sources if s.port is not None and s.descriptor is None]
        if self._unread:
            timeout_s = 0.0
        elif self._busy:
            time.sleep(REST_S)  # a pace; what is waited for has come already
        elif polled:
            timeout_s = min(timeout_s, POLL_S)
        ready: list[Source] = [key.data for key, _ in self._selector.select(timeout_s)]
        waiting = self._unread
        self._unread = []
        frames: list[Frame] = []
        for source in (*ready, *polled, *(s for s in waiting if s not in ready and s not in polled)):
            if source.port is not None:
                self._drain(source, source.port, frames)
        self._busy = bool(frames) and all(source.stamp != COMPUTER for source in self.sources)
        t_ns = self._clock.t_ns()
        if t_ns - self._watched_ns >= WATCH_NS:
            self.watch(t_ns)
        return frames

    def watch(self, t_ns: int) -> None:
        """Notice silence, count losses, open again what failed. `read` calls it, four times a second."""
        self._watched_ns = t_ns
        asking = t_ns - self._asked_ns >= ASK_NS
        if asking:
            self._count_rates(t_ns)
        for source in self.sources:
            source.threads = [thread for thread in source.threads if thread.is_alive()]
            if source.port is not None:
                self._look_at(source, source.port, t_ns, asking)
            elif source.opening:
                self._notice_hanging(source, t_ns)
            elif t_ns >= source.retry_ns and len(source.threads) < HANGING:
                self._start_opening(source)

    def close(self) -> None:
        """Close all of them, also one that is just being opened."""
        for source in self.sources:
            if source.port is not None:
                self._close(source)
        end_ns = self._clock.t_ns() + int(LEAVE_S * 1e9)
        for thread in [thread for source in self.sources for thread in source.threads]:
            thread.join(max(end_ns - self._clock.t_ns(), 0) * 1e-9)
        self._adopt()  # those that were just being opened
        for source in self.sources:
            if source.port is not None:
                self._close(source)
        self._adopt()  # what closing them had to say
        self._selector.close()

    def _drain(self, source: Source, port: Port, frames: list[Frame]) -> None:
        before = len(frames)
        received = 0
        try:
            received = port.take(frames, BATCH)
            if received >= BATCH:
                self._unread.append(source)
        except Exception as error:  # a driver may raise anything; the other buses go on
            self._fail(source, why_not(error, source.config))
        if len(frames) > before:
            self._heard(source, frames[-1].t_ns)
            self._took(source, port, len(frames) - before)
        elif received:
            self._heard(source, self._clock.t_ns())
            self._notice_unusable(source)
        elif source.descriptor is not None:
            source.empty_reads += 1
            if source.empty_reads > EMPTY_READS:
                self._fail(source, f"{source.config.channel}: the far side has hung up")

    def _heard(self, source: Source, t_ns: int) -> None:
        """A frame of any kind: the bus is not dead."""
        if source.down_ns and source.port is not None:
            down_s = (t_ns - source.down_ns) * 1e-9
            text = f"works again after {down_s:.1f} s (failure {source.failures}, opening {source.opened})"
            self._say(source, text)
            source.down_ns, source.failing, source.reported = 0, False, ""
        elif source.state == "silent":
            silent_s = (t_ns - source.heard_ns) * 1e-9
            self._say(source, f"heard again after {silent_s:.1f} s (silence {source.silences})")
        if source.state == "silent":
            source.state, source.reason = "open", ""
        source.heard_ns = t_ns
        source.empty_reads = 0
        source.back_off_ns = BACK_OFF_NS
        source.renew_ns = RENEW_NS

    def _took(self, source: Source, port: Port, frames: int) -> None:
        source.frames += frames
        source.usable_ns = source.heard_ns
        if source.port is not None:
            source.state, source.reason, source.reported = "open", "", ""
        if source.stamp != port.stamp:
            source.stamp = port.stamp
            self._say(source, f"its frames are stamped by {STAMPED[port.stamp]}")

    def _notice_unusable(self, source: Source) -> None:
        if source.port is None or source.heard_ns - source.usable_ns < SILENT_NS:
            return
        source.reason = source.unusable
        if source.reported != source.reason:
            source.reported = source.reason
            self._say(source, source.reason)

    def _look_at(self, source: Source, port: Port, t_ns: int, asking: bool) -> None:
        try:
            if asking:
                port.ask(t_ns)
                self._count_lost(source, port)
        except Exception as error:
            self._fail(source, why_not(error, source.config))
            return
        for noted in (port.note, port.problem):
            if noted and noted not in source.noted:
                source.noted.add(noted)
                self._say(source, noted)
        data_frames = source.frames - source.tally.error_frames
        for text in source.tally.health.news(t_ns, data_frames != source.watched_frames):
            self._say(source, text)
        source.watched_frames = data_frames
        if source.failing and t_ns - source.opened_ns >= WORKED_NS:  # no frame says so where nobody sends
            source.failing, source.reported = False, ""
        self._notice_silence(source, port, t_ns)

    def _notice_silence(self, source: Source, port: Port, t_ns: int) -> None:
        silent_ns = t_ns - source.heard_ns
        if silent_ns < SILENT_NS:
            return
        if source.state != "silent":
            source.state = "silent"
            source.silences += 1
            source.reason = "no frame; check that its devices are on, the bit rate, the plug"
            seconds = f"{silent_ns * 1e-9:.1f} s (silence {source.silences})"
            self._say(source, f"silent, no frame for {seconds}, {source.frames} until then")
        if port.renewable and silent_ns >= source.renew_ns:
            source.renew_ns = min(silent_ns + 2 * source.renew_ns, silent_ns + RENEW_MOST_NS)
            self._start_opening(source, self._release(source))

    def _notice_hanging(self, source: Source, t_ns: int) -> None:
        taken_ns = t_ns - source.asked_ns
        if taken_ns >= GIVE_UP_NS:
            source.opening = False
            source.attempt += 1  # what comes of the one before is not wanted any more
            self._fail(source, SLOW)
        elif taken_ns >= SLOW_NS and source.reported != SLOW:
            source.state, source.reason, source.reported = "failed", SLOW, SLOW
            self._count_failure(source)
            self._say(source, SLOW)

    def _fail(self, source: Source, reason: str) -> None:
        """Close and try later. Said once for each failure and reason, however soon it is over."""
        self._close(source)
        source.state, source.reason = "failed", reason
        source.retry_ns = self._clock.t_ns() + source.back_off_ns
        source.back_off_ns = min(2 * source.back_off_ns, BACK_OFF_MOST_NS)
        self._count_failure(source)
        if source.reported != reason:
            source.reported = reason
            so_far = f"(failure {source.failures}, {source.frames} frames until then)"
            self._say(source, f"{reason}; it is tried again {so_far}")

    def _count_failure(self, source: Source) -> None:
        if not source.failing:
            source.failing = True
            source.failures += 1
        source.down_ns = source.down_ns or self._clock.t_ns()

    def _say(self, source: Source, text: str) -> None:
        self._report("bus", f"{source.name}: {text}")

    def _release(self, source: Source) -> Port | None:
        """Take the port from the loop, to be closed elsewhere."""
        port, source.port = source.port, None
        if source.descriptor is not None:
            self._selector.unregister(source.descriptor)
            source.descriptor = None
        if port is not None:
            self._count_lost(source, port)
        source.lost_before = source.lost
        return port

    def _close(self, source: Source) -> None:
        port = self._release(source)
        if port is not None:
            self._start_closing(source, port)

    def _start_closing(self, source: Source, port: Port) -> None:
        self._start(source, lambda: self._close_port(source, port))

    def _start_opening(self, source: Source, old: Port | None = None) -> None:
        source.opening = True
        source.asked_ns = self._clock.t_ns()
        source.attempt += 1
        attempt = source.attempt
        self._start(source, lambda: self._open(source, attempt, old))

    def _start(self, source: Source, job: Callable[[], None]) -> None:
        thread = threading.Thread(target=job, name="tilth-bus", daemon=True)
        source.threads.append(thread)
        thread.start()

    def _open(self, source: Source, attempt: int, old: Port | None) -> None:
        """In a thread: close the old one, if any, then open."""
        if old is not None:
            self._close_port(source, old)
        try:
            self._opened.put((source, attempt, self._opener(source.config, self._clock, source.tally)))
        except Exception as error:  # handed to the loop, which says it
            self._opened.put((source, attempt, error))

    def _close_port(self, source: Source, port: Port) -> None:
        """In a thread."""
        try:
            port.close()
        except Exception as error:  # a driver whose device is gone
            self._said.put(f"{source.name}: closing it failed: {why_not(error, source.config)}")

    def _adopt(self) -> None:
        """Take over what the threads have done."""
        while not self._said.empty():
            self._report("bus", self._said.get())
        while True:
            try:
                source, attempt, result = self._opened.get_nowait()
            except Empty:
                return
            if attempt != source.attempt:  # given up meanwhile
                if not isinstance(result, BaseException):
                    self._start_closing(source, result)
                continue
            source.opening = False
            if isinstance(result, BaseException):
                self._fail(source, why_not(result, source.config))
            else:
                self._use(source, result)

    def _use(self, source: Source, port: Port) -> None:
        source.port = port
        source.empty_reads = 0
        source.opened += 1
        source.opened_ns = self._clock.t_ns()
        if source.state != "silent":  # one that was silent stays so until a frame comes
            source.state, source.reason = "open", ""
            source.heard_ns = source.usable_ns = self._clock.t_ns()
        if port.descriptor is not None:
            try:
                self._selector.register(port.descriptor, selectors.EVENT_READ, source)
            except (ValueError, OSError):  # a descriptor that nothing can wait for
                return
            source.descriptor = port.descriptor

    def _count_rates(self, t_ns: int) -> None:
        seconds = max(t_ns - self._asked_ns, 1) * 1e-9
        self._asked_ns = t_ns
        for source in self.sources:
            source.frames_per_s = (source.frames - source.frames_before) / seconds
            source.frames_before = source.frames

    def _count_lost(self, source: Source, port: Port) -> None:
        lost = source.lost_before + port.lost()
        if lost > source.lost:
            new, source.lost = lost - source.lost, lost
            what = LOST.get(source.config.interface, "frames lost in the kernel, the computer was busy")
            self._say(source, f"{new} {what} ({lost} in all)")
