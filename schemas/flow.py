"""What flows through Tilth: frames in, publications out. Every type that crosses a layer is here.

    Frame ─decode─► Message ─► Measurement ─align, geometry─► Pose ─► Estimate ─► Publication

Units are SI and radians; a unit that is not is in the field's name. Times are integer nanoseconds of the
log's own clock. World frame W: x north, y east. Body frames: x forward, y right, z down. Headings and courses
clockwise from north, right turns and right-hand wheel angles positive, roll positive right side down.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import field
from enum import IntEnum, StrEnum
from typing import Final

from tilth.schemas.notices import Notice
from tilth.schemas.reasons import Advice, Combination, Reason
from tilth.schemas.values import dataclass

Word = float | int | str


class Mount(StrEnum):
    """Where a receiver sits. The order is the order of every array over receivers."""

    TRACTOR_FRONT = "tractor_front"
    TRACTOR_REAR = "tractor_rear"
    IMPLEMENT_FRONT = "implement_front"
    IMPLEMENT_REAR = "implement_rear"

    @property
    def body(self) -> str:
        """tractor | implement."""
        return self.value.partition("_")[0]


class FixType(StrEnum):
    """Quality of a position solution, in the words of the command line."""

    NONE = "none"
    GNSS = "gnss"
    DGNSS = "dgnss"
    PRECISE = "precise"
    RTK_FIXED = "rtk_fixed"
    RTK_FLOAT = "rtk_float"
    DEAD_RECKONING = "dead_reckoning"
    MANUAL = "manual"
    SIMULATED = "simulated"


class Status(IntEnum):
    """What a published number may be used for."""

    UNESTIMATED = 0
    ESTIMATED = 1
    STALE = 2
    INVALID = 3


PARAMETERS = ("C_af", "C_ar", "C_ai", "sigma_f", "sigma_r", "sigma_i")
"""The six soil-tyre parameters in the order of every array over them: N/rad (whole axle) and m."""


@dataclass(frozen=True, slots=True)
class Frame:
    """One CAN frame, exactly what is logged. `data` is at most 8 bytes, or a whole message where a foreign
    log holds it already assembled."""

    t_ns: int  # when the loop took it: orders everything, never decreases within a log
    rx_ns: int  # the kernel's or adapter's receive stamp on the clock of t_ns: what the physics uses
    bus: str
    can_id: int
    extended: bool
    error: bool
    data: bytes


@dataclass(frozen=True, slots=True)
class Origin:
    """Who sent a message."""

    bus: str
    source: int  # J1939 source address; -1 for a frame that has none
    name: int | None = None  # 64-bit NAME, where an address claim told it
    mount: Mount | None = None  # the receiver of the machine file that it is, if any


@dataclass(frozen=True, slots=True)
class Message:
    """One decoded message: the signals it carries, absent where not available."""

    t_ns: int  # of the first frame
    rx_ns: int  # of the first frame
    origin: Origin
    pgn: int
    sid: int | None  # NMEA 2000 sequence identifier: ties messages of one device to one instant
    values: Mapping[str, Word]  # keys: schemas.signals.SIGNALS
    repeat: bool = False  # a position that repeats the one before: not a new measurement
    title: str = ""  # what the message is called
    priority: int | None = None  # of its frames
    destination: int = 255  # 255: everybody
    groups: Mapping[str, Sequence[Mapping[str, Word]]] = field(default_factory=dict)  # what it repeats
    dropped: Mapping[str, Word] = field(default_factory=dict)  # signals outside of their range
    reason: str | None = None  # why there is no value, or not every one: a Rejection


@dataclass(frozen=True, slots=True)
class Measurement:
    """What every kind of measurement carries."""

    t_ns: int
    rx_ns: int
    origin: Origin
    pgn: int
    sid: int | None


@dataclass(frozen=True, slots=True)
class Position(Measurement):
    latitude_deg: float
    longitude_deg: float
    sd: float  # horizontal, per axis, m
    altitude_m: float | None = None
    repeat: bool = False


@dataclass(frozen=True, slots=True)
class Velocity(Measurement):
    """Over ground, at the antenna."""

    course: float  # rad, true
    speed: float  # m/s
    sd: float  # per horizontal axis, m/s


@dataclass(frozen=True, slots=True)
class Heading(Measurement):
    heading: float  # rad, true
    sd: float


@dataclass(frozen=True, slots=True)
class YawRate(Measurement):
    yaw_rate: float  # rad/s
    sd: float


@dataclass(frozen=True, slots=True)
class Attitude(Measurement):
    roll: float | None  # rad
    pitch: float | None  # rad, positive nose up
    sd: float  # rad


@dataclass(frozen=True, slots=True)
class Fix(Measurement):
    fix: FixType
    satellites: int | None = None
    hdop: float | None = None


@dataclass(frozen=True, slots=True)
class UtcTime(Measurement):
    utc_ns: int  # nanoseconds since 1970
    sd: float  # s: the resolution of the message


@dataclass(frozen=True, slots=True)
class WheelAngle(Measurement):
    """Mean road-wheel angle of the front axle, zero and sign applied."""

    angle: float  # rad
    sd: float  # rad, white noise; the zero's own uncertainty is the machine file's


@dataclass(frozen=True, slots=True)
class HandWheelAngle(Measurement):
    """The driver's wheel; never used as a road-wheel angle."""

    angle: float  # rad


