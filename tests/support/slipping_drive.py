"""Rows and turns of a tractor whose driven tyres slip, by its speeds alone, for the watch of their radius."""

import math

import numpy as np
from circle import START_NS, demo_machine

from tilth.estimator.diagnosis import wheel_speed
from tilth.estimator.diagnosis.wheel_speed import Instant, WheelSpeedState
from tilth.estimator.pose.aligner import ALIGNMENT
from tilth.schemas.diagnosis import Diagnosis
from tilth.schemas.machine import Machine, Quantity

MACHINE = demo_machine()
FACTOR = 1.02
SPEED, TURN_SPEED, TURN_RATE = 3.0, 1.9, 0.3  # m/s, m/s, rad/s
LIFTED = 20.0  # m, of each end of a row
MOST = 0.12  # slip


def with_factor(value: float, sd: float = 0.005) -> Machine:
    tractor = MACHINE.tractor.model_copy(update={"wheel_speed_factor": Quantity(value=value, sd=sd)})
    return MACHINE.model_copy(update={"tractor": tractor})


class SlippingDrive:
    """Rows and turns. The slip of work wanders about that of the field; on headlands it is small."""

    def __init__(self, seed: int, machine: Machine = MACHINE, row: float = 250.0, lifts: bool = True) -> None:
        """row: m. lifts: the implement is out of the ground in turns and next to them."""
        self.state, self.machine, self.t_ns = WheelSpeedState(), machine, START_NS
        self.factor, self.row, self.lifts = FACTOR, row, lifts
        self._rng = np.random.default_rng(seed)
        self._wandering = 0.0
        self.field(0.03)

    def field(self, mean: float) -> None:
        """Another one, of that mean slip."""
        self.mean, self._length = mean, float(self._rng.uniform(50.0, 300.0))
        self._sd, self._light = float(self._rng.uniform(0.01, 0.04)), float(self._rng.uniform(0.002, 0.013))

    def other_fields(self, count: int, minutes: float) -> list[Diagnosis]:
        """One after the other: the mean slip steps by 5 %."""
        found = []
        for _ in range(count):
            self.field(float(np.clip(self.mean + self._rng.choice([-0.05, 0.05]), 0.01, 0.1)))
            found += self.drive(minutes)
        return found

    def stand(self, seconds: float = 600.0) -> None:
        self.t_ns += round(seconds * 1e9)

    def drive(self, minutes: float) -> list[Diagnosis]:
        found, end_ns = list[Diagnosis](), self.t_ns + round(minutes * 60e9)
        poses = round(self.row / (SPEED * 0.2))
        while self.t_ns < end_ns:
            for k in range(poses):
                place = k * SPEED * 0.2
                lifted = place < LIFTED or self.row - place < LIFTED
                found += self._pose(SPEED, self._rng.normal(0.0, 0.02), self._slip(lifted))
            for _ in range(round(math.pi / TURN_RATE / 0.2)):
                found += self._pose(TURN_SPEED, TURN_RATE, self._slip(True))
        return found

    def _slip(self, lifted: bool) -> float:
        keep = math.exp(-SPEED * 0.2 / self._length)
        self._wandering = keep * self._wandering + self._sd * math.sqrt(1.0 - keep**2) * self._rng.normal()
        return (
            self._light if lifted and self.lifts else min(max(self.mean + self._wandering, self._light), MOST)
        )

    def _pose(self, speed: float, yaw_rate: float, slip: float) -> list[Diagnosis]:
        self.t_ns += ALIGNMENT.pose_ns
        ground = speed + self._rng.normal(0.0, 0.035)
        wheels = self.factor * speed / (1.0 - slip) + self._rng.normal(0.0, 0.01)
        found = wheel_speed.take(self.state, self.machine, Instant(self.t_ns, ground, wheels, yaw_rate))
        return [] if found is None else [found]
