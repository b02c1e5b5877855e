"""The wheel that each Python builds, in an environment of its own: installed, and a tractor driven."""

import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest
from paths import ROOT

MINORS = range(11, 15)
pytestmark = [
    pytest.mark.interpreters,
    pytest.mark.skipif(shutil.which("uv") is None, reason="needs uv"),
]


def interpreter(minor: int) -> str | None:
    """pyenv's, whose names on the path work only while they are chosen, or the system's."""
    kept = sorted(Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")).glob(f"versions/3.{minor}.*"))
    return next((str(one / "bin/python") for one in kept), None) or shutil.which(f"python3.{minor}")


def said(*words: str | Path, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Without what this environment tells a child of itself."""
    plain = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "VIRTUAL"))}
    done = subprocess.run(words, cwd=cwd, env=plain, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    return done


@pytest.mark.parametrize("minor", MINORS, ids=lambda minor: f"3.{minor}")
def test_a_wheel_for_this_python_is_whole(minor: int, tmp_path: Path) -> None:
    python = interpreter(minor)
    if python is None:
        pytest.skip(f"no Python 3.{minor} here")
    tree = tmp_path / "tilth"
    shutil.copytree(ROOT, tree, ignore=shutil.ignore_patterns(".*", "build", "dist", "logs", "kernels"))
    said("uv", "build", "--wheel", "--quiet", "--python", python, "--out-dir", tmp_path, tree, cwd=tmp_path)
    (wheel,) = tmp_path.glob("tilth-*.whl")
    venv = tmp_path / "venv"
    said("uv", "venv", "--quiet", "--python", python, venv, cwd=tmp_path)
    constraints = ROOT / "deploy/constraints.txt"
    install: list[str | Path] = [
        "uv",
        "pip",
        "install",
        "--quiet",
        "--python",
        venv / "bin/python",
        "--constraint",
        constraints,
    ]
    said(*install, wheel, cwd=tmp_path)
    assert said(venv / "bin/python", "--version", cwd=tmp_path).stdout.startswith(f"Python 3.{minor}.")
    demo = said(venv / "bin/tilth", "demo", "--seconds", "6", "--json", cwd=tmp_path)
    result = json.loads(demo.stdout)
    assert result["frames_lost"] == 0 and result["frames"] > 3000 and result["poses"] >= 25
    assert "compil" not in demo.stderr, "the wheel carries what is compiled for this Python"
    held = [one.name for one in (venv / "lib").glob("python3.*/site-packages/tilth/estimator/kernels/*.nbi")]
    assert held and all(f".py3{minor}." in name for name in held)
