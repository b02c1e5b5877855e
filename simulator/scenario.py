"""A scenario: how the virtual tractor is driven, over which ground and soil, and what is out of order.

One TOML text with the keys of `Scenario`; the ones that have several parts are tables. SI and radians, except
where the key says degrees. A wrong one raises ScenarioError in one sentence. The files in examples/scenarios
show every key in use.
"""

import difflib
import tomllib
from collections.abc import Collection, Mapping
from typing import Annotated, Any, Final, Literal

from pydantic import BeforeValidator, ConfigDict, Discriminator, Field, Tag, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass

from tilth.schemas.file_problem import sentence
from tilth.schemas.flow import Mount


class ScenarioError(Exception):
    """The scenario is wrong; the text says where and what to do."""


class CannotBeDriven(ValueError):
    """The scenario asks too much of this machine; the text says what, and what to change."""


ORIGIN_DEG: Final = (42.0267, -93.6465)  # latitude and longitude
STEP_S: Final = 0.01  # between samples of a simulated run
_CONFIG: Final = ConfigDict(extra="forbid", allow_inf_nan=False)

Share = Annotated[float, Field(ge=0, le=1)]
NotNegative = Annotated[float, Field(ge=0)]
Positive = Annotated[float, Field(gt=0)]
Factor = Annotated[float, Field(ge=0.05, le=20)]
Duration = Annotated[float, Field(gt=0, le=86_400)]
Degrees = Annotated[float, Field(ge=-360, le=360)]
Angle = Annotated[float, Field(ge=-45, le=45)]  # of wheels, degrees
Speed = Annotated[float, Field(ge=-4, le=15)]
Stiffness = Annotated[float, Field(ge=20e3, le=20e6)]
Track = Annotated[float, Field(ge=0.8, le=6)]
Gyration = Annotated[float, Field(ge=0.2, le=3)]
Radius = Annotated[float, Field(ge=0.2, le=1.5)]
Wave = Annotated[float, Field(ge=0.3, le=1000)]
Instant = Annotated[int, Field(ge=946_684_800_000_000_000, le=4_102_444_800_000_000_000)]  # ns; 2000 to 2100
ClockOffset = Annotated[float, Field(ge=-1e8, le=1e8)]  # s; three years
TyreCurve = Literal["exponential", "tanh", "brush", "magic"]
Lag = Literal["first_order", "string"]
Parameter = Literal["C_af", "C_ar", "C_ai", "sigma_f", "sigma_r", "sigma_i"]
FaultKind = Literal["silent", "not_available", "repeat", "late", "moved", "rtk_float", "dgnss", "gnss"]


# How it is steered.


def _target(raw: Any) -> Any:
    if isinstance(raw, str) and raw != "random":
        raise ValueError('give degrees, or "random"')
    return None if raw == "random" else raw


Segments = Annotated[
    tuple[tuple[Duration, Annotated[Angle | None, BeforeValidator(_target)]], ...], Field(min_length=1)
]
"""((seconds, wheel angle in degrees, or None, in TOML "random", for random steering), …), repeated"""


@dataclass(frozen=True, slots=True, config=_CONFIG)
class Turns:
    """Straight stretches and steady turns to alternating sides, then random steering; repeated."""

    kind: Literal["turns"] = "turns"
    turns: Annotated[int, Field(ge=1, le=100)] = 6
    angle_deg: tuple[Positive, Angle] = (5.0, 8.0)  # of the wheels, each turn's drawn between
    hold: tuple[Positive, Positive] = (10.0, 11.0)  # s
    straight: tuple[Positive, Positive] = (2.0, 2.4)  # s


@dataclass(frozen=True, slots=True, config=_CONFIG)
class DrivenManoeuvre:
    """A row of estimator.manoeuvres, the wheels no faster than they can turn."""

    kind: Literal["step", "steps", "chirp", "random"]
    amplitude_deg: Annotated[float, Field(gt=0, le=45)] = 8.0


