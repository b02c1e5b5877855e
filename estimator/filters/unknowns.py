"""All unknowns of the estimators that learn the six parameters, in one vector, with priors by the machine
file.

A Gaussian over this vector is the prior and the posterior of a fit. An unknown that the machine file gives
without an sd has a prior sd of zero and stays fixed.
"""

import math
from typing import Annotated, Final

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.models.parameters import GEOMETRY, geometry_of
from tilth.estimator.once import once_for_a_machine
from tilth.estimator.pose import latency
from tilth.estimator.state_json import Shape
from tilth.schemas.flow import PARAMETERS, Mount
from tilth.schemas.machine import Implement, Machine, Quantity, Tractor

Array = NDArray[np.float64]

NOISES: Final = (
    "push_t", "push_i", "push_yaw", "memory", "uneven", "s_yaw_rate", "s_velocity", "s_position", "s_roll",
)  # fmt: skip
"""Natural logarithms: sds of how the ground pushes across the tractor and the implement (m/s^2) and turns the
tractor (rad/s^2), and how long that lasts (s, of a first-order Gauss-Markov process; white where that is less
than a tick); sd of how far uneven ground turns the wheels of a body about its long axis (rad); factors on the
sds that the machine file states for yaw rates, velocities, positions and headings, and rolls."""

ROLL_ZEROS: Final = tuple(f"roll_zero_{mount.value}" for mount in Mount)
N_ROLL_MODES: Final = 13  # unknowns from roll_k_t to shrink

NAMES: Final = (
    *PARAMETERS,  # natural logarithms of N/rad and m
    "wheel_zero",  # rad: reading when straight
    "wheel_gain",  # logarithm: reading over true angle
    "latency",  # s: by how much all receivers report later than the file says
    "pair_t", "pair_i",  # rad: heading by the surveyed antennas minus true heading
    "lever_t", "lever_i",  # m: by how much a body's antennas are further forward than surveyed
    "aside_i",  # m: by how much the implement's antennas are further right, relative to the tractor's
    "cg_t", "cg_i",  # m: CG further forward than the file says
    "rolling",  # rolling resistance over load
    "roll_k_t", "roll_k_i",  # logarithms: roll stiffness over that of rig_setup.nominal_roll
    "roll_d_t", "roll_d_i",  # the same of roll damping
    "roll_j_t", "roll_j_i",  # the same of roll inertia
    "roll_front",  # the same of the front axle about its pin
    "roll_pin", "roll_hitch",  # m: the front axle's pin and the drawbar are higher than nominal
    "roll_cg_t", "roll_cg_i",  # m: CG higher than the file says
    "camber",  # camber thrust of a leaning wheel over its load and camber angle
    "shrink",  # how far relaxation lengths fall with slip: 1 as the secant of the tyre curve, 0 not at all
    *ROLL_ZEROS,  # rad: measured roll less true, of each receiver
    "roll_late_t", "roll_late_i",  # s: by how much the rolls of a body's receivers are late
    "rate_late_t", "rate_late_i",  # s: the same of their turn rates, after their positions
    "sway",  # of velocities where positions are corrected for roll: 1 the antenna's, 0 of the ground point
    "curvature",  # 1 over the largest side force over load: 0 is a linear tyre
    "parallel",  # how far the front wheels turn by the same angle: 0 towards one centre, 1 in parallel
    "two_track",  # how far an axle's wheels slip each by itself: 1 as two, 0 as one (a single-track model)
    *NOISES,
    *GEOMETRY,  # logarithms of true over surveyed; e as m
)  # fmt: skip

AT: Final = {name: k for k, name in enumerate(NAMES)}
Vector = Annotated[Array, Shape((len(NAMES),))]  # in that order; of a state that is stored
Matrix = Annotated[Array, Shape((len(NAMES), len(NAMES)))]
SIX: Final = slice(0, 6)
NOISE: Final = slice(AT["push_t"], AT["s_roll"] + 1)
SHAPE: Final = slice(AT["a"], AT["I_i"] + 1)

MASSES: Final = (AT["m_t"], AT["m_i"])
"""Not learned with the six, but considered: driving shows stiffnesses over masses. What forces tell of a mass
itself goes by the small couplings between the bodies, where errors of the model are largest."""

