"""The stages of a calibration drive for the driver: what, why, how far, and what to do next, in words.

The stages are rows; each says from the sums of stages.py how far it is. They come in the order in which they
are asked for, but may be driven in any.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from tilth.estimator.calibration.stages import SIDES, TICK_S, StageFold, StageTally, there_and_back
from tilth.estimator.tuning import tuned
from tilth.schemas.notices import NoticeCode
from tilth.schemas.sentences import notice_sentence


@dataclass(frozen=True, slots=True)
class StageTuning:
    """When a stage of a calibration drive is complete."""

    park_s: float = tuned(20.0, "s", "of standing")
    straight_m: float = tuned(150.0, "m", "each way")
    round: float = tuned(0.8, "1", "of a circle, to each side at each angle: who drives one has it")
    swings: int = tuned(6, "swings", "of weaving")
    weave_s: float = tuned(45.0, "s", "slowly, and quickly")
    long_s: float = tuned(60.0, "s", "of standing without need")
    recent_ticks: int = tuned(
        25, "ticks", "5 s: who goes on with something else is asked for what is missing"
    )


STAGE: Final = StageTuning()

ABOUT: Final = ("a little (about 10°)", "half (about 18°)", "far (about 28°)")
PACES: Final = ("slowly (8 km/h)", "quickly (16 km/h)")


class HowFar(NamedTuple):
    """Of one stage."""

    share: float  # 0 to 1
    done: str  # what was driven, in words
    todo: str  # what is missing, as an order; "" when it is complete


class Stage(NamedTuple):
    """One that a driver can follow."""

    name: str
    title: str
    what: str
    why: str
    how_far: Callable[[StageTally], HowFar]


class StageProgress(NamedTuple):
    """A stage, and how far it is."""

    stage: Stage
    far: HowFar

    @property
    def complete(self) -> bool:
        return not self.far.todo


def _whole(left: float) -> int:
    """Of what is missing: never 0."""
    return math.ceil(left)


def _parked(tally: StageTally) -> HowFar:
    stood = tally.parked * TICK_S
    left = STAGE.park_s - stood
    todo = f"Stand still for {_whole(left)} s more, with all receivers on." if left > 0.0 else ""
    return HowFar(
        min(stood / STAGE.park_s, 1.0), f"{min(int(stood), STAGE.park_s):.0f} of {STAGE.park_s:.0f} s", todo
    )


def _straight(tally: StageTally) -> HowFar:
    there, back = there_and_back(tally, STAGE.straight_m)
    share = (min(there, STAGE.straight_m) + min(back, STAGE.straight_m)) / (2 * STAGE.straight_m)
    done = f"there {there:.0f}, back {back:.0f} of {STAGE.straight_m:.0f} m"
    if there < STAGE.straight_m:
        todo = f"Drive straight, {_whole(STAGE.straight_m - there)} m more, at about 10 km/h."
    elif back < STAGE.straight_m:
        todo = f"Turn round and drive back on the same line, {_whole(STAGE.straight_m - back)} m more."
    else:
        todo = ""
    return HowFar(share, done, todo)


def _circles(tally: StageTally) -> HowFar:
    rounds = tally.rounds
    share = float(sum(min(one / STAGE.round, 1.0) for one in rounds.flat) / rounds.size)
    sides = [
        f"{side} {', '.join(f'{one:.1f}' for one in row)}"
        for side, row in zip(SIDES, rounds.tolist(), strict=True)
    ]
    done = f"rounds (wheels a little, half, far): {'; '.join(sides)}"
    for k, about in enumerate(ABOUT):
        for side, row in zip(SIDES, rounds.tolist(), strict=True):
            if row[k] < STAGE.round:
                left = max(1.0 - row[k], 0.1)
                how_much = "one round" if left > 0.9 else f"{left:.1f} of a round more"
                todo = f"Hold the wheels {about} to the {side} and drive {how_much}, at 5 km/h."
                return HowFar(share, done, todo)
    return HowFar(share, done, "")


def _folds(tally: StageTally) -> HowFar:
    done = f"{min(tally.swings, STAGE.swings)} of {STAGE.swings} swings from side to side"
    left = STAGE.swings - tally.swings
    todo = (
        f"Steer far to the left, then far to the right, some seconds each, at 6 km/h: {left} swings more."
        if left > 0
        else ""
    )
    return HowFar(min(tally.swings / STAGE.swings, 1.0), done, todo)


def _weaving(tally: StageTally) -> HowFar:
    seconds = [one * TICK_S for one in tally.weaved]
    share = sum(min(one / STAGE.weave_s, 1.0) for one in seconds) / len(seconds)
    slow, fast = (min(one, STAGE.weave_s) for one in seconds)
    done = f"slowly {slow:.0f}, quickly {fast:.0f} of {STAGE.weave_s:.0f} s"
    for one, pace in zip(seconds, PACES, strict=True):
        if one < STAGE.weave_s:
            return HowFar(
                share,
                done,
                f"Weave from side to side {pace}, never straight, {_whole(STAGE.weave_s - one)} s more.",
            )
    return HowFar(share, done, "")


STAGES: Final = (
    Stage("park", "Park", "stand still for 20 s, all receivers on",
          "shows who sends, how often, and how much each receiver jitters", _parked),
    Stage("straight", "Straight there and back", "150 m on one line, and back on the same line, 10 km/h",
          "shows which way the receivers look, where the wheels are straight, and the slope of the ground",
          _straight),
    Stage("circles", "Slow circles",
          "a round to each side with the wheels turned a little, half and far, 5 km/h",
          "shows how far the wheels really turn, and how far forward the receivers stand", _circles),
    Stage("fold", "Turns that fold the implement", "from far left to far right and back, 6 km/h",
          "shows where the hitch is, and how long the drawbar", _folds),
    Stage("weave", "Weaving", "from side to side, a minute slowly and a minute quickly",
          "shows how late the receivers are", _weaving),
)  # fmt: skip


def progress(state: StageFold) -> tuple[StageProgress, ...]:
    """Of every stage."""
    return tuple(StageProgress(stage, stage.how_far(state.tally)) for stage in STAGES)


def next_step(state: StageFold, far: Sequence[StageProgress]) -> str:
    """What to drive now: what is being driven, where it is not complete, else the first that is not; "" when
    all are."""
    recent = state.tick is not None and state.tick - state.lately_tick <= STAGE.recent_ticks
    for one in far:
        if recent and one.stage.name == state.lately and not one.complete:
            return one.far.todo
    return next((one.far.todo for one in far if not one.complete), "")


def happening(state: StageFold) -> str:
    """What the driving of this instant is good for, or why for nothing: never empty."""
    if state.tick is None:
        return "Nothing has been measured yet."
    if state.trouble is not None:
        remedy = _REMEDIES[state.trouble.code]
        return f"What is driven now does not count; {notice_sentence(state.trouble)}. {remedy}."
    stood = state.stood * TICK_S
    if stood > STAGE.long_s and state.tally.parked * TICK_S >= STAGE.park_s:
        return f"Standing for {stood:.0f} s: that tells nothing more. Drive what comes next."
    title = next((stage.title for stage in STAGES if stage.name == state.doing), "")
    if title:
        return f"This counts for: {title}."
    return "This driving counts for no stage; the numbers may learn from it all the same."


_REMEDIES: Final = {
    NoticeCode.WITHOUT_RTK: "Check the correction service, wait for it, then drive on",
    NoticeCode.NO_WHEEL_ANGLE: (
        "[wheel_angle] of the machine file fits no message; `tilth discover` lists candidates"
    ),
    NoticeCode.NOT_HEARD: (
        "Check power and plugs; or the machine file names other devices, `tilth discover` lists them"
    ),
}
