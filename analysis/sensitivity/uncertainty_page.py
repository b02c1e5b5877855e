"""The report of uncertainties: how well each output is known, by what, and what must be known better."""

from collections.abc import Mapping, Sequence
from typing import Final

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
from tilth.analysis.report.wording import NOTHING, listed, number
from tilth.analysis.sensitivity.answers import Assumed, OutputAnswer, UncertaintyData, UncertaintyEntry
from tilth.analysis.sensitivity.local_page import MEANINGS, made_section
from tilth.analysis.sensitivity.outputs import OUTPUTS
from tilth.schemas.spread import share

ANY: Final = 3.0  # sd of a logarithm: who knows a parameter to a factor of 400 knows nothing of it
SHOWN: Final = 0.05  # of the variance: smaller shares are not listed
TOLD: Final = {output.name: output.meaning for output in OUTPUTS}
_UNIT: Final = {"m": "m", "": "%"}
_FACTOR: Final = {"m": 1.0, "": 100.0}


MUCH: Final = 1.5  # first order and all of the model differ by this factor: said in words
WHICH: Final = (
    "Use “known to”: it carries each rig drawn through the whole model. The first order takes the "
    "outputs for "
    "straight lines in the parameters; it holds while both are alike, and gives the shares."
)


def apart(outputs: Mapping[str, OutputAnswer]) -> str:
    """Where the first order is far from what the whole model gives, in words; "" where nowhere."""
    far = [
        name
        for name, one in outputs.items()
        if one["half"] and one["first_order"] and not 1 / MUCH <= one["first_order"] / one["half"] <= MUCH
    ]
    if not far:
        return ""
    return (
        f"For {listed(far)} the first order is far off, since the model bends over what is not known "
        "(or near "
        "instability): take “known to” alone, and the shares for a hint."
    )


def known_to(half: float | None, unit: str) -> str:
    """Half of a 95 % interval, in words."""
    if half is None:
        return NOTHING
    return f"± {number(half * _FACTOR[unit], 2)} {_UNIT[unit]}"


def causes(output: OutputAnswer) -> str:
    """Parameters by their share of the variance, the largest first."""
    shares = {name: one["share"] or 0.0 for name, one in output["parameters"].items()}
    largest = sorted(shares, key=lambda name: -abs(shares[name]))
    return ", ".join(f"{name} {100 * shares[name]:.0f} %" for name in largest if abs(shares[name]) >= SHOWN)


def in_words(name: str, output: OutputAnswer, parameters: Mapping[str, Assumed]) -> str:
    """What must be known for what is wanted of an output."""
    found, unit = output.get("wanted"), output["unit"]
    assert found is not None
    wanted = f"For {name} to be known to {known_to(found['half'], unit)}"
    if found["factor"] is None:
        return f"{wanted} nothing is needed: no parameter that is not known moves it."
    if found["factor"] >= 1.0:
        return f"{wanted} all sds may be {number(found['factor'], 2)} times as large (first order)."
    enough = [
        f"{one} to {share(sd)}"
        for one, sd in found["alone"].items()
        if sd is not None and sd < parameters[one]["log_sd"]
    ]
    said = f"{wanted} all sds must be {number(found['factor'], 2)} times as large (first order)"
    if enough:
        return f"{said}; or, with the others as they are, {listed(enough)}."
    return f"{said}; one parameter alone does not bring it there."


def uncertainty_report(data: UncertaintyData) -> DriveReport:
    """A section for each speed."""
    sections = [_short(data)]
    sections += [_at_speed(data, entry) for entry in data["speeds"]]
    sections += [_assumed(data), made_section(data)]
    return DriveReport(f"Uncertainty: {data['machine']}", tuple(sections), data)


def _key(entry: UncertaintyEntry) -> str:
    return f"{entry['model']}-{entry['speed']:g}".replace(".", "-")


def _title(entry: UncertaintyEntry) -> str:
    return f"{entry['speed']:g} m/s, {entry['model']} model"


def _short(data: UncertaintyData) -> ReportSection:
    parts: list[Part] = [ReportText(f"{one['reason']}.", WARNING) for one in data["refused"]]
    for entry in data["speeds"]:
        if entry["unstable_share"] > 0:
            parts.append(
                ReportText(
                    f"At {_title(entry)}: {100 * entry['unstable_share']:.1f} % of the rigs that were drawn "
                    "are unstable. They have no outputs and are left out.",
                    WARNING,
                )
            )
    for entry in data["speeds"]:
        output = entry["outputs"].get("implement_position") or next(iter(entry["outputs"].values()))
        name = next(name for name, one in entry["outputs"].items() if one is output)
        what = causes(output)
        parts.append(
            ReportText(
                f"At {_title(entry)}, with what {data['source']} knows, the {TOLD[name]} is known to "
                f"{known_to(output['half'], output['unit'])} (95 %)"
                + (f": {what} of the variance." if what else ".")
            )
        )
    parts += [
        ReportText(in_words(name, output, data["parameters"]))
        for entry in data["speeds"]
        for name, output in entry["outputs"].items()
        if "wanted" in output
    ]
    return ReportSection("short", "In short", tuple(parts))


def _at_speed(data: UncertaintyData, entry: UncertaintyEntry) -> ReportSection:
    key, outputs = _key(entry), entry["outputs"]
    parts: list[Part] = [_outputs_table(entry, key)]
    if told := apart(outputs):
        parts.append(ReportText(told))
    parts.append(_alone_table(entry, key))
    parts += [_distributions(entry, key), _growth(entry, key)]
    parts += [
        _wanted_table(name, one, data["parameters"], key) for name, one in outputs.items() if "wanted" in one
    ]
    return ReportSection(key, f"At {_title(entry)}", tuple(parts))


