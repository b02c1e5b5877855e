"""Fits of segments and of all together, and whether they agree.

fit: {"runs": [{"id", "log", "start_s", "end_s", "kind", "name", "parameters": {C_af: {"value", "sd",
"status", "reason"}, …}, "nuisances", "log_covariance": 6 x 6 or None, "seconds"}, …], "joint": {"parameters",
"log_covariance", "nuisances"} or None,
"groups": [the same with "segments": [id, …] and "name", …],
"agreement": {"chi2", "dof", "p", "sentence"} or None, "notes": [what else is to be said]}; SI.
"""

from collections.abc import Mapping
from typing import Any, Final

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
from tilth.schemas.flow import PARAMETERS

TOGETHER: Final = "all together"


def fit_section(
    fit: Mapping[str, Any] | None, prior: Mapping[str, Any] | None = None
) -> ReportSection | None:
    """prior: the machine file's, of `gather.facts_of`. None without fits."""
    if not fit or not (fit.get("runs") or fit.get("joint")):
        return None
    parts: list[Part] = [ReportText(text) for text in fit.get("notes") or ()]
    agreement = fit.get("agreement")
    if agreement:
        parts.append(ReportText(str(agreement["sentence"])))
    parts += [_figure(fit, prior), _table(fit), *_reasons(fit)]
    sections = []
    joint = fit.get("joint") or {}
    covariance = joint.get("log_covariance")
    known = [name for name in PARAMETERS if _value(joint, name) is not None]
    if covariance and len(known) > 1:
        figure = correlation_figure(covariance, known, "fit", "of all segments together")
        sections.append(ReportSection("fit-correlations", "Correlations of the joint fit", (figure,)))
    return ReportSection("fit", "Fits of segments", tuple(parts), tuple(sections))


def _value(found: Mapping[str, Any], name: str) -> float | None:
    value: float | None = (found.get("parameters") or {}).get(name, {}).get("value")
    return value


def _rows(fit: Mapping[str, Any]) -> list[tuple[str, Mapping[str, Any]]]:
    """What each row is called, and its fit."""
    rows = [(str(one["id"]), one) for one in fit.get("runs") or ()]
    several = [one for one in fit.get("groups") or () if len(one["segments"]) > 1]
    rows += [(f"together: {one['name']}", one) for one in several]
    return [*rows, (TOGETHER, fit["joint"])] if fit.get("joint") else rows


def _table(fit: Mapping[str, Any]) -> ReportTable:
    rows = []
    for name, one in _rows(fit):
        kind = one.get("name") or NAMES.get(one.get("kind", ""), one.get("kind", "")) or NOTHING
        start, end = one.get("start_s"), one.get("end_s")
        rows.append((
            ReportCell(name),
            ReportCell(fixed(start, 1), start),
            ReportCell(fixed(end, 1), end),
            ReportCell(kind),
            *(parameter_cell(parameter, one["parameters"].get(parameter)) for parameter in PARAMETERS),
        ))  # fmt: skip
    columns = ("segment", "from, s", "to, s", "kind", *map(heading_of, PARAMETERS))
    caption = (
        "Fits by segment and of all together, with 95 % intervals; a status where there is no number. "
        "Segment 2.34 is number 34 of run 2."
    )
    return ReportTable("fit-table", caption, columns, tuple(rows))


def _reasons(fit: Mapping[str, Any]) -> list[Part]:
    """Why numbers are missing, each reason once."""
    found: dict[str, list[str]] = {}
    for row, one in _rows(fit):
        for name in PARAMETERS:
            parameter = one["parameters"].get(name) or {}
            if parameter.get("reason"):
                found.setdefault(parameter["reason"], []).append(f"{name} of {row}")
    return [ReportText(f"{', '.join(names)}: {reason}.") for reason, names in found.items()]


def _figure(fit: Mapping[str, Any], prior: Mapping[str, Any] | None) -> ReportFigure:
    rows = [
        {"name": name, "joint": name == TOGETHER,
         "parameters": {p: _with_sd(one["parameters"].get(p)) for p in PARAMETERS}}
        for name, one in _rows(fit)
    ]  # fmt: skip
    return ReportFigure(
        "fit-intervals", "intervals",
        "Estimates of each segment and of all together (diamond), with 95 % intervals. Dashed: the "
        "machine file.",
        f"Six panels with {len(rows)} intervals each; the table below has the numbers.",
        {"rows": rows, "prior": prior},
    )  # fmt: skip


def _with_sd(found: Mapping[str, Any] | None) -> dict[str, Any] | None:
    if not found or found.get("value") is None or found.get("sd") is None:
        return None
    return {"value": found["value"], "sd": found["sd"]}
