"""The virtual tractor: how a tractor with a towed implement moves when it is driven, and what is true of it.

The planar plant, the nonlinear model (estimator/models/nonlinear.py), is integrated with the sample period;
ground, soil and a pilot are asked every HOLD samples. The spatial plant is in simulator/spatial_run.py.
Everything is a function of the machine file, the seed and the scenario.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.models import nonlinear
from tilth.estimator.models.nonlinear import INPUTS, STATES
from tilth.estimator.models.parameters import GEOMETRY, Rig, checked, rig_of, upright_axles
from tilth.schemas.flow import PARAMETERS, Mount
from tilth.schemas.machine import Machine
from tilth.simulator import noise
from tilth.simulator.ground import SoilField, Terrain, field, terrain
from tilth.simulator.noise import generator, within
from tilth.simulator.pilots import HOLD, Driver
from tilth.simulator.scenario import STEP_S, Scenario, Spatial
from tilth.simulator.spatial.plant import Space

Array = NDArray[np.float64]

PARAMETER_LOG_SD: Final = 0.2
PARAMETER_LIMIT: Final = 0.35
PAIR_LIMIT_DEG: Final = 0.3
ZERO_SD_DEG: Final = 0.3
ROLL_PLAIN: Final = (0.2, 0.0, 0.0, 0.0)
"""Sd and zero error of a receiver's roll, degrees; its delay and that of the turn rate, s."""
ROLL_DRAWN: Final = ((0.2, 0.5), (-1.0, 1.0), (0.0, 0.1), (0.0, 0.06))  # the same, from and to
COMPILED_FROM: Final = 2000  # samples: what is shorter is done before a compiler has been loaded
TOLD: Final = 1000  # samples between two words on progress
AT: Final = {name: k for k, name in enumerate(STATES)}
OF_GROUND: Final = ("gravity_t", "gravity_i", "drive", "force_t", "moment_t", "force_i", "moment_i")
DRIVEN: Final = [INPUTS.index(name) for name in OF_GROUND]


@dataclass(frozen=True, slots=True)
class BodyTrack:
    """One body's CG over time, arrays of shape (n,), named as in schemas.flow.BodyPose.

    The CG sways with roll and pitch about the ground below it, which is what the model moves.
    """

    x: Array
    y: Array
    heading: Array  # not wrapped
    forward_velocity: Array
    lateral_velocity: Array
    yaw_rate: Array
    roll: Array
    pitch: Array
    gyro: Array | None = None  # rad/s about the body's own z axis; None: that is the yaw rate


@dataclass(frozen=True, slots=True)
class Truth:
    """What a simulated run is made from, for comparison with what is estimated from its frames."""

    seed: int
    scenario: Scenario
    parameters: dict[str, float]  # PARAMETERS, N/rad and m: -dF/d alpha without slip, under the static load
    geometry: Array  # as parameters.GEOMETRY: what the machine file gives with an sd is drawn
    nuisances: dict[str, float]  # SI; see `_nuisances`
    time: Array  # s of UTC since scenario.utc_start_ns, shape (n,), STEP_S apart
    wheel_angle: Array  # rad, mean road-wheel angle of the front axle, shape (n,)
    tractor: BodyTrack
    implement: BodyTrack
    rig: Rig  # all that the model was given
    soil: Array  # PARAMETERS under each axle, shape (n, 6)
    states: Array  # of the nonlinear model, its STATES, shape (n, 13): CGs on the ground, not swaying; of the
    # spatial plant the CGs themselves
    space: Space | None = None  # of the spatial plant


@dataclass(frozen=True, slots=True)
class Setting:
    """What a run is, before anybody drives it."""

    seed: int
    scenario: Scenario
    believed: Rig  # what the machine file says
    parameters: dict[str, float]
    nuisances: dict[str, float]
    rig: Rig
    time: Array  # (n,)
    land: Terrain
    soil: SoilField

    def truth(self, time: Array, way: float, states: Array, soil: Array) -> Truth:
        """Of a stretch of the run. time: (m,), s; way: m driven before it; states: (m, 13); soil: (m, 6).

        Raises ValueError on the spatial plant, whose states do not tell all.
        """
        if self.scenario.plant == "spatial":
            raise ValueError('who steers by CAN drives the planar plant: leave out plant = "spatial"')
        return Truth(
            self.seed, self.scenario, self.parameters, self.rig.geometry, self.nuisances, time,
            states[:, AT["delta"]], *_tracks(self.rig, self.land, states, way), self.rig, soil, states,
        )  # fmt: skip


