"""The demo as a person runs it, in processes of its own, and its parts."""

import json
import math
import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any, BinaryIO

import can
import numpy as np
import pytest
from logs import frames_in
from loopback import PATIENCE_S

from tilth.cli import main
from tilth.estimator.fold import initial, step
from tilth.logger.clock import Clock
from tilth.logger.run_summary import RunSummary
from tilth.replay.readers.any_log import frames
from tilth.replay.simulated import simulated_by
from tilth.schemas.decode import Decoder
from tilth.schemas.flow import PARAMETERS, Attitude, Estimate, Frame, ParameterEstimate, Status
from tilth.schemas.machine import Machine
from tilth.schemas.machine_toml import parse_machine
from tilth.schemas.reasons import text_reason
from tilth.simulator.demo import (
    Demo,
    DemoError,
    compare,
    comparison_table,
    on_loopback,
    reasons,
    result,
    run_demo,
)
from tilth.simulator.packaged import packaged_file
from tilth.simulator.scenario import Scenario
from tilth.simulator.socketcand_server import SocketcandServer, open_server, play
from tilth.simulator.tractor import draw
from tilth.simulator.traffic import simulate

pytestmark = pytest.mark.long


TEXT = packaged_file().text
# Without asammdf, which reads files that are not needed here and takes two seconds to import.
START = "import sys; sys.modules['asammdf'] = None; from tilth.cli import main; sys.exit(main())"
COMMAND = [sys.executable, "-c", START, "demo", "--no-page"]
# A network of its own with nothing but loopback, and no privilege, where the system allows that.
ALONE = ["unshare", "-rn", "sh", "-c", 'ip link set lo up && exec "$@"', "sh"]


def _can_be_alone() -> bool:
    if not (shutil.which("unshare") and shutil.which("ip")):
        return False
    return subprocess.run([*ALONE, "true"], capture_output=True, check=False).returncode == 0


@pytest.fixture(scope="module")
def machine() -> Machine:
    return parse_machine(TEXT)


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What four seconds of demo say."""
    folder = tmp_path_factory.mktemp("demo")
    command = [*COMMAND, "--seconds", "4", "--json", "--log", str(folder)]
    if _can_be_alone():
        command = [*ALONE, *command]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert len(lines) == 1
    answer: dict[str, Any] = json.loads(lines[0])
    return answer


def test_no_frame_is_lost(short: dict[str, Any], machine: Machine) -> None:
    assert short["frames"] == short["frames_sent"]
    # How many epochs there are depends on where within a second it began.
    assert short["frames"] == pytest.approx(len(list(simulate(machine, 1, 4.0))), abs=80)
    assert short["frames_lost"] == 0
    (log,) = short["log"]
    assert short["simulated"] is True and simulated_by([Path(log)]) == "tilth demo"
    read = list(frames(Path(log)))
    # Sent in real time, never faster; a busy computer may take the last ones late.
    assert (read[-1].rx_ns - read[0].rx_ns) * 1e-9 > 3.9
    assert short["duration_s"] == pytest.approx((read[-1].t_ns - read[0].t_ns) * 1e-9)


def test_the_answer_has_the_fields_of_a_replay_and_the_truth(short: dict[str, Any], machine: Machine) -> None:
    assert short["truth"] == pytest.approx(draw(machine, 1, Scenario()))
    assert tuple(short["truth"]) == PARAMETERS
    assert short["measurements"] > 1000
    assert short["poses"] > 10
    assert short["truncated"] is False
    for method in ("steady_state", "recommended"):
        assert tuple(short["estimates"][method]) == PARAMETERS
        for parameter in short["estimates"][method].values():
            assert set(parameter) == {"value", "sd", "status", "reason"}
    assert set(short["nuisances"]) == set(short["estimates"])


def test_its_log_replays_to_the_byte(short: dict[str, Any], capsys: pytest.CaptureFixture[str]) -> None:
    (log,) = short["log"]
    assert main(["replay", log, "--verify", "--json"]) == 0
    replayed = json.loads(capsys.readouterr().out)
    assert replayed["verify"]["difference"] is None
    assert replayed["verify"]["compared"] > short["measurements"]
    assert not replayed["truncated"]
    for key in ("frames", "measurements", "poses", "rejected", "estimates", "nuisances"):
        assert replayed[key] == short[key], key


@pytest.mark.skipif(find_spec("mujoco") is None, reason="needs the extra `spatial`")
def test_in_space_it_rolls_over_uneven_ground(tmp_path: Path, machine: Machine) -> None:
    words = ["--spatial", "--seconds", "3", "--json", "--log", str(tmp_path)]
    done = subprocess.run([*COMMAND, *words], capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    assert answer["frames_lost"] == 0
    assert answer["truth"] == pytest.approx(draw(machine, 1, Scenario()))
    decoder = Decoder(machine)
    told = [m for frame in frames(Path(answer["log"][0])) for m in decoder.measurements(frame)]
    rolls = [one.roll for one in told if isinstance(one, Attitude) and one.roll is not None]
    assert len(rolls) > 20
    assert np.ptp(rolls) > np.radians(1.5)  # it rolls, and each receiver has another zero and more noise


def test_a_simulator_that_dies_ends_the_run_with_a_whole_log(tmp_path: Path) -> None:
    def kill_once_logged() -> bool:
        if any(frames_in(path) > 100 for path in tmp_path.glob("*.mcap")):
            for child in _children("socketcand_server"):
                os.kill(child, signal.SIGKILL)
        return False

    with pytest.raises(DemoError, match="died") as caught:
        run_demo(600.0, 1, tmp_path, stop=kill_once_logged)
    log = Path(str(caught.value).split()[-1])
    assert len(list(frames(log))) > 100


def test_ctrl_c_before_it_begins_leaves_nothing_behind(tmp_path: Path) -> None:
    with pytest.raises(DemoError, match="stopped before it began"):
        run_demo(600.0, 1, tmp_path, stop=lambda: True)
    assert list(tmp_path.iterdir()) == []
    assert list(_children("socketcand_server")) == []


def _children(words: str) -> Iterator[int]:
    """Process ids of this process's children with these words in their command."""
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            parent = int(stat.read_text().rpartition(")")[2].split()[1])
            if parent == os.getpid() and words in stat.with_name("cmdline").read_text():
                yield int(stat.parent.name)


