"""Chapter 7's tables: chapter7.json is whole, and each table says what stands there and in print."""

import json
import re
from typing import Any

import numpy as np
import pytest

from studies.dissertation import experiments, field_errata, field_figures, field_tables
from studies.dissertation.chapter7 import as_text
from studies.dissertation.field_page import section
from studies.dissertation.field_tables import ERRORS, ESTIMATES, RUNS, Numbers, holds, merged, read


@pytest.fixture(scope="module")
def found() -> Numbers:
    return read()


def test_the_file_is_whole_and_of_these_fields(found: Numbers) -> None:
    assert found["truth"] == {f: list(experiments.truth(f).values()) for f in experiments.FIELDS}
    named = {(one["plant"], one["field"], one["manoeuvre"]) for one in found["groups"]}
    assert named == {tuple(run)[:3] for run in experiments.all_of()} and len(found["groups"]) == 12
    for one in found["groups"]:
        assert [tuple(row["runs"]) for row in one["subsets"]] == [(), *RUNS]
        assert all(np.shape(row["cells"]) == (3, 2) for row in one["subsets"])
    assert len(found["wholes"]) == 4 and all(
        np.shape(row["steps_predict"]) == (6, 2) for row in found["wholes"]
    )
    assert field_tables.FILE.read_text(encoding="utf-8") == as_text(found)


def test_merging_is_that_of_the_dissertation() -> None:
    """7.20 and 7.21 by hand for C_ai of N1 and N3: 70 ± 5 and 60 ± 5."""
    values, sds = merged((1, 3))
    assert values[2] == pytest.approx(65.0) and sds[2] == pytest.approx(5.0 / np.sqrt(2.0))
    assert ESTIMATES[(1, 3)][0][2] == 59  # as printed


def test_three_of_four_merged_stiffnesses_do_not_follow() -> None:
    off = [runs for runs in field_errata.MERGED if not field_errata.agrees(runs, 2)]
    assert off == [(1, 3), (2, 3), (1, 2, 3)]
    assert all(field_errata.agrees(runs, k) for runs in field_errata.MERGED for k in (3, 4, 5))
    (row,) = (row for row in field_errata.field_errata() if "C_αi of" in row.where)
    assert (row.printed, row.right) == ("59, 60, 62", "65, 66, 68")


def test_a_cell_that_was_not_fitted_is_bold(found: Numbers) -> None:
    rows = [line.split("|") for line in field_tables.table_7_6(found).splitlines()[2:]]
    assert len(rows) == 3 * len(ERRORS)
    for row in rows:
        fitted = {int(k) for k in re.findall(r"N(\d)", row[1])}
        for k, cell in enumerate(row[2:5], 1):
            assert ("**" in cell) == (k not in fitted), row


@pytest.mark.parametrize(
    ("value", "sd", "truth", "within"),
    [
        (100.0, 10.0, 118.0, True),
        (100.0, 10.0, 123.0, False),
        (100.0, 10.0, 83.0, True),
        (100.0, 10.0, 80.0, False),
    ],
)
def test_intervals(value: float, sd: float, truth: float, within: bool) -> None:
    assert holds(value, sd, truth) == within


def test_what_is_outside_is_marked_and_counted(found: Numbers) -> None:
    """The marks of table 7.5 and the counts of the table of intervals come from the same numbers."""
    for plant in field_tables.PLANTS:
        for _, group in field_tables.estimates(found, plant):
            assert group
    single = dict(field_tables.estimates(found, "planar"))["1 run"]
    outside = sum(
        not holds(v, s, t)
        for row, truth in single
        for v, s, t in zip(row["values"], row["sds"], truth, strict=True) if v is not None
    )  # fmt: skip
    line = next(x for x in field_tables.coverage_table(found).splitlines() if "planar, 1 run" in x)
    counts = [tuple(map(int, pair)) for pair in re.findall(r"(\d+) of (\d+)", line)]
    assert sum(of - within for within, of in counts) == outside and len(counts) == 6


def test_a_prediction_of_a_fitted_run_is_not_held_out(found: Numbers) -> None:
    assert len(field_tables.held_out_errors(found, "planar", 1, 0)) == 36  # 6 groups, 3 runs, 2 others each
    assert len(field_tables.held_out_errors(found, "planar", 2, 0)) == 18
    changed: dict[str, Any] = json.loads(json.dumps(found))
    for one in changed["groups"]:
        for row in one["subsets"]:
            for k in row["runs"]:
                row["cells"][k - 1] = [1e6, 1e6]  # of runs that were fitted
    for size in (1, 2):
        before, after = (field_tables.held_out_errors(x, "planar", size, 0) for x in (found, changed))
        assert before == after


def test_paths_begin_together_and_the_initial_one_leaves(found: Numbers) -> None:
    for row in found["paths"]:
        for body in field_figures.BODIES:
            ways = {name: np.array(row[body][name]) for name in field_figures.LINES}
            assert len({len(way) for way in ways.values()}) == 1 and len(ways["measured"]) == 60
            off = {name: np.hypot(*(way - ways["measured"]).T) for name, way in ways.items()}
            assert all(one[0] < 0.2 for one in off.values())
            assert off["initial"].max() > max(off["N2"].max(), off["N1+N2"].max())


def test_the_section_names_its_command_and_leaves_nothing_open(found: Numbers) -> None:
    text = section(found)
    assert "studies.dissertation.chapter7" in text and "$" not in text
    assert text.count("Table 7.") >= 5
