"""The prompter: it starts nothing by itself, breaks off with a reason, and has every run driven again."""

import math
from dataclasses import replace

import numpy as np
import pytest
from paths import MACHINE_FILE, ROOT
from prompted_run import Prompted, placed

from tilth.client.experiment.following import wanted_at
from tilth.client.experiment.prompter import (
    ARM,
    COUNTDOWN,
    FINISHED,
    IDLE,
    LEAD_S,
    LINING_UP,
    NOTING,
    RUNNING,
    SILENT_S,
    SKIP,
    STOP,
    Anew,
    Attempt,
    Course,
    Input,
    Leave,
    Mark,
    Marked,
    Order,
    Prompt,
    Tick,
    conditions_of,
    course_of,
    name_of,
    step,
)
from tilth.client.experiment.shown import shown
from tilth.client.experiment.sight import FieldPlace, Seen, corner_of, in_plane
from tilth.estimator.models.parameters import TABLE_5_1
from tilth.estimator.pose.geometry import to_degrees
from tilth.schemas.experiment import Rectangle, parse_plan
from tilth.schemas.machine_toml import parse_machine
from tilth.schemas.notices import NoticeCode, notice
from tilth.schemas.sentences import notice_sentence
from tilth.simulator.drive import drive
from tilth.simulator.prompted_driver import Person
from tilth.simulator.scenario import Ground, Scenario, Soil

TEXT = (ROOT / "examples/experiments.toml").read_text(encoding="utf-8")
PLAN = parse_plan(TEXT)
COURSE = course_of(PLAN, TABLE_5_1)
POSE_S = 0.2
SPEED = 4.5
LOST_FRONT = notice(NoticeCode.RTK_LOST, mounts="tractor front")


def words_of(attempt: Attempt) -> str:
    """Why it is not done."""
    return "" if attempt.why is None else notice_sentence(attempt.why)


def seen_at(t_s: float, **changes: object) -> Seen:
    """Straight along the field at the speed wanted."""
    seen = Seen(t_s, 30.0 + 0.05 * t_s, 0.0, 0.0, 0.0, SPEED, 0.0, 1)
    return seen._replace(**changes)  # type: ignore[arg-type]


class Play:
    """Feeds a prompter with what a driver does who follows the bar exactly."""

    def __init__(self, course: Course = COURSE) -> None:
        self.course, self.t_s = course, 0.0
        self.prompt = Prompt(place=FieldPlace(0.0, -40.0, 0.0))
        self.marks: list[str] = []
        self.confirm = True
        self.refusal = ""

    def take(self, came: Input) -> None:
        before, copy = self.prompt, replace(self.prompt)
        self.prompt, acts = step(self.prompt, self.course, came)
        assert before == copy  # what was stays as it was
        for act in acts:
            assert isinstance(act, Mark)
            self.marks.append(act.text)
            if self.confirm:
                self.take(Marked(act.text, self.refusal))

    def go(self, seconds: float, **changes: object) -> None:
        for _ in range(round(seconds / POSE_S)):
            self.t_s += POSE_S
            wheel = 0.0
            if self.prompt.phase == RUNNING:
                at = self.t_s - self.prompt.since_s - LEAD_S
                wheel = wanted_at(self.course.drives[self.prompt.at].angles, at)
            self.take(seen_at(self.t_s, **({"wheel_angle": wheel} | changes)))
            self.take(Tick(self.t_s))

    def until(self, phase: str, seconds: float = 60.0) -> None:
        while self.prompt.phase != phase and seconds > 0.0:
            self.go(POSE_S)
            seconds -= POSE_S
        assert self.prompt.phase == phase

    def running(self, into_s: float = 5.0) -> "Play":
        self.go(3.0)
        self.take(Order(ARM))
        self.until(RUNNING)
        self.go(into_s)
        assert self.prompt.phase == RUNNING
        return self


def test_nothing_starts_before_the_driver_arms_it() -> None:
    play = Play()
    play.go(60.0)
    assert (play.prompt.phase, play.marks) == (IDLE, [])


