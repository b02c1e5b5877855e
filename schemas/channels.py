"""One row per published topic: its schema, its Zenoh key, how a value becomes bytes.

`CHANNELS` is an extension point: the log's schemas, the Zenoh keys and the comparison of live with replay
all come from it.
"""

from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, fields
from itertools import zip_longest
from typing import Any

from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.descriptor import Descriptor, FileDescriptor
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.message import Message as ProtoMessage

from tilth.schemas import flow
from tilth.schemas.drawing import encode_drawing, encode_frames
from tilth.schemas.identity import KnownAddress
from tilth.schemas.machine import Machine
from tilth.schemas.notices import Notice
from tilth.schemas.proto import tilth_pb2 as pb
from tilth.schemas.reasons import Reason
from tilth.schemas.sentences import advice_sentence, combination_words, event_sentence, sentence


@dataclass(frozen=True, slots=True)
class Channel:
    topic: str
    message: type[ProtoMessage]
    encode: Callable[[Any], bytes]
    key: str | None = None  # below <prefix>/<machine>/; None: logged only
    identical: bool = True  # replay gives the same bytes on the same machine
    logged: bool = True

    @property
    def encoding(self) -> str:
        """Zenoh encoding of the payload."""
        return f"application/protobuf;{self.message.DESCRIPTOR.full_name}"


_SKIPPED = {"origin", "t_ns", "rx_ns", "pgn", "sid", "sd"}


def _set_present(target: Any, value: Any, names: tuple[str, ...]) -> None:
    for name in names:
        item = getattr(value, name)
        if item is not None:
            setattr(target, name, item)


def _measurement_encoder(kind: type[flow.Measurement]) -> Callable[[Any], bytes]:
    own_fields = tuple(f.name for f in fields(kind) if f.name not in _SKIPPED)
    common = ("sid", "sd") if "sd" in kind.__dataclass_fields__ else ("sid",)

    def encode(value: flow.Measurement) -> bytes:
        origin = value.origin
        message = pb.Measurement(
            t_ns=value.t_ns, rx_ns=value.rx_ns, bus=origin.bus, source=origin.source, pgn=value.pgn
        )
        if origin.name is not None:
            message.name = origin.name
        if origin.mount is not None:
            message.mount = origin.mount.value
        _set_present(message, value, common)
        _set_present(message, value, own_fields)
        return message.SerializeToString()

    return encode


_BODY_FIELDS = tuple(f.name for f in fields(flow.BodyPose))
_POSE_FIELDS = (
    "articulation", "sd_articulation", "wheel_angle", "sd_wheel_angle", "utc_ns",
)  # fmt: skip


def _encode_pose(pose: flow.Pose) -> bytes:
    message = pb.Pose(
        t_ns=pose.t_ns,
        origin_latitude_deg=pose.origin_latitude_deg,
        origin_longitude_deg=pose.origin_longitude_deg,
        direction=pose.direction,
        receivers=pose.receivers,
        sd_time=pose.sd_time,
        flags=map(str, pose.flags),
    )
    _set_present(message, pose, _POSE_FIELDS)
    message.tractor.SetInParent()
    _set_present(message.tractor, pose.tractor, _BODY_FIELDS)
    message.implement.SetInParent()
    _set_present(message.implement, pose.implement, _BODY_FIELDS)
    return message.SerializeToString()


def _reason(reason: Reason) -> pb.Reason:
    because = [_reason(one) for one in reason.because]
    return pb.Reason(code=reason.code, of=reason.of, numbers=reason.numbers, because=because)


