"""The prompter: takes a driver through a plan, run by run. A pure function of what was so far and what comes.

    idle ─arm─► lining_up ─all is as it should be─► countdown ─► running ─► noting ─► idle, next run
                    ▲  stop: idle     something is not │            │ broken off: idle, the same run again
                    └──────────────────────────────────┘            └───────────────────────────────────►

Nothing starts without the driver's `arm`. What `step` wants done it gives back as acts: marks for the log,
which are asked of the daemon, and answered by `Marked`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.random import default_rng
from numpy.typing import NDArray

from tilth.client.experiment import conditions
from tilth.client.experiment.conditions import Condition
from tilth.client.experiment.following import disturbed, followed, off_the_bar
from tilth.client.experiment.sight import (
    FieldPlace,
    Seen,
    abort_reason,
    corner_of,
    in_plane,
    place_of,
)
from tilth.estimator.models.parameters import Rig
from tilth.estimator.models.planned_run import DT, Scheduled, Way, check, drives, way
from tilth.schemas.experiment import ExperimentPlan, Outcome, Phase
from tilth.schemas.notices import Notice, NoticeCode, in_words, notice
from tilth.schemas.sentences import notice_sentence

Array = NDArray[np.float64]

IDLE, LINING_UP, COUNTDOWN, RUNNING, NOTING, FINISHED = Phase
ARM, STOP, SKIP = "arm", "stop", "skip"
ORDERS: Final = (ARM, STOP, SKIP)
LEAD_S: Final = 1.0  # straight, marked, before the planned run: a filter settles
SILENT_S: Final = 1.0  # without a pose
MARK_S: Final = 12.0  # a disk may stall; longer than that a mark is lost
START_MARK_S: Final = 6.0  # nobody is to steer for long while the start is not in the log
KEPT_S: Final = 3.0  # of the driving, before a run
SLACK_M: Final = 2.0  # of the room kept free, that may go in a countdown: the heading is not held exactly


@dataclass(frozen=True, slots=True)
class PlannedDrive:
    """One run of the plan, ready to be driven. angles: rad, planned_run.DT apart."""

    scheduled: Scheduled
    angles: Array
    way: Way

    @property
    def seconds(self) -> float:
        """From the start mark to the end mark."""
        return LEAD_S + (len(self.angles) - 1) * DT


@dataclass(frozen=True, slots=True)
class Course:
    """What does not change while a plan is driven."""

    plan: ExperimentPlan
    drives: tuple[PlannedDrive, ...]


class Attempt(NamedTuple):
    """What became of one try, and why it is not done."""

    name: str
    outcome: Outcome
    why: Notice | None


@dataclass(frozen=True, slots=True)
class Prompt:
    """Where a plan stands."""

    phase: Phase = IDLE
    at: int = 0  # which drive
    tries: int = 1  # of this one, with the present
    since_s: float = 0.0  # when the phase began, s of the poses' clock
    now_s: float = -math.inf
    track: tuple[Seen, ...] = ()  # lately; in a run, all of it
    place: FieldPlace | None = None
    armed: Seen | None = None  # where the run was armed
    off_s: float = 0.0  # how long the wheels have been off the bar
    attempts: tuple[Attempt, ...] = ()
    said: str = ""  # the last thing to tell the driver
    recorded: bool = False  # the start mark is in the log


class Mark(NamedTuple):
    """An act: ask for a note in the log."""

    text: str


class Tick(NamedTuple):
    """Time goes on. now_s: of the poses' clock."""

    now_s: float


class Order(NamedTuple):
    """The driver's."""

    kind: str


class Marked(NamedTuple):
    """What became of a mark: in the log if refusal is ""."""

    text: str
    refusal: str


class Anew(NamedTuple):
    """Poses begin again: nothing goes on from those before, not even their clock. why: in words."""

    why: str


class Leave(NamedTuple):
    """The prompter is ended, whatever is under way."""


Input = Seen | Tick | Order | Marked | Anew | Leave


def course_of(plan: ExperimentPlan, rig: Rig) -> Course:
    """A plan, ready to be driven. Raises PlanError where a run is too hard or has no room."""
    planned = drives(plan, default_rng)
    check(plan, rig, planned)
    return Course(
        plan, tuple(PlannedDrive(one, angles, way(rig, one.run.speed, angles)) for one, angles in planned)
    )


