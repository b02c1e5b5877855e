"""Propagates state and covariance over one tick: the filters' motion model.

The model is models.rolling. Its Jacobians, over the states and over any unknowns, are renewed every few
ticks; with them the mean takes one step per tick (exponential integrator), which is exact for a linear model.
The states x, shape (26,), are those of states.py. Together with the active ones of unknowns.NAMES, which are
constant, they are the joint state, shape (n,).
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.compiled import kernel
from tilth.estimator.filters.rig_setup import RigSetup
from tilth.estimator.filters.states import (
    ACROSS,
    ALONG,
    DT,
    N_STATES,
    PAIR_DECAY,
    SLOPE_LENGTH,
    START,
    START_PLACE,
    UNEVEN_LENGTH,
    X_ALPHA,
    X_PAIR,
    X_POSITION,
    X_PSI,
    X_PUSH,
    X_R,
    X_SLOPE,
    X_SLOPE_RATE,
    X_UNEVEN,
    X_V,
    Places,
    Point,
)
from tilth.estimator.filters.unknowns import (
    AT_CAMBER,
    AT_CG,
    AT_CURVATURE,
    AT_GEOMETRY,
    AT_HITCH,
    AT_LATENCY,
    AT_ROLL_MODES,
    AT_ROLLING,
    AT_SHRINK,
    AT_WHEEL_GAIN,
    AT_WHEEL_ZERO,
    N_ROLL_MODES,
)
from tilth.estimator.filters.unknowns import geometry as geometry_at
from tilth.estimator.models.parameters import Rig
from tilth.estimator.models.rolling import (
    HELD,
    N_INPUTS,
    N_ROLLING,
    UNEVEN,
    RollModes,
    RollWork,
    rates_rolling,
    roll_work,
)
from tilth.estimator.record.record import WHEEL_ANGLE, U

Array = NDArray[np.float64]

NUDGE: Final = 1e-5  # step of the differences, in the unit of each state or unknown
EVERY: Final = 5  # ticks for which one set of Jacobians is used
SLOWEST: Final = 1.0  # m/s: distances along the ground are driven at least as fast


class Plant(NamedTuple):
    """The motion model at one point of the unknowns, and its work arrays."""

    theta: Array  # (6,)
    rig: Rig
    roll: RollModes
    scale: float  # of all motions; as RigSetup.scale
    x: Array  # (15,), its state
    w: Array  # (12,), its inputs
    forces: Array  # (6, 3)
    rates: Array  # (15,), x'
    work: RollWork


class Active(NamedTuple):
    """The unknowns that are estimated."""

    places: Places  # (a,), indices into unknowns.NAMES
    geometry: Array  # (a, 9), derivative of the geometry by each


class DriveInputs(NamedTuple):
    """Inputs of the rig in the middle of a tick."""

    u: float  # m/s
    u_rate: float  # m/s^2
    wheel: float  # true wheel angle, rad
    wheel_rate: float  # its rate, rad/s
    wheel_scale: float  # true wheel angle over reading


class GroundNoise(NamedTuple):
    """Sds of what the ground does."""

    push: Array  # (3,), m/s^2, m/s^2, rad/s^2
    memory_s: float  # time constant of the pushes
    uneven: float  # rad


class Transition(NamedTuple):
    """Transition of x over one tick, linearised, and work arrays."""

    rates_x: Array  # (12, 21), Jacobian of the rates of the states before X_PUSH over those before X_POSITION
    rates_wheel: Array  # (12,), over the true wheel angle
    rates_unknowns: Array  # (12, a), over the active unknowns
    rates: Array  # (12,), the rates themselves
    nudged: Array  # (12,), overwritten
    held: Array  # (12, 12), change of the states before X_PUSH per rate that is held over the tick
    wheel: Array  # (12,), change of the states before X_PUSH per rad of true wheel angle
    decay: Array  # (26,), factor on the states from X_PUSH on
    q: Array  # (26,), variances of the process noise, without that of the position
    slope: Array  # (2, 3), transition of a cross slope and its rate, and covariances of their process noise
    F: Array  # (26, n), Jacobian of x one tick later over the joint state
    F_T: Array  # (n, 26)
    F_P: Array  # (26, 26 + a), overwritten


# The inputs and the rates.


@kernel
def wheel_angle_at(ticks: Array, k: int, behind: float) -> float:
    """The wheel's reading `behind` seconds before tick k (linear between ticks, held at the ends)."""
    n = ticks.shape[0]
    at = k - behind / DT
    if at <= 0.0:
        return float(ticks[0, WHEEL_ANGLE])
    if at >= n - 1:
        return float(ticks[n - 1, WHEEL_ANGLE])
    low = int(at)
    share = at - low
    return float(ticks[low, WHEEL_ANGLE] * (1.0 - share) + ticks[low + 1, WHEEL_ANGLE] * share)


