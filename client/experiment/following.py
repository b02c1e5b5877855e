"""How a driver followed the bar: too far off for too long, or hardly at all."""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.models.planned_run import DT
from tilth.schemas.notices import Notice, NoticeCode, notice

Array = NDArray[np.float64]

LATEST_S: Final = 1.2  # a driver may be so late: the angle is held against all that was wanted since
LEAST_SHARE: Final = 0.5  # of the bar's swing that the wheels must have made
MOST_LEFT: Final = 0.6  # of the bar's root mean square that may be left of it at the best delay
STEERED: Final = math.radians(0.5)  # root mean square of a bar that can be followed at all


class Followed(NamedTuple):
    """How the wheels went with the bar. Of a driver with no delay and no error 1, 0 and 0."""

    share: float
    late_s: float
    left: float  # root mean square of what is left, over that of the bar


def wanted_at(angles: Array, t_s: float) -> float:
    """Wheel angle to have at a time of the run, s from where `angles` begin; straight before
    and after."""
    place = t_s / DT
    if not 0.0 < place <= len(angles) - 1.0:
        return 0.0
    low = int(place)
    high = min(low + 1, len(angles) - 1)
    return float(angles[low] + (place - low) * (angles[high] - angles[low]))


def off_the_bar(angles: Array, t_s: float, measured: float) -> float:
    """How far the wheels are from all that was wanted in the last LATEST_S, rad; 0 within it."""
    first, last = (int(np.clip(t / DT, 0, len(angles) - 1)) for t in (t_s - LATEST_S, t_s))
    lately = angles[first : last + 1]
    low, high = float(lately.min()), float(lately.max())
    if t_s < LATEST_S:
        low, high = min(low, 0.0), max(high, 0.0)
    return max(0.0, low - measured, measured - high)


def followed(angles: Array, t_s: Array, measured: Array) -> Followed:
    """Over a whole run. t_s: s from where `angles` begin, (n,); measured: rad, (n,)."""
    grid = np.arange(len(angles)) * DT
    found = []
    for late in np.arange(0.0, LATEST_S + 0.05, 0.1):
        wanted = np.interp(t_s - late, grid, angles, left=0.0)
        power = float(np.mean(np.square(wanted)))
        if power < STEERED**2:
            continue
        gain = float(np.mean(wanted * measured)) / power
        left = math.sqrt(float(np.mean(np.square(measured - wanted))) / power)
        found.append(Followed(gain, float(late), left))
    return min(found, key=lambda one: one.left) if found else Followed(1.0, 0.0, 0.0)


def disturbed(made: Followed) -> Notice | None:
    """Why a run is to be driven again, None where it need not."""
    if made.share < LEAST_SHARE:
        return notice(NoticeCode.FOLLOWED_LITTLE, share=max(made.share, 0.0))
    if made.left > MOST_LEFT:
        return notice(NoticeCode.NOT_WITH_THE_BAR, left=made.left)
    return None
