"""How the virtual tractor is steered: wheel angles planned beforehand, or a pilot who looks where he is.

A pilot drives along rows by a linear quadratic regulator behind the steering actuator, and through headland
turns by looking ahead along a path. He is asked every HOLD samples.
"""

import math
from dataclasses import dataclass, field
from itertools import cycle
from typing import Final, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.models import nonlinear
from tilth.estimator.models.actuator import BOSSERD, Actuator
from tilth.estimator.models.family import model_named
from tilth.estimator.models.linear_analysis import system
from tilth.estimator.models.manoeuvres import manoeuvre_named, rate_limited
from tilth.estimator.models.nonlinear import STATES
from tilth.estimator.models.parameters import Rig
from tilth.estimator.models.regulator import gain_on, regulator
from tilth.simulator import noise
from tilth.simulator.noise import gauss_markov, generator
from tilth.simulator.scenario import (
    STEP_S,
    DrivenManoeuvre,
    Fieldwork,
    HeadlandTurn,
    RowSteering,
    Scenario,
    Turns,
)

Array = NDArray[np.float64]

HOLD: Final = 2  # samples between two looks of a pilot, 0.02 s
ACCELERATION: Final = 0.8  # m/s^2, with which a wanted speed changes
RANDOM_DEG: Final = 8.0  # of random steering between other segments
WANDER_S: Final = 10.0
BELIEF_S: Final = 20.0  # correlation time of a pilot's position error
DESIGN_STEP: Final = 0.5  # m/s between the speeds that gains are made for
SLOWEST: Final = 0.5  # m/s, gains below are those of this speed
SERVO: Final = 3.0  # rad/s of steering for each rad that is missing: damping 0.9 behind BOSSERD
PATH_STEP: Final = 0.1  # m
LEAD_OUT_M: Final = 40.0  # of the next row at the end of a turn's path
DRAWN_OUT_M: Final = 5.0  # straight on before a reversal, so that the implement follows in line
BACK_SPEED: Final = 1.2  # m/s
BACK_BEYOND_M: Final = 1.0  # further back than the next quarter turn begins
BACK_GAIN: Final = 2.5  # wheel angle for each rad of articulation; above 0.63 it stays in line in reverse
IN_LINE: Final = (0.15, math.radians(4.0))  # m and rad off the row: where the regulator takes over
AT: Final = {name: k for k, name in enumerate(STATES)}


class InRow(NamedTuple):
    """Where the tractor is in a row."""

    row: int
    right: float  # m, of its CG right of the row, as it drives
    off: float  # rad, of its heading from the row's
    ahead: float  # 1: the row runs north, -1: south


class RowSteer(Protocol):
    """An autosteer of simulator/autosteers.py."""

    def command(self, k: int, x: Array, at: InRow) -> float:
        """The actuator's command at sample k, rad/s. x: the state, (13,)."""
        ...


class Driver(Protocol):
    """Who steers."""

    actuator: Actuator | None

    def start(self) -> Array:
        """The first state, shape (13,)."""
        ...

    def steer(self, k: int, end: int, x: Array) -> tuple[Array | float, Array | float]:
        """(wheel angle in rad or, behind an actuator, its command; speed to hold in m/s) at samples k to end
        inclusive, from the state at k, shape (13,)."""
        ...


def driver_of(
    scenario: Scenario, rig: Rig, time: Array, seed: int, autosteer: RowSteer | None = None
) -> Driver:
    """The driver of a scenario. rig: what a pilot believes of the machine. time: (n,), s, STEP_S apart.
    autosteer: in rows instead of the pilot's regulator."""
    speed = speeds(scenario, time, generator(seed, noise.SPEED))
    steering = scenario.steering
    if isinstance(steering, (RowSteering, Fieldwork)):
        return pilot(scenario, steering, rig, speed, generator(seed, noise.BELIEF), autosteer)
    return DrivePlan(wheel_angles(scenario, time, generator(seed, noise.STEERING)), speed)


@dataclass(slots=True)
class DrivePlan:
    """Wheel angles and speeds that were settled before."""

    wheel_angle: Array  # rad, (n,)
    speed: Array  # m/s, (n,)
    actuator: Actuator | None = None

    def start(self) -> Array:
        return nonlinear.running(float(self.speed[0]), delta=float(self.wheel_angle[0]))

    def steer(self, k: int, end: int, x: Array) -> tuple[Array | float, Array | float]:
        return self.wheel_angle[k : end + 1], self.speed[k : end + 1]


# Plans.


