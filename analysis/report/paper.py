"""A report as PDF, by typst: an extra, since it is large. The same bytes from the same report.

How it looks is in paper.typ; what stands in it is handed over as JSON and is never a part of that code.
"""

import json
from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from typing import Final

import matplotlib

from tilth.analysis.report.document import (
    HELD_OUT,
    DriveReport,
    Part,
    ReportFigure,
    ReportSection,
    ReportTable,
)
from tilth.analysis.report.figures import svg
from tilth.schemas.readable import readable

WIDE: Final = 8  # columns of a table that is set smaller
LONG: Final = 30  # characters of a text that is broken


class NoTypst(Exception):
    """It is not installed."""


def require_typst() -> None:
    """Raises NoTypst."""
    try:
        import typst  # noqa: F401
    except ImportError:
        raise NoTypst from None


def paper(report: DriveReport) -> bytes:
    """The PDF. Raises NoTypst."""
    require_typst()
    import typst

    code = resources.files("tilth.analysis.report").joinpath("paper.typ").read_bytes()
    fonts = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
    compiler = typst.Compiler(font_paths=[fonts], ignore_system_fonts=True)
    made = compiler.compile(code, format="pdf", sys_inputs={"report": json.dumps(content(report))})
    assert isinstance(made, bytes)
    return made


def content(report: DriveReport) -> dict[str, object]:
    """What paper.typ sets, one part after the other; figures as SVG."""
    parts = [part for section in report.sections for part in _section(section, 1)]
    return {"title": readable(report.title), "parts": parts}


def _section(section: ReportSection, level: int) -> Iterator[dict[str, object]]:
    yield {"kind": "heading", "level": level, "text": readable(section.title)}
    yield from map(_part, section.parts)
    for inner in section.sections:
        yield from _section(inner, level + 1)


def _part(part: Part) -> dict[str, object]:
    if isinstance(part, ReportTable):
        return _table(part)
    if isinstance(part, ReportFigure):
        texts = {"caption": readable(part.caption), "description": readable(part.description)}
        return {"kind": "figure", "svg": svg(part), **texts}
    return {"kind": part.kind, "text": readable(part.text)}


def _table(part: ReportTable) -> dict[str, object]:
    """Columns as wide as what is in them; a column of long texts takes what is left."""
    longest = [
        max((max(map(len, row[k].text.split(", "))) for row in part.rows), default=0)
        for k in range(len(part.columns))
    ]
    return {
        "kind": "table",
        "caption": readable(part.caption),
        "columns": list(map(readable, part.columns)),
        "wide": [length > LONG for length in longest],
        "small": len(part.columns) >= WIDE,
        "cells": [
            {"text": _breakable(readable(cell.text)), "held": cell.mark == HELD_OUT}
            for row in part.rows
            for cell in row
        ],
    }


def _breakable(text: str) -> str:
    """Sums and paths may be broken anywhere: with spaces of no width."""
    return text if max(map(len, text.split()), default=0) < LONG else "\u200b".join(text)
