"""One pose, for checks of single poses."""

from tilth.schemas.flow import (
    BodyPose,
    Pose,
)


def pose_of(u: float, r: float, wheel: float | None) -> Pose:
    body = BodyPose(0.0, 0.0, 0.02, 0.0, 0.003, u, 0.0, 0.03, 0.03, r, 0.005, 0.0, 0.01)
    return Pose(0, 43.5, -83.4, body, body, 0.0, 0.004, wheel, 0.002, 1, None, 0.01, 4, ())
