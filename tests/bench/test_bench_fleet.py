"""The design on the virtual fleet: balance, table, a drive; and the rigs that other benches take of it."""

import json
import math
from collections import Counter
from pathlib import Path

import calibration
import estimation_study
import fleet
import numpy as np
import pytest
import spatial_rows
import wrong_files
from estimation_table import Bench
from fleet_design import GROUNDS, MANOEUVRES, PLANTS, cell_of, scenario

from tilth.estimator.diagnosis.open_numbers import HYPOTHESES
from tilth.schemas.machine_toml import parse_machine
from tilth.simulator.fleet import drawn
from tilth.simulator.fleet_files import owners_text
from tilth.simulator.packaged import packaged_file


@pytest.mark.parametrize("first", [0, 17, 120])
def test_sixty_drives_are_all_cells_once_and_fewer_are_balanced(first: int) -> None:
    cells = [cell_of(first + k) for k in range(60)]
    assert len({(c.manoeuvre.name, c.rms, c.plant, c.slope_deg) for c in cells}) == 60
    for of, kinds in (
        (lambda c: c.manoeuvre.name, len(MANOEUVRES)), (lambda c: c.rms, len(GROUNDS)),
        (lambda c: (c.plant, c.slope_deg), len(PLANTS)),
    ):  # fmt: skip
        counts = Counter(map(of, cells[:24]))
        assert len(counts) == kinds and max(counts.values()) - min(counts.values()) <= 1


@pytest.mark.parametrize("number", range(12))
def test_every_cell_has_a_scenario_for_its_rig(number: int) -> None:
    rig, cell = drawn(number), cell_of(number)
    made = scenario(rig, cell)
    assert (made.plant, made.ground.slope_deg) == (cell.plant, cell.slope_deg)
    assert made.soil.parameters == rig.parameters
    assert bool(made.ground.rut) is (cell.plant == "planar")


def _made(z: float, sd: float, count: int = 60) -> list[fleet.Result]:
    """Drives whose numbers are off by z sds, times a normal number."""
    rng, made = np.random.default_rng(1), []
    for k in range(count):
        cell = cell_of(k)
        error = z * sd * rng.standard_normal(6)
        said = {
            "error": error.tolist(),
            "sd": [sd] * 6,
            "last": [[off, sd] for off in error.tolist()],
            "given": [True, k % 10 > 0, True],
            "reasons": [""] * 6,
            "over_mass": [float(error[2]), sd],
        }
        made.append({
            "row": "fleet", "seed": k, "first": 0, "scale": 1.0, "rig": k, "tractor": "heavy",
            "implement": "sprayer", "duals": False, "manoeuvre": cell.manoeuvre.name, "rms": cell.rms,
            "slope": cell.slope_deg, "plant": cell.plant,
            "methods": {"pem": said, "recommended": said}, "contradictions": [], "took_s": 1.0,
        })  # fmt: skip
    return json.loads(json.dumps(made))  # type: ignore[no-any-return]


@pytest.mark.parametrize(("z", "sd", "held"), [(1.0, 0.05, True), (1.6, 0.05, False), (1.0, 0.4, False)])
def test_the_table_tells_right_numbers_from_wrong_ones(z: float, sd: float, held: bool) -> None:
    """Too far off for their sds, or too far off for use."""
    lines = {line.figure: line for line in fleet.lines_of(_made(z, sd, 600))}
    assert lines["pem C_ar"].held is held
    assert lines["tracker C_ar"].reached == "no number"
    given = lines["right files with numbers of recommended, 60 s after steering began"]
    later = lines["right files with numbers of recommended, 120 s after steering began"]
    assert (given.held, later.held) == (True, False)
    assert lines["plant planar, 300 drives"].held is (z < 1.2)
    assert lines["right files contradicted"].held is True


def test_a_number_that_is_far_off_is_named_with_its_drive() -> None:
    made = _made(1.0, 0.05, 4)
    made[2]["methods"]["pem"]["last"][2][0] = 0.05 * 4.5
    (line,) = (line for line in fleet.lines_of(made) if line.figure == "far off: pem C_ai")
    assert line.reached.startswith("+4.5 sd") and "rig 2" in line.reached


def test_a_drive_is_followed_and_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(runs=1, scale=0.12, kept=tmp_path / "kept.jsonl")
    assert any(line.figure.startswith("right files") for line in fleet.row(0, bench))
    made = json.loads((tmp_path / "kept.jsonl").read_text())
    assert made["rig"] == 0 and {"pem", "tracker"} <= made["methods"].keys()
    monkeypatch.setattr(fleet, "drawn", None)
    fleet.row(0, bench)  # not driven again


