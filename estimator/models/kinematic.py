"""Tractor and towed single-axle implement whose wheels move where they point: no slip.

Source: Karkee (2009), eqs. 5.1-5.3, which are 3.9-3.13 without v = b r in the first line. States: lateral
position y_t (m) and headings psi_t, psi_i (rad), relative to a line that the tractor nearly follows. Form: x'
= A(u) x + B(u) w, u the forward speed (m/s), w as INPUTS. Valid for small angles and without slip: slowly, on
firm soil, below about 0.2 Hz. Since 5.1 leaves out b r, y_t is the position of the rear axle; the lateral
velocity of the CG is b r_t. Gravity along a slope has no effect, since nothing slips. It also holds in
reverse, where the implement's heading is unstable: the rig jackknifes.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

STATES: Final = ("y_t", "psi_t", "psi_i")

INPUTS: Final = ("delta", "gravity_t", "gravity_i")
"""Front wheel angle (rad); g sin(roll) of the tractor and of the implement (m/s^2)."""


def system_matrix(u: float, geometry: Array, theta: Array) -> Array:
    """A(u), shape (3, 3).

    u: forward speed, m/s, negative in reverse. geometry: shape (9,), as parameters.GEOMETRY. theta: not used.
    """
    _, _, _, d, e, _, _, _, _ = geometry
    towed = d + e  # L^i
    return np.array(
        [
            [0.0, u, 0.0],  # 5.1
            [0.0, 0.0, 0.0],  # 5.2
            [0.0, u / towed, -u / towed],  # 5.3
        ]
    )


def input_matrix(u: float, geometry: Array, theta: Array) -> Array:
    """B(u), shape (3, 3), columns as INPUTS. Arguments as of `system_matrix`."""
    a, b, c, d, e, _, _, _, _ = geometry
    wheelbase, towed, hitch = a + b, d + e, c - b  # L^t, L^i, and the hitch behind the rear axle
    return np.array(
        [
            [0.0, 0.0, 0.0],
            [u / wheelbase, 0.0, 0.0],
            [-u * hitch / (wheelbase * towed), 0.0, 0.0],
        ]
    )