def setting_of(machine: Machine, seed: int, seconds: float, scenario: Scenario) -> Setting:
    """All that is drawn before a run begins. Raises ValueError, as `drive`."""
    if scenario.plant == "spatial":
        scenario = replace(scenario, spatial=_described(machine, scenario.spatial))
    believed = rig_of(machine)
    nuisances = _nuisances(machine, scenario, seed)
    parameters = draw(machine, seed, scenario)
    drawn = generator(rig_seed(scenario, seed), noise.GEOMETRY)
    rig = _rig(machine, scenario, believed, parameters, nuisances, drawn)
    time: Array = np.arange(round(seconds / STEP_S) + 1, dtype=np.float64) * STEP_S
    land = terrain(scenario.ground, scenario.roll_deg, rig, generator(seed, noise.GROUND))
    of_soil = seed if scenario.soil.patch_seed is None else scenario.soil.patch_seed
    soil = field(scenario.soil, parameters, rig, generator(of_soil, noise.SOIL), scenario.loads)
    return Setting(seed, scenario, believed, parameters, nuisances, rig, time, land, soil)


def _described(machine: Machine, spatial: Spatial) -> Spatial:
    """With what the machine file tells of the rig where the scenario does not. Tracks and tyres count where
    all three axles have them."""
    tractor, axles = machine.tractor, upright_axles(machine)
    tyres = (machine.tyres.front, machine.tyres.rear, machine.tyres.implement)
    one_by_one = {
        "axle_mass": tractor.front_axle_mass,
        "hitch_height": tractor.hitch_height,
        "pin_height": tractor.pivot_height,
    }
    told: dict[str, Any] = {key: one.value for key, one in one_by_one.items() if one is not None}
    if all(tyre.track for tyre in tyres):
        told["track"] = tuple(axle.track for axle in axles)
    if all(tyre.deflection or (tyre.size and tyre.pressure) for tyre in tyres):
        told["vertical_stiffness"] = tuple(axle.stiffness / 2 for axle in axles)
    return replace(spatial, **{key: value for key, value in told.items() if getattr(spatial, key) is None})


def rig_seed(scenario: Scenario, seed: int) -> int:
    """Seed of what runs of one rig have in common: the rig, its sensors' constant errors, the six."""
    return seed if scenario.rig_seed is None else scenario.rig_seed


def draw(machine: Machine, seed: int, scenario: Scenario) -> dict[str, float]:
    """The six soil-tyre parameters of a run, before any change of soil."""
    tyres = (machine.tyres.front, machine.tyres.rear, machine.tyres.implement)
    priors = [t.cornering_stiffness for t in tyres] + [t.relaxation_length for t in tyres]
    rng = generator(rig_seed(scenario, seed), noise.PARAMETERS)
    factors = np.exp(rng.normal(0.0, PARAMETER_LOG_SD, len(PARAMETERS)))
    factors = np.clip(factors, 1.0 - PARAMETER_LIMIT, 1.0 + PARAMETER_LIMIT)
    drawn = {name: float(p * f) for name, p, f in zip(PARAMETERS, priors, factors, strict=True)}
    given = {str(name): value for name, value in (scenario.soil.parameters or {}).items()}
    return {**drawn, **given}


