"""The dissertation's two-step identification as an estimator: it fits the windows of pem one by one and
merges them.

two_step_fit describes the method, and why none of its numbers is published as usable.
"""

import math
from dataclasses import dataclass, field
from typing import Annotated, Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.filters import unknowns
from tilth.estimator.filters.two_step_fit import TwoStep, Window, identify, merge_scalar
from tilth.estimator.models.parameters import geometry_of
from tilth.estimator.record.record import TICK_NS, Record, Segment
from tilth.estimator.record.windows import OPEN, close_window, collect, refuse
from tilth.estimator.results.method_state import MethodState, step_clock
from tilth.estimator.results.reporting import MODEL, age_s, per_mass
from tilth.estimator.state_json import Shape
from tilth.estimator.tuning import tuned
from tilth.schemas.flow import PARAMETERS, Estimate, ParameterEstimate, Pose, Status
from tilth.schemas.machine import Machine
from tilth.schemas.reasons import Code, Reason

Array = NDArray[np.float64]
OfSix = Annotated[Array, Shape((6,))]

METHOD: Final = "pem_two_step"


@dataclass(frozen=True, slots=True)
class TwoStepTuning:
    """When the dissertation's two-step fit is computed."""

    publish_ns: int = tuned(10_000_000_000, "ns", "between two estimates")
    latency_ns: int = tuned(4_000_000_000, "ns", "a second more than pem: the worker computes its fit first")


TWO_STEP: Final = TwoStepTuning()


@dataclass(frozen=True, slots=True)
class Job:
    """A fit to compute."""

    asked_ns: int  # t_ns of the frame at which it was requested
    closed_ns: int  # instant of its last tick
    record: Record


@dataclass(slots=True)
class TwoStepState(MethodState):
    """The present window, and the merged results of those before. Times ns."""

    window: list[Segment] = field(default_factory=list)
    closed: Record | None = None  # a complete window whose fit is not requested yet
    job: Job | None = None  # requested, not adopted yet
    decided: int = OPEN  # state of the job: see windows.OPEN
    late_ns: int = 0  # by how much the last decided fit was late
    values: OfSix = field(default_factory=lambda: np.zeros(6))  # of flow.PARAMETERS, merged so far
    sds: OfSix = field(default_factory=lambda: np.zeros(6))
    runs: OfSix = field(default_factory=lambda: np.zeros(6))  # number of windows merged into each
    rank: int = 0  # of the last window
    window_s: float = 0.0
    late: int = 0  # fits that came too late
    failure: Code | None = None  # why the last window gave no result


def initial(machine: Machine) -> TwoStepState:
    """Before the first window."""
    return TwoStepState()


def take(state: TwoStepState, machine: Machine, pose: Pose, segment: Segment | None) -> Estimate | None:
    """Take one segment. Returns an estimate each `publish_ns`. Of the pose only the time is used."""
    return (
        estimate(state, machine, pose.t_ns)
        if collect(state, pose.t_ns, segment, TWO_STEP.publish_ns)
        else None
    )


def finish(state: TwoStepState) -> None:
    """No more driving follows: close the present window, as a gap would."""
    close_window(state, 0.0, 0.0)


def request_fit(state: TwoStepState, t_ns: int) -> Job | None:
    """The fit to request at the frame of t_ns: of a complete window, if no other fit is pending; else
    None."""
    if state.closed is None or state.job is not None:
        return None
    record, state.closed = state.closed, None
    state.job = Job(t_ns, record.end_ns, record)
    return state.job


def fit(machine: Machine, job: Job) -> TwoStep:
    """The result of a job, a pure function of its arguments. The search starts at the tyres of the machine
    file."""
    mean, _ = unknowns.prior(machine)
    start: Array = np.exp(mean[unknowns.SIX])
    return identify(Window(job.record, geometry_of(machine), start, unknowns.levers(machine)))


def rehearse(machine: Machine) -> None:
    """Nothing here is compiled."""


def adopt(state: TwoStepState, machine: Machine, made: TwoStep | None, t_ns: int) -> Estimate:
    """Merge the result of a window, each number by itself (7.20, 7.21); made: None if there is none."""
    job, state.job, state.decided = state.job, None, OPEN
    if made is None or job is None:
        state.late += 1
        return estimate(state, machine, t_ns)
    state.late += state.late_ns > 0
    state.rank, state.failure = made.rank, made.reason
    if made.reason:
        refuse(state, made.reason)
    for k in range(len(PARAMETERS)):
        if not made.found[k // 3] or not 0.0 < made.sds[k] < math.inf:
            continue
        values, sds = [float(made.values[k])], [float(made.sds[k])]
        if state.runs[k]:
            values, sds = [float(state.values[k]), *values], [float(state.sds[k]), *sds]
        state.values[k], state.sds[k] = merge_scalar(values, sds)
        state.runs[k] += 1
    if any(made.found):
        state.informed_ns = job.closed_ns
        state.window_s += len(job.record.ticks) * TICK_NS * 1e-9
    return estimate(state, machine, t_ns)


def estimate(state: TwoStepState, machine: Machine, t_ns: int) -> Estimate:
    """The estimate at t_ns; each number has the reason why it must not be used."""
    age = age_s(state.informed_ns, t_ns)
    parameters = tuple(_parameter(state, k, age) for k in range(len(PARAMETERS)))
    _, prior_sd = unknowns.prior(machine)
    log_sds = np.where(state.runs > 0, state.sds / np.maximum(state.values, 1e-9), prior_sd[unknowns.SIX])
    excitation = {"runs": float(state.runs.max()), "late": float(state.late)}
    if state.late_ns:
        excitation["late_s"] = state.late_ns * 1e-9
    given = [p.value is not None for p in parameters[:3]]
    masses = per_mass(
        machine, np.log(np.maximum(state.values[:3], 1e-9)).tolist(), log_sds[:3].tolist(), given
    )
    return Estimate(
        t_ns=t_ns,
        method=METHOD,
        model=MODEL,
        parameters=parameters,
        log_covariance=tuple(np.diag(log_sds**2).ravel().tolist()),  # the method has no correlations
        per_mass=masses.values,
        per_mass_sd=masses.sds,
        rank=state.rank,
        excitation=excitation,
        window_s=state.window_s,
    )


def _parameter(state: TwoStepState, k: int, age: float | None) -> ParameterEstimate:
    if not state.runs[k]:
        return ParameterEstimate(None, None, Status.UNESTIMATED, Reason(state.failure or Code.NO_WINDOW_YET))
    of_stiffness = Reason(Code.RANK_OF_TWO_OUTPUTS, numbers=(float(state.rank),))
    reason = of_stiffness if k < 3 else Reason(Code.ON_UNIDENTIFIABLE)
    return ParameterEstimate(float(state.values[k]), float(state.sds[k]), Status.INVALID, reason, age)


def clock_stepped(state: TwoStepState, by_ns: int) -> None:
    """The log's clock stepped back: discard the window and the pending fit; merged values stay."""
    state.window.clear()
    state.closed = state.job = None
    state.decided = OPEN
    step_clock(state, by_ns)
