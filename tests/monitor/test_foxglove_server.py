"""`tilth foxglove` between processes: a real daemon, the server, a client that knows only the protocol."""

import base64
import signal
import socket
import subprocess
import sys
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from ipaddress import ip_address
from pathlib import Path
from typing import Any

import pytest
import zenoh
from client_daemon import Publisher, until
from field_rig import FieldRig
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_viewer import viewer_at
from loopback import PATIENCE_S, messages, session

from tilth.cli import main
from tilth.client.link import open_session
from tilth.schemas.channels import CHANNEL, CHANNELS
from tilth.schemas.proto import tilth_pb2 as pb

pytest.importorskip("foxglove", reason="the extra foxglove is not installed")
from tilth.monitor.door import hidden_host
from tilth.monitor.foxglove_server import FoxgloveServer

BASE = "tilth/jd7930-parker500"
WANTED = (
    "/pose", "/drawing/frames", "/drawing/bodies", "/gnss/tractor_front", "/soil_tire", "/status",
)  # fmt: skip


@contextmanager
def server(*words: str) -> Iterator[tuple[str, "subprocess.Popen[str]"]]:
    """Its address and process; fails where it does not end as it should."""
    code = f"import sys; from tilth.cli import main; sys.exit(main({('foxglove', '--port', '0', *words)!r}))"
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        yield process.stdout.readline().split()[0], process
    finally:
        process.kill()
        process.communicate()


@pytest.mark.long
def test_a_viewer_has_what_the_daemon_publishes(tmp_path: Path) -> None:
    with closing(FieldRig(tmp_path, 240.0)) as rig, server("--connect", rig.endpoint) as (address, process):
        assert address.startswith("ws://127.0.0.1:")
        rig.start()
        other = _opened(rig)
        published = _listener(other)
        until(
            lambda: all(published()[t] for t in WANTED)
        )  # what a viewer hears from now on, this one does too
        with viewer_at(address) as wild:
            wild.misbehave()
        with viewer_at(address) as viewer:
            viewer.hear_until(lambda: len(viewer.channels) == len(_served()))
            assert viewer.info["name"] == "tilth" and "time" in viewer.info["capabilities"]
            assert {t: row["schemaName"] for t, row in viewer.channels.items()} == _served()
            viewer.subscribe(*WANTED)
            viewer.hear_until(
                lambda: all(viewer.heard[topic] for topic in WANTED) and len(viewer.heard["/pose"]) > 10
            )
            poses = {pose.t_ns: pose for pose in viewer.decoded("/pose")}
            frames = viewer.decoded("/drawing/frames")
            assert viewer.times == sorted(viewer.times) and len(viewer.times) > 3
        assert [t_ns for t_ns, _ in viewer.heard["/pose"]] == [*poses]
        for message in frames[1:-1]:  # what is at either end may have come without its pose
            first = message.transforms[0]
            body = poses[first.timestamp.ToNanoseconds()].tractor
            assert (first.translation.y, first.translation.x) == (body.x, body.y)
        other.close()
        process.send_signal(signal.SIGTERM)
        assert process.stdout is not None
        out = process.stdout.read()
        assert process.wait(PATIENCE_S) == 0
        assert f"hears {BASE}" in out and "foxglove/tilth.json" in out and "foxglove/experiment.json" in out
        rig.stop()
        # By the log, which loses nothing: a listener of the test's own may miss some on a busy computer.
        for topic, logged in _logged(rig.folder).items():
            assert {data for _, data in viewer.heard[topic]} <= logged, topic


@pytest.mark.parametrize(
    ("origin", "host", "status"),
    [
        (None, None, 101),  # a program that is no browser
        ("file://", None, 101),  # a viewer with a window of its own
        ("https://viewer.example", None, 101),  # allowed below
        ("https://VIEWER.example", None, 101),
        ("https://evil.example", None, 403),
        ("http://viewer.example", None, 403),
        ("null", None, 403),
        ("http://localhost:8080", None, 403),
        (None, "evil.example", 403),  # a name of somebody's that points here
        ("http://[", None, 400),
        (None, "[", 400),
    ],
)
def test_a_viewer_of_another_origin_is_refused_as_by_the_page(
    guarded: tuple[int, list[str]], origin: str | None, host: str | None, status: int
) -> None:
    port, refused = guarded
    refused.clear()
    headers = [f"Host: {host or f'127.0.0.1:{port}'}", *([f"Origin: {origin}"] if origin else [])]
    assert status_of(port, headers) == status
    assert refused == ([] if status == 101 else [origin or ""])


def test_what_is_no_request_ends(guarded: tuple[int, list[str]]) -> None:
    port, _ = guarded
    for nonsense in (b"\r\n\r\n", b"\xff" * 100_000, b"GET / HTTP/1.1\r\n" + b"X: y\r\n" * 9000):
        with socket.create_connection(("127.0.0.1", port), PATIENCE_S) as raw, suppress(ConnectionError):
            raw.sendall(nonsense)
            assert b"400" in raw.recv(100)
    assert status_of(port, [f"Host: localhost:{port}"]) == 101


