from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class ParameterStatus(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    UNESTIMATED: _ClassVar[ParameterStatus]
    ESTIMATED: _ClassVar[ParameterStatus]
    STALE: _ClassVar[ParameterStatus]
    INVALID: _ClassVar[ParameterStatus]
UNESTIMATED: ParameterStatus
ESTIMATED: ParameterStatus
STALE: ParameterStatus
INVALID: ParameterStatus

class CanFrame(_message.Message):
    __slots__ = ("rx_ns", "can_id", "extended", "error", "data")
    RX_NS_FIELD_NUMBER: _ClassVar[int]
    CAN_ID_FIELD_NUMBER: _ClassVar[int]
    EXTENDED_FIELD_NUMBER: _ClassVar[int]
    ERROR_FIELD_NUMBER: _ClassVar[int]
    DATA_FIELD_NUMBER: _ClassVar[int]
    rx_ns: int
    can_id: int
    extended: bool
    error: bool
    data: bytes
    def __init__(self, rx_ns: _Optional[int] = ..., can_id: _Optional[int] = ..., extended: _Optional[bool] = ..., error: _Optional[bool] = ..., data: _Optional[bytes] = ...) -> None: ...

class Measurement(_message.Message):
    __slots__ = ("t_ns", "rx_ns", "bus", "source", "name", "mount", "pgn", "sid", "sd", "latitude_deg", "longitude_deg", "altitude_m", "repeat", "course", "speed", "heading", "yaw_rate", "roll", "pitch", "fix", "satellites", "hdop", "utc_ns", "angle", "curvature", "direction", "manufacturer", "identity", "whole_mass", "carried_mass")
    T_NS_FIELD_NUMBER: _ClassVar[int]
    RX_NS_FIELD_NUMBER: _ClassVar[int]
    BUS_FIELD_NUMBER: _ClassVar[int]
    SOURCE_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    MOUNT_FIELD_NUMBER: _ClassVar[int]
    PGN_FIELD_NUMBER: _ClassVar[int]
    SID_FIELD_NUMBER: _ClassVar[int]
    SD_FIELD_NUMBER: _ClassVar[int]
    LATITUDE_DEG_FIELD_NUMBER: _ClassVar[int]
    LONGITUDE_DEG_FIELD_NUMBER: _ClassVar[int]
    ALTITUDE_M_FIELD_NUMBER: _ClassVar[int]
    REPEAT_FIELD_NUMBER: _ClassVar[int]
    COURSE_FIELD_NUMBER: _ClassVar[int]
    SPEED_FIELD_NUMBER: _ClassVar[int]
    HEADING_FIELD_NUMBER: _ClassVar[int]
    YAW_RATE_FIELD_NUMBER: _ClassVar[int]
    ROLL_FIELD_NUMBER: _ClassVar[int]
    PITCH_FIELD_NUMBER: _ClassVar[int]
    FIX_FIELD_NUMBER: _ClassVar[int]
    SATELLITES_FIELD_NUMBER: _ClassVar[int]
    HDOP_FIELD_NUMBER: _ClassVar[int]
    UTC_NS_FIELD_NUMBER: _ClassVar[int]
    ANGLE_FIELD_NUMBER: _ClassVar[int]
    CURVATURE_FIELD_NUMBER: _ClassVar[int]
    DIRECTION_FIELD_NUMBER: _ClassVar[int]
    MANUFACTURER_FIELD_NUMBER: _ClassVar[int]
    IDENTITY_FIELD_NUMBER: _ClassVar[int]
    WHOLE_MASS_FIELD_NUMBER: _ClassVar[int]
    CARRIED_MASS_FIELD_NUMBER: _ClassVar[int]
    t_ns: int
    rx_ns: int
    bus: str
    source: int
    name: int
    mount: str
    pgn: int
    sid: int
    sd: float
    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    repeat: bool
    course: float
    speed: float
    heading: float
    yaw_rate: float
    roll: float
    pitch: float
    fix: str
    satellites: int
    hdop: float
    utc_ns: int
    angle: float
    curvature: float
    direction: str
    manufacturer: int
    identity: int
    whole_mass: float
    carried_mass: float
    def __init__(self, t_ns: _Optional[int] = ..., rx_ns: _Optional[int] = ..., bus: _Optional[str] = ..., source: _Optional[int] = ..., name: _Optional[int] = ..., mount: _Optional[str] = ..., pgn: _Optional[int] = ..., sid: _Optional[int] = ..., sd: _Optional[float] = ..., latitude_deg: _Optional[float] = ..., longitude_deg: _Optional[float] = ..., altitude_m: _Optional[float] = ..., repeat: _Optional[bool] = ..., course: _Optional[float] = ..., speed: _Optional[float] = ..., heading: _Optional[float] = ..., yaw_rate: _Optional[float] = ..., roll: _Optional[float] = ..., pitch: _Optional[float] = ..., fix: _Optional[str] = ..., satellites: _Optional[int] = ..., hdop: _Optional[float] = ..., utc_ns: _Optional[int] = ..., angle: _Optional[float] = ..., curvature: _Optional[float] = ..., direction: _Optional[str] = ..., manufacturer: _Optional[int] = ..., identity: _Optional[int] = ..., whole_mass: _Optional[float] = ..., carried_mass: _Optional[float] = ...) -> None: ...

class BodyPose(_message.Message):
    __slots__ = ("x", "y", "sd_position", "heading", "sd_heading", "forward_velocity", "lateral_velocity", "sd_velocity", "sd_lateral_velocity", "yaw_rate", "sd_yaw_rate", "roll", "sd_roll")
    X_FIELD_NUMBER: _ClassVar[int]
    Y_FIELD_NUMBER: _ClassVar[int]
    SD_POSITION_FIELD_NUMBER: _ClassVar[int]
    HEADING_FIELD_NUMBER: _ClassVar[int]
    SD_HEADING_FIELD_NUMBER: _ClassVar[int]
    FORWARD_VELOCITY_FIELD_NUMBER: _ClassVar[int]
    LATERAL_VELOCITY_FIELD_NUMBER: _ClassVar[int]
    SD_VELOCITY_FIELD_NUMBER: _ClassVar[int]
    SD_LATERAL_VELOCITY_FIELD_NUMBER: _ClassVar[int]
    YAW_RATE_FIELD_NUMBER: _ClassVar[int]
    SD_YAW_RATE_FIELD_NUMBER: _ClassVar[int]
    ROLL_FIELD_NUMBER: _ClassVar[int]
    SD_ROLL_FIELD_NUMBER: _ClassVar[int]
    x: float
    y: float
    sd_position: float
    heading: float
    sd_heading: float
    forward_velocity: float
    lateral_velocity: float
    sd_velocity: float
    sd_lateral_velocity: float
    yaw_rate: float
    sd_yaw_rate: float
    roll: float
    sd_roll: float
    def __init__(self, x: _Optional[float] = ..., y: _Optional[float] = ..., sd_position: _Optional[float] = ..., heading: _Optional[float] = ..., sd_heading: _Optional[float] = ..., forward_velocity: _Optional[float] = ..., lateral_velocity: _Optional[float] = ..., sd_velocity: _Optional[float] = ..., sd_lateral_velocity: _Optional[float] = ..., yaw_rate: _Optional[float] = ..., sd_yaw_rate: _Optional[float] = ..., roll: _Optional[float] = ..., sd_roll: _Optional[float] = ...) -> None: ...

class Pose(_message.Message):
    __slots__ = ("t_ns", "origin_latitude_deg", "origin_longitude_deg", "tractor", "implement", "articulation", "sd_articulation", "wheel_angle", "sd_wheel_angle", "direction", "utc_ns", "receivers", "flags", "sd_time")
    T_NS_FIELD_NUMBER: _ClassVar[int]
    ORIGIN_LATITUDE_DEG_FIELD_NUMBER: _ClassVar[int]
    ORIGIN_LONGITUDE_DEG_FIELD_NUMBER: _ClassVar[int]
    TRACTOR_FIELD_NUMBER: _ClassVar[int]
    IMPLEMENT_FIELD_NUMBER: _ClassVar[int]
    ARTICULATION_FIELD_NUMBER: _ClassVar[int]
    SD_ARTICULATION_FIELD_NUMBER: _ClassVar[int]
    WHEEL_ANGLE_FIELD_NUMBER: _ClassVar[int]
    SD_WHEEL_ANGLE_FIELD_NUMBER: _ClassVar[int]
    DIRECTION_FIELD_NUMBER: _ClassVar[int]
    UTC_NS_FIELD_NUMBER: _ClassVar[int]
    RECEIVERS_FIELD_NUMBER: _ClassVar[int]
    FLAGS_FIELD_NUMBER: _ClassVar[int]
    SD_TIME_FIELD_NUMBER: _ClassVar[int]
    t_ns: int
    origin_latitude_deg: float
    origin_longitude_deg: float
    tractor: BodyPose
    implement: BodyPose
    articulation: float
    sd_articulation: float
    wheel_angle: float
    sd_wheel_angle: float
    direction: int
    utc_ns: int
    receivers: int
    flags: _containers.RepeatedScalarFieldContainer[str]
    sd_time: float
    def __init__(self, t_ns: _Optional[int] = ..., origin_latitude_deg: _Optional[float] = ..., origin_longitude_deg: _Optional[float] = ..., tractor: _Optional[_Union[BodyPose, _Mapping]] = ..., implement: _Optional[_Union[BodyPose, _Mapping]] = ..., articulation: _Optional[float] = ..., sd_articulation: _Optional[float] = ..., wheel_angle: _Optional[float] = ..., sd_wheel_angle: _Optional[float] = ..., direction: _Optional[int] = ..., utc_ns: _Optional[int] = ..., receivers: _Optional[int] = ..., flags: _Optional[_Iterable[str]] = ..., sd_time: _Optional[float] = ...) -> None: ...

class Reason(_message.Message):
    __slots__ = ("code", "of", "numbers", "because")
    CODE_FIELD_NUMBER: _ClassVar[int]
    OF_FIELD_NUMBER: _ClassVar[int]
    NUMBERS_FIELD_NUMBER: _ClassVar[int]
    BECAUSE_FIELD_NUMBER: _ClassVar[int]
    code: str
    of: _containers.RepeatedScalarFieldContainer[str]
    numbers: _containers.RepeatedScalarFieldContainer[float]
    because: _containers.RepeatedCompositeFieldContainer[Reason]
    def __init__(self, code: _Optional[str] = ..., of: _Optional[_Iterable[str]] = ..., numbers: _Optional[_Iterable[float]] = ..., because: _Optional[_Iterable[_Union[Reason, _Mapping]]] = ...) -> None: ...

class Advice(_message.Message):
    __slots__ = ("kind", "parameters", "log_sds", "determined", "speed", "manoeuvre", "seconds", "degrees", "after", "turn_tells", "turn_after")
    KIND_FIELD_NUMBER: _ClassVar[int]
    PARAMETERS_FIELD_NUMBER: _ClassVar[int]
    LOG_SDS_FIELD_NUMBER: _ClassVar[int]
    DETERMINED_FIELD_NUMBER: _ClassVar[int]
    SPEED_FIELD_NUMBER: _ClassVar[int]
    MANOEUVRE_FIELD_NUMBER: _ClassVar[int]
    SECONDS_FIELD_NUMBER: _ClassVar[int]
    DEGREES_FIELD_NUMBER: _ClassVar[int]
    AFTER_FIELD_NUMBER: _ClassVar[int]
    TURN_TELLS_FIELD_NUMBER: _ClassVar[int]
    TURN_AFTER_FIELD_NUMBER: _ClassVar[int]
    kind: str
    parameters: _containers.RepeatedScalarFieldContainer[str]
    log_sds: _containers.RepeatedScalarFieldContainer[float]
    determined: bool
    speed: float
    manoeuvre: str
    seconds: float
    degrees: float
    after: _containers.RepeatedScalarFieldContainer[float]
    turn_tells: str
    turn_after: float
    def __init__(self, kind: _Optional[str] = ..., parameters: _Optional[_Iterable[str]] = ..., log_sds: _Optional[_Iterable[float]] = ..., determined: _Optional[bool] = ..., speed: _Optional[float] = ..., manoeuvre: _Optional[str] = ..., seconds: _Optional[float] = ..., degrees: _Optional[float] = ..., after: _Optional[_Iterable[float]] = ..., turn_tells: _Optional[str] = ..., turn_after: _Optional[float] = ...) -> None: ...

class Combination(_message.Message):
    __slots__ = ("exponents", "log_sd")
    EXPONENTS_FIELD_NUMBER: _ClassVar[int]
    LOG_SD_FIELD_NUMBER: _ClassVar[int]
    exponents: _containers.RepeatedScalarFieldContainer[float]
    log_sd: float
    def __init__(self, exponents: _Optional[_Iterable[float]] = ..., log_sd: _Optional[float] = ...) -> None: ...

class Parameter(_message.Message):
    __slots__ = ("name", "value", "sd", "status", "reason", "age_s", "per_mass", "per_mass_sd", "why")
    NAME_FIELD_NUMBER: _ClassVar[int]
    VALUE_FIELD_NUMBER: _ClassVar[int]
    SD_FIELD_NUMBER: _ClassVar[int]
    STATUS_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    AGE_S_FIELD_NUMBER: _ClassVar[int]
    PER_MASS_FIELD_NUMBER: _ClassVar[int]
    PER_MASS_SD_FIELD_NUMBER: _ClassVar[int]
    WHY_FIELD_NUMBER: _ClassVar[int]
    name: str
    value: float
    sd: float
    status: ParameterStatus
    reason: str
    age_s: float
    per_mass: float
    per_mass_sd: float
    why: Reason
    def __init__(self, name: _Optional[str] = ..., value: _Optional[float] = ..., sd: _Optional[float] = ..., status: _Optional[_Union[ParameterStatus, str]] = ..., reason: _Optional[str] = ..., age_s: _Optional[float] = ..., per_mass: _Optional[float] = ..., per_mass_sd: _Optional[float] = ..., why: _Optional[_Union[Reason, _Mapping]] = ...) -> None: ...

class Nuisance(_message.Message):
    __slots__ = ("name", "value", "sd")
    NAME_FIELD_NUMBER: _ClassVar[int]
    VALUE_FIELD_NUMBER: _ClassVar[int]
    SD_FIELD_NUMBER: _ClassVar[int]
    name: str
    value: float
    sd: float
    def __init__(self, name: _Optional[str] = ..., value: _Optional[float] = ..., sd: _Optional[float] = ...) -> None: ...

class Excitation(_message.Message):
    __slots__ = ("name", "value")
    NAME_FIELD_NUMBER: _ClassVar[int]
    VALUE_FIELD_NUMBER: _ClassVar[int]
    name: str
    value: float
    def __init__(self, name: _Optional[str] = ..., value: _Optional[float] = ...) -> None: ...

class OwnSteering(_message.Message):
    __slots__ = ("share", "rms", "seconds")
    SHARE_FIELD_NUMBER: _ClassVar[int]
    RMS_FIELD_NUMBER: _ClassVar[int]
    SECONDS_FIELD_NUMBER: _ClassVar[int]
    share: float
    rms: float
    seconds: float
    def __init__(self, share: _Optional[float] = ..., rms: _Optional[float] = ..., seconds: _Optional[float] = ...) -> None: ...

class SoilPlace(_message.Message):
    __slots__ = ("latitude_deg", "longitude_deg", "radius_m", "this_pass", "neighbours", "prior", "log_mean")
    LATITUDE_DEG_FIELD_NUMBER: _ClassVar[int]
    LONGITUDE_DEG_FIELD_NUMBER: _ClassVar[int]
    RADIUS_M_FIELD_NUMBER: _ClassVar[int]
    THIS_PASS_FIELD_NUMBER: _ClassVar[int]
    NEIGHBOURS_FIELD_NUMBER: _ClassVar[int]
    PRIOR_FIELD_NUMBER: _ClassVar[int]
    LOG_MEAN_FIELD_NUMBER: _ClassVar[int]
    latitude_deg: float
    longitude_deg: float
    radius_m: float
    this_pass: float
    neighbours: float
    prior: float
    log_mean: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, latitude_deg: _Optional[float] = ..., longitude_deg: _Optional[float] = ..., radius_m: _Optional[float] = ..., this_pass: _Optional[float] = ..., neighbours: _Optional[float] = ..., prior: _Optional[float] = ..., log_mean: _Optional[_Iterable[float]] = ...) -> None: ...

