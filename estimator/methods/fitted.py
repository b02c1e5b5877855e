"""What methods have in common whose fits are computed outside the fold (pem, rows): from the request to the
adoption, and how old what they tell is."""

import math
from dataclasses import KW_ONLY, dataclass, field
from typing import Annotated, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.record.record import Segment
from tilth.estimator.record.record_builder import WAYS_OF_DRIVING
from tilth.estimator.record.windows import OPEN, late_reason, refuse
from tilth.estimator.results.method_state import SixState, step_clock
from tilth.estimator.results.reporting import age_s, stale_reason
from tilth.estimator.state_json import Shape
from tilth.estimator.tuning import tuned
from tilth.schemas.flow import EventKind, Pose
from tilth.schemas.notices import reasoned
from tilth.schemas.reasons import Code, Reason


@dataclass(frozen=True, slots=True)
class FittedTuning:
    """By how much the results of one job differ between two kinds of processor."""

    ends: float = tuned(0.1, "sd", "of the six, apart at most: so near its maximum a search may end")
    """As `SearchTuning.settled_step`. The largest seen is 0.065, of sigma_i on a drive that tells little."""
    other_ends: float = tuned(1.0, "sd", "of all else: a search ends where the six have settled")
    """As `NewtonTuning.same_place`. The largest seen is 0.66, of a noise level, with the six within 0.025."""
    near: float = tuned(0.05, "1", "of a threshold: a statistic that such ends may take to its other side")


FITTED: Final = FittedTuning()


class Fit(Protocol):
    """The result of a job."""

    @property
    def mean(self) -> NDArray[np.float64]: ...  # [n] of unknowns.NAMES
    @property
    def covariance(self) -> NDArray[np.float64]: ...  # [n, n]
    @property
    def changed(self) -> bool: ...  # whether its data contradict what was known
    @property
    def tie(self) -> bool: ...  # whether another kind of computer may decide otherwise
    @property
    def refused(self) -> Code | None: ...  # why it must not be used
    @property
    def cost(self) -> float: ...


def is_tie(*pairs: tuple[float, float]) -> bool:
    """Whether any of (statistic, threshold) is so near that another computer may decide otherwise."""
    return any(abs(value - limit) <= FITTED.near * limit for value, limit in pairs)


def apart(one: Fit, other: Fit) -> float:
    """By how many sds the six of one job differ that two kinds of processor have computed, or all else by
    that share of what it may; infinitely where they decide otherwise, but FITTED.ends where that is a tie."""
    if (one.changed, one.refused) != (other.changed, other.refused):
        return FITTED.ends if one.tie or other.tie else math.inf
    sds, others = (np.sqrt(np.diag(fit.covariance)) for fit in (one, other))
    known = np.where(sds > 0.0, sds, 1.0)
    far = np.maximum(np.abs(one.mean - other.mean), np.abs(sds - others)) / known
    far[6:] *= FITTED.ends / FITTED.other_ends
    return float(np.max(far)) if np.all(np.isfinite(far)) else math.inf


@dataclass(slots=True)
class FittedState(SixState):
    """Besides `job`, the requested fit that is not adopted yet, and `last`, the last one's result."""

    _: KW_ONLY
    model_sd: Annotated[NDArray[np.float64], Shape((6,))] = field(default_factory=lambda: np.zeros(6))
    """Of the six, what errors of the model leave in `mean` and more data do not take away."""
    decided: int = OPEN  # state of the job: see windows.OPEN
    late_ns: int = 0  # by how much the last decided fit was late
    sound_ns: int = 0  # until when data have been sound, without a silence of STALE_S since the last fit
    fits: int = 0
    late: int = 0
    stops: int = 0  # after which the load may be another, so that what was collected ended


def drive_on(state: FittedState, pose: Pose, segment: Segment | None) -> float:
    """Take the pose that ends a segment; distance to it, m."""
    seconds = (pose.t_ns - state.last_pose_ns) * 1e-9 if state.last_pose_ns else 0.0
    state.last_pose_ns = pose.t_ns
    metres = min(seconds, 3600.0) * abs(pose.tractor.forward_velocity or 0.0)
    state.distance += metres
    if segment is not None and segment.reason in WAYS_OF_DRIVING and stale(state, pose.t_ns) is None:
        state.sound_ns = pose.t_ns
    return metres


def stale(state: FittedState, t_ns: int) -> Reason | None:
    """Why numbers are stale."""
    return stale_reason(Code.NO_SOUND_DATA_FOR, age_s(max(state.informed_ns, state.sound_ns), t_ns))


def is_used(state: FittedState, made: Fit | None) -> bool:
    """Decide about the result of the job, None if there is none: count and tell of one that is late or
    refused. Whether it is to be learned from."""
    state.decided = OPEN
    if made is None or state.late_ns:
        state.late += 1
        state.events.append((EventKind.FIT, reasoned(late_reason(state.late_ns, made is not None))))
    if made is not None and made.refused:
        refuse(state, made.refused)
        state.events.append((EventKind.FIT, reasoned(Reason(made.refused))))
    return made is not None and not made.refused


def excitation(
    state: FittedState, own: dict[str, float], last: Fit | None, iterations: int
) -> dict[str, float]:
    """As of an estimate. own: what a method tells besides."""
    told = {
        "fits": float(state.fits), "late": float(state.late), "soil_changes": float(state.changes),
        "stops": float(state.stops), **own,
        "cost": last.cost if last else 0.0, "iterations": float(iterations),
    }  # fmt: skip
    return told | ({"late_s": state.late_ns * 1e-9} if state.late_ns else {})


def clock_stepped(state: FittedState, by_ns: int) -> None:
    """The log's clock stepped back: discard the pending fit, keep the posterior and its age."""
    step_clock(state, by_ns)
    state.decided, state.last_pose_ns = OPEN, 0
    state.sound_ns += by_ns if state.sound_ns else 0
