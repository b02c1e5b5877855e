"""The virtual tractor in real time on a bus: real processes, a real socket, good commands and bad ones."""

import json
import math
import socket
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import can
import pytest
from loopback import PATIENCE_S

from tilth.schemas.decode import encode, frames_of
from tilth.schemas.flow import Word
from tilth.simulator.packaged import packaged_file
from tilth.simulator.scenario import Scenario, as_json, from_json
from tilth.simulator.steering import COMMAND, REFUSALS

pytestmark = pytest.mark.long


QUIET = Scenario(speed=3.0, other_traffic=False, speed_sd=0.0)


def test_a_scenario_goes_to_another_process_and_comes_back() -> None:
    assert from_json(as_json(QUIET)) == QUIET


@pytest.fixture
def rig() -> Iterator[subprocess.Popen[bytes]]:
    process = subprocess.Popen(
        [sys.executable, "-m", "tilth.simulator.real_time_rig"], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    with process:
        yield process
        assert process.stdin is not None
        process.stdin.close()
        assert process.wait(PATIENCE_S) == 0


def order(rig: subprocess.Popen[bytes], seconds: float) -> int:
    fact = {
        "machine_text": packaged_file().text,
        "seed": 1,
        "seconds": seconds,
        "scenario": as_json(QUIET),
        "listeners": 1,
    }
    assert rig.stdin is not None
    rig.stdin.write(json.dumps(fact).encode() + b"\n")
    rig.stdin.flush()
    return int(next_fact(rig)["port"])


def next_fact(rig: subprocess.Popen[bytes]) -> dict[str, Any]:
    assert rig.stdout is not None
    return dict(json.loads(rig.stdout.readline()))


def command(angle_deg: float, source: int) -> can.Message:
    bend = math.tan(math.radians(angle_deg)) / 2.9
    words: dict[str, Word] = {"commanded_curvature_per_m": bend, "command_status": "intended"}
    ((can_id, data),) = frames_of(COMMAND, encode(COMMAND, words), source, 0xF0)
    return can.Message(arbitration_id=can_id, data=data, is_extended_id=True)


def test_it_obeys_one_of_two_controllers_refuses_what_it_cannot_do_and_outlives_rubbish(
    rig: subprocess.Popen[bytes],
) -> None:
    port = order(rig, 2.5)
    with (
        can.Bus(interface="socketcand", host="127.0.0.1", port=port, channel="can0") as bus,
        socket.create_connection(("127.0.0.1", port)) as rubbish,
        socket.create_connection(("127.0.0.1", port)) as endless,
    ):
        assert bus.recv(PATIENCE_S) is not None
        rubbish.sendall(
            b"< send >< send zz 1 0 >< send 1F 9 0 >< send 1CADF01C 2 fff 0 >< send FFFFFFFF 0 >>><"
        )
        endless.sendall(b"x" * 10_000)
        for sent in (command(2.0, 0x1C), command(50.0, 0x1C), command(1.0, 0x2A), command(30.0, 0x1C)):
            bus.send(sent)
        bus.send(can.Message(arbitration_id=command(0.0, 0x1C).arbitration_id, data=b"", is_extended_id=True))
        places = []
        while "sent" not in (fact := next_fact(rig)):
            places.append(fact["implement"])
    wanted = ("beyond_limit", "another_controller", "too_fast", "short_frame")
    assert fact["refused"] == {REFUSALS[name]: 1 for name in wanted}
    assert (fact["commands"], fact["let_go"], fact["no_frame"], fact["stopped"]) == (1, 1, 5, False)
    assert len(places) == 25
    assert 2.0 < places[-1][0] - places[0][0] < 7.0
