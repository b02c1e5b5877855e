"""The router of the container: who has a key reaches the recorder behind it, also one that starts later."""

import json
import signal
import socket
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest
from loopback import PATIENCE_S, free_port, rig, udp_bus, until

from tilth.cli import main
from tilth.deploy import keys
from tilth.logger.zenoh.sink import ZenohSink
from tilth.schemas.proto import tilth_pb2 as pb

ROUTER = [sys.executable, "-m", "tilth.deploy.router"]


def test_a_key_opens_what_is_behind_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    machine, text = rig(tmp_path, udp_bus("can0", free_port()))
    (tmp_path / "machine.toml").write_text(text)
    folder, port = tmp_path / "keys", str(free_port(socket.SOCK_STREAM))
    made = [
        "keys",
        str(folder),
        "--machine",
        str(tmp_path / "machine.toml"),
        "--host",
        "127.0.0.1",
        "--router",
    ]
    assert main([*made, "--port", port, "--reader", "rita", "--operator", "olga"]) == 0
    assert "daemon.json: for the router, python -m tilth.deploy.router" in capsys.readouterr().out
    assert main(["keys", str(folder), "--revoke", "olga"]) == 0
    assert keys.read_register(folder).recorder == tuple(machine.zenoh.listen)
    tried = ["keys", "--try", str(folder / "rita.json")]
    with subprocess.Popen([*ROUTER, str(folder / "daemon.json")]) as router:
        until(lambda: "connection refused" not in _said(tried, capsys), lambda: None)
        with closing(ZenohSink(machine)) as sink:
            sink.put("/status", pb.Status().SerializeToString())
            until(lambda: main(tried) == 0, lambda: None)
        router.send_signal(signal.SIGTERM)
        assert router.wait(PATIENCE_S) == 0


def test_a_router_has_a_port_of_its_own(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _, text = rig(tmp_path, udp_bus("can0", free_port()))
    (tmp_path / "machine.toml").write_text(text.replace("listen =", 'listen = ["tcp/127.0.0.1:7448"] #'))
    made = ["keys", str(tmp_path / "keys"), "--machine", str(tmp_path / "machine.toml"), "--host", "tractor"]
    assert main([*made, "--router"]) == 2
    assert "--port 7448: the recorder listens there itself" in capsys.readouterr().err
    assert main([*made, "--router", "--port", "7449"]) == 0
    content = json.loads((tmp_path / "keys/daemon.json").read_text())
    assert content["listen"]["endpoints"] == ["tls/0.0.0.0:7449"]
    assert content["connect"]["endpoints"] == ["tcp/127.0.0.1:7448"]


@pytest.mark.parametrize("words", [[], ["broken.json"]])
def test_without_a_configuration_it_says_what_it_wants(words: list[str], tmp_path: Path) -> None:
    (tmp_path / "broken.json").write_text("{")
    done = subprocess.run([*ROUTER, *words], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 2 and "daemon.json of `tilth keys FOLDER" in done.stderr
    assert done.stderr.count("\n") == 1


def _said(words: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    main(words)
    return capsys.readouterr().out
