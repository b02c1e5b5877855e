"""What a driver is shown of where a plan stands, as the message that goes to the page and the terminal."""

import math
from typing import Final

from tilth.client.experiment.following import wanted_at
from tilth.client.experiment.prompter import (
    COUNTDOWN,
    IDLE,
    LEAD_S,
    LINING_UP,
    RUNNING,
    Attempt,
    Course,
    Prompt,
    conditions_of,
    drive_at,
    run_s,
)
from tilth.schemas.channels import notice_message
from tilth.schemas.experiment import Outcome
from tilth.schemas.proto import tilth_pb2 as pb
from tilth.schemas.sentences import notice_sentence

AHEAD_S: Final = 4.0  # of the bar, so that a driver sees what comes
APART_S: Final = 0.1
ATTEMPTS: Final = 60  # the last ones


def shown(prompt: Prompt, course: Course) -> pb.ExperimentState:
    """At the prompt's own time."""
    drive = drive_at(prompt, course)
    state = pb.ExperimentState(
        plan=course.plan.name, phase=prompt.phase, done=prompt.at, of=len(course.drives),
        text=prompt.said or "Arm the first run when you are ready: it starts nothing by itself.",
        t_ns=round(1e9 * max(prompt.now_s, 0.0)),
        skipped=sum(one.outcome is Outcome.SKIPPED for one in prompt.attempts),
        attempts=map(_attempt, prompt.attempts[-ATTEMPTS:]),
    )  # fmt: skip
    measured = prompt.track[-1].wheel_angle if prompt.track else math.nan
    if math.isfinite(measured):
        state.measured = measured
    if drive is None:
        return state
    run = drive.scheduled.run
    state.drive = f"{drive.scheduled.name}, {drive.seconds:g} s at {3.6 * run.speed:.1f} km/h"
    state.length_s, state.speed = drive.seconds, run.speed
    state.largest = math.radians(run.amplitude_deg)
    begins_s = _begins_s(prompt, course)
    state.wanted = wanted_at(drive.angles, begins_s) if prompt.phase == RUNNING else 0.0
    state.ahead.extend(
        wanted_at(drive.angles, begins_s + k * APART_S) for k in range(round(AHEAD_S / APART_S) + 1)
    )
    if prompt.phase == RUNNING:
        state.at_s = begins_s + LEAD_S
    if prompt.phase == COUNTDOWN:
        state.count_s = max(course.plan.countdown_s - (prompt.now_s - prompt.since_s), 0.0)
    if prompt.phase in (IDLE, LINING_UP, COUNTDOWN):
        state.conditions.extend(
            pb.ExperimentCondition(name=one.name, met=one.met, text=one.text)
            for one in conditions_of(prompt, course)
        )
    return state


def _begins_s(prompt: Prompt, course: Course) -> float:
    """Time of the planned run, s: what is wanted before it begins is straight."""
    if prompt.phase == RUNNING:
        return run_s(prompt)
    if prompt.phase == COUNTDOWN:
        return prompt.now_s - prompt.since_s - course.plan.countdown_s - LEAD_S
    return -AHEAD_S


def _attempt(one: Attempt) -> pb.ExperimentAttempt:
    shown = pb.ExperimentAttempt(name=one.name, outcome=one.outcome)
    if one.why is not None:
        shown.reason = notice_sentence(one.why)
        shown.why.CopyFrom(notice_message(one.why))
    return shown
