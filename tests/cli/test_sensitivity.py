"""`tilth sensitivity`: its numbers, its report, its words for wrong use, its exit status."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from asked import Answer, asked
from paths import MACHINE_FILE
from report_run import write_run

from tilth.analysis.report.document import ReportFigure
from tilth.analysis.report.figures import svg
from tilth.analysis.report.sensitivity_figures import SENSITIVITY_DRAWINGS
from tilth.analysis.sensitivity.frequency import TRANSFERS
from tilth.analysis.sensitivity.local import local_sensitivities, overall
from tilth.analysis.sensitivity.outputs import NAMES, SIX
from tilth.analysis.sensitivity.slopes import MACHINE_PARAMETERS
from tilth.analysis.sensitivity.sobol import POINTS
from tilth.estimator.models.family import model_named
from tilth.estimator.models.parameters import TABLE_7_2

pytestmark = pytest.mark.long


@pytest.fixture
def answer(capsys: pytest.CaptureFixture[str]) -> Answer:
    return asked(capsys, "sensitivity")


@pytest.fixture
def quick(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A quarter of the points from which indices are made; nothing kept from another test."""
    monkeypatch.setattr("tilth.analysis.sensitivity.indices_answer.POINTS", POINTS // 4)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def oversteering(folder: Path) -> Path:
    """Loose behind: unstable at 7.5 m/s, not at 1."""
    text = MACHINE_FILE.read_text(encoding="utf-8").replace(
        "cornering_stiffness = 486e3", "cornering_stiffness = 60e3"
    )
    path = folder / "loose.toml"
    path.write_text(text, encoding="utf-8")
    return path


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_the_numbers_are_those_of_the_step(answer: Answer) -> None:
    status, out, _ = answer(
        MACHINE_FILE, "--speed", 4.5, "--seconds", 6, "--speed", 1, "--seconds", 30, "--json"
    )
    found = json.loads(out, parse_constant=pytest.fail)
    assert status == 0 and [entry["speed"] for entry in found["speeds"]] == [4.5, 1.0]
    entry = found["speeds"][0]
    assert entry["outputs"] == list(NAMES) and list(entry["local"]) == list(MACHINE_PARAMETERS)
    assert set(entry["local"]["C_af"]) == {*NAMES, "overall"}
    direct = local_sensitivities(model_named("relaxation"), TABLE_7_2, 4.5, seconds=6.0)
    told = [[entry["local"][name][output] for output in NAMES] for name in direct.parameters]
    np.testing.assert_allclose(told, direct.step, rtol=1e-12)
    told_overall = [entry["local"][name]["overall"] for name in direct.parameters]
    np.testing.assert_allclose(told_overall, overall(direct.step), rtol=1e-12)


def test_derivatives_and_a_choice(answer: Answer) -> None:
    words = (
        "--speed",
        4.5,
        "--outputs",
        "r_t,psi_t",
        "--parameters",
        "C_af",
        "--parameters",
        "m_i",
        "--json",
    )
    exact, step = (
        json.loads(answer(MACHINE_FILE, *words, "--step", way)[1])["speeds"][0] for way in ("exact", "1%")
    )
    assert exact["outputs"] == ["r_t", "psi_t"] and list(exact["local"]) == ["C_af", "m_i"]
    for name, row in exact["local"].items():
        assert list(row) == ["r_t", "psi_t", "overall"]
        for output, value in row.items():
            assert value == pytest.approx(step["local"][name][output], rel=0.02)
            assert value != step["local"][name][output]


def test_the_table_has_every_parameter_that_acts(answer: Answer) -> None:
    status, out, _ = answer(MACHINE_FILE, "--speed", 4.5)
    assert status == 0 and re.search(r"│ C_af +│ 0\.21\d │", out)
    assert all(f"│ {name} " in out for name in MACHINE_PARAMETERS[:-2]) and "h_t" not in out
    assert all(output in out for output in SIX)


def test_two_models(answer: Answer) -> None:
    words = ("--speed", 4.5, "--model", "kinematic", "--model", "dynamic", "--json")
    entries = json.loads(answer(MACHINE_FILE, *words)[1])["speeds"]
    assert [entry["model"] for entry in entries] == ["kinematic", "dynamic"]
    overalls = [entry["local"]["C_af"]["overall"] for entry in entries]
    assert overalls[0] == 0.0 < overalls[1]


def test_a_report(answer: Answer, tmp_path: Path) -> None:
    out = tmp_path / "a.html"
    status, _, err = answer(MACHINE_FILE, "--speed", 1, "--speed", 4.5, "--out", out)
    assert status == 0 and "wrote" in err and names(tmp_path) == ["a.html", "a.json"]
    page, content = (
        out.read_text(encoding="utf-8"),
        json.loads((tmp_path / "a.json").read_text(encoding="utf-8")),
    )
    for figure in ("6.3", "6.4", "6.5", "6.6", "6.7", "6.8", "6.9"):
        assert f"Figure {figure} of the" in page
    ids = re.findall(r'<figure id="([\w-]+)"', page)
    assert len(set(ids)) == len(ids) == 4 + 2 + 2 + 2 * len(TRANSFERS)
    assert all(page.count(f'id="{one}"') == 1 for one in re.findall(r' id="([^"]+)"', page))
    assert "<script" not in page and not re.search(r'(?:src|href)="https?:', page)
    assert "Of no influence on any of these outputs by this model: h_t and h_i." in page
    frequency = content["data"]["frequency"]["relaxation"]
    assert len(frequency["omega"]) == len(frequency["speeds"][0]["transfers"]["r_i"]["phase"]["I_i"])
    assert set(frequency["speeds"][0]["transfers"]) == set(TRANSFERS)
    assert content["data"]["speeds"][0]["local"]["a"]["r_t"] > 0


def test_the_same_question_gives_the_same_bytes(
    answer: Answer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = []
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        monkeypatch.chdir(tmp_path / name)
        assert answer(MACHINE_FILE, "--speed", 4.5, "--parameters", "C_af", "--out", "a.html")[0] == 0
        made.append([(path.name, path.read_bytes()) for path in sorted(Path().iterdir())])
    assert made[0] == made[1] and len(made[0]) == 2


@pytest.mark.parametrize("kind", SENSITIVITY_DRAWINGS)
def test_every_figure_is_drawn_the_same_each_time(kind: str) -> None:
    curve = {"t_s": [0.0, 1.0], "reference": [0.0, 1.0], "changed": [0.0, 1.1]}
    panel: dict[str, Any] = {
        "title": "x",
        "label": "y",
        "series": [{"name": "1 m/s", "values": [0.1, None]}],
        **curve,
        "lines": [{"name": "C_af", "gain": [0.1, 0.2], "phase": [0.0, -0.1]}],
        "edges": [-1.0, 0.0, 1.0],
        "counts": [3.0, 4.0],
        "first_order_sd": 0.5,
        "model": [0.1, 0.3],
        "first_order": [0.1, 0.2],
        "shares": [0.0, 3.0],
        "low": "1",
        "high": "2",
    }
    if kind == "pairs":
        line = {"at": [[1.0, 3.0], [0.0, 2.0]], "growth": [[-1.0, 1.0], [0.5, 2.0]]}
        panel = {"names": ["C_af", "C_ar"], "low_to_high": [[1.0, 2.0, 3.0], [0.0, 1.0, 2.0]],
                 "shares": [[0.0, 1.0], [None, 0.5]], "line": line}  # fmt: skip
    for count in (1, 4, 5):
        data = {
            "rows": ["v", "r_t"], "panels": [panel] * count, "label": "%", "name": "C_af",
            "omega": [0.1, 1.0], "factors": [1.0, 2.0],
            "ranges": [{"name": "C_af", "low": 0.1, "high": 1.0, "median": 0.3, "mean": None}],
        }  # fmt: skip
        figure = ReportFigure("one", kind, "caption", "description", data)
        text = svg(figure)
        assert text == svg(figure)
        ElementTree.fromstring(text)


def test_a_speed_at_which_it_is_unstable_is_left_out_and_told(answer: Answer, tmp_path: Path) -> None:
    loose = oversteering(tmp_path)
    status, out, err = answer(loose, "--speed", 1, "--speed", 7.5, "--json")
    found = json.loads(out)
    assert status == 1 and "at 7.5 m/s this rig is unstable" in err and "give a lower speed" in err
    assert [entry["speed"] for entry in found["speeds"]] == [1.0]
    assert [entry["speed"] for entry in found["refused"]] == [7.5]
    status, out, err = answer(loose, "--speed", 7.5, "--out", tmp_path / "a.html")
    assert status == 2 and out == "" and "unstable" in err and names(tmp_path) == ["loose.toml"]


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--parameters", "C_ag"], 'C_ag: there is no such name; did you mean "C_a'),
        (["--parameters", "c_AF"], 'did you mean "C_af"?'),
        (["--outputs", "r_t,yaw"], "--outputs yaw: there is no such name"),
        (["--outputs", "crosstrack"], 'did you mean "cross_track"?'),
        (["--speed", "-1"], "give a number from 0.1 to 30 m/s"),
        (["--speed", "nan"], "give a number from 0.1 to 30 m/s"),
        (["--seconds", "1", "--seconds", "2"], "given 2 times for 3 speeds"),
        (["--seconds", "1e9"], "give a number from 0.02 to 2000 s"),
        (["--model", "cubic"], "invalid choice"),
        (["--step", "2%"], "invalid choice"),
        (["--out", "a.pdf"], "give a name that ends in .html"),
        (["--out", "nowhere/a.html"], "there is no such folder"),
        (["--points", "500"], "--points needs --global"),
        (["--no-indices"], "--no-indices needs --global"),
        (["--global", "--points", "5"], "from 100 up"),
        (["--global", "--box", "C_af=2"], "give NAME=LOW:HIGH"),
        (["--global", "--box", "C_af=0:2"], "give a range above zero"),
        (["--global", "--box", "Caf=1:2"], 'did you mean "C_af"'),
        (["--global", "--box", "C_af=1e5:2e5", "--from", "a.mcap"], "give one of them"),
        (["--global", "--from", "none.mcap"], "none.mcap"),
        (["--global", "--workers", "0"], "from 1 up"),
        (["--input", "wiggle"], "invalid choice"),
    ],
)
def test_wrong_use(answer: Answer, words: list[str], told: str) -> None:
    status, out, err = answer(MACHINE_FILE, *words)
    assert status == 2 and out == "" and told in err and err.count("\n") == 1


