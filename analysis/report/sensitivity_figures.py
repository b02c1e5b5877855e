"""Figures of what outputs hang on: sensitivities, also over frequency, changed curves, distributions."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator

from tilth.analysis.report.figure_look import (
    BLUE,
    GREEN,
    INK,
    ORANGE,
    PURPLE,
    QUIET,
    SKY,
    VERMILLION,
    floats,
    panels,
    plain_ticks,
)

ROW: Final = 0.165  # in, of a list
ACROSS: Final = 3  # panels
COLOURS: Final = (BLUE, ORANGE, VERMILLION, GREEN, PURPLE, SKY)
MARKERS: Final = ("o", "s", "^", "D", "v", "P")
_SHARE: Final = LinearSegmentedColormap.from_list("share", ["#f7f7f7", ORANGE, VERMILLION])
DASHES: Final[Sequence[Any]] = ("-", (0, (5, 1.5)), (0, (1, 1)))


def _grid(count: int) -> tuple[int, int]:
    """(across, down) of so many panels."""
    across = 2 if count == 4 else min(ACROSS, count)
    return across, math.ceil(count / across)


def _lowest(column: int, count: int) -> int:
    """The row of the last panel of a column."""
    across, down = _grid(count)
    return max(row for row in range(down) if row * across + column < count)


def dots(data: Mapping[str, Any]) -> Figure:
    """A panel for each of data["panels"]: {"title", "series": [{"name", "values"}]}, a value for each row."""
    rows, shown = data["rows"], data["panels"]
    across, down = _grid(len(shown))
    figure, axes = panels(down, across, 0.5 + down * max(1.0, 0.55 + ROW * len(rows)), sharey=True)
    for panel, one in zip(axes.flat, shown, strict=False):
        for k, series in enumerate(one["series"]):
            panel.plot(
                floats(series["values"]), range(len(rows)), linestyle="none", marker=MARKERS[k % 6],
                color=COLOURS[k % 6], markersize=4, fillstyle="none" if k % 2 else "full",
                label=series["name"],
            )  # fmt: skip
        panel.set_title(one["title"])
        panel.set_xlim(0.0, None)
    for panel in axes.flat[len(shown) :]:
        panel.set_visible(False)
    for panel in axes[:, 0]:
        panel.set_yticks(range(len(rows)), rows)
        panel.set_ylim(len(rows) - 0.5, -0.5)
    for k in range(across):
        axes[_lowest(k, len(shown)), k].set_xlabel(data["label"])
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=6)
    return figure


def changed(data: Mapping[str, Any]) -> Figure:
    """Curves before and after a change; a panel for each of data["panels"]."""
    shown = data["panels"]
    across, down = _grid(len(shown))
    figure, axes = panels(down, across, 2.3 * down)
    for panel, one in zip(axes.flat, shown, strict=False):
        t = floats(one["t_s"])
        panel.plot(t, np.degrees(floats(one["reference"])), color=BLUE, label="as it is")
        panel.plot(
            t, np.degrees(floats(one["changed"])), color=VERMILLION, linestyle=DASHES[1], label=data["name"]
        )
        panel.set(title=one["title"], xlabel="time, s", ylim=(0.0, None))
    for panel in axes.flat[len(shown) :]:
        panel.set_visible(False)
    for panel in axes[:, 0]:
        panel.set_ylabel("tractor's yaw rate, °/s")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


def slopes(data: Mapping[str, Any]) -> Figure:
    """Over frequency: gain above, phase below; a column for each speed."""
    omega, shown = floats(data["omega"]), data["panels"]
    figure, axes = panels(2, len(shown), 4.2, sharex=True, sharey="row")
    for column, one in zip(axes.T, shown, strict=True):
        for k, line in enumerate(one["lines"]):
            look = {"color": COLOURS[k % 6], "linestyle": DASHES[k // 6], "label": line["name"]}
            column[0].semilogx(omega, floats(line["gain"]), **look)
            column[1].semilogx(omega, np.degrees(floats(line["phase"])) / 100.0, **look)
        for panel in column:
            panel.axhline(0.0, color=QUIET, linewidth=0.8)
        column[0].set_title(one["title"])
        column[1].set_xlabel("frequency, rad/s")
        plain_ticks(column[1].xaxis)
    axes[0, 0].set_ylabel("gain, % for 1 %")
    axes[1, 0].set_ylabel("phase, ° for 1 %")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=6)
    figure.align_ylabels()
    return figure


def distributions(data: Mapping[str, Any]) -> Figure:
    """Histograms, with the normal distribution of the first order beside them."""
    shown = data["panels"]
    across, down = _grid(len(shown))
    figure, axes = panels(down, across, 1.9 * down)
    for panel, one in zip(axes.flat, shown, strict=False):
        _histogram(panel, one)
    for panel in axes.flat[len(shown) :]:
        panel.set_visible(False)
    for panel in axes[:, 0]:
        panel.set_ylabel("density")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


def _histogram(panel: Axes, one: Mapping[str, Any]) -> None:
    edges, counts = floats(one["edges"]), floats(one["counts"])
    widths = np.diff(edges)
    panel.bar(
        edges[:-1], counts / (counts.sum() * widths), widths, align="edge", color=SKY, linewidth=0,
        label="through the model",
    )  # fmt: skip
    sd = one["first_order_sd"]
    if sd:
        x = np.linspace(edges[0], edges[-1], 120)
        normal = np.exp(-0.5 * (x / sd) ** 2) / (sd * math.sqrt(2 * math.pi))
        panel.plot(x, normal, color=VERMILLION, label="first order")
    panel.axvline(0.0, color=INK, linewidth=0.6)
    panel.set(title=one["title"], xlabel=one["label"], yticks=[])


def growth(data: Mapping[str, Any]) -> Figure:
    """What an output is known to, over how well the parameters are known."""
    shown, factors = data["panels"], floats(data["factors"])
    across, down = _grid(len(shown))
    figure, axes = panels(down, across, 1.9 * down)
    for panel, one in zip(axes.flat, shown, strict=False):
        panel.plot(factors, floats(one["model"]), marker="o", markersize=3, color=BLUE,
                   label="through the model")  # fmt: skip
        panel.plot(
            factors, floats(one["first_order"]), color=VERMILLION, linestyle=DASHES[1], label="first order"
        )
        panel.set(title=one["title"], ylabel=one["label"], ylim=(0.0, None), xlim=(0.0, None))
    for panel in axes.flat[len(shown) :]:
        panel.set_visible(False)
    for k in range(across):
        axes[_lowest(k, len(shown)), k].set_xlabel(data["label"])
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


def spreads(data: Mapping[str, Any]) -> Figure:
    """Of each parameter the middle 90 % of its sensitivities, their median and their mean."""
    rows = data["ranges"]
    figure, axes = panels(1, 1, 0.8 + 2 * ROW * len(rows))
    panel = axes[0, 0]
    for k, row in enumerate(reversed(rows)):
        panel.plot([row["low"], row["high"]], [k, k], color=BLUE, linewidth=1.4)
        panel.plot(row["median"], k, "o", color=BLUE, markersize=4, label="median" if k == 0 else "")
        if row["mean"] is not None:
            panel.plot(row["mean"], k, "D", color=VERMILLION, markersize=4, label="mean" if k == 0 else "")
    panel.set(xscale="log", xlabel=data["label"], yticks=range(len(rows)))
    panel.set_yticklabels([row["name"] for row in reversed(rows)])
    figure.legend(*panel.get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


def unstable(data: Mapping[str, Any]) -> Figure:
    """Share of rigs that are unstable over the part of each parameter's range."""
    shown = data["panels"]
    across, down = _grid(len(shown))
    figure, axes = panels(down, across, 1.6 * down)
    top = max((max(floats(one["shares"])) for one in shown), default=0.0)
    for panel, one in zip(axes.flat, shown, strict=False):
        shares = floats(one["shares"])
        panel.bar(np.arange(1, len(shares) + 1), shares, color=VERMILLION)
        panel.set(title=one["title"], ylim=(0.0, 1.1 * top or 1.0), xticks=[1, len(shares)])
        panel.set_xticklabels([one["low"], one["high"]])
    for panel in axes.flat[len(shown) :]:
        panel.set_visible(False)
    for panel in axes[:, 0]:
        panel.set_ylabel("unstable, %")
    return figure


