"""A report as plain data: sections of sentences, tables and figures. page.py and paper.py write it down.

Each part of a report is made by a function `section(data) -> ReportSection | None` from plain data; None
where there is nothing to say. `plain` makes plain data of what other rooms compute.
"""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from typing import Any, Final

import numpy as np

FORM: Final = 1  # of the JSON; grows when a key changes its meaning
PLAIN, WARNING = "plain", "warning"
HELD_OUT: Final = "held_out"  # mark of a cell
"""What XML and fonts do not take: control characters, halves of characters as in names that are no UTF-8."""
_DIGITS: Final = 15  # of a number in JSON: binary fractions as people write them


@dataclass(frozen=True, slots=True)
class ReportCell:
    """What a table shows, and the number behind it, SI, where it is one."""

    text: str
    value: float | int | None = None
    sd: float | None = None
    mark: str = ""


@dataclass(frozen=True, slots=True)
class ReportText:
    """A paragraph. kind: PLAIN or WARNING."""

    text: str
    kind: str = PLAIN


@dataclass(frozen=True, slots=True)
class ReportTable:
    """The first cell of a row names it. columns: headings, as many as each row has cells."""

    id: str
    caption: str
    columns: tuple[str, ...]
    rows: tuple[tuple[ReportCell, ...], ...]


@dataclass(frozen=True, slots=True)
class ReportFigure:
    """kind: a row of figures.DRAWINGS, which draws `data`. description: for who cannot see it."""

    id: str
    kind: str
    caption: str
    description: str
    data: Mapping[str, Any]


Part = ReportText | ReportTable | ReportFigure


@dataclass(frozen=True, slots=True)
class ReportSection:
    """What stands under one heading; sections within have headings one level below."""

    id: str
    title: str
    parts: tuple[Part, ...] = ()
    sections: tuple["ReportSection", ...] = ()


@dataclass(frozen=True, slots=True)
class DriveReport:
    """All of it. data: every number of it as plain data, SI; its keys are described in docs/report.md."""

    title: str
    sections: tuple[ReportSection, ...]
    data: Mapping[str, Any]


def figures_of(report: DriveReport) -> Iterator[ReportFigure]:
    """All figures, in the order in which they stand."""
    return (part for part in parts_of(report.sections) if isinstance(part, ReportFigure))


def parts_of(sections: tuple[ReportSection, ...]) -> Iterator[Part]:
    """All parts of sections and of those within."""
    for section in sections:
        yield from section.parts
        yield from parts_of(section.sections)


def as_json(report: DriveReport) -> dict[str, object]:
    """For json.dumps(…, allow_nan=False). The curves of figures stand in `data` only."""
    return {
        "form": FORM,
        "title": report.title,
        "sections": [_section(section) for section in report.sections],
        "data": report.data,
    }


def _section(section: ReportSection) -> dict[str, object]:
    return {
        "id": section.id,
        "title": section.title,
        "parts": [_part(part) for part in section.parts],
        "sections": [_section(one) for one in section.sections],
    }


def _part(part: Part) -> dict[str, object]:
    if isinstance(part, ReportText):
        return {part.kind: part.text}
    if isinstance(part, ReportFigure):
        return {"figure": part.id, "caption": part.caption, "description": part.description}
    rows = [[_cell(cell) for cell in row] for row in part.rows]
    return {"table": part.id, "caption": part.caption, "columns": list(part.columns), "rows": rows}


def _cell(cell: ReportCell) -> dict[str, object]:
    found = {"text": cell.text, "value": cell.value, "sd": cell.sd, "mark": cell.mark}
    return {key: value for key, value in found.items() if value not in (None, "") or key == "text"}


def plain(value: Any) -> Any:
    """Of dataclasses, arrays and complex numbers: dicts, lists and numbers as JSON has them.

    What is not finite becomes None; a complex number or array {"re": …, "im": …}.
    """
    if is_dataclass(value):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain(one) for key, one in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        if np.iscomplexobj(value):
            return {"re": plain(value.real), "im": plain(value.imag)}
        return plain(value.tolist())
    if isinstance(value, complex):
        return {"re": plain(value.real), "im": plain(value.imag)}
    if isinstance(value, float):
        return float(f"{value:.{_DIGITS}g}") if math.isfinite(value) else None
    if isinstance(value, Enum):
        return plain(value.value)
    if value is None or isinstance(value, bool | int | str):
        return value
    members: Iterable[Any] = value
    return [plain(one) for one in members]
