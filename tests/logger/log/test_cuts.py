"""Cuts by the hundred: processes killed while they record, files cut at random bytes, read by two readers."""

import json
import shutil
import subprocess
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from logs import some_frames, write_mcap
from loopback import logged_frames, messages
from paths import SUPPORT

from tilth.logger.log.recovery import finish, rescue, unfinished

pytestmark = pytest.mark.cuts
KILLS, CUTS, AT_A_TIME = 104, 200, 8


@pytest.fixture(scope="module")
def killed(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[Path, int]]:
    """Folders of recordings that were killed, and how many frames had been given to each."""
    top = tmp_path_factory.mktemp("killed")
    processes = []
    for seed in range(AT_A_TIME):
        each = [str(top / str(seed)), str(seed), str(KILLS // AT_A_TIME)]
        words = [sys.executable, str(SUPPORT / "kill_load.py"), *each]
        processes.append((seed, subprocess.Popen(words, stdout=subprocess.PIPE, text=True)))
    found = []
    for seed, process in processes:
        output, _ = process.communicate()
        assert process.returncode == 0
        rows = (map(int, line.split()) for line in output.splitlines())
        found += [(top / str(seed) / f"{number:03d}", given) for number, given in rows]
    assert len(found) == KILLS
    return found


def test_killed_at_random_instants_every_file_reads_and_little_is_lost(
    killed: list[tuple[Path, int]], capsys: pytest.CaptureFixture[str]
) -> None:
    lost = []
    for folder, given in killed:
        for path in unfinished(folder):
            finish(path)
        assert unfinished(folder) == []
        numbers = [
            int.from_bytes(frame.data, "little")
            for path in sorted(folder.glob("*.mcap"))
            for frame in logged_frames(path)
        ]
        assert numbers == list(range(len(numbers)))
        lost.append((given - len(numbers)) * 0.5e-3)
    with capsys.disabled():
        sys.stdout.write(f"\n{KILLS} kills: lost at most {max(lost):.3f} s, median {np.median(lost):.3f} s\n")
    assert max(lost) < 1.0 and sum(given for _, given in killed) > KILLS * 1000


def test_cut_at_random_bytes_every_file_reads(tmp_path: Path) -> None:
    rows = some_frames(1500)
    content = write_mcap(tmp_path / "x.mcap", rows, chunk_kilobytes=4).read_bytes()
    rng = np.random.default_rng(3)
    path = tmp_path / "cut.mcap"
    for size in rng.integers(0, len(content), CUTS).tolist():
        path.write_bytes(content[:size])
        finish(path)
        frames = logged_frames(path)
        assert frames == rows[: len(frames)]


def test_another_reader_finds_the_same_in_what_was_recovered(
    killed: list[tuple[Path, int]], tmp_path: Path
) -> None:
    """The npm package @mcap/core, by the index and with its checksums."""
    if shutil.which("npm") is None:
        pytest.skip("no npm: install Node.js")
    install = ["npm", "install", "--silent", "--no-audit", "--no-fund", "@mcap/core@2", "fzstd@0.1.1"]
    done = subprocess.run(install, cwd=tmp_path, capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip(f"npm: {done.stderr[-200:]}")
    shutil.copy(SUPPORT / "second_reader.mjs", tmp_path)
    paths = [path for folder, _ in killed[::4] for path in sorted(folder.glob("*.mcap"))]
    for path in paths:
        finish(path)
    # Among them what could be read of one with a hole.
    content = bytearray(write_mcap(tmp_path / "hole.mcap", some_frames(900), finish=False).read_bytes())
    among_frames = len(content) * 9 // 10  # before them stand schemas, in which nobody looks for a hole
    content[among_frames : among_frames + 30] = bytes(30)
    (tmp_path / "hole.mcap").write_bytes(content)
    assert rescue(tmp_path / "hole.mcap", tmp_path / "rescued.mcap").unreadable_bytes > 0
    paths.append(tmp_path / "rescued.mcap")
    words = ["node", "second_reader.mjs", *map(str, paths)]
    result = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=True).stdout
    for path, line in zip(paths, result.splitlines(), strict=True):
        output = json.loads(line)
        with messages(path) as rows:
            assert output["topics"] == Counter(channel.topic for channel, _ in rows)
            assert output["said"] == len(rows)