def test_over_many_rigs(answer: Answer, quick: None, tmp_path: Path) -> None:
    """A box at a speed at which a part of it is unstable; by the table, JSON and page."""
    words = (MACHINE_FILE, "--speed", 7.5, "--seconds", 1, "--outputs", "r_t", "--global", "--points", 200)
    box = ("--box", "C_af=100e3:400e3", "--box", "C_ar=60e3:900e3")
    status, out, _ = answer(
        *words, *box, "--workers", 1, "--json", "--out", tmp_path / "a.html", "--no-indices"
    )
    (entry,) = json.loads(out, parse_constant=pytest.fail)["speeds"]
    assert status == 0 and set(entry["global"]) == {"C_af", "C_ar"} and entry["points"] == 200
    assert 0 < entry["unstable_share"] < 1 and "C_ar low" in entry["unstable_where"]
    page = (tmp_path / "a.html").read_text(encoding="utf-8")
    assert "200 random rigs of the box" in page and "relaxation-global-7-5-unstable" in page
    assert "relaxation-global-7-5-pairs" in page and "of the unstable rigs have" in page
    status, out, _ = answer(*words, *box, "--workers", 1)
    assert status == 0 and "of the rigs are unstable" in out and "what makes the variance of r_t" in out


def test_the_shape_of_the_json(answer: Answer, quick: None, tmp_path: Path) -> None:
    """Keys and nesting that programs rely on; the outer indices are the means of those by output."""
    box = ("--box", "C_af=100e3:300e3", "--box", "C_ai=60e3:300e3")
    words = ("--speed", 4.5, "--seconds", 1, "--global", "--points", 100, "--workers", 1, "--json")
    (entry,) = json.loads(answer(MACHINE_FILE, *words, *box)[1], parse_constant=pytest.fail)["speeds"]
    assert {"speed", "outputs", "local", "global", "unstable_share"} <= set(entry)
    for row in entry["global"].values():
        assert {"mean", "median", "q05", "q95", "sobol_first", "sobol_total"} <= set(row)
        for kind in ("sobol_first", "sobol_total"):
            assert list(row[kind]) == ["value", "low", "high"]
            inner = [row["by_output"][output][kind]["value"] for output in SIX]
            assert row[kind]["value"] == pytest.approx(np.mean(inner))
            assert row[kind]["low"] < row[kind]["value"] < row[kind]["high"]
        means = [row["by_output"][output]["mean"] for output in SIX]
        assert row["mean"] == pytest.approx(np.mean(means))
        assert set(row["by_output"]) == set(NAMES)


