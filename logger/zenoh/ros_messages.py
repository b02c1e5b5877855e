"""What is published, as messages of ROS 2, in its frames and units (REP 103, REP 105).

x east, y north, z up in the map; x forward, y left, z up on a body, yaw anticlockwise from the east. Trees
of several machines stay apart: each frame begins with the machine's name. map and odom are one frame, since
poses are of receivers and do not drift:

    NAME/map ─► NAME/odom ─► NAME/base_link (tractor) ─► its front wheels
                          └► NAME/implement_link

Both links are at the centre of gravity of their body. Stamps are UTC as soon as a receiver has told it,
before that the clock of the log.
"""

import math
import re
from collections.abc import Callable, Iterable
from importlib.resources import files
from typing import Any, Final, NamedTuple

import numpy as np
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from tilth.estimator.pose.body_frames import body_quaternion
from tilth.schemas.flow import Mount
from tilth.schemas.machine import Machine
from tilth.schemas.proto import tilth_pb2 as pb

ODOMETRY: Final = "nav_msgs/msg/Odometry"
TRANSFORMS: Final = "tf2_msgs/msg/TFMessage"
FIX: Final = "sensor_msgs/msg/NavSatFix"
DIAGNOSTICS: Final = "diagnostic_msgs/msg/DiagnosticArray"
ESTIMATE: Final = "tilth_msgs/msg/SoilTireEstimate"
_OWN: Final = ("SoilTireParameter", "SoilTireEstimate")  # one that is made of another comes after it
_FRAMES: Final = {"world": "odom", "tractor": "base_link", "implement": "implement_link"}
_BODIES: Final = ("tractor", "implement")
_UNKNOWN: Final = 1e6  # a variance; what has none is said to be 0 in ROS, which would be certain
_CORRECTED: Final = ("rtk_fixed", "rtk_float", "dgnss")  # by a base station: what GBAS means there
_LEVELS: Final = {
    "alive": "OK",
    "open": "OK",
    "good": "OK",
    "waiting": "WARN",
    "degraded": "WARN",
    "silent": "WARN",
}

STORE: Final = get_typestore(Stores.ROS2_JAZZY)
for _name in _OWN:
    _text = files("tilth.ros2").joinpath("tilth_msgs", "msg", f"{_name}.msg").read_text(encoding="utf-8")
    STORE.register(get_types_from_msg(_text, f"tilth_msgs/msg/{_name}"))


class RosMessage(NamedTuple):
    topic: str  # below the node's namespace, or global with a leading /
    type: str
    value: Any  # a dataclass of STORE


class RosTopic(NamedTuple):
    name: str
    type: str


def _new(kind: str, **fields: Any) -> Any:
    return STORE.types[kind](**fields)


def ros_name(name: str) -> str:
    """As part of a topic of ROS 2: letters, digits and _, no digit first."""
    plain = re.sub(r"[^A-Za-z0-9_]", "_", name)
    return f"_{plain}" if plain[:1].isdigit() else plain


