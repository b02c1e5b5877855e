"""`Client`: receives from one daemon; tells at any moment, to any thread, which parameters may be used."""

import logging
import math
import queue
import threading
import time
from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Final, NamedTuple, Self

import zenoh

from tilth.client.latest import Latest, Linear, Staleness, judge, linear
from tilth.client.link import ENDPOINT, Link, base_key, open_session
from tilth.client.received import HeardRig, Refused, answered_age, estimate_of, event_of, rig_of_message
from tilth.schemas.flow import Estimate, Event, EventKind

SOIL_CHANGE: Final = EventKind.SOIL_CHANGE  # kind of the event
SIMULATED: Final = (
    "only a replay or a simulation of this machine is heard: to hear it, connect with replay=True; never on "
    "a tractor"
)
WAITING: Final = 256  # calls that may wait for a slow callback; further ones are dropped and counted
_DRIFT: Final = 1e-4  # of two computers' clocks against each other, at most
_ANOTHER_CLOCK_S: Final = 60.0  # no connection holds a message back so long and lives
_ENDING_S: Final = 1.0  # longest wait for a callback that was told to end
_LOGGER: Final = logging.getLogger(__name__)


class _Held(NamedTuple):
    estimate: Estimate
    received_s: float  # time.monotonic
    behind_s: float  # how old it was then, as far as can be known


