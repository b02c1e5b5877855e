"""Figures 3.6, 3.7, 5.3 to 5.10, 6.8 and 6.10 of the dissertation, drawn anew, and the table of all.
Call them within plots.look()."""

import math
from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator

from studies.dissertation import chapter6, closed_loop, field_figures, open_loop
from studies.dissertation.closed_loop import HEADING, OFFSET, WIRINGS, ClosedLoopRun
from tilth.analysis import plots
from tilth.analysis.rig_report import LINEAR
from tilth.estimator.models.actuator import BOSSERD
from tilth.estimator.models.linear_analysis import Complex, system

RIG = open_loop.RIG
BODE_OMEGA = np.geomspace(0.05, 50.0, 140)  # rad/s
SPEED_COLOURS: Final = ("#0072b2", "#e69f00", "#d55e00")
SPEED_MARKERS: Final = ("o", "s", "^")


def _panels(rows: int, columns: int, width: float, height: float, **share: Any) -> tuple[Figure, Any]:
    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, **share)


def _style(name: str) -> dict[str, object]:
    return {"color": plots.COLOURS[name], "linestyle": plots.DASHES[name], "label": name}


def step_responses() -> Figure:
    """Figure 3.6."""
    figure, axes = _panels(1, 3, 9.0, 3.0)
    for panel, speed, letter, seconds in zip(axes[0], open_loop.SPEEDS, "abc", (6.0, 3.0, 3.0), strict=True):
        for model in LINEAR:
            time, yaw = plots.yaw_step(model, RIG, speed, seconds, open_loop.STEP_ANGLE)
            panel.plot(time, np.degrees(yaw[:, 0]), **_style(model.name))
        panel.set(title=f"{letter}) {speed} m/s", xlabel="time, s", ylim=(0, None))
    axes[0, 0].set_ylabel("tractor's yaw rate, °/s")
    axes[0, 0].legend(loc="lower right")
    return figure


def trajectories() -> Figure:
    """Figure 3.7: the linear model's path and, dashed, that of the nonlinear model."""
    figure, axes = _panels(1, 1, 5.6, 5.0)
    panel = axes[0, 0]
    for speed, colour in zip(open_loop.SPEEDS, SPEED_COLOURS, strict=True):
        seconds = 2.1 * math.pi * open_loop.radius(speed, False) / speed
        for planar, dash in ((False, "-"), (True, "--")):
            x, y = open_loop.path(speed, seconds, planar).T
            name = "nonlinear model" if planar else "relaxation model"
            panel.plot(y, x, color=colour, linestyle=dash, label=f"{speed} m/s, {name}")
    panel.set(xlabel="to the right, m", ylabel="forward, m", aspect="equal")
    panel.legend(loc="center")
    return figure


def _maps(poles: Callable[[str, float], Complex], speeds: tuple[float, ...]) -> Figure:
    figure, axes = _panels(1, 3, 9.0, 3.4)
    for panel, model, letter in zip(axes[0], LINEAR, "abc", strict=True):
        for speed, colour, marker in zip(speeds, SPEED_COLOURS, SPEED_MARKERS, strict=True):
            found = poles(model.name, speed)
            plots.pole_map(panel, found, color=colour, marker=marker, label=f"{speed} m/s")
        panel.axvline(0.0, color="#888888", linewidth=0.8)
        panel.set_title(f"{letter}) {model.name}")
        low, high = panel.get_ylim()
        panel.set_ylim(min(1.2 * low, -1.0), max(1.2 * high, 1.0))
    for panel in axes[0, 1:]:
        panel.set_ylabel("")
    axes[0, 0].legend(loc="upper left")
    return figure


def open_loop_map() -> Figure:
    """Figure 5.3."""
    return _maps(open_loop.poles_of, (0.5, 4.5, 7.5))


def closed_loop_map() -> Figure:
    """Figure 5.7: kinematic without, the others with the steering actuator."""
    actuators = {model.name: actuator for model, actuator in closed_loop.DESIGNED}

    def poles(name: str, speed: float) -> Complex:
        return closed_loop.design(name, speed, actuators[name]).poles

    return _maps(poles, closed_loop.SPEEDS)


def frequency_responses(speed: float) -> Figure:
    """Figures 5.4 to 5.6: yaw rates of tractor (a) and implement (b) over the wheel angle."""
    figure, axes = _panels(2, 2, 9.0, 5.0, sharex=True)
    for column, (letter, body) in enumerate(zip("ab", open_loop.BODIES, strict=True)):
        gain, phase = axes[:, column]
        for model in LINEAR:
            sys = system(model, RIG, speed)
            plots.bode(gain, phase, sys, sys.outputs[column], BODE_OMEGA, **_style(model.name))
        gain.axvline(0.4 * math.pi, color="#888888", linewidth=0.8)
        gain.set(title=f"{letter}) {body}, {speed} m/s", ylim=(-45, 12))
        phase.axvline(0.4 * math.pi, color="#888888", linewidth=0.8)
        phase.yaxis.set_major_locator(MultipleLocator(90))
        phase.set_xlabel("rad/s (grey: 0.2 Hz)")
    axes[0, 0].set_ylabel("gain, dB (1/s per rad)")
    axes[1, 0].set_ylabel("phase, °")
    axes[0, 0].legend(loc="lower left")
    return figure


