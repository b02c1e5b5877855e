"""What the methods remember, common parts of their states: each is stored in the log with the state that has
it (state_json.py)."""

from dataclasses import KW_ONLY, dataclass, field

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.filters.drift import drift, retained_share
from tilth.estimator.filters.unknowns import SIX, Matrix, Vector
from tilth.schemas.notices import Notice
from tilth.schemas.reasons import Code

Array = NDArray[np.float64]


@dataclass(slots=True, kw_only=True)
class MethodState:
    """Of any method. Times ns."""

    informed_ns: int = 0  # when it last learned from data, 0: never
    published_ns: int = 0
    refused: dict[Code, int] = field(default_factory=dict)  # reason -> poses, segments, windows or fits
    reason: Code | None = None  # why nothing is learned now
    events: list[tuple[str, Notice]] = field(default_factory=list)  # with kinds, not taken yet


@dataclass(slots=True)
class SixState(MethodState):
    """Of a method that learns all six logarithms. Arrays in the order of unknowns.NAMES; distances m."""

    mean: Vector
    covariance: Matrix
    prior_mean: Vector
    prior_sd: Vector
    _: KW_ONLY
    distance: float = 0.0  # m
    last_pose_ns: int = 0
    window_s: float = 0.0  # duration of what was learned from
    changes: int = 0  # of soil
    has_number: list[bool] = field(default_factory=lambda: [False] * 6)
    """Whether each of the six had a number in the last estimate."""


def take_events(state: MethodState) -> list[tuple[str, Notice]]:
    """(kind, notice) of a method's events since the last call."""
    events, state.events = state.events, []
    return events


def is_due(state: MethodState, t_ns: int, every_ns: int) -> bool:
    """Whether an estimate is due at t_ns, with so much between two."""
    due = t_ns - state.published_ns >= every_ns
    if due:
        state.published_ns = t_ns
    return due


def step_clock(state: MethodState, by_ns: int) -> None:
    """The log's clock stepped back: what was learned keeps its age."""
    state.published_ns = 0
    state.informed_ns += by_ns if state.informed_ns else 0


def drifted(state: SixState, covariance: Array, metres: float) -> Array:
    """A covariance, (n, n), of the unknowns, so many metres later."""
    covariance = covariance.copy()
    drift(covariance, SIX, retained_share(metres), state.prior_sd)
    return covariance
