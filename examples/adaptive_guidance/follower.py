"""The follower: poses in, commanded wheel angles out. Pure state and arithmetic; its caller owns the clock.

pose ─► where along the plan ─► deviations ─► observer ─┐
now  ─► carried to now with what was commanded since ───┴─► regulator, preview, limits ─► wheel angle
"""

import math
from collections import deque
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.adaptive_guidance.law import (
    HIDDEN,
    PREVIEW_STEP_S,
    SERVO,
    TICK_S,
    Design,
    design,
)
from tilth.adaptive_guidance.plan import STEP, Plan
from tilth.estimator.models.parameters import Rig
from tilth.schemas.flow import PARAMETERS

Array = NDArray[np.float64]

PERIOD_S: Final = 0.1  # between commands
SPEED_STEP: Final = 0.25  # m/s: gains are made anew where the speed has moved by more
SLOWEST: Final = 0.5  # m/s, of any design
LOG_STEP: Final = 0.02  # gains are made anew where the logarithm of a parameter has moved by more
POSE_OLD_S: Final = 1.0  # without a pose for longer there is nothing to steer by
REACH_M: Final = 4.0  # the plan is searched this far ahead of, and behind, where the rig was


class BodyState(NamedTuple):
    """Of one CG: m in the plan's frame, rad, m/s, rad/s."""

    x: float
    y: float
    heading: float
    lateral_velocity: float
    yaw_rate: float
    roll: float


class MeasuredPose(NamedTuple):
    """What a pose says; `at` in s on the clock of the caller."""

    at: float
    tractor: BodyState
    implement: BodyState
    speed: float
    wheel_angle: float


class Command(NamedTuple):
    """What to ask of the steering, and why not, where nothing can be asked."""

    wheel_angle: float | None  # rad
    code: str = ""
    reason: str = ""  # the code in words


