"""Tractor and towed single-axle implement with tyre relaxation lengths: M x' = N x + P u, so x' = A x + B u.

Karkee (2009), eqs. 3.108-3.121, with the erratum of 3.121 (row 2 of N holds c C_ai in the column of the
implement's slip angle), and with gravity along a side slope as two more inputs. Slip angle alpha = direction
of travel minus direction of facing, lateral force -C alpha, right turns and right-hand wheel angles positive.

Plain arrays and numpy only, so that a compiler of numeric kernels can take these functions as they are.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.schemas.machine import Machine

Array = NDArray[np.float64]

STATES: Final = ("v", "r_t", "r_i", "alpha_f", "alpha_r", "alpha_i", "y_t", "psi_t", "psi_i")
"""Lateral velocity of the tractor's CG in its body frame (m/s), yaw rates (rad/s), slip angles (rad), lateral
position of the tractor's CG (m) and headings (rad), both from a line that the tractor nearly follows."""

INPUTS: Final = ("delta", "gravity_t", "gravity_i")
"""Front wheel angle (rad); g sin(roll) of the tractor and of the implement (m/s^2)."""

GEOMETRY: Final = ("a", "b", "c", "d", "e", "m_t", "m_i", "I_t", "I_i")
"""Distances (m), masses (kg) and yaw inertias (kg m^2), in the order of every array `geometry`."""


def geometry_of(machine: Machine) -> Array:
    """The values of a machine file in the order of GEOMETRY, shape (9,)."""
    tractor, implement = machine.tractor, machine.implement
    quantities = (
        tractor.a, tractor.b, tractor.c, implement.d, implement.e,
        tractor.mass, implement.mass, tractor.yaw_inertia, implement.yaw_inertia,
    )  # fmt: skip
    return np.array([quantity.value for quantity in quantities])


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


def system_matrix(u: float, geometry: Array, theta: Array) -> Array:
    """A(u), shape (9, 9).

    u: forward speed, m/s. geometry: shape (9,), as GEOMETRY. theta: shape (6,), as schemas.flow.PARAMETERS.
    """
    a, b, c, d, e, m_t, m_i, _, _ = geometry
    c_af, c_ar, c_ai, sigma_f, sigma_r, sigma_i = theta
    forces = np.zeros((3, 9))  # the first three rows of N
    forces[:, 1] = [-u * (m_t + m_i), u * m_i * c, u * m_i * d]
    forces[:, 3] = [-c_af, -a * c_af, 0.0]
    forces[:, 4] = [-c_ar, b * c_ar, 0.0]
    forces[:, 5] = [-c_ai, c * c_ai, (d + e) * c_ai]
    matrix = np.zeros((9, 9))
    matrix[:3] = np.linalg.solve(inertia(geometry), forces)
    matrix[3, :4] = [1 / sigma_f, a / sigma_f, 0.0, -u / sigma_f]  # 3.109
    matrix[4, :5] = [1 / sigma_r, -b / sigma_r, 0.0, 0.0, -u / sigma_r]  # 3.111
    matrix[5, :3] = [1 / sigma_i, -c / sigma_i, -(d + e) / sigma_i]  # 3.114
    matrix[5, 5:] = [-u / sigma_i, 0.0, u / sigma_i, -u / sigma_i]
    matrix[6, 0], matrix[6, 7] = 1.0, u  # 3.118
    matrix[7, 1] = matrix[8, 2] = 1.0  # 3.119, 3.120
    return matrix


def input_matrix(u: float, geometry: Array, theta: Array) -> Array:
    """B(u), shape (9, 3), columns as INPUTS. Arguments as of `system_matrix`.

    Gravity acts at both CGs, to the right where the right side is down. The implement's CG moves to the right
    by dy - c dpsi_t - d dpsi_i, which gives the arms of its force.
    """
    _, _, c, d, _, m_t, m_i, _, _ = geometry
    forces = np.array([[m_t, m_i], [0.0, -c * m_i], [0.0, -d * m_i]])
    matrix = np.zeros((9, 3))
    matrix[:3, 1:] = np.linalg.solve(inertia(geometry), forces)
    matrix[3, 0] = -u / theta[3]  # 3.109
    return matrix
