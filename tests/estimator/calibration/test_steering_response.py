"""How the wheels follow an automatic steering: by frames, against the truth; and what tells nothing."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest
from kinematic_drive import MACHINE
from numpy.typing import NDArray

from tilth.estimator.calibration import steering_response as reasons
from tilth.estimator.calibration.steering_response import SteeringResponse, respond
from tilth.replay.steering_commands import SteeringCommands
from tilth.schemas.decode import Decoder, encode, frames_of
from tilth.schemas.flow import Frame, WheelAngle, Word
from tilth.schemas.wheel_angle import RUDDER, compile_sensor
from tilth.simulator.drive import drive
from tilth.simulator.noise import gauss_markov
from tilth.simulator.scenario import Scenario
from tilth.simulator.steered_rig import LiveDriver
from tilth.simulator.tractor import Setting

pytestmark = pytest.mark.long


GUIDANCE = 44288
SOURCE = 0x1C
START_NS = 1_760_000_000_000_000_000
WHEELBASE = MACHINE.tractor.wheelbase
DELAY = MACHINE.wheel_angle.delay
FINE = 0.001  # s, of the truth
FREE = 500.0  # °/s: no limit

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Steered:
    """A drive by an automatic steering. Angles in degrees."""

    dead_time: float = 0.12  # s
    time_constant: float = 0.35  # s
    limit: float = FREE  # °/s
    noise: tuple[float, float] = (0.1, 1.0)  # sd, and how long it lasts in s
    gain: float = 1.0  # measured over commanded
    bend: float = 8.0
    seconds: float = 90.0
    on_s: float = math.inf  # steers so long, then not for 3 s
    by_rudder: bool = False
    obeyed: bool = True
    quick: bool = True  # in steps, as onto a row; else it weaves
    seed: int = 1


def orders_at(one: Steered, rng: np.random.Generator) -> tuple[Array, Array]:
    """(s, commanded degrees), ten a second with jitter."""
    n = round(one.seconds * 10)
    t = np.arange(n) * 0.1 + rng.uniform(0.0, 0.01, n)
    if one.quick:
        return t, one.bend * np.repeat(rng.normal(0.0, 0.5, n // 30 + 1), 30)[:n]
    sweep = 0.1 + 0.3 * t / one.seconds
    return t, one.bend * np.sin(2 * np.pi * (sweep * t + rng.uniform())) * 0.9


def wheels(one: Steered, t: Array, u: Array) -> Array:
    """Degrees at each FINE, by small steps of the differential equation."""
    fine = np.arange(round(one.seconds / FINE)) * FINE
    held = np.searchsorted(t, fine - one.dead_time, "right") - 1
    wanted = np.where(held >= 0, u[np.maximum(held, 0)], 0.0) * (1.0 if one.obeyed else 0.0)
    share, most, y = -math.expm1(-FINE / one.time_constant), one.limit * FINE, 0.0
    out = np.empty(len(fine))
    for k, target in enumerate(wanted.tolist()):
        out[k] = y
        y += min(max((target - y) * share, -most), most)
    return out


def frames_of_drive(one: Steered, truth: Array, t: Array, u: Array) -> Iterator[Frame]:
    rng = np.random.default_rng(100 + one.seed)
    sensor = compile_sensor(MACHINE)
    at = np.arange(0.0, one.seconds - 0.1, 0.01) + 0.003
    size, lasts = one.noise
    noise = gauss_markov(rng, size, lasts, 0.01, len(at)) + rng.normal(0.0, 0.04, len(at))
    y = one.gain * np.interp(at, np.arange(len(truth)) * FINE, truth) + 0.3 + noise
    rows = [(s + DELAY, sensor.can_id, sensor.data(math.radians(deg))) for s, deg in zip(at, y, strict=True)]
    for s, deg in zip(t, u, strict=True):
        steers = one.on_s > 0.0 and s % (one.on_s + 3.0) < one.on_s
        if one.by_rudder:
            words: dict[str, Word] = {"angle_order_rad": math.radians(deg)} if steers else {}
            rows += [(s, *made) for made in frames_of(RUDDER, encode(RUDDER, words), SOURCE)]
            continue
        words = {"command_status": "intended" if steers else "not_intended"}
        words["commanded_curvature_per_m"] = math.tan(math.radians(deg)) / WHEELBASE
        rows += [(s, *made) for made in frames_of(GUIDANCE, encode(GUIDANCE, words), SOURCE, 0xF0)]
    for s, can_id, data in sorted(rows):
        at_ns = START_NS + round(s * 1e9)
        yield Frame(at_ns, at_ns, "can0", can_id, True, False, data)


def told_by(frames: list[Frame]) -> SteeringResponse | str:
    """As `tilth calibrate` does it."""
    commands, decoder = SteeringCommands(), Decoder(MACHINE)
    t, wheel = list[float](), list[float]()
    for frame in frames:
        commands.take(frame)
        for measured in decoder.measurements(frame):
            if isinstance(measured, WheelAngle):
                t.append((measured.rx_ns - START_NS) * 1e-9)
                wheel.append(measured.angle)
    return respond(commands.orders(WHEELBASE, START_NS), np.array(t), np.array(wheel), DELAY)


def made(one: Steered) -> tuple[SteeringResponse | str, float]:
    """(What is told, the largest rate in truth, rad/s, measured)."""
    t, u = orders_at(one, np.random.default_rng(one.seed))
    truth = wheels(one, t, u)
    since = np.arange(len(truth) - 1) * FINE % (one.on_s + 3.0)
    used = (since > reasons.STEERING_RESPONSE.most_dead_time_s) & (
        since < one.on_s
    )  # before, what was asked for is not known
    fastest = math.radians(abs(one.gain) * float(np.max(np.abs(np.diff(truth)[used]), initial=0.0)) / FINE)
    return told_by(list(frames_of_drive(one, truth, t, u))), fastest


def errors(one: Steered) -> Array:
    """Of dead time, time constant and rate, in their sds."""
    told, fastest = made(one)
    assert isinstance(told, SteeringResponse), told
    return np.array([
        (told.dead_time - one.dead_time) / told.dead_time_sd,
        (told.time_constant - one.time_constant) / told.time_constant_sd,
        (told.rate - fastest) / told.rate_sd,
    ])  # fmt: skip


WORLDS = {
    "as most": Steered(),
    "at once": Steered(dead_time=0.0, time_constant=0.05),
    "late": Steered(dead_time=0.3, time_constant=0.05),
    "slow": Steered(dead_time=0.3, time_constant=0.8),
    "slow without dead time": Steered(dead_time=0.0, time_constant=0.8, quick=False),
    "limited": Steered(limit=12.0),
    "limited, weaving": Steered(dead_time=0.1, time_constant=0.2, limit=8.0, quick=False),
    "limited and slow": Steered(dead_time=0.15, time_constant=0.6, limit=6.0),
    "noise that lasts": Steered(noise=(0.3, 3.0)),
    "other lengths": Steered(gain=0.9),
    "another sign": Steered(gain=-1.05),
    "on and off": Steered(on_s=9.0, seconds=120.0),
    "by a rudder's order": Steered(by_rudder=True),
    "weaving": Steered(quick=False),
}


@pytest.mark.parametrize("one", WORLDS.values(), ids=WORLDS)
def test_dead_time_time_constant_and_rate_are_found(one: Steered) -> None:
    told, _ = made(one)
    assert isinstance(told, SteeringResponse), told
    assert np.all(np.abs(errors(one)) < 3.3)
    assert told.dead_time_sd < 0.02 and told.time_constant_sd < 0.06
    assert told.limited == (one.limit < FREE)
    assert told.gain == pytest.approx(one.gain, abs=0.03)
    assert ("opposite signs" in told.words) == (one.gain < 0.0)


@pytest.mark.parametrize(("hz", "phase_s"), [(5.0, 0.0), (5.0, 0.1), (2.5, 0.0), (2.5, 0.13)])
def test_a_slow_wheel_sensor_tells_as_well(hz: float, phase_s: float) -> None:
    one = Steered()
    t, u = orders_at(one, np.random.default_rng(one.seed))
    truth = wheels(one, t, u)
    commands = SteeringCommands()
    for frame in frames_of_drive(one, truth, t, u):
        commands.take(frame)
    at = np.arange(phase_s, (len(truth) - 1) * FINE, 1.0 / hz)
    noise = np.random.default_rng(2).normal(0.0, math.radians(0.05), len(at))
    wheel = np.radians(np.interp(at, np.arange(len(truth)) * FINE, truth)) + noise
    told = respond(commands.orders(WHEELBASE, START_NS), at + DELAY, wheel, DELAY)
    assert isinstance(told, SteeringResponse), told


NOTHING = {
    "no commands": (Steered(seconds=40.0, by_rudder=True, on_s=0.0), reasons.NO_COMMANDS),
    "never steers": (Steered(on_s=0.0), reasons.NEVER_STEERED),
    "gentle": (Steered(bend=0.8), reasons.TOO_GENTLE),
    "brief": (Steered(seconds=25.0), reasons.TOO_SHORT),
    "in pieces": (Steered(on_s=4.0), reasons.TOO_SHORT),
    "not obeyed": (Steered(obeyed=False), reasons.NOT_FOLLOWED),
    "a copy of the wheels": (Steered(dead_time=-0.15, time_constant=0.02), reasons.AFTERWARDS),
}


@pytest.mark.parametrize(("one", "why"), NOTHING.values(), ids=NOTHING)
def test_why_nothing_can_be_told(one: Steered, why: str) -> None:
    assert made(one)[0] == why


@pytest.mark.coverage
@pytest.mark.parametrize("one", WORLDS.values(), ids=WORLDS)
def test_intervals_hold_the_truth(one: Steered) -> None:
    """At least nine of ten 95 % intervals, over all three numbers of 10 drives; once of 40 of each kind."""
    found = np.array([errors(replace(one, seed=seed)) for seed in range(10, 20)])
    assert np.mean(np.abs(found) < 1.96) >= 0.9


def test_the_virtual_tractors_own_steering_is_found() -> None:
    """Its servo is of second order: 30 / (s^2 + 10 s + 30), whose lags add up to a third of a second; it is
    asked every 0.02 s, and hears a command up to 0.02 s after it came."""
    seconds, frames = 50.0, list[Frame]()

    def exchange(now: float, sent: list[Frame]) -> list[tuple[int, bytes]]:
        frames.extend(sent)
        if now < 1.0 or round(now * 100) % 10:
            return []
        aim = 6.0 * math.sin(0.8 * (now - 1.0)) + 3.0 * math.sin(2.1 * (now - 1.0))
        words: dict[str, Word] = {"command_status": "intended"}
        words["commanded_curvature_per_m"] = math.tan(math.radians(aim)) / WHEELBASE
        made = frames_of(GUIDANCE, encode(GUIDANCE, words), SOURCE, 0xF0)
        at_ns = frames[-1].rx_ns
        frames.extend(Frame(at_ns, at_ns, "can0", can_id, True, False, data) for can_id, data in made)
        return list(made)

    def driver(setting: Setting) -> LiveDriver:
        return LiveDriver(MACHINE, setting, exchange)

    quiet = Scenario(speed=2.0, other_traffic=False, clock_offset_s=0.0)
    drive(MACHINE, 3, seconds, quiet, driven_by=driver)
    assert all(one.rx_ns <= other.rx_ns for one, other in pairwise(frames))
    commands = SteeringCommands()
    for frame in frames:
        commands.take(frame)
    base = frames[0].rx_ns
    decoder = Decoder(MACHINE)
    wheel = [m for frame in frames for m in decoder.measurements(frame) if isinstance(m, WheelAngle)]
    t = np.array([m.rx_ns - base for m in wheel]) * 1e-9
    told = respond(commands.orders(WHEELBASE, base), t, np.array([m.angle for m in wheel]), DELAY)
    assert isinstance(told, SteeringResponse), told
    assert told.dead_time + told.time_constant == pytest.approx(1 / 3 + 0.02, abs=0.04)
    assert told.explained > 0.99
