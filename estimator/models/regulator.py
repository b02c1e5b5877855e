"""Linear quadratic regulator for a model, with or without the steering actuator.

Source: Karkee (2009), eqs. 5.31 and 5.32: u_c = -K x with the least integral of x'Qx + u'Ru.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, solve_continuous_are

from tilth.estimator.models.linear_analysis import Complex, System, eigenvalues

Array = NDArray[np.float64]


class Regulator(NamedTuple):
    """Gain of the first input on each state at one speed, with the closed-loop poles of its model."""

    speed: float
    states: tuple[str, ...]
    gain: Array  # (n,)
    poles: Complex  # (n,) of A - B K
    cost: Array  # (n, n): x' cost x is what is still to come from x


def regulator(sys: System, q: float | Array = 1.0, r: float = 800.0) -> Regulator:
    """Gain on the first input.

    q: weight of every state, of each (n,) or a matrix (n, n). r: weight of the input. The defaults are the
    dissertation's. Raises ValueError where no gain makes the system stable.
    """
    n = len(sys.a)
    b = sys.b[:, :1]
    weight = np.asarray(q, np.float64)
    weights = weight if weight.ndim == 2 else np.diag(np.broadcast_to(weight, (n,)))
    try:
        cost = solve_continuous_are(sys.a, b, weights, np.array([[r]]))
    except LinAlgError as error:
        raise ValueError(
            f"no gain steadies this rig at {sys.speed:g} m/s: choose another speed or other weights ({error})"
        ) from None
    gain = (b.T @ cost / r)[0]
    return Regulator(sys.speed, sys.states, gain, eigenvalues(sys.a - b * gain), cost)


def gain_on(states: Sequence[str], gain: Array, target: Sequence[str]) -> Array:
    """The same gain for a system with other states, shape (len(target),): by name, zero where it has none.

    Raises ValueError where the target lacks a state that the gain needs.
    """
    missing = [name for name in states if name not in target]
    if missing:
        raise ValueError(f"the gain needs {', '.join(missing)}, which that system does not have")
    table = dict(zip(states, gain.tolist(), strict=True))
    return np.array([table.get(name, 0.0) for name in target])


def closed_loop(sys: System, gain: Array) -> Array:
    """A - B K for a gain on the first input, shape (n, n). gain: (n,)."""
    return np.asarray(sys.a - sys.b[:, :1] * gain)
