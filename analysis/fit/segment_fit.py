"""The product's own estimators over one segment of driving, from the machine file's prior.

The same steps as in the fold: what a replay gives that holds this driving and nothing else.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from tilth.analysis.runs.driven import Driven
from tilth.estimator.filters.unknowns import NOISE
from tilth.estimator.methods import pem
from tilth.estimator.methods.estimators import ROW, Estimator
from tilth.estimator.record.record import Record
from tilth.schemas.flow import Estimate
from tilth.schemas.machine import Machine
from tilth.schemas.reasons import Code

Array = NDArray[np.float64]

METHODS: Final = (pem.METHOD, "tracker", "steady_state")
TWO_STEP: Final = "pem_two_step"


@dataclass(frozen=True, slots=True)
class FittedWindow:
    """Driving that pem has fitted, and the noise levels that it found, as unknowns.NOISE."""

    record: Record
    noise: Array


@dataclass(frozen=True, slots=True)
class SegmentFit:
    """What the methods say of one segment."""

    estimates: dict[str, Estimate]  # method -> at the segment's end
    mean: Array  # [n] of unknowns.NAMES, by pem
    covariance: Array  # [n, n]
    windows: tuple[FittedWindow, ...]
    metres: float  # driven since the last window
    refused: dict[Code, int]  # reason -> windows or stretches of 0.2 s of which pem learned nothing
    whiteness: float  # of the last fit: autocorrelation of its innovations
    excess: Array = field(default_factory=lambda: np.zeros(6))  # as pem.excess

    @property
    def seconds(self) -> float:
        """Of driving that was fitted."""
        return sum(len(window.record.ticks) for window in self.windows) * 0.02


def fit_segment(machine: Machine, driven: Sequence[Driven], methods: Sequence[str] = METHODS) -> SegmentFit:
    """A pure function of its arguments. driven: at least one pose."""
    followed = {method: _follow(ROW[method], machine, driven) for method in methods}
    t_ns = driven[-1].t_ns
    estimates = {
        method: ROW[method].estimate(state, machine, t_ns) for method, (state, _) in followed.items()
    }
    learned, windows = followed[pem.METHOD]
    last = learned.last
    return SegmentFit(
        estimates, learned.mean, pem.drifted(learned), windows, learned.distance, dict(learned.refused),
        last.whiteness if last else 0.0, pem.excess(learned),
    )  # fmt: skip


def _follow(
    row: Estimator, machine: Machine, driven: Sequence[Driven]
) -> tuple[Any, tuple[FittedWindow, ...]]:
    """A method's state after the driving, and what was fitted; fits are used when they would be in the
    fold."""
    state, fitting = row.initial(machine), row.fitting
    windows: list[FittedWindow] = []
    for at in driven:
        if fitting is not None and state.job and at.t_ns >= state.job.asked_ns + fitting.latency_ns:
            _adopt(row, state, machine, at.t_ns, windows)
        row.take(state, machine, at.pose, at.segment)
        if fitting is not None:
            fitting.request_fit(state, at.t_ns)
    if fitting is not None:
        t_ns = driven[-1].t_ns
        _fit_now(row, state, machine, t_ns, windows)
        fitting.finish(state)
        _fit_now(row, state, machine, t_ns, windows)
    return state, tuple(windows)


def _fit_now(row: Estimator, state: Any, machine: Machine, t_ns: int, windows: list[FittedWindow]) -> None:
    """Make and use all fits that wait."""
    assert row.fitting is not None
    while state.job is not None or row.fitting.request_fit(state, t_ns) is not None:
        _adopt(row, state, machine, t_ns, windows)


def _adopt(row: Estimator, state: Any, machine: Machine, t_ns: int, windows: list[FittedWindow]) -> None:
    assert row.fitting is not None
    job = state.job
    made = row.fitting.fit(machine, job)
    if isinstance(made, pem.Fit) and not made.refused:
        windows.append(FittedWindow(job.record, made.mean[NOISE].copy()))
    row.fitting.adopt(state, machine, made, t_ns)
