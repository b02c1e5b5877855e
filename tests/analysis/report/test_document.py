"""Plain data, and the JSON of a report."""

from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np

from tilth.analysis.report.document import (
    DriveReport,
    ReportCell,
    ReportFigure,
    ReportSection,
    ReportTable,
    ReportText,
    as_json,
    figures_of,
    plain,
)


class Colour(Enum):
    RED = "red"


@dataclass(frozen=True, slots=True)
class Found:
    value: complex
    rows: tuple[float, ...]


def test_plain_data_of_what_others_compute() -> None:
    assert plain(Found(1 + 2j, (float("nan"), 0.1 + 0.2))) == {
        "value": {"re": 1.0, "im": 2.0},
        "rows": [None, 0.3],
    }
    assert plain(np.array([[1 + 1j]])) == {"re": [[1.0]], "im": [[1.0]]}
    assert plain({1: np.float64("inf"), "b": (Colour.RED, np.int64(3), True, None, "x")}) == {
        "1": None,
        "b": ["red", 3, True, None, "x"],
    }


def test_the_json_holds_all_parts_once() -> None:
    table = ReportTable("t", "c", ("a", "b"), ((ReportCell("x"), ReportCell("1.0 m", 1.0, 0.1, "held_out")),))
    figure = ReportFigure("f", "path", "caption", "description", {"x": [1.0]})
    inner = ReportSection("i", "inner", (figure,))
    report = DriveReport(
        "title", (ReportSection("s", "section", (ReportText("p"), table), (inner,)),), {"runs": []}
    )
    found: Any = as_json(report)
    (section,) = found["sections"]
    assert section["parts"][0] == {"plain": "p"}
    assert section["parts"][1]["rows"] == [
        [{"text": "x"}, {"text": "1.0 m", "value": 1.0, "sd": 0.1, "mark": "held_out"}]
    ]
    assert section["sections"][0]["parts"] == [
        {"figure": "f", "caption": "caption", "description": "description"}
    ]
    assert list(figures_of(report)) == [figure]