def test_the_server_behind_is_on_no_address_that_a_page_could_guess() -> None:
    drawn = {hidden_host() for _ in range(50)}
    assert len(drawn) > 40 and all(ip_address(host).is_loopback for host in drawn)


@pytest.fixture(scope="module")
def guarded() -> Iterator[tuple[int, list[str]]]:
    refused: list[str] = []
    server = FoxgloveServer(
        "127.0.0.1", 0, ["https://viewer.example"], lambda refusal, origin: refused.append(origin)
    )
    yield server.port, refused
    server.stop()


def status_of(port: int, headers: list[str]) -> int:
    """The status that a handshake with these headers is answered with."""
    key = base64.b64encode(bytes(16)).decode()
    lines = ["GET / HTTP/1.1", *headers, "Upgrade: websocket", "Connection: Upgrade"]
    lines += [
        "Sec-WebSocket-Version: 13",
        f"Sec-WebSocket-Key: {key}",
        "Sec-WebSocket-Protocol: foxglove.sdk.v1",
    ]
    with socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S) as raw:
        raw.sendall("\r\n".join([*lines, "", ""]).encode())
        return int(raw.recv(100).split()[1])


@pytest.mark.parametrize(
    ("topic", "data", "encoding", "expected"),
    [
        ("/pose", b"\xff\xff", "", "not a Pose"),
        ("/pose", b"x" * 100_000, "", "too many bytes"),
        ("/pose", pb.Pose(t_ns=1).SerializeToString(), "text/plain", "its encoding is not application/"),
        ("/pose", b"", "", "without a time"),
        ("/drawing/frames", b"", "", "without a time"),
        ("/drawing/bodies", SceneUpdate(entities=[SceneEntity()]).SerializeToString(), "", "without a time"),
        ("/status", pb.Status(t_ns=2**64 - 1).SerializeToString(), "", "without a time"),
    ],
)
def test_what_is_no_message_is_refused(
    serving: tuple[FoxgloveServer, zenoh.Session], topic: str, data: bytes, encoding: str, expected: str
) -> None:
    server, ours = serving
    served, refused = server.served, server.refused.total()
    ours.put(f"{BASE}{topic}", data, encoding=encoding or CHANNEL[topic].encoding)
    until(lambda: server.refused.total() == refused + 1)
    assert [*server.refused][-1].startswith(f"{topic}: {expected}")
    ours.put(f"{BASE}/pose", pb.Pose(t_ns=5).SerializeToString(), encoding=CHANNEL["/pose"].encoding)
    until(lambda: server.served == served + 1)


@pytest.fixture
def serving() -> Iterator[tuple[FoxgloveServer, zenoh.Session]]:
    """A server that hears its own session."""
    with open_session("tcp/127.0.0.1:1") as ours:
        server = FoxgloveServer("127.0.0.1", 0)
        server.follow(ours, BASE)
        yield server, ours
        server.stop()


def _served() -> dict[str, str]:
    rows = [row for row in CHANNELS if row.key is not None and row.logged]
    return {row.topic: row.message.DESCRIPTOR.full_name for row in rows} | {
        "/experiment": "tilth.ExperimentPrompt"
    }


def _logged(folder: Path) -> dict[str, set[bytes]]:
    """All that a daemon logged on the topics WANTED."""
    logged: dict[str, set[bytes]] = {topic: set() for topic in WANTED}
    for path in folder.rglob("*.mcap"):
        with messages(path) as rows:
            for channel, message in rows:
                if channel.topic in logged:
                    logged[channel.topic].add(message.data)
    return logged


def _listener(session: Any) -> Callable[[], dict[str, list[bytes]]]:
    """What was published on each topic until now.

    It is kept outside of Python: the daemon leaves out messages for a listener that is slow."""
    subscriber = session.declare_subscriber(f"{BASE}/**", zenoh.handlers.FifoChannel(100_000))
    heard: dict[str, list[bytes]] = defaultdict(list)

    def until_now() -> dict[str, list[bytes]]:
        while (sample := subscriber.try_recv()) is not None:
            heard[str(sample.key_expr).removeprefix(BASE)].append(sample.payload.to_bytes())
        return heard

    return until_now


def _opened(rig: FieldRig) -> Any:
    """A session with the daemon, once it lives."""
    found: list[Any] = []

    def tried() -> bool:
        try:
            found.append(session([rig.endpoint]))
        except Exception:  # whatever Zenoh says of a daemon that does not listen yet
            return False
        return True

    until(tried)
    return found[0]


def test_a_taken_port_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    with Publisher() as publisher, server("--connect", publisher.endpoint) as (address, _):
        assert main(("foxglove", "--port", address.rpartition(":")[2])) == 2
    assert "in use" in capsys.readouterr().err
