"""`tilth season`: what it says, and its exit status."""

import json
from pathlib import Path

import pytest
from logs import some_frames, write_mcap

from tilth.analysis.season.season import SUMMARY, TABLE
from tilth.cli import main

pytest.importorskip("pyarrow")


def test_a_season_is_told_and_nothing_is_done_twice(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = write_mcap(tmp_path / "day.mcap", some_frames(30))
    words = ["season", str(log), "--out", str(tmp_path / "out"), "--workers", "1"]
    assert main([*words, "--json"]) == 0
    told = capsys.readouterr()
    answer = json.loads(told.out)
    assert (answer["runs"], answer["computed"], answer["failed"]) == (1, 1, 0)
    assert (tmp_path / "out" / TABLE).exists() and (tmp_path / "out" / SUMMARY).exists()
    assert main(words) == 0
    again = capsys.readouterr().err
    assert "nothing to do" in again and "runs that deserve a look: 1" in again  # too short to learn from
    (tmp_path / "empty").mkdir()
    page = (tmp_path / "out" / SUMMARY).read_bytes()
    assert main(["season", str(tmp_path / "empty"), *words[2:]]) == 2  # a slip costs no season
    assert (tmp_path / "out" / SUMMARY).read_bytes() == page


def test_a_run_that_fails_is_told_by_the_exit_status(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A log of another program, without its machine file."""
    log = tmp_path / "other.log"
    log.write_text("(1700000000.000000) can0 18FEF300#0102030405060708\n")
    assert main(["season", str(log), "--out", str(tmp_path / "out"), "--workers", "1"]) == 1
    assert "--retry" in capsys.readouterr().err
    assert "give --machine" in (tmp_path / "out" / SUMMARY).read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["none.mcap", "--out", "out"], "no such file or folder"),
        (["here.mcap", "--out", "out", "--dask-tls", "a", "b", "c"], "needs --dask"),
        (["here.mcap", "--out", "here.mcap"], "is a file"),
        (["folder", "--out", "out"], "folder: no run was found"),
        (["letter.txt", "--out", "out"], "letter.txt: not a log of CAN frames"),
    ],
)
def test_wrong_use_is_one_sentence(
    words: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    write_mcap(tmp_path / "here.mcap", some_frames(9))
    (tmp_path / "folder").mkdir()
    (tmp_path / "letter.txt").write_text("Dear all,\n")
    assert main(["season", *words]) == 2
    assert said in capsys.readouterr().err
