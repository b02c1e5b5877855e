"""`tilth.analysis.open`: runs of every kind of log, as arrays; what is kept; what cannot be opened."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from logs import MACHINE, MACHINE_FILE, MACHINE_TEXT, some_frames, write_mcap
from recorded import MARKS, SECONDS, cut, frames, marked, recorded

import tilth.analysis
from tilth.analysis.runs.kept import cache_folder
from tilth.analysis.runs.log_file import LogFile
from tilth.analysis.runs.run import _name
from tilth.logger.machine_file import read_machine
from tilth.replay.readers.log import EmptyLog, LogError
from tilth.schemas.flow import Frame

pytestmark = pytest.mark.long


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return cache_folder()


@pytest.mark.parametrize(
    ("said", "name"),
    [("5" * 32, "rig_20261121T080000Z"), ("field 3", "field 3"), ("", "rig_20261121T080000Z")],
)
def test_a_run_that_the_daemon_numbered_is_called_as_its_files_are(said: str, name: str) -> None:
    path = Path("rig_20261121T080000Z_002.mcap")
    assert _name(path, LogFile(path, {"run": {"part": "2"}}, 0, 1, True), said) == name


def test_a_run_has_all_that_was_recorded() -> None:
    (run,) = tilth.analysis.open(recorded(3).parts)
    assert run.id == "r" and len(run.files) == 3 and run.whole and run.machine == MACHINE
    assert run.duration_s == pytest.approx(SECONDS, abs=0.5)
    assert 0.0 <= run.poses.t_s[0] < 2.0 and run.poses.t_s[-1] <= run.duration_s
    assert np.nanmax(run.poses["tractor_forward_velocity_mps"]) > 4.0
    assert run.measurements("wheel_angle").rows > 4000 and run.estimates("tracker").rows > 30
    nuisances = run.nuisances("pem")
    assert nuisances["wheel_zero"].shape == nuisances.t_s.shape and np.isfinite(
        nuisances["wheel_zero_sd"][-1]
    )
    assert "version" in run.software
    with pytest.raises(KeyError, match=r"wheel_angel: there are .*wheel_angle"):
        run.measurements("wheel_angel")
    with pytest.raises(KeyError, match="C_af: there are t_s"):
        run.poses["C_af"]


def test_parts_are_put_in_order_and_runs_stay_apart(tmp_path: Path, cache: Path) -> None:
    parts = recorded(3).parts
    other = shutil.copy(marked(), tmp_path / "other.mcap")
    runs = tilth.analysis.open([parts[2], other, parts[0], parts[1]])
    assert [len(run.files) for run in runs] == [3, 1]
    assert [file.path for file in runs[0].files] == list(parts)


def test_a_log_without_poses_is_replayed_once_and_kept(cache: Path) -> None:
    said: list[str] = []
    progress: list[tuple[int, int]] = []
    (run,) = tilth.analysis.open(marked(), say=said.append, progress=lambda *done: progress.append(done))
    assert run.sources == (marked(),) and run.files[0].path.parent == cache
    assert progress and all(0 <= done <= of for done, of in progress)
    assert any("replayed for its poses, once" in text for text in said)
    assert [str(text) for text in run.marks["text"]] == [text for _, text in MARKS]
    assert run.marks.t_s == pytest.approx([at_s for at_s, _ in MARKS], abs=0.01)
    made = run.files[0].path.stat().st_ino
    (again,) = tilth.analysis.open(marked())
    assert again.files[0].path.stat().st_ino == made
    assert not list(cache.glob("*.part"))


def test_logs_of_others_need_a_machine_file(tmp_path: Path, cache: Path) -> None:
    path = candump(tmp_path / "drive.log", list(frames())[:9000])
    with pytest.raises(LogError, match="give --machine"):
        tilth.analysis.open(path)
    (run,) = tilth.analysis.open(path, machine=(MACHINE, MACHINE_TEXT))
    assert run.id == "drive" and run.poses.rows > 20
    assert run.poses["utc_s"][0] == pytest.approx(frames()[0].t_ns * 1e-9, abs=2.0)


def test_another_machine_file_is_used_where_it_is_given(tmp_path: Path, cache: Path) -> None:
    text = MACHINE_TEXT.replace("a = 1.7", "a = 1.75")
    changed = tmp_path / "changed.toml"
    changed.write_text(text)
    (run,) = tilth.analysis.open(recorded().parts, machine=read_machine(changed))
    assert run.machine.tractor.a.value == 1.75 and run.files[0].path.parent == cache


def test_a_cut_log_is_opened_as_far_as_it_is_whole() -> None:
    (run,) = tilth.analysis.open(cut())
    assert not run.whole and 20.0 < run.duration_s < SECONDS and run.poses.rows > 100


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("empty.mcap", b"", "an empty file"),
        ("text.log", b"hello\nworld\n", "not a log of CAN frames"),
        ("frames.mcap", None, "for its poses"),
    ],
)
def test_what_cannot_be_opened_is_said(
    tmp_path: Path, cache: Path, name: str, content: bytes | None, says: str
) -> None:
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
        with pytest.raises(LogError, match=says):
            tilth.analysis.open(path)
        return
    write_mcap(path, some_frames(300))
    said: list[str] = []
    (run,) = tilth.analysis.open(path, say=said.append)
    assert run.poses.rows == 0 and any(says in text for text in said)


def test_no_log_at_all() -> None:
    with pytest.raises(EmptyLog, match="no log was given"):
        tilth.analysis.open([])


def test_an_interrupted_replay_leaves_nothing(cache: Path) -> None:
    def stop(done: int, of: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        tilth.analysis.open(marked(), progress=stop)
    assert list(cache.iterdir()) == []


def candump(path: Path, rows: list[Frame]) -> Path:
    with path.open("w") as file:
        for row in rows:
            seconds, rest = divmod(row.t_ns, 1_000_000_000)
            file.write(
                f"({seconds}.{rest // 1000:06d}) {row.bus} {row.can_id:08X}#{row.data.hex().upper()}\n"
            )
    return path


assert MACHINE_FILE.exists()
