"""The sections of a report that tell of sensitivities over many rigs: Karkee (2009), figure 6.10."""

from collections.abc import Sequence

from tilth.analysis.report.document import (
    Part,
    ReportCell,
    ReportFigure,
    ReportSection,
    ReportTable,
    ReportText,
)
from tilth.analysis.report.wording import NOTHING, listed, number
from tilth.analysis.sensitivity.answers import (
    DesignAnswer,
    GlobalEntry,
    GlobalRow,
    IndexCounts,
    Interval,
    SensitivityData,
)


def global_section(data: SensitivityData, entry: GlobalEntry) -> ReportSection:
    """entry: one that has them."""
    key = f"{entry['model']}-global-{entry['speed']:g}".replace(".", "-")
    design = data.get("design")
    assert design is not None
    parts: list[Part] = [
        ReportText(
            f"The mean of the sensitivities of {listed(entry['global_outputs'])}, as at one point, over "
            f"{design['what']}: "
            f"{entry['simulations']} simulations of {entry['seconds']:.3g} s."
        ),
        ReportText(
            f"Of these rigs {100 * entry['unstable_share']:.2g} % are unstable; {entry['unstable_where']}."
        ),
        _table(entry, key),
        _spreads(entry, key),
    ]
    if entry["unstable_share"] > 0:
        parts.append(_unstable(design, entry, key))
    if entry["unstable_pairs"]:
        parts += _pairs(entry, key)
    if "indices" in entry:
        parts += _indices(entry, entry["indices"], key)
    title = f"Over many rigs, {entry['speed']:g} m/s, {entry['model']} model"
    return ReportSection(key, title, tuple(parts))


def _table(entry: GlobalEntry, key: str) -> ReportTable:
    stable = entry["global_stable"]
    rows = tuple(
        (
            ReportCell(name),
            *map(_cell, (row["mean"], row["median"], row["q05"], row["q95"])),
            *map(_cell, (stable[name]["mean"], stable[name]["median"])),
        )
        for name, row in _sorted(entry)
    )
    caption = (
        "% of the motion for each % of the parameter. A few rigs near instability can make a mean; the "
        "median does not mind them. The last two columns are of stable rigs alone."
    )
    columns = ("", "mean", "median", "5 % below", "95 % below", "mean, stable", "median, stable")
    return ReportTable(f"{key}-table", caption, columns, rows)


def _sorted(entry: GlobalEntry) -> list[tuple[str, GlobalRow]]:
    return sorted(entry["global"].items(), key=lambda pair: -(pair[1]["median"] or 0.0))


def _cell(value: float | None) -> ReportCell:
    return ReportCell(NOTHING) if value is None else ReportCell(number(value, 3), value)


def _spreads(entry: GlobalEntry, key: str) -> ReportFigure:
    rows = [
        {"name": name, "low": row["q05"], "high": row["q95"], "median": row["median"], "mean": row["mean"]}
        for name, row in _sorted(entry)
        if row["median"]
    ]
    return ReportFigure(
        f"{key}-spreads",
        "spreads",
        "Sensitivities over all rigs: the middle 90 %, median and mean.",
        f"{len(rows)} ranges; the table above has their numbers.",
        {"ranges": rows, "label": "% of the motion for 1 % of the parameter"},
    )


def with_interval(found: Interval | None) -> str:
    """An index and its 95 % interval."""
    if found is None:
        return NOTHING
    value, low, high = found["value"], found["low"], found["high"]
    if value is None or low is None or high is None:
        return NOTHING
    return f"{value:.2f} ± {(high - low) / 2:.2f}"


def _value(found: Interval | None) -> float | None:
    return None if found is None else found["value"]


def outputs_with_indices(entry: GlobalEntry) -> dict[str, dict[str, GlobalRow]]:
    """output -> parameter -> with its indices; the largest total index first."""
    if "indices" not in entry:
        return {}
    first = next(iter(entry["global"].values()))
    return {
        output: dict(
            sorted(
                ((name, row["by_output"][output]) for name, row in entry["global"].items()),
                key=lambda pair: -(_value(pair[1]["sobol_total"]) or 0.0),
            )
        )
        for output in first["by_output"]
    }


def _indices(entry: GlobalEntry, counts: IndexCounts, key: str) -> list[Part]:
    """A table of each output."""
    parts: list[Part] = []
    if counts["lost"] > 0:
        parts.append(
            ReportText(
                f"For the indices {100 * counts['lost']:.1f} % of the points were left out: they, or one "
                "that they are compared with, are of an unstable rig. The indices are of the stable rest."
            )
        )
    for output, rows in outputs_with_indices(entry).items():
        cells = tuple(
            (
                ReportCell(name),
                ReportCell(with_interval(row["sobol_first"]), _value(row["sobol_first"])),
                ReportCell(with_interval(row["sobol_total"]), _value(row["sobol_total"])),
                _cell(None if row["morris"] is None else row["morris"]["size"]),
                _cell(None if row["morris"] is None else row["morris"]["spread"]),
                _cell(row["dgsm_bound"]),
            )
            for name, row in rows.items()
        )
        caption = (
            f"What makes the variance of {output}: the share of each parameter alone (Sobol', first order), "
            "with all it does together with others (total), 95 % intervals; Morris's elementary effects over "
            "the whole range, and the bound of the total index by derivatives."
        )
        columns = ("", "first order", "total", "Morris, size", "Morris, spread", "bound by derivatives")
        parts.append(ReportTable(f"{key}-indices-{output}", caption, columns, cells))
    return parts


def _unstable(design: DesignAnswer, entry: GlobalEntry, key: str) -> ReportFigure:
    lows: Sequence[float | None] = design.get("low") or [None] * len(design["names"])
    highs: Sequence[float | None] = design.get("high") or [None] * len(design["names"])
    panels = [
        {
            "title": name,
            "shares": [100 * share for share in entry["unstable_by_level"][name]],
            "low": "low" if low is None else f"{low:g}",
            "high": "high" if high is None else f"{high:g}",
        }
        for name, low, high in zip(design["names"], lows, highs, strict=True)
    ]
    return ReportFigure(
        f"{key}-unstable",
        "unstable",
        "Share of rigs that are unstable in each part of a parameter's range, from its lower end to its "
        "upper, SI.",
        f"{len(panels)} panels of bars; {entry['unstable_where']}.",
        {"panels": panels},
    )


def _pairs(entry: GlobalEntry, key: str) -> list[Part]:
    """Where rigs are unstable in two parameters at once."""
    shown = entry["unstable_pairs"]
    figure = ReportFigure(
        f"{key}-pairs",
        "pairs",
        "Share of rigs that are unstable in each part of the ranges of two parameters, SI, over all values "
        "of the others. The line: where the machine file's own rig, with these two changed, becomes "
        "unstable.",
        f"{len(shown)} panels of shaded fields; {entry['unstable_where']}.",
        {"panels": shown},
    )
    domain = entry["unstable_domain"]
    return [*([ReportText(f"{domain['text']}.")] if domain else []), figure]
