"""`tilth calibrate --live` beside the daemon: processes of their own, a bus, Zenoh with keys between them."""

import shlex
import signal
import socket
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path

import pytest
import zenoh
from client_daemon import until
from field_rig import FieldRig
from live_rig import PARKED, calibrating, drive_before
from loopback import PATIENCE_S, free_port

from tilth.client.link import ENDPOINT, open_session
from tilth.deploy import keys
from tilth.estimator.calibration.stage_words import STAGE
from tilth.logger.clock import Clock
from tilth.schemas.machine_toml import parse_machine
from tilth.schemas.proto import tilth_pb2 as pb

pytestmark = pytest.mark.long


NAME = "jd7930-parker500"
BASE = f"tilth/{NAME}"


def _order(session: zenoh.Session, kind: str) -> list[str]:
    """As the page sends it: what is answered, "" where it was taken."""
    payload = pb.CalibrationOrder(kind=kind).SerializeToString()
    replies = session.get(f"{BASE}/calibration/order", payload=payload, timeout=PATIENCE_S)
    return ["" if one.err is None else one.err.payload.to_string() for one in replies]


class Page:
    """What a page hears and orders."""

    def __init__(self, key: Path | None = None, endpoint: str = ENDPOINT) -> None:
        self.session = open_session(endpoint, key)
        self.states: list[pb.CalibrationState] = []
        self.session.declare_subscriber(f"{BASE}/calibration", self._take)

    def _take(self, sample: zenoh.Sample) -> None:
        self.states.append(pb.CalibrationState.FromString(sample.payload.to_bytes()))

    def hears_the_daemon(self) -> bool:
        return any(one.ok for one in self.session.get(f"{BASE}/status", timeout=PATIENCE_S))

    def close(self) -> None:
        self.session.close()


@pytest.fixture
def key_folder(tmp_path: Path) -> Path:
    folder = tmp_path / "keys"
    now = datetime.fromtimestamp(Clock().t_ns() // 1_000_000_000, UTC)
    keys.make(folder, keys.Register(NAME, "tilth", ("127.0.0.1",), free_port(socket.SOCK_STREAM)), now)
    keys.admit(folder, [("olga", "operator"), ("page", "operator"), ("rita", "reader")], now)
    return folder


def test_who_may_order_has_it_computed_and_finished(key_folder: Path, tmp_path: Path) -> None:
    out, report = tmp_path / "calibrated.toml", tmp_path / "calibration.html"
    words = ["--config", str(key_folder / "olga.json"), "--out", str(out), "--report", str(report)]
    with (
        closing(FieldRig(tmp_path, 90.0, PARKED, key_folder / "daemon.json")) as rig,
        closing(Page(key_folder / "page.json")) as page,
        closing(Page(key_folder / "rita.json")) as reader,
    ):
        rig.start()
        drive_before(rig)
        until(page.hears_the_daemon)
        until(reader.hears_the_daemon)
        with calibrating(*words) as process:
            _ordered(page, reader, out)
            said, complained = process.communicate(timeout=PATIENCE_S)
        assert process.returncode == 0, complained
        until(lambda: page.states[-1].phase == "finished")
        assert rig.file.read_text() == rig.text
    assert "tractor's pair" in said and "written: " in complained
    assert parse_machine(out.read_text()) != rig.machine and "# calibrate 20" in out.read_text()
    assert "Is it good" in report.read_text(encoding="utf-8")


def _ordered(page: Page, reader: Page, out: Path) -> None:
    until(lambda: bool(page.states) and "The next estimate begins after" in page.states[-1].computed)
    assert page.states[-1].machine == NAME and page.states[-1].stages[0].share > 0.0
    assert _order(reader.session, "finish") == []  # without the right: nobody is asked
    assert "no order; there are compute, finish" in _order(page.session, "dance")[0]
    assert _order(page.session, "compute") == [""]
    until(lambda: page.states[-1].computing)  # so the reader's order did not end it
    until(lambda: reader.states[-1].computing)
    assert page.states[-1].phase == "driving" and not out.exists()
    assert _order(page.session, "finish") == [""]
    until(lambda: page.states[-1].phase == "finishing")


def test_it_outlives_the_daemon_and_tells_how_to_go_on_when_it_is_ended(tmp_path: Path) -> None:
    """Ended in the midst of the last estimate."""
    out, folder = tmp_path / "calibrated.toml", tmp_path / "logs"
    folder.mkdir()
    with closing(FieldRig(folder, 90.0, PARKED)) as rig:
        rig.start()
        out.write_text(rig.text)
        options = ["--out", str(out), "--bus", "can0=can0", "--yes"]
        where = ["--connect", rig.endpoint]
        with closing(Page(endpoint=rig.endpoint)) as page:
            until(page.hears_the_daemon)
            with calibrating(*options, *where) as process:
                _restarted(rig, page)
                process.send_signal(signal.SIGINT)
                _, complained = process.communicate(timeout=PATIENCE_S)
            until(lambda: page.states[-1].phase == "stopped")
            assert "start `tilth calibrate --live` again to go on" in page.states[-1].text
    assert process.returncode == 1 and out.read_text() == rig.text
    first, go_on, compute = complained.splitlines()[-3:]
    assert "nothing was changed, and what was driven is in the logs" in first
    assert go_on.endswith(shlex.join(["calibrate", "--live", *options, *where]))
    logs = [str(path) for path in sorted(folder.glob("*.mcap"))]
    assert len(logs) == 2 and compute.endswith(shlex.join(["calibrate", *logs, *options]))


def _restarted(rig: FieldRig, page: Page) -> None:
    """And finished."""
    until(lambda: bool(page.states and page.states[-1].happening == "This counts for: Park."))
    rig.kill()
    parked_s = _parked_s(page.states[-1])
    rig.start()
    until(lambda: _parked_s(page.states[-1]) > parked_s + 1.0)  # by the log of the new one
    assert not any("does not count" in note for note in page.states[-1].notes)
    assert _order(page.session, "finish") == [""]
    until(lambda: page.states[-1].phase == "finishing")


def _parked_s(state: pb.CalibrationState) -> float:
    return state.stages[0].share * STAGE.park_s