def test_what_is_there_of_a_run_that_was_stopped_is_read_of_its_own_rigs_only(tmp_path: Path) -> None:
    bench = Bench(runs=60, kept=tmp_path / "kept.jsonl", only_kept=True)
    for one in _made(1.0, 0.05, 7):
        for first in (0, 100):
            spatial_rows.keep(bench, one | {"first": first})
    lines = {line.figure: line for line in fleet.row(0, bench)}
    assert lines["pem C_af"].reached.split()[0].endswith("/7")
    assert lines["recommended C_af: |ln|"].reached.endswith("of 7 hold")
    assert lines["beyond 4 and 6 sds, all methods"].held


def test_harm_of_wrong_files_is_counted_and_the_number_is_named() -> None:
    rows = np.full((5, 13), np.nan)
    rows[1:, 1:7], rows[1:, 7:] = 0.41, 0.1
    rows[3, 1] = 0.1
    assert estimation_study.harm(rows, np.zeros(6)) == (24, 23)
    wrong = {fleet.wrong_number(k)[0] for k in range(len(HYPOTHESES))}
    assert len(wrong) == len(HYPOTHESES) and {"e", "m_t", "I_t"} <= wrong
    met = {(fleet.wrong_number(k)[0], cell_of(k).manoeuvre.name) for k in range(5 * len(wrong))}
    assert len(met) == len(wrong) * len(MANOEUVRES)
    machine = parse_machine(owners_text(drawn(4)))
    for number in range(len(wrong)):
        assert fleet._with_wrong_number(machine, number) != machine
    made = _made(1.0, 0.05, 2)
    for one in made:
        one |= {"wrong": ["e", 0.3], "contradictions": []}
        for said in one["methods"].values():
            said["harm"] = [1000, 3]
    (pem,) = (line for line in fleet.lines_of_wrong(made) if line.figure.startswith("pem"))
    assert pem.reached == "6 of 2000" and pem.held is False
    assert "e off by +0.3" in fleet.lines_of_wrong(made)[-1].figure


def test_a_number_that_is_withdrawn_is_judged_as_it_was_given_last() -> None:
    rows = np.full((4, 13), np.nan)
    rows[:, 0] = range(4)
    rows[1, 1:], rows[2, 1], rows[2, 7] = 1.0, 2.0, 0.5  # of the second time only C_af is given again
    last = np.array(fleet._last(rows, np.zeros(6)))
    assert last.tolist() == [[2.0, 0.5], *([[1.0, 1.0]] * 5)]
    assert np.isnan(fleet._last(rows[:1], np.zeros(6))).all()


# The other benches on it.


def test_wrong_files_of_the_fleet_start_from_their_owners() -> None:
    one = wrong_files.named("fleet-3")
    assert one.raw["tractor"]["mass"]["value"] != one.machine.tractor.mass.value
    assert one.scenario.soil.parameters == drawn(3).parameters
    change = next(c for c in wrong_files.changes() if c.name == "tractor.a x 2")
    change.apply(one.raw)
    assert one.raw["tractor"]["a"]["value"] == pytest.approx(2 * drawn(3).tractor.a, abs=0.1)


def test_the_right_file_of_a_calibrated_rig_of_the_fleet_is_exact() -> None:
    machine, _ = calibration.right_file("fleet", 3)
    assert machine.tractor.a.value == pytest.approx(drawn(3).tractor.a, abs=1e-4)
    assert machine.machine.name == "fleet-3"
    assert calibration.right_file("planar", 3) == packaged_file()


@pytest.mark.parametrize(
    ("sds", "given"),
    [
        ((0.2, 0.2, 0.3, math.nan), True), ((0.2, 0.2, 0.4, 0.3), True), ((0.2, 0.2, math.nan, 0.31), False),
        ((0.31, 0.2, 0.2, 0.2), False), ((0.2, math.nan, 0.2, 0.2), False),
    ],
)  # fmt: skip
def test_numbers_are_there_with_c_ai_or_with_c_ai_over_the_mass(sds: tuple[float, ...], given: bool) -> None:
    rows = np.zeros((2, 14))
    rows[:, 0], rows[1, [7, 8, 9, 13]] = (0.0, 10.0), sds
    assert fleet._given(rows, 10.0) == given and not fleet._given(rows, -1.0)