class SoilTireEstimate(_message.Message):
    __slots__ = ("t_ns", "method", "model", "parameters", "log_covariance", "nuisances", "rank", "condition", "excitation", "window_s", "rule", "determined", "bound", "advice", "chosen", "combinations", "advised", "own_steering", "of_place")
    T_NS_FIELD_NUMBER: _ClassVar[int]
    METHOD_FIELD_NUMBER: _ClassVar[int]
    MODEL_FIELD_NUMBER: _ClassVar[int]
    PARAMETERS_FIELD_NUMBER: _ClassVar[int]
    LOG_COVARIANCE_FIELD_NUMBER: _ClassVar[int]
    NUISANCES_FIELD_NUMBER: _ClassVar[int]
    RANK_FIELD_NUMBER: _ClassVar[int]
    CONDITION_FIELD_NUMBER: _ClassVar[int]
    EXCITATION_FIELD_NUMBER: _ClassVar[int]
    WINDOW_S_FIELD_NUMBER: _ClassVar[int]
    RULE_FIELD_NUMBER: _ClassVar[int]
    DETERMINED_FIELD_NUMBER: _ClassVar[int]
    BOUND_FIELD_NUMBER: _ClassVar[int]
    ADVICE_FIELD_NUMBER: _ClassVar[int]
    CHOSEN_FIELD_NUMBER: _ClassVar[int]
    COMBINATIONS_FIELD_NUMBER: _ClassVar[int]
    ADVISED_FIELD_NUMBER: _ClassVar[int]
    OWN_STEERING_FIELD_NUMBER: _ClassVar[int]
    OF_PLACE_FIELD_NUMBER: _ClassVar[int]
    t_ns: int
    method: str
    model: str
    parameters: _containers.RepeatedCompositeFieldContainer[Parameter]
    log_covariance: _containers.RepeatedScalarFieldContainer[float]
    nuisances: _containers.RepeatedCompositeFieldContainer[Nuisance]
    rank: int
    condition: float
    excitation: _containers.RepeatedCompositeFieldContainer[Excitation]
    window_s: float
    rule: str
    determined: _containers.RepeatedScalarFieldContainer[str]
    bound: _containers.RepeatedScalarFieldContainer[float]
    advice: str
    chosen: Reason
    combinations: _containers.RepeatedCompositeFieldContainer[Combination]
    advised: Advice
    own_steering: OwnSteering
    of_place: SoilPlace
    def __init__(self, t_ns: _Optional[int] = ..., method: _Optional[str] = ..., model: _Optional[str] = ..., parameters: _Optional[_Iterable[_Union[Parameter, _Mapping]]] = ..., log_covariance: _Optional[_Iterable[float]] = ..., nuisances: _Optional[_Iterable[_Union[Nuisance, _Mapping]]] = ..., rank: _Optional[int] = ..., condition: _Optional[float] = ..., excitation: _Optional[_Iterable[_Union[Excitation, _Mapping]]] = ..., window_s: _Optional[float] = ..., rule: _Optional[str] = ..., determined: _Optional[_Iterable[str]] = ..., bound: _Optional[_Iterable[float]] = ..., advice: _Optional[str] = ..., chosen: _Optional[_Union[Reason, _Mapping]] = ..., combinations: _Optional[_Iterable[_Union[Combination, _Mapping]]] = ..., advised: _Optional[_Union[Advice, _Mapping]] = ..., own_steering: _Optional[_Union[OwnSteering, _Mapping]] = ..., of_place: _Optional[_Union[SoilPlace, _Mapping]] = ...) -> None: ...

