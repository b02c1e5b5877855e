"""Figures of results: correlations, nuisances, intervals of fits, frequency response."""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

from tilth.analysis.report.figure_look import (
    BLUE,
    COLUMN,
    INK,
    MODEL_LINES,
    ORANGE,
    PAPER,
    QUIET,
    VERMILLION,
    WIDTH,
    band,
    floats,
    panels,
    plain_ticks,
)
from tilth.analysis.report.wording import SYMBOLS
from tilth.schemas.flow import PARAMETERS
from tilth.schemas.spread import WITHIN, interval, scale_of, unit_of

ROW: Final = 0.145  # in, of a list of intervals
FURTHEST: Final = 6.0  # sds, where an axis of distances ends
AGREES: Final = 2.0  # sds
_SIGNED: Final = LinearSegmentedColormap.from_list("signed", [BLUE, "#f7f7f7", ORANGE])


def correlation(data: Mapping[str, Any]) -> Figure:
    """A matrix with its numbers: blue and negative, orange and positive."""
    names, matrix = data["names"], np.array(data["matrix"], dtype=np.float64)
    figure, axes = panels(1, 1, COLUMN, COLUMN + 0.3)
    panel = axes[0, 0]
    panel.pcolormesh(matrix, cmap=_SIGNED, vmin=-1.0, vmax=1.0, edgecolor=PAPER, linewidth=0.5)
    for j, k in np.ndindex(*matrix.shape):
        panel.text(k + 0.5, j + 0.5, f"{matrix[j, k]:.2f}".replace("-", "−"), ha="center", va="center",
                   color="#000000")  # fmt: skip
    labels = [SYMBOLS[name] for name in names]
    panel.set_xticks(np.arange(len(names)) + 0.5, labels)
    panel.set_yticks(np.arange(len(names)) + 0.5, labels)
    panel.set_aspect("equal")
    panel.invert_yaxis()
    panel.grid(False)
    panel.tick_params(length=0, top=True, labeltop=True, bottom=False, labelbottom=False)
    for spine in panel.spines.values():
        spine.set_visible(False)
    return figure


def nuisances(data: Mapping[str, Any]) -> Figure:
    """Distance of each value from what was assumed, in sds of that, with 95 % intervals."""
    rows = data["rows"]
    figure, axes = panels(1, 1, max(1.6, 0.7 + ROW * len(rows)), WIDTH)
    panel = axes[0, 0]
    panel.axvspan(-AGREES, AGREES, color=QUIET, alpha=0.15, linewidth=0)
    panel.axvline(0.0, color=QUIET, linewidth=0.8)
    for k, row in enumerate(rows):
        centre = (row["value"] - row["prior"]) / row["prior_sd"]
        half = WITHIN * row["sd"] / row["prior_sd"]
        stated = row["stated"]
        colour = VERMILLION if abs(centre) > AGREES else BLUE
        panel.plot([centre - half, centre + half], [k, k], color=colour, linewidth=1.2)
        panel.plot(centre, k, marker="s" if stated else "o", color=colour, markersize=4,
                   markerfacecolor=colour if stated else PAPER)  # fmt: skip
    panel.set_yticks(range(len(rows)), [row["name"] for row in rows])
    panel.set_ylim(len(rows) - 0.4, -0.6)
    low, high = panel.get_xlim()
    panel.set_xlim(max(low, -FURTHEST), min(high, FURTHEST))
    panel.set_xlabel("found less assumed, in sd of what was assumed")
    panel.grid(axis="y", visible=False)
    return figure


def intervals(data: Mapping[str, Any]) -> Figure:
    """Estimates with 95 % intervals: a row for each fit, a panel for each parameter."""
    rows = data["rows"]
    figure, axes = panels(2, 3, max(3.0, 1.6 + 2 * ROW * len(rows)), sharey=True)
    for k, name in enumerate(PARAMETERS):
        panel, factor = axes[k // 3, k % 3], scale_of(name)
        if data["prior"]:
            panel.axvline(
                factor * data["prior"][name]["value"], color=QUIET, linewidth=0.8, linestyle=(0, (4, 2))
            )
        for at, row in enumerate(rows):
            found = row["parameters"][name]
            if found is None:
                continue
            low, high = interval(found["value"], found["sd"] / found["value"])
            colour = VERMILLION if row["joint"] else BLUE
            panel.plot([factor * low, factor * high], [at, at], color=colour, linewidth=1.4)
            panel.plot(
                factor * found["value"], at, marker="D" if row["joint"] else "o", color=colour, markersize=4
            )
        panel.set_xscale("log")
        plain_ticks(panel.xaxis)
        panel.set_xlabel(f"{SYMBOLS[name]}, {unit_of(name)}")
        panel.grid(axis="y", visible=False)
    for panel in axes[:, 0]:
        panel.set_yticks(range(len(rows)), [row["name"] for row in rows])
        panel.set_ylim(len(rows) - 0.4, -0.6)
    return figure


def response(data: Mapping[str, Any]) -> Figure:
    """Gain, phase and coherence of one output over frequency."""
    hz = floats(data["hz"])
    figure, axes = panels(3, 1, 5.6, sharex=True, height_ratios=(2.2, 2.2, 1))
    gain, phase, coherence = axes[:, 0]
    low, high = floats(data["gain_low_db"]), floats(data["gain_high_db"])
    centre, half = floats(data["phase_deg"]), floats(data["phase_half_deg"])
    value = floats(data["gain_db"])
    floor = float(np.nanmin(value)) - 20.0
    band(gain, hz, np.where(np.isfinite(low), low, floor), high, BLUE)
    gain.semilogx(hz, value, marker="o", markersize=2.5, linestyle="none", color=BLUE, label="measured, 95 %")
    band(phase, hz, centre - half, centre + half, BLUE)
    phase.semilogx(hz, centre, marker="o", markersize=2.5, linestyle="none", color=BLUE)
    for model, line in zip(data["models"], MODEL_LINES, strict=False):
        gain.semilogx(hz, floats(model["gain_db"]), label=model["name"], **line)
        phase.semilogx(hz, floats(model["phase_deg"]), **line)
    coherence.semilogx(hz, floats(data["coherence"]), color=INK)
    gain.set_ylabel("gain, dB")
    gain.set_ylim(floor, None)
    phase.set_ylabel("phase, °")
    coherence.set(ylabel="coherence", ylim=(0.0, 1.02), xlabel="frequency, Hz")
    plain_ticks(coherence.xaxis)
    figure.legend(*gain.get_legend_handles_labels(), loc="outside upper center", ncols=5)
    figure.align_ylabels()
    return figure