@dataclass(slots=True)
class Follower:
    """Steers the implement's CG along the plan. Who hears estimates sets `theta`; the rest is its own."""

    plan: Plan
    rig: Rig  # as the machine file believes it: the nominal parameters are its own
    limit: float = math.radians(33.0)  # rad, of the command
    rate: float = math.radians(20.0)  # rad/s, of the command
    theta: Array = field(init=False)  # (6,): the parameters to design for, moving no faster than gains should
    station: float = 0.0  # sample of the plan at the last pose
    _design: Design = field(init=False)
    _state: Array = field(init=False)  # deviations and hidden pushes at the last pose
    _pose: MeasuredPose | None = None
    _given: deque[tuple[float, float]] = field(
        init=False
    )  # (s, deviation of the commanded angle from then on)
    _deviation: float = 0.0  # of the commanded angle
    _commanded: float = 0.0  # the commanded angle itself
    _ticked: float | None = None

    def __post_init__(self) -> None:
        self.theta = self.rig.theta
        self._design = design(self.rig, 2.0)
        self._state = np.zeros(len(self._design.f) + len(HIDDEN))
        self._given = deque([(-math.inf, 0.0)], maxlen=64)

    @property
    def speed(self) -> float | None:
        """Of the last pose, m/s; None before it."""
        return None if self._pose is None else self._pose.speed

    @property
    def done(self) -> bool:
        """Whether the end of the plan is reached."""
        return self.station >= len(self.plan.row) - 20

    def pose(self, measured: MeasuredPose) -> None:
        """Take a pose; they come in the order of their instants."""
        if self._pose is None:
            self.station = float(np.argmin(np.hypot(*(self.plan.tractor[:, :2] - measured.tractor[:2]).T)))
        elif measured.at <= self._pose.at:
            return
        else:
            self._state = self._carried(measured.at)
        self.station = self._project(measured.tractor)
        self._pose = measured
        self._redesign()
        made = self._design
        off = self._deviations(measured)
        n = len(made.f)
        self._state = self._state + made.observer @ (off - made.outputs @ self._state[:n])

    def command(self, now: float) -> Command:
        """The wheel angle to ask for from now on, once in PERIOD_S."""
        if self._pose is None:
            return self._silent("no_pose", "no pose yet")
        if now - self._pose.at > POSE_OLD_S:
            return self._silent("old_pose", f"the last pose is {now - self._pose.at:.1f} s old")
        if self.done:
            return self._silent("done", "the plan is done")
        period = PERIOD_S if self._ticked is None else min(now - self._ticked, 2 * PERIOD_S)
        self._ticked = now
        made, speed = self._design, self._pose.speed
        state = self._carried(now)
        station = self.station + speed * (now - self._pose.at) / STEP
        ahead = station + np.arange(len(made.preview), dtype=np.float64) * (speed * PREVIEW_STEP_S / STEP)
        n = len(made.f)
        rate = -float(made.gain[:n] @ state[:n]) - float(made.gain[n]) * self._deviation
        rate += float(np.sum(made.preview * self._force(ahead, speed)))
        rate += float(made.steady[3:] @ np.concatenate([self._gravity(), state[n:]]))
        planned = self._planned(station + speed * PERIOD_S / STEP, speed)
        commanded = planned + self._deviation + rate * period
        most = self.rate * period
        commanded = min(max(commanded, self._commanded - most), self._commanded + most)
        self._commanded = min(max(commanded, -self.limit), self.limit)
        self._deviation = self._commanded - planned
        self._given.append((now, self._deviation))
        return Command(self._commanded)

    def _silent(self, code: str, reason: str) -> Command:
        self._ticked = None
        return Command(None, code, reason)

    def _redesign(self) -> None:
        assert self._pose is not None
        speed = max(self._pose.speed, SLOWEST)
        moved = np.abs(np.log(self.theta / self._design.theta)).max() > LOG_STEP
        if moved or abs(speed - self._design.speed) > SPEED_STEP:
            rig = self.rig._replace(**dict(zip(PARAMETERS, self.theta.tolist(), strict=True)))
            self._design = design(rig, speed)

    def _project(self, body: BodyState) -> float:
        """Sample of the plan, with its fraction, where the tractor's CG is neither ahead nor behind."""
        plan, reach = self.plan.tractor, round(REACH_M / STEP)
        first = max(0, round(self.station) - reach)
        near = plan[first : round(self.station) + reach + 1]
        k = first + int(np.argmin(np.hypot(near[:, 0] - body.x, near[:, 1] - body.y)))
        x, y, psi = plan[min(k, len(plan) - 1)]
        ahead = (body.x - x) * math.cos(psi) + (body.y - y) * math.sin(psi)
        return float(min(max(k + ahead / STEP, 0.0), len(plan) - 1.0))

    def _deviations(self, measured: MeasuredPose) -> Array:
        """Of MEASURED from the plan."""
        plan, at = self.plan, self.station
        row = np.arange(len(plan.row))

        def of(values: Array) -> float:
            return float(np.interp(at, row, values))

        offs = []
        for body, planned in ((measured.tractor, plan.tractor), (measured.implement, plan.implement)):
            x, y, psi = (of(planned[:, k]) for k in range(3))
            across = -(body.x - x) * math.sin(psi) + (body.y - y) * math.cos(psi)
            offs.append((across, math.remainder(body.heading - psi, math.tau)))
        bend, bend_i = of(plan.curvature), of(plan.implement_curvature)
        return np.array(
            [
                offs[0][0],
                offs[1][0],
                offs[0][1],
                offs[1][1],
                measured.tractor.lateral_velocity - self.rig.b * bend * measured.speed,
                measured.tractor.yaw_rate - bend * measured.speed,
                measured.implement.yaw_rate - bend_i * measured.speed,
                measured.wheel_angle - of(plan.wheel_angle),
            ]
        )

    def _carried(self, to: float) -> Array:
        """The observer's state carried from the last pose on."""
        assert self._pose is not None
        made, speed = self._design, self._pose.speed
        n = len(made.f)
        x, hidden = self._state[:n], self._state[n:]
        steps = round((to - self._pose.at) / TICK_S)
        times = self._pose.at + TICK_S * np.arange(steps)
        ahead = self.station + np.arange(steps, dtype=np.float64) * (speed * TICK_S / STEP)
        forces = self._force(ahead, speed)
        still = made.e[:, 3:] @ np.concatenate([self._gravity(), hidden])
        since = [at for at, _ in self._given]
        values = [value for _, value in self._given]
        which = np.maximum(np.searchsorted(since, times, side="right") - 1, 0)
        for k in range(steps):
            x = made.f @ x + made.g * values[which[k]] + made.e[:, :3] @ forces[k] + still
        return np.concatenate([x, hidden])

    def _force(self, stations: Array, speed: float) -> Array:
        """The plan's forces at stations, shape (k, 3)."""
        last = len(self.plan.row) - 1
        k = np.clip(np.round(stations), 0, last).astype(np.int64)
        return np.asarray(speed**2 * self.plan.force[k])

    def _gravity(self) -> Array:
        assert self._pose is not None
        return 9.80665 * np.sin([self._pose.tractor.roll, self._pose.implement.roll])

    def _planned(self, station: float, speed: float) -> float:
        """The command that makes the servo follow the plan's wheel angle without lag."""
        delta = self.plan.wheel_angle
        k = min(max(round(station), 1), len(delta) - 2)
        slope = speed * (delta[k + 1] - delta[k - 1]) / (2 * STEP)
        bend = speed**2 * (delta[k + 1] - 2 * delta[k] + delta[k - 1]) / STEP**2
        return float(delta[k] + slope / SERVO + bend / (10.0 * SERVO))