@dataclass(frozen=True, slots=True)
class Curvature(Measurement):
    """Estimated by the steering system; logged, not used as a wheel angle."""

    curvature: float  # 1/m, positive right


@dataclass(frozen=True, slots=True)
class VehicleSpeed(Measurement):
    """Speed and direction of travel from the wheels (65096) or a ground sensor (65097)."""

    speed: float  # m/s, magnitude
    direction: str | None  # "forward" | "reverse"


@dataclass(frozen=True, slots=True)
class Weight(Measurement):
    """What a scale says of the implement, kg; one of both at least."""

    whole_mass: float | None  # of the implement with all that it carries
    carried_mass: float | None  # of what it carries


@dataclass(frozen=True, slots=True)
class AddressClaim(Measurement):
    """A device said which source address it uses; the NAME is origin.name."""

    manufacturer: int
    identity: int


@dataclass(frozen=True, slots=True)
class BodyPose:
    """One body at one instant, referred to its centre of gravity. None: could not be given, see flags."""

    x: float | None  # m north of the pose's origin
    y: float | None  # m east
    sd_position: float | None  # per axis, m
    heading: float | None  # rad
    sd_heading: float | None
    forward_velocity: float | None  # u, m/s, along the body
    lateral_velocity: float | None  # v, m/s, to its right
    sd_velocity: float | None  # of u, m/s
    sd_lateral_velocity: float | None  # of v: holds the heading's error as well
    yaw_rate: float | None  # rad/s
    sd_yaw_rate: float | None
    roll: float | None  # rad
    sd_roll: float | None


class FlagKind(StrEnum):
    """What may be unusual about a pose; docs/notation.md says what each means."""

    CONTRADICTION = "contradiction"
    DOUBTFUL = "doubtful"
    FIX_UNKNOWN = "fix_unknown"
    FLOATING = "floating"
    HEADING_BY_HITCH = "heading_by_hitch"
    HEADING_BY_REPORTED = "heading_by_reported"
    HEADING_BY_YAW_RATE = "heading_by_yaw_rate"
    LATE = "late"
    LATE_FRAMES = "late_frames"
    LATENCY = "latency"
    LEFT_OUT = "left_out"
    LOST = "lost"
    MISSING = "missing"
    MOVED = "moved"
    NO_FIX = "no_fix"
    NO_HEADING = "no_heading"
    NO_ROLL = "no_roll"
    NO_RTK = "no_rtk"
    NO_YAW_RATE = "no_yaw_rate"
    NOT_ROLL_CORRECTED = "not_roll_corrected"
    REPEATING = "repeating"
    ROLL_CORRECTED_TWICE = "roll_corrected_twice"
    ROLL_CORRECTION = "roll_correction"
    SMOOTHED_YAW_RATE = "smoothed_yaw_rate"
    SPIKES = "spikes"
    STANDS_STILL = "stands_still"
    SWAPPED = "swapped"
    WAITING = "waiting"
    YAW_RATE_OF_HEADING = "yaw_rate_of_heading"


WITHOUT_RTK: Final = frozenset({FlagKind.FLOATING, FlagKind.NO_RTK, FlagKind.NO_FIX, FlagKind.FIX_UNKNOWN})
"""Of a receiver whose positions are not good to centimetres, or not known to be."""
MISPLACED: Final = frozenset({FlagKind.SWAPPED, FlagKind.MOVED, FlagKind.DOUBTFUL, FlagKind.LATENCY})
"""Of a receiver that does not fit the rig."""


@dataclass(frozen=True, slots=True, order=True)
class Flag:
    """One thing that is unusual about a pose."""

    kind: FlagKind
    of: str  # a mount, a body, "wheel_angle", "rig", or the machine-file key that is contradicted

    def __str__(self) -> str:
        """As published: kind:of."""
        return f"{self.kind}:{self.of}"

    @classmethod
    def parse(cls, text: str) -> "Flag":
        """Of what is published. Raises ValueError where the kind is not known."""
        kind, _, of = text.partition(":")
        return cls(FlagKind(kind), of)


