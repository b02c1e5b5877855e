"""The demo's log, read by a reader that shares no code with ours: Rerun's, where it can be had.

.ci/run installs it into an environment of its own.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from mcap.reader import make_reader

RERUN = Path.home() / ".cache" / "tilth" / "rerun" / "bin" / "rerun"
pytestmark = [
    pytest.mark.rerun,
    pytest.mark.skipif(not RERUN.exists(), reason=f"no {RERUN}: .ci/run installs it where it can"),
]
TILTH = [sys.executable, "-c", "import sys; from tilth.cli import main; sys.exit(main())"]


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of a demo, as it comes."""
    folder = tmp_path_factory.mktemp("demo")
    demo = subprocess.run(
        [*TILTH, "demo", "--seconds", "10", "--json"], cwd=folder, capture_output=True, text=True, check=False
    )
    assert demo.returncode == 0, demo.stderr
    output = json.loads(demo.stdout)
    assert output["frames"] > 1000
    (log,) = folder.glob("**/*.mcap")
    return log


def rerun(*words: str) -> subprocess.CompletedProcess[str]:
    home = RERUN.parents[1]  # where it keeps that it is to send nothing
    environment = {**os.environ, "HOME": str(home), "XDG_CONFIG_HOME": str(home), "NO_COLOR": "1"}
    subprocess.run([RERUN, "analytics", "disable"], env=environment, capture_output=True, check=True)
    return subprocess.run([RERUN, *words], env=environment, capture_output=True, text=True, check=False)


def topics(log: Path) -> set[str]:
    with log.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    return {channel.topic for channel in summary.channels.values()}


def table(result: str) -> dict[str, str]:
    """{topic: status} of what `mcap check` says."""
    rows = [line.split() for line in result.splitlines()]
    return {words[3]: words[0] for words in rows if len(words) > 3 and words[3].startswith("/")}


@pytest.mark.parametrize("words", [(), ("--full",)])
def test_the_demos_log_is_checked(log: Path, words: tuple[str, ...]) -> None:
    checked = rerun("mcap", "check", *words, str(log))
    assert checked.returncode == 0, checked.stdout + checked.stderr
    assert table(checked.stdout) == dict.fromkeys(topics(log), "ok")


def test_the_demos_log_is_converted_with_every_topic(log: Path, tmp_path: Path) -> None:
    converted = rerun("mcap", "convert", str(log), "-o", str(tmp_path / "log.rrd"))
    assert converted.returncode == 0, converted.stderr
    assert "ERROR" not in converted.stderr
    assert (tmp_path / "log.rrd").stat().st_size > 10_000
    for topic in topics(log):
        assert f"    {topic},\n" in converted.stderr + converted.stdout


def test_a_log_without_its_end_is_recovered_and_one_without_its_head_is_not(
    log: Path, tmp_path: Path
) -> None:
    content = log.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(content[: len(content) * 2 // 3])
    assert rerun("mcap", "check", str(cut)).returncode != 0
    recovered = rerun("mcap", "check", "--recover", str(cut))
    assert recovered.returncode == 0 and set(table(recovered.stdout).values()) == {"ok"}
    cut.write_bytes(content[8:])
    assert rerun("mcap", "check", "--recover", str(cut)).returncode != 0
