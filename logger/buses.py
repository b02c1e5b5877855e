"""Reads CAN buses through python-can: several, in one loop, listening only.

python-can's Notifier is not used: its thread ends at the first error. A bus that fails is closed and opened
again with back-off while the others go on; opening may take seconds (a serial adapter, a dead server), so it
happens in a thread of its own.
"""

import logging
import selectors
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from queue import Empty, SimpleQueue

import can

from tilth.logger.bus_opening import check_interface, dropped, open_bus, readable, why_not
from tilth.logger.clock import Clock
from tilth.schemas.flow import Frame
from tilth.schemas.machine import Bus

BATCH = 32  # frames taken from one bus before the others have their turn
POLL_S = 0.002  # for interfaces without a descriptor
SILENT_NS = 2_000_000_000
RENEW_NS = 10_000_000_000  # a silent bus is opened afresh after this: some die without an error
RENEW_MOST_NS = 60_000_000_000
BACK_OFF_NS = 500_000_000
BACK_OFF_MOST_NS = 5_000_000_000
EMPTY_READS = 200  # readable, but nothing to read: the far side is gone
NOT_YET = "not open yet"
LEAVE_S = 2.0  # how long the end of a run waits for a bus that is just being opened

Report = Callable[[str, str], None]  # kind and text of an event


@dataclass(slots=True)
class Source:
    """One bus as it is at the moment."""

    config: Bus
    state: str = "failed"  # open | silent | failed
    reason: str = NOT_YET
    bus: can.BusABC | None = None
    descriptor: int | None = None
    opening: bool = False
    frames: int = 0
    frames_per_s: float = 0.0
    error_frames: int = 0
    remote_frames: int = 0
    fd_frames: int = 0
    lost: int = 0  # dropped by the kernel, as far as it says
    opened: int = 0
    heard_ns: int = 0  # last frame of any kind, or opening
    usable_ns: int = 0  # last frame that is taken, or opening
    retry_ns: int = 0
    back_off_ns: int = BACK_OFF_NS
    renew_ns: int = RENEW_NS
    empty_reads: int = 0
    lost_before: int = 0  # by sockets closed since
    frames_before: int = 0  # at the last watch
    reported: str = ""

    @property
    def name(self) -> str:
        return self.config.name

    @property
    def unusable(self) -> str:
        """What kinds of frame came that are not taken, and what to do; "" where none did."""
        kinds = [name for name, n in (("CAN FD", self.fd_frames), ("remote", self.remote_frames)) if n]
        return f"only {' and '.join(kinds)} frames, which are not read; check the channel" if kinds else ""


