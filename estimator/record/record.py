"""Raw measurements in order of their instants, on ticks of 20 ms: the data of the dynamic estimators.

Each sample is there once, as it was measured. Poses are used only as the point about which angles and lever
arms are linearised, and for inputs that are measured in no other way (forward speed). Positions and
velocities are corrected for pitch, not for roll, which is a state of the filters.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.tuning import tuned
from tilth.schemas.reasons import Code

Array = NDArray[np.float64]
Speed = TypeVar("Speed", float, Array)

TICK_NS = 20_000_000
INPUTS = ("wheel_angle", "u", "psi_t", "psi_i", "r_t", "r_i", "roll_t", "roll_i")
"""Columns of Record.ticks: rad, m/s, rad, rad, rad/s, rad/s, rad, rad.

wheel_angle is measured; u (tractor's CG) and the rolls are inputs from the poses. psi (not wrapped) and r are
only the point of linearisation. Columns are linear between poses, so the slope between a segment's last two
ticks holds to its end; the rolls have one more node halfway between two poses.
"""
WHEEL_ANGLE, U, PSI, R, ROLL = 0, 1, 2, 4, 6
"""The same columns by number; of PSI, R and ROLL the tractor's, with the implement's beside it."""
YAW_RATE, VELOCITY, NORTH, EAST, HEADING, ROLL_ANGLE = 0, 1, 2, 3, 4, 5
ROWS = ("tick", "offset", "kind", "place", "value", "sd")
"""Columns of Record.rows, one row per measurement, sorted by instant.

tick: the last one at or before the instant; offset: s after it, [0, 0.02). kind: YAW_RATE to ROLL_ANGLE.
place: for YAW_RATE and HEADING the body, 0 tractor, 1 implement; else the receiver, as in flow.Mount. value:
rad/s; m/s to the right of the psi of `ticks` at that instant; m in the plane of the poses; rad. sd: the white
noise that the machine file states for such a message, or a larger one that the receiver reports.
"""
TICK, OFFSET, KIND, PLACE, VALUE, SD = 0, 1, 2, 3, 4, 5


@dataclass(frozen=True, slots=True)
class SpeedTuning:
    """How the noise of the forward speed is kept from its rate."""

    means: int = tuned(3, "1", "how often a speed becomes a mean of three poses, besides once as it comes")
    """Of 1, 2, 4 and 8 in all, 4 is the likeliest on eleven headland turns of a folded cart, on the planar
    plant and on the spatial one."""


SPEED: Final = SpeedTuning()


@dataclass(slots=True)
class Record:
    """Inputs on a grid of ticks, and the measurements among them."""

    t_ns: int  # instant of tick 0, on the clock of Frame.rx_ns, latencies subtracted
    ticks: Array = field(default_factory=lambda: np.zeros((0, len(INPUTS))))  # [n, 8]
    rows: Array = field(default_factory=lambda: np.zeros((0, len(ROWS))))  # [m, 6]

    @property
    def end_ns(self) -> int:
        """Instant at which the next record begins."""
        return self.t_ns + len(self.ticks) * TICK_NS


@dataclass(frozen=True, slots=True)
class Segment:
    """What was measured between two poses. Without ticks if inputs are missing."""

    record: Record
    follows: bool  # begins at the end of the segment before, and both may be learned from
    reason: Code | None  # why nothing may be learned from it


def concatenate(segments: Sequence[Segment]) -> Record:
    """One record of segments that follow each other without a gap. Raises ValueError if there is a gap."""
    if not segments:
        raise ValueError("no segment to make a record of")
    rows, ticks = [], 0
    end_ns = segments[0].record.t_ns
    for segment in segments:
        record = segment.record
        if record.t_ns != end_ns:
            raise ValueError(
                f"a segment begins {(record.t_ns - end_ns) * 1e-9:g} s after the end of the last"
            )
        shifted = record.rows.copy()
        shifted[:, 0] += ticks
        rows.append(shifted)
        ticks += len(record.ticks)
        end_ns = record.end_ns
    inputs = np.concatenate([segment.record.ticks for segment in segments])
    starts = np.cumsum([0, *(len(segment.record.ticks) for segment in segments)])
    inputs[:, U] = _without_noise(inputs[:, U], starts)
    return Record(segments[0].record.t_ns, inputs, np.concatenate(rows))


def mean_of_three(before: Speed, at: Speed, after: Speed) -> Speed:
    """Of speeds at three poses, evenly apart: a quarter, a half, a quarter."""
    return 0.25 * before + 0.5 * at + 0.25 * after


def _without_noise(speed: Array, poses: NDArray[np.int64]) -> Array:
    """Forward speed at each tick, m/s, shape (n,), by the poses on both sides: more of them than
    record_builder can wait for. speed: linear between poses. poses: their ticks, 0 to n, evenly apart."""
    if len(speed) < 2:
        return speed
    at_poses = np.append(speed[poses[:-1]], 2.0 * speed[-1] - speed[-2])
    for _ in range(SPEED.means):
        at_poses[1:-1] = mean_of_three(at_poses[:-2], at_poses[1:-1], at_poses[2:])
    return np.asarray(np.interp(np.arange(len(speed)), poses, at_poses), np.float64)
