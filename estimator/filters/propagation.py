"""Propagates state and covariance over one tick: the filters' motion model.

The model is models.rolling. Its Jacobians, over the states and over any unknowns, are renewed every few
ticks; with them the mean takes one step per tick (exponential integrator), which is exact for a linear model.
The states x, shape (30,), are those of states.py. Together with the active ones of unknowns.NAMES, which are
constant, they are the joint state, shape (n,).
"""

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.compiled import inline_kernel, inner_kernel, kernel
from tilth.estimator.driving import DRIVING
from tilth.estimator.filters.generated.observation_kernels import WHEEL_ANGLE_UNKNOWNS
from tilth.estimator.filters.rig_setup import RigSetup
from tilth.estimator.filters.sensors.wheel_angle import DriveInputs, drive_at, set_wheel_slopes
from tilth.estimator.filters.states import (
    BANK_DIFFERENCE,
    BANK_LENGTH,
    BANK_STATES,
    DT,
    INITIAL_BANK_DIFFERENCE,
    N_STATES,
    PAIR_DECAY,
    SPEED_MEMORY_S,
    START,
    START_PLACE,
    UNEVEN_LENGTH,
    X_ALPHA,
    X_BANK,
    X_DISTURBANCE,
    X_LATERAL_OFFSET,
    X_PAIR,
    X_POSITION,
    X_PSI,
    X_R,
    X_ROLL,
    X_SPEED,
    X_UNEVEN,
    X_V,
    Places,
)
from tilth.estimator.filters.transition import (
    Transition,
    integrate_exponential,
    joint_jacobian,
    multiply,
    position_jacobian,
    set_coupled,
    unknowns_jacobian,
)
from tilth.estimator.filters.unknowns import (
    ACTED_ON,
    AT_DISTURBANCE,
    AT_MEMORY,
    AT_UNEVEN,
    FIRST_ACTION,
    apply,
)
from tilth.estimator.models.rolling import (
    BY_INPUT,
    N_INPUTS,
    N_PARAMETERS,
    MotionRates,
    empty_motion,
    rates,
    rates_by_parameter,
    rates_by_state,
)
from tilth.estimator.models.rolling import N_STATES as N_MOTION
from tilth.estimator.models.rolling_terms import INPUTS, PARAMETERS
from tilth.estimator.tuning import tuned

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PropagationTuning:
    """How a filter's state is carried on."""

    every: int = tuned(3, "ticks", "with one set of Jacobians; odd, so that the middle of one is theirs")


PROPAGATION: Final = PropagationTuning()
# Kernels read globals; a record is none for them.
EVERY: Final = PROPAGATION.every

UNDER_WAY: Final = DRIVING.under_way  # distances along the ground are driven at least as fast

# Indices of rolling's inputs and parameters. Of those of two bodies the tractor's; the implement's is next.
W_DELTA: Final = INPUTS.index("delta")
W_GRAVITY: Final = INPUTS.index("gravity_t")
W_UNEVEN: Final = INPUTS.index("uneven_t")
W_U: Final = INPUTS.index("u")
W_U_RATE: Final = INPUTS.index("u_rate")
P_GEOMETRY: Final = PARAMETERS.index("a")
P_HEIGHT: Final = PARAMETERS.index("h_t")
P_DRAWBAR: Final = PARAMETERS.index("h_h")
P_ROLL_MODES: Final = PARAMETERS.index("k_t")
P_PIVOT_HEIGHT: Final = PARAMETERS.index("pivot_height")
P_FRONT: Final = PARAMETERS.index("k_f")
P_SLIP_DEPENDENCE: Final = PARAMETERS.index("slip_dependence")
P_CONSTANTS: Final = len(PARAMETERS)


class Plant(NamedTuple):
    """The motion model at one point of the unknowns, and its work arrays."""

    p: Array  # (38,), rolling_terms.PARAMETERS and CONSTANTS
    p_slopes: Array  # of unknowns.ACTIONS, derivatives of PARAMETERS by what acts on them
    p_unknowns: Array  # (a, 32), derivatives of PARAMETERS by the active unknowns
    scale: float  # of all motions; as RigSetup.scale
    x: Array  # (12,), its state
    w: Array  # (7,), its inputs
    motion: MotionRates


