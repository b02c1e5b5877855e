"""A report as one HTML file: nothing from elsewhere; light, dark, on paper, for screen readers. No script
but that of maps, which zoom by it and are whole without."""

import html
import re
from collections.abc import Iterator
from importlib import resources
from typing import Final

from tilth.analysis.report.document import (
    HELD_OUT,
    WARNING,
    DriveReport,
    Part,
    ReportCell,
    ReportFigure,
    ReportSection,
    ReportTable,
    ReportText,
    figures_of,
)
from tilth.analysis.report.figures import ZOOMING, inline
from tilth.schemas.readable import readable

LONG: Final = 28  # characters of a text that may take several lines
WIDE: Final = 8  # columns
DAY: Final = re.compile(r"\b\d{4}-\d\d-\d\d\b")
_DEEPEST: Final = 6  # heading of HTML


def escape(text: str) -> str:
    """For HTML; a number and its % stay on one line."""
    return html.escape(readable(text)).replace(" %", "\u00a0%")


def page(report: DriveReport) -> str:
    """The whole file."""
    return "\n".join(_lines(report)) + "\n"


def _lines(report: DriveReport) -> Iterator[str]:
    style = _beside("page.css")
    title = escape(report.title)
    yield '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">'
    yield '<meta name="viewport" content="width=device-width, initial-scale=1">'
    yield '<meta name="color-scheme" content="light dark">'
    yield f"<title>{title}</title>\n<style>\n{style}</style>\n</head>\n<body>\n<main>\n<h1>{title}</h1>"
    yield '<nav aria-label="Contents">\n<ul>'
    for section in report.sections:
        yield _entry(section)
    yield "</ul>\n</nav>"
    for section in report.sections:
        yield from _section(section, 2)
    yield "</main>"
    if any(figure.kind in ZOOMING for figure in figures_of(report)):
        yield f"<script>\n{_beside('zoom.js')}</script>"
    yield "</body>\n</html>"


def _beside(name: str) -> str:
    return resources.files("tilth.analysis.report").joinpath(name).read_text(encoding="utf-8")


def _entry(section: ReportSection) -> str:
    """Of the contents, with the sections within."""
    inner = "".join(f'<li><a href="#{one.id}">{escape(one.title)}</a></li>' for one in section.sections)
    within = f"<ul>{inner}</ul>" if inner else ""
    return f'<li><a href="#{section.id}">{escape(section.title)}</a>{within}</li>'


def _section(section: ReportSection, level: int) -> Iterator[str]:
    heading = f"h{min(level, _DEEPEST)}"
    yield f'<section aria-labelledby="{section.id}">'
    yield f'<{heading} id="{section.id}">{escape(section.title)}</{heading}>'
    for part in section.parts:
        yield _part(part)
    for inner in section.sections:
        yield from _section(inner, level + 1)
    yield "</section>"


def _part(part: Part) -> str:
    if isinstance(part, ReportTable):
        return _table(part)
    if isinstance(part, ReportFigure):
        return _figure(part)
    return _text(part)


def _text(part: ReportText) -> str:
    if part.kind == WARNING:
        return f'<p class="warning"><b>Note:</b> {escape(part.text)}</p>'
    return f"<p>{escape(part.text)}</p>"


def _figure(part: ReportFigure) -> str:
    caption = escape(part.caption)
    return (
        f'<figure id="{part.id}"><div class="scroll" tabindex="0" role="group" aria-label="{caption}">'
        f"{inline(part)}</div>\n<figcaption>{caption}</figcaption></figure>"
    )


def _table(part: ReportTable) -> str:
    """In a frame of its own that scrolls where the screen is narrow."""
    head = "".join(f'<th scope="col">{escape(one)}</th>' if one else "<td></td>" for one in part.columns)
    rows = "\n".join(
        f'<tr><th scope="row">{_words(row[0])}</th>{"".join(map(_cell, row[1:]))}</tr>' for row in part.rows
    )
    caption = escape(part.caption)
    wide = ' class="wide"' if len(part.columns) >= WIDE else ""
    return (
        f'<div class="scroll" tabindex="0" role="group" aria-label="{caption}">\n'
        f'<table id="{part.id}"{wide}>\n'
        f"<caption>{caption}</caption>\n<thead><tr>{head}</tr></thead>\n<tbody>\n{rows}\n</tbody>\n</table>\n</div>"
    )


def _cell(cell: ReportCell) -> str:
    names = ["number"] if cell.value is not None else ["long"] if len(cell.text) > LONG else []
    names += ["held-out"] if cell.mark == HELD_OUT else []
    attribute = f' class="{" ".join(names)}"' if names else ""
    return f"<td{attribute}>{_words(cell)}</td>"


def _words(cell: ReportCell) -> str:
    """Of a cell; a day stays in one line."""
    return DAY.sub(r"<time>\g<0></time>", escape(cell.text))
