"""Every parameter of the models: unit, range, default and source; and the rig that a machine file describes.

Defaults are the dissertation's Table 5.1 (Karkee 2009) where it has them. Its Table 7.2 differs in the three
relaxation lengths only; both sets are used, for different chapters. What the tables do not give is marked
"assumed": a usual value of such a machine, to be replaced by what was measured.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.models.upright import AxleUpright, axles_upright, hitch_height
from tilth.schemas.axle_loads import axle_loads
from tilth.schemas.flow import PARAMETERS
from tilth.schemas.limits import LIMITS
from tilth.schemas.machine import Machine

Array = NDArray[np.float64]


class Parameter(NamedTuple):
    """One row: `low` and `high` bound what a rig can sensibly have, inclusive."""

    name: str  # in code
    symbol: str  # in docs/notation.md and in print
    unit: str
    low: float
    high: float
    default: float
    meaning: str
    source: str


GEOMETRY: Final = ("a", "b", "c", "d", "e", "m_t", "m_i", "I_t", "I_i")
"""Distances (m), masses (kg) and yaw inertias (kg m^2), in the order of every array `geometry`."""

_AT = {key: row.range for key, row in LIMITS.items()}  # of the machine file: it is refused beyond them
_STIFFNESS = _AT["tyres.cornering_stiffness"]
_RELAXATION = _AT["tyres.relaxation_length"]
_T = "Table 5.1"
_FILE = "machine file; default of deploy/machines/jd7930-parker500.toml"
_CART = "machine file; default: a grain cart"
_ROW = "machine file; default: tyres 76 inches apart, as on row crops"
_GRIP = "assumed: tyre on firm soil; eq. 5.34, where it is A"
_ROLL = "ASABE D497, motion resistance ratio of firm soil without slip, 1/55 + 0.04"

RIG_PARAMETERS: Final = (
    Parameter("a", "a", "m", *_AT["tractor.a"], 1.7, "tractor's CG to its front axle", _T),
    Parameter("b", "b", "m", *_AT["tractor.b"], 1.2, "tractor's CG to its rear axle", _T),
    Parameter("c", "c", "m", *_AT["tractor.c"], 2.1, "tractor's CG to the hitch, behind", _T),
    Parameter("d", "d", "m", *_AT["implement.d"], 3.62, "hitch to the implement's CG", _T),
    Parameter("e", "e", "m", *_AT["implement.e"], 0.1, "implement's CG to its axle, behind", _T),
    Parameter("m_t", "m^t", "kg", *_AT["tractor.mass"], 9391.0, "mass of the tractor", _T),
    Parameter("m_i", "m^i", "kg", *_AT["implement.mass"], 2127.0,
              "mass of the implement with its load", _T),
    Parameter("I_t", "I_z^t", "kg m^2", *_AT["tractor.yaw_inertia"], 35709.0,
              "yaw inertia of the tractor about its CG", _T),
    Parameter("I_i", "I_z^i", "kg m^2", *_AT["implement.yaw_inertia"], 6402.0,
              "yaw inertia of the implement about its CG", _T),
    Parameter("C_af", "C_αf", "N/rad", *_STIFFNESS, 220e3, "cornering stiffness, tractor's front axle", _T),
    Parameter("C_ar", "C_αr", "N/rad", *_STIFFNESS, 486e3, "cornering stiffness, tractor's rear axle", _T),
    Parameter("C_ai", "C_αi", "N/rad", *_STIFFNESS, 167e3, "cornering stiffness, implement's axle", _T),
    Parameter("sigma_f", "σ_f", "m", *_RELAXATION, 0.75, "relaxation length, tractor's front tyres", _T),
    Parameter("sigma_r", "σ_r", "m", *_RELAXATION, 1.0, "relaxation length, tractor's rear tyres", _T),
    Parameter("sigma_i", "σ_i", "m", *_RELAXATION, 0.75, "relaxation length, implement's tyres", _T),
    Parameter("h_t", "h^t", "m", *_AT["tractor.cg_height"], 1.1, "height of the tractor's CG", _FILE),
    Parameter("h_i", "h^i", "m", *_AT["implement.cg_height"], 1.2, "height of the implement's CG", _FILE),
    Parameter("h_h", "h_p", "m", 0.1, 1.5, 0.5, "height of the hitch", "machine file; default: a drawbar"),
    Parameter("w_f", "w_f", "m", 0.8, 5.2, 1.93, "track width, tractor's front axle", _ROW),
    Parameter("w_r", "w_r", "m", 0.8, 5.2, 1.93, "track width, tractor's rear axle", _ROW),
    Parameter("w_i", "w_i", "m", 0.8, 6.0, 2.5, "track width, implement", _CART),
    Parameter("roll_share_f", "–", "1", 0.0, 1.0, 0.1, "share of the tractor's roll moment that its front "
              "axle carries", "assumed: the axle swings on a pivot until it meets its stop"),
    Parameter("grip_f", "A_f", "1", 0.1, math.inf, 0.7, "largest lateral over vertical force, front", _GRIP),
    Parameter("grip_r", "A_r", "1", 0.1, math.inf, 0.7, "the same, rear; infinite: a linear tyre", _GRIP),
    Parameter("grip_i", "A_i", "1", 0.1, math.inf, 0.7, "the same, implement", _GRIP),
    Parameter("load_exponent", "n", "1", 0.0, 1.0, 0.8, "stiffness of a wheel grows with its load to this "
              "power", "assumed: tyres are degressive; 1 is eq. 5.34 as printed, 0 a stiffness without load"),
    Parameter("roll_f", "f_f", "1", 0.0, 0.5, 0.058, "rolling resistance over load, front", _ROLL),
    Parameter("roll_r", "f_r", "1", 0.0, 0.5, 0.058, "rolling resistance over load, rear", _ROLL),
    Parameter("roll_i", "f_i", "1", 0.0, 0.5, 0.058, "rolling resistance over load, implement", _ROLL),
    Parameter("front_drive", "–", "1", 0.0, 1.0, 0.0, "share of the drive force on the front axle",
              "assumed: rear-wheel drive"),
    Parameter("drive_gain", "k_u", "N s/m", 0.0, 1e6, 60e3, "drive force for each m/s that is missing; 0: no "
              "control of speed", "assumed: a transmission that holds its speed, some 0.2 s"),
    Parameter("drive_limit", "–", "N", 0.0, 500e3, 40e3, "largest drive or braking force", "assumed: four "
              "tenths of the tractor's weight"),
    Parameter("g", "g", "m/s^2", 9.76, 9.84, 9.80665, "gravity", "ISO 80000-3, standard"),
)  # fmt: skip
"""In the order of the fields of Rig."""


class Rig(NamedTuple):
    """A machine on its soil: all that the models need, in the units of RIG_PARAMETERS. Plain data.

    The kernels are compiled for floats: give floats, or pass the rig through `checked`.
    """

    a: float
    b: float
    c: float
    d: float
    e: float
    m_t: float
    m_i: float
    I_t: float
    I_i: float
    C_af: float
    C_ar: float
    C_ai: float
    sigma_f: float
    sigma_r: float
    sigma_i: float
    h_t: float
    h_i: float
    h_h: float
    w_f: float
    w_r: float
    w_i: float
    roll_share_f: float
    grip_f: float
    grip_r: float
    grip_i: float
    load_exponent: float
    roll_f: float
    roll_r: float
    roll_i: float
    front_drive: float
    drive_gain: float
    drive_limit: float
    g: float

    @property
    def geometry(self) -> Array:
        """In the order of GEOMETRY, shape (9,)."""
        return np.array([getattr(self, name) for name in GEOMETRY])

    @property
    def theta(self) -> Array:
        """The six soil-tyre parameters in the order of schemas.flow.PARAMETERS, shape (6,)."""
        return np.array([getattr(self, name) for name in PARAMETERS])

    @property
    def wheelbase(self) -> float:
        """L^t, m."""
        return self.a + self.b

    @property
    def towed_length(self) -> float:
        """L^i, hitch to the implement's axle, m."""
        return self.d + self.e


