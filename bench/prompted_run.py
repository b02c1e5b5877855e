"""A virtual tractor whose driver is prompted through a plan, faster than real time, on either plant.

The prompter is the product's own; it sees poses made of the plant's states with receivers' noise. Its marks
come with their times, so that a log can be cut by them as one of a real run.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.random import default_rng
from numpy.typing import NDArray

from tilth.client.experiment.following import wanted_at
from tilth.client.experiment.prompter import (
    FINISHED,
    RUNNING,
    Course,
    Input,
    Mark,
    Marked,
    Order,
    Prompt,
    Tick,
    conditions_of,
    drive_at,
    run_s,
    step,
)
from tilth.client.experiment.sight import FieldPlace, Seen
from tilth.estimator.models import nonlinear
from tilth.estimator.models.actuator import Actuator
from tilth.estimator.models.nonlinear import STATES
from tilth.estimator.models.parameters import Rig
from tilth.schemas.experiment import ExperimentPlan
from tilth.simulator.pilots import ACCELERATION
from tilth.simulator.prompted_driver import Bar, Person, PromptedDriver
from tilth.simulator.scenario import STEP_S

Array = NDArray[np.float64]

POSE_S: Final = 0.2
NOISE: Final = (0.02, math.radians(0.2), math.radians(0.2), 0.03, math.radians(0.1))
"""Sds of a pose: place, m; heading, rad; yaw rate, rad/s; speed, m/s; wheel angle, rad."""
AT: Final = {name: k for k, name in enumerate(STATES)}

Mishap = Callable[[float, Prompt, Seen], Seen]
"""What goes wrong: may change what is seen, by the time and where the plan stands."""


def nothing_wrong(now: float, prompt: Prompt, seen: Seen) -> Seen:
    return seen


@dataclass(slots=True)
class Prompted:
    """A driver of `simulator.drive.drive`. `mishap` also may ask for another speed by `pedal`."""

    course: Course
    rig: Rig
    person: Person
    seed: int
    mishap: Mishap = nothing_wrong
    refuse: Callable[[str], str] = lambda text: ""  # marks, by their text: why one is refused, or ""
    pedal: Callable[[float, Prompt, float], float] = lambda now, prompt, wanted: wanted
    prompt: Prompt = field(default_factory=Prompt)
    marks: list[tuple[float, str]] = field(default_factory=list)
    phases: list[tuple[float, str, str]] = field(default_factory=list)  # when, phase, what was said
    actuator: Actuator | None = None
    _next_s: float = 0.0
    _angle: float = 0.0
    _speed: float = 0.0
    _driver: PromptedDriver = field(init=False)
    _rng: np.random.Generator = field(init=False)

    def __post_init__(self) -> None:
        field_ = self.course.plan.field
        self._rng = default_rng([self.seed, 5])
        lane = (field_.headland, 0.0, 0.0, field_.length - 2 * field_.headland)
        self._driver = PromptedDriver(self.person, lane, self.seed)
        self._speed = self.course.drives[0].scheduled.run.speed

    @property
    def finished(self) -> bool:
        return self.prompt.phase == FINISHED

    @property
    def driver(self) -> PromptedDriver:
        return self._driver

    def start(self) -> Array:
        return nonlinear.running(self._speed)

    def steer(self, k: int, end: int, x: Array) -> tuple[Array | float, Array | float]:
        now = k * STEP_S
        if now >= self._next_s - 1e-9:
            self._next_s += POSE_S
            self._see(now, x)
        bar = self._bar()
        wanted = self._driver.hands(now, bar, x)
        most = self.person.rate * STEP_S
        angles = []
        for _ in range(k, end + 1):
            angles.append(self._angle)
            self._angle += min(max(wanted - self._angle, -most), most)
        self._angle = angles[-1]
        asked = self.pedal(now, self.prompt, bar.speed)
        change = ACCELERATION * (end - k) * STEP_S * (4.0 if asked < self._speed - 1.0 else 1.0)
        self._speed += min(max(asked - self._speed, -change), change)
        return np.array(angles), self._speed

    def _see(self, now: float, x: Array) -> None:
        place, heading, yaw, speed, wheel = self._rng.standard_normal(5) * NOISE
        seen = Seen(
            now, x[AT["x_t"]] + place, x[AT["y_t"]] + place, x[AT["psi_t"]] + heading, x[AT["r_t"]] + yaw,
            x[AT["u"]] + speed, x[AT["delta"]] + wheel, 1 if x[AT["u"]] > 0.1 else 0,
        )  # fmt: skip
        self._take(self.mishap(now, self.prompt, seen))
        self._take(Tick(now))
        pressed = self._driver.look(now, self._bar(), x)
        if pressed:
            self._take(Order(pressed))

    def _take(self, came: Input) -> None:
        before = self.prompt
        self.prompt, acts = step(self.prompt, self.course, came)
        if (before.phase, before.said) != (self.prompt.phase, self.prompt.said):
            self.phases.append((self.prompt.now_s, self.prompt.phase, self.prompt.said))
        for act in acts:
            self._mark(act)

    def _mark(self, mark: Mark) -> None:
        refusal = self.refuse(mark.text)
        if not refusal:
            self.marks.append((self.prompt.now_s, mark.text))
        self._take(Marked(mark.text, refusal))

    def _bar(self) -> Bar:
        prompt, drive = self.prompt, drive_at(self.prompt, self.course)
        if drive is None:
            return Bar(prompt.phase, 0.0, self.course.drives[-1].scheduled.run.speed, True)
        wanted = wanted_at(drive.angles, run_s(prompt)) if prompt.phase == RUNNING else 0.0
        room = prompt.place is None or all(
            c.met for c in conditions_of(prompt, self.course) if c.name == "room"
        )
        return Bar(prompt.phase, wanted, drive.scheduled.run.speed, room)


def placed(prompt: Prompt, plan: ExperimentPlan) -> Prompt:
    """With the field about the lane that the driver follows: the corner left of where he starts."""
    return replace(prompt, place=FieldPlace(0.0, -plan.field.width / 2, 0.0))