def known_flags(texts: Iterable[str]) -> tuple[Flag, ...]:
    """Of a published pose; kinds that a later version may have added are left out."""
    return tuple(Flag.parse(text) for text in texts if text.partition(":")[0] in set(FlagKind))


@dataclass(frozen=True, slots=True)
class Pose:
    """Both bodies at one instant. `t_ns` is the instant itself, on the clock of Frame.rx_ns."""

    t_ns: int
    origin_latitude_deg: float
    origin_longitude_deg: float
    tractor: BodyPose
    implement: BodyPose
    articulation: float | None  # psi_t - psi_i, rad
    sd_articulation: float | None
    wheel_angle: float | None  # rad
    sd_wheel_angle: float | None
    direction: int  # +1 forward, -1 reverse, 0 standstill or unknown
    utc_ns: int | None
    sd_time: (
        float  # s, of the instant itself: latency that all receivers share; only in sd_position beyond this
    )
    receivers: int  # how many of them this pose rests on
    flags: tuple[Flag, ...]


@dataclass(frozen=True, slots=True)
class Transform:
    """Where a frame stands in its parent. Frames of a drawing are as viewers of 3D scenes have them:
    right-handed with z up; x east and y north in the world, x forward and y left on a body."""

    parent: str
    child: str
    translation: tuple[float, float, float]  # of the child's origin, m
    rotation: tuple[float, float, float, float]  # quaternion x, y, z, w


@dataclass(frozen=True, slots=True)
class BodyFrames:
    """Where both bodies stand at the instant of a pose, for viewers."""

    t_ns: int
    transforms: tuple[Transform, ...]  # a frame that is not known at this instant is not among them


@dataclass(frozen=True, slots=True)
class Solid:
    """One part of a drawing, at rest in a frame of BodyFrames."""

    name: str
    frame: str
    centre: tuple[float, float, float]  # m
    size: tuple[float, float, float]  # along x, y, z, m
    colour: tuple[float, float, float]  # red, green, blue, 0 to 1
    wheel: bool = False  # a cylinder about y; else a box


@dataclass(frozen=True, slots=True)
class Drawing:
    """What both bodies look like: lengths of the machine file, usual ones where it tells none."""

    t_ns: int
    solids: tuple[Solid, ...]


@dataclass(frozen=True, slots=True)
class ParameterEstimate:
    """One of PARAMETERS. `value` and `sd` are None unless the data support them."""

    value: float | None
    sd: float | None
    status: Status
    reason: Reason | None  # why there is no number, why it must not be used, or what it is widened by
    age_s: float | None = None  # since data last informed it


@dataclass(frozen=True, slots=True)
class OwnSteering:
    """How much of the wheel angle in straight rows the steering makes by itself, apart from what it answers
    to the ground: only that tells of the tyres."""

    share: float  # of the variance, 0 to 1
    rms: float  # rad, of that share
    seconds: float  # of rows that it is of


