"""The notebooks run from their first cell to the last, and say what they promise."""

import os
import subprocess
import sys

import pytest
from paths import ROOT
from recorded import recorded, shared_cache

NOTEBOOKS = {
    "log_to_parameters": ("C_af", "segments agree", "machine file", "each:"),
    "parameters_to_gains": ("gains for the learned soil", "slowest pole of 200 draws"),
}


def test_each_notebook_is_tested() -> None:
    assert {path.stem for path in (ROOT / "examples/notebooks").glob("*.py")} == set(NOTEBOOKS)


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_a_notebook_runs(name: str) -> None:
    path = ROOT / "examples/notebooks" / f"{name}.py"
    environment = {**os.environ, "XDG_CACHE_HOME": str(shared_cache()), "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, "-W", "error", str(path)]
    made = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    assert made.returncode == 0, made.stderr[-2000:]
    for text in NOTEBOOKS[name]:
        assert text in made.stdout, made.stdout[-2000:]


def test_the_examples_of_the_page_run(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(shared_cache()))
    page = (ROOT / "docs/analysis.md").read_text(encoding="utf-8")
    names = {"log": recorded().parts[0]}
    blocks = [part.partition("```")[0] for part in page.split("```python\n")[1:]]
    assert len(blocks) == 3
    for block in blocks:
        exec(block, names)
    out = capsys.readouterr().out
    assert "step" in out and "(0." in out
