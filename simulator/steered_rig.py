"""The virtual tractor while it drives: it hears commands on its bus and sends its sensors there.

`LiveDriver` is the driver of a run: asked every HOLD samples, it has the sensors report what the
plant has just done, exchanges frames with the bus, and lets the steering ECU work the valve. Who owns the bus
decides whether this runs in real time or as fast as it can.
"""

import heapq
import math
from collections import deque
from collections.abc import Callable, Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.models import nonlinear
from tilth.estimator.models.actuator import BOSSERD, Actuator
from tilth.estimator.models.nonlinear import STATES
from tilth.schemas.flow import Frame
from tilth.schemas.machine import Machine
from tilth.schemas.wheel_angle import compile_sensor
from tilth.simulator.noise import SPEED, generator
from tilth.simulator.other_traffic import Sent
from tilth.simulator.pilots import ACCELERATION, HOLD, speeds
from tilth.simulator.receivers import FIRST_EPOCH_S, Receiving, WheelSensor
from tilth.simulator.scenario import STEP_S
from tilth.simulator.steering import Steering
from tilth.simulator.tractor import Setting, Truth
from tilth.simulator.traffic import Arbiter, claims_of, ecu_frames, receiver_frames
from tilth.simulator.wheel_speed import indicated

Array = NDArray[np.float64]

AT: Final = {name: k for k, name in enumerate(STATES)}
LAG: Final = HOLD  # samples after an epoch at which it is reported: its rates need both sides
ECU_SAMPLES: Final = 10

Exchange = Callable[[float, list[Frame]], list[tuple[int, bytes]]]
"""Takes the time (s of the run) and what the rig has sent; gives (identifier, data) of what others have."""


class LiveDriver:
    """Someone holds the speed; who commands by CAN steers. Once nobody does who did, the driver brakes."""

    actuator: Actuator | None = BOSSERD

    def __init__(self, machine: Machine, setting: Setting, exchange: Exchange) -> None:
        """The machine has one bus."""
        scenario = setting.scenario
        self.steering = Steering(
            setting.believed.wheelbase,
            math.radians(scenario.steering_limit_deg),
            math.radians(scenario.steering_rate_degps),
        )
        self._setting = setting
        self._exchange = exchange
        self._speed = speeds(scenario, setting.time, generator(setting.seed, SPEED))
        self._most = math.inf  # m/s, falling once the driver brakes
        self._sensor = compile_sensor(machine)
        self._wheel = WheelSensor(setting)
        self._wheel_delay = machine.wheel_angle.delay + setting.nuisances["wheel_delay"]
        claims, self._sources = claims_of(machine, scenario)
        self._receiving = [(r, Receiving(machine, setting, r, FIRST_EPOCH_S)) for r in machine.receiver]
        self._next = [0 for _ in machine.receiver]  # epoch of each that is to be reported
        self._free = [0.0 for _ in machine.receiver]  # when each has sent its last frame
        self._waiting: list[Sent] = [sent for _, sent in claims]
        heapq.heapify(self._waiting)
        self._bus = Arbiter(machine.bus[0], setting)
        self._recent: deque[Array] = deque(maxlen=3)  # states, HOLD samples apart
        self._way = 0.0  # m, at the first of them

    def implement(self) -> tuple[float, float]:
        """North and east of its CG on the ground, m."""
        x = self._recent[-1] if self._recent else self.start()
        ((north, east, _, _),) = nonlinear.implement(self._setting.rig, x[None]).tolist()
        return north, east

    def start(self) -> Array:
        return nonlinear.running(float(self._speed[0]))

    def steer(self, k: int, end: int, x: Array) -> tuple[Array | float, Array | float]:
        now = k * STEP_S
        reading = self._sense(k, x)
        frames = list(self._on_bus(now))
        for can_id, data in self._exchange(now, frames):
            self.steering.hear(can_id, data, now, reading)
        valve = self.steering.valve(now, reading)
        if self.steering.taken and self.steering.obeyed is None:
            self._most = max(min(self._most, float(x[AT["u"]])) - ACCELERATION * (end - k) * STEP_S, 0.0)
        return valve, min(float(self._speed[k]), self._most)

    def _sense(self, k: int, x: Array) -> float:
        """Put down what all sensors have to send by now; the wheel sensor's reading, rad."""
        if len(self._recent) == self._recent.maxlen:
            self._way += float(self._recent[0][AT["u"]]) * HOLD * STEP_S
        before = self._recent[-1] if self._recent else x
        self._recent.append(x.copy())
        angles = np.array([x[AT["delta"]]])
        if k:
            angles = np.array([(before[AT["delta"]] + x[AT["delta"]]) / 2, x[AT["delta"]]])
        first = k - len(angles) + 1
        readings = self._wheel.readings(angles, first)
        for i, angle in enumerate(readings.tolist()):
            sent_s = (first + i) * STEP_S + self._wheel_delay
            self._put(sent_s, self._sensor.can_id, self._sensor.extended, self._sensor.data(angle))
        if k % ECU_SAMPLES == 0:
            at_s, u = k * STEP_S, float(x[AT["u"]])
            for sent in ecu_frames(at_s, u, self._by_wheels(at_s, u), float(x[AT["r_t"]])):
                self._put(*sent)
        if len(self._recent) == self._recent.maxlen:
            self._report(k)
        return float(readings[-1])

    def _by_wheels(self, at_s: float, velocity: float) -> float:
        """Its way is not known beforehand, so neither is where the slip would vary."""
        of = self._setting.scenario.wheel_speed
        return float(indicated(of, np.array(at_s), np.array(velocity), np.array(of.slip)))

    def _report(self, k: int) -> None:
        """What the receivers measured LAG samples ago."""
        epoch_s = (k - LAG) * STEP_S
        truth: Truth | None = None
        for i, (receiver, receiving) in enumerate(self._receiving):
            j = self._next[i]
            if j == len(receiving.epochs) or receiving.epochs[j] > epoch_s + STEP_S / 2:
                continue
            truth = truth or self._lately(k)
            self._next[i] = j + 1
            rows = receiving.rows(truth, j, j + 1)
            made = receiver_frames(receiver, rows, self._sources[receiver.mount], self._setting.scenario)
            for at_s, can_id, extended, data in made:
                self._free[i] = max(self._free[i], at_s)
                self._put(self._free[i], can_id, extended, data)

    def _lately(self, k: int) -> Truth:
        """The last samples, between those that are known."""
        known = np.array(self._recent)
        m = HOLD * (len(known) - 1) + 1
        at, rows = np.arange(m) / HOLD, np.arange(len(known))
        states = np.column_stack([np.interp(at, rows, column) for column in known.T])
        time: Array = (k - m + 1 + np.arange(m, dtype=np.float64)) * STEP_S
        soil = np.zeros((m, 6))  # the receivers do not look at it
        return self._setting.truth(time, self._way, states, soil)

    def _put(self, at_s: float, can_id: int, extended: bool, data: bytes) -> None:
        heapq.heappush(self._waiting, (at_s, can_id, extended, data))

    def _on_bus(self, now: float) -> Iterator[Frame]:
        """What the bus has carried by now."""
        while self._waiting and self._waiting[0][0] <= now:
            yield from self._bus.take(heapq.heappop(self._waiting))
        yield from self._bus.until(now)
