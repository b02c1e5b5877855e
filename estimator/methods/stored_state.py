"""The state of each method in the snapshot: one function writes it, one reads it back.

The names of the parts are those in the log; they stay when an attribute is renamed. If a part is added or
gets another meaning, raise `VERSION` of estimator/snapshot.py too. Reading raises ValueError if a part is
missing, has another type or shape, or is unknown.
"""

from typing import Any, Final

from tilth.estimator.filters.soil_change import Checkpoint
from tilth.estimator.filters.states import N_STATES
from tilth.estimator.filters.tracker_kernel import SENSORS
from tilth.estimator.filters.unknowns import NAMES
from tilth.estimator.methods import pem, two_step
from tilth.estimator.methods.consistency import Consistency, Finding
from tilth.estimator.methods.pem import PemState
from tilth.estimator.methods.steady_state import STATES, SteadyState
from tilth.estimator.methods.tracker import TrackerState
from tilth.estimator.methods.two_step import TwoStepState
from tilth.estimator.pose.motion_check import MotionCheck
from tilth.estimator.pose.wheel_check import WheelCheck
from tilth.estimator.record.record import INPUTS, Record, Segment
from tilth.estimator.record.steady_driving import Steadiness, SteadySample
from tilth.estimator.results.advice import Advisor
from tilth.estimator.state_json import Stored, to_json_data

Json = dict[str, Any]

N: Final = len(NAMES)


def steady_state_json(state: SteadyState) -> Json:
    """The state as JSON data."""
    return {
        "mean": to_json_data(state.x),
        "covariance": to_json_data(state.P),
        "prior_sd": to_json_data(state.prior_sd),
        "prior_logs": to_json_data(state.prior_logs),
        "logs": to_json_data(state.logs),
        "log_covariance": to_json_data(state.log_covariance),
        "ground": to_json_data(state.ground),
        "ground_samples": to_json_data(state.ground_samples),
        "steadiness": to_json_data(state.steadiness),
        "previous": to_json_data(state.previous),
        "seen_ns": state.last_pose_ns,
        "informed_ns": state.informed_ns,
        "published_ns": state.published_ns,
        "steady_s": to_json_data(state.steady_s),
        "sideslip_s": to_json_data(state.sideslip_s),
        "largest_angle": to_json_data(state.largest_angle),
        "surprise": to_json_data(state.mean_nis),
        "forgotten": state.forgotten,
        "refused": dict(state.refused),
        "reason": state.reason,
        "supported": to_json_data(state.supported),
        "events": to_json_data(state.events),
    }


def steady_state_of(raw: Any) -> SteadyState:
    """The state that `steady_state_json` wrote. Raises ValueError."""
    stored, n = Stored(raw, "the state of steady_state"), len(STATES)
    state = SteadyState(
        x=stored.array("mean", n),
        P=stored.array("covariance", n, n),
        prior_sd=stored.array("prior_sd", n),
        prior_logs=stored.array("prior_logs", 3),
        logs=stored.array("logs", 3),
        log_covariance=stored.array("log_covariance", 3, 3),
        ground=stored.array("ground", 3, 3),
        ground_samples=stored.value(float, "ground_samples"),
        steadiness=stored.value(Steadiness, "steadiness"),
        previous=stored.optional(SteadySample, "previous"),
        last_pose_ns=stored.value(int, "seen_ns"),
        informed_ns=stored.value(int, "informed_ns"),
        published_ns=stored.value(int, "published_ns"),
        steady_s=stored.value(float, "steady_s"),
        sideslip_s=stored.value(float, "sideslip_s"),
        largest_angle=stored.value(float, "largest_angle"),
        mean_nis=stored.value(float, "surprise"),
        forgotten=stored.value(int, "forgotten"),
        refused=stored.value(dict[str, int], "refused"),
        reason=stored.value(str, "reason"),
        supported=stored.value(list[bool], "supported"),
        events=stored.value(list[tuple[str, str]], "events"),
    )
    stored.end()
    return state


