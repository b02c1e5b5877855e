"""Three cornering stiffnesses from steady driving, recursively.

In a steady turn the relaxation lengths drop out (Karkee 2009, section 3.6). Yaw rate and articulation alone
determine two combinations of the three stiffnesses, at any speed: rank 2. With the lateral velocity of the
tractor's CG as third output the rank is 3. The filter publishes the rank, and numbers only with rank 3.

States: the constants that the outputs depend on and that are not known exactly, with the uncertainties of the
machine file (`steady_outputs.CONSTANTS`); the data cannot separate most of them from stiffness. And the zero
error of either body's measured roll, and the slow heading error of either antenna pair from multipath.
Straight driving is a steady turn too: it shows the zero of the wheel angle and the misalignment of the pairs.

What uneven ground does to the outputs is learned from straight driving, where it is all that is left, and in
turns from how far one second differs from the next, since errors of the stiffnesses are the same in both.

The outputs are nearly linear in compliance 1/C, but the prior is normal in the logarithm. So the filter's
states are compliances, with a prior that is practically flat. The information of the data on them, a
quadratic form, is combined with the logarithmic prior when an estimate is due. With logarithms as states,
Jacobians taken far from the true values made the 95 % interval of C_af hold 84 % of true values drawn with an
sd of 0.5.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.filters import fit_covariance, unknowns
from tilth.estimator.filters.drift import retained_share
from tilth.estimator.filters.priors import PRIOR
from tilth.estimator.filters.rig_setup import slow_pair_sd
from tilth.estimator.filters.states import STATE
from tilth.estimator.filters.steady_outputs import CONSTANTS, INPUTS, largest_slip, linearised
from tilth.estimator.pose.aligner import ALIGNMENT
from tilth.estimator.record.record import Segment
from tilth.estimator.record.steady_driving import STEADY_DRIVING, Steadiness, SteadySample, observe
from tilth.estimator.results import advice
from tilth.estimator.results.advice import ADVICE
from tilth.estimator.results.method_state import MethodState, is_due, step_clock
from tilth.estimator.results.reporting import (
    OVER,
    REPORTING,
    age_s,
    condition_number,
    is_supported,
    log_sds_over_masses,
    nothing_yet,
    nuisance_sd,
    of_the_mass,
    parameter,
    per_mass,
    stale_reason,
)
from tilth.estimator.state_json import Shape
from tilth.estimator.ties import exceeds, within
from tilth.estimator.tuning import tuned
from tilth.schemas.flow import PARAMETERS, Estimate, EventKind, ParameterEstimate, Pose, Status
from tilth.schemas.machine import Machine
from tilth.schemas.notices import NoticeCode, notice
from tilth.schemas.reasons import Code, Reason

Array = NDArray[np.float64]

METHOD = "steady_state"
MODEL = "steady_turn"
STATES = (*CONSTANTS, "roll_zero_t", "roll_zero_i", "slow_t", "slow_i")
"""The first three as compliance over the prior mean's; the others as unknowns.NAMES, but the zero of roll is
the mean of a body's receivers; rad."""
OfStates = Annotated[Array, Shape((len(STATES),))]
OfThree = Annotated[Array, Shape((3,))]
ThreeByThree = Annotated[Array, Shape((3, 3))]
AT = {name: k for k, name in enumerate(STATES)}
PUBLISHED = ("wheel_zero", "wheel_gain", "pair_t", "pair_i", "rolling", "curvature")
SOIL = [AT["rolling"], AT["curvature"]]  # they differ with the soil too
STRAIGHT = [
    AT[name] for name in ("wheel_zero", "pair_t", "pair_i", "roll_zero_t", "roll_zero_i", "slow_t", "slow_i")
]
"""The states that are learned in straight driving."""
SLOW = [AT["slow_t"], AT["slow_i"]]


