"""What chapters 3 and 5 of the dissertation print, what is right, and what the printed form would give."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from studies.dissertation.compared import number, pole
from studies.dissertation.open_loop import peak, poles_of
from tilth.estimator.models import dynamic, nonlinear, relaxation
from tilth.estimator.models import linear_analysis as linear
from tilth.estimator.models.actuator import BOSSERD
from tilth.estimator.models.family import model_named
from tilth.estimator.models.linear_analysis import Array, dominant, eigenvalues, system
from tilth.estimator.models.parameters import TABLE_5_1, TABLE_7_2, Rig
from tilth.estimator.models.regulator import regulator

RIG = TABLE_5_1
SPEED = 4.5  # m/s
ANGLE = 1e-3  # rad, of the long simulation


class Erratum(NamedTuple):
    """One place. `settles` says which of the two a computation bears out, with its numbers."""

    where: str
    printed: str
    right: str
    settles: str


def simulated_yaw() -> float:
    """Yaw rate per rad after 40 s of the nonlinear model, 1/s: another way than 3.126-3.128."""
    smooth = RIG._replace(roll_f=0.0, roll_r=0.0, roll_i=0.0)
    inputs = nonlinear.inputs_of(2000, delta=ANGLE, speed=SPEED)
    states = nonlinear.simulate(smooth, inputs, nonlinear.running(SPEED, delta=ANGLE), 0.02)
    return float(states[-1, nonlinear.STATES.index("r_t")] / ANGLE)


def dynamic_with(row: int, column: int, change: float, mass: float = 0.0) -> tuple[Array, Array]:
    """(A, B) of the dynamic model with `change` added to an entry of N, or `mass` to the same one of M."""
    args = (SPEED, RIG.geometry, RIG.theta)
    inertia = dynamic.inertia(RIG.geometry)
    a, b = dynamic.system_matrix(*args), dynamic.input_matrix(*args)
    forces, steering = inertia @ a[:3], inertia @ b[:3]
    forces[row, column] += change
    inertia[row, column] += mass
    a[:3], b[:3] = np.linalg.solve(inertia, forces), np.linalg.solve(inertia, steering)
    return a, b


def steady_yaw(a: Array, b: Array) -> float:
    """Yaw rate per rad in a steady turn of the dynamic model, 1/s: v, one yaw rate, and the articulation."""
    columns = np.column_stack([a[:3, 0], a[:3, 1] + a[:3, 2], a[:3, 4]])
    return float(np.linalg.solve(columns, -b[:3, 0])[1])


def printed_3_121() -> Array:
    """A of the relaxation model with c C_αf where c C_αi belongs."""
    a = relaxation.system_matrix(SPEED, RIG.geometry, RIG.theta)
    inertia = dynamic.inertia(RIG.geometry)
    forces = inertia @ a[:3]
    forces[1, relaxation.STATES.index("alpha_i")] = RIG.c * RIG.C_af
    a[:3] = np.linalg.solve(inertia, forces)
    return a


def relaxation_yaw(a: Array) -> float:
    """Yaw rate per rad in a steady turn of the relaxation model, 1/s."""
    b = relaxation.input_matrix(SPEED, RIG.geometry, RIG.theta)[:, 0]
    columns = np.column_stack([a[:6, 0], a[:6, 1] + a[:6, 2], a[:6, 3:6], a[:6, 7]])
    return float(np.linalg.solve(columns, -b[:6])[1])


def lateral_gain() -> float:
    """Size of the kinematic response Y/Δ at 1 rad/s, m."""
    sys = system(model_named("kinematic"), RIG, SPEED, outputs=("psi_t",))
    sys = sys._replace(outputs=("y_t",), c=np.eye(3)[:1], d=np.zeros((1, 3)))
    return float(abs(linear.frequency_response(sys, np.array([1.0]))[0, 0, 0]))


def errata() -> list[Erratum]:
    """Rows of chapters 3 and 5, in the order of the text."""
    return [*_of_chapter_3(), *_of_chapter_5()]


def _of_chapter_3() -> list[Erratum]:
    right, held = float(linear.steady_gains(RIG, SPEED)[1]), simulated_yaw()
    mixed = steady_yaw(*dynamic_with(1, 1, RIG.m_i * RIG.c * (1.0 - SPEED)))
    wrong_inertia = eigenvalues(dynamic_with(2, 2, 0.0, RIG.I_t - RIG.I_i)[0])
    wrong, sound = printed_3_121(), relaxation.system_matrix(SPEED, RIG.geometry, RIG.theta)
    return [
        Erratum("3.20", "Y/Δ = u/(L s²)", "u²/(L s²)",
                f"at 1 rad/s and 4.5 m/s 3.9 and 3.10 give {number(lateral_gain(), 3)} m; u²/L is "
                f"{number(SPEED**2 / RIG.wheelbase, 3)}, u/L {number(SPEED / RIG.wheelbase, 3)}"),
        Erratum("3.98, first line", "I_z^t", "I_z^i",
                f"with I_z^t the dynamic model's fast eigenvalues at 4.5 m/s are {_fast(wrong_inertia)}, "
                f"with I_z^i {_fast(poles_of('dynamic', SPEED))}; 5.3.1 has −7.5 for the slowest of them"),
        Erratum("3.121, row 2 of N", "c C_αf in the implement's column", "c C_αi",
                f"a turn at 4.5 m/s: {number(relaxation_yaw(wrong), 3)} 1/s as printed, "
                f"{number(relaxation_yaw(sound), 3)} as right, {number(right, 3)} by 3.126 to 3.128; "
                f"dominant eigenvalue {pole(dominant(eigenvalues(wrong)))} and "
                f"{pole(dominant(eigenvalues(sound)))}"),
        Erratum("3.122, 5.33", "δ″ = +(d/I) δ′ + (K/I) u", "δ″ = −(d/I) δ′ + (K/I) u", _of_the_actuator()),
        Erratum("number 3.122", "the actuator and the first steady-state equation", "two equations", "–"),
        Erratum("3.127 (7.13)", "m^i c u beside c(d+e)C_αi", "m^i c u², inside the bracket of the yaw rate",
                f"a turn at 4.5 m/s: {number(mixed, 4)} 1/s as printed, {number(right, 4)} as right, "
                f"{number(held, 4)} after 40 s of the nonlinear model"),
    ]  # fmt: skip


def _of_the_actuator() -> str:
    flipped = BOSSERD._replace(damping=-BOSSERD.damping)
    systems = [system(model_named("dynamic"), RIG, SPEED, actuator=act) for act in (BOSSERD, flipped)]
    sound, wrong = map(regulator, systems)
    assert np.allclose(sound.poles, wrong.poles, atol=1e-6)
    return (
        "as printed the valve alone has an eigenvalue at +10 1/s instead of the time constant of 0.1 s that "
        "5.2.3 states. The closed-loop poles do not tell: a regulator mirrors an unstable pole, and those of "
        f"the dynamic model at 4.5 m/s are the same either way, dominant {pole(dominant(sound.poles), 4)}; "
        f"only the gain on δ′ differs, {number(sound.gain[-1], 3)} and {number(wrong.gain[-1], 3)}"
    )


def _of_chapter_5() -> list[Erratum]:
    found = poles_of("relaxation", SPEED)
    return [
        Erratum("5.3.1, dynamic at 7.5 m/s", "−1.4 ± 1.2j", "−3.39 ± 1.24j",
                "computed: " + pole(dominant(poles_of("dynamic", 7.5)), 3)),
        Erratum("figure 5.3 c, caption", "three eigenvalues at the origin, all real",
                "two at the origin, three pairs",
                f"at 4.5 m/s {int(np.sum(found == 0))} at the origin and {int(np.sum(found.imag > 0))} "
                "pairs; the section's text says so, too"),
        Erratum("Tables 5.1 and 7.2", "relaxation lengths 0.75, 1.0, 0.75 m and 1.1, 1.5, 1.1 m",
                "both, each for its chapters",
                f"two machine files; the tractor's resonance at 1.0, 2.5, 4.5 m/s is at {_peaks(RIG)} rad/s "
                f"with the first and at {_peaks(TABLE_7_2)} rad/s with the second"),
    ]  # fmt: skip


def errata_table(rows: Iterable[Erratum]) -> str:
    """In Markdown."""
    return "\n".join(
        "| " + " | ".join(row) + " |"
        for row in (("where", "printed", "right", "what computation says"), ("---",) * 4, *rows)
    )


def _fast(poles: linear.Complex) -> str:
    return ", ".join(pole(p, 1) for p in poles if p.real < -2.0 and p.imag >= 0)


def _peaks(rig: Rig) -> str:
    return ", ".join(number(peak(u, rig)[0], 1) for u in (1.0, 2.5, 4.5))