def tracker_json(state: TrackerState) -> Json:
    """The state as JSON data."""
    return {
        "mean": to_json_data(state.mean),
        "covariance": to_json_data(state.covariance),
        "prior_mean": to_json_data(state.prior_mean),
        "prior_sd": to_json_data(state.prior_sd),
        "motion": to_json_data(state.x),
        "steered_motion": to_json_data(state.steered),
        "motion_covariance": to_json_data(state.P_xx),
        "cross_covariance": to_json_data(state.P_xtheta),
        "noise_ratios": to_json_data(state.residual_ratio),
        "adapted": state.segments_adapted,
        "push_variances": to_json_data(state.push),
        "running": to_json_data(state.running),
        "since": state.segments_since_start,
        "waiting": to_json_data(state.pending),
        "ticks_before": to_json_data(state.ticks_before),
        "steering": to_json_data(state.steering),
        "held_at": to_json_data(state.held_at),
        "held": state.held,
        "marks": to_json_data(state.checkpoints),
        "marks_after": state.segments_since_checkpoint,
        "counts": to_json_data(state.counts),
        "distance": to_json_data(state.distance),
        "tight_s": to_json_data(state.tight_s),
        "hard": to_json_data(state.hard),
        "window_s": to_json_data(state.window_s),
        "seen_ns": state.last_pose_ns,
        "informed_ns": state.informed_ns,
        "published_ns": state.published_ns,
        "changed_ns": state.changed_ns,
        "changes": state.changes,
        "restarts": state.restarts,
        "refused": dict(state.refused),
        "supported": to_json_data(state.has_number),
        "advisor": to_json_data(state.advisor),
        "reason": state.reason,
        "events": to_json_data(state.events),
        "considered": to_json_data(state.considered),
        "steered": to_json_data(state.needs_steering),
        "by_steering": state.by_steering,
    }


def tracker_of(raw: Any) -> TrackerState:
    """The state that `tracker_json` wrote. Raises ValueError."""
    stored = Stored(raw, "the state of tracker")
    state = TrackerState(
        mean=stored.array("mean", N),
        covariance=stored.array("covariance", N, N),
        prior_mean=stored.array("prior_mean", N),
        prior_sd=stored.array("prior_sd", N),
        x=stored.array("motion", N_STATES),
        steered=stored.array("steered_motion", N_STATES),
        P_xx=stored.array("motion_covariance", N_STATES, N_STATES),
        P_xtheta=stored.array("cross_covariance", N_STATES, N),
        residual_ratio=stored.array("noise_ratios", SENSORS),
        segments_adapted=stored.value(int, "adapted"),
        push=stored.array("push_variances", 4),
        running=stored.value(bool, "running"),
        segments_since_start=stored.value(int, "since"),
        pending=stored.optional(Record, "waiting"),
        ticks_before=stored.array("ticks_before", -1, len(INPUTS)),
        steering=stored.value(float, "steering"),
        held_at=stored.value(float, "held_at"),
        held=stored.value(int, "held"),
        checkpoints=stored.value(list[Checkpoint], "marks"),
        segments_since_checkpoint=stored.value(int, "marks_after"),
        counts=stored.array("counts", 3),
        distance=stored.value(float, "distance"),
        tight_s=stored.value(float, "tight_s"),
        hard=stored.value(float, "hard"),
        window_s=stored.value(float, "window_s"),
        last_pose_ns=stored.value(int, "seen_ns"),
        informed_ns=stored.value(int, "informed_ns"),
        published_ns=stored.value(int, "published_ns"),
        changed_ns=stored.value(int, "changed_ns"),
        changes=stored.value(int, "changes"),
        restarts=stored.value(int, "restarts"),
        refused=stored.value(dict[str, int], "refused"),
        has_number=stored.value(list[bool], "supported"),
        advisor=stored.value(Advisor, "advisor"),
        reason=stored.value(str, "reason"),
        events=stored.value(list[tuple[str, str]], "events"),
        considered=stored.value(list[int], "considered"),
        needs_steering=stored.value(list[int], "steered"),
        by_steering=stored.value(bool, "by_steering"),
    )
    stored.end()
    return state


def pem_json(state: PemState) -> Json:
    """The state as JSON data."""
    return {
        "mean": to_json_data(state.mean),
        "covariance": to_json_data(state.covariance),
        "prior_mean": to_json_data(state.prior_mean),
        "prior_sd": to_json_data(state.prior_sd),
        "model_sd": to_json_data(state.model_sd),
        "window": to_json_data(state.window),
        "closed": to_json_data(state.closed),
        "job": to_json_data(state.job),
        "decided": to_json_data(state.decided),
        "late_ns": state.late_ns,
        "distance": to_json_data(state.distance),
        "seen_ns": state.last_pose_ns,
        "informed_ns": state.informed_ns,
        "sound_ns": state.sound_ns,
        "published_ns": state.published_ns,
        "window_s": to_json_data(state.window_s),
        "fits": state.fits,
        "late": state.late,
        "changes": state.changes,
        "refused": dict(state.refused),
        "supported": to_json_data(state.has_number),
        "last": to_json_data(state.last),
        "advisor": to_json_data(state.advisor),
        "reason": state.reason,
        "events": to_json_data(state.events),
    }


