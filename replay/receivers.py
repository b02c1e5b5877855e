"""What the virtual tractor's receivers and wheel-angle sensor measure: truth, noise, faults, survey errors.

Positions: white noise and slow (Gauss-Markov) errors of each receiver, and a slow error that all share, as
RTK receivers have that use one base. Doppler velocities, yaw rate, heading and roll have white noise.
Quantisation comes from the encoding of the messages.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from pyproj import Transformer

from tilth.replay import noise as streams
from tilth.replay.noise import Array, gauss_markov, generator
from tilth.replay.scenario import STEP_S, Scenario
from tilth.replay.tractor import Track, Truth, leaning, rate
from tilth.schemas.flow import FixType, Mount
from tilth.schemas.machine import Machine, Receiver

ORIGIN_DEG: Final = (42.0267, -93.6465)
"""Latitude and longitude of the truth's x = y = 0."""

POSITION_WHITE = 0.008  # m, per axis
POSITION_OWN = (0.007, 20.0)  # m and s of each receiver's slow error
POSITION_COMMON = (0.015, 100.0)  # m and s of the error that all share
VELOCITY = 0.03  # m/s, per axis
YAW_RATE = np.radians(0.18)
HEADING = np.radians(0.3)
ROLL = np.radians(0.2)  # and pitch
WHEEL = np.radians(0.07)


@dataclass(frozen=True, slots=True)
class Effect:
    """What a fault does to a receiver's reports."""

    sends: bool = True
    available: bool = True
    holds: bool = False  # repeats the last good position
    late_s: float = 0.0
    moved_m: float = 0.0  # to the right
    fix: FixType = FixType.RTK_FIXED
    sd_m: float = 0.0  # of a further slow position error


SILENT: Final = Effect(sends=False)
FAULTS: Final[Mapping[str, Effect]] = {
    "silent": SILENT,
    "not_available": Effect(available=False, fix=FixType.NONE),
    "repeat": Effect(holds=True),
    "late": Effect(late_s=0.3),
    "moved": Effect(moved_m=0.4),
    "rtk_float": Effect(fix=FixType.RTK_FLOAT, sd_m=0.2),
    "dgnss": Effect(fix=FixType.DGNSS, sd_m=0.4),
    "gnss": Effect(fix=FixType.GNSS, sd_m=1.5),
}


@dataclass(frozen=True, slots=True)
class Report:
    """What one receiver measured at one epoch; times in s of UTC since the start."""

    epoch_s: float
    sent_s: float  # when the first frame may go to the bus
    latitude_deg: float
    longitude_deg: float
    course: float  # rad, 0 to 2 pi
    speed: float  # m/s
    yaw_rate: float  # rad/s
    heading: float  # rad, 0 to 2 pi
    roll: float  # rad
    pitch: float  # rad, nose up
    effect: Effect


def star_fire_like(receiver: Receiver) -> bool:
    """John Deere's receivers speak J1939; the others here speak NMEA 2000."""
    manufacturer = receiver.manufacturer if receiver.name is None else (receiver.name >> 21) & 0x7FF
    return manufacturer == 33


def reports(machine: Machine, truth: Truth, receiver: Receiver, first_s: float) -> list[Report]:
    """All that one receiver measures, at epochs on UTC multiples of its period, from first_s on."""
    number = list(Mount).index(receiver.mount)
    rng = generator(truth.seed, streams.RECEIVERS, number)
    scenario = truth.scenario
    epochs = _epochs(scenario, 0.2 if star_fire_like(receiver) else 0.1, first_s, float(truth.time[-1]))
    if not len(epochs):
        return []
    dropped = generator(truth.seed, streams.DROP_OUT, number).random(len(epochs)) < scenario.link.drop_out
    effects = _effects(scenario, receiver.mount, epochs, dropped)
    at = _at(machine, truth, receiver, epochs, np.array([effect.moved_m for effect in effects]))
    noise = scenario.noise * rng.standard_normal((6, len(epochs)))
    dx, dy = _position_errors(truth, epochs, np.array([effect.sd_m for effect in effects]), rng)
    north, east = at.forward_velocity + VELOCITY * noise[0], at.lateral_velocity + VELOCITY * noise[1]
    latest = _latest_new(effects)
    longitude, latitude = _plane().transform((at.y + dy)[latest], (at.x + dx)[latest], direction="INVERSE")
    latency = truth.nuisances[f"latency_{receiver.mount}"] + np.array([effect.late_s for effect in effects])
    columns = (
        epochs,
        epochs + latency + rng.exponential(scenario.link.jitter, len(epochs)),
        latitude,
        longitude,
        np.arctan2(east, north) % (2 * np.pi),
        np.hypot(north, east),
        at.yaw_rate + YAW_RATE * noise[2],
        (at.heading + HEADING * noise[3]) % (2 * np.pi),
        at.roll + ROLL * noise[4],
        at.pitch + ROLL * noise[5],
    )
    rows = zip(*(column.tolist() for column in columns), effects, strict=True)
    return [Report(*row) for row in rows]


def wheel_readings(truth: Truth) -> Array:
    """The wheel angle as the sensor says it at each of truth.time, rad: play and gain of its linkage, zero
    error and noise."""
    noise = truth.scenario.noise * generator(truth.seed, streams.WHEEL).normal(0.0, WHEEL, len(truth.time))
    moved = _with_play(truth.wheel_angle, np.radians(truth.scenario.wheel.dead_band_deg))
    return truth.nuisances["wheel_gain"] * moved + truth.nuisances["wheel_zero"] + noise


