"""Chapters 3 and 5 of the dissertation, without a controller: eigenvalues, steady turns, frequencies."""

import math
from collections.abc import Sequence

import numpy as np

from studies.dissertation.compared import ComparedFigure, claim, figures, number, pole, table
from tilth.analysis import plots
from tilth.analysis.rig_report import LINEAR
from tilth.estimator.models import linear_analysis as linear
from tilth.estimator.models import nonlinear
from tilth.estimator.models.family import model_named
from tilth.estimator.models.linear_analysis import Array, Complex, decibel, dominant, eigenvalues, system
from tilth.estimator.models.parameters import TABLE_5_1, TABLE_7_2, Rig

RIG = TABLE_5_1
SPEEDS = (1.0, 4.5, 7.5)  # m/s, of figures 3.6 and 3.7
FIELD_SPEEDS = (1.0, 2.5, 4.5)  # m/s, of figures 5.4 to 5.6
STEP_ANGLE = math.radians(10.0)
HERTZ = (0.05, 0.1, 0.2, 0.5, 1.0)
BODIES = {"tractor": 0, "implement": 1}
OMEGA: Array = np.geomspace(0.05, 60.0, 3000)  # rad/s, where peaks are looked for


def poles_of(name: str, speed: float, rig: Rig = RIG) -> Complex:
    """Eigenvalues of a linear model at a speed, m/s; complex (n,), 1/s."""
    return eigenvalues(system(model_named(name), rig, speed).a)


def moving(name: str, speed: float) -> Complex:
    """Eigenvalues that are no integrators, the dominant one last."""
    poles = poles_of(name, speed)
    return poles[np.abs(poles) > 0]


def pairs(name: str, speed: float) -> Complex:
    poles = poles_of(name, speed)
    return poles[poles.imag > 0]


def eigenvalue_lines() -> list[ComparedFigure]:
    """Section 5.3.1 and figure 5.3, kinematic and dynamic."""
    kinematic, dynamic = moving("kinematic", 4.5), moving("dynamic", 4.5)
    slow = [
        (u, dominant(moving("kinematic", u)).real, dominant(moving("dynamic", u)).real)
        for u in (0.5, 1.0, 2.5)
    ]
    apart = max(abs(k / d - 1) for _, k, d in slow)
    fast = dominant(moving("dynamic", 7.5))
    return [
        claim("5.3.1", "eigenvalues, and of them at the origin: kinematic; dynamic; relaxation",
              "3, 2; 6, 2; 9, 2", "; ".join(_counts(m.name) for m in LINEAR), _counts("relaxation") == "9, 2",
              "the caption of figure 5.3 c says otherwise: three at the origin, all real"),
        figures("5.3.1", "kinematic, 4.5 m/s: the one that is not zero", [-1.2],
                [dominant(kinematic).real], digits=1),
        figures("5.3.1", "dynamic, 4.5 m/s: dominant", [-1.4], [dominant(dynamic).real], digits=1),
        claim("5.3.1", "dynamic, 4.5 m/s: the others", "−7.5 or further left, real",
              ", ".join(number(p.real, 2) for p in dynamic[:-1]),
              bool(np.all(dynamic[:-1].real < -7.45) and np.all(dynamic.imag == 0))),
        claim("5.3.1", "below 4.5 m/s, kinematic and dynamic", "not much different",
              "; ".join(f"{number(k, 3)} and {number(d, 3)} at {u} m/s" for u, k, d in slow), apart < 0.05),
        claim("5.3.1", "dynamic, 7.5 m/s: dominant pair", "−1.4 ± 1.2j", pole(fast),
              abs(fast - (-1.4 + 1.2j)) < 0.1,
              "the imaginary part agrees, and so does every other printed eigenvalue of this model; −1.4 is "
              "the dominant one at 4.5 m/s, presumably put here by mistake"),
    ]  # fmt: skip


