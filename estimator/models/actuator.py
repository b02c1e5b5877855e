"""Steering actuator: delta'' = -(d/I) delta' + (K/I) u_c.

Source: Karkee (2009), eqs. 3.122 and 5.33 with the sign of the damping put right (the printed one diverges).
States: wheel angle delta (rad) and its rate (rad/s), appended to a model's own. Input: the command u_c takes
the place of delta. The command sets the *rate* of steering: held constant, the wheels go on turning at
(K/d) u_c with the time constant I/d. Whoever feeds a wanted wheel angle into it closes no loop that is meant.
Valid within the steering stop, which it does not know, and for a valve that is not saturated.
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
    """(A, B) of a model behind the actuator.

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
