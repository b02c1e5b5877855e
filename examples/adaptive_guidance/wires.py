"""The controller's wires: poses and estimates from a daemon over Zenoh, commands to a CAN bus."""

import logging
import queue
import time
from collections import Counter
from collections.abc import Iterable
from types import TracebackType
from typing import Final, Self

import can
import zenoh

from tilth.adaptive_guidance.controller import STALE
from tilth.client import Client, HeardRig, Latest
from tilth.client.latest import judge
from tilth.client.link import Link, base_key, open_session
from tilth.client.received import Refused, pose_of
from tilth.schemas.flow import Estimate, Pose

UNHEARD: Final = 1000  # frames, at most, thrown away before a command
WAITING: Final = 32  # poses that may wait for the loop; older ones are dropped


def throw_away(bus: can.BusABC) -> None:
    """What others say is for the daemon; left lying, it fills a bus over TCP until that waits for us."""
    for _ in range(UNHEARD):
        if bus.recv(0.0) is None:
            return


class Wires:
    """One daemon and one bus. `now` is the daemon's clock where it runs on the same computer, or where both
    computers' clocks are set alike when they start."""

    def __init__(self, machine: str, *, endpoint: str, prefix: str = "tilth", replay: bool = False) -> None:
        """Raises ValueError in a person's words."""
        self._base = base_key(machine, prefix, replay)
        self._bus: can.BusABC | None = None
        self._offset_ns = time.time_ns() - time.monotonic_ns()
        self._poses: queue.Queue[Pose] = queue.Queue(WAITING)
        self._refused: Counter[str] = Counter()
        session = open_session(endpoint)
        self.place: tuple[float, float] | None = None  # of which to ask, as of Controller.ahead
        self._ahead: tuple[Estimate, float] | None = None  # and when it came, s
        self._client = Client(session, self._base, "", STALE)
        self._client.on_estimate(self._ask)
        self._link = Link(session)
        self._link.hear(session.declare_subscriber(f"{self._base}/pose"), self._take)

    @property
    def rig(self) -> HeardRig | None:
        """What the daemon says of the machine; None until it has been heard."""
        return self._client.rig

    def wait(self, timeout_s: float) -> bool:
        """Until the rig and a first estimate have been heard; False where they were not in that time."""
        return self._client.wait(timeout_s)

    @property
    def refused(self) -> dict[str, int]:
        """What came and could not be used, and commands that the bus did not take."""
        return dict(self._refused + Counter(self._client.refused))

    def now(self) -> float:
        """s, on the clock of the poses."""
        return (time.monotonic_ns() + self._offset_ns) * 1e-9

    def latest(self) -> Latest:
        return self._client.latest()

    def ahead(self) -> Latest | None:
        """What the memory by place has said last of `place`; None before that."""
        if self._ahead is None:
            return None
        estimate, at = self._ahead
        return judge(estimate, time.monotonic() - at, STALE)

    def poses(self) -> Iterable[Pose]:
        """Those that came since the last call."""
        while not self._poses.empty():
            yield self._poses.get()

    def command_on(self, bus: can.BusABC) -> None:
        """Send commands there from now on; it is shut down with the wires."""
        # It warns at each half-read frame.
        logging.getLogger("can.interfaces.socketcand").setLevel(logging.ERROR)
        self._bus = bus

    def send(self, frames: Iterable[tuple[int, bytes]]) -> None:
        """What the bus does not take is counted; the steering lets go when nothing comes."""
        if self._bus is None:
            return
        try:
            throw_away(self._bus)
        except can.CanError as error:
            self._refused[f"the bus was not read: {error}"[:120]] += 1
        for can_id, data in frames:
            try:
                self._bus.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=True), 0.05)
            except can.CanError as error:
                self._refused[f"a command was not sent: {error}"[:120]] += 1

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._client.close()
        self._link.close()
        if self._bus is not None:
            self._bus.shutdown()

    def _ask(self, _: Latest) -> None:
        """In a thread of the client, with each estimate."""
        if self.place is None:
            return
        try:
            self._ahead = self._client.estimate_at(*self.place), time.monotonic()
        except LookupError as error:
            self._refused[str(error)] += 1

    def _take(self, sample: zenoh.Sample) -> None:
        """In a thread that hears."""
        try:
            if str(sample.key_expr) != f"{self._base}/pose" or sample.kind != zenoh.SampleKind.PUT:
                raise Refused("not sent to this machine's pose alone")
            pose = pose_of(sample.payload.to_bytes(), str(sample.encoding))
        except Refused as error:
            self._refused[str(error)] += 1
            return
        if self._poses.full():
            self._poses.get()
        self._poses.put(pose)
