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
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.models import rolling_terms

Array = NDArray[np.float64]
Places = NDArray[np.int64]

STATES: Final = (
    *rolling_terms.STATES, "disturbance_t", "disturbance_i", "disturbance_yaw", "bank_t", "bank_i",
    "uneven_t", "uneven_i", "bank_rate_t", "bank_rate_i", "speed", "north", "east", "pair_t_north",
    "pair_t_east", "pair_i_north", "pair_i_east", "offset_north", "offset_east",
)  # fmt: skip
N_STATES: Final = len(STATES)

# Of what both bodies have, the tractor's; the implement's is the next one.
X_V: Final = STATES.index("v")
X_R: Final = STATES.index("r_t")
X_ALPHA: Final = STATES.index("alpha_f")  # of the front axle, the rear one, the implement's
X_ROLL: Final = STATES.index("phi_t")  # lean of the tractor and of the implement, then their rates
X_PSI: Final = STATES.index("psi_t")
X_DISTURBANCE: Final = STATES.index("disturbance_t")  # on either body, then about the tractor's vertical axis
X_BANK: Final = STATES.index("bank_t")
X_UNEVEN: Final = STATES.index("uneven_t")  # rad, by which uneven ground turns the wheels of a body
X_BANK_RATE: Final = STATES.index("bank_rate_t")
BANK_STATES: Final = (X_BANK, X_BANK + 1, X_BANK_RATE, X_BANK_RATE + 1)
X_SPEED: Final = STATES.index("speed")  # m/s, true speed less the measured one
X_POSITION: Final = STATES.index("north")  # then east
X_PAIR: Final = STATES.index("pair_t_north")  # of the tractor to north and to east, then of the implement
X_LATERAL_OFFSET: Final = STATES.index("offset_north")  # then to east

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
