"""The estimators, one row each: an extension point. Tests run over every row. The first is recommended.

A row's three functions share a state of their own type, which must be plain data (see estimator/plain.py): it
is stored with the log and taken up again.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from tilth.estimator import steady_state
from tilth.schemas.flow import Estimate, Pose
from tilth.schemas.machine import Machine


@dataclass(frozen=True, slots=True)
class Estimator:
    method: str  # published on /soil_tire/<method>
    state: type
    initial: Callable[[Machine], Any]
    take: Callable[[Any, Machine, Pose], Estimate | None]  # changes the state; an estimate when one is due
    estimate: Callable[[Any, Machine, int], Estimate]  # what can be said at a time, ns
    clock_stepped: Callable[
        [Any, int], None
    ]  # the log's clock ran on by so many ns, below zero; keep what was learned


ESTIMATORS: tuple[Estimator, ...] = (
    Estimator(
        steady_state.METHOD,
        steady_state.SteadyState,
        steady_state.initial,
        steady_state.take,
        steady_state.estimate,
        steady_state.clock_stepped,
    ),
)
