"""A player on Zenoh: what is heard of it, and that it does what it is told. Real sessions over TCP."""

import os
import queue
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import zenoh
from client_daemon import until
from hypothesis import given, settings
from hypothesis import strategies as st
from logs import MACHINE
from loopback import PATIENCE_S, session
from recorded_run import MARKS, SECOND, START_NS, write_run

from tilth.logger.zenoh.session import free_endpoint, open_session
from tilth.replay.catalogue import listing, run_files
from tilth.replay.player import PlayState
from tilth.replay.player_service import MOST_LISTS, PlayerService, Sources
from tilth.replay.prepared import Opening
from tilth.replay.readers.log import EmptyLog
from tilth.schemas.machine import Zenoh
from tilth.schemas.proto import tilth_pb2 as pb

OTHER = "another-rig"
BASE = f"tilth/{MACHINE.name}/replay"
KINDS: dict[str, Any] = {
    "player": pb.PlayerState,
    "pose": pb.Pose,
    "soil_tire": pb.SoilTireEstimate,
    "event": pb.Event,
}


class Heard:
    """A stranger who hears a player and gives orders."""

    def __init__(self, other: zenoh.Session) -> None:
        self.other = other
        self.rows: list[tuple[str, Any]] = []
        self._subscriber = other.declare_subscriber("tilth/*/replay/*", self._take)

    def _take(self, sample: zenoh.Sample) -> None:
        kind = str(sample.key_expr).rpartition("/")[2]
        if kind in KINDS:
            self.rows.append((str(sample.key_expr), KINDS[kind].FromString(sample.payload.to_bytes())))

    def last(self, kind: str, machine: str = MACHINE.name) -> Any:
        key = f"tilth/{machine}/replay/{kind}"
        return next((message for heard, message in reversed(self.rows) if heard == key), None)

    @property
    def state(self) -> pb.PlayerState:
        return self.last("player") or pb.PlayerState()

    def order(self, kind: str, base: str = BASE, **fields: Any) -> str:
        order = pb.PlayerOrder(kind=kind, **fields)
        for reply in self.other.get(
            f"{base}/player/order", payload=order.SerializeToString(), timeout=PATIENCE_S
        ):
            return refused(reply)
        return "no answer"

    def asked_event(self) -> pb.Event:
        """The last one that was published, whether it was heard or not."""
        for reply in self.other.get(f"{BASE}/event", timeout=PATIENCE_S):
            if reply.ok is not None:
                return pb.Event.FromString(reply.ok.payload.to_bytes())
        return pb.Event()

    def ask(self, what: str, message: Any, base: str = BASE) -> Any:
        (reply,) = self.other.get(f"{base}/player/{what}".rstrip("/"), timeout=PATIENCE_S)
        assert reply.ok is not None
        assert str(reply.ok.encoding) == f"application/protobuf;tilth.{message.DESCRIPTOR.name}"
        return message.FromString(reply.ok.payload.to_bytes())


def refused(reply: zenoh.Reply) -> str:
    return "" if reply.err is None else reply.err.payload.to_string()


def alive(other: zenoh.Session) -> list[str]:
    return [str(reply.ok.key_expr) for reply in other.liveliness().get("tilth/**/alive") if reply.ok]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs")
    write_run(folder, 120.0)
    write_run(folder, 30.0, name=OTHER)
    return folder


Start = Callable[..., Heard]


@pytest.fixture
def start(folder: Path, tmp_path: Path) -> Iterator[Start]:
    with ExitStack() as stack:

        def started(
            play: bool = True,
            slow: bool = False,
            more: Path | None = None,
            hold: threading.Event | None = None,
        ) -> Heard:
            runs = {run.name: run for run in run_files([folder, *([more] if more else [])])}
            opening = Opening(tmp_path, "tilth")

            def open_it(name: str, progress: Callable[[str, float], None]) -> Any:
                if name == "broken":
                    raise EmptyLog("broken.mcap: no frame is in it")
                while slow:
                    progress("reading the run", 0.25)
                    time.sleep(0.001)
                return opening.open(runs[name], progress)

            rows = [listing(run) for run in runs.values()]

            def listings() -> Iterator[pb.RunListing]:
                if hold is not None:
                    hold.wait(PATIENCE_S)
                return iter(rows)

            sources = Sources((*runs, "broken"), open_it, listings)
            endpoint = free_endpoint("tcp/127.0.0.1:0")
            here = MACHINE.model_copy(update={"zenoh": Zenoh(listen=[endpoint])})
            own, _, _ = open_session(here)
            stack.callback(own.close)
            heard = Heard(stack.enter_context(session([endpoint])))
            service = PlayerService(own, MACHINE, sources, time.monotonic)
            stack.callback(service.close)
            service.start(
                opening.open(runs[name_of(MACHINE.name)], lambda text, share: None) if play else None
            )
            until(lambda: heard.state.state != "")
            return heard

        yield started


def name_of(machine: str) -> str:
    return f"{machine}_20261121T080000Z"