def test_the_machine_file_differs_in_its_bus_only(machine: Machine) -> None:
    moved = parse_machine(on_loopback(TEXT, 4711))
    (bus,) = moved.bus
    assert (bus.name, bus.interface, bus.options) == (
        "can0",
        "socketcand",
        {"host": "127.0.0.1", "port": 4711},
    )
    assert moved.model_copy(update={"bus": machine.bus}) == machine


def test_ninety_seconds_give_six_parameters_that_hold_the_truth(machine: Machine) -> None:
    """What the default demo shows at its end, without waiting for it."""
    state = initial(machine)
    for frame in simulate(machine, 1, 90.0):
        step(state, frame)
    rows = compare(draw(machine, 1, Scenario()), state.estimates["recommended"])
    for row in rows:
        assert row.estimate is not None
        assert row.estimate.status is Status.ESTIMATED, row.estimate.reason
        assert row.holds, row


def _estimate(log_sd: float) -> Estimate:
    covariance = [0.0] * 36
    covariance[0] = log_sd**2
    known = ParameterEstimate(200e3, 200e3 * log_sd, Status.ESTIMATED, None)
    unknown = ParameterEstimate(None, None, Status.UNESTIMATED, text_reason("no turn"))
    return Estimate(0, "m", "m", (known, *[unknown] * 5), tuple(covariance), (None,) * 3)


@pytest.mark.parametrize(
    ("true", "log_sd", "holds"),
    [(220e3, 0.1, True), (170e3, 0.1, True), (250e3, 0.1, False), (163e3, 0.1, False)],
)
def test_the_interval_is_log_normal(machine: Machine, true: float, log_sd: float, holds: bool) -> None:
    truth = draw(machine, 1, Scenario()) | {"C_af": true}
    row, other = compare(truth, _estimate(log_sd))[:2]
    assert row.interval == pytest.approx((200e3 * math.exp(-1.96 * log_sd), 200e3 * math.exp(1.96 * log_sd)))
    assert row.holds is holds
    assert other.interval is None
    assert other.holds is None