def relaxation_lines() -> list[ComparedFigure]:
    """Section 5.3.1 and figure 5.3, relaxation."""
    least = [float(linear.damping(pairs("relaxation", u)).min()) for u in SPEEDS]
    crawl = float(moving("relaxation", 0.05).real.max())
    slow, fast = (np.sort(pairs("relaxation", u).imag) for u in (0.5, 7.5))
    less = 100 * (1 - fast / slow)
    return [
        claim("5.3.1", "relaxation: damping of the least damped pair at 1.0, 4.5, 7.5 m/s",
              "highly underdamped when slow, more damped when fast", ", ".join(number(z, 2) for z in least),
              least == sorted(least)),
        claim("5.3.1", "relaxation: imaginary parts of the pairs from 0.5 to 7.5 m/s", "decrease slightly",
              " to ".join(", ".join(number(w, 1) for w in size) for size in (slow, fast)),
              bool(np.all(fast < slow)), f"by {less.min():.0f} to {less.max():.0f} %"),
        claim("5.3.1", "relaxation, very slowly", "might be marginally unstable",
              f"largest real part {number(crawl, 3)} at 0.05 m/s", -0.1 < crawl < 0.0,
              "it goes to zero with the speed and stays on the stable side"),
    ]  # fmt: skip


def _counts(name: str) -> str:
    poles = poles_of(name, 4.5)
    return f"{len(poles)}, {int(np.sum(poles == 0))}"


def dominant_table() -> str:
    """Dominant eigenvalue of each model over speed, in Markdown."""
    speeds = (0.5, 1.0, 2.5, 4.5, 7.5)
    rows = [[model.name, *(pole(dominant(moving(model.name, u)), 3) for u in speeds)] for model in LINEAR]
    return table(["model", *(f"{u} m/s" for u in speeds)], rows)


def steady_yaw(name: str, speed: float, rig: Rig = RIG) -> float:
    """Yaw rate per rad of wheel angle in a steady turn, 1/s."""
    if name == "kinematic":
        return speed / rig.wheelbase
    return float(linear.steady_gains(rig, speed)[1])


def step_overshoot(name: str, speed: float) -> float:
    """How far the tractor's yaw rate goes beyond its last value after a step of the wheel angle, a share."""
    _, yaw = plots.yaw_step(model_named(name), RIG, speed, 20.0, STEP_ANGLE)
    return float(yaw[:, 0].max() / yaw[-1, 0] - 1.0)


def path(speed: float, seconds: float, planar: bool) -> Array:
    """x, y of the tractor's CG after a step of STEP_ANGLE, shape (n, 2).

    The dissertation's: the linear model's velocities along a path with sines and cosines (3.102a, 3.103a).
    With planar=True the nonlinear model's.
    """
    n = 600
    dt = seconds / n
    if planar:
        x0 = nonlinear.running(speed, delta=STEP_ANGLE)
        inputs = nonlinear.inputs_of(n, delta=STEP_ANGLE, speed=speed)
        return nonlinear.simulate(RIG, inputs, x0, dt)[:, :2]
    model = model_named("relaxation")
    inputs = np.zeros((n, len(model.inputs)))
    inputs[:, 0] = STEP_ANGLE
    states = linear.simulate(model, RIG, speed, inputs, np.zeros(len(model.states)), dt)
    v, heading = states[:, model.states.index("v")], states[:, model.states.index("psi_t")]
    rate = np.column_stack(
        [speed * np.cos(heading) - v * np.sin(heading), speed * np.sin(heading) + v * np.cos(heading)]
    )
    moved = np.cumsum((rate[1:] + rate[:-1]) * (dt / 2), axis=0)
    return np.vstack([np.zeros(2), moved])


def radius(speed: float, planar: bool) -> float:
    """Of the circle that the path ends in, m: from its last third."""
    points = path(speed, 40.0, planar)[400:]
    columns = np.column_stack([2 * points, np.ones(len(points))])
    centre_x, centre_y, rest = np.linalg.lstsq(columns, np.sum(points**2, axis=1), rcond=None)[0]
    return float(math.sqrt(rest + centre_x**2 + centre_y**2))


