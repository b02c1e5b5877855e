"""`tilth mavlink` between processes: a daemon's Zenoh, the bridge, a UDP way that loses, and a peer."""

import math
import os
import re
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import pytest
from client_daemon import LOG_SD, THETA, Publisher, estimate
from loopback import PATIENCE_S, free_port, until
from pymavlink.dialects.v20 import common

from tilth.client import Staleness
from tilth.client.latest import judge
from tilth.client.mavlink import AGE, SUFFIXES, numbers
from tilth.schemas.flow import PARAMETERS, ParameterEstimate, Status
from tilth.schemas.reasons import text_reason

RULE = Staleness(silence_s=3.0, data_s=math.inf)
MAVPROXY = Path(
    os.environ.get("TILTH_MAVPROXY", Path.home() / ".cache/tilth/mavproxy/bin/mavproxy.py")
)  # in an environment of its own; it is not ours
PER_TICK = 1 + 1 + len(PARAMETERS) * len(SUFFIXES) + 1  # heartbeat, array, named values with AGE


class Peer:
    """Hears MAVLink on a UDP port, without every `lossy`-th datagram; counts what its numbers say is lost."""

    def __init__(self, lossy: int = 0) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.settimeout(PATIENCE_S)
        self.address = f"127.0.0.1:{self._socket.getsockname()[1]}"
        self._codec = common.MAVLink(None)
        self._lossy, self._came, self._last = lossy, 0, -1
        self.dropped = self.lost = 0
        self.names: dict[str, float] = {}
        self.array: list[float] = []
        self.heartbeats: list[tuple[int, int]] = []

    def hear(self) -> None:
        packed = self._socket.recv(2048)
        self._came += 1
        if self._lossy and self._came % self._lossy == 0:
            self.dropped += 1
            return
        message: Any = self._codec.parse_char(packed)
        if self._last >= 0:
            self.lost += (message.get_seq() - self._last - 1) % 256
        self._last = message.get_seq()
        kind = message.get_type()
        if kind == "NAMED_VALUE_FLOAT":
            self.names[message.name] = message.value
        elif kind == "DEBUG_FLOAT_ARRAY":
            assert message.name == "tilth"
            self.array = message.data
        else:
            assert kind == "HEARTBEAT"
            self.heartbeats.append((message.get_srcSystem(), message.type))

    def hear_until(self, condition: Callable[[], bool]) -> None:
        while not condition():
            self.hear()

    def hear_all(self) -> None:
        """Each name and the array afresh, whatever is lost meanwhile."""
        self.names.clear()
        self.array = []
        self.hear_until(lambda: len(self.names) == PER_TICK - 2 and bool(self.array))

    def close(self) -> None:
        self._socket.close()


@contextmanager
def bridge(endpoint: str, to: str, *options: str) -> Iterator[subprocess.Popen[str]]:
    words = ("mavlink", "--connect", endpoint, "--to", f"udpout:{to}", *options)
    code = f"import sys; from tilth.cli import main; sys.exit(main({words!r}))"
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def test_a_peer_has_the_numbers_with_status_and_age_whatever_the_way_loses() -> None:
    with (
        closing(Peer(lossy=7)) as peer,
        Publisher() as publisher,
        bridge(publisher.endpoint, peer.address) as process,
    ):

        def fresh() -> bool:
            """Where the publisher, or this, was not late."""
            peer.hear_all()
            states = {peer.names[f"{name}_st"] for name in PARAMETERS}
            heard = [*peer.names.values(), *peer.array[:25]]
            return states == {Status.ESTIMATED} and peer.names[AGE] < 3 and not any(map(math.isnan, heard))

        until(fresh)
        for i, (name, value) in enumerate(zip(PARAMETERS, THETA, strict=True)):
            row = [peer.names[name + suffix] for suffix in SUFFIXES]
            assert row[:3] == pytest.approx([value, value * LOG_SD, Status.ESTIMATED], rel=1e-6)
            assert 0.5 <= row[3] < 5.0
            assert peer.array[1 + 4 * i : 4 + 4 * i] == pytest.approx(row[:3])
        publisher.order(silent=True)  # the daemon falls silent: no number outlives it
        peer.hear_until(lambda: peer.names["C_af_st"] == peer.names["sigma_i_st"] == Status.STALE)
        peer.hear_all()
        assert all(math.isnan(peer.names[name]) for name in PARAMETERS)
        assert peer.names[AGE] > 3
        assert peer.dropped > 5
        assert 0 <= peer.dropped - peer.lost <= 1  # what was dropped last may not be missed yet
        assert {*peer.heartbeats} == {(1, common.MAV_TYPE_ONBOARD_CONTROLLER)}
        process.terminate()
        out, _ = process.communicate(timeout=PATIENCE_S)
        assert process.returncode == 0
        assert "all six may be used" in out and "0 of them not sent" in out


