"""A drawing as messages that viewers of 3D scenes know: foxglove.FrameTransforms, foxglove.SceneUpdate."""

import math
from typing import Final

from foxglove_schemas_protobuf.CubePrimitive_pb2 import CubePrimitive
from foxglove_schemas_protobuf.CylinderPrimitive_pb2 import CylinderPrimitive
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from tilth.schemas.flow import BodyFrames, Drawing

_HALF: Final = math.sqrt(0.5)  # their cylinders stand on z; a quarter turn about x lays them along y


def encode_frames(value: BodyFrames) -> bytes:
    message = FrameTransforms()
    for one in value.transforms:
        x, y, z = one.translation
        qx, qy, qz, qw = one.rotation
        row = message.transforms.add(parent_frame_id=one.parent, child_frame_id=one.child)
        row.timestamp.FromNanoseconds(value.t_ns)
        row.translation.x, row.translation.y, row.translation.z = x, y, z
        row.rotation.x, row.rotation.y, row.rotation.z, row.rotation.w = qx, qy, qz, qw
    return message.SerializeToString()


def encode_drawing(value: Drawing) -> bytes:
    """One entity for each solid; it stays, and goes where its frame goes, until one of that name comes."""
    message = SceneUpdate()
    for solid in value.solids:
        entity = message.entities.add(id=solid.name, frame_id=solid.frame, frame_locked=True)
        entity.timestamp.FromNanoseconds(value.t_ns)
        part: CylinderPrimitive | CubePrimitive
        length, width, height = solid.size
        if solid.wheel:
            part = entity.cylinders.add(bottom_scale=1.0, top_scale=1.0)
            size = length, height, width
            part.pose.orientation.x = part.pose.orientation.w = _HALF
        else:
            part, size = entity.cubes.add(), (length, width, height)
            part.pose.orientation.w = 1.0
        at = part.pose.position
        at.x, at.y, at.z = solid.centre
        part.size.x, part.size.y, part.size.z = size
        part.color.r, part.color.g, part.color.b = solid.colour
        part.color.a = 1.0
    return message.SerializeToString()
