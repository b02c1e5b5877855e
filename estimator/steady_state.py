"""Three cornering stiffnesses from steady driving, recursively.

In a steady turn the relaxation lengths drop out (Karkee 2009, section 3.6). Yaw rate and articulation alone
carry two numbers about three stiffnesses, at any speed: rank 2. With the lateral velocity of the tractor's CG
as third output the rank is 3. This filter says which of the two it is before it says a number.

States: natural logarithms of the three stiffnesses; zero error of the wheel angle; heading error of either
antenna pair, which is its misalignment and its multipath; logarithms of both masses, which data cannot tell
from stiffness and which therefore carry the machine file's uncertainty into it. Straight driving is a steady
turn too, and the one that tells zero and misalignment. Last, rolling resistance over load, which the model
needs and nobody knows.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from filterpy.kalman import update
from numpy.typing import NDArray

from tilth.estimator.aligner import POSE_NS
from tilth.estimator.models.steady_turn import steady_turn
from tilth.estimator.steady_driving import BLOCK, Sample, Steadiness, observe
from tilth.schemas.flow import PARAMETERS, Estimate, ParameterEstimate, Pose, Status
from tilth.schemas.machine import Machine, Tyre

Array = NDArray[np.float64]

METHOD = "steady_state"
MODEL = "steady_turn"
STATES = (
    "C_af",
    "C_ar",
    "C_ai",
    "wheel_zero",
    "pair_tractor",
    "pair_implement",
    "mass_t",
    "mass_i",
    "rolling",
)
OUTPUTS = ("yaw_rate", "articulation", "lateral_velocity")

NUISANCES = (3, 4, 5, 8)  # indices of STATES that are published as such
ROLLING = (0.04, 0.03)  # resistance over load and its sd: 0.01 on a road, 0.1 on tilled soil
TEACHING_ANGLE = math.radians(1.0)
"""Of the wheels: below, the outputs' slope over stiffness is mostly the noise of wheel angle and roll, and
squares of noise would add up to information that nobody received."""
CORRELATED_SHARE = 0.4  # of a position's sd that stays for PAIR_MEMORY and does not cancel in a pair
PAIR_MEMORY_S = 20.0
DRIFT_M = 50_000.0  # distance over which the soil forgets itself
STEP = 1e-4  # of the central differences
GATE = {2: 13.8, 3: 16.3}  # chi-square of so many outputs, 0.1 %
SURPRISE_MEMORY = 10.0  # samples, 10 s
LARGEST_SURPRISE = 6.0  # that one sample may count for
SURPRISED = 2.0  # beyond: the soil is another, or the rig is
SUPPORTED = 0.5  # posterior over prior sd of the logarithm: above, the data do not support a number
RANK_GAIN = 3.0  # information over prior information, for a direction to count as determined
STALE_S = 300.0
PUBLISH_NS = 1_000_000_000

_RELAXATION = ParameterEstimate(
    None, None, Status.UNESTIMATED, "steady driving carries no relaxation-length information"
)


@dataclass(slots=True)
class SteadyState:
    """State of the filter. Angles rad, times ns."""

    x: Array  # [9] in the order of STATES
    p: Array  # [9, 9]
    prior: Array  # [9] sd
    steadiness: Steadiness = field(default_factory=Steadiness)
    seen_ns: int = 0
    informed_ns: int = 0
    published_ns: int = 0
    steady_s: float = 0.0  # of turning, used
    sideslip_s: float = 0.0
    surprise: float = 1.0  # recent mean of the squared, normalised innovation per output; 1 is as expected
    forgotten: int = 0  # times that learning began anew
    refused: dict[str, int] = field(default_factory=dict)  # reason -> poses
    reason: str = ""  # why the latest pose taught nothing


def initial(machine: Machine) -> SteadyState:
    """At the machine file's priors."""
    tyres = _tyres(machine)
    mean = [math.log(t.cornering_stiffness) for t in tyres]
    sd = [t.log_sd for t in tyres]
    pairs = [_pair_sd(machine, body) for body in ("tractor", "implement")]
    masses = (machine.tractor.mass, machine.implement.mass)
    prior = np.array(
        [
            *sd,
            math.radians(machine.wheel_angle.zero.sd),
            *pairs,
            *(max(m.sd / m.value, 1e-4) for m in masses),
            ROLLING[1],
        ]
    )
    x = np.array([*mean, 0.0, 0.0, 0.0, *(math.log(m.value) for m in masses), ROLLING[0]])
    return SteadyState(x, np.diag(prior**2), prior)


def _pair_sd(machine: Machine, body: str) -> float:
    """Sd of a pair's heading error that lasts, rad: slow multipath over the baseline."""
    pair = [r for r in machine.receiver if r.mount.value.startswith(body)]
    if len(pair) < 2:
        return math.radians(2.0)
    length = math.dist(pair[0].position[:2], pair[1].position[:2])
    return CORRELATED_SHARE * math.hypot(*(r.position_sd for r in pair)) / length