def test_lost_frames_and_a_run_without_estimates_are_told(machine: Machine) -> None:
    summary = RunSummary(0, 1, None, None, 9, 0, 0, {}, {}, (), 9, 0, 0, 0, 0, ())
    demo = Demo(1, draw(machine, 1, Scenario()), summary, 10)
    assert result(demo)["frames_lost"] == 1
    assert result(demo)["duration_s"] == 0.0
    assert comparison_table(demo).row_count == 6
    assert reasons(demo) == [", ".join(PARAMETERS) + ": no estimator has spoken"]


# The bus.


@pytest.fixture
def server() -> Iterator[SocketcandServer]:
    server = open_server()
    yield server
    server.close()


@pytest.fixture
def orders() -> Iterator[tuple[BinaryIO, BinaryIO]]:
    """(what the player listens to, where to write): none come until the second is closed."""
    reading, writing = os.pipe()
    with os.fdopen(reading, "rb", 0) as ours, os.fdopen(writing, "wb", 0) as theirs:
        yield ours, theirs


@contextmanager
def _playing(
    server: SocketcandServer, frames: list[Frame], clients: int, orders: tuple[BinaryIO, BinaryIO]
) -> Iterator[list[int]]:
    """Plays in a thread as soon as so many clients listen; gives a list that receives the count sent."""
    sent: list[int] = []

    def serve() -> None:
        while len(server.listening()) < clients:
            server.serve(0.01, orders[0])
        sent.append(play(server, iter(frames), Clock(), orders[0]))
        while not server.serve(0.05, orders[0]):
            continue

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield sent
    finally:
        orders[1].close()
        thread.join(PATIENCE_S)


def _traffic(machine: Machine, seconds: float) -> list[Frame]:
    """Half a second of it is due at once, the rest in real time."""
    start_ns = Clock().t_ns() // 10_000_000 * 10_000_000 - 500_000_000
    return list(simulate(machine, 1, seconds, Scenario(utc_start_ns=start_ns, clock_offset_s=0.0)))


def _client(server: SocketcandServer) -> can.BusABC:
    return can.Bus(interface="socketcand", channel="can0", host="127.0.0.1", port=server.port)


def _heard(bus: can.BusABC, count: int) -> list[can.Message]:
    """So many messages, or what there was before it fell silent."""
    received: list[can.Message] = []
    while len(received) < count and (message := bus.recv(PATIENCE_S)) is not None:
        received.append(message)
    return received


def test_every_client_gets_every_frame_in_order(
    server: SocketcandServer, machine: Machine, orders: tuple[BinaryIO, BinaryIO]
) -> None:
    played = _traffic(machine, 0.8)
    with _playing(server, played, 2, orders) as sent, _client(server) as one, _client(server) as other:
        for bus in (one, other):
            received = _heard(bus, len(played))
            assert [(m.arbitration_id, bytes(m.data)) for m in received] == [
                (f.can_id, f.data) for f in played
            ]
            assert [m.timestamp for m in received] == pytest.approx(
                [f.rx_ns * 1e-9 for f in played], abs=2e-6
            )
            assert all(m.is_extended_id for m in received)
    assert sent == [len(played)]


def test_clients_that_leave_do_no_harm(
    server: SocketcandServer, machine: Machine, orders: tuple[BinaryIO, BinaryIO]
) -> None:
    played = _traffic(machine, 0.7)
    with socket.create_connection(("127.0.0.1", server.port)):
        pass  # only looked in
    with _playing(server, played, 1, orders) as sent, _client(server) as stays:
        _client(server).shutdown()
        assert len(_heard(stays, len(played))) == len(played)
    assert sent == [len(played)]


def test_frames_are_not_sent_before_their_time(
    server: SocketcandServer, machine: Machine, orders: tuple[BinaryIO, BinaryIO]
) -> None:
    played = _traffic(machine, 0.9)
    clock = Clock()
    with _playing(server, played, 1, orders), _client(server) as bus:
        for frame in played:
            assert bus.recv(PATIENCE_S) is not None
            assert clock.t_ns() >= frame.rx_ns