def pem_of(raw: Any) -> PemState:
    """The state that `pem_json` wrote. Raises ValueError."""
    stored = Stored(raw, "the state of pem")
    state = PemState(
        mean=stored.array("mean", N),
        covariance=stored.array("covariance", N, N),
        prior_mean=stored.array("prior_mean", N),
        prior_sd=stored.array("prior_sd", N),
        model_sd=stored.array("model_sd", 6),
        window=stored.value(list[Segment], "window"),
        closed=stored.optional(Record, "closed"),
        job=stored.optional(pem.Job, "job"),
        decided=stored.value(int, "decided"),
        late_ns=stored.value(int, "late_ns"),
        distance=stored.value(float, "distance"),
        last_pose_ns=stored.value(int, "seen_ns"),
        informed_ns=stored.value(int, "informed_ns"),
        sound_ns=stored.value(int, "sound_ns"),
        published_ns=stored.value(int, "published_ns"),
        window_s=stored.value(float, "window_s"),
        fits=stored.value(int, "fits"),
        late=stored.value(int, "late"),
        changes=stored.value(int, "changes"),
        refused=stored.value(dict[str, int], "refused"),
        has_number=stored.value(list[bool], "supported"),
        last=stored.optional(pem.Fit, "last"),
        advisor=stored.value(Advisor, "advisor"),
        reason=stored.value(str, "reason"),
        events=stored.value(list[tuple[str, str]], "events"),
    )
    stored.end()
    return state


def two_step_json(state: TwoStepState) -> Json:
    """The state as JSON data."""
    return {
        "window": to_json_data(state.window),
        "closed": to_json_data(state.closed),
        "job": to_json_data(state.job),
        "decided": to_json_data(state.decided),
        "late_ns": state.late_ns,
        "values": to_json_data(state.values),
        "sds": to_json_data(state.sds),
        "runs": to_json_data(state.runs),
        "rank": to_json_data(state.rank),
        "window_s": to_json_data(state.window_s),
        "informed_ns": state.informed_ns,
        "published_ns": state.published_ns,
        "late": state.late,
        "refused": dict(state.refused),
        "reason": state.reason,
        "nothing": state.failure,
        "events": to_json_data(state.events),
    }


def two_step_of(raw: Any) -> TwoStepState:
    """The state that `two_step_json` wrote. Raises ValueError."""
    stored = Stored(raw, "the state of pem_two_step")
    state = TwoStepState(
        window=stored.value(list[Segment], "window"),
        closed=stored.optional(Record, "closed"),
        job=stored.optional(two_step.Job, "job"),
        decided=stored.value(int, "decided"),
        late_ns=stored.value(int, "late_ns"),
        values=stored.array("values", 6),
        sds=stored.array("sds", 6),
        runs=stored.array("runs", 6),
        rank=stored.value(int, "rank"),
        window_s=stored.value(float, "window_s"),
        informed_ns=stored.value(int, "informed_ns"),
        published_ns=stored.value(int, "published_ns"),
        late=stored.value(int, "late"),
        refused=stored.value(dict[str, int], "refused"),
        reason=stored.value(str, "reason"),
        failure=stored.value(str, "nothing"),
        events=stored.value(list[tuple[str, str]], "events"),
    )
    stored.end()
    return state


def consistency_json(state: Consistency) -> Json:
    """The state as JSON data."""
    return {
        "open_tracker": tracker_json(state.open),
        "wheel": to_json_data(state.wheel),
        "motion": to_json_data(state.motion),
        "findings": to_json_data(state.findings),
        "confirmed": to_json_data(state.confirmed),
        "was_confirmed": to_json_data(state.was_confirmed),
        "pairs_known": to_json_data(state.pairs_known),
        "lacks": state.missing,
        "agreed": state.agreed,
        "rates_known": to_json_data(state.rates_known),
        "rows": to_json_data(state.rows),
        "learned": state.learned,
        "methods": to_json_data(state.methods),
        "accused": to_json_data(state.open_restarted),
        "forgets": to_json_data(state.must_forget),
    }


def consistency_of(raw: Any) -> Consistency:
    """The state that `consistency_json` wrote. Raises ValueError."""
    stored = Stored(raw, "the state of consistency")
    state = Consistency(
        open=tracker_of(stored.raw("open_tracker")),
        wheel=stored.value(WheelCheck, "wheel"),
        motion=stored.value(MotionCheck, "motion"),
        findings=stored.value(dict[str, Finding], "findings"),
        confirmed=stored.value(bool, "confirmed"),
        was_confirmed=stored.value(bool, "was_confirmed"),
        pairs_known=stored.value(bool, "pairs_known"),
        missing=stored.value(str, "lacks"),
        agreed=stored.value(int, "agreed"),
        rates_known=stored.value(bool, "rates_known"),
        rows=stored.value(list[tuple[float, float]], "rows"),
        learned=stored.value(int, "learned"),
        methods=stored.value(dict[str, dict[str, str]], "methods"),
        open_restarted=stored.value(bool, "accused"),
        must_forget=stored.value(bool, "forgets"),
    )
    stored.end()
    return state
