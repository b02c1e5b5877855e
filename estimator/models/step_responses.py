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
AHEAD: Final = 16  # samples that are worked out from one state
_DOUBLINGS: Final = 4  # of a step, to so many
_NORM: Final = 0.5  # of the exponential's series
_TERMS: Final = 13  # which are enough for it
_TWO_PI: Final = 2 * math.pi
_TURN: Final = 1 / _TWO_PI
_WHOLE: Final = 1.5 * 2.0**52  # added and taken away again: rounds to a whole number
_S: Final = tuple((-1) ** k / math.factorial(2 * k + 1) for k in range(1, 9))  # sine's series
_C: Final = tuple((-1) ** k / math.factorial(2 * k) for k in range(1, 9))  # cosine's


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
            disturbance = input_matrix(speed, rig[:9], rig[9:])
            for i in range(6):
                for j in range(7):
                    a[point, variant, i, j] = whole[i, keep[j]]
                b[point, variant, i] = disturbance[i, 0]
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
    z = np.zeros((8, 8))
    f = np.zeros((8, 8))
    spare = np.zeros((3, 8, 8))
    rows = np.zeros((4, 8, AHEAD))
    reference = np.zeros((3, samples + AHEAD))
    own, ends = np.zeros(9), np.zeros(9)
    for point in range(a.shape[0]):
        for variant in range(a.shape[1]):
            for i in range(7):
                for j in range(7):
                    z[i, j] = a[point, variant, i, j] * step_s
                z[i, 7] = b[point, variant, i] * angle * step_s
            z[7, 1] = step_s
            _discretise(z, f, spare)
            _look_ahead(f, rows)
            _march(f, rows, speed, samples, step_s, variant == 0, reference, spare, ends)
            if variant == 0:
                own[:] = ends
                continue
            out = shares[point, variant - 1]
            for k in range(3):
                out[k] = math.sqrt(ends[k] / own[k])
            out[3] = math.hypot(ends[3] - own[3], ends[4] - own[4]) * abs(own[5]) / speed
            for k in range(6, 8):
                out[k - 2] = abs((ends[k] - own[k]) / own[k])


def _discretise(z: Array, f: Array, spare: Array) -> None:
    """Fill f, (8, 8): the exponential of a step, less one. Rows: the states and psi_t; columns: the states
    and the constant push, for no state depends on psi_t.

    z: (8, 8), A and the push, times the step; its last row turns r_t into psi_t. Squared as often as needed.
    """
    norm = 0.0
    for i in range(7):
        row = 0.0
        for j in range(7):
            row += abs(z[i, j])
        norm = max(norm, row)
    halvings = 0
    while norm > _NORM and halvings < 40:
        norm *= 0.5
        halvings += 1
    part = 0.5**halvings
    # The exponential minus one is the sum of terms T_k = Z T_{k-1} / k.
    for i in range(8):
        for j in range(8):
            spare[0, i, j] = z[i, j] * part
            f[i, j] = spare[0, i, j]
    for k in range(2, _TERMS + 1):
        now, after = spare[k % 2], spare[1 - k % 2]
        _product(z, now, part / k, after)
        for i in range(8):
            for j in range(8):
                f[i, j] += after[i, j]
    for _ in range(halvings):
        _twice(f, spare[0])


def _product(left: Array, right: Array, scale: float, out: Array) -> None:
    """scale times left times right, (8, 8): over the seven states that rows and columns have in common."""
    for i in range(8):
        for j in range(8):
            out[i, j] = scale * (
                left[i, 0] * right[0, j] + left[i, 1] * right[1, j] + left[i, 2] * right[2, j]
                + left[i, 3] * right[3, j] + left[i, 4] * right[4, j] + left[i, 5] * right[5, j]
                + left[i, 6] * right[6, j]
            )  # fmt: skip


def _twice(f: Array, spare: Array) -> None:
    """From one step to two: exp(2 Z) - 1 = (exp(Z) - 1)^2 + 2 (exp(Z) - 1)."""
    _product(f, f, 1.0, spare)
    for i in range(8):
        for j in range(8):
            f[i, j] = spare[i, j] + 2.0 * f[i, j]


def _look_ahead(f: Array, rows: Array) -> None:
    """Fill rows, (4, 8, AHEAD): what v, r_t, r_i and the change of psi_t will be after 1, 2, … steps, by the
    states now and the push. Rows of powers of the step, each from the one before."""
    for out in range(4):
        row = rows[out]
        at = out if out < 3 else 7
        for s in range(8):
            row[s, 0] = f[at, s] + (1.0 if at == s and at < 3 else 0.0)
        for j in range(1, AHEAD):
            for s in range(8):
                more = row[s, j - 1]
                for i in range(7):
                    more += row[i, j - 1] * f[i, s]
                row[s, j] = more + (f[7, s] if at == 7 else 0.0)


