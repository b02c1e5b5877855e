"""Builds the examples in Rust; what a machine has built once it keeps."""

import shutil
import subprocess
from pathlib import Path

import pytest


def build(command: list[str], folder: Path) -> str:
    built = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert built.returncode == 0, (built.stdout + built.stderr)[-3000:]
    return built.stdout


def in_rust(folder: Path) -> Path:
    """The program of that crate. CARGO_TARGET_DIR, where it is set, keeps what was built."""
    if shutil.which("cargo") is None:
        pytest.skip("no cargo here: install Rust to build the example")
    told = build(["cargo", "build", "--locked", "--message-format=json"], folder)
    (last,) = (line for line in told.splitlines() if '"executable":"' in line)
    return Path(last.partition('"executable":"')[2].partition('"')[0])
