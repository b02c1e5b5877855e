"""Answers of many rigs to a step of the wheels, side by side, and how far each parameter moves them.

Source: Karkee (2009), section 6.2.2: for each point of a grid the rig and each of its changed rigs are
simulated (6.16), and the changes of six outputs are made shares of the answer. The linear model is made
discrete exactly, by a Taylor series of the matrix exponential; the path is summed over the samples (6.10,
6.11). Rigs lie side by side in the last axis of every array, so that one instruction works on several.

Systems are packed: the states v, r_t, r_i, then up to three more (slip angles), then psi_t - psi_i. A model
with fewer is filled up with states that decay on their own. psi_t is the integral of r_t.
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.compiled import kernel
from tilth.estimator.models.family import Model
from tilth.estimator.models.parameters import GEOMETRY, Rig
from tilth.estimator.models.relaxation import input_matrix, system_matrix
from tilth.schemas.flow import PARAMETERS

Array = NDArray[np.float64]

OUTPUTS: Final = ("v", "r_t", "r_i", "position", "psi_t", "psi_i")
"""Columns of `step_changes`."""
FIELDS: Final = (*GEOMETRY, *PARAMETERS)
"""Columns of an array of rigs."""
PACKED: Final = 7  # states
_SIDE_BY_SIDE: Final = 4  # points; each with its changed rigs
_TERMS: Final = 22  # of the exponential's series, for a norm of 2 at most
_TWO_PI: Final = 2 * math.pi
_TURN: Final = 1 / _TWO_PI
_WHOLE: Final = 1.5 * 2.0**52  # added and taken away again: rounds to a whole number


@kernel
def relaxation_systems(
    rigs: Array, columns: NDArray[np.int64], share: float, speed: float, a: Array, b: Array
) -> None:
    """Fill a, (n, 1 + k, 7, 7), and b, (n, 1 + k, 7): of each rig, and of it with one parameter raised.

    rigs: (n, 15), as FIELDS. columns: (k,), of those that are raised by the share. speed: m/s.
    """
    keep = np.array([0, 1, 2, 3, 4, 5, 7])
    for point in range(len(rigs)):
        for variant in range(len(columns) + 1):
            rig = rigs[point].copy()
            if variant > 0:
                rig[columns[variant - 1]] *= 1.0 + share
            whole = system_matrix(speed, rig[:9], rig[9:])
            push = input_matrix(speed, rig[:9], rig[9:])
            for i in range(6):
                for j in range(7):
                    a[point, variant, i, j] = whole[i, keep[j]]
                b[point, variant, i] = push[i, 0]
            a[point, variant, 6, :] = 0.0
            a[point, variant, 6, 1], a[point, variant, 6, 2] = 1.0, -1.0
            b[point, variant, 6] = 0.0


@kernel
def step_changes(
    a: Array, b: Array, angle: float, speed: float, samples: int, step_s: float, shares: Array
) -> None:
    """Fill shares, (n, k, 6): change of each output of OUTPUTS as a share of the answer of the first rig.

    a: (n, 1 + k, 7, 7), b: (n, 1 + k, 7), packed, per rad of the wheels. angle: rad. speed: m/s. Velocities:
    root mean square over root mean square; position: distance of the ends over the radius of the turn at the
    end; headings: change over value, at the end.
    """
    points, variants = a.shape[0], a.shape[1]
    lanes = _SIDE_BY_SIDE
    width = lanes * variants
    z = np.zeros((7, 8, width))
    f = np.zeros((8, 8, width))
    spare = np.zeros((8, 8, width))
    sums = np.zeros((6, width))
    for first in range(0, points, lanes):
        for variant in range(variants):
            for lane in range(lanes):
                point = min(first + lane, points - 1)
                at = variant * lanes + lane
                for i in range(7):
                    for j in range(7):
                        z[i, j, at] = a[point, variant, i, j] * step_s
                    z[i, 7, at] = b[point, variant, i] * angle * step_s
        _discretise(z, step_s, f, spare)
        ends = _march(f, speed, samples, step_s, lanes, sums)
        for variant in range(1, variants):
            for lane in range(min(lanes, points - first)):
                at = variant * lanes + lane
                out = shares[first + lane, variant - 1]
                for k in range(3):
                    out[k] = math.sqrt(sums[k, at] / sums[k, lane])
                apart = math.hypot(sums[3, at] - sums[3, lane], sums[4, at] - sums[4, lane])
                out[3] = apart * abs(ends[1, lane]) / speed
                psi_i, psi_i_changed = ends[7, lane] - ends[6, lane], ends[7, at] - ends[6, at]
                out[4] = abs((ends[7, at] - ends[7, lane]) / ends[7, lane])
                out[5] = abs((psi_i_changed - psi_i) / psi_i)


def _discretise(z: Array, step_s: float, f: Array, spare: Array) -> None:
    """Fill f, (8, 8, w): rows the states and psi_t, columns the states and the constant push, over one step.

    z: (7, 8, w), A and the push, times the step. Squared as often as the largest norm needs.
    """
    width = z.shape[2]
    norm = 0.0
    for at in range(width):
        for i in range(7):
            row = 0.0
            for j in range(7):
                row += abs(z[i, j, at])
            norm = max(norm, row)
    halvings = 0
    while norm > 2.0 and halvings < 40:
        norm *= 0.5
        halvings += 1
    part = 0.5**halvings
    # With psi_t as an eighth state the exponential minus one is the sum of terms T_k = Z T_{k-1} / k.
    term = np.zeros((8, 8, width))
    after = spare
    for i in range(8):
        for j in range(8):
            for at in range(width):
                turned = step_s * part if j == 1 and i == 7 else 0.0
                term[i, j, at] = z[i, j, at] * part if i < 7 else turned
                f[i, j, at] = term[i, j, at]
    for k in range(2, _TERMS + 1):
        scale = part / k
        for i in range(7):
            for j in range(8):
                for at in range(width):
                    after[i, j, at] = scale * (
                        z[i, 0, at] * term[0, j, at] + z[i, 1, at] * term[1, j, at]
                        + z[i, 2, at] * term[2, j, at] + z[i, 3, at] * term[3, j, at]
                        + z[i, 4, at] * term[4, j, at] + z[i, 5, at] * term[5, j, at]
                        + z[i, 6, at] * term[6, j, at]
                    )  # fmt: skip
        for j in range(8):
            for at in range(width):
                after[7, j, at] = scale * step_s * term[1, j, at]
        for i in range(8):
            for j in range(8):
                for at in range(width):
                    term[i, j, at] = after[i, j, at]
                    f[i, j, at] += after[i, j, at]
    for _ in range(halvings):  # exp(2 Z) - 1 = (exp(Z) - 1)^2 + 2 (exp(Z) - 1)
        for i in range(8):
            for j in range(8):
                for at in range(width):
                    total = 2.0 * f[i, j, at]
                    for k in range(7):
                        total += f[i, k, at] * f[k, j, at]
                    after[i, j, at] = total
        for i in range(8):
            for j in range(8):
                for at in range(width):
                    f[i, j, at] = after[i, j, at]


def _march(f: Array, speed: float, samples: int, step_s: float, lanes: int, sums: Array) -> Array:
    """States at the last sample, (8, w). f: exponential less one, added to the state at each step.

    Fills sums, (5, w): of v^2, r_t^2, r_i^2 in the first rigs' columns and of the squared differences from
    them in the others; north and east of the tractor's CG at the end, m (6.10, 6.11).
    """
    width = f.shape[2]
    x = np.zeros((8, width))
    y = np.zeros((8, width))
    cosine = np.ones(width)
    sine = np.zeros(width)
    turn_sine = np.zeros(width)
    turn_cosine = np.zeros(width)
    sums[:, :] = 0.0
    sums[3, :] = speed * step_s  # at t = 0
    for _ in range(samples - 1):
        for i in range(8):
            # In two parts, and not in one: a compiler makes vectors of a loop over few rows only.
            for at in range(width):
                y[i, at] = (
                    f[i, 0, at] * x[0, at] + f[i, 1, at] * x[1, at]
                    + f[i, 2, at] * x[2, at] + f[i, 3, at] * x[3, at]
                )  # fmt: skip
            for at in range(width):
                y[i, at] += (
                    f[i, 4, at] * x[4, at] + f[i, 5, at] * x[5, at] + f[i, 6, at] * x[6, at] + f[i, 7, at]
                )
            for at in range(width):
                y[i, at] += x[i, at]
        # The heading turns by t, folded into half a turn: sine and cosine by their series.
        for at in range(width):
            t = y[7, at] - x[7, at]
            t -= _TWO_PI * ((t * _TURN + _WHOLE) - _WHOLE)
            q = t * t
            turn_sine[at] = t * (
                1 + q * (-1 / 6 + q * (1 / 120 + q * (-1 / 5040 + q * (1 / 362880 - q * (1 / 39916800)))))
            )
            turn_cosine[at] = 1 + q * (
                -1 / 2 + q * (1 / 24 + q * (-1 / 720 + q * (1 / 40320 - q * (1 / 3628800))))
            )
        for at in range(width):
            turned = cosine[at] * turn_cosine[at] - sine[at] * turn_sine[at]
            sine[at] = sine[at] * turn_cosine[at] + cosine[at] * turn_sine[at]
            cosine[at] = turned
        for at in range(width):
            sums[3, at] += (speed * cosine[at] - y[0, at] * sine[at]) * step_s
        for at in range(width):
            sums[4, at] += (speed * sine[at] + y[0, at] * cosine[at]) * step_s
        for k in range(3):
            for at in range(lanes):
                sums[k, at] += y[k, at] * y[k, at]
            for variant in range(1, width // lanes):
                for lane in range(lanes):
                    change = y[k, variant * lanes + lane] - y[k, lane]
                    sums[k, variant * lanes + lane] += change * change
        x, y = y, x
    return x


def packed_systems(
    model: Model, rig: Rig, rigs: Array, columns: NDArray[np.int64], share: float, speed: float
) -> tuple[Array, Array]:
    """(a, b) as of `step_changes`. rigs: (n, 15), as FIELDS; the other fields are those of `rig`.

    Raises ValueError for a model without inertia, whose velocities are no states.
    """
    shape = (len(rigs), len(columns) + 1, PACKED)
    a, b = np.zeros((*shape, PACKED)), np.zeros(shape)
    if model.name == "relaxation":
        relaxation_systems(rigs, columns, share, speed, a, b)
        return a, b
    if model.states[:3] != ("v", "r_t", "r_i"):
        raise ValueError(
            f"the {model.name} model has no velocities of its own to follow: take the dynamic, relaxation "
            "or the nonlinear model"
        )
    core = [k for k, name in enumerate(model.states) if name not in ("y_t", "psi_t", "psi_i")]
    used, bent = [*range(len(core)), 6], [*core, model.states.index("psi_t")]
    for at, values in enumerate(rigs):
        for variant in range(shape[1]):
            changed = values.copy()
            if variant:
                changed[columns[variant - 1]] *= 1 + share
            whole, push = model.matrices(
                rig._replace(**dict(zip(FIELDS, changed.tolist(), strict=True))), speed
            )
            packed = -np.eye(PACKED)
            packed[np.ix_(used, used)] = whole[np.ix_(bent, bent)]
            packed[6] = np.array([0.0, 1.0, -1.0, 0.0, 0.0, 0.0, 0.0])
            a[at, variant] = packed
            b[at, variant, : len(core)] = push[core, 0]
    return a, b


def growth(a: Array) -> Array:
    """Largest real part of the eigenvalues of each matrix, 1/s, shape (n,). a: (n, 7, 7)."""
    return np.asarray(np.linalg.eigvals(a).real.max(axis=-1), dtype=np.float64)
