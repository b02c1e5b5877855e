"""Plays recorded runs on Zenoh under the prefix of replays, and does what it is told there.

<prefix>/<machine>/replay/… carries what the run's daemon published, and below it
    player            tilth.PlayerState: what plays, where it is, how fast
    player/order      takes a tilth.PlayerOrder; answered when it is done, or with why it is not
    player/runs       tilth.RunListings: what can be opened
    player/overview   tilth.Places: poses, estimates and events of the whole run
    player/places     tilth.Places: where one may want to jump to
"""

import queue
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Final

import zenoh
from google.protobuf.message import DecodeError, Message

from tilth.logger.zenoh.sink import SIMULATED_SUFFIX, ZenohSink
from tilth.replay.player import PlayState, RunPlayer
from tilth.replay.prepared import OpenedRun
from tilth.replay.readers.log import LogError
from tilth.replay.recorded import Recorded
from tilth.schemas.limiter import Limiter, asked_by
from tilth.schemas.machine import Machine, MachineError
from tilth.schemas.proto import tilth_pb2 as pb
from tilth.schemas.readable import reason_of

TURN_S: Final = 0.02  # between two looks at what is due
IDLE_S: Final = 0.25  # the same while nothing plays
SAID_S: Final = 0.1  # between two states while it plays
QUIET_S: Final = 1.0  # the same while nothing changes
LATEST_S: Final = 1e9
MOST_ORDERS: Final = 100  # that wait; a slider that is drawn asks a few times a second
MOST_LISTS: Final = 4  # that are made at a time; each looks into many logs


class Stopped(Exception):
    """What is prepared is no longer wanted."""


@dataclass(frozen=True, slots=True)
class Sources:
    """What a player needs of its surroundings.

    open: a run by its name, LogError, MachineError or OSError where it cannot be played; it tells a share
    done and a text. listings: what can be opened, a run at a time.
    """

    names: Sequence[str]
    open: Callable[[str, Callable[[str, float], None]], OpenedRun]
    listings: Callable[[], Iterator[pb.RunListing]]


