"""Predicted measurements in a steady turn, as a function of all that is not known exactly, and their
Jacobians.

A steady turn is a state of the filters' motion model (filters/propagation.py) in which nothing changes any
more but the articulation. Newton's method finds it, from straight driving on, by the exact slopes of that
model. They also tell how the turn changes with constants and inputs: implicit differentiation.

A tractor is in its turn within a second or two; the implement behind it needs several times as long. So how
fast the rig folds is an input. It fades as that of a towed axle without slip behind a tractor that is nearly
in line, which is close enough for what is left of it. Measured roll is cross slope and lean; the lean is
solved for, and the rest is slope.
"""

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.filters import unknowns
from tilth.estimator.filters.propagation import (
    P_GEOMETRY,
    P_SLIP_DEPENDENCE,
    Plant,
    empty_plant,
    rate_jacobians,
    set_plant,
)
from tilth.estimator.filters.rig_setup import rig_setup
from tilth.estimator.filters.sensors.wheel_angle import DriveInputs, driven_by, set_wheel_slopes
from tilth.estimator.filters.states import N_STATES, X_ALPHA, X_BANK, X_PSI, X_R, X_ROLL, X_SPEED, X_V
from tilth.estimator.filters.transition import Transition, empty_transition
from tilth.estimator.record.steady_driving import SteadySample
from tilth.estimator.tuning import tuned
from tilth.schemas.machine import Machine
from tilth.schemas.plausible import GRAVITY

Array = NDArray[np.float64]

CONSTANTS: Final = (
    "C_af", "C_ar", "C_ai", "wheel_zero", "wheel_gain", "pair_t", "pair_i", "lever_t", "cg_t", "cg_i",
    "rolling", "roll_k_t", "roll_k_i", "camber", "curvature", "parallel", "two_track", "a", "b", "c", "d",
    "e", "m_t", "m_i",
)  # fmt: skip
"""The constants that a steady turn depends on, as in unknowns.NAMES. A lever of the implement's antennas has
no effect on OUTPUTS."""
INPUTS: Final = ("u", "wheel_angle", "roll_t", "roll_i", "folding")
"""m/s; rad, as the sensor reads it; measured rolls, rad; rate of the articulation, rad/s."""
OUTPUTS: Final = ("yaw_rate", "articulation", "lateral_velocity")
KERNELS: Final = (driven_by, set_plant, rate_jacobians, set_wheel_slopes)  # that the functions below call


@dataclass(frozen=True, slots=True)
class SteadyOutputsTuning:
    """Newton's method for steady motions."""

    most_steps: int = tuned(20, "steps", "it takes four or five")
    longest_step: float = tuned(0.5, "m/s, rad/s, rad", "of one state")
    exact: float = tuned(1e-9, "m/s, rad/s, rad", "a step so small is the last")


STEADY_OUTPUTS: Final = SteadyOutputsTuning()


AT: Final = {name: k for k, name in enumerate(CONSTANTS)}
PLACES: Final = np.array([unknowns.AT[name] for name in CONSTANTS])
SLIPS: Final = slice(X_ALPHA, X_ALPHA + 3)
LEANS: Final = slice(X_ROLL, X_ROLL + 2)
BANK_STATES: Final = slice(X_BANK, X_BANK + 2)
TURN: Final = np.r_[X_V, X_R, SLIPS, LEANS, X_PSI]
"""The states that are solved for. The implement's yaw rate and the slopes follow from them; psi_i is 0."""
LENGTH: Final = slice(P_GEOMETRY + 3, P_GEOMETRY + 5)  # d and e
STEADY: Final = np.r_[X_V, X_R, SLIPS, X_ROLL + 2, X_ROLL + 3, X_R + 1]
"""The states whose rates are 0, and as the last one r_i, whose rate follows from the folding."""


class _Model(NamedTuple):
    """The motion model at a point of CONSTANTS with its INPUTS; its rates and their slopes at a state."""

    plant: Plant
    step: Transition
    x: Array  # (30,), the state
    drive: DriveInputs
    rolls: Array  # (2,), measured, rad
    folding: float  # rad/s
    length: float  # from the hitch to the implement's axle, m


def _model(point: Array, inputs: Array, machine: Machine) -> _Model:
    """At rest. point: (24,), CONSTANTS; inputs: (5,), INPUTS."""
    setup, (at, _) = rig_setup(machine), unknowns.prior(machine)
    at[PLACES] = point
    n, (u, reading, *_, folding) = len(PLACES), inputs.tolist()
    plant, drive = empty_plant(setup, n), driven_by(u, 0.0, reading, 0.0, at)
    set_plant(plant, at, setup, PLACES)
    length, step = float(plant.p[LENGTH].sum()), empty_transition(n, 0, 1)
    set_wheel_slopes(drive, at, step.wheel_unknowns)
    return _Model(plant, step, np.zeros(N_STATES), drive, inputs[2:4], folding, length)


