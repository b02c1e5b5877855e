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
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.models import rolling_terms
from tilth.estimator.record.record import TICK_NS
from tilth.estimator.tuning import tuned

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

DT: Final = TICK_NS * 1e-9  # s


@dataclass(frozen=True, slots=True)
class StateTuning:
    """What the states of the filters are assumed to do."""

    pair_memory_s: float = tuned(20.0, "s", "for which the slow error of an antenna pair lasts")
    speed_memory_s: float = tuned(1.0, "s", "for which the error of the measured speed lasts")
    """Noise of a speed lasts a quarter of a second, what a turn adds to it as long as the turn: between."""
    along: float = tuned(0.01, "m/s^0.5", "what the speed's error adds to the way")
    across: float = tuned(0.003, "m/s^0.5", "the slow error that all receivers share")
    start: tuple[float, ...] = tuned(
        (0.4, 0.1, 0.1, 0.1, 0.1, 0.1, 0.02, 0.01, 0.05, 0.02, 0.05, 0.05),
        "m/s, rad/s, rad",
        "sds at first, of the states before the disturbance forces",
    )
    start_place: float = tuned(1.0, "m", "the same of the position")
    bank_length: float = tuned(20.0, "m", "over which the bank angle of the ground changes")
    """Time constant of a critically damped process. With 6 m a slope all the way was taken for zero errors of
    roll and for lateral offsets of antennas, and what wheels do on uneven ground for slope: sigma_i of the
    tracker came out 8 % long, with 20 m or more 4 %."""
    bank_difference: float = tuned(0.05, "1", "sd of the implement's own bank angle, over the tractor's")
    initial_bank_difference: float = tuned(0.5, "1", "same where a run begins: perhaps turning on a slope")
    uneven_length: float = tuned(1.5, "m", "over which unevenness changes")


STATE: Final = StateTuning()
# Kernels read globals; a record is none for them.
SPEED_MEMORY_S: Final = STATE.speed_memory_s
ALONG: Final = STATE.along
ACROSS: Final = STATE.across
START: Final = STATE.start
START_PLACE: Final = STATE.start_place
BANK_LENGTH: Final = STATE.bank_length
BANK_DIFFERENCE: Final = STATE.bank_difference
INITIAL_BANK_DIFFERENCE: Final = STATE.initial_bank_difference
UNEVEN_LENGTH: Final = STATE.uneven_length

PAIR_DECAY: Final = math.exp(-DT / STATE.pair_memory_s)