def take(state: SteadyState, machine: Machine, pose: Pose) -> Estimate | None:
    """Take one pose; an estimate each PUBLISH_NS."""
    seconds = (pose.t_ns - state.seen_ns) * 1e-9 if state.seen_ns else math.inf
    state.seen_ns = pose.t_ns
    _drift(state, seconds, pose)
    length = machine.implement.d.value + machine.implement.e.value
    sample, state.reason = observe(state.steadiness, pose, seconds, length)
    if state.reason:
        state.refused[state.reason] = state.refused.get(state.reason, 0) + 1
    elif sample is not None and _learn(state, machine, sample):
        state.informed_ns = pose.t_ns
    if pose.t_ns - state.published_ns < PUBLISH_NS:
        return None
    state.published_ns = pose.t_ns
    return estimate(state, machine, pose.t_ns)


def clock_stepped(state: SteadyState, by_ns: int) -> None:
    """Time ran back: forget what was going on, keep what was learned and how old it is."""
    state.steadiness = Steadiness()
    state.seen_ns = state.published_ns = 0
    state.informed_ns += by_ns if state.informed_ns else 0


def _drift(state: SteadyState, seconds: float, pose: Pose) -> None:
    """Ornstein-Uhlenbeck drift: stiffness over distance, pair errors over time, both towards the prior."""
    seconds = min(seconds, 3600.0) if math.isfinite(seconds) else 0.0
    distance = seconds * abs(pose.tractor.forward_velocity or 0.0)
    keep = np.ones(len(STATES))
    keep[:3] = math.exp(-distance / DRIFT_M)
    keep[4:6] = math.exp(-seconds / PAIR_MEMORY_S)
    # Stiffness forgets what it knew, not where it stood: only its covariance returns to the prior.
    state.x[4:6] *= keep[4:6]
    state.p = state.p * np.outer(keep, keep) + np.diag((1 - keep**2) * state.prior**2)


def _learn(state: SteadyState, machine: Machine, sample: Sample) -> bool:
    """One update. Whether it taught of stiffness: not straight driving, nor outputs too far from expected."""
    teaches = abs(sample.wheel_angle - state.x[3]) > TEACHING_ANGLE
    try:
        predicted, slope, spread = _linearise(state.x, machine, sample, teaches)
    except np.linalg.LinAlgError:
        return _refuse(state, "no steady turn exists at these stiffnesses")
    measured, noise = _outputs(sample, spread)
    rows = [0, 1] if sample.v is None else [0, 1, 2]
    innovation, slope, noise = (measured - predicted)[rows], slope[rows], noise[np.ix_(rows, rows)]
    expected = slope @ state.p @ slope.T + noise
    distance = float(innovation @ np.linalg.solve(expected, innovation))
    if not math.isfinite(distance):
        return _refuse(state, "not a number")
    state.surprise += (min(distance / len(rows), LARGEST_SURPRISE) - state.surprise) / SURPRISE_MEMORY
    if state.surprise > SURPRISED:
        _forget(state)
    if distance > GATE[len(rows)]:
        return _refuse(state, "outlier")
    x, p = update(state.x, state.p, innovation + slope @ state.x, noise, slope)[:2]
    state.x, state.p = x, (p + p.T) / 2
    if teaches:
        state.steady_s += BLOCK * POSE_NS * 1e-9
        state.sideslip_s += 0.0 if sample.v is None else BLOCK * POSE_NS * 1e-9
    return bool(teaches)


def _refuse(state: SteadyState, reason: str) -> bool:
    state.reason = reason
    state.refused[reason] = state.refused.get(reason, 0) + 1
    return False


def _forget(state: SteadyState) -> None:
    """What was learned no longer explains what is seen: keep the values, give up the confidence in them."""
    state.p[:3, :] = 0.0
    state.p[:, :3] = 0.0
    state.p[:3, :3] = np.diag(state.prior[:3] ** 2)
    state.surprise = 1.0
    state.steady_s = state.sideslip_s = 0.0
    state.forgotten += 1


