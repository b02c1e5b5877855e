"""`tilth monitor LOG…`: what cannot be played is told in a sentence, with the exit status of all commands."""

import gzip
from pathlib import Path

import pytest
from logs import MACHINE_FILE, some_frames, write_mcap
from recorded_run import write_run
from stage import Monitor

from tilth.cli import main

CANDUMP = "(1700000000.000000) can0 18FF0001#1122\n"


def answer(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, str]:
    """Exit status and stderr."""
    status = main(["monitor", "--port", "0", *map(str, words)])
    out, err = capsys.readouterr()
    assert out == ""
    return status, err


@pytest.fixture(autouse=True)
def _cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    folder = tmp_path / "logs"
    folder.mkdir()
    return folder


def test_no_log(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    status, err = answer(capsys, folder / "none.mcap")
    assert status == 2 and "none.mcap: cannot be read (no such file or directory)" in err


def test_a_log_of_no_kind(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "words.bin").write_text("words\n")
    status, err = answer(capsys, folder / "words.bin")
    assert status == 2 and "not a log of CAN frames" in err and err.count("\n") == 1


def test_an_empty_folder(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    status, err = answer(capsys, folder)
    assert status == 2 and "no run is in it; name the folder that the logs are in" in err


def test_an_empty_log(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "empty.mcap").touch()
    status, err = answer(capsys, folder / "empty.mcap")
    assert status == 1 and "an empty file; no frame is in it" in err


def test_a_log_without_a_machine_file(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("one.log", "two.log"):
        (folder / name).write_text(CANDUMP)
    for what in (folder, folder / "one.log"):
        status, err = answer(capsys, what)
        assert status == 2 and "give --machine M.toml" in err and err.count("\n") == 1
    status, err = answer(capsys, folder, "--machine", folder / "none.toml")
    assert status == 2 and "none.toml" in err


def test_a_run_without_poses(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_mcap(folder / "frames.mcap", some_frames(1000))
    status, err = answer(capsys, path)
    assert status == 1 and "no pose comes of it, so there is nothing to show" in err
    packed = folder / "packed.log.gz"
    packed.write_bytes(gzip.compress(CANDUMP.encode()))
    status, err = answer(capsys, packed, "--machine", MACHINE_FILE)
    assert status == 1 and "no pose comes of it" in err


def test_a_port_that_is_taken(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (path,) = write_run(folder, 5.0)
    one = Monitor(str(path))
    status, err = answer(capsys, path, "--port", one.address.rpartition(":")[2])
    one.close()
    assert status == 2 and "give another --port or --host" in err


@pytest.mark.parametrize("words", [("--replay",), ("--config", "key.json")])
def test_options_of_a_daemon(
    folder: Path, words: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    (path,) = write_run(folder, 5.0)
    status, err = answer(capsys, path, *words)
    assert status == 2 and "leave them out where you give logs" in err


def test_a_cut_log_is_played_and_it_ends_as_it_is_meant_to(folder: Path) -> None:
    (path,) = write_run(folder, 30.0, finish=False)
    path.write_bytes(path.read_bytes()[:-500])
    one = Monitor(str(path))
    assert one.ask("/")[0] == 200
    one.close()  # with status 0