@dataclass(frozen=True, slots=True)
class SteadyStateTuning:
    """What steady turns teach."""

    least_angle: float = tuned(math.radians(1.0), "rad", "least wheel angle to learn stiffnesses")
    """Below it the Jacobian over stiffness consists mostly of noise of wheel angle and roll, and the squares
    of this noise would add up to false information."""
    wide_sd: float = tuned(3.0, "1", "prior sd of a compliance over its mean: flat beside the prior")
    largest_slip: float = tuned(math.radians(6.0), "rad", "of an axle: above, one number is no tyre curve")
    no_pair_sd: float = tuned(
        math.radians(2.0), "rad", "sd of the slow heading error of a body without a pair"
    )
    gate: Mapping[int, float] = tuned({2: 13.8, 3: 16.3}, "chi^2", "by number of outputs, 0.1 %: outliers")
    nis_memory: float = tuned(10.0, "samples", "over which NIS per output is averaged, 10 s")
    """NIS is the normalised innovation squared."""
    largest_nis: float = tuned(6.0, "1", "NIS that one sample adds to that mean at most")
    nis_limit: float = tuned(2.0, "1", "of the mean: above, soil or rig have changed")
    ground_sd: tuple[float, ...] = tuned(
        (0.004, 0.004, 0.02),
        "rad/s, rad, m/s",
        "sds of what uneven ground does to a sample of the outputs, before any driving",
    )
    largest_ground: float = tuned(5.0, "sd", "of an innovation in that average")
    ground_memory: tuple[float, ...] = tuned(
        (10.0, 100.0), "samples", "of that average, at first and at most"
    )
    newton_steps: int = tuned(50, "steps", "of the search for the maximum")
    longest_step: float = tuned(0.5, "1", "of a logarithm, in one of these")


STEADY_STATE: Final = SteadyStateTuning()


_RELAXATION = ParameterEstimate(None, None, Status.UNESTIMATED, Reason(Code.NO_RELAXATION))


@dataclass(slots=True)
class SteadyState(MethodState):
    """State of the filter. Times ns. P: covariance of x."""

    x: OfStates
    P: Annotated[Array, Shape((len(STATES), len(STATES)))]
    prior_sd: OfStates  # sd; of the first three that of their logarithm
    prior_logs: OfThree  # prior mean
    logs: OfThree  # natural logarithms of the stiffnesses, of data and prior
    log_covariance: ThreeByThree
    # covariance of what uneven ground does to a sample of the outputs, and samples that it is from
    ground: ThreeByThree = field(default_factory=lambda: np.diag(np.square(STEADY_STATE.ground_sd)))
    ground_samples: float = STEADY_STATE.ground_memory[0]
    steadiness: Steadiness = field(default_factory=Steadiness)
    previous: SteadySample | None = None  # the sample before, of the same turn
    last_pose_ns: int = 0
    steady_s: float = 0.0  # of turning, used
    sideslip_s: float = 0.0
    largest_angle: float = 0.0  # of the wheels, that stiffnesses were learned at, rad
    mean_nis: float = 1.0  # recent mean of the normalised innovation squared per output; 1 is as expected
    forgotten: int = 0  # times that the stiffnesses were reset
    supported: list[bool] = field(default_factory=lambda: [False] * 3)  # of each stiffness, with hysteresis


def initial(machine: Machine) -> SteadyState:
    """The state before any data, at the priors of the machine file."""
    mean, sd = unknowns.prior(machine)
    chosen = [unknowns.AT[name] for name in CONSTANTS]
    pairs = [slow_pair_sd(machine, body) for body in ("tractor", "implement")]
    slow = [STEADY_STATE.no_pair_sd if sd is None else sd for sd in pairs]
    prior_sd = np.concatenate(
        [sd[chosen], [_roll_zero_sd(machine, b) for b in ("tractor", "implement")], slow]
    )
    x = np.concatenate([np.ones(3), mean[chosen][3:], np.zeros(4)])
    P = np.diag(np.concatenate([np.full(3, STEADY_STATE.wide_sd), prior_sd[3:]]) ** 2)
    return SteadyState(x, P, prior_sd, mean[:3], mean[:3].copy(), np.diag(prior_sd[:3] ** 2))


def _roll_zero_sd(machine: Machine, body: str) -> float:
    """Sd of the mean zero error of the rolls that a body's receivers measure, rad."""
    n = sum(r.mount.body == body for r in machine.receiver)
    return PRIOR.roll_zero_sd / math.sqrt(n) if n else 0.0