def _rig(
    machine: Machine,
    scenario: Scenario,
    believed: Rig,
    parameters: dict[str, float],
    nuisances: dict[str, float],
    rng: np.random.Generator,
) -> Rig:
    """The rig as it is: what the file gives with an sd is drawn, then both CGs are moved."""
    tractor, implement = machine.tractor, machine.implement
    sd = [q.sd for q in (tractor.a, tractor.b, tractor.c, implement.d, implement.e, tractor.mass)]
    sd += [q.sd for q in (implement.mass, tractor.yaw_inertia, implement.yaw_inertia)]
    geometry = believed.geometry + scenario.noise * np.array(sd) * within(rng, len(sd))
    rig = believed._replace(**dict(zip(GEOMETRY, geometry.tolist(), strict=True)), **parameters)
    ahead_t, ahead_i = nuisances["cg_forward_tractor"], nuisances["cg_forward_implement"]
    return checked(
        rig._replace(
            a=rig.a - ahead_t,
            b=rig.b + ahead_t,
            c=rig.c + ahead_t,
            d=rig.d - ahead_i,
            e=rig.e + ahead_i,
            h_t=rig.h_t + nuisances["cg_up_tractor"],
            h_i=rig.h_i + nuisances["cg_up_implement"],
            **dict.fromkeys(("grip_f", "grip_r", "grip_i"), scenario.soil.grip),
            **dict.fromkeys(("roll_f", "roll_r", "roll_i"), scenario.soil.rolling),
            **{str(name): value for name, value in (scenario.planar or {}).items()},
        )
    )


def _nuisances(machine: Machine, scenario: Scenario, seed: int) -> dict[str, float]:
    """Errors that are constant over a run and that an estimator must live with.

    wheel_zero: the sensor's reading when straight minus what the machine file says of it, rad; wheel_gain, 1;
    wheel_delay: beyond the file's, s. pair_tractor, pair_implement: heading by the surveyed receiver
    positions minus true heading, rad. cg_<forward|right|up>_<body>: true CG from the file's, m.
    <forward|right>_<mount>: true place of a receiver from the surveyed one, m. latency_<mount>: s.
    clock_offset, clock_skew: host clock minus UTC at the start, s, and its growth, s/s.
    roll_<sd|zero|delay>_<mount>: of a receiver's own roll, rad, rad and s. turn_rate_delay_<mount>: s.
    """
    rng = generator(rig_seed(scenario, seed), noise.NUISANCES)
    zero, tractor, implement, offset, skew = rng.standard_normal(5) * [ZERO_SD_DEG, 1.0, 1.0, 0.2, 15e-6]
    survey, wheel = scenario.survey, scenario.wheel
    most = scenario.noise * PAIR_LIMIT_DEG
    pairs = np.clip(scenario.noise * survey.pair_sd_deg * np.array([tractor, implement]), -most, most)
    result = {
        "wheel_zero": np.radians(scenario.noise * zero if wheel.zero_deg is None else wheel.zero_deg),
        "wheel_gain": wheel.gain,
        "wheel_delay": wheel.delay,
        "pair_tractor": np.radians(pairs[0]),
        "pair_implement": np.radians(pairs[1]),
        "clock_offset": offset if scenario.clock_offset_s is None else scenario.clock_offset_s,
        "clock_skew": skew if scenario.clock_offset_s is None else 0.0,
    }
    given = scenario.latency_s or {}
    for receiver, share in zip(machine.receiver, within(rng, len(machine.receiver)), strict=True):
        drawn = max(0.02, receiver.latency.value + receiver.latency.sd * share)
        result[f"latency_{receiver.mount}"] = given.get(receiver.mount, drawn)
    names = [f"cg_{axis}_{body}" for body in ("tractor", "implement") for axis in ("forward", "right", "up")]
    height_sd = survey.cg_sd if survey.cg_height_sd is None else survey.cg_height_sd
    shifts = scenario.noise * np.tile([survey.cg_sd, survey.cg_sd, height_sd], 2) * within(rng, len(names))
    result |= zip(names, shifts, strict=True)
    for receiver in machine.receiver:
        forward, right = scenario.noise * survey.lever_sd * within(rng, 2)
        result |= {f"forward_{receiver.mount}": forward, f"right_{receiver.mount}": right}
        result |= _roll_sensor(scenario, receiver.mount, seed)
    return {key: float(value) for key, value in result.items()}


def _roll_sensor(scenario: Scenario, mount: Mount, seed: int) -> dict[str, float]:
    """Errors of one receiver's roll and turn rate, as `_nuisances`."""
    given, stream = scenario.roll_sensor, list(Mount).index(mount)
    rng = generator(rig_seed(scenario, seed), noise.ROLL, stream)
    drawn = tuple(rng.uniform(low, high) for low, high in ROLL_DRAWN)
    sd, zero, delay, rate_delay = drawn if given.draw else ROLL_PLAIN
    return {
        f"roll_sd_{mount}": float(np.radians(sd if given.sd_deg is None else given.sd_deg)),
        f"roll_zero_{mount}": float(
            np.radians(scenario.noise * zero if given.zero_deg is None else given.zero_deg)
        ),
        f"roll_delay_{mount}": float(delay if given.delay is None else given.delay),
        f"turn_rate_delay_{mount}": float(
            rate_delay if given.turn_rate_delay is None else given.turn_rate_delay
        ),
    }


