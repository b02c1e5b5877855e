"""Data received from one daemon: the latest of each message, all events, and which daemons are alive.

Threads of Zenoh fill it, the page's loop empties it.
"""

import threading
import time
from collections import Counter, deque
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeVar

import zenoh
from google.protobuf.message import Message

from tilth.client.link import Alive, alive_of, base_key, open_session, tokens
from tilth.client.received import LARGEST, Refused, answered_age, parse, rig_of_message
from tilth.monitor.in_german import add_german
from tilth.monitor.json_safe import plain
from tilth.schemas.invocation import command
from tilth.schemas.proto import tilth_pb2 as pb

MESSAGES: Final[dict[str, type[Message]]] = {
    "rig": pb.Rig,
    "status": pb.Status,
    "pose": pb.Pose,
    "soil_tire": pb.SoilTireEstimate,
    "event": pb.Event,
    "player": pb.PlayerState,
    "report": pb.ReportState,
    "experiment": pb.ExperimentState,
    "calibration": pb.CalibrationState,
}
MANY: Final = frozenset({"pose", "soil_tire"})  # kinds of which a single one may be missed
WAITING: Final = 2000  # messages that may wait to be taken; a player sends a thousand a second at most
KINDS_OF_REFUSAL: Final = 20
GONE_S: Final = 10.0  # then another daemon may be followed
MARK_S: Final = 5.0  # longest wait until a mark is in the log
ORDER_S: Final = 10.0  # the same of an order to a player; it may have to read
FILE_S: Final = 60.0  # longest wait for a report's file
LARGEST_REPORT: Final = 32 * 1024 * 1024  # bytes
LIST_S: Final = 120.0  # the same for what it says of its runs: it looks into many logs
LARGEST_LIST: Final = 64 * 1024 * 1024  # bytes of that

M = TypeVar("M", bound=Message)


class MarkAnswer(NamedTuple):
    """What became of one: in the log, or why not."""

    noted: bool
    text: str


class Heard(NamedTuple):
    """A message, and when it was sent."""

    kind: str
    message: dict[str, Any]
    sent_s: float


class _Raw(NamedTuple):
    kind: str
    data: bytes
    encoding: str
    sent_s: float