def demo_steering(turns: Turns, rng: np.random.Generator) -> list[tuple[float, float | None]]:
    """Straight stretches and steady turns to alternating sides, then random steering: about 90 s."""
    side = 1 if rng.random() < 0.5 else -1
    segments: list[tuple[float, float | None]] = [(5.0, 0.0)]
    for turn in range(turns.turns):
        angle = side * (-1) ** turn * rng.uniform(*turns.angle_deg)
        segments += [(rng.uniform(*turns.hold), angle), (rng.uniform(*turns.straight), 0.0)]
    return [*segments, (12.0, None), (2.0, 0.0)]


def wheel_angles(scenario: Scenario, time: Array, rng: np.random.Generator) -> Array:
    """Targets of the scenario, reached at a limited rate: rad, shape (n,)."""
    steering, rate = scenario.steering, scenario.steering_rate_degps
    if isinstance(steering, DrivenManoeuvre):
        wanted = manoeuvre_named(steering.kind).wheel_angle(time, math.radians(steering.amplitude_deg), rng)
        return rate_limited(wanted, math.radians(rate) * STEP_S)
    assert not isinstance(steering, (RowSteering, Fieldwork))  # a pilot's
    segments = demo_steering(steering, rng) if isinstance(steering, Turns) else steering
    line = PiecewiseLine(0.0)
    for duration, target in cycle(segments):
        if line.end > time[-1]:
            break
        if target is not None:
            line.towards(duration, target, rate)
            continue
        end = line.end + duration
        while (duration_left := end - line.end) > 1e-9:
            line.towards(
                min(duration_left, rng.uniform(0.5, 2.0)), rng.uniform(-RANDOM_DEG, RANDOM_DEG), rate
            )
    return np.radians(line.at(time))


def speeds(scenario: Scenario, time: Array, rng: np.random.Generator) -> Array:
    """Speed to hold, m/s, shape (n,): as asked for, and wandering unless the rig stands."""
    rows = scenario.speed if isinstance(scenario.speed, tuple) else ((math.inf, scenario.speed),)
    line = PiecewiseLine(rows[0][1])
    for duration, target in cycle(rows):
        if line.end > time[-1]:
            break
        line.towards(duration, target, ACCELERATION)
    wanted = line.at(time)
    wander = gauss_markov(rng, scenario.speed_sd, WANDER_S, STEP_S, len(time))
    return np.asarray(wanted + np.minimum(np.abs(wanted), 1.0) * wander)


class PiecewiseLine:
    """A function of time made of straight pieces."""

    def __init__(self, value: float) -> None:
        self._times, self._values = [0.0], [value]

    @property
    def end(self) -> float:
        return self._times[-1]

    def towards(self, hold: float, target: float, rate: float) -> None:
        """For so many seconds towards a target at a limited rate, then staying there."""
        start, before = self._times[-1], self._values[-1]
        needed = abs(target - before) / rate
        if needed >= hold:
            self._times.append(start + hold)
            self._values.append(before + math.copysign(rate * hold, target - before))
            return
        self._times += [start + needed, start + hold]
        self._values += [target, target]

    def at(self, time: Array) -> Array:
        """Value at each time (n,), s; linear between the points."""
        return np.asarray(np.interp(time, self._times, self._values))


# The pilot.


