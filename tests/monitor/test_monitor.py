"""The page's server as browsers and strangers meet it, over real sockets. In a browser: test_page.py."""

import base64
import http.client
import ipaddress
import json
import math
import signal
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from itertools import pairwise
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
import zenoh
from client_daemon import until
from hypothesis import example, given, settings
from hypothesis import strategies as st
from loopback import PATIENCE_S, free_port, session
from stage import Monitor, Stage
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection

from tilth.cli import main
from tilth.monitor.addresses import network_addresses
from tilth.monitor.daemon_data import DaemonData
from tilth.monitor.history import MOST, RECENT_S, History
from tilth.monitor.json_safe import plain
from tilth.monitor.origin import refusal
from tilth.monitor.server import FILES, GIVEN_WAY, VIEWERS
from tilth.monitor.view import WAIT_S, View
from tilth.schemas.proto import tilth_pb2 as pb

BASE = "tilth/jd7930-parker500/replay"
Fields = dict[str, Any]


@pytest.fixture(scope="module")
def stage() -> Iterator[Stage]:
    with Stage() as one:
        yield one


@pytest.fixture(scope="module")
def monitor(stage: Stage) -> Iterator[Monitor]:
    with closing(Monitor("--connect", stage.endpoint)) as one:
        yield one


def hear(live: ClientConnection, wanted: Callable[[Fields], bool], known: Fields | None = None) -> Fields:
    """What a page would know as soon as that is so."""
    state: Fields = known or {}
    deadline = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline:
        message = json.loads(live.recv(timeout=PATIENCE_S))
        if "whole" in message:
            state.clear()
        events = state.get("events", []) + (message.get("new") or message["whole"]).pop("events", [])
        state |= message.get("new") or message["whole"]
        state["events"] = events
        if wanted(state):
            return state
    raise AssertionError(f"waited in vain; heard {sorted(state)}, {state.get('notes')}")


def test_a_page_that_opens_has_all_and_hears_what_is_new(stage: Stage, monitor: Monitor) -> None:
    with monitor.live() as live:
        wanted = {"rig", "pose", "status", "soil_tire"}
        state = hear(live, lambda s: wanted <= set(s) and s["age_s"]["pose"] < 1.0 and s["notes"] == [])
        assert state["machine"] == "jd7930-parker500" and state["simulated"] and state["alive"]
        assert state["rig"]["d"] == 3.62 and len(state["rig"]["antennas"]) == 4
        stage.order(event="mark", text="<img src=x onerror=alert(1)>\n")
        state = hear(live, lambda s: bool(s["events"]))
        assert state["events"][-1]["text"] == "<img src=x onerror=alert(1)> "
    with monitor.live() as live:  # a later one has what was before it
        state = hear(live, lambda s: True)
        assert state["events"] and len(state["track"]["t"]) == len(state["track"]["tractor"]) > 0
        assert set(map(len, state["estimates"].values())) == {len(state["estimates"]["t"])}


@pytest.mark.parametrize(("path", "file", "kind"), FILES)
def test_every_file_is_there_and_lets_nothing_in(monitor: Monitor, path: str, file: str, kind: str) -> None:
    status, body, headers = monitor.ask(path)
    assert status == 200 and body and headers["content-type"].startswith(kind)
    policy = headers["content-security-policy"]
    assert "default-src 'none'" in policy and "unsafe" not in policy
    assert "http://" not in body.replace("http://www.w3.org/2000/svg", "")
    if kind == "text/html":
        assert "<script>" not in body and "style=" not in body and " on" not in body.split("<body>")[0]


@pytest.mark.parametrize(
    ("path", "headers", "status"),
    [
        ("/nothing", {}, 404),
        ("/../server.py", {}, 404),
        ("/uplot/..%2f..%2fserver.py", {}, 404),
        ("/live", {}, 404),
        ("/mark", {}, 405),
        ("/", {"host": "evil.example"}, 403),
        ("/", {"origin": "http://evil.example"}, 403),
        ("/", {"host": ""}, 403),
        ("/", {"host": "["}, 400),
        ("/", {"host": "localhost:http"}, 400),
        ("/", {"origin": "http://["}, 400),
        ("/", {"origin": "localhost"}, 400),
    ],
)
def test_what_is_not_for_a_page_of_ours(
    monitor: Monitor, path: str, headers: dict[str, str], status: int
) -> None:
    assert monitor.ask(path, None, **headers)[0] == status


