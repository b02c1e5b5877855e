"""What has to be compiled is so before the first bus is opened: it takes longer than any frame can wait."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from logs import MACHINE_FILE

HERE = Path(__file__).parent
NEEDED = """
import gc, sys
from dataclasses import replace
from circle import demo_machine
from drives import LEARNING, QUIET
from tilth.estimator.compiled import Kernel
from tilth.logger.compiling import prepare
from tilth.logger.guarded_fold import GuardedFold
from tilth.replay.scenario import Fault
from tilth.replay.traffic import simulate
from tilth.schemas.flow import Mount

def compiled():
    kernels = [one for one in gc.get_objects() if isinstance(one, Kernel) and one.how != "not called yet"]
    return {one.function.__qualname__: (one.how, len(one._run.signatures)) for one in kernels}

machine = demo_machine()
estimation = machine.estimation.model_copy(update={"two_step": True})
machine = machine.model_copy(update={"estimation": estimation})
silent = Fault(Mount.IMPLEMENT_REAR, 20.0, 24.0, "silent")
faults = (silent, Fault(Mount.TRACTOR_FRONT, 30.0, 30.5, "rtk_float"))
frames = list(simulate(machine, 3, 42.0, replace(QUIET, faults=faults)))
prepare(machine, sys.stderr.write)
before = compiled()
assert before and all(how == "compiled and kept" for how, _ in before.values()), before
fold = GuardedFold(machine)
for frame in frames:
    fold.take(frame)
fold.renew()
assert fold.faults == 0 and fold.poses > 190, (fold.faults, fold.poses)
assert all(fold.estimates[method].parameters[0].value for method in ("tracker", "pem")), fold.estimates
assert compiled() == before, (compiled(), before)
"""
DEMO = """
import sys
sys.modules["asammdf"] = None  # two seconds of import for reading files
from tilth.cli import main
raise SystemExit(main())
"""


def test_what_a_drive_calls_was_prepared() -> None:
    """Whatever the estimators do: stretches, advice, fits in place, faults. A process of its own, since here
    others have called kernels before."""
    command = [sys.executable, "-c", NEEDED]
    done = subprocess.run(command, cwd=HERE, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.cold
def test_the_first_demo_on_a_new_computer_loses_nothing(tmp_path: Path) -> None:
    command = [sys.executable, "-c", DEMO, "demo", "--seconds", "6", "--json", "--no-page"]
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "kernels")}
    for told in (True, False):  # the second finds what was kept
        done = subprocess.run(
            [*command, "--log", str(tmp_path / "logs")],
            env=environment,
            check=False,
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stderr
        said = json.loads(done.stdout)
        assert said["frames_lost"] == 0 and said["poses"] >= 25 and "stamp" not in said["rejected"], said
        assert done.stderr.count("compiling kernels, once per machine") == told
        assert done.stderr.count("compiled: kernels were compiled for") == told
        assert "no frame for" not in done.stderr and "is silent" not in done.stderr


@pytest.mark.parametrize(
    ("words", "status", "said"),
    [
        ([], 2, "usage: python -m tilth.logger.compiling MACHINE.toml\n"),
        (["nowhere.toml"], 2, "nowhere.toml: the machine file cannot be read (no such file"),
        ([str(MACHINE_FILE)], 0, ""),
    ],
)
def test_it_is_a_command_too(words: list[str], status: int, said: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "tilth.logger.compiling", *words], check=False, capture_output=True, text=True
    )
    assert done.returncode == status and done.stderr.startswith(said) and bool(done.stderr) == bool(said)
