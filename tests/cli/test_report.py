"""`tilth report`: its files, its words for wrong use, its exit status."""

import json
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from asked import Answer, asked
from paths import MACHINE_FILE
from report_run import WrittenRun, write_run
from small_disk import TILTH, on_a_small_disk

pytestmark = pytest.mark.long


@pytest.fixture
def answer(capsys: pytest.CaptureFixture[str]) -> Answer:
    return asked(capsys, "report")


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_run(tmp_path_factory.mktemp("log") / "field.mcap")


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_html_json_pdf_and_figures(answer: Answer, log: Path, tmp_path: Path) -> None:
    out, figures = tmp_path / "a.html", tmp_path / "figures"
    status, told, err = answer(log, "--out", out, "--pdf", "--figures", figures, "--json")
    assert status == 0 and "wrote" in err
    assert names(tmp_path) == ["a.html", "a.json", "a.pdf", "figures"]
    assert "run1-path.svg" in names(figures) and "run1-path.pdf" in names(figures)
    content = json.loads(told, parse_constant=pytest.fail)
    assert told == (tmp_path / "a.json").read_text(encoding="utf-8")
    assert content["data"]["runs"][0]["driving"]["distance_m"] == pytest.approx(240.0)
    assert content["data"]["command"].partition("tilth report ")[2].startswith(str(log))
    assert (tmp_path / "a.pdf").read_bytes().startswith(b"%PDF")


