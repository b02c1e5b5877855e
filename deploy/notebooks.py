"""Writes docs/notebooks/: each notebook of examples/ with what it prints, to be read on the project's page.

    uv run python -m tilth.deploy.notebooks

A notebook is a script in the percent format: `# %% [markdown]` begins text, `# %%` a cell of code. What a
cell draws with pyplot becomes a figure beside the page, as an editor would show it.
"""

import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Final, NamedTuple

ROOT: Final = Path(__file__).resolve().parents[1]
SOURCES: Final = ROOT / "examples/notebooks"
PAGES: Final = ROOT / "docs/notebooks"
_END: Final = "-- a cell of this notebook ends here --"
# Tilth's messages name the command as it was started: on a page always as with `uv run`.
_FIGURE: Final = "-- a figure of this cell: "
_DRAWN: Final = """
if "matplotlib.pyplot" in __import__("sys").modules:
    from matplotlib import pyplot
    pyplot.rcParams["svg.hashsalt"] = _STEM  # the same figure has the same names in it
    for _figure in map(pyplot.figure, pyplot.get_fignums()):
        _name = f"{_STEM}-{_figure.get_label()}.svg"
        _figure.savefig(f"{_FOLDER}/{_name}", metadata={"Date": None})
        print(f"{_MARK}{_figure.get_suptitle()}|{_name}")
    pyplot.close("all")
"""
_STARTED_WITH_UV: Final = {"UV_RUN_RECURSION_DEPTH": "1"}


class NotebookCell(NamedTuple):
    """Text without its `# `, or code."""

    is_code: bool
    content: str


def cells_of(source: str) -> list[NotebookCell]:
    """In their order; what stands before the first mark is left out."""
    found = []
    for part in re.split(r"^# %%", source, flags=re.MULTILINE)[1:]:  # in prose it is no mark
        kind, _, body = part.partition("\n")
        lines = body.strip("\n").split("\n")
        if kind.strip() == "[markdown]":
            lines = [line.removeprefix("#").removeprefix(" ") for line in lines]
        found.append(NotebookCell(kind.strip() != "[markdown]", "\n".join(lines)))
    return found


def printed(
    cells: list[NotebookCell],
    environment: Mapping[str, str] = os.environ,
    name: str = "",
    into: Path | None = None,
) -> list[str]:
    """What each cell of code prints, run in one process; warnings are errors. Raises RuntimeError.

    name, into: of the script and the folder for its figures, which are named after it and their labels.
    """
    codes = [cell.content for cell in cells if cell.is_code]
    with tempfile.TemporaryDirectory() as elsewhere:
        given = {"_STEM": name, "_FOLDER": str(into or elsewhere), "_MARK": _FIGURE}
        head = "".join(f"{key} = {value!r}\n" for key, value in given.items())
        script = head + "".join(f"{code}\n{_DRAWN}\nprint({_END!r})\n" for code in codes)
        command = [sys.executable, "-W", "error", "-c", script]
        around = dict(environment) | _STARTED_WITH_UV | {"MPLBACKEND": "agg"}
        made = subprocess.run(command, capture_output=True, text=True, check=False, env=around)
    if made.returncode:
        raise RuntimeError(made.stderr[-2000:])
    return [_tidy(text) for text in made.stdout.split(_END)[: len(codes)]]


def _tidy(text: str) -> str:
    """Without names of temporary folders, which differ each time, and blanks at line ends."""
    folder = re.escape(tempfile.gettempdir()) + r"/[^/\s]+/"
    return "\n".join(line.rstrip() for line in re.sub(folder, "", text).strip("\n").split("\n"))


def page_of(name: str, cells: list[NotebookCell], outputs: list[str]) -> str:
    """Markdown. name: of the script, without .py."""
    left = iter(outputs)
    parts = []
    for cell in cells:
        if not cell.is_code:
            parts.append(cell.content)
            continue
        parts.append(f"```python\n{cell.content}\n```")
        said = next(left).split("\n")
        if text := "\n".join(line for line in said if line and not line.startswith(_FIGURE)):
            parts.append(f"```text\n{text}\n```")
        for line in said:
            if line.startswith(_FIGURE):
                title, _, file = line.removeprefix(_FIGURE).partition("|")
                parts.append(f"![{title}]({file})")
    parts.append(
        f"This is [examples/notebooks/{name}.py](../../examples/notebooks/{name}.py) with what it "
        "prints, written by `uv run python -m tilth.deploy.notebooks`."
    )
    return "\n\n".join(parts) + "\n"


def main() -> None:
    PAGES.mkdir(exist_ok=True)
    for path in sorted(SOURCES.glob("*.py")):
        cells = cells_of(path.read_text(encoding="utf-8"))
        page = page_of(path.stem, cells, printed(cells, name=path.stem, into=PAGES))
        (PAGES / f"{path.stem}.md").write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main()
