"""All unknowns of the estimators that learn the six parameters, in one vector, with priors by the machine
file: one row for each.

A Gaussian over this vector is the prior and the posterior of a fit.
"""

import math
from collections.abc import Callable
from enum import IntEnum
from typing import Annotated, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.filters.priors import (
    CG_SD,
    LEVER_SD,
    PAIR_SD,
    PRIOR,
    Prior,
    cg_height,
    common_latency,
    constant,
    front_axle,
    front_pivot,
    hitch,
    level,
    roll_compensation,
    roll_stiffness,
    roll_zero,
    survey,
    surveyed,
    tyre,
)
from tilth.estimator.models import rolling_terms
from tilth.estimator.models.parameters import GEOMETRY
from tilth.estimator.once import once_for_a_machine
from tilth.estimator.state_json import Shape
from tilth.schemas.flow import PARAMETERS, Mount
from tilth.schemas.machine import Machine

Array = NDArray[np.float64]


class ActsAs(IntEnum):
    """How an unknown acts on a parameter of the motion model."""

    NONE = 0  # on none: sensors, ground, geometry
    VALUE = 1  # it is the parameter
    FACTOR = 2  # natural logarithm of the parameter over its nominal value
    SUM = 3  # it is added to the parameter, or taken off where the name has a minus


class Unknown(NamedTuple):
    """One row: all that the filters, their priors and what is published of it need."""

    name: str
    meaning: str  # with its unit
    prior: Callable[[Machine], Prior]  # sd 0: the machine file gives it as exact, and it stays fixed
    transform: ActsAs = ActsAs.NONE
    acts_on: str = ""  # of rolling_terms.PARAMETERS, one or several
    least: float = -math.inf  # of the parameter
    linear: bool = False  # the linear model has it as well
    needs_steering: bool = False  # along a row only ground that is not as in the model tells of it
    model_sd: float = 0.0  # by how much errors of the model move it, in its unit; part of its published sd
    doubted: bool = False  # such errors move it far: what goes beyond half of the prior's sd rather is one


def _factor(name: str, meaning: str, prior: Callable[[Machine], Prior], acts_on: str) -> Unknown:
    """Of how the bodies roll: a factor on what roll_stiffness.nominal_roll says."""
    return Unknown(name, meaning, prior, ActsAs.FACTOR, acts_on, needs_steering=True)


def _sum(name: str, meaning: str, prior: Callable[[Machine], Prior], acts_on: str) -> Unknown:
    """A height, not below the ground."""
    return Unknown(name, meaning, prior, ActsAs.SUM, acts_on, 0.0, needs_steering=True)


_VALUE: Final = ActsAs.VALUE
ROLL_ZEROS: Final = tuple(f"roll_zero_{mount.value}" for mount in Mount)

