"""Figures of a season: its days, and its soils."""

from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure

from tilth.analysis.report.figure_look import (
    BLUE,
    GREEN,
    ORANGE,
    PURPLE,
    QUIET,
    SKY,
    VERMILLION,
    WIDTH,
    panels,
    plain_ticks,
)
from tilth.analysis.report.wording import SYMBOLS
from tilth.schemas.spread import scale_of, unit_of

COLOURS: Final = (BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY)
MOST_DAYS_NAMED: Final = 12  # on an axis


def calendar(data: Mapping[str, Any]) -> Figure:
    """Hours of each day, a colour for each machine with its implement."""
    days, rigs = data["days"], data["rigs"]
    figure, axes = panels(1, 1, 2.0, WIDTH)
    panel, below = axes[0, 0], np.zeros(len(days))
    for k, rig in enumerate(rigs):
        hours = np.array(rig["hours"], dtype=np.float64)
        panel.bar(
            np.arange(len(days)), hours, bottom=below, color=COLOURS[k % len(COLOURS)], label=rig["name"]
        )
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
        panel.set_ylabel(f"{SYMBOLS[name]}, {unit_of(name)}")
        for first in data["days"]:
            panel.axvline(first["at"] - 0.5, color=QUIET, linewidth=0.3)
    step = -(-len(data["days"]) // MOST_DAYS_NAMED) or 1
    shown = data["days"][::step]
    axes[-1, 0].set_xticks(
        [day["at"] for day in shown], [day["day"] for day in shown], rotation=30, ha="right"
    )
    return figure


SEASON_DRAWINGS: Final[Mapping[str, Callable[[Mapping[str, Any]], Figure]]] = {
    "calendar": calendar,
    "soils": soils,
}
"""By the kind of a figure."""
