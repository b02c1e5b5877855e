"""What a full disk leaves of the files that commands write: a sentence, a status, and no half file."""

import os
import subprocess
from pathlib import Path

import pytest
from logs import MACHINE_TEXT, some_frames, write_mcap
from sampled import sampled
from small_disk import TILTH, on_a_small_disk

SCENARIOS = Path(__file__).parents[2] / "examples" / "scenarios"

WRITERS: dict[str, tuple[str, str, tuple[str, ...]]] = {  # file on the disk -> its size, words of a command
    "again.mcap": ("24k", "replay", ("LOG", "--out", "OUT")),
    "rig.svg": ("16k", "model", ("MACHINE", "--plot", "OUT")),
    "rescued.mcap": ("24k", "recover", ("LOG", "--out", "OUT")),
    "driven.log": ("64k", "simulate", ("SCENARIO", "--seconds", "2", "--out", "OUT")),
    "driven.mcap": ("64k", "simulate", ("SCENARIO", "--seconds", "2", "--out", "OUT")),
    "draft.toml": ("0", "discover", ("LOG", "--out", "OUT")),
}  # fmt: skip


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_mcap(tmp_path_factory.mktemp("log") / "log.mcap", some_frames(20_000))


@pytest.mark.parametrize("name", sampled(WRITERS, ("again.mcap", "driven.log")))
def test_a_full_disk_leaves_no_half_file(name: str, log: Path, tmp_path: Path) -> None:
    disk, machine = tmp_path / "disk", tmp_path / "machine.toml"
    disk.mkdir()
    machine.write_text(MACHINE_TEXT)
    size, command, words = WRITERS[name]
    places = {"LOG": log, "MACHINE": machine, "OUT": disk / name, "SCENARIO": SCENARIOS / "random.toml"}
    if size == "0":  # of one page, and that is taken
        size, filled = "4k", "import sys; open(sys.argv[1] + '/filler', 'wb').write(bytes(4096));"
        program = filled + " from tilth.cli import main; sys.exit(main(sys.argv[2:]))"
        before: tuple[str | Path, ...] = (TILTH[0], "-c", program, disk)
    else:
        before = TILTH
    done = on_a_small_disk(disk, size, *before, command, *(places.get(word, word) for word in words))
    assert done.status in (1, 2) and [file for file in done.left if file != "filler"] == []
    assert done.err.splitlines()[-1].startswith(f"tilth {command}: ")
    assert "no space left on device" in done.err and name in done.err and "Traceback" not in done.err


@pytest.mark.parametrize(
    "words", [("model", "MACHINE", "--json"), ("decode", "LOG"), ("verify", "LOG", "--json")]
)
def test_an_answer_that_cannot_be_written_is_said(words: tuple[str, ...], log: Path, tmp_path: Path) -> None:
    machine = tmp_path / "machine.toml"
    machine.write_text(MACHINE_TEXT)
    places = {"MACHINE": str(machine), "LOG": str(log)}
    with Path("/dev/full").open("wb") as full:
        done = subprocess.run(
            [*TILTH, *(places.get(word, word) for word in words)],
            stdout=full, stderr=subprocess.PIPE, text=True, check=False, env=os.environ,
        )  # fmt: skip
    assert done.returncode == 1
    assert done.stderr.endswith(f"tilth {words[0]}: standard output: no space left on device\n")


def test_a_replay_that_is_stopped_leaves_no_half_file(tmp_path: Path) -> None:
    """The name would say that all is in it."""
    log, out = write_mcap(tmp_path / "log.mcap", some_frames(3000)), tmp_path / "out"
    out.mkdir()
    words = ["replay", str(log), "--rate", "0.01", "--out", str(out / "again.mcap")]
    with subprocess.Popen([*TILTH, *words], stderr=subprocess.PIPE, text=True) as replay:
        while not list(out.glob(".again.mcap.*")):
            assert replay.poll() is None
        replay.terminate()
        replay.send_signal(2)
        assert replay.wait() != 0
    assert not (out / "again.mcap").exists()
