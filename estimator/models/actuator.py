"""Steering actuator: delta'' = -(d/I) delta' + (K/I) u_c.

Source: Karkee (2009), eqs. 3.122 and 5.33, with the sign of the damping corrected (the printed one diverges).
States: wheel angle delta (rad) and its rate (rad/s), appended to those of a model. Input: the command u_c, in
the place of delta. The command sets the *rate* of steering: with a constant one the wheels turn on at (K/d)
u_c, after a transient with the time constant I/d. So u_c must not be a desired wheel angle. Valid within the
steering stops, which are not modelled, and for a valve that is not saturated.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

STATES: Final = ("delta", "delta_rate")
INPUT: Final = "command"


class Actuator(NamedTuple):
    """K, I and d of 5.33; only the ratios K/I (1/s^2 per rad of command) and d/I (1/s) matter."""

    gain: float = 10.0
    inertia: float = 1.0
    damping: float = 10.0


BOSSERD: Final = Actuator()
"""The dissertation's, with a time constant of 0.1 s (its source: Bosserd 2007)."""


def with_actuator(a: Array, b: Array, actuator: Actuator = BOSSERD) -> tuple[Array, Array]:
    """(A, B) of a model whose wheel angle is driven by the actuator.

    a: (n, n). b: (n, m), first column delta. Returns (n+2, n+2) and (n+2, m), first column the command.
    """
    n, m = b.shape
    matrix, inputs = np.zeros((n + 2, n + 2)), np.zeros((n + 2, m))
    matrix[:n, :n] = a
    matrix[:n, n] = b[:, 0]
    matrix[n, n + 1] = 1.0
    matrix[n + 1, n + 1] = -actuator.damping / actuator.inertia
    inputs[:n, 1:] = b[:, 1:]
    inputs[n + 1, 0] = actuator.gain / actuator.inertia
    return matrix, inputs
