"""The notebooks run from their first cell to the last, and say what they promise."""

import os
import re
from pathlib import Path

import pytest
from paths import ROOT
from recorded import recorded, shared_cache

from tilth.deploy.notebooks import PAGES, SOURCES, cells_of, page_of, printed

pytestmark = pytest.mark.long


NOTEBOOKS = {
    "log_to_parameters": ("C_af", "segments agree", "machine file", "each:"),
    "parameters_to_gains": ("gains for the learned soil", "slowest pole of 200 draws"),
}


def test_each_notebook_is_tested() -> None:
    assert {path.stem for path in (ROOT / "examples/notebooks").glob("*.py")} == set(NOTEBOOKS)


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_a_notebook_runs(name: str) -> None:
    cells = cells_of((SOURCES / f"{name}.py").read_text(encoding="utf-8"))
    environment = {**os.environ, "XDG_CACHE_HOME": str(shared_cache()), "OPENBLAS_NUM_THREADS": "1"}
    outputs = printed(cells, environment, name)
    for text in NOTEBOOKS[name]:
        assert any(text in one for one in outputs), outputs
    # Another computer rounds differently: the page says the same with its own last digits.
    page = (PAGES / f"{name}.md").read_text(encoding="utf-8")
    assert words(page) == words(page_of(name, cells, outputs)), "run `python -m tilth.deploy.notebooks`"


def words(page: str) -> list[str]:
    return re.sub(r"[-−+]?[\d.]+(e[-+]\d+)?\*?", "0", page).split()


def test_a_page_has_text_code_and_what_it_prints() -> None:
    cells = cells_of("before\n# %% [markdown]\n# # A title\n#\n# Words.\n\n# %%\nprint(6 * 7)\n# %%\nx = 1\n")
    assert cells == [(False, "# A title\n\nWords."), (True, "print(6 * 7)"), (True, "x = 1")]
    page = page_of("some", cells, printed(cells))
    assert page.startswith("# A title\n\nWords.\n\n```python\nprint(6 * 7)\n```\n\n```text\n42\n```\n")
    assert page.count("```text") == 1 and "examples/notebooks/some.py" in page


def test_a_mark_in_prose_or_code_begins_no_cell() -> None:
    cells = cells_of("# %% [markdown]\n# Cells begin with `# %%`: so.\n# %%\nprint('# %% x')\n")
    assert cells == [(False, "Cells begin with `# %%`: so."), (True, "print('# %% x')")]


def test_what_a_cell_draws_stands_below_it(tmp_path: Path) -> None:
    source = (
        "# %%\nimport matplotlib.pyplot as plt\nplt.figure('line').suptitle('A line')\n"
        "plt.plot([1, 2])\nprint(1)\n"
        "# %%\nprint(2)\n"
    )
    cells = cells_of(source)
    page = page_of("some", cells, printed(cells, name="some", into=tmp_path))
    assert page.count("```text\n1\n```\n\n![A line](some-line.svg)") == 1 and page.count("![") == 1
    assert (tmp_path / "some-line.svg").read_text(encoding="utf-8").count("<svg") == 1


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_each_page_has_a_figure_that_is_there(name: str) -> None:
    page = (PAGES / f"{name}.md").read_text(encoding="utf-8")
    files = re.findall(r"!\[.+\]\((.+\.svg)\)", page)
    assert files and all((PAGES / file).is_file() for file in files)


def test_a_cell_that_fails_is_told() -> None:
    with pytest.raises(RuntimeError, match="ZeroDivisionError"):
        printed(cells_of("# %%\n1 / 0\n"))


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