# Indices for kernels. Of pair, lever, cg and push it is the first one; the others follow it.
AT_WHEEL_ZERO: Final = AT["wheel_zero"]
AT_WHEEL_GAIN: Final = AT["wheel_gain"]
AT_LATENCY: Final = AT["latency"]
AT_PAIR: Final = AT["pair_t"]
AT_LEVER: Final = AT["lever_t"]
AT_ASIDE: Final = AT["aside_i"]
AT_CG: Final = AT["cg_t"]
AT_ROLLING: Final = AT["rolling"]
AT_CURVATURE: Final = AT["curvature"]
AT_PARALLEL: Final = AT["parallel"]
AT_TWO_TRACK: Final = AT["two_track"]
AT_ROLL_MODES: Final = AT["roll_k_t"]
AT_FRONT: Final = AT["roll_front"]
AT_PIN: Final = AT["roll_pin"]
AT_HITCH: Final = AT["roll_hitch"]
AT_CAMBER: Final = AT["camber"]
AT_SHRINK: Final = AT["shrink"]
AT_ROLL_ZERO: Final = AT[ROLL_ZEROS[0]]
AT_ROLL_LATE: Final = AT["roll_late_t"]
AT_RATE_LATE: Final = AT["rate_late_t"]
AT_SWAY: Final = AT["sway"]
AT_PUSH: Final = AT["push_t"]
AT_MEMORY: Final = AT["memory"]
AT_UNEVEN: Final = AT["uneven"]
AT_S_YAW_RATE: Final = AT["s_yaw_rate"]
AT_S_VELOCITY: Final = AT["s_velocity"]
AT_S_POSITION: Final = AT["s_position"]
AT_S_ROLL: Final = AT["s_roll"]
AT_GEOMETRY: Final = AT["a"]

ROLLING: Final = (0.04, 0.03)  # 0.01 on a road, 0.1 on tilled soil
CURVATURE: Final = (1.0, 0.6)  # grip 0.6 to 2.5; a linear tyre is 1.7 sd away
ROLL_SD: Final = (0.6, 0.6, 0.8, 0.8, 0.4, 0.4, 0.4, 0.15, 0.1, 0.05, 0.05)  # of the roll modes' unknowns
TWO_TRACK: Final = (1.0, 0.5)  # twin wheels, wide tyres; one wheel an axle is 2 sd away
CAMBER: Final = (0.2, 0.15)
SHRINK: Final = (0.5, 0.4)
ROLL_ZERO_SD: Final = 0.01  # rad: zero errors of up to a degree
ROLL_LATE: Final = (0.03, 0.03)  # s, and its sd
RATE_LATE: Final = (0.02, 0.03)  # the same; a gyro is filtered less than a roll
SWAY: Final = (0.5, 0.5)  # either of 0 and 1; sd
DISTURBANCE: Final = (0.15, 0.15, 0.03)  # m/s^2, rad/s^2: forces of a hundredth or two of the weight
DISTURBANCE_LOG_SD: Final = 1.2
MEMORY: Final = (0.1, 1.0)  # s, and the sd of its logarithm: waves of 1 to 20 m come by in 0.2 to 4 s
UNEVEN: Final = 0.006  # rad
ROUGH: Final = 0.01  # rad: such ground, about 3 cm rms, makes the loads of the wheels come and go
UNEVEN_LOG_SD: Final = 1.2
SENSOR_LOG_SD: Final = 0.5


def prior(machine: Machine) -> tuple[Array, Array]:
    """(mean [n], sd [n]) of NAMES before any data."""
    mean, sd = _prior(machine)
    return mean.copy(), sd.copy()