def _linearise(x: Array, machine: Machine, sample: Sample, teaches: bool) -> tuple[Array, Array, Array]:
    """(outputs [3], their slope over STATES [3, 9], their covariance from noisy inputs [3, 3])."""
    inputs = (sample.u, sample.wheel_angle - x[3], sample.roll_t, sample.roll_i)
    point = np.array([*np.exp(x[:3]), *np.exp(x[6:8]), *inputs, x[8]])
    nudges = np.diag([*point[:5] * STEP, STEP, STEP, STEP, STEP, STEP])  # of logarithms; m/s, rad, 1
    t, i = machine.tractor, machine.implement
    geometry = (t.a.value, t.b.value, t.c.value, i.d.value, i.e.value)
    rows = np.vstack([point, point + nudges, point - nudges])
    heights = (t.cg_height.value, i.cg_height.value)
    z = steady_turn(rows[:, :9], *geometry, rolling=rows[:, 9], heights=heights)[:, [1, 2, 0]]
    gradient = (z[1:11] - z[11:21]).T / (2 * STEP)  # [3, 10]: steady_turn.INPUTS, rolling
    slope = np.zeros((3, len(STATES)))
    if teaches:
        slope[:, :3] = gradient[:, :3]
        slope[:, 6:8] = gradient[:, 3:5]
        slope[:, 8] = gradient[:, 9]
    slope[:, 3] = -gradient[:, 6]
    slope[:, 4] = 0.0, 1.0, -sample.u  # a pair that shows too large a heading: more λ, less sideslip
    slope[:, 5] = 0.0, -1.0, 0.0
    predicted = z[0] + slope[:, 4:6] @ x[4:6]
    sd = (sample.sd_velocity, sample.sd_wheel_angle, sample.sd_roll_t, sample.sd_roll_i)
    driven = gradient[:, 5:9] * np.array(sd)
    return predicted, slope, driven @ driven.T


def _outputs(sample: Sample, spread: Array) -> tuple[Array, Array]:
    """(measured [3], white noise covariance [3, 3]) in the order of OUTPUTS."""
    measured = np.array([sample.yaw_rate, sample.articulation, sample.v or 0.0])
    # One heading error enters both articulation and lateral velocity.
    mixing = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, -1.0, 0.0], [0.0, -sample.u, 0.0, 1.0]])
    sd = (sample.sd_yaw_rate, sample.sd_heading_t, sample.sd_heading_i, sample.sd_velocity)
    noise = mixing * np.array(sd)
    return measured, noise @ noise.T + spread


def identifiability(state: SteadyState) -> tuple[int, float | None]:
    """(rank, condition) of what the data, without the prior, say of the three logarithms.

    Directions whose information exceeds RANK_GAIN times the prior's count.
    """
    scaled = state.p[:3, :3] / np.outer(state.prior[:3], state.prior[:3])
    information = np.linalg.eigvalsh(np.linalg.inv(scaled)) - 1.0
    rank = int(np.sum(information > RANK_GAIN))
    if information[0] <= 0:
        return rank, None
    return rank, float(information[-1] / information[0])


def estimate(state: SteadyState, machine: Machine, t_ns: int) -> Estimate:
    """What can be said now."""
    rank, condition = identifiability(state)
    age = (t_ns - state.informed_ns) * 1e-9 if state.informed_ns else None
    parameters = tuple(_parameter(state, k, rank, age) for k in range(3))
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = state.p[:3, :3]
    covariance[3:, 3:] = np.diag([t.log_sd**2 for t in _tyres(machine)])
    masses = (machine.tractor.mass.value, machine.tractor.mass.value, machine.implement.mass.value)
    return Estimate(
        t_ns=t_ns,
        method=METHOD,
        model=MODEL,
        parameters=(*parameters, _RELAXATION, _RELAXATION, _RELAXATION),
        log_covariance=tuple(covariance.ravel().tolist()),
        per_mass=tuple(p.value / m if p.value else None for p, m in zip(parameters, masses, strict=True)),
        nuisances={
            name: (float(state.x[k]), math.sqrt(state.p[k, k]))
            for k, name in enumerate(STATES)
            if k in NUISANCES
        },
        rank=rank,
        condition=condition,
        excitation={"steady_s": state.steady_s, "sideslip_s": state.sideslip_s, "forgotten": state.forgotten},
        window_s=state.steady_s,
    )


def _tyres(machine: Machine) -> tuple[Tyre, Tyre, Tyre]:
    return (machine.tyres.front, machine.tyres.rear, machine.tyres.implement)


def _parameter(state: SteadyState, k: int, rank: int, age: float | None) -> ParameterEstimate:
    """One stiffness: a number only where the data support it."""
    sd_log = math.sqrt(state.p[k, k])
    if age is None:
        now = f" (now: {state.reason})" if state.reason else ""
        return ParameterEstimate(None, None, Status.UNESTIMATED, f"no steady turn yet{now}")
    if rank < 3 or sd_log > SUPPORTED * state.prior[k]:
        return ParameterEstimate(None, None, Status.UNESTIMATED, _what_lacks(state, rank), age)
    value = math.exp(state.x[k])
    if age > STALE_S:
        return ParameterEstimate(
            value, value * sd_log, Status.STALE, f"no steady driving for {age:.0f} s", age
        )
    return ParameterEstimate(value, value * sd_log, Status.ESTIMATED, "", age)


def _what_lacks(state: SteadyState, rank: int) -> str:
    if rank < 3 and state.sideslip_s == 0:
        return f"rank {rank} of 3: without sideslip three stiffnesses cannot be told apart"
    return f"rank {rank} of 3: more steady turns to both sides are needed"


assert PARAMETERS[:3] == STATES[:3]
