"""Reads CAN buses: several, in one loop, listening only.

A bus that fails is closed and opened again with back-off while the others go on. Nothing here rests on
python-can's Notifier: its thread ends at the first error.
"""

import logging
import selectors
import time
from collections.abc import Sequence

from tilth.logger.can.bus_opening import check_interface, open_port, why_not
from tilth.logger.can.live_bus import BusState, LiveBus
from tilth.logger.can.port import STAMPED, Port, StampedBy
from tilth.logger.can.port_threads import Opener, PortThreads
from tilth.logger.clock import Clock
from tilth.schemas.flow import EventKind, Frame
from tilth.schemas.machine import Bus
from tilth.schemas.notices import NoticeCode, Report, Value, notice

BATCH = 32  # frames taken from one bus before the others have their turn
# After frames that were stamped on arrival others are let come: a wake-up costs as much as three of them.
REST_S = 0.008
POLL_S = 0.002  # for interfaces without a descriptor
WATCH_NS = 250_000_000
ASK_NS = 1_000_000_000
SILENT_NS = 1_500_000_000  # the slowest devices send once a second
WORKED_NS = 1_000_000_000  # open for so long, it has worked: what fails it now is another failure
SLOW_NS = 5_000_000_000  # an opening that takes so long is reported
GIVE_UP_NS = 30_000_000_000  # and after this another one is begun beside it
EMPTY_READS = 200  # readable, but nothing to read: the far side is gone
SLOW = "opening it does not end; the far side or the driver hangs: restart it"
LOST = {"mavlink": "messages of the autopilot lost on the way; give its link more bit rate, or less to do"}
LEAVE_S = 2.0  # how long the end of a run waits for buses that are just being opened or closed


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
        self.live_buses = [LiveBus(config) for config in configs]
        self._clock = clock
        self._report = report
        self._threads = PortThreads(opener, clock)
        self._selector = selectors.DefaultSelector()
        self._unread: list[LiveBus] = []  # had more than a batch
        self._busy = False
        self._watched_ns = self._polled_ns = clock.t_ns()
        for bus in self.live_buses:
            self._threads.open(bus)

    def read(self, timeout_s: float) -> list[Frame]:
        """Frames in the order taken, at most a batch of each bus; [] after timeout_s without any."""
        self._adopt()
        polled = [
            bus
            for bus in self.live_buses
            if bus.connection.port is not None and bus.connection.descriptor is None
        ]
        if self._unread:
            timeout_s = 0.0
        elif self._busy:
            time.sleep(REST_S)  # a pace; what is waited for has come already
        elif polled:
            timeout_s = min(timeout_s, POLL_S)
        ready: list[LiveBus] = [key.data for key, _ in self._selector.select(timeout_s)]
        waiting = self._unread
        self._unread = []
        frames: list[Frame] = []
        for bus in (*ready, *polled, *(bus for bus in waiting if bus not in ready and bus not in polled)):
            if bus.connection.port is not None:
                self._drain(bus, bus.connection.port, frames)
        stamped_on_reading = any(bus.traffic.stamp is StampedBy.COMPUTER for bus in self.live_buses)
        self._busy = bool(frames) and not stamped_on_reading
        t_ns = self._clock.t_ns()
        if t_ns - self._watched_ns >= WATCH_NS:
            self.watch(t_ns)
        return frames

    def watch(self, t_ns: int) -> None:
        """Notice silence, count losses, open again what failed. `read` calls it, four times a second."""
        self._watched_ns = t_ns
        poll_ports = t_ns - self._polled_ns >= ASK_NS
        if poll_ports:
            self._count_rates(t_ns)
        for bus in self.live_buses:
            connection = bus.connection
            connection.threads = [thread for thread in connection.threads if thread.is_alive()]
            if connection.port is not None:
                self._look_at(bus, connection.port, t_ns, poll_ports)
            elif connection.opening:
                self._notice_hanging(bus, t_ns)
            elif connection.may_retry(t_ns):
                self._threads.open(bus)

    def close(self) -> None:
        """Close all of them, also one that is just being opened."""
        for bus in self.live_buses:
            self._close(bus)
        end_ns = self._clock.t_ns() + int(LEAVE_S * 1e9)
        for thread in [thread for bus in self.live_buses for thread in bus.connection.threads]:
            thread.join(max(end_ns - self._clock.t_ns(), 0) * 1e-9)
        self._adopt()  # those that were just being opened
        for bus in self.live_buses:
            self._close(bus)
        self._adopt()  # what went wrong with closing them
        self._selector.close()

    def _drain(self, bus: LiveBus, port: Port, frames: list[Frame]) -> None:
        before = len(frames)
        received = 0
        try:
            received = port.take(frames, BATCH)
            if received >= BATCH:
                self._unread.append(bus)
        except Exception as error:  # a driver may raise anything; the other buses go on
            self._fail(bus, why_not(error, bus.config))
        if len(frames) > before:
            self._alive(bus, frames[-1].t_ns)
            self._took(bus, port, len(frames) - before)
        elif received:
            self._alive(bus, self._clock.t_ns())
            self._notice_unusable(bus)
        elif bus.connection.descriptor is not None:
            bus.traffic.empty_reads += 1
            if bus.traffic.empty_reads > EMPTY_READS:
                self._fail(bus, f"{bus.config.channel}: the far side has hung up")

    def _alive(self, bus: LiveBus, t_ns: int) -> None:
        """A frame of any kind has come."""
        outages, traffic = bus.outages, bus.traffic
        if outages.down_ns and bus.connection.port is not None:
            down_s = (t_ns - outages.down_ns) * 1e-9
            self._event(
                bus, NoticeCode.BUS_BACK, down_s=down_s, failure=outages.failures,
                opening=bus.connection.opened,
            )  # fmt: skip
            outages.down_ns = 0
            outages.end_failure()
        elif bus.state is BusState.SILENT:
            silence_s = (t_ns - traffic.last_ns) * 1e-9
            self._event(bus, NoticeCode.BUS_HEARD, silence_s=silence_s, silence=outages.silences)
        if bus.state is BusState.SILENT:
            bus.is_now(BusState.OPEN)
        traffic.last_ns = t_ns
        traffic.empty_reads = 0
        bus.connection.works()

    def _took(self, bus: LiveBus, port: Port, frames: int) -> None:
        traffic = bus.traffic
        traffic.frames += frames
        traffic.usable_ns = traffic.last_ns
        if bus.connection.port is not None:
            bus.is_now(BusState.OPEN)
            bus.outages.forget_reported()
        if traffic.stamp != port.stamp:
            traffic.stamp = port.stamp
            self._event(bus, NoticeCode.BUS_STAMPED, by=STAMPED[port.stamp])

    def _notice_unusable(self, bus: LiveBus) -> None:
        if bus.connection.port is None or bus.traffic.last_ns - bus.traffic.usable_ns < SILENT_NS:
            return
        bus.reason = bus.unusable
        if bus.outages.is_news(bus.reason):
            self._event(bus, NoticeCode.BUS_TROUBLE, why=bus.reason)

    def _look_at(self, bus: LiveBus, port: Port, t_ns: int, poll_ports: bool) -> None:
        try:
            if poll_ports:
                port.ask(t_ns)
                self._count_lost(bus, port)
        except Exception as error:
            self._fail(bus, why_not(error, bus.config))
            return
        for note in (port.note, port.problem):
            if note and bus.outages.is_first(note):
                self._event(bus, NoticeCode.BUS_TROUBLE, why=note)
        for text in bus.tally.health.news(t_ns, bus.traffic.data_has_come(bus.tally.error_frames)):
            self._event(bus, NoticeCode.BUS_TROUBLE, why=text)
        # No frame tells that it works where nobody sends.
        if bus.outages.failing and t_ns - bus.connection.opened_ns >= WORKED_NS:
            bus.outages.end_failure()
        self._notice_silence(bus, t_ns)

    def _notice_silence(self, bus: LiveBus, t_ns: int) -> None:
        silent_ns = t_ns - bus.traffic.last_ns
        if silent_ns < SILENT_NS:
            return
        if bus.state is not BusState.SILENT:
            bus.is_now(BusState.SILENT, "no frame; check that its devices are on, the bit rate, the plug")
            bus.outages.silences += 1
            self._event(
                bus, NoticeCode.BUS_SILENT, silence_s=silent_ns * 1e-9, silence=bus.outages.silences,
                frames=bus.traffic.frames,
            )  # fmt: skip
        if bus.connection.wants_renewing(silent_ns):
            self._threads.open(bus, self._release(bus))

    def _notice_hanging(self, bus: LiveBus, t_ns: int) -> None:
        taken_ns = t_ns - bus.connection.opening_began_ns
        if taken_ns >= GIVE_UP_NS:
            bus.connection.give_up()
            self._fail(bus, SLOW)
        elif taken_ns >= SLOW_NS and bus.outages.is_news(SLOW):
            bus.is_now(BusState.FAILED, SLOW)
            bus.outages.begin_failure(self._clock.t_ns())
            self._event(bus, NoticeCode.BUS_TROUBLE, why=SLOW)

    def _fail(self, bus: LiveBus, reason: str) -> None:
        """Close and try later. One event for each failure and reason, however soon it is over."""
        self._close(bus)
        bus.is_now(BusState.FAILED, reason)
        t_ns = self._clock.t_ns()
        bus.connection.back_off.failed(t_ns)
        bus.outages.begin_failure(t_ns)
        if bus.outages.is_news(reason):
            self._event(
                bus, NoticeCode.BUS_FAILED, why=reason, failure=bus.outages.failures,
                frames=bus.traffic.frames,
            )  # fmt: skip

    def _event(self, bus: LiveBus, code: NoticeCode, **values: Value) -> None:
        self._report(EventKind.BUS, notice(code, bus=bus.name, **values))

    def _release(self, bus: LiveBus) -> Port | None:
        """Take the port from the loop, to be closed elsewhere."""
        connection = bus.connection
        port, connection.port = connection.port, None
        if connection.descriptor is not None:
            self._selector.unregister(connection.descriptor)
            connection.descriptor = None
        if port is not None:
            self._count_lost(bus, port)
        bus.traffic.port_released()
        return port

    def _close(self, bus: LiveBus) -> None:
        port = self._release(bus)
        if port is not None:
            self._threads.close(bus, port)

    def _adopt(self) -> None:
        """Take up what the threads have done."""
        for bus, why in self._threads.not_closed():
            self._event(bus, NoticeCode.BUS_TROUBLE, why=f"closing it failed: {why}")
        for bus, attempt, result in self._threads.opened():
            if attempt != bus.connection.attempt:  # given up meanwhile
                if not isinstance(result, BaseException):
                    self._threads.close(bus, result)
                continue
            bus.connection.opening = False
            if isinstance(result, BaseException):
                self._fail(bus, why_not(result, bus.config))
            else:
                self._use(bus, result)

    def _use(self, bus: LiveBus, port: Port) -> None:
        t_ns = self._clock.t_ns()
        bus.connection.adopt(port, t_ns)
        bus.traffic.empty_reads = 0
        if bus.state is not BusState.SILENT:  # one that was silent stays so until a frame comes
            bus.is_now(BusState.OPEN)
            bus.traffic.last_ns = bus.traffic.usable_ns = t_ns
        if port.descriptor is not None:
            try:
                self._selector.register(port.descriptor, selectors.EVENT_READ, bus)
            except (ValueError, OSError):  # a descriptor that nothing can wait for
                return
            bus.connection.descriptor = port.descriptor

    def _count_rates(self, t_ns: int) -> None:
        seconds = max(t_ns - self._polled_ns, 1) * 1e-9
        self._polled_ns = t_ns
        for bus in self.live_buses:
            bus.traffic.count_rate(seconds)

    def _count_lost(self, bus: LiveBus, port: Port) -> None:
        new = bus.traffic.count_lost(port)
        if new:
            what = LOST.get(bus.config.interface, "frames lost in the kernel, the computer was busy")
            self._event(bus, NoticeCode.BUS_LOST_FRAMES, frames=new, what=what, in_all=bus.traffic.lost)