def take(state: SteadyState, machine: Machine, pose: Pose, segment: Segment | None = None) -> Estimate | None:
    """Take one pose. Returns an estimate at its time. The segment, with the dynamics, is not used."""
    seconds = (pose.t_ns - state.last_pose_ns) * 1e-9 if state.last_pose_ns else math.inf
    state.last_pose_ns = pose.t_ns
    _drift(state, seconds, pose)
    length = machine.implement.d.value + machine.implement.e.value
    sample, state.reason = observe(state.steadiness, pose, seconds, length)
    if state.reason:
        state.previous = None
        state.refused[state.reason] = state.refused.get(state.reason, 0) + 1
    elif sample is not None and _update(state, machine, sample):
        state.informed_ns = pose.t_ns
    if not is_due(state, pose.t_ns, REPORTING.publish_ns):
        return None
    _find_posterior(state)
    _update_supported(state)
    return estimate(state, machine, pose.t_ns)


def stood(state: SteadyState) -> None:
    """As of estimators.Estimator: the present block ends."""
    state.steadiness, state.previous = Steadiness(), None


def clock_stepped(state: SteadyState, by_ns: int) -> None:
    """The log's clock stepped back: discard the present block, keep the posterior and its age."""
    stood(state)
    step_clock(state, by_ns)
    state.last_pose_ns = 0


def _drift(state: SteadyState, seconds: float, pose: Pose) -> None:
    """Propagate: Ornstein-Uhlenbeck drift of the soil over distance and of multipath over time."""
    seconds = min(seconds, 3600.0) if math.isfinite(seconds) else 0.0
    distance = seconds * abs(pose.tractor.forward_velocity or 0.0)
    retained_soil = retained_share(distance)
    retained = np.ones(len(STATES))
    retained[SOIL] = retained_soil
    retained[SLOW] = math.exp(-seconds / STATE.pair_memory_s)
    # The drift widens the sds of rolling resistance and tyre curve, but leaves their means.
    state.x[SLOW] *= retained[SLOW]
    added = (1 - retained**2) * state.prior_sd**2
    added[:3] = (1 - retained_soil**2) * (state.prior_sd[:3] * np.exp(state.prior_logs - state.logs)) ** 2
    state.P = state.P * np.outer(retained, retained) + np.diag(added)


def _update(state: SteadyState, machine: Machine, sample: SteadySample) -> bool:
    """One update. Returns whether stiffness was learned: not in straight driving, nor from an outlier."""
    zero = float(state.x[AT["wheel_zero"]])
    informative = exceeds(abs(sample.wheel_angle - zero), STEADY_STATE.least_angle)
    if exceeds(largest_slip(sample, zero, machine), STEADY_STATE.largest_slip):
        return _refuse(state, Code.SLIP_BEYOND_MODEL)
    try:
        off, H, noise = _innovation(state, machine, sample, informative)
        if not informative and sample.v is not None:
            _learn_ground(state, off, H @ state.P @ H.T + noise)
        elif informative and sample.v is not None and state.previous is not None:
            before, _, noise_before = _innovation(state, machine, state.previous, informative)
            _learn_ground(state, (off - before) / math.sqrt(2.0), (noise + noise_before) / 2.0)
    except np.linalg.LinAlgError:
        return _refuse(state, Code.NO_STEADY_TURN_EXISTS)
    state.previous = sample if informative and sample.v is not None else None
    noise = noise + state.ground
    rows = [0, 1] if sample.v is None else [0, 1, 2]
    innovation, H, noise = off[rows], H[rows], noise[np.ix_(rows, rows)]
    S = H @ state.P @ H.T + noise
    distance = float(innovation @ np.linalg.solve(S, innovation))
    if not math.isfinite(distance):
        return _refuse(state, Code.RESULT_NOT_FINITE)
    state.mean_nis += (
        min(distance / len(rows), STEADY_STATE.largest_nis) - state.mean_nis
    ) / STEADY_STATE.nis_memory
    if exceeds(state.mean_nis, STEADY_STATE.nis_limit):
        _reset_stiffness(state)
    if exceeds(distance, STEADY_STATE.gate[len(rows)]):
        return _refuse(state, Code.OUTLIER)
    state.x, state.P = kalman_update(state.x, state.P, innovation, H, noise)
    _find_posterior(state)
    if informative:
        state.largest_angle = max(state.largest_angle, abs(sample.wheel_angle - zero))
        state.steady_s += STEADY_DRIVING.block * ALIGNMENT.pose_ns * 1e-9
        state.sideslip_s += 0.0 if sample.v is None else STEADY_DRIVING.block * ALIGNMENT.pose_ns * 1e-9
    return informative


