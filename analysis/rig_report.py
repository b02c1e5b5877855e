"""What the models say of a rig before it is driven, as one plain object that becomes JSON as it stands.

Numbers are SI and radians unless the key names another unit. A complex number is [real, imaginary]; what does
not exist (the damping of an integrator, a parameter that the data leave open) is None.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, TypedDict, final

import numpy as np

from tilth.estimator.models import identifiability as knowing
from tilth.estimator.models import linear_analysis as linear
from tilth.estimator.models.actuator import BOSSERD, Actuator
from tilth.estimator.models.family import MODELS, Model
from tilth.estimator.models.linear_analysis import Array, Complex, System, system
from tilth.estimator.models.manoeuvres import Manoeuvre, manoeuvre_named
from tilth.estimator.models.parameters import RIG_PARAMETERS, Rig, static_loads
from tilth.estimator.models.regulator import regulator

LINEAR = tuple(model for model in MODELS if model.name != "nonlinear")
SPEEDS = (1.0, 2.5, 4.5, 7.5)  # m/s
SPEED_RANGE = (0.1, 30.0)  # m/s, of what a report can be asked for
OMEGA = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 8.0, 10.0, 20.0)  # rad/s
MEASURED = ("y_t", "psi_t", "psi_i")  # for observability: the dissertation's assumption
ACTUATORS: Mapping[str, Actuator | None] = {"without_actuator": None, "with_actuator": BOSSERD}
SAMPLE_S = 0.02
SEED = 1  # of manoeuvres that draw


class Drive(NamedTuple):
    """A manoeuvre and what is measured meanwhile."""

    manoeuvre: Manoeuvre = manoeuvre_named("steps")
    sensors: str = "gyros_headings"  # a key of identifiability.SENSOR_SETS
    amplitude: float = math.radians(5.0)  # rad
    seconds: float = 30.0

    def wheel_angle(self) -> Array:
        """Every SAMPLE_S, rad, shape (n,)."""
        time: Array = np.arange(round(self.seconds / SAMPLE_S) + 1, dtype=np.float64) * SAMPLE_S
        return self.manoeuvre.wheel_angle(time, self.amplitude, np.random.default_rng(SEED))


class ParameterRow(TypedDict):
    value: float | None
    unit: str


class Understeer(TypedDict):
    """wheel_angle_ratio: by speed_key, over that of rolling without slip."""

    gradient_rad_s2_per_m: float
    gradient_deg_per_g: float
    characteristic_speed_m_per_s: float | None
    wheel_angle_ratio: dict[str, float]


class SensorRow(TypedDict):
    output: str
    sd: float
    every_s: float


class DriveFacts(TypedDict):
    manoeuvre: str
    amplitude_deg: float
    seconds: float
    sensors: str
    sensor_rows: list[SensorRow]
    disturbances: dict[str, float]


class Poles(TypedDict):
    """`dominant` is the one with the largest real part; what they say of settling is of it."""

    eigenvalues: list[list[float]]
    damping: list[float | None]
    dominant: list[float] | None
    dominant_damping: float | None
    settling_time_s: float | None
    settling_distance_m: float | None
    stable: bool


class SteadyTurn(TypedDict):
    """Per rad of wheel angle."""

    lateral_velocity: float
    yaw_rate: float
    articulation: float
    yaw_rate_dB: float


class GainAndPhase(TypedDict):
    """Of one output at OMEGA."""

    gain_dB: list[float]
    phase_deg: list[float]


class FrequencyResponse(TypedDict):
    """Of both yaw rates from the wheel angle, at OMEGA. Phases from −180° to 180°."""

    omega_rad_per_s: list[float]
    r_t: GainAndPhase
    r_i: GainAndPhase


class Rank(TypedDict):
    rank: int
    of: int
    condition: float | None


class Observability(Rank):
    outputs: list[str]


@final
class NoRegulator(TypedDict):
    reason: str


@final
class RegulatorFacts(Poles):
    """Of the closed loop. gain: by state."""

    input: str
    gain: dict[str, float]


class TyreBound(Rank):
    """Least standard deviations, as shares of the values: sd with all else known, sd_zero_unknown where the
    zero of the wheel-angle sensor is to be found as well."""

    sd: dict[str, float | None]
    sd_zero_unknown: dict[str, float | None]


class AtSpeed(Poles):
    """One model at one speed. lqr: by name of ACTUATORS."""

    states: list[str]
    inputs: list[str]
    a: list[list[float]]
    b: list[list[float]]
    steady_turn_per_rad: SteadyTurn | None
    frequency_response: FrequencyResponse
    controllability: Rank
    observability: Observability
    lqr: dict[str, RegulatorFacts | NoRegulator]
    bound: TyreBound | None


class RigReport(TypedDict):
    """models: by name and speed_key; its eigenvalues are sorted by real, then imaginary part."""

    parameters: dict[str, ParameterRow]
    static_loads_N: dict[str, float]
    understeer: Understeer
    drive: DriveFacts
    models: dict[str, dict[str, AtSpeed]]


def speed_key(speed: float) -> str:
    """Plain decimal text of a speed within SPEED_RANGE: 4.5 and 1.0."""
    return repr(float(speed))


def rig_report(
    rig: Rig, models: Sequence[Model] = LINEAR, speeds: Sequence[float] = SPEEDS, drive: Drive | None = None
) -> RigReport:
    """The whole report. speeds: m/s, within SPEED_RANGE."""
    drive = drive or Drive()
    return {
        "parameters": {
            row.name: {"value": _plain(value), "unit": row.unit}
            for row, value in zip(RIG_PARAMETERS, rig, strict=True)
        },
        "static_loads_N": dict(zip(("front", "rear", "implement"), static_loads(rig), strict=True)),
        "understeer": understeer(rig, speeds),
        "drive": {
            "manoeuvre": drive.manoeuvre.name,
            "amplitude_deg": math.degrees(drive.amplitude),
            "seconds": drive.seconds,
            "sensors": drive.sensors,
            "sensor_rows": [
                {"output": s.output, "sd": s.sd, "every_s": s.every * SAMPLE_S}
                for s in knowing.SENSOR_SETS[drive.sensors]
            ],
            "disturbances": dict(knowing.DISTURBANCES),
        },
        "models": {
            model.name: {speed_key(u): at_speed(model, rig, float(u), drive) for u in speeds}
            for model in models
        },
    }


def understeer(rig: Rig, speeds: Sequence[float]) -> Understeer:
    """Gradient, characteristic speed, and what each speed costs in wheel angle."""
    gradient = linear.understeer_gradient(rig)
    return {
        "gradient_rad_s2_per_m": gradient,
        "gradient_deg_per_g": math.degrees(gradient * rig.g),
        "characteristic_speed_m_per_s": _plain(linear.characteristic_speed(rig)),
        "wheel_angle_ratio": {speed_key(u): 1.0 + gradient * u**2 / rig.wheelbase for u in speeds},
    }


def at_speed(model: Model, rig: Rig, speed: float, drive: Drive) -> AtSpeed:
    """One model at one speed."""
    sys = system(model, rig, speed)
    measured = system(model, rig, speed, outputs=MEASURED)
    steer = sys.b[:, :1]
    return {
        "states": list(sys.states),
        "inputs": list(sys.inputs),
        "a": sys.a.tolist(),
        "b": sys.b.tolist(),
        **poles(linear.eigenvalues(sys.a), speed),
        "steady_turn_per_rad": steady_turn(model, rig, speed),
        "frequency_response": frequency_response(sys),
        "controllability": _rank(linear.controllability(sys.a, steer), sys),
        "observability": {"outputs": list(MEASURED), **_rank(linear.observability(sys.a, measured.c), sys)},
        "lqr": {name: lqr(model, rig, speed, actuator) for name, actuator in ACTUATORS.items()},
        "bound": bound(model, rig, speed, drive),
    }


def poles(eigenvalues: Complex, speed: float) -> Poles:
    """Eigenvalues and what they say of settling."""
    try:
        slowest: complex | None = linear.dominant(eigenvalues)
    except ValueError:
        slowest = None
    settles = None if slowest is None else linear.settling_time(eigenvalues)
    damping = linear.damping(eigenvalues)
    return {
        "eigenvalues": _plain(eigenvalues),
        "damping": _plain(damping),
        "dominant": _plain(slowest),
        "dominant_damping": None if slowest is None else _plain(-slowest.real / abs(slowest)),
        "settling_time_s": _plain(settles),
        "settling_distance_m": None if settles is None else _plain(speed * settles),
        "stable": bool(np.all(eigenvalues.real <= 0.0)),
    }


def steady_turn(model: Model, rig: Rig, speed: float) -> SteadyTurn | None:
    """None where there is no such turn.

    Headings grow without end in a turn: only their difference is kept as a state.
    """
    sys = system(model, rig, speed, outputs=("v", "r_t", "articulation"))
    names = list(sys.states)
    retained = [i for i, name in enumerate(names) if name not in ("y_t", "psi_t", "psi_i")]
    spread = np.zeros((len(names), len(retained) + 1))  # states from those kept and the articulation
    spread[retained, range(len(retained))] = 1.0
    spread[names.index("psi_t"), -1] = 1.0
    gather = spread.T.copy()
    gather[-1, names.index("psi_i")] = -1.0
    try:
        steady = -np.linalg.solve(gather @ sys.a @ spread, gather @ sys.b[:, 0])
    except np.linalg.LinAlgError:
        return None
    v, r, articulation = (sys.c @ spread @ steady + sys.d[:, 0]).tolist()
    return {
        "lateral_velocity": v,
        "yaw_rate": r,
        "articulation": articulation,
        "yaw_rate_dB": float(20 * np.log10(abs(r))),
    }


def frequency_response(sys: System) -> FrequencyResponse:
    """By the names of its outputs."""
    response = linear.frequency_response(sys, np.array(OMEGA))[:, :, 0]
    gain, phase = linear.decibel(response), np.degrees(np.angle(response))
    of_t, of_i = (GainAndPhase(gain_dB=gain[:, k].tolist(), phase_deg=phase[:, k].tolist()) for k in (0, 1))
    return {"omega_rad_per_s": list(OMEGA), "r_t": of_t, "r_i": of_i}


def lqr(model: Model, rig: Rig, speed: float, actuator: Actuator | None) -> RegulatorFacts | NoRegulator:
    """The dissertation's regulator, Q = 1 on every state and R = 800; `reason` where there is none."""
    sys = system(model, rig, speed, actuator=actuator)
    try:
        found = regulator(sys)
    except ValueError as error:
        return {"reason": str(error)}
    gain = dict(zip(found.states, found.gain.tolist(), strict=True))
    return {"input": sys.inputs[0], "gain": gain, **poles(found.poles, speed)}


