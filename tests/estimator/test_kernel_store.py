"""Compiled kernels lie in the package: who may write nowhere finds them; other code finds nothing."""

import json
import os
import platform
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from installed import STARTED
from logs import MACHINE_FILE

from tilth.estimator import kernel_store


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where a wheel has been unpacked."""
    folder = tmp_path_factory.mktemp("site")
    with zipfile.ZipFile(wheel) as content:
        content.extractall(folder)
    return folder


def started(installed: Path, tmp_path: Path, **environment: str) -> tuple[bool, int, str, str]:
    """A process of an installed Tilth, for whose kernels there is no other place. Whether it was ready
    without compiling, what it compiled, the package's folder, and what kernels are for."""
    blocked = tmp_path / "blocked"
    blocked.touch()
    nowhere = dict.fromkeys(("NUMBA_CACHE_DIR", "HOME", "XDG_CACHE_HOME"), str(blocked))
    ours = {"PYTHONPATH": str(installed), "PYTHONDONTWRITEBYTECODE": "1", **nowhere, **environment}
    done = subprocess.run(
        [sys.executable, "-c", STARTED, str(MACHINE_FILE)],
        env=os.environ | ours,
        check=False,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    ready, compiled, folder, target = json.loads(done.stdout)
    return ready, compiled, folder, target


@pytest.mark.skipif(bool(kernel_store.lacking()), reason="this processor lacks the baseline")
@pytest.mark.long
def test_an_installed_tilth_compiles_nothing(installed: Path, tmp_path: Path) -> None:
    ready, compiled, folder, target = started(installed, tmp_path)
    assert folder.startswith(str(installed)) and target in ("x86-64-v3", "generic")
    assert (ready, compiled) == (True, 0)


def test_no_kernel_of_another_processor_or_of_other_sources_is_packaged(installed: Path) -> None:
    names = [path.name for path in (installed / "tilth/estimator/kernels").iterdir()]
    here, _ = kernel_store.BASELINES[platform.machine()]
    assert len(names) > 50 and not [name for name in names if f"-{here}." not in name or "stale" in name]


@pytest.mark.skipif(bool(kernel_store.lacking()), reason="this processor lacks the baseline")
def test_a_changed_constant_is_not_run_as_it_was_compiled(installed: Path, tmp_path: Path) -> None:
    """A gate, which is a constant of another module than the tracker's kernels that read it."""
    source = installed / "tilth/estimator/filters/gates.py"
    text = source.read_text()
    before, after = "yaw_rate: float = tuned(5.0", "yaw_rate: float = tuned(4.9"
    assert text.count(before) == 1
    source.write_text(text.replace(before, after))
    try:
        assert started(installed, tmp_path)[0] is False
    finally:
        source.write_text(text)


def test_for_another_processor_nothing_is_taken_from_the_package(installed: Path, tmp_path: Path) -> None:
    ready, _, _, target = started(installed, tmp_path, NUMBA_CPU_NAME="x86-64-v2", NUMBA_CPU_FEATURES="")
    assert not ready and target == "x86-64-v2"


def test_the_baseline_is_what_this_family_of_processors_has(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernel_store, "get_host_cpu_features", lambda: {"avx2": True, "fma": False})
    monkeypatch.setattr("platform.machine", lambda: "x86_64")
    assert "processor (x86_64) lacks bmi, bmi2, f16c, fma, lzcnt, movbe:" in kernel_store.lacking()
    monkeypatch.setattr("platform.machine", lambda: "riscv64")
    assert "(riscv64) lacks a baseline:" in kernel_store.lacking()
    monkeypatch.setattr("platform.machine", lambda: "aarch64")
    assert not kernel_store.lacking()
