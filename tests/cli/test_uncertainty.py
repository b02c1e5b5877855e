"""`tilth uncertainty`: its table, JSON and report, its words for wrong use, its exit status."""

import json
from pathlib import Path

import pytest
from asked import Answer, asked
from logs import MACHINE_TEXT
from paths import MACHINE_FILE
from report_run import WrittenRun, write_run
from small_disk import TILTH, on_a_small_disk

from tilth.schemas.flow import PARAMETERS

QUICK = ("--speed", "4.5", "--draws", "100")


@pytest.fixture
def answer(capsys: pytest.CaptureFixture[str]) -> Answer:
    return asked(capsys, "uncertainty")


def test_what_the_machine_file_knows(answer: Answer) -> None:
    status, out, _ = answer(MACHINE_FILE, *QUICK, "--json")
    said = json.loads(out, parse_constant=pytest.fail)
    (entry,) = said["speeds"]
    assert status == 0 and set(PARAMETERS) <= set(said["parameters"]) and said["source"] == "the machine file"
    assert entry["draws"] == 100 and 0.0 < entry["unstable_share"] < 0.3
    status, out, _ = answer(MACHINE_FILE, *QUICK)
    assert status == 0 and "off_tracking" in out and "% of the rigs drawn are unstable" in out
    told = " ".join(out.replace("│", " ").split())
    assert "Use “known to”" in told and "C_af: cornering stiffness, tractor's front axle" in told
    assert "off_tracking, how far" in told and "the first order is far off" in told


def test_what_a_log_knows_is_more(answer: Answer, tmp_path: Path) -> None:
    log = write_run(tmp_path / "a.mcap")
    words = ("--outputs", "off_tracking", *QUICK)
    machine = tmp_path / "machine.toml"
    machine.write_text(MACHINE_TEXT, encoding="utf-8")
    _, told, _ = answer(machine, "--from", log, "--json", *words)
    _, before, _ = answer(machine, "--json", *words)
    after, prior = (json.loads(text)["speeds"][0]["outputs"]["off_tracking"] for text in (told, before))
    assert 0 < after["half"] < 0.3 * prior["half"]


def test_the_report(answer: Answer, tmp_path: Path) -> None:
    out = tmp_path / "a.html"
    words = ("--sd", "C_ai=20%", "--sd", "sigma_i=0.2", "--correlation", "C_ai,sigma_i=0.5")
    status, _, err = answer(
        MACHINE_FILE, *QUICK, *words, "--want", "off_tracking=0.01", "--want", "r_i=5%", "--out", out
    )
    assert status == 0 and "wrote" in err
    page = out.read_text(encoding="utf-8")
    assert "For off_tracking to be known to ± 0.010 m all sds must be" in page
    content = json.loads((tmp_path / "a.json").read_text(encoding="utf-8"))["data"]
    assert "--correlation C_ai,sigma_i=0.5" in content["command"]
    assert set(content["parameters"]) == {"C_ai", "sigma_i"}


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--sd", "Cai=10%"], 'did you mean "C_ai"'),
        (["--sd", "C_ai=-3"], "a number above zero"),
        (["--sd", "C_ai"], "give NAME=NUMBER"),
        (["--correlation", "C_ai,C_af=0.5"], "--correlation needs --sd"),
        (["--sd", "C_ai=1%", "--correlation", "C_ai,C_af=0.5"], "no such name"),
        (["--sd", "C_ai=1%", "--sd", "C_af=1%", "--correlation", "C_ai,C_af=1.5"], "between -1 and 1"),
        (["--want", "off_tracking=5%"], "give it in m"),
        (["--want", "r_t=5"], "in per cent"),
        (["--draws", "7"], "from 100 up"),
        (["--speed", "-1"], "give a number from"),
        (["--from", "none.mcap"], "none.mcap"),
        (["--from", "none.mcap", "--sd", "C_ai=1%"], "not allowed with"),
        (["--out", "a.txt"], "ends in .html"),
    ],
)
def test_wrong_use(answer: Answer, words: list[str], told: str) -> None:
    status, out, err = answer(MACHINE_FILE, *words)
    assert status == 2 and told in err and out == "" and "Traceback" not in err
    assert len(err.strip().splitlines()) == 1


def test_a_log_without_an_estimate(answer: Answer, tmp_path: Path) -> None:
    log = write_run(tmp_path / "a.mcap", WrittenRun(without_estimates=True))
    machine = tmp_path / "machine.toml"
    machine.write_text(MACHINE_TEXT, encoding="utf-8")
    status, _, err = answer(machine, "--from", log, *QUICK)
    assert status == 2 and "there are no estimates in field-1; `tilth replay` makes them" in err


def test_a_log_of_another_machine_file_is_replayed(
    answer: Answer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Here one without any frame that tells something."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    log = write_run(tmp_path / "a.mcap")
    machine = tmp_path / "machine.toml"
    machine.write_text(MACHINE_TEXT.replace("a = 1.7", "a = 1.75"), encoding="utf-8")
    status, _, err = answer(machine, "--from", log, *QUICK)
    assert status == 2 and "made with another machine file; it is replayed with jd7930-parker500" in err


def test_a_rig_that_is_unstable(answer: Answer, tmp_path: Path) -> None:
    loose = tmp_path / "loose.toml"
    text = MACHINE_FILE.read_text(encoding="utf-8")
    loose.write_text(text.replace("cornering_stiffness = 486e3", "cornering_stiffness = 60e3"), "utf-8")
    status, _, err = answer(loose, "--speed", 7.5, "--sd", "C_ar=1%")
    assert status == 2 and "unstable" in err
    status, _, err = answer(loose, "--speed", 7.5, "--speed", 1, "--sd", "C_ar=1%", "--draws", 100)
    assert status == 1 and "at 7.5 m/s this rig is unstable" in err


@pytest.mark.long
def test_a_full_disk(tmp_path: Path) -> None:
    words: list[str | Path] = [
        "uncertainty",
        MACHINE_FILE,
        *QUICK,
        "--sd",
        "C_ai=10%",
        "--out",
        tmp_path / "a.html",
    ]
    made = on_a_small_disk(tmp_path, "40k", *TILTH, *words)
    assert made.status == 1 and "no space left on device; nothing was written" in made.err, made
    assert made.left == []