def _encode_estimate(estimate: flow.Estimate) -> bytes:
    message = pb.SoilTireEstimate(
        t_ns=estimate.t_ns,
        method=estimate.method,
        model=estimate.model,
        log_covariance=estimate.log_covariance,
        rank=estimate.rank,
        window_s=estimate.window_s,
        rule=sentence(estimate.rule),
        determined=map(combination_words, estimate.determined),
        bound=estimate.bound,
        advice=advice_sentence(estimate.advice),
    )
    if estimate.rule is not None:
        message.chosen.CopyFrom(_reason(estimate.rule))
    for one in estimate.determined:
        message.combinations.add(exponents=one.exponents, log_sd=one.log_sd)
    if estimate.advice is not None:
        message.advised.CopyFrom(pb.Advice(**asdict(estimate.advice)))
    if estimate.own_steering is not None:
        message.own_steering.CopyFrom(pb.OwnSteering(**asdict(estimate.own_steering)))
    if estimate.of_place is not None:
        message.of_place.CopyFrom(pb.SoilPlace(**asdict(estimate.of_place)))
    if estimate.condition is not None:
        message.condition = estimate.condition
    over_mass = zip_longest(flow.PARAMETERS, estimate.parameters, estimate.per_mass, estimate.per_mass_sd)
    for name, parameter, ratio, ratio_sd in over_mass:
        row = message.parameters.add(
            name=name, status=int(parameter.status), reason=sentence(parameter.reason)
        )
        if parameter.reason is not None:
            row.why.CopyFrom(_reason(parameter.reason))
        _set_present(row, parameter, ("value", "sd", "age_s"))
        if ratio is not None:
            row.per_mass = ratio
        if ratio_sd is not None:
            row.per_mass_sd = ratio_sd
    for name, (value, sd) in estimate.nuisances.items():
        message.nuisances.add(name=name, value=value, sd=sd)
    for name, amount in estimate.excitation.items():
        message.excitation.add(name=name, value=amount)
    return message.SerializeToString()


def notice_message(notice: Notice) -> pb.Notice:
    """As it is published."""
    message = pb.Notice(code=notice.code, parts=map(notice_message, notice.parts))
    for name, value in notice.values.items():
        if isinstance(value, str):
            message.values.add(name=name, text=value)
        else:
            message.values.add(name=name, number=value)
    if notice.reason is not None:
        message.reason.CopyFrom(_reason(notice.reason))
    return message


def _encode_event(event: flow.Event) -> bytes:
    message = pb.Event(
        t_ns=event.t_ns, kind=event.kind, text=event_sentence(event), notice=notice_message(event.notice)
    )
    _set_present(message, event, ("latitude_deg", "longitude_deg", "utc_ns"))
    return message.SerializeToString()


def _encode_outcome(outcome: flow.FitOutcome) -> bytes:
    return pb.FitOutcome(
        t_ns=outcome.t_ns,
        method=outcome.method,
        asked_ns=outcome.asked_ns,
        adopted=outcome.adopted,
        awaited=outcome.awaited,
        late_ns=outcome.late_ns,
        result=outcome.result,
        job_sha256=outcome.job_sha256,
    ).SerializeToString()


def decode_outcome(data: bytes) -> flow.FitOutcome:
    """As logged. Raises protobuf's DecodeError."""
    one = pb.FitOutcome.FromString(data)
    return flow.FitOutcome(
        one.t_ns, one.method, one.asked_ns, one.adopted, one.awaited, one.late_ns, one.result, one.job_sha256
    )


def _encode_tie(tie: flow.Tie) -> bytes:
    return pb.Tie(
        t_ns=tie.t_ns, statistic=tie.statistic, threshold=tie.threshold, above=tie.above
    ).SerializeToString()


def decode_tie(data: bytes) -> flow.Tie:
    """As logged. Raises protobuf's DecodeError."""
    one = pb.Tie.FromString(data)
    return flow.Tie(one.t_ns, one.statistic, one.threshold, one.above)


def _encode_ready(ready: flow.Ready) -> bytes:
    return pb.Ready(t_ns=ready.t_ns, ready=ready.ready, text=ready.text).SerializeToString()


def _encode_accepted(accepted: flow.Accepted) -> bytes:
    return pb.Accepted(
        t_ns=accepted.t_ns, what=accepted.what, amounts=accepted.amounts, sds=accepted.sds
    ).SerializeToString()


def carried_message(load: flow.Carried) -> pb.Carried:
    """As it is logged, and told in the status."""
    return pb.Carried(t_ns=load.t_ns, mass=load.mass, sd=load.sd, source=load.source)