@kernel
def drive_at(ticks: Array, k: int, unknowns: Array) -> DriveInputs:
    """Inputs of the rig in the middle of tick k. unknowns: (n,)."""
    k = min(k, ticks.shape[0] - 1)
    nxt = min(k + 1, ticks.shape[0] - 1)
    scale = math.exp(-unknowns[AT_WHEEL_GAIN])
    behind = unknowns[AT_LATENCY]
    early, late = wheel_angle_at(ticks, k, behind), wheel_angle_at(ticks, nxt, behind)
    wheel = (0.5 * (early + late) - unknowns[AT_WHEEL_ZERO]) * scale
    u, u_rate = 0.5 * (ticks[k, U] + ticks[nxt, U]), (ticks[nxt, U] - ticks[k, U]) / DT
    return DriveInputs(u, u_rate, wheel, (late - early) / DT * scale, scale)


@kernel
def rig_at(rig: Rig, geometry: Array, unknowns: Array, linear: bool) -> Rig:
    """The rig with this geometry (9,), and heights, rolling resistance and curvature of the tyre curve
    (1/grip) at a point of the unknowns, of which a linear model has none."""
    grip = 1.0 / max(unknowns[AT_CURVATURE], 1e-3)
    rolling, raised = unknowns[AT_ROLLING], unknowns[AT_HITCH : AT_HITCH + 3]
    if linear:
        rolling, raised = 0.0, np.zeros(3)
    return Rig(
        geometry[0], geometry[1], geometry[2], geometry[3], geometry[4], geometry[5], geometry[6],
        geometry[7], geometry[8], rig.C_af, rig.C_ar, rig.C_ai, rig.sigma_f, rig.sigma_r, rig.sigma_i,
        rig.h_t + raised[1], rig.h_i + raised[2], rig.h_h + raised[0], rig.w_f, rig.w_r, rig.w_i,
        rig.roll_share_f, grip, grip, grip, rig.load_exponent, rolling, rolling, rolling, rig.front_drive,
        0.0, rig.drive_limit, rig.g,
    )  # fmt: skip


@kernel
def roll_at(roll: RollModes, unknowns: Array) -> RollModes:
    """The roll modes at a point of the unknowns."""
    k = np.exp(unknowns[AT_ROLL_MODES : AT_ROLL_MODES + 6])
    return RollModes(
        roll.stiffness_t * k[0], roll.stiffness_i * k[1], roll.damping_t * k[2], roll.damping_i * k[3],
        roll.inertia_t * k[4], roll.inertia_i * k[5],
        max(roll.pin + unknowns[AT_ROLL_MODES + 6], 0.0), roll.stiffness_f * k[0], unknowns[AT_CAMBER],
        unknowns[AT_SHRINK],
    )  # fmt: skip


@kernel
def plant_of(setup: RigSetup) -> Plant:
    """The motion model with the machine file's parameters."""
    return Plant(
        np.zeros(6), setup.rig, setup.roll, setup.scale,
        np.zeros(N_ROLLING), np.zeros(N_INPUTS), np.zeros((6, 3)), np.zeros(N_ROLLING), roll_work(),
    )  # fmt: skip