assert Rig._fields == tuple(row.name for row in RIG_PARAMETERS)

TABLE_5_1: Final = Rig(*(row.default for row in RIG_PARAMETERS))
TABLE_7_2: Final = TABLE_5_1._replace(sigma_f=1.1, sigma_r=1.5, sigma_i=1.1)


def rig_of(machine: Machine) -> Rig:
    """The rig of a machine file, with its priors as soil-tyre parameters and defaults for the rest.

    Raises ValueError, as `checked`.
    """
    tractor, implement, tyres = machine.tractor, machine.implement, machine.tyres
    axles = (tyres.front, tyres.rear, tyres.implement)
    front, rear, towed = upright_axles(machine)
    return checked(
        TABLE_5_1._replace(
            **dict(zip(GEOMETRY, geometry_of(machine).tolist(), strict=True)),
            **dict(zip(PARAMETERS[:3], (t.cornering_stiffness for t in axles), strict=True)),
            **dict(zip(PARAMETERS[3:], (t.relaxation_length for t in axles), strict=True)),
            h_t=tractor.cg_height.value,
            h_i=implement.cg_height.value,
            h_h=hitch_height(machine, TABLE_5_1.h_h).value,
            w_f=front.track,
            w_r=rear.track,
            w_i=towed.track,
        )
    )


def upright_axles(machine: Machine) -> tuple[AxleUpright, AxleUpright, AxleUpright]:
    """Of front, rear and implement's axle, by the machine file and the tracks of TABLE_5_1."""
    return axles_upright(machine, (TABLE_5_1.w_f, TABLE_5_1.w_r, TABLE_5_1.w_i))


def geometry_of(machine: Machine) -> Array:
    """The values of a machine file in the order of GEOMETRY, shape (9,)."""
    tractor, implement = machine.tractor, machine.implement
    quantities = (
        tractor.a, tractor.b, tractor.c, implement.d, implement.e,
        tractor.mass, implement.mass, tractor.yaw_inertia, implement.yaw_inertia,
    )  # fmt: skip
    return np.array([quantity.value for quantity in quantities])


def checked(rig: Rig) -> Rig:
    """The rig, all floats. Raises ValueError that names the first parameter out of its range."""
    for row, value in zip(RIG_PARAMETERS, rig, strict=True):
        if not row.low <= value <= row.high:
            raise ValueError(
                f"{row.name} = {value:g} {row.unit}: {row.meaning} must be from {row.low:g} to {row.high:g}"
            )
    loads = static_loads(rig)
    if min(loads) <= 0:
        axle = ("tractor's front", "tractor's rear", "implement's")[loads.index(min(loads))]
        raise ValueError(f"the {axle} axle would stand off the ground: check a, b, c, d, e and both masses")
    return Rig(*map(float, rig))


def static_loads(rig: Rig) -> tuple[float, float, float]:
    """Vertical loads of the three axles on level ground, N: front, rear, implement."""
    return axle_loads(rig.a, rig.b, rig.c, rig.d, rig.e, rig.m_t, rig.m_i, rig.g)
