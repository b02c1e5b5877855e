"""How all figures of a report look: one font size, one palette, colours that a page replaces for the dark."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

Floats = NDArray[np.float64]

INK: Final = "#141414"
GRID: Final = "#d6d6d6"
QUIET: Final = "#767676"
PAPER: Final = "#fefefe"  # none of these four is used for anything else: a page replaces them by its own
WIDTH: Final = 7.1  # in: a page's width, 180 mm
COLUMN: Final = 3.5  # in: a column's, 89 mm
FONT_PT: Final = 8.0
BLUE, VERMILLION, GREEN, ORANGE, PURPLE, SKY = (
    "#0072b2", "#d55e00", "#009e73", "#e69f00", "#cc79a7", "#56b4e9",
)  # fmt: skip
"""Of Okabe and Ito (2008), told apart by colour-blind eyes."""
KIND_COLOURS: Final[Mapping[str, str]] = {
    "step": VERMILLION, "steady_turn": ORANGE, "chirp": BLUE, "random": PURPLE, "headland_turn": GREEN,
    "turn": SKY, "row": QUIET, "marked": BLUE, "given": BLUE,
}  # fmt: skip
METHOD_LINES: Final[Mapping[str, dict[str, Any]]] = {
    "steady_state": {"color": ORANGE, "linestyle": (0, (1, 1))},
    "tracker": {"color": BLUE, "linestyle": (0, (5, 1.5))},
    "pem": {"color": VERMILLION, "linestyle": "-"},
}
MODEL_LINES: Final[Sequence[dict[str, Any]]] = (
    {"color": QUIET, "linestyle": (0, (1, 1))},
    {"color": VERMILLION, "linestyle": "-"},
    {"color": GREEN, "linestyle": (0, (5, 1.5))},
    {"color": PURPLE, "linestyle": (0, (6, 1.5, 1, 1.5))},
)
TICKS: Final = ((1.5, (1.0, 3.0)), (0.8, (1.0, 2.0, 5.0)), (0.4, (1.0, 1.5, 2.0, 3.0, 5.0, 7.0)))
"""Decades that a logarithmic axis spans more than, and its numbers in each."""
LOOK: Final[dict[Any, Any]] = {
    "font.family": "DejaVu Sans",
    "font.size": FONT_PT,
    **dict.fromkeys(("axes.titlesize", "axes.labelsize", "legend.fontsize", "xtick.labelsize",
                     "ytick.labelsize", "figure.titlesize"), FONT_PT),
    **dict.fromkeys(("text.color", "axes.labelcolor", "axes.edgecolor", "xtick.color", "ytick.color"), INK),
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": GRID,
    "grid.linewidth": 0.5,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "lines.linewidth": 1.0,
    "legend.frameon": False,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    "savefig.facecolor": "none",
    "svg.hashsalt": "tilth",
    "pdf.fonttype": 42,
    "path.simplify_threshold": 0.2,
}  # fmt: skip


def floats(values: Sequence[float | None]) -> Floats:
    """[n], NaN for None."""
    return np.array([np.nan if value is None else value for value in values], dtype=np.float64)


def panels(rows: int, columns: int, height: float, width: float = WIDTH, **shared: Any) -> tuple[Figure, Any]:
    """An empty figure, in, and its axes, shape (rows, columns)."""
    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, **shared)


def band(axes: Axes, x: Floats, low: Floats, high: Floats, colour: str) -> None:
    """A 95 % band."""
    axes.fill_between(x, low, high, color=colour, alpha=0.22, linewidth=0)


def plain_ticks(axis: Axis) -> None:
    """Numbers as people write them on a logarithmic axis, which may span much less than a decade."""
    low, high = axis.get_view_interval()
    decades = math.log10(high / low)
    steps = next((steps for span, steps in TICKS if decades > span), None)
    ticks = [step * 10.0**power for power in range(-4, 7) for step in steps or ()]
    if steps is None:  # as on an even axis
        ticks = [round(float(value), 12) for value in MaxNLocator(5).tick_values(low, high)]
    shown = [value for value in ticks if low <= value <= high]
    axis.set_ticks(shown, [f"{value:g}" for value in shown])
    axis.set_ticks([], minor=True)


def time_scale(duration_s: float) -> tuple[float, str]:
    """What times are divided by, and the label of their axis."""
    return (60.0, "time, min") if duration_s > 600 else (1.0, "time, s")
