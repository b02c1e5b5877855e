"""A machine whose buses are multicast groups of this computer, and a process that sends on them."""

import contextlib
import json
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import zenoh
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader
from paths import MACHINE_FILE

from tilth.schemas.flow import Frame
from tilth.schemas.machine import Machine
from tilth.schemas.machine_toml import parse_machine
from tilth.schemas.proto import tilth_pb2 as pb

TEXT = MACHINE_FILE.read_text()
GROUP = "239.74.163.2"
START_NS = 1_790_000_000_000_000_000
PATIENCE_S = 120.0  # that a test which hangs ends; a busy computer takes its time, a quiet one does not wait

_BUS = TEXT[TEXT.index("[[bus]]") : TEXT.index("[[receiver]]")]
_SENDER = """
import json, sys, time
sys.modules["asammdf"] = None  # two seconds of import for reading files
import can
for line in sys.stdin:
    job = json.loads(line)
    buses = [can.Bus(interface="udp_multicast", channel=g, port=p, hop_limit=0) for g, p in job["buses"]]
    began = time.monotonic()
    for i, (bus, identifier, data, at) in enumerate(job["frames"]):
        wait = began + at - time.monotonic()
        if wait > 0.001:
            time.sleep(wait)  # the pace that was asked for
        buses[bus].send(can.Message(arbitration_id=identifier, is_extended_id=True, data=bytes.fromhex(data)))
    for bus in buses:
        bus.shutdown()
    print("sent", flush=True)
"""


def free_port(kind: int = socket.SOCK_DGRAM) -> int:
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def udp_bus(name: str, port: int) -> str:
    return (
        f'[[bus]]\nname = "{name}"\ninterface = "udp_multicast"\nchannel = "{GROUP}"\n'
        f"options = {{ port = {port}, hop_limit = 0 }}\n\n"
    )


def machine_text(folder: Path, *buses: str, log: str = "") -> str:
    """The demo's machine with these [[bus]] sections, logging there, on a Zenoh port of its own."""
    port = free_port(socket.SOCK_STREAM)
    return (
        TEXT.replace(_BUS, "".join(buses))
        .replace('folder = "logs"', f'folder = "{folder}"\n{log}')
        .replace('prefix = "tilth"', f'prefix = "tilth"\nlisten = ["tcp/127.0.0.1:{port}"]')
    )


def rig(folder: Path, *buses: str, log: str = "") -> tuple[Machine, str]:
    text = machine_text(folder, *buses, log=log)
    return parse_machine(text), text


def numbered(count: int, start_ns: int = START_NS, bus: str = "can0") -> list[Frame]:
    """Frames a millisecond apart that tell their number; none is of interest to a decoder."""
    return [
        Frame(
            start_ns + i * 1_000_000,
            start_ns + i * 1_000_000 - 150_000,
            bus,
            0x18FF0001,
            True,
            False,
            _number(i),
        )
        for i in range(count)
    ]


def _number(i: int) -> bytes:
    return i.to_bytes(8, "little")


class Sender:
    """A second process that puts frames on the groups of some ports."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-c", _SENDER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def begin(self, ports: Sequence[int], frames: Sequence[tuple[int, Frame, float]]) -> None:
        """(index of the port, frame, seconds after the beginning) in that order."""
        assert self._process.stdin is not None
        rows = [(bus, frame.can_id, frame.data.hex(), at) for bus, frame, at in frames]
        self._process.stdin.write(json.dumps({"buses": [(GROUP, p) for p in ports], "frames": rows}) + "\n")
        self._process.stdin.flush()

    def finish(self) -> None:
        assert self._process.stdout is not None
        assert self._process.stdout.readline() == "sent\n"

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.close()
        self._process.wait(PATIENCE_S)
        self._process.stdout.close()


def breath() -> None:
    """What is waited for needs this computer's cores, behind all else where it has the lowest priority."""
    threading.Event().wait(0.02)


def until(
    condition: Callable[[], bool], turn: Callable[[], object] = breath, seconds: float = PATIENCE_S
) -> None:
    """Turn a loop until something is so; fails where it never is."""
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "waited in vain"
        turn()


@contextmanager
def messages(path: Path) -> Iterator[list[tuple[Channel, Message]]]:
    """All messages of a finished file in their order, as the mcap package reads them."""
    with path.open("rb") as stream:
        rows = make_reader(stream).iter_messages(log_time_order=False)
        yield [(channel, message) for _, channel, message in rows]


def logged_frames(path: Path) -> list[Frame]:
    with messages(path) as rows:
        return [_frame(channel, message) for channel, message in rows if channel.topic.startswith("/can/")]


def _frame(channel: Channel, message: Message) -> Frame:
    raw = pb.CanFrame.FromString(message.data)
    bus = channel.topic.removeprefix("/can/")
    return Frame(message.log_time, raw.rx_ns, bus, raw.can_id, raw.extended, raw.error, raw.data)


def records_of(path: Path, topic: str, message: Any) -> list[Any]:
    """What was logged on one topic, parsed."""
    with messages(path) as rows:
        return [message.FromString(row.data) for channel, row in rows if channel.topic == topic]


def salvaged(data: bytes) -> list[Frame]:
    """Frames of a file that may have been cut."""
    channels: dict[int, Channel] = {}
    got = []
    with contextlib.suppress(McapError, struct.error):
        for record in StreamReader(BytesIO(data)).records:
            if isinstance(record, Channel):
                channels[record.id] = record
            elif isinstance(record, Message) and channels[record.channel_id].topic.startswith("/can/"):
                got.append(_frame(channels[record.channel_id], record))
    return got


def session(endpoints: list[str]) -> zenoh.Session:
    """Another program's."""
    config = zenoh.Config()
    for key, value in (
        ("mode", "client"),
        ("connect/endpoints", endpoints),
        ("scouting/multicast/enabled", False),
    ):
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)


def answers(other: zenoh.Session, selector: str) -> dict[str, tuple[bytes, str]]:
    replies = [reply.ok for reply in other.get(selector, timeout=PATIENCE_S)]
    return {
        str(one.key_expr): (one.payload.to_bytes(), str(one.encoding)) for one in replies if one is not None
    }
