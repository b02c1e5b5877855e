"""Rows of the table of figures run, on a few seconds of driving."""

import ast
import importlib

import estimation as bench
import estimation_runs
import pytest
from estimation_table import Bench, Row, wilson

SHORT = 0.2  # of a window of 30 s
QUICK = ("efficiency_random", "merging", "hidden_all_errors")


@pytest.mark.parametrize("row", [r for r in bench.ROWS if r.name in QUICK], ids=lambda row: row.name)
def test_a_row_gives_its_figures(row: Row) -> None:
    lines = row.make(Bench(runs=1, scale=SHORT))
    assert any(line.reach for line in lines)
    assert all(line.figure and line.reached for line in lines)


def test_an_interval_of_a_share_holds_it() -> None:
    for hits, n in ((0, 10), (5, 10), (10, 10), (950, 1000)):
        low, high = wilson(hits, n)
        assert -1e-12 <= low <= hits / n + 1e-12
        assert hits / n - 1e-12 <= high <= 1.0 + 1e-12


def test_what_a_new_process_is_to_import_is_there() -> None:
    """The text that measures a first fit is run by another process: no checker sees its imports."""
    imports = [node for node in ast.walk(ast.parse(estimation_runs.COLD)) if isinstance(node, ast.ImportFrom)]
    assert imports
    for node in imports:
        assert node.module is not None
        for alias in node.names:
            importlib.import_module(f"{node.module}.{alias.name}")