def integrate(
    rig: Rig,
    driver: Driver,
    land: Terrain,
    soil: SoilField,
    time: Array,
    progress: Callable[[float], None] | None,
) -> tuple[Array, Array]:
    """(states, shape (n, 13); soil-tyre parameters, shape (n, 6)) at each sample."""
    n = len(time)
    run: Callable[..., Any] = nonlinear.integrate if n >= COMPILED_FROM else _interpreted()
    act = driver.actuator
    act_pair = (0.0, 0.0) if act is None else (act.gain / act.inertia, act.damping / act.inertia)
    states, inputs = np.zeros((n, len(STATES))), np.zeros((n, len(INPUTS)))
    theta = np.tile(soil.theta, (n, 1))
    states[0] = driver.start()
    way = 0.0  # of the tractor, m
    for k in range(0, n - 1, HOLD):
        x, end = states[k], min(k + HOLD, n - 1)
        rows = inputs[k : end + 1]
        rows[:, 0], rows[:, 3] = driver.steer(k, end, x)
        rows[:, DRIVEN] = land.inputs(way, x, soil.rig_at(time[k]))
        if not soil.uniform:
            theta[k : end + 1] = soil.at(time[k], x)
        run(states[k : end + 1], rows, theta[k : k + 1], soil.rig_at(time[k]), act_pair, STEP_S, 1, True)
        way += x[AT["u"]] * (end - k) * STEP_S
        if progress is not None and k % TOLD == 0:
            progress(time[k])
    return states, theta


@cache
def _interpreted() -> Callable[..., Any]:
    return nonlinear.integrate.interpreted()


def _tracks(rig: Rig, land: Terrain, states: Array, way: float) -> tuple[BodyTrack, BodyTrack]:
    """Both bodies from the model's states; way: m that were driven before."""
    u = states[:, AT["u"]]
    ways = way + np.concatenate([[0.0], np.cumsum(u[:-1] * STEP_S)])
    rolls = land.rolls(ways, states[:, AT["psi_t"]], states[:, AT["psi_i"]])
    cart = nonlinear.implement(rig, states)
    bodies = (
        (states[:, [AT[name] for name in ("x_t", "y_t", "u", "v")]], "psi_t", "r_t", rig.h_t, rolls[0]),
        (cart, "psi_i", "r_i", rig.h_i, rolls[1]),
    )
    one, other = (
        _with_roll(motion, states[:, AT[psi]], states[:, AT[r]], height, roll, land)
        for motion, psi, r, height, roll in bodies
    )
    return one, other


def _with_roll(motion: Array, psi: Array, r: Array, height: float, roll: Array, land: Terrain) -> BodyTrack:
    """The CG `height` above the ground point that moves as `motion`: x, y, u, v, shape (n, 4)."""
    pitch = np.broadcast_to(land.pitch(psi), psi.shape)
    back, side = leaning(roll, pitch)
    ahead, lateral_offset = -height * back, height * side
    cosine, sine = np.cos(psi), np.sin(psi)
    return BodyTrack(
        motion[:, 0] + ahead * cosine - lateral_offset * sine,
        motion[:, 1] + ahead * sine + lateral_offset * cosine,
        psi,
        motion[:, 2] + rate(ahead) - r * lateral_offset,
        motion[:, 3] + rate(lateral_offset) + r * ahead,
        r,
        roll,
        pitch,
    )


def leaning(roll: Array, pitch: Array) -> tuple[Array, Array]:
    """How far back and to the right a body's vertical leans over a metre of it, m, each shape (n,)."""
    return np.cos(roll) * np.sin(pitch), np.sin(roll)


def rate(series: Array) -> Array:
    """Derivative of a series of samples, 1/s, shape (n,)."""
    return np.gradient(series, STEP_S) if len(series) > 1 else np.zeros_like(series)