def test_over_many_rigs_by_any_model_input_and_output(answer: Answer, quick: None) -> None:
    words = (
        "--speed",
        3,
        "--seconds",
        1,
        "--global",
        "--points",
        100,
        "--workers",
        1,
        "--no-indices",
        "--json",
    )
    asked = ("--model", "kinematic", "--input", "chirp", "--outputs", "cross_track,r_i", "--box", "d=2:4")
    (entry,) = json.loads(answer(MACHINE_FILE, *words, *asked)[1], parse_constant=pytest.fail)["speeds"]
    row = entry["global"]["d"]
    assert entry["global_outputs"] == ["r_i", "cross_track"] or set(row["by_output"]) == {
        "r_i",
        "cross_track",
    }
    assert row["sobol_first"] is None and entry["unstable_share"] == 0.0
    for output, local in entry["local"]["d"].items():
        if output in row["by_output"]:
            assert 0.3 * local < row["by_output"][output]["median"] < 3 * local


def test_rigs_by_the_covariance_of_a_log(answer: Answer, quick: None, tmp_path: Path) -> None:
    log = write_run(tmp_path / "a.mcap")
    words = ("--speed", 4.5, "--seconds", 1, "--global", "--points", 100, "--workers", 1, "--json")
    status, out, _ = answer(MACHINE_FILE, *words, "--from", log, "--outputs", "off_tracking")
    said = json.loads(out, parse_constant=pytest.fail)
    (entry,) = said["speeds"]
    assert status == 0 and "covariance" in said["design"]["what"] and entry["unstable_share"] == 0.0
    rows = entry["global"]
    local = entry["local"]["C_ai"]["off_tracking"]
    assert rows["C_ai"]["median"] == rows["C_ai"]["by_output"]["off_tracking"]["median"]
    assert rows["C_ai"]["median"] == pytest.approx(local, rel=0.3)
    assert rows["C_ai"]["sobol_total"]["low"] > 0.05 > rows["sigma_f"]["sobol_total"]["high"]
    assert rows["C_ai"]["by_output"]["off_tracking"]["morris"] is None and entry["indices"]["lost"] == 0.0


