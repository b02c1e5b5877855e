"""The installer for real, in a folder for a computer."""

import os
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest
from paths import ROOT

from tilth.deploy.install import KERNELS

INSTALLER = ROOT / "deploy" / "install.py"
PYTHON = Path(sys.base_prefix) / "bin" / "python3"  # as on a bare computer, with pip


@cache
def has_pip() -> bool:
    asked = subprocess.run([str(PYTHON), "-m", "pip", "--version"], capture_output=True, check=False)
    return asked.returncode == 0


def without_tilth(target: Path) -> Path:
    """All that Tilth needs, as an environment would have it once pip has fetched it. Skips the test where
    the computer's Python has no pip to install Tilth with."""
    if not has_pip():
        pytest.skip(f"no pip for {PYTHON}: apt-get install python3-pip")
    target.mkdir()
    for path in Path(pytest.__file__).parents[1].iterdir():
        if not path.name.startswith(("tilth", "__editable__")) and path.suffix != ".pth":
            (target / path.name).symlink_to(path)
    return target


class Box:
    """A folder that stands for a computer."""

    def __init__(self, folder: Path, needed: Path, kernels: bool = False) -> None:
        """kernels: whether they are compiled, which takes half a minute for each release."""
        self.root = folder / "root"
        self.environment = {
            **os.environ,
            "PIP_NO_DEPS": "1",
            "PIP_NO_COMPILE": "1",
            "NUMBA_DISABLE_JIT": "0" if kernels else "1",
            "PYTHONPATH": str(needed),
        }

    def setup(self, *words: str | Path) -> "subprocess.CompletedProcess[str]":
        command = [str(PYTHON), str(INSTALLER), "--root", str(self.root), *map(str, words)]
        return subprocess.run(command, capture_output=True, text=True, check=False, env=self.environment)

    def tilth(self, *words: str) -> "subprocess.CompletedProcess[str]":
        command = [str(self.root / "opt/tilth/current/bin/tilth"), *words]
        environment = {**self.environment, "NUMBA_CACHE_DIR": str(self.root / KERNELS)}
        return subprocess.run(command, capture_output=True, text=True, check=False, env=environment)

    def release(self, link: str) -> str:
        return (self.root / "opt/tilth" / link).resolve().name

    def files(self) -> set[str]:
        """All but what the releases hold."""
        return {
            str(path.relative_to(self.root))
            for path in self.root.rglob("*")
            if not path.is_dir() and "releases" not in path.parts
        }