def test_an_armed_run_lines_up_counts_down_runs_ends_by_itself_and_the_next_waits() -> None:
    play = Play()
    play.go(3.0)
    play.take(Order(ARM))
    play.until(COUNTDOWN)
    began_s = play.t_s
    play.until(RUNNING)
    assert play.t_s - began_s == pytest.approx(PLAN.countdown_s, abs=2 * POSE_S)
    began_s = play.t_s
    play.until(IDLE)
    assert play.t_s - began_s == pytest.approx(COURSE.drives[0].seconds, abs=2 * POSE_S)
    assert [one.outcome for one in play.prompt.attempts] == ["done"]
    assert play.prompt.at == 1
    start, end = play.marks
    assert (start.removesuffix(" start"), end.removesuffix(" end")) == (play.prompt.attempts[0].name,) * 2
    assert "experiment three-kinds run " in start and "replicate 1 of 3 try 1 seed 1" in start
    play.go(60.0)
    assert play.prompt.phase == IDLE


ABORTS = [
    ({"trouble": LOST_FRONT}, "RTK is lost"),
    ({"direction": -1, "speed": -0.5}, "backwards"),
    ({"speed": -0.5}, "backwards"),
    ({"speed": 2.0}, "braked with"),
    ({"yaw_rate": 0.7}, "to the side; the plan allows 2.5"),
    ({"wheel_angle": math.radians(16)}, "the wheels are at 16°"),
    ({"north": 399.0}, "the field ends here"),
    ({"east": 41.0}, "the field ends here"),
    ({"speed": 6.0}, "the run is driven at 16.2"),
]


@pytest.mark.parametrize(("changes", "words"), ABORTS)
def test_what_goes_wrong_breaks_a_run_off_at_once_with_its_reason_and_it_is_repeated(
    changes: dict[str, object], words: str
) -> None:
    play = Play().running()
    play.go(2 * POSE_S, **changes)
    assert play.prompt.phase == IDLE
    (attempt,) = play.prompt.attempts
    assert attempt.outcome == "aborted" and words in words_of(attempt)
    assert words in play.prompt.said and "driven again" in play.prompt.said
    assert play.marks[-1] == f"{attempt.name} aborted ({words_of(attempt)})"
    assert play.prompt.at == 0 and play.prompt.tries == 2
    play.go(10.0)
    assert play.prompt.phase == IDLE  # it waits to be armed
    play.take(Order(ARM))
    play.until(RUNNING)
    play.until(IDLE)
    assert [one.outcome for one in play.prompt.attempts] == ["aborted", "done"]
    assert "try 2" in play.prompt.attempts[1].name


def test_slowly_slower_is_no_braking_but_too_slow() -> None:
    play = Play().running()
    for k in range(40):
        play.go(POSE_S, speed=SPEED - 0.1 * k)
        if play.prompt.phase == IDLE:
            break
    assert "only" in words_of(play.prompt.attempts[0]) and "km/h" in words_of(play.prompt.attempts[0])


def test_silence_breaks_a_run_off() -> None:
    play = Play().running()
    play.take(Tick(play.t_s + SILENT_S + 0.1))
    assert "no pose has come" in words_of(play.prompt.attempts[0])


@pytest.mark.parametrize("phase", [IDLE, LINING_UP, COUNTDOWN, RUNNING, NOTING, FINISHED])
def test_when_poses_begin_anew_the_run_is_lost_and_the_plan_goes_on(phase: str) -> None:
    """In another plane, by an earlier clock."""
    play = Play()
    play.go(3.0)
    if phase == FINISHED:
        for _ in COURSE.drives:
            play.take(Order(SKIP))
    elif phase != IDLE:
        play.take(Order(ARM))
        play.until(RUNNING if phase == NOTING else phase)
        play.confirm = phase != NOTING
        play.until(phase)
    before, place = play.prompt, play.prompt.place
    play.take(Anew("the daemon is another"))
    if phase == FINISHED:
        assert play.prompt is before
        return
    assert play.prompt.phase == IDLE and "he daemon is another. " in play.prompt.said
    lost = phase in (RUNNING, NOTING)
    assert [one.outcome for one in play.prompt.attempts] == ["aborted"] * lost
    assert play.marks[-1 - lost] == "experiment three-kinds seed 1 goes on: the daemon is another"
    assert not [one for one in conditions_of(play.prompt, COURSE) if one.met]
    play.t_s, play.confirm = -5000.0, True
    away = to_degrees((0.0, 0.0), 30.0, 0.0)
    for _ in range(15):
        play.go(POSE_S, origin_deg=away, north=5.0)
    assert play.prompt.now_s < 0.0 and place is not None
    assert play.prompt.place == in_plane(place, away)
    play.take(Order(ARM))
    while play.prompt.phase not in (RUNNING, IDLE):
        play.go(POSE_S, origin_deg=away, north=5.0)
    while play.prompt.phase != IDLE:
        play.go(POSE_S, origin_deg=away, north=5.0)
    assert [one.outcome for one in play.prompt.attempts] == [*["aborted"] * lost, "done"]


