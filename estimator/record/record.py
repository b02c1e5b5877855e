"""Raw measurements in order of their instants, on a grid of 20 ms: what the dynamic estimators learn from.

Every sample is there once, as it was measured; filtered poses serve only as what angles and lever arms are
made linear about, and as inputs that nobody else measures (forward speed, roll). Positions and velocities are
freed of the body's lean: they are those of an antenna that stands upright over the point on the ground below
the body's CG. That point, and not the CG that sways above it, is what tyres and hitch hold.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

TICK_NS = 20_000_000
INPUTS = ("wheel_angle", "u", "psi_t", "psi_i", "r_t", "r_i", "roll_t", "roll_i")
"""Columns of Record.ticks: rad, m/s, rad, rad, rad/s, rad/s, rad, rad.

wheel_angle is measured; u (tractor's CG) and the rolls are inputs from the poses; psi and r, not wrapped, are
only where things are made linear about. They are straight lines between poses, so the slope between a
stretch's last two ticks holds to its end; rolls are given twice as often.
"""
WHEEL_ANGLE, U, PSI, R, ROLL = 0, 1, 2, 4, 6
"""The same columns by number; of PSI, R and ROLL the tractor's, with the implement's beside it."""
YAW_RATE, VELOCITY, NORTH, EAST, HEADING, ROLL_ANGLE = 0, 1, 2, 3, 4, 5
ROWS = ("tick", "offset", "kind", "place", "value", "sd")
"""Columns of Record.rows, one row per measurement, sorted by instant.

tick: the last one at or before the instant; offset: s after it, [0, 0.02).
place: of YAW_RATE and HEADING the body, 0 tractor, 1 implement; else the receiver, as in flow.Mount.
value: rad/s; m/s to the right of psi as `ticks` has it at that instant; m in the plane of the poses; rad.
sd: the white noise that the machine file states for such a message, or a worse one that the receiver tells;
of VELOCITY also what is left of a swaying body's roll rate.
"""
TICK, OFFSET, KIND, PLACE, VALUE, SD = 0, 1, 2, 3, 4, 5


@dataclass(slots=True)
class Record:
    """Inputs on a grid of ticks, and the measurements among them."""

    t_ns: int  # instant of tick 0, on the clock of Frame.rx_ns, latencies taken out
    ticks: Array = field(default_factory=lambda: np.zeros((0, len(INPUTS))))  # [n, 8]
    rows: Array = field(default_factory=lambda: np.zeros((0, len(ROWS))))  # [m, 6]

    @property
    def end_ns(self) -> int:
        """Where the next record goes on."""
        return self.t_ns + len(self.ticks) * TICK_NS


@dataclass(frozen=True, slots=True)
class Stretch:
    """What was measured between two poses. Without ticks where even the inputs were missing."""

    record: Record
    follows: bool  # goes on where the stretch before ended, and both may teach
    reason: str  # why it may not teach, or ""


def concatenate(stretches: Sequence[Stretch]) -> Record:
    """One record of stretches of which each goes on where the one before ended.

    Raises ValueError where one does not.
    """
    if not stretches:
        raise ValueError("no stretch to make a record of")
    rows, ticks = [], 0
    end_ns = stretches[0].record.t_ns
    for stretch in stretches:
        record = stretch.record
        if record.t_ns != end_ns:
            raise ValueError(
                f"a stretch begins {(record.t_ns - end_ns) * 1e-9:g} s after the end of the last"
            )
        shifted = record.rows.copy()
        shifted[:, 0] += ticks
        rows.append(shifted)
        ticks += len(record.ticks)
        end_ns = record.end_ns
    inputs = np.concatenate([stretch.record.ticks for stretch in stretches])
    return Record(stretches[0].record.t_ns, inputs, np.concatenate(rows))
