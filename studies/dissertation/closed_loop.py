"""Chapter 5 of the dissertation, with a controller: the regulator, its wiring, runs on the nonlinear plant.

The regulator has R = 800 and Q = 1 on every state. The plant is the nonlinear model with tyres as 5.34, made
odd, and every angle with its sine and cosine. The controller acts once in PERIOD_S; its command is held.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from studies.dissertation.compared import ComparedFigure, claim, figures, number, pole, table
from tilth.analysis.rig_report import LINEAR, MEASURED
from tilth.estimator.models import linear_analysis as linear
from tilth.estimator.models import nonlinear
from tilth.estimator.models.actuator import BOSSERD, Actuator
from tilth.estimator.models.family import model_named
from tilth.estimator.models.linear_analysis import Array, Complex, damping, dominant, eigenvalues, system
from tilth.estimator.models.parameters import TABLE_5_1, TABLE_7_2, Rig, static_loads
from tilth.estimator.models.regulator import Regulator, closed_loop, gain_on, regulator

RIG = TABLE_5_1
SPEEDS = (1.0, 4.5, 7.5)  # m/s
SPEED = 4.5  # m/s, of the runs
RANGE: Array = np.linspace(0.5, 10.0, 39)  # m/s, of figure 5.8
GRIP = 0.7  # A of 5.34
PERIOD_S = 0.02
SECONDS = 30.0
OFFSET, HEADING = 5.0, math.radians(20.0)  # m and rad, of both bodies, pointing away from the line
BAND = 0.05  # share of the start, of settling
VALID = math.radians(35.0)  # wheel angle to which the nonlinear model holds
SERVO = 2.5  # rad of command for each rad of missing wheel angle: with BOSSERD a double pole at -5 1/s
NAMES = nonlinear.STATES


def design(name: str, speed: float, actuator: Actuator | None = BOSSERD, rig: Rig = RIG) -> Regulator:
    return regulator(system(model_named(name), rig, speed, actuator=actuator))


def as_printed(rig: Rig = RIG, grip: float = GRIP) -> Rig:
    """The dissertation's plant: constant speed, no rolling resistance, force in proportion to load (5.34)."""
    return rig._replace(
        grip_f=grip, grip_r=grip, grip_i=grip, load_exponent=1.0, roll_f=0.0, roll_r=0.0, roll_i=0.0,
        drive_gain=1e6, drive_limit=500e3,
    )  # fmt: skip


class ClosedLoopRun(NamedTuple):
    """A run from beside the line: time (n,), states (n, 13)."""

    time: Array
    states: Array

    def of(self, name: str) -> Array:
        return self.states[:, NAMES.index(name)]


def run(
    plant: Rig,
    gain: Array,
    actuator: Actuator | None,
    offset: float = OFFSET,
    heading: float = HEADING,
    seconds: float = SECONDS,
    period: float = PERIOD_S,
) -> ClosedLoopRun:
    """The line y = 0 is to be followed at SPEED. gain: (13,), of the command on the plant's states.

    Ends early where steering or articulation passes 90°: there is nothing to see beyond.
    """
    x = nonlinear.running(SPEED, y_t=offset, psi_t=heading, psi_i=heading)
    command = nonlinear.inputs_of(1, speed=SPEED)
    trajectory = [x]
    for _ in range(round(seconds / period)):
        command[0, 0] = -float(gain @ x)
        x = nonlinear.simulate(plant, command, x, period, actuator=actuator)[-1]
        trajectory.append(x)
        if max(abs(x[NAMES.index("delta")]), abs(x[2] - x[3])) > math.pi / 2:
            break
    states = np.array(trajectory)
    time: Array = np.arange(len(states), dtype=np.float64) * period
    return ClosedLoopRun(time, states)


def settled(time: Array, error: Array, band: float) -> float:
    """When the error enters ± band to stay, s; infinite where it does not."""
    outside = np.flatnonzero(np.abs(error) > band)
    if not len(outside):
        return 0.0
    return float(time[outside[-1] + 1]) if outside[-1] + 1 < len(time) else math.inf


