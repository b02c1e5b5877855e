"""`tilth model`: published numbers through the command, its tables and figures, and its errors."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from asked import Answer, asked
from paths import ROOT, shared

from tilth.estimator.models.parameters import TABLE_5_1, TABLE_7_2, Rig, rig_of
from tilth.logger.machine_file import read_machine
from tilth.schemas.flow import PARAMETERS

MACHINES = ROOT / "deploy" / "machines"
MACHINE = MACHINES / "jd7930-parker500.toml"
CHAPTER_5 = MACHINES / "jd7930-parker500-ch5.toml"
FILES = {"table_5_1": CHAPTER_5, "table_7_2": MACHINE}
PRINTED = 1.01e-6  # the published values have six decimals
QUICK = ("--seconds", "2")


@pytest.fixture
def answer(capsys: pytest.CaptureFixture[str]) -> Answer:
    return asked(capsys, "model")


@pytest.fixture
def report(answer: Answer) -> Callable[..., dict[str, Any]]:
    def ask(*words: object) -> dict[str, Any]:
        status, out, _ = answer(*words, "--json", *QUICK)
        assert status == 0
        found: dict[str, Any] = json.loads(out, parse_constant=pytest.fail)
        return found

    return ask


def speeds(*values: float) -> list[str]:
    return [word for value in values for word in ("--speed", str(value))]


def close(found: Any, published: Any, decimals: float = PRINTED) -> None:
    np.testing.assert_allclose(np.array(found, float), np.array(published, float), rtol=0, atol=decimals)


@pytest.mark.parametrize(("machine", "rig"), [(CHAPTER_5, TABLE_5_1), (MACHINE, TABLE_7_2)])
def test_the_machine_files_are_the_dissertations_tables(machine: Path, rig: Rig) -> None:
    assert rig_of(read_machine(machine)[0]) == rig


@pytest.mark.parametrize("table", FILES)
def test_published_eigenvalues(table: str, report: Callable[..., dict[str, Any]]) -> None:
    published = json.loads(shared("reference/model_values.json").read_text())["eigenvalues"][table]
    found = report(FILES[table], *speeds(0.5, 1, 2.5, 4.5, 7.5))["models"]
    assert found.keys() == published.keys()
    for model, values in published.items():
        assert found[model].keys() == values.keys()
        for speed, eigenvalues in values.items():
            close(found[model][speed]["eigenvalues"], eigenvalues)


def test_published_regulators_responses_and_turns(report: Callable[..., dict[str, Any]]) -> None:
    published = json.loads(shared("reference/model_values.json").read_text())
    found = report(CHAPTER_5, *speeds(0.5, 1, 2.5, 4.5, 7.5, 10))["models"]
    for model in ("kinematic", "dynamic", "relaxation"):
        for speed, values in published["lqr"][model].items():
            design = found[model][speed]["lqr"][
                "without_actuator" if model == "kinematic" else "with_actuator"
            ]
            close(design["eigenvalues"], values["closed_loop_eigenvalues"])
            close(list(design["gain"].values()), values["gain"])
    for model, by_speed in published["yaw_rate_frequency_response_dB_deg"].items():
        for speed, by_omega in by_speed.items():
            response = found[model][speed]["frequency_response"]
            for omega, bodies in by_omega.items():
                k = response["omega_rad_per_s"].index(float(omega))
                for body, output in (("tractor", "r_t"), ("implement", "r_i")):
                    close(response[output]["gain_dB"][k], bodies[body][0])
                    close(response[output]["phase_deg"][k], bodies[body][1], 1e-4)
    for speed in ("1.0", "2.5", "4.5", "7.5"):
        turn = found["relaxation"][speed]["steady_turn_per_rad"]
        values = [turn[name] for name in ("lateral_velocity", "yaw_rate", "articulation")]
        close(values, published["steady_state_per_rad"][speed])


def test_numbers_that_need_no_reference(report: Callable[..., dict[str, Any]]) -> None:
    models = report(CHAPTER_5, *speeds(4.5))["models"]
    kinematic, dynamic = models["kinematic"]["4.5"], models["dynamic"]["4.5"]
    assert kinematic["eigenvalues"] == [[-4.5 / 3.72, 0.0], [0.0, 0.0], [0.0, 0.0]]
    assert kinematic["steady_turn_per_rad"]["yaw_rate"] == pytest.approx(4.5 / 2.9)
    assert dynamic["dominant"][0] == pytest.approx(-1.366404, abs=1e-6)
    assert kinematic["settling_time_s"] == pytest.approx(4 * 3.72 / 4.5)
    assert kinematic["settling_distance_m"] == pytest.approx(4 * 3.72)
    assert kinematic["damping"] == [1.0, None, None]


def test_the_object(answer: Answer) -> None:
    status, out, err = answer(MACHINE, "--json", "--model", "dynamic", *speeds(4.5, 1.0, 4.5), *QUICK)
    assert (status, err, out.count("\n")) == (0, "", 1)
    output = json.loads(out)
    assert output["machine"] == "jd7930-parker500"
    assert list(output["models"]) == ["dynamic"]
    assert list(output["models"]["dynamic"]) == ["4.5", "1.0"]
    at = output["models"]["dynamic"]["4.5"]
    pairs = [tuple(pair) for pair in at["eigenvalues"]]
    assert pairs == sorted(pairs) and len(pairs) == len(at["states"])
    assert np.array(at["a"]).shape == (6, 6) and np.array(at["b"]).shape == (6, 3)
    assert set(at["bound"]["sd"]) == set(PARAMETERS[:3])
    assert output["parameters"]["C_af"] == {"value": 220e3, "unit": "N/rad"}


def test_more_steering_tells_more(report: Callable[..., dict[str, Any]]) -> None:
    def sd(*words: object) -> float:
        bound = report(MACHINE, "--model", "relaxation", *speeds(4.5), *words)["models"]["relaxation"]["4.5"]
        return float(bound["bound"]["sd"]["C_af"])

    assert sd("--wheel-angle", 10) == pytest.approx(sd("--wheel-angle", 5) / 2, rel=1e-3)
    assert sd("--manoeuvre", "row") > sd("--manoeuvre", "random")


def test_tables_say_what_the_object_says(answer: Answer) -> None:
    status, out, err = answer(CHAPTER_5, *QUICK, "--sensors", "positions_5hz")
    assert (status, err) == (0, "")
    assert max(map(len, out.splitlines())) <= 80
    for words in (
        "9391 kg",
        "+3.43°/g",
        "21.8 m/s",
        "-1.37",
        "-3.39±1.24j",
        "9/9",
        "3.45",
    ):
        assert words in out
    assert "y_t ±0.035 m (95 %) at 5 Hz" in " ".join(out.split())


def test_a_rig_that_oversteers(answer: Answer, tmp_path: Path) -> None:
    text = MACHINE.read_text().replace("cornering_stiffness = 486e3", "cornering_stiffness = 110e3")
    machine = tmp_path / "loose.toml"
    machine.write_text(text)
    status, out, _ = answer(machine, "--model", "dynamic", *speeds(4.5, 25), *QUICK)
    assert status == 0
    assert "It OVERSTEERS" in out
    output = json.loads(answer(machine, "--model", "dynamic", *speeds(4.5, 25), *QUICK, "--json")[1])
    limit = -output["understeer"]["characteristic_speed_m_per_s"]
    assert 4.5 < limit < 25.0
    fast = output["models"]["dynamic"]["25.0"]
    assert output["models"]["dynamic"]["4.5"]["stable"] and not fast["stable"]
    assert fast["settling_time_s"] is None and fast["lqr"]["with_actuator"]["stable"]


def test_kinematic_alone_tells_nothing_of_tyres(answer: Answer) -> None:
    _, out, _ = answer(MACHINE, "--model", "kinematic", *speeds(4.5))
    assert "has no tyres" in out


@pytest.mark.parametrize("suffix", [".svg", ".PNG", ".pdf"])
def test_the_plot(suffix: str, answer: Answer, tmp_path: Path) -> None:
    path = tmp_path / f"rig{suffix}"
    status, out, err = answer(MACHINE, "--plot", path, "--json", "--model", "kinematic", *speeds(1.0, 4.5))
    assert status == 0
    assert json.loads(out)["machine"] == "jd7930-parker500"
    assert err == f"tilth model: drew {path}\n"
    assert path.stat().st_size > 5000


def test_the_plots_bytes_depend_on_the_numbers_only(answer: Answer, tmp_path: Path) -> None:
    paths = [tmp_path / name for name in ("one.svg", "two.svg")]
    for path in paths:
        answer(MACHINE, "--plot", path, "--model", "dynamic", *speeds(4.5), *QUICK)
    assert paths[0].read_bytes() == paths[1].read_bytes()
    ElementTree.parse(paths[0])
    assert "<dc:date>" not in paths[0].read_text()


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["/nowhere.toml"], "cannot be read"),
        ([MACHINE, "--speed", "-1"], "give a number from 0.1 to 30 m/s, not -1"),
        ([MACHINE, "--speed", "0"], "give a number from 0.1 to 30 m/s, not 0"),
        ([MACHINE, "--speed", "nan"], "give a number from 0.1 to 30 m/s, not nan"),
        ([MACHINE, "--speed", "fast"], "give a number from 0.1 to 30 m/s, not fast"),
        ([MACHINE, "--model", "bicycle"], "invalid choice: 'bicycle'"),
        ([MACHINE, "--manoeuvre", "slalom"], "invalid choice: 'slalom'"),
        ([MACHINE, "--sensors", "eyes"], "invalid choice: 'eyes'"),
        ([MACHINE, "--wheel-angle", "90"], "give a number from 0.1 to 20 degrees, not 90"),
        ([MACHINE, "--seconds", "0"], "give a number from 2 to 300 s, not 0"),
        ([MACHINE, "--plot", "rig.jpg"], "give a name that ends in .svg, .png, .pdf"),
        ([MACHINE, "--plot", "/nowhere/rig.svg"], "no such file or directory; give another path"),
        ([MACHINE, "--plot", "rig.svg", *speeds(*range(1, 10))], "has room for 8 speeds, not 9"),
    ],
    ids=lambda value: "" if isinstance(value, str) else " ".join(map(str, value[1:3])) or "file",
)
def test_wrong_use_gets_one_sentence(words: list[object], sentence: str, answer: Answer) -> None:
    status, out, err = answer(*words)
    assert (status, out) == (2, "")
    assert sentence in err and err.count("\n") == 1


def test_a_rig_out_of_range_is_named(answer: Answer, tmp_path: Path) -> None:
    machine = tmp_path / "long.toml"
    machine.write_text(MACHINE.read_text().replace("d = 3.62", "d = 36.2"))
    status, _, err = answer(machine)
    assert status == 2
    assert "d = 36.2 m" in err and err.count("\n") == 1
