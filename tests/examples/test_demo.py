"""The demo of guidance: a loop closed over CAN and Zenoh."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import zenoh

from tilth.adaptive_guidance.__main__ import arguments
from tilth.adaptive_guidance.demo import FROM_CHANGE, run_guidance, run_lockstep, table
from tilth.adaptive_guidance.plan import Work
from tilth.adaptive_guidance.study import middle
from tilth.client.link import open_session
from tilth.logger.display import NoDisplay
from tilth.replay.readers.any_log import frames
from tilth.schemas.can_id import split
from tilth.schemas.flow import Event
from tilth.schemas.proto import tilth_pb2 as pb
from tilth.schemas.sentences import event_sentence
from tilth.simulator.steering import COMMAND


class Heard(NoDisplay):
    def __init__(self) -> None:
        self.told: list[str] = []

    def event(self, event: Event) -> None:
        self.told.append(event_sentence(event))


@pytest.mark.long
def test_the_demo_closes_the_loop_over_can_and_zenoh_and_logs_what_was_commanded(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    display, received, pages = Heard(), list[bytes](), list[zenoh.Session]()

    def watch(endpoint: str) -> None:
        pages.append(open_session(endpoint))  # as the live page has it
        pages[0].declare_subscriber(
            "tilth/*/replay/event", lambda sample: received.append(sample.payload.to_bytes())
        )

    # The usual endpoint may be taken by another test's daemon before that of the demo opens.
    listen = "tcp/127.0.0.1:0"
    # Long enough for a busy computer to open all sessions before it ends.
    guided = run_guidance(1, tmp_path, display, watch=watch, work=Work(rows=1, length=60.0), listen=listen)
    pages[0].close()
    assert "pipe" not in capfd.readouterr().err.lower()  # all processes have said their last word
    messages = [event.text for event in map(pb.Event.FromString, received) if event.kind == "guidance"]
    assert "the controller steers" in messages and set(messages) <= set(display.told)
    assert guided.commands["refused"] == {}
    assert guided.commands["commands"] >= 5  # a busy computer is late
    assert "the controller steers" in display.told
    assert np.abs(guided.adapting.error).max() < 0.3
    assert guided.figure is not None and guided.figure.exists()
    assert table(guided).row_count == 2
    (log,) = guided.summary.log_files
    read = list(frames(log))
    assert len(read) == guided.summary.recorded
    wishes = [frame for frame in read if frame.extended and split(frame.can_id).pgn == COMMAND]
    assert len(wishes) >= guided.commands["commands"]


@pytest.mark.long
def test_both_halves_are_driven_without_wires_for_a_small_computer(tmp_path: Path) -> None:
    said: list[str] = []
    work = replace(FROM_CHANGE, rows=2, length=40.0)
    guided = run_lockstep(1, tmp_path / "new", said.append, work)
    assert len(said) == 2 and guided.figure is not None and guided.figure.exists()
    for path in (guided.fixed, guided.adapting):
        assert path.after.any() and not path.after.all() and np.abs(path.error).max() < 0.5
    assert table(guided).row_count == 2


def test_the_demo_may_begin_a_row_before_the_soil_changes() -> None:
    assert middle(FROM_CHANGE) == FROM_CHANGE.spacing / 2 and middle(Work(rows=6)) == 2.5 * Work().spacing


def test_the_controller_asks_for_what_it_needs(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--machine", "rig", "--interface", "virtual", "--origin", "43.5", "-83.4"]
    given = arguments().parse_args(words)
    assert (given.origin, given.gains, given.replay) == ([43.5, -83.4], "adapting", False)
    for left_out in (0, 2, 4):
        with pytest.raises(SystemExit):
            arguments().parse_args(words[:left_out] + words[left_out + (3 if left_out == 4 else 2) :])
    assert "required" in capsys.readouterr().err
