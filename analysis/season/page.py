"""A season as a person reads it: its days, machines and implements, soils, runs that deserve a look, disk."""

import math
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from tilth.analysis.report.document import (
    WARNING,
    DriveReport,
    Part,
    ReportCell,
    ReportFigure,
    ReportSection,
    ReportTable,
    ReportText,
    as_json,
    plain,
)
from tilth.analysis.report.page import page
from tilth.analysis.report.wording import (
    NOTHING,
    clock,
    dates,
    heading_of,
    many,
    number,
    parameter_text,
    seconds,
    sentences,
)
from tilth.analysis.report.writing import json_text
from tilth.analysis.season.season import SUMMARY, Season
from tilth.analysis.season.stretches import STRETCH, DrivenRig, DrivenRun, SaidOfSix, SeasonRow
from tilth.logger.log import whole_file
from tilth.logger.log.software import software
from tilth.replay.simulated import SAID
from tilth.schemas.flow import PARAMETERS
from tilth.schemas.readable import readable
from tilth.schemas.spread import interval

NUMBERS: Final = "summary.json"
STIFFNESSES: Final = PARAMETERS[:3]
WHICH: Final = ("run", "machine", "day")
MB: Final = 1e6


def write_summary(made: Season, command: str) -> None:
    """DIR/season.html, and every number of it beside. Raises OSError."""
    report = report_of(made, command)
    whole_file.write(made.out / SUMMARY, readable(page(report)).encode())
    whole_file.write(made.out / NUMBERS, readable(json_text(as_json(report))).encode())


def report_of(made: Season, command: str) -> DriveReport:
    """made: a season with its rows."""
    runs, rows = made.runs or (), made.rows or ()
    sections = [
        _short(made, runs, rows), _look(made, runs), _days(runs), _rigs(runs, rows), *_soils(rows),
        _disk(made, runs), _how(command),
    ]  # fmt: skip
    data = {
        "command": command,
        "software": software(),
        "done": made.done,
        "runs": [_plain_run(one) for one in runs],
        "left_out": [{"file": path, "why": why} for path, why in made.inventory.left_out],
    }
    return DriveReport("Season", tuple(sections), plain(data))


def _plain_run(one: DrivenRun) -> dict[str, object]:
    found = one.found
    return {
        "run": one.run.name,
        "machine": one.rig and one.rig.machine,
        "implement": one.rig and one.rig.implement,
        "begin_utc_s": one.begins_ns * 1e-9 if one.begins_ns else None,
        "seconds": one.seconds,
        "cpu_s": found.cpu_s,
        "frames": found.frames,
        "poses": found.poses,
        "stretches": len(found.stretches),
        "failure": found.failure,
        "apart": one.apart,
        "look": one.look,
        "rejected": found.rejected,
    }


def _short(made: Season, runs: Sequence[DrivenRun], rows: Sequence[SeasonRow]) -> ReportSection:
    hours = sum(one.seconds for one in runs)
    stretches = [row for row in rows if row.kind == STRETCH]
    used = sum(row.known is not None for row in stretches)
    rigs = _rigs_of(runs)
    machines = many(len({one.machine for one in rigs}), "machine")
    when = dates(one.begins_ns for one in runs if one.begins_ns)
    driven = f", {when}" if when else ""
    text = (
        f"{many(len(runs), 'run')} of {seconds(hours)} by {machines}, {many(len(rigs), 'pair')} of machine "
        f"and implement{driven}. Fitted stretches of driving: {len(stretches)}; used: {used}."
    )
    look, left_out = sum(bool(one.look) for one in runs), len(made.inventory.left_out)
    parts: list[Part] = [
        ReportText(text),
        ReportText(f"Runs that deserve a look: {look}. Files that are not used: {left_out}."),
    ]
    failed = sum(bool(one.found.failure) for one in runs)
    if failed:
        parts.append(ReportText(f"{many(failed, 'run')} could not be identified.", WARNING))
    if any(file.simulated for one in runs for file in one.run.files):
        parts.append(ReportText(f"{SAID.capitalize()}.", WARNING))
    if made.not_kept:
        parts.append(ReportText(f"What came of some runs could not be kept: {made.not_kept}.", WARNING))
    return ReportSection("short", "In short", tuple(parts))