def steady_lines() -> list[ComparedFigure]:
    """Sections 3.2 and 3.6, figures 3.6 and 3.7."""
    last = {model.name: [_last_yaw(model.name, u) for u in SPEEDS] for model in LINEAR}
    closed = [math.degrees(steady_yaw("dynamic", u) * STEP_ANGLE) for u in SPEEDS]
    gap = max(abs(r - d) for r, d in zip(last["relaxation"], last["dynamic"], strict=True))
    over = step_overshoot("relaxation", 1.0)
    circles = [radius(u, False) for u in SPEEDS]
    gradient, limit = linear.understeer_gradient(RIG), linear.characteristic_speed(RIG)
    return [
        claim("3.21", "implement, kinematic, 4.5 m/s: its own eigenvalue, and its zero", "−u/L^i and +u/l",
              f"{number(moving('kinematic', 4.5)[0].real, 3)} = −4.5/3.72; no response at s = 4.5/0.9",
              _at_zero() < 1e-12),
        claim("3.6, figure 3.6", "yaw rate after 10°, dynamic and relaxation at 1.0, 4.5, 7.5 m/s",
              "the same in the end",
              f"{_listed(closed, 2)} °/s by 3.126 to 3.128 and in both models after 30 s", gap < 1e-3),
        claim("figure 3.6", "the same, kinematic", "constant from the start",
              f"{_listed(last['kinematic'], 2)} °/s", step_overshoot("kinematic", 4.5) < 1e-9),
        claim("figure 3.6 a", "relaxation, 1.0 m/s: yaw rate", "substantially underdamped",
              f"{100 * over:.0f} % overshoot", over > 0.25),
        claim("3.6", "yaw rate in the end as the speed rises, all three", "increases", "increases",
              all(values == sorted(values) for values in last.values())),
        claim("3.6, figure 3.7", "radius after 10° at 1.0, 4.5, 7.5 m/s", "increases: understeer",
              f"{_listed(circles, 2)} m; understeer gradient {number(math.degrees(gradient), 3)} ° s²/m, "
              f"characteristic speed {number(limit, 1)} m/s", circles == sorted(circles) and limit > 0,
              "the nonlinear model, with its sines, load transfer and tyres that saturate, turns with "
              f"{_listed([radius(u, True) for u in SPEEDS], 2)} m"),
    ]  # fmt: skip


def _last_yaw(name: str, speed: float) -> float:
    """Yaw rate of the tractor 30 s after the step, °/s."""
    return math.degrees(plots.yaw_step(model_named(name), RIG, speed, 30.0, STEP_ANGLE)[1][-1, 0])


def _listed(values: Sequence[float], digits: int) -> str:
    return ", ".join(number(value, digits) for value in values)


def _at_zero() -> float:
    """Size of the kinematic implement's response at s = u/l."""
    sys = system(model_named("kinematic"), RIG, 4.5, outputs=("psi_i",))
    s = 4.5 / (RIG.c - RIG.b)
    return float(abs(sys.c @ np.linalg.solve(s * np.eye(3) - sys.a, sys.b[:, :1]))[0, 0])


def response(name: str, speed: float, omega: Array, rig: Rig = RIG) -> Complex:
    """Both yaw rates over the wheel angle, shape (len(omega), 2)."""
    return linear.frequency_response(system(model_named(name), rig, speed), omega)[:, :, 0]


def peak(speed: float, rig: Rig = RIG, body: str = "tractor") -> tuple[float, float]:
    """Frequency (rad/s) of the relaxation model's largest yaw-rate gain, and its height over DC, dB."""
    gain = decibel(response("relaxation", speed, OMEGA, rig))[:, BODIES[body]]
    top = int(np.argmax(gain))
    return float(OMEGA[top]), float(gain[top] - 20 * math.log10(steady_yaw("relaxation", speed, rig)))


def crossing(value: Array, level: float) -> float:
    """Frequency of OMEGA, rad/s, at which a falling value goes below a level; infinite where it does not."""
    below = np.flatnonzero(value < level)
    return float(OMEGA[below[0]]) if len(below) else math.inf


