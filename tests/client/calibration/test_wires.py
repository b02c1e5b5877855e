"""A calibration that is at work is left alone."""

import threading
from concurrent.futures import ThreadPoolExecutor

import pytest
import zenoh
from client_daemon import until
from loopback import PATIENCE_S
from stage import Stage

from tilth.cli import main
from tilth.client.calibration.shown import (
    DRIVING,
    FINISHED,
    FINISHING,
    STOPPED,
)
from tilth.client.calibration.wires import ENCODING
from tilth.client.link import open_session
from tilth.schemas.proto import tilth_pb2 as pb


def _statuses(session: zenoh.Session) -> list[pb.Status]:
    replies = session.get("tilth/jd7930-parker500/replay/status", timeout=PATIENCE_S)
    return [pb.Status.FromString(reply.ok.payload.to_bytes()) for reply in replies if reply.ok]


@pytest.mark.parametrize(
    ("phase", "refused"), [(DRIVING, True), (FINISHING, True), (FINISHED, False), (STOPPED, False)]
)
def test_one_that_is_at_work_is_left_alone(
    phase: str, refused: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    with Stage() as stage, open_session(stage.endpoint) as other, ThreadPoolExecutor() as pool:
        ended = threading.Event()

        def show() -> None:
            state = pb.CalibrationState(machine="jd7930-parker500", phase=phase).SerializeToString()
            while not ended.wait(0.1):
                other.put("tilth/jd7930-parker500/replay/calibration", state, encoding=ENCODING)

        showing = pool.submit(show)
        stage.order(log_file="/nowhere/daemon.mcap")
        try:
            until(lambda: any(one.log_file for one in _statuses(other)))
            assert main(["calibrate", "--live", "--connect", stage.endpoint]) == 2
        finally:
            ended.set()
            showing.result()
    said = capsys.readouterr().err
    assert ("is at work already" if refused else "/nowhere/daemon.mcap: the daemon writes this log") in said