def test_the_same_input_gives_the_same_files(
    answer: Answer, log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = []
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        monkeypatch.chdir(tmp_path / name)
        assert answer(log, "--out", "a.html", "--pdf")[0] == 0
        made.append({path.name: path.read_bytes() for path in Path().iterdir()})
    assert made[0] == made[1] and len(made[0]) == 3


def test_given_segments(answer: Answer, log: Path, tmp_path: Path) -> None:
    status, told, _ = answer(
        log, "--out", tmp_path / "a.html", "--json", "--segment", "12:30", "--segment", "1:32:39"
    )
    (run,) = json.loads(told)["data"]["runs"]
    assert status == 0 and [one["start_s"] for one in run["segments"]] == [12.0, 32.0]


def test_a_log_of_another_program_is_replayed(
    answer: Answer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Here one without any frame that the machine file knows: it gives no pose."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    foreign = tmp_path / "a.log"
    foreign.write_text("".join(f"(17000000{k:02}.000000) can0 09F8011C#A7DF521F4A624103\n" for k in range(5)))
    status, _, err = answer(foreign, "--out", tmp_path / "a.html", "--machine", MACHINE_FILE)
    assert status == 1 and "no pose could be computed" in err and "--machine" in err
    assert not (tmp_path / "a.html").exists()


def test_a_log_without_poses(answer: Answer, log: Path, tmp_path: Path) -> None:
    """Beside one that has some: that one is reported."""
    other = write_run(
        tmp_path / "other.log.mcap", WrittenRun(run="other", without_poses=True, without_estimates=True)
    )
    out = tmp_path / "a.html"
    status, _, err = answer(log, other, "--out", out)
    assert status == 1 and "other.log.mcap: no pose" in err and out.exists()


def test_a_log_that_was_cut(answer: Answer, tmp_path: Path) -> None:
    cut = write_run(tmp_path / "cut.mcap", WrittenRun(finish=False))
    status, _, err = answer(cut, "--out", tmp_path / "a.html")
    assert status == 1 and "Cut off: cut.mcap" in err
    assert "Cut off: cut.mcap" in (tmp_path / "a.html").read_text(encoding="utf-8")


def test_a_contradiction_is_said_first(answer: Answer, tmp_path: Path) -> None:
    wrong = write_run(tmp_path / "a.mcap", replace(WrittenRun(), contradicted=True))
    status, _, err = answer(wrong, "--out", tmp_path / "a.html")
    assert status == 0 and "contradict the machine file at tractor.c" in err


def test_segments_that_overlap_are_not_fitted(answer: Answer, log: Path, tmp_path: Path) -> None:
    status, _, err = answer(log, "--out", tmp_path / "a.html", "--segment", "5:30", "--segment", "10:35")
    assert status == 0 and "Nothing was fitted: the segments 5:30 and 10:35 overlap" in err


def test_marks_that_are_not_there(answer: Answer, log: Path, tmp_path: Path) -> None:
    """The report has all else, and the command with which it was made."""
    status, _, err = answer(log, "--out", tmp_path / "a.html", "--mark", "no such")
    assert status == 1 and "no marks begin and end a run that is called no such" in err
    assert "--mark 'no such'" in (tmp_path / "a.html").read_text(encoding="utf-8").replace("&#x27;", "'")


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["LOG"], "--out"),
        (["LOG", "--out", "DIR/a.txt"], "ends in .html"),
        (["LOG", "--out", "DIR/there.html"], "never overwritten"),
        (["LOG", "--out", "DIR/json.html"], "json.json: exists"),
        (["LOG", "--out", "DIR/no/a.html"], "there is no such folder"),
        (["LOG", "--out", "DIR/a.html", "--figures", "DIR"], "new or an empty folder"),
        (["LOG", "--out", "DIR/a.html", "--figures", "DIR/there.html"], "new or an empty folder"),
        (["LOG", "--out", "DIR/a.html", "--segment", "5"], "give seconds"),
        (["LOG", "--out", "DIR/a.html", "--segment", "3:1:2"], "there are 1 logs"),
        (["LOG", "--out", "DIR/a.html", "--fit", "0"], "give a number of segments or all, from 1 up"),
        (["LOG", "--out", "DIR/a.html", "--fit", "most"], "give a number of segments or all, from 1 up"),
        (["LOG", "--out", "DIR/a.html", "--segment", "500:600"], "no poses between"),
        (["LOG", "--out", "DIR/a.html", "--segment", "5:9", "--mark", "a"], "leave out --mark beside it"),
        (["DIR/none.mcap", "--out", "DIR/a.html"], "none.mcap"),
        (["DIR/there.html", "--out", "DIR/a.html"], "there.html"),
        (["LOG", "--out", "DIR/a.html", "--machine", "DIR/none.toml"], "none.toml"),
    ],
)
def test_wrong_use(answer: Answer, log: Path, tmp_path: Path, words: list[str], told: str) -> None:
    (tmp_path / "there.html").write_text("no log")
    (tmp_path / "json.json").write_text("")
    before = names(tmp_path)
    status, out, err = answer(
        *(word.replace("LOG", str(log)).replace("DIR", str(tmp_path)) for word in words)
    )
    assert status == 2 and told in err and out == ""
    assert len(err.strip().splitlines()) == 1 and "Traceback" not in err
    assert names(tmp_path) == before


def test_pdf_without_typst(
    answer: Answer, log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "typst", None)
    status, _, err = answer(log, "--out", tmp_path / "a.html", "--pdf")
    assert status == 2 and re.search(r"--pdf needs typst: (uv|pip) .*report", err) and names(tmp_path) == []


@pytest.mark.parametrize("more", [[], ["--pdf"], ["--figures", "FIGURES"]])
def test_a_full_disk(log: Path, tmp_path: Path, more: list[str]) -> None:
    """There is room for the page of 230 kB, but not for what comes after it."""
    options = [word.replace("FIGURES", str(tmp_path / "figures")) for word in more]
    made = on_a_small_disk(tmp_path, "300k", *TILTH, "report", log, "--out", tmp_path / "a.html", *options)
    assert made.status == 1 and "no space left on device; nothing was written" in made.err, made
    assert made.left == [] and "Traceback" not in made.err


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_that_may_not_be_written(answer: Answer, log: Path, tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    status, _, err = answer(log, "--out", tmp_path / "a.html")
    assert status == 2 and "you may not" in err


def test_help_needs_no_matplotlib() -> None:
    code = "import sys; from tilth.cli import main\n"
    code += "try: main(['report', '-h'])\nfinally: print('matplotlib' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.endswith("False\n")