class FitOutcome(_message.Message):
    __slots__ = ("t_ns", "method", "asked_ns", "adopted", "awaited", "late_ns", "result", "job_sha256")
    T_NS_FIELD_NUMBER: _ClassVar[int]
    METHOD_FIELD_NUMBER: _ClassVar[int]
    ASKED_NS_FIELD_NUMBER: _ClassVar[int]
    ADOPTED_FIELD_NUMBER: _ClassVar[int]
    AWAITED_FIELD_NUMBER: _ClassVar[int]
    LATE_NS_FIELD_NUMBER: _ClassVar[int]
    RESULT_FIELD_NUMBER: _ClassVar[int]
    JOB_SHA256_FIELD_NUMBER: _ClassVar[int]
    t_ns: int
    method: str
    asked_ns: int
    adopted: bool
    awaited: bool
    late_ns: int
    result: str
    job_sha256: str
    def __init__(self, t_ns: _Optional[int] = ..., method: _Optional[str] = ..., asked_ns: _Optional[int] = ..., adopted: _Optional[bool] = ..., awaited: _Optional[bool] = ..., late_ns: _Optional[int] = ..., result: _Optional[str] = ..., job_sha256: _Optional[str] = ...) -> None: ...

class Tie(_message.Message):
    __slots__ = ("t_ns", "statistic", "threshold", "above")
    T_NS_FIELD_NUMBER: _ClassVar[int]
    STATISTIC_FIELD_NUMBER: _ClassVar[int]
    THRESHOLD_FIELD_NUMBER: _ClassVar[int]
    ABOVE_FIELD_NUMBER: _ClassVar[int]
    t_ns: int
    statistic: float
    threshold: float
    above: bool
    def __init__(self, t_ns: _Optional[int] = ..., statistic: _Optional[float] = ..., threshold: _Optional[float] = ..., above: _Optional[bool] = ...) -> None: ...

