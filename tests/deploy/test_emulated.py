"""A log that this computer has recorded is verified on an emulated ARMv8, by checkout and by package."""

import json
import platform
import shutil
import subprocess
import tempfile
from pathlib import Path

import pytest
from installed import STARTED
from logs import MACHINE, MACHINE_FILE, record

from tilth.deploy import emulated, package
from tilth.simulator.traffic import simulate

ROOT = Path(tempfile.gettempdir()) / "tilth-armv8"  # kept: it takes minutes to make
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


def test_a_package_is_made_that_compiles_nothing_there(log: tuple[Path, int], tmp_path: Path) -> None:
    """By the one command. Its wheel is unpacked where nothing else of Tilth is, nor a place for kernels."""
    assert package.main([str(tmp_path), "--armv8", str(ROOT)]) == 0
    (made,) = tmp_path.glob("tilth_*_arm64.deb")
    subprocess.run(["dpkg-deb", "--extract", made, tmp_path / "tree"], check=True)
    (wheel,) = (tmp_path / "tree" / package.HOME / "wheels").glob("tilth-*-linux_aarch64.whl")
    shutil.unpack_archive(wheel, tmp_path / "site", "zip")
    blocked = tmp_path / "blocked"
    blocked.touch()
    nowhere = dict.fromkeys(("NUMBA_CACHE_DIR", "HOME", "XDG_CACHE_HOME"), str(blocked))
    ours = {**emulated.environment(ROOT), **nowhere, "PYTHONPATH": str(tmp_path / "site")}
    words = [
        *emulated.python(ROOT),
        "-c",
        STARTED,
        MACHINE_FILE,
    ]
    started = subprocess.run(words, env=ours, check=True, capture_output=True, text=True, cwd=tmp_path)
    assert json.loads(started.stdout) == [True, 0, f"{tmp_path}/site/tilth/estimator/kernels", "generic"]
    words = [*emulated.python(ROOT), "-m", "tilth.cli", "replay", "--verify", "--json", log[0]]
    done = subprocess.run(words, env=ours, check=True, capture_output=True, text=True, cwd=tmp_path)
    expect_verified(done.stdout, log[1])