@dataclass(frozen=True, slots=True)
class SoilPlace:
    """Where an estimate is of, and what it rests on: shares that add up to 1."""

    latitude_deg: float  # of the tractor's rear axle
    longitude_deg: float
    radius_m: float  # over which the soil of this field is alike
    this_pass: float  # by what was driven since the rig last turned round
    neighbours: float  # by passes before
    prior: float  # by the machine file
    log_mean: tuple[float, ...] = ()
    """Of the six, N/rad and m, also where no number is given since it is too wide: for who weighs by
    `log_covariance`. Empty while numbers are withheld."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """What one estimator says of the six parameters at one instant."""

    t_ns: int
    method: str
    model: str
    parameters: tuple[ParameterEstimate, ...]  # in the order of PARAMETERS
    log_covariance: tuple[float, ...]  # 6 x 6, natural logarithms, row by row; empty where there is none
    per_mass: tuple[float | None, ...]  # C_af/m_t, C_ar/m_t, C_ai/m_i, 1/(rad) m/s^2
    per_mass_sd: tuple[float | None, ...] = ()  # of each, without what is not known of the masses
    nuisances: Mapping[str, tuple[float, float]] = field(default_factory=dict)  # name -> value, sd (SI)
    rank: int = 0  # of what the data determine among the parameters estimated
    condition: float | None = None
    excitation: Mapping[str, float] = field(default_factory=dict)
    window_s: float = 0.0  # data used, s
    rule: Reason | None = None  # of the recommended one: why this method
    determined: tuple[Combination, ...] = ()  # parameters, or combinations, that data and prior determine
    bound: tuple[float, ...] = ()  # sd of each logarithm by the data alone, infinite where open; or empty
    advice: Advice | None = None  # which manoeuvre would help, and by how much
    own_steering: OwnSteering | None = None  # of the method `rows`: in the rows fitted last
    of_place: SoilPlace | None = None  # of the method `place`


class EventKind(StrEnum):
    """What kind an event is of, besides the kinds of flags (FlagKind), which are events when they begin and
    end."""

    ACCEPTED = "accepted"  # the operator has accepted a value that the watch has found
    ADDRESSES = "addresses"
    BUS = "bus"
    CLOCK = "clock"  # the computer's clock was set
    CLOCK_STEP = "clock_step"  # the log's clock stepped
    COARSE_STAMPS = "coarse_stamps"  # of the log: what came within one step cannot be told apart
    COMPILED = "compiled"
    DISAGREEMENT = "disagreement"  # of methods
    FAULT = "fault"  # of the program
    FIT = "fit"
    GAP = "gap"
    IMPLEMENT = "implement"  # another is hitched on
    LOAD = "load"  # the implement carries more or less
    LOG = "log"
    MACHINE_FILE = "machine_file"  # says something unusual
    MARK = "mark"  # by the operator; the words are theirs
    MOVED = "moved"
    OTHER_CLOCK = "other_clock"  # of a bus
    OTHER_TIME = "other_time"  # of frames that are left out
    POSITIONS_REPEATED = "positions_repeated"
    POSITIONS_SLOW = "positions_slow"
    REPORT = "report"
    SOIL_CHANGE = "soil_change"
    STORED_STATE = "stored_state"
    TWIN_NAME = "twin_name"  # two devices have it
    UPDATE = "update"  # of the software, with nobody present
    WARM_START = "warm_start"
    ZENOH = "zenoh"


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened and will be asked about later."""

    t_ns: int
    kind: str  # of EventKind or FlagKind
    notice: Notice  # what; schemas/sentences makes the words
    latitude_deg: float | None = None  # of the tractor's CG, where that matters
    longitude_deg: float | None = None
    utc_ns: int | None = None  # of a mark: when it was made, as far as UTC was known then


@dataclass(frozen=True, slots=True)
class FitOutcome:
    """What became of a fit that was asked for at the frame of `asked_ns`."""

    t_ns: int
    method: str
    asked_ns: int
    adopted: bool  # False: it was not ready in time and was dropped, unless it is awaited
    awaited: bool = False  # it is late: another outcome follows
    late_ns: int = 0  # how much later than it was due it was decided
    result: str = ""  # as JSON, if it is adopted
    job_sha256: str = ""  # of what it was made of, and the machine file


@dataclass(frozen=True, slots=True)
class Tie:
    """A decision that another kind of processor may take otherwise (estimator/ties.py)."""

    t_ns: int  # of the frame with which it was taken
    statistic: float
    threshold: float
    above: bool  # as it was taken: the statistic is above the threshold


@dataclass(frozen=True, slots=True)
class Accepted:
    """A value that the watch has found and the operator accepted; used from the next frame on."""

    t_ns: int
    what: str  # estimator/diagnosis/accepted.py: KNOWN
    amounts: tuple[float, ...]
    """By which it has been moved: forward and right, m; or one angle, rad; or m. Of wheel_speed the factor of
    the wheel-based speed as it is now, and as it was."""
    sds: tuple[float, ...]


class LoadSource(StrEnum):
    """Who says how much an implement carries."""

    OPERATOR = "operator"
    SCALE = "scale"
    NOBODY = "nobody"  # nobody has: all that it can carry is possible


@dataclass(frozen=True, slots=True)
class Carried:
    """How much the implement carries; of an operator, used from the next frame on."""

    t_ns: int
    mass: float  # kg, without the empty implement's own
    sd: float  # kg, when it was said
    source: LoadSource


@dataclass(frozen=True, slots=True)
class Ready:
    """Whether the estimators run from here on in the log; what was driven before waits for them."""

    t_ns: int
    ready: bool
    text: str  # what they wait for, or what has happened


Payload = Measurement | Pose | BodyFrames | Drawing | Estimate | Event | FitOutcome | Tie | Ready | Accepted


@dataclass(frozen=True, slots=True)
class Publication:
    """What sinks understand: a value on a channel (a row of schemas.channels.CHANNELS), encoded there."""

    t_ns: int  # of the frame that caused it
    topic: str
    value: Payload
