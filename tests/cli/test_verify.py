"""A log is read whole, and what it lacks is said."""

import json
from pathlib import Path

import pytest
from logs import chunk_ends
from stored_runs import drive

from tilth.cli import main
from tilth.replay.survey import survey


def test_a_log_is_read_whole_and_what_is_missing_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    paths = drive(tmp_path / "logs", lost_rear=True)
    assert main(["verify", *map(str, paths)]) == 1
    output = capsys.readouterr().out
    for words in (
        "6000 at 1000.2/s, no gap", "tractor front", "1 gap: 1.2 s at 2026-09-21T14:13:21Z", "never heard",
        "dropped on can0: 3", "set by +5.0", "not confirmed by any receiver", "mark: stone", "clay, dry",
    ):  # fmt: skip
        assert words in output, (words, output)
    (found,) = survey(paths)
    assert found.coverage["/gnss/tractor_rear"].count == 0 and found.coverage["/can/can0"].count == 6000
    assert found.wrong == [] and found.steps_s == [pytest.approx(5.0, abs=0.1)] and found.backwards == 0
    assert main(["verify", "--json", str(paths[1]), str(paths[0])]) == 1  # the wrong way round
    fields = json.loads(capsys.readouterr().out)
    assert any("part 1 after part 2; give each once and in order" in what for what in fields[0]["wrong"])
    assert any("what was before it is not here" in what for what in fields[0]["wrong"])
    assert fields[0]["backwards"] == 1


def test_damage_and_cuts_are_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, second = drive(tmp_path / "logs")
    assert main(["verify", str(first), str(second)]) == 0
    assert "whole, nothing dropped" in capsys.readouterr().out
    content = bytearray(first.read_bytes())
    content[chunk_ends(bytes(content))[0] - 20] ^= 0xFF
    first.write_bytes(content)
    second.write_bytes(second.read_bytes()[:-100])
    assert main(["verify", str(first), str(second)]) == 1
    output = capsys.readouterr().out
    assert "_001.mcap: damaged at byte " in output and "tilth recover` finishes it" in output
    assert main(["recover", str(first), str(second)]) == 1
    assert first.read_bytes() == content
    assert main(["verify", str(second)]) == 1
    assert "part 2 comes first" in capsys.readouterr().out.splitlines()[-2]
    (tmp_path / "text.mcap").write_text("hello")
    assert main(["verify", str(tmp_path / "text.mcap")]) == 1
    assert main(["verify", str(tmp_path / "none.mcap")]) == 2
