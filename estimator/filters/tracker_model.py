"""Propagation of the tracker's state over one tick, and its Jacobians.

The states x, shape (16,), are those of states.py. Together with the active ones of unknowns.NAMES, which are
constant, they are the joint state, shape (n,).

The model is the nonlinear one. Its Jacobians are renewed every few ticks; with them the mean takes one step
per tick (exponential integrator), which is exact for a linear model.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.compiled import kernel
from tilth.estimator.filters.propagation import (
    Plant,
    plant_rates,
    position_jacobian,
    propagate_position,
    rig_at,
    roll_at,
)
from tilth.estimator.filters.rig_setup import RigSetup
from tilth.estimator.filters.states import (
    DT,
    N_TRACKER,
    X_POSITION,
    X_PSI,
    X_PUSH,
    X_R,
    X_SLOPE,
    X_UNEVEN,
    X_V,
    Places,
    Point,
)
from tilth.estimator.filters.unknowns import (
    AT_CG,
    AT_CURVATURE,
    AT_GEOMETRY,
    AT_LATENCY,
    AT_ROLL_MODES,
    AT_ROLLING,
    AT_WHEEL_GAIN,
    AT_WHEEL_ZERO,
)
from tilth.estimator.filters.unknowns import geometry as geometry_at

Array = NDArray[np.float64]

NUDGE: Final = 1e-5  # step of the differences, in the unit of each state or unknown


class Active(NamedTuple):
    """The unknowns that are estimated."""

    places: Places  # (a,), indices into unknowns.NAMES
    geometry: Array  # (a, 9), derivative of the geometry by each


class DriveInputs(NamedTuple):
    """Inputs of the rig in the middle of a tick."""

    u: float  # m/s
    wheel: float  # true wheel angle, rad
    wheel_rate: float  # its rate, rad/s
    gravity_t: float  # across the tractor, m/s^2
    gravity_i: float
    wheel_scale: float  # true wheel angle over reading


class RateJacobians(NamedTuple):
    """Jacobians of the rates of the states before X_PUSH, and work arrays."""

    x: Array  # (8, 11), over the states before X_POSITION
    wheel: Array  # (8,), over the true wheel angle
    unknowns: Array  # (8, a), over the active unknowns
    rates: Array  # (8,), the rates themselves
    nudged: Array  # (8,), overwritten


class Transition(NamedTuple):
    """Transition of x over one tick, linearised."""

    held: Array  # (8, 8), change of the states before X_PUSH per rate that is held over the tick
    decay: Array  # (8,), factor on the states from X_PUSH on
    wheel: Array  # (8,), change of the states before X_PUSH per rad of true wheel angle
    F: Array  # (16, n), Jacobian of x one tick later over the joint state
    F_T: Array  # (n, 16)


@kernel
def state_rates(x: Array, drive: DriveInputs, plant: Plant, out: Array) -> None:
    """Fill out (8,), the rates of the states before X_PUSH."""
    plant.w[0] = drive.wheel
    plant.w[1], plant.w[2] = x[X_PUSH] + x[X_SLOPE], x[X_PUSH + 1] + x[X_SLOPE + 1]
    plant.w[9], plant.w[10] = x[X_UNEVEN], x[X_UNEVEN + 1]
    plant_rates(x, drive.u, plant)
    for i in range(X_PSI):
        out[i] = plant.rates[5 + i]
    out[X_R] += x[X_PUSH + 2]
    out[X_PSI], out[X_PSI + 1] = x[X_R], x[X_R + 1]


@kernel
def rate_jacobians(
    x: Array,
    drive: DriveInputs,
    point: Point,
    plant: Plant,
    setup: RigSetup,
    active: Active,
    out: RateJacobians,
) -> None:
    """Fill out, by differences. rig: that of the machine file, from which the plant was made."""
    base, nudged_rate = out.rates, out.nudged
    state_rates(x, drive, plant, base)
    at = x.copy()
    for j in range(X_POSITION):
        if j == X_PSI + 1 or X_PUSH + 2 <= j < X_UNEVEN:
            continue  # of the headings only the difference matters
        at[j] += NUDGE
        state_rates(at, drive, plant, nudged_rate)
        at[j] = x[j]
        for i in range(X_PUSH):
            out.x[i, j] = (nudged_rate[i] - base[i]) / NUDGE
    for i in range(X_PUSH):
        out.x[i, X_PSI + 1] = -out.x[i, X_PSI]
        out.x[i, X_PUSH + 2] = 1.0 if i == X_R else 0.0
        out.x[i, X_SLOPE], out.x[i, X_SLOPE + 1] = out.x[i, X_PUSH], out.x[i, X_PUSH + 1]
    nudged_drive = DriveInputs(
        drive.u, drive.wheel + NUDGE, drive.wheel_rate, drive.gravity_t, drive.gravity_i, drive.wheel_scale
    )
    state_rates(x, nudged_drive, plant, nudged_rate)
    for i in range(X_PUSH):
        out.wheel[i] = (nudged_rate[i] - base[i]) / NUDGE
    for j in range(active.places.shape[0]):
        depends = nudged_rates(x, drive, point, plant, setup, active, j, nudged_rate)
        for i in range(X_PUSH):
            out.unknowns[i, j] = (nudged_rate[i] - base[i]) / NUDGE if depends else 0.0


@kernel
def nudged_rates(
    x: Array,
    drive: DriveInputs,
    point: Point,
    plant: Plant,
    setup: RigSetup,
    active: Active,
    j: int,
    out: Array,
) -> bool:
    """Fill out (8,), the rates with the j-th active unknown nudged; whether they depend on it."""
    place, rig = active.places[j], setup.rig
    theta, nudged_rig, roll = plant.theta, plant.rig, plant.roll
    rolling, curvature = point.unknowns[AT_ROLLING], point.unknowns[AT_CURVATURE]
    if place < 6:
        theta = plant.theta.copy()
        theta[place] = plant.theta[place] * (1.0 + NUDGE)
    elif AT_ROLL_MODES <= place < AT_ROLL_MODES + 7:
        nudged = point.unknowns.copy()
        nudged[place] += NUDGE
        roll = roll_at(setup.roll, nudged)
    elif place == AT_ROLLING:
        nudged_rig = rig_at(rig, point.geometry, rolling + NUDGE, curvature)
    elif place == AT_CURVATURE:
        nudged_rig = rig_at(rig, point.geometry, rolling, curvature + NUDGE)
    elif place >= AT_GEOMETRY or place == AT_CG or place == AT_CG + 1:
        geometry = point.geometry.copy()
        for i in range(9):
            geometry[i] = point.geometry[i] + NUDGE * active.geometry[j, i]
        nudged_rig = rig_at(rig, geometry, rolling, curvature)
    else:
        return False
    state_rates(
        x, drive, Plant(theta, nudged_rig, plant.x, plant.w, plant.forces, plant.rates, roll, plant.work), out
    )
    return True


@kernel
def geometry_jacobian(base: Array, unknowns: Array, geometry: Array, active: Active) -> None:
    """Fill active.geometry. base: the geometry of the machine file; geometry: that at the unknowns. Each
    (9,)."""
    for j in range(active.places.shape[0]):
        place = active.places[j]
        before = unknowns[place]
        unknowns[place] += NUDGE
        active.geometry[j] = (geometry_at(base, unknowns) - geometry) / NUDGE
        unknowns[place] = before


@kernel
def integrate_exponential(jacobian: Array, out: Array) -> None:
    """Fill out (8, 8): the integral of the Jacobian's matrix exponential over DT, by a power series."""
    A = jacobian[:, :X_PUSH].copy()
    power, factor = np.eye(X_PUSH), DT
    out[:] = DT * power
    for order in range(2, 5):
        power = power @ A
        factor *= DT / order
        out += factor * power


