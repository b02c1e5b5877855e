"""Fits of segments and of all together, and whether they agree."""

from collections.abc import Mapping
from typing import Final, NamedTuple

from tilth.analysis.fit.published_values import own
from tilth.analysis.fit.result import FitAnswer
from tilth.analysis.report.data import PriorFacts
from tilth.analysis.report.document import (
    Part,
    ReportCell,
    ReportFigure,
    ReportSection,
    ReportTable,
    ReportText,
)
from tilth.analysis.report.glance import NAMES
from tilth.analysis.report.published import correlation_figure
from tilth.analysis.report.wording import NOTHING, fixed, heading_of, parameter_cell
from tilth.replay.estimates_json import ParameterEntry
from tilth.schemas.flow import PARAMETERS

TOGETHER: Final = "all together"


def fit_section(fit: FitAnswer | None, prior: Mapping[str, PriorFacts] | None = None) -> ReportSection | None:
    """prior: the machine file's, of `gather.facts_of`. None without fits."""
    if not fit or not (fit["runs"] or fit["joint"]):
        return None
    parts: list[Part] = [ReportText(text) for text in fit.get("notes") or ()]
    if fit["agreement"]:
        parts.append(ReportText(fit["agreement"]["sentence"]))
    parts += [_figure(fit, prior), _table(fit), *_reasons(fit)]
    sections = [
        ReportSection("fit-published", "Beside published values", (_published_table(fit), *_sources()))
    ]
    joint = fit["joint"]
    known = [name for name in PARAMETERS if joint and joint["parameters"][name]["value"] is not None]
    if joint and len(known) > 1:
        figure = correlation_figure(joint["log_covariance"], known, "fit", "of all segments together")
        sections.append(ReportSection("fit-correlations", "Correlations of the joint fit", (figure,)))
    return ReportSection("fit", "Fits of segments", tuple(parts), tuple(sections))


class _Row(NamedTuple):
    """A fit as a table shows it."""

    name: str
    parameters: Mapping[str, ParameterEntry]
    kind: str = NOTHING
    start_s: float | None = None
    end_s: float | None = None


def _rows(fit: FitAnswer) -> list[_Row]:
    rows = [
        _Row(one["id"], one["parameters"], one["name"] or NAMES[one["kind"]], one["start_s"], one["end_s"])
        for one in fit["runs"]
    ]
    several = [one for one in fit["groups"] if len(one["segments"]) > 1]
    rows += [_Row(f"together: {one['name']}", one["parameters"], one["name"]) for one in several]
    return [*rows, _Row(TOGETHER, fit["joint"]["parameters"])] if fit["joint"] else rows


def _table(fit: FitAnswer) -> ReportTable:
    rows = tuple(
        (
            ReportCell(one.name),
            ReportCell(fixed(one.start_s, 1), one.start_s),
            ReportCell(fixed(one.end_s, 1), one.end_s),
            ReportCell(one.kind),
            *(parameter_cell(parameter, one.parameters[parameter]) for parameter in PARAMETERS),
        )
        for one in _rows(fit)
    )
    columns = ("segment", "from, s", "to, s", "kind", *map(heading_of, PARAMETERS))
    caption = (
        "Fits by segment and of all together, with 95 % intervals; a status where there is no number. "
        "Segment 2.34 is number 34 of run 2."
    )
    return ReportTable("fit-table", caption, columns, rows)


def _published_table(fit: FitAnswer) -> ReportTable:
    """This fit, and what others have published."""
    ours = [
        (
            ReportCell("this fit"),
            *(parameter_cell(name, one.parameters[name]) for name in PARAMETERS),
            ReportCell(""),
        )
        for one in _rows(fit)[-1:]
    ]
    theirs = [
        (
            ReportCell(one.title),
            *(ReportCell(one.told(name) or NOTHING) for name in PARAMETERS),
            ReportCell(one.where),
        )
        for one in own()
    ]
    caption = (
        "What others have published of tractors and implements in fields, of the whole axle, with 95 % "
        "intervals "
        "where they give sds. Other rigs, soils and loads: a difference is no fault of either."
    )
    columns = ("of", *map(heading_of, PARAMETERS), "where")
    return ReportTable("fit-published-table", caption, columns, (*ours, *theirs))


def _sources() -> list[ReportText]:
    """Each once, with what is said of its sets of values."""
    found: dict[str, list[str]] = {}
    for one in own():
        about = "; ".join(filter(None, (one.rig, one.load, one.tyre, one.soil, one.how)))
        found.setdefault(one.source, []).append(f"{one.title}: {about}.")
    return [ReportText(f"{source}. {' '.join(about)}") for source, about in found.items()]


def _reasons(fit: FitAnswer) -> list[Part]:
    """Why numbers are missing, each reason once."""
    found: dict[str, list[str]] = {}
    for one in _rows(fit):
        for name in PARAMETERS:
            if reason := one.parameters[name]["reason"]:
                found.setdefault(reason, []).append(f"{name} of {one.name}")
    return [ReportText(f"{', '.join(names)}: {reason}.") for reason, names in found.items()]


def _figure(fit: FitAnswer, prior: Mapping[str, PriorFacts] | None) -> ReportFigure:
    rows = [
        {"name": one.name, "joint": one.name == TOGETHER,
         "parameters": {p: _with_sd(one.parameters[p]) for p in PARAMETERS}}
        for one in _rows(fit)
    ]  # fmt: skip
    return ReportFigure(
        "fit-intervals", "intervals",
        "Estimates of each segment and of all together (diamond), with 95 % intervals. Dashed: the "
        "machine file.",
        f"Six panels with {len(rows)} intervals each; the table below has the numbers.",
        {"rows": rows, "prior": prior},
    )  # fmt: skip


def _with_sd(found: ParameterEntry) -> dict[str, float] | None:
    if found["value"] is None or found["sd"] is None:
        return None
    return {"value": found["value"], "sd": found["sd"]}