def _imbalance(model: _Model) -> tuple[Array, Array, Array]:
    """(What is left of the rates of STEADY, (8,), its slopes by TURN, (8, 8), and by measured roll, (8, 2)).

    Sets the states that follow from TURN, and the slopes of the motion model.
    """
    x, step, slope = model.x, model.step, model.rolls - model.x[LEANS]
    x[X_R + 1], x[BANK_STATES] = x[X_R] - model.folding, GRAVITY * np.sin(slope)
    rate_jacobians(x, model.drive, model.plant, step)
    left, by_x = step.rates[STEADY], step.rates_x[STEADY]
    left[-1] -= model.folding * model.drive.u / model.length
    by_turn, by_rolls = by_x[:, TURN], by_x[:, BANK_STATES] * GRAVITY * np.cos(slope)
    by_turn[:, 1] += by_x[:, X_R + 1]  # r_i goes with r_t,
    by_turn[:, 5:7] -= by_rolls  # and where a body leans more, there is less slope
    return left, by_turn, by_rolls


def _solved(point: Array, inputs: Array, machine: Machine) -> tuple[_Model, Array, Array]:
    """(The model in its steady turn, slopes as of `_imbalance`). Raises as `outputs`."""
    model = _model(point, inputs, machine)
    for _ in range(STEADY_OUTPUTS.most_steps):
        left, by_turn, by_rolls = _imbalance(model)
        step = np.linalg.solve(by_turn, left)
        longest = float(np.abs(step).max())
        if not np.isfinite(longest):
            break
        model.x[TURN] -= step * min(1.0, STEADY_OUTPUTS.longest_step / max(longest, STEADY_OUTPUTS.exact))
        if longest < STEADY_OUTPUTS.exact:
            return model, by_turn, by_rolls
    raise np.linalg.LinAlgError("no steady turn was found")


def _seen(model: _Model, point: Array) -> Array:
    """OUTPUTS, (3,)."""
    v, r, articulation = model.x[[X_V, X_R, X_PSI]]
    return np.array([r, articulation, v + r * (point[AT["lever_t"]] - point[AT["cg_t"]])])


def outputs(points: Array, inputs: Array, machine: Machine) -> Array:
    """OUTPUTS, shape [n, 3].

    points: [n, 23], CONSTANTS. inputs: [n, 5], INPUTS. The lateral velocity is that of the point where the
    machine file has the CG, computed from where it has the antennas, without the errors of the pairs. Raises
    numpy.linalg.LinAlgError if there is no steady turn.
    """
    rows = zip(points, inputs, strict=True)
    return np.array([_seen(_solved(point, row, machine)[0], point) for point, row in rows])


def prepare(machine: Machine) -> None:
    """Compile KERNELS: straight driving."""
    outputs(unknowns.prior(machine)[0][None, PLACES], np.array([[4.0, 0.0, 0.0, 0.0, 0.0]]), machine)


def inputs_of(sample: SteadySample) -> Array:
    """INPUTS, [5]."""
    return np.array([getattr(sample, name) for name in INPUTS])


def linearised(point: Array, sample: SteadySample, machine: Machine) -> tuple[Array, Array, Array]:
    """(OUTPUTS [3], their Jacobian over CONSTANTS [3, 23], and over INPUTS [3, 5]).

    point: [23], CONSTANTS. Raises as `outputs`.
    """
    model, by_turn, by_rolls = _solved(point, inputs_of(sample), machine)
    step, n, pace = model.step, len(point), model.drive.u / model.length
    by_wheel, by_constants = step.rates_wheel[STEADY], step.rates_unknowns[STEADY]
    by_constants += np.outer(by_wheel, step.wheel_unknowns[PLACES])
    by_constants[-1] += model.folding * pace / model.length * model.plant.p_unknowns[:, LENGTH].sum(axis=1)
    by_u, by_folding = step.rates_x[STEADY, X_SPEED], -step.rates_x[STEADY, X_R + 1]
    by_u[-1] -= model.folding / model.length
    by_folding[-1] -= pace
    known = np.column_stack(
        [by_constants, by_u, -step.wheel_unknowns[unknowns.AT["wheel_zero"]] * by_wheel, by_rolls, by_folding]
    )
    v, r, *_, articulation = -np.linalg.solve(by_turn, known)
    lever = point[AT["lever_t"]] - point[AT["cg_t"]]
    slope = np.array([r, articulation, v + lever * r])
    slope[2, AT["lever_t"]] += model.x[X_R]
    slope[2, AT["cg_t"]] -= model.x[X_R]
    return _seen(model, point), slope[:, :n], slope[:, n:]


def largest_slip(sample: SteadySample, zero: float, machine: Machine) -> float:
    """Largest measured slip angle of the three axles, rad; 0 without a lateral velocity.

    zero: reading of the wheel angle when straight, rad.
    """
    if sample.v is None:
        return 0.0
    point = unknowns.prior(machine)[0][PLACES]
    point[AT["wheel_zero"]] = zero
    model = _model(point, inputs_of(sample), machine)
    model.plant.p[P_SLIP_DEPENDENCE] = 0.0
    model.x[[X_V, X_R, X_PSI]] = sample.v, sample.yaw_rate, sample.articulation
    _imbalance(model)
    # A tyre that has not slipped yet: how fast its slip angle grows, over how fast it falls per tan of it.
    tangents = model.step.rates[SLIPS] / np.diag(model.step.rates_x[SLIPS, SLIPS])
    return float(np.abs(np.arctan(tangents)).max())