def _rigs_of(runs: Sequence[DrivenRun]) -> list[DrivenRig]:
    return list(dict.fromkeys(one.rig for one in runs if one.rig is not None))


def _name(rig: DrivenRig) -> str:
    return f"{rig.machine}, implement {rig.implement}"


def _day(utc_ns: int) -> str:
    return clock(utc_ns * 1e-9, "%Y-%m-%d") if utc_ns else "unknown"


def _days(runs: Sequence[DrivenRun]) -> ReportSection:
    days = list(dict.fromkeys(_day(one.begins_ns) for one in runs))
    rigs = _rigs_of(runs)
    of_day = {(rig, day): 0.0 for rig in rigs for day in days}
    for one in runs:
        if one.rig is not None:
            of_day[one.rig, _day(one.begins_ns)] += one.seconds / 3600
    hours = [[of_day[rig, day] for day in days] for rig in rigs]
    rows = tuple(
        (
            ReportCell(day),
            *(ReportCell(f"{of[k]:.2f}" if of[k] else NOTHING, of[k]) for of in hours),
            ReportCell(str(count := sum(_day(one.begins_ns) == day for one in runs)), count),
        )
        for k, day in enumerate(days)
    )
    columns = ("day", *(f"{_name(rig)}, h" for rig in rigs), "runs")
    parts: list[Part] = [ReportTable("days-table", "Hours of recording of each day (UTC).", columns, rows)]
    if days and rigs:
        figure = {
            "days": days,
            "rigs": [{"name": _name(rig), "hours": of} for rig, of in zip(rigs, hours, strict=True)],
        }
        text = f"{many(len(days), 'day')}; the table has the numbers."
        parts.insert(0, ReportFigure("days-figure", "calendar", "Hours of recording by day.", text, figure))
    return ReportSection("days", "Days", tuple(parts))


def _rigs(runs: Sequence[DrivenRun], rows: Sequence[SeasonRow]) -> ReportSection:
    table = []
    for rig in _rigs_of(runs):
        own = [one for one in runs if one.rig == rig]
        last = _last(rows, rig)
        table.append((
            ReportCell(_name(rig)),
            ReportCell(str(len(own)), len(own)),
            ReportCell(seconds(hours := sum(one.seconds for one in own)), hours),
            *(_value(last, k) for k in range(len(PARAMETERS))),
        ))  # fmt: skip
    columns = ("machine, implement", "runs", "recorded", *map(heading_of, PARAMETERS))
    caption = "Machines and implements, with the values of the last stretch of the season and 95 % intervals."
    return ReportSection(
        "machines", "Machines and implements", (ReportTable("rigs", caption, columns, tuple(table)),)
    )


def _last(rows: Sequence[SeasonRow], rig: DrivenRig) -> SaidOfSix | None:
    known = [row.known for row in rows if row.run is not None and row.run.rig == rig and not row.run.apart]
    return next((one for one in reversed(known) if one is not None), None)


def _value(known: SaidOfSix | None, k: int) -> ReportCell:
    if known is None or known.reasons[k]:
        return ReportCell(NOTHING)
    value = math.exp(known.six.mean[k])
    sd = value * math.sqrt(known.six.covariance[k, k])
    return ReportCell(parameter_text(PARAMETERS[k], value, sd), value, sd)


