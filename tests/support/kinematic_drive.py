"""Measurements of a rig whose wheels do not slip, on a plane that slopes: calibration must find it."""

import math
from collections.abc import Sequence

import numpy as np
from paths import MACHINE_FILE

from tilth.estimator.pose.geometry import to_degrees
from tilth.schemas.flow import (
    Attitude,
    Fix,
    FixType,
    Measurement,
    Mount,
    Origin,
    Position,
    Velocity,
    WheelAngle,
    YawRate,
)
from tilth.schemas.machine import Machine
from tilth.schemas.machine_toml import parse_machine

MACHINE: Machine = parse_machine(MACHINE_FILE.read_text(encoding="utf-8"))
ORIGIN_DEG = (52.0, 11.0)
START_NS = 1_000_000_000_000
STEP = 0.02  # s
Plan = Sequence[tuple[float, float, float]]  # s, m/s, degrees of the wheels
GUIDED: Plan = (
    (12, 0.0, 0), (30, 3.0, 0), (22, 1.8, -25), (30, 3.0, 0), (40, 1.4, 20), (40, 1.4, -20),
    (6, 1.8, 25), (6, 1.8, -25), (6, 1.8, 25), (6, 1.8, -25), (20, 1.2, 12), (20, 4.0, -6),
)  # fmt: skip
ROWS: Plan = ((60, 3.0, 0), (60, 3.5, 0), (30, 2.0, 0))
ONE_SPEED: Plan = ((24, 3.0, 0), *((8, 3.0, 8), (8, 3.0, -8)) * 6)
ONE_SIDE: Plan = ((30, 3.0, 0), (40, 1.4, 20), (40, 1.6, 12))


def measurements(
    plan: Plan = GUIDED,
    machine: Machine = MACHINE,
    *,
    slope: tuple[float, float] = (0.03, 0.01),
    fix: FixType = FixType.RTK_FIXED,
    noise: float = 1.0,
    seed: int = 1,
) -> list[Measurement]:
    """In the order of their times. machine: the truth, which also says the latencies. slope: rad, of the roll
    of a body that faces west and north."""
    rng = np.random.default_rng(seed)
    motion = _motion(plan, machine)
    end = motion[-1, 0]
    late = {r.mount: r.latency.value for r in machine.receiver}
    found: list[tuple[float, Measurement]] = []
    for number, receiver in enumerate(machine.receiver):
        for epoch in np.arange(0.4, end - 0.5, 0.2):
            row = motion[round(epoch / STEP)]
            found += _epoch(machine, number, row, epoch, late[receiver.mount], (slope, fix, noise, rng))
    for t, angle in zip(motion[::2, 0], motion[::2, 6], strict=True):
        sent = t + machine.wheel_angle.delay
        head = _head(sent, Origin("can0", 11), 65291)
        found.append((sent, WheelAngle(*head, angle + noise * rng.normal(0, 1e-3), 1e-3)))
    return [measurement for _, measurement in sorted(found, key=lambda pair: pair[0])]


def _motion(plan: Plan, machine: Machine) -> np.ndarray:
    """Rows t, north and east of the rear axle, psi_t, psi_i, u, wheel angle, r_t, r_i; each STEP."""
    base = machine.tractor.wheelbase
    back = machine.tractor.c.value - machine.tractor.b.value
    drawbar = machine.implement.d.value + machine.implement.e.value
    north = east = psi = psi_i = u = delta = 0.0
    rows, t = [], 0.0
    for seconds, speed, degrees in plan:
        for _ in range(round(seconds / STEP)):
            u += min(max(speed - u, -0.8 * STEP), 0.8 * STEP)
            wanted = math.radians(degrees)
            delta += min(max(wanted - delta, -0.4 * STEP), 0.4 * STEP)
            r = u * math.tan(delta) / base
            fold = psi - psi_i
            r_i = (u * math.sin(fold) - r * back * math.cos(fold)) / drawbar
            rows.append((t, north, east, psi, psi_i, u, delta, r, r_i))
            middle = psi + r * STEP / 2
            north, east = north + u * STEP * math.cos(middle), east + u * STEP * math.sin(middle)
            psi, psi_i, t = psi + r * STEP, psi_i + r_i * STEP, t + STEP
    return np.array(rows)


def _epoch(
    machine: Machine, number: int, row: np.ndarray, epoch: float, late: float,
    how: tuple[tuple[float, float], FixType, float, np.random.Generator],
) -> list[tuple[float, Measurement]]:  # fmt: skip
    slope, fix, noise, rng = how
    receiver = machine.receiver[number]
    _, north, east, psi_t, psi_i, u, _, r_t, r_i = row.tolist()
    tractor = receiver.mount in (Mount.TRACTOR_FRONT, Mount.TRACTOR_REAR)
    psi, r = (psi_t, r_t) if tractor else (psi_i, r_i)
    roll = -slope[0] * math.sin(psi) + slope[1] * math.cos(psi)
    pitch = -slope[0] * math.cos(psi) - slope[1] * math.sin(psi)
    hitch = machine.tractor.b.value - machine.tractor.c.value
    forward, right = receiver.position[:2]
    height = 0.0 if receiver.roll_corrected else receiver.position[2]
    forward, right = forward - height * math.sin(pitch), right + height * math.sin(roll)
    at = np.array([north, east])
    speed = np.array([u * math.cos(psi_t), u * math.sin(psi_t)])
    if tractor:
        arm = _turned(forward + machine.tractor.b.value, right, psi_t)
    else:
        at = at + _turned(hitch, 0.0, psi_t)
        speed = speed + r_t * _turned(0.0, hitch, psi_t)
        arm = _turned(forward - machine.implement.d.value, right, psi_i)
    at, speed = at + arm, speed + r * np.array([-arm[1], arm[0]])
    at, speed = at + noise * rng.normal(0, 0.006, 2), speed + noise * rng.normal(0, 0.02, 2)
    sent = epoch + late
    origin = Origin("can0", 28 + number, receiver.name, receiver.mount)
    place = to_degrees(ORIGIN_DEG, *at)
    zero = 0.0 if receiver.roll_zero is None else math.radians(receiver.roll_zero.value)
    measured = receiver.roll_sign * (roll + zero + noise * rng.normal(0, 0.003))
    rate = receiver.yaw_rate_sign * (r + noise * rng.normal(0, 0.003))
    course = math.atan2(speed[1], speed[0]) % math.tau
    return [
        (sent, Position(*_head(sent, origin, 129025), place[0], place[1], 0.025)),
        (sent, Velocity(*_head(sent, origin, 129026), course, float(np.hypot(*speed)), 0.05)),
        (sent, YawRate(*_head(sent, origin, 127251), rate, 0.005)),
        (sent, Attitude(*_head(sent, origin, 127257), measured, pitch, 0.009)),
        (sent, Fix(*_head(sent, origin, 129029), fix)),
    ]


def _turned(forward: float, right: float, psi: float) -> np.ndarray:
    cosine, sine = math.cos(psi), math.sin(psi)
    return np.array([forward * cosine - right * sine, forward * sine + right * cosine])


def _head(t: float, origin: Origin, pgn: int) -> tuple[int, int, Origin, int, None]:
    ns = START_NS + round(t * 1e9)
    return ns, ns, origin, pgn, None
