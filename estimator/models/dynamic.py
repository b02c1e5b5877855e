"""Tractor and towed single-axle implement on tyres without relaxation length: M x' = N x + P w.

Source: Karkee (2009), eqs. 3.99-3.106, with gravity along a side slope as two more inputs. Derived here by
inserting the slip angles of 3.86, 3.89 and 3.93 into 3.115-3.117.
States: lateral velocity v of the tractor's CG (m/s), yaw rates r_t, r_i (rad/s), lateral position y_t (m) and
headings psi_t, psi_i (rad), both relative to a line that the tractor nearly follows.
Form: x' = A(u) x + B(u) w, u the forward speed (m/s), w as INPUTS. Force -C alpha of each axle.
Valid for small angles of steering, articulation and slip (to about 10°) at constant or slowly changing speed,
not at standstill. In reverse the slip angle counts from the wheel's backward direction, so that the force
still opposes the slip; both yaw motions are then unstable, as on the real machine.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

STATES: Final = ("v", "r_t", "r_i", "y_t", "psi_t", "psi_i")

INPUTS: Final = ("delta", "gravity_t", "gravity_i")
"""Front wheel angle (rad); g sin(roll) of the tractor and of the implement (m/s^2)."""


def inertia(geometry: Array) -> Array:
    """Upper left block of M, of v, r_t and r_i, shape (3, 3) (3.115-3.117). geometry: shape (9,)."""
    _, _, c, d, _, m_t, m_i, i_t, i_i = geometry
    return np.array(
        [
            [m_t + m_i, -m_i * c, -m_i * d],
            [-m_i * c, i_t + m_i * c**2, m_i * c * d],
            [-m_i * d, m_i * c * d, i_i + m_i * d**2],
        ]
    )


def axle_arms(geometry: Array) -> Array:
    """Generalised forces on v, r_t and r_i per unit force of each axle, (3, 3): columns front, rear,
    implement.

    Its transpose gives each axle's lateral velocity from v, r_t and r_i.
    """
    a, b, c, d, e, _, _, _, _ = geometry
    return np.array([[1.0, 1.0, 1.0], [a, -b, -c], [0.0, 0.0, -(d + e)]])


def turning(u: float, geometry: Array) -> Array:
    """Inertia forces of the turning frame, the factors of r_t in 3.115-3.117, shape (3,)."""
    _, _, c, d, _, m_t, m_i, _, _ = geometry
    return u * np.array([-(m_t + m_i), m_i * c, m_i * d])


def gravity_arms(geometry: Array) -> Array:
    """Generalised forces on v, r_t and r_i per m/s^2 of gravity along the slope on either body, (3, 2).

    The implement's CG moves to the right by dy - c dpsi_t - d dpsi_i, which gives the arms of its weight.
    """
    _, _, c, d, _, m_t, m_i, _, _ = geometry
    return np.array([[m_t, m_i], [0.0, -c * m_i], [0.0, -d * m_i]])


def system_matrix(u: float, geometry: Array, theta: Array) -> Array:
    """A(u), shape (6, 6).

    u: forward speed, m/s, negative in reverse. geometry: shape (9,), as parameters.GEOMETRY. theta: shape
    (6,), as schemas.flow.PARAMETERS; the relaxation lengths are not used. Raises ValueError at standstill.
    """
    if u == 0.0:
        raise ValueError("the dynamic model divides by speed: use the relaxation model at standstill")
    c_af, c_ar, c_ai, _, _, _ = theta
    arms = axle_arms(geometry)
    stiffness = arms * np.array([c_af, c_ar, c_ai])  # each column times its axle's
    forces = np.zeros((3, 6))
    forces[:, :3] = -stiffness @ arms.T / abs(u)
    forces[:, 1] += turning(u, geometry)
    forces[:, 4] = -np.sign(u) * stiffness[:, 2]  # 3.93: the implement's slip angle holds psi_t - psi_i
    forces[:, 5] = np.sign(u) * stiffness[:, 2]
    matrix = np.zeros((6, 6))
    matrix[:3] = np.linalg.solve(inertia(geometry), forces)
    matrix[3, 0], matrix[3, 4] = 1.0, u  # 3.103
    matrix[4, 1] = matrix[5, 2] = 1.0  # 3.104, 3.105
    return matrix


def input_matrix(u: float, geometry: Array, theta: Array) -> Array:
    """B(u), shape (6, 3), columns as INPUTS. Arguments as of `system_matrix`."""
    forces = np.zeros((3, 3))
    forces[:, 0] = np.sign(u) * theta[0] * axle_arms(geometry)[:, 0]
    forces[:, 1:] = gravity_arms(geometry)
    matrix = np.zeros((6, 3))
    matrix[:3] = np.linalg.solve(inertia(geometry), forces)
    return matrix