class Figures(NamedTuple):
    """Read off a run: settling of y, psi_t, psi_i (s), overshoot (share of the offset), largest angles (°)"""

    settling: tuple[float, float, float]
    overshoot: float
    heading_t: float
    heading_i: float
    steering: float


def read_off(made: ClosedLoopRun, band: float = BAND) -> Figures:
    """band: share of the start within which an error has settled."""
    y, psi_t, psi_i = made.of("y_t"), made.of("psi_t"), made.of("psi_i")
    settling = [settled(made.time, e, band * abs(e[0])) for e in (y, psi_t, psi_i)]
    return Figures(
        (settling[0], settling[1], settling[2]),
        float(-(y / y[0]).min()),
        math.degrees(np.abs(psi_t).max()),
        math.degrees(np.abs(psi_i).max()),
        math.degrees(np.abs(made.of("delta")).max()),
    )


def relaxation_gain(rig: Rig = RIG) -> Array:
    """On the plant's states: designed on the relaxation model with the actuator, at SPEED."""
    found = design("relaxation", SPEED, rig=rig)
    return gain_on(found.states, found.gain, NAMES)


class Wiring(NamedTuple):
    """A gain designed on the kinematic model and how its output reaches the wheels."""

    name: str
    meaning: str
    designed_with: Actuator | None
    driven_by: Actuator | None
    servo: bool = False


WIRINGS = (
    Wiring("dissertation's", "designed without the actuator, fed into its input, which sets a steering rate",
           None, BOSSERD),
    Wiring("direct", "the same gain, sets the wheel angle at once, no actuator", None, None),
    Wiring("servo", "the same gain, sets the wheel angle wanted of a servo made of that actuator",
           None, BOSSERD, True),
    Wiring("designed with it", "designed with the actuator in the model, fed into its input",
           BOSSERD, BOSSERD),
)  # fmt: skip


def wired(wiring: Wiring, speed: float, states: Sequence[str]) -> Array:
    """The gain of the command on those states."""
    found = design("kinematic", speed, wiring.designed_with)
    gain = gain_on(found.states, found.gain, states)
    if wiring.servo:
        gain = SERVO * gain
        gain[list(states).index("delta")] += SERVO
    return gain


def wired_poles(wiring: Wiring, speed: float, plant: str = "relaxation") -> Complex:
    """Eigenvalues with the linear model of that name as plant."""
    sys = system(model_named(plant), RIG, speed, actuator=wiring.driven_by)
    return eigenvalues(closed_loop(sys, wired(wiring, speed, sys.states)))


def wired_run(wiring: Wiring, heading: float = HEADING) -> ClosedLoopRun:
    return run(as_printed(), wired(wiring, SPEED, NAMES), wiring.driven_by, heading=heading)


def invalid_from(made: ClosedLoopRun) -> float:
    """When the wheel angle passes VALID, s; infinite where it does not."""
    beyond = np.flatnonzero(np.abs(made.of("delta")) > VALID)
    return float(made.time[beyond[0]]) if len(beyond) else math.inf


def growth(wiring: Wiring) -> float:
    """1/s, of a small error on the nonlinear plant: from peaks of the tracking error between 5 and 20 s."""
    made = run(as_printed(), wired(wiring, SPEED, NAMES), wiring.driven_by, 1e-3, 0.0, 20.0)
    y = np.abs(made.of("y_t"))
    tops = np.flatnonzero((y[1:-1] > y[:-2]) & (y[1:-1] >= y[2:])) + 1
    tops = tops[made.time[tops] > 5.0]
    return float(np.log(y[tops[-1]] / y[tops[0]]) / (made.time[tops[-1]] - made.time[tops[0]]))


def _real(name: str, actuator: Actuator | None) -> list[float]:
    return [dominant(design(name, u, actuator).poles).real for u in SPEEDS]