def _innovation(
    state: SteadyState, machine: Machine, sample: SteadySample, informative: bool
) -> tuple[Array, Array, Array]:
    """(measured less predicted [3], Jacobian over STATES [3, n], covariance of the white noise [3, 3])."""
    predicted, H, by_inputs = _linearise(state, machine, sample, informative)
    measured, noise = _measured(sample, by_inputs)
    return measured - predicted, H, noise


def _learn_ground(state: SteadyState, innovation: Array, expected: Array) -> None:
    """What innovations (3,) are beyond their expected covariance without ground, (3, 3), is the ground's."""
    if not np.all(np.isfinite(innovation)):
        return
    limit = STEADY_STATE.largest_ground * np.sqrt(np.diag(expected + state.ground))
    innovation = np.clip(innovation, -limit, limit)
    state.ground_samples = min(state.ground_samples + 1.0, STEADY_STATE.ground_memory[1])
    excess = np.outer(innovation, innovation) - expected
    values, vectors = np.linalg.eigh(state.ground + (excess - state.ground) / state.ground_samples)
    state.ground = np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T, np.float64)


def kalman_update(x: Array, P: Array, innovation: Array, H: Array, R: Array) -> tuple[Array, Array]:
    """Kalman update: (mean (n,), covariance (n, n)); the Joseph form keeps the covariance positive definite.

    innovation: (m,), measured minus predicted. H: (m, n), Jacobian. R: (m, m), covariance of the noise.
    """
    gain = np.linalg.solve(H @ P @ H.T + R, H @ P).T
    remaining = np.eye(len(x)) - gain @ H
    covariance = remaining @ P @ remaining.T + gain @ R @ gain.T
    return x + gain @ innovation, (covariance + covariance.T) / 2


def _refuse(state: SteadyState, reason: Code) -> bool:
    state.reason = reason
    state.refused[reason] = state.refused.get(reason, 0) + 1
    return False


def _reset_stiffness(state: SteadyState) -> None:
    """The posterior no longer explains the measurements: keep the means of the soil's states, reset their
    sds."""
    if state.steady_s > 0:
        anew = notice(NoticeCode.STIFFNESSES_ANEW, turning_s=state.steady_s)
        state.events.append((EventKind.SOIL_CHANGE, anew))
    changed = [0, 1, 2, *SOIL]
    state.P[changed, :] = 0.0
    state.P[:, changed] = 0.0
    state.P[changed, changed] = np.concatenate([np.full(3, STEADY_STATE.wide_sd), state.prior_sd[SOIL]]) ** 2
    state.mean_nis = 1.0
    state.steady_s = state.sideslip_s = state.largest_angle = 0.0
    state.forgotten += 1


def _linearise(
    state: SteadyState, machine: Machine, sample: SteadySample, informative: bool
) -> tuple[Array, Array, Array]:
    """(predicted outputs [3], Jacobian over STATES [3, n], and over steady_outputs.INPUTS [3, 5]).

    Linearised at the posterior logarithms, so that stiffnesses are positive.
    """
    n, x = len(CONSTANTS), state.x
    predicted, jacobian, by_inputs = linearised(np.concatenate([state.logs, x[3:n]]), sample, machine)
    compliance = np.exp(state.prior_logs - state.logs)
    H = np.zeros((3, len(STATES)))
    H[:, :n] = jacobian
    H[:, :3] = -jacobian[:, :3] / compliance
    if not informative:
        fixed = [k for k in range(n) if k not in STRAIGHT]
        H[:, fixed] = 0.0
    predicted = predicted + H[:, :3] @ (x[:3] - compliance)
    for pair in ("pair_t", "slow_t"):
        H[:, AT[pair]] = 0.0, 1.0, -sample.u  # a heading that is too large: more λ, less sideslip
    for pair in ("pair_i", "slow_i"):
        H[:, AT[pair]] = 0.0, -1.0, 0.0
    for body in ("t", "i"):
        H[:, AT[f"roll_zero_{body}"]] = -by_inputs[:, INPUTS.index(f"roll_{body}")]
    errors = [AT[f"{name}_{body}"] for name in ("pair", "slow", "roll_zero") for body in ("t", "i")]
    return predicted + H[:, errors] @ x[errors], H, by_inputs


