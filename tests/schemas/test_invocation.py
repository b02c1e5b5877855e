"""Commands that are printed run as they are printed: from a checkout, by a path, from the PATH."""

import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from paths import ROOT

from tilth.cli import _started
from tilth.schemas.invocation import command, in_background, installing, started_as

TILTH = Path(sys.executable).with_name("tilth")


def environment(**more: str) -> dict[str, str]:
    """Of a shell that nobody started by `uv run`."""
    retained = {
        name: value for name, value in os.environ.items() if not name.startswith(("UV", "VIRTUAL_ENV"))
    }
    return retained | more


@pytest.fixture(autouse=True)
def as_before() -> None:
    """Whoever comes next sets it by itself: main does."""
    started_as(["tilth"])


def test_how_it_was_started(tmp_path: Path) -> None:
    assert TILTH.exists()
    assert _started(str(TILTH), {"UV_RUN_RECURSION_DEPTH": "1"}) == ["uv", "run", "tilth"]
    assert _started(str(TILTH), {"PATH": str(TILTH.parent)}) == ["tilth"]
    assert _started(str(TILTH), {"PATH": str(tmp_path)}) == [str(TILTH)]
    assert _started("/usr/bin/pytest", {"PATH": ""}) == ["tilth"]
    assert _started("tilth", {"PATH": str(tmp_path)}) == ["tilth"]  # a path that is gone


def test_words_are_quoted_for_a_shell() -> None:
    started_as(["uv", "run", "tilth"])
    assert command("replay", "my logs/a.mcap") == "uv run tilth replay 'my logs/a.mcap'"
    assert installing("mf4") == "uv sync --inexact --extra mf4"
    started_as(["/opt/my tilth/bin/tilth"])
    assert command("run") == "'/opt/my tilth/bin/tilth' run"
    assert installing("mf4") == "pip install 'tilth[mf4]'"


def test_only_a_program_that_says_how_starts_others_behind_all_else() -> None:
    assert in_background("report", "a.mcap") == []
    started_as(["tilth"], ["python", "-m", "behind"])
    assert in_background("report", "my logs/a.mcap") == ["python", "-m", "behind", "report", "my logs/a.mcap"]


@pytest.mark.parametrize("uv", [False, True])
def test_a_hint_runs_as_it_is_printed(tmp_path: Path, uv: bool) -> None:
    """What is said of a log where a machine file should be, in a folder whose name has a space."""
    if uv and shutil.which("uv") is None:
        pytest.skip("uv is not installed")
    (tmp_path / "a folder").mkdir()
    log = tmp_path / "a folder/some.mcap"
    log.write_bytes(b"\x89MCAP0\r\n")
    shell = environment(UV_NO_SYNC="1") if uv else environment(PATH="/usr/bin:/bin")  # tilth is not there
    words = [*(["uv", "run", "tilth"] if uv else [str(TILTH)]), "check", str(log)]
    result = subprocess.run(words, cwd=ROOT, env=shell, capture_output=True, text=True, check=False)
    decoded = result.stderr.rstrip().partition("to read it: ")[2]
    assert shlex.split(decoded) == [*words[:-2], "replay", str(log)], result.stderr
    ended = subprocess.run(
        ["sh", "-c", decoded], cwd=ROOT, env=shell, capture_output=True, text=True, check=False
    )
    assert ended.returncode == 2 and ended.stderr.startswith(f"tilth replay: {log}: "), ended.stderr
