"""The closed loop in one process, as fast as it can and the same each time: plant, CAN, fold, controller.

nonlinear tractor ─► its frames ─► the daemon's fold ─► poses, estimates ─► controller ─► commands ─► tractor

Only the wires are missing: no Zenoh, no socket, no clock. What the controller is told of the soil is a
choice:

fixed     nothing: the nominal gains
adapting  what the fold publishes, with the caution of tilth.client
knowing   the true parameters under the axles at each moment
"""

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.adaptive_guidance.controller import LIMITS, STALE, Controller
from tilth.adaptive_guidance.follower import PERIOD_S
from tilth.adaptive_guidance.plan import STEP, Along, Plan, Work, plan
from tilth.client import Limits
from tilth.client.latest import judge
from tilth.estimator.models.parameters import Rig, rig_of
from tilth.logger.guarded_fold import GuardedFold
from tilth.schemas.flow import PARAMETERS, Estimate, Frame, Pose
from tilth.schemas.machine import Machine
from tilth.simulator.drive import drive
from tilth.simulator.scenario import ORIGIN_DEG, STEP_S, Scenario
from tilth.simulator.steered_rig import LiveDriver
from tilth.simulator.tractor import Setting, Truth

Array = NDArray[np.float64]

FIRST_S: Final = 1.0  # of a run: poses come by then
EVERY: Final = 10  # samples between two of an error

TimedEstimates = list[tuple[float, Estimate]]
"""(s of the run, recommended estimate)"""


@dataclass(slots=True)
class RunTrace:
    """What one run leaves behind besides the truth."""

    estimates: TimedEstimates = field(default_factory=list)
    theta: list[Array] = field(default_factory=list)  # (6,) in force at each command
    taken: int = 0  # commands
    refused: dict[str, int] = field(default_factory=dict)
    ended: str = ""  # code of why the controller had ceased to steer at the end


@dataclass(slots=True)
class Loop:
    """The exchange of a LiveDriver: frames of the tractor in, commands out."""

    controller: Controller
    fold: GuardedFold
    mode: str
    truth: Callable[[float], Array]  # parameters at a time, as far as they are to be known, (6,)
    zero_ns: int  # of the run, on the frames' clock
    estimates: TimedEstimates  # instead of what the fold says
    trace: RunTrace = field(default_factory=RunTrace)
    _next: float = FIRST_S
    _last: tuple[float, Estimate] | None = None
    _ahead: Estimate | None = None  # asked for with the last

    def __call__(self, now: float, frames: list[Frame]) -> list[tuple[int, bytes]]:
        for frame in frames:
            for publication, _ in self.fold.take(frame):
                value = publication.value
                if isinstance(value, Pose):
                    self.controller.pose(value, (value.t_ns - self.zero_ns) * 1e-9)
                elif isinstance(value, Estimate) and publication.topic == "/soil_tire":
                    self._last = now, value
                    self.trace.estimates.append(self._last)
                    place = self.controller.ahead()
                    self._ahead = None if place is None else self.fold.estimate_at(*place)
        while self.estimates and self.estimates[0][0] <= now:
            self._last = self.estimates.pop(0)
        if now < self._next - STEP_S / 2:
            return []
        self._next += PERIOD_S
        if self.mode == "adapting":
            estimate, age = (None, math.inf) if self._last is None else (self._last[1], now - self._last[0])
            ahead = None if self._ahead is None else judge(self._ahead, age, STALE)
            self.controller.estimate(judge(estimate, age, STALE), now, ahead)
        elif self.mode == "knowing":
            self.controller.follower.theta = self.truth(now)
        self.trace.theta.append(self.controller.follower.theta)
        return self.controller.command(now)


def run(
    machine: Machine,
    seed: int,
    scenario: Scenario,
    work: Work,
    mode: str,
    *,
    limits: Limits = LIMITS,
    known: Collection[str] = PARAMETERS,
    estimates: TimedEstimates | None = None,
    slack_s: float = 3.0,
) -> tuple[Plan, Truth, RunTrace]:
    """Drive the field at the scenario's speed (a number). mode: fixed | adapting | knowing.

    known: what of the parameters who knows does know; he takes the rest for nominal. estimates: what is
    said to who adapts, instead of what the fold finds. slack_s: longer than the plan; who strays needs more.
    """
    nominal = rig_of(machine)
    line = plan(work, nominal)
    assert isinstance(scenario.speed, float)
    seconds = len(line.row) * STEP / scenario.speed + slack_s
    scenario = replace(scenario, clock_offset_s=0.0, other_traffic=False)
    loops: list[Loop] = []
    drivers: list[LiveDriver] = []

    def driver(setting: Setting) -> LiveDriver:
        controller = Controller(line, nominal, ORIGIN_DEG, limits)
        fold = GuardedFold(machine)
        fold.ready = mode == "adapting" and estimates is None  # others need poses only
        soil = _soil(setting, controller, nominal, known)
        loops.append(Loop(controller, fold, mode, soil, scenario.utc_start_ns, list(estimates or ())))
        drivers.append(LiveDriver(machine, setting, loops[0]))
        return drivers[0]

    truth = drive(machine, seed, seconds, scenario, driven_by=driver)
    trace, steering = loops[0].trace, drivers[0].steering
    trace.taken, trace.refused = steering.taken, dict(steering.refused)
    trace.ended = loops[0].controller.code
    return line, truth, trace


def _soil(
    setting: Setting, controller: Controller, nominal: Rig, known: Collection[str]
) -> Callable[[float], Array]:
    """The true parameters where the plan's tractor is: its CG's place counts for all axles."""

    def at(now: float) -> Array:
        follower = controller.follower
        x = np.zeros(13)
        x[:2] = follower.plan.tractor[min(round(follower.station), len(follower.plan.row) - 1), :2]
        return np.where([name in known for name in PARAMETERS], setting.soil.at(now, x), nominal.theta)

    return at


def cross_track(line: Plan, truth: Truth) -> tuple[Array, NDArray[np.int64]]:
    """(error of the implement's CG to the right of its line, m; sample of the plan), each EVERY samples."""
    along, track = Along(line), truth.implement
    found = [along.error(x, y) for x, y in zip(track.x[::EVERY], track.y[::EVERY], strict=True)]
    errors, at = zip(*found, strict=True)
    return np.array(errors), np.array(at)
