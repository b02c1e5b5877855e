"""What the report says first, and how it was made: warnings, versions, sums of the logs, the command."""

from collections.abc import Mapping, Sequence
from typing import Final

from tilth.analysis.report.data import OriginFacts, ReportData, RunFacts
from tilth.analysis.report.document import WARNING, Part, ReportCell, ReportSection, ReportTable, ReportText
from tilth.analysis.report.glance import at_a_glance, contradicted
from tilth.analysis.report.published import RECOMMENDED, values_table
from tilth.analysis.report.wording import NOTHING, listed, many
from tilth.replay.simulated import SAID
from tilth.schemas.flow import PARAMETERS, EventKind

SIMULATED: Final = f"{SAID.capitalize()}."
FAULTS: Final = (
    EventKind.FAULT, EventKind.GAP, EventKind.CLOCK_STEP, EventKind.STORED_STATE, EventKind.DISAGREEMENT,
)  # fmt: skip
"""Kinds of events that make results doubtful."""
_SKIPPED: Final = {
    "damaged_chunk": "Damaged parts of the log", "damaged_message": "Damaged messages",
}  # fmt: skip
"""What could not be read; a file without its end has a sentence of its own."""


def short_section(runs: Sequence[RunFacts]) -> ReportSection:
    """Warnings first; then what each run was, and its result."""
    parts: list[Part] = []
    for run in runs:
        name = f"{run['id']}: " if len(runs) > 1 else ""
        parts += [ReportText(name + text, WARNING) for text in warnings_of(run)]
    for k, run in enumerate(runs, 1):
        parts.append(ReportText(at_a_glance(run)))
        if run["estimates"]:
            parts.append(values_table(run, f"short{k}"))
        else:
            parts.append(ReportText("There are no estimates in it."))
    return ReportSection("short", "In short", tuple(parts))


def warnings_of(run: RunFacts) -> list[str]:
    """What makes the results of a run doubtful, in sentences."""
    found = [
        f"The data contradict the machine file at {key}, in {100 * share:.0f} % of the poses. While they do, "
        "no estimate is published. Correct the machine file and replay the log"
        for key, share in contradicted(run)
    ]
    origin = run["origin"]
    if origin["simulated"]:
        found.append(SIMULATED.rstrip("."))
    if not origin["whole"]:
        found.append(f"Cut off: {listed(origin['cut'])} has no end; what followed is missing")
    found += [f"{words} could not be read" for what, words in _SKIPPED.items() if what in run["skipped"]]
    if run["start_utc_s"] is None:
        found.append("The log does not know UTC: no receiver told it")
    kinds = [event["kind"] for event in run["events"]]
    counts = [f"{many(kinds.count(kind), 'event')} “{kind}”" for kind in FAULTS if kind in kinds]
    if counts:
        found.append(f"There were {listed(counts)}; see the events")
    return [f"{text}." for text in (*found, *_unusable(run))]


def _unusable(run: RunFacts) -> list[str]:
    """Recommended values that may not be used."""
    last = run["estimates"].get(RECOMMENDED)
    if last is None:
        return []
    states: dict[str, list[str]] = {}
    for name in PARAMETERS:
        found = last["parameters"][name]
        if found["status"] in ("stale", "invalid"):
            states.setdefault(found["status"], []).append(name)
    return [
        f"Not to be used at the end of the run ({state}): {listed(names)}" for state, names in states.items()
    ]


def made_section(data: ReportData) -> ReportSection:
    """The command, the logs and their sums, machine files, versions."""
    parts: list[Part] = [ReportText(f"Made by: {data['command']}")] if data.get("command") else []
    parts.append(
        ReportText(
            "An interval is of 95 % (1.96 sd); of a parameter it is log-normal about the median. The JSON "
            "file beside this report holds every number in SI units, with standard deviations."
        )
    )
    rows = []
    for run in data["runs"]:
        for log in run["origin"]["logs"]:
            rows.append((
                ReportCell(log["path"]),
                ReportCell(run["id"]),
                ReportCell(str(log["bytes"]), log["bytes"]),
                ReportCell(log["sha256"]),
            ))  # fmt: skip
    logs = ReportTable("made-logs", "Logs.", ("log", "run", "bytes", "SHA-256"), tuple(rows))
    machines = tuple(
        (
            ReportCell(run["id"]),
            ReportCell(run["machine"]["name"]),
            ReportCell(run["origin"]["machine_sha256"]),
            ReportCell(_results(run["origin"])),
        )
        for run in data["runs"]
    )
    columns = ("run", "machine", "SHA-256 of the machine file", "results")
    parts += [logs, ReportTable("made-machines", "Machine files, and who computed.", columns, machines)]
    parts.append(_versions(data["runs"]))
    return ReportSection("made", "How this was made", tuple(parts))


def _results(origin: OriginFacts) -> str:
    if origin["replayed"]:
        return "replayed for this report"
    return f"as recorded, by tilth {origin['recorded_with'].get('version', NOTHING)}"


def _versions(runs: Sequence[RunFacts]) -> ReportTable:
    """Of the software that recorded each run and of that which made the report."""
    now = runs[0]["origin"]["reported_with"]
    rows = [_version_row("this report", now)]
    rows += [
        _version_row(run["id"], run["origin"]["recorded_with"])
        for run in runs
        if run["origin"]["recorded_with"]
    ]
    return ReportTable(
        "made-versions", "Versions.", ("of", "tilth", "Python", "system", "packages"), tuple(rows)
    )


def _version_row(name: str, versions: Mapping[str, str]) -> tuple[ReportCell, ...]:
    own = ("version", "python", "system", "processor")
    packages = ", ".join(
        f"{package} {version}" for package, version in versions.items() if package not in own
    )
    told = (versions.get("version"), versions.get("python"), versions.get("system"), packages)
    return (ReportCell(name), *(ReportCell(one or NOTHING) for one in told))
