"""A short run as the daemon would log it, but made by hand: what a report of it must say is known."""

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from logs import MACHINE, MACHINE_TEXT, SECOND, START_NS

from tilth.estimator.filters import unknowns
from tilth.logger.log.mcap_log import LogWriter, RunPart
from tilth.schemas.flow import (
    BodyPose,
    Estimate,
    Event,
    Fix,
    FixType,
    Flag,
    FlagKind,
    Frame,
    Mount,
    Origin,
    ParameterEstimate,
    Payload,
    Pose,
    Position,
    Publication,
    Status,
    WheelAngle,
)
from tilth.schemas.machine_toml import MachineFile
from tilth.schemas.notices import in_words
from tilth.schemas.reasons import Advice, AdviceKind, Code, Combination, Reason

SPEED = 4.0  # m/s
SECONDS = 60.0
ANGLE = math.radians(8.0)  # of the wheels, from 10 to 40 s
STEP_S = (10.0, 40.0)
TURNING = 0.15  # rad/s
WRITTEN = "<script>alert('a & b')</script>"
PLACE_DEG = (52.0, 5.0)
VALUES = (220e3, 540e3, 170e3, 1.1, 1.5, 0.9)
SHARE = 0.06  # sd of each logarithm
UTC = 0  # added to log times


@dataclass(frozen=True, slots=True)
class WrittenRun:
    """What is unusual about a run that is written."""

    mark: str = WRITTEN
    contradicted: bool = False
    without_estimates: bool = False
    without_poses: bool = False
    undetermined: tuple[str, ...] = ()
    finish: bool = True
    silent_s: tuple[float, float] = (0.0, 0.0)  # of the implement's rear receiver
    run: str = "field-1"


def write_run(path: Path, run: WrittenRun = WrittenRun()) -> Path:
    """The log file."""
    log = MACHINE.log.model_copy(update={"chunk_kilobytes": 4})
    writer = LogWriter(
        path,
        MachineFile(MACHINE.model_copy(update={"log": log}), MACHINE_TEXT),
        RunPart(run.run, 1, START_NS, "clay <dry>"),
    )
    writer.frame(Frame(START_NS, START_NS, "can0", 0x18FF0B15, True, False, run.run.encode()[:8]))
    for k in range(int(SECONDS * 5) + 1):
        t_ns = START_NS + k * SECOND // 5
        writer.publications(Publication(t_ns, *row) for row in _rows(run, k / 5.0, t_ns))
    writer.frame(Frame(START_NS + int(SECONDS) * SECOND, START_NS, "can0", 0x18FF0B15, True, False, bytes(8)))
    if run.finish:
        writer.close()
    else:
        writer.flush()
        writer.abandon()
    return path


def _rows(run: WrittenRun, t: float, t_ns: int) -> list[tuple[str, Payload]]:
    rows = [(f"/measurement/{kind}", one) for kind, one in _measurements(run, t, t_ns)]
    if not run.without_poses:
        rows.append(("/pose", pose(t, t_ns, run.contradicted)))
    if t % 1.0 == 0.0 and t >= 20.0 and not run.without_estimates:
        rows += [(topic, estimate(t, t_ns, method, run.undetermined)) for topic, method in TOPICS]
    if t == 30.0:
        rows.append(("/event", Event(t_ns, "mark", in_words(run.mark), *PLACE_DEG, t_ns)))
    if t == 45.0:
        rows.append(
            (
                "/event",
                Event(t_ns, "soil_change", in_words("the soil holds the tyres differently"), *PLACE_DEG),
            )
        )
    return rows


TOPICS = (("/soil_tire", "recommended"), ("/soil_tire/pem", "pem"), ("/soil_tire/tracker", "tracker"))


def _measurements(run: WrittenRun, t: float, t_ns: int) -> list[tuple[str, Payload]]:
    found: list[tuple[str, Payload]] = []
    for k, mount in enumerate(Mount):
        if mount is Mount.IMPLEMENT_REAR and run.silent_s[0] <= t < run.silent_s[1]:
            continue
        origin = Origin("can0", k + 1, None, mount)
        found.append(("position", Position(t_ns, t_ns, origin, 129025, None, *PLACE_DEG, 0.02)))
        if t % 1.0 == 0.0:
            found.append(("fix", Fix(t_ns, t_ns, origin, 129029, None, FixType.RTK_FIXED)))
    angle = WheelAngle(t_ns, t_ns, Origin("can0", -1), 65291, None, wheel_angle(t), 0.002)
    return [*found, ("wheel_angle", angle)]


def wheel_angle(t: float) -> float:
    """rad, at a time of the run."""
    return ANGLE if STEP_S[0] <= t < STEP_S[1] else 0.0


def pose(t: float, t_ns: int, contradicted: bool) -> Pose:
    """On a straight line, then on a circle, then straight again."""
    heading = TURNING * (min(max(t, STEP_S[0]), STEP_S[1]) - STEP_S[0])
    radius = SPEED / TURNING
    x = (
        SPEED * min(t, STEP_S[0])
        + radius * math.sin(heading)
        + SPEED * max(0.0, t - STEP_S[1]) * math.cos(heading)
    )
    y = radius * (1.0 - math.cos(heading)) + SPEED * max(0.0, t - STEP_S[1]) * math.sin(heading)
    rate = TURNING if wheel_angle(t) else 0.0
    tractor = BodyPose(x, y, 0.02, heading, 0.01, SPEED, 0.0, 0.03, 0.05, rate, 0.004, 0.0, 0.006)
    behind = replace(tractor, x=x - 5.7 * math.cos(heading), y=y - 5.7 * math.sin(heading))
    flags = (Flag(FlagKind.CONTRADICTION, "tractor.c"),) if contradicted else ()
    turned = wheel_angle(t)
    return Pose(t_ns, *PLACE_DEG, tractor, behind, turned, 0.015, turned, 0.002, 1, t_ns, 0.01, 4, flags)


def estimate(t: float, t_ns: int, method: str, undetermined: tuple[str, ...]) -> Estimate:
    """What a method publishes: it comes nearer to VALUES."""
    names = ("C_af", "C_ar", "C_ai", "sigma_f", "sigma_r", "sigma_i")
    share = SHARE * math.sqrt(SECONDS / t)
    missing = ParameterEstimate(None, None, Status.UNESTIMATED, Reason(Code.WIDE, numbers=(0.4,)))
    parameters = tuple(
        missing
        if name in undetermined
        else ParameterEstimate(value, value * share, Status.ESTIMATED, None, 0.2)
        for name, value in zip(names, VALUES, strict=True)
    )
    covariance = share**2 * (0.8 * np.eye(6) + 0.2)
    mean, sd = unknowns.prior(MACHINE)
    at = unknowns.AT
    nuisances = {name: (float(mean[at[name]]), float(sd[at[name]]) / 2) for name in ("latency", "rolling")}
    nuisances["wheel_zero"] = (3.0 * float(sd[at["wheel_zero"]]), float(sd[at["wheel_zero"]]) / 4)
    rule = Reason(Code.FIRST_WITH_NUMBERS, ("pem", "pem")) if method == "recommended" else None
    return Estimate(
        t_ns, method, "relaxation", parameters, tuple(covariance.ravel().tolist()), (None,) * 3,
        nuisances=nuisances, rank=6, condition=4.0, window_s=t, rule=rule,
        determined=(Combination((1.0, *[0.0] * 5), 0.06),),
        advice=Advice(AdviceKind.MANOEUVRE, ("sigma_i",), (0.3,), False, 0.0, "chirp", 10.0, 5.0, (0.1,)),
    )  # fmt: skip
