"""The rig in space as plain data: what the machine file does not say, nominal or drawn.

Frames: tractor T and implement I at their CGs, x forward, y right, z down (SAE J670, ISO 8855). Wheels in the
order of WHEELS. What is marked "assumed" is a usual value of such a machine.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.simulator.scenario import CannotBeDriven, Scenario, Spatial
from tilth.simulator.spatial.tyre import CURVES, RELAXATIONS

Array = NDArray[np.float64]
Three = tuple[float, float, float]
"""Of front, rear and implement's axle."""

WHEELS: Final = ("front_left", "front_right", "rear_left", "rear_right", "implement_left", "implement_right")
SIDE: Final = (-1.0, 1.0)  # of left and right
GRAVITY: Final = 9.80665

STIFFNESS: Final[Three] = (250e3, 350e3, 300e3)  # N/m of each tyre: front, rear, implement
DAMPING_S: Final = 0.012  # vertical damping over stiffness, s: with the side forces 0.10 of the roll mode
TRACK: Final[Three] = (1.93, 1.93, 2.2)  # m, assumed: rows 76 inches apart, a grain cart
PIVOT_HEIGHT: Final = 0.75  # m
HITCH_HEIGHT: Final = 0.5  # m, assumed: a drawbar
ROLL_GYRATION: Final = (1.05, 0.9)  # m, assumed
PITCH_INERTIA: Final = 0.95  # over the yaw inertia, assumed: a long body
BEAM_MASS: Final = 0.07  # of the tractor's mass: front axle with its wheels, assumed
BEAM_GYRATION: Final = (0.75, 0.3)  # about the x and z axes over half the track; about y, m
RADIUS: Final = (0.65, 0.9, 0.7)  # m, of the loaded tyres, assumed

DRAWN: Final = {
    "stiffness": (0.7, 1.5), "damping": (0.5, 4.0), "pin_height": (0.2, 0.9), "hitch_height": (0.4, 0.65),
    "gyration": (0.85, 1.15), "track": (0.9, 1.1), "load_exponent": (0.5, 1.0), "camber_thrust": (0.0, 0.5),
    "grip": (0.5, 0.9), "rms": (0.0, 0.02),
}  # fmt: skip
"""From, to: of a factor on the nominal value, or of the value itself."""
OWN_STIFFNESS: Final = (0.75, 1.33)  # the same of front and implement tyres over that of the rear ones

SETTLING_DAMPING: Final = 6.0  # times that of the tyres, while the rig settles before a run
STABLE: Final = 3.6  # of (omega step)^2 + 2 (damping/mass) step; from 4 on an oscillator grows by steps


class Masses(NamedTuple):
    """What the machine file knows, SI, as the run has it: distances and heights as in docs/notation.md."""

    a: float
    b: float
    c: float
    d: float
    e: float
    m_t: float
    m_i: float
    I_t: float
    I_i: float
    h_t: float
    h_i: float


class Vehicle(NamedTuple):
    """All that the spatial plant is made of, besides ground and soil. Plain data, SI."""

    masses: Masses
    stiffness: Three  # N/m of each tyre
    damping: Three  # N s/m of each tyre
    track: Three  # m
    radius: Three  # m, of the loaded tyres
    beam_mass: float  # kg, of the front axle with its wheels
    suspension: tuple[float, float]  # N/m and N s/m between it and the tractor; zeros: rigid
    pin_height: float
    hitch_height: float
    roll_gyration: tuple[float, float]
    tyre: str  # of CURVES
    relaxation: str  # of RELAXATIONS
    load_exponent: float
    camber_thrust: float
    grip: float
    rolling: float
    combined: bool
    ackermann: float
    front_drive: float
    rms: float  # of the ground, m


def vehicle_of(masses: Masses, scenario: Scenario, rng: np.random.Generator) -> Vehicle:
    """As the scenario says, else nominal or drawn. The same numbers are drawn whatever is given."""
    given, draws = scenario.spatial, _draws(scenario.spatial, rng)
    front, rear, implement = _each(STIFFNESS, draws["stiffness"])
    drawn = (front * draws["front_stiffness"], rear, implement * draws["implement_stiffness"])
    stiffness = given.vertical_stiffness or drawn
    roll_t, roll_i = ROLL_GYRATION
    return Vehicle(
        masses,
        stiffness,
        given.vertical_damping or _each(stiffness, DAMPING_S * draws["damping"]),
        given.track or _each(TRACK, draws["track"]),
        given.radius or RADIUS,
        _first(given.axle_mass, BEAM_MASS * masses.m_t),
        given.suspension or (0.0, 0.0),
        _first(given.pin_height, draws["pin_height"]),
        _first(given.hitch_height, draws["hitch_height"]),
        given.roll_gyration or (roll_t * draws["gyration"], roll_i * draws["gyration"]),
        given.tyre or CURVES[int(draws["tyre"])],
        given.relaxation or RELAXATIONS[int(draws["relaxation"])],
        _first(given.load_exponent, draws["load_exponent"]),
        _first(given.camber_thrust, draws["camber_thrust"]),
        _first(given.grip, draws["grip"] or scenario.soil.grip),
        scenario.soil.rolling,
        given.combined,
        given.ackermann,
        given.front_drive,
        _first(scenario.ground.rms, draws["rms"]),
    )


