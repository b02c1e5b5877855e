"""Tractor and towed single-axle implement with tyre relaxation lengths: M x' = N x + P w.

Source: Karkee (2009), eqs. 3.108-3.121, with the erratum of 3.121 (row 2 of N holds c C_ai in the column of
the implement's slip angle), and with gravity along a side slope as two more inputs.
States: those of the dynamic model and, before the positions, the slip angle of each axle (rad), which follows
the direction of travel over a distance: sigma alpha' = (lateral velocity of the axle across its wheels) - |u|
alpha. Slip angle = direction of travel minus direction of facing, lateral force -C alpha.
Form: x' = A(u) x + B(u) w, u the forward speed (m/s), w as INPUTS.
Valid for small angles of steering, articulation and slip (to about 10°) at constant or slowly changing speed;
a constant relaxation length is doubtful below about 1 m/s. At standstill tyres become springs. In reverse the
slip angle counts from the wheel's backward direction, so that the force still opposes the slip; the rig is
then unstable, as it is in truth: it folds up.

It uses only arrays and numpy, so kernels can call these functions.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.models.dynamic import axle_arms, gravity_arms, inertia, turning
from tilth.estimator.models.parameters import GEOMETRY as GEOMETRY
from tilth.estimator.models.parameters import geometry_of as geometry_of
from tilth.schemas.plausible import GRAVITY

Array = NDArray[np.float64]

STATES: Final = ("v", "r_t", "r_i", "alpha_f", "alpha_r", "alpha_i", "y_t", "psi_t", "psi_i")
"""Lateral velocity of the tractor's CG in its body frame (m/s), yaw rates (rad/s), slip angles (rad), lateral
position of the tractor's CG (m) and headings (rad), both from a line that the tractor nearly follows."""

INPUTS: Final = ("delta", "gravity_t", "gravity_i")
"""Front wheel angle (rad); g sin(roll) of the tractor and of the implement (m/s^2)."""


def system_matrix(
    u: float, geometry: Array, theta: Array, rolling: float = 0.0, heights: tuple[float, float] = (0.0, 0.0)
) -> Array:
    """A(u), shape (9, 9).

    u: forward speed, m/s, negative in reverse. geometry: shape (9,), as GEOMETRY. theta: shape (6,), as
    schemas.flow.PARAMETERS. rolling: rolling resistance over load, and the heights of both CGs (m), through
    which it turns the bodies; see steady_turn.
    """
    c_af, c_ar, c_ai, sigma_f, sigma_r, sigma_i = theta
    stiffness = np.array([c_af, c_ar, c_ai])
    lengths = np.array([sigma_f, sigma_r, sigma_i])
    arms = axle_arms(geometry)
    resisting, skew = _rolling(u, geometry, rolling, heights)
    forces = np.zeros((3, 9))  # the first three rows of N
    forces[:, 1] = turning(u, geometry) - u * skew
    forces[:, 3:6] = -arms * stiffness
    # The implement's drag points along it: across the tractor, at the hitch, with the articulation.
    forces[0, 7], forces[1, 7] = resisting[1], -geometry[2] * resisting[1]
    forces[0, 8], forces[1, 8] = -resisting[1], geometry[2] * resisting[1]
    matrix = np.zeros((9, 9))
    matrix[:3] = np.linalg.solve(_inertia(geometry, skew), forces)
    for k in range(3):  # 3.109, 3.111, 3.114
        matrix[3 + k, :3] = arms[:, k] / lengths[k]
        matrix[3 + k, 3 + k] = -abs(u) / lengths[k]
    matrix[5, 7], matrix[5, 8] = u / sigma_i, -u / sigma_i
    matrix[6, 0], matrix[6, 7] = 1.0, u  # 3.118
    matrix[7, 1] = matrix[8, 2] = 1.0  # 3.119, 3.120
    return matrix


def input_matrix(
    u: float, geometry: Array, theta: Array, rolling: float = 0.0, heights: tuple[float, float] = (0.0, 0.0)
) -> Array:
    """B(u), shape (9, 3), columns as INPUTS. Arguments as of `system_matrix`."""
    resisting, skew = _rolling(u, geometry, rolling, heights)
    forces = np.zeros((3, 3))
    forces[:, 0] = -resisting[0] * axle_arms(geometry)[:, 0]
    forces[:, 1:] = gravity_arms(geometry)
    forces[1, 1] += skew[1]
    forces[2, 2] += skew[2]
    matrix = np.zeros((9, 3))
    matrix[:3] = np.linalg.solve(_inertia(geometry, skew), forces)
    matrix[3, 0] = -u / theta[3]  # 3.109
    return matrix


def _rolling(
    u: float, geometry: Array, rolling: float, heights: tuple[float, float]
) -> tuple[tuple[float, float], Array]:
    """((drag of the front axle and of the implement's, N), moments per lateral acceleration on v, r_t, r_i).

    The wheels on the outside of a turn carry more load and so resist more; this is a yaw moment outwards.
    """
    a, b, c, d, e, m_t, m_i, _, _ = geometry
    tongue = m_i * GRAVITY * e / (d + e)
    way = np.sign(u) * rolling
    front = way * (m_t * GRAVITY * b - tongue * (c - b)) / (a + b)
    behind = way * (m_i * GRAVITY - tongue)
    return (front, behind), np.array([0.0, way * heights[0] * m_t, way * heights[1] * m_i])


def _inertia(geometry: Array, skew: Array) -> Array:
    """M's upper left block with what the bodies' lateral accelerations add to the yaw moments."""
    matrix = inertia(geometry)
    matrix[1, 0] += skew[1]
    matrix[2, 0] += skew[2]
    matrix[2, 1] -= skew[2] * geometry[2]
    matrix[2, 2] -= skew[2] * geometry[3]
    return matrix