@kernel
def plant_at(plant: Plant, point: Point, setup: RigSetup) -> Plant:
    """The plant at a point of the unknowns, with the same work arrays."""
    linear = setup.scale != 1.0
    rig = rig_at(setup.rig, point.geometry, point.unknowns, linear)
    roll = setup.roll if linear else roll_at(setup.roll, point.unknowns)
    return Plant(
        point.theta, rig, roll, setup.scale,
        plant.x, plant.w, plant.forces, plant.rates, plant.work,
    )  # fmt: skip


@kernel
def state_rates(x: Array, drive: DriveInputs, plant: Plant, out: Array) -> None:
    """Fill out (12,), the rates of the states before X_PUSH."""
    state, w, scale = plant.x, plant.w, plant.scale
    state[2], state[3], state[4] = scale * x[X_PSI], scale * x[X_PSI + 1], drive.u
    for i in range(X_PSI):
        state[5 + i] = scale * x[i]
    w[0], w[3], w[HELD] = scale * drive.wheel, drive.u, drive.u_rate if scale == 1.0 else 0.0
    for body in range(2):
        w[1 + body] = scale * (x[X_PUSH + body] + x[X_SLOPE + body])
        w[UNEVEN + body] = scale * x[X_UNEVEN + body]
    rates_rolling(state, w, plant.theta, plant.rig, plant.roll, plant.forces, plant.work, plant.rates)
    for i in range(X_PSI):
        out[i] = plant.rates[5 + i] / scale
    out[X_R] += x[X_PUSH + 2]
    out[X_PSI], out[X_PSI + 1] = x[X_R], x[X_R + 1]


# The Jacobians.


@kernel
def rate_jacobians(
    x: Array, drive: DriveInputs, point: Point, plant: Plant, setup: RigSetup, active: Active, out: Transition
) -> None:
    """Fill the Jacobians of the rates, by differences."""
    base, nudged_rate = out.rates, out.nudged
    state_rates(x, drive, plant, base)
    at = x.copy()
    for j in range(X_POSITION):
        if j == X_PSI + 1 or X_PUSH + 2 <= j < X_UNEVEN or j >= X_SLOPE_RATE:
            continue  # of the headings only the difference matters
        at[j] += NUDGE
        state_rates(at, drive, plant, nudged_rate)
        at[j] = x[j]
        for i in range(X_PUSH):
            out.rates_x[i, j] = (nudged_rate[i] - base[i]) / NUDGE
    for i in range(X_PUSH):
        out.rates_x[i, X_PSI + 1] = -out.rates_x[i, X_PSI]
        out.rates_x[i, X_PUSH + 2] = 1.0 if i == X_R else 0.0
        out.rates_x[i, X_SLOPE] = out.rates_x[i, X_PUSH]
        out.rates_x[i, X_SLOPE + 1] = out.rates_x[i, X_PUSH + 1]
    nudged_drive = DriveInputs(
        drive.u, drive.u_rate, drive.wheel + NUDGE, drive.wheel_rate, drive.wheel_scale
    )
    state_rates(x, nudged_drive, plant, nudged_rate)
    for i in range(X_PUSH):
        out.rates_wheel[i] = (nudged_rate[i] - base[i]) / NUDGE
    for j in range(active.places.shape[0]):
        depends = nudged_rates(x, drive, point, plant, setup, active, j, nudged_rate)
        for i in range(X_PUSH):
            out.rates_unknowns[i, j] = (nudged_rate[i] - base[i]) / NUDGE if depends else 0.0


@kernel
def nudged_rates(
    x: Array, drive: DriveInputs, point: Point, plant: Plant, setup: RigSetup, active: Active, j: int,
    out: Array,
) -> bool:  # fmt: skip
    """Fill out (12,), the rates with the j-th active unknown nudged; whether they depend on it."""
    place = active.places[j]
    roll_mode = AT_ROLL_MODES <= place < AT_ROLL_MODES + N_ROLL_MODES
    if place < 6:
        theta = point.theta.copy()
        theta[place] *= 1.0 + NUDGE
        nudged = plant_at(plant, Point(point.unknowns, theta, point.geometry), setup)
    elif roll_mode or place in (AT_ROLLING, AT_CURVATURE):
        unknowns = point.unknowns.copy()
        unknowns[place] += NUDGE
        nudged = plant_at(plant, Point(unknowns, point.theta, point.geometry), setup)
    elif place >= AT_GEOMETRY or place == AT_CG or place == AT_CG + 1:
        geometry = point.geometry + NUDGE * active.geometry[j]
        nudged = plant_at(plant, Point(point.unknowns, point.theta, geometry), setup)
    else:
        return False
    state_rates(x, drive, nudged, out)
    return True


