"""A prompter's wires: poses and orders in, marks and what is shown out, all over one Zenoh session."""

import math
import queue
import threading
import time
from collections import Counter, deque
from collections.abc import Iterable
from contextlib import suppress
from typing import Final

import zenoh

from tilth.client.experiment.prompter import FINISHED, ORDERS, Marked, Order
from tilth.client.experiment.sight import Seen, seen_of
from tilth.client.link import Link, first_heard
from tilth.client.orders import OrderQueue
from tilth.client.received import HeardRig, Refused, parse, pose_of, rig_of_message, text
from tilth.schemas.proto import tilth_pb2 as pb

WAITING: Final = 64  # poses that may wait for the loop; older ones are dropped
MARK_S: Final = 10.0  # a disk may stall for some seconds before it takes a mark
ASK_S: Final = 5.0
SHOWN_S: Final = 1.0  # a prompter shows ten states a second, also where nothing goes on
ENCODING: Final = f"application/protobuf;{pb.ExperimentState.DESCRIPTOR.full_name}"
SILENT: Final = "the daemon does not answer; is this key an operator's?"


class PrompterWires:
    """One daemon, below `base`. The session is closed with it."""

    def __init__(self, session: zenoh.Session, base: str) -> None:
        self._session, self._base, self._link = session, base, Link(session)
        self._poses: deque[tuple[float, Seen]] = deque(maxlen=WAITING)  # one thread adds, another takes
        self._orders = OrderQueue(pb.ExperimentOrder, ORDERS, session)
        self._marked: queue.Queue[Marked] = queue.Queue()
        self._refused: Counter[str] = Counter()
        self._logs: dict[str, None] = {}
        self._me, self._first = str(session.zid()), ""
        self._heard_s = math.inf  # when the daemon last told how it is
        self._run = ""  # of the daemon: another one after it was restarted
        self._restarted = threading.Event()
        self._link.hear(session.declare_subscriber(f"{base}/pose"), self._take_pose)
        self._link.hear(session.declare_subscriber(f"{base}/status"), self._take_status)
        self._link.hear(session.declare_subscriber(f"{base}/experiment"), self._take_state)
        self._link.hear(session.declare_queryable(f"{base}/experiment/order"), self._orders.take)

    @property
    def logs(self) -> tuple[str, ...]:
        """Paths of the log that is written, on the daemon's computer, as far as they were heard."""
        return tuple(self._logs)

    @property
    def refused(self) -> dict[str, int]:
        """What came and could not be used."""
        return dict(self._refused)

    def rig(self) -> HeardRig:
        """What the daemon says of the machine. Raises Refused."""
        for reply in self._session.get(f"{self._base}/rig", timeout=ASK_S):
            if reply.ok is not None:
                return rig_of_message(reply.ok.payload.to_bytes(), str(reply.ok.encoding))
        raise Refused("the daemon does not say what its machine is")

    def restarted(self) -> bool:
        """Whether the daemon tells of another run than before, since the last call."""
        again = self._restarted.is_set()
        self._restarted.clear()
        return again

    @property
    def gives_way_to(self) -> str:
        """The plan of another prompter that began at the same moment and goes on; "" without."""
        return self._first

    @property
    def silent_s(self) -> float:
        """How long the daemon has told nothing of itself; 0 before it has."""
        return max(time.monotonic() - self._heard_s, 0.0)

    def poses(self) -> list[tuple[float, Seen]]:
        """(when it came, s of time.monotonic; the pose), of those since the last call."""
        found = []
        while self._poses:
            found.append(self._poses.popleft())
        return found

    def orders(self) -> list[Order]:
        """Those since the last call."""
        return [Order(kind) for kind in self._orders.new()]

    def answers(self) -> list[Marked]:
        """What became of marks, since the last call."""
        found = []
        while not self._marked.empty():
            found.append(self._marked.get())
        return found

    def mark(self, note: str) -> None:
        """Ask for a note in the log; `answers` tells what became of it."""
        replies = self._session.get(f"{self._base}/mark", payload=note.encode(), timeout=MARK_S)
        self._link.hear([replies], lambda come: self._marked.put(_answered(note, come)))

    def mark_now(self, note: str) -> Marked:
        """The same, waiting for the answer."""
        return _answered(note, self._session.get(f"{self._base}/mark", payload=note.encode(), timeout=MARK_S))

    def show(self, state: pb.ExperimentState) -> None:
        state.prompter = self._me
        self._session.put(f"{self._base}/experiment", state.SerializeToString(), encoding=ENCODING)

    def close(self) -> None:
        self._link.close()

    # What follows runs in threads that hear.

    def _take_pose(self, sample: zenoh.Sample) -> None:
        try:
            seen = seen_of(pose_of(sample.payload.to_bytes(), str(sample.encoding)))
        except Refused as error:
            self._refused[str(error)] += 1
            return
        self._poses.append((time.monotonic(), seen))

    def _take_state(self, sample: zenoh.Sample) -> None:
        with suppress(Refused):
            state = parse(pb.ExperimentState, sample.payload.to_bytes(), str(sample.encoding))
            if state.phase != FINISHED and "" < state.prompter < self._me:
                self._first = state.plan

    def _take_status(self, sample: zenoh.Sample) -> None:
        try:
            status = parse(pb.Status, sample.payload.to_bytes(), str(sample.encoding))
        except Refused as error:
            self._refused[str(error)] += 1
            return
        self._heard_s = time.monotonic()
        if status.run and status.run != self._run:
            if self._run:
                self._restarted.set()
            self._run = status.run
        if status.log_file:
            self._logs[status.log_file] = None


def prompts_already(session: zenoh.Session, base: str) -> str:
    """The plan that another prompter takes a driver through just now; "" where none does. Takes SHOWN_S."""

    def plan_of(sample: zenoh.Sample) -> str | None:
        state = parse(pb.ExperimentState, sample.payload.to_bytes(), str(sample.encoding))
        return state.plan if state.phase != FINISHED else None

    return first_heard(session, f"{base}/experiment", plan_of, SHOWN_S) or ""


def _answered(note: str, replies: Iterable[zenoh.Reply]) -> Marked:
    for reply in replies:
        if reply.ok is not None:
            return Marked(note, "")
        refusal = reply.err.payload.to_bytes()[:200].decode(errors="replace") if reply.err else ""
        return Marked(note, text(refusal) or "the daemon refused it")
    return Marked(note, SILENT)