class Ready(_message.Message):
    __slots__ = ("t_ns", "ready", "text")
    T_NS_FIELD_NUMBER: _ClassVar[int]
    READY_FIELD_NUMBER: _ClassVar[int]
    TEXT_FIELD_NUMBER: _ClassVar[int]
    t_ns: int
    ready: bool
    text: str
    def __init__(self, t_ns: _Optional[int] = ..., ready: _Optional[bool] = ..., text: _Optional[str] = ...) -> None: ...

class Accepted(_message.Message):
    __slots__ = ("t_ns", "what", "amounts", "sds")
    T_NS_FIELD_NUMBER: _ClassVar[int]
    WHAT_FIELD_NUMBER: _ClassVar[int]
    AMOUNTS_FIELD_NUMBER: _ClassVar[int]
    SDS_FIELD_NUMBER: _ClassVar[int]
    t_ns: int
    what: str
    amounts: _containers.RepeatedScalarFieldContainer[float]
    sds: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, t_ns: _Optional[int] = ..., what: _Optional[str] = ..., amounts: _Optional[_Iterable[float]] = ..., sds: _Optional[_Iterable[float]] = ...) -> None: ...

class Carried(_message.Message):
    __slots__ = ("t_ns", "mass", "sd", "source")
    T_NS_FIELD_NUMBER: _ClassVar[int]
    MASS_FIELD_NUMBER: _ClassVar[int]
    SD_FIELD_NUMBER: _ClassVar[int]
    SOURCE_FIELD_NUMBER: _ClassVar[int]
    t_ns: int
    mass: float
    sd: float
    source: str
    def __init__(self, t_ns: _Optional[int] = ..., mass: _Optional[float] = ..., sd: _Optional[float] = ..., source: _Optional[str] = ...) -> None: ...

class Addresses(_message.Message):
    __slots__ = ("t_ns", "known", "machine_sha256")
    class Known(_message.Message):
        __slots__ = ("bus", "source", "name", "mount", "last_ns")
        BUS_FIELD_NUMBER: _ClassVar[int]
        SOURCE_FIELD_NUMBER: _ClassVar[int]
        NAME_FIELD_NUMBER: _ClassVar[int]
        MOUNT_FIELD_NUMBER: _ClassVar[int]
        LAST_NS_FIELD_NUMBER: _ClassVar[int]
        bus: str
        source: int
        name: int
        mount: str
        last_ns: int
        def __init__(self, bus: _Optional[str] = ..., source: _Optional[int] = ..., name: _Optional[int] = ..., mount: _Optional[str] = ..., last_ns: _Optional[int] = ...) -> None: ...
    T_NS_FIELD_NUMBER: _ClassVar[int]
    KNOWN_FIELD_NUMBER: _ClassVar[int]
    MACHINE_SHA256_FIELD_NUMBER: _ClassVar[int]
    t_ns: int
    known: _containers.RepeatedCompositeFieldContainer[Addresses.Known]
    machine_sha256: str
    def __init__(self, t_ns: _Optional[int] = ..., known: _Optional[_Iterable[_Union[Addresses.Known, _Mapping]]] = ..., machine_sha256: _Optional[str] = ...) -> None: ...

class Notice(_message.Message):
    __slots__ = ("code", "values", "parts", "reason")
    class Value(_message.Message):
        __slots__ = ("name", "number", "text")
        NAME_FIELD_NUMBER: _ClassVar[int]
        NUMBER_FIELD_NUMBER: _ClassVar[int]
        TEXT_FIELD_NUMBER: _ClassVar[int]
        name: str
        number: float
        text: str
        def __init__(self, name: _Optional[str] = ..., number: _Optional[float] = ..., text: _Optional[str] = ...) -> None: ...
    CODE_FIELD_NUMBER: _ClassVar[int]
    VALUES_FIELD_NUMBER: _ClassVar[int]
    PARTS_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    code: str
    values: _containers.RepeatedCompositeFieldContainer[Notice.Value]
    parts: _containers.RepeatedCompositeFieldContainer[Notice]
    reason: Reason
    def __init__(self, code: _Optional[str] = ..., values: _Optional[_Iterable[_Union[Notice.Value, _Mapping]]] = ..., parts: _Optional[_Iterable[_Union[Notice, _Mapping]]] = ..., reason: _Optional[_Union[Reason, _Mapping]] = ...) -> None: ...

class Event(_message.Message):
    __slots__ = ("t_ns", "kind", "text", "latitude_deg", "longitude_deg", "utc_ns", "notice")
    T_NS_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    TEXT_FIELD_NUMBER: _ClassVar[int]
    LATITUDE_DEG_FIELD_NUMBER: _ClassVar[int]
    LONGITUDE_DEG_FIELD_NUMBER: _ClassVar[int]
    UTC_NS_FIELD_NUMBER: _ClassVar[int]
    NOTICE_FIELD_NUMBER: _ClassVar[int]
    t_ns: int
    kind: str
    text: str
    latitude_deg: float
    longitude_deg: float
    utc_ns: int
    notice: Notice
    def __init__(self, t_ns: _Optional[int] = ..., kind: _Optional[str] = ..., text: _Optional[str] = ..., latitude_deg: _Optional[float] = ..., longitude_deg: _Optional[float] = ..., utc_ns: _Optional[int] = ..., notice: _Optional[_Union[Notice, _Mapping]] = ...) -> None: ...