def regulator_lines() -> list[ComparedFigure]:
    """Sections 5.2.3 and 5.3.2, figure 5.7."""
    kinematic, dynamic = _real("kinematic", None), _real("dynamic", BOSSERD)
    coarse = RANGE[::4].tolist()
    worst = max(float(design(m.name, u, act).poles.real.max()) for m, act in DESIGNED for u in coarse)
    slow = design("relaxation", 1.0).poles
    real_poles = [p.real for p in slow if p.imag == 0][-2:]
    return [
        claim("5.2.3", "relaxation with actuator: controllable; observable from y_t, ψ_t, ψ_i", "both",
              "ranks {} and {} of {} at 4.5 m/s".format(*_ranks()), len(set(_ranks())) == 1),
        figures("5.3.2", "kinematic: dominant real part at 1.0, 4.5, 7.5 m/s", [-0.08, -0.35, -0.58],
                kinematic, digits=2, why="−0.58 is the right number cut after two places, not rounded"),
        figures("5.3.2", "kinematic: settling, s", [50, 11, 7], [-4 / x for x in kinematic], digits=0,
                within=1.0, why="four time constants; the print is 4 over the real part as printed"),
        figures("5.3.2", "dynamic with actuator: dominant real part", [-0.12, -0.31, -0.42], dynamic,
                digits=2),
        figures("5.3.2", "dynamic with actuator: settling, s", [33, 13, 10], [-4 / x for x in dynamic],
                digits=0, within=1.0, why="as above: 4/0.42 = 9.5"),
        claim("5.3.2", "all closed loops from 0.5 to 10 m/s", "stable",
              f"largest real part {number(worst, 3)}", worst < 0),
        claim("5.3.2", "relaxation, 1.0 m/s: two real eigenvalues near the dominant pair",
              "they improve the damping",
              f"{', '.join(number(x, 3) for x in real_poles)} beside {pole(dominant(slow), 3)}",
              len(real_poles) == 2),
    ]  # fmt: skip


def settling_lines() -> list[ComparedFigure]:
    """Sections 5.3.2 and 5.4, figure 5.8."""
    distance, ratio = settling_distances(), damping_ratios()
    later = RANGE >= 2.5
    bend, later_bend = straightness(RANGE, distance), straightness(RANGE[later], distance[later])
    swing = math.exp(-math.pi / math.tan(math.acos(float(np.interp(SPEED, RANGE, ratio)))))
    return [
        figures("5.3.2, figure 5.8", "relaxation: settling distance at 0.5 m/s, m", [24.0],
                distance[:1].tolist(), digits=0, within=1.5),
        claim("figure 5.8", "settling distance from 0.5 to 10 m/s", "grows almost linearly",
              f"{number(float(distance[0]), 1)} to {number(float(distance[-1]), 1)} m, always growing",
              bool(np.all(np.diff(distance) > 0)),
              f"bent below 2.5 m/s: the best straight line misses it by up to {number(bend, 1)} m, one for "
              f"2.5 to 10 m/s by {number(later_bend, 1)} m"),
        claim("figure 5.8", "damping ratio of the dominant pair", "about 0.5, decreasing slightly",
              f"{number(float(ratio[0]), 3)} to {number(float(ratio[-1]), 3)}",
              bool(np.all(np.diff(ratio) < 1e-6) and abs(ratio.mean() - 0.5) < 0.05)),
        figures("5.4", "overshoot that the dominant pair alone would give at 4.5 m/s, %", [15.0],
                [100 * swing], digits=0, within=1.0),
    ]  # fmt: skip


def straightness(x: Array, y: Array) -> float:
    """By how much the best straight line misses y at most."""
    return float(np.abs(np.polynomial.Polynomial.fit(x, y, 1)(x) - y).max())


DESIGNED = [(model, None if model.name == "kinematic" else BOSSERD) for model in LINEAR]
"""As in the dissertation: the actuator is added to the dynamic models, not to the kinematic one."""


