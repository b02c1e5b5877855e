"""What the virtual tractor's receivers and wheel-angle sensor measure: truth, noise, faults, survey errors.

Positions: white noise and slow (Gauss-Markov) errors of each receiver, and a slow error that all share, as
RTK receivers have that use one base. Doppler velocities, yaw rate, heading and roll have white noise;
roll may have a zero error and be late. Quantisation comes from the encoding of the messages.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray
from pyproj import Transformer

from tilth.schemas.flow import FixType, Mount
from tilth.schemas.machine import Machine, Receiver
from tilth.simulator import noise as streams
from tilth.simulator.noise import Array, gauss_markov, generator
from tilth.simulator.scenario import ORIGIN_DEG, STEP_S, Scenario, Wheel
from tilth.simulator.tractor import BodyTrack, Setting, Truth, leaning, rate

FIRST_EPOCH_S: Final = 0.5  # address claims, and 250 ms in which they may be contested, come first

POSITION_WHITE = 0.008  # m, per axis
POSITION_OWN = (0.007, 20.0)  # m and s of each receiver's slow error
POSITION_COMMON = (0.015, 100.0)  # m and s of the error that all share
BASE_S = 100.0  # between jumps of the base, mean
VELOCITY = 0.03  # m/s, per axis
YAW_RATE = np.radians(0.18)
HEADING = np.radians(0.3)
PITCH = np.radians(0.2)
WHEEL = np.radians(0.07)
BENT = np.radians(30.0)  # wheel angle that Wheel.bend is told of


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


class Receiving:
    """One receiver of a run: its errors are drawn beforehand, its reports are asked for in order.

    So a run that is steered while it goes on measures just what one does that was driven to its end before.
    """

    def __init__(self, machine: Machine, run: Truth | Setting, receiver: Receiver, first_s: float) -> None:
        """Epochs on UTC multiples of its period, from first_s to the end of run.time."""
        number = list(Mount).index(receiver.mount)
        rng = generator(run.seed, streams.RECEIVERS, number)
        scenario, period_s = run.scenario, 0.2 if star_fire_like(receiver) else 0.1
        self.receiver = receiver
        self.epochs = _epochs(scenario, period_s, first_s, float(run.time[-1]))  # s, (n,)
        self._machine = machine
        self._held: tuple[float, float] | None = None
        n = len(self.epochs)
        dropped = generator(run.seed, streams.DROP_OUT, number).random(n) < scenario.link.drop_out
        self._effects = _effects(scenario, receiver.mount, self.epochs, dropped)
        self._moved_m = np.array([effect.moved_m for effect in self._effects])
        self._noise = scenario.noise * rng.standard_normal((6, n))
        self._roll_sd = run.nuisances[f"roll_sd_{receiver.mount}"]
        worse = np.array([effect.sd_m for effect in self._effects])
        self._off = _position_errors(run, self.epochs, worse, rng) if n else (self._moved_m, self._moved_m)
        late = np.array([effect.late_s for effect in self._effects])
        self._sent = self.epochs + (run.nuisances[f"latency_{receiver.mount}"] + late)
        self._sent = self._sent + rng.exponential(scenario.link.jitter, n)

    def rows(self, truth: Truth, first: int, end: int) -> list[Report]:
        """Reports of the epochs first to end - 1, which truth.time must hold."""
        if first >= end:
            return []
        which = slice(first, end)
        at = _at(self._machine, truth, self.receiver, self.epochs[which], self._moved_m[which])
        noise, dx, dy = self._noise[:, which], self._off[0][which], self._off[1][which]
        north, east = at.forward_velocity + VELOCITY * noise[0], at.lateral_velocity + VELOCITY * noise[1]
        longitude, latitude = plane(truth.scenario.origin_deg).transform(
            at.y + dy, at.x + dx, direction="INVERSE"
        )
        columns = (
            self.epochs[which],
            self._sent[which],
            latitude,
            longitude,
            np.arctan2(east, north) % (2 * np.pi),
            np.hypot(north, east),
            at.yaw_rate + YAW_RATE * noise[2],
            (at.heading + HEADING * noise[3]) % (2 * np.pi),
            at.roll + self._roll_sd * noise[4],
            at.pitch + PITCH * noise[5],
        )
        rows = zip(*(column.tolist() for column in columns), self._effects[which], strict=True)
        return [self._repeating(Report(*row)) for row in rows]

    def heard(self) -> Array:
        """What whoever steers by it hears, without the truth: of each epoch that is sent with a position,
        (instant, s; when it is sent, s; errors of position and of velocity to north and east, and of the turn
        rate), (m, 7)."""
        good = np.array([effect.sends and effect.available for effect in self._effects], dtype=np.bool_)
        off = (*self._off, *(VELOCITY * self._noise[:2]), YAW_RATE * self._noise[2])
        return np.column_stack([self.epochs, self._sent, *off])[good]

    def _repeating(self, row: Report) -> Report:
        """The last good position again, where it holds that."""
        if row.effect.holds and self._held is not None:
            return replace(row, latitude_deg=self._held[0], longitude_deg=self._held[1])
        self._held = row.latitude_deg, row.longitude_deg
        return row


def reports(machine: Machine, truth: Truth, receiver: Receiver, first_s: float) -> list[Report]:
    """All that one receiver measures in a whole run, from first_s on."""
    receiving = Receiving(machine, truth, receiver, first_s)
    return receiving.rows(truth, 0, len(receiving.epochs))


class WheelSensor:
    """The wheel angle as its sensor says it: play and gain of its linkage, zero error and noise."""

    def __init__(self, run: Truth | Setting) -> None:
        self._told = run.nuisances
        self._play = float(np.radians(run.scenario.wheel.dead_band_deg))
        self._noise = run.scenario.noise * generator(run.seed, streams.WHEEL).normal(
            0.0, WHEEL, len(run.time)
        )
        self._drift = float(np.radians(run.scenario.wheel.zero_drift_degps))  # rad/s
        self._passed: float | None = None
        self._wheel, self._base = run.scenario.wheel, run.rig.a + run.rig.b

    def readings(self, angle: Array, first: int) -> Array:
        """At the samples from `first` on, in the order of time: rad, shape (m,). angle: the wheels', (m,)."""
        moved = _with_play(angle, self._play, angle[0] if self._passed is None else self._passed)
        self._passed = float(moved[-1])
        noise = self._noise[first : first + len(angle)]
        drifted = self._drift * STEP_S * np.arange(first, first + len(angle))
        shown = _by_the_linkage(_of_the_kingpin(moved, self._wheel, self._base), self._wheel.curve)
        shown = shown * (1.0 + self._wheel.bend * np.abs(shown) / BENT)
        return np.asarray(self._told["wheel_gain"] * shown + self._told["wheel_zero"] + drifted + noise)