@dataclass(frozen=True, slots=True, config=_CONFIG)
class Autosteer:
    """Steering in rows by one of simulator/autosteers.py, instead of by a regulator that knows the state."""

    make: Literal["pid", "valve", "pursuit", "manual"]
    own: Annotated[float, Field(ge=0, le=5)] = 1.0  # factor on its own errors, dead bands and steps
    dither_deg: Annotated[float, Field(ge=0, le=2)] = 0.0  # sd of what it adds to the wheel angle it wants
    slack_deg: Annotated[float, Field(ge=0, le=1)] = 0.0  # of a "valve", besides what `own` makes


@dataclass(frozen=True, slots=True, config=_CONFIG)
class RowSteering:
    """Automatic steering along a row that runs north from the start."""

    kind: Literal["row"] = "row"
    offset: Annotated[float, Field(ge=-30, le=30)] = 0.0  # m, of the row to the right of the start
    heading_deg: Annotated[float, Field(ge=-60, le=60)] = 0.0  # of the rig at the start
    position_sd: NotNegative = 0.02  # m, slow error of the position that steering believes
    autosteer: Autosteer | None = None


@dataclass(frozen=True, slots=True, config=_CONFIG)
class HeadlandTurn:
    """From one row to the next one: a U, or a loop where the rows are closer than two radii, or a quarter
    turn, some metres back, and another quarter turn."""

    spacing: Annotated[float, Field(ge=1, le=100)] = 6.1  # m, to the next row
    radius: Annotated[float, Field(ge=4, le=50)] = 6.0  # m, of the tractor's rear axle
    reversal: bool = False


@dataclass(frozen=True, slots=True, config=_CONFIG)
class Fieldwork:
    """Rows to and fro, each next one to the east, with headland turns by hand between them."""

    kind: Literal["field"] = "field"
    length: Annotated[float, Field(ge=10, le=10_000)] = 200.0  # m, of the rows, from turn to turn
    spacing: Annotated[float, Field(ge=1, le=100)] = 6.1  # m; closer than two radii needs a loop
    turn_radius: Annotated[float, Field(ge=5, le=50)] = 6.0  # m, of the tractor's rear axle
    turn_speed: Annotated[float, Field(ge=0.5, le=5)] = 2.0  # m/s
    turns: tuple[HeadlandTurn, ...] = ()  # in this order, repeated; instead of spacing and turn_radius
    position_sd: NotNegative = 0.02  # as of Row
    autosteer: Autosteer | None = None  # in the rows


_KINDS: Final = ("turns", "step", "steps", "chirp", "random", "row", "field")
_SAY_KIND: Final = f"give rows of [seconds, degrees], or a table whose kind is one of {', '.join(_KINDS)}"
_MANOEUVRES: Final = ("step", "steps", "chirp", "random")


def _rows_or_number(raw: Any) -> str:
    return "rows" if isinstance(raw, (list, tuple)) else "number"


Speeds = Annotated[
    Annotated[Speed, Tag("number")]
    | Annotated[tuple[tuple[Duration, Speed], ...], Field(min_length=1), Tag("rows")],
    Discriminator(_rows_or_number),
]
"""m/s, or ((seconds, m/s), …), repeated"""


def _kind(raw: Any) -> str | None:
    if isinstance(raw, (list, tuple)):
        return "segments"
    kind = raw.get("kind") if isinstance(raw, dict) else getattr(raw, "kind", None)
    return "manoeuvre" if kind in _MANOEUVRES else kind


Steering = Annotated[
    Annotated[Segments, Tag("segments")]
    | Annotated[Turns, Tag("turns")]
    | Annotated[DrivenManoeuvre, Tag("manoeuvre")]
    | Annotated[RowSteering, Tag("row")]
    | Annotated[Fieldwork, Tag("field")],
    Discriminator(_kind, custom_error_type="kind", custom_error_message=_SAY_KIND),
]


# Over what it drives.


@dataclass(frozen=True, slots=True, config=_CONFIG)
class Bump:
    """One bump, flat on top, its sides along north and east; a negative height makes a hole. Lengths in m."""

    north: float  # of its middle
    east: float
    height: Annotated[float, Field(ge=-0.3, le=0.3)]
    length: Annotated[float, Field(ge=0.1, le=1000)] = 1.0  # to north
    width: Annotated[float, Field(ge=0.1, le=1000)] = 0.8  # to east
    ramp: Annotated[float, Field(ge=0.05, le=10)] = 0.3  # of its sides, within length and width


