"""A fleet of rigs as farms have them, for tests on rigs of any size: one seed, one rig.

`drawn(seed)` draws tractor, implement and load, tyres, soil and sensors from the ranges of
simulator/fleet_ranges.py. `scenario_of` puts the rig into a scenario, for either plant;
simulator/fleet_files.py writes its machine file. SI; angles in degrees where the name says so.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple, get_args

import numpy as np

from tilth.schemas.axle_loads import axle_loads
from tilth.schemas.flow import Mount
from tilth.simulator import noise
from tilth.simulator.fleet_ranges import ANY, CHANCES, IMPLEMENTS, RANGES, TRACTORS
from tilth.simulator.noise import generator
from tilth.simulator.scenario import (
    Ground,
    HeadlandTurn,
    Lag,
    Parameter,
    PlanarKey,
    RollSensor,
    Scenario,
    Spatial,
    SurveyErrors,
    TyreCurve,
    Wheel,
)
from tilth.simulator.spatial.vehicle import GRAVITY, Masses, Three

LEAST_FRONT: Final = 0.2  # of the tractor's weight on its front axle, which makers ask for
MOST_TOWED: Final = 1.5  # implement's over tractor's mass, as implements' manuals allow
HEAVIEST: Final = 12_000.0  # kg, of an implement
TRIES: Final = 1000
OWN_STIFFNESS_SD: Final = 0.2  # of an axle about that of the soil, natural logarithm
GAIN_SD: Final = 0.01  # of the wheel sensor
ZERO_DEG: Final = 0.5  # of the wheel sensor, sd
LEAST_RADIUS: Final = 5.0  # m, of a headland turn
TURN_DEG: Final = 20.0  # of the wheels in it, at most
FOLDING: Final = 1.5  # radius over the towed length, at least
PER_CM: Final = (0.7, 0.015)  # of the planar plant's ground for each cm of rms: roll, degrees, and force_sd


class FleetTyres(NamedTuple):
    """Of one axle."""

    track: float  # m; of dual wheels between the inner ones
    twin_spacing: float  # m, from the inner to the outer of dual wheels; 0: single ones
    radius: float  # m, loaded
    deflection: float  # m, under this load
    load: float  # N, of the axle at rest

    @property
    def stiffness(self) -> float:
        """Of all tyres of one side, N/m."""
        return 0.5 * self.load / self.deflection

    @property
    def spring_track(self) -> float:
        """Track of single wheels whose springs hold the body as these do, m."""
        return math.hypot(self.track + self.twin_spacing, self.twin_spacing)


class FleetTractor(NamedTuple):
    """A tractor as it stands: with ballast."""

    kind: str  # of TRACTORS
    a: float
    b: float
    c: float
    mass: float
    yaw_inertia: float
    cg_height: float
    roll_gyration: float
    ballast: tuple[float, float]  # kg of front weights, m ahead of the front axle
    axle_mass: float  # kg, front axle with wheels
    pin_height: float
    hitch_height: float
    suspension: tuple[float, float] | None  # Hz and damping ratio of a suspended front axle
    ackermann: float
    front_drive: float


class FleetImplement(NamedTuple):
    """An implement with its load."""

    kind: str  # of IMPLEMENTS
    fill: float  # 0 empty, 1 full
    d: float
    e: float
    mass: float
    yaw_inertia: float
    cg_height: float
    roll_gyration: float
    full_mass: float


@dataclass(frozen=True, slots=True)
class FleetRig:
    """All that is true of a rig: what `drawn` draws."""

    seed: int
    tractor: FleetTractor
    implement: FleetImplement
    tyres: tuple[FleetTyres, FleetTyres, FleetTyres]  # front, rear, implement
    vertical_damping: float  # s, over stiffness
    parameters: Mapping[Parameter, float]
    curve: TyreCurve
    relaxation: Lag
    load_exponent: float
    camber_thrust: float
    grip: float
    rolling: float
    places: Mapping[Mount, tuple[float, float, float]]  # of antennas: forward and right of the CG, up, m
    roll_corrected: bool  # the tractor's receivers
    latency_s: Mapping[Mount, float]
    wheel: Wheel
    speed: float
    base_jump: float  # m, of all positions

    @property
    def masses(self) -> Masses:
        t, i = self.tractor, self.implement
        return Masses(t.a, t.b, t.c, i.d, i.e, t.mass, i.mass, t.yaw_inertia, i.yaw_inertia, t.cg_height,
                      i.cg_height)  # fmt: skip


class _Draws:
    """Uniform numbers from the ranges."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng

    def of(self, name: str, kind: str = ANY) -> float:
        row = next(row for row in RANGES if (row.of, row.name) == (kind, name))
        return float(self.rng.uniform(row.low, row.high))

    def one_of(self, words: Any) -> Any:
        """One of a Literal's."""
        return str(self.rng.choice(get_args(words)))

    def happens(self, name: str, kind: str) -> bool:
        chances = [row.low for row in CHANCES if row.name == name and row.of in (kind, ANY)]
        return bool(self.rng.random() < (chances[0] if chances else 0.0))


