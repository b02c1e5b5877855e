"""Layout of the filters' state vectors, and the length of a tick.

x, shape (15,): v, r_t, r_i, alpha_f, alpha_r, alpha_i (as models.relaxation), psi_t, psi_i (rad, not
wrapped); the ground's pushes: accelerations across the tractor and across the implement at their CGs, as of
gravity (m/s^2), and a yaw acceleration of the tractor (rad/s^2), three first-order Gauss-Markov processes
with one time constant; north and east of the tractor's CG (m); the slow heading error of each antenna pair
(rad). The tracker's x, shape (16,), has one more: the slow lateral error of the implement's antennas relative
to the tractor's (m).
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Places = NDArray[np.int64]

X_V: Final = 0
X_R: Final = 1  # of the tractor; the implement's is the next one, here and below
X_ALPHA: Final = 3  # of the front axle, the rear one, the implement's
X_PSI: Final = 6
X_PUSH: Final = 8  # on the tractor, on the implement, about the tractor's vertical axis
X_POSITION: Final = 11  # north, east
X_PAIR: Final = 13
X_ASIDE: Final = 15
N_STATES: Final = 15
N_TRACKER: Final = 16

DT: Final = 0.02  # s, of a tick
PAIR_MEMORY_S: Final = 20.0
PAIR_DECAY: Final = math.exp(-DT / PAIR_MEMORY_S)
ALONG: Final = 0.01  # m per sqrt(s), process noise along the heading, from the error of the speed
ACROSS: Final = 0.003  # m per sqrt(s), across it, from slow errors that all receivers share
START: Final = (0.4, 0.1, 0.1, 0.1, 0.1, 0.1, 0.05, 0.05)  # initial sds of the states before X_PUSH
START_PLACE: Final = 1.0  # m, initial sd of the position


class Point(NamedTuple):
    """One point of the unknowns, with the parameters and the geometry that follow from it."""

    unknowns: Array  # (n,), in the order of unknowns.NAMES
    theta: Array  # (6,), N/rad and m
    geometry: Array  # (9,), as parameters.GEOMETRY
