"""The fits that methods ask for, which a process beside the fold computes."""

from typing import Any

from tilth.estimator.methods.estimators import FITTED
from tilth.estimator.record.windows import AWAITED, DROPPED, TAKEN
from tilth.estimator.state import State
from tilth.schemas.flow import FitOutcome


def finish(state: State) -> None:
    """No frame follows: the windows of driving that are open now are complete, and fits may be requested."""
    for method, fitting in FITTED:
        if method in state.estimators:
            fitting.finish(state.estimators[method])


def request_fits(state: State, t_ns: int) -> list[tuple[str, Any]]:
    """(method, job) of the fits that are requested after the frame of t_ns; `ROW[method].fitting` makes
    them."""
    jobs = []
    for method, fitting in FITTED:  # at every frame: those that are not enabled have no state
        method_state = state.estimators.get(method)
        job = fitting.request_fit(method_state, t_ns) if method_state is not None else None
        if job is not None:
            jobs.append((method, job))
    return jobs


def pending(state: State) -> list[tuple[str, Any, int]]:
    """(method, job, t_ns at which its result is due) of the fits that were requested and not adopted yet."""
    return [
        (method, method_state.job, method_state.job.asked_ns + fitting.latency_ns)
        for method, fitting in FITTED
        if (method_state := state.estimators.get(method)) is not None and method_state.job is not None
    ]


def decide(state: State, outcome: FitOutcome) -> None:
    """Store the outcome of a method's pending fit, for a program that restores the state before the fit is
    used."""
    method_state = state.estimators[outcome.method]
    method_state.decided = TAKEN if outcome.adopted else AWAITED if outcome.awaited else DROPPED
    method_state.late_ns = outcome.late_ns