def drawn(seed: int) -> FleetRig:
    """Rig number `seed` of the fleet, drawn anew until the tractor can tow the implement."""
    draws = _Draws(generator(seed, noise.FLEET))
    for _ in range(TRIES):
        tractor, implement = _tractor(draws), _implement(draws)
        loads = loads_of(tractor, implement)
        able = implement.mass <= min(MOST_TOWED * tractor.mass, HEAVIEST)
        if able and loads[0] >= LEAST_FRONT * tractor.mass * GRAVITY:
            return _equipped(seed, draws, tractor, implement, loads)
    raise AssertionError("the fleet's ranges leave no rig that can be driven")


def loads_of(tractor: FleetTractor, implement: FleetImplement) -> Three:
    """Of front, rear and implement's axle at rest, N."""
    t, i = tractor, implement
    return axle_loads(t.a, t.b, t.c, i.d, i.e, t.mass, i.mass, GRAVITY)


def _tractor(draws: _Draws) -> FleetTractor:
    kind = str(draws.rng.choice(TRACTORS))
    bare, base, front_share = draws.of("mass", kind), draws.of("wheelbase", kind), draws.of("front_share")
    inertia = bare * (draws.of("tractor_gyration") * base) ** 2
    share, ahead = draws.of("ballast_share"), draws.of("ballast_ahead")
    weights = share * bare if draws.happens("ballasted", kind) else 0.0
    mass, b_bare = bare + weights, front_share * base
    b = (bare * b_bare + weights * (base + ahead)) / mass
    inertia += bare * (b - b_bare) ** 2 + weights * (base + ahead - b) ** 2
    suspension = draws.of("suspension_hz"), draws.of("suspension_damping")
    radius = draws.of("front_radius", kind)
    front_drive = draws.of("front_drive")
    return FleetTractor(
        kind,
        base - b,
        b,
        b + draws.of("hitch_behind", kind),
        mass,
        inertia,
        draws.of("cg_height", kind),
        draws.of("tractor_roll") * draws.of("rear_track", kind),
        (weights, ahead if weights else 0.0),
        draws.of("axle_share") * bare,
        draws.of("pin_share") * radius,
        draws.of("hitch_height"),
        suspension if draws.happens("suspended", kind) else None,
        draws.of("ackermann"),
        front_drive if draws.happens("driven_in_front", kind) else 0.0,
    )


def _implement(draws: _Draws) -> FleetImplement:
    """A third of them empty, a third full."""
    kind = str(draws.rng.choice(IMPLEMENTS))
    fill = float(draws.rng.choice([0.0, 1.0, draws.rng.uniform(0.1, 0.9)]))
    empty, full, length = (draws.of(name, kind) for name in ("empty", "full", "hitch_to_axle"))
    tongue = np.interp(fill, [0.0, 1.0], [draws.of("empty_tongue"), draws.of("full_tongue")])
    height = np.interp(fill, [0.0, 1.0], [draws.of("empty_height", kind), draws.of("full_height", kind)])
    mass = empty + fill * (full - empty)
    e = float(tongue) * length
    return FleetImplement(
        kind, fill, length - e, e, mass, mass * (draws.of("gyration", kind) * length) ** 2, float(height),
        draws.of("implement_roll") * draws.of("track", kind), full,
    )  # fmt: skip


