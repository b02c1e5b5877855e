"""The outputs of the daemon: log, Zenoh and display."""

from collections import deque
from collections.abc import Callable

from zenoh import ZError

from tilth.logger.clock import Clock
from tilth.logger.display import Display, NoDisplay
from tilth.logger.log.run_log import Recording
from tilth.logger.zenoh.session import why
from tilth.logger.zenoh.sink import ZenohSink
from tilth.schemas.channels import CHANNEL
from tilth.schemas.flow import Estimate, Event, EventKind
from tilth.schemas.notices import Notice, NoticeCode, notice
from tilth.schemas.proto import tilth_pb2 as pb
from tilth.schemas.sentences import notice_sentence

Events = deque[tuple[str, Notice]]
"""What has happened since the last turn of the loop, with its kind; any thread may append. It is logged after
the frames of the turn: the times in a file never run back."""


class Outlets:
    def __init__(self, recording: Recording, display: Display, events: Events, clock: Clock) -> None:
        self.recording = recording
        self.sink: ZenohSink | None = None
        self._no_session = ""  # why there is none although one is wanted
        self._display = display
        self._events = events
        self._clock = clock

    def open_zenoh(self, open_sink: Callable[[], ZenohSink]) -> None:
        """A session that cannot be had costs nothing but itself."""
        try:
            self.sink = open_sink()
        except ZError as error:
            refused = notice(NoticeCode.NOT_PUBLISHED, why=why(error))
            self._no_session = notice_sentence(refused)
            self._events.append((EventKind.ZENOH, refused))
            return
        if self.sink.note:
            self._events.append((EventKind.ZENOH, notice(NoticeCode.TEXT, text=self.sink.note)))

    @property
    def zenoh_problem(self) -> str:
        """What is wrong with Zenoh, in words; "" where nothing is."""
        return self._no_session if self.sink is None else self.sink.problem

    @property
    def not_published(self) -> int:
        """Values that could not be."""
        return 0 if self.sink is None else self.sink.failures

    def put(self, topic: str, t_ns: int, data: bytes) -> None:
        """Log, then publish."""
        self.recording.message(topic, t_ns, data)
        self.publish(topic, data)

    def publish(self, topic: str, data: bytes) -> None:
        if self.sink is not None:
            self.sink.put(topic, data)

    def put_events(self) -> None:
        """Log, publish and show what has happened."""
        while self._events:
            kind, told = self._events.popleft()
            event = Event(self._clock.t_ns(), kind, told)
            self.put("/event", event.t_ns, CHANNEL["/event"].encode(event))
            self.show_event(event)

    def show_event(self, event: Event) -> None:
        try:
            self._display.event(event)
        except OSError:
            self._display = NoDisplay()

    def show(self, status: pb.Status, estimate: Estimate | None) -> None:
        try:
            self._display.show(status, estimate)
        except OSError:  # the terminal is gone; the log goes on
            self._display = NoDisplay()

    def close(self) -> None:
        """Close Zenoh and the display."""
        if self.sink is not None:
            self.sink.close()
