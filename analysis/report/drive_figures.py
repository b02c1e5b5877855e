"""Figures of a run: the map, the drive over time, parameters over time, from the plain data of sections."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke

from tilth.analysis.report.figure_look import (
    GREEN,
    INK,
    KIND_COLOURS,
    METHOD_LINES,
    PAPER,
    PURPLE,
    QUIET,
    WIDTH,
    Floats,
    band,
    floats,
    panels,
    plain_ticks,
    time_scale,
)
from tilth.analysis.report.wording import METHODS, SYMBOLS
from tilth.schemas.fields import KMH
from tilth.schemas.flow import PARAMETERS
from tilth.schemas.spread import WITHIN, interval, scale_of, unit_of

LEAST_LATERAL_OFFSET: Final = 0.25  # of a map's longer side: how narrow a map may become
HIGHEST: Final = 4.8  # in, of a map
STRIP: Final = 0.65  # in below the track, for scale and north
MOST_LABELS: Final = 60  # of segments on a map: more hide what they label
MOST_OVER_TIME: Final = 30
ROW: Final = "row"  # kind of segments that do not steer
PANELS: Final = (
    ("wheel_angle", "wheel angle, °", 180.0 / math.pi),
    ("speed", "speed, km/h", 1.0 / KMH),
    ("articulation", "articulation, °", 180.0 / math.pi),
)


def path(data: Mapping[str, Any]) -> Figure:
    """Both CGs, north up."""
    x, y = floats(data["tractor"]["x"]), floats(data["tractor"]["y"])
    height, width, limits = _frame(x, y)
    figure = Figure(figsize=(width, height), layout="constrained")
    axes = figure.subplots()
    axes.plot(y, x, color=INK, linewidth=0.7)
    axes.plot(floats(data["implement"]["y"]), floats(data["implement"]["x"]), color=INK, linewidth=0.6,
              linestyle=(0, (3, 1.5)), alpha=0.75)  # fmt: skip
    labelled = _labelled(data["segments"], MOST_LABELS)
    for segment in data["segments"]:
        _path_segment(axes, segment, segment["number"] in labelled)
    for event in data["events"]:
        axes.plot(event["y"], event["x"], marker="^", color=PURPLE, markeredgecolor=PAPER, markersize=6)
        _label(axes, str(event["number"]), event["y"], event["x"], PURPLE, -9)
    for change in data["soil_changes"]:
        axes.plot(change["y"], change["x"], marker="D", color=GREEN, markeredgecolor=PAPER, markersize=6)
    axes.set_xlim(*limits[0])
    axes.set_ylim(*limits[1])
    axes.set_aspect("equal")
    axes.set_axis_off()
    _scale_bar(axes, limits)
    figure.legend(handles=_legend_of_map(data), loc="outside lower center", ncols=int(width / 1.2))
    return figure


def _labelled(segments: Sequence[Mapping[str, Any]], most: int) -> set[int]:
    """Numbers that are shown: all, else those of segments that steer, else as many of these as there is room
    for."""
    numbers = [segment["number"] for segment in segments]
    if len(numbers) > most:
        numbers = [segment["number"] for segment in segments if segment["kind"] != ROW]
    return set(numbers[:: -(-len(numbers) // most) or 1])


def _frame(x: Floats, y: Floats) -> tuple[float, float, tuple[tuple[float, float], tuple[float, float]]]:
    """Height and width in in, and limits east and north in m, of a map that is not too narrow."""
    if not np.any(np.isfinite(x)):
        return 2.0, WIDTH, ((0.0, 1.0), (0.0, 1.0))
    low, high = (np.array([fold(y), fold(x)]) for fold in (np.nanmin, np.nanmax))
    middle, half = (low + high) / 2, (high - low) / 2
    half = np.maximum(half, max(LEAST_LATERAL_OFFSET * float(half.max()), 1.0)) * 1.08
    height = min(WIDTH * half[1] / half[0], HIGHEST)
    width = WIDTH if height < HIGHEST else max(height * half[0] / half[1], WIDTH / 2)
    (west, south), (east, north) = middle - half, middle + half
    south -= STRIP * 2 * half[1] / height
    height += STRIP
    return float(height) + 0.4, float(width), ((float(west), float(east)), (float(south), float(north)))


def _path_segment(axes: Axes, segment: Mapping[str, Any], labelled: bool) -> None:
    x, y = floats(segment["x"]), floats(segment["y"])
    if not x.size:
        return
    colour = KIND_COLOURS[segment["kind"]]
    axes.plot(y, x, color=colour, linewidth=3.2, alpha=0.75, solid_capstyle="butt", zorder=1.5)
    if labelled:
        middle = len(x) // 2
        _label(axes, str(segment["number"]), float(y[middle]), float(x[middle]), INK, 6)


def _label(axes: Axes, text: str, x: float, y: float, colour: str, up: float) -> None:
    axes.annotate(
        text, (x, y), (0, up), textcoords="offset points", ha="center", va="center", color=colour,
        fontweight="bold", path_effects=[withStroke(linewidth=2.0, foreground=PAPER)],
    )  # fmt: skip


def _scale_bar(axes: Axes, limits: tuple[tuple[float, float], tuple[float, float]]) -> None:
    """Bottom left; the arrow of north bottom right."""
    (west, east), (south, north) = limits
    length = _round_length((east - west) / 5)
    left, bottom = west + 0.03 * (east - west), south + 0.01 * (north - south)
    axes.plot([left, left + length], [bottom, bottom], color=INK, linewidth=2.0, solid_capstyle="butt")
    axes.annotate(
        f"{length:g} m", (left + length / 2, bottom), (0, 6), textcoords="offset points", ha="center"
    )
    right = east - 0.04 * (east - west)
    axes.annotate("", (right, bottom), (0, 18), textcoords="offset points",
                  arrowprops={"arrowstyle": "<|-", "color": INK, "linewidth": 1.0})  # fmt: skip
    axes.annotate("N", (right, bottom), (-8, 9), textcoords="offset points", ha="center", va="center",
                  fontweight="bold")  # fmt: skip


def _round_length(metres: float) -> float:
    """1, 2 or 5 times a power of ten, not above."""
    power: float = 10.0 ** math.floor(math.log10(max(metres, 1e-3)))
    return max(power * step for step in (1.0, 2.0, 5.0) if power * step <= metres * (1 + 1e-9))


def _legend_of_map(data: Mapping[str, Any]) -> list[Line2D]:
    lines = [
        Line2D([], [], color=INK, linewidth=0.8, label="tractor"),
        Line2D([], [], color=INK, linewidth=0.8, linestyle=(0, (3, 1.5)), label="implement"),
    ]
    kinds = dict.fromkeys(segment["kind"] for segment in data["segments"])
    lines += [
        Line2D([], [], color=KIND_COLOURS[kind], linewidth=3.2, alpha=0.75, label=kind.replace("_", " "))
        for kind in kinds
    ]
    marker = {"linestyle": "none", "markeredgecolor": PAPER, "markersize": 6}
    if data["events"]:
        lines.append(Line2D([], [], marker="^", color=PURPLE, label="event", **marker))  # type: ignore[arg-type]
    if data["soil_changes"]:
        lines.append(Line2D([], [], marker="D", color=GREEN, label="change of soil", **marker))  # type: ignore[arg-type]
    return lines


def drive(data: Mapping[str, Any]) -> Figure:
    """Wheel angle, speed and articulation over time, segments shaded."""
    scale, label = time_scale(data["duration_s"])
    figure, axes = panels(3, 1, 4.6, sharex=True)
    labelled = _labelled(data["segments"], MOST_OVER_TIME)
    for row, (panel, (name, title, factor)) in enumerate(zip(axes[:, 0], PANELS, strict=True)):
        curve = data[name]
        t = floats(curve["t_s"]) / scale
        low, high, value = (factor * floats(curve[key]) for key in ("low", "high", "value"))
        for segment in data["segments"]:
            colour = KIND_COLOURS[segment["kind"]]
            panel.axvspan(
                segment["start_s"] / scale, segment["end_s"] / scale, color=colour, alpha=0.13, linewidth=0
            )
            if row == 0 and segment["number"] in labelled:
                middle = (segment["start_s"] + segment["end_s"]) / 2 / scale
                panel.text(middle, 1.02, str(segment["number"]), transform=panel.get_xaxis_transform(),
                           ha="center", va="bottom")  # fmt: skip
        band(panel, t, low, high, QUIET)
        panel.plot(t, value, color=INK, linewidth=0.8)
        panel.set_ylabel(title)
    axes[2, 0].set_xlabel(label)
    axes[2, 0].set_xlim(0.0, data["duration_s"] / scale)
    figure.align_ylabels()
    return figure


def parameters(data: Mapping[str, Any]) -> Figure:
    """As published over time: a panel for each of the six, logarithmic."""
    scale, label = time_scale(data["duration_s"])
    figure, axes = panels(3, 2, 6.0, sharex=True)
    for k, name in enumerate(PARAMETERS):
        panel = axes[k % 3, k // 3]
        factor = scale_of(name)
        prior = data["prior"][name]
        low, high = (factor * end for end in interval(prior["value"], prior["log_sd"]))
        for end in (low, high):
            panel.axhline(end, color=QUIET, linewidth=0.8, linestyle=(0, (1, 2)))
        panel.axhline(factor * prior["value"], color=QUIET, linewidth=0.8)
        ends: list[float] = []
        for method, curves in data["methods"].items():
            ends += _published(panel, curves[name], factor, scale, METHOD_LINES[method])
        for t_s in data["soil_changes_s"]:
            panel.axvline(t_s / scale, color=GREEN, linewidth=0.8, linestyle=(0, (2, 2)))
        _logarithmic(panel, [*ends, factor * prior["value"]] if ends else [low, high])
        panel.set_ylabel(f"${_tex(name)}$, {unit_of(name)}")
    for panel in axes[2]:
        panel.set_xlabel(label)
        panel.set_xlim(0.0, data["duration_s"] / scale)
    lines = [
        Line2D([], [], label=METHODS[method], **METHOD_LINES[method])
        for method, curves in data["methods"].items()
        if any(any(curves[name]["usable"]) for name in PARAMETERS)
    ]
    lines.append(Line2D([], [], color=QUIET, linewidth=0.8, label="machine file"))
    figure.legend(handles=lines, loc="outside upper center", ncols=len(lines))
    return figure


def _published(
    axes: Axes, curve: Mapping[str, Any], factor: float, scale: float, line: dict[str, Any]
) -> list[float]:
    """Draws one method's; returns what the axis must hold: its values, and its last band."""
    t, value, sd = floats(curve["t_s"]) / scale, factor * floats(curve["value"]), factor * floats(curve["sd"])
    usable = np.array(curve["usable"], dtype=bool)
    shown = np.where(usable, value, np.nan)
    with np.errstate(invalid="ignore"):
        spread = np.exp(WITHIN * sd / value)
    band(axes, t, shown / spread, shown * spread, line["color"])
    axes.plot(t, shown, **line)
    axes.plot(t, np.where(usable, np.nan, value), color=line["color"], linestyle=":", linewidth=0.6)
    known = np.flatnonzero(np.isfinite(shown))
    if not known.size:
        return []
    last = known[-1]
    ends = [value[last] / spread[last], value[last] * spread[last], np.nanmin(shown), np.nanmax(shown)]
    return [float(end) for end in ends]


def _logarithmic(axes: Axes, ends: list[float]) -> None:
    axes.set_yscale("log")
    axes.set_ylim(min(ends) / 1.1, max(ends) * 1.1)
    plain_ticks(axes.yaxis)


def _tex(name: str) -> str:
    """For matplotlib's own mathematical text."""
    letter, index = SYMBOLS[name].split("_")
    return rf"{letter}_{{\mathrm{{{index.replace('α', ' α ').strip()}}}}}".replace("σ", r"\sigma")