def _equipped(
    seed: int, draws: _Draws, tractor: FleetTractor, implement: FleetImplement, loads: Three
) -> FleetRig:
    tyres = _tyres(draws, tractor, implement, loads)
    soil = math.log(draws.of("cornering"))
    own = np.exp(soil + OWN_STIFFNESS_SD * np.clip(draws.rng.standard_normal(3), -2.0, 2.0))
    front, rear, cart = (float(c * tyre.load) for c, tyre in zip(own, tyres, strict=True))
    sigmas = [draws.of("relaxation") * tyre.radius for tyre in tyres]
    wheel = Wheel(
        zero_deg=float(np.clip(draws.rng.normal(0.0, ZERO_DEG), -2 * ZERO_DEG, 2 * ZERO_DEG)),
        gain=1.0 + GAIN_SD * float(np.clip(draws.rng.standard_normal(), -2.0, 2.0)),
        dead_band_deg=draws.of("play"),
        bend=draws.of("bend"),
    )
    return FleetRig(
        seed, tractor, implement, tyres, draws.of("vertical_damping"),
        {"C_af": front, "C_ar": rear, "C_ai": cart, "sigma_f": sigmas[0], "sigma_r": sigmas[1],
         "sigma_i": sigmas[2]},
        draws.one_of(TyreCurve), draws.one_of(Lag), draws.of("load_exponent"),
        draws.of("camber_thrust"), draws.of("grip"), draws.of("rolling"), _places(draws, tractor, implement),
        draws.happens("roll_corrected", tractor.kind), {mount: draws.of("latency") for mount in Mount}, wheel,
        draws.of("speed"), draws.of("base_jump") * draws.happens("base_moves", tractor.kind),
    )  # fmt: skip


def _tyres(
    draws: _Draws, tractor: FleetTractor, implement: FleetImplement, loads: Three
) -> tuple[FleetTyres, FleetTyres, FleetTyres]:
    spacing = draws.of("twin_spacing")
    twin = spacing if draws.happens("duals", tractor.kind) else 0.0
    given = draws.of("implement_deflection") * implement.mass / implement.full_mass
    front, rear, cart = loads
    kind = tractor.kind
    return (
        FleetTyres(draws.of("front_track", kind), 0.0, draws.of("front_radius", kind),
                   draws.of("front_deflection"), front),
        FleetTyres(draws.of("rear_track", kind), twin, draws.of("rear_radius", kind),
                   draws.of("rear_deflection"), rear),
        FleetTyres(draws.of("track", implement.kind), 0.0, draws.of("radius", implement.kind), given, cart),
    )  # fmt: skip


def _places(
    draws: _Draws, tractor: FleetTractor, implement: FleetImplement
) -> dict[Mount, tuple[float, float, float]]:
    """Two antennas on each body, the rear one of the tractor on its cab, above the rear axle."""
    apart = min(draws.of("antennas_apart"), tractor.a + tractor.b)
    rear = -tractor.b + float(draws.rng.uniform(-0.1, 0.4))
    span = min(draws.of("antennas_apart"), implement.d + implement.e - 0.8)
    behind = -implement.e - float(draws.rng.uniform(0.2, 0.7)) * span

    def up(cg_height: float, above: str) -> float:
        return cg_height + draws.of(above)

    t, i = tractor.cg_height, implement.cg_height
    return {
        Mount.TRACTOR_FRONT: (rear + apart, 0.0, up(t, "roof")),
        Mount.TRACTOR_REAR: (rear, 0.0, up(t, "roof")),
        Mount.IMPLEMENT_FRONT: (behind + span, 0.0, up(i, "mast")),
        Mount.IMPLEMENT_REAR: (behind, 0.0, up(i, "mast")),
    }