class PlayerService:
    """In a thread of its own, on a session that stays the caller's."""

    def __init__(
        self, session: zenoh.Session, machine: Machine, sources: Sources, clock: Callable[[], float]
    ) -> None:
        """machine: under whose name it is there before a run is open. clock: seconds, never steps."""
        self._session, self._sources, self._clock = session, sources, clock
        self._orders: queue.SimpleQueue[tuple[pb.PlayerOrder, zenoh.Query, str]] = queue.SimpleQueue()
        self._order_limiter = Limiter(MOST_ORDERS, MOST_ORDERS // 2, "orders", threading.Lock())
        self._list_limiter = Limiter(MOST_LISTS, MOST_LISTS // 2, "lists of runs", threading.Lock())
        self._came: queue.SimpleQueue[OpenedRun | str] = queue.SimpleQueue()  # opened, or why not
        self._stop = threading.Event()
        self._loading = 0  # the last run that was asked for
        self._prepared: tuple[str, float] = ("", 0.0)
        self._state = pb.PlayerState(state=PlayState.IDLE, rate=1.0)
        self._said_s = float("-inf")
        self._jumps = 0  # of runs that were open before
        self._player: RunPlayer | None = None
        self._overview = self._places = self._said = b""
        self._sink: ZenohSink | None = None
        self._appear(machine)
        # Threads that Zenoh starts from a daemon thread are daemons as well: one that comes back to Python
        # while the interpreter ends would abort the process.
        self._thread = threading.Thread(target=self._run, name="tilth.player", daemon=False)
        self._lock = threading.Lock()
        self._beside: list[threading.Thread] = []

    def start(self, opened: OpenedRun | None = None) -> None:
        """opened: what plays at once."""
        if opened is not None:
            self._came.put(opened)
        self._thread.start()

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self._disappear()
        with self._lock:
            beside = list(self._beside)
        for thread in beside:
            thread.join()
        while not self._came.empty():
            if isinstance(opened := self._came.get(), OpenedRun):
                opened.run.close()
        if self._player is not None:
            self._player.run.close()

    def _start_beside(self, job: Callable[..., None], *values: object) -> None:
        """In a thread that `close` waits for: the job looks at `_stop` now and then."""
        thread = threading.Thread(target=job, args=values, name="tilth.beside", daemon=False)
        with self._lock:
            self._beside = [one for one in self._beside if one.is_alive()]
            if not self._stop.is_set():
                thread.start()
                self._beside.append(thread)

    def _appear(self, machine: Machine) -> None:
        self._disappear()
        # A value of a run that is paused does not grow old.
        sink = self._sink = ZenohSink(machine, SIMULATED_SUFFIX, now_ns=lambda: 0, session=self._session)
        key = f"{sink.base}/player"
        self._publisher = self._session.declare_publisher(key, encoding=_encoding(pb.PlayerState))
        self._queryable = self._session.declare_queryable(f"{key}/**", self._answer, complete=True)

    def _disappear(self) -> None:
        if self._sink is not None:
            self._queryable.undeclare()
            self._publisher.undeclare()
            self._sink.close()

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                rows = self._turn()
            except Exception as error:  # a page must never see a run stand still without a word
                rows = self._take_opened(_why(error, self._state.run))
            self._say(rows)

    def _turn(self) -> list[Recorded]:
        """What is to be published. Raises LostLog."""
        playing = self._player is not None and self._player.state == PlayState.PLAYING
        rows = self._take_orders(TURN_S if playing else IDLE_S)
        with suppress(queue.Empty):
            rows = self._take_opened(self._came.get_nowait())
        if self._player is not None:
            rows += self._player.due(self._clock()) or self._standing()
        return rows

    def _standing(self) -> list[Recorded]:
        """What holds where a run stands, each second again: a network may drop what is published once."""
        player, now_s = self._player, self._clock()
        stands = player is not None and player.state in (PlayState.PAUSED, PlayState.ENDED)
        if player is None or not stands or now_s - self._said_s < QUIET_S:
            return []
        return player.run.before(player.at_ns(now_s))

    def _take_orders(self, wait_s: float) -> list[Recorded]:
        """What is to be published for those that wait, or come within that time."""
        rows: list[Recorded] = []
        with suppress(queue.Empty):
            order, query, client = self._orders.get(timeout=wait_s)
            while True:
                self._order_limiter.leave(client)
                try:
                    rows = self._obey(order) or rows
                    _reply(query, b"", pb.PlayerState)
                except ValueError as error:
                    _refuse(query, str(error))
                except LogError as error:
                    _refuse(query, str(error))
                    raise
                order, query, client = self._orders.get_nowait()
        return rows

    def _obey(self, order: pb.PlayerOrder) -> list[Recorded]:
        """What is to be published at once. Raises ValueError in a person's words."""
        if order.kind == "open":
            self._load(order.run)
            return []
        player, now_s = self._player, self._clock()
        if player is None:
            raise ValueError("no run is open yet: choose one of the list")
        match order.kind:
            case "play":
                return player.play(now_s)
            case "pause":
                player.pause(now_s)
            case "seek":
                if not abs(order.at_s) < LATEST_S:  # also where it is no number
                    raise ValueError("no run is so long")
                return player.seek(round(order.at_s * 1e9), now_s)
            case "rate":
                player.set_rate(order.rate, now_s)
            case _:
                raise ValueError(f"{order.kind[:40]!r}: no order of a player")
        return []

    def _load(self, name: str) -> None:
        """Open a run in a thread of its own; another that is being opened is given up."""
        if name not in self._sources.names:
            raise ValueError(f"{name[:80]}: no such run in the list")
        if self._player is not None:
            self._player.pause(self._clock())
        self._loading += 1
        number = self._loading
        self._prepared = ("opening", 0.0)

        def progress(text: str, share: float) -> None:
            if self._stop.is_set() or number != self._loading:
                raise Stopped
            self._prepared = (text, share)

        def load() -> None:
            try:
                opened: OpenedRun | str = self._sources.open(name, progress)
            except Stopped:
                return
            except Exception as error:
                opened = _why(error, name)
            if number == self._loading:
                self._came.put(opened)

        self._start_beside(load)

    def _take_opened(self, opened: OpenedRun | str) -> list[Recorded]:
        self._prepared = ("", 0.0)
        if self._player is not None:
            self._jumps += self._player.jumps
            self._player.run.close()
        self._player, self._overview, self._places = None, b"", b""
        if isinstance(opened, str):
            self._jumps += 1
            self._state = pb.PlayerState(state=PlayState.FAILED, rate=1.0, jumps=self._jumps, text=opened)
            return []
        self._appear(opened.machine)
        self._player = player = RunPlayer(opened.run)
        self._overview, self._places = _overview(opened), _places(opened)
        self._state = pb.PlayerState(run=opened.name, text=opened.run.text)
        rows = player.seek(0, self._clock())
        player.play(self._clock())
        return rows

    def _say(self, rows: Sequence[Recorded]) -> None:
        """The state first: who hears it knows what the results after it belong to."""
        now_s, state, player = self._clock(), self._state, self._player
        was = (state.state, state.rate, state.jumps, state.text)
        text, share = self._prepared
        if player is not None:
            state.state, state.rate, state.jumps = player.state, player.rate, self._jumps + player.jumps
            state.at_s, state.length_s = player.at_ns(now_s) / 1e9, player.run.length_ns / 1e9
            state.t_ns, state.text = max(0, player.t_ns(now_s)), player.run.text
        state.ClearField("share")
        if text:
            state.state, state.text, state.share = PlayState.PREPARING, text, share
        changed = was != (state.state, state.rate, state.jumps, state.text)
        quiet_s = SAID_S if state.state in (PlayState.PLAYING, PlayState.PREPARING) else QUIET_S
        if changed or rows or now_s - self._said_s >= quiet_s:
            self._said_s = now_s
            self._said = state.SerializeToString()
            self._publisher.put(self._said)
        assert self._sink is not None
        for row in rows:
            self._sink.put(row.topic, row.data)

    # What follows runs in threads of Zenoh's.

    def _answer(self, query: zenoh.Query) -> None:
        assert self._sink is not None
        key = str(query.key_expr)
        match key.removeprefix(f"{self._sink.base}/player"):
            case "/order":
                self._take_order(query)
            case "/runs":  # many logs are looked into: others who ask are not to wait for it
                self._take_list(query)
            case "/overview":
                _reply(query, self._overview, pb.Places)
            case "/places":
                _reply(query, self._places, pb.Places)
            case _ if query.key_expr.intersects(self._publisher.key_expr):
                _reply(query, self._said, pb.PlayerState, self._publisher.key_expr)

    def _take_order(self, query: zenoh.Query) -> None:
        try:
            order = pb.PlayerOrder.FromString(query.payload.to_bytes() if query.payload is not None else b"")
        except DecodeError:
            _refuse(query, "this is no tilth.PlayerOrder")
            return
        client = asked_by(query, self._session)
        if refused := self._order_limiter.enter(client):
            _refuse(query, refused)
        else:
            self._orders.put((order, query, client))

    def _take_list(self, query: zenoh.Query) -> None:
        client = asked_by(query, self._session)
        if refused := self._list_limiter.enter(client):
            _refuse(query, refused)
        else:
            self._start_beside(self._list, query, client)

    def _list(self, query: zenoh.Query, client: str) -> None:
        listings = pb.RunListings()
        try:
            for row in self._sources.listings():
                if self._stop.is_set():
                    return
                listings.rows.append(row)
            _reply(query, listings.SerializeToString(), pb.RunListings)
        except OSError as error:
            _refuse(query, f"{error.filename or 'the logs'}: {reason_of(error)}")
        finally:
            self._list_limiter.leave(client)


def _why(error: Exception, run: str) -> str:
    """Why a run cannot be played, or not any further."""
    if isinstance(error, LogError | MachineError):
        return str(error)
    if isinstance(error, OSError):
        return f"{error.filename or run}: {reason_of(error)}"
    return f"{run}: cannot be played ({type(error).__name__}: {error})"


def _encoding(message: type[Message]) -> zenoh.Encoding:
    return zenoh.Encoding(f"application/protobuf;{message.DESCRIPTOR.full_name}")


def _reply(query: zenoh.Query, data: bytes, message: type[Message], key: zenoh.KeyExpr | None = None) -> None:
    with suppress(zenoh.ZError):  # who asked has gone
        query.reply(key or query.key_expr, data, encoding=_encoding(message), attachment="0")
        query.drop()


def _refuse(query: zenoh.Query, why: str) -> None:
    with suppress(zenoh.ZError):
        query.reply_err(why)
        query.drop()


def _overview(opened: OpenedRun) -> bytes:
    found = pb.Places(run=opened.name)
    for row in opened.run.overview:
        kind = row.topic.removeprefix("/")
        found.rows.add(at_s=row.at_ns / 1e9, kind=kind, data=row.data, t_ns=row.t_ns)
    return found.SerializeToString()


def _places(opened: OpenedRun) -> bytes:
    found = pb.Places(run=opened.name)
    for place in opened.run.places:
        found.rows.add(at_s=place.at_ns / 1e9, kind=place.kind, t_ns=place.t_ns, text=place.text)
    return found.SerializeToString()