@dataclass(frozen=True, slots=True, config=_CONFIG)
class Ground:
    """A side slope, as a plane, and what is uneven on it: of the planar plant waves along the way that roll
    and push both bodies, of the spatial one a height field with a continuous spectrum."""

    slope_deg: Annotated[float, Field(ge=0, le=15)] = 0.0
    downhill_deg: Degrees = 90.0  # direction in which the plane falls, clockwise from north
    roll_sd_deg: Annotated[float, Field(ge=0, le=5)] = 0.0  # of either body on uneven ground
    force_sd: Annotated[float, Field(ge=0, le=0.3)] = 0.0  # of the force across either body, over its weight
    band: tuple[Positive, Positive] = (3.0, 30.0)  # m, shortest and longest wave; of roll 5 times these
    rut: bool = False  # whether force_sd is of one rut that each axle meets in its turn; else of both CGs
    rms: Annotated[float, Field(ge=0, le=0.1)] | None = None  # m, of the height field; None: even, or drawn
    waves: tuple[Wave, Wave] = (1.0, 20.0)  # m, its shortest and longest wave
    bumps: tuple[Bump, ...] = ()

    def __post_init__(self) -> None:
        for key in ("band", "waves"):
            band = getattr(self, key)
            if not band[0] < band[1]:
                raise ValueError(f"{key} = {list(band)}: give the shortest wave first, then a longer one")


_OF_PLANT: Final = {
    "planar": ("rms", "waves", "bumps"),
    "spatial": ("roll_sd_deg", "force_sd", "band", "rut"),
}
"""Keys of Ground that a plant does not have."""


@dataclass(frozen=True, slots=True, config=_CONFIG)
class SoilChange:
    """Other soil from a time on, or beyond a line. A parameter is multiplied by its factor there."""

    at_s: NotNegative | None = None
    north: float | None = None  # m, of a point on the line
    east: float | None = None
    towards_deg: Degrees = 0.0  # where beyond is: across the line, clockwise from north
    over: NotNegative = 0.0  # s or m that the change takes; 0: at once
    C_af: Factor = 1.0
    C_ar: Factor = 1.0
    C_ai: Factor = 1.0
    sigma_f: Factor = 1.0
    sigma_r: Factor = 1.0
    sigma_i: Factor = 1.0

    def __post_init__(self) -> None:
        if (self.at_s is None) == (self.north is None or self.east is None):
            raise ValueError("give at_s for a time, or north and east of a point on the line")


@dataclass(frozen=True, slots=True, config=_CONFIG)
class Soil:
    """What holds the tyres, and where it is different."""

    grip: Annotated[float, Field(ge=0.2, le=1000)] = (
        3.0  # largest side over vertical force; in a field 0.5 to 1
    )
    rolling: Annotated[float, Field(ge=0, le=0.5)] = 0.02  # resistance over load; on firm soil 0.06
    parameters: Mapping[Parameter, Positive] | None = None  # N/rad, m: instead of what is drawn
    changes: tuple[SoilChange, ...] = ()
    patch_log_sd: Annotated[float, Field(ge=0, le=1)] = 0.0  # stiffness here and there, natural logarithm
    patch_length: Annotated[float, Field(ge=2, le=10_000)] = 40.0  # m, shortest wave of the patches
    patch_across: Annotated[float, Field(ge=0.1, le=10)] = 1.0  # their length to east over that to north
    patch_common: Share = 1.0  # correlation of the patches that different axles feel
    patch_seed: Annotated[int, Field(ge=0)] | None = None  # of the field, on every day; None: the seed


@dataclass(frozen=True, slots=True, config=_CONFIG)
class LoadChange:
    """The implement comes to carry more or less; its CG stays. Tyres follow their loads."""

    at_s: NotNegative
    mass: Factor  # on the implement's mass and yaw inertia
    over: NotNegative = 0.0  # s that it takes; 0: at once
    exponent: Annotated[float, Field(ge=0, le=1.2)] = 0.8  # of a stiffness, over its load; planar plant


# What a machine file does not say of the rig, for either plant.

