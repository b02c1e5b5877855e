"""A map as a picture and as a page."""

import math
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any, Final

import matplotlib
import numpy as np

from tilth.analysis.report.document import (
    DriveReport,
    ReportCell,
    ReportFigure,
    ReportSection,
    ReportTable,
    ReportText,
)
from tilth.analysis.report.figure_look import LOOK, PAPER
from tilth.analysis.report.page import page
from tilth.analysis.report.season_figures import field_map
from tilth.analysis.report.wording import NOTHING, dates, many, meaning_of, sentences
from tilth.analysis.season.field_map import STIFFNESSES, MappedField
from tilth.analysis.season.kept_table import RigStretches, runs_in
from tilth.analysis.season.map_files import MEANING
from tilth.logger.log import whole_file
from tilth.schemas.readable import readable
from tilth.schemas.spread import scale_of, unit_of

HECTARE: Final = 1e4
DPI: Final = 200


def write_picture(path: Path, rig: RigStretches, field: MappedField) -> None:
    """A PNG, a new file or nothing. Raises OSError."""
    stream = BytesIO()
    with matplotlib.rc_context(LOOK):
        figure = field_map(drawn(field))
        figure.suptitle(title := f"{_name(rig)}: field {field.number}, {_days(field)}")
        told = {"Software": None, "Title": title}
        figure.savefig(stream, format="png", dpi=DPI, facecolor=PAPER, metadata=told)
    whole_file.write(path, stream.getvalue(), replace=False)


def write_page(path: Path, rig: RigStretches, fields: Sequence[MappedField], command: str) -> None:
    """One HTML file that needs nothing else; its maps zoom. A new file or nothing. Raises OSError."""
    how = [f"Made by: {command}.", *(sentences([text]) for text in rig.left_out)]
    how += [sentences([f"{what}: {text}"]) for what, text in MEANING.items()]
    made = ReportSection("made", "How this was made", tuple(map(ReportText, how)))
    sections = [*map(_section, fields), made]
    report = DriveReport(f"Fields of {_name(rig)}", tuple(sections), {})
    whole_file.write(path, readable(page(report)).encode(), replace=False)


def drawn(field: MappedField) -> dict[str, Any]:
    """What a figure shows: east and north of the ways, and the cells by rows from the south."""
    cells = np.round(field.grid / field.cell_m).astype(int)
    ways = [*field.ways, field.outline]
    places = np.concatenate([cells * field.cell_m, (cells + 1) * field.cell_m, *ways])
    first = np.floor(places.min(axis=0) / field.cell_m).astype(int)
    size = np.ceil(places.max(axis=0) / field.cell_m).astype(int) - first
    size = np.maximum(size, 1)
    south, west = (field.cell_m * first).tolist()
    north, east = (field.cell_m * (first + size)).tolist()
    parameters = {}
    for k, name in enumerate(STIFFNESSES):
        rows = {"mean": np.full(size, np.nan), "sd": np.full(size, np.nan)}
        rows["mean"][tuple((cells - first).T)] = field.mean[:, k]
        rows["sd"][tuple((cells - first).T)] = field.sd[:, k]
        if not np.all(np.isnan(rows["mean"])):
            parameters[name] = {key: of.tolist() for key, of in rows.items()}
    return {
        "extent": [west, east, south, north],
        "parameters": parameters,
        "ways": [way[:, ::-1].tolist() for way in field.ways],
        "outline": field.outline[:, ::-1].tolist(),
    }


def _name(rig: RigStretches) -> str:
    return f"{rig.machine_name}, implement {rig.implement}"


def _days(field: MappedField) -> str:
    """When it was driven."""
    return dates(one.begin_utc_ns for one in field.stretches)


def told_of(field: MappedField) -> str:
    """A field in a sentence."""
    latitude, longitude = field.origin_deg
    runs = many(len(runs_in(field.stretches)), "run")
    text = (
        f"field {field.number}: {len(field.stretches)} stretches of {runs}, "
        f"{_days(field)}, near {latitude:.5f}, {longitude:.5f}; "
        f"{len(field.grid) * field.cell_m**2 / HECTARE:.2f} ha with a number"
    )
    return f"{text}; the soil has changed since {', '.join(field.changed)}" if field.changed else text


def _section(field: MappedField) -> ReportSection:
    told = sentences([told_of(field)])
    rows = tuple(
        (
            ReportCell(f"{meaning_of(name)}, {unit_of(name)}"),
            *(_cell(field.mean[:, k], share, scale_of(name)) for share in (5, 50, 95)),
            _cell(np.log(field.sd[:, k]), 50, 100.0),
        )
        for k, name in enumerate(STIFFNESSES)
    )
    columns = ("in cells with a number", "5 % are below", "median", "95 % are below", "median sd, %")
    table = ReportTable(f"values-{field.number}", "Values of the cells.", columns, rows)
    data = drawn(field)
    parts: list[Any] = [ReportText(told), table]
    if data["parameters"]:
        caption = (
            "Cornering stiffness (the larger, the more firmly the soil holds the tyres) and its uncertainty, "
            "north up. Thin lines: paths of the implement's axle; thick line: their outline."
        )
        parts.insert(1, ReportFigure(f"map-{field.number}", "field_map", caption, told, data))
    return ReportSection(f"field-{field.number}", f"Field {field.number}", tuple(parts))


def _cell(logs: Any, share: float, scale: float) -> ReportCell:
    known = logs[np.isfinite(logs)]
    if not known.size:
        return ReportCell(NOTHING)
    value = math.exp(np.percentile(known, share)) * scale
    return ReportCell(f"{value:.3g}", value)
