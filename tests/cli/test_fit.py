"""`tilth fit` as it is typed: its JSON and tables, and what it says when it cannot."""

import csv
import io
import json
from pathlib import Path
from typing import Any

import pytest
from asked import Answer, asked
from logs import MACHINE_TEXT
from recorded import cut, recorded, shared_cache
from recorded_run import write_run

from tilth.analysis.runs.run import open_runs
from tilth.schemas.flow import PARAMETERS, Status


@pytest.fixture
def fit(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Answer:
    """(status, stdout, stderr) of `tilth fit …`."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(shared_cache()))

    return asked(capsys, "fit")


def test_json_and_tables_say_the_same(fit: Answer) -> None:
    log = recorded().parts[0]
    status, out, _ = fit(log, "--segment", "4:27", "--json")
    answer: dict[str, Any] = json.loads(out)
    assert status == 0 and set(answer) == {"runs", "joint", "agreement", "groups", "simulated"}
    (run,) = answer["runs"]
    assert (run["log"], run["start_s"], run["end_s"]) == (1, 4.0, 27.0) and run["kind"] == "given"
    assert set(run["parameters"]) == set(PARAMETERS) == set(run["filter"])
    assert all(set(row) == {"value", "sd", "status", "reason"} for row in run["parameters"].values())
    status, out, _ = fit(log, "--segment", "4:27")
    value = run["parameters"]["C_af"]["value"]
    assert status == 0 and f"{1e-3 * value:.0f}" in out and "kN/rad" in out and "all together" not in out
    assert max(map(len, out.splitlines())) <= 80
    _, out, _ = fit(log, "--segment", "4:27", "--csv")
    row = next(row for row in csv.DictReader(io.StringIO(out)) if row["parameter"] == "C_af")
    assert float(row["estimate"]) == pytest.approx(1e-3 * value, rel=1e-3) and row["unit"] == "kN/rad"
    assert float(row["low_95"]) < float(row["estimate"]) < float(row["high_95"])
    _, out, _ = fit(log, "--segment", "4:27", "--latex")
    assert r"$C_{\alpha f}$ [kN/rad]" in out and f"${1e-3 * value:.0f}" in out
    _, out, _ = fit(log, "--segment", "4:27", "--all")
    assert "segment 1.1, given, 4.0 to 27.0 s" in out and "estimated" in out


def test_the_two_steps_stand_beside(fit: Answer) -> None:
    status, out, _ = fit(recorded().parts[0], "--segment", "4:27", "--two-step", "--json")
    (run,) = json.loads(out)["runs"]
    assert status == 0 and set(run["two_step"]) == set(PARAMETERS)


@pytest.mark.long
def test_a_cut_log_is_fitted_as_far_as_it_is_whole(fit: Answer) -> None:
    status, out, _ = fit(cut(), "--json")
    assert status == 0 and json.loads(out)["runs"][0]["kind"] == "step"


@pytest.mark.parametrize(
    ("words", "status", "says"),
    [
        (("--segment", "90:120"), 2, "no poses between 90 and 120 s of the run"),
        (("--segment", "20:10"), 2, "20:10: give seconds since it began"),
        (("--segment", "a:b"), 2, "a:b: give seconds since it began"),
        (("--segment", "2:1:20"), 2, "there are 1 runs"),
        (("--segment", "2.5:5"), 1, ""),
        (("--kind", "chirp"), 1, "no driving with steering of the kinds chirp was found"),
        (("--segment", "4:27", "--mark", "west*"), 2, "leave out --mark and --kind beside it"),
        (("--mark", "north*"), 1, "no marks begin and end a run that is called north*"),
        (("--kind", "dance"), 2, "invalid choice: 'dance'"),
        (("--jobs", "0"), 2, "0: give a number of processes, from 1 up"),
        (("--bus", "a=b"), 2, "--bus a=b: write LOG=MACHINE; the machine file has can0"),
    ],
)
def test_mistakes_are_said_in_a_sentence(fit: Answer, words: tuple[str, ...], status: int, says: str) -> None:
    found, _, err = fit(recorded().parts[0], *words)
    assert found == status and says in err and "Traceback" not in err


def test_what_is_no_log(fit: Answer, tmp_path: Path) -> None:
    missing, text, foreign = tmp_path / "no.mcap", tmp_path / "a.txt", tmp_path / "b.log"
    text.write_text("hello\n")
    foreign.write_text("(1700000000.000000) can0 18FEF300#0102030405060708\n")
    assert fit(missing)[0] == 2 and "no such file" in fit(missing)[2]
    assert fit(text)[0] == 2 and "not a log of CAN frames" in fit(text)[2]
    status, _, err = fit(foreign)
    assert status == 2 and "give --machine M.toml" in err
    machine = tmp_path / "m.toml"
    machine.write_text(MACHINE_TEXT)
    status, _, err = fit(foreign, "--machine", machine)
    assert status == 1 and "there are no poses in these logs" in err


def test_of_logs_of_two_rigs_the_keys_that_differ_are_named(fit: Answer, tmp_path: Path) -> None:
    (other,) = write_run(tmp_path, name="fendt")
    status, _, err = fit(recorded().parts[0], other)
    assert status == 2 and "are of different machine files" in err
    assert "They differ in machine.name" in err and "log.chunk_kilobytes" not in err


@pytest.mark.parametrize(("share", "withheld"), [(1.0, False), (0.3, True)])
def test_a_fit_says_where_nothing_is_published(
    fit: Answer, tmp_path: Path, share: float, withheld: bool
) -> None:
    """It does not look whether driving has shown yet that the machine file is right."""
    log, whole = tmp_path / "drive.mcap", recorded().parts[0].read_bytes()
    log.write_bytes(whole[: round(share * len(whole))])
    (run,) = open_runs([log])
    last = run.estimates()
    status, out, err = fit(log)
    assert status == 0 and "N/rad" in out and (last["C_af_status"][-1] == Status.UNESTIMATED) == withheld
    assert (f"at the end of a log no number is published, since {last['C_af_reason'][-1]}" in err) == withheld
