"""Writing what is generated: which files, only where they differ, and none by --check or --help."""

import math
import shutil
from pathlib import Path
from typing import Any

import pytest
from paths import ROOT

from tilth.deploy import codes_page, motion_equations, observation_equations, wire_page
from tilth.deploy.generate import PROTO, main
from tilth.deploy.kernel_text import kernel

pytestmark = pytest.mark.skipif(shutil.which("uv") is None, reason="needs uv")
SOURCES = ("pyproject.toml", "uv.lock", f"{PROTO}/tilth.proto")
FILES = {
    f"{PROTO}/tilth_pb2.py",
    f"{PROTO}/tilth_pb2.pyi",
    "schemas/machine.schema.json",
    motion_equations.TARGET,
    codes_page.TARGET,
    wire_page.TARGET,
    observation_equations.TARGET,
    "deploy/constraints.txt",
}


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """The sources of what is generated, and two generated files that are out of date."""
    for name in SOURCES:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    for name in FILES:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
    for name in ("schemas/machine.schema.json", f"{PROTO}/tilth_pb2.py"):
        (tmp_path / name).write_text("old")
    return tmp_path


def _contents(tree: Path) -> dict[str, bytes]:
    return {str(path.relative_to(tree)): path.read_bytes() for path in tree.rglob("*") if path.is_file()}


def test_check_names_what_is_not_current_and_writes_nothing(
    tree: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = _contents(tree)
    assert main(["--check"], tree) == 1
    assert {line.removesuffix(": not current") for line in capsys.readouterr().out.splitlines()} == FILES
    assert _contents(tree) == before


def test_it_writes_what_differs_and_is_current_then(tree: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([], tree) == 0
    assert {line.removesuffix(": written") for line in capsys.readouterr().out.splitlines()} == FILES
    assert set(_contents(tree)) == {*SOURCES, *FILES}
    assert (main(["--check"], tree), capsys.readouterr().out) == (0, "")
    (tree / "deploy" / "constraints.txt").write_text("old")
    assert main([], tree) == 0
    assert capsys.readouterr().out == "deploy/constraints.txt: written\n"


@pytest.mark.parametrize(("words", "status"), [(["--help"], 0), (["--chekc"], 2), (["all"], 2)])
def test_help_and_wrong_words_write_nothing(
    words: list[str], status: int, tree: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = _contents(tree)
    with pytest.raises(SystemExit) as end:
        main(words, tree)
    assert end.value.code == status
    assert "--check" in "".join(capsys.readouterr())
    assert _contents(tree) == before


def test_what_occurs_twice_is_computed_once_and_is_equal() -> None:
    lines = [
        "    t0 = x - y",
        "    s0 = z*(10 - 10*(sin(t0*x + 3)*sin(t0*x + 3)))",
        "    t1 = z*sin(t0*x + 3)",
        "    return z*(1 - sin(t0*x + 3)*sin(t0*x + 3)) + s0/(10 - 10*(sin(t0*x + 3)*sin(t0*x + 3))) - t1",
    ]
    text = kernel("f", "", "x: float, y: float, z: float", lines, gives="float").removeprefix("@kernel\n")
    plain = "def f(x, y, z):\n" + "\n".join(lines)
    found: list[float] = []
    for source in (text, plain):
        scope: dict[str, Any] = {"sin": math.sin}
        exec(source, scope)
        found.append(scope["f"](0.3, 0.7, 1.1))
    assert found[0] == found[1] and text.count("sin") == 1 and plain.count("sin") == 7