def decode_carried(data: bytes) -> flow.Carried:
    """As logged. Raises protobuf's DecodeError, ValueError for a source that is not known."""
    one = pb.Carried.FromString(data)
    return flow.Carried(one.t_ns, one.mass, one.sd, flow.LoadSource(one.source))


def encode_addresses(t_ns: int, known: Iterable[KnownAddress], machine_sha256: str) -> bytes:
    """Who has which address, for the head of a log file. machine_sha256: of whose machine file they are."""
    message = pb.Addresses(t_ns=t_ns, machine_sha256=machine_sha256)
    for one in known:
        row = message.known.add(bus=one.bus, source=one.source, last_ns=one.last_ns)
        _set_present(row, one, ("name", "mount"))
    return message.SerializeToString()


def decode_addresses(data: bytes, machine_sha256: str) -> list[KnownAddress]:
    """What `encode_addresses` wrote; with another machine file only the NAMEs count.

    Raises what protobuf raises for other bytes, ValueError for a mount that is not known.
    """
    message = pb.Addresses.FromString(data)
    same = message.machine_sha256 == machine_sha256
    return [
        KnownAddress(
            one.bus,
            one.source,
            one.name if one.HasField("name") else None,
            flow.Mount(one.mount) if same and one.HasField("mount") else None,
            one.last_ns,
        )
        for one in message.known
    ]


def _encode_rig(machine: Machine) -> bytes:
    tractor, implement, tyres = machine.tractor, machine.implement, machine.tyres
    axles = (tyres.front, tyres.rear, tyres.implement)
    values = (*(axle.cornering_stiffness for axle in axles), *(axle.relaxation_length for axle in axles))
    message = pb.Rig(
        name=machine.name,
        a=tractor.a.value,
        b=tractor.b.value,
        c=tractor.c.value,
        d=implement.d.value,
        e=implement.e.value,
        m_t=tractor.mass.value,
        m_i=implement.mass.value,
        I_t=tractor.yaw_inertia.value,
        I_i=implement.yaw_inertia.value,
        h_t=tractor.cg_height.value,
        h_i=implement.cg_height.value,
    )
    for name, value, axle in zip(flow.PARAMETERS, values, axles * 2, strict=True):
        message.priors.add(name=name, value=value, log_sd=axle.log_sd)
    for receiver in machine.receiver:
        forward, right, height = receiver.position
        message.antennas.add(mount=receiver.mount.value, forward=forward, right=right, height=height)
    return message.SerializeToString()


def _encode_fix(position: flow.Position) -> bytes:
    variance = position.sd**2
    message = LocationFix(
        latitude=position.latitude_deg,
        longitude=position.longitude_deg,
        altitude=position.altitude_m or 0.0,
        frame_id=position.origin.mount or "",
        position_covariance=[variance, 0, 0, 0, variance, 0, 0, 0, 4 * variance],
        position_covariance_type=LocationFix.APPROXIMATED,
    )
    message.timestamp.FromNanoseconds(position.rx_ns)
    return message.SerializeToString()


KINDS: tuple[tuple[str, type[flow.Measurement]], ...] = (
    ("position", flow.Position),
    ("velocity", flow.Velocity),
    ("heading", flow.Heading),
    ("yaw_rate", flow.YawRate),
    ("attitude", flow.Attitude),
    ("fix", flow.Fix),
    ("time", flow.UtcTime),
    ("wheel_angle", flow.WheelAngle),
    ("hand_wheel_angle", flow.HandWheelAngle),
    ("curvature", flow.Curvature),
    ("vehicle_speed", flow.VehicleSpeed),
    ("weight", flow.Weight),
    ("address_claim", flow.AddressClaim),
)

TOPIC_OF: dict[type[flow.Measurement], str] = {kind: f"/measurement/{name}" for name, kind in KINDS}

FIT_TOPIC = "/fit"
TIE_TOPIC = "/tie"
READY_TOPIC = "/ready"
ACCEPTED_TOPIC = "/accepted"
ADDRESSES_TOPIC = "/addresses"
LOAD_TOPIC = "/load"