class GroundNoise(NamedTuple):
    """Sds of what the ground does."""

    disturbance: Array  # (3,), m/s^2, m/s^2, rad/s^2
    memory_s: float  # time constant of the pushes
    uneven: float  # rad


# The inputs and the rates.


def empty_plant(setup: RigSetup, na: int) -> Plant:
    """A Plant for `na` active unknowns, without its parameters."""
    return Plant(
        np.zeros(N_PARAMETERS), np.zeros(ACTED_ON.shape[0]), np.zeros((na, P_CONSTANTS)), setup.scale,
        np.zeros(N_MOTION), np.zeros(N_INPUTS), empty_motion(),
    )  # fmt: skip


@inline_kernel
def set_parameters(unknowns: Array, setup: RigSetup, p: Array, slopes: Array) -> None:
    """Fill p (38,), rolling_terms.PARAMETERS and CONSTANTS, at a point of the unknowns, and slopes as
    `unknowns.apply`. A linear model has no rolling resistance, and its roll modes and heights are those of
    the setup."""
    rig, roll = setup.rig, setup.roll
    for i in range(P_CONSTANTS):
        p[i] = 1.0 if i < 6 else 0.0
    for i in range(9):
        p[P_GEOMETRY + i] = setup.geometry[i]
    p[P_HEIGHT], p[P_HEIGHT + 1], p[P_DRAWBAR] = rig.h_t, rig.h_i, rig.h_h
    modes = (roll.k_t, roll.k_i, roll.d_t, roll.d_i, roll.j_t, roll.j_i)
    p[P_PIVOT_HEIGHT], p[P_FRONT] = roll.pivot_height, roll.k_f
    constants = (rig.w_f, rig.w_r, rig.w_i, rig.load_exponent, rig.front_drive, rig.g)
    for i in range(6):
        p[P_ROLL_MODES + i] = modes[i]
        p[P_CONSTANTS + i] = constants[i]
    apply(unknowns, setup.scale != 1.0, p, slopes)


@inner_kernel
def set_plant(plant: Plant, unknowns: Array, setup: RigSetup, places: Places) -> None:
    """Move the plant to a point of the unknowns. places: (a,), of the active ones."""
    set_parameters(unknowns, setup, plant.p, plant.p_slopes)
    plant.p_unknowns[:] = 0.0
    for j in range(places.shape[0]):
        for k in range(FIRST_ACTION[places[j]], FIRST_ACTION[places[j] + 1]):
            plant.p_unknowns[j, ACTED_ON[k]] = plant.p_slopes[k]


@inner_kernel
def state_rates(x: Array, drive: DriveInputs, plant: Plant, out: Array) -> None:
    """Fill out (12,), the rates of the states before X_DISTURBANCE."""
    state, w, scale = plant.x, plant.w, plant.scale
    for i in range(X_DISTURBANCE):
        state[i] = scale * x[i]
    w[W_DELTA], w[W_U] = scale * drive.wheel, drive.u + x[X_SPEED]
    w[W_U_RATE] = drive.u_rate if scale == 1.0 else 0.0
    for body in range(2):
        w[W_GRAVITY + body] = scale * (x[X_DISTURBANCE + body] + x[X_BANK + body])
        w[W_UNEVEN + body] = scale * x[X_UNEVEN + body]
    rates(state, w, plant.p, plant.motion, out)
    for i in range(X_DISTURBANCE):
        out[i] /= scale
    out[X_R] += x[X_DISTURBANCE + 2]


# The Jacobians.


