"""Whether the fits hold: drives predicted that were not fitted, and what residuals tell."""

import math
from collections.abc import Sequence
from statistics import median
from typing import Final

from tilth.analysis.report.data import HeldOut, HeldOutCell, HeldOutSubset, TestFacts
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
    "WhitenessTest": "one step ahead: white (Ljung–Box)",
    "InputTest": "one step ahead: independent of the wheel angle",
    "SizeTest": "one step ahead: as large as the filter says",
}
"""Names of tests by the class that holds one."""
ANOTHER_TEST: Final = (
    "This is another test than the one under Frequency response. Here each measurement corrects the "
    "prediction "
    "of the next, so only what goes wrong within a step is seen. There nothing is corrected over a "
    "whole drive, "
    "with parameters of all segments together, so small errors add up. A model can pass here and fail there."
)
OUTPUTS: Final = {
    "yaw_rate": ("yaw rate", "°/s", math.degrees(1.0)),
    "velocity": ("velocity", "m/s", 1.0),
    "heading": ("heading", "°", math.degrees(1.0)),
}
"""Outputs of held_out: in words, their unit here, and how many of it make one of SI."""


def held_out_section(held_out: HeldOut | None) -> ReportSection | None:
    """None without subsets."""
    subsets = held_out["subsets"] if held_out else []
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


def _outputs_table(subsets: Sequence[HeldOutSubset]) -> list[ReportTable]:
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


def _by_output(cell: HeldOutCell) -> dict[str, float | None]:
    """What a column is called -> its value, in the unit that the name says."""
    found: dict[str, float | None] = {
        f"fit of {OUTPUTS[name][0]}, %": value for name, value in (cell.get("fit_percent") or {}).items()
    }
    for ahead, by_name in (cell.get("horizon_rms") or {}).items():
        for name, value in by_name.items():
            words, unit, per_si = OUTPUTS[name]
            found[f"{words} {ahead} s ahead, {unit}"] = None if value is None else value * per_si
    return found | {"log-likelihood gain": cell.get("gain")}


def _cells(subset: HeldOutSubset, runs: Sequence[str]) -> list[ReportCell]:
    by_run = {str(cell["run"]): cell for cell in subset["cells"]}
    found = []
    for run in runs:
        cell = by_run.get(run)
        out = cell is not None and cell["held_out"]
        for value in (cell["tractor_m"], cell["implement_m"]) if cell else (None, None):
            text = NOTHING if value is None else number(value, 2)
            found.append(ReportCell(f"{text} ({MARK})" if out else text, value, mark=HELD_OUT if out else ""))
    return found


def _in_words(subsets: Sequence[HeldOutSubset]) -> list[Part]:
    cells = [cell for subset in subsets for cell in subset["cells"] if subset["fitted"] and cell["held_out"]]
    known = [(cell["tractor_m"], cell["run"]) for cell in cells if cell["tractor_m"] is not None]
    if not known:
        return [
            ReportText("No drive was held out: the table shows how well the fits describe their own data.")
        ]
    worst_m, run = max(known, key=lambda row: row[0])
    return [
        ReportText(
            f"{many(len(known), 'prediction')} of drives that were not fitted; the tractor's is at worst "
            f"{number(worst_m, 2, 'm')} from the driven path (segment {run})."
        ),
        *_together_or_alone(subsets),
    ]


def _together_or_alone(subsets: Sequence[HeldOutSubset]) -> list[ReportText]:
    """Why several segments together predict better or worse than one of them; nothing of less than three."""
    runs = {str(cell["run"]) for subset in subsets for cell in subset["cells"]}
    own, alone, together = list[float](), list[float](), list[float]()
    for subset in subsets:
        for cell in subset["cells"]:
            if cell["tractor_m"] is None or not subset["fitted"]:
                continue
            if not cell["held_out"]:
                own += [cell["tractor_m"]] if len(subset["fitted"]) == 1 else []
            elif len(subset["fitted"]) == 1:
                alone.append(cell["tractor_m"])
            elif len(subset["fitted"]) == len(runs) - 1:
                together.append(cell["tractor_m"])
    if not (own and alone and together):
        return []
    one, rest = median(alone), median(together)
    why = (
        "what is special to one drive (its soil, the ground's pushes) averages out."
        if rest < one
        else "they are weighted by how well each tells the parameters, and where soil or load differ between "
        "drives their mean is of none of them. See above whether the segments agree."
    )
    return [
        ReportText(
            f"Median distance of the tractor: {number(median(own), 2, 'm')} of a drive by its own fit, "
            f"{number(one, 2, 'm')} by the fit of one other, {number(rest, 2, 'm')} by that of all others "
            f"together. Together they predict {'better' if rest < one else 'no better'} than one "
            f"alone: {why} A fit "
            "makes each next measurement likely, not the path of half a minute; so even its own path "
            "need not be "
            "the nearest."
        )
    ]


def residuals_section(residuals: Sequence[TestFacts] | None) -> ReportSection | None:
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
    caption = (
        "Tests of what a segment's own fit leaves of each measurement, predicted one step ahead from "
        "all before "
        "it: residuals of a right model are white and free of steering. p: as it counts among all tests."
    )
    table = ReportTable("residual-tests", caption, columns, rows)
    return ReportSection("residuals", "Residuals", (ReportText(text), table, ReportText(ANOTHER_TEST)))


def _test(one: TestFacts) -> str:
    kind = str(one.get("test") or NOTHING)
    return TESTS.get(kind, kind)
