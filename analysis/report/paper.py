"""A report as PDF, by typst: an extra, since it is large. The same bytes from the same report."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import matplotlib

from tilth.analysis.report.document import (
    HELD_OUT,
    WARNING,
    DriveReport,
    Part,
    ReportCell,
    ReportFigure,
    ReportSection,
    ReportTable,
)
from tilth.analysis.report.figures import svg

WIDE: Final = 8  # columns of a table that is set smaller
_HEAD: Final = """\
#set document(title: {title}, date: none)
#set page(paper: "a4", margin: (x: 14mm, y: 16mm), numbering: "1 / 1")
#set text(font: "DejaVu Sans", size: 8.5pt, lang: "en")
#set par(leading: 0.6em)
#set heading(numbering: none)
#show heading: set block(above: 1.4em, below: 0.8em)
#show figure: set align(left)
#show figure.caption: set align(left)
#show figure.where(kind: table): set figure.caption(position: top)
#show figure.where(kind: table): set block(breakable: true)
#set figure(supplement: none, numbering: none)
#let warning(body) = block(stroke: (left: 3pt + rgb("#b07800")), inset: 6pt, fill: rgb("#fff3c4"), body)
#let held(body) = table.cell(fill: rgb("#dcebf7"), strong(body))
"""


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

    fonts = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
    compiler = typst.Compiler(font_paths=[fonts], ignore_system_fonts=True)
    made = compiler.compile(source(report).encode(), format="pdf")
    assert isinstance(made, bytes)
    return made


def source(report: DriveReport) -> str:
    """What typst sets; figures stand in it as SVG."""
    return "\n".join(_lines(report)) + "\n"


def _lines(report: DriveReport) -> Iterator[str]:
    yield _HEAD.replace("{title}", _string(report.title))
    yield f'#text(size: 16pt, weight: "bold", {_string(report.title)})'
    for section in report.sections:
        yield from _section(section, 1)


def _section(section: ReportSection, level: int) -> Iterator[str]:
    yield f"#heading(level: {level}, {_string(section.title)})"
    for part in section.parts:
        yield _part(part)
    for inner in section.sections:
        yield from _section(inner, level + 1)


def _part(part: Part) -> str:
    if isinstance(part, ReportTable):
        return _table(part)
    if isinstance(part, ReportFigure):
        picture = f'image(bytes({_string(svg(part))}), format: "svg", alt: {_string(part.description)})'
        return f"#figure({picture}, caption: {_string(part.caption)})"
    text = f"text({_string(part.text)})"
    return f"#warning({text})" if part.kind == WARNING else f"#par({text})"


def _table(part: ReportTable) -> str:
    """Columns as wide as what is in them; a column of long texts takes what is left."""
    longest = [
        max((max(map(len, row[k].text.split(", "))) for row in part.rows), default=0)
        for k in range(len(part.columns))
    ]
    widths = ", ".join("1fr" if length > 30 else "auto" for length in longest)
    head = ", ".join(f"strong({_string(one)})" for one in part.columns)
    cells = ",\n".join(_cell(cell) for row in part.rows for cell in row)
    size = "6.3pt" if len(part.columns) >= WIDE else "7.5pt"
    lines = "(x, y) => (bottom: 0.4pt + luma(190))"
    return (
        f"#text(size: {size}, figure(kind: table, caption: {_string(part.caption)},\n"
        f"table(columns: ({widths},), stroke: {lines}, inset: 3pt, align: left,\n"
        f"table.header({head}),\n{cells})))"
    )


def _cell(cell: ReportCell) -> str:
    text = f"text({_string(_breakable(cell.text))})"
    return f"held({text})" if cell.mark == HELD_OUT else text


def _breakable(text: str) -> str:
    """Sums and paths may be broken anywhere: with spaces of no width."""
    return text if max(map(len, text.split()), default=0) < 30 else "\u200b".join(text)


def _string(text: str) -> str:
    """A string of typst: none of its signs acts in one."""
    return json.dumps(text, ensure_ascii=False).replace("\\b", "").replace("\\f", "")
