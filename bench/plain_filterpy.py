"""The same linear model as an extended Kalman filter of filterpy, its parameters' logarithms as states."""

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter
from numpy.typing import NDArray
from plain_least_squares import DT, OUTPUT_STATES, discrete, middles

Array = NDArray[np.float64]

STEP = 1e-4
AGAIN = 25  # samples after which the Jacobian over the parameters is renewed


class Tracking(ExtendedKalmanFilter):  # type: ignore[misc]
    """States (15,): the rig's eight, six logarithms, the wheel's zero."""

    def __init__(self, geometry: Array, speed: float, mean: Array, sd: Array) -> None:
        super().__init__(dim_x=15, dim_z=4)
        self._geometry, self._speed = geometry, speed
        self.x = np.concatenate([np.zeros(8), mean])
        start = [0.4, 0.1, 0.1, 0.1, 0.1, 0.1, 0.05, 0.05]
        self.P = np.diag(np.square([*start, *sd]))
        self.matrices()

    def matrices(self) -> None:
        """F and G at the present parameters, and their slopes over the logarithms."""
        logs = self.x[8:14]
        self._f, self._g = discrete(np.exp(logs), self._geometry, self._speed)
        near = [discrete(np.exp(logs + STEP * row), self._geometry, self._speed) for row in np.eye(6)]
        self._df = np.array([(f - self._f) / STEP for f, _ in near])
        self._dg = np.array([(g - self._g) / STEP for _, g in near])

    def predict_x(self, u: float = 0.0) -> None:
        delta = u - self.x[14]
        self.F = np.eye(15)
        self.F[:8, :8] = self._f
        self.F[:8, 8:14] = (self._df @ self.x[:8] + self._dg * delta).T
        self.F[:8, 14] = -self._g
        self.x[:8] = self._f @ self.x[:8] + self._g * delta


def track(
    y: Array,
    wheel: Array,
    geometry: Array,
    speed: float,
    prior: tuple[Array, Array],
    noise: tuple[Array, Array],
) -> tuple[Array, Array]:
    """(logarithms (6,), their sds (6,)) after the last sample. prior: (7,) means and sds of logarithms and
    zero; noise: (3,) disturbances and (4,) sds of the outputs, given here as known."""
    filter_ = Tracking(geometry, speed, *prior)
    filter_.Q = np.diag([*np.square(noise[0] * DT), *[0.0] * 12])
    filter_.R = np.diag(np.square(noise[1]))
    slope = np.zeros((4, 15))
    slope[range(4), OUTPUT_STATES] = 1.0
    held = middles(wheel)
    for k, row in enumerate(y):
        filter_.update(row, lambda x: slope, lambda x: x[OUTPUT_STATES])
        filter_.predict(held[k])
        if k % AGAIN == 0:
            filter_.matrices()
    return filter_.x[8:14].copy(), np.sqrt(np.diag(filter_.P)[8:14])