def step(prompt: Prompt, course: Course, came: Input) -> tuple[Prompt, tuple[Mark, ...]]:
    """What follows from what came."""
    match came:
        case Seen():
            return _see(replace(prompt, now_s=max(prompt.now_s, came.t_s)), course, came)
        case Tick():
            return _tick(replace(prompt, now_s=max(prompt.now_s, came.now_s)), course)
        case Order():
            return _order(prompt, course, came.kind)
        case Marked():
            return _marked(prompt, course, came)
        case Anew():
            return _anew(prompt, course, came.why)
        case Leave():
            return _leave(prompt, course)


def drive_at(prompt: Prompt, course: Course) -> PlannedDrive | None:
    """The run that is due; None once all are done."""
    return course.drives[prompt.at] if prompt.at < len(course.drives) else None


def name_of(prompt: Prompt, course: Course) -> str:
    """What the marks of this try begin with: a name of its own among all."""
    one = course.drives[prompt.at].scheduled
    plan = course.plan
    return (
        f"experiment {plan.name} run {one.number} {one.run.kind} replicate {one.replicate} of "
        f"{one.run.replicates} try {prompt.tries} seed {plan.seed}"
    )


def run_s(prompt: Prompt) -> float:
    """s since the planned run began, at its straight beginning: LEAD_S after the start mark."""
    return prompt.now_s - prompt.since_s - LEAD_S


def conditions_of(prompt: Prompt, course: Course) -> tuple[Condition, ...]:
    """What must be so for a run to begin."""
    drive = drive_at(prompt, course)
    if drive is None:
        return ()
    run = drive.scheduled.run
    slack = SLACK_M if prompt.phase == COUNTDOWN else 0.0
    return conditions.of(prompt.track, prompt.now_s, run, drive.way, course.plan, prompt.place, slack)


def _see(prompt: Prompt, course: Course, seen: Seen) -> tuple[Prompt, tuple[Mark, ...]]:
    if prompt.track and seen.t_s <= prompt.track[-1].t_s:
        return prompt, ()
    kept = prompt.track
    if prompt.phase != RUNNING:
        kept = tuple(one for one in kept if seen.t_s - one.t_s <= KEPT_S)
    place = in_plane(prompt.place, seen.origin_deg) if prompt.place is not None else None
    if place is None and course.plan.field.corner is not None and not seen.trouble:
        place = place_of(course.plan.field, seen)
    prompt = replace(prompt, track=(*kept, seen), place=place)
    if prompt.phase == RUNNING:
        return _while_running(prompt, course, seen)
    return _lined_up(prompt, course)


def _tick(prompt: Prompt, course: Course) -> tuple[Prompt, tuple[Mark, ...]]:
    silent_s = prompt.now_s - prompt.track[-1].t_s if prompt.track else 0.0
    if prompt.phase == RUNNING and silent_s > SILENT_S:
        return _end(prompt, course, Outcome.ABORTED, notice(NoticeCode.NO_POSE_FOR, silence_s=silent_s))
    if prompt.phase == RUNNING and not prompt.recorded and prompt.now_s - prompt.since_s > START_MARK_S:
        return _end(prompt, course, Outcome.ABORTED, notice(NoticeCode.START_NOT_CONFIRMED))
    if prompt.phase == NOTING and prompt.now_s - prompt.since_s > MARK_S:
        return _end(prompt, course, Outcome.DISTURBED, notice(NoticeCode.END_NOT_CONFIRMED))
    if prompt.phase == RUNNING and run_s(prompt) + LEAD_S > _length(prompt, course):
        return _complete(prompt, course)
    if prompt.phase in (LINING_UP, COUNTDOWN):
        return _lined_up(prompt, course)
    return prompt, ()


def _length(prompt: Prompt, course: Course) -> float:
    return course.drives[prompt.at].seconds


def _order(prompt: Prompt, course: Course, kind: str) -> tuple[Prompt, tuple[Mark, ...]]:
    if prompt.phase == FINISHED:
        return prompt, ()
    if kind == ARM and prompt.phase == IDLE:
        said = "Line up: drive straight at the speed shown."
        armed = prompt.track[-1] if prompt.track else None
        lining_up = replace(prompt, phase=LINING_UP, since_s=prompt.now_s, said=said, armed=armed)
        return _begin_field(lining_up, course)
    if kind == STOP and prompt.phase == RUNNING:
        return _end(prompt, course, Outcome.ABORTED, notice(NoticeCode.STOPPED))
    if kind == STOP and prompt.phase in (LINING_UP, COUNTDOWN):
        said = "Stopped. Arm it when you are ready."
        return replace(prompt, phase=IDLE, since_s=prompt.now_s, said=said), ()
    if kind == SKIP and prompt.phase in (IDLE, LINING_UP, COUNTDOWN):
        return _skip(prompt, course)
    if kind == SKIP and prompt.phase == RUNNING:
        return replace(prompt, said="Follow the bar. To skip this run, stop it first."), ()
    return prompt, ()


