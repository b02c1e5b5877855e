"""What the documentation names exists: paths, names, links, commands, symbols."""

import argparse
import ast
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from contributing import CONTRIBUTING, DIFFS, FILES, changed
from paths import MACHINE_FILE, ROOT

from tilth.cli import COMMANDS, CommandFailed
from tilth.deploy.imports import folders
from tilth.estimator.methods.estimators import Estimator
from tilth.estimator.models.parameters import RIG_PARAMETERS
from tilth.logger.machine_file import read_machine
from tilth.schemas.channels import CHANNEL
from tilth.schemas.proto.tilth_pb2 import SoilTireEstimate

FENCE = re.compile(r"^```.*?^```", re.M | re.S)
LINK = re.compile(r"\]\(([^)\s]+)\)")
CODE = re.compile(r"`([^`\n]+)`")
NAMED = re.compile(r"([\w./-]+\.\w+): (\w+)")
README_LINES = 95


TOPS = {*folders(), "bench", "docs", "examples", "tests"}
PAGES = [page for folder in (".", "deploy", "docs") for page in sorted((ROOT / folder).glob("*.md"))]


def ids(page: Path) -> str:
    return str(page.relative_to(ROOT))


def prose(page: Path) -> str:
    return FENCE.sub("", page.read_text(encoding="utf-8"))


def anchors(page: Path) -> set[str]:
    """As GitHub makes them of headings."""
    headings = re.findall(r"^#+ (.+)$", prose(page), re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def top_level_names(path: Path) -> set[str]:
    """What a module defines, imports included; of another file its words."""
    text = path.read_text(encoding="utf-8")
    if path.suffix != ".py":
        return set(re.findall(r"\w+", text))
    found: set[str] = set()
    for node in ast.parse(text).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            found.add(node.name)
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            found |= {leaf.id for one in targets for leaf in ast.walk(one) if isinstance(leaf, ast.Name)}
    return found


@pytest.mark.parametrize("page", PAGES, ids=ids)
def test_links_point_to_what_exists(page: Path) -> None:
    for target in LINK.findall(prose(page)):
        if target.startswith(("http://", "https://")):
            continue
        path, _, anchor = target.partition("#")
        found = (page.parent / path).resolve() if path else page
        assert found.exists(), target
        assert not anchor or anchor in anchors(found), target


@pytest.mark.parametrize("page", PAGES, ids=ids)
def test_paths_and_names_in_code_exist(page: Path) -> None:
    for text in CODE.findall(prose(page)):
        words, names = text.split(), NAMED.fullmatch(text)
        path = names[1] if names else text
        if path.partition("/")[0] not in TOPS or "/" not in path or not re.fullmatch(r"[\w./-]+", path):
            if len(words) < 2 or words[0] != "python":
                continue
            path = words[1]
        if path.endswith("/") or Path(path).suffix:
            assert (ROOT / path).exists(), text
        if names:
            assert names[2] in top_level_names(ROOT / path), text


@pytest.mark.parametrize("page", PAGES, ids=ids)
def test_tables_are_whole(page: Path) -> None:
    """A header, a line of dashes, and as many cells in each row: what a viewer needs to draw a table."""
    for block in re.findall(r"(?:^\|.*\n?)+", prose(page), re.M):
        rows = [re.split(r"(?<!\\)\|", line)[1:-1] for line in block.splitlines()]
        assert len(rows) > 2 and all(re.fullmatch(r" *:?-+:? *", cell) for cell in rows[1]), rows[0]
        for row in rows:
            assert len(row) == len(rows[0]), row


@pytest.mark.parametrize("page", PAGES, ids=ids)
def test_commands_exist(page: Path) -> None:
    known = {name for name, _ in COMMANDS}
    examples = re.compile(r"^```(?:python|diff)\n.*?^```", re.M | re.S)
    text = examples.sub("", page.read_text(encoding="utf-8"))
    found = re.findall(r"(?:`|uv run |^)tilth ([a-z]+)\b(?! 0)", text, re.M)
    assert set(found) <= known


def test_every_command_is_in_the_list() -> None:
    text = (ROOT / "docs" / "operating.md").read_text(encoding="utf-8")
    for name, _ in COMMANDS:
        assert re.search(rf"^\| `tilth {name}\b", text, re.M), name


def test_the_readme_is_short() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(text.splitlines()) <= README_LINES
    assert "pip install uv && uv run tilth demo" in text and "pip install uv && uv run pytest" in text


def test_the_walkthrough_names_eight_files_each_way() -> None:
    text = prose(ROOT / "docs" / "walkthrough.md")
    for title in ("In", "Out"):
        section = text.partition(f"## {title}: ")[2].partition("\n## ")[0]
        steps = re.findall(r"^\| (\d) \| `([\w./-]+)", section, re.M)
        assert [number for number, _ in steps] == list("12345678")
        assert len({path for _, path in steps}) == 8


def test_the_program_of_the_walkthrough(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(ROOT)
    page = (ROOT / "docs" / "walkthrough.md").read_text(encoding="utf-8")
    exec(page.partition("```python\n")[2].partition("```")[0], {})
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == ["/measurement/position", "/gnss/tractor_front"]
    assert all("latitude_deg=52.5524903, longitude_deg=5.461665" in line for line in lines)


def test_each_symbol_is_defined_once() -> None:
    page = (ROOT / "docs" / "notation.md").read_text(encoding="utf-8")
    found: dict[str, str] = {}  # symbol -> its names in code
    for block in re.findall(r"(?:^\|.*\n)+", page, re.M):
        rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in block.splitlines()]
        if rows[0][0] != "symbol":
            continue
        for symbols, names, *_ in rows[2:]:
            for symbol, name in zip(symbols.split(", "), CODE.findall(names) or ["–"] * 9, strict=False):
                assert symbol not in found, f"{symbol} is defined twice"
                found[symbol] = name
    for parameter in RIG_PARAMETERS:
        if parameter.symbol != "–":
            assert found.get(parameter.symbol) == parameter.name, parameter.name


# CONTRIBUTING: examples that fit the code.


@pytest.mark.parametrize("diff", DIFFS, ids=lambda diff: diff.partition("\n")[0].removeprefix("--- a/"))
def test_the_examples_still_fit(diff: str) -> None:
    for path, text in changed(diff).items():
        if path.endswith(".py"):
            compile(text, path, "exec")


def test_the_example_of_an_estimator() -> None:
    names: dict[str, Any] = {}
    exec(FILES["estimator/methods/idle.py"], names)
    row = re.search(r"^\+    (Estimator\(.*\)),$", CONTRIBUTING, re.M)
    assert row is not None
    made: Estimator = eval(row[1], {"Estimator": Estimator, "idle": SimpleNamespace(**names)})
    machine, _ = read_machine(MACHINE_FILE)
    estimate = made.estimate(made.initial(machine), machine, 1)
    sent = CHANNEL["/soil_tire"].encode(estimate)
    assert [one.status for one in SoilTireEstimate.FromString(sent).parameters] == [0] * 6


def test_the_example_of_a_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    names: dict[str, Any] = {}
    exec(FILES["cli/count.py"], names)
    parser = argparse.ArgumentParser()
    names["add"](parser.add_subparsers())
    log = tmp_path / "a.log"
    log.write_text("(1700000000.000000) can0 09F8011C#A7DF521F4A624103\n" * 3)
    assert names["run"](parser.parse_args(["count", str(log)])) == 0
    assert capsys.readouterr().out == "3\n"
    with pytest.raises(CommandFailed):
        names["run"](parser.parse_args(["count", str(tmp_path)]))