class Client:
    """Made by `Client.connect`. Any thread may call any method.

    Use it as a context: `with Client.connect(…) as client:`. One that is never closed is closed when the
    program ends, after an exception too, and does not keep it from ending.
    """

    def __init__(self, session: zenoh.Session, base: str, method: str, stale: Staleness) -> None:
        """For `connect`, and for a program that has a session already: `close` closes it."""
        self.stale = stale
        self._base = base
        self._key = f"{base}/soil_tire/{method}" if method else f"{base}/soil_tire"
        self._lock = threading.Condition()
        self._held: _Held | None = None
        self._nearest_s: float | None = None  # smallest difference seen between this clock and the daemon's
        self._rig: HeardRig | None = None
        self._alive = False
        self._simulated = False
        self._refused: Counter[str] = Counter()
        self._closed = False
        self._callbacks: list[tuple[str, Callable[[Event], None]]] = []  # kind of event or "", what to call
        self._listeners: list[Callable[[Latest], None]] = []
        self._calls: queue.Queue[Callable[[], None] | None] = queue.Queue(WAITING)
        self._caller = threading.Thread(target=self._call, name="tilth.client", daemon=True)
        self._caller.start()
        self._link = Link(session)
        self._link.hear(session.declare_subscriber(self._key), self._take_sample)
        self._link.hear(session.declare_subscriber(f"{base}/event"), self._take_event)
        # On a tractor's key also those of its replays and simulations, which are named and not followed.
        tokens = session.liveliness().declare_subscriber(f"{base}/**/alive", history=True)
        self._link.hear(tokens, self._take_token)

    @classmethod
    def connect(
        cls,
        machine: str,
        *,
        stale: Staleness,
        endpoint: str = ENDPOINT,
        prefix: str = "tilth",
        method: str = "",
        replay: bool = False,
        config: Path | None = None,
    ) -> Self:
        """Returns at once; a daemon that is not there is waited for as long as the client lives.

        machine, prefix: as in the machine file. method: an estimator's own estimate, such as "pem", instead
        of the recommended one. replay: hear what a replay or a simulation publishes, nothing else.
        config: a Zenoh configuration file instead of an endpoint. Raises ValueError in a person's words.
        """
        base = base_key(machine, prefix, replay)
        if method:
            base_key(method, "tilth", False)
        return cls(open_session(endpoint, config), base, method, stale)

    def latest(self) -> Latest:
        """The last estimate, judged now."""
        with self._lock:
            held, rule = self._held, self.stale
        if held is None:
            return judge(None, math.inf, rule, SIMULATED if self._simulated and not self.alive else "")
        return judge(held.estimate, time.monotonic() - held.received_s + held.behind_s, rule)

    def estimate_at(self, x: float, y: float, timeout_s: float = 1.0) -> Estimate:
        """What the daemon's memory by place says of a place ahead. x, y: north and east of the tractor's rear
        axle there, m, in the plane of the poses; the bodies in line as they head now.

        Raises LookupError where no daemon answers in that time, or with its reason.
        """
        key = f"{self._base}/soil_tire/place/at"
        why = f"no answer in {timeout_s:g} s: does the daemon run?"
        for reply in self._link.session.get(f"{key}?x={x!r};y={y!r}", timeout=timeout_s):
            if reply.ok is not None:
                return estimate_of(_bytes_of(reply.ok, key), str(reply.ok.encoding))
            why = reply.err.payload.to_string() if reply.err else why
        raise LookupError(why)

    @property
    def alive(self) -> bool:
        """Whether the daemon's token is there: says who stopped, not whether an estimate may be used."""
        with self._lock:
            return self._alive

    @property
    def rig(self) -> HeardRig | None:
        """The daemon's rig; None until it has been heard."""
        with self._lock:
            return self._rig

    @property
    def refused(self) -> dict[str, int]:
        """How often something came that is not what it should be, by what was wrong with it."""
        with self._lock:
            return dict(self._refused)

    def linear(self, u: float, model: str = "relaxation") -> Linear:
        """A(u), B(u) with the estimates that may be used, the machine file's priors elsewhere.

        Raises LookupError before the rig has been heard, ValueError as `latest.linear`.
        """
        rig = self.rig
        if rig is None:
            raise LookupError("no rig has been heard yet: wait(), or build one from a machine file")
        return linear(rig.rig, self.latest().theta(rig.rig.theta), u, model)

    def wait(self, timeout_s: float) -> bool:
        """Until both the rig and a first estimate have been heard; False where they were not in that time."""
        with self._lock:
            return self._lock.wait_for(lambda: self._held is not None and self._rig is not None, timeout_s)

    def on_soil_change(self, callback: Callable[[Event], None]) -> None:
        """Call it for each change of soil that an estimator detects, in a thread of the client's own."""
        self.on_event(callback, SOIL_CHANGE)

    def on_event(self, callback: Callable[[Event], None], kind: str = "") -> None:
        """Call it for each event of that kind, or for all."""
        with self._lock:
            self._callbacks.append((kind, callback))

    def on_estimate(self, callback: Callable[[Latest], None]) -> None:
        """Call it for each estimate that comes, judged then. That none comes, only `latest` tells."""
        with self._lock:
            self._listeners.append(callback)

    def close(self) -> None:
        """End the session; callbacks that wait are dropped. What was heard grows old, as it should."""
        with self._lock:
            if self._closed:
                return
            self._closed = True
        self._link.close()
        while not self._calls.empty():
            self._calls.get_nowait()
        self._calls.put(None)
        if threading.current_thread() is not self._caller:
            self._caller.join(_ENDING_S)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    # What follows runs in threads that hear.

    def _take_sample(self, sample: zenoh.Sample) -> None:
        with self._refusing():
            self._take(_bytes_of(sample, self._key), str(sample.encoding), None)

    def _take_reply(self, requested_s: float, reply: zenoh.Reply) -> None:
        if reply.ok is None:  # the daemon says that it has none that is fresh
            return
        with self._refusing():
            answered = (answered_age(reply.ok.attachment), time.monotonic() - requested_s)
            self._take(_bytes_of(reply.ok, self._key), str(reply.ok.encoding), answered)

    def _take(self, data: bytes, encoding: str, answered: tuple[float, float] | None) -> None:
        """answered: (age reported by the daemon, time that the answer took), s; None for a publication."""
        estimate = estimate_of(data, encoding)
        now_s = time.monotonic()
        with self._lock:
            held = self._held
            fresh = held is not None and now_s - held.received_s + held.behind_s <= self.stale.silence_s
            if held is not None and estimate.t_ns <= held.estimate.t_ns:
                if answered is not None:
                    return  # what has been heard already
                if estimate.t_ns == held.estimate.t_ns:
                    raise Refused("the same estimate again: it does not make it younger")
                if fresh:
                    raise Refused("older than the last: do two daemons publish as one machine?")
            if answered is None:
                behind_s = self._behind_s(estimate.t_ns, now_s)
            else:
                behind_s = sum(answered)  # at most
                if math.isfinite(answered[0]):  # what stalls from now on is seen by this
                    self._nearest_s = now_s - estimate.t_ns * 1e-9 - answered[0]
            self._held = _Held(estimate, now_s, behind_s)
            self._lock.notify_all()
            listeners = list(self._listeners)
        if listeners:
            latest = self.latest()
            for listener in listeners:
                self._later(lambda call=listener: call(latest))  # type: ignore[misc]

    def _behind_s(self, t_ns: int, now_s: float) -> float:
        """How much longer this one was under way than the fastest so far: what a stalled network held back
        is as old as it is, not as it looks."""
        apart_s = now_s - t_ns * 1e-9
        if self._nearest_s is None or not 0 <= apart_s - self._nearest_s < _ANOTHER_CLOCK_S:
            self._nearest_s = apart_s
        behind_s = apart_s - self._nearest_s
        self._nearest_s += _DRIFT  # an estimate comes each second: follow a clock that runs slower
        return behind_s

    def _take_event(self, sample: zenoh.Sample) -> None:
        with self._refusing():
            event = event_of(_bytes_of(sample, f"{self._base}/event"), str(sample.encoding))
            with self._lock:
                callbacks = [call for kind, call in self._callbacks if kind in ("", event.kind)]
            for callback in callbacks:
                self._later(lambda call=callback: call(event))  # type: ignore[misc]

    def _take_rig(self, reply: zenoh.Reply) -> None:
        if reply.ok is None:
            return
        with self._refusing():
            rig = rig_of_message(_bytes_of(reply.ok, f"{self._base}/rig"), str(reply.ok.encoding))
            with self._lock:
                self._rig = rig
                self._lock.notify_all()

    def _take_token(self, sample: zenoh.Sample) -> None:
        """A daemon that begins has a clock of its own, and may have a value that was missed."""
        with self._lock:
            begins = sample.kind == zenoh.SampleKind.PUT
            if str(sample.key_expr) != f"{self._base}/alive":
                self._simulated = begins
                return
            self._alive = begins
            if not self._alive or self._closed:
                return
            self._nearest_s = None
        requested_s = time.monotonic()
        try:
            rigs = self._link.session.get(f"{self._base}/rig", timeout=5.0)
            estimates = self._link.session.get(self._key, timeout=5.0)
        except zenoh.ZError:
            return  # closed meanwhile
        self._link.hear(rigs, self._take_rig)
        self._link.hear(estimates, partial(self._take_reply, requested_s))

    def _refusing(self) -> "_Refusing":
        return _Refusing(self._lock, self._refused)

    def _later(self, call: Callable[[], None]) -> None:
        try:
            self._calls.put_nowait(call)
        except queue.Full:
            with self._lock:
                self._refused["not told: a callback is too slow"] += 1

    # In the client's own thread.

    def _call(self) -> None:
        while (call := self._calls.get()) is not None:
            try:
                call()
            except Exception:  # the controller's own code: its fault must not end what it is told
                _LOGGER.exception("a callback failed")
                with self._lock:
                    self._refused["a callback failed"] += 1


class _Refusing:
    """Counts what is refused within it."""

    def __init__(self, lock: threading.Condition, refused: Counter[str]) -> None:
        self._lock, self._refused = lock, refused

    def __enter__(self) -> None:
        return

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool:
        if not isinstance(error, Refused):
            return False
        with self._lock:
            self._refused[str(error)] += 1
            while len(self._refused) > WAITING:  # who sends rubbish may send it in many kinds
                self._refused["others"] += self._refused.pop(next(iter(self._refused)))
        return True


def _bytes_of(sample: zenoh.Sample, key: str) -> bytes:
    """Raises Refused where it was not sent to that very key: a key with wildcards reaches many."""
    if str(sample.key_expr) != key:
        raise Refused(f"sent to {str(sample.key_expr)[:80]!r}, not to this machine alone")
    if sample.kind != zenoh.SampleKind.PUT:
        raise Refused("a deletion")
    return sample.payload.to_bytes()
