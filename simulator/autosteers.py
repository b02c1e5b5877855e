"""Autosteers of different make, in rows: what each hears, what it asks of the wheels, how they follow.

pid      a receiver of its own on the cab; PID on offset and course at 10 Hz, a tenth of a second late, with a
         dead band; the wheels follow with a lag of 0.3 s
valve    hears the first receiver of the tractor, as Tilth does; commands of curvature at 5 Hz, in steps of
         PGN 44288, to a valve with hysteresis that turns the wheels at one rate to either side: a limit cycle
pursuit  a receiver and a gyro of its own; pure pursuit of a recorded line at 20 Hz, smooth
manual   a person who looks at a point ahead, and corrects from time to time

Each believes the wheelbase of the machine file, has a wheel-angle sensor of its own without error, and
corrects position and course for roll and slip, so that its integral alone finds a side slope's crab angle.
`own` of the scenario is a factor on all that does not answer the ground: errors of own sensors, dead bands,
hysteresis, steps of the line. All is drawn from the run's seed.
"""

import math
from collections import deque
from dataclasses import dataclass, field
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.models.nonlinear import STATES
from tilth.schemas.machine import Machine
from tilth.simulator import noise
from tilth.simulator.ground import Waves, waves
from tilth.simulator.noise import gauss_markov, generator
from tilth.simulator.pilots import HOLD, SERVO, SLOWEST, InRow
from tilth.simulator.receivers import FIRST_EPOCH_S, Receiving
from tilth.simulator.scenario import STEP_S, Autosteer, Fieldwork, RowSteering
from tilth.simulator.tractor import Setting

Array = NDArray[np.float64]

AT: Final = {name: k for k, name in enumerate(STATES)}
NUDGE_S: Final = 15.0  # mean time between two steps of the line
NUDGE_SD: Final = 0.01  # m, of where each step leads
SUM_LIMIT: Final = math.radians(3.0)  # of what an integrator may ask for
SUM_WITHIN: Final = 0.1  # m off the row, as which more counts when it adds up
MOST_RIGHT: Final = 2.0  # m off the row, as which whatever is further counts: no steeper approach


class Law(Protocol):
    """From what is heard to a wheel angle."""

    def wheel_angle(self, k: int, x: Array, at: InRow) -> float:
        """Asked for at sample k, rad; asked HOLD samples apart."""
        ...

    def begin(self) -> None:
        """A row begins: what was there before is of a turn or of nothing."""
        ...


VALVE_RATE: Final = math.radians(4.0)  # rad/s
VALVE_SLACK: Final = math.radians(0.1)
VALVE_LATE: Final = 6  # looks, HOLD samples apart: 0.1 s until its spool has moved


@dataclass(slots=True)
class Valve:
    """Wheels that follow what is asked for in proportion, with a lag of 1/SERVO; or, with a slack (rad), at
    one rate to either side: it turns over once they are further off than that, so that they never rest."""

    slack: float = 0.0
    _ways: deque[float] = field(default_factory=lambda: deque([VALVE_RATE] * VALVE_LATE, maxlen=VALVE_LATE))

    def command(self, missing: float) -> float:
        """rad/s. missing: rad."""
        if self.slack == 0.0:
            return SERVO * missing
        turned_over = abs(missing) > self.slack
        self._ways.append(math.copysign(VALVE_RATE, missing) if turned_over else self._ways[-1])
        return self._ways[0]


@dataclass(slots=True)
class Steered:
    """An autosteer at work: a law, and the valve that follows it."""

    law: Law
    valve: Valve
    dither: Array  # rad, (n,)
    row: int | None = None

    def command(self, k: int, x: Array, at: InRow) -> float:
        """As RowSteer."""
        if at.row != self.row:
            self.row = at.row
            self.law.begin()
        wanted = self.law.wheel_angle(k, x, at) + float(self.dither[k])
        return self.valve.command(wanted - float(x[AT["delta"]]))


