"""A log that is still being written gives each frame once, wherever its end is at the moment."""

from pathlib import Path

import numpy as np
import pytest
from kinematic_drive import FILE, MACHINE
from paths import ROOT

from tilth.cli import main
from tilth.replay.growing import FollowedLogs, GrowingLog, opening_machine
from tilth.replay.readers.any_log import frames
from tilth.replay.readers.log import EmptyLog
from tilth.schemas.flow import Frame


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    to = tmp_path_factory.mktemp("growing") / "drive.mcap"
    scenario = ROOT / "examples" / "scenarios" / "calibration_drive.toml"
    assert main(["simulate", str(scenario), "--seconds", "8", "--out", str(to), "--machine", str(FILE)]) == 0
    return to


@pytest.mark.parametrize("seed", range(8))
def test_portions_give_what_the_whole_gives(log: Path, tmp_path: Path, seed: int) -> None:
    data, growing = log.read_bytes(), tmp_path / "growing.mcap"
    cuts = np.sort(np.random.default_rng(seed).integers(100, len(data), 12)).tolist()
    growing.write_bytes(data[: cuts[0]])
    following = GrowingLog(growing)
    found: list[Frame] = []
    for begin, end in zip(cuts, [*cuts[1:], len(data)], strict=True):
        found += following.frames()
        with growing.open("ab") as file:
            file.write(data[begin:end])
        growing = growing.rename(tmp_path / f"{end}.mcap")  # it stays open
    found += following.frames()
    assert found == list(frames(log)) and following.finished and not following.skipped
    assert list(following.frames()) == []


def test_the_machine_file_is_at_the_beginning(log: Path, tmp_path: Path) -> None:
    assert opening_machine(log) == FILE.read_text(encoding="utf-8")
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(log.read_bytes()[:60])
    assert opening_machine(cut) is None
    with pytest.raises(EmptyLog, match="nothing is in it yet"):
        FollowedLogs(MACHINE, [], {}, cut)


def test_a_log_of_before_counts_once(log: Path) -> None:
    followed = FollowedLogs(MACHINE, [log], {}, log)
    once = list(followed.measurements())
    assert once and list(followed.measurements()) == [] and followed.paths == [log]
    followed.close()
    without = FollowedLogs(MACHINE, [], {}, log)
    assert list(without.measurements()) == once
    without.close()
