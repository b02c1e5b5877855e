"""The HTML: whole, without anything from elsewhere, and its numbers are those of the JSON."""

import re
from collections.abc import Iterator
from html.parser import HTMLParser
from typing import Any

import pytest
from report_parts import everything
from report_run import WRITTEN

from tilth.analysis.report.document import DriveReport, ReportTable, as_json, figures_of, parts_of
from tilth.analysis.report.page import page
from tilth.analysis.report.sections import report_of

pytestmark = pytest.mark.long


VOID = {"meta", "br", "hr", "img", "input", "link"}


class Reading(HTMLParser):
    """Fails where tags do not close; collects what the tests ask for."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.cells: list[str] = []
        self.headings: list[int] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)
        if tag in ("td", "th"):
            self.cells.append("")
        if re.fullmatch("h[1-6]", tag):
            self.headings.append(int(tag[1]))

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open and self.open.pop() == tag, tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] in ("td", "th"):
            self.cells[-1] += data


def read(text: str) -> Reading:
    found = Reading()
    found.feed(text)
    found.close()
    assert found.open == []
    return found


@pytest.fixture(scope="module")
def report(untouched: Any) -> DriveReport:
    return report_of(everything() | {"runs": [untouched], "command": "tilth report a.mcap"})


@pytest.fixture(scope="module")
def text(report: DriveReport) -> str:
    """The page of that report."""
    return page(report)


def numbers_in(value: Any) -> Iterator[float]:
    if isinstance(value, dict):
        for one in value.values():
            yield from numbers_in(one)
    elif isinstance(value, list):
        for one in value:
            yield from numbers_in(one)
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield value


def test_it_is_well_formed_and_its_headings_are_in_order(text: str) -> None:
    found = read(text)
    assert found.headings[0] == 1 and found.headings.count(1) == 1
    assert all(after <= before + 1 for before, after in zip(found.headings, found.headings[1:], strict=False))
    assert ("html", {"lang": "en"}) in found.tags


def test_every_id_is_there_once_and_every_reference_has_one(text: str) -> None:
    ids = re.findall(r'\bid="([^"]+)"', text)
    assert len(ids) == len(set(ids))
    used = set(re.findall(r'href="#([^"]+)"', text)) | set(re.findall(r"url\(#([^)]+)\)", text))
    for names in re.findall(r'aria-(?:labelledby|describedby)="([^"]+)"', text):
        used |= set(names.split())
    assert used <= set(ids)


def test_nothing_comes_from_elsewhere(text: str) -> None:
    assert "http" not in text and "//" not in re.sub(r"/\*.*?\*/", "", text)
    tags = {tag for tag, _ in read(text).tags}
    assert not tags & {"script", "link", "img", "iframe", "object", "base"}
    assert "@import" not in text and "javascript" not in text


def test_every_table_cell_stands_in_the_json_with_its_number(report: DriveReport, text: str) -> None:
    content = as_json(report)
    shown = [cell.replace("\u00a0", " ") for cell in read(text).cells if cell]
    texts: list[str] = []
    for part in parts_of(report.sections):
        if isinstance(part, ReportTable):
            texts += [one for one in part.columns if one]
            texts += [cell.text for row in part.rows for cell in row if cell.text]
    assert shown == texts
    known = {round(value, 9) for value in numbers_in(content["data"])}
    for part in parts_of(report.sections):
        if isinstance(part, ReportTable) and not part.id.startswith(
            "response"
        ):  # made of real and imaginary parts
            for row in part.rows:
                for cell in row:
                    if cell.value is not None and part.id != "run1-events":  # its numbers count the rows
                        assert round(cell.value, 9) in known, (part.id, cell)


def test_tables_and_figures_can_be_heard(report: DriveReport, text: str) -> None:
    tables, figures = text.count("<table"), text.count("<svg")
    assert tables == text.count("<caption>") > 8
    assert figures == len(list(figures_of(report))) > 7
    for tag, attributes in read(text).tags:
        if tag == "th":
            assert attributes["scope"] in ("col", "row")
        if tag == "svg":
            assert (
                attributes["role"] == "img"
                and attributes["aria-labelledby"]
                and attributes["aria-describedby"]
            )
    assert text.count("<title id=") == text.count("<desc id=") == figures


def test_what_people_wrote_is_text(text: str, facts: Any) -> None:
    assert WRITTEN not in text and "&lt;script&gt;alert(&#x27;a &amp; b&#x27;)&lt;/script&gt;" in text
    assert "clay &lt;dry&gt;" in text
    facts["id"] = '"><b>x</b>'
    assert "<b>x" not in page(report_of({"runs": [facts], "command": ""}))


def test_light_dark_and_paper(text: str) -> None:
    assert "prefers-color-scheme: dark" in text and "@media print" in text
    figures = re.findall(r"<svg.*?</svg>", text, re.S)
    assert all("var(--ink)" in one for one in figures)
    assert not any("#141414" in one or "#ffffff" in one for one in figures)


def test_the_same_bytes_from_the_same_report(report: DriveReport, text: str) -> None:
    assert page(report) == text


def test_what_is_absent_is_left_out(facts: Any) -> None:
    text = page(report_of({"runs": [facts], "command": ""}))
    for title in ("Fits of segments", "Prediction of drives", "Residuals", "Frequency response"):
        assert title not in text
    facts |= {"estimates": {}, "nuisances": [], "segments": [], "events": [], "flags": []}
    facts["curves"]["parameters"] = {}
    text = page(report_of({"runs": [facts], "command": ""}))
    assert "holds no estimates" in text and "No segment was found" in text
    assert "no marks and no events" in text and "Found beside" not in text
    read(text)


def test_several_runs_are_told_apart(facts: Any) -> None:
    text = page(report_of({"runs": [facts, facts], "command": ""}))
    read(text)
    ids = re.findall(r'\bid="([^"]+)"', text)
    assert len(ids) == len(set(ids))
    assert f"Run 2: {facts['machine']['name']}, 20" in text and text.count("field-1") > 1


def test_a_run_is_called_as_people_call_it(facts: Any) -> None:
    named = report_of({"runs": [facts | {"start_utc_s": 1_795_000_000.0}], "command": ""})
    assert named.title == f"Drive report: {facts['machine']['name']}, 2026-11-18 11:06 UTC"
    assert report_of({"runs": [facts | {"start_utc_s": None}], "command": ""}).title.endswith(facts["id"])


def test_a_small_file(text: str) -> None:
    assert len(text) < 1_500_000
