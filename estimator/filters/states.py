"""Layout of the filters' state vector x, shape (30,), and the length of a tick.

v, r_t, r_i, alpha_f, alpha_r, alpha_i (as models.rolling); lean of tractor and implement (rad) and their
rates (rad/s); psi_t, psi_i (rad, not wrapped). What the ground does: sideways forces at both CGs over mass,
as of gravity (m/s^2), and a yaw acceleration of the tractor (rad/s^2), first-order Gauss-Markov processes
with one time constant; gravity along the cross slope under either body (m/s^2), and how far unevenness turns
the wheels of either body about its long axis (rad), a first-order process over distance; the slopes' rates
(m/s^3): the tractor's slope is a critically damped process over distance, and the implement's follows it.
What the measured speed lacks (m/s), a first-order process. North and east of the tractor's CG (m). Slow
errors of the receivers, by what is around them and so not turning with a body: of each antenna pair, over its
length (m/m), and of the implement's antennas relative to the tractor's (m), each to north and to east."""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Places = NDArray[np.int64]

X_V: Final = 0
X_R: Final = 1  # of the tractor; the implement's is the next one, here and below
X_ALPHA: Final = 3  # of the front axle, the rear one, the implement's
X_ROLL: Final = 6  # lean of the tractor and of the implement, then their rates
X_PSI: Final = 10
X_DISTURBANCE: Final = 12  # on the tractor, on the implement, about the tractor's vertical axis
X_BANK: Final = 15
X_UNEVEN: Final = 17  # rad, by which uneven ground turns the wheels of a body
X_BANK_RATE: Final = 19  # of X_BANK
BANK_STATES: Final = (X_BANK, X_BANK + 1, X_BANK_RATE, X_BANK_RATE + 1)
X_SPEED: Final = 21  # m/s, true speed less the measured one
X_POSITION: Final = 22  # north, east
X_PAIR: Final = 24  # of the tractor to north and to east, then of the implement
X_LATERAL_OFFSET: Final = 28  # to north, to east
N_STATES: Final = 30

DT: Final = 0.02  # s, of a tick
PAIR_MEMORY_S: Final = 20.0
SPEED_MEMORY_S: Final = 1.0
"""Noise of a speed lasts a quarter of a second, what a turn adds to it as long as the turn: between."""
PAIR_DECAY: Final = math.exp(-DT / PAIR_MEMORY_S)
ALONG: Final = 0.01  # m per sqrt(s), what the speed's error adds to the way
ACROSS: Final = 0.003  # m per sqrt(s), the slow error that all receivers share
START: Final = (0.4, 0.1, 0.1, 0.1, 0.1, 0.1, 0.02, 0.01, 0.05, 0.02, 0.05, 0.05)
"""Sds of the states before X_DISTURBANCE, at first."""
START_PLACE: Final = 1.0  # m
BANK_LENGTH: Final = 20.0
"""m, over which the cross slope changes: time constant of a critically damped process. With 6 m a slope all
the way was taken for zero errors of roll and for antennas aside, and what wheels do on uneven ground for
slope: sigma_i of the tracker came out 8 % long, with 20 m or more 4 %."""
BANK_DIFFERENCE: Final = 0.05
"""Sd of what the implement's cross slope has of its own, over that of the tractor's."""
INITIAL_BANK_DIFFERENCE: Final = 0.5  # the same where a run begins: perhaps in a turn on a slope
UNEVEN_LENGTH: Final = 1.5  # m


class Point(NamedTuple):
    """One point of the unknowns, with the parameters and the geometry that follow from it."""

    unknowns: Array  # (n,), in the order of unknowns.NAMES
    theta: Array  # (6,), N/rad and m
    geometry: Array  # (9,), as parameters.GEOMETRY
