"""The controller: what the daemon says of poses and soil goes in, the guidance command of ISO 11783 comes
out.

latest estimate, in patches that of the place ahead ─► cautious parameters ─► follower's gains
pose            ─► field's plane       ─► follower ─► wheel angle ─► curvature ─► CAN, PGN 44288

No clock and no wire: who owns them calls it. So the process on a rig (__main__.py) and the deterministic
loop of the study (lockstep.py) run the same lines.
"""

import math
from dataclasses import replace
from typing import Final

from pyproj import Transformer

from tilth.adaptive_guidance.follower import BodyState, Follower, MeasuredPose
from tilth.adaptive_guidance.plan import STEP, Plan
from tilth.client import Cautious, InForce, Latest, Limits, Staleness
from tilth.client.latest import judge
from tilth.estimator.models.parameters import Rig
from tilth.estimator.results.recommend import PATCHY, RECOMMENDATION
from tilth.schemas.decode import encode, frames_of
from tilth.schemas.flow import BodyPose, Pose, Status, Word

COMMAND: Final = 44288
ADDRESS: Final = 0x80  # source address of this controller; a rig's own would claim one
STEERING: Final = 0xF0  # address of the steering ECU
STALE: Final = Staleness(silence_s=3.0, data_s=300.0)
LIMITS: Final = Limits(ratio=3.0, per_s=0.1, log_sd=0.3, doubt_sd=3.0)
PLACE_DOUBT_SD: Final = 1.0  # where soil is in patches
AHEAD_S: Final = 1.0  # that the place of which a controller asks is ahead: an estimate comes each second


class Controller:
    """Steers the implement along a plan; begins, and stays where nothing may be used, at the nominal
    gains."""

    def __init__(
        self, plan: Plan, nominal: Rig, origin_deg: tuple[float, float], limits: Limits = LIMITS
    ) -> None:
        """nominal: as the machine file has it. origin_deg: latitude and longitude of the plan's x = y = 0."""
        self.follower = Follower(plan, nominal)
        self.code, self.reason = "no_pose", "no pose yet"  # why nothing is commanded; "" while it steers
        self.unusable = 0  # poses that lack something
        self._limits = limits
        self._cautious = Cautious(nominal.theta, limits)
        self._plane = _plane(origin_deg)
        self._origin = math.nan, math.nan  # latitude and longitude of the poses' origin
        self._shift = 0.0, 0.0  # its north and east here, m

    def ahead(self) -> tuple[float, float] | None:
        """Where its rear axle will be, of which to ask `estimate_at`: m, in the plane of the last pose."""
        speed, plan = self.follower.speed, self.follower.plan
        if speed is None:
            return None
        at = min(round(self.follower.station + speed * AHEAD_S / STEP), len(plan.row) - 1)
        x, y, heading = plan.tractor[at].tolist()
        b, (north, east) = self.follower.rig.b, self._shift
        return x - b * math.cos(heading) - north, y - b * math.sin(heading) - east

    def estimate(self, latest: Latest, now: float, ahead: Latest | None = None) -> InForce:
        """Take what may be used of the last estimate at this moment, s. Call it with each command.

        ahead: what `estimate_at` says of the place `ahead`; used while soil is thought to be in patches. Its
        means are used, also where they are too uncertain to be given as numbers: they are of all axles, and
        where little was told near the file's already (kriging), so that there is less left to doubt.
        """
        told = None if ahead is None else _of_means(ahead)
        of_place = replace(self._limits, log_sd=math.inf, doubt_sd=min(self._limits.doubt_sd, PLACE_DOUBT_SD))
        self._cautious.limits = self._limits if told is None else of_place
        force = self._cautious.step(latest if told is None else told, now)
        self.follower.theta = force.theta
        return force

    def pose(self, pose: Pose, at: float) -> None:
        """Take a pose, whose instant was `at` on the caller's clock, s."""
        origin = pose.origin_latitude_deg, pose.origin_longitude_deg
        if origin != self._origin:
            east, north = self._plane.transform(origin[1], origin[0])
            self._origin, self._shift = origin, (north, east)
        tractor, implement = self._body(pose.tractor), self._body(pose.implement)
        speed, angle = pose.tractor.forward_velocity, pose.wheel_angle
        if tractor is None or implement is None or speed is None or angle is None:
            self.unusable += 1
            return
        self.follower.pose(MeasuredPose(at, tractor, implement, speed, angle))

    def command(self, now: float) -> list[tuple[int, bytes]]:
        """Frames to send now, (identifier, data): an intention to steer, or none and why in `reason`."""
        command = self.follower.command(now)
        self.code, self.reason = command.code, command.reason
        if command.wheel_angle is None:
            return self.release()
        bend = math.tan(command.wheel_angle) / self.follower.rig.wheelbase
        return _frames({"commanded_curvature_per_m": bend, "command_status": "intended"})

    def release(self) -> list[tuple[int, bytes]]:
        """Frames that let go of the steering."""
        return _frames({"commanded_curvature_per_m": 0.0, "command_status": "not_intended"})

    def _body(self, body: BodyPose) -> BodyState | None:
        x, y, heading = body.x, body.y, body.heading
        v, r = body.lateral_velocity, body.yaw_rate
        if x is None or y is None or heading is None or v is None or r is None:
            return None
        north, east = self._shift
        return BodyState(x + north, y + east, heading, v, r, body.roll or 0.0)


def _of_means(ahead: Latest) -> Latest | None:
    """With the means of a place for numbers; None where there are none, or soil is hardly in patches."""
    one = ahead.estimate
    if one is None or one.of_place is None or not one.of_place.log_mean:
        return None
    if one.excitation.get(PATCHY, 0.0) <= RECOMMENDATION.patchy:
        return None
    parameters = tuple(
        replace(p, value=math.exp(log), status=Status.ESTIMATED)
        for p, log in zip(one.parameters, one.of_place.log_mean, strict=True)
    )
    return judge(replace(one, parameters=parameters), ahead.age_s, STALE)


def _frames(words: dict[str, Word]) -> list[tuple[int, bytes]]:
    return frames_of(COMMAND, encode(COMMAND, words), ADDRESS, STEERING)


def _plane(origin_deg: tuple[float, float]) -> Transformer:
    plane = f"+proj=tmerc +lat_0={origin_deg[0]} +lon_0={origin_deg[1]} +k=1 +ellps=WGS84 +units=m"
    return Transformer.from_crs("EPSG:4326", plane, always_xy=True)