def lag(name: str, speed: float, body: str) -> Array:
    """Unwrapped phase at OMEGA, degrees, shape (n,)."""
    return np.asarray(np.degrees(np.unwrap(np.angle(response(name, speed, OMEGA)[:, BODIES[body]]))))


def gain_lines() -> list[ComparedFigure]:
    """Section 5.3.1, figures 5.4 to 5.6: low frequencies, kinematic and dynamic."""
    dc = {u: {m.name: 20 * math.log10(steady_yaw(m.name, u)) for m in LINEAR} for u in (*FIELD_SPEEDS, 7.5)}
    ends: Array = np.array([0.05, 0.6])
    drop = max(
        abs(float(np.diff(decibel(response(m.name, u, ends))[:, 0])[0])) for m in LINEAR for u in FIELD_SPEEDS
    )
    gains = {u: decibel(response("dynamic", u, OMEGA))[:, 0] for u in dc}
    cut = [crossing(gains[u], dc[u]["dynamic"] - 3.01) for u in dc]
    loss = [float(np.interp(5.0, OMEGA, gains[u])) - dc[u]["dynamic"] for u in FIELD_SPEEDS]
    lags = [lag("kinematic", u, "implement") for u in FIELD_SPEEDS]
    band = "; ".join(f"{number(crossing(x, -10.0), 2)} to {number(crossing(x, -170.0), 1)}" for x in lags)
    return [
        figures("5.3.1", "DC gain at 1.0, 2.5, 4.5 m/s, dB: kinematic", [-9.0, 0.0, 3.8],
                [dc[u]["kinematic"] for u in FIELD_SPEEDS], digits=1,
                why="20 log(u/L^t) leaves no choice, and 0 dB at 2.5 m/s would need a wheelbase of 2.5 m; "
                "the first two are presumably read off a figure. Dynamic and relaxation: "
                + _listed([dc[u]["dynamic"] for u in FIELD_SPEEDS], 2)),
        claim("5.3.1", "tractor, all three: gain up to 0.6 rad/s", "that of DC",
              f"within {number(drop, 2)} dB", drop < 0.1),
        claim("5.3.1", "dynamic, tractor: cut-off frequency", "about 5 rad/s",
              f"−3 dB at {_listed(cut[:3], 1)} rad/s at 1.0, 2.5, 4.5 m/s", abs(cut[2] - 5.0) < 1.0,
              f"at 5 rad/s the gain has lost {_listed([-x for x in loss], 2)} dB; the cut-off falls with "
              f"speed and is {number(cut[3], 1)} rad/s at 7.5 m/s"),
        claim("5.3.1", "kinematic: band in which the implement's lag grows", "about 0.1 to 10 rad/s",
              f"{band} rad/s at 1.0, 2.5, 4.5 m/s", 0.5 < crossing(lags[1], -10.0) / 0.1 < 2.0,
              "taken as from 10° to 170°; the lag stays at 180° beyond"),
    ]  # fmt: skip


def resonance_lines() -> list[ComparedFigure]:
    """Section 5.3.1, figures 5.4 to 5.6: relaxation."""
    peaks, other = [peak(u) for u in FIELD_SPEEDS], [peak(u, TABLE_7_2)[0] for u in FIELD_SPEEDS]
    heights = [height for _, height in peaks]
    behind = [peak(u, RIG, "implement")[0] for u in FIELD_SPEEDS[:2]]
    phase = lag("relaxation", 4.5, "implement")
    late = crossing(phase, -200.0)
    gain = float(decibel(response("relaxation", 4.5, np.array([late])))[0, 1])
    return [
        figures("5.3.1", "relaxation: resonance of the tractor at 1.0, 2.5, 4.5 m/s, rad/s", [5.0] * 3,
                [omega for omega, _ in peaks], digits=0, within=1.5,
                why="the print is nearer to what the relaxation lengths of Table 7.2 give, "
                + _listed(other, 1)),
        claim("5.3.1", "its height over DC as the speed rises", "decreases", _listed(heights, 1) + " dB",
              heights == sorted(heights, reverse=True)),
        claim("5.3.1", "relaxation: resonance of the implement", "the same frequency",
              f"{_listed(behind, 1)} rad/s at 1.0, 2.5 m/s; at 4.5 m/s it is not above DC",
              abs(behind[0] / peaks[0][0] - 1.0) < 0.1, "its own pairs lie higher than the tractor's"),
        claim("5.3.1", "relaxation, implement, 4.5 m/s: lag while the gain is above 0 dB",
              "about 200° at about 1.0 rad/s",
              f"200° at {number(late, 1)} rad/s, where the gain is {number(gain, 1)} dB; "
              f"{number(-float(np.interp(1.0, OMEGA, phase)), 0)}° at 1.0 rad/s", abs(late - 1.0) < 0.5,
              "it is at the resonance, near 5 rad/s, that this happens; no model lags by 200° at 1.0 rad/s"),
    ]  # fmt: skip


