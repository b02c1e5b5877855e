"""Figures of a season: its days, its soils, and maps of its fields."""

from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure
from matplotlib.transforms import ScaledTranslation

from tilth.analysis.report.figure_look import (
    BLUE,
    GREEN,
    INK,
    ORANGE,
    PURPLE,
    QUIET,
    SKY,
    VERMILLION,
    WIDTH,
    panels,
    plain_ticks,
)
from tilth.analysis.report.wording import AXLES, SYMBOLS
from tilth.schemas.spread import scale_of, unit_of

COLOURS: Final = (BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY)
MOST_DAYS_NAMED: Final = 8  # on an axis
LEAST_LOG_RANGE, LEAST_SD_RANGE = 0.2, 0.05  # of the colours of a map


def calendar(data: Mapping[str, Any]) -> Figure:
    """Hours of each day, a colour for each machine with its implement; those with fewest share one."""
    days = data["days"]
    rigs = sorted(data["rigs"], key=lambda rig: -sum(rig["hours"]))
    named, others = rigs[: len(COLOURS)], rigs[len(COLOURS) :]
    figure, axes = panels(1, 1, 2.0, WIDTH)
    panel, below = axes[0, 0], np.zeros(len(days))
    bars = [(rig["hours"], colour, rig["name"]) for rig, colour in zip(named, COLOURS, strict=False)]
    if others:
        bars.append((np.sum([rig["hours"] for rig in others], axis=0), QUIET, f"{len(others)} others"))
    for of_days, colour, name in bars:
        hours = np.array(of_days, dtype=np.float64)
        panel.bar(np.arange(len(days)), hours, bottom=below, color=colour, label=name)
        below += hours
    _name_days(panel, days)
    panel.set_ylabel("hours")
    panel.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def _name_days(panel: Any, days: list[str]) -> None:
    step = -(-len(days) // MOST_DAYS_NAMED)
    panel.set_xticks(range(0, len(days), step), days[::step], rotation=30, ha="right")


def soils(data: Mapping[str, Any]) -> Figure:
    """The three stiffnesses of each stretch in the order of driving, with 95 % intervals."""
    names = list(data["parameters"])
    figure, axes = panels(len(names), 1, 1.4 * len(names) + 0.5, WIDTH, sharex=True)
    for panel, name in zip(axes[:, 0], names, strict=True):
        rows, scale = data["parameters"][name], scale_of(name)
        at = np.array([row["at"] for row in rows], dtype=np.float64)
        low, value, high = (
            np.array([row[key] for row in rows], dtype=np.float64) * scale for key in ("low", "value", "high")
        )
        panel.vlines(at, low, high, color=QUIET, linewidth=0.8)
        panel.plot(at, value, ".", color=BLUE, markersize=3)
        panel.set_yscale("log")
        plain_ticks(panel.yaxis)
        panel.set_ylabel(f"{AXLES[name[-1]]}\n{SYMBOLS[name]}, {unit_of(name)}")
        for first in data["days"]:
            panel.axvline(first["at"] - 0.5, color=QUIET, linewidth=0.3)
    step = -(-len(data["days"]) // MOST_DAYS_NAMED) or 1
    shown = data["days"][::step]
    axes[-1, 0].set_xticks(
        [day["at"] for day in shown], [day["day"] for day in shown], rotation=30, ha="right"
    )
    return figure


def field_map(data: Mapping[str, Any]) -> Figure:
    """Value and uncertainty of each stiffness side by side, north up, with ways and the field's outline."""
    names = list(data["parameters"])
    west, east, south, north = data["extent"]
    shape = (north - south) / (east - west)
    tall = min(max(shape, 0.35), 1.2) * WIDTH / 2.0  # so a scale has room for its label
    figure, axes = panels(len(names), 2, len(names) * (tall + 0.4), sharex=True, sharey=True)
    for k, ((value, sd), name) in enumerate(zip(axes, names, strict=True)):
        logs, sds = (np.array(data["parameters"][name][key], dtype=np.float64) for key in ("mean", "sd"))
        shown = {"origin": "lower", "extent": (west, east, south, north), "interpolation": "none"}
        shades = np.exp(_at_least(logs, LEAST_LOG_RANGE)) * scale_of(name)
        drawn = value.imshow(np.exp(logs) * scale_of(name), cmap="viridis", clim=shades, **shown)
        figure.colorbar(drawn, ax=value, shrink=0.9, label=f"{SYMBOLS[name]}, {unit_of(name)}")
        drawn = sd.imshow(100.0 * sds, cmap="cividis_r", clim=100.0 * _at_least(sds, LEAST_SD_RANGE), **shown)
        figure.colorbar(drawn, ax=sd, shrink=0.9, label="sd of its logarithm, %")
        for panel in (value, sd):
            for way in data["ways"]:
                panel.plot(*np.array(way).T, color=INK, linewidth=0.4)
            panel.plot(*np.array(data["outline"]).T, color=INK, linewidth=0.8)
            panel.set(xticks=[], yticks=[], xlim=(west, east), ylim=(south, north))
            panel.spines[:].set_visible(False)
        value.set(gid=f"panel-{2 * k}")
        sd.set(gid=f"panel-{2 * k + 1}")
        value.set_title(AXLES[name[-1]], loc="left")
        sd.set_title("how uncertain", loc="left")
    _scale_and_north(axes[0, 0], east - west)
    return figure


def _at_least(shown: Any, span: float) -> Any:
    """Least and largest, at least so far apart: what hardly differs is not shown as if it did."""
    low, high = np.nanmin(shown), np.nanmax(shown)
    more = max(0.0, span - (high - low)) / 2.0
    return np.maximum([low - more, high + more], 0.0 if low >= 0.0 else low - more)


def _scale_and_north(panel: Any, width_m: float) -> None:
    """A bar of a round length below the panel, and an arrow above it, whatever its shape."""
    power = 10.0 ** np.floor(np.log10(width_m / 4.0))
    bar = max(step * power for step in (1.0, 2.0, 5.0) if step * power <= width_m / 4.0)
    plain = {"shrinkA": 0, "shrinkB": 0, "color": INK}

    def off(points: float) -> dict[str, Any]:
        moved = panel.transAxes + ScaledTranslation(0.0, points / 72.0, panel.figure.dpi_scale_trans)
        return {"xycoords": moved, "annotation_clip": False}

    ends = {"arrowstyle": "|-|,widthA=0.2,widthB=0.2", **plain}
    panel.annotate("", (bar / width_m, 0.0), (0.0, 0.0), arrowprops=ends, **off(-8.0))
    beside = {"xytext": (4.0, 0.0), "textcoords": "offset points", "va": "center"}
    panel.annotate(f"{bar:g} m", (bar / width_m, 0.0), gid="scale", **beside, **off(-8.0))
    arrow, tail = {"arrowstyle": "<-", **plain}, off(17.0)["xycoords"]
    panel.annotate(
        "N", (0.97, 1.0), (0.97, 1.0), ha="center", va="bottom", arrowprops=arrow, textcoords=tail, **off(4.0)
    )


SEASON_DRAWINGS: Final[Mapping[str, Callable[[Mapping[str, Any]], Figure]]] = {
    "calendar": calendar,
    "soils": soils,
    "field_map": field_map,
}
"""By the kind of a figure."""
