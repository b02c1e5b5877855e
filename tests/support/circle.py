"""A rig on a circle, in closed form: measurements whose pose is known exactly, for the tests of alignment.

The tractor's CG runs on a circle at constant speed and yaw rate; the implement follows at a constant
articulation, so that all truth is trigonometry.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from paths import MACHINE_FILE

from tilth.estimator.pose.geometry import to_plane
from tilth.estimator.rig.geometry import lever, rotate
from tilth.schemas.flow import (
    Attitude,
    Fix,
    FixType,
    Measurement,
    Mount,
    Origin,
    Position,
    Velocity,
    WheelAngle,
    YawRate,
)
from tilth.schemas.machine import Machine, Receiver
from tilth.schemas.machine_toml import parse_machine

ORIGIN_DEG = (43.5, -83.4)
START_NS = 1_777_881_600_000_000_000


def demo_machine(**replaced: str) -> Machine:
    """The packaged rig; `replaced` maps a text of the file onto another."""
    text = MACHINE_FILE.read_text()
    for old, new in replaced.items():
        text = text.replace(old, new)
    return parse_machine(text)


@dataclass(frozen=True)
class Circle:
    """How the rig moves, and how its receivers report."""

    machine: Machine = field(default_factory=demo_machine)
    speed: float = 4.5
    yaw_rate: float = 0.15
    lateral_velocity: float = 0.1
    articulation: float = 0.14
    roll: float = 0.0
    latency_s: Mapping[Mount, float] = field(default_factory=dict)  # else the machine file's
    jitter_s: float = 0.0
    noise_m: float = 0.0
    period_s: Mapping[Mount, float] = field(default_factory=dict)  # else 0.2
    fix: FixType = FixType.RTK_FIXED
    seed: int = 1

    def heading(self, t: float, body: int) -> float:
        return 0.3 + self.yaw_rate * t - body * self.articulation

    def cg(self, t: float, body: int) -> tuple[float, float]:
        """(north, east) of the tractor's (0) or implement's (1) CG, m."""
        psi = self.heading(t, 0)
        r = self.yaw_rate
        # Integral of the rotated constant body velocity (u, v), from psi = 0.
        u, v = self.speed, self.lateral_velocity
        if r == 0:
            north, east = rotate((u * t, v * t), 0.3)
        else:
            north = (u * math.sin(psi) + v * math.cos(psi)) / r
            east = (-u * math.cos(psi) + v * math.sin(psi)) / r
        if body == 0:
            return north, east
        to_hitch = rotate((-self.machine.tractor.c.value, 0.0), psi)
        to_cart = rotate((-self.machine.implement.d.value, 0.0), self.heading(t, 1))
        return north + to_hitch[0] + to_cart[0], east + to_hitch[1] + to_cart[1]

    def reported(self, receiver: Receiver, t: float) -> tuple[float, float]:
        """(north, east) that a receiver reports, m."""
        body = int(receiver.mount.value.startswith("implement"))
        height = (self.machine.tractor, self.machine.implement)[body].cg_height.value
        arm = rotate(
            lever(receiver.position, height, receiver.roll_corrected, self.roll, 0.0), self.heading(t, body)
        )
        cg = self.cg(t, body)
        return cg[0] + arm[0], cg[1] + arm[1]

    def measurements(self, seconds: float, absent: frozenset[Mount] = frozenset()) -> Iterator[Measurement]:
        """All that the rig's sensors say, in order of arrival."""
        rng = np.random.default_rng(self.seed)
        messages: list[Measurement] = []
        for index, receiver in enumerate(self.machine.receiver):
            if receiver.mount in absent:
                continue
            messages += self._receiver(receiver, 28 + index, seconds, rng)
        delay = round(self.machine.wheel_angle.delay * 1e9)
        origin = Origin("can0", 0x15)
        for k in range(round(seconds * 50)):
            at = START_NS + k * 20_000_000 + delay
            messages.append(WheelAngle(at, at, origin, 65291, None, 0.1, math.radians(0.1)))
        return iter(sorted(messages, key=lambda m: m.rx_ns))

    def _receiver(
        self, receiver: Receiver, source: int, seconds: float, rng: np.random.Generator
    ) -> list[Measurement]:
        origin = Origin("can0", source, receiver.name, receiver.mount)
        period = self.period_s.get(receiver.mount, 0.2)
        latency = self.latency_s.get(receiver.mount, receiver.latency.value)
        messages: list[Measurement] = []
        for k in range(round(seconds / period)):
            t = k * period
            rx = START_NS + round((t + latency + self.jitter_s * rng.random()) * 1e9)
            here, ahead = self.reported(receiver, t), self.reported(receiver, t + 1e-4)
            velocity = ((ahead[0] - here[0]) / 1e-4, (ahead[1] - here[1]) / 1e-4)
            noisy = rng.normal(0, self.noise_m, 2) if self.noise_m else (0.0, 0.0)
            latitude, longitude = from_plane(here[0] + float(noisy[0]), here[1] + float(noisy[1]))
            head = (rx, rx, origin)
            messages += [
                Position(*head, 65267, None, latitude, longitude, receiver.position_sd),
                Velocity(
                    *head, 65256, None, math.atan2(velocity[1], velocity[0]), math.hypot(*velocity), 0.03
                ),
                YawRate(*head, 65535, None, self.yaw_rate, 0.003),
                Attitude(*head, 65535, None, self.roll, None, 0.01),
            ]
            if k % 5 == 0:
                messages.append(Fix(*head, 65535, None, self.fix))
        return messages


def from_plane(north: float, east: float) -> tuple[float, float]:
    """(latitude, longitude) in degrees: the inverse of geometry.to_plane by Newton steps."""
    latitude, longitude = ORIGIN_DEG
    for _ in range(4):
        x, y = to_plane(ORIGIN_DEG, latitude, longitude)
        latitude += (north - x) / 111_100.0
        longitude += (east - y) / (111_300.0 * math.cos(math.radians(latitude)))
    return latitude, longitude