class RosMessages:
    """Messages of one machine. Keeps when UTC was, and how good the receivers' fixes are."""

    def __init__(self, machine: Machine, replayed: bool = False) -> None:
        """replayed: of a replay or a simulation. Its topics and frames have a namespace of their own, also
        those that are global otherwise, so that no robot takes them for its own."""
        own = ros_name(machine.name)
        self.namespace = f"/{own}/replay" if replayed else f"/{own}"
        self._shared = self.namespace if replayed else ""
        self._prefix = self.namespace[1:]
        self._machine = machine.name
        self._utc_ahead_ns = 0
        self._fixes: dict[str, str] = {}
        self._of: dict[str, Callable[[bytes], Iterable[RosMessage]]] = {
            "/pose": self._odometry,
            "/drawing/frames": self._transforms,
            "/status": self._sensors,
            "/soil_tire": self._estimate,
            **{f"/gnss/{mount.value}": self._fix for mount in Mount},
        }
        self.topics = (
            *(RosTopic(f"{self.namespace}/{body}/odometry", ODOMETRY) for body in _BODIES),
            RosTopic(f"{self._shared}/tf", TRANSFORMS),
            *(RosTopic(f"{self.namespace}/gnss/{one.mount.value}/fix", FIX) for one in machine.receiver),
            RosTopic(f"{self._shared}/diagnostics", DIAGNOSTICS),
            RosTopic(f"{self.namespace}/soil_tire", ESTIMATE),
        )

    def of(self, topic: str, data: bytes) -> Iterable[RosMessage]:
        """What a publication of Tilth's is in ROS; nothing for topics that have no counterpart."""
        make = self._of.get(topic)
        return () if make is None else make(data)

    def _time(self, t_ns: int) -> Any:
        seconds, nanoseconds = divmod(t_ns + self._utc_ahead_ns, 1_000_000_000)
        return _new("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)

    def _header(self, t_ns: int, frame: str) -> Any:
        frame_id = f"{self._prefix}/{frame}" if frame else ""
        return _new("std_msgs/msg/Header", stamp=self._time(t_ns), frame_id=frame_id)

    def _odometry(self, data: bytes) -> Iterable[RosMessage]:
        pose = pb.Pose.FromString(data)
        if pose.HasField("utc_ns"):
            self._utc_ahead_ns = pose.utc_ns - pose.t_ns
        for body in _BODIES:
            one: pb.BodyPose = getattr(pose, body)
            if one.HasField("x") and one.HasField("heading"):
                value = _new(
                    ODOMETRY,
                    header=self._header(pose.t_ns, "odom"),
                    child_frame_id=f"{self._prefix}/{_FRAMES[body]}",
                    pose=_pose_of(one),
                    twist=_twist_of(one),
                )
                yield RosMessage(f"{self.namespace}/{body}/odometry", ODOMETRY, value)

    def _transforms(self, data: bytes) -> Iterable[RosMessage]:
        sent = FrameTransforms.FromString(data).transforms
        if not sent:
            return
        t_ns = sent[0].timestamp.ToNanoseconds()
        rows = [self._transform(t_ns, "map", "odom", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))]
        for one in sent:
            parent, child = (_FRAMES.get(name, name) for name in (one.parent_frame_id, one.child_frame_id))
            at, turned = one.translation, one.rotation
            rotation = turned.x, turned.y, turned.z, turned.w
            rows.append(self._transform(t_ns, parent, child, (at.x, at.y, at.z), rotation))
        yield RosMessage(f"{self._shared}/tf", TRANSFORMS, _new(TRANSFORMS, transforms=rows))

    def _transform(
        self, t_ns: int, parent: str, child: str, at: tuple[float, ...], rotation: tuple[float, ...]
    ) -> Any:
        return _new(
            "geometry_msgs/msg/TransformStamped",
            header=self._header(t_ns, parent),
            child_frame_id=f"{self._prefix}/{child}",
            transform=_new(
                "geometry_msgs/msg/Transform", translation=_vector(*at), rotation=_quaternion(*rotation)
            ),
        )

    def _fix(self, data: bytes) -> Iterable[RosMessage]:
        fix = LocationFix.FromString(data)
        status: Any = STORE.types["sensor_msgs/msg/NavSatStatus"]
        corrected = self._fixes.get(fix.frame_id) in _CORRECTED
        value = _new(
            FIX,
            header=self._header(fix.timestamp.ToNanoseconds(), fix.frame_id),
            status=status(
                status=status.STATUS_GBAS_FIX if corrected else status.STATUS_FIX,
                service=status.SERVICE_GPS,
            ),
            latitude=fix.latitude,
            longitude=fix.longitude,
            altitude=fix.altitude,
            position_covariance=np.array(fix.position_covariance),
            position_covariance_type=int(fix.position_covariance_type),
        )
        yield RosMessage(f"{self.namespace}/gnss/{fix.frame_id}/fix", FIX, value)

    def _sensors(self, data: bytes) -> Iterable[RosMessage]:
        status = pb.Status.FromString(data)
        self._fixes = {one.mount: one.fix for one in status.receivers}
        rows = [self._diagnostic("daemon", status.health, "; ".join(status.problems), {"run": status.run})]
        rows += [
            self._diagnostic(
                f"bus {one.name}",
                one.state,
                one.reason,
                {"frames": one.frames, "frames_per_s": one.frames_per_s, "lost_frames": one.lost_frames},
            )
            for one in status.buses
        ]
        receivers = [(one.mount, one) for one in status.receivers]
        rows += [
            self._diagnostic(name, one.state, one.fault, {"fix": one.fix, "per_s": one.per_s})
            for name, one in (*receivers, ("wheel_angle", status.wheel_angle))
        ]
        yield self._diagnostics(status.t_ns, rows)

    def _estimate(self, data: bytes) -> Iterable[RosMessage]:
        estimate = pb.SoilTireEstimate.FromString(data)
        value = _new(
            ESTIMATE,
            header=self._header(estimate.t_ns, "base_link"),
            machine=self._machine,
            method=estimate.method,
            parameters=[_parameter(one) for one in estimate.parameters],
            log_covariance=np.array(estimate.log_covariance, dtype=np.float64),
        )
        yield RosMessage(f"{self.namespace}/soil_tire", ESTIMATE, value)
        usable = sum(one.status == pb.ESTIMATED for one in estimate.parameters)
        values: dict[str, object] = {"method": estimate.method}
        for one in estimate.parameters:
            given = one.status == pb.ESTIMATED
            values[one.name] = f"{one.value:.6g} +- {one.sd:.2g}" if given else one.reason
        state = "good" if usable == len(estimate.parameters) else "waiting"
        told = f"{usable} of {len(estimate.parameters)} numbers may be used"
        yield self._diagnostics(estimate.t_ns, [self._diagnostic("soil_tire", state, told, values)])

    def _diagnostics(self, t_ns: int, rows: list[Any]) -> RosMessage:
        value = _new(DIAGNOSTICS, header=self._header(t_ns, ""), status=rows)
        return RosMessage(f"{self._shared}/diagnostics", DIAGNOSTICS, value)

    def _diagnostic(self, name: str, state: str, told: str, values: dict[str, object]) -> Any:
        status: Any = STORE.types["diagnostic_msgs/msg/DiagnosticStatus"]
        pairs = [_new("diagnostic_msgs/msg/KeyValue", key=key, value=str(one)) for key, one in values.items()]
        return status(
            level=getattr(status, _LEVELS.get(state, "ERROR")),
            name=f"{self._prefix}: {name}",
            message=": ".join(part for part in (state, told) if part),
            hardware_id=self._machine,
            values=pairs,
        )


