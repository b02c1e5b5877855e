"""The estimators, one row each: an extension point. Tests run over every row.

A row's functions share a state of their own type, which must be plain data (estimator/state_json.py): it is
stored with the log and taken up again. Its `events` are what happened and was not published yet. A row with
`fitting` asks for fits, which are made outside the fold.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from tilth.estimator.compiled import Kernel
from tilth.estimator.filters import unknowns
from tilth.estimator.methods import pem, steady_state, tracker, two_step
from tilth.estimator.record.record import Stretch
from tilth.schemas.flow import Estimate, Pose
from tilth.schemas.machine import Machine


@dataclass(frozen=True, slots=True)
class Fitting:
    """How a row's fits are asked for, made and taken. The job that waits stands in `state.job`."""

    latency_ns: int  # of the log's time, from asking to taking
    wanted: Callable[[Any, int], Any]  # (state, t_ns): a job, or None
    fit: Callable[[Machine, Any], Any]  # pure
    rehearse: Callable[[Machine], None]  # a fit of nothing, which compiles what a fit needs
    adopt: Callable[[Any, Machine, Any, int], Estimate]  # (state, machine, result or None, t_ns)


@dataclass(frozen=True, slots=True)
class Memory:
    """What of a row's state goes on in the next run: attributes of the state, besides `informed_ns`."""

    names: tuple[str, ...]  # of what the vector holds
    mean: str
    covariance: str
    passing: tuple[str, ...]  # names that begin anew with each run
    counts: tuple[str, ...]  # numbers that go on


@dataclass(frozen=True, slots=True)
class Estimator:
    method: str  # published on /soil_tire/<method>
    state: type
    initial: Callable[[Machine], Any]
    take: Callable[
        [Any, Machine, Pose, Stretch | None], Estimate | None
    ]  # changes the state; an estimate when one is due
    estimate: Callable[[Any, Machine, int], Estimate]  # what can be said at a time, ns
    clock_stepped: Callable[
        [Any, int], None
    ]  # the log's clock ran on by so many ns, below zero; keep what was learned
    fitting: Fitting | None = None
    memory: Memory | None = None
    asked_for: Callable[[Machine], bool] = lambda machine: True  # whether a machine file wants it
    prepare: Callable[[Machine], None] = lambda machine: None  # compiles what `take` needs; changes nothing
    kernels: tuple[Kernel[..., Any], ...] = ()  # that `prepare` compiles


ESTIMATORS: tuple[Estimator, ...] = (
    Estimator(
        steady_state.METHOD,
        steady_state.SteadyState,
        steady_state.initial,
        steady_state.take,
        steady_state.estimate,
        steady_state.clock_stepped,
        memory=Memory(steady_state.STATES, "x", "p", ("slow_t", "slow_i"), ("steady_s", "sideslip_s")),
    ),
    Estimator(
        tracker.METHOD,
        tracker.TrackerState,
        tracker.initial,
        tracker.take,
        tracker.estimate,
        tracker.clock_stepped,
        memory=Memory(unknowns.NAMES, "mean", "covariance", unknowns.NOISES, ("window_s", "distance")),
        prepare=tracker.prepare,
        kernels=tracker.KERNELS,
    ),
    Estimator(
        pem.METHOD,
        pem.PemState,
        pem.initial,
        pem.take,
        pem.estimate,
        pem.clock_stepped,
        fitting=Fitting(pem.LATENCY_NS, pem.wanted, pem.fit, pem.rehearse, pem.adopt),
        memory=Memory(unknowns.NAMES, "mean", "covariance", unknowns.NOISES, ("fits", "window_s")),
    ),
    Estimator(
        two_step.METHOD,
        two_step.TwoStepState,
        two_step.initial,
        two_step.take,
        two_step.estimate,
        two_step.clock_stepped,
        fitting=Fitting(
            two_step.LATENCY_NS, two_step.wanted, two_step.fit, two_step.rehearse, two_step.adopt
        ),
        asked_for=lambda machine: machine.estimation.two_step,
        # No memory: 7.20 forgets nothing, so that what it merged begins anew with each run.
    ),
)

ROW: dict[str, Estimator] = {row.method: row for row in ESTIMATORS}


def rows_for(machine: Machine) -> tuple[Estimator, ...]:
    """The rows that run on a machine, in their order, which is also that of their fits in the worker."""
    return tuple(row for row in ESTIMATORS if row.asked_for(machine))
