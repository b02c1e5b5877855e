"""For the warm start: take what a method has learned out of its state, and put it into a fresh one."""

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.filters.soil_field import KeptSoil
from tilth.estimator.filters.unknowns import SIX
from tilth.estimator.methods.pem import PemState, drifted, excess, with_known_masses
from tilth.estimator.methods.place import PLACE, PlaceState
from tilth.estimator.methods.rows import RowsState, learned_covariance
from tilth.estimator.methods.steady_state import SteadyState
from tilth.estimator.methods.tracker import TrackerState
from tilth.estimator.tuning import tuned
from tilth.schemas.flow import PARAMETERS

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class LearnedTuning:
    """What a fit leaves for the next."""

    largest_share: float = tuned(0.95, "1", "of a sd, that errors of the model make of it")


LEARNED: Final = LearnedTuning()

_MODEL_SDS: Final = tuple(f"model_sd_{name}" for name in PARAMETERS)


@dataclass(frozen=True, slots=True)
class Learned:
    """The posterior of a method and its counters."""

    mean: Array  # [n]
    covariance: Array  # [n, n]
    counts: Mapping[str, float]  # name -> counter that continues in the next run
    soil: KeptSoil | None = None  # of the method place


def of_steady_state(state: SteadyState) -> Learned:
    """What this method has learned, from its state."""
    counts = {
        "steady_s": float(state.steady_s), "sideslip_s": float(state.sideslip_s),
        "largest_angle": float(state.largest_angle),
    }  # fmt: skip
    return Learned(state.x.copy(), state.P.copy(), counts)


def into_steady_state(state: SteadyState, learned: Learned) -> None:
    """Put what was learned into a fresh state."""
    state.x, state.P = learned.mean, learned.covariance
    state.steady_s = _counted(learned, "steady_s")
    state.sideslip_s = _counted(learned, "sideslip_s")
    state.largest_angle = _counted(learned, "largest_angle")  # errors of the model in sharp turns stay


def of_tracker(state: TrackerState) -> Learned:
    """What this method has learned, from its state."""
    counts = {
        "window_s": state.window_s, "tight_s": state.tight_s, "hard": state.hard, "distance": state.distance,
    }  # fmt: skip
    return Learned(state.mean.copy(), _with_excess(state.covariance, state.excess), counts)


def into_tracker(state: TrackerState, learned: Learned) -> None:
    """Put what was learned into a fresh state."""
    state.mean, state.covariance = learned.mean, with_known_masses(learned.covariance)
    state.window_s = _counted(learned, "window_s")
    state.tight_s = _counted(learned, "tight_s")  # what was learned in them stays as uncertain
    state.hard = _counted(learned, "hard")
    state.distance = _counted(learned, "distance")


def of_pem(state: PemState) -> Learned:
    """What this method has learned, from its state."""
    counts = {"fits": float(state.fits), "window_s": float(state.window_s)}
    found = excess(state)
    counts |= dict(zip(_MODEL_SDS, np.hypot(state.model_sd, found).tolist(), strict=True))
    return Learned(state.mean.copy(), _with_excess(drifted(state), found), counts)


def into_pem(state: PemState, learned: Learned) -> None:
    """Put what was learned into a fresh state."""
    state.mean, state.covariance = learned.mean, learned.covariance
    state.fits = int(_counted(learned, "fits"))
    state.window_s = _counted(learned, "window_s")
    # The covariance has them in it; taken for noise, they would average out in the windows to come.
    model_sd = np.array([max(_counted(learned, name), 0.0) for name in _MODEL_SDS])
    state.model_sd = np.minimum(model_sd, LEARNED.largest_share * np.sqrt(np.diag(learned.covariance)[SIX]))


def of_rows(state: RowsState) -> Learned:
    """What this method has learned, from its state."""
    counts = {"fits": float(state.fits), "window_s": float(state.window_s)}
    return Learned(state.mean.copy(), learned_covariance(state), counts)


def into_rows(state: RowsState, learned: Learned) -> None:
    """Put what was learned into a fresh state."""
    state.mean, state.covariance = learned.mean, learned.covariance
    state.before_mean, state.before_covariance = learned.mean.copy(), learned.covariance.copy()
    state.fits = int(_counted(learned, "fits"))
    state.window_s = state.before_s = _counted(learned, "window_s")


def of_place(state: PlaceState) -> Learned:
    """What this method has learned, from its state: all of it stands in `soil`."""
    soil = None
    if state.origin_deg is not None:
        windows = [replace(one, begin_ns=one.begin_ns - state.informed_ns) for one in state.windows]
        soil = KeptSoil(state.origin_deg, windows, list(state.way))
    prior = np.diag(state.prior_sd[SIX] ** 2)
    return Learned(state.prior_mean[SIX].copy(), prior, {"window_s": state.window_s}, soil)


def into_place(state: PlaceState, learned: Learned) -> None:
    """Put what was learned into a fresh state, whose `informed_ns` is known: of no pass of this run."""
    state.window_s = _counted(learned, "window_s")
    if learned.soil is not None:
        state.origin_deg, since_ns = learned.soil.origin_deg, state.informed_ns
        state.windows = [
            replace(one, passing=-1, begin_ns=one.begin_ns + since_ns) for one in learned.soil.windows
        ]
        last = max((point.passing for point in learned.soil.way), default=0)
        way = (replace(one, passing=one.passing - last - 1) for one in learned.soil.way)
        state.way = deque(way, PLACE.way)


def _with_excess(covariance: Array, excess: Array) -> Array:
    """With what the next run has to find again: sds of the six, (6,)."""
    wider = covariance.copy()
    wider[SIX, SIX] += np.diag(excess**2)
    return wider


def _counted(learned: Learned, name: str) -> float:
    """A counter of the run before; 0 if it is not finite."""
    count = learned.counts[name]
    return count if math.isfinite(count) else 0.0