@once_for_a_machine
def _prior(machine: Machine) -> tuple[Array, Array]:
    mean, sd = np.zeros(len(NAMES)), np.zeros(len(NAMES))
    tyres = (machine.tyres.front, machine.tyres.rear, machine.tyres.implement)
    mean[SIX] = np.log([t.cornering_stiffness for t in tyres] + [t.relaxation_length for t in tyres])
    sd[SIX] = [t.log_sd for t in tyres] * 2
    wheel, tractor, implement = machine.wheel_angle, machine.tractor, machine.implement
    gain = wheel.gain.sd / wheel.gain.value
    sd[AT["wheel_zero"]], sd[AT["wheel_gain"]] = math.radians(wheel.zero.sd), gain
    sd[AT["latency"]] = _common_latency(machine)
    bodies: tuple[Tractor | Implement, ...] = (tractor, implement)
    for k, body in enumerate(bodies):
        name = ("tractor", "implement")[k]
        survey = _survey(machine, name) if body.lever_sd is None else body.lever_sd
        turned = _turned(machine, name)
        sd[AT["pair_t"] + k] = math.hypot(math.radians(body.pair_yaw_sd), turned)
        sd[AT["lever_t"] + k] = survey
        sd[AT["cg_t"] + k] = body.cg_sd
    sd[AT["aside_i"]] = math.hypot(_survey(machine, "tractor"), _survey(machine, "implement"))
    (mean[AT["rolling"]], sd[AT["rolling"]]) = ROLLING
    (mean[AT["curvature"]], sd[AT["curvature"]]) = CURVATURE
    (mean[AT["parallel"]], sd[AT["parallel"]]) = 1.0 - tractor.ackermann.value, tractor.ackermann.sd
    (mean[AT["two_track"]], sd[AT["two_track"]]) = TWO_TRACK
    sd[AT_ROLL_MODES : AT_ROLL_MODES + len(ROLL_SD)] = ROLL_SD
    (mean[AT["camber"]], sd[AT["camber"]]) = CAMBER
    (mean[AT["shrink"]], sd[AT["shrink"]]) = SHRINK
    zeros = {
        r.mount: ROLL_ZERO_SD if r.roll_zero is None else math.radians(r.roll_zero.sd)
        for r in machine.receiver
    }
    sd[AT_ROLL_ZERO : AT_ROLL_ZERO + 4] = [zeros.get(mount, 0.0) for mount in Mount]
    mean[AT_ROLL_LATE : AT_ROLL_LATE + 2] = ROLL_LATE[0]
    sd[AT_ROLL_LATE : AT_ROLL_LATE + 2] = ROLL_LATE[1]
    mean[AT_RATE_LATE : AT_RATE_LATE + 2], sd[AT_RATE_LATE : AT_RATE_LATE + 2] = RATE_LATE
    if any(r.roll_corrected for r in machine.receiver):
        mean[AT["sway"]], sd[AT["sway"]] = SWAY
    mean[NOISE] = np.log([*DISTURBANCE, MEMORY[0], UNEVEN, 1.0, 1.0, 1.0, 1.0])
    sd[NOISE] = [DISTURBANCE_LOG_SD] * 3 + [MEMORY[1], UNEVEN_LOG_SD] + [SENSOR_LOG_SD] * 4
    sd[SHAPE] = [_share(name, q) for name, q in zip(GEOMETRY, _quantities(machine), strict=True)]
    return mean, sd


def geometry(base: Array, point: Array) -> Array:
    """GEOMETRY at a point of NAMES, shape (9,). base: as `parameters.geometry_of`. Kernels call it too."""
    changed = np.zeros(9)
    set_geometry(base, point, changed)
    return changed


def set_geometry(base: Array, point: Array, changed: Array) -> None:
    """Fill changed, (9,), with `geometry`. Kernels call it."""
    for i in range(9):
        changed[i] = base[i] * math.exp(point[AT_GEOMETRY + i])
    changed[4] = base[4] + point[AT_GEOMETRY + 4]
    changed[0] -= point[AT_CG]
    changed[1] += point[AT_CG]
    changed[2] += point[AT_CG]
    changed[3] -= point[AT_CG + 1]
    changed[4] += point[AT_CG + 1]


def levers(machine: Machine) -> Array:
    """(forward, right) of each receiver from its body's CG, m, shape (4, 2), in the order of flow.Mount."""
    by_mount = {r.mount: r.position[:2] for r in machine.receiver}
    return np.array([by_mount.get(mount, (0.0, 0.0)) for mount in Mount], dtype=np.float64)


def pair_middles(machine: Machine) -> Array:
    """(forward, right) of the middle of each body's receivers, m, shape (2, 2)."""
    middles = np.zeros((2, 2))
    for k, body in enumerate(("tractor", "implement")):
        places = [r.position[:2] for r in machine.receiver if r.mount.body == body]
        if places:
            middles[k] = np.mean(places, axis=0)
    return middles


def base_geometry(machine: Machine) -> Array:
    """GEOMETRY of the machine file, shape (9,)."""
    return geometry_of(machine)


def _common_latency(machine: Machine) -> float:
    by_mount = {r.mount: r.latency.sd for r in machine.receiver}
    sds = [by_mount[m] for m in Mount if m in by_mount]
    return latency.prior([*sds, *[0.0] * (4 - len(sds))]).sd_mean(list(range(len(sds))))


def _survey(machine: Machine, body: str) -> float:
    """Sd of the middle of a body's receivers, m."""
    sds = [r.survey_sd for r in machine.receiver if r.mount.body == body]
    return math.hypot(*sds) / len(sds) if sds else 0.0


def _turned(machine: Machine, body: str) -> float:
    """Sd of the yaw of a body's two receivers, rad, by what is not known of their places to either side."""
    pair = [r for r in machine.receiver if r.mount.body == body]
    if len(pair) != 2:
        return 0.0
    return math.hypot(*(r.survey_sd for r in pair)) / math.dist(pair[0].position[:2], pair[1].position[:2])


def _quantities(machine: Machine) -> tuple[Quantity, ...]:
    t, i = machine.tractor, machine.implement
    return (t.a, t.b, t.c, i.d, i.e, t.mass, i.mass, t.yaw_inertia, i.yaw_inertia)


def _share(name: str, quantity: Quantity) -> float:
    return quantity.sd if name == "e" else quantity.sd / abs(quantity.value)
