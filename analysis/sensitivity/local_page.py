"""The report of local sensitivities: what the dissertation's figures 6.3 to 6.9 show, for any rig, and the
frequency domain."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Final, TypedDict, cast

from tilth.analysis.report.document import (
    WARNING,
    DriveReport,
    Part,
    ReportCell,
    ReportFigure,
    ReportSection,
    ReportTable,
    ReportText,
)
from tilth.analysis.report.wording import NOTHING, fixed, listed
from tilth.analysis.sensitivity.answers import (
    ChangedCurves,
    FrequencyAnswer,
    FrequencyEntry,
    GlobalEntry,
    LocalEntry,
    Numbers,
    SensitivityData,
    UncertaintyData,
    Values,
)
from tilth.analysis.sensitivity.global_page import global_section
from tilth.analysis.sensitivity.local_answer import BY, OVERALL
from tilth.analysis.sensitivity.outputs import OUTPUTS, SIX
from tilth.estimator.models.manoeuvres import manoeuvre_named
from tilth.estimator.models.parameters import RIG_PARAMETERS

GROUPS: Final[Mapping[str, tuple[str, ...]]] = {
    "mass and inertia": ("m_t", "m_i", "I_t", "I_i"),
    "cornering stiffness": ("C_af", "C_ar", "C_ai"),
    "relaxation lengths": ("sigma_f", "sigma_r", "sigma_i"),
    "distances and heights": ("a", "b", "c", "d", "e", "h_t", "h_i"),
}
"""Of parameters: figures 6.3, 6.4, 6.5; the last are ours."""
LABEL: Final = "% of the output for 1 %"
MEANINGS: Final = {row.name: row.meaning for row in RIG_PARAMETERS}
_TRANSFERS: Final = {
    "r_t": "the tractor's yaw rate",
    "r_i": "the implement's yaw rate",
    "v": "the tractor's lateral velocity",
    "articulation": "the articulation",
}


class SlopeLine(TypedDict):
    name: str
    gain: Numbers
    phase: Numbers


class SlopePanel(TypedDict):
    title: str
    lines: list[SlopeLine]


def local_report(data: SensitivityData) -> DriveReport:
    """Its sections by model."""
    models = list(dict.fromkeys(entry["model"] for entry in data["speeds"]))
    sections = [_short(data)]
    sections += [
        global_section(data, cast("GlobalEntry", entry)) for entry in data["speeds"] if "global" in entry
    ]
    for model in models:
        entries = [entry for entry in data["speeds"] if entry["model"] == model]
        title = "Local sensitivities" + (f", {model} model" if len(models) > 1 else "")
        inner = [_tables(entries, model), _by_group(entries, model), _overall_section(data, entries, model)]
        inner += [_curves(data["curves"][model], model)] if data["curves"].get(model) else []
        sections.append(ReportSection(f"{model}-local", title, (), tuple(inner)))
        if data["frequency"].get(model):
            sections.append(_frequency(data["frequency"][model], model))
    sections.append(made_section(data))
    return DriveReport(f"Sensitivity: {data['machine']}", tuple(sections), data)


def _short(data: SensitivityData) -> ReportSection:
    parts: list[Part] = [ReportText(f"{one['reason']}.", WARNING) for one in data["refused"]]
    for entry in data["speeds"]:
        first = largest(entry["local"])[:4]
        told = listed([f"{name} ({fixed(entry['local'][name][OVERALL], 2)})" for name in first])
        parts.append(
            ReportText(
                f"At {entry['speed']:g} m/s, by the {entry['model']} model, what counts most is {told}: per "
                "cent of the motion for each per cent of the parameter, the mean over six outputs."
            )
        )
    parts.append(
        ReportText(
            f"The wheels: {manoeuvre_named(data['input']).meaning}, to 10°. Each parameter in turn is "
            "changed. Of curves the root mean square of the change over that of the curve is taken; of "
            "places the distance of the ends over the radius of the turn; else the change over the value "
            "(Karkee 2009, 6.10 to 6.17). Of "
            "another manoeuvre than a step headings are curves, and the radius is of the mean yaw rate."
        )
    )
    return ReportSection("short", "In short", tuple(parts))


def largest(local: Mapping[str, Values]) -> list[str]:
    """Parameters by their overall sensitivity, the largest first."""
    return sorted(local, key=lambda name: -(local[name][OVERALL] or 0.0))


def _tables(entries: Sequence[LocalEntry], model: str) -> ReportSection:
    idle = [name for name in entries[0]["local"] if not any(_acts(entry, name) for entry in entries)]
    parts: list[Part] = []
    if idle:
        parts.append(ReportText(f"Of no influence on any of these outputs by this model: {listed(idle)}."))
    for entry in entries:
        six = [name for name in entry["outputs"] if name in SIX]
        parts.append(_table(entry, model, "six", [*six, OVERALL], idle))
        others = [name for name in entry["outputs"] if name not in SIX]
        if others:
            parts.append(_table(entry, model, "others", others, idle))
    told = {output.name: output.meaning for output in OUTPUTS}
    for what, names, meanings in (
        ("output", entries[0]["outputs"], told),
        ("parameter", list(entries[0]["local"]), MEANINGS),
    ):
        rows = tuple((ReportCell(name), ReportCell(meanings[name])) for name in names)
        parts.append(
            ReportTable(f"{model}-{what}s", f"What the {what}s are.", (what, "meaning"), rows),
        )
    return ReportSection(f"{model}-tables", "By output and parameter", tuple(parts))


def _acts(entry: LocalEntry, name: str) -> bool:
    return any(entry["local"][name].values())


def _table(
    entry: LocalEntry, model: str, which: str, outputs: Sequence[str], idle: Sequence[str]
) -> ReportTable:
    rows = tuple(
        (ReportCell(name), *(_cell(entry["local"][name][output]) for output in outputs))
        for name in largest(entry["local"])
        if name not in idle
    )
    told = " The last column is the mean over the dissertation's six outputs." if OVERALL in outputs else ""
    caption = f"At {entry['speed']:g} m/s over {entry['seconds']:.3g} s: {LABEL} of the parameter.{told}"
    return ReportTable(f"{model}-{which}-{_key(entry)}", caption, ("", *outputs), rows)


def _key(entry: LocalEntry) -> str:
    return f"{entry['speed']:g}".replace(".", "-")


def _cell(value: float | None) -> ReportCell:
    return ReportCell(NOTHING) if value is None else ReportCell(f"{value:.3f}", value)


def _by_group(entries: Sequence[LocalEntry], model: str) -> ReportSection:
    parts: list[Part] = []
    for number, (group, names) in enumerate(GROUPS.items(), 3):
        there = [
            name for name in names if name in entries[0]["local"] and any(_acts(e, name) for e in entries)
        ]
        if not there:
            continue
        shown = [
            {
                "title": name,
                "series": [
                    {"name": f"{e['speed']:g} m/s", "values": [e["local"][name][o] for o in e["outputs"]]}
                    for e in entries
                ],
            }
            for name in there
        ]
        source = f" Figure 6.{number} of the dissertation." if number <= 5 else ""
        parts.append(
            ReportFigure(
                f"{model}-{group.split()[0]}",
                "dots",
                f"Sensitivity to {group}, by output and speed.{source}",
                f"A panel for each of {listed(there)}; the tables above have the numbers.",
                {"rows": entries[0]["outputs"], "panels": shown, "label": LABEL},
            )
        )
    return ReportSection(f"{model}-groups", "Which output hangs on what", tuple(parts))


def _overall_section(data: SensitivityData, entries: Sequence[LocalEntry], model: str) -> ReportSection:
    order = largest(entries[-1]["local"])
    parts: list[Part] = [
        _overall_figure(
            f"{model}-overall", "Overall sensitivity: the mean over six outputs. Figure 6.8 of the "
            "dissertation.", order, entries,
        )
    ]  # fmt: skip
    other = data["another"].get(model)
    if other:
        told = "relaxation lengths of a tenth, the implement's mass and inertia doubled"
        parts += [ReportText(f"With {told}: {one['reason']}.", WARNING) for one in other["refused"]]
        parts.append(
            _overall_figure(
                f"{model}-another",
                f"The same at another point: {told}. Figure 6.9 of the dissertation.",
                order,
                other["speeds"],
            )
        )
    return ReportSection(f"{model}-overalls", "What counts most", tuple(parts))


def _overall_figure(
    id: str, caption: str, order: Sequence[str], entries: Sequence[LocalEntry]
) -> ReportFigure:
    series = [
        {"name": f"{e['speed']:g} m/s", "values": [e["local"][name][OVERALL] for name in order]}
        for e in entries
    ]
    return ReportFigure(
        id, "dots", caption, f"Parameters, the most important first: {listed(list(order))}.",
        {"rows": list(order), "panels": [{"title": "", "series": series}], "label": LABEL},
    )  # fmt: skip


def _curves(curves: Mapping[str, Sequence[ChangedCurves]], model: str) -> ReportSection:
    parts = tuple(
        ReportFigure(
            f"{model}-changed-{name}", "changed",
            f"The tractor's yaw rate with that input, as it is and with {name} {100 * (BY - 1):.0f} % "
            f"larger. Figure {figure} of the dissertation.",
            f"Two curves for each of {len(shown)} speeds.",
            {"name": f"{name} + {100 * (BY - 1):.0f} %",
             "panels": [{**one, "title": f"{one['speed']:g} m/s"} for one in shown]},
        )
        for figure, (name, shown) in zip(("6.6", "6.7"), curves.items(), strict=True)
    )  # fmt: skip
    return ReportSection(f"{model}-curves", "What a change looks like", parts)


def _frequency(found: FrequencyAnswer, model: str) -> ReportSection:
    parts: list[Part] = [
        ReportText(
            "How gain and phase of each transfer function from the wheel angle change when a parameter grows "
            "by 1 %, in closed form: dG = dC R B + C R dA R B + C R dB + dD with R = (jω − A)⁻¹. The "
            "dissertation names this as future work (8.2)."
        )
    ]
    parts += _frequency_figures(found, model)
    return ReportSection(f"{model}-frequency", f"Over frequency, {model} model", tuple(parts))


def _frequency_figures(found: FrequencyAnswer, model: str) -> Iterator[ReportFigure]:
    for output, words in _TRANSFERS.items():
        for group, what, names in (
            ("tyres", "soil and tyres", GROUPS["cornering stiffness"] + GROUPS["relaxation lengths"]),
            (
                "body",
                "mass, inertia and distances",
                GROUPS["mass and inertia"] + GROUPS["distances and heights"],
            ),
        ):
            shown = [_panel(at, output, names) for at in found["speeds"]]
            if not shown[0]["lines"]:
                continue
            yield ReportFigure(
                f"{model}-{output}-{group}",
                "slopes",
                f"Sensitivity of {words} over frequency to {what}.",
                f"Gain and phase at {len(shown)} speeds; every number is in the JSON file.",
                {"omega": found["omega"], "panels": shown},
            )


def _panel(at: FrequencyEntry, output: str, names: Sequence[str]) -> SlopePanel:
    """Without parameters that do nothing at all."""
    curves = at["transfers"][output]
    lines: list[SlopeLine] = [
        {"name": name, "gain": curves["gain"][name], "phase": curves["phase"][name]}
        for name in names
        if name in curves["gain"] and (any(curves["gain"][name]) or any(curves["phase"][name]))
    ]
    return {"title": f"{at['speed']:g} m/s", "lines": lines}


def made_section(data: SensitivityData | UncertaintyData) -> ReportSection:
    """The command, the machine file's sum and versions: of all reports without a log."""
    made = data["made"]
    rows = [("machine file, SHA-256", made["machine_sha256"])]
    rows += [(name, text) for name, text in made["software"].items()]
    table = ReportTable(
        "made-versions", "Where the numbers come from.", ("", ""),
        tuple((ReportCell(name), ReportCell(text)) for name, text in rows),
    )  # fmt: skip
    return ReportSection("made", "How this was made", (ReportText(f"Made by: {data['command']}"), table))
