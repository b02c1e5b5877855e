"""Figures 7.4 to 7.6 of the dissertation from chapter7.json: a step run that was not fitted, as measured and
as predicted, and the frequency response of a run with random steering."""

from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from studies.dissertation.chapter7 import PATH_EVERY_S
from studies.dissertation.field_tables import read

Array = NDArray[np.float64]

LINES: Final[Mapping[str, Mapping[str, Any]]] = {
    "measured": {"color": "#000000", "label": "measured"},
    "initial": {"color": "#999999", "linestyle": (0, (4, 1.5)), "label": "initial parameters"},
    "N2": {"color": "#d55e00", "linestyle": "--", "label": "parameters of N2"},
    "N1+N2": {"color": "#0072b2", "linestyle": (0, (6, 1.5, 1, 1.5)), "label": "parameters of N1 + N2"},
}
MODELS: Final[Mapping[str, Mapping[str, Any]]] = {
    "machine file": LINES["initial"],
    "estimated": {**LINES["N2"], "label": "estimated parameters"},
}
BAND: Final[Mapping[str, Any]] = {"color": "#bbbbbb", "linewidth": 0, "label": "95 % of the measured"}
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


def frequency() -> Figure:
    """Figure 7.6: yaw rates over the wheel angle, measured with their 95 % band, and of the models."""
    found = read()["responses"]
    figure = Figure(figsize=(10.0, 4.8), layout="constrained")
    axes = figure.subplots(2, 2 * len(found), sharex=True, sharey="row", squeeze=False)
    for k, (gain, phase) in enumerate(axes.T):
        row, body = found[k // 2], BODIES[k % 2]
        rate, output = 2 * np.pi * np.array(row["hz"]), row["outputs"][k % 2]
        low, high, middle, half = (
            np.array(output[key], np.float64)
            for key in ("gain_low_db", "gain_high_db", "phase_deg", "phase_half_deg")
        )
        gain.fill_between(rate, low, high, **BAND)
        phase.fill_between(rate, middle - half, middle + half, **BAND)
        for panel, key in ((gain, "gain_db"), (phase, "phase_deg")):
            panel.plot(rate, np.array(output[key], np.float64), **LINES["measured"])
            for model in output["models"]:
                panel.plot(rate, np.array(model[key], np.float64), **MODELS[model["name"]])
        gain.set(title=f"{'abcd'[k]}) {body}, {row['plant']}")
        phase.set(xlabel="steering, rad/s")
    axes[0, 0].set_ylabel("yaw rate over wheel angle, dB")
    axes[1, 0].set_ylabel("phase, °")
    axes[1, 0].legend(loc="lower left")
    return figure


DRAWINGS: Final[Mapping[str, Callable[[], Figure]]] = {
    "figure-7-4": paths,
    "figure-7-5": distances,
    "figure-7-6": frequency,
}
"""As figures.DRAWINGS."""
