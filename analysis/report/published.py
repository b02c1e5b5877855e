"""Parameters as they were published during the run, and against the machine file."""

from typing import Final

from tilth.analysis.report.data import NuisanceFacts, RunFacts
from tilth.analysis.report.document import (
    WARNING,
    Part,
    ReportCell,
    ReportFigure,
    ReportSection,
    ReportTable,
    ReportText,
)
from tilth.analysis.report.wording import (
    METHODS,
    NOTHING,
    fixed,
    heading_of,
    listed,
    meaning_of,
    parameter_cell,
    parameter_text,
    seconds,
)
from tilth.analysis.runs.nuisance_words import WORDS, nuisance_text
from tilth.schemas.flow import PARAMETERS, EventKind

RECOMMENDED: Final = "recommended"
FAR: Final = 2.0  # sds from what was assumed: named in words
_FINE: Final = "estimated"


def published_section(run: RunFacts, id: str) -> ReportSection:
    """What each method published last, and over time."""
    title = "Parameters as published"
    if not run["estimates"]:
        text = "The log holds no estimates: it was too short, or estimation had not begun when it ended."
        return ReportSection(f"{id}-published", title, (ReportText(text),))
    parts: list[Part] = []
    curves = run["curves"]["parameters"]
    if curves:
        parts.append(_over_time(run, id))
    parts.append(_by_method(run, id))
    sections = [_determined(run, id)]
    correlated = _correlations(run, id)
    if correlated:
        sections.append(correlated)
    return ReportSection(f"{id}-published", title, tuple(parts), tuple(sections))


def values_table(run: RunFacts, id: str) -> ReportTable:
    """The last recommended values beside the machine file's."""
    last = run["estimates"][RECOMMENDED]
    rows = []
    for name in PARAMETERS:
        found, prior = last["parameters"][name], run["machine"]["prior"][name]
        rows.append((
            ReportCell(f"{name}, {meaning_of(name)}"),
            ReportCell(parameter_text(name, found["value"], found["sd"], True), found["value"], found["sd"]),
            ReportCell(parameter_text(name, prior["value"], prior["sd"], True), prior["value"], prior["sd"]),
            ReportCell(found["status"]),
            ReportCell(found["reason"] or NOTHING),
        ))  # fmt: skip
    caption = (
        f"Recommended values at the end of the run, at {last['t_s']:.1f} s, with their 95 % intervals. "
        + (f"Rule: {last['rule']}." if last["rule"] else "")
    ).strip()
    columns = ("parameter", "estimate, 95 %", "machine file, 95 %", "status", "reason")
    return ReportTable(f"{id}-values", caption, columns, tuple(rows))


def _over_time(run: RunFacts, id: str) -> ReportFigure:
    curves = run["curves"]["parameters"]
    changes = [event["t_s"] for event in run["events"] if event["kind"] == EventKind.SOIL_CHANGE]
    names = listed([METHODS[method] for method in curves])
    return ReportFigure(
        f"{id}-parameters", "parameters",
        "Parameters over the time of the run as the methods published them, with 95 % bands. Grey: the "
        "machine file's value and, dotted, its 95 % interval. Dotted in colour: no longer to be used. "
        "Vertical lines: changes of soil.",
        f"Six panels, one for each parameter, with curves of {names}. The table below has the last values.",
        {"methods": curves, "prior": run["machine"]["prior"], "soil_changes_s": changes,
         "duration_s": run["duration_s"]},
    )  # fmt: skip


def _by_method(run: RunFacts, id: str) -> ReportTable:
    rows = tuple(
        (
            ReportCell(METHODS[method]),
            *(parameter_cell(name, last["parameters"][name]) for name in PARAMETERS),
        )
        for method, last in run["estimates"].items()
    )
    caption = (
        "The last values of each method, with 95 % intervals. Where there is no number its status stands."
    )
    return ReportTable(f"{id}-methods", caption, ("method", *map(heading_of, PARAMETERS)), rows)


def _determined(run: RunFacts, id: str) -> ReportSection:
    last = run["estimates"][RECOMMENDED]
    parts: list[Part] = []
    reasons: dict[str, list[str]] = {}
    for name, found in last["parameters"].items():
        if found["status"] != _FINE:
            reasons.setdefault(f"{found['status']}: {found['reason'] or 'no reason given'}", []).append(name)
    parts += [ReportText(f"{listed(names)}: {reason}.", WARNING) for reason, names in reasons.items()]
    if not reasons:
        parts.append(ReportText("All six have an estimate that may be used."))
    if last["determined"]:
        parts.append(
            ReportText(f"By the data alone, without the machine file's priors: {last['determined']}.")
        )
    if last["advice"]:
        parts.append(ReportText(f"What would help: {last['advice']}."))
    if last["window_s"]:
        parts.append(ReportText(f"The estimate rests on {seconds(last['window_s'])} of driving."))
    return ReportSection(
        f"{id}-determined", "What is not determined, and what would determine it", tuple(parts)
    )


