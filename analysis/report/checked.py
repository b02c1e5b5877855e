"""Whether the fits hold: drives predicted that were not fitted, and what residuals tell.

held_out: {"subsets": [{"fitted": [ids], "cells": [{"run": id, "tractor_m", "implement_m", "held_out":
bool, "fit_percent": {output: %}, "horizon_rms": {s ahead: {output: SI}}, "gain": nats}], "refused": why
there are none}]}, RMS distances between predicted and driven paths, m; what could not be computed is None or
absent.

residuals: a list of tests, made plain by `document.plain`: {"output", "outcome": passed, failed or undecided,
"p_value", "sentence"}, with "test": what was tested, or the name of the class that held it (TESTS).
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

from tilth.analysis.report.document import (
    HELD_OUT,
    Part,
    ReportCell,
    ReportSection,
    ReportTable,
    ReportText,
)
from tilth.analysis.report.wording import NOTHING, listed, many, number, probability

MARK: Final = "held out"
TESTS: Final = {
    "WhitenessTest": "white (Ljung–Box)",
    "InputTest": "independent of the wheel angle",
    "SizeTest": "as large as the filter says",
}
"""Names of tests by the class that holds one."""
OUTPUTS: Final = {
    "yaw_rate": ("yaw rate", "°/s", math.degrees(1.0)),
    "velocity": ("velocity", "m/s", 1.0),
    "heading": ("heading", "°", math.degrees(1.0)),
}
"""Outputs of held_out: in words, their unit here, and how many of it make one of SI."""


def held_out_section(held_out: Mapping[str, Any] | None) -> ReportSection | None:
    """None without subsets."""
    subsets = (held_out or {}).get("subsets") or []
    if not subsets:
        return None
    runs = list(dict.fromkeys(str(cell["run"]) for subset in subsets for cell in subset["cells"]))
    refused = [subset for subset in subsets if subset.get("refused")]
    rows = tuple(
        (ReportCell(", ".join(map(str, subset["fitted"])) or "none: machine file"), *_cells(subset, runs))
        for subset in subsets
        if not subset.get("refused")
    )
    columns = ("fitted to", *(f"{run}: {body}, m" for run in runs for body in ("tractor", "implement")))
    caption = (
        f"RMS distance between the predicted and the driven path, m. A cell that says “{MARK}” is of a drive "
        "that was not among those fitted: only such cells tell how well the parameters predict."
    )
    table = ReportTable("held-out", caption, columns, rows)
    parts: list[Part] = [*_in_words(subsets), table, *_outputs_table(subsets)]
    if refused:
        named = "; ".join(", ".join(map(str, subset["fitted"])) for subset in refused)
        parts.insert(1, ReportText(f"Nothing is predicted from segments that do not agree: {named}."))
    return ReportSection("prediction", "Prediction of drives", tuple(parts))


def _outputs_table(subsets: Sequence[Mapping[str, Any]]) -> list[ReportTable]:
    """How well each output is predicted, of those subsets that were looked at over horizons; none without."""
    cells = [(subset, cell) for subset in subsets for cell in subset["cells"] if cell.get("horizon_rms")]
    values = [_by_output(cell) for _, cell in cells]
    asked = [key for key in dict.fromkeys(key for row in values for key in row)]
    known = [key for key in asked if any(row.get(key) is not None for row in values)]
    if not known:
        return []
    rows = []
    for (subset, cell), row in zip(cells, values, strict=True):
        fitted = ", ".join(map(str, subset["fitted"]))
        name = "none: machine file" if not fitted else "all" if len(subset["fitted"]) > 1 else fitted
        shown = [ReportCell(NOTHING if (v := row.get(key)) is None else number(v, 2), v) for key in known]
        rows.append((ReportCell(name), ReportCell(str(cell["run"])), *shown))
    caption = (
        "Fit: 100 % less the size of the error over 30 s as a share of what the output changes; below 0 a "
        "constant would have done better. Ahead: RMS error that long after the last correction."
    )
    return [ReportTable("outputs", caption, ("fitted to", "run", *known), tuple(rows))]


def _by_output(cell: Mapping[str, Any]) -> dict[str, float | None]:
    """What a column is called -> its value, in the unit that the name says."""
    found: dict[str, float | None] = {
        f"fit of {OUTPUTS[name][0]}, %": value for name, value in (cell.get("fit_percent") or {}).items()
    }
    for ahead, by_name in (cell.get("horizon_rms") or {}).items():
        for name, value in by_name.items():
            words, unit, per_si = OUTPUTS[name]
            found[f"{words} {ahead} s ahead, {unit}"] = None if value is None else value * per_si
    return found | {"log-likelihood gain": cell.get("gain")}


def _cells(subset: Mapping[str, Any], runs: Sequence[str]) -> list[ReportCell]:
    by_run = {str(cell["run"]): cell for cell in subset["cells"]}
    found = []
    for run in runs:
        cell = by_run.get(run, {})
        out = bool(cell.get("held_out"))
        for body in ("tractor_m", "implement_m"):
            value = cell.get(body)
            text = NOTHING if value is None else number(value, 2)
            found.append(ReportCell(f"{text} ({MARK})" if out else text, value, mark=HELD_OUT if out else ""))
    return found


def _in_words(subsets: Sequence[Mapping[str, Any]]) -> list[Part]:
    cells = [cell for subset in subsets for cell in subset["cells"] if subset["fitted"] and cell["held_out"]]
    known = [cell for cell in cells if cell.get("tractor_m") is not None]
    if not known:
        return [
            ReportText("No drive was held out: the table shows how well the fits describe their own data.")
        ]
    worst = max(known, key=lambda cell: float(cell["tractor_m"]))
    return [
        ReportText(
            f"{many(len(known), 'prediction')} of drives that were not fitted; the tractor's is at worst "
            f"{number(worst['tractor_m'], 2, 'm')} from the driven path (segment {worst['run']})."
        )
    ]


def residuals_section(residuals: Sequence[Mapping[str, Any]] | None) -> ReportSection | None:
    """None without tests."""
    if not residuals:
        return None
    rows = tuple(
        (
            ReportCell(str(one["output"])),
            ReportCell(_test(one)),
            ReportCell(str(one["outcome"])),
            ReportCell(probability(one.get("p_value")), one.get("p_value")),
            ReportCell(str(one["sentence"])),
        )
        for one in residuals
    )
    failed = [f"{one['output']} ({_test(one)})" for one in residuals if one["outcome"] == "failed"]
    text = f"Not passed: {listed(failed)}." if failed else "No test of the residuals failed."
    columns = ("output", "test", "outcome", "p", "what it means")
    caption = "Tests of what the fit leaves: residuals of a right model are white and free of steering."
    table = ReportTable("residual-tests", caption, columns, rows)
    return ReportSection("residuals", "Residuals", (ReportText(text), table))


def _test(one: Mapping[str, Any]) -> str:
    kind = str(one.get("test") or NOTHING)
    return TESTS.get(kind, kind)
