"""Figures 7.4 and 7.5 of the dissertation from chapter7.json: a step run that was not fitted, as measured and
as predicted. Figure 7.6, the frequency response of the random runs, gets its rows here, too."""

from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tilth.analysis.dissertation.chapter7 import PATH_EVERY_S
from tilth.analysis.dissertation.field_tables import read

Array = NDArray[np.float64]

LINES: Final[Mapping[str, Mapping[str, Any]]] = {
    "measured": {"color": "#000000", "label": "measured"},
    "initial": {"color": "#999999", "linestyle": (0, (4, 1.5)), "label": "initial parameters"},
    "N2": {"color": "#d55e00", "linestyle": "--", "label": "parameters of N2"},
    "N1+N2": {"color": "#0072b2", "linestyle": (0, (6, 1.5, 1, 1.5)), "label": "parameters of N1 + N2"},
}
BODIES: Final = ("tractor", "implement")


def _panels(found: dict[str, Any], height: float) -> tuple[Figure, Any]:
    figure = Figure(figsize=(9.0, height), layout="constrained")
    axes = figure.subplots(1, 2 * len(found["paths"]), squeeze=False)[0]
    return figure, axes


def paths() -> Figure:
    """Figure 7.4: both bodies of both plants on N3, from which nothing was learned."""
    found = read()
    figure, axes = _panels(found, 3.6)
    for k, panel in enumerate(axes):
        row, body = found["paths"][k // 2], BODIES[k % 2]
        for name in ("measured", "initial", "N2"):
            north, east = np.array(row[body][name]).T
            panel.plot(east, north, **LINES[name])
        panel.set(title=f"{'abcd'[k]}) {body}, {row['plant']}", xlabel="east, m", aspect="equal")
        panel.set_adjustable("datalim")
    axes[0].set_ylabel("north, m")
    axes[0].legend(loc="lower left")
    return figure


def distances() -> Figure:
    """Figure 7.5: how far predictions by fitted parameters are from what was measured; in print, paths."""
    found = read()
    figure, axes = _panels(found, 2.8)
    for k, panel in enumerate(axes):
        row, body = found["paths"][k // 2], BODIES[k % 2]
        for name in ("N2", "N1+N2"):
            off = _distance(row[body], name)
            panel.plot(np.arange(len(off)) * PATH_EVERY_S, off, **LINES[name])
        panel.set(title=f"{'abcd'[k]}) {body}, {row['plant']}", xlabel="time, s", ylim=(0, None))
    axes[0].set_ylabel("distance from the measured place, m")
    axes[0].legend(loc="upper left")
    return figure


def _distance(row: Mapping[str, Any], name: str) -> Array:
    apart = np.array(row[name]) - np.array(row["measured"])
    return np.asarray(np.hypot(apart[:, 0], apart[:, 1]))


DRAWINGS: Final[Mapping[str, Callable[[], Figure]]] = {"figure-7-4": paths, "figure-7-5": distances}
"""As figures.DRAWINGS."""
