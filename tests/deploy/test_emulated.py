"""A log that this computer has recorded is verified on an emulated ARMv8: by the checkout, by the wheel of
the package, and by the package as apt installs it there."""

import json
import os
import platform
import shutil
import subprocess
import tempfile
from pathlib import Path

import emulated_debian
import pytest
from installed import STARTED
from logs import MACHINE, MACHINE_FILE, record

from tilth.deploy import emulated, package
from tilth.simulator.traffic import simulate

ROOT = Path(tempfile.gettempdir()) / "tilth-armv8"  # kept: it takes minutes to make
DEBIAN = ROOT.with_name("tilth-armv8-debian")  # kept too
pytestmark = [
    pytest.mark.elsewhere,
    pytest.mark.skipif(not emulated.EMULATOR.exists(), reason="no qemu: apt-get install qemu-user-static"),
    pytest.mark.skipif(shutil.which("mmdebstrap") is None, reason="apt-get install mmdebstrap arch-test"),
]


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, int]:
    """Of half a minute, and how many results are in it."""
    live = record(tmp_path_factory.mktemp("log"), list(simulate(MACHINE, 3, 30.0)), 1)
    return live.parts[0], live.results


@pytest.fixture(scope="module")
def deb(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """By the one command, of this checkout."""
    out = tmp_path_factory.mktemp("package")
    assert package.main([str(out), "--armv8", str(ROOT)]) == 0
    (made,) = out.glob("tilth_*_arm64.deb")
    return made


def expect_verified(said: str, results: int) -> None:
    found = json.loads(said)["verify"]
    assert (found["difference"], found["compared"]) == (None, results)
    assert f"{platform.machine()}, here aarch64" in found["recorded_elsewhere"]


def test_another_kind_of_processor_gives_the_same(
    log: tuple[Path, int], capfd: pytest.CaptureFixture[str]
) -> None:
    """Where the checkout has no kernels of ARMv8 yet, they are compiled first: ten minutes."""
    emulated.make(ROOT)
    done = emulated.run(ROOT, "-m", "tilth.cli", "replay", "--verify", "--json", log[0])
    assert done.returncode == 0
    expect_verified(capfd.readouterr().out, log[1])


def test_a_package_is_made_that_compiles_nothing_there(
    log: tuple[Path, int], deb: Path, tmp_path: Path
) -> None:
    """Its wheel is unpacked where nothing else of Tilth is, nor a place for kernels."""
    subprocess.run(["dpkg-deb", "--extract", deb, tmp_path / "tree"], check=True)
    (wheel,) = (tmp_path / "tree" / package.HOME / "wheels").glob("tilth-*-linux_aarch64.whl")
    shutil.unpack_archive(wheel, tmp_path / "site", "zip")
    blocked = tmp_path / "blocked"
    blocked.touch()
    nowhere = dict.fromkeys(("NUMBA_CACHE_DIR", "HOME", "XDG_CACHE_HOME"), str(blocked))
    ours = {**emulated.environment(ROOT), **nowhere, "PYTHONPATH": str(tmp_path / "site")}
    words = [*emulated.python(ROOT), "-c", STARTED, MACHINE_FILE]
    started = subprocess.run(words, env=ours, check=True, capture_output=True, text=True, cwd=tmp_path)
    assert json.loads(started.stdout) == [True, 0, f"{tmp_path}/site/tilth/estimator/kernels", "generic"]
    words = [*emulated.python(ROOT), "-m", "tilth.cli", "replay", "--verify", "--json", log[0]]
    done = subprocess.run(words, env=ours, check=True, capture_output=True, text=True, cwd=tmp_path)
    expect_verified(done.stdout, log[1])


@pytest.mark.skipif(os.geteuid() != 0, reason="takes root")
def test_it_is_installed_verifies_a_log_is_removed_and_asks_before_logs_go(
    log: tuple[Path, int], deb: Path, tmp_path: Path
) -> None:
    """By apt, in a Debian of its own without a network."""
    emulated_debian.make(DEBIAN)
    shutil.copy(deb, tmp_path)
    shutil.copy(log[0], tmp_path / "log.mcap")
    shutil.copy(MACHINE_FILE, tmp_path / "machine.toml")
    emulated_debian.run(DEBIAN, Path(__file__).with_name("package_arm64.sh").read_text(), tmp_path)
    expect_verified((tmp_path / "verify.json").read_text(), log[1])
    assert "Remove the logs that Tilth has recorded?" in (tmp_path / "asked.txt").read_text()