def _measured(sample: SteadySample, by_inputs: Array) -> tuple[Array, Array]:
    """(measured [3], covariance of the white noise of innovations [3, 3]) in the order of OUTPUTS."""
    measured = np.array([sample.yaw_rate, sample.articulation, sample.v or 0.0])
    by_u, by_wheel, by_roll_t, by_roll_i, by_folding = by_inputs.T
    # The tractor's heading error acts on both articulation and lateral velocity, its yaw rate on the folding.
    noise = np.column_stack([
        (np.array([1.0, 0.0, 0.0]) - by_folding) * sample.sd_yaw_rate,
        by_folding * sample.sd_yaw_rate_i,
        np.array([0.0, 1.0, -sample.u]) * sample.sd_heading_t,
        np.array([0.0, -1.0, 0.0]) * sample.sd_heading_i,
        np.array([0.0, 0.0, 1.0]) * sample.sd_velocity,
        by_u * sample.sd_velocity, by_wheel * sample.sd_wheel_angle,
        by_roll_t * sample.sd_roll_t, by_roll_i * sample.sd_roll_i,
    ])  # fmt: skip
    return measured, noise @ noise.T


def _data_information(state: SteadyState) -> tuple[Array, Array]:
    """(information matrix [3, 3], information vector [3]) of the data alone on the three compliances."""
    inverse = np.linalg.inv(state.P[:3, :3])
    information = inverse - np.eye(3) / STEADY_STATE.wide_sd**2
    values, vectors = np.linalg.eigh((information + information.T) / 2)
    positive = vectors[:, values > 0]
    information = (positive * values[values > 0]) @ positive.T
    return information, positive @ (
        positive.T @ (inverse @ state.x[:3] - np.ones(3) / STEADY_STATE.wide_sd**2)
    )


def _find_posterior(state: SteadyState) -> None:
    """Set the most probable logarithms of stiffness and their covariance, from data and prior, by Newton's
    method."""
    information, vector = _data_information(state)
    weight = np.diag(state.prior_sd[:3] ** -2)

    def cost(at: Array) -> float:
        y, deviation = np.exp(state.prior_logs - at), at - state.prior_logs
        return float(y @ information @ y / 2 - vector @ y + deviation @ weight @ deviation / 2)

    at = state.logs
    for _ in range(STEADY_STATE.newton_steps):
        y = np.exp(state.prior_logs - at)
        gradient = -y * (information @ y - vector) + weight @ (at - state.prior_logs)
        hessian = np.outer(y, y) * information + weight
        step = np.linalg.solve(hessian, gradient)
        length = min(1.0, STEADY_STATE.longest_step / max(float(np.abs(step).max()), 1e-12))
        while cost(at - length * step) > cost(at) + 1e-12 and length > 1e-3:
            length /= 2
        at = at - length * step
        if float(np.abs(length * step).max()) < 1e-9:
            break
    y = np.exp(state.prior_logs - at)
    state.logs = at
    covariance = np.asarray(np.linalg.inv(np.outer(y, y) * information + weight), np.float64)
    # Errors of the model, as far as anything was learned.
    learned = np.maximum(1.0 - np.diag(covariance) / state.prior_sd[:3] ** 2, 0.0)
    tight = state.largest_angle > fit_covariance.FIT_COVARIANCE.tight
    room = np.square(
        fit_covariance.FIT_COVARIANCE.tight_sd[:3] if tight else fit_covariance.FIT_COVARIANCE.model_sd
    )
    state.log_covariance = covariance + np.diag(learned * room)


class Identifiability(NamedTuple):
    """What the data alone tell of the three logarithms."""

    information: Array  # (3, 3)
    values: Array  # (3,), its eigenvalues over the prior's

    def rank(self, supported: float = ADVICE.supported) -> int:
        """The number of directions whose sd is below that share of the prior's."""
        return int(np.sum(self.values > supported**-2 - 1.0))