GOOD = st.sampled_from(["localhost", "127.0.0.1:80", "[::1]:8117", "http://localhost", "null", "file://"])
ODD = st.text(st.characters(blacklist_categories=["Cs", "Cc"]), max_size=20) | st.text(
    "[]:/@.x0 %", max_size=8
)


@settings(derandomize=True, max_examples=300, deadline=None)
@given(st.lists(GOOD | ODD, max_size=2), st.lists(GOOD | ODD, max_size=2))
def test_only_who_asks_for_this_computer_and_from_its_own_page_is_heard(
    hosts: list[str], origins: list[str]
) -> None:
    refused = refusal(hosts, origins, ("file://",))
    if refused is None:
        (host,) = hosts
        name = (urlsplit(f"//{host}").hostname or "").lower()
        assert name in ("localhost", socket.gethostname().lower()) or ipaddress.ip_address(name)
        assert origins in ([], ["file://"]) or urlsplit(origins[0]).netloc.lower() == host.lower()
    else:
        assert refused.status in (400, 403) and refused.why


def test_a_malformed_header_is_a_400_and_no_traceback(stage: Stage, tmp_path: Path) -> None:
    """Raw bytes, on the page and on its stream."""
    odd = (b"[", b"]", b"[::1", b"[::1]]", b"a b", b"localhost:", b"localhost:99x", b"user@localhost", b"a/b",
           b"\xff\xfe", b"http://[", b"%00", b"localhost, localhost", b"[v1.x]", b"\xe2\x80\xae")  # fmt: skip
    stream = b"Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: "
    stream += base64.b64encode(bytes(16)) + b"\r\n"
    with (tmp_path / "stderr").open("w+") as output:
        with closing(Monitor("--connect", stage.endpoint, stderr=output.fileno())) as one:
            here = one.address.encode()
            for path, more in ((b"/", b""), (b"/live", stream)):
                requested = [(b"Host: %b" % value, value) for value in odd]
                requested += [(b"Host: %b\r\nOrigin: %b" % (here, value), value) for value in odd]
                requested += [(b"Host: %b\r\nHost: evil.example" % here, b"two hosts"), (b"X: y", b"no host")]
                for head, value in requested:
                    request = b"GET %b HTTP/1.1\r\n%b\r\n%b\r\n" % (path, head, more)
                    assert raw_status(one.address, request) == 400, (path, head, value)
                good = b"GET %b HTTP/1.1\r\nHost: %b\r\n%b\r\n" % (path, here, more)
                assert raw_status(one.address, good) in (101, 200)
        output.seek(0)
        assert output.read() == ""


def raw_status(address: str, request: bytes) -> int:
    host, _, port = address.rpartition(":")
    with socket.create_connection((host, int(port)), timeout=PATIENCE_S) as raw:
        raw.sendall(request)
        return int(raw.recv(100).split()[1])


def test_a_page_for_the_networks_says_its_addresses_and_who_may_mark(stage: Stage) -> None:
    ours = network_addresses()
    with closing(Monitor("--connect", stage.endpoint, "--host", "0.0.0.0")) as one:
        assert one.process.stdout is not None
        messages = [one.url, *(one.process.stdout.readline().strip() for _ in range(max(len(ours), 1)))]
        port = one.url.rstrip("/").rpartition(":")[2]
        assert messages[:-1] == [f"http://{address}:{port}/" for address in ours or ["127.0.0.1"]]
        assert "everybody" in messages[-1] and "may see the page and mark" in messages[-1]
        assert one.ask("/")[0] == 200  # by that very address


