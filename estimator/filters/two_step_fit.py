"""The dissertation's identification, to compare with: first stiffnesses, then relaxation lengths.

Source: Karkee (2009), section 7.2.3. Step one minimises the weighted squares of yaw rate and articulation
(7.15) over the steady part of a run, where relaxation lengths drop out. Step two holds the stiffnesses and
minimises the one-step prediction errors (7.19) of the relaxation model in innovations form (7.17, 7.18) at
the mean speed, with a wholly free gain K. Replicates are merged one number at a time (7.20, 7.21).

Its limits: the two outputs of step one determine two combinations of the three stiffnesses, so it ends
somewhere on a line of equally good solutions. Step two takes that point as true. And a free gain fits the
noise of a window of 30 s too well. With the true stiffnesses, sensor noise only and the relaxation model as
plant, its 95 % intervals hold 80 % of the relaxation lengths (60 runs); after step one, on the nonlinear
plant, 14 % (12 runs). So its numbers serve only for comparison.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.filters.states import DT
from tilth.estimator.models.relaxation import input_matrix, system_matrix
from tilth.estimator.models.steady_turn import steady_turn
from tilth.estimator.record.record import EAST, HEADING, NORTH, YAW_RATE, Record
from tilth.estimator.record.steady_driving import STEADY_DRIVING
from tilth.estimator.rig.geometry import wrap
from tilth.estimator.rig.residuals import pair_of
from tilth.estimator.tuning import tuned
from tilth.schemas.plausible import GRAVITY
from tilth.schemas.reasons import Code

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class TwoStepFitTuning:
    """The dissertation's two-step fit."""

    weights: tuple[float, ...] = tuned((4.0, 1.0), "1", "w_r, w_lambda of 7.15")
    every: int = tuned(10, "ticks", "between two samples: the dissertation's receivers had 5 Hz")
    first_gain: float = tuned(0.3, "1", "of each output on its own state, in the search for K")
    search_range: float = tuned(2.0, "1", "a logarithm is sought within ± this of its start")
    settling_lengths: float = tuned(6.0, "1", "in lengths d + e, for the implement to fall in line")
    turning: float = tuned(math.radians(1.0), "rad", "least wheel angle of a turn that is used")
    straight: float = tuned(0.01, "rad/s", "largest yaw rate of straight driving")
    least_samples: int = tuned(10, "samples", "of steady turning, 2 s")
    rank_tolerance: float = tuned(
        0.02, "1", "of the largest singular value: less is a direction not observed"
    )
    singular_floor: float = tuned(1e-6, "1", "of the largest singular value: smaller ones are raised to it")
    diverged: float = tuned(1e4, "1", "a state, or a scaled error, of a predictor that has become unstable")
    most_passes: int = tuned(60, "passes", "of the search for K")


TWO_STEP_FIT: Final = TwoStepFitTuning()

PREDICTOR_STATES: Final = (
    0,
    1,
    2,
    3,
    4,
    5,
    7,
    8,
)  # of relaxation.STATES: those of 7.9, without the lateral position
OUTPUT_STATES: Final = (1, 2, 6, 7)  # of these: yaw rates and headings, the outputs of 7.18


@dataclass(frozen=True, slots=True)
class Window:
    """One run, and what is needed from the machine file."""

    record: Record
    geometry: Array  # [9] as parameters.GEOMETRY
    start: Array  # [6] of flow.PARAMETERS: where the search begins
    levers: Array  # [4, 2] forward and right of each receiver, m, in the order of flow.Mount


@dataclass(frozen=True, slots=True)
class TwoStep:
    """The result of one run."""

    values: Array  # [6] of flow.PARAMETERS, N/rad and m; those of the start if not `found`
    sds: Array  # [6] as the method gives them
    found: tuple[bool, bool]  # whether stiffnesses and relaxation lengths were found
    rank: int  # of the three stiffnesses in 7.15
    zero: float  # rad, subtracted from the wheel angle
    straight_s: float  # duration of the straight driving from which the zero was found
    steady_s: float  # duration of the steady turning
    reason: Code | None  # why something was not found