def _pose_of(body: pb.BodyPose) -> Any:
    quaternion = _quaternion(*body_quaternion(body.heading, body.roll))
    point = _new("geometry_msgs/msg/Point", x=body.y, y=body.x, z=0.0)
    position = _variance(body, "sd_position")
    return _new(
        "geometry_msgs/msg/PoseWithCovariance",
        pose=_new("geometry_msgs/msg/Pose", position=point, orientation=quaternion),
        covariance=_covariance(
            position, position, _UNKNOWN, _variance(body, "sd_roll"), _UNKNOWN, _variance(body, "sd_heading")
        ),
    )


def _twist_of(body: pb.BodyPose) -> Any:
    return _new(
        "geometry_msgs/msg/TwistWithCovariance",
        twist=_new(
            "geometry_msgs/msg/Twist",
            linear=_vector(body.forward_velocity, -body.lateral_velocity, 0.0),
            angular=_vector(0.0, 0.0, -body.yaw_rate),
        ),
        covariance=_covariance(
            _variance(body, "sd_velocity"),
            _variance(body, "sd_lateral_velocity"),
            *(_UNKNOWN,) * 3,
            _variance(body, "sd_yaw_rate"),
        ),
    )


def _variance(body: pb.BodyPose, name: str) -> float:
    return getattr(body, name) ** 2 if body.HasField(name) else _UNKNOWN


def _covariance(*variances: float) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return np.diag(variances).reshape(36)


def _vector(x: float, y: float, z: float) -> Any:
    return _new("geometry_msgs/msg/Vector3", x=x, y=y, z=z)


def _quaternion(x: float, y: float, z: float, w: float) -> Any:
    return _new("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)


def _parameter(one: pb.Parameter) -> Any:
    given = one.status == pb.ESTIMATED

    def present(name: str, wanted: bool = True) -> float:
        return getattr(one, name) if wanted and one.HasField(name) else math.nan

    return _new(
        "tilth_msgs/msg/SoilTireParameter",
        name=one.name,
        status=int(one.status),
        value=present("value", given),
        sd=present("sd", given),
        per_mass=present("per_mass", given),
        age=present("age_s"),
        reason=one.reason,
    )