def settling_distances() -> Array:
    """Over RANGE, m, of the relaxation model's regulator with the actuator."""
    return np.array([linear.settling_distance(design("relaxation", u).poles, u) for u in RANGE.tolist()])


def damping_ratios() -> Array:
    """Of the dominant pair, over RANGE."""
    pairs = np.array([dominant(design("relaxation", u).poles) for u in RANGE.tolist()])
    return damping(pairs)


def _ranks() -> tuple[int, int, int]:
    sys = system(model_named("relaxation"), RIG, SPEED, outputs=MEASURED, actuator=BOSSERD)
    ranks = linear.controllability(sys.a, sys.b[:, :1])[0], linear.observability(sys.a, sys.c)[0]
    return *ranks, len(sys.a)


def unstable_lines() -> list[ComparedFigure]:
    """Section 5.4, figure 5.9 a."""
    first = WIRINGS[0]
    passes = [invalid_from(wired_run(first, heading)) for heading in (HEADING, -HEADING)]
    real = dominant(wired_poles(first, SPEED))
    return [
        claim("5.4, figure 5.9 a", "kinematic design, 4.5 m/s: eigenvalue with the relaxation model as plant",
              "one has a small positive real part", pole(real), real.real > 0,
              "in the dissertation's wiring, and owing to it: see below"),
        claim("5.4, figure 5.9 a", "the same on the nonlinear plant", "unstable",
              f"a millimetre grows with {number(growth(first), 3)} 1/s; from 5 m and 20° the wheels pass 35° "
              f"after {number(passes[0], 1)} s (pointing away from the line) or {number(passes[1], 1)} s "
              "(towards it)", max(passes) < SECONDS),
    ]  # fmt: skip


def run_lines() -> list[ComparedFigure]:
    """Section 5.4, figures 5.9 b and 5.10."""
    whole = run(as_printed(), relaxation_gain(), BOSSERD)
    found, strict = read_off(whole), read_off(whole, 0.02)
    small, towards = (
        read_off(run(as_printed(), relaxation_gain(), BOSSERD, 3.0, math.radians(way))) for way in (10, -10)
    )
    above = [longest_above(whole, name, math.radians(10.0)) for name in ("psi_t", "psi_i", "delta")]
    return [
        figures("5.4, figures 5.9 b, 5.10 a", "relaxation design: settling of tracking and heading error, s",
                [12, 13], found.settling[:2], digits=0, within=1.5,
                why=f"to 5 % of the start. To 2 %: {_seconds(strict.settling[:2])} s"),
        figures("5.4, figure 5.10 b", "settling of the implement's heading, s", [14], found.settling[2:],
                digits=0, within=0.5, why=f"to 5 %. To 2 %: {_seconds(strict.settling[2:])} s"),
        figures("5.4", "overshoot of the tracking error, %", [10], [100 * found.overshoot], digits=0,
                within=2.5),
        figures("5.4", "largest heading error, tractor and implement, °", [24, 20],
                [found.heading_t, found.heading_i], digits=0, within=1.5,
                why="no variant of the plant below moves them by more than 0.4°"),
        figures("5.4", "largest wheel angle, °", [11], [found.steering], digits=0, within=1.0),
        claim("5.4", "from 3 m and 10°: largest ψ_t, ψ_i, δ", "below 10°",
              f"{_seconds([small.heading_t, small.heading_i, small.steering])}°", small.heading_t < 10,
              "it cannot be with 24° from 5 m and 20° in a system this nearly linear, unless the rig points "
              f"to the line: then {_seconds([towards.heading_t, towards.heading_i, towards.steering])}°"),
        claim("5.4", "angles above 10° in the transient", "for less than 5 s",
              f"at a stretch {_seconds(above)} s (ψ_t, ψ_i, δ)", max(above) < 5.0),
    ]  # fmt: skip


def longest_above(made: ClosedLoopRun, name: str, level: float) -> float:
    """Longest stretch, s, over which the size of a state is above a level."""
    longest = count = 0
    for above in np.abs(made.of(name)) > level:
        count = count + 1 if above else 0
        longest = max(longest, count)
    return longest * PERIOD_S