def _marked(prompt: Prompt, course: Course, marked: Marked) -> tuple[Prompt, tuple[Mark, ...]]:
    name = name_of(prompt, course) if prompt.at < len(course.drives) else ""
    if prompt.phase == RUNNING and marked.text == f"{name} start":
        if marked.refusal:
            return _end(prompt, course, Outcome.ABORTED, notice(NoticeCode.START_REFUSED, why=marked.refusal))
        return replace(prompt, recorded=True), ()
    if prompt.phase == NOTING and marked.text == f"{name} end":
        if marked.refusal:
            return _end(prompt, course, Outcome.DISTURBED, notice(NoticeCode.END_REFUSED, why=marked.refusal))
        return _next(prompt, course, Outcome.DONE, None), ()
    return prompt, ()


def _anew(prompt: Prompt, course: Course, why: str) -> tuple[Prompt, tuple[Mark, ...]]:
    """The run under way is lost; its note, and that the plan goes on, are for the log that is written now."""
    if prompt.phase == FINISHED:
        return prompt, ()
    marks = [Mark(f"experiment {course.plan.name} seed {course.plan.seed} goes on: {why}")]
    if prompt.phase in (RUNNING, NOTING):
        prompt, ended = _end(prompt, course, Outcome.ABORTED, in_words(why))
        marks += ended
    else:
        said = f"{why[0].upper()}{why[1:]}. The plan goes on: arm the run when you are ready."
        prompt = replace(prompt, phase=IDLE, said=said)
    return replace(prompt, track=(), now_s=-math.inf), tuple(marks)


def _leave(prompt: Prompt, course: Course) -> tuple[Prompt, tuple[Mark, ...]]:
    """The run under way is not done: whoever goes on drives it again."""
    if prompt.phase == FINISHED:
        return prompt, ()
    marks: tuple[Mark, ...] = ()
    if prompt.phase == RUNNING:
        prompt, marks = _end(prompt, course, Outcome.ABORTED, notice(NoticeCode.PROMPTER_ENDED))
    elif prompt.phase == NOTING:
        early = notice(NoticeCode.PROMPTER_ENDED_EARLY)
        prompt, marks = _end(prompt, course, Outcome.DISTURBED, early)
    return replace(prompt, said="The prompter was ended."), marks


def _lined_up(prompt: Prompt, course: Course) -> tuple[Prompt, tuple[Mark, ...]]:
    """Armed: wait until all is as it should be, count down, begin."""
    if prompt.phase not in (LINING_UP, COUNTDOWN):
        return prompt, ()
    prompt, marks = _begin_field(prompt, course)
    open_ones = [one for one in conditions_of(prompt, course) if not one.met]
    if prompt.phase == LINING_UP and not open_ones:
        return replace(prompt, phase=COUNTDOWN, since_s=prompt.now_s, said="Ready: keep straight."), marks
    if prompt.phase == COUNTDOWN and open_ones:
        said = f"Countdown stopped: {open_ones[0].text}."
        return replace(prompt, phase=LINING_UP, since_s=prompt.now_s, said=said), marks
    if prompt.phase == COUNTDOWN and prompt.now_s - prompt.since_s >= course.plan.countdown_s:
        started = replace(
            prompt, phase=RUNNING, since_s=prompt.now_s, track=prompt.track[-1:], off_s=0.0, recorded=False,
            said="Follow the bar.",
        )  # fmt: skip
        return started, (*marks, Mark(f"{name_of(prompt, course)} start"))
    return prompt, marks


def _begin_field(prompt: Prompt, course: Course) -> tuple[Prompt, tuple[Mark, ...]]:
    """An armed run is where the field begins, if that is not known yet: beside where it was armed, in the way
    that is driven once it is straight, since a driver may arm it in a turn. It is noted: a prompter that was
    killed tells nobody."""
    if prompt.place is not None or not prompt.track or prompt.track[-1].trouble:
        return prompt, ()
    if not conditions.drives_straight(prompt.track):
        return prompt, ()
    place = place_of(course.plan.field, _beside(prompt.track[-1], prompt.armed))
    told = f"experiment {course.plan.name} seed {course.plan.seed} field corner {corner_of(place).text}"
    return replace(prompt, place=place), (Mark(told),)


