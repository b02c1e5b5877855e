"""The sensor of the wheel angle. It drives the motion and updates nothing, so it has no gate: its noise is
noise of the front slip angle."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.compiled import inner_kernel
from tilth.estimator.filters.generated.observation_kernels import wheel_angle, wheel_angle_slopes
from tilth.estimator.filters.states import DT, X_ALPHA
from tilth.estimator.filters.transition import Transition
from tilth.estimator.filters.unknowns import AT_LATENCY, AT_SIGMA_F
from tilth.estimator.record.record import WHEEL_ANGLE, U

Array = NDArray[np.float64]


class DriveInputs(NamedTuple):
    """Inputs of the rig in the middle of a tick."""

    u: float  # m/s
    u_rate: float  # m/s^2
    wheel: float  # true wheel angle, rad
    reading: float  # of the sensor, rad, by as much later as the latency says
    reading_rate: float  # rad/s


@inner_kernel
def wheel_angle_at(ticks: Array, k: int, behind: float) -> float:
    """The wheel's reading `behind` seconds before tick k (linear between ticks, held at the ends)."""
    n = ticks.shape[0]
    at = k - behind / DT
    if at <= 0.0:
        return float(ticks[0, WHEEL_ANGLE])
    if at >= n - 1:
        return float(ticks[n - 1, WHEEL_ANGLE])
    low = int(at)
    share = at - low
    return float(ticks[low, WHEEL_ANGLE] * (1.0 - share) + ticks[low + 1, WHEEL_ANGLE] * share)


@inner_kernel
def drive_at(ticks: Array, k: int, unknowns: Array) -> DriveInputs:
    """Inputs of the rig in the middle of tick k. unknowns: (n,)."""
    k = min(k, ticks.shape[0] - 1)
    nxt = min(k + 1, ticks.shape[0] - 1)
    behind = unknowns[AT_LATENCY]
    early, late = wheel_angle_at(ticks, k, behind), wheel_angle_at(ticks, nxt, behind)
    u, u_rate = 0.5 * (ticks[k, U] + ticks[nxt, U]), (ticks[nxt, U] - ticks[k, U]) / DT
    return driven_by(u, u_rate, 0.5 * (early + late), (late - early) / DT, unknowns)


@inner_kernel
def driven_by(u: float, u_rate: float, reading: float, reading_rate: float, unknowns: Array) -> DriveInputs:
    """The inputs by what the sensors say, as DriveInputs."""
    return DriveInputs(u, u_rate, wheel_angle(reading, reading_rate, unknowns), reading, reading_rate)


@inner_kernel
def set_wheel_slopes(drive: DriveInputs, unknowns: Array, out: Array) -> None:
    """Fill out (n,), derivatives of the true wheel angle, by WHEEL_ANGLE_UNKNOWNS."""
    wheel_angle_slopes(drive.reading, drive.reading_rate, unknowns, out)


@inner_kernel
def set_wheel_noise(u: float, unknowns: Array, sds: Array, step: Transition) -> None:
    """Process noise of the front slip angle from that of the wheel angle. sds: as RigSetup.sds."""
    step.q[:, X_ALPHA] = (u / math.exp(unknowns[AT_SIGMA_F]) * sds[0] * DT) ** 2
