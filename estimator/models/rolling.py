"""Tractor and towed implement in the plane with both bodies' roll on their tyres: the filters' motion model.

The planar model of nonlinear.py and two more degrees of freedom. Each body leans about the line on the ground
below its CG: lean phi, relative to the ground's cross slope, positive right side down, and its rate p. The
line is what tyres and hitch hold; the CG at height h sways above it, so that the side forces move
m (a_y + h p'). The front axle hangs on a pivot, the drawbar is at height h_h. The speed is held, by whatever
force of the driven wheels it takes; what an implement's rolling resistance pulls takes load off the front
wheels. The two wheels of an axle slip each by itself, as far as `two_track` says. Valid for driving forward,
to 35 degrees of the wheels and 60 of articulation.

Source: Kane's equations, in symbols in deploy/motion_equations.py. generated/rolling_kernels.py is written
from them: values and exact derivatives. Names of states, inputs and parameters: rolling_terms.py.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.compiled import inline_kernel, inner_kernel
from tilth.estimator.models.generated.rolling_kernels import motion, motion_by_parameter, motion_by_state
from tilth.estimator.models.rolling_terms import CONSTANTS, INPUTS, PARAMETERS, SPEEDS, STATES

Array = NDArray[np.float64]

N_STATES: Final = len(STATES)
N_INPUTS: Final = len(INPUTS)
N_PARAMETERS: Final = len(PARAMETERS) + len(CONSTANTS)
BY_INPUT: Final = N_STATES - 1  # columns of derivatives: states but psi_i, then inputs but u'
N_COLUMNS: Final = BY_INPUT + N_INPUTS - 1


class MotionRates(NamedTuple):
    """The rates at one state and their derivatives, with work arrays."""

    M: Array  # (6, 6), mass matrix, then its factors
    right: Array  # (6, 1), then drive's force (N), v', r_t', r_i', p_t', p_i'
    slip: Array  # (3,), alpha'
    right_by_state: Array  # (6, 17), derivatives of the same by states but psi_i and inputs but u'
    slip_by_state: Array  # (3, 17)
    right_by_parameter: Array  # (6, 32), by PARAMETERS
    slip_by_parameter: Array  # (3, 32)


def empty_motion() -> MotionRates:
    """Arrays for `rates` and its derivatives."""
    return MotionRates(
        np.zeros((SPEEDS, SPEEDS)), np.zeros((SPEEDS, 1)), np.zeros(3), np.zeros((SPEEDS, N_COLUMNS)),
        np.zeros((3, N_COLUMNS)), np.zeros((SPEEDS, len(PARAMETERS))), np.zeros((3, len(PARAMETERS))),
    )  # fmt: skip


@inline_kernel
def factorise(M: Array) -> None:
    """Gauss's factors of M (n, n), in its place, without a search for pivots."""
    n = M.shape[0]
    for k in range(n):
        for i in range(k + 1, n):
            M[i, k] /= M[k, k]
            for j in range(k + 1, n):
                M[i, j] -= M[i, k] * M[k, j]


@inner_kernel
def solve(factors: Array, B: Array) -> None:
    """Solve M X = B (n, m) in the place of B. factors: as of `factorise`."""
    n, m = B.shape
    for k in range(n):
        for i in range(k + 1, n):
            for j in range(m):
                B[i, j] -= factors[i, k] * B[k, j]
    for k in range(n - 1, -1, -1):
        for i in range(k + 1, n):
            for j in range(m):
                B[k, j] -= factors[k, i] * B[i, j]
        for j in range(m):
            B[k, j] /= factors[k, k]


@inner_kernel
def rates(x: Array, w: Array, p: Array, at: MotionRates, out: Array) -> None:
    """Fill out (12,), x', and the first three arrays of `at`. p: PARAMETERS and CONSTANTS, (38,)."""
    motion(x, w, p, at.M, at.right, at.slip)
    factorise(at.M)
    solve(at.M, at.right)
    for i in range(3):
        out[i] = at.right[1 + i, 0]
        out[3 + i] = at.slip[i]
    for body in range(2):
        out[6 + body], out[8 + body] = x[8 + body], at.right[4 + body, 0]
        out[10 + body] = x[1 + body]


@inline_kernel
def rates_by_state(x: Array, w: Array, p: Array, at: MotionRates) -> None:
    """Fill right_by_state and slip_by_state of `at`; `rates` has filled its first three at the same state."""
    at.right_by_state[:] = 0.0
    motion_by_state(x, w, p, at.right[:, 0], at.right_by_state, at.slip_by_state)
    solve(at.M, at.right_by_state)


@inline_kernel
def rates_by_parameter(x: Array, w: Array, p: Array, at: MotionRates) -> None:
    """Fill right_by_parameter and slip_by_parameter, as `rates_by_state` its own."""
    at.right_by_parameter[:] = 0.0
    motion_by_parameter(x, w, p, at.right[:, 0], at.right_by_parameter, at.slip_by_parameter)
    solve(at.M, at.right_by_parameter)