def test_a_driver_who_looks_away_is_told_and_drives_it_again() -> None:
    play = Play().running(3.0)
    play.go(20.0, wheel_angle=0.0)
    (attempt,) = play.prompt.attempts
    assert attempt.outcome == "disturbed"
    assert "off the bar" in words_of(attempt) or "followed only" in words_of(attempt)


def test_a_mark_that_is_refused_or_never_confirmed_counts_as_not_driven() -> None:
    play = Play()
    play.refusal = "you may not mark"
    play.go(3.0)
    play.take(Order(ARM))
    play.go(12.0)
    assert "the start is not in the log: you may not mark" in words_of(play.prompt.attempts[0])
    silent = Play()
    silent.confirm = False
    silent.running().go(5.0)
    assert "has not confirmed the mark at its start" in words_of(silent.prompt.attempts[0])
    ending = Play().running()
    ending.confirm = False
    ending.until(NOTING)
    ending.go(15.0)
    assert ending.prompt.attempts[0].outcome == "disturbed"
    assert "at its end" in words_of(ending.prompt.attempts[0])


def test_stop_and_skip_do_as_they_say() -> None:
    play = Play()
    play.go(3.0)
    play.take(Order(ARM))
    assert play.prompt.phase == LINING_UP
    play.take(Order(STOP))
    assert (play.prompt.phase, play.prompt.attempts) == (IDLE, ())
    play.running().take(Order(SKIP))
    assert play.prompt.phase == RUNNING and "stop it first" in play.prompt.said
    play.take(Order(STOP))
    assert words_of(play.prompt.attempts[0]) == "stopped by the driver"
    name = name_of(play.prompt, COURSE)
    play.take(Order(SKIP))
    assert play.prompt.attempts[1].outcome == "skipped" and play.prompt.at == 1
    assert play.marks[-1] == f"{name} skipped (by the driver)"
    assert play.prompt.said.startswith("Skipped. Arm the next run")
    for _ in COURSE.drives[1:]:
        play.take(Order(SKIP))
    assert play.prompt.phase == FINISHED
    assert play.prompt.said == "The plan is at its end: 9 of 9 runs were skipped."
    assert shown(play.prompt, COURSE).skipped == 9
    for order in (ARM, STOP, SKIP, "dance"):
        play.take(Order(order))
    assert play.prompt.phase == FINISHED
    assert shown(play.prompt, COURSE).done == len(COURSE.drives)


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("speed", {"speed": 3.0}),
        ("straight", {"yaw_rate": 0.1}),
        ("room", {"north": 330.0}),
        ("room", {"heading": math.pi / 2}),
        ("receivers", {"trouble": LOST_FRONT}),
    ],
)
def test_a_run_waits_for_each_condition_and_says_which(name: str, changes: dict[str, object]) -> None:
    play = Play()
    play.take(Order(ARM))
    play.go(10.0, **changes)
    assert play.prompt.phase == LINING_UP
    assert [one.name for one in conditions_of(play.prompt, COURSE) if not one.met] == [name]
    play.until(COUNTDOWN)
    play.go(POSE_S, **changes)
    assert play.prompt.phase == LINING_UP and "Countdown stopped" in play.prompt.said