@dataclass(frozen=True, slots=True)
class Outputs:
    """A record's inputs at all ticks and its outputs at each `every`-th."""

    wheel: Array  # [n] rad, zero error subtracted
    u: Array  # [n] m/s
    gravity: Array  # [n, 2] g sin(roll) of both bodies, m/s^2
    y: Array  # [k, 4] rad/s, rad/s, rad, rad: yaw rates and headings
    at: NDArray[np.int64]  # [k] ticks of y


def merge_scalar(values: Sequence[float], sds: Sequence[float]) -> tuple[float, float]:
    """(mean, sd) of one parameter from several estimates, by 7.20 and 7.21, two at a time.

    This is right for independent, unbiased estimates whose sds are right and do not depend on the value. The
    sds of a stiffness do: a low estimate has a low sd and so a larger weight. Correlations between parameters
    are lost too. After six runs of row following, its 95 % intervals hold 83 % of the true values. Raises
    ValueError for no estimates.
    """
    if not values:
        raise ValueError("no estimate to merge")
    mean, variance = values[0], sds[0] ** 2
    for value, sd in zip(values[1:], sds[1:], strict=True):
        total = variance + sd**2
        mean = sd**2 / total * mean + variance / total * value
        variance = variance * sd**2 / total
    return mean, math.sqrt(variance)


def identify(window: Window) -> TwoStep:
    """Both steps on one run."""
    outputs = _outputs(window)
    start = window.start
    if outputs is None:
        return _not_found(start, 0.0, 0.0, Code.OUTPUTS_NOT_MEASURED)
    straight = np.abs(outputs.y[:, 0]) < TWO_STEP_FIT.straight
    zero = float(outputs.wheel[outputs.at[straight]].mean()) if straight.any() else 0.0
    outputs.wheel[:] -= zero
    straight_s = float(straight.sum() * TWO_STEP_FIT.every * DT)
    steady = _steady_indices(outputs, window.geometry)
    if len(steady) < TWO_STEP_FIT.least_samples:
        return _not_found(start, zero, straight_s, Code.NO_STEADY_TURN)
    stiffness, sd_stiffness, rank, within = _stiffnesses(outputs, steady, window)
    theta = np.concatenate([stiffness, start[3:]])
    lengths, sd_lengths, also_within = _relaxation_lengths(outputs, window.geometry, theta)
    reason = None if within and also_within else Code.END_OF_SEARCH
    return TwoStep(
        values=np.concatenate([stiffness, lengths]),
        sds=np.concatenate([sd_stiffness, sd_lengths]),
        found=(within, also_within),
        rank=rank,
        zero=zero,
        straight_s=straight_s,
        steady_s=float(len(steady) * TWO_STEP_FIT.every * DT),
        reason=reason,
    )


def _not_found(start: Array, zero: float, straight_s: float, reason: Code) -> TwoStep:
    return TwoStep(start.copy(), np.zeros(6), (False, False), 0, zero, straight_s, 0.0, reason)


def _outputs(window: Window) -> Outputs | None:
    """The record on the grid of the outputs: mean yaw rate of each body, heading by its two receivers.

    None if one of the four is not measured.
    """
    record = window.record
    ticks, rows = record.ticks, record.rows
    at = np.arange(0, len(ticks), TWO_STEP_FIT.every)
    columns = [*(_yaw_rate(rows, body, at) for body in (0, 1))]
    columns += [_heading(rows, body, at, window.levers, ticks[at, 2 + body]) for body in (0, 1)]
    found = [column for column in columns if column is not None]
    if len(found) < 4:
        return None
    gravity = GRAVITY * np.sin(ticks[:, 6:8])
    return Outputs(ticks[:, 0].copy(), ticks[:, 1], gravity, np.column_stack(found), at)


def _series(rows: Array, kind: float, place: int, at: NDArray[np.int64]) -> Array | None:
    """Values of one kind and place at these ticks, linear between samples; samples of one instant are
    averaged."""
    chosen = rows[(rows[:, 2] == kind) & (rows[:, 3] == place)]
    if len(chosen) < 2:
        return None
    instants, which = np.unique(chosen[:, 0] * DT + chosen[:, 1], return_inverse=True)
    values = np.bincount(which, chosen[:, 4]) / np.bincount(which)
    return np.asarray(np.interp(at * DT, instants, values))


def _yaw_rate(rows: Array, body: int, at: NDArray[np.int64]) -> Array | None:
    return _series(rows, YAW_RATE, body, at)


