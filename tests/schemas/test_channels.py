"""One row per published topic: schemas that stand alone, bytes that say what the value said."""

from dataclasses import fields
from typing import Any

import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

from tilth.estimator.methods.estimators import ESTIMATORS
from tilth.schemas import flow
from tilth.schemas.channels import CHANNELS, KINDS, TOPIC_OF, file_descriptor_set, payload
from tilth.schemas.proto import tilth_pb2 as pb

ORIGIN = flow.Origin("can0", 28, 0xA00017000421E240, flow.Mount.TRACTOR_REAR)
HEAD = (10, 9, ORIGIN, 65267, 4)
EXAMPLES: dict[str, Any] = {
    "position": flow.Position(*HEAD, 43.5, -83.4, 0.025, 204.4, True),
    "velocity": flow.Velocity(*HEAD, 1.5, 4.5, 0.05),
    "heading": flow.Heading(*HEAD, 6.1, 0.01),
    "yaw_rate": flow.YawRate(*HEAD, -0.2, 0.005),
    "attitude": flow.Attitude(*HEAD, 0.03, None, 0.01),
    "fix": flow.Fix(*HEAD, flow.FixType.RTK_FLOAT, 14, 0.8),
    "time": flow.UtcTime(*HEAD, 1_777_881_600_000_000_001, 1e-4),
    "wheel_angle": flow.WheelAngle(*HEAD, 0.1, 0.002),
    "hand_wheel_angle": flow.HandWheelAngle(*HEAD, -3.0),
    "curvature": flow.Curvature(*HEAD, 0.02),
    "vehicle_speed": flow.VehicleSpeed(*HEAD, 1.25, "reverse"),
    "weight": flow.Weight(*HEAD, 8127.0, 6000.0),
    "address_claim": flow.AddressClaim(*HEAD, 33, 123456),
}


@pytest.mark.parametrize("channel", CHANNELS, ids=lambda c: c.topic)
def test_the_schema_in_the_log_stands_alone(channel: Any) -> None:
    pool = descriptor_pool.DescriptorPool()
    files = descriptor_pb2.FileDescriptorSet.FromString(file_descriptor_set(channel.message.DESCRIPTOR))
    for file in files.file:
        pool.Add(file)
    found = pool.FindMessageTypeByName(channel.message.DESCRIPTOR.full_name)
    assert message_factory.GetMessageClass(found)().DESCRIPTOR.fields


def test_topics_and_keys_are_used_once() -> None:
    topics = [c.topic for c in CHANNELS]
    keys = [c.key for c in CHANNELS if c.key]
    assert len(set(topics)) == len(topics) and len(set(keys)) == len(keys)
    methods = {f"soil_tire/{row.method}" for row in ESTIMATORS}
    places = {f"gnss/{mount.value}" for mount in flow.Mount}
    drawn = {"drawing/frames", "drawing/bodies"}
    assert set(keys) == {"pose", "soil_tire", "event", "status", "rig", "report", *methods, *places, *drawn}


@pytest.mark.parametrize(("name", "kind"), KINDS, ids=lambda k: k if isinstance(k, str) else "")
def test_a_measurement_is_told_whole(name: str, kind: type[flow.Measurement]) -> None:
    value = EXAMPLES[name]
    assert type(value) is kind
    message = pb.Measurement.FromString(payload(flow.Publication(1, TOPIC_OF[kind], value)))
    assert (message.t_ns, message.rx_ns, message.bus, message.source) == (10, 9, "can0", 28)
    assert (message.name, message.mount, message.pgn, message.sid) == (ORIGIN.name, "tractor_rear", 65267, 4)
    for f in fields(kind):
        if f.name in ("t_ns", "rx_ns", "origin", "pgn", "sid"):
            continue
        wanted = getattr(value, f.name)
        assert message.HasField(f.name) == (wanted is not None)
        assert wanted is None or getattr(message, f.name) == wanted
