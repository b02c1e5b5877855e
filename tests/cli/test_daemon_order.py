"""A daemon that has just started is asked until it has something to say; an order is given once."""

import threading
from contextlib import closing
from pathlib import Path

import pytest
import zenoh
from loopback import rig, until

from tilth.cli import main
from tilth.logger.zenoh.sink import ZenohSink
from tilth.schemas.proto import tilth_pb2 as pb

VIRTUAL = '[[bus]]\nname = "can0"\ninterface = "virtual"\nchannel = "tilth-order"\n\n'


def test_what_is_asked_before_there_is_an_answer_is_asked_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    machine, text = rig(tmp_path, VIRTUAL)
    file = tmp_path / "m.toml"
    file.write_text(text)
    asked: list[str] = []

    def heard(query: zenoh.Query, by: str) -> None:
        asked.append(by)
        query.drop()

    statuses: list[int] = []
    asking = threading.Thread(target=lambda: statuses.append(main(["accept", "--machine", str(file)])))
    with closing(ZenohSink(machine, answers={"status": heard})) as sink:
        asking.start()
        until(lambda: len(asked) > 1 or not asking.is_alive(), lambda: asking.join(0.01))
        sink.put("/status", pb.Status().SerializeToString())
        until(lambda: not asking.is_alive(), lambda: asking.join(0.01))
    assert statuses == [0]
    assert f"Nothing of {machine.name} has been found moved." in capsys.readouterr().out


def test_an_order_is_given_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Whoever took it may have acted, also where the answer is lost."""
    machine, text = rig(tmp_path, VIRTUAL)
    file = tmp_path / "m.toml"
    file.write_text(text)
    asked: list[str] = []

    def heard(query: zenoh.Query, by: str) -> None:
        asked.append(by)
        query.drop()

    with closing(ZenohSink(machine, answers={"mark": heard})):
        assert main(["mark", "rain", "--machine", str(file)]) == 2
    assert len(asked) == 1
    assert "look into the log before asking again" in capsys.readouterr().err
