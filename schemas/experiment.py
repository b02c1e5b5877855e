"""A plan of experiments: one TOML text that people edit says what is to be driven, how often, and where.

A wrong plan raises PlanError with one line that names the key, the value, what is allowed and the nearest
right key. examples/experiments.toml shows most keys in use, docs/experiments.md what they are for. This
module reads text; whether a rig and a field have room for it is in estimator/models/planned_run.py.
"""

import hashlib
import re
import tomllib
from collections.abc import Mapping
from enum import StrEnum
from typing import Annotated, Any, Final, Literal, Self

from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, ValidationError, model_validator

from tilth.schemas.file_problem import sentence
from tilth.schemas.flow import PARAMETERS


class PlanError(Exception):
    """The plan is wrong; the text says where and what to do."""


class Phase(StrEnum):
    """Where the prompting of a run stands."""

    IDLE = "idle"
    LINING_UP = "lining_up"
    COUNTDOWN = "countdown"
    RUNNING = "running"
    NOTING = "noting"
    FINISHED = "finished"


class Outcome(StrEnum):
    """What became of one try of a run."""

    DONE = "done"
    ABORTED = "aborted"
    DISTURBED = "disturbed"
    SKIPPED = "skipped"


KINDS: Final = ("step", "steps", "chirp", "random", "multisine", "turn")  # rows of MANOEUVRES
_SAY_KIND: Final = f"give kind = one of {', '.join(KINDS)}"

Hertz = Annotated[float, Field(ge=0.02, le=2.0)]
Hold = Annotated[float, Field(ge=0.2, le=30.0, description="s")]


class _PlanSection(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _nothing_is_true_or_false(cls, raw: Any) -> Any:
        for key, value in raw.items() if isinstance(raw, dict) else ():
            if isinstance(value, bool):  # which counts as 1 or 0 otherwise
                raise ValueError(f"{key} = {str(value).lower()}: give a number or a text")
        return raw


class DrivingLimits(_PlanSection):
    """What no run may exceed, and when a run is broken off."""

    wheel_angle_deg: float = Field(default=12.0, gt=0, le=37, description="of the wheels")
    wheel_rate_degps: float = Field(default=15.0, gt=0, le=60, description="how fast a driver turns them")
    lateral_acceleration: float = Field(default=2.5, gt=0, le=5, description="m/s^2")
    braking: float = Field(default=1.5, gt=0, le=8, description="m/s^2: a harder one breaks a run off")
    off_the_bar_deg: float = Field(default=5.0, gt=0, le=20, description="of a driver who looks away")
    off_the_bar_s: float = Field(default=1.5, gt=0, le=20, description="after which he has looked away")


class Rectangle(_PlanSection):
    """Where to drive. Without a corner its near headland ends where the first run is armed."""

    length: float = Field(ge=30, le=5000, description="m, along the runs")
    width: float = Field(ge=10, le=5000, description="m, to the right of the corner")
    headland: float = Field(default=20.0, ge=0, le=200, description="m, at both ends: for turning only")
    corner: tuple[Annotated[float, Field(ge=-90, le=90)], Annotated[float, Field(ge=-180, le=180)]] | None = (
        Field(default=None, description="latitude, longitude; the left one at the near end, degrees")
    )
    heading_deg: float | None = Field(
        default=None, ge=-360, le=360, description="of its length, clockwise from north"
    )

    @model_validator(mode="after")
    def _both(self) -> Self:
        if (self.corner is None) != (self.heading_deg is None):
            raise ValueError("give corner and heading_deg both, or neither")
        if 2 * self.headland >= self.length:
            raise ValueError(
                f"two headlands of {self.headland:g} m leave nothing of a field of {self.length:g} m"
            )
        return self


class _RunBase(_PlanSection):
    speed: float = Field(ge=1.5, le=12, description="m/s")
    amplitude_deg: float = Field(gt=0, le=37, description="largest angle of the wheels")
    seconds: float = Field(ge=6, le=60, description="s, of steering")
    replicates: int = Field(default=3, ge=1, le=20)
    side: Literal["right", "left", "both"] = Field(
        default="both", description="to which it begins; both: replicates in turn"
    )
    predicted: Mapping[str, float] = Field(
        default_factory=dict, description="sd of the logarithms by its replicates alone; for reading"
    )


class StepRun(_RunBase):
    """The wheels turned at once and held."""

    kind: Literal["step"]


class StepsRun(_RunBase):
    """To one side and the other."""

    kind: Literal["steps"]
    hold_s: Hold = 3.0

    @model_validator(mode="after")
    def _to_both_sides(self) -> Self:
        if self.hold_s >= self.seconds:
            raise ValueError(
                f"hold_s = {self.hold_s:g} leaves no second side in seconds = {self.seconds:g}; one angle "
                'that is held is kind = "step"'
            )
        return self


class _SweptRun(_RunBase):
    low_hz: Hertz = 0.05
    high_hz: Hertz = 0.5

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.high_hz < self.low_hz:
            raise ValueError(f"high_hz = {self.high_hz:g} is below low_hz")
        return self


class ChirpRun(_SweptRun):
    """Swinging faster and faster."""

    kind: Literal["chirp"]


class RandomRun(_RunBase):
    """Levels drawn within the amplitude, held for a while that is drawn too."""

    kind: Literal["random"]
    shortest_s: Hold = 0.5
    longest_s: Hold = 2.0

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.longest_s < self.shortest_s:
            raise ValueError(f"longest_s = {self.longest_s:g} is shorter than shortest_s")
        return self


class MultisineRun(_SweptRun):
    """Many frequencies at once."""

    kind: Literal["multisine"]


class TurnRun(_RunBase):
    """As into a headland turn: the wheels turned within two seconds, and held."""

    kind: Literal["turn"]


def _kind(raw: Any) -> str | None:
    return raw.get("kind") if isinstance(raw, dict) else getattr(raw, "kind", None)


Run = Annotated[
    Annotated[StepRun, Tag("step")]
    | Annotated[StepsRun, Tag("steps")]
    | Annotated[ChirpRun, Tag("chirp")]
    | Annotated[RandomRun, Tag("random")]
    | Annotated[MultisineRun, Tag("multisine")]
    | Annotated[TurnRun, Tag("turn")],
    Discriminator(_kind, custom_error_type="kind", custom_error_message=_SAY_KIND),
]
AnyRun = StepRun | StepsRun | ChirpRun | RandomRun | MultisineRun | TurnRun


class ExperimentPlan(_PlanSection):
    """All of a plan."""

    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,60}$", description="part of every mark")
    machine: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$", description="of the machine file")
    seed: int = Field(default=1, ge=0, le=2**31, description="of the order and of random steering")
    countdown_s: float = Field(default=3.0, ge=1, le=20)
    field: Rectangle
    limits: DrivingLimits = DrivingLimits()
    run: tuple[Run, ...] = Field(min_length=1, max_length=50)
    predicted: Mapping[str, float] = Field(
        default_factory=dict, description="sd of the logarithms by all runs; for reading"
    )
    predicted_with_log: Mapping[str, float] = Field(
        default_factory=dict, description="the same with what a log told before; for reading"
    )
    predicted_for: str = Field(default="", max_length=64, description="`steered` of the plan as it was then")

    @model_validator(mode="after")
    def _within_limits(self) -> Self:
        for number, run in enumerate(self.run, 1):
            if run.amplitude_deg > self.limits.wheel_angle_deg:
                raise ValueError(
                    f"run[{number}].amplitude_deg = {run.amplitude_deg:g}: limits.wheel_angle_deg allows "
                    f"{self.limits.wheel_angle_deg:g}"
                )
        for name in {
            *self.predicted,
            *self.predicted_with_log,
            *(key for run in self.run for key in run.predicted),
        }:
            if name not in PARAMETERS:
                raise ValueError(f"predicted.{name}: there are {', '.join(PARAMETERS)}")
        return self