def _march(
    f: Array, rows: Array, speed: float, samples: int, step_s: float, first: bool, reference: Array,
    spare: Array, ends: Array,
) -> None:  # fmt: skip
    """Fill ends, (9,): sums of v^2, r_t^2, r_i^2, of the first rig, which are kept in `reference`, or of
    the squared differences from it; north and east of the tractor's CG at the end, m (6.10, 6.11); there
    r_t, psi_t, psi_i.

    f: over one step, overwritten. rows: of `_look_ahead`. So many samples are worked out from one state.
    """
    x = np.zeros(8)
    x[7] = 1.0
    y = np.zeros((4, AHEAD))
    sums = np.zeros((5, AHEAD))
    one = spare[1]
    one[:, :] = f
    for _ in range(_DOUBLINGS):
        _twice(f, spare[0])
    psi = 0.0
    at = 1
    while at < samples:
        count = min(AHEAD, samples - at)
        x0, x1, x2, x3, x4, x5, x6 = x[0], x[1], x[2], x[3], x[4], x[5], x[6]
        for out in range(4):
            row = rows[out]
            start = psi if out == 3 else 0.0
            for j in range(AHEAD):
                y[out, j] = start + (
                    row[0, j] * x0 + row[1, j] * x1 + row[2, j] * x2 + row[3, j] * x3
                    + row[4, j] * x4 + row[5, j] * x5 + row[6, j] * x6 + row[7, j]
                )  # fmt: skip
        _add(y, count, at, first, reference, sums)
        _add_path(y, count, speed, step_s, sums)
        psi = y[3, count - 1]
        if count == AHEAD:
            _ahead(f, x)
        else:
            for _ in range(count):
                _ahead(one, x)
        at += count
    for k in range(5):
        total = speed * step_s if k == 3 else 0.0  # at t = 0
        for j in range(AHEAD):
            total += sums[k, j]
        ends[k] = total
    ends[5], ends[6], ends[7] = x[1], psi, psi - x[6]


def _ahead(f: Array, x: Array) -> None:
    """The states, (8,), as f leads on; the last stays one."""
    x0, x1, x2, x3, x4, x5, x6 = x[0], x[1], x[2], x[3], x[4], x[5], x[6]
    for i in range(7):
        x[i] += (
            f[i, 0] * x0 + f[i, 1] * x1 + f[i, 2] * x2 + f[i, 3] * x3 + f[i, 4] * x4 + f[i, 5] * x5
            + f[i, 6] * x6 + f[i, 7]
        )  # fmt: skip


def _add(y: Array, count: int, at: int, first: bool, reference: Array, sums: Array) -> None:
    """Squares of the velocities of the samples from `at` on, or of their differences from the reference."""
    for k in range(3):
        kept = reference[k, at : at + AHEAD]
        if first:
            for j in range(count):
                kept[j] = y[k, j]
                sums[k, j] += y[k, j] * y[k, j]
        else:
            for j in range(count):
                change = y[k, j] - kept[j]
                sums[k, j] += change * change


def _add_path(y: Array, count: int, speed: float, step_s: float, sums: Array) -> None:
    """The path, sample by sample. Sine and cosine by their series, of half the heading within a turn."""
    for j in range(count):
        h = y[3, j]
        h = 0.5 * (h - _TWO_PI * ((h * _TURN + _WHOLE) - _WHOLE))
        q = h * h
        sine = h * (
            1 + q * (_S[0] + q * (_S[1] + q * (_S[2] + q * (_S[3] + q * (_S[4] + q * (_S[5] + q * (
                _S[6] + q * _S[7])))))))
        )  # fmt: skip
        cosine = 1 + q * (
            _C[0] + q * (_C[1] + q * (_C[2] + q * (_C[3] + q * (_C[4] + q * (_C[5] + q * (
                _C[6] + q * _C[7]))))))
        )  # fmt: skip
        east = 2 * sine * cosine
        north = 1 - 2 * sine * sine
        sums[3, j] += (speed * north - y[0, j] * east) * step_s
        sums[4, j] += (speed * east + y[0, j] * north) * step_s


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
            whole, disturbance = model.matrices(
                rig._replace(**dict(zip(FIELDS, changed.tolist(), strict=True))), speed
            )
            packed = -np.eye(PACKED)
            packed[np.ix_(used, used)] = whole[np.ix_(bent, bent)]
            packed[6] = np.array([0.0, 1.0, -1.0, 0.0, 0.0, 0.0, 0.0])
            a[at, variant] = packed
            b[at, variant, : len(core)] = disturbance[core, 0]
    return a, b


def growth(a: Array) -> Array:
    """Largest real part of the eigenvalues of each matrix, 1/s, shape (n,). a: (n, 7, 7)."""
    return np.asarray(np.linalg.eigvals(a).real.max(axis=-1), dtype=np.float64)