@inner_kernel
def rate_jacobians(x: Array, drive: DriveInputs, plant: Plant, out: Transition) -> None:
    """Fill the rates at x and their Jacobians. Those of psi_t, psi_i and of the leans are constant."""
    state_rates(x, drive, plant, out.rates)
    motion = plant.motion
    rates_by_state(plant.x, plant.w, plant.p, motion)
    if plant.p_unknowns.shape[0] > 0:
        rates_by_parameter(plant.x, plant.w, plant.p, motion)
        out.rates_unknowns[:] = 0.0
    for k in range(8):
        i = k if k < X_ROLL else k + 2  # v, yaw rates, slip angles, rates of the leans
        slips = X_ALPHA <= k < X_ROLL
        row = k - X_ALPHA if slips else (1 + k if k < X_ALPHA else k - 2)
        slopes = motion.slip_by_state[row] if slips else motion.right_by_state[row]
        for j in range(X_PSI + 1):
            out.rates_x[i, j] = slopes[j]
        out.rates_x[i, X_PSI + 1] = -slopes[X_PSI]
        for body in range(2):
            out.rates_x[i, X_DISTURBANCE + body] = slopes[BY_INPUT + W_GRAVITY + body]
            out.rates_x[i, X_BANK + body] = slopes[BY_INPUT + W_GRAVITY + body]
            out.rates_x[i, X_UNEVEN + body] = slopes[BY_INPUT + W_UNEVEN + body]
        out.rates_x[i, X_SPEED] = slopes[BY_INPUT + W_U] / plant.scale
        out.rates_wheel[i] = slopes[BY_INPUT + W_DELTA]
    rates_by_unknown(plant, out.rates_unknowns)


@inner_kernel
def rates_by_unknown(plant: Plant, out: Array) -> None:
    """Fill the rows of out (12, a), the rates' derivatives by the active unknowns, that are not zero, from
    plant.motion."""
    motion = plant.motion
    for j in range(out.shape[1]):
        for k in range(P_CONSTANTS):
            part = plant.p_unknowns[j, k] / plant.scale
            if part != 0.0:
                for i in range(3):
                    out[i, j] += part * motion.right_by_parameter[1 + i, k]
                    out[X_ALPHA + i, j] += part * motion.slip_by_parameter[i, k]
                for i in range(2):
                    out[X_ROLL + 2 + i, j] += part * motion.right_by_parameter[4 + i, k]


@kernel
def parameter_slopes(x: Array, w: Array, p: Array, motion: MotionRates) -> None:
    """As `rates_by_parameter`."""
    rates_by_parameter(x, w, p, motion)


def rehearse() -> None:
    """Compile the slopes by parameters alone: they take longest, and all filters need them."""
    x, w, p = np.zeros(N_MOTION), np.zeros(N_INPUTS), np.zeros(N_PARAMETERS)
    parameter_slopes(x, w, p, empty_motion())


@inner_kernel
def find_middle(x: Array, ticks: Array, k: int, unknowns: Array, plant: Plant, step: Transition) -> None:
    """Fill step.middle, roughly x in the middle of EVERY ticks from tick k on."""
    middle = step.middle
    for i in range(N_STATES):
        middle[i] = x[i]
    state_rates(x, drive_at(ticks, k, unknowns), plant, step.rates)
    for i in range(X_DISTURBANCE):
        middle[i] += 0.5 * EVERY * DT * step.rates[i]