def _with_play(angle: Array, play: float) -> Array:
    """What a linkage passes on that turns freely within so much, rad, shape (n,)."""
    if play == 0.0:
        return angle
    half, value, values = play / 2, float(angle[0]), []
    for there in angle.tolist():
        value = min(max(value, there - half), there + half)
        values.append(value)
    return np.array(values)


def _plane() -> Transformer:
    plane = f"+proj=tmerc +lat_0={ORIGIN_DEG[0]} +lon_0={ORIGIN_DEG[1]} +k=1 +ellps=WGS84 +units=m"
    return Transformer.from_crs("EPSG:4326", plane, always_xy=True)


def _epochs(scenario: Scenario, period_s: float, first_s: float, end_s: float) -> Array:
    phase = -(scenario.utc_start_ns / 1e9) % period_s
    first = np.ceil((first_s - phase) / period_s - 1e-9)
    last = np.floor((end_s - phase) / period_s + 1e-9)
    return phase + np.arange(first, last + 1) * period_s


def _effects(scenario: Scenario, mount: Mount, epochs: Array, dropped: NDArray[np.bool_]) -> list[Effect]:
    good = Effect()
    result = [SILENT if lost else good for lost in dropped.tolist()]
    for fault in scenario.faults:
        if fault.mount == mount:
            for k in np.flatnonzero((epochs >= fault.start_s) & (epochs < fault.end_s)):
                result[k] = FAULTS[fault.kind]
    return result


def _stands_at(scenario: Scenario, mount: Mount) -> Mount:
    one, other = scenario.swapped or (mount, mount)
    return {one: other, other: one}.get(mount, mount)


def _place(machine: Machine, truth: Truth, mount: Mount) -> tuple[float, float]:
    """True (forward, right) of the antenna from the true CG: the surveyed pair of a body, turned by its
    alignment error, each moved by its own error."""
    body = mount.split("_")[0]
    surveyed = {r.mount: np.array(r.position[:2]) for r in machine.receiver if r.mount.startswith(body)}
    middle = np.mean(list(surveyed.values()), axis=0)
    told = truth.nuisances
    arm = surveyed.get(mount, middle) - middle
    cosine, sine = np.cos(told[f"pair_{body}"]), np.sin(told[f"pair_{body}"])
    placed = middle + np.array([[cosine, -sine], [sine, cosine]]) @ arm
    moved = [told.get(f"{axis}_{mount}", 0.0) - told[f"cg_{axis}_{body}"] for axis in ("forward", "right")]
    return float(placed[0] + moved[0]), float(placed[1] + moved[1])


def _at(machine: Machine, truth: Truth, receiver: Receiver, epochs: Array, moved_m: Array) -> Track:
    """Where the receiver reports itself to be at its epochs; the velocities are those to north and east.

    A roll-corrected receiver reports the point on the ground below its antenna.
    """
    mount = _stands_at(truth.scenario, receiver.mount)
    tractor = mount.startswith("tractor")
    body = truth.tractor if tractor else truth.implement
    height = 0.0 if receiver.roll_corrected else receiver.position[2]
    above = height - (truth.rig.h_t if tractor else truth.rig.h_i)
    back, side = leaning(body.roll, body.pitch)  # of a point one metre higher
    k = np.round(epochs / STEP_S).astype(np.int64)
    psi, roll, pitch, r = body.heading[k], body.roll[k], body.pitch[k], body.yaw_rate[k]
    forward, right = _place(machine, truth, mount)
    ahead = forward * np.cos(pitch) - above * back[k]
    aside = (right + moved_m) * np.cos(roll) + above * side[k]
    u = body.forward_velocity[k] - r * aside - above * rate(back)[k]
    v = body.lateral_velocity[k] + r * ahead + above * rate(side)[k]
    cosine, sine = np.cos(psi), np.sin(psi)
    return Track(
        body.x[k] + ahead * cosine - aside * sine,
        body.y[k] + ahead * sine + aside * cosine,
        psi,
        u * cosine - v * sine,
        u * sine + v * cosine,
        r,
        roll,
        pitch,
    )


def _position_errors(
    truth: Truth, epochs: Array, worse_m: Array, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Errors north and east, m, each shape (n,); worse_m: sd of what a worse fix adds."""
    n, step = len(epochs), float(epochs[1] - epochs[0]) if len(epochs) > 1 else 0.1
    common_step = 0.1  # its own grid: the same for every receiver, whatever its period
    length = int(truth.time[-1] / common_step) + 2
    result = []
    for axis in range(2):
        common = gauss_markov(
            generator(truth.seed, streams.COMMON, axis), *POSITION_COMMON, common_step, length
        )
        own = gauss_markov(rng, *POSITION_OWN, step, n) + rng.normal(0.0, POSITION_WHITE, n)
        shared = np.interp(epochs, np.arange(length) * common_step, common)
        worse = worse_m * gauss_markov(rng, 1.0, 30.0, step, n)
        result.append(truth.scenario.noise * (own + shared) + worse)
    return result[0], result[1]


def _latest_new(effects: list[Effect]) -> NDArray[np.int64]:
    """For each epoch the index of the one whose position is reported, shape (n,)."""
    own = np.arange(len(effects))
    repeats = np.array([effect.holds for effect in effects])
    return np.maximum.accumulate(np.where(repeats, 0, own))