PlanarKey = Literal["w_f", "w_r", "w_i", "h_h", "roll_share_f", "load_exponent", "front_drive"]
"""Of estimator.models.parameters.RIG_PARAMETERS."""


@dataclass(frozen=True, slots=True, config=_CONFIG)
class Spatial:
    """The rig as two bodies in space on six tyres. A key that is not given has the value of
    simulator/spatial/vehicle.py or, with `draw`, one that is drawn from the seed."""

    draw: bool = False
    vertical_stiffness: tuple[Stiffness, Stiffness, Stiffness] | None = None  # N/m of each tyre; front,
    vertical_damping: tuple[NotNegative, NotNegative, NotNegative] | None = None  # rear, implement; N s/m
    track: tuple[Track, Track, Track] | None = None  # m
    radius: tuple[Radius, Radius, Radius] | None = None  # m, of the loaded tyres
    axle_mass: Positive | None = None  # kg, of the front axle with its wheels
    suspension: tuple[Stiffness, NotNegative] | None = None  # N/m and N s/m of the front axle; None: rigid
    pin_height: Annotated[float, Field(ge=0, le=1.5)] | None = None  # m, of the front axle's pin
    hitch_height: Annotated[float, Field(ge=0.1, le=1.5)] | None = None  # m
    roll_gyration: tuple[Gyration, Gyration] | None = None  # m, radius of tractor and implement
    tyre: TyreCurve | None = None
    relaxation: Lag | None = None
    load_exponent: Share | None = None  # of the stiffness
    camber_thrust: Share | None = None  # side force over load, for each rad that a tyre leans
    grip: Annotated[float, Field(ge=0.2, le=1000)] | None = None  # None: that of the soil, or drawn
    combined: bool = True  # drive force takes some of the side force
    ackermann: Share = 1.0  # 0: both front wheels turn by the same angle, 1: towards one centre
    front_drive: Share = 0.0  # of the drive force
    step: Annotated[float, Field(ge=0.0002, le=0.0025)] = 0.002  # s, or a little less


# What is out of order.


@dataclass(frozen=True, slots=True, config=_CONFIG)
class SurveyErrors:
    """How far the machine file is from the truth; drawn once for a run."""

    cg_sd: Annotated[float, Field(ge=0, le=0.2)] = 0.01  # m, of either CG, along each axis
    cg_height_sd: Annotated[float, Field(ge=0, le=0.3)] | None = None  # m, instead; None: the same
    lever_sd: Annotated[float, Field(ge=0, le=0.2)] = 0.01  # m, of each receiver, forward and right
    pair_sd_deg: Annotated[float, Field(ge=0, le=1)] = 0.2  # of the yaw of either pair, at most 0.3 in truth


@dataclass(frozen=True, slots=True, config=_CONFIG)
class Wheel:
    """Errors of the wheel-angle sensor and its linkage."""

    zero_deg: Annotated[float, Field(ge=-5, le=5)] | None = None  # beyond the file's; None: drawn, sd 0.3
    zero_drift_degps: Annotated[float, Field(ge=-0.1, le=0.1)] = 0.0  # of the zero, from the start on
    gain: Annotated[float, Field(ge=0.5, le=2)] = 1.0
    dead_band_deg: Annotated[float, Field(ge=0, le=5)] = 0.0  # play: from the right to the left flank
    delay: Annotated[float, Field(ge=0, le=1)] = 0.0  # s, beyond the machine file's
    kingpin: Literal["mean", "left", "right"] = "mean"  # wheel that carries it, where the file says mean
    kingpin_distance: Track = 1.7  # m
    curve: Annotated[float, Field(ge=-0.3, le=0.3)] = 0.0  # 1/rad: wheel angle = reading + curve reading^2
    bend: Annotated[float, Field(ge=-0.2, le=0.2)] = 0.0  # of the gain at 30 degrees to either side, less 1