def _heading(rows: Array, body: int, at: NDArray[np.int64], levers: Array, near: Array) -> Array | None:
    """Heading of a body, rad, not wrapped. near: an approximate one at the same ticks, rad."""
    pair = (2 * body, 2 * body + 1)
    points = []
    for place in pair:
        north, east = (_series(rows, kind, place, at) for kind in (NORTH, EAST))
        if north is None or east is None:
            return _series(rows, HEADING, body, at)
        points.append((north, east))
    front, rear = ((levers[place][0], levers[place][1]) for place in pair)
    return np.asarray(near + wrap(pair_of(points[0], points[1], front, rear).heading - near))


def _steady_indices(outputs: Outputs, geometry: Array) -> NDArray[np.int64]:
    """Indices into outputs.y of the steady turn, where the wheel angle has been constant for long enough."""
    settling_ticks = math.ceil(
        TWO_STEP_FIT.settling_lengths * float(geometry[3] + geometry[4]) / float(outputs.u.mean()) / DT
    )
    chosen = []
    for k, tick in enumerate(outputs.at):
        recent = outputs.wheel[max(tick - settling_ticks, 0) : tick + 1]
        still = len(recent) > settling_ticks and float(np.ptp(recent)) < STEADY_DRIVING.steer_range
        if still and abs(float(recent[-1])) > TWO_STEP_FIT.turning:
            chosen.append(k)
    return np.array(chosen, dtype=np.int64)


def _stiffnesses(
    outputs: Outputs, steady: NDArray[np.int64], window: Window
) -> tuple[Array, Array, int, bool]:
    """(C_af, C_ar, C_ai; their sds; rank; whether within the search): the minimum of 7.15, over logarithms.

    Speed and roll vary a little and so give a little information on the third number. That decides where on
    the line of equally good solutions it ends.
    """
    g, ticks, n = window.geometry, outputs.at[steady], np.ones(len(steady))
    rolls = window.record.ticks[ticks, 6:8]
    measured = np.column_stack([outputs.y[steady, 0], outputs.y[steady, 2] - outputs.y[steady, 3]])
    scale = np.sqrt(np.array(TWO_STEP_FIT.weights) / len(steady))

    def residuals(logs: Array) -> Array:
        fixed = [value * n for value in (*np.exp(logs), g[5], g[6])]
        inputs = np.column_stack([*fixed, outputs.u[ticks], outputs.wheel[ticks], rolls])
        turn = steady_turn(inputs, g[0], g[1], g[2], g[3], g[4])
        return np.asarray(((measured - turn[:, 1:]) * scale).ravel())

    start_logs = np.log(window.start[:3])
    from scipy.optimize import least_squares  # importing it takes half a second, so only where it is needed

    found = least_squares(
        residuals,
        start_logs,
        bounds=(start_logs - TWO_STEP_FIT.search_range, start_logs + TWO_STEP_FIT.search_range),
        x_scale="jac",
    )
    values = np.exp(found.x)
    _, singular, directions = np.linalg.svd(found.jac, full_matrices=False)
    variance = 2 * found.cost / max(found.fun.size - 3, 1)
    # Along the line the sd must be practically infinite, not zero.
    root = directions.T / np.maximum(singular, TWO_STEP_FIT.singular_floor * singular[0])
    sd = np.sqrt(np.sum(root**2, axis=1) * variance)
    within = bool(np.all(np.abs(found.x - start_logs) < 0.99 * TWO_STEP_FIT.search_range))
    return values, values * sd, int(np.sum(singular > TWO_STEP_FIT.rank_tolerance * singular[0])), within


@dataclass(frozen=True, slots=True)
class _Discrete:
    """The relaxation model from one sample of the outputs to the next."""

    F: Array  # [8, 8]
    input_effect: Array  # [k - 1, 8] change of the state by the inputs