def test_what_is_played_is_heard_under_the_prefix_of_replays(start: Start) -> None:
    heard = start()
    until(lambda: heard.last("pose") is not None and heard.state.state == PlayState.PLAYING)
    state = heard.state
    assert (state.run, state.length_s, state.rate) == (name_of(MACHINE.name), 120.0, 1.0)
    until(lambda: heard.last("pose").t_ns > START_NS + SECOND // 2)
    t_ns = [message.t_ns for key, message in heard.rows if key.endswith("/pose")]
    assert t_ns == sorted(t_ns) and all(key.startswith(f"{BASE}/") for key, _ in heard.rows)
    assert alive(heard.other) == [f"{BASE}/alive"]


def _are_there(heard: Heard, t_ns: dict[str, int]) -> bool:
    found = {kind: heard.last(kind) for kind in t_ns}
    return all(found[kind] is not None and found[kind].t_ns == at_ns for kind, at_ns in t_ns.items())


def _stands(heard: Heard, jumps: int, at_s: float) -> bool:
    return (heard.state.jumps, heard.state.at_s) == (jumps, at_s)


def test_a_jump_gives_the_values_of_its_time_at_once_and_in_order(start: Start) -> None:
    heard = start()
    until(lambda: heard.state.state == PlayState.PLAYING)
    assert heard.order("pause") == ""
    until(lambda: heard.state.state == PlayState.PAUSED)
    for at_s in (75.0, 31.25):
        jumps = heard.state.jumps + 1
        assert heard.order("seek", at_s=at_s) == ""
        t_ns = {"pose": START_NS + int(10 * at_s) * SECOND // 10, "soil_tire": START_NS + int(at_s) * SECOND}
        until(partial(_are_there, heard, t_ns))
        until(partial(_stands, heard, jumps, at_s))
        kinds = [(key.rpartition("/")[2], getattr(message, "jumps", 0)) for key, message in heard.rows]
        assert ("pose", 0) in kinds[kinds.index(("player", jumps)) :]
    value = heard.last("soil_tire").parameters[0].value
    assert value == pytest.approx(215e3, rel=0.05)
    assert heard.order("rate", rate=50.0) == "" and heard.order("play") == ""
    until(lambda: heard.state.state == PlayState.ENDED)
    assert heard.state.at_s == 120.0
    # An event is published once, and a busy network may drop it: who missed it asks.
    until(lambda: heard.asked_event().text == MARKS[-1][1])


def test_what_holds_where_it_stands_is_said_again(start: Start) -> None:
    heard = start()
    until(lambda: heard.state.state == PlayState.PLAYING)
    assert heard.order("pause") == "" and heard.order("seek", at_s=50.0) == ""
    t_ns = {"pose": START_NS + 50 * SECOND, "soil_tire": START_NS + 50 * SECOND}
    for _ in range(2):
        heard.rows.clear()
        until(partial(_are_there, heard, t_ns))


@pytest.mark.parametrize(
    ("order", "why"),
    [
        ({"kind": "rate", "rate": 1000.0}, "give 1 to 100 times real time"),
        ({"kind": "seek", "at_s": float("nan")}, "no run is so long"),
        ({"kind": "jump"}, "no order of a player"),
        ({"kind": "open", "run": "none"}, "no such run in the list"),
    ],
)
def test_an_order_that_makes_no_sense_is_refused(start: Start, order: dict[str, Any], why: str) -> None:
    heard = start()
    until(lambda: heard.state.run != "")
    assert why in heard.order(**order)
    bad = heard.other.get(f"{BASE}/player/order", payload=b"\xff", timeout=PATIENCE_S)
    assert [*map(refused, bad)] == ["this is no tilth.PlayerOrder"]


def test_its_runs_and_places_can_be_asked_for(start: Start) -> None:
    heard = start()
    until(lambda: heard.state.run != "")
    runs = heard.ask("runs", pb.RunListings).rows
    assert {run.name: round(run.length_s) for run in runs} == {name_of(MACHINE.name): 120, name_of(OTHER): 30}
    assert all(run.learned.parameters[0].value > 0 for run in runs)
    places = heard.ask("places", pb.Places)
    assert places.run == name_of(MACHINE.name)
    assert [(row.at_s, row.text) for row in places.rows if row.kind == "mark"] == list(MARKS)
    overview = heard.ask("overview", pb.Places)
    assert {row.kind for row in overview.rows} == {"pose", "soil_tire", "event"}
    late = heard.ask("", pb.PlayerState)  # the last state, for who comes later
    assert late.run == name_of(MACHINE.name)


def test_another_run_is_opened_under_the_name_of_its_own_machine(start: Start) -> None:
    heard = start(play=False)
    assert heard.state.state == PlayState.IDLE
    assert "no run is open yet" in heard.order("play")
    assert heard.order("open", run=name_of(OTHER)) == ""
    until(lambda: heard.last("pose", OTHER) is not None and heard.last("player", OTHER) is not None)
    until(lambda: heard.last("player", OTHER).run == name_of(OTHER))
    until(lambda: alive(heard.other) == [f"tilth/{OTHER}/replay/alive"])
    assert heard.order("open", f"tilth/{OTHER}/replay", run=name_of(MACHINE.name)) == ""
    until(lambda: heard.state.run == name_of(MACHINE.name))


def test_what_it_starts_is_waited_for_at_the_end(start: Start) -> None:
    """A daemon thread of Zenoh's that comes back to Python while the interpreter ends aborts the process."""
    before = set(threading.enumerate())
    heard = start()
    until(lambda: heard.last("pose") is not None)
    started = set(threading.enumerate()) - before
    assert {"tilth.player"} < {thread.name for thread in started}
    assert [thread.name for thread in started if thread.daemon] == []


def test_a_run_that_cannot_be_opened_is_told(start: Start) -> None:
    heard = start(play=False)
    assert heard.order("open", run="broken") == ""
    until(lambda: heard.state.state == PlayState.FAILED)
    assert heard.state.text == "broken.mcap: no frame is in it" and heard.state.run == ""


def test_what_is_prepared_is_told_and_can_be_given_up(start: Start) -> None:
    heard = start(play=False, slow=True)
    assert heard.order("open", run=name_of(MACHINE.name)) == ""
    until(lambda: heard.state.state == PlayState.PREPARING and heard.state.share == 0.25)
    assert heard.state.text == "reading the run"


def _truncated(path: Path) -> None:
    os.truncate(path, 100)


def _zeroed(path: Path) -> None:
    path.write_bytes(bytes(path.stat().st_size))


def _another_run(path: Path) -> None:
    """One of the same length: its records may even stand where the others did."""
    (other,) = write_run(path.parent / "new", 120.0, start_ns=START_NS + 7 * SECOND)
    path.write_bytes(other.read_bytes())


def _pulled_out(path: Path) -> None:
    """What the kernel reads then ends in an error, here that it is a folder."""
    folder = os.open(path.parent, os.O_RDONLY)
    for one in Path("/proc/self/fd").iterdir():
        with suppress(OSError):
            if one.readlink() == path:
                os.dup2(folder, int(one.name))
    os.close(folder)


@pytest.mark.parametrize("lose", [_truncated, _zeroed, _another_run, _pulled_out])
@pytest.mark.parametrize("stands", [False, True])
def test_a_log_that_is_lost_while_it_plays_ends_it_with_a_sentence(
    lose: Callable[[Path], None], stands: bool, start: Start, tmp_path: Path
) -> None:
    (tmp_path / "new").mkdir()
    (log,) = write_run(tmp_path, 120.0, start_ns=START_NS + 3600 * SECOND)
    copy = log.rename(tmp_path / "lost.mcap")
    heard = start(play=False, more=copy)
    assert heard.order("open", run="lost") == ""
    until(lambda: heard.state.state == PlayState.PLAYING)
    if stands:
        assert heard.order("pause") == ""
    lose(copy)
    for at_s in (100.0, 50.0, 110.0):
        why = heard.order("rate", rate=100.0) or heard.order("seek", at_s=at_s)
        if why:
            break
    until(lambda: heard.state.state == PlayState.FAILED)
    lost = f"{copy}: changed since it was opened, or not there any more; open the run again"
    assert heard.state.text == lost and why in (lost, "no run is open yet: choose one of the list")
    assert heard.order("open", run=name_of(MACHINE.name)) == ""  # and it goes on
    until(lambda: heard.state.state == PlayState.PLAYING)


def test_a_flood_of_queries_starts_few_threads_and_each_is_answered(start: Start) -> None:
    gate = threading.Event()
    heard = start(play=False, hold=gate)
    replies: queue.SimpleQueue[str] = queue.SimpleQueue()
    for _ in range(150):
        heard.other.get(f"{BASE}/player/runs", lambda reply: replies.put(refused(reply)), timeout=PATIENCE_S)
    said = [replies.get(timeout=PATIENCE_S) for _ in range(150 - MOST_LISTS // 2)]
    beside = [thread for thread in threading.enumerate() if thread.name == "tilth.beside"]
    assert len(beside) == MOST_LISTS // 2
    assert all("too many lists of runs at a time from" in one for one in said)
    gate.set()
    assert [replies.get(timeout=PATIENCE_S) for _ in range(MOST_LISTS // 2)] == [""] * (MOST_LISTS // 2)
    until(lambda: not any(thread.name == "tilth.beside" for thread in threading.enumerate()))
    assert len(heard.ask("runs", pb.RunListings).rows) == 2


def test_no_order_goes_without_an_answer(start: Start) -> None:
    heard = start(play=False)
    runs = st.text(st.characters(exclude_categories=["Cs"]), max_size=20)
    kinds = st.sampled_from(["open", "play", "pause", "seek", "rate", "x"]) | runs
    orders = st.builds(pb.PlayerOrder, kind=kinds, run=runs, at_s=st.floats(), rate=st.floats())

    @settings(max_examples=25, deadline=None)
    @given(st.binary(max_size=40) | orders.map(lambda order: order.SerializeToString()))
    def answered(payload: bytes) -> None:
        (reply,) = heard.other.get(f"{BASE}/player/order", payload=payload, timeout=PATIENCE_S)
        assert reply.ok is not None or refused(reply)

    answered()
