"""A recording and its fold as the daemon has them, and a disk that fills."""

import contextlib
import queue
import resource
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path

from loopback import PATIENCE_S, rig, udp_bus

from tilth.logger.clock import Clock
from tilth.logger.guarded_fold import GuardedFold
from tilth.logger.log.run_log import FLUSH_NS, Recording
from tilth.schemas.flow import Frame
from tilth.schemas.machine_toml import MachineFile
from tilth.schemas.notices import Notice
from tilth.schemas.sentences import notice_sentence


class Recorder:
    """A recording and its fold, fed with frames as the daemon feeds them."""

    def __init__(self, folder: Path, log: str = "", simulated: str = "") -> None:
        self.machine, self.text = rig(folder, udp_bus("can0", 1), log=log)
        self.events: list[str] = []
        self.taken: list[Frame] = []
        self.clock = Clock()
        self._now_ns = self.clock.t_ns()
        self._began_ns = self.clock.t_ns()
        self._later_ns = 0  # by how much the frames are later than they were, for what was waited
        self.fold = GuardedFold(self.machine)
        self.recording = Recording(
            folder,
            MachineFile(self.machine, self.text),
            self.clock,
            self._report,
            self.fold.renew,
            simulated=simulated,
        )

    def _report(self, kind: str, told: Notice) -> None:
        self.events.append(f"{kind}: {notice_sentence(told)}")

    def take(self, frame: Frame) -> None:
        frame = replace(frame, t_ns=frame.t_ns + self._later_ns, rx_ns=frame.rx_ns + self._later_ns)
        self._now_ns = frame.t_ns
        self.taken.append(frame)
        self.recording.frame(frame)
        for publication, data in self.fold.take(frame):
            self.recording.message(publication.topic, publication.t_ns, data)
        self.recording.tick(frame.t_ns)

    def until(self, condition: Callable[[], bool]) -> None:
        """Go on as on silent buses, a tick of 0.4 s each time, until something is so."""
        deadline = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < deadline, self.recording.problem
            self.later()
            time.sleep(0.001)

    def on_disk(self) -> bool:
        """Whether all that was logged until now is on the disk, and what follows is written too."""
        said: queue.SimpleQueue[str] = queue.SimpleQueue()
        self.recording.settle(said.put)
        return said.get(timeout=PATIENCE_S) == "" and self.recording.recording

    def later(self) -> None:
        """A tick 0.4 s later, without a frame."""
        self._now_ns += FLUSH_NS
        self._later_ns += FLUSH_NS
        self.recording.tick(self._now_ns)

    def from_now(self, frames: Iterable[Frame]) -> Iterator[Frame]:
        """The frames as if they came from now on, the first ones from the beginning on."""
        shift = None
        for frame in frames:
            if shift is None:
                shift = (self.clock.t_ns() if self.taken else self._began_ns) - frame.t_ns
            yield replace(frame, t_ns=frame.t_ns + shift, rx_ns=frame.rx_ns + shift)


@contextlib.contextmanager
def file_size_limit(size: int) -> Iterator[None]:
    """A disk that is full as soon as a file is so large: the kernel refuses, nothing is imitated."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
