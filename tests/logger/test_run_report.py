"""The report of the run so far: made on request by a real `tilth report` beside a daemon that goes on."""

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path

import pytest
import zenoh
from field_rig import FieldRig
from loopback import PATIENCE_S, free_port, records_of, rig, session, udp_bus, until
from turned import turning

from tilth.cli.background import FIRST_TO_END
from tilth.logger.daemon import Daemon
from tilth.logger.display import NoDisplay
from tilth.logger.log.derived import REPORTS as FOLDER
from tilth.logger.log.recovery import finish
from tilth.logger.priority import REPORTS
from tilth.logger.run_report import BUSY
from tilth.schemas.invocation import started_as
from tilth.schemas.machine_toml import MachineFile
from tilth.schemas.proto import tilth_pb2 as pb

pytestmark = pytest.mark.long


DIES = (
    "import os, sys; print('no driving with steering was found', file=sys.stderr); os.kill(os.getpid(), {})"
)
BASE = "tilth/jd7930-parker500"


@pytest.fixture(autouse=True)
def commands(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[str]]:
    """How commands are started, here not behind this run's other tests; a test may change the words."""
    monkeypatch.setattr("tilth.logger.run_report.REPORTS", 0)
    words = [sys.executable, "-P", "-m", "tilth.cli"]
    started_as(["tilth"], words)
    yield words
    started_as(["tilth"])


@pytest.fixture
def daemon(tmp_path: Path) -> Iterator[Daemon]:
    machine, text = rig(tmp_path, udp_bus("can0", free_port()))
    with turning(Daemon(MachineFile(machine, text), tmp_path / "logs", "", NoDisplay())) as one:
        yield one


def asked(other: zenoh.Session, key: str) -> tuple[bytes, str]:
    """What is answered, and the refusal; two empty ones where nobody answers."""
    reply = next(iter(other.get(f"{BASE}/{key}", timeout=PATIENCE_S)), None)
    if reply is None:
        return b"", ""
    if reply.ok is not None:
        return reply.ok.payload.to_bytes(), ""
    assert reply.err is not None
    return b"", reply.err.payload.to_string()


def told(other: zenoh.Session) -> pb.ReportState:
    """What is said of the last report, as who comes late hears it."""
    return pb.ReportState.FromString(asked(other, "report")[0])


def ended(other: zenoh.Session) -> pb.ReportState:
    """Once it is ready or has failed. A query that found no time to be answered says nothing."""
    states: list[pb.ReportState] = []

    def over() -> bool:
        states.append(told(other))
        return states[-1].state in ("ready", "failed")

    until(over, seconds=5 * PATIENCE_S)  # it has the lowest priority, and this computer may be busy
    return states[-1]


@contextmanager
def joined(daemon: Daemon) -> Iterator[zenoh.Session]:
    assert daemon.parts.outlets.sink is not None
    with session(daemon.parts.outlets.sink.endpoints) as other:
        yield other


def test_a_report_that_cannot_be_made_says_why(daemon: Daemon, tmp_path: Path) -> None:
    with joined(daemon) as other:
        until(lambda: bool(list(other.get(f"{BASE}/report", timeout=PATIENCE_S))))
        assert told(other).state == ""
        assert asked(other, "report/file")[1] == "no report has been made in this run yet"
        begun = pb.ReportState.FromString(asked(other, "report/make")[0])
        assert begun.state == "making" and begun.began_ns > 0
        assert asked(other, "report/make")[1] == BUSY
        until(lambda: told(other).state == "failed")
        assert "no pose could be computed from it, so there is nothing to report" in told(other).text
        assert asked(other, "report/file")[1] == "no report has been made in this run yet"
        # Who asks for everything there is orders nothing.
        assert all(reply.ok for reply in other.get(f"{BASE}/**", timeout=PATIENCE_S))
        assert told(other).state == "failed"
    (path,) = (tmp_path / "logs").glob("*.mcap")
    daemon.parts.outlets.put_events()
    assert not list((tmp_path / "logs" / FOLDER).iterdir())
    until(lambda: "no report of the run so far" in str(reasons(path, tmp_path)))


