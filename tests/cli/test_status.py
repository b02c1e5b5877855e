"""How the daemon that runs is, in words and as an exit status."""

from contextlib import closing
from pathlib import Path

import pytest
from loopback import rig

from tilth.cli import main
from tilth.logger.zenoh.sink import ZenohSink
from tilth.schemas.proto import tilth_pb2 as pb
from tilth.schemas.states import RunHealth

VIRTUAL = '[[bus]]\nname = "can0"\ninterface = "virtual"\nchannel = "tilth-status"\n\n'


@pytest.mark.parametrize(("health", "expected"), [("good", 0), ("degraded", 0), ("bad", 1)])
def test_the_exit_status_is_the_health(
    health: str, expected: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    machine, text = rig(tmp_path, VIRTUAL)
    file = tmp_path / "m.toml"
    file.write_text(text)
    assert main(["status", "--machine", str(file)]) == 2
    assert "no daemon can be reached" in capsys.readouterr().err
    problems = [] if health == RunHealth.GOOD else ["disk: full"]
    with closing(ZenohSink(machine)) as sink:
        sink.put("/status", pb.Status(health=health, problems=problems).SerializeToString())
        assert main(["status", "--machine", str(file)]) == expected
    lines = [f"{machine.name}: {health}", *(f"  {problem}" for problem in problems)]
    assert capsys.readouterr().out.splitlines() == lines