def steered(plan: ExperimentPlan) -> str:
    """Eight hexadecimal digits that change with what is steered: what was predicted holds for that alone.
    Numbers count with the six digits with which a plan is written."""
    runs = [run.model_dump(exclude={"predicted"}) for run in plan.run]
    drawn = plan.seed if any(run.kind == "random" for run in plan.run) else 0
    rows = [[f"{key}={_written(value)}" for key, value in run.items()] for run in runs]
    whole = f"{drawn} {_written(plan.limits.wheel_rate_degps)} {rows}"
    return hashlib.sha256(whole.encode()).hexdigest()[:8]


def edited(plan: ExperimentPlan) -> bool:
    """Whether its runs are others than those of which something was predicted."""
    return bool(plan.predicted_for) and plan.predicted_for != steered(plan)


def _written(value: Any) -> str:
    return f"{value:g}" if isinstance(value, int | float) else str(value)


def parse_plan(text: str) -> ExperimentPlan:
    """Raises PlanError."""
    try:
        raw = tomllib.loads(text.removeprefix("\ufeff"))  # as some editors begin a file
    except tomllib.TOMLDecodeError as error:
        raise PlanError(f"not a TOML file: {_toml_fault(text, str(error).lower())}") from None
    if not raw:
        raise PlanError("there is nothing in it; a plan needs name, machine, [field] and a [[run]]")
    if "tractor" in raw and "run" not in raw:
        raise PlanError("this is a machine file; a plan needs name, machine, [field] and a [[run]]")
    try:
        return ExperimentPlan.model_validate(raw)
    except ValidationError as error:
        raise PlanError(sentence(error, raw, ExperimentPlan)) from None


def _toml_fault(text: str, said: str) -> str:
    """What the reader of TOML says, and what it comes from where that is known."""
    if "cannot overwrite" not in said:
        return said
    if re.search(r"^\s*\[run\]", text, re.MULTILINE):
        return f"{said}: write [[run]], in two brackets, before each run"
    return f"{said}: a key or a section stands there for the second time"