CHANNELS: tuple[Channel, ...] = (
    *(Channel(TOPIC_OF[kind], pb.Measurement, _measurement_encoder(kind)) for _, kind in KINDS),
    *(
        Channel(f"/gnss/{mount.value}", LocationFix, _encode_fix, key=f"gnss/{mount.value}")
        for mount in flow.Mount
    ),
    Channel("/pose", pb.Pose, _encode_pose, key="pose"),
    Channel("/drawing/frames", FrameTransforms, encode_frames, key="drawing/frames"),
    Channel("/drawing/bodies", SceneUpdate, encode_drawing, key="drawing/bodies"),
    Channel("/soil_tire", pb.SoilTireEstimate, _encode_estimate, key="soil_tire"),
    Channel("/soil_tire/steady_state", pb.SoilTireEstimate, _encode_estimate, key="soil_tire/steady_state"),
    Channel("/soil_tire/tracker", pb.SoilTireEstimate, _encode_estimate, key="soil_tire/tracker"),
    Channel("/soil_tire/pem", pb.SoilTireEstimate, _encode_estimate, key="soil_tire/pem"),
    Channel("/soil_tire/rows", pb.SoilTireEstimate, _encode_estimate, key="soil_tire/rows"),
    Channel("/soil_tire/place", pb.SoilTireEstimate, _encode_estimate, key="soil_tire/place"),
    Channel("/soil_tire/pem_two_step", pb.SoilTireEstimate, _encode_estimate, key="soil_tire/pem_two_step"),
    Channel(FIT_TOPIC, pb.FitOutcome, _encode_outcome),
    Channel(TIE_TOPIC, pb.Tie, _encode_tie, identical=False),  # elsewhere others lie so near
    Channel(READY_TOPIC, pb.Ready, _encode_ready, identical=False),
    Channel(ACCEPTED_TOPIC, pb.Accepted, _encode_accepted, identical=False),
    Channel(LOAD_TOPIC, pb.Carried, lambda load: carried_message(load).SerializeToString(), identical=False),
    Channel(ADDRESSES_TOPIC, pb.Addresses, pb.Addresses.SerializeToString, identical=False),
    Channel("/event", pb.Event, _encode_event, key="event", identical=False),
    Channel("/status", pb.Status, pb.Status.SerializeToString, key="status", identical=False),
    Channel("/rig", pb.Rig, _encode_rig, key="rig", identical=False, logged=False),
    Channel(
        "/report",
        pb.ReportState,
        pb.ReportState.SerializeToString,
        key="report",
        identical=False,
        logged=False,
    ),
)

WORDING: dict[str, tuple[str, ...]] = {
    "Parameter": ("reason",), "SoilTireEstimate": ("rule", "determined", "advice"), "Event": ("text",),
}  # fmt: skip
"""Message -> its fields that are words for people, made of codes beside them: no part of identity."""


def without_wording(message: ProtoMessage) -> ProtoMessage:
    """The message with the fields of WORDING cleared, in place, also in the messages within it."""
    for name in WORDING.get(message.DESCRIPTOR.name, ()):
        message.ClearField(name)
    for field, value in message.ListFields():
        if field.message_type is not None:
            for inner in value if field.is_repeated else (value,):
                without_wording(inner)
    return message


CHANNEL: dict[str, Channel] = {channel.topic: channel for channel in CHANNELS}


def payload(publication: flow.Publication) -> bytes:
    """The bytes of a publication, as logged and as put on Zenoh."""
    return CHANNEL[publication.topic].encode(publication.value)


def file_descriptor_set(descriptor: Descriptor) -> bytes:
    """Serialised FileDescriptorSet of a message with all that it imports: an MCAP protobuf schema."""
    result = FileDescriptorSet()
    added: set[str] = set()

    def add(file: FileDescriptor) -> None:
        if file.name in added:
            return
        added.add(file.name)
        for dependency in file.dependencies:
            add(dependency)
        file.CopyToProto(result.file.add())

    add(descriptor.file)
    return result.SerializeToString()
