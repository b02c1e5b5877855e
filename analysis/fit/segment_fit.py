"""The product's own estimators over one segment of driving, from the machine file's prior.

The same steps as in the fold: what a replay gives that holds this driving and nothing else.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from tilth.analysis.runs.driving import Driven
from tilth.estimator.filters import likelihood
from tilth.estimator.filters.unknowns import AT
from tilth.estimator.methods import pem
from tilth.estimator.methods.estimators import ROW, Estimator
from tilth.estimator.record.record import WHEEL_ANGLE
from tilth.schemas.flow import Estimate
from tilth.schemas.machine import Machine

Array = NDArray[np.float64]

METHODS: Final = (pem.METHOD, "tracker", "steady_state")
TWO_STEP: Final = "pem_two_step"


@dataclass(frozen=True, slots=True)
class SegmentFit:
    """What the methods say of one segment."""

    estimates: dict[str, Estimate]  # method -> at the segment's end
    mean: Array  # [n] of unknowns.NAMES, by pem
    covariance: Array  # [n, n]
    model_sd: Array  # (6,), what of it are errors of the model, which segments have in common
    seconds: float  # of driving that pem has fitted
    metres: float  # driven in the segment
    refused: dict[str, int]  # reason -> windows or stretches of 0.2 s of which pem learned nothing
    whiteness: float  # of the last fit: autocorrelation of its innovations


def fit_segment(machine: Machine, driven: Sequence[Driven], methods: Sequence[str] = METHODS) -> SegmentFit:
    """A pure function of its arguments. driven: at least one pose."""
    states = {method: _follow(ROW[method], machine, driven) for method in methods}
    t_ns = driven[-1].t_ns
    estimates = {method: ROW[method].estimate(state, machine, t_ns) for method, state in states.items()}
    learned = states[pem.METHOD]
    last = learned.last
    return SegmentFit(
        estimates, learned.mean, pem.drifted(learned), _model_sd(driven, learned.mean), learned.window_s,
        learned.distance, dict(learned.refused), last.whiteness if last else 0.0,
    )  # fmt: skip


def _follow(row: Estimator, machine: Machine, driven: Sequence[Driven]) -> Any:
    """A method's state after the driving; fits are used when they would be in the fold."""
    state, fitting = row.initial(machine), row.fitting
    for at in driven:
        if fitting is not None and state.job and at.t_ns >= state.job.asked_ns + fitting.latency_ns:
            fitting.adopt(state, machine, fitting.fit(machine, state.job), at.t_ns)
        row.take(state, machine, at.pose, at.segment)
        if fitting is not None:
            fitting.request_fit(state, at.t_ns)
    if fitting is None:
        return state
    t_ns = driven[-1].t_ns
    _fit_now(row, state, machine, t_ns)
    fitting.finish(state)
    _fit_now(row, state, machine, t_ns)
    return state


def _fit_now(row: Estimator, state: Any, machine: Machine, t_ns: int) -> None:
    """Make and use all fits that wait."""
    fitting = row.fitting
    assert fitting is not None
    while state.job is not None or fitting.request_fit(state, t_ns) is not None:
        fitting.adopt(state, machine, fitting.fit(machine, state.job), t_ns)


def _model_sd(driven: Sequence[Driven], mean: Array) -> Array:
    """As likelihood.model_sd_of, of all that may be learned from."""
    angles = [
        float(np.abs(at.segment.record.ticks[:, WHEEL_ANGLE]).max())
        for at in driven
        if at.segment is not None and not at.segment.reason and len(at.segment.record.ticks)
    ]
    tight = max(angles, default=0.0) > likelihood.TIGHT
    return likelihood.model_sd(tight, float(np.exp(mean[_UNEVEN])))


_UNEVEN: Final = AT["uneven"]
