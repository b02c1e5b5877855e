"""The PDF: it opens, has its pages and its words, and is the same each time."""

import json
import re
import sys
import zlib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from report_parts import everything
from report_run import WRITTEN

from tilth.analysis.report.document import (
    HELD_OUT,
    WARNING,
    DriveReport,
    ReportCell,
    ReportFigure,
    ReportSection,
    ReportTable,
    ReportText,
    as_json,
)
from tilth.analysis.report.page import page
from tilth.analysis.report.paper import NoTypst, content, paper, require_typst
from tilth.analysis.report.sections import report_of
from tilth.analysis.report.writing import json_text


def pages(pdf: bytes) -> int:
    """Counted in the objects, packed ones too."""
    packed = re.findall(rb"stream\r?\n(.*?)\r?\nendstream", pdf, re.S)
    texts = [pdf]
    for one in packed:
        try:
            texts.append(zlib.decompress(one))
        except zlib.error:
            continue
    return sum(len(re.findall(rb"/Type\s*/Page(?![s\w])", text)) for text in texts)


@pytest.mark.long
def test_a_pdf_with_pages_the_same_each_time(facts: Any) -> None:
    report = report_of(everything() | {"runs": [facts], "command": "tilth report a.mcap"})
    made = paper(report)
    assert made.startswith(b"%PDF-") and made.rstrip().endswith(b"%%EOF")
    assert 5 <= pages(made) <= 20
    assert made == paper(report)
    assert b"CreationDate" not in made


ANY = st.text(st.characters(exclude_categories=()), max_size=40)
"""Control characters and halves of characters too, as a mark or the name of a file may have them."""


@settings(max_examples=10, deadline=None)
@example(WRITTEN)
@example('\\b" + read("id_rsa") ), //')
@example("\b")
@example('#panic("x") $ _a_ *b* @c <d> \\ " [ ] #{')
@example("line\nline\ttab\r\0\x1b[31m")
@example("\ud800 \udcff \uffff")
@given(ANY)
def test_no_text_acts(text: str) -> None:
    """Wherever it stands: in a title, a paragraph, a warning, a table, a caption, below a figure."""
    cells = tuple((ReportCell(text), ReportCell(text, 1.0, mark=HELD_OUT)) for _ in range(2))
    matrix = {"names": ["C_af", "C_ar"], "matrix": [[1.0, 0.5], [0.5, 1.0]]}
    parts = (
        ReportText(text),
        ReportText(text, WARNING),
        ReportTable("t", text, (text, text), cells),
        ReportFigure("f", "correlation", text, text, matrix),
    )
    report = DriveReport(text, (ReportSection("s", text, parts),), {})
    assert paper(report).startswith(b"%PDF-")
    page(report).encode()
    assert json.loads(json_text(as_json(report)).encode())["title"] == text


def test_a_mark_reads_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What stands in the PDF is the mark, as it was written."""
    monkeypatch.chdir(tmp_path)
    Path("id_rsa").write_text("SECRET" * 40)
    mark = '\\b" + read( `id_rsa`.text ) ), //'
    report = DriveReport("t", (ReportSection("s", "s", (ReportText(mark),)),), {})
    parts: Any = content(report)["parts"]
    (shown,) = [part["text"] for part in parts if part["kind"] == "plain"]
    assert shown == mark
    inside = paper(report)
    Path("id_rsa").unlink()
    assert paper(report) == inside


def test_without_typst_it_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "typst", None)
    with pytest.raises(NoTypst):
        require_typst()
