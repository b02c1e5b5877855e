"""What estimators call is compiled while frames are recorded; who calls it later finds it compiled."""

import contextlib
import json
import math
import os
import shutil
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from logs import MACHINE
from loopback import PATIENCE_S, machine_text, records_of
from mcap.reader import make_reader
from numba.core import event
from paths import ROOT, SUPPORT

from tilth.cli import main
from tilth.estimator.compiled import InterpretedWarning, Kernel
from tilth.estimator.methods.estimators import ROW
from tilth.logger import compiling
from tilth.logger.compiling import Preparing
from tilth.logger.guarded_fold import GuardedFold
from tilth.schemas.channels import READY_TOPIC
from tilth.schemas.machine import Machine
from tilth.schemas.notices import Notice
from tilth.schemas.proto.tilth_pb2 import Ready, Status
from tilth.schemas.sentences import notice_sentence
from tilth.simulator.traffic import simulate

NEEDED = """
import gc, sys
from dataclasses import replace
from circle import demo_machine
from drives import LEARNING, QUIET
from tilth.estimator.compiled import InterpretedWarning, Kernel
from tilth.logger.compiling import is_prepared, kernels_of, prepare
from tilth.logger.guarded_fold import GuardedFold
from tilth.logger.compiling import Preparing
from tilth.simulator.scenario import Fault
from tilth.simulator.traffic import simulate
from tilth.schemas.flow import Mount

def compiled():
    kernels = [one for one in gc.get_objects() if isinstance(one, Kernel) and one.called]
    return {one.function.__qualname__: (one.how, len(one._run.signatures)) for one in kernels}

machine = demo_machine()
estimation = machine.estimation.model_copy(update={"two_step": True})
machine = machine.model_copy(update={"estimation": estimation})
silent = Fault(Mount.IMPLEMENT_REAR, 20.0, 24.0, "silent")
faults = (silent, Fault(Mount.TRACTOR_FRONT, 30.0, 30.5, "rtk_float"))
frames = list(simulate(machine, 3, 42.0, replace(QUIET, faults=faults)))
prepare(machine, lambda share: None)
before = compiled()
assert is_prepared(machine)
assert set(before) >= {one.function.__qualname__ for one in kernels_of(machine)}, before
assert before and all(how == "compiled and kept" for how, _ in before.values()), before
fold = GuardedFold(machine)
for frame in frames:
    fold.take(frame)
fold.renew()
assert fold.faults == 0 and fold.poses > 190, (fold.faults, fold.poses)
assert all(fold.estimates[method].parameters[0].age_s is not None for method in ("tracker", "pem"))
assert compiled() == before, (compiled(), before)
"""
DEMO = """
import sys
sys.modules["asammdf"] = None  # two seconds of import for reading files
from tilth.cli import main
raise SystemExit(main())
"""


def unfit(x: float) -> float:
    return x + len(f"{object()!r}") * 0.0


