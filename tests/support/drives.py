"""Simulated drives through the fold, for the tests of what is learned; fits are ready at once."""

import math
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from circle import demo_machine
from estimation_study import fitted_at_once
from numpy.typing import NDArray

from tilth.estimator import fold
from tilth.estimator.fold import State, initial, step
from tilth.schemas.flow import PARAMETERS, Estimate, Frame, Pose, Publication, Status
from tilth.schemas.machine import Machine
from tilth.simulator.scenario import Scenario
from tilth.simulator.tractor import draw
from tilth.simulator.traffic import simulate

Array = NDArray[np.float64]
Changes = tuple[tuple[str, str], ...]

SEED = 3
SECOND = 1_000_000_000
SPEED = 5.5
LEARNING = ((2.0, 0.0), (10.0, 8.0), (10.0, -8.0), (10.0, 7.0), (10.0, -7.0))  # 42 s, degrees of the wheels
QUIET = Scenario(other_traffic=False, noise=0.5, speed=SPEED, steering=LEARNING)


@dataclass(frozen=True)
class Run:
    """A drive as the fold saw it."""

    state: State
    start_ns: int
    publications: list[Publication]
    truth: dict[str, float]  # PARAMETERS

    def estimates(self, method: str) -> list[Estimate]:
        topic = f"/soil_tire/{method}"
        return [p.value for p in self.publications if p.topic == topic and isinstance(p.value, Estimate)]

    def poses(self) -> list[Pose]:
        return [p.value for p in self.publications if isinstance(p.value, Pose)]

    def last(self, method: str, before_s: float = math.inf) -> Estimate:
        """The last estimate published up to a time of the drive."""
        return [e for e in self.estimates(method) if self.at(e.t_ns) <= before_s][-1]

    def at(self, t_ns: int) -> float:
        return (t_ns - self.start_ns) * 1e-9


def folded(machine: Machine, frames: list[Frame], truth: dict[str, float], decoder: Any = None) -> Run:
    state = initial(machine)
    if decoder is not None:
        state.decoder = decoder
    out: list[Publication] = []
    for frame in frames:
        out += fitted_at_once(state, frame.t_ns)
        out += step(state, frame)
        fold.request_fits(state, frame.t_ns)
    return Run(state, frames[0].t_ns, out, truth)


@cache
def driven(scenario: Scenario, seconds: float, changes: Changes = ()) -> Run:
    """changes: of texts of the packaged machine file."""
    machine = demo_machine(**dict(changes))
    frames = list(simulate(machine, SEED, seconds, scenario))
    return folded(machine, frames, draw(machine, SEED, scenario))


def sds(estimate: Estimate) -> Array:
    """Of the six natural logarithms."""
    return np.sqrt(np.diag(np.array(estimate.log_covariance).reshape(6, 6)))


def values(estimate: Estimate) -> Array:
    """Natural logarithms, nan where there is no number."""
    return np.array([math.log(p.value) if p.value else math.nan for p in estimate.parameters])


def moved(before: Estimate, after: Estimate) -> float:
    """Largest change of a number that both give, in sds of the one before."""
    change = np.abs(values(after) - values(before)) / sds(before)
    return float(np.nanmax(change)) if np.isfinite(change).any() else 0.0


def errors(run: Run, estimate: Estimate) -> Array:
    """Of what is said to be usable, in published sds; nan where nothing is."""
    usable = [p.status is Status.ESTIMATED for p in estimate.parameters]
    truth = np.log([run.truth[name] for name in PARAMETERS])
    return np.where(usable, (values(estimate) - truth) / sds(estimate), math.nan)