UNKNOWNS: Final = (
    *(
        Unknown(
            name, "natural logarithm, of N/rad or m", tyre(k), ActsAs.FACTOR, acts_on, linear=True,
            needs_steering=True,
        )
        for k, (name, acts_on) in enumerate(zip(PARAMETERS, rolling_terms.PARAMETERS[:6], strict=True))
    ),
    Unknown(
        "wheel_zero", "rad: reading of the wheel angle when straight",
        lambda machine: (0.0, math.radians(machine.wheel_angle.zero.sd)), model_sd=0.0015,
    ),
    Unknown(
        "wheel_gain", "logarithm: reading over true wheel angle",
        lambda machine: (0.0, machine.wheel_angle.gain.sd / machine.wheel_angle.gain.value),
        model_sd=0.02, doubted=True,
    ),
    Unknown(
        "latency", "s: by how much all receivers report later than the file says",
        lambda machine: (0.0, common_latency(machine)), model_sd=0.01, doubted=True,
    ),
    *(
        Unknown(f"pair_{of}", "rad: heading by the surveyed antennas less true", prior, model_sd=0.002)
        for of, prior in zip("ti", PAIR_SD, strict=True)
    ),
    *(
        Unknown(f"lever_{of}", "m: a body's antennas are further forward than surveyed", prior, model_sd=0.01)
        for of, prior in zip("ti", LEVER_SD, strict=True)
    ),
    Unknown(
        "aside_i", "m: the implement's antennas are further right, relative to the tractor's",
        lambda machine: (0.0, math.hypot(survey(machine, "tractor"), survey(machine, "implement"))),
        model_sd=0.02, doubted=True,
    ),
    *(
        Unknown(
            f"cg_{of}", "m: CG further forward than the file says", prior, ActsAs.SUM, acts_on, linear=True,
            doubted=True,
        )
        for of, prior, acts_on in zip("ti", CG_SD, ("-a b c", "-d e"), strict=True)
    ),
    # 0.01 on a road, 0.1 on tilled soil
    Unknown(
        "rolling", "rolling resistance over load", constant(0.04, 0.03), _VALUE, "rolling",
        needs_steering=True,
    ),
    _factor("roll_k_t", "logarithm: roll stiffness over the nominal", roll_stiffness(1), "k_t"),
    _factor("roll_k_i", "the same, implement", roll_stiffness(2), "k_i"),
    _factor("roll_d_t", "logarithm: roll damping over the nominal", constant(0.0, 0.8), "d_t"),
    _factor("roll_d_i", "the same, implement", constant(0.0, 0.8), "d_i"),
    _factor("roll_j_t", "logarithm: roll inertia over the nominal", constant(0.0, 0.4), "j_t"),
    _factor("roll_j_i", "the same, implement", constant(0.0, 0.4), "j_i"),
    _factor("roll_front", "logarithm: of the front axle about its pin", front_axle, "k_f"),
    _sum("roll_pin", "m: the front axle's pin is higher than nominal", front_pivot, "pivot_height"),
    _sum("roll_hitch", "m: the drawbar is higher than nominal", hitch, "h_h"),
    _sum("roll_cg_t", "m: CG higher than the file says", cg_height("tractor"), "h_t"),
    _sum("roll_cg_i", "the same, implement", cg_height("implement"), "h_i"),
    Unknown(
        "camber", "camber thrust over load and camber angle", constant(0.2, 0.15), _VALUE, "camber",
        needs_steering=True,
    ),
    Unknown(
        "shrink", "how far relaxation lengths fall with slip: 1 as the tyre curve's secant, 0 not at all",
        constant(0.5, 0.4), _VALUE, "slip_dependence", needs_steering=True,
    ),
    *(
        Unknown(name, "rad: measured roll less true", roll_zero(mount), model_sd=0.01, doubted=True)
        for name, mount in zip(ROLL_ZEROS, Mount, strict=True)
    ),
    *(
        Unknown(
            f"roll_late_{of}", "s: by how much the rolls of a body's receivers are late",
            constant(0.03, 0.03),
            model_sd=0.02, doubted=True, needs_steering=True,
        )
        for of in "ti"
    ),
    *(  # a gyro is filtered less than a roll
        Unknown(f"rate_late_{of}", "s: the same of their turn rates", constant(0.02, 0.03), model_sd=0.01)
        for of in "ti"
    ),
    Unknown(
        "sway", "of velocities where positions are corrected for roll: 1 the antenna's, 0 the ground point's",
        roll_compensation, model_sd=0.2,
    ),
    Unknown(  # grip 0.6 to 2.5; a linear tyre is 1.7 sd away
        "curvature", "1 over the largest side force over load: 0 is a linear tyre", constant(1.0, 0.6),
        _VALUE, "curvature", PRIOR.least_curvature, linear=True, needs_steering=True,
    ),
    Unknown(
        "parallel", "how far the front wheels turn by the same angle: 0 towards one centre, 1 in parallel",
        lambda machine: (1.0 - machine.tractor.ackermann.value, machine.tractor.ackermann.sd),
        _VALUE, "parallel",
    ),
    Unknown(  # twin wheels, wide tyres; one wheel an axle is 2 sd away
        "two_track", "how far an axle's wheels slip each by itself: 1 as two, 0 as one (single-track)",
        constant(1.0, 0.5), _VALUE, "two_track",
    ),
    # Natural logarithms of noise levels. Pushes last as a first-order Gauss-Markov process does, white where
    # that is less than a tick; waves of 1 to 20 m come by in 0.2 to 4 s.
    Unknown("push_t", "the ground's force across the tractor, m/s^2", level(PRIOR.disturbance[0], 1.2)),
    Unknown("push_i", "the same, implement", level(PRIOR.disturbance[1], 1.2)),
    Unknown("push_yaw", "sd of how it turns the tractor, rad/s^2", level(PRIOR.disturbance[2], 1.2)),
    Unknown("memory", "how long a push lasts, s", level(0.1, 1.0)),
    Unknown("uneven", "sd of how far uneven ground turns a body's wheels, rad", level(PRIOR.uneven, 1.2)),
    Unknown("s_yaw_rate", "factor on the sd that the machine file states", level(1.0, 0.5)),
    Unknown("s_velocity", "the same of velocities", level(1.0, 0.5)),
    Unknown("s_position", "the same of positions and headings", level(1.0, 0.5)),
    Unknown("s_roll", "the same of rolls", level(1.0, 0.5)),
    *(
        Unknown(name, "m: true less told", surveyed(k), ActsAs.SUM, name, linear=True)
        if name == "e"
        else Unknown(name, "logarithm: true over told", surveyed(k), ActsAs.FACTOR, name, linear=True)
        for k, name in enumerate(GEOMETRY)
    ),
)  # fmt: skip
"""What the data may say otherwise than the machine file, or beyond it. A new row needs nothing else where it
acts on a parameter of the motion model. What it does to a measurement is a symbol in
deploy/observation_equations.py, and what it does to the ground's noise stands in propagation.py.

model_sd: on the spatial plant such errors are left after 20 min of a field, where noise explains a tenth of
them. doubted: on steps of 30 s rolls' zeros of 10 mrad sd came out as much as 44 mrad off, latency by 47 ms,
and the gain of `steady_state` by 5 %; a side slope all the way is taken for zeros of rolls and for antennas
aside. In headland turns the tracker moves a CG by up to 15 cm."""