def test_on_the_headland_it_says_how_far_to_go_on() -> None:
    play = Play()
    play.go(3.0, north=1.0)
    words = {one.name: one.text for one in conditions_of(play.prompt, COURSE)}
    assert words["room"] == "drive on for 1 m, past the headland"
    play.go(3.0, north=380.0)
    words = {one.name: one.text for one in conditions_of(play.prompt, COURSE)}
    assert "turn round, or start further back" in words["room"]


@pytest.mark.parametrize("phase", [IDLE, LINING_UP, COUNTDOWN, RUNNING, NOTING, FINISHED])
def test_a_prompter_that_is_ended_notes_the_run_under_way_as_not_done(phase: str) -> None:
    play = Play()
    if phase == FINISHED:
        for _ in COURSE.drives:
            play.take(Order(SKIP))
    elif phase != IDLE:
        play.go(3.0)
        play.take(Order(ARM))
        play.until(RUNNING if phase == NOTING else phase)
        play.confirm = phase != NOTING
        play.until(phase)
    before, name = len(play.marks), name_of(play.prompt, COURSE) if phase != FINISHED else ""
    play.take(Leave())
    ended = notice_sentence(notice(NoticeCode.PROMPTER_ENDED))
    unconfirmed = notice_sentence(notice(NoticeCode.PROMPTER_ENDED_EARLY))
    notes: dict[str, str] = {RUNNING: f"aborted ({ended})", NOTING: f"disturbed ({unconfirmed})"}
    assert play.marks[before:] == ([f"{name} {notes[phase]}"] if phase in notes else [])
    assert play.prompt.tries == 1 + (phase in notes)
    assert phase == FINISHED or play.prompt.said == "The prompter was ended."


def test_where_the_run_ends_the_bar_goes_straight() -> None:
    play = Play().running(COURSE.drives[0].seconds - LEAD_S - 1.0)
    state = shown(play.prompt, COURSE)
    left = round((state.length_s - state.at_s) / 0.1)
    assert 10 < left < 30 and any(state.ahead[:left])
    assert list(state.ahead[left + 1 :]) == [0.0] * (40 - left)
    assert f", {state.length_s:g} s at " in state.drive


def test_what_is_shown_follows_the_phase() -> None:
    play = Play()
    assert shown(play.prompt, COURSE).text.startswith("Arm the first run")
    play.go(3.0)
    play.take(Order(ARM))
    play.until(COUNTDOWN)
    state = shown(play.prompt, COURSE)
    assert 0.0 < state.count_s <= 3.0 and all(one.met for one in state.conditions)
    play.until(RUNNING)
    play.go(4.0)
    state = shown(play.prompt, COURSE)
    assert state.at_s == pytest.approx(4.0, abs=0.3)
    assert state.ahead[0] == pytest.approx(state.wanted)
    assert max(map(abs, state.ahead)) <= state.largest + 1e-9
    assert state.measured == pytest.approx(state.wanted, abs=0.03)


def test_a_field_without_a_corner_begins_where_the_first_run_is_armed() -> None:
    play = Play()
    play.prompt = Prompt()
    play.go(3.0, north=500.0, east=70.0, heading=1.0)
    assert play.prompt.place is None
    play.take(Order(ARM))
    place = play.prompt.place
    assert place is not None and place.heading == pytest.approx(1.0)
    assert play.marks == [f"experiment three-kinds seed 1 field corner {corner_of(place).text}"]
    assert corner_of(place).heading_deg == pytest.approx(math.degrees(1.0))
    across = (70.0 - place.east) * math.cos(1.0) - (500.0 - place.north) * math.sin(1.0)
    assert across == pytest.approx(PLAN.field.width / 2)