@dataclass(frozen=True, slots=True, config=_CONFIG)
class WheelBasedSpeed:
    """The speed by the driven wheels: the factor of their radius, and slip that varies along the way. In
    turns and 20 m before and after them the implement is lifted and the tractor runs light."""

    factor: Annotated[float, Field(ge=0.5, le=2)] = 1.02  # wheel-based over ground speed without slip
    new_tyres_s: NotNegative | None = None  # s, when it gets other tyres
    new_radius: Annotated[float, Field(ge=0.5, le=2)] = 1.0  # of theirs over that of the old ones
    slip: Annotated[float, Field(ge=0, le=0.3)] = 0.0  # mean, while working
    slip_sd: Annotated[float, Field(ge=0, le=0.1)] = 0.0  # about that mean
    slip_length: Annotated[float, Field(ge=5, le=10_000)] = 100.0  # m, over which it varies
    light_slip: Annotated[float, Field(ge=0, le=0.1)] = 0.0  # while running light


@dataclass(frozen=True, slots=True, config=_CONFIG)
class ReceiverLink:
    """How the receivers' reports come through."""

    jitter: Annotated[float, Field(ge=0, le=0.2)] = 0.0015  # s, mean of what is added to the latency
    drop_out: Share = 0.0  # of the epochs that are never sent
    base_jump: Annotated[float, Field(ge=0, le=1)] = 0.0  # m, by which the base moves all positions, at times


@dataclass(frozen=True, slots=True, config=_CONFIG)
class RollSensor:
    """The receivers' own roll and turn rate. With `draw` what is not given is drawn anew for each."""

    draw: bool = False
    sd_deg: Annotated[float, Field(ge=0, le=5)] | None = None  # None: 0.2, or drawn from 0.2 to 0.5
    zero_deg: Annotated[float, Field(ge=-5, le=5)] | None = None  # None: 0, or drawn within 1
    delay: Annotated[float, Field(ge=0, le=0.5)] | None = None  # s; None: 0, or drawn up to 0.1
    turn_rate_delay: Annotated[float, Field(ge=0, le=0.5)] | None = None  # s; None: 0, or drawn up to 0.06


@dataclass(frozen=True, slots=True, config=_CONFIG)
class Fault:
    """What goes wrong with one receiver for a while; `kind` is a key of receivers.FAULTS."""

    mount: Mount
    start_s: NotNegative
    end_s: NotNegative
    kind: FaultKind

    def __post_init__(self) -> None:
        if self.end_s <= self.start_s:
            raise ValueError(f"end_s = {self.end_s:g} must come after start_s = {self.start_s:g}")


@dataclass(frozen=True, slots=True, config=_CONFIG)
class Reclaim:
    """A receiver changes its source address; another one's address makes the two claim the same."""

    mount: Mount
    at_s: NotNegative
    source: Annotated[int, Field(ge=0, le=253)]


