"""Options of the test run, and what it makes once for all."""

import gc
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # before numpy: on few cores its threads wait for each other

import pytest
from logs import MACHINE, MACHINE_FILE
from loopback import Sender
from paths import ROOT, SUPPORT
from recorded import RUN_FOLDER, once

from tilth.estimator.kernel_store import BASELINES
from tilth.logger import compiling
from tilth.logger.can.lean_can import import_can
from tilth.schemas.machine import Machine

if TYPE_CHECKING:
    import can
    from playwright.sync_api import Browser

# Many tests start processes, which would each compile all that they import: three times the computing.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False


def pytest_sessionstart(session: pytest.Session) -> None:
    """Compile once, before all processes and what they start would each do it."""
    if getattr(session.config.option, "numprocesses", None):
        once("compiled", _compiled)


def _compiled(folder: Path) -> None:
    """folder: nothing is left there; numba keeps what is compiled."""
    commands = ["-m", "tilth.logger.compiling", str(MACHINE_FILE)], [str(SUPPORT / "compiled_before.py")]
    for process in [subprocess.Popen([sys.executable, *words]) for words in commands]:
        assert process.wait() == 0, process.args


def pytest_configure(config: pytest.Config) -> None:
    """Drives and fits that a test of one process has made are there for those of the others."""
    gc.disable()  # what is imported and collected is no garbage
    import_can()  # before anybody else: else asammdf and pandas come along, in each process
    if RUN_FOLDER not in os.environ:
        folder = tempfile.TemporaryDirectory(prefix="tilth-tests-")
        os.environ[RUN_FOLDER] = folder.name
        config.add_cleanup(folder.cleanup)


ONE_MARKER = re.compile(r"(\w+)( and not \w+)*")
OF_A_FILE = re.compile(r"^pytestmark = \[?pytest\.mark\.(\w+)", re.MULTILINE)


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """A run reads the files that have tests for it: to import all takes longer than most runs of one marker,
    and each process of the ordinary run would import what none of its tests needs."""
    if collection_path.suffix != ".py" or not (wanted := config.option.markexpr):
        return None
    text = collection_path.read_text(encoding="utf-8")
    if (of_all := OF_A_FILE.search(text)) and f"not {of_all[1]}" in re.split(" and ", wanted):
        return True
    one = ONE_MARKER.fullmatch(wanted)
    return None if one is None or f"mark.{one[1]}" in text or "sampled(" in text else True


def pytest_collection_finish(session: pytest.Session) -> None:
    """Whoever looks for garbage from here on does not look through modules and ten thousand tests."""
    gc.freeze()
    gc.enable()


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--refresh", action="store_true", help="write the golden files anew instead of comparing"
    )


@pytest.fixture(scope="session")
def wheel() -> Path:
    """Of this checkout, in which an earlier build has left a module that is no longer there."""
    return once("wheel", _built)


def _built(folder: Path) -> Path:
    root = folder / "checkout" / "tilth"
    others = (".*", "tests", "docs", "bench", "build", "dist", "logs", "*.egg-info", "__pycache__")
    shutil.copytree(ROOT, root, ignore=shutil.ignore_patterns(*others))
    (root / "build/lib/tilth/cli").mkdir(parents=True)
    (root / "build/lib/tilth/cli/stale.py").touch()
    for target in BASELINES.values():  # kernels that nobody calls, of this and of the other processor
        (root / f"estimator/kernels/arrays.stale-0-{target[0]}.py311.nbi").touch()
    build = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(folder), str(root)]
    built = subprocess.run(build, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stdout[-2000:] + built.stderr[-2000:]
    (path,) = folder.glob("*.whl")
    return path


@pytest.fixture(scope="session")
def machine() -> Machine:
    """The packaged rig."""
    return MACHINE


@pytest.fixture(scope="session")
def prepared() -> None:
    """A daemon of this process estimates from its first frame on."""
    compiling.prepare(MACHINE, lambda share: None)


@pytest.fixture(scope="module")
def sender() -> Iterator[Sender]:
    """Of frames, over loopback."""
    with Sender() as process:
        yield process


@pytest.fixture(scope="module")
def browser() -> "Iterator[Browser]":
    """For pages, with `chromium.with_browser`."""
    from chromium import launched  # a browser's library: only who asks pays for it

    with launched() as one:
        yield one


@pytest.fixture
def watched_by_hand(monkeypatch: pytest.MonkeyPatch) -> None:
    """Time goes by as the tests say, however busy this computer is."""
    monkeypatch.setattr("tilth.logger.can.buses.WATCH_NS", 1 << 62)


@pytest.fixture
def talker() -> "Iterator[can.BusABC]":
    """The other end of virtual("v")."""
    import can

    with can.Bus(interface="virtual", channel="tilth-v") as bus:
        yield bus
