"""What `tilth fit` gives as one table: a row for each segment, for those that agree, and for all together."""

import csv
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TextIO

from tilth.analysis.fit.result import FitAnswer, RunAnswer
from tilth.replay.estimates_json import ParameterEntry
from tilth.schemas.flow import PARAMETERS
from tilth.schemas.spread import interval, of_parameter, scale_of, unit_of


@dataclass(frozen=True, slots=True)
class FitRow:
    """One line of the table; parameters in N/rad and m."""

    name: str  # short, such as: 1.2
    title: str
    parameters: Mapping[str, ParameterEntry]
    is_last: bool = False  # of the segments, or of the groups


def title_of(run: RunAnswer) -> str:
    """Such as: segment 1.2, headland turn, 31.0 to 58.5 s."""
    return f"segment {run['id']}, {_what(run)}, {run['start_s']:.1f} to {run['end_s']:.1f} s"


def _what(run: RunAnswer) -> str:
    return run["name"] or run["kind"].replace("_", " ")


def rows_of(answer: FitAnswer) -> Iterator[FitRow]:
    """Segments, groups of those that agree among themselves, all together."""
    runs = answer["runs"]
    for k, run in enumerate(runs):
        title = f"{run['id']} {_what(run)}\n{run['start_s']:.0f} to {run['end_s']:.0f} s"
        yield FitRow(run["id"], title, run["parameters"], k == len(runs) - 1)
    groups = [group for group in answer["groups"] if len(group["segments"]) > 1]
    for k, group in enumerate(groups):
        yield FitRow(group["name"], f"{group['name']}\ntogether", group["parameters"], k == len(groups) - 1)
    if answer["joint"] is not None and len(runs) > 1:
        yield FitRow("all", "all together", answer["joint"]["parameters"])


def write_csv(answer: FitAnswer, out: TextIO) -> None:
    """One line for each row and parameter, in the units of people, with both ends of the 95 % interval."""
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(("segments", "parameter", "unit", "estimate", "low_95", "high_95", "status", "reason"))
    for row in rows_of(answer):
        for name in PARAMETERS:
            one = row.parameters[name]
            numbers: tuple[object, ...] = ("", "", "")
            if one["value"] is not None and one["sd"] is not None:
                low, high = interval(one["value"], one["sd"] / one["value"])
                numbers = tuple(f"{scale_of(name) * x:.4g}" for x in (one["value"], low, high))
            writer.writerow((row.name, name, unit_of(name), *numbers, one["status"], one["reason"]))


def latex(answer: FitAnswer) -> str:
    """A tabular for a paper: estimates with their 95 % intervals. It needs no package."""
    heads = [f"${_symbol(name)}$ [{unit_of(name)}]" for name in PARAMETERS]
    lines = [r"\begin{tabular}{l" + "r" * len(heads) + "}", r"\hline", _line(["segment", *heads]), r"\hline"]
    for row in rows_of(answer):
        cells = [_cell(name, row.parameters[name]) for name in PARAMETERS]
        lines.append(_line([_escaped(row.title.replace("\n", ", ")), *cells]))
        if row.is_last:
            lines.append(r"\hline")
    return "\n".join([*lines, *([] if lines[-1] == r"\hline" else [r"\hline"]), r"\end{tabular}"])


def _line(cells: list[str]) -> str:
    return " & ".join(cells) + r" \\"


def _symbol(name: str) -> str:
    letter, axle = name.split("_")
    index = axle if letter == "sigma" else r"\alpha " + axle[-1]
    return f"{chr(92) + letter if letter == 'sigma' else letter}_{{{index}}}"


def _cell(name: str, one: ParameterEntry) -> str:
    if one["value"] is None or one["sd"] is None:
        return "--"
    text = of_parameter(name, one["value"], one["sd"], bare=True)
    return f"${text.replace('±', chr(92) + 'pm').replace('…', chr(92) + 'ldots')}$"


def _escaped(text: str) -> str:
    for character in "&%$#_{}":
        text = text.replace(character, chr(92) + character)
    return text