def test_a_page_from_elsewhere_hears_nothing_and_marks_nothing(monitor: Monitor) -> None:
    with pytest.raises(InvalidStatus, match="403"), monitor.live(origin="http://evil.example"):
        pass
    assert monitor.ask("/mark", b"{}", origin="null", content_type="application/json")[0] == 403


def test_a_mark_is_confirmed_by_the_daemon_or_not_there(stage: Stage, monitor: Monitor) -> None:
    with monitor.live() as live:
        assert monitor.mark("wet  spot\nbegins ü") == {"noted": True, "text": "in the log"}
        state = hear(live, lambda s: bool(s["events"]) and "wet" in s["events"][-1]["text"])
        assert state["events"][-1]["kind"] == "mark"
        assert state["events"][-1]["text"] == "wet spot begins ü"
        stage.order(refusal="the disk is full")
        until(lambda: monitor.mark("again") == {"noted": False, "text": "the disk is full"})
        stage.order(refusal="")
    for text, words in (("", "write something"), (" \n", "write something"), (7, "write something"),
                        ("ü" * 513, "1026 bytes"), ("x" * 10_000, "too long")):  # fmt: skip
        result = monitor.mark(text)
        assert not result["noted"] and words in result["text"]
    for data in (b"", b"[]", b"{", b"[" * 5000, b"\xff"):
        assert monitor.ask("/mark", data, content_type="application/json")[0] == 400
    assert "as JSON" in monitor.mark("x", content_type="text/plain")["text"]


def test_what_has_been_found_moved_is_shown_and_accepted(stage: Stage, monitor: Monitor) -> None:
    stage.order(moved=["tractor_front", "pair_tractor"])
    with monitor.live() as live:
        state = hear(live, lambda s: bool(s.get("status", {}).get("moved")))
        assert state["status"]["moved"][0]["names"] == ["tractor_front", "pair_tractor"]
        for name, noted, words in (
            ("tractor_rear", False, "tractor_rear has not been found moved"),
            ("tractor_front", True, "in the log"),
        ):
            data = json.dumps({"text": name}).encode()
            said = json.loads(monitor.ask("/accept", data, content_type="application/json")[1])
            assert said == {"noted": noted, "text": words}
        hear(live, lambda s: "status" in s and not s["status"].get("moved"))


def test_a_mark_of_ten_megabytes_is_not_even_read(monitor: Monitor) -> None:
    host, _, port = monitor.address.rpartition(":")
    with socket.create_connection((host, int(port)), timeout=PATIENCE_S) as raw:
        head = f"POST /mark HTTP/1.1\r\nHost: {monitor.address}\r\nContent-Type: application/json\r\n"
        raw.sendall(f"{head}Content-Length: 10000000\r\n\r\n".encode())
        raw.sendall(b'{"text":"' + b"x" * 100_000)
        assert b"400" in raw.recv(100)
    assert monitor.ask("/")[0] == 200


def test_browsers_that_go_in_mid_stream_and_those_too_many(monitor: Monitor) -> None:
    for _ in range(5):
        with monitor.live() as live:
            live.recv()
            live.socket.shutdown(socket.SHUT_RDWR)
    with ExitStack() as several:
        pages = [several.enter_context(monitor.live()) for _ in range(VIEWERS + 1)]
        assert "whole" in json.loads(pages[-1].recv(timeout=PATIENCE_S))  # the driver's, opened last
        with pytest.raises(ConnectionClosed) as closed:
            while True:
                pages[0].recv(timeout=PATIENCE_S)
        last = closed.value.rcvd
        assert last is not None and (last.code, last.reason) == GIVEN_WAY
        assert monitor.mark("the driver's") == {"noted": True, "text": "in the log"}
    with monitor.live() as live:
        live.send("anything")
        hear(live, lambda s: True)