@dataclass(slots=True)
class Pilot:
    """Automatic steering on rows that run north and south, turns between them. Angles rad, lengths m.

    Rows run from north = 0 to `length`, even ones northwards; the next one is always to the east. The
    regulator has the model's whole state, with an error of position that it does not know.
    """

    work: Fieldwork
    length: float  # infinite: one row
    east: float  # of the row that is driven
    heading: float  # of the rig at the start
    speed: Array  # m/s, (n,)
    belief: Array  # error of the believed position across the row, (n,)
    gains: Array  # (q, 13), at speeds from SLOWEST on, DESIGN_STEP apart
    rear: float  # from the CG to the rear axle
    wheelbase: float
    rate: float  # rad/s
    limit: float
    actuator: Actuator | None = BOSSERD
    autosteer: RowSteer | None = None
    row: int = 0
    turning: int | None = None  # how far along the turn's path
    path: Array = field(default_factory=lambda: np.zeros((0, 2)))
    back_at: int | None = None  # where on the path a reversal begins
    backing: bool = False
    most: float = math.inf  # m/s, rising with ACCELERATION after a turn

    def start(self) -> Array:
        return nonlinear.running(float(self.speed[0]), psi_t=self.heading, psi_i=self.heading)

    def steer(self, k: int, end: int, x: Array) -> tuple[Array | float, Array | float]:
        axle = x[:2] - self.rear * np.array([math.cos(x[AT["psi_t"]]), math.sin(x[AT["psi_t"]])])
        distance_left = self.length - axle[0] if self.row % 2 == 0 else axle[0]
        change = ACCELERATION * (end - k) * STEP_S
        if self.turning is None and distance_left <= 0.0:
            self._begin_turn()
        if self.backing and not self._is_back(axle):
            self.most = max(-BACK_SPEED, self.most - change)
            return self._command(SERVO * (self._in_reverse(x) - x[AT["delta"]]), x), self.most
        if self.turning is not None:
            rate = SERVO * (self._ahead(x, axle) - x[AT["delta"]])
            allowed = min(self.speed[k], self.work.turn_speed)
        else:
            rate = self._regulated(k, x)
            allowed = min(
                self.speed[k], math.sqrt(self.work.turn_speed**2 + 2 * ACCELERATION * max(distance_left, 0.0))
            )
        self.most = min(allowed, self.most + change)
        return self._command(rate, x), self.most

    @property
    def turn(self) -> HeadlandTurn:
        """The one at the end of this row."""
        turns = self.work.turns or (HeadlandTurn(self.work.spacing, self.work.turn_radius),)
        return turns[self.row % len(turns)]

    def _regulated(self, k: int, x: Array) -> float:
        """-K x in the row's frame, or what an autosteer commands."""
        north = self.row % 2 == 0
        off = x.copy()
        across = x[AT["y_t"]] - self.east
        right = across if north else -across
        off[AT["y_t"]] = right + self.belief[k]
        for name in ("psi_t", "psi_i"):
            off[AT[name]] = math.remainder(x[AT[name]] - (0.0 if north else math.pi), math.tau)
        if self.autosteer is not None:
            at = InRow(self.row, float(right), float(off[AT["psi_t"]]), 1.0 if north else -1.0)
            return self.autosteer.command(k, x, at)
        design = round((abs(x[AT["u"]]) - SLOWEST) / DESIGN_STEP)
        return -float(self.gains[min(max(design, 0), len(self.gains) - 1)] @ off)

    def _command(self, rate: float, x: Array) -> float:
        """The actuator's command: its rate limited, and none into the stop."""
        delta = x[AT["delta"]]
        low = -self.rate if delta > -self.limit else 0.0
        high = self.rate if delta < self.limit else 0.0
        return min(max(rate, low), high)

    def _end_turn(self, axle: Array, psi: float) -> None:
        """Once the rig is on the next row and in line with it."""
        assert self.turning is not None
        north, east = self.path[-1] - self.path[-2]
        across, off = (
            abs(self.path[-1][1] - axle[1]),
            abs(math.remainder(psi - math.atan2(east, north), math.tau)),
        )
        to_go = (len(self.path) - self.turning) * PATH_STEP
        if to_go < 1.0 or (to_go < LEAD_OUT_M and across < IN_LINE[0] and off < IN_LINE[1]):
            self.east += self.turn.spacing
            self.turning, self.row = None, self.row + 1

    def _begin_turn(self) -> None:
        """Lay the path from the end of this row to the start of the next one."""
        north = 1.0 if self.row % 2 == 0 else -1.0
        turn, start = self.turn, np.array([self.length if north > 0 else 0.0, self.east])
        shape = away(turn.radius) if turn.reversal else headland(turn.radius, turn.spacing)
        self.path = start + shape * np.array([north, 1.0])  # the next row is to the east in either direction
        self.turning = 0
        self.back_at = len(shape) - round(LEAD_OUT_M / PATH_STEP) if turn.reversal else None

    def _is_back(self, axle: Array) -> bool:
        """Whether the reversal is over; then lay the path from here to the start of the next row."""
        radius = self.turn.radius
        ahead = self.east + self.turn.spacing - radius - axle[1]
        if ahead < BACK_BEYOND_M:
            return False
        north = 1.0 if self.row % 2 == 0 else -1.0
        # Along the headland forward is east, and the row's start is on the other side.
        shape = _laid([(ahead, 0.0), (radius * math.pi / 2, 1 / radius)])
        self.path = axle + shape[:, ::-1] * np.array([-north, 1.0])
        self.backing, self.turning = False, 0
        return True

    def _in_reverse(self, x: Array) -> float:
        """Wheel angle that backs the implement straight along the headland."""
        off = math.remainder(x[AT["psi_i"]] - math.pi / 2, math.tau)
        if x[AT["u"]] > 0.0:
            wanted = -math.remainder(x[AT["psi_t"]] - math.pi / 2, math.tau)
        else:
            wanted = BACK_GAIN * (math.remainder(x[AT["psi_t"]] - x[AT["psi_i"]], math.tau) - off)
        return min(max(wanted, -self.limit), self.limit)

    def _ahead(self, x: Array, axle: Array) -> float:
        """Wheel angle towards a point of the path ahead; ends the turn at the path's end."""
        assert self.turning is not None
        near = self.path[self.turning : self.turning + 20] - axle
        self.turning += int(np.argmin(np.hypot(near[:, 0], near[:, 1])))
        reach = 2.0 + 1.5 * abs(x[AT["u"]])
        target = self.path[min(self.turning + round(reach / PATH_STEP), len(self.path) - 1)] - axle
        bearing = math.atan2(target[1], target[0]) - x[AT["psi_t"]]
        if self.back_at is None:
            self._end_turn(axle, x[AT["psi_t"]])
        elif self.turning >= self.back_at:
            self.back_at, self.backing = None, True
        # The circle through the rear axle, tangent to the tractor, that passes the point.
        wanted = math.atan2(2 * self.wheelbase * math.sin(bearing), math.hypot(target[0], target[1]))
        return min(max(wanted, -self.limit), self.limit)