def test_a_field_begins_in_the_way_that_is_driven_though_a_run_was_armed_in_a_turn() -> None:
    """Beside where it was armed, or its end would be further ahead than the real one."""
    play = Play()
    play.prompt = Prompt()
    play.go(3.0, north=500.0, east=70.0, heading=1.0, yaw_rate=0.3)
    play.take(Order(ARM))
    play.go(1.0, north=510.0, east=60.0, heading=1.5, yaw_rate=0.3)
    assert play.prompt.place is None and not play.marks
    assert shown(play.prompt, COURSE).conditions[2].text == "drive straight"
    play.go(2.4, north=530.0, east=50.0, heading=0.0)
    place = play.prompt.place
    assert place is not None and place.heading == 0.0 and len(play.marks) == 1
    assert place.east == pytest.approx(50.0 - PLAN.field.width / 2)
    assert place.north == pytest.approx(500.0 - PLAN.field.headland)


# The simulated driver: late, not exact, looking away; a pedal and receivers that go wrong.


def prompted(seed: int, **changes: object) -> Prompted:
    machine = parse_machine(MACHINE_FILE.read_text(encoding="utf-8"))
    plan = PLAN.model_copy(update={"field": Rectangle(length=900, width=120)})  # seldom to turn round
    course = course_of(plan, TABLE_5_1)
    one = Prompted(course, TABLE_5_1, Person(looks_away=0.02), seed, **changes)  # type: ignore[arg-type]
    one.prompt = placed(one.prompt, plan)
    rough = Ground(roll_sd_deg=0.7, force_sd=0.015)
    scenario = Scenario(speed=SPEED, other_traffic=False, soil=Soil(grip=0.7, rolling=0.06), ground=rough)
    drive(machine, seed, 560.0, scenario, driven_by=lambda setting: one)
    return one


def test_all_nine_runs_get_done_by_a_driver_who_is_late_inexact_and_looks_away() -> None:
    one = prompted(1)
    assert one.finished and one.driver.looked_away > 0
    told_of = [attempt for attempt in one.prompt.attempts if attempt.outcome != "done"]
    assert all(words_of(attempt) for attempt in told_of)
    assert sum(attempt.outcome == "done" for attempt in one.prompt.attempts) == 9
    started = [text for _, text in one.marks if text.endswith(" start")]
    ended = [text for _, text in one.marks if text.endswith(" end")]
    assert len(ended) == 9 and len(started) == 9 + len(told_of) == len(set(started))
    armed = [phase for _, phase, _ in one.phases if phase == RUNNING]
    assert len(armed) == len(started)


def in_the_middle(prompt: Prompt, at: int) -> bool:
    """Of the first try of a run."""
    into_s = prompt.now_s - prompt.since_s
    return prompt.phase == RUNNING and (prompt.at, prompt.tries) == (at, 1) and 4.0 < into_s < 9.0


@pytest.mark.long
def test_brakes_lost_rtk_and_a_refused_mark_cost_a_try_and_no_run() -> None:
    fourth = COURSE.drives[4].scheduled

    def lost(now: float, prompt: Prompt, seen: Seen) -> Seen:
        lost_now = in_the_middle(prompt, 2)
        return seen._replace(trouble=notice(NoticeCode.RTK_LOST, mounts="tractor rear")) if lost_now else seen

    def pedal(now: float, prompt: Prompt, wanted: float) -> float:
        return 0.5 if in_the_middle(prompt, 0) else wanted

    def refuse(text: str) -> str:
        name = f"run {fourth.number} {fourth.run.kind} replicate {fourth.replicate} of 3 try 1"
        return "the disk is full" if name in text and text.endswith("start") else ""

    one = prompted(2, mishap=lost, pedal=pedal, refuse=refuse)
    reasons = [words_of(attempt) for attempt in one.prompt.attempts if attempt.outcome != "done"]
    assert one.finished
    for words in ("braked with", "RTK is lost at tractor rear", "the disk is full"):
        assert any(words in reason for reason in reasons), words
    assert sum(attempt.outcome == "done" for attempt in one.prompt.attempts) == 9


def test_the_same_seed_drives_the_same() -> None:
    plan = PLAN.model_copy(update={"run": PLAN.run[:1]})
    course = course_of(plan, TABLE_5_1)
    assert [one.scheduled for one in course.drives] == [
        one.scheduled for one in course_of(plan, TABLE_5_1).drives
    ]
    assert np.array_equal(course.drives[0].angles, course_of(plan, TABLE_5_1).drives[0].angles)