NAMES: Final = tuple(row.name for row in UNKNOWNS)
N_UNKNOWNS: Final = len(NAMES)
NEED_STEERING: Final = [k for k, row in enumerate(UNKNOWNS) if row.needs_steering]
NOISES: Final = NAMES[NAMES.index("push_t") : NAMES.index("s_roll") + 1]

AT: Final = {name: k for k, name in enumerate(NAMES)}
Vector = Annotated[Array, Shape((len(NAMES),))]  # in that order; of a state that is stored
Matrix = Annotated[Array, Shape((len(NAMES), len(NAMES)))]
SIX: Final = slice(0, 6)
NOISE: Final = slice(AT["push_t"], AT["s_roll"] + 1)
SHAPE: Final = slice(AT["a"], AT["I_i"] + 1)

MASSES: Final = (AT["m_t"], AT["m_i"])
"""Not learned with the six, but considered: driving shows stiffnesses over masses. What forces tell of a mass
itself goes by the small couplings between the bodies, where errors of the model are largest."""

# Indices for kernels. Of what tractor and implement have, the tractor's; the implement's is the next one.
AT_SIGMA_F: Final = AT["sigma_f"]
AT_LATENCY: Final = AT["latency"]
AT_ROLL_ZERO: Final = AT[ROLL_ZEROS[0]]
AT_YAW_RATE_DELAY: Final = AT["rate_late_t"]
AT_DISTURBANCE: Final = AT["push_t"]
AT_MEMORY: Final = AT["memory"]
AT_UNEVEN: Final = AT["uneven"]
AT_S_YAW_RATE: Final = AT["s_yaw_rate"]
AT_S_VELOCITY: Final = AT["s_velocity"]
AT_S_POSITION: Final = AT["s_position"]
AT_S_ROLL: Final = AT["s_roll"]


class Action(NamedTuple):
    """What one unknown does to one parameter."""

    unknown: int  # index into NAMES
    parameter: int  # index into rolling_terms.PARAMETERS
    transform: ActsAs
    sign: float
    least: float
    linear: bool


def _actions() -> list[Action]:
    """In the order of NAMES."""
    return [
        Action(
            k, rolling_terms.PARAMETERS.index(name.lstrip("-")), row.transform,
            -1.0 if name.startswith("-") else 1.0, row.least, row.linear,
        )
        for k, row in enumerate(UNKNOWNS)
        for name in row.acts_on.split()
    ]  # fmt: skip


# The same as arrays for kernels.
ACTIONS: Final = _actions()
ACTED_ON: Final = np.array([one.parameter for one in ACTIONS])
TRANSFORM: Final = np.array([int(one.transform) for one in ACTIONS])
SIGN: Final = np.array([one.sign for one in ACTIONS])
LEAST: Final = np.array([one.least for one in ACTIONS])
IN_LINEAR: Final = np.array([one.linear for one in ACTIONS])
ACTING: Final = np.array([one.unknown for one in ACTIONS])
FIRST_ACTION: Final = np.searchsorted(ACTING, np.arange(len(NAMES) + 1))
"""(n + 1,), of each unknown; then their number."""
_FACTOR: Final = int(ActsAs.FACTOR)
_SUM: Final = int(ActsAs.SUM)


def prior(machine: Machine) -> tuple[Array, Array]:
    """(mean [n], sd [n]) of NAMES before any data."""
    mean, sd = _prior(machine)
    return mean.copy(), sd.copy()


@once_for_a_machine
def _prior(machine: Machine) -> tuple[Array, Array]:
    mean, sd = np.array([row.prior(machine) for row in UNKNOWNS], dtype=np.float64).T
    return mean, sd


def apply(point: Array, linear: bool, p: Array, slopes: Array) -> None:
    """Change p, (32 or more,), from the nominal rolling_terms.PARAMETERS to those at a point of NAMES; fill
    slopes, of ACTIONS, with the derivative of each one's parameter by its unknown. Sums come after factors.
    linear: only what the linear model has as well. Kernels call it."""
    slopes[:] = 0.0
    for summed in (False, True):
        for k in range(len(ACTED_ON)):
            if (TRANSFORM[k] == _SUM) != summed or (linear and not IN_LINEAR[k]):
                continue
            at, value = ACTED_ON[k], point[ACTING[k]]
            if TRANSFORM[k] == _FACTOR:
                p[at] *= math.exp(value)
                slopes[k] = p[at]
            else:
                p[at] = p[at] + SIGN[k] * value if summed else value
                slopes[k] = SIGN[k] if p[at] > LEAST[k] else 0.0
            p[at] = max(p[at], LEAST[k])


def geometry(base: Array, point: Array) -> Array:
    """GEOMETRY at a point of NAMES, shape (9,). base: as `parameters.geometry_of`."""
    first = rolling_terms.PARAMETERS.index(GEOMETRY[0])
    p = np.ones(len(rolling_terms.PARAMETERS))
    p[first : first + len(GEOMETRY)] = base
    apply(point, True, p, np.zeros(len(ACTIONS)))
    return p[first : first + len(GEOMETRY)]


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
