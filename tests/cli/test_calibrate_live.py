"""`tilth calibrate --live`: wrong use, what a driver is shown, estimates in the background."""

import json
import socket
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
from calibration_shown import STANDS, computed, fold_of, shown_of
from client_daemon import until
from kinematic_drive import GUIDED, MACHINE, Plan, measurements
from paths import MACHINE_FILE
from rich.console import Console

from tilth.cli import main
from tilth.cli.calibrate_computing import EVERY_S, LEAST_S, SOON_S, BackgroundEstimates
from tilth.cli.calibrate_screen import line, panel, without_seconds
from tilth.client.calibration import shown as screen
from tilth.client.calibration.shown import (
    ALL_DRIVEN,
    FINISHED,
    FINISHING,
    STOPPED,
    ComputedSoFar,
    ParkedSenders,
)
from tilth.estimator.calibration import stages
from tilth.estimator.calibration.sought_numbers import SOUGHT
from tilth.estimator.calibration.stage_words import STAGE
from tilth.estimator.calibration.verdict import NOT_IDENTIFIABLE
from tilth.schemas.invocation import started_as

pytestmark = pytest.mark.long


DRIVES: Plan = ((LEAST_S + 20, 3.0, 0),)


def _free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--json"], "--json is for logs"),
        (["no_such.mcap"], "there is no such log"),
        (["--machine", "no_such.toml"], "no_such.toml"),
        ([], "no daemon can be reached"),
    ],
)
def test_wrong_use_is_a_sentence(words: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    at = f"tcp/127.0.0.1:{_free_port()}"
    assert main(["calibrate", "--live", "--machine", str(MACHINE_FILE), "--connect", at, *words]) == 2
    assert said in capsys.readouterr().err


def test_numbers_are_shown_as_before_and_now() -> None:
    answer = computed()
    answer["numbers"][0]["status"] = NOT_IDENTIFIABLE
    state = shown_of(fold_of(STANDS), answer)
    assert list(state.found) == ["two are exchanged"]
    assert [row.words for row in state.numbers] == [number.words for number in SOUGHT]
    assert state.numbers[0].change == "stays as it is"
    assert all("±" in row.change for row in state.numbers[1:])
    assert all(row.before.startswith("±") and row.before != row.now for row in state.numbers)


LEFT = [
    {"kind": "position", "words": "positions", "over_stated": 0.9, "more": False, "text": "as expected"},
    {"kind": "yaw_rate", "words": "turn rates", "over_stated": 2.4, "more": True, "text": "more: look at it"},
]


def test_what_is_left_and_how_the_wheels_follow_are_shown_and_read() -> None:
    words = "Steering follows its commands after 0.12 ± 0.02 s."
    state = shown_of(fold_of(STANDS), computed(residuals={"kinds": LEFT}, steering_words=words))
    assert [(one.words, one.ratio, one.more) for one in state.left] == [
        ("positions", 0.9, False),
        ("turn rates", 2.4, True),
    ]
    assert {stage.name: stage.told for stage in state.stages if stage.told} == {"weave": words}
    assert words in line(state) and "What is left of turn rates: more: look at it." in line(state)
    assert "positions" not in line(state)
    console = Console(width=120, height=60, color_system=None)
    with console.capture() as drawn:
        console.print(panel(state))
    assert words in drawn.get() and "turn rates" in drawn.get()
    assert not shown_of(fold_of(STANDS), {}).left, "none before an estimate"


@pytest.mark.parametrize("phase", [FINISHING, FINISHED, STOPPED])
def test_the_end_has_its_own_sentence(phase: str) -> None:
    state = shown_of(fold_of(STANDS), {}, phase)
    assert state.text == screen.PHASE_TEXT[phase] and ALL_DRIVEN not in state.text and not state.happening


@pytest.mark.parametrize(("width", "height"), [(80, 24), (120, 30), (60, 20)])
def test_the_panel_fits_and_the_keys_are_always_there(width: int, height: int) -> None:
    answer = computed()
    for row in answer["numbers"][::2]:
        row.update(status="rough", tell="drive slow circles to both sides, at three angles of the wheels")
    for given in (answer, {"refused": "the drive has rows only: " + "drive circles " * 20}):
        state = shown_of(fold_of(GUIDED), given)
        state.notes.extend(["a log does not count, " + "as is said here " * 10] * 3)
        console = Console(width=width, height=height, color_system=None)
        with console.capture() as drawn:
            console.print(panel(state))
        rows = drawn.get().splitlines()
        assert len(rows) <= height and "c: compute now   f: finish   q: stop" in drawn.get()
        assert given is not answer or "8 of 17 numbers are known as well as is wanted" in drawn.get()


def test_who_sends_is_said_once_the_rig_has_been_parked() -> None:
    """In sentences that do not change with each position."""
    senders, fold, made = ParkedSenders(MACHINE), stages.initial(MACHINE), measurements(((30, 0.0, 0),))
    said = list[str]()
    for measurement in made:
        stages.take(fold, measurement)
        if (now := senders.lines(fold)) and now != said:
            assert not said and fold.tally.parked * stages.TICK_S == STAGE.park_s
            said = now
    assert len(said) == 4 and said[0].startswith("tractor front: ")
    assert all("5.0 positions a second, jitter " in one and "mm at standstill, " in one for one in said)
    assert all(one.endswith("latency 100 ms by the file.") for one in said)
    assert senders.lines(stages.initial(MACHINE)) == said


def test_who_reads_lines_is_told_why_nothing_counts_and_how_the_estimate_stands() -> None:
    fold = fold_of(STANDS)
    silent = shown_of(fold, {}, trouble="Nothing of the rig has been heard for 7 s: is the bus silent?")
    assert "\n  Nothing of the rig has been heard for 7 s" in line(silent)
    assert "This counts for: Park." not in line(shown_of(fold, {})), "which changes with each bend"
    state = shown_of(fold, {})
    told = []
    for took in range(3):
        state.computed = f"Computing with 65 s of driving, for {took} s now."
        told.append(line(state))
        assert state.computed in told[-1]
    assert len({without_seconds(one) for one in told}) == 1 < len(set(told))


@pytest.fixture
def estimates() -> Iterator[BackgroundEstimates]:
    """They end with the test, also with one that fails."""
    with closing(BackgroundEstimates(["--machine", str(MACHINE_FILE)])) as them:
        yield them


def test_estimates_begin_with_driving_and_a_failure_is_a_sentence(
    estimates: BackgroundEstimates, tmp_path: Path
) -> None:
    started_as(["tilth"], [sys.executable, "-P", "-m", "tilth.cli"])  # not behind this run's other tests
    standing, driving = fold_of(STANDS), fold_of(DRIVES)
    estimates.turn(standing, [])
    assert not estimates.so_far.busy and "begins after 65 s more" in estimates.so_far.text
    missing = tmp_path / "gone.mcap"
    estimates.turn(driving, [missing])
    assert estimates.so_far.busy

    def over() -> bool:
        if estimates.so_far.busy:
            estimates.turn(driving, [missing])
        return not estimates.so_far.busy

    until(over)
    assert "The estimate failed" in estimates.so_far.text and "gone.mcap" in estimates.so_far.text
    estimates.turn(driving, [missing])
    assert not estimates.so_far.busy, "only after new driving"
    estimates.ask()
    estimates.turn(driving, [missing])
    assert estimates.so_far.busy


@pytest.mark.parametrize(
    ("answer", "more_s", "said"),
    [
        ({"refused": "rows only"}, SOON_S, "Nothing could be told yet by 65 s"),
        ({}, EVERY_S, "Computed by 65 s"),
    ],
)
def test_the_next_estimate_is_counted_down_to_and_begins(
    estimates: BackgroundEstimates, answer: dict[str, str], more_s: float, said: str
) -> None:
    """65 s are enough for the first; what told nothing is tried again soon."""
    fold = fold_of(STANDS)

    def turned(driven_s: float) -> ComputedSoFar:
        fold.tally.moving = round(driven_s / stages.TICK_S)
        estimates.turn(fold, [])
        return estimates.so_far

    started_as(["tilth"], [sys.executable, "-c", f"print({json.dumps(answer)!r})"])
    assert "begins after 1 s more" in turned(64.0).text
    assert turned(65.0).busy
    until(lambda: not turned(65.0).busy)
    assert said in estimates.so_far.text and f"after {more_s:.0f} s more" in estimates.so_far.text
    assert "after 1 s more" in turned(64.0 + more_s).text and turned(65.0 + more_s).busy


def test_an_estimate_that_was_asked_for_early_keeps_nobody_waiting(estimates: BackgroundEstimates) -> None:
    fold = fold_of(STANDS)
    started_as(["tilth"], [sys.executable, "-c", 'print(\'{"refused": "less than a minute"}\')'])
    fold.tally.moving = round(30.0 / stages.TICK_S)
    estimates.ask()
    estimates.turn(fold, [])

    def over() -> bool:
        estimates.turn(fold, [])
        return not estimates.so_far.busy

    until(over)
    assert "after 35 s more" in estimates.so_far.text