def _each(values: Three, factor: float) -> Three:
    front, rear, implement = values
    return front * factor, rear * factor, implement * factor


def _first(given: float | None, other: float) -> float:
    return other if given is None else given


def _draws(given: Spatial, rng: np.random.Generator) -> dict[str, float]:
    """Of each name of DRAWN, and which curve and which lag."""
    drawn = {name: float(rng.uniform(*ends)) for name, ends in DRAWN.items()}
    drawn |= {"tyre": float(rng.integers(len(CURVES))), "relaxation": float(rng.integers(len(RELAXATIONS)))}
    own = ("front_stiffness", "implement_stiffness")
    drawn |= {name: float(rng.uniform(*OWN_STIFFNESS)) for name in own}
    if given.draw:
        return drawn
    plain = {"pin_height": PIVOT_HEIGHT, "hitch_height": HITCH_HEIGHT, "load_exponent": 0.8}
    ones = dict.fromkeys(("stiffness", "damping", "gyration", "track", *own), 1.0)
    return dict.fromkeys(drawn, 0.0) | ones | plain


def static_loads(vehicle: Vehicle) -> Three:
    """Loads of front, rear and implement's axle at rest on level ground, N: moments about each support."""
    m = vehicle.masses
    implement = m.m_i * GRAVITY * m.d / (m.d + m.e)
    hitch = m.m_i * GRAVITY - implement
    front = (m.m_t * GRAVITY * m.b - hitch * (m.c - m.b)) / (m.a + m.b)
    return front, m.m_t * GRAVITY + hitch - front, implement


def wheel_places(vehicle: Vehicle) -> Array:
    """Wheel centres in the frame of T or, the last two, I, at rest, shape (6, 3), m."""
    m = vehicle.masses
    along = np.repeat([m.a, -m.b, -m.e], 2)
    across = np.array([SIDE[k % 2] * vehicle.track[k // 2] / 2 for k in range(6)])
    down = np.repeat(np.array([m.h_t, m.h_t, m.h_i]) - vehicle.radius, 2)
    return np.column_stack([along, across, down])


def check_tyres(vehicle: Vehicle, step: float) -> None:
    """Raises CannotBeDriven where the tyres do not hold the rig upright, or where steps of `step` s are too
    long for them."""
    m = vehicle.masses
    arm = m.h_t - m.b / (m.a + m.b) * vehicle.pin_height  # the front axle swings on its pin
    for k, name, moment in ((1, "tractor", m.m_t * arm), (2, "implement", m.m_i * m.h_i)):
        least, given = 2 * GRAVITY * moment / vehicle.track[k] ** 2, vehicle.stiffness[k]
        if given <= least:
            raise CannotBeDriven(
                f"spatial.vertical_stiffness[{k + 1}] = {given:g} N/m does not hold the {name} upright; "
                f"give more than {1e3 * math.ceil(least / 1e3):.0f}, or a wider track"
            )
    for k, name in enumerate(("front", "rear", "implement's")):
        mass = _moved_by_a_tyre(vehicle, k)
        square, damped = vehicle.stiffness[k] / mass, SETTLING_DAMPING * vehicle.damping[k] / mass
        longest = STABLE / (damped + math.sqrt(damped**2 + STABLE * square))
        if step > longest:
            cure = (
                f"give spatial.step = {math.floor(1e5 * longest) / 1e5:g}, or " if longest > 2e-4 else "give "
            )
            raise CannotBeDriven(
                f"the {name} tyres are too stiff, or damped too much, for steps of {step:g} s; {cure}smaller "
                f"spatial.vertical_stiffness[{k + 1}] and vertical_damping[{k + 1}]"
            )


def _moved_by_a_tyre(vehicle: Vehicle, k: int) -> float:
    """The least mass that one tyre of an axle moves up and down, kg: both alike, or against each other."""
    m = vehicle.masses
    if k == 0:
        return vehicle.beam_mass * BEAM_GYRATION[0] ** 2 / 2  # the axle rolls by itself
    mass, yaw, arm, roll = (
        (m.m_t, m.I_t, m.b, vehicle.roll_gyration[0])
        if k == 1
        else (m.m_i, m.I_i, m.e, vehicle.roll_gyration[1])
    )
    alike = 1 / (1 / mass + arm**2 / (PITCH_INERTIA * yaw)) / 2
    return min(alike, 2 * mass * (roll / vehicle.track[k]) ** 2)
