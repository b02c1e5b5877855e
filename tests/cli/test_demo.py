"""tilth demo from the outside."""

import json
import re
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest
import zenoh
from logs import frames_in
from loopback import PATIENCE_S, until

from tilth.cli import main

# Without asammdf, which reads files that are not needed here and takes two seconds to import.
START = "import sys; sys.modules['asammdf'] = None; from tilth.cli import main; sys.exit(main())"
COMMAND = [sys.executable, "-c", START, "demo", "--no-page"]


@pytest.mark.long
def test_ctrl_c_ends_it_with_a_whole_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = [*COMMAND, "--seconds", "600", "--json", "--log", str(tmp_path)]
    output = tmp_path / "stderr"
    with (
        output.open("w") as stderr,
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=stderr, text=True) as process,
    ):
        _wait_for_frames(process, tmp_path)
        keys: list[str] = []
        until(  # a status comes each second, and the first bytes of the log before it
            lambda: "tilth/jd7930-parker500/replay/status" in keys,
            lambda: keys.extend(_keys_published(output.read_text())),
        )
        process.send_signal(signal.SIGINT)
        out, _ = process.communicate(timeout=PATIENCE_S)
    answer = json.loads(out)
    assert process.returncode == 0, output.read_text()
    assert answer["frames_lost"] == 0
    assert 0 < answer["frames"] < 60_000
    # Under the replay prefix only: no controller takes it for a tractor.
    assert all(key.startswith("tilth/jd7930-parker500/replay/") for key in keys)
    assert main(["replay", *answer["log"], "--json"]) == 0
    replayed = json.loads(capsys.readouterr().out)
    assert replayed["frames"] == answer["frames"]
    assert not replayed["truncated"]


def _wait_for_frames(process: subprocess.Popen[str], folder: Path) -> None:
    """Until the log of a running demo holds some; fails where it ends before."""
    for _ in range(round(PATIENCE_S / 0.1)):
        if any(map(frames_in, folder.glob("*.mcap"))):
            return
        with suppress(subprocess.TimeoutExpired):
            process.wait(0.1)
            break
    process.kill()
    pytest.fail("the demo writes no log")


def _keys_published(output: str) -> list[str]:
    """Keys that a running demo answers for; `said` names its endpoint where the usual one is taken."""
    taken = re.search(r"listening on (tcp/[0-9.:]+)", output)
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([taken[1] if taken else "tcp/127.0.0.1:7447"]))
    with zenoh.open(config) as session:
        return [str(reply.ok.key_expr) for reply in session.get("tilth/**", timeout=PATIENCE_S) if reply.ok]


@pytest.mark.parametrize(
    "words",
    [
        ["--guidance", "--seconds", "5"],
        ["--fast"],
        ["--from-change", "--seconds", "5"],
        ["--seconds", "0"],
        ["--seconds", "nan"],
        ["--seed", "-1"],
        ["--second", "x"],
    ],
)
def test_wrong_use(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    try:
        status: object = main(["demo", *words])
    except SystemExit as left:
        status = left.code
    assert status == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert len(captured.err.splitlines()) == 1