@dataclass(slots=True)
class Feedback:
    """Wheel angle on offset and course: bandwidth 1/m and damping of the path that follows, and an integral
    for side slopes and a wrong zero."""

    wheelbase: float
    bandwidth: float
    damping: float
    integral_s: float
    sum: float = 0.0

    @property
    def by_course(self) -> float:
        """Wheel angle for each rad of course."""
        return 2 * self.damping * self.wheelbase * self.bandwidth

    def __call__(self, right: float, course: float, step_s: float) -> float:
        """rad. right: m; course: rad; both from the line."""
        by_offset = self.wheelbase * self.bandwidth**2
        right = min(max(right, -MOST_RIGHT), MOST_RIGHT)
        near = min(max(right, -SUM_WITHIN), SUM_WITHIN)
        grown = self.sum + by_offset * near * step_s / self.integral_s
        self.sum = min(max(grown, -SUM_LIMIT), SUM_LIMIT)
        return -(by_offset * right + self.by_course * course + self.sum)


@dataclass(slots=True)
class Pid:
    """Every PID_STEP samples."""

    feedback: Feedback
    dead: float  # m
    offset_error: Array  # m, (n,), of its receiver and of where it takes the line to be
    drift: Array  # m/s, (n,), error of its velocity across
    _course: float | None = None
    _asked: deque[float] = field(default_factory=lambda: deque([0.0, 0.0], maxlen=2))

    def begin(self) -> None:
        self.feedback.sum, self._course = 0.0, None

    def wheel_angle(self, k: int, x: Array, at: InRow) -> float:
        if k % PID_STEP == 0:
            right = at.right + float(self.offset_error[k])
            right -= min(max(right, -self.dead), self.dead)
            course = at.off + float(self.drift[k]) / max(float(x[AT["u"]]), SLOWEST)
            turned = 0.0 if self._course is None else course - self._course
            self._course = course
            wanted = self.feedback(right, course, PID_STEP * STEP_S)
            wanted -= PID_LEAD_S * self.feedback.by_course * turned / (PID_STEP * STEP_S)
            self._asked.append(wanted)
        return self._asked[0]  # one look late


PID_STEP: Final = 10  # samples, 0.1 s
PID_DEAD: Final = 0.01  # m
PID_LEAD_S: Final = 0.25  # of the course's rate of change
PID_WHITE: Final = (0.006, 0.035)  # m and m/s, sd of position and velocity at each look


@dataclass(slots=True)
class ByCurvature:
    """On each report of a receiver that Tilth hears too, once it has come."""

    feedback: Feedback
    heard: Array  # as Receiving.heard, at least CURVATURE_S apart
    ahead: float  # m, of the receiver from the CG
    line: Array  # m, (n,), steps of the line
    resolution: float  # 1/m
    _next: int = 0
    _waiting: deque[tuple[float, float, float, float]] = field(default_factory=deque)  # s; m; rad; rad turned
    _smooth: float = 0.0  # rad, the course
    _reports: int = 0  # in this row
    _asked: float = 0.0

    def begin(self) -> None:
        self.feedback.sum, self._smooth, self._reports = 0.0, 0.0, 0
        self._waiting.clear()

    def wheel_angle(self, k: int, x: Array, at: InRow) -> float:
        now, u = k * STEP_S, max(float(x[AT["u"]]), SLOWEST)
        while self._next < len(self.heard) and self.heard[self._next, 0] <= now + 1e-9:
            instant, sent, _, east, _, drift, turning = self.heard[self._next].tolist()
            self._next += 1
            if instant < now - HOLD * STEP_S:
                continue  # of a turn, in which nobody asked
            right = at.right + self.ahead * at.off + at.ahead * east + float(self.line[k])
            turned = CURVATURE_S * (float(x[AT["r_t"]]) + turning)
            self._waiting.append((sent, right, at.off + at.ahead * drift / u, turned))
        while self._waiting and self._waiting[0][0] <= now:
            _, right, course, turned = self._waiting.popleft()
            self._reports += 1
            self._smooth += turned
            self._smooth += max(SMOOTHED, 1.0 / self._reports) * (course - self._smooth)
            angle = self.feedback(right, self._smooth, CURVATURE_S)
            curvature = math.tan(angle) / self.feedback.wheelbase
            if self.resolution:
                curvature = self.resolution * round(curvature / self.resolution)
            self._asked = math.atan(self.feedback.wheelbase * curvature)
        return self._asked