def _of_the_kingpin(mean: Array, wheel: Wheel, base: float) -> Array:
    """Angle of the wheel that carries the sensor: both turn about one point beside the rear axle."""
    if wheel.kingpin == "mean":
        return mean
    further = (0.5 if wheel.kingpin == "left" else -0.5) * wheel.kingpin_distance
    bent = np.abs(mean) > 1e-9
    radius = base / np.tan(np.where(bent, mean, 1.0))  # m, to the right, from the middle
    return np.asarray(np.where(bent, np.arctan(base / (radius + further)), mean))


def _by_the_linkage(angle: Array, curve: float) -> Array:
    """Reading x of a wheel at x + curve x^2, by Newton's steps."""
    x: Array = angle.copy()
    for _ in range(12 if curve else 0):
        x = x - (x + curve * x**2 - angle) / (1.0 + 2.0 * curve * x)
    return x


def wheel_readings(truth: Truth) -> Array:
    """Of a whole run, at each of truth.time, rad."""
    return WheelSensor(truth).readings(truth.wheel_angle, 0)


def _with_play(angle: Array, play: float, value: float) -> Array:
    """What a linkage passes on that turns freely within so much, rad, shape (n,), after it passed `value`."""
    if play == 0.0:
        return angle
    half, values = play / 2, []
    for there in angle.tolist():
        value = min(max(value, there - half), there + half)
        values.append(value)
    return np.array(values)