@kernel
def joint_jacobian(jacobians: RateJacobians, active: Active, step: Transition) -> None:
    """Fill step.F and step.wheel, except for what `complete_jacobian` adds."""
    held, F = step.held, step.F
    F[:, :] = 0.0
    for i in range(X_PUSH):
        for j in range(X_POSITION):
            total = 1.0 if i == j else 0.0
            for k in range(X_PUSH):
                total += held[i, k] * jacobians.x[k, j]
            F[i, j] = total
        step.wheel[i] = 0.0
        for k in range(X_PUSH):
            step.wheel[i] += held[i, k] * jacobians.wheel[k]
        for j in range(active.places.shape[0]):
            for k in range(X_PSI):
                F[i, N_TRACKER + j] += held[i, k] * jacobians.unknowns[k, j]
    for i in range(X_PUSH, N_TRACKER):
        F[i, i] = step.decay[i - X_PUSH]


@kernel
def complete_jacobian(
    x: Array, following: Array, drive: DriveInputs, active: Active, step: Transition
) -> None:
    """Complete step.F for one tick: rows of the position, columns of wheel zero, gain and latency; fill
    step.F_T.

    x, following: (16,), the state before and after the tick.
    """
    F, F_T = step.F, step.F_T
    for j in range(active.places.shape[0]):
        place = active.places[j]
        if AT_WHEEL_ZERO <= place <= AT_LATENCY:
            factor = -drive.wheel_rate
            if place == AT_WHEEL_ZERO:
                factor = -drive.wheel_scale
            elif place == AT_WHEEL_GAIN:
                factor = -drive.wheel
            for i in range(X_PUSH):
                F[i, N_TRACKER + j] = factor * step.wheel[i]
    psi, v = 0.5 * (x[X_PSI] + following[X_PSI]), 0.5 * (x[X_V] + following[X_V])
    position_jacobian(drive.u, psi, v, F.shape[1], F)
    F[X_POSITION, X_POSITION] = F[X_POSITION + 1, X_POSITION + 1] = 1.0
    for i in range(N_TRACKER):
        for j in range(F.shape[1]):
            F_T[j, i] = F[i, j]


@kernel
def propagate_mean(x: Array, u: float, rates: Array, step: Transition, out: Array) -> None:
    """Fill out (16,), the state one tick later. rates: (8,), of the states before X_PUSH."""
    for i in range(X_PUSH):
        total = x[i]
        for j in range(X_PUSH):
            total += step.held[i, j] * rates[j]
        out[i] = total
    for i in range(X_PUSH, N_TRACKER):
        out[i] = step.decay[i - X_PUSH] * x[i]
    propagate_position(x, u, out)