def reasons(path: Path, folder: Path) -> list[str]:
    """What the log as it now is says of reports."""
    copy = folder / "copy.mcap"
    shutil.copy(path, copy)
    finish(copy)
    return [event.text for event in records_of(copy, "/event", pb.Event) if event.kind == "report"]


@pytest.mark.parametrize(
    ("words", "text"),
    [
        ([], "this program makes no reports; use `tilth report"),
        (["/nowhere/python"], "/nowhere/python: no such file or directory"),
        ([sys.executable, "-c", "import sys; sys.exit(3)"], "it ended with status 3"),
        ([sys.executable, "-c", "raise SystemExit('tilth report: no room')"], "no room"),
        (
            [sys.executable, "-c", DIES.format(9)],
            "killed, most likely since this computer has too little memory",
        ),
        (["sh", "-c", f'"{sys.executable}" -c "{DIES.format(9)}"; exit $?'], "it was killed, most likely"),
        ([sys.executable, "-c", DIES.format(15)], "it was ended by SIGTERM"),
    ],
)
def test_programs_that_make_no_report(
    daemon: Daemon, commands: list[str], words: list[str], text: str
) -> None:
    started_as(["tilth"], words)
    with joined(daemon) as other:
        refused = asked(other, "report/make")[1]
        if words:
            assert refused == ""
            until(lambda: told(other).state == "failed")
            refused = told(other).text
    assert text in refused


def test_a_folder_that_cannot_be_written_is_told(daemon: Daemon, tmp_path: Path) -> None:
    (tmp_path / "logs" / FOLDER).write_text("a file where the folder should be")
    with joined(daemon) as other:
        assert asked(other, "report/make")[1] == ""
        until(lambda: told(other).state == "failed")
        assert told(other).text.endswith(f"{FOLDER}: file exists")


def test_a_daemon_that_ends_takes_its_report_with_it(tmp_path: Path) -> None:
    machine, text = rig(tmp_path, udp_bus("can0", free_port()))
    started_as(["tilth"], [sys.executable, "-c", "import signal; signal.pause()"])
    daemon = Daemon(MachineFile(machine, text), tmp_path / "logs", "", NoDisplay())
    with turning(daemon), joined(daemon) as other:
        assert asked(other, "report/make")[1] == ""
        until(lambda: bool(children("signal.pause")))
    assert not children("signal.pause")


def children(words: str) -> list[Path]:
    """Folders in /proc of the processes that this one started with these words."""
    own = os.getpid()
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            parent = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
            if parent == own and words in (folder / "cmdline").read_text():
                found.append(folder)
    return found


def opened(endpoint: str) -> zenoh.Session:
    """A session with a daemon, once it listens."""
    found: list[zenoh.Session] = []

    def tried() -> bool:
        with suppress(zenoh.ZError):
            found.append(session([endpoint]))
        return bool(found)

    until(tried)
    return found[0]


def test_a_report_of_a_run_in_the_field_is_made_while_it_is_recorded(tmp_path: Path) -> None:
    """`tilth run` in a process of its own; the report is made behind it, its own file is sent."""
    with closing(FieldRig(tmp_path, 600.0)) as field:
        field.start()
        with opened(field.endpoint) as other:
            until(lambda: asked(other, "pose")[0] != b"")
            begun = pb.ReportState.FromString(asked(other, "report/make")[0])
            assert begun.state == "making"
            state = ended(other)
            assert state.state == "ready", state.text
            page = asked(other, "report/file")[0].decode()
            status = pb.Status.FromString(asked(other, "status")[0])
        assert status.recording and status.health != "bad"
    (made,) = (tmp_path / FOLDER).glob("*.html")
    assert state.text == made.name and page == made.read_text(encoding="utf-8")
    assert "<h1" in page and made.with_suffix(".json").exists()


def test_it_stands_behind_all_else() -> None:
    show = (
        "import os, pathlib; from tilth.cli.background import step_back; step_back(); "
        "print(os.nice(0), pathlib.Path('/proc/self/oom_score_adj').read_text())"
    )
    said = subprocess.run(
        [sys.executable, "-P", "-c", show], capture_output=True, text=True, check=True
    ).stdout
    assert said.split() == [str(REPORTS), FIRST_TO_END]