class DaemonData:
    """Follows one machine of those that live at an endpoint. `now_s` of time.monotonic throughout."""

    def __init__(
        self,
        endpoint: str,
        config: Path | None,
        prefix: str,
        machine: str,
        replay: bool,
        gone_s: float = GONE_S,
    ) -> None:
        """machine: "" for whichever lives; one on a tractor before a simulation. gone_s: after which another
        one may be followed. Raises ValueError in a person's words."""
        base_key(machine or "any", prefix, replay)
        self._prefix, self._wanted, self._gone_s = prefix, (machine, replay), gone_s
        self._lock = threading.Lock()
        self._new: deque[_Raw] = deque()  # in the order in which they came
        self._alive: set[Alive] = set()
        self._refused: Counter[str] = Counter()
        self._followed = Alive(replay, machine) if machine else None
        self._subscriber: Any = None
        self._lived_s = float("-inf")  # when the followed one was last known to live
        self.kept_report = b""  # HTML, of a daemon that has ended
        self._session = open_session(endpoint, config)
        if self._followed is not None:
            self._follow(self._followed)
        self._session.liveliness().declare_subscriber(tokens(prefix), self._take_token, history=True)

    @property
    def followed(self) -> Alive | None:
        """The daemon that is followed; None before one lives."""
        return self._followed

    @property
    def base(self) -> str:
        """Its key prefix; "" where none is followed."""
        return "" if self._followed is None else self._followed.base(self._prefix)

    def alive(self) -> tuple[bool, list[str]]:
        """Whether the followed one lives, and the names of all that do."""
        with self._lock:
            return self._followed in self._alive, [one.machine for one in sorted(self._alive)]

    def refused(self) -> dict[str, int]:
        """Reason -> number of messages that were not used."""
        with self._lock:
            return dict(self._refused)

    def choose(self, now_s: float) -> bool:
        """Follow another one where that is better; True where it is another now."""
        with self._lock:
            alive = sorted(self._alive)
        if self._followed in alive:
            self._lived_s = now_s
            return False
        if self._wanted[0] or not alive or now_s - self._lived_s < self._gone_s:
            return False
        self._follow(alive[0])
        self._lived_s = now_s
        return True

    def take(self) -> list[Heard]:
        """What came since the last call, in its order."""
        with self._lock:
            new = list(self._new)
            self._new.clear()
        found = []
        for raw in new:
            message = self._plain(raw.kind, raw.data, raw.encoding)
            if message is not None:
                found.append(Heard(raw.kind, message, raw.sent_s))
        return found

    def mark(self, text: str) -> MarkAnswer:
        """Ask for a note in the log, and wait until it is there. Not in the loop's own thread."""
        return self._log("mark", text)

    def accept(self, name: str) -> MarkAnswer:
        """Ask for what has been found moved to be taken as it is now, and wait until that is in the log. Not
        in the loop's own thread."""
        return self._log("accept", name)

    def implement(self, name: str) -> MarkAnswer:
        """Ask for a run with this implement, and wait until that is in the log. Not in the loop's own
        thread."""
        return self._log("implement", name)

    def load(self, text: str) -> MarkAnswer:
        """Say what the implement carries, and wait until that is in the log. Not in the loop's own thread."""
        return self._log("load", text)

    def _log(self, key: str, text: str) -> MarkAnswer:
        if not self.base:
            return MarkAnswer(False, f"no daemon has been heard yet: the {key} is not in the log")
        for reply in self._replies(key, MARK_S, text.encode()):
            return (
                MarkAnswer(True, "in the log") if reply.ok is not None else MarkAnswer(False, _refusal(reply))
            )
        return MarkAnswer(
            False, f"the daemon did not confirm it within {MARK_S:.0f} s: look whether it records"
        )

    def make_report(self) -> str:
        """Ask for the report of the run so far: "" where it has begun, or why not. Not in the loop's own
        thread."""
        if not self.base:
            return "no daemon has been heard yet"
        for reply in self._replies("report/make", ORDER_S):
            return "" if reply.ok is not None else _refusal(reply)
        return "the daemon does not make it: it is an older one, or this page's key may not ask for it"

    def report_file(self) -> bytes:
        """The last report that was made, HTML. Not in the loop's own thread. Raises Refused."""
        if self.kept_report:
            return self.kept_report
        for reply in self._replies("report/file", FILE_S):
            if reply.ok is None:
                raise Refused(_refusal(reply))
            if len(reply.ok.payload) > LARGEST_REPORT:
                raise Refused("the report is too large to be shown here")
            return reply.ok.payload.to_bytes()
        raise Refused("the daemon does not answer")

    def order(self, order: pb.PlayerOrder) -> str:
        """Tell a player what to do, and wait until it is done: "", or why it is not. Not in the loop's own
        thread."""
        if not self.base:
            return "no player has been heard yet"
        for reply in self._replies("player/order", ORDER_S, order.SerializeToString()):
            return "" if reply.ok is not None else _refusal(reply)
        return f"the player did not answer within {ORDER_S:.0f} s"

    def experiment(self, kind: str) -> str:
        """Tell who prompts a driver what the driver orders: "", or why it is not done. Not in the loop's own
        thread."""
        return self._driver_orders("experiment", pb.ExperimentOrder(kind=kind[:40]), command("experiment"))

    def calibration(self, kind: str) -> str:
        """The same to who calibrates live."""
        words = command("calibrate", "--live")
        return self._driver_orders("calibration", pb.CalibrationOrder(kind=kind[:40]), words)

    def _driver_orders(self, key: str, order: Message, to: str) -> str:
        if not self.base:
            return "no daemon has been heard yet"
        for reply in self._replies(f"{key}/order", ORDER_S, order.SerializeToString()):
            return "" if reply.ok is not None else _refusal(reply)
        return f"`{to}` does not answer: was it ended?"

    def ask_player(self, what: str, message: type[M]) -> M:
        """What a player says of its runs, on a key below `player`. Not in the loop's own thread. Raises
        Refused."""
        for reply in self._replies(f"player/{what}", LIST_S):
            if reply.ok is None:
                raise Refused(_refusal(reply))
            return parse(message, reply.ok.payload.to_bytes(), str(reply.ok.encoding), most=LARGEST_LIST)
        raise Refused("the player does not answer")

    def _replies(self, key: str, timeout_s: float, payload: bytes | None = None) -> Iterable[zenoh.Reply]:
        """Of the daemon that is followed, which is told who asks: then it has a share of its own."""
        who = zenoh.SourceInfo(self._session.id, 0)
        try:
            return (
                self._session.get(f"{self.base}/{key}", payload=payload, timeout=timeout_s, source_info=who)
                if self.base
                else ()
            )
        except zenoh.ZError:  # this page ends
            return ()

    def close(self) -> None:
        self._session.close()

    def _follow(self, which: Alive) -> None:
        if self._subscriber is not None:
            self._subscriber.undeclare()
        with self._lock:
            self._new.clear()
            self._followed = which
        self._subscriber = self._session.declare_subscriber(f"{self.base}/*", self._take_sample)
        self._ask()

    def _ask(self) -> None:
        self._session.get(f"{self.base}/*", self._take_reply, timeout=5.0)

    def _plain(self, kind: str, data: bytes, encoding: str) -> dict[str, Any] | None:
        try:
            if kind == "rig":
                rig_of_message(data, encoding)
            return add_german(kind, plain(parse(MESSAGES[kind], data, encoding)), data, encoding)
        except Refused as refusal:
            with self._lock:
                self._count(f"{kind}: {refusal}")
            return None

    def _count(self, refusal: str) -> None:
        self._refused[refusal] += 1
        if len(self._refused) > KINDS_OF_REFUSAL:
            self._refused["others"] += self._refused.pop(next(iter(self._refused)))

    # What follows runs in threads of Zenoh's.

    def _take_sample(self, sample: zenoh.Sample) -> None:
        self._keep(sample, time.monotonic())

    def _take_reply(self, reply: zenoh.Reply) -> None:
        if reply.ok is None:
            return
        age_s = answered_age(reply.ok.attachment)
        kind = str(reply.ok.key_expr).removeprefix(f"{self.base}/")
        with self._lock:
            if any(raw.kind == kind for raw in self._new):
                return  # a newer one has come meanwhile
        self._keep(reply.ok, time.monotonic() - age_s)

    def _keep(self, sample: zenoh.Sample, received_s: float) -> None:
        key = str(sample.key_expr)
        kind = key.removeprefix(f"{self.base}/")
        with self._lock:
            if kind not in MESSAGES or sample.kind != zenoh.SampleKind.PUT:
                if not kind.startswith("soil_tire/"):
                    self._count(f"sent to {key[:80]!r}, where nothing is expected")
                return
            if len(sample.payload) > LARGEST:  # not even kept until it is looked at
                self._count(f"{kind}: {len(sample.payload)} bytes are too many")
                return
            if len(self._new) >= (WAITING if kind in MANY else 2 * WAITING):
                self._count(f"{kind}: came faster than they could be shown")
                return
            self._new.append(_Raw(kind, sample.payload.to_bytes(), str(sample.encoding), received_s))

    def _take_token(self, sample: zenoh.Sample) -> None:
        which = alive_of(str(sample.key_expr), self._prefix)
        if which is None:
            return
        with self._lock:
            (self._alive.add if sample.kind == zenoh.SampleKind.PUT else self._alive.discard)(which)
            is_new_start = which == self._followed and which in self._alive
        if is_new_start:  # it has begun anew: another rig perhaps, and values that were missed
            self._ask()


def _refusal(reply: zenoh.Reply) -> str:
    refused = reply.err.payload.to_bytes() if reply.err is not None else b""
    return refused[:200].decode(errors="replace") or "the daemon refused it"