def _seconds(values: Sequence[float]) -> str:
    """One decimal each."""
    return ", ".join("never" if math.isinf(value) else number(value, 1) for value in values)


def wiring_table() -> str:
    """What the wiring does to the kinematic design at SPEED, in Markdown."""
    rows = []
    for wiring in WIRINGS:
        made = wired_run(wiring)
        found, late = read_off(made), invalid_from(made)
        stays = math.isinf(late)
        end = (
            f"settles in {_seconds(found.settling[:1])} s"
            if stays
            else f"wheels pass 35° at {number(late, 1)} s"
        )
        poles = [
            pole(dominant(wired_poles(wiring, SPEED, plant)), 3) for plant in ("kinematic", "relaxation")
        ]
        over = f"{100 * found.overshoot:.0f} %" if stays else "–"
        rows.append([f"{wiring.name}: {wiring.meaning}", *poles, end, over])
    head = ["wiring", "on the kinematic model", "on the relaxation model", "nonlinear plant", "overshoot"]
    return table(head, rows)


def wiring_speeds() -> str:
    """Dominant real parts of the dissertation's wiring over speed, in Markdown."""
    speeds = (0.5, 1.0, 2.5, 4.5, 7.5, 10.0)
    rows = [
        [wiring.name, *(number(dominant(wired_poles(wiring, u)).real, 3) for u in speeds)]
        for wiring in WIRINGS
    ]
    return table(["1/s, relaxation model", *(f"{u} m/s" for u in speeds)], rows)


class Variant(NamedTuple):
    """Another plant or start for the same controller."""

    name: str
    plant: Rig
    offset: float = OFFSET
    heading: float = HEADING
    rig: Rig = RIG  # that the regulator is designed on


def variants() -> tuple[Variant, ...]:
    return (
        Variant("as the dissertation's, A = 0.7", as_printed()),
        Variant("A = 0.5", as_printed(grip=0.5)),
        Variant("A = 1.0", as_printed(grip=1.0)),
        Variant("linear tyres", as_printed(grip=math.inf)),
        Variant("load transfer, degressive tyres, rolling resistance, speed control", RIG),
        Variant("Table 7.2, A = 0.7", as_printed(TABLE_7_2), rig=TABLE_7_2),
        Variant("pointing towards the line", as_printed(), heading=-HEADING),
        Variant("from 3 m and 10°", as_printed(), 3.0, math.radians(10.0)),
    )


def variant_table() -> str:
    """What the plant's details change, in Markdown."""
    rows = []
    for variant in variants():
        made = run(variant.plant, relaxation_gain(variant.rig), BOSSERD, variant.offset, variant.heading)
        at5, at2 = read_off(made), read_off(made, 0.02)
        rows.append([
            variant.name, _seconds(at5.settling), _seconds(at2.settling), number(100 * at5.overshoot, 1),
            number(at5.heading_t, 1), number(at5.heading_i, 1), number(at5.steering, 1),
        ])  # fmt: skip
    head = [
        "plant and start",
        "5 % settling of y, ψ_t, ψ_i, s",
        "2 %, s",
        "overshoot, %",
        "ψ_t, °",
        "ψ_i, °",
        "δ, °",
    ]
    return table(head, rows)


def tyre_table() -> str:
    """N, A and B of 5.34 for each axle, in Markdown."""
    rows = []
    names = ("front", "rear", "implement")
    for name, load, stiffness in zip(names, static_loads(RIG), RIG.theta[:3].tolist(), strict=True):
        rows.append([name, number(load / 1000, 1), number(GRIP, 1), number(stiffness / (GRIP * load), 2),
                     number(GRIP * load / 1000, 1)])  # fmt: skip
    return table(["axle", "N, kN", "A", "B = C_α/(A N), 1/rad", "largest force A N, kN"], rows)