def test_a_report_is_never_overwritten(answer: Answer, tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text("mine")
    status, _, err = answer(MACHINE_FILE, "--out", tmp_path / "a.html")
    assert status == 2 and "never overwritten" in err and (tmp_path / "a.json").read_text() == "mine"


def test_a_value_that_is_not_positive(answer: Answer, tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.write_text(MACHINE_FILE.read_text(encoding="utf-8").replace("= 167e3", "= 0.0"), encoding="utf-8")
    status, _, err = answer(path)
    assert status == 2 and "tyres.implement.cornering_stiffness" in err


def test_a_full_disk(answer: Answer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(path: Path, data: bytes) -> int:
        raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr(Path, "write_bytes", full)
    status, out, err = answer(
        MACHINE_FILE, "--speed", 4.5, "--parameters", "C_af", "--out", tmp_path / "a.html", "--json"
    )
    assert status == 1 and "no space left on device; nothing was written" in err and names(tmp_path) == []
    assert json.loads(out)["speeds"]


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_that_may_not_be_written(answer: Answer, tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    status, _, err = answer(MACHINE_FILE, "--speed", 4.5, "--out", tmp_path / "a.html")
    assert status == 2 and "you may not" in err


@pytest.mark.parametrize("name", ["sensitivity"])
def test_help_needs_no_matplotlib(name: str) -> None:
    code = "import sys; from tilth.cli import main\n"
    code += f"try: main(['{name}', '-h'])\nfinally: print('matplotlib' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.endswith("False\n")