class BusStatus(_message.Message):
    __slots__ = ("name", "state", "frames", "frames_per_s", "silent_s", "reopened", "error_frames", "lost_frames", "reason", "stamp", "controller", "errors", "failures", "silences", "load")
    NAME_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    FRAMES_FIELD_NUMBER: _ClassVar[int]
    FRAMES_PER_S_FIELD_NUMBER: _ClassVar[int]
    SILENT_S_FIELD_NUMBER: _ClassVar[int]
    REOPENED_FIELD_NUMBER: _ClassVar[int]
    ERROR_FRAMES_FIELD_NUMBER: _ClassVar[int]
    LOST_FRAMES_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    STAMP_FIELD_NUMBER: _ClassVar[int]
    CONTROLLER_FIELD_NUMBER: _ClassVar[int]
    ERRORS_FIELD_NUMBER: _ClassVar[int]
    FAILURES_FIELD_NUMBER: _ClassVar[int]
    SILENCES_FIELD_NUMBER: _ClassVar[int]
    LOAD_FIELD_NUMBER: _ClassVar[int]
    name: str
    state: str
    frames: int
    frames_per_s: float
    silent_s: float
    reopened: int
    error_frames: int
    lost_frames: int
    reason: str
    stamp: str
    controller: str
    errors: _containers.RepeatedCompositeFieldContainer[Count]
    failures: int
    silences: int
    load: float
    def __init__(self, name: _Optional[str] = ..., state: _Optional[str] = ..., frames: _Optional[int] = ..., frames_per_s: _Optional[float] = ..., silent_s: _Optional[float] = ..., reopened: _Optional[int] = ..., error_frames: _Optional[int] = ..., lost_frames: _Optional[int] = ..., reason: _Optional[str] = ..., stamp: _Optional[str] = ..., controller: _Optional[str] = ..., errors: _Optional[_Iterable[_Union[Count, _Mapping]]] = ..., failures: _Optional[int] = ..., silences: _Optional[int] = ..., load: _Optional[float] = ...) -> None: ...

class ReceiverStatus(_message.Message):
    __slots__ = ("mount", "state", "fix", "age_s", "source", "per_s", "fault", "fault_age_s")
    MOUNT_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    FIX_FIELD_NUMBER: _ClassVar[int]
    AGE_S_FIELD_NUMBER: _ClassVar[int]
    SOURCE_FIELD_NUMBER: _ClassVar[int]
    PER_S_FIELD_NUMBER: _ClassVar[int]
    FAULT_FIELD_NUMBER: _ClassVar[int]
    FAULT_AGE_S_FIELD_NUMBER: _ClassVar[int]
    mount: str
    state: str
    fix: str
    age_s: float
    source: int
    per_s: float
    fault: str
    fault_age_s: float
    def __init__(self, mount: _Optional[str] = ..., state: _Optional[str] = ..., fix: _Optional[str] = ..., age_s: _Optional[float] = ..., source: _Optional[int] = ..., per_s: _Optional[float] = ..., fault: _Optional[str] = ..., fault_age_s: _Optional[float] = ...) -> None: ...

class Count(_message.Message):
    __slots__ = ("reason", "count")
    REASON_FIELD_NUMBER: _ClassVar[int]
    COUNT_FIELD_NUMBER: _ClassVar[int]
    reason: str
    count: int
    def __init__(self, reason: _Optional[str] = ..., count: _Optional[int] = ...) -> None: ...

class Moved(_message.Message):
    __slots__ = ("names", "text")
    NAMES_FIELD_NUMBER: _ClassVar[int]
    TEXT_FIELD_NUMBER: _ClassVar[int]
    names: _containers.RepeatedScalarFieldContainer[str]
    text: str
    def __init__(self, names: _Optional[_Iterable[str]] = ..., text: _Optional[str] = ...) -> None: ...

class Status(_message.Message):
    __slots__ = ("t_ns", "run", "version", "uptime_s", "frames", "measurements", "poses", "buses", "receivers", "rejected", "recording", "log_file", "log_bytes", "disk_free_bytes", "problems", "wheel_angle", "fit_s", "health", "faults", "longest_turn_s", "hours_left", "resting", "preparing", "ready_in_s", "moved", "implement", "implements", "load", "full_load")
    T_NS_FIELD_NUMBER: _ClassVar[int]
    RUN_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    UPTIME_S_FIELD_NUMBER: _ClassVar[int]
    FRAMES_FIELD_NUMBER: _ClassVar[int]
    MEASUREMENTS_FIELD_NUMBER: _ClassVar[int]
    POSES_FIELD_NUMBER: _ClassVar[int]
    BUSES_FIELD_NUMBER: _ClassVar[int]
    RECEIVERS_FIELD_NUMBER: _ClassVar[int]
    REJECTED_FIELD_NUMBER: _ClassVar[int]
    RECORDING_FIELD_NUMBER: _ClassVar[int]
    LOG_FILE_FIELD_NUMBER: _ClassVar[int]
    LOG_BYTES_FIELD_NUMBER: _ClassVar[int]
    DISK_FREE_BYTES_FIELD_NUMBER: _ClassVar[int]
    PROBLEMS_FIELD_NUMBER: _ClassVar[int]
    WHEEL_ANGLE_FIELD_NUMBER: _ClassVar[int]
    FIT_S_FIELD_NUMBER: _ClassVar[int]
    HEALTH_FIELD_NUMBER: _ClassVar[int]
    FAULTS_FIELD_NUMBER: _ClassVar[int]
    LONGEST_TURN_S_FIELD_NUMBER: _ClassVar[int]
    HOURS_LEFT_FIELD_NUMBER: _ClassVar[int]
    RESTING_FIELD_NUMBER: _ClassVar[int]
    PREPARING_FIELD_NUMBER: _ClassVar[int]
    READY_IN_S_FIELD_NUMBER: _ClassVar[int]
    MOVED_FIELD_NUMBER: _ClassVar[int]
    IMPLEMENT_FIELD_NUMBER: _ClassVar[int]
    IMPLEMENTS_FIELD_NUMBER: _ClassVar[int]
    LOAD_FIELD_NUMBER: _ClassVar[int]
    FULL_LOAD_FIELD_NUMBER: _ClassVar[int]
    t_ns: int
    run: str
    version: str
    uptime_s: float
    frames: int
    measurements: int
    poses: int
    buses: _containers.RepeatedCompositeFieldContainer[BusStatus]
    receivers: _containers.RepeatedCompositeFieldContainer[ReceiverStatus]
    rejected: _containers.RepeatedCompositeFieldContainer[Count]
    recording: bool
    log_file: str
    log_bytes: int
    disk_free_bytes: float
    problems: _containers.RepeatedScalarFieldContainer[str]
    wheel_angle: ReceiverStatus
    fit_s: float
    health: str
    faults: _containers.RepeatedCompositeFieldContainer[Count]
    longest_turn_s: float
    hours_left: float
    resting: bool
    preparing: str
    ready_in_s: float
    moved: _containers.RepeatedCompositeFieldContainer[Moved]
    implement: str
    implements: _containers.RepeatedScalarFieldContainer[str]
    load: Carried
    full_load: float
    def __init__(self, t_ns: _Optional[int] = ..., run: _Optional[str] = ..., version: _Optional[str] = ..., uptime_s: _Optional[float] = ..., frames: _Optional[int] = ..., measurements: _Optional[int] = ..., poses: _Optional[int] = ..., buses: _Optional[_Iterable[_Union[BusStatus, _Mapping]]] = ..., receivers: _Optional[_Iterable[_Union[ReceiverStatus, _Mapping]]] = ..., rejected: _Optional[_Iterable[_Union[Count, _Mapping]]] = ..., recording: _Optional[bool] = ..., log_file: _Optional[str] = ..., log_bytes: _Optional[int] = ..., disk_free_bytes: _Optional[float] = ..., problems: _Optional[_Iterable[str]] = ..., wheel_angle: _Optional[_Union[ReceiverStatus, _Mapping]] = ..., fit_s: _Optional[float] = ..., health: _Optional[str] = ..., faults: _Optional[_Iterable[_Union[Count, _Mapping]]] = ..., longest_turn_s: _Optional[float] = ..., hours_left: _Optional[float] = ..., resting: _Optional[bool] = ..., preparing: _Optional[str] = ..., ready_in_s: _Optional[float] = ..., moved: _Optional[_Iterable[_Union[Moved, _Mapping]]] = ..., implement: _Optional[str] = ..., implements: _Optional[_Iterable[str]] = ..., load: _Optional[_Union[Carried, _Mapping]] = ..., full_load: _Optional[float] = ...) -> None: ...