@inline_kernel
def linearise(x: Array, ticks: Array, k: int, unknowns: Array, plant: Plant, step: Transition) -> None:
    """Renew step's Jacobians, except for what `complete_jacobian` adds, for EVERY ticks from tick k on, about
    x in the middle of them, roughly.

    At 3 ticks a chirp's derivative by C_af is that of differences to a hundredth or two; at 5 it was 4 % off.
    """
    find_middle(x, ticks, k, unknowns, plant, step)
    rate_jacobians(step.middle, drive_at(ticks, k + EVERY // 2, unknowns), plant, step)
    integrate_exponential(step)
    joint_jacobian(step)


@inline_kernel
def jacobian_at_instrument(
    instrument: Array, ticks: Array, k: int, unknowns: Array, plant: Plant, step: Transition
) -> None:
    """Renew F_unknowns after `linearise`, with the slopes where the rig would be by steering alone: at
    `instrument`, (30,), a state that no measurement has moved.

    What the ground does is in the estimated state and in the innovations. Slopes that are taken there are
    correlated with what they are compared with, and tyres came out up to 40 % too soft in slow turns. These
    are an instrumental variable, as in refined instrumental variables for time series (P. C. Young 1976).
    """
    find_middle(instrument, ticks, k, unknowns, plant, step)
    state_rates(step.middle, drive_at(ticks, k + EVERY // 2, unknowns), plant, step.rates)
    rates_by_parameter(plant.x, plant.w, plant.p, plant.motion)
    step.rates_unknowns[:] = 0.0
    rates_by_unknown(plant, step.rates_unknowns)
    unknowns_jacobian(step)
    set_coupled(step, 0, X_DISTURBANCE)


@inline_kernel
def complete_jacobian(
    x: Array, following: Array, drive: DriveInputs, unknowns: Array, places: Places, step: Transition
) -> None:
    """Complete the Jacobians for one tick: rows of the position, columns of the wheel angle's unknowns.

    x, following: (30,), the state before and after the tick.
    """
    F_unknowns, in_covariance = step.F_unknowns, step.F_coupled.shape[1]
    set_wheel_slopes(drive, unknowns, step.wheel_unknowns)
    for j in range(places.shape[0]):
        if places[j] in WHEEL_ANGLE_UNKNOWNS:
            factor = step.wheel_unknowns[places[j]]
            for i in range(X_DISTURBANCE):
                F_unknowns[i, j] = factor * step.wheel[i]
            if N_STATES + j < in_covariance:
                for i in range(X_DISTURBANCE):
                    step.F_coupled[i, N_STATES + j] = step.F_coupled_T[N_STATES + j, i] = F_unknowns[i, j]
    psi, v = 0.5 * (x[X_PSI] + following[X_PSI]), 0.5 * (x[X_V] + following[X_V])
    position_jacobian(drive.u + x[X_SPEED], psi, v, step)


# One tick.


@inner_kernel
def propagate_mean(x: Array, u: float, step: Transition, out: Array) -> None:
    """Fill out (30,), the state one tick later, with step.rates. u: the measured speed, m/s."""
    for i in range(X_DISTURBANCE):
        total = x[i]
        for j in range(X_DISTURBANCE):
            total += step.held[i, j] * step.rates[j]
        out[i] = total
    for i in range(X_DISTURBANCE, N_STATES):
        out[i] = step.decay[0, i] * x[i]
    for i in range(4):
        out[BANK_STATES[i]] = 0.0
        for j in range(4):
            out[BANK_STATES[i]] += step.bank[i, j] * x[BANK_STATES[j]]
    psi, v = 0.5 * (x[X_PSI] + out[X_PSI]), 0.5 * (x[X_V] + out[X_V])
    u, sine, cosine = u + x[X_SPEED], math.sin(psi), math.cos(psi)
    out[X_POSITION] = x[X_POSITION] + DT * (u * cosine - v * sine)
    out[X_POSITION + 1] = x[X_POSITION + 1] + DT * (u * sine + v * cosine)


@inner_kernel
def propagate(
    x: Array, drive: DriveInputs, unknowns: Array, plant: Plant, places: Places, step: Transition,
    following: Array,
) -> None:  # fmt: skip
    """Fill following (30,), x one tick later, and step's Jacobians of this tick."""
    state_rates(x, drive, plant, step.rates)
    propagate_mean(x, drive.u, step, following)
    complete_jacobian(x, following, drive, unknowns, places, step)


# What a run begins with.


@kernel
def ground_at(unknowns: Array) -> GroundNoise:
    """What the ground does, at a point of the unknowns."""
    return GroundNoise(
        np.exp(unknowns[AT_DISTURBANCE : AT_DISTURBANCE + 3]),
        math.exp(unknowns[AT_MEMORY]),
        math.exp(unknowns[AT_UNEVEN]),
    )


@kernel
def stationary(ground: GroundNoise, setup: RigSetup) -> Array:
    """Stationary variances of the states from X_DISTURBANCE on, (30,), 0 for the position and BANK_STATES."""
    sds = setup.sds
    out = np.zeros(N_STATES)
    for i in range(3):
        out[X_DISTURBANCE + i] = ground.disturbance[i] * ground.disturbance[i]
    for i in range(2):
        out[X_UNEVEN + i] = ground.uneven * ground.uneven
        out[X_PAIR + i], out[X_PAIR + 2 + i], out[X_LATERAL_OFFSET + i] = (
            sds[1] ** 2,
            sds[2] ** 2,
            sds[3] ** 2,
        )
    out[X_SPEED] = setup.speed_sd * setup.speed_sd
    return out


@kernel
def bank_rates(u: float, setup: RigSetup) -> tuple[float, float]:
    """Rates (1/s) of the critically damped processes of BANK_STATES at speed u, m/s: the tractor's, and that
    with
    which the implement's follows: it gets there when its wheels have come to where the tractor's CG was."""
    behind = setup.geometry[2] + setup.geometry[3] + setup.geometry[4]
    return max(u, UNDER_WAY) / BANK_LENGTH, 2.0 * max(u, UNDER_WAY) / behind


@kernel
def first_covariance(u: float, ground: GroundNoise, setup: RigSetup) -> Array:
    """Covariance of the first state of a run at speed u, m/s, shape (30, 30)."""
    variances = stationary(ground, setup)
    for i in range(X_DISTURBANCE):
        variances[i] = START[i] * START[i]
    variances[X_POSITION] = variances[X_POSITION + 1] = START_PLACE * START_PLACE
    P = np.diag(variances)
    common, apart = bank_rates(u, setup)
    bank, own = setup.bank_sd, INITIAL_BANK_DIFFERENCE * setup.bank_sd
    for i in (0, 2):
        of_all = (bank if i == 0 else common * bank) ** 2
        for j in range(2):
            for k in range(2):
                P[BANK_STATES[i + j], BANK_STATES[i + k]] = of_all
        P[BANK_STATES[i + 1], BANK_STATES[i + 1]] += (own if i == 0 else apart * own) ** 2
    return P


@kernel
def set_bank(u: float, setup: RigSetup, step: Transition) -> None:
    """Fill bank and bank_noise at speed u, m/s. A critically damped process of rate w and stationary
    variance s^2 is driven by white noise of density 4 w^3 s^2."""
    common, apart = bank_rates(u, setup)
    A, B, power = np.zeros((4, 4)), np.eye(4), np.zeros((4, 4))
    A[0, 2] = A[1, 3] = DT
    A[2, 0], A[2, 2] = -common * common * DT, -2.0 * common * DT
    A[3, 0], A[3, 1], A[3, 3] = apart * apart * DT, -apart * apart * DT, -2.0 * apart * DT
    for i in range(4):
        step.bank[i] = 0.0
        step.bank[i, i] = 1.0
    for order in range(1, 4):
        multiply(A, B, power)
        for i in range(4):
            for j in range(4):
                B[i, j] = power[i, j] / order
                step.bank[i, j] += B[i, j]
    for body in range(2):
        sd = setup.bank_sd * (BANK_DIFFERENCE if body else 1.0)
        density = 4.0 * (apart if body else common) ** 3 * sd * sd
        step.bank_noise[body, body] = density * DT**3 / 3.0
        step.bank_noise[body, 2 + body] = step.bank_noise[2 + body, body] = density * DT**2 / 2.0
        step.bank_noise[2 + body, 2 + body] = density * DT


@kernel
def set_processes(u: float, ground: GroundNoise, setup: RigSetup, step: Transition, c: int) -> None:
    """Fill decay and q of the states from X_DISTURBANCE on but BANK_STATES, at speed u, m/s, for filter c."""
    decay, q = step.decay[c], step.q[c]
    for i in range(3):
        decay[X_DISTURBANCE + i] = math.exp(-DT / ground.memory_s)
    for i in range(2):
        decay[X_UNEVEN + i] = math.exp(-DT * max(u, UNDER_WAY) / UNEVEN_LENGTH)
    decay[X_PAIR:] = PAIR_DECAY
    decay[X_SPEED] = math.exp(-DT / SPEED_MEMORY_S)
    variances = stationary(ground, setup)
    for i in range(X_DISTURBANCE, N_STATES):
        q[i] = (1.0 - decay[i] * decay[i]) * variances[i]
