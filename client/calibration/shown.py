"""What a driver is shown of a live calibration, as the message that goes to the page and the terminal."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from tilth.estimator.calibration.receivers import rows
from tilth.estimator.calibration.stage_words import STAGE, StageProgress, happening, next_step, progress
from tilth.estimator.calibration.stages import TICK_S, StageFold
from tilth.estimator.calibration.verdict import IDENTIFIED, NOT_IDENTIFIABLE
from tilth.estimator.rig.numbers import NUMBER, RigNumber
from tilth.schemas.machine import Machine
from tilth.schemas.proto import tilth_pb2 as pb
from tilth.schemas.spread import half_alone, plus_minus

DRIVING, FINISHING, FINISHED, STOPPED = "driving", "finishing", "finished", "stopped"
ALL_DRIVEN: Final = "All stages are driven."
ENOUGH: Final = f"{ALL_DRIVEN} Every number is known as well as is wanted: finish when you like."
PHASE_TEXT: Final = {
    FINISHING: "Finished. The last estimate is made now, where this was started; there it asks before a file "
    "is changed.",
    FINISHED: "Finished. The last estimate is made: what it says stands where this was started.",
    STOPPED: "Stopped before the last estimate was made. What was driven is kept: start `tilth calibrate "
    "--live` again to go on, or compute with the logs; both commands stand where this was started.",
}
LONGEST: Final = 500  # characters of a sentence
MOST: Final = 12  # sentences
STEERED: Final = "weave"  # the stage beside which stands how the wheels follow an automatic steering


@dataclass(slots=True)
class ComputedSoFar:
    """What the estimates in the background have told. answer: of `tilth calibrate --json`, {} before;
    with `refused` and why where the drive tells nothing, else with `numbers`."""

    answer: Mapping[str, Any] = field(default_factory=dict)
    busy: bool = False
    text: str = "Nothing has been computed yet; that begins by itself after some driving."


class ParkedSenders:
    """What the stage `park` shows: who sends. In sentences that stay as they are until the next whole stage,
    for who hears or reads them line by line."""

    def __init__(self, machine: Machine) -> None:
        self._machine = machine
        self._parked = 0  # whole stages
        self._lines: list[str] = []

    def lines(self, fold: StageFold) -> list[str]:
        """One for each receiver; none before it is parked."""
        parked = int(fold.tally.parked * TICK_S / STAGE.park_s)
        if parked > self._parked:
            self._parked = parked
            self._lines = [f"{row.words}." for row in rows(fold.senders, self._machine, {})]
        return self._lines


def shown(
    machine: str, fold: StageFold, computed: ComputedSoFar, notes: Sequence[str], trouble: str, phase: str
) -> pb.CalibrationState:
    """trouble: why nothing comes, in a sentence; "" where it does."""
    far = progress(fold)
    answer = computed.answer
    state = pb.CalibrationState(
        machine=machine, phase=phase, text=PHASE_TEXT.get(phase) or _text(fold, far, computed),
        happening="" if phase in PHASE_TEXT else trouble or happening(fold),
        stages=[_stage(one, answer) for one in far],
        computing=computed.busy, computed=computed.text[:LONGEST],
        found=[str(fault["text"])[:LONGEST] for fault in answer.get("faults", ())][:MOST],
        told=[str(line)[:LONGEST] for line in answer.get("sentences", ())][:MOST],
        notes=[note[:LONGEST] for note in notes][:MOST],
    )  # fmt: skip
    if answer.get("refused"):
        state.told.append(f"No numbers yet: {answer['refused']}"[:LONGEST])
    state.left.extend(_left(row) for row in answer.get("residuals", {}).get("kinds", ()))
    state.numbers.extend(_number(row) for row in answer.get("numbers", ()))
    return state


def _text(fold: StageFold, far: Sequence[StageProgress], computed: ComputedSoFar) -> str:
    """What to do next, first what stages ask for, then what the numbers do."""
    todo = next_step(fold, far)
    if todo:
        return todo
    if computed.answer.get("good"):
        return ENOUGH
    if not computed.answer.get("numbers"):
        return f"{ALL_DRIVEN} Wait for the numbers, or go on driving: that makes them better."
    open_rows = [row for row in computed.answer["numbers"] if row["status"] != IDENTIFIED]
    if not open_rows:
        return f"{ALL_DRIVEN} Look at what the estimate says, and finish when you like."
    first = NUMBER[open_rows[0]["name"]]
    return f"{ALL_DRIVEN} For the {first.words}: {first.drive}. Or finish; it is listed what is not known."


def _stage(one: StageProgress, answer: Mapping[str, Any]) -> pb.CalibrationStage:
    stage = one.stage
    told = answer.get("steering_words", "") if stage.name == STEERED else ""
    return pb.CalibrationStage(
        name=stage.name, title=stage.title, what=stage.what, why=stage.why, share=one.far.share,
        done=one.far.done, complete=one.complete, told=str(told)[:LONGEST],
    )  # fmt: skip


def _left(row: Mapping[str, Any]) -> pb.CalibrationLeft:
    return pb.CalibrationLeft(
        words=row["words"], ratio=row["over_stated"], text=str(row["text"])[:LONGEST], more=row["more"]
    )


def _number(row: Mapping[str, Any]) -> pb.CalibrationNumber:
    number = NUMBER[row["name"]]
    change = "stays as it is"
    if row["status"] != NOT_IDENTIFIABLE:
        sd = row["sd"] / number.per_unit
        change = plus_minus(row["moved"] / number.per_unit, sd, number.unit, bare=True)
    return pb.CalibrationNumber(
        words=number.words, change=change, before=_half_width(number, row["prior_sd"]),
        now=_half_width(number, row["sd"]), wanted=_half_width(number, row["wanted_sd"]),
        status=row["status"], tell=row["tell"],
    )  # fmt: skip


def _half_width(number: RigNumber, sd: float) -> str:
    return half_alone(sd / number.per_unit, number.unit)