@pytest.mark.long
def test_what_a_drive_calls_was_prepared() -> None:
    """Whatever the estimators do: stretches, advice, fits in place, faults. A process of its own, since here
    others have called kernels before."""
    command = [sys.executable, "-c", NEEDED]
    done = subprocess.run(
        command,
        env={**os.environ, "PYTHONPATH": f"{SUPPORT}{os.pathsep}{ROOT / 'bench'}"},
        check=False,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr


def test_poses_need_no_kernel(monkeypatch: pytest.MonkeyPatch) -> None:
    """They follow from the first frame on, and wait for the estimators."""

    def never(kernel: Kernel[..., Any], *args: object) -> object:
        raise AssertionError("a kernel was called")

    monkeypatch.setattr(Kernel, "__call__", never)
    fold = GuardedFold(MACHINE)
    fold.ready = False
    result = {p.topic for frame in simulate(MACHINE, 3, 12.0) for p, _ in fold.take(frame)}
    fold.renew()
    assert fold.faults == 0 and len(fold.state.waiting) == fold.poses > 50 and not fold.ready
    assert "/pose" in result and not any(topic.startswith("/soil_tire") for topic in result)


def test_the_share_of_the_compiling_grows_with_what_is_done(monkeypatch: pytest.MonkeyPatch) -> None:
    """As numba tells it, without its work."""
    told: list[compiling.KernelsDone] = []
    kernels = [Kernel(one.function) for one in compiling.kernels_of(MACHINE)]
    assert sum(len(kernel.functions()) > 5 for kernel in kernels) >= 2  # large ones, whose shares overlap

    def compile_all(machine: Machine) -> None:
        for kernel in kernels:
            event.start_event("numba:compile", data={"dispatcher": None})
            for function in (*reversed(kernel.functions()), compile_all):  # the last is one of numba's own
                dispatcher = SimpleNamespace(py_func=function)
                event.end_event("numba:compile", data={"dispatcher": dispatcher})

    rows = [SimpleNamespace(prepare=compile_all, kernels=kernels)]
    monkeypatch.setattr(compiling, "rows_for", lambda machine: rows)
    compiling.prepare(MACHINE, told.append)
    shares = [done.share for done in told]
    assert shares[0] == 0.0 and shares == sorted(shares) and shares[-1] == compiling.MOST
    assert 0.2 < shares[len(shares) // 2] < 0.9  # the motion's slopes, most of the work, come early
    functions = {function for kernel in kernels for function in kernel.functions()}
    assert [done.functions for done in told] == [*range(1 + len(functions))]
    assert {done.of for done in told} == {len(functions)}
    assert compiling.SECONDS.keys() <= {function.__name__ for function in functions}


def test_a_kernel_that_the_compiler_refuses_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    refused: Kernel[..., Any] = Kernel(unfit)
    told = threading.Event()
    said: list[str] = []

    def report(kind: str, one: Notice) -> None:
        said.append(notice_sentence(one))
        told.set()

    monkeypatch.setattr(compiling, "kernels_of", lambda machine: [refused])
    with pytest.warns(InterpretedWarning):
        refused(1.5)
    monkeypatch.setattr(compiling, "is_prepared", lambda machine: False)
    monkeypatch.setattr(compiling, "load", lambda machine: True)
    with contextlib.closing(Preparing(MACHINE, report)):
        assert told.wait(PATIENCE_S)
    assert len(said) == 1 and "unfit is interpreted: " in said[0]


def test_the_time_left_never_grows_nor_stands_while_a_function_takes_long(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = [100.0]
    monkeypatch.setattr("tilth.logger.compiling.time.monotonic", lambda: now[0])
    monkeypatch.setattr(compiling, "is_prepared", lambda machine: True)
    preparing = Preparing(MACHINE, lambda kind, told: None)
    preparing.ready, preparing._doing = False, "compiling"
    said = []
    for after_s, done, share in (
        (0, 0, 0.0),
        (1, 1, 0.05),
        (9, 40, 0.5),
        (60, 40, 0.5),
        (5, 78, 0.9),
        (60, 79, 0.99),
    ):
        now[0] += after_s
        preparing._progress(compiling.KernelsDone(done, 80, share))
        for wait_s in (0.0, 30.0):
            now[0] += wait_s
            said.append(preparing.remaining_s)
        assert preparing.text == f"compiling: {done} of 80 done"
    known = [one for one in said if one is not None]
    assert said[:4] == [None] * 4 and len(known) == 8
    assert all(later < before for before, later in zip(known[:-1:2], known[1::2], strict=True))  # 30 s later
    assert known == sorted(known, reverse=True) and known[-1] > 0.0


@pytest.fixture(scope="module")
def nowhere(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Environment of a program for whose kernels there is no place: whoever runs it, root too."""
    root = tmp_path_factory.mktemp("program")
    (root / "tilth").mkdir()
    for folder in (ROOT / ".typing" / "tilth").iterdir():
        if folder.name != "estimator":
            (root / "tilth" / folder.name).symlink_to(folder.resolve())
    ours = root / "tilth" / "estimator"
    shutil.copytree(ROOT / "estimator", ours, ignore=shutil.ignore_patterns("__pycache__", "kernels"))
    for folder in (root, ours, *(room for room in ours.rglob("*") if room.is_dir())):
        (folder / "__pycache__").write_text("in the way")
    in_the_way = str(root / "__pycache__")
    return {
        **os.environ, "PYTHONPATH": str(root), "HOME": in_the_way, "XDG_CACHE_HOME": in_the_way,
        "NUMBA_CACHE_DIR": in_the_way,
    }  # fmt: skip


def test_no_place_for_kernels_is_said_by_check(nowhere: dict[str, str], tmp_path: Path) -> None:
    text = machine_text(tmp_path / "logs", '[[bus]]\nname = "can0"\ninterface = "virtual"\nchannel = "v"\n\n')
    (tmp_path / "m.toml").write_text(text)
    words = ["check", str(tmp_path / "m.toml"), "--seconds", "0.1"]
    for environment, state in ((nowhere, "PROBLEM"), (dict(os.environ), "OK")):
        done = subprocess.run(
            [sys.executable, "-c", DEMO, *words],
            env=environment,
            cwd=tmp_path,
            check=False,
            capture_output=True,
            text=True,
        )
        (line,) = [line for line in done.stdout.splitlines() if " kernels: " in line]
        assert line.startswith(state), done.stderr
        assert ("set NUMBA_CACHE_DIR to a folder" in line) == (state == "PROBLEM")


def demo(environment: dict[str, str], folder: Path) -> tuple[dict[str, Any], str]:
    """What six seconds of it say, and what it says of itself meanwhile."""
    command = [sys.executable, "-c", DEMO, "demo", "--seconds", "6", "--json", "--no-page"]
    done = subprocess.run(
        [*command, "--log", str(folder)], env=environment, check=False, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    output: dict[str, Any] = json.loads(done.stdout)
    assert output["frames_lost"] == 0 and output["poses"] >= 25 and "stamp" not in output["rejected"], output
    return output, done.stderr


def seconds_of(paths: list[Path]) -> tuple[float, float, float]:
    """From a run's start to its first frame, to when the estimators were ready, to the first estimate; nan
    where the log has none, as where they are ready from the start."""
    began_ns, first = 0, dict[str, int]()
    for path in paths:
        with path.open("rb") as stream:
            reader = make_reader(stream)
            for record in reader.iter_metadata():
                if record.name == "clock" and record.metadata["why"] == "start":
                    began_ns = int(record.metadata["t_ns"])
            for _, channel, message in reader.iter_messages(log_time_order=False):
                name = "frame" if channel.topic.startswith("/can/") else channel.topic
                if name != READY_TOPIC or Ready.FromString(message.data).ready:
                    first.setdefault(name, message.log_time)
    names = ("frame", READY_TOPIC, "/soil_tire/tracker")
    return tuple(  # type: ignore[return-value]
        (first[name] - began_ns) * 1e-9 if name in first else math.nan for name in names
    )


@pytest.mark.cold
@pytest.mark.parametrize("expected", [True, False], ids=["expected", "nowhere"])
def test_the_first_start_on_a_new_computer_records_from_the_first_second(
    tmp_path: Path, nowhere: dict[str, str], expected: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    # For a processor that lacks the baseline nothing is there, as in an installed Tilth.
    ours = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "kernels"), "NUMBA_CPU_NAME": "x86-64-v2"}
    output, result = demo(ours if expected else nowhere, tmp_path / "logs")
    logs = [Path(name) for name in output["log"]]  # one, unless this computer is very busy
    frame_s, ready_s, estimate_s = seconds_of(logs)
    # What was driven meanwhile is caught up with within 3 s, and estimates come each second.
    assert frame_s < 3.0 and 5.0 < ready_s <= estimate_s < ready_s + 4.5
    assert output["duration_s"] > ready_s + 4.0  # its time counts from then
    assert (
        result.count("compiled: compiling kernels")
        == result.count("compiled: kernels were compiled for")
        == 1
    )
    assert result.count("set NUMBA_CACHE_DIR to a folder") == (not expected)
    assert " s left" in result
    statuses = [one for log in logs for one in records_of(log, "/status", Status)]
    remaining = [one.ready_in_s for one in statuses if one.HasField("ready_in_s")]
    assert len(remaining) > 1 and remaining[-1] < max(remaining) and not statuses[-1].preparing
    assert max(one.longest_turn_s for one in statuses if one.preparing) < 2.0  # the loop is not held up
    assert main(["replay", *output["log"], "--verify", "--json"]) == 0
    again = json.loads(capsys.readouterr().out)
    assert again["verify"]["difference"] is None and again["verify"]["compared"] > output["measurements"]
    assert all(again[key] == output[key] for key in ("frames", "measurements", "poses"))
    # A replay fits what was driven up to the end of the log too.
    here, there = (
        {row.method: each["estimates"].get(row.method) for row in ROW.values() if row.fitting is None}
        for each in (again, output)
    )
    assert here == there and here
    if expected:  # the second start finds them
        output, result = demo(ours, tmp_path / "logs")
        assert "compil" not in result and seconds_of([Path(name) for name in output["log"]])[0] < 3.0


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ([], "usage: python -m tilth.logger.compiling MACHINE.toml [only]\n"),
        (["nowhere.toml"], "nowhere.toml: the machine file cannot be read (no such file"),
    ],
)
def test_it_is_a_command_too(words: list[str], expected: str) -> None:
    """The one with which each run of the tests begins (conftest.py)."""
    done = subprocess.run(
        [sys.executable, "-m", "tilth.logger.compiling", *words], check=False, capture_output=True, text=True
    )
    assert done.returncode == 2 and done.stderr.startswith(expected)


LOOSENED: dict[str, Callable[[Path], object]] = {
    "the folder": lambda folder: folder.chmod(0o777),
    "to its group": lambda folder: folder.chmod(0o775),
    "a folder above": lambda folder: folder.parent.chmod(0o757),
    "a folder in it": lambda folder: (folder / "pose_1a").chmod(0o777),
    "a file in it": lambda folder: (folder / "pose_1a/pose.nbi").chmod(0o666),
}


@pytest.fixture
def kernels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "cache" / "kernels"
    (folder / "pose_1a").mkdir(parents=True)
    (folder / "pose_1a/pose.nbi").touch()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(folder))
    return folder


def test_a_folder_of_ones_own_is_trusted(kernels: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert compiling.untrusted() == ""
    kernels.parent.chmod(0o1777)  # sticky, as /tmp
    (kernels / "link").symlink_to("/dev/null")
    assert compiling.untrusted() == ""
    for other in (str(kernels / "none"), ""):
        monkeypatch.setenv("NUMBA_CACHE_DIR", other)
        assert compiling.untrusted() == ""


@pytest.mark.parametrize("what", LOOSENED)
def test_one_that_others_may_write_is_not(what: str, kernels: Path) -> None:
    LOOSENED[what](kernels)
    assert "can be written by others" in compiling.untrusted()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives files away")
@pytest.mark.parametrize("place", [".", "..", "pose_1a", "pose_1a/pose.nbi"])
def test_nor_one_that_belongs_to_another(place: str, kernels: Path) -> None:
    os.chown(kernels / place, 12345, 0)
    assert "can be written by others" in compiling.untrusted()


ELSEWHERE = """
import os, time
from logs import MACHINE
from tilth.logger.compiling import Preparing
from tilth.schemas.sentences import notice_sentence
said = []
preparing = Preparing(MACHINE, lambda kind, told: said.append(notice_sentence(told)))
deadline = time.monotonic() + 120.0
while preparing._job is None and time.monotonic() < deadline:
    time.sleep(0.02)
print(said[0], os.environ["NUMBA_CACHE_DIR"], preparing.text, sep="\\n")
preparing.close()
"""


def test_the_recorder_takes_nothing_from_there(kernels: Path, tmp_path: Path) -> None:
    kernels.chmod(0o777)
    path = {"PYTHONPATH": ":".join(sys.path), "NUMBA_CPU_NAME": "x86-64-v2"}  # for which nothing is packaged
    done = subprocess.run(
        [sys.executable, "-c", ELSEWHERE], env=os.environ | path, capture_output=True, text=True, check=True
    )
    said, folder, text = done.stdout.splitlines()
    assert "can be written by others" in said and not folder.startswith(str(tmp_path)), done.stdout
    assert text.startswith("compiling kernels, which cannot be kept")
    assert [one.name for one in kernels.rglob("*")] == ["pose_1a", "pose.nbi"]