def _soils(rows: Sequence[SeasonRow]) -> Iterator[ReportSection]:
    by_rig: dict[DrivenRig, list[SeasonRow]] = {}
    for row in rows:
        if row.known is not None and row.run is not None and row.run.rig is not None and not row.run.apart:
            by_rig.setdefault(row.run.rig, []).append(row)
    for number_of, (rig, own) in enumerate(by_rig.items(), 1):
        days: dict[str, int] = {}
        curves: dict[str, list[dict[str, float]]] = {name: [] for name in STIFFNESSES}
        for at, row in enumerate(own):
            assert row.run is not None and row.known is not None
            days.setdefault(_day(row.run.begins_ns), at)
            for k, name in enumerate(STIFFNESSES):
                if not row.known.reasons[k]:
                    value = math.exp(row.known.six.mean[k])
                    low, high = interval(value, float(np.sqrt(row.known.six.covariance[k, k])))
                    curves[name].append({"at": at, "low": low, "value": value, "high": high})
        data = {
            "parameters": {name: points for name, points in curves.items() if points},
            "days": [{"day": day, "at": at} for day, at in days.items()],
        }
        if not data["parameters"]:
            continue
        figure = ReportFigure(
            f"soils-{number_of}", "soils",
            f"Cornering stiffnesses, stretch by stretch, by the whole season: {_name(rig)}; 95 % intervals.",
            f"{len(own)} stretches of {len(days)} days; the table of stretches has the numbers.", data,
        )  # fmt: skip
        yield ReportSection(f"soil-{number_of}", f"Soils: {_name(rig)}", (figure,))


def _which(one: DrivenRun) -> tuple[ReportCell, ...]:
    """A run among all, under WHICH."""
    machine = one.rig.machine if one.rig is not None else NOTHING
    return ReportCell(one.run.name), ReportCell(machine), ReportCell(_day(one.begins_ns))


def _look(made: Season, runs: Sequence[DrivenRun]) -> ReportSection:
    rows = [(*_which(one), ReportCell(sentences(one.look))) for one in runs if one.look]
    parts: list[Part] = [
        ReportTable("look", "Runs that deserve a look, and why.", (*WHICH, "why"), tuple(rows))
        if rows
        else ReportText("No run deserves a look.")
    ]
    if made.inventory.left_out:
        files = tuple((ReportCell(path), ReportCell(why)) for path, why in made.inventory.left_out)
        parts.append(ReportTable("left-out", "Files that are not used, and why.", ("file", "why"), files))
    return ReportSection("look-at", "To look at", tuple(parts))


def _disk(made: Season, runs: Sequence[DrivenRun]) -> ReportSection:
    rows = []
    for one in runs:
        size, cpu = one.run.size, one.found.cpu_s
        fast = one.seconds / cpu if cpu else math.nan
        rows.append((
            *_which(one),
            ReportCell(seconds(one.seconds), one.seconds),
            ReportCell(f"{size / MB:.1f}", size),
            ReportCell(str(len(one.found.stretches)), len(one.found.stretches)),
            ReportCell(number(fast, 2), fast if math.isfinite(fast) else None),
        ))  # fmt: skip
    columns = (*WHICH, "length", "MB", "stretches", "times real time, a core")
    size, hours = sum(one.run.size for one in runs), sum(one.seconds for one in runs) / 3600
    per_hour = f", {size / MB / hours:.0f} MB an hour" if hours else ""
    text = f"The logs are {size / MB:.0f} MB for {hours:.2f} h{per_hour}."
    return ReportSection(
        "disk",
        "Runs, disk and hours",
        (ReportText(text), ReportTable("runs", "All runs.", columns, tuple(rows))),
    )


def _how(command: str) -> ReportSection:
    told = software()
    versions = f"tilth {told['version']}, estimator {told['estimator'][:12]}, Python {told['python']}"
    text = f"Made by: {command}. {versions}."
    more = (
        "An interval is of 95 % (1.96 sd), log-normal about the median. stretches.parquet beside this page "
        "has a row for each stretch, with its path, covariance and reasons, and the hashes of its logs."
    )
    return ReportSection("made", "How this was made", (ReportText(text), ReportText(more)))