def _correlations(run: RunFacts, id: str) -> ReportSection | None:
    last = run["estimates"][RECOMMENDED]
    covariance = last["log_covariance"]
    known = [name for name in PARAMETERS if last["parameters"][name]["value"] is not None]
    if covariance is None or len(known) < 2:
        return None
    figure = correlation_figure(covariance, known, id, "recommended at the end of the run")
    return ReportSection(f"{id}-correlations", "Correlations", (figure,))


def correlation_figure(covariance: list[list[float]], known: list[str], id: str, of: str) -> ReportFigure:
    """covariance: 6 x 6, of logarithms. known: those of PARAMETERS that have a number."""
    at = [PARAMETERS.index(name) for name in known]
    sd = {k: covariance[k][k] ** 0.5 for k in at}
    matrix = [[covariance[j][k] / (sd[j] * sd[k]) for k in at] for j in at]
    pairs = [(abs(matrix[j][k]), known[j], known[k]) for j in range(len(at)) for k in range(j)]
    largest = max(pairs)
    return ReportFigure(
        f"{id}-correlation", "correlation",
        f"Correlations between the logarithms of the parameters, {of}.",
        f"Matrix of {len(at)} by {len(at)} correlations; the largest in size is {largest[0]:.2f}, between "
        f"{largest[1]} and {largest[2]}.",
        {"names": known, "matrix": matrix},
    )  # fmt: skip


def nuisances_section(run: RunFacts, id: str) -> ReportSection | None:
    """What was found beside the six; None where nothing was."""
    rows = [one for one in run["nuisances"] if one["name"] in WORDS]
    if not rows:
        return None
    far = [one for one in rows if one["prior_sd"] > 0 and _distance(one) > FAR]
    stated = [one for one in far if WORDS[one["name"]].key]
    parts: list[Part] = [ReportText(_far_text(one), WARNING) for one in stated]
    if not stated:
        parts.append(ReportText("Nothing differs from the machine file by more than 2 of its sd."))
    usual = [
        f"{WORDS[one['name']].words} ({_distance(one):.1f} sd)" for one in far if not WORDS[one["name"]].key
    ]
    if usual:
        parts.append(ReportText(f"Far from what is usual, which no machine file states: {listed(usual)}."))
    parts += [_nuisance_figure(rows, id), _nuisance_table(rows, id)]
    return ReportSection(
        f"{id}-nuisances", "Found beside the parameters, against the machine file", tuple(parts)
    )


def _distance(one: NuisanceFacts) -> float:
    """From what was assumed, in its sds."""
    return float(abs(one["value"] - one["prior"]) / one["prior_sd"]) if one["prior_sd"] > 0 else 0.0


def _far_text(one: NuisanceFacts) -> str:
    words = WORDS[one["name"]]
    found = nuisance_text(one["name"], one["value"], one["sd"])
    stated = nuisance_text(one["name"], one["prior"], one["prior_sd"])
    return (
        f"{words.words[0].upper()}{words.words[1:]} ({one['name']}): {found}, where the machine file allows "
        f"{stated} (95 %); that is {_distance(one):.1f} of its sd. Look at {words.key}."
    )


def _nuisance_figure(rows: list[NuisanceFacts], id: str) -> ReportFigure:
    shown = [one for one in rows if one["prior_sd"] > 0]
    furthest = max(shown, key=_distance, default=None)
    told = f" The furthest is {furthest['name']} with {_distance(furthest):.1f} sd." if furthest else ""
    return ReportFigure(
        f"{id}-nuisance", "nuisances",
        "Values found, with 95 % intervals, less what was assumed before, in sds of that. Within the grey "
        "band they agree with it (2 sd); squares: stated by the machine file, circles: usual values.",
        f"{len(shown)} values with intervals.{told} The table has all of them.",
        {"rows": [{**one, "stated": bool(WORDS[one["name"]].key)} for one in shown]},
    )  # fmt: skip


def _nuisance_table(rows: list[NuisanceFacts], id: str) -> ReportTable:
    cells = tuple(
        (
            ReportCell(one["name"]),
            ReportCell(WORDS[one["name"]].words),
            ReportCell(
                nuisance_text(one["name"], one["prior"], one["prior_sd"]), one["prior"], one["prior_sd"]
            ),
            ReportCell(nuisance_text(one["name"], one["value"], one["sd"]), one["value"], one["sd"]),
            ReportCell(fixed(_distance(one), 1)),
            ReportCell(WORDS[one["name"]].key or "a usual value"),
        )
        for one in rows
    )
    caption = (
        "Beside the six: what was assumed before the drive, what was found by the recommended estimate, both "
        "with 95 % intervals, the distance in sd of what was assumed, and who states it."
    )
    columns = ("name", "meaning", "assumed, 95 %", "found, 95 %", "distance, sd", "stated by")
    return ReportTable(f"{id}-nuisance-table", caption, columns, cells)
