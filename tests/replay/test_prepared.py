"""Runs as they are opened to be played: at once, or replayed first where they hold frames only."""

from collections.abc import Callable
from pathlib import Path

import pytest
from logs import MACHINE, MACHINE_TEXT, SECONDS, some_frames, write_mcap
from recorded_run import write_run

from tilth.replay.catalogue import run_files
from tilth.replay.prepared import READING, REPLAYING, Opening
from tilth.replay.readers.log import EmptyLog, ForeignLog
from tilth.schemas.flow import Frame
from tilth.schemas.machine_toml import MachineFile
from tilth.simulator.traffic import simulate

Told = list[tuple[str, float]]


@pytest.fixture
def told() -> Told:
    return []


def teller(told: Told) -> Callable[[str, float], None]:
    return lambda text, share: told.append((text, share))


def candump(path: Path, frames: list[Frame]) -> Path:
    lines = [
        f"({row.t_ns / 1e9:.6f}) {row.bus} {row.can_id:08X}#{row.data.hex().upper()}\n" for row in frames
    ]
    path.write_text("".join(lines))
    return path


def test_a_run_with_results_is_played_as_it_is(tmp_path: Path, told: Told) -> None:
    opening = Opening(tmp_path / "kept", "a/b")
    (run,) = run_files(write_run(tmp_path, 10.0))
    opened = opening.open(run, teller(told))
    assert opened.name == run.name and opened.run.paths == run.paths
    assert opened.machine.name == MACHINE.name and opened.machine.zenoh.prefix == "a/b"
    assert {text for text, _ in told} == {READING} and not opening.kept.exists()
    opened.run.close()


def test_a_log_of_others_is_replayed_once(tmp_path: Path, told: Told) -> None:
    path = candump(tmp_path / "drive.log", list(simulate(MACHINE, 3, SECONDS)))
    (run,) = run_files([path])
    with pytest.raises(ForeignLog, match="give --machine"):
        Opening(tmp_path / "kept", "tilth").open(run, teller(told))
    opening = Opening(tmp_path / "kept", "tilth", MachineFile(MACHINE, MACHINE_TEXT))
    opened = opening.open(run, teller(told))
    assert opened.run.has_poses and opened.run.length_ns * 1e-9 == pytest.approx(SECONDS, abs=2.0)
    opened.run.close()
    shares = [share for text, share in told if text == REPLAYING]
    assert shares and shares == sorted(shares) and shares[-1] <= 1.0
    (kept,) = opening.kept.iterdir()
    assert kept == opening.prepared(run) and kept.name.startswith("drive_")
    told.clear()
    opening.open(run, teller(told)).run.close()
    assert {text for text, _ in told} == {READING}
    with path.open("a") as log:
        log.write("(1800000000.0) can0 18FF0001#00\n")
    assert opening.prepared(run) != kept  # another log, other results


def test_one_that_is_given_up_leaves_nothing(tmp_path: Path) -> None:
    path = candump(tmp_path / "drive.log", list(simulate(MACHINE, 3, SECONDS)))
    opening = Opening(tmp_path / "kept", "tilth", MachineFile(MACHINE, MACHINE_TEXT))

    def stop(text: str, share: float) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        opening.open(run_files([path])[0], stop)
    assert list(opening.kept.iterdir()) == []


def test_what_gives_no_pose_is_told(tmp_path: Path, told: Told) -> None:
    path = write_mcap(tmp_path / "other.mcap", some_frames(3000))
    (run,) = run_files([path])
    opening = Opening(tmp_path / "kept", "tilth")
    with pytest.raises(EmptyLog, match="no pose comes of it, so there is nothing to show"):
        opening.open(run, teller(told))
    assert list(opening.kept.iterdir()) == []
    with pytest.raises(ForeignLog, match="write LOG=MACHINE"):
        Opening(tmp_path / "kept", "tilth", buses=("x",)).open(run, teller(told))