def pairs(data: Mapping[str, Any]) -> Figure:
    """Share of rigs that are unstable over the ranges of two parameters; the line of one rig."""
    shown = data["panels"]
    across, down = _grid(len(shown))
    figure, axes = panels(down, across, 0.5 + 2.0 * down)
    drawn = None
    top = max((share or 0.0 for one in shown for row in one["shares"] for share in row), default=0.0) * 100.0
    for panel, one in zip(axes.flat, shown, strict=False):
        x, y = (np.array(edges) for edges in one["low_to_high"])
        shares = 100.0 * np.array(one["shares"], dtype=np.float64).T
        drawn = panel.pcolormesh(x, y, shares, cmap=_SHARE, vmin=0.0, vmax=top)
        line = one["line"]
        growth = np.array(line["growth"]).T
        if growth.min() < 0.0 < growth.max():
            panel.contour(*line["at"], growth, levels=[0.0], colors=[INK], linewidths=1.0)
        panel.set(xlabel=one["names"][0], ylabel=one["names"][1], xlim=x[[0, -1]], ylim=y[[0, -1]])
        panel.grid(False)
        for axis in (panel.xaxis, panel.yaxis):
            axis.set_major_locator(MaxNLocator(2 if axis is panel.xaxis else 4))
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.6g}".replace(",", " ")))
    for panel in axes.flat[len(shown) :]:
        panel.set_visible(False)
    if drawn is not None:
        figure.colorbar(drawn, ax=axes, label="unstable, %", shrink=0.8)
    return figure


SENSITIVITY_DRAWINGS: Final[Mapping[str, Callable[[Mapping[str, Any]], Figure]]] = {
    "dots": dots,
    "changed": changed,
    "slopes": slopes,
    "distributions": distributions,
    "spreads": spreads,
    "unstable": unstable,
    "pairs": pairs,
    "growth": growth,
}
"""By the kind of a figure."""