class Snapshot(_message.Message):
    __slots__ = ("t_ns", "machine_sha256", "state_json")
    T_NS_FIELD_NUMBER: _ClassVar[int]
    MACHINE_SHA256_FIELD_NUMBER: _ClassVar[int]
    STATE_JSON_FIELD_NUMBER: _ClassVar[int]
    t_ns: int
    machine_sha256: str
    state_json: str
    def __init__(self, t_ns: _Optional[int] = ..., machine_sha256: _Optional[str] = ..., state_json: _Optional[str] = ...) -> None: ...

class Prior(_message.Message):
    __slots__ = ("name", "value", "log_sd")
    NAME_FIELD_NUMBER: _ClassVar[int]
    VALUE_FIELD_NUMBER: _ClassVar[int]
    LOG_SD_FIELD_NUMBER: _ClassVar[int]
    name: str
    value: float
    log_sd: float
    def __init__(self, name: _Optional[str] = ..., value: _Optional[float] = ..., log_sd: _Optional[float] = ...) -> None: ...

class Antenna(_message.Message):
    __slots__ = ("mount", "forward", "right", "height")
    MOUNT_FIELD_NUMBER: _ClassVar[int]
    FORWARD_FIELD_NUMBER: _ClassVar[int]
    RIGHT_FIELD_NUMBER: _ClassVar[int]
    HEIGHT_FIELD_NUMBER: _ClassVar[int]
    mount: str
    forward: float
    right: float
    height: float
    def __init__(self, mount: _Optional[str] = ..., forward: _Optional[float] = ..., right: _Optional[float] = ..., height: _Optional[float] = ...) -> None: ...

class Rig(_message.Message):
    __slots__ = ("name", "a", "b", "c", "d", "e", "m_t", "m_i", "I_t", "I_i", "h_t", "h_i", "priors", "antennas")
    NAME_FIELD_NUMBER: _ClassVar[int]
    A_FIELD_NUMBER: _ClassVar[int]
    B_FIELD_NUMBER: _ClassVar[int]
    C_FIELD_NUMBER: _ClassVar[int]
    D_FIELD_NUMBER: _ClassVar[int]
    E_FIELD_NUMBER: _ClassVar[int]
    M_T_FIELD_NUMBER: _ClassVar[int]
    M_I_FIELD_NUMBER: _ClassVar[int]
    I_T_FIELD_NUMBER: _ClassVar[int]
    I_I_FIELD_NUMBER: _ClassVar[int]
    H_T_FIELD_NUMBER: _ClassVar[int]
    H_I_FIELD_NUMBER: _ClassVar[int]
    PRIORS_FIELD_NUMBER: _ClassVar[int]
    ANTENNAS_FIELD_NUMBER: _ClassVar[int]
    name: str
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
    priors: _containers.RepeatedCompositeFieldContainer[Prior]
    antennas: _containers.RepeatedCompositeFieldContainer[Antenna]
    def __init__(self, name: _Optional[str] = ..., a: _Optional[float] = ..., b: _Optional[float] = ..., c: _Optional[float] = ..., d: _Optional[float] = ..., e: _Optional[float] = ..., m_t: _Optional[float] = ..., m_i: _Optional[float] = ..., I_t: _Optional[float] = ..., I_i: _Optional[float] = ..., h_t: _Optional[float] = ..., h_i: _Optional[float] = ..., priors: _Optional[_Iterable[_Union[Prior, _Mapping]]] = ..., antennas: _Optional[_Iterable[_Union[Antenna, _Mapping]]] = ...) -> None: ...

class ReportState(_message.Message):
    __slots__ = ("state", "text", "began_ns", "ended_ns")
    STATE_FIELD_NUMBER: _ClassVar[int]
    TEXT_FIELD_NUMBER: _ClassVar[int]
    BEGAN_NS_FIELD_NUMBER: _ClassVar[int]
    ENDED_NS_FIELD_NUMBER: _ClassVar[int]
    state: str
    text: str
    began_ns: int
    ended_ns: int
    def __init__(self, state: _Optional[str] = ..., text: _Optional[str] = ..., began_ns: _Optional[int] = ..., ended_ns: _Optional[int] = ...) -> None: ...

class PlayerState(_message.Message):
    __slots__ = ("run", "state", "at_s", "length_s", "rate", "jumps", "t_ns", "text", "share")
    RUN_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    AT_S_FIELD_NUMBER: _ClassVar[int]
    LENGTH_S_FIELD_NUMBER: _ClassVar[int]
    RATE_FIELD_NUMBER: _ClassVar[int]
    JUMPS_FIELD_NUMBER: _ClassVar[int]
    T_NS_FIELD_NUMBER: _ClassVar[int]
    TEXT_FIELD_NUMBER: _ClassVar[int]
    SHARE_FIELD_NUMBER: _ClassVar[int]
    run: str
    state: str
    at_s: float
    length_s: float
    rate: float
    jumps: int
    t_ns: int
    text: str
    share: float
    def __init__(self, run: _Optional[str] = ..., state: _Optional[str] = ..., at_s: _Optional[float] = ..., length_s: _Optional[float] = ..., rate: _Optional[float] = ..., jumps: _Optional[int] = ..., t_ns: _Optional[int] = ..., text: _Optional[str] = ..., share: _Optional[float] = ...) -> None: ...

class PlayerOrder(_message.Message):
    __slots__ = ("kind", "run", "at_s", "rate")
    KIND_FIELD_NUMBER: _ClassVar[int]
    RUN_FIELD_NUMBER: _ClassVar[int]
    AT_S_FIELD_NUMBER: _ClassVar[int]
    RATE_FIELD_NUMBER: _ClassVar[int]
    kind: str
    run: str
    at_s: float
    rate: float
    def __init__(self, kind: _Optional[str] = ..., run: _Optional[str] = ..., at_s: _Optional[float] = ..., rate: _Optional[float] = ...) -> None: ...

class Place(_message.Message):
    __slots__ = ("at_s", "kind", "data", "t_ns", "text")
    AT_S_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    DATA_FIELD_NUMBER: _ClassVar[int]
    T_NS_FIELD_NUMBER: _ClassVar[int]
    TEXT_FIELD_NUMBER: _ClassVar[int]
    at_s: float
    kind: str
    data: bytes
    t_ns: int
    text: str
    def __init__(self, at_s: _Optional[float] = ..., kind: _Optional[str] = ..., data: _Optional[bytes] = ..., t_ns: _Optional[int] = ..., text: _Optional[str] = ...) -> None: ...