@dataclass(frozen=True, slots=True, config=_CONFIG)
class Scenario:
    """How the machine is driven, and what is out of order. The default is the demo's."""

    purpose: str = ""  # one sentence: what it is good for
    seconds: Duration = 90.0
    seed: Annotated[int, Field(ge=0)] = 1
    rig_seed: Annotated[int, Field(ge=0)] | None = None  # of rig and sensors' constant errors; None: the seed
    machine: str | None = None  # machine file, from this file's folder; None: the packaged one
    plant: Literal["planar", "spatial"] = "planar"  # spatial needs the extra of that name
    speed: Speeds = 4.5
    speed_sd: Annotated[float, Field(ge=0, le=1)] = 0.05  # m/s, wandering within some ten seconds
    steering: Steering = Turns()
    steering_rate_degps: Positive = 25.0
    steering_limit_deg: Annotated[float, Field(ge=5, le=45)] = 35.0  # stop of automatic steering
    roll_deg: tuple[Angle, Angle] = (
        0.0,
        0.0,
    )  # of tractor and implement, right side down
    ground: Ground = Ground()
    soil: Soil = Soil()
    loads: tuple[LoadChange, ...] = ()
    spatial: Spatial = Spatial()
    planar: Mapping[PlanarKey, NotNegative] | None = None  # of the rig, instead of what is usual
    survey: SurveyErrors = SurveyErrors()
    wheel: Wheel = Wheel()
    wheel_speed: WheelBasedSpeed = WheelBasedSpeed()
    roll_sensor: RollSensor = RollSensor()
    link: ReceiverLink = ReceiverLink()
    noise: NotNegative = 1.0  # factor on every noise and drawn error of the sensors and the survey
    latency_s: Mapping[Mount, NotNegative] | None = None  # instead of what is drawn
    faults: tuple[Fault, ...] = ()
    reclaims: tuple[Reclaim, ...] = ()
    swapped: tuple[Mount, Mount] | None = None  # these two receivers stand in each other's place
    wheel_sensor: bool = True
    claims: bool = True  # False: everybody has claimed an address before the recording began
    other_traffic: bool = True  # the frames that nobody wants
    origin_deg: tuple[Annotated[float, Field(ge=-80, le=80)], Annotated[float, Field(ge=-180, le=180)]] = (
        ORIGIN_DEG  # latitude and longitude of x = y = 0
    )
    utc_start_ns: Instant = 1_777_881_600_000_000_000  # 2026-05-04T08:00:00Z; a multiple of the sample period
    clock_offset_s: ClockOffset | None = None  # host clock minus UTC at the start; None: drawn

    def __post_init__(self) -> None:
        slowest = min(row[1] for row in self.speed) if isinstance(self.speed, tuple) else self.speed
        if slowest < 0 and isinstance(self.steering, (RowSteering, Fieldwork)):
            raise ValueError(f"speed = {slowest:g}: automatic steering does not drive in reverse")
        self._check_plant()

    def _check_plant(self) -> None:
        """Raises ValueError for a key of the other plant."""
        ground, blank = self.ground, Ground()
        given = [
            f"ground.{key}" for key in _OF_PLANT[self.plant] if getattr(ground, key) != getattr(blank, key)
        ]
        if self.plant == "planar":
            given += ["spatial"] if self.spatial != Spatial() else []
            say = 'is of the spatial plant; add plant = "spatial"'
        else:
            given += ["roll_deg"] if self.roll_deg != (0.0, 0.0) else []
            say = "is of the planar plant; give ground.rms or ground.bumps for uneven ground"
            if any(change.exponent != LoadChange(0.0, 1.0).exponent for change in self.loads):
                raise ValueError("loads.exponent is of the planar plant; give spatial.load_exponent")
            if self.planar:
                raise ValueError("planar is of the planar plant; give spatial")
        if given:
            raise ValueError(f"{given[0]} {say}")


_SCENARIO: Final = TypeAdapter(Scenario)


def parse_scenario(text: str) -> Scenario:
    """Scenario from the TOML text of a scenario file. Raises ScenarioError."""
    try:
        raw = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ScenarioError(f"not a TOML file: {error}") from None
    _check_kind(raw.get("steering"))
    try:
        return _SCENARIO.validate_python(raw)
    except ValidationError as error:
        raise ScenarioError(sentence(error, raw, Scenario)) from None


def as_json(scenario: Scenario) -> str:
    """For another process; `from_json` reads it."""
    return _SCENARIO.dump_json(scenario).decode()


def from_json(text: str) -> Scenario:
    """Raises pydantic.ValidationError."""
    return _SCENARIO.validate_json(text)


def check_mounts(scenario: Scenario, mounts: Collection[Mount]) -> None:
    """Raises ScenarioError where it names a receiver that the machine does not have."""
    named = [("faults", fault.mount) for fault in scenario.faults]
    named += [("reclaims", claim.mount) for claim in scenario.reclaims]
    named += [("swapped", mount) for mount in scenario.swapped or ()]
    named += [("latency_s", mount) for mount in scenario.latency_s or ()]
    for key, mount in named:
        if mount not in mounts:
            raise ScenarioError(f"{key}: the machine has no receiver {mount}; it has {', '.join(mounts)}")


def _check_kind(steering: Any) -> None:
    """Pydantic would not say what was given. Raises ScenarioError."""
    kind = steering.get("kind") if isinstance(steering, dict) else _KINDS[0]
    if kind not in _KINDS:
        near = difflib.get_close_matches(str(kind), _KINDS, n=1)
        hint = f'; did you mean "{near[0]}"?' if near else ""
        raise ScenarioError(f"steering.kind = {kind!r}: there are {', '.join(_KINDS)}{hint}")
