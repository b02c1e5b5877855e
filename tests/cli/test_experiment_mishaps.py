"""What goes wrong while `tilth experiment` runs: real processes, poses as a daemon publishes them."""

import shlex
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import zenoh
from client_daemon import until
from loopback import PATIENCE_S
from stage import Stage

from tilth.client.experiment.prompter import FINISHED, IDLE, RUNNING
from tilth.client.experiment.runner import RESTARTED
from tilth.client.link import open_session
from tilth.schemas.proto import tilth_pb2 as pb

pytestmark = pytest.mark.long


BASE = "tilth/jd7930-parker500/replay"
RATE = 4.0  # of the stage's time
PLAN = """
name = "mishaps"
machine = "jd7930-parker500"
countdown_s = 1
[field]
length = 300
width = 60
corner = [43.4995, -83.4005]
heading_deg = 0
[[run]]
kind = "steps"
speed = 2.4
amplitude_deg = 8
seconds = 6
replicates = 2
"""


class Cab:
    """A driver beside a stage: sees what is shown, follows the bar, presses what he is told to."""

    def __init__(self, plan: Path) -> None:
        self.stage = Stage(rate=RATE, run="before", log_file="/logs/before.mcap")
        self.states: list[pb.ExperimentState] = []
        self.marks: list[str] = []
        self._wheel = 0.0
        self._page = self._open()
        self.prompt(plan)

    def prompt(self, plan: Path, *words: str) -> None:
        """Start a prompter."""
        start = "import sys; from tilth.cli import main; sys.exit(main())"
        self.process = subprocess.Popen(
            [sys.executable, "-c", start, "experiment", str(plan), "--connect", self.stage.endpoint, *words],
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip

    def _open(self) -> zenoh.Session:
        page = open_session(self.stage.endpoint)
        page.declare_subscriber(
            f"{BASE}/experiment",
            lambda s: self.states.append(pb.ExperimentState.FromString(bytes(s.payload))),
        )
        page.declare_subscriber(
            f"{BASE}/event", lambda s: self.marks.append(pb.Event.FromString(bytes(s.payload)).text)
        )
        return page

    def until(self, so: Callable[[pb.ExperimentState], bool]) -> pb.ExperimentState:
        """Steers meanwhile."""

        def look() -> bool:
            if not self.states:
                return False
            now = self.states[-1]
            if now.wanted != self._wheel:
                self._wheel = now.wanted
                self.stage.order(wheel=now.wanted)
            return so(now)

        until(look)
        return self.states[-1]

    def arm(self) -> None:
        order = pb.ExperimentOrder(kind="arm").SerializeToString()
        list(self._page.get(f"{BASE}/experiment/order", payload=order, timeout=PATIENCE_S))
        self.until(lambda now: now.phase == RUNNING)

    def begin(self) -> None:
        """Arm, and drive the first third of a run."""
        self.arm()
        self.until(lambda now: now.at_s > now.length_s / 3)

    def finish(self, runs: int) -> None:
        """Arm and drive until so many are done: on a busy computer some are followed too late."""
        while self.states[-1].done < runs:
            self.arm()
            self.until(lambda now: now.phase in (IDLE, FINISHED))

    def restart(self) -> None:
        """The daemon is killed; another begins at the same port, in another log and by an earlier clock.
        What is shown meanwhile passes through the daemon too, and is not heard. It says nothing until it is
        heard here again: an event that it told before would be missed."""
        self.stage.kill()
        self.stage = Stage(self.stage.port, RATE, run="after", log_file="/logs/after.mcap", silent=True)
        until(lambda: bool(list(self._page.get(f"{BASE}/rig", timeout=1.0))))
        self.stage.order(silent=False)

    def close(self) -> None:
        self._page.close()
        if self.process.poll() is None:
            self.process.kill()
            self.process.communicate()
        self.stage.__exit__(None, None, None)


@pytest.fixture
def cab(tmp_path: Path) -> Iterator[Cab]:
    plan = tmp_path / "plan.toml"
    plan.write_text(PLAN, encoding="utf-8")
    one = Cab(plan)
    yield one
    one.close()


def test_lost_rtk_and_a_restarted_daemon_cost_a_try_each_and_no_run(cab: Cab) -> None:
    cab.until(lambda now: now.HasField("measured"))
    cab.begin()
    cab.stage.order(flag="no_rtk:tractor_rear")
    lost = cab.until(lambda now: bool(now.attempts))
    assert lost.text.startswith("Broken off: RTK is lost at tractor rear. It will be driven again")
    assert lost.at_s < lost.length_s and lost.phase == IDLE
    assert {one.name for one in lost.conditions if not one.met} == {"receivers"}
    cab.stage.order(flag="")
    cab.finish(1)
    cab.begin()
    cab.restart()
    again = cab.until(lambda now: RESTARTED in now.text.lower())
    assert again.text.endswith(("arm the run when you are ready.", "arm it when you are ready."))
    # Which of the two is noticed first, hangs on how long the new one takes to begin.
    assert any(why in again.attempts[-1].reason for why in ("no pose has come for", RESTARTED))
    cab.finish(2)
    said, complained = cab.process.communicate(timeout=PATIENCE_S)
    assert (cab.process.returncode, complained) == (0, "")
    attempts = [one for one in cab.states[-1].attempts if one.outcome != "disturbed"]
    assert [one.outcome for one in attempts] == ["aborted", "done", "aborted", "done"]
    first, second = attempts[1].name, attempts[3].name
    assert "try 1" in attempts[0].name and "try 1" not in first and "try 1" not in second
    for name in (first, second):
        assert [mark for mark in cab.marks if mark.startswith(name)] == [f"{name} start", f"{name} end"]
    aborted = [mark for mark in cab.marks if "aborted (RTK is lost at tractor rear)" in mark]
    goes_on = cab.marks.index(f"experiment mishaps seed 1 goes on: {RESTARTED}")
    assert len(aborted) == 1 and cab.marks.index(f"{second} start") > goes_on
    assert "RTK is lost" in said and "fit /logs/before.mcap /logs/after.mcap" in said


ANYWHERE = PLAN.replace(
    "corner = [43.4995, -83.4005]\nheading_deg = 0\n", ""
)  # its field begins where it is armed


@pytest.mark.parametrize("ending", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_prompter_that_is_ended_in_a_run_notes_it_and_the_next_one_goes_on_in_the_same_field(
    ending: signal.Signals, tmp_path: Path
) -> None:
    plan = tmp_path / "plan.toml"
    plan.write_text(ANYWHERE, encoding="utf-8")
    cab = Cab(plan)
    try:
        cab.until(lambda now: now.HasField("measured"))
        cab.begin()
        cab.process.send_signal(ending)
        _, complained = cab.process.communicate(timeout=PATIENCE_S)
        aborted = [
            mark for mark in cab.marks if mark.endswith("try 1 seed 1 aborted (the prompter was ended)")
        ]
        (field,) = [mark for mark in cab.marks if " field corner " in mark]
        corner = field.partition(" field corner ")[2]
        words = shlex.split(complained.splitlines()[-1].partition("to go on: ")[2])
        assert len(aborted) == 1 and cab.process.returncode == 1
        assert words[-5:] == ["--start-at", "1", "--try", "2", f"--corner={corner}"]
        cab.states.clear()
        cab.prompt(plan, *words[-5:])
        cab.until(lambda now: any(one.name == "room" for one in now.conditions))
        assert "drive to where it begins" not in cab.states[0].text
        assert not any("begin where you arm" in one.text for one in cab.states[-1].conditions)
        cab.finish(1)
    finally:
        cab.close()
    assert "run 1 steps replicate 1 of 2 try 1" not in cab.states[-1].attempts[0].name
    assert len([mark for mark in cab.marks if " field corner " in mark]) == 1
