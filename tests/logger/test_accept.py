"""What the operator accepts is logged, then used: by the run, by a replay of its log, by the next run."""

import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import can
import numpy as np
import pytest
from logs import MACHINE
from loopback import records_of, rig, until
from verified import verified

from tilth.cli import main
from tilth.estimator.diagnosis.hypotheses import judge, posterior
from tilth.estimator.diagnosis.information import InformationForm, N
from tilth.estimator.diagnosis.watch import Moved, directions_of
from tilth.estimator.rig.numbers import WHEEL
from tilth.logger import warm_start_file
from tilth.logger.clock import Clock
from tilth.logger.daemon import Daemon
from tilth.logger.display import NoDisplay
from tilth.logger.guarded_fold import GuardedFold
from tilth.schemas.flow import Accepted, Frame
from tilth.schemas.machine import Machine
from tilth.schemas.machine_toml import MachineFile, parse_machine
from tilth.schemas.proto import tilth_pb2 as pb
from tilth.simulator.traffic import simulate

VIRTUAL = '[[bus]]\nname = "can0"\ninterface = "virtual"\nchannel = "tilth-accept"\n\n'
SLIPPED = Accepted(1, WHEEL, (0.0175,), (0.001,))

pytestmark = pytest.mark.usefixtures("prepared")


@pytest.fixture
def talker() -> Iterator[can.BusABC]:
    with can.Bus(interface="virtual", channel="tilth-accept") as bus:
        yield bus


def moved(machine: Machine, name: str, amounts: tuple[float, ...]) -> Moved:
    """As if it had been driven for long before and since."""
    before = InformationForm(np.eye(N) * 1e8, np.zeros(N), 1)
    after = InformationForm(np.eye(N) * 1e8, 1e8 * directions_of(machine, name) @ np.array(amounts), 2)
    first, *_ = judge(machine, *posterior(before), after)
    assert first.name == name
    return Moved([name], first.amounts, first.covariance, 2, before, after)


def now(frames: list[Frame], after_ns: int = 0) -> list[Frame]:
    """Frames that begin now, or after a time that a log has reached already."""
    shift_ns = max(Clock().t_ns(), after_ns + 1) - frames[0].t_ns
    return [replace(f, t_ns=f.t_ns + shift_ns, rx_ns=f.rx_ns + shift_ns) for f in frames]


def commands(daemon: Daemon, *each: list[str]) -> list[int]:
    """Exit statuses, of commands beside the daemon that goes round."""
    statuses: list[int] = []
    asking = threading.Thread(target=lambda: statuses.extend(main(words) for words in each))
    asking.start()
    until(lambda: not asking.is_alive(), lambda: daemon.turn(0.01))
    return statuses


