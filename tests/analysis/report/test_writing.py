"""Files appear whole and all together, or not at all."""

from pathlib import Path
from typing import Any

import pytest

from tilth.analysis.report import writing
from tilth.analysis.report.document import DriveReport, as_json
from tilth.analysis.report.sections import report_of
from tilth.analysis.report.writing import outputs, write


@pytest.fixture
def report(facts: Any) -> DriveReport:
    return report_of({"runs": [facts], "command": ""})


@pytest.mark.long
def test_all_files(report: DriveReport, tmp_path: Path) -> None:
    written = write(report, as_json(report), tmp_path / "a.html", figures=tmp_path / "figures")
    assert written[:2] == outputs(tmp_path / "a.html", False) and all(path.exists() for path in written)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.html", "a.json", "figures"]
    assert {path.suffix for path in (tmp_path / "figures").iterdir()} == {".svg", ".pdf"}


def test_nothing_is_left_of_a_report_that_failed(
    report: DriveReport, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(figure: object) -> str:
        raise OSError(28, "No space left on device", str(tmp_path))

    monkeypatch.setattr(writing, "svg", fails)
    with pytest.raises(OSError, match="No space"):
        write(report, as_json(report), tmp_path / "a.html", figures=tmp_path / "figures")
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_appears_meanwhile_is_left_alone(report: DriveReport, tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text("mine")
    with pytest.raises(FileExistsError):
        write(report, as_json(report), tmp_path / "a.html")
    assert [path.name for path in tmp_path.iterdir()] == ["a.json"] and (
        tmp_path / "a.json"
    ).read_text() == "mine"