def _discretise(outputs: Outputs, geometry: Array, theta: Array) -> _Discrete:
    """Exact for inputs that are held over a tick, at the mean speed."""
    u = float(outputs.u.mean())
    a = system_matrix(u, geometry, theta)[np.ix_(PREDICTOR_STATES, PREDICTOR_STATES)]
    b = input_matrix(u, geometry, theta)[list(PREDICTOR_STATES)]
    F, held, power, factor = np.eye(8), DT * np.eye(8), np.eye(8), 1.0
    for order in range(1, 12):
        power, factor = power @ a, factor * DT / order
        F = F + factor * power
        held = held + factor * DT / (order + 1) * power
    inputs = np.column_stack([outputs.wheel, outputs.gravity])
    middles = (inputs[:-1] + inputs[1:]) / 2
    n = (len(outputs.at) - 1) * TWO_STEP_FIT.every
    input_effect = (middles[:n] @ (held @ b).T).reshape(-1, TWO_STEP_FIT.every, 8)
    sample_effect = np.zeros((len(input_effect), 8))
    for j in range(TWO_STEP_FIT.every):
        sample_effect = sample_effect @ F.T + input_effect[:, j]
    return _Discrete(np.linalg.matrix_power(F, TWO_STEP_FIT.every), sample_effect)


def _errors(
    outputs: Outputs, steps: Sequence[_Discrete], gains: Array, first: Array, which: NDArray[np.intp]
) -> Array:
    """Prediction errors [q, k, 4] of q predictors (7.19).

    gains: [q, 8, 4]; first: states, [q, 8]; which: [q], index into steps.
    """
    transitions = np.array([s.F for s in steps])[which]
    input_effect = np.array([s.input_effect for s in steps])
    x = first.copy()
    errors = np.zeros((len(x), *outputs.y.shape))
    for k, y in enumerate(outputs.y):
        e = errors[:, k] = y - x[:, OUTPUT_STATES]
        if k < len(outputs.y) - 1:
            x = np.einsum("qij,qj->qi", transitions, x + np.einsum("qij,qj->qi", gains, e))
            x = np.clip(x + input_effect[which, k], -TWO_STEP_FIT.diverged, TWO_STEP_FIT.diverged)
    return errors


def _relaxation_lengths(outputs: Outputs, geometry: Array, theta: Array) -> tuple[Array, Array, bool]:
    """(sigma_f, sigma_r, sigma_i; their sds; whether within `search_range`).

    43 numbers are sought: the logarithms of the three, K (8 x 4) and the first state. Each output is weighted
    by the sd of its errors at the first gain.
    """
    start_logs = np.log(theta[3:])
    first = np.zeros(8)
    first[list(OUTPUT_STATES)] = outputs.y[0]
    gain = np.zeros((8, 4))
    gain[OUTPUT_STATES, range(4)] = TWO_STEP_FIT.first_gain
    point = np.concatenate([start_logs, gain.ravel(), first])
    difference_steps = np.concatenate([np.full(3, 1e-4), np.full(40, 1e-5)])

    def run(points: Array) -> Array:
        # Points that share their relaxation lengths share the model.
        lengths, which = np.unique(points[:, :3], axis=0, return_inverse=True)
        steps = [_discretise(outputs, geometry, np.concatenate([theta[:3], np.exp(one)])) for one in lengths]
        gains = points[:, 3:35].reshape(-1, 8, 4)
        return _errors(outputs, steps, gains, points[:, 35:], which.ravel())

    scale = np.sqrt(np.mean(run(point[None])[0] ** 2, axis=0))

    def residuals(at: Array) -> Array:
        return np.asarray((run(at[None])[0] / scale).ravel())

    def slopes(at: Array) -> Array:
        e = (run(np.vstack([at, at + np.diag(difference_steps)])) / scale).reshape(len(point) + 1, -1)
        return np.asarray(((e[1:] - e[0]) / difference_steps[:, None]).T)

    derivative: Any = slopes  # the type stubs of scipy allow only names here
    search_range = np.concatenate([np.full(3, TWO_STEP_FIT.search_range), np.full(40, np.inf)])
    from scipy.optimize import least_squares  # as above

    found = least_squares(
        residuals,
        point,
        jac=derivative,
        bounds=(point - search_range, point + search_range),
        x_scale="jac",
        max_nfev=TWO_STEP_FIT.most_passes,
    )
    logs = found.x[:3]
    degrees = max(found.fun.size - found.x.size, 1)
    inverse = np.linalg.pinv(found.jac.T @ found.jac)
    sd = np.sqrt(np.maximum(np.diag(inverse)[:3], 0.0) * 2 * found.cost / degrees)
    return (
        np.exp(logs),
        np.exp(logs) * sd,
        bool(np.all(np.abs(logs - start_logs) < 0.99 * TWO_STEP_FIT.search_range)),
    )
