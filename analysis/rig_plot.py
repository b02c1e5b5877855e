"""A rig at several speeds in one figure: frequency response, step response and eigenvalues of the models."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MultipleLocator

from tilth.analysis import plots
from tilth.analysis.rig_report import speed_key
from tilth.estimator.models.family import Model
from tilth.estimator.models.linear_analysis import eigenvalues, system
from tilth.estimator.models.parameters import Rig

MOST_SPEEDS = 8  # columns of a figure
OMEGA = np.geomspace(0.05, 50.0, 240)  # rad/s
STEP_SECONDS = 5.0
BODIES: Final[tuple[tuple[str, Literal["-", ":"]], ...]] = (("tractor", "-"), ("implement", ":"))
_ROWS = ("gain of yaw rate\nover wheel angle, dB", "phase, °", "yaw rate after a step\nof wheel angle, 1/s")


def draw_rig(name: str, rig: Rig, models: Sequence[Model], speeds: Sequence[float], path: Path) -> None:
    """Write the figure, one column a speed. path: with a suffix of plots.FORMATS. Raises OSError."""
    with plots.look():
        figure = Figure(figsize=(2.0 + 2.7 * max(len(speeds), 2), 9.6), layout="constrained")
        axes = figure.subplots(4, len(speeds), squeeze=False, sharey="row", sharex="row")
        for column, speed in enumerate(speeds):
            _column(axes[:, column], rig, models, speed)
        for row, label in enumerate(_ROWS):
            axes[row, 0].set_ylabel(label)
        for panel in axes[3, 1:]:
            panel.set_ylabel("")
        figure.suptitle(f"{name}: models of the rig")
        figure.legend(handles=_legend(models), loc="outside lower center", ncols=len(models) + 2)
        plots.save(figure, path)


def _column(axes: Any, rig: Rig, models: Sequence[Model], speed: float) -> None:
    gain, phase, step, plane = axes
    for model in models:
        colour = plots.COLOURS[model.name]
        sys = system(model, rig, speed)
        time, yaw = plots.yaw_step(model, rig, speed, STEP_SECONDS, 1.0)
        for k, (_, dash) in enumerate(BODIES):
            plots.bode(gain, phase, sys, sys.outputs[k], OMEGA, color=colour, linestyle=dash)
            step.plot(time, yaw[:, k], color=colour, linestyle=dash)
        plots.pole_map(plane, eigenvalues(sys.a), color=colour, marker=plots.MARKERS[model.name])
    gain.set_title(f"{speed_key(speed)} m/s")
    phase.set_xlabel("rad/s")
    phase.yaxis.set_major_locator(MultipleLocator(90.0))
    step.set_xlabel("s")
    plane.axvline(0.0, color="#888888", linewidth=0.8)


def _legend(models: Sequence[Model]) -> list[Line2D]:
    colours = [
        Line2D([], [], color=plots.COLOURS[model.name], marker=plots.MARKERS[model.name], fillstyle="none",
               label=model.name)
        for model in models
    ]  # fmt: skip
    return colours + [Line2D([], [], color="black", linestyle=dash, label=body) for body, dash in BODIES]