def test_it_is_logged_then_used_and_a_replay_and_the_next_run_do_alike(
    tmp_path: Path, talker: can.BusABC, capsys: pytest.CaptureFixture[str]
) -> None:
    machine, text = rig(tmp_path, VIRTUAL)
    file = tmp_path / "m.toml"
    file.write_text(text)
    daemon = Daemon(MachineFile(machine, text), tmp_path / "logs", "", NoDisplay(), keep=True)
    drive = now(list(simulate(MACHINE, 4, 4.0)))
    for frame in drive[: len(drive) // 2]:
        daemon.take(frame)
    fold = daemon.parts.estimation.fold
    fold.state.diagnosis.watch.moved.append(moved(machine, "implement_front", (0.1, -0.02)))
    name = ["--machine", str(file)]
    asked = (
        ["accept", *name],
        ["accept", "cab", *name],
        ["accept", "implement_front", *name],
        ["accept", "implement_front", *name],
    )
    assert commands(daemon, *asked) == [0, 2, 0, 2]
    output = capsys.readouterr()
    assert "implement_front: implement_front has been moved 0.100" in output.out
    assert "cab has not been found moved; what has been is implement_front" in output.err
    assert "for the machine file: implement_front position = [1.400, -0.020" in output.out
    assert "implement_front has not been found moved; nothing has been" in output.err
    for frame in now(drive[len(drive) // 2 :]):
        daemon.take(frame)
    assert fold.accepted[0].what == "implement_front"
    logs = daemon.close().log_files
    (logged,) = (said for log in logs for said in records_of(log, "/accepted", pb.Accepted))
    assert logged.what == "implement_front" and logged.amounts == pytest.approx([0.1, -0.02], abs=1e-3)
    verified(logs, MachineFile(machine, text), 500)
    following = Daemon(MachineFile(machine, text), tmp_path / "logs", None, NoDisplay(), keep=True)
    assert following.parts.estimation.fold.state.machine == fold.state.machine
    following.close()


def test_a_load_is_logged_then_used_and_a_replay_and_the_next_run_do_alike(
    tmp_path: Path, talker: can.BusABC, capsys: pytest.CaptureFixture[str]
) -> None:
    bare, text = rig(tmp_path, VIRTUAL)
    text += "\n[implement.load]\nmass = 6000\nahead_of_axle = 0.1\nheight = 1.4\n"
    machine, file, own = parse_machine(text), tmp_path / "m.toml", bare.implement.mass.value
    file.write_text(text)
    daemon = Daemon(MachineFile(machine, text), tmp_path / "logs", "", NoDisplay(), keep=True)
    fold = daemon.parts.estimation.fold
    drive = now(list(simulate(MACHINE, 4, 4.0)))
    for frame in drive[: len(drive) // 2]:
        daemon.take(frame)
    name = ["--machine", str(file)]
    words: tuple[list[str], ...] = (
        [],
        ["--load", "5.5 t"],
        ["--load", "9 t"],
        [],
        ["cart", "--load", "full"],
    )
    asked = [["implement", *more, *name] for more in words]
    assert commands(daemon, *asked) == [0, 0, 2, 0, 2]
    output = capsys.readouterr()
    assert "Nobody has said what it carries. It is full with 6.0 t." in output.out
    assert "the implement carries 5.50 ± 0.54 t (95 %); source: operator" in output.out
    assert "9.0 t is more than it carries when it is full" in output.err
    assert "the load when its run has begun" in output.err
    assert fold.state.machine.implement.mass.value == pytest.approx(own + 5500.0)
    rest = now(drive[len(drive) // 2 :], after_ns=fold.state.latest_ns)
    at_ns = rest[len(rest) // 2].t_ns
    scale = Frame(at_ns, at_ns, "can0", 0x1CFEEA40, True, False, bytes.fromhex("FFFFFFFFFFE803FF"))
    for frame in (*rest[: len(rest) // 2], scale, *rest[len(rest) // 2 :]):
        daemon.take(frame)
    assert fold.state.machine.implement.mass.value == pytest.approx(own + 2000.0)
    logs = daemon.close().log_files
    (logged,) = (said for log in logs for said in records_of(log, "/load", pb.Carried))
    assert (logged.mass, logged.source) == (5500.0, "operator")
    verified(logs, MachineFile(machine, text), 500)
    following = Daemon(MachineFile(machine, text), tmp_path / "logs", None, NoDisplay(), keep=True)
    kept = following.parts.estimation.fold.state.carried
    assert kept is not None and kept.mass == pytest.approx(2000.0)
    following.close()


def test_another_machine_file_has_its_own_values(tmp_path: Path) -> None:
    path = tmp_path / "x.warm.json"
    path.write_text(warm_start_file.text_of(MACHINE, {}, 5, [SLIPPED]))
    kept = warm_start_file.read(path, MACHINE, 6)
    assert kept is not None and kept.accepted == [SLIPPED]
    changed = MACHINE.wheel_angle.model_copy(update={"sign": -1})
    with pytest.raises(warm_start_file.NotUsable, match="wheel_angle"):
        warm_start_file.read(path, MACHINE.model_copy(update={"wheel_angle": changed}), 6)


def test_it_outlives_a_fault_and_a_new_log_file() -> None:
    fold = GuardedFold(MACHINE)
    fold.accept(SLIPPED)
    slipped = fold.state.machine.wheel_angle.zero.value
    assert slipped == pytest.approx(MACHINE.wheel_angle.zero.value + 1.0027, abs=1e-4)
    again = GuardedFold(MACHINE, fold.renew())
    assert again.state.machine == fold.state.machine and again.accepted == [SLIPPED]
    fold.state.record = None  # type: ignore[assignment]
    for frame in list(simulate(MACHINE, 1, 4.0)):
        fold.take(frame)
    assert fold.faults >= 1 and fold.state.machine.wheel_angle.zero.value == slipped