def agreement_lines() -> list[ComparedFigure]:
    """Abstract and section 5.5: where the models agree and where they part."""
    names = [model.name for model in LINEAR]
    low = [spread(u, 0.2, body, names) for u in FIELD_SPEEDS for body in BODIES]
    fast = [spread(7.5, 0.2, body, names) for body in BODIES]
    high = [spread(u, 1.0, body, names) for u in (*FIELD_SPEEDS, 7.5) for body in BODIES]
    slow = [spread(u, 1.0 / (2 * math.pi), body, names[:2]) for u in FIELD_SPEEDS for body in BODIES]
    return [
        claim("abstract", "all three at 0.2 Hz, up to 4.5 m/s", "similar", f"within {_most(low)}",
              max(g for g, _ in low) < 1.0 and max(p for _, p in low) < 15.0,
              f"at 7.5 m/s within {_most(fast)}"),
        claim("abstract", "all three at 1 Hz", "vary substantially",
              f"apart by {min(g for g, _ in high):.1f} to {_most(high)}", min(p for _, p in high) > 45.0),
        claim("5.5", "kinematic and dynamic up to 4.5 m/s and 1 rad/s", "equally good",
              f"within {_most(slow)}", max(g for g, _ in slow) < 1.0),
    ]  # fmt: skip


def _most(apart: Sequence[tuple[float, float]]) -> str:
    return f"{number(max(g for g, _ in apart), 1)} dB and {number(max(p for _, p in apart), 0)}°"


def frequency_table(speed: float, body: str) -> str:
    """Gain and phase of the three models at HERTZ, in Markdown."""
    omega = 2 * np.pi * np.array(HERTZ)
    rows = []
    for model in LINEAR:
        found = response(model.name, speed, omega)[:, BODIES[body]]
        gain, phase = decibel(found), np.degrees(np.unwrap(np.angle(found)))
        rows.append(
            [model.name, *(f"{number(g, 2)}, {number(p, 1)}" for g, p in zip(gain, phase, strict=True))]
        )
    return table([f"{speed} m/s, {body}", *(f"{hz} Hz" for hz in HERTZ)], rows)


def spread(speed: float, hertz: float, body: str, names: Sequence[str]) -> tuple[float, float]:
    """Largest difference of gain (dB) and of phase (°) between those models at a frequency."""
    omega = 2 * np.pi * np.linspace(0.01, hertz, 100)
    found = np.array([response(name, speed, omega)[:, BODIES[body]] for name in names])
    gain, phase = decibel(found), np.degrees(np.unwrap(np.angle(found), axis=1))
    return float(np.ptp(gain, axis=0)[-1]), float(np.ptp(phase, axis=0)[-1])


def spread_table() -> str:
    """How far the three models lie apart, in Markdown."""
    names = [model.name for model in LINEAR]
    rows = []
    for speed in (*FIELD_SPEEDS, 7.5):
        for body in BODIES:
            apart = [spread(speed, hz, body, names) for hz in HERTZ]
            rows.append([f"{speed} m/s, {body}", *(f"{number(g, 2)}, {number(p, 1)}" for g, p in apart)])
    return table(["dB, °", *(f"{hz} Hz" for hz in HERTZ)], rows)