class Places(_message.Message):
    __slots__ = ("run", "rows")
    RUN_FIELD_NUMBER: _ClassVar[int]
    ROWS_FIELD_NUMBER: _ClassVar[int]
    run: str
    rows: _containers.RepeatedCompositeFieldContainer[Place]
    def __init__(self, run: _Optional[str] = ..., rows: _Optional[_Iterable[_Union[Place, _Mapping]]] = ...) -> None: ...

class RunListing(_message.Message):
    __slots__ = ("name", "began", "length_s", "latitude_deg", "longitude_deg", "learned", "machine", "notes", "state", "simulated")
    NAME_FIELD_NUMBER: _ClassVar[int]
    BEGAN_FIELD_NUMBER: _ClassVar[int]
    LENGTH_S_FIELD_NUMBER: _ClassVar[int]
    LATITUDE_DEG_FIELD_NUMBER: _ClassVar[int]
    LONGITUDE_DEG_FIELD_NUMBER: _ClassVar[int]
    LEARNED_FIELD_NUMBER: _ClassVar[int]
    MACHINE_FIELD_NUMBER: _ClassVar[int]
    NOTES_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    SIMULATED_FIELD_NUMBER: _ClassVar[int]
    name: str
    began: str
    length_s: float
    latitude_deg: float
    longitude_deg: float
    learned: SoilTireEstimate
    machine: str
    notes: _containers.RepeatedScalarFieldContainer[str]
    state: str
    simulated: bool
    def __init__(self, name: _Optional[str] = ..., began: _Optional[str] = ..., length_s: _Optional[float] = ..., latitude_deg: _Optional[float] = ..., longitude_deg: _Optional[float] = ..., learned: _Optional[_Union[SoilTireEstimate, _Mapping]] = ..., machine: _Optional[str] = ..., notes: _Optional[_Iterable[str]] = ..., state: _Optional[str] = ..., simulated: _Optional[bool] = ...) -> None: ...

class RunListings(_message.Message):
    __slots__ = ("rows",)
    ROWS_FIELD_NUMBER: _ClassVar[int]
    rows: _containers.RepeatedCompositeFieldContainer[RunListing]
    def __init__(self, rows: _Optional[_Iterable[_Union[RunListing, _Mapping]]] = ...) -> None: ...

class ExperimentState(_message.Message):
    __slots__ = ("plan", "phase", "drive", "done", "of", "text", "conditions", "count_s", "at_s", "length_s", "wanted", "measured", "ahead", "largest", "speed", "attempts", "learned", "commands", "t_ns", "skipped", "prompter")
    PLAN_FIELD_NUMBER: _ClassVar[int]
    PHASE_FIELD_NUMBER: _ClassVar[int]
    DRIVE_FIELD_NUMBER: _ClassVar[int]
    DONE_FIELD_NUMBER: _ClassVar[int]
    OF_FIELD_NUMBER: _ClassVar[int]
    TEXT_FIELD_NUMBER: _ClassVar[int]
    CONDITIONS_FIELD_NUMBER: _ClassVar[int]
    COUNT_S_FIELD_NUMBER: _ClassVar[int]
    AT_S_FIELD_NUMBER: _ClassVar[int]
    LENGTH_S_FIELD_NUMBER: _ClassVar[int]
    WANTED_FIELD_NUMBER: _ClassVar[int]
    MEASURED_FIELD_NUMBER: _ClassVar[int]
    AHEAD_FIELD_NUMBER: _ClassVar[int]
    LARGEST_FIELD_NUMBER: _ClassVar[int]
    SPEED_FIELD_NUMBER: _ClassVar[int]
    ATTEMPTS_FIELD_NUMBER: _ClassVar[int]
    LEARNED_FIELD_NUMBER: _ClassVar[int]
    COMMANDS_FIELD_NUMBER: _ClassVar[int]
    T_NS_FIELD_NUMBER: _ClassVar[int]
    SKIPPED_FIELD_NUMBER: _ClassVar[int]
    PROMPTER_FIELD_NUMBER: _ClassVar[int]
    plan: str
    phase: str
    drive: str
    done: int
    of: int
    text: str
    conditions: _containers.RepeatedCompositeFieldContainer[ExperimentCondition]
    count_s: float
    at_s: float
    length_s: float
    wanted: float
    measured: float
    ahead: _containers.RepeatedScalarFieldContainer[float]
    largest: float
    speed: float
    attempts: _containers.RepeatedCompositeFieldContainer[ExperimentAttempt]
    learned: _containers.RepeatedScalarFieldContainer[str]
    commands: _containers.RepeatedScalarFieldContainer[str]
    t_ns: int
    skipped: int
    prompter: str
    def __init__(self, plan: _Optional[str] = ..., phase: _Optional[str] = ..., drive: _Optional[str] = ..., done: _Optional[int] = ..., of: _Optional[int] = ..., text: _Optional[str] = ..., conditions: _Optional[_Iterable[_Union[ExperimentCondition, _Mapping]]] = ..., count_s: _Optional[float] = ..., at_s: _Optional[float] = ..., length_s: _Optional[float] = ..., wanted: _Optional[float] = ..., measured: _Optional[float] = ..., ahead: _Optional[_Iterable[float]] = ..., largest: _Optional[float] = ..., speed: _Optional[float] = ..., attempts: _Optional[_Iterable[_Union[ExperimentAttempt, _Mapping]]] = ..., learned: _Optional[_Iterable[str]] = ..., commands: _Optional[_Iterable[str]] = ..., t_ns: _Optional[int] = ..., skipped: _Optional[int] = ..., prompter: _Optional[str] = ...) -> None: ...

class ExperimentPrompt(_message.Message):
    __slots__ = ("t_ns", "phase", "drive", "text", "count", "wanted_deg", "measured_deg", "ahead_deg", "left_end_deg", "right_end_deg", "conditions")
    T_NS_FIELD_NUMBER: _ClassVar[int]
    PHASE_FIELD_NUMBER: _ClassVar[int]
    DRIVE_FIELD_NUMBER: _ClassVar[int]
    TEXT_FIELD_NUMBER: _ClassVar[int]
    COUNT_FIELD_NUMBER: _ClassVar[int]
    WANTED_DEG_FIELD_NUMBER: _ClassVar[int]
    MEASURED_DEG_FIELD_NUMBER: _ClassVar[int]
    AHEAD_DEG_FIELD_NUMBER: _ClassVar[int]
    LEFT_END_DEG_FIELD_NUMBER: _ClassVar[int]
    RIGHT_END_DEG_FIELD_NUMBER: _ClassVar[int]
    CONDITIONS_FIELD_NUMBER: _ClassVar[int]
    t_ns: int
    phase: str
    drive: str
    text: str
    count: int
    wanted_deg: float
    measured_deg: float
    ahead_deg: _containers.RepeatedScalarFieldContainer[float]
    left_end_deg: float
    right_end_deg: float
    conditions: _containers.RepeatedCompositeFieldContainer[ExperimentCondition]
    def __init__(self, t_ns: _Optional[int] = ..., phase: _Optional[str] = ..., drive: _Optional[str] = ..., text: _Optional[str] = ..., count: _Optional[int] = ..., wanted_deg: _Optional[float] = ..., measured_deg: _Optional[float] = ..., ahead_deg: _Optional[_Iterable[float]] = ..., left_end_deg: _Optional[float] = ..., right_end_deg: _Optional[float] = ..., conditions: _Optional[_Iterable[_Union[ExperimentCondition, _Mapping]]] = ...) -> None: ...