CURVATURE_S: Final = 0.2  # between two commands
CURVATURE_STEP: Final = 0.25e-3  # 1/m, of PGN 44288
SMOOTHED: Final = 0.1  # of each report's course, that enters what the turn rate says


@dataclass(slots=True)
class Pursuit:
    """Towards a point ahead on a line that was recorded, every PURSUIT_STEP samples."""

    wheelbase: float
    line: Waves  # m right of the row, by the way north
    offset_error: Array  # m, (n,)
    course_error: Array  # rad, (n,)
    _sum: float = 0.0
    _asked: float = 0.0

    def begin(self) -> None:
        self._sum = 0.0

    def wheel_angle(self, k: int, x: Array, at: InRow) -> float:
        if k % PURSUIT_STEP == 0:
            reach = PURSUIT_LEAST + PURSUIT_S * max(float(x[AT["u"]]), SLOWEST)
            right = at.right + float(self.offset_error[k])
            course = at.off + float(self.course_error[k])
            target = float(self.line.at(float(x[AT["x_t"]]) + at.ahead * reach))
            bearing = math.atan2(target - right, reach) - course
            near = min(max(target - right, -SUM_WITHIN), SUM_WITHIN)
            grown = self._sum + near * PURSUIT_STEP * STEP_S / PURSUIT_SUM_S
            self._sum = min(max(grown, -PURSUIT_SUM), PURSUIT_SUM)
            bearing += self._sum / reach
            self._asked = math.atan(2 * self.wheelbase * math.sin(bearing) / reach)
        return self._asked


PURSUIT_STEP: Final = 5  # samples, 0.05 s
PURSUIT_LEAST, PURSUIT_S = 2.5, 0.8  # m, and s of the way ahead
PURSUIT_LINE: Final = (0.008, (6.0, 20.0))  # m, sd of the line; m, its waves
PURSUIT_COURSE: Final = (math.radians(0.38), 0.4)  # rad and s, of course by gyro and receiver
PURSUIT_SUM_S: Final = 12.0
PURSUIT_SUM: Final = 0.3  # m, the most by which the integral moves the target


@dataclass(slots=True)
class ManualSteering:
    """Holds the wheel, and corrects it every now and then."""

    feedback: Feedback
    instants: NDArray[np.int64]  # (m,), samples at which he corrects
    slips: Array  # (m,), rad, by how much each correction is off
    seen_error: Array  # m, (n,), at the point ahead
    dead: float  # m
    _next: int = 0
    _asked: float = 0.0

    def begin(self) -> None:
        self.feedback.sum = 0.0

    def wheel_angle(self, k: int, x: Array, at: InRow) -> float:
        if self._next < len(self.instants) and k >= self.instants[self._next]:
            self._next = int(np.searchsorted(self.instants, k, side="right"))
            slip = float(self.slips[self._next - 1])
            right = at.right + float(self.seen_error[k])
            right -= min(max(right, -self.dead), self.dead)
            self._asked = self.feedback(right, at.off, PERSON_S[0]) + slip
        return self._asked


PERSON_S: Final = (0.5, 0.2)  # s between two corrections, mean and least
PERSON_SEES: Final = (0.03, 2.0)  # m and s, error of what he sees
PERSON_DEAD: Final = 0.02  # m
PERSON_SLIP: Final = math.radians(0.4)


# Making them.