@cache
def plane(origin_deg: tuple[float, float] = ORIGIN_DEG) -> Transformer:
    """From longitude and latitude, degrees, to metres east and north of such a place."""
    plane = f"+proj=tmerc +lat_0={origin_deg[0]} +lon_0={origin_deg[1]} +k=1 +ellps=WGS84 +units=m"
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
    surveyed = {r.mount: np.array(r.position[:2]) for r in machine.receiver if r.mount.body == body}
    middle = np.mean(list(surveyed.values()), axis=0)
    told = truth.nuisances
    arm = surveyed.get(mount, middle) - middle
    cosine, sine = np.cos(told[f"pair_{body}"]), np.sin(told[f"pair_{body}"])
    placed = middle + np.array([[cosine, -sine], [sine, cosine]]) @ arm
    moved = [told.get(f"{axis}_{mount}", 0.0) - told[f"cg_{axis}_{body}"] for axis in ("forward", "right")]
    return float(placed[0] + moved[0]), float(placed[1] + moved[1])


def _at(machine: Machine, truth: Truth, receiver: Receiver, epochs: Array, moved_m: Array) -> BodyTrack:
    """Where the receiver reports itself to be at its epochs; the velocities are those to north and east.

    A roll-corrected receiver reports the point on the ground below its antenna. Roll is what its own sensor
    says, but for noise; the yaw rate is that of a gyro fixed to the body.
    """
    mount = _stands_at(truth.scenario, receiver.mount)
    tractor = mount.startswith("tractor")
    body = truth.tractor if tractor else truth.implement
    height = 0.0 if receiver.roll_corrected else receiver.position[2]
    above = height - (truth.rig.h_t if tractor else truth.rig.h_i)
    back, side = leaning(body.roll, body.pitch)  # of a point one metre higher
    k = np.round((epochs - truth.time[0]) / STEP_S).astype(np.int64)
    psi, roll, pitch, r = body.heading[k], body.roll[k], body.pitch[k], body.yaw_rate[k]
    late, rate_late = (
        np.maximum(k - round(truth.nuisances[f"{what}_delay_{receiver.mount}"] / STEP_S), 0)
        for what in ("roll", "turn_rate")
    )
    measured_roll = body.roll[late] + truth.nuisances[f"roll_zero_{receiver.mount}"]
    turn_rate = body.yaw_rate if body.gyro is None else body.gyro
    forward, right = _place(machine, truth, mount)
    ahead = forward * np.cos(pitch) - above * back[k]
    lateral_offset = (right + moved_m) * np.cos(roll) + above * side[k]
    u = body.forward_velocity[k] - r * lateral_offset - above * rate(back)[k]
    v = body.lateral_velocity[k] + r * ahead + above * rate(side)[k]
    cosine, sine = np.cos(psi), np.sin(psi)
    return BodyTrack(
        body.x[k] + ahead * cosine - lateral_offset * sine,
        body.y[k] + ahead * sine + lateral_offset * cosine,
        psi,
        u * cosine - v * sine,
        u * sine + v * cosine,
        turn_rate[rate_late],
        measured_roll,
        pitch,
    )


def _position_errors(
    run: Truth | Setting, epochs: Array, worse_m: Array, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Errors north and east, m, each shape (n,); worse_m: sd of what a worse fix adds."""
    n, step = len(epochs), float(epochs[1] - epochs[0]) if len(epochs) > 1 else 0.1
    common_step = 0.1  # its own grid: the same for every receiver, whatever its period
    length = int(run.time[-1] / common_step) + 2
    jumps = _base_jumps(run, epochs)
    result = []
    for axis in range(2):
        common = gauss_markov(
            generator(run.seed, streams.COMMON, axis), *POSITION_COMMON, common_step, length
        )
        own = gauss_markov(rng, *POSITION_OWN, step, n) + rng.normal(0.0, POSITION_WHITE, n)
        shared = np.interp(epochs, np.arange(length) * common_step, common)
        worse = worse_m * gauss_markov(rng, 1.0, 30.0, step, n)
        result.append(run.scenario.noise * (own + shared) + worse + jumps[:, axis])
    return result[0], result[1]


def _base_jumps(run: Truth | Setting, epochs: Array) -> Array:
    """How far the base is from where it began, north and east, m, shape (n, 2); alike for all receivers."""
    rng = generator(run.seed, streams.BASE)
    times = np.cumsum(rng.exponential(BASE_S, 2 + int(4 * run.time[-1] / BASE_S)))
    bearing = rng.uniform(0.0, 2 * np.pi, len(times) + 1)
    places = run.scenario.link.base_jump * np.column_stack([np.cos(bearing), np.sin(bearing)])
    places[0] = 0.0
    return np.asarray(places[np.searchsorted(times, epochs)])