# Into a scenario.


def scenario_of(rig: FleetRig, scenario: Scenario) -> Scenario:
    """The scenario with this rig, its soil and its sensors. What differs from place to place stays."""
    soil = replace(scenario.soil, parameters=rig.parameters, grip=rig.grip, rolling=rig.rolling)
    of_plant = {"spatial": _spatial(rig)} if scenario.plant == "spatial" else {"planar": _planar(rig)}
    return replace(
        scenario,
        rig_seed=rig.seed,
        soil=soil,
        survey=SurveyErrors(0.0, 0.0, 0.0, 0.0),  # the machine is the true one; its file has the errors
        wheel=rig.wheel,
        roll_sensor=RollSensor(draw=True),
        latency_s=rig.latency_s,
        link=replace(scenario.link, base_jump=rig.base_jump),
        **of_plant,
    )


def ground_of(scenario_plant: str, rms: float, slope_deg: float, downhill_deg: float = 90.0) -> Ground:
    """Ground of so much roughness, m, on either plant; on the planar one a rut of usual pushes."""
    if scenario_plant == "spatial":
        return Ground(slope_deg=slope_deg, downhill_deg=downhill_deg, rms=rms)
    roll, force = (100.0 * rms * each for each in PER_CM)
    return Ground(slope_deg=slope_deg, downhill_deg=downhill_deg, roll_sd_deg=roll, force_sd=force, rut=True)


def headlands_of(rig: FleetRig) -> tuple[HeadlandTurn, HeadlandTurn]:
    """A U and a loop that the wheels can turn and the implement can follow."""
    towed, base = rig.implement.d + rig.implement.e, rig.tractor.a + rig.tractor.b
    radius = max(LEAST_RADIUS, FOLDING * towed, base / math.tan(math.radians(TURN_DEG)))
    return HeadlandTurn(2.1 * radius, radius), HeadlandTurn(6.1, radius)


def _spatial(rig: FleetRig) -> Spatial:
    tractor = rig.tractor
    front, rear, cart = rig.tyres
    stiffness = (front.stiffness, rear.stiffness, cart.stiffness)
    return Spatial(
        vertical_stiffness=stiffness,
        vertical_damping=(
            rig.vertical_damping * front.stiffness,
            rig.vertical_damping * rear.stiffness,
            rig.vertical_damping * cart.stiffness,
        ),
        track=(front.spring_track, rear.spring_track, cart.spring_track),
        radius=(front.radius, rear.radius, cart.radius),
        axle_mass=tractor.axle_mass,
        suspension=_suspension(tractor, front.load),
        pin_height=tractor.pin_height,
        hitch_height=tractor.hitch_height,
        roll_gyration=(tractor.roll_gyration, rig.implement.roll_gyration),
        tyre=rig.curve,
        relaxation=rig.relaxation,
        load_exponent=rig.load_exponent,
        camber_thrust=rig.camber_thrust,
        grip=rig.grip,
        ackermann=tractor.ackermann,
        front_drive=tractor.front_drive,
    )


def _suspension(tractor: FleetTractor, front_load: float) -> tuple[float, float] | None:
    """N/m and N s/m."""
    if tractor.suspension is None:
        return None
    hertz, damping = tractor.suspension
    sprung, omega = front_load / GRAVITY - tractor.axle_mass, 2 * math.pi * hertz
    return sprung * omega**2, 2 * damping * sprung * omega


def _planar(rig: FleetRig) -> dict[PlanarKey, float]:
    front, rear, cart = rig.tyres
    return {
        "w_f": front.spring_track,
        "w_r": rear.spring_track,
        "w_i": cart.spring_track,
        "h_h": rig.tractor.hitch_height,
        "load_exponent": rig.load_exponent,
        "front_drive": rig.tractor.front_drive,
    }