def test_hostile_payloads_are_counted_and_said(stage: Stage, monitor: Monitor) -> None:
    broken = pb.Pose(t_ns=1, origin_latitude_deg=math.nan)
    broken.tractor.x = math.inf
    pose = zenoh.Encoding("application/protobuf;tilth.Pose")
    with session([stage.endpoint]) as stranger, monitor.live() as live:
        state = hear(live, lambda s: True)
        for key, data, encoding, words in (
            (f"{BASE}/status", b"<script>", zenoh.Encoding("text/html"), "encoding is 'text/html'"),
            (f"{BASE}/<script>alert(1)<!script>", b"x", pose, "where nothing is expected"),
            (f"{BASE}/*", b"x" * 1000, pose, "where nothing is expected"),
            (f"{BASE}/event", b"x" * 1_000_000, pose, "bytes are too many"),
        ):

            def said(
                s: Fields, key: str = key, data: bytes = data, e: Any = encoding, w: str = words
            ) -> bool:
                stranger.put(key, data, encoding=e, congestion_control=zenoh.CongestionControl.BLOCK)
                return any(w in note for note in s["notes"])

            state = hear(live, said, state)
        stranger.put(f"{BASE}/pose", broken.SerializeToString(), encoding=pose)
        stage.order(event="mark", text="after")
        hear(live, lambda s: any(event["text"] == "after" for event in s["events"]), state)
        assert monitor.process.poll() is None


def test_a_first_word_is_waited_for_before_anything_is_said_to_be_wrong() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port(socket.SOCK_STREAM)}"
    with closing(DaemonData(endpoint, None, "tilth", "", False)) as received:
        view = View(received, endpoint)
        for now_s in (100.0, 100.0 + WAIT_S - 0.1):
            output = json.loads(view.turn(now_s).text)["new"]
            assert output["waiting"] and output["notes"] == []
        output = json.loads(view.turn(100.0 + WAIT_S).text)["new"]
        assert not output["waiting"] and "No daemon is heard" in output["notes"][0]


def test_a_daemon_that_is_not_there_comes_goes_and_comes_again_as_another_version() -> None:
    port = free_port(socket.SOCK_STREAM)
    with closing(Monitor("--connect", f"tcp/127.0.0.1:{port}")) as monitor, monitor.live() as live:
        state = hear(live, lambda s: s["waiting"])
        assert state["notes"] == [] and state["machine"] == ""
        assert monitor.mark("x")["text"].startswith("no daemon has been heard yet")
        with Stage(port) as first:
            state = hear(live, lambda s: s["alive"] and "pose" in s and not s["waiting"], state)
            first.kill()
        state = hear(live, lambda s: not s["alive"], state)
        assert "does not answer" in state["notes"][0]
        with Stage(port) as second:
            second.order(version="9.9.9")
            state = hear(live, lambda s: s["alive"] and any("9.9.9" in note for note in s["notes"]), state)
        assert monitor.process.poll() is None


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--connect", "nonsense"], "one looks like"),
        (["--port", "99999"], "from 0 to 65535"),
        (["--host", "203.0.113.9"], "give another --port or --host"),
        (["--machine", "**"], "its name in the machine file"),
        (["--prefix", "a/*"], "the prefix in the machine file"),
    ],
)
def test_wrong_use_is_told_in_one_line(
    words: list[str], expected: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["monitor", "--port", "0", *words]) == 2
    error = capsys.readouterr().err
    assert expected in error and error.count("\n") == 1


def test_a_port_that_is_taken(monitor: Monitor, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["monitor", "--port", monitor.address.rpartition(":")[2]]) == 2
    assert "give another --port" in capsys.readouterr().err


def test_it_ends_as_it_is_meant_to(stage: Stage) -> None:
    one = Monitor("--connect", stage.endpoint)
    with one.live() as live:
        live.recv(timeout=PATIENCE_S)
        one.process.send_signal(signal.SIGINT)
        assert one.process.wait(PATIENCE_S) == 0
    one.process.communicate()


def test_eight_hours_stay_few_rows_the_last_minutes_whole() -> None:
    history, thinned = History(), 0
    for second in range(8 * 3600):
        thinned += history.add((float(second), second))
        assert len(history.rows) <= MOST
    times = [row[0] for row in history.rows]
    assert times == sorted(times) and times[0] == 0.0 and thinned < 60
    assert times[-int(RECENT_S) :] == [float(s) for s in range(8 * 3600 - int(RECENT_S), 8 * 3600)]
    gaps = [b - a for a, b in pairwise(times)]
    assert max(gaps) <= 2 * history.every_s <= 64