@pytest.mark.skipif(not MAVPROXY.exists(), reason=f"no MAVProxy at {MAVPROXY}; .ci/run installs it")
def test_mavproxy_reads_the_same_numbers(tmp_path: Path) -> None:
    port = free_port()
    command = [
        str(MAVPROXY.with_name("python")), str(MAVPROXY), f"--master=udpin:127.0.0.1:{port}",
        "--non-interactive", "--default-modules=link,misc", f"--state-basedir={tmp_path}",
        "--cmd=watch NAMED_VALUE_FLOAT DEBUG_FLOAT_ARRAY",
    ]  # fmt: skip
    received: dict[str, float] = {}
    array: list[float] = []
    with (
        Publisher() as publisher,
        bridge(publisher.endpoint, f"127.0.0.1:{port}"),
        subprocess.Popen(
            command, cwd=tmp_path, text=True,
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        ) as mavproxy,
    ):  # fmt: skip
        watchdog = threading.Timer(PATIENCE_S, mavproxy.kill)
        watchdog.start()
        assert mavproxy.stdout is not None
        for line in mavproxy.stdout:
            if found := re.search(r"name : (\w+), value : (\S+)}", line):
                received[found[1]] = float(found[2])
            elif found := re.search(r"name : tilth, .*data : \[(.*)\]", line):
                array = [float(number) for number in found[1].split(",")]
            result = [received.get(name, math.nan) for name in (*PARAMETERS, "sigma_i_ag")] + (
                array or [math.nan]
            )
            if not any(map(math.isnan, result)):
                break
        watchdog.cancel()
        mavproxy.kill()
    values = dict(zip(PARAMETERS, THETA, strict=True))
    assert {name: received[name] for name in PARAMETERS} == pytest.approx(values, rel=1e-6)
    assert {received[f"{name}_st"] for name in PARAMETERS} == {float(Status.ESTIMATED)}
    assert array[1:25:4] == pytest.approx(THETA, rel=1e-6)


@pytest.mark.parametrize("status", Status)
def test_a_number_is_there_only_while_it_may_be_used(status: Status) -> None:
    row = ParameterEstimate(150e3, 15e3, status, text_reason("because"), 7.0)
    result = estimate(parameters=(row,) * 6)
    named = numbers(judge(result, 2.0, RULE))
    assert math.isnan(named["C_ai"]) == math.isnan(named["C_ai_sd"]) == (status is not Status.ESTIMATED)
    assert (named["C_ai_st"], named["C_ai_ag"], named[AGE]) == (status, 9.0, 2.0)
    silent = numbers(judge(result, 4.0, RULE))
    assert math.isnan(silent["C_ai"]) and silent["C_ai_st"] != Status.ESTIMATED


def test_before_the_first_estimate_all_are_nan_and_names_fit_the_message() -> None:
    named = numbers(judge(None, math.inf, RULE))
    assert {named[name + "_st"] for name in PARAMETERS} == {float(Status.UNESTIMATED)}
    assert all(math.isnan(number) for name, number in named.items() if not name.endswith("_st"))
    assert max(map(len, named)) <= 10 and len(named) == PER_TICK - 2 <= 58
