"""The PDF: it opens, has its pages and its words, and is the same each time."""

import re
import sys
import zlib
from typing import Any

import pytest
from report_parts import everything
from report_run import WRITTEN

from tilth.analysis.report.build import report_of
from tilth.analysis.report.document import (
    DriveReport,
    ReportSection,
    ReportText,
)
from tilth.analysis.report.paper import NoTypst, paper, require_typst, source


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


def test_a_pdf_with_pages_the_same_each_time(facts: dict[str, Any]) -> None:
    report = report_of({"runs": [facts], "command": "tilth report a.mcap", **everything()})
    made = paper(report)
    assert made.startswith(b"%PDF-") and made.rstrip().endswith(b"%%EOF")
    assert 5 <= pages(made) <= 20
    assert made == paper(report)
    assert b"CreationDate" not in made


@pytest.mark.parametrize(
    "text", [WRITTEN, '#panic("x")', '$ _a_ *b* @c <d> \\ " [ ]', "#{", "line\nline\ttab"]
)
def test_no_sign_acts(text: str) -> None:
    report = DriveReport(text, (ReportSection("s", text, (ReportText(text),)),), {})
    assert paper(report).startswith(b"%PDF-")
    assert "#panic(" not in re.sub(r'"(?:[^"\\]|\\.)*"', "", source(report))


def test_without_typst_it_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "typst", None)
    with pytest.raises(NoTypst):
        require_typst()
