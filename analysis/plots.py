"""How everything here is drawn: colours, axes, and files whose bytes depend on the numbers only."""

import io
from collections.abc import Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, Final

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator

from tilth.estimator.models.family import Model
from tilth.estimator.models.linear_analysis import (
    Array,
    Complex,
    System,
    decibel,
    frequency_response,
    outputs_of,
    simulate,
    system,
)
from tilth.estimator.models.parameters import Rig
from tilth.logger.log import whole_file

COLOURS: Final = {
    "kinematic": "#999999",
    "dynamic": "#0072b2",
    "relaxation": "#d55e00",
    "nonlinear": "#009e73",
}
DASHES: Final[Mapping[str, object]] = {
    "kinematic": (0, (4, 1.5)),
    "dynamic": (0, (6, 1.5, 1, 1.5)),
    "relaxation": "-",
    "nonlinear": ":",
}
MARKERS: Final = {"kinematic": "o", "dynamic": "s", "relaxation": "x", "nonlinear": "+"}
FORMATS = (".svg", ".png", ".pdf")
_REAL_TICKS: Final = (-100.0, -30.0, -10.0, -3.0, -1.0, -0.5, 0.0, 0.5, 1.0, 3.0, 10.0)
STEP_POINTS: Final = 401
_LOOK: Final[dict[Any, object]] = {
    "font.size": 9.0,
    "axes.titlesize": 9.0,
    "legend.fontsize": 8.0,
    "axes.grid": True,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "lines.linewidth": 1.4,
    "svg.hashsalt": "tilth",
    "path.simplify_threshold": 0.2,
}
_NO_DATE: Mapping[str, Mapping[str, None]] = {
    ".svg": {"Date": None}, ".pdf": {"CreationDate": None, "ModDate": None}, ".png": {},
}  # fmt: skip


def look() -> AbstractContextManager[None]:
    """Figures are made within it: `with plots.look(): …`."""
    return matplotlib.rc_context(_LOOK)


def save(figure: Figure, path: Path) -> None:
    """Write a figure as its suffix says, one of FORMATS. Raises OSError."""
    form, drawn = path.suffix.lower(), io.BytesIO()
    with look():
        figure.savefig(drawn, format=form[1:], metadata=dict(_NO_DATE[form]), dpi=110)
    whole_file.write(path, drawn.getvalue())


def bode(gain: Axes, phase: Axes, sys: System, output: str, omega: Array, **line: Any) -> None:
    """Gain (dB) and unwrapped phase (°) of one output over the first input. omega: rad/s."""
    response = frequency_response(sys, omega)[:, sys.outputs.index(output), 0]
    gain.semilogx(omega, decibel(response), **line)
    phase.semilogx(omega, np.degrees(np.unwrap(np.angle(response))), **line)


def pole_map(axes: Axes, poles: Complex, **marks: Any) -> None:
    """Eigenvalues, 1/s, in the complex plane; the real axis is logarithmic beyond ±1."""
    axes.plot(poles.real, poles.imag, linestyle="none", fillstyle="none", **marks)
    axes.set_xscale("symlog", linthresh=1.0)
    axes.xaxis.set_major_locator(FixedLocator(_REAL_TICKS))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set(xlabel="real part, 1/s", ylabel="imaginary part, rad/s")


def yaw_step(model: Model, rig: Rig, speed: float, seconds: float, angle: float) -> tuple[Array, Array]:
    """Time (s), shape (n,), and the yaw rates of tractor and implement (rad/s), shape (n, 2).

    After the wheels are turned by `angle` (rad) at 0 s from straight running.
    """
    sys = system(model, rig, speed)
    inputs = np.zeros((STEP_POINTS, len(sys.inputs)))
    inputs[:, 0] = angle
    dt = seconds / (STEP_POINTS - 1)
    states = simulate(model, rig, speed, inputs[1:], np.zeros(len(sys.states)), dt)
    time: Array = np.arange(STEP_POINTS, dtype=np.float64) * dt
    return time, outputs_of(sys, states, inputs)