class ExperimentCondition(_message.Message):
    __slots__ = ("name", "met", "text")
    NAME_FIELD_NUMBER: _ClassVar[int]
    MET_FIELD_NUMBER: _ClassVar[int]
    TEXT_FIELD_NUMBER: _ClassVar[int]
    name: str
    met: bool
    text: str
    def __init__(self, name: _Optional[str] = ..., met: _Optional[bool] = ..., text: _Optional[str] = ...) -> None: ...

class ExperimentAttempt(_message.Message):
    __slots__ = ("name", "outcome", "reason", "why")
    NAME_FIELD_NUMBER: _ClassVar[int]
    OUTCOME_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    WHY_FIELD_NUMBER: _ClassVar[int]
    name: str
    outcome: str
    reason: str
    why: Notice
    def __init__(self, name: _Optional[str] = ..., outcome: _Optional[str] = ..., reason: _Optional[str] = ..., why: _Optional[_Union[Notice, _Mapping]] = ...) -> None: ...

class ExperimentOrder(_message.Message):
    __slots__ = ("kind",)
    KIND_FIELD_NUMBER: _ClassVar[int]
    kind: str
    def __init__(self, kind: _Optional[str] = ...) -> None: ...

class CalibrationState(_message.Message):
    __slots__ = ("machine", "phase", "text", "happening", "stages", "numbers", "found", "computing", "computed", "told", "notes", "left")
    MACHINE_FIELD_NUMBER: _ClassVar[int]
    PHASE_FIELD_NUMBER: _ClassVar[int]
    TEXT_FIELD_NUMBER: _ClassVar[int]
    HAPPENING_FIELD_NUMBER: _ClassVar[int]
    STAGES_FIELD_NUMBER: _ClassVar[int]
    NUMBERS_FIELD_NUMBER: _ClassVar[int]
    FOUND_FIELD_NUMBER: _ClassVar[int]
    COMPUTING_FIELD_NUMBER: _ClassVar[int]
    COMPUTED_FIELD_NUMBER: _ClassVar[int]
    TOLD_FIELD_NUMBER: _ClassVar[int]
    NOTES_FIELD_NUMBER: _ClassVar[int]
    LEFT_FIELD_NUMBER: _ClassVar[int]
    machine: str
    phase: str
    text: str
    happening: str
    stages: _containers.RepeatedCompositeFieldContainer[CalibrationStage]
    numbers: _containers.RepeatedCompositeFieldContainer[CalibrationNumber]
    found: _containers.RepeatedScalarFieldContainer[str]
    computing: bool
    computed: str
    told: _containers.RepeatedScalarFieldContainer[str]
    notes: _containers.RepeatedScalarFieldContainer[str]
    left: _containers.RepeatedCompositeFieldContainer[CalibrationLeft]
    def __init__(self, machine: _Optional[str] = ..., phase: _Optional[str] = ..., text: _Optional[str] = ..., happening: _Optional[str] = ..., stages: _Optional[_Iterable[_Union[CalibrationStage, _Mapping]]] = ..., numbers: _Optional[_Iterable[_Union[CalibrationNumber, _Mapping]]] = ..., found: _Optional[_Iterable[str]] = ..., computing: _Optional[bool] = ..., computed: _Optional[str] = ..., told: _Optional[_Iterable[str]] = ..., notes: _Optional[_Iterable[str]] = ..., left: _Optional[_Iterable[_Union[CalibrationLeft, _Mapping]]] = ...) -> None: ...

class CalibrationStage(_message.Message):
    __slots__ = ("name", "title", "what", "why", "share", "done", "complete", "told")
    NAME_FIELD_NUMBER: _ClassVar[int]
    TITLE_FIELD_NUMBER: _ClassVar[int]
    WHAT_FIELD_NUMBER: _ClassVar[int]
    WHY_FIELD_NUMBER: _ClassVar[int]
    SHARE_FIELD_NUMBER: _ClassVar[int]
    DONE_FIELD_NUMBER: _ClassVar[int]
    COMPLETE_FIELD_NUMBER: _ClassVar[int]
    TOLD_FIELD_NUMBER: _ClassVar[int]
    name: str
    title: str
    what: str
    why: str
    share: float
    done: str
    complete: bool
    told: str
    def __init__(self, name: _Optional[str] = ..., title: _Optional[str] = ..., what: _Optional[str] = ..., why: _Optional[str] = ..., share: _Optional[float] = ..., done: _Optional[str] = ..., complete: _Optional[bool] = ..., told: _Optional[str] = ...) -> None: ...

class CalibrationLeft(_message.Message):
    __slots__ = ("words", "ratio", "text", "more")
    WORDS_FIELD_NUMBER: _ClassVar[int]
    RATIO_FIELD_NUMBER: _ClassVar[int]
    TEXT_FIELD_NUMBER: _ClassVar[int]
    MORE_FIELD_NUMBER: _ClassVar[int]
    words: str
    ratio: float
    text: str
    more: bool
    def __init__(self, words: _Optional[str] = ..., ratio: _Optional[float] = ..., text: _Optional[str] = ..., more: _Optional[bool] = ...) -> None: ...

class CalibrationNumber(_message.Message):
    __slots__ = ("words", "change", "before", "now", "wanted", "status", "tell")
    WORDS_FIELD_NUMBER: _ClassVar[int]
    CHANGE_FIELD_NUMBER: _ClassVar[int]
    BEFORE_FIELD_NUMBER: _ClassVar[int]
    NOW_FIELD_NUMBER: _ClassVar[int]
    WANTED_FIELD_NUMBER: _ClassVar[int]
    STATUS_FIELD_NUMBER: _ClassVar[int]
    TELL_FIELD_NUMBER: _ClassVar[int]
    words: str
    change: str
    before: str
    now: str
    wanted: str
    status: str
    tell: str
    def __init__(self, words: _Optional[str] = ..., change: _Optional[str] = ..., before: _Optional[str] = ..., now: _Optional[str] = ..., wanted: _Optional[str] = ..., status: _Optional[str] = ..., tell: _Optional[str] = ...) -> None: ...

class CalibrationOrder(_message.Message):
    __slots__ = ("kind",)
    KIND_FIELD_NUMBER: _ClassVar[int]
    kind: str
    def __init__(self, kind: _Optional[str] = ...) -> None: ...