def _beside(seen: Seen, armed: Seen | None) -> Seen:
    """On the line that is driven, as far along it as where the run was armed."""
    if armed is None or armed.origin_deg != seen.origin_deg:
        return seen
    cosine, sine = math.cos(seen.heading), math.sin(seen.heading)
    back = (armed.north - seen.north) * cosine + (armed.east - seen.east) * sine
    if not math.isfinite(back):
        return seen
    return seen._replace(north=seen.north + back * cosine, east=seen.east + back * sine)


def _while_running(prompt: Prompt, course: Course, seen: Seen) -> tuple[Prompt, tuple[Mark, ...]]:
    plan, drive = course.plan, course.drives[prompt.at]
    recent = tuple(one for one in prompt.track if seen.t_s - one.t_s <= KEPT_S)
    why = abort_reason(plan.limits, plan.field, prompt.place, recent)
    why = why or conditions.speed_fault(seen.speed, drive.scheduled.run.speed)
    if why is not None:
        return _end(prompt, course, Outcome.ABORTED, why)
    t_s = seen.t_s - prompt.since_s - LEAD_S
    off = off_the_bar(drive.angles, t_s, seen.wheel_angle)
    off_s = 0.0
    if off > math.radians(plan.limits.off_the_bar_deg):
        off_s = prompt.off_s + seen.t_s - prompt.track[-2].t_s
    prompt = replace(prompt, off_s=off_s)
    if off_s > plan.limits.off_the_bar_s:
        away = notice(NoticeCode.OFF_THE_BAR, off_deg=math.degrees(off), off_s=off_s)
        return _end(prompt, course, Outcome.DISTURBED, away)
    if t_s + LEAD_S > drive.seconds:
        return _complete(prompt, course)
    return prompt, ()


def _complete(prompt: Prompt, course: Course) -> tuple[Prompt, tuple[Mark, ...]]:
    """The run has ended by itself: was it followed, and is its beginning in the log?"""
    drive = course.drives[prompt.at]
    t_s = np.array([one.t_s for one in prompt.track]) - prompt.since_s - LEAD_S
    why = disturbed(followed(drive.angles, t_s, np.array([one.wheel_angle for one in prompt.track])))
    if why is None and not prompt.recorded:
        why = notice(NoticeCode.START_NOT_CONFIRMED)
    if why is not None:
        return _end(prompt, course, Outcome.DISTURBED, why)
    noting = replace(prompt, phase=NOTING, since_s=prompt.now_s, said="Done: the mark is written.")
    return noting, (Mark(f"{name_of(prompt, course)} end"),)


def _end(prompt: Prompt, course: Course, outcome: Outcome, why: Notice) -> tuple[Prompt, tuple[Mark, ...]]:
    """Not done: it is said why, noted, and driven again once the driver arms it."""
    name, reason = name_of(prompt, course), notice_sentence(why)
    attempt = Attempt(name, outcome, why)
    word = "Broken off" if outcome is Outcome.ABORTED else "Disturbed"
    again = replace(
        prompt, phase=IDLE, since_s=prompt.now_s, tries=prompt.tries + 1,
        attempts=(*prompt.attempts, attempt),
        said=f"{word}: {reason}. It will be driven again: arm it when you are ready.",
    )  # fmt: skip
    return again, (Mark(f"{name} {outcome} ({reason})"),)


def _skip(prompt: Prompt, course: Course) -> tuple[Prompt, tuple[Mark, ...]]:
    """Left out, which is noted."""
    why = notice(NoticeCode.BY_THE_DRIVER)
    mark = Mark(f"{name_of(prompt, course)} {Outcome.SKIPPED} ({notice_sentence(why)})")
    return _next(prompt, course, Outcome.SKIPPED, why), (mark,)


def _next(prompt: Prompt, course: Course, outcome: Outcome, why: Notice | None) -> Prompt:
    attempts = (*prompt.attempts, Attempt(name_of(prompt, course), outcome, why))
    at = prompt.at + 1
    over = at == len(course.drives)
    said = f"{outcome.capitalize()}. Arm the next run when you are ready and have room ahead."
    if over:
        left_out = skipped_of(attempts, len(course.drives))
        said = f"The plan is at its end: {left_out}." if left_out else "All runs are driven."
    return replace(
        prompt, phase=FINISHED if over else IDLE, at=at, tries=1, since_s=prompt.now_s, attempts=attempts,
        said=said,
    )  # fmt: skip


def skipped_of(attempts: Sequence[Attempt], of: int) -> str:
    """How many of so many runs were skipped, in words; "" for none."""
    skipped = sum(one.outcome is Outcome.SKIPPED for one in attempts)
    return f"{skipped} of {of} runs {'was' if skipped == 1 else 'were'} skipped" if skipped else ""