@settings(derandomize=True, max_examples=50, deadline=None)
@given(st.lists(st.floats(0, 1e4), max_size=60))
def test_rows_are_in_order_whatever_comes_and_the_last_is_there(times: list[float]) -> None:
    history = History(most=8, recent_s=5.0)
    for at in times:
        history.add((at,))
        held = [row[0] for row in history.rows]
        assert held == sorted(held) and held[-1] == at and len(held) <= 8


def test_a_message_becomes_what_json_can_hold() -> None:
    status = pb.Status(version="1\n\x1b[2J", uptime_s=math.nan, problems=["x" * 9999] * 100)
    status.wheel_angle.state = "alive"
    result = plain(status)
    json.dumps(result, allow_nan=False)
    assert (
        result["version"] == "1  [2J" and result["uptime_s"] is None and result["wheel_angle"]["per_s"] == 0.0
    )
    assert len(result["problems"]) == 64 and len(result["problems"][0]) == 500
    assert "disk_free_bytes" not in result
    assert plain(pb.Pose())["flags"] == []


LEAVES = (
    st.none() | st.booleans() | st.floats() | st.integers() | st.integers(-(10**4000), 10**4000)
    | st.text(st.characters(exclude_categories=()), max_size=20)
    | st.sampled_from(["open", "play", "pause", "seek", "rate", "arm", "skip", "a" * 2000, "\ud800", "\0"])
)  # fmt: skip
NAMES = st.sampled_from(["text", "order", "run", "at_s", "rate", "kind"])
ANYTHING = st.recursive(
    LEAVES, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(NAMES, inner), max_leaves=5
)
BODIES = (
    st.dictionaries(NAMES, ANYTHING, max_size=4).map(lambda one: json.dumps(one).encode())
    | ANYTHING.map(lambda one: json.dumps(one).encode())
    | st.binary(max_size=60)
    | st.sampled_from(
        [b'{"a":' * 1500, b'{"rate": ' + b"9" * 4000 + b"}", b'{"text": "\\ud800"}', b'{"rate": 1e999}']
    )
)
POSTS = ("/mark", "/accept", "/implement", "/player", "/experiment", "/calibration", "/report")


@settings(max_examples=60, deadline=None)
@given(path=st.sampled_from(POSTS), body=BODIES)
@example("/mark", b'{"text": "\\ud800"}')
@example("/accept", b'{"text": "\\ud800"}')
@example("/player", b'{"order": "open", "run": "\\udfff"}')
@example("/player", b'{"order": "rate", "rate": ' + b"7" * 4000 + b"}")
@example("/experiment", b'{"kind": "\\ud800"}')
@example("/experiment", b'{"kind": ' + b"7" * 4000 + b"}")
@example("/calibration", b'{"kind": {"a": []}}')
def test_nothing_that_is_sent_is_a_fault_of_the_server(monitor: Monitor, path: str, body: bytes) -> None:
    status, text, _ = monitor.ask(path, body, content_type="application/json")
    said = json.loads(text)
    assert status in (200, 400) and isinstance(said["text"], str)
    assert status == 200 or said["text"]


@settings(max_examples=30, deadline=None)
@given(
    path=st.text(st.characters(min_codepoint=33, max_codepoint=126, exclude_characters="#"), max_size=30),
    method=st.sampled_from(["GET", "POST", "PUT", "HEAD", "DELETE", "OPTIONS"]),
    kind=st.text(st.characters(min_codepoint=32, max_codepoint=126), max_size=20),
)
def test_no_address_is_a_fault_of_the_server(monitor: Monitor, path: str, method: str, kind: str) -> None:
    host, _, port = monitor.address.rpartition(":")
    with closing(http.client.HTTPConnection(host, int(port), timeout=PATIENCE_S)) as connection:
        connection.request(method, f"/{path}", b"{}", {"content-type": kind})
        assert connection.getresponse().status < 500