def identifiability(state: SteadyState) -> Identifiability:
    """By the posterior that there is now."""
    scale = np.outer(state.prior_sd[:3], state.prior_sd[:3])
    information = advice.information_of(state.log_covariance, state.prior_sd[:3])
    return Identifiability(information, np.asarray(np.linalg.eigvalsh(information * scale), np.float64))


def _update_supported(state: SteadyState) -> None:
    """Update which stiffnesses the data support: begins at ADVICE.supported, ends at REPORTING.withdrawn."""
    of_data = identifiability(state)
    for k, was_supported in enumerate(state.supported):
        limit = REPORTING.withdrawn if was_supported else ADVICE.supported
        sd = math.sqrt(state.log_covariance[k, k])
        state.supported[k] = of_data.rank(limit) == 3 and within(sd, limit * float(state.prior_sd[k]))


def estimate(state: SteadyState, machine: Machine, t_ns: int) -> Estimate:
    """The estimate at t_ns."""
    of_data = identifiability(state)
    rank, information = of_data.rank(), of_data.information
    age = age_s(state.informed_ns, t_ns)
    told = age is not None and advice.is_read()
    bounds = advice.bound(information, state.prior_sd[:3]) if told else ()
    over_sds = _over_masses(state)
    over = [
        age is not None and rank == 3 and is_supported(had, sd, own)
        for had, sd, own in zip(state.supported, over_sds, state.prior_sd[:3].tolist(), strict=True)
    ]
    parameters = tuple(
        _parameter(
            state,
            k,
            rank,
            age,
            of_the_mass(k, math.sqrt(state.P[AT[OVER[k]], AT[OVER[k]]]), over_sds[k]) if over[k] else None,
        )
        for k in range(3)
    )
    masses = per_mass(machine, state.logs.tolist(), over_sds, over)
    prior_mean, prior_sd = unknowns.prior(machine)
    covariance = np.diag(prior_sd[unknowns.SIX] ** 2)
    covariance[:3, :3] = state.log_covariance
    return Estimate(
        t_ns=t_ns,
        method=METHOD,
        model=MODEL,
        parameters=(*parameters, _RELAXATION, _RELAXATION, _RELAXATION),
        log_covariance=tuple(covariance.ravel().tolist()),
        per_mass=masses.values,
        per_mass_sd=masses.sds,
        nuisances={
            name: (
                float(state.x[AT[name]]),
                nuisance_sd(
                    name,
                    state.P[AT[name], AT[name]],
                    prior_sd[unknowns.AT[name]],
                    float(state.x[AT[name]] - prior_mean[unknowns.AT[name]]),
                ),
            )
            for name in PUBLISHED
        },
        rank=rank,
        condition=condition_number(of_data.values),
        excitation={"steady_s": state.steady_s, "sideslip_s": state.sideslip_s, "forgotten": state.forgotten},
        window_s=state.steady_s,
        determined=advice.determined(information, state.prior_sd[:3]) if told else (),
        bound=(*(math.inf if sd is None else sd for sd in bounds), *[math.inf] * 3) if told else (),
    )


def _over_masses(state: SteadyState) -> list[float]:
    """Sds of the logarithms over the masses. The first states are compliances: they err the other way."""
    masses = [AT[name] for name in OVER]
    together = -state.P[range(3), masses] * np.exp(state.logs - state.prior_logs)
    return log_sds_over_masses(state.log_covariance, (2.0 * together - np.diag(state.P)[masses]).tolist())


def _parameter(
    state: SteadyState, k: int, rank: int, age: float | None, of_mass: Reason | None
) -> ParameterEstimate:
    """One stiffness, with a number only if the data support it. of_mass: why not, where it is the mass."""
    missing = of_mass or _missing(state, rank)
    if age is None:
        missing = nothing_yet(Code.NO_STEADY_TURN_YET, state.reason)
    stale = stale_reason(Code.NO_STEADY_DRIVING_FOR, age)
    sd_log = math.sqrt(state.log_covariance[k, k])
    return parameter(state.logs[k], sd_log, state.supported[k], age, missing, stale)


def _missing(state: SteadyState, rank: int) -> Reason:
    without_sideslip = rank < 3 and state.sideslip_s == 0
    return Reason(Code.RANK_WITHOUT_SIDESLIP if without_sideslip else Code.RANK, numbers=(float(rank),))


assert PARAMETERS[:3] == STATES[:3]