def settling_and_damping() -> Figure:
    """Figure 5.8."""
    figure, axes = _panels(1, 1, 5.6, 3.4)
    panel = axes[0, 0]
    right: Axes = panel.twinx()
    panel.plot(
        closed_loop.RANGE, closed_loop.settling_distances(), color="#0072b2", label="settling distance"
    )
    right.plot(closed_loop.RANGE, closed_loop.damping_ratios(), "--", color="#d55e00", label="damping ratio")
    panel.set(xlabel="speed, m/s", ylabel="settling distance, m", ylim=(0, 90), xlim=(0, 10))
    right.set(ylabel="damping ratio of the dominant pair", ylim=(0, 0.9))
    right.spines["right"].set_visible(True)
    right.grid(False)
    figure.legend(loc="outside upper center", ncols=2)
    return figure


def tracking_errors() -> Figure:
    """Figure 5.9: the kinematic design in the dissertation's wiring (a), the relaxation design (b)."""
    figure, axes = _panels(1, 2, 9.0, 3.4)
    first = WIRINGS[0]
    ways = (
        (HEADING, plots.COLOURS["relaxation"], "away from"),
        (-HEADING, plots.COLOURS["dynamic"], "towards"),
    )
    for heading, colour, where in ways:
        gain = closed_loop.wired(first, closed_loop.SPEED, closed_loop.NAMES)
        wired = closed_loop.run(closed_loop.as_printed(), gain, first.driven_by, heading=heading)
        _valid_part(axes[0, 0], wired, colour, f"pointing {where} the line")
        good = closed_loop.run(
            closed_loop.as_printed(), closed_loop.relaxation_gain(), BOSSERD, heading=heading, seconds=20.0
        )
        axes[0, 1].plot(good.time, good.of("y_t"), color=colour, label=f"pointing {where} the line")
    axes[0, 0].set(title="a) designed on the kinematic model")
    axes[0, 0].plot([], [], "x", color="black", label="wheel angle passes 35°")
    axes[0, 0].set_ylim(None, 15.0)
    axes[0, 1].set(title="b) designed on the relaxation model")
    axes[0, 1].axhspan(-0.05 * OFFSET, 0.05 * OFFSET, color="#dddddd", zorder=0, label="5 % of the start")
    for panel in axes[0]:
        panel.set(xlabel="time, s", ylabel="tracking error of the tractor's CG, m")
        panel.legend()
    return figure


def _valid_part(panel: Axes, made: ClosedLoopRun, colour: str, label: str) -> None:
    """The error while the model is valid, a cross where steering passes 35°, dotted beyond."""
    end = closed_loop.invalid_from(made)
    valid = made.time <= end
    y = made.of("y_t")
    panel.plot(made.time[valid], y[valid], color=colour, label=label)
    panel.plot(made.time[~valid], y[~valid], ":", color=colour)
    panel.plot(made.time[valid][-1:], y[valid][-1:], "x", color=colour)


def heading_errors() -> Figure:
    """Figure 5.10, and the wheel angle that the text speaks of."""
    made = closed_loop.run(closed_loop.as_printed(), closed_loop.relaxation_gain(), BOSSERD, seconds=20.0)
    figure, axes = _panels(1, 3, 9.0, 3.0)
    rows = (("psi_t", "a) tractor's heading error, °"), ("psi_i", "b) implement's heading error, °"),
            ("delta", "c) wheel angle, °"))  # fmt: skip
    for panel, (name, label) in zip(axes[0], rows, strict=True):
        panel.plot(made.time, np.degrees(made.of(name)), color=plots.COLOURS["relaxation"])
        panel.set(title=label, xlabel="time, s")
    for panel in axes[0, :2]:
        panel.set_ylim(-28, 23)
    return figure


DRAWINGS: Mapping[str, Callable[[], Figure]] = {
    "figure-3-6": step_responses,
    "figure-3-7": trajectories,
    "figure-5-3": open_loop_map,
    "figure-5-4": lambda: frequency_responses(1.0),
    "figure-5-5": lambda: frequency_responses(2.5),
    "figure-5-6": lambda: frequency_responses(4.5),
    "figure-5-7": closed_loop_map,
    "figure-5-8": settling_and_damping,
    "figure-5-9": tracking_errors,
    "figure-5-10": heading_errors,
    "figure-6-8": chapter6.overall_bars,
    "figure-6-10": chapter6.global_bars,
    **field_figures.DRAWINGS,
}
"""Name of the file, without its suffix -> what draws it."""