class Buses:
    """Call `read` all the time and `watch` about each second; both return at once where there is nothing."""

    def __init__(self, configs: Sequence[Bus], clock: Clock, report: Report) -> None:
        """Raises MachineError where python-can does not know an interface."""
        for config in configs:
            check_interface(config)
        # What goes wrong comes as an exception as well and is reported from here, in a person's words.
        logging.getLogger("can").setLevel(logging.CRITICAL)
        self.sources = [Source(config) for config in configs]
        self._clock = clock
        self._report = report
        self._selector = selectors.DefaultSelector()
        self._unread: list[Source] = []  # had more than a batch
        self._opened: SimpleQueue[tuple[Source, can.BusABC | BaseException]] = SimpleQueue()
        self._threads: list[threading.Thread] = []
        self._watched_ns = clock.t_ns()
        for source in self.sources:
            self._start_opening(source)

    def read(self, timeout_s: float) -> list[Frame]:
        """Frames in the order taken, at most a batch of each bus; [] after timeout_s without any."""
        self._adopt()
        polled = [s for s in self.sources if s.bus is not None and s.descriptor is None]
        if self._unread:
            timeout_s = 0.0
        elif polled:
            timeout_s = min(timeout_s, POLL_S)
        ready: list[Source] = [key.data for key, _ in self._selector.select(timeout_s)]
        waiting = self._unread
        self._unread = []
        frames: list[Frame] = []
        for source in (*ready, *polled, *(s for s in waiting if s not in ready and s not in polled)):
            if source.bus is not None:
                self._drain(source, source.bus, frames)
        return frames

    def watch(self, t_ns: int) -> None:
        """Notice silence, count losses, open again what failed."""
        elapsed_s = max(t_ns - self._watched_ns, 1) * 1e-9
        self._watched_ns = t_ns
        self._threads = [thread for thread in self._threads if thread.is_alive()]
        for source in self.sources:
            source.frames_per_s = (source.frames - source.frames_before) / elapsed_s
            source.frames_before = source.frames
            if source.bus is not None:
                self._count_lost(source)
                self._notice_silence(source, t_ns)
            elif not source.opening and t_ns >= source.retry_ns:
                self._start_opening(source)

    def close(self) -> None:
        """Close all of them, also one that is just being opened."""
        for thread in self._threads:
            thread.join(LEAVE_S)
        self._adopt()
        for source in self.sources:
            self._close(source)
        self._selector.close()

    def _drain(self, source: Source, bus: can.BusABC, frames: list[Frame]) -> None:
        before = len(frames)
        received = 0
        receive, stamps, name = bus.recv, self._clock.stamps, source.config.name
        try:
            for _ in range(BATCH):
                message = receive(0)
                if message is None:
                    break
                received += 1
                if message.is_remote_frame or message.is_fd:
                    _count_unusable(source, message)
                    continue
                t_ns, rx_ns = stamps(message.timestamp)
                error = message.is_error_frame
                source.error_frames += error
                identifier, extended = message.arbitration_id, message.is_extended_id
                frames.append(Frame(t_ns, rx_ns, name, identifier, extended, error, bytes(message.data)))
            else:
                self._unread.append(source)
        except Exception as error:  # a driver may raise anything; the other buses go on
            self._fail(source, why_not(error, source.config))
        if len(frames) > before:
            self._heard(source, frames[-1].t_ns)
            self._took(source, len(frames) - before)
        elif received:
            self._heard(source, self._clock.t_ns())
            self._notice_unusable(source)
        elif source.descriptor is not None:
            source.empty_reads += 1
            if source.empty_reads > EMPTY_READS:
                self._fail(source, f"{source.config.channel}: the far side has hung up")

    def _heard(self, source: Source, t_ns: int) -> None:
        """A frame of any kind: the bus is not dead."""
        if source.state == "silent":
            self._report("bus", f"{source.name}: heard again after {(t_ns - source.heard_ns) * 1e-9:.1f} s")
            source.state, source.reason = "open", ""
        source.heard_ns = t_ns
        source.empty_reads = 0
        source.back_off_ns = BACK_OFF_NS
        source.renew_ns = RENEW_NS

    def _took(self, source: Source, frames: int) -> None:
        source.frames += frames
        source.usable_ns = source.heard_ns
        if source.bus is not None:
            source.state, source.reason, source.reported = "open", "", ""

    def _notice_unusable(self, source: Source) -> None:
        if source.bus is None or source.heard_ns - source.usable_ns < SILENT_NS:
            return
        source.reason = source.unusable
        if source.reported != source.reason:
            source.reported = source.reason
            self._report("bus", f"{source.name}: {source.reason}")

    def _notice_silence(self, source: Source, t_ns: int) -> None:
        silent_ns = t_ns - source.heard_ns
        if silent_ns < SILENT_NS:
            return
        if source.state != "silent":
            source.state = "silent"
            source.reason = "no frame; check that its devices are on, the bit rate, the plug"
            self._report("bus", f"{source.name}: silent, no frame for {silent_ns * 1e-9:.0f} s")
        if silent_ns >= source.renew_ns:
            source.renew_ns = min(silent_ns + 2 * source.renew_ns, silent_ns + RENEW_MOST_NS)
            self._close(source)
            self._start_opening(source)

    def _fail(self, source: Source, reason: str) -> None:
        """Close and try later. Said once for each reason, until frames have come again."""
        self._close(source)
        source.state, source.reason = "failed", reason
        source.retry_ns = self._clock.t_ns() + source.back_off_ns
        source.back_off_ns = min(2 * source.back_off_ns, BACK_OFF_MOST_NS)
        if source.reported != reason:
            source.reported = reason
            self._report("bus", f"{source.name}: {reason}; it is tried again")

    def _close(self, source: Source) -> None:
        if source.descriptor is not None:
            self._count_lost(source)
            self._selector.unregister(source.descriptor)
        source.lost_before = source.lost
        bus, source.bus, source.descriptor = source.bus, None, None
        if bus is None:
            return
        try:
            bus.shutdown()
        except Exception as error:  # a driver whose device is gone
            self._report("bus", f"{source.name}: closing it failed: {why_not(error, source.config)}")

    def _start_opening(self, source: Source) -> None:
        source.opening = True
        thread = threading.Thread(target=self._open, args=(source,), name="tilth-open-bus", daemon=True)
        self._threads.append(thread)
        thread.start()

    def _open(self, source: Source) -> None:
        try:
            self._opened.put((source, open_bus(source.config)))
        except Exception as error:  # handed to the loop, which says it
            self._opened.put((source, error))

    def _adopt(self) -> None:
        """Take over what the opening threads have done."""
        while True:
            try:
                source, result = self._opened.get_nowait()
            except Empty:
                return
            source.opening = False
            if isinstance(result, BaseException):
                self._fail(source, why_not(result, source.config))
                continue
            source.bus = result
            source.empty_reads = 0
            source.opened += 1
            if source.state != "silent":  # one that was silent stays so until a frame comes
                source.state, source.reason = "open", ""
                source.heard_ns = source.usable_ns = self._clock.t_ns()
            self._select(source, readable(result))

    def _select(self, source: Source, descriptor: int | None) -> None:
        if descriptor is not None:
            try:
                self._selector.register(descriptor, selectors.EVENT_READ, source)
            except (ValueError, OSError):  # a descriptor that nothing can wait for
                return
            source.descriptor = descriptor

    def _count_lost(self, source: Source) -> None:
        if source.descriptor is None:
            return
        lost = source.lost_before + dropped(source.descriptor)
        if lost > source.lost:
            self._report(
                "bus",
                f"{source.name}: {lost - source.lost} frames lost in the kernel, the computer was busy",
            )
        source.lost = lost


def _count_unusable(source: Source, message: can.Message) -> None:
    if message.is_remote_frame:
        source.remote_frames += 1
    else:
        source.fd_frames += 1