def bound(model: Model, rig: Rig, speed: float, drive: Drive) -> TyreBound | None:
    """What the drive can give; None without parameters."""
    names = model.parameters
    if not names:
        return None
    sensors, wanted = knowing.SENSOR_SETS[drive.sensors], (*names, "wheel_zero")
    outputs = [sensor.output for sensor in sensors]
    slopes = knowing.sensitivities(model, rig, speed, drive.wheel_angle(), SAMPLE_S, outputs, wanted)
    white = knowing.whitened(model, rig, speed, SAMPLE_S, sensors, slopes, knowing.DISTURBANCES)
    known = knowing.bound(white[:, : len(names)], names)
    zero_unknown = knowing.bound(white, wanted)
    return {
        "sd": _by_name(names, known.sd),
        "sd_zero_unknown": _by_name(names, zero_unknown.sd),
        "rank": known.rank,
        "of": len(names),
        "condition": _plain(known.condition),
    }


def _by_name(names: Sequence[str], values: Array) -> dict[str, float | None]:
    return {name: _plain(float(value)) for name, value in zip(names, values, strict=False)}


def _rank(found: tuple[int, float], sys: System) -> Rank:
    rank, condition = found
    return {"rank": rank, "of": len(sys.states), "condition": _plain(condition)}


def _plain(value: Any) -> Any:
    """What JSON can hold: lists, numbers, None for what is not finite, [re, im] for a complex number."""
    if isinstance(value, np.ndarray):
        return [_plain(item) for item in value.tolist()]
    if isinstance(value, complex):
        return [value.real, value.imag]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