def _outputs_table(entry: UncertaintyEntry, key: str) -> ReportTable:
    rows = tuple(
        (
            ReportCell(name),
            ReportCell(TOLD[name]),
            ReportCell(_range(one["low"], one["high"], one["unit"]), one["half"]),
            ReportCell(known_to(one["first_order"], one["unit"]), one["first_order"]),
            ReportCell(causes(one) or NOTHING),
        )
        for name, one in entry["outputs"].items()
    )
    caption = (
        f"How far each output may be from that of the rig at its medians, 95 % of {entry['draws']} rigs "
        f"simulated for {entry['seconds']:.3g} s: use this. Beside it the first order, which takes "
        "outputs for "
        "straight lines in the parameters, and what share of its variance each parameter has. Shares "
        "of correlated parameters may be negative. Outputs without a unit of "
        "their own are in per cent of the output."
    )
    columns = ("output", "meaning", "all together", "first order", "of the variance")
    return ReportTable(f"{key}-outputs", caption, columns, rows)


def _range(low: float | None, high: float | None, unit: str) -> str:
    if low is None or high is None:
        return NOTHING
    factor = _FACTOR[unit]
    return f"{number(low * factor, 2)} … {number(high * factor, 2)} {_UNIT[unit]}"


def _alone_table(entry: UncertaintyEntry, key: str) -> ReportTable:
    outputs = entry["outputs"]
    first = next(iter(outputs.values()))
    rows = tuple(
        (
            ReportCell(name),
            *(
                ReportCell(
                    _range(one["parameters"][name]["low"], one["parameters"][name]["high"], one["unit"])
                )
                for one in outputs.values()
            ),
        )
        for name in first["parameters"]
    )
    caption = "The same where one parameter alone is not known, the others at their medians."
    return ReportTable(f"{key}-alone", caption, ("not known", *outputs), rows)


def _distributions(entry: UncertaintyEntry, key: str) -> ReportFigure:
    panels = []
    for name, one in entry["outputs"].items():
        factor = _FACTOR[one["unit"]]
        edges = [factor * edge for edge in one["histogram"]["edges"]]
        if len(edges) < 2:
            continue
        sd = None if one["first_order"] is None else factor * one["first_order"] / 1.96
        panels.append({
            "title": name, "label": f"change, {_UNIT[one['unit']]}", "edges": edges,
            "counts": one["histogram"]["counts"], "first_order_sd": sd,
        })  # fmt: skip
    return ReportFigure(
        f"{key}-distributions",
        "distributions",
        "Distribution of each output through the model, and the normal one of the first order (Karkee 2009, "
        "figure 6.11), the middle 99 %. Of curves: the root mean square of the change, above zero where it "
        "adds to the curve.",
        f"{len(panels)} histograms; the table above has their intervals.",
        {"panels": panels},
    )


def _growth(entry: UncertaintyEntry, key: str) -> ReportFigure:
    panels: list[dict[str, object]] = []
    factors: Sequence[float] = ()
    for name, one in entry["outputs"].items():
        factor, factors = _FACTOR[one["unit"]], one["growth"]["factors"]
        model, first = (
            [None if value is None else factor * value for value in one["growth"][which]]
            for which in ("half", "first_order")
        )
        panels.append(
            {"title": name, "label": f"±, {_UNIT[one['unit']]}", "model": model, "first_order": first}
        )
    return ReportFigure(
        f"{key}-growth",
        "growth",
        "Half of the 95 % interval of each output, where all parameters are known better or worse than now "
        "by one factor (Karkee 2009, figure 6.12).",
        f"{len(panels)} curves over {len(factors)} factors of all standard deviations.",
        {"panels": panels, "factors": list(factors), "label": "sds, times as large"},
    )


def _wanted_table(
    name: str, output: OutputAnswer, parameters: Mapping[str, Assumed], key: str
) -> ReportTable:
    found = output.get("wanted")
    assert found is not None
    rows = tuple(
        (
            ReportCell(one),
            ReportCell(share(row["log_sd"]), row["log_sd"]),
            _sd_cell(None if found["factor"] is None else found["factor"] * row["log_sd"]),
            _sd_cell(found["alone"][one]),
            _sd_cell(found["only"][one]),
        )
        for one, row in parameters.items()
    )
    caption = (
        f"For {name} known to {known_to(found['half'], output['unit'])} (95 %): how well each parameter must "
        "be known, 95 %, in the first order. A dash: no value does it."
    )
    columns = (
        "",
        "known to",
        "all by one factor",
        "this one, the others as they are",
        "if nothing else were unknown",
    )
    return ReportTable(f"{key}-wanted-{name}", caption, columns, rows)


def _sd_cell(sd: float | None) -> ReportCell:
    if sd is None:
        return ReportCell(NOTHING)
    return ReportCell(share(sd) if sd < ANY else "any value", sd)


def _assumed(data: UncertaintyData) -> ReportSection:
    rows = tuple(
        (
            ReportCell(name),
            ReportCell(MEANINGS[name]),
            ReportCell(number(one["median"], 4), one["median"]),
            ReportCell(share(one["log_sd"]), one["log_sd"]),
        )
        for name, one in data["parameters"].items()
    )
    caption = f"What is not known exactly, by {data['source']}: medians in SI units, and 95 %."
    table = ReportTable("assumed-parameters", caption, ("", "meaning", "median", "known to"), rows)
    return ReportSection("assumed", "What was assumed", (table,))