def pilot(
    scenario: Scenario,
    work: RowSteering | Fieldwork,
    rig: Rig,
    speed: Array,
    rng: np.random.Generator,
    autosteer: RowSteer | None = None,
) -> Pilot:
    """A pilot for a scenario; his gains are the dissertation's weights on the relaxation-length model."""
    rows = Fieldwork() if isinstance(work, RowSteering) else work
    length, first, heading_deg = rows.length, 0.0, 0.0
    if isinstance(work, RowSteering):
        length, first, heading_deg = math.inf, work.offset, work.heading_deg
    return Pilot(
        work=rows,
        length=length,
        east=first,
        heading=math.radians(heading_deg),
        speed=speed,
        belief=gauss_markov(rng, work.position_sd, BELIEF_S, STEP_S, len(speed)),
        gains=design(rig, float(speed.max())),
        rear=rig.b,
        wheelbase=rig.wheelbase,
        rate=math.radians(scenario.steering_rate_degps),
        limit=math.radians(scenario.steering_limit_deg),
        autosteer=autosteer,
    )


def design(rig: Rig, fastest: float) -> Array:
    """Gains on the states of the nonlinear model at speeds from SLOWEST on, shape (q, 13)."""
    grid = np.arange(SLOWEST, max(fastest, SLOWEST) + DESIGN_STEP, DESIGN_STEP)
    made = [regulator(system(model_named("relaxation"), rig, float(u), actuator=BOSSERD)) for u in grid]
    return np.array([gain_on(each.states, each.gain, STATES) for each in made])


def headland(radius: float, spacing: float) -> Array:
    """Path of the rear axle from one row to the next one on the right: forward and right, shape (m, 2), m.

    Rows that are closer than two radii need a loop: away from the next row, round, and back into it.
    """
    if spacing < 2 * radius:
        away = math.acos((radius + spacing / 2) / (2 * radius))
        pieces = [
            (radius * away, -1 / radius),
            (radius * (math.pi + 2 * away), 1 / radius),
            (radius * away, -1 / radius),
        ]
    else:
        quarter = radius * math.pi / 2
        pieces = [(quarter, 1 / radius), (spacing - 2 * radius, 0.0), (quarter, 1 / radius)]
    return _laid(pieces)


def away(radius: float) -> Array:
    """Path of the rear axle into a turn with a reversal: a quarter to the right and straight on along the
    headland, as `headland`. What lies DRAWN_OUT_M beyond the quarter is only to look at."""
    return _laid([(radius * math.pi / 2, 1 / radius), (DRAWN_OUT_M, 0.0)])


def _laid(pieces: list[tuple[float, float]]) -> Array:
    """A path of (length in m, bend to the right in 1/m) and LEAD_OUT_M straight on: forward and right from
    its start, shape (m, 2), m."""
    lengths, bends = np.array([*pieces, (LEAD_OUT_M, 0.0)]).T
    ends = np.concatenate([[0.0], np.cumsum(lengths)])
    headings = np.concatenate([[0.0], np.cumsum(lengths * bends)])
    middle = np.interp(np.arange(0.0, ends[-1], PATH_STEP) + PATH_STEP / 2, ends, headings)
    steps = PATH_STEP * np.column_stack([np.cos(middle), np.sin(middle)])
    return np.vstack([np.zeros(2), np.cumsum(steps, axis=0)])