def autosteer_of(machine: Machine, setting: Setting) -> Steered | None:
    """What steers in the rows of a run; None where that is the pilot's regulator, or there are no rows."""
    work = setting.scenario.steering
    if not isinstance(work, (RowSteering, Fieldwork)) or work.autosteer is None:
        return None
    made, n = work.autosteer, len(setting.time)
    rng = generator(setting.seed, noise.AUTOSTEER)
    dither = gauss_markov(rng, math.radians(made.dither_deg), DITHER_S, STEP_S, n)
    law, valve = {"pid": _pid, "valve": _valve, "pursuit": _pursuit, "manual": _manual}[made.make](
        machine, setting, made, work.position_sd, rng
    )
    return Steered(law, valve, dither)


DITHER_S: Final = 0.5  # correlation time


def _slow(rng: np.random.Generator, sd: float, n: int) -> Array:
    return gauss_markov(rng, sd, POSITION_S, STEP_S, n)


POSITION_S: Final = 20.0  # correlation time of an own receiver's error


def _nudges(rng: np.random.Generator, own: float, n: int) -> Array:
    """Steps of the line, m, (n,): somebody shifts it, or the base's correction does."""
    line, at = np.zeros(n), 0
    while at < n:
        last = at + max(1, round(rng.exponential(NUDGE_S) / STEP_S))
        line[at:last] = own * rng.normal(0.0, NUDGE_SD)
        at = last
    return line


def _pid(
    machine: Machine, setting: Setting, made: Autosteer, position_sd: float, rng: np.random.Generator
) -> tuple[Law, Valve]:
    n, own = len(setting.time), made.own
    offset = own * (_slow(rng, position_sd, n) + PID_WHITE[0] * rng.standard_normal(n)) + _nudges(rng, own, n)
    drift = own * PID_WHITE[1] * rng.standard_normal(n)
    return Pid(Feedback(setting.believed.wheelbase, 0.18, 0.8, 12.0), own * PID_DEAD, offset, drift), Valve()


def _valve(
    machine: Machine, setting: Setting, made: Autosteer, position_sd: float, rng: np.random.Generator
) -> tuple[Law, Valve]:
    receiver = next(r for r in machine.receiver if r.mount.body == "tractor")
    heard = Receiving(machine, setting, receiver, FIRST_EPOCH_S).heard()
    taken = heard[np.unique(np.round(heard[:, 0] / CURVATURE_S).astype(np.int64), return_index=True)[1]]
    line = _nudges(rng, made.own, len(setting.time))
    feedback = Feedback(setting.believed.wheelbase, 0.14, 0.8, 12.0)
    law = ByCurvature(feedback, taken, receiver.position[0], line, made.own * CURVATURE_STEP)
    return law, Valve(made.own * VALVE_SLACK + math.radians(made.slack_deg))


def _pursuit(
    machine: Machine, setting: Setting, made: Autosteer, position_sd: float, rng: np.random.Generator
) -> tuple[Law, Valve]:
    n, own = len(setting.time), made.own
    sd, band = PURSUIT_LINE
    base = setting.believed.wheelbase
    return Pursuit(
        base,
        waves(rng, own * sd, band),
        own * _slow(rng, position_sd, n),
        own * gauss_markov(rng, *PURSUIT_COURSE, STEP_S, n),
    ), Valve()


def _manual(
    machine: Machine, setting: Setting, made: Autosteer, position_sd: float, rng: np.random.Generator
) -> tuple[Law, Valve]:
    n, own = len(setting.time), made.own
    mean, least = PERSON_S
    gaps = least + rng.exponential(mean - least, math.ceil(n * STEP_S / least) + 1)
    instants = np.round(np.cumsum(gaps) / STEP_S).astype(np.int64)
    seen = own * gauss_markov(rng, *PERSON_SEES, STEP_S, n)
    slips = own * PERSON_SLIP * rng.standard_normal(len(instants))
    feedback = Feedback(setting.believed.wheelbase, 0.12, 0.9, 15.0)
    return ManualSteering(feedback, instants, slips, seen, own * PERSON_DEAD), Valve()
