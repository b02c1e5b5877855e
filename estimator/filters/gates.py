"""Gates of the filters, and so of the tracker: beyond how many sds an innovation is an outlier, by sensor."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.record.record import KIND
from tilth.estimator.tuning import tuned

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class GateTuning:
    """A larger innovation is an outlier. The wheel angle drives the motion and updates nothing: no gate."""

    yaw_rate: float = tuned(5.0, "sd", "of a receiver's yaw rate")
    velocity: float = tuned(5.0, "sd", "of its velocity")
    position: float = tuned(5.0, "sd", "of its position, north or east")
    heading: float = tuned(5.0, "sd", "of a heading that a receiver measures itself")
    roll: float = tuned(5.0, "sd", "of a receiver's roll")


GATE: Final = GateTuning()
GATES: Final = (GATE.yaw_rate, GATE.velocity, GATE.position, GATE.position, GATE.heading, GATE.roll)
"""By the kind of a measurement, record.YAW_RATE to ROLL_ANGLE."""
UNLIMITED: Final = 1e30  # sds: no innovation is an outlier


def outliers(rows: Array, e: Array, S: Array) -> NDArray[np.bool_]:
    """(m,), which of the innovations e, with variances S, of a record's rows are beyond their gates."""
    gates = np.array(GATES)[rows[:, KIND].astype(np.intp)]
    return np.asarray(np.abs(e) > gates * np.sqrt(S))