@kernel
def geometry_jacobian(base: Array, point: Point, active: Active) -> None:
    """Fill active.geometry. base: (9,), the geometry of the machine file."""
    unknowns = point.unknowns.copy()
    for j in range(active.places.shape[0]):
        place = active.places[j]
        unknowns[place] += NUDGE
        active.geometry[j] = (geometry_at(base, unknowns) - point.geometry) / NUDGE
        unknowns[place] = point.unknowns[place]


@kernel
def integrate_exponential(jacobian: Array, out: Array) -> None:
    """Fill out (12, 12): the integral of the Jacobian's matrix exponential over DT, by a power series."""
    A = jacobian[:, :X_PUSH].copy()
    power, factor = np.eye(X_PUSH), DT
    out[:] = DT * power
    for order in range(2, 5):
        power = power @ A
        factor *= DT / order
        out += factor * power


@kernel
def joint_jacobian(active: Active, step: Transition) -> None:
    """Fill step.F and step.wheel, except for what `complete_jacobian` adds."""
    held, F = step.held, step.F
    F[:, :] = 0.0
    for i in range(X_PUSH):
        F[i, i] = 1.0
        step.wheel[i] = 0.0
        for k in range(X_PUSH):
            part = held[i, k]
            if part != 0.0:
                step.wheel[i] += part * step.rates_wheel[k]
                for j in range(X_POSITION):
                    F[i, j] += part * step.rates_x[k, j]
                for j in range(active.places.shape[0]):
                    F[i, N_STATES + j] += part * step.rates_unknowns[k, j]
    for i in range(X_PUSH, N_STATES):
        F[i, i] = step.decay[i]
    for k in range(4):
        i = (X_SLOPE if k < 2 else X_SLOPE_RATE) + k % 2
        for j in range(2):
            F[i, (X_SLOPE, X_SLOPE_RATE)[j] + k % 2] = step.slope[k // 2, j]


@kernel
def linearise(
    x: Array,
    ticks: Array,
    k: int,
    point: Point,
    plant: Plant,
    setup: RigSetup,
    active: Active,
    step: Transition,
) -> None:
    """Renew step's Jacobians for EVERY ticks from tick k on, about x in the middle of them, roughly."""
    middle = x.copy()
    for _ in range(EVERY):
        state_rates(middle, drive_at(ticks, k, point.unknowns), plant, step.rates)
        for i in range(X_PUSH):
            middle[i] += 0.5 * DT * step.rates[i]
    rate_jacobians(middle, drive_at(ticks, k + EVERY // 2, point.unknowns), point, plant, setup, active, step)
    integrate_exponential(step.rates_x, step.held)
    joint_jacobian(active, step)


@kernel
def position_jacobian(u: float, psi: float, v: float, columns: int, F: Array) -> None:
    """Fill the position's rows of F, in its first columns, from its rows of v and psi_t."""
    sine, cosine = math.sin(psi), math.cos(psi)
    north = -u * sine - v * cosine
    east = u * cosine - v * sine
    for j in range(columns):
        half_v = 0.5 * DT * (F[X_V, j] + (1.0 if j == X_V else 0.0))
        half_psi = 0.5 * DT * (F[X_PSI, j] + (1.0 if j == X_PSI else 0.0))
        F[X_POSITION, j] = -sine * half_v + north * half_psi
        F[X_POSITION + 1, j] = cosine * half_v + east * half_psi


@kernel
def complete_jacobian(
    x: Array, following: Array, drive: DriveInputs, active: Active, step: Transition
) -> None:
    """Complete step.F for one tick: rows of the position, columns of wheel zero, gain and latency; fill
    step.F_T.

    x, following: (26,), the state before and after the tick.
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
                F[i, N_STATES + j] = factor * step.wheel[i]
    psi, v = 0.5 * (x[X_PSI] + following[X_PSI]), 0.5 * (x[X_V] + following[X_V])
    position_jacobian(drive.u, psi, v, F.shape[1], F)
    F[X_POSITION, X_POSITION] = F[X_POSITION + 1, X_POSITION + 1] = 1.0
    for i in range(N_STATES):
        for j in range(F.shape[1]):
            F_T[j, i] = F[i, j]


# One tick.


@kernel
def propagate_mean(x: Array, u: float, step: Transition, out: Array) -> None:
    """Fill out (26,), the state one tick later, with step.rates."""
    for i in range(X_PUSH):
        total = x[i]
        for j in range(X_PUSH):
            total += step.held[i, j] * step.rates[j]
        out[i] = total
    for i in range(X_PUSH, N_STATES):
        out[i] = step.decay[i] * x[i]
    for body in range(2):
        slope, rate = x[X_SLOPE + body], x[X_SLOPE_RATE + body]
        out[X_SLOPE + body] = step.slope[0, 0] * slope + step.slope[0, 1] * rate
        out[X_SLOPE_RATE + body] = step.slope[1, 0] * slope + step.slope[1, 1] * rate
    psi, v = 0.5 * (x[X_PSI] + out[X_PSI]), 0.5 * (x[X_V] + out[X_V])
    sine, cosine = math.sin(psi), math.cos(psi)
    out[X_POSITION] = x[X_POSITION] + DT * (u * cosine - v * sine)
    out[X_POSITION + 1] = x[X_POSITION + 1] + DT * (u * sine + v * cosine)


@kernel
def propagate(
    x: Array, drive: DriveInputs, plant: Plant, active: Active, step: Transition, following: Array
) -> None:
    """Fill following (26,), x one tick later, and step's Jacobians of this tick."""
    state_rates(x, drive, plant, step.rates)
    propagate_mean(x, drive.u, step, following)
    complete_jacobian(x, following, drive, active, step)


@kernel
def add_position_noise(P: Array, psi: float) -> None:
    """Add the position's process noise of one tick to a covariance: along and across the heading psi, rad."""
    sine, cosine = math.sin(psi), math.cos(psi)
    along, across = ALONG * ALONG * DT, ACROSS * ACROSS * DT
    P[X_POSITION, X_POSITION] += along * cosine * cosine + across * sine * sine
    P[X_POSITION + 1, X_POSITION + 1] += along * sine * sine + across * cosine * cosine
    cross = (along - across) * sine * cosine
    P[X_POSITION, X_POSITION + 1] += cross
    P[X_POSITION + 1, X_POSITION] += cross


@kernel
def propagate_covariance(P: Array, step: Transition, psi: float) -> None:
    """Propagate P (n, n), of x or of the joint state, over one tick, in place.

    Processes and unknowns only decay or are constant, so that their part of F is diagonal. Loops add rows to
    rows and skip zeros, so that the compiler can use vector instructions.
    """
    F, F_T, F_P, n = step.F, step.F_T, step.F_P, P.shape[0]
    F_P[:X_PAIR] = 0.0
    for i in range(X_PAIR):
        for k in range(n):
            part = F[i, k]
            if part != 0.0:
                for j in range(n):
                    F_P[i, j] += part * P[k, j]
    for i in range(X_PAIR, N_STATES):
        for j in range(X_PAIR, n):
            P[i, j] *= F[i, i] * (F[j, j] if j < N_STATES else 1.0)
            if j >= N_STATES:
                P[j, i] = P[i, j]
    for i in range(X_PAIR):
        for j in range(X_PAIR):
            P[i, j] = 0.0
        for k in range(n):
            if k < X_PAIR or F_T[k, 0] != 0.0 or F_T[k, 1] != 0.0:
                part = F_P[i, k]
                for j in range(X_PAIR):
                    P[i, j] += part * F_T[k, j]
        for j in range(X_PAIR, n):
            P[i, j] = F_P[i, j] * (F[j, j] if j < N_STATES else 1.0)
            P[j, i] = P[i, j]
    for i in range(N_STATES):
        P[i, i] += step.q[i]
    for body in range(2):
        slope, rate = X_SLOPE + body, X_SLOPE_RATE + body
        P[slope, rate] += step.slope[0, 2]
        P[rate, slope] += step.slope[0, 2]
    add_position_noise(P, psi)


# What a run begins with.


@kernel
def stationary(u: float, ground: GroundNoise, setup: RigSetup) -> Array:
    """Stationary variances of the states from X_PUSH on, shape (26,), 0 before and for the position. u:
    m/s."""
    sds, rate = setup.sds, max(u, SLOWEST) / SLOPE_LENGTH
    out = np.zeros(N_STATES)
    for i in range(3):
        out[X_PUSH + i] = ground.push[i] * ground.push[i]
        out[X_PAIR + i] = sds[1 + i] * sds[1 + i]
        if i < 2:
            out[X_SLOPE + i] = setup.slope_sd * setup.slope_sd
            out[X_SLOPE_RATE + i] = rate * rate * out[X_SLOPE + i]
            out[X_UNEVEN + i] = ground.uneven * ground.uneven
    return out


@kernel
def first_covariance(u: float, ground: GroundNoise, setup: RigSetup) -> Array:
    """Covariance of the first state of a run at speed u, m/s, shape (26, 26)."""
    variances = stationary(u, ground, setup)
    for i in range(X_PUSH):
        variances[i] = START[i] * START[i]
    variances[X_POSITION] = variances[X_POSITION + 1] = START_PLACE * START_PLACE
    return np.diag(variances)


@kernel
def empty_transition(na: int, rows: int) -> Transition:
    """A Transition for `na` active unknowns, of which `rows` are in the covariance, without its Jacobians."""
    n = N_STATES + na
    return Transition(
        np.zeros((X_PUSH, X_POSITION)), np.zeros(X_PUSH), np.zeros((X_PUSH, na)), np.zeros(X_PUSH),
        np.zeros(X_PUSH), np.zeros((X_PUSH, X_PUSH)), np.zeros(X_PUSH), np.ones(N_STATES), np.zeros(N_STATES),
        np.zeros((2, 3)),
        np.zeros((N_STATES, n)), np.zeros((n, N_STATES)), np.zeros((N_STATES, N_STATES + rows)),
    )  # fmt: skip


@kernel
def set_processes(u: float, ground: GroundNoise, setup: RigSetup, step: Transition) -> None:
    """Fill decay, slope and q of the states from X_PUSH on at speed u, m/s."""
    decay, slope, speed = step.decay, step.slope, max(u, SLOWEST)
    for i in range(3):
        decay[X_PUSH + i], decay[X_PAIR + i] = math.exp(-DT / ground.memory_s), PAIR_DECAY
        if i < 2:
            decay[X_UNEVEN + i] = math.exp(-DT * speed / UNEVEN_LENGTH)
    variances = stationary(u, ground, setup)
    for i in range(X_PUSH, N_STATES):
        step.q[i] = (1.0 - decay[i] * decay[i]) * variances[i]
    rate = speed / SLOPE_LENGTH
    left = math.exp(-rate * DT)
    slope[0, 0], slope[0, 1] = left * (1.0 + rate * DT), left * DT
    slope[1, 0], slope[1, 1] = -left * rate * rate * DT, left * (1.0 - rate * DT)
    one, two = variances[X_SLOPE], variances[X_SLOPE_RATE]
    slope[0, 2] = -(slope[0, 0] * slope[1, 0] * one + slope[0, 1] * slope[1, 1] * two)
    for body in range(2):
        step.q[X_SLOPE + body] = one - slope[0, 0] ** 2 * one - slope[0, 1] ** 2 * two
        step.q[X_SLOPE_RATE + body] = two - slope[1, 0] ** 2 * one - slope[1, 1] ** 2 * two


@kernel
def set_wheel_noise(u: float, sigma_f: float, sds: Array, step: Transition) -> None:
    """Process noise of the front slip angle from that of the wheel angle."""
    step.q[X_ALPHA] = (u / sigma_f * sds[0] * DT) ** 2
