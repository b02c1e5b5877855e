"""The table of a fit holds every number and every reason once, in each of its forms."""

import csv
import io
import re
from typing import Any, cast

import pytest

from tilth.analysis.fit.result import FitAnswer
from tilth.analysis.fit.summary import latex, rows_of, write_csv
from tilth.schemas.flow import PARAMETERS


def _parameters(scale: float, without: str = "") -> dict[str, Any]:
    rows: dict[str, Any] = {}
    for name in PARAMETERS:
        value = scale * (200e3 if name.startswith("C_") else 0.5)
        rows[name] = {"value": value, "sd": 0.05 * value, "status": "estimated", "reason": ""}
    if without:
        rows[without] = {"value": None, "sd": None, "status": "unestimated", "reason": "too little steering"}
    return rows


def _answer(segments: int, group: bool = False) -> FitAnswer:
    runs = [
        {"id": f"1.{k + 1}", "kind": "headland_turn", "name": "50 % & #1" if k == 1 else "",
         "start_s": 10.0 * k, "end_s": 10.0 * k + 8.0,
         "parameters": _parameters(1.0 + k, "C_ai" if k == 0 else "")}
        for k in range(segments)
    ]  # fmt: skip
    joint = {"parameters": _parameters(1.5)}
    groups = (
        [{"segments": ["1.1", "1.2"], "name": "1.1, 1.2", "parameters": _parameters(1.2)}] if group else []
    )
    return cast("FitAnswer", {"runs": runs, "joint": joint, "groups": groups})


@pytest.mark.parametrize(("segments", "group", "rows"), [(1, False, 1), (2, False, 3), (3, True, 5)])
def test_every_row_is_in_every_form(segments: int, group: bool, rows: int) -> None:
    answer = _answer(segments, group)
    assert len(list(rows_of(answer))) == rows
    out = io.StringIO()
    write_csv(answer, out)
    lines = list(csv.DictReader(io.StringIO(out.getvalue())))
    assert len(lines) == 6 * rows
    missing = [line for line in lines if not line["estimate"]]
    assert [(line["segments"], line["parameter"], line["reason"]) for line in missing] == [
        ("1.1", "C_ai", "too little steering")
    ]
    assert (lines[0]["unit"], lines[0]["estimate"]) == ("kN/rad", "200")
    text = latex(answer)
    body = [line for line in text.splitlines() if line.endswith(r"\\")]
    assert len(body) == rows + 1 and all(len(re.findall(r"(?<!\\)&", line)) == 6 for line in body)
    assert ("50 \\% \\& \\#1" in text) == (segments > 1) and text.count("{") == text.count("}")
