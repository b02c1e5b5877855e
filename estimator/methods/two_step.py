"""The dissertation's two steps as an estimator: the windows of pem, each fitted alone, merged by number.

What the method is, and why none of its numbers is published as one to use: two_step_fit.
"""

import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.filters import unknowns
from tilth.estimator.filters.two_step_fit import TwoStep, Window, identify, merge_scalar
from tilth.estimator.record.record import TICK_NS, Record, Segment
from tilth.estimator.record.windows import OPEN, collect, refuse
from tilth.estimator.results.reporting import MODEL, age_s, per_mass
from tilth.schemas.flow import PARAMETERS, Estimate, ParameterEstimate, Pose, Status
from tilth.schemas.machine import Machine

Array = NDArray[np.float64]

METHOD: Final = "pem_two_step"
PUBLISH_NS: Final = 10_000_000_000
LATENCY_NS: Final = 4_000_000_000  # a second more than pem's: the one worker makes that fit first
_REASONS: Final = (
    "rank {rank} of 3: yaw rate and articulation do not tell three stiffnesses apart",
    "stands on stiffnesses that two outputs do not tell apart; with a free gain its interval is too narrow",
)


@dataclass(frozen=True, slots=True)
class Job:
    """A fit to be made."""

    asked_ns: int  # of the frame at which the window closed
    closed_ns: int  # instant of its last tick
    record: Record


@dataclass(slots=True)
class TwoStepState:
    """The window being driven, and what those before gave. Plain data; times ns."""

    window: list[Segment] = field(default_factory=list)
    closed: Record | None = None  # waits to be asked for
    job: Job | None = None  # asked for, not taken yet
    decided: int = OPEN  # of the job: see windows.OPEN
    late_ns: int = 0  # by how much the fit was late that was decided last
    values: Array = field(default_factory=lambda: np.zeros(6))  # of flow.PARAMETERS, merged so far
    sds: Array = field(default_factory=lambda: np.zeros(6))
    runs: Array = field(default_factory=lambda: np.zeros(6))  # merged into each
    rank: int = 0  # of the last window
    window_s: float = 0.0
    informed_ns: int = 0
    published_ns: int = 0
    late: int = 0  # fits that came too late
    refused: dict[str, int] = field(default_factory=dict)  # reason -> stretches, or windows
    reason: str = ""  # why nothing is collected now
    failure: str = ""  # why the last window gave nothing
    events: list[tuple[str, str]] = field(default_factory=list)  # none so far


def initial(machine: Machine) -> TwoStepState:
    """Before the first window."""
    return TwoStepState()


def take(state: TwoStepState, machine: Machine, pose: Pose, segment: Segment | None) -> Estimate | None:
    """Take one stretch; an estimate each PUBLISH_NS. The pose serves as the time."""
    return estimate(state, machine, pose.t_ns) if collect(state, pose.t_ns, segment, PUBLISH_NS) else None


def request_fit(state: TwoStepState, t_ns: int) -> Job | None:
    """A fit to ask for at the frame of t_ns, once a window has closed."""
    if state.closed is None or state.job is not None:
        return None
    record, state.closed = state.closed, None
    state.job = Job(t_ns, record.end_ns, record)
    return state.job


def fit(machine: Machine, job: Job) -> TwoStep:
    """The result of a job: a function of its arguments alone. Sought from the machine file's tyres on."""
    mean, _ = unknowns.prior(machine)
    start: Array = np.exp(mean[unknowns.SIX])
    return identify(Window(job.record, unknowns.base_geometry(machine), start, unknowns.levers(machine)))


def rehearse(machine: Machine) -> None:
    """Nothing here is compiled."""


def adopt(state: TwoStepState, machine: Machine, made: TwoStep | None, t_ns: int) -> Estimate:
    """Merge what a window gave, each number by itself (7.20, 7.21); None: there is none."""
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
    """What the method says now, with why it is not to be used."""
    age = age_s(state.informed_ns, t_ns)
    parameters = tuple(_parameter(state, k, age) for k in range(len(PARAMETERS)))
    _, prior_sd = unknowns.prior(machine)
    log_sds = np.where(state.runs > 0, state.sds / np.maximum(state.values, 1e-9), prior_sd[unknowns.SIX])
    excitation = {"runs": float(state.runs.max()), "late": float(state.late)}
    if state.late_ns:
        excitation["late_s"] = state.late_ns * 1e-9
    return Estimate(
        t_ns=t_ns,
        method=METHOD,
        model=MODEL,
        parameters=parameters,
        log_covariance=tuple(np.diag(log_sds**2).ravel().tolist()),  # the method knows of no correlations
        per_mass=per_mass(machine, parameters),
        rank=state.rank,
        excitation=excitation,
        window_s=state.window_s,
    )


def _parameter(state: TwoStepState, k: int, age: float | None) -> ParameterEstimate:
    if not state.runs[k]:
        return ParameterEstimate(
            None, None, Status.UNESTIMATED, state.failure or "no window has been fitted yet"
        )
    reason = _REASONS[k // 3].format(rank=state.rank)
    return ParameterEstimate(float(state.values[k]), float(state.sds[k]), Status.INVALID, reason, age)


def clock_stepped(state: TwoStepState, by_ns: int) -> None:
    """Time ran back: the window and the fit under way are given up; what was learned stays."""
    state.window.clear()
    state.closed = state.job = None
    state.decided = OPEN
    state.published_ns = 0
    state.informed_ns += by_ns if state.informed_ns else 0
