"""Makes chapter7.json, the numbers of chapter 7 from logs:

    uv run python -m studies.dissertation.chapter7 [--to FOLDER] [--cache FOLDER] [--jobs N]

From a development install. Logs, replays and fits are kept, so that what is there is not made anew. The page
is written from the file (page.py), without any of this.
"""

import argparse
import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from studies.dissertation import experiments
from studies.dissertation.experiments import FIELDS, MANOEUVRES, PLANTS, REPLICATES, Experiment
from studies.dissertation.true_values import true_point
from tilth.analysis.fit.fitting import Fitted, choose, driven_of, fit_all
from tilth.analysis.fit.joint import join
from tilth.analysis.fit.result import JointAnswer, RunAnswer, as_json
from tilth.analysis.report.answered import drawn
from tilth.analysis.report.document import plain
from tilth.analysis.runs.kept import cache_folder
from tilth.analysis.validation import held_out
from tilth.analysis.validation.held_out import Cell, Predictable
from tilth.analysis.validation.validate import hold_out, responses
from tilth.estimator.filters import unknowns
from tilth.schemas.flow import PARAMETERS
from tilth.simulator.tractor import setting_of

Array = NDArray[np.float64]

FILE: Final = Path(__file__).with_suffix(".json")
DIGITS: Final = 4  # of a number in the file
PATH_EVERY_S: Final = 0.5  # of the paths in the file


def numbers(cache: Path, jobs: int, plants: Sequence[str] = PLANTS) -> dict[str, object]:
    """The whole file. Raises OSError, LogError, CannotFit."""
    experiments.prepare(experiments.all_of(plants), cache, jobs)
    groups, wholes, ways, measured = [], [], [], []
    for plant, field in product(plants, FIELDS):
        for manoeuvre in MANOEUVRES:
            runs = [Experiment(plant, field, manoeuvre, number) for number in REPLICATES]
            fitted = fit(runs, cache, jobs)
            named = {"plant": plant, "field": field, "manoeuvre": manoeuvre}
            true = by_truth(runs[0], fitted, cache) if plant == "planar" else {}
            groups.append({**named, **true, **group(fitted, cache)})
            if (field, manoeuvre) == (FIELDS[0], "steps"):
                ways.append({"plant": plant, **paths(fitted, cache)})
            if (field, manoeuvre) == (FIELDS[0], "random"):
                measured.append({"plant": plant, **frequency_response(fitted)})
        wholes.append({"plant": plant, "field": field, **whole(plant, field, cache, jobs)})
    truth = {field: list(experiments.truth(field).values()) for field in FIELDS}
    found: dict[str, object] = _rounded({
        "truth": truth, "groups": groups, "wholes": wholes, "paths": ways, "responses": measured,
    })  # fmt: skip
    return found


def fit(runs: Iterable[Experiment], cache: Path, jobs: int) -> Fitted:
    """Each run as one segment, and all together. Raises OSError, LogError, CannotFit; ValueError where a run
    told nothing."""
    opened = [experiments.opened(run, cache) for run in runs]
    given = [(number, *experiments.FITTED_S) for number in range(1, len(opened) + 1)]
    fitted = fit_all(choose(opened, given), jobs=jobs, cache=cache)
    if len(fitted.told) < len(opened):
        raise ValueError(f"of {len(opened)} runs only {len(fitted.told)} told anything")
    return fitted


def group(fitted: Fitted, cache: Path) -> dict[str, object]:
    """Replicates: the six of each subset, and how every subset predicts every run."""
    number = {wanted.id: k for k, wanted in enumerate(fitted.wanted)}
    answer, rows = as_json(fitted), []
    for subset in hold_out(fitted, cache):
        chosen = [number[id] for id in subset.fitted]
        row: dict[str, object] = {"runs": [k + 1 for k in chosen]}
        if len(chosen) == 1:
            row |= _six(answer["runs"][chosen[0]])
        elif chosen:
            row |= _joint(fitted, chosen)
        rows.append(row | {"cells": [_errors(cell) for cell in subset.cells]})
    return {"subsets": rows}


def frequency_response(fitted: Fitted) -> dict[str, object]:
    """Of the first run: yaw rates over the wheel angle, dB and degrees, with bands; and of the models. Raises
    ValueError where nothing was measured."""
    first = next(iter(responses(fitted).values()))
    if first.reason:
        raise ValueError(first.reason)
    found = drawn(plain(first))
    return {"hz": found["hz"], "outputs": found["outputs"][:2]}


def by_truth(run: Experiment, fitted: Fitted, cache: Path) -> dict[str, object]:
    """How what is true of these runs, which are of one rig, predicts each."""
    machine = fitted.wanted[0].run.machine
    point = true_point(machine, setting_of(machine, run.seed, 1.0, run.scenario))
    runs = [predictable(fitted, k, cache) for k in range(len(fitted.wanted))]
    (_, predicted) = held_out.table(machine, runs, {("truth",): point})
    return {"by_truth": [_errors(cell) for cell in predicted.cells]}


def _joint(fitted: Fitted, chosen: Sequence[int] | None = None) -> dict[str, object]:
    """The six of some of the segments together, of all if None, and whether they agree."""
    assert fitted.linearised is not None
    joint = join(fitted.wanted[0].run.machine, fitted.linearised, chosen)
    answer = as_json(replace(fitted, joint=joint))
    return _six(answer["joint"]) | {"p": joint.agreement.p}


def _six(answer: RunAnswer | JointAnswer | None) -> dict[str, object]:
    """Values and sds of PARAMETERS, N/rad and m; None where one is not estimated."""
    assert answer is not None
    rows = [answer["parameters"][name] for name in PARAMETERS]
    return {"values": [row["value"] for row in rows], "sds": [row["sd"] for row in rows]}


def _errors(cell: Cell) -> list[float]:
    """Root mean square distances of tractor and implement, m."""
    return [cell.tractor_m, cell.implement_m]


def whole(plant: str, field: str, cache: Path, jobs: int) -> dict[str, object]:
    """All nine runs of a field as one; and what its step runs predict of the other manoeuvres."""
    runs = [Experiment(plant, field, *row) for row in product(MANOEUVRES, REPLICATES)]
    fitted = fit(runs, cache, jobs)
    assert fitted.linearised is not None
    steps = [k for k, run in enumerate(runs) if run.manoeuvre == "steps"]
    mean = join(fitted.wanted[0].run.machine, fitted.linearised, steps).mean
    others = [k for k in range(len(runs)) if k not in steps]
    (_, predicted) = held_out.table(
        fitted.wanted[0].run.machine,
        [predictable(fitted, k, cache) for k in others],
        {tuple(fitted.wanted[k].id for k in steps): mean},
    )
    return {**_joint(fitted), "steps_predict": [_errors(cell) for cell in predicted.cells]}


def predictable(fitted: Fitted, k: int, cache: Path) -> Predictable:
    """A run as the table of predictions takes it. Raises ValueError where it is too short."""
    driven = driven_of(fitted.wanted[k], cache)
    made = held_out.predictable(
        fitted.wanted[k].run.machine, fitted.wanted[k].id, driven, fitted.fits[k].mean
    )
    if made is None:
        raise ValueError(f"{fitted.wanted[k].id} is too short to be predicted")
    return made


def paths(fitted: Fitted, cache: Path) -> dict[str, object]:
    """Of the step run N3, which was not fitted: north and east of either body as measured, and as predicted
    by the machine file's parameters, by those of N2, and by those of N1 and N2; m, every PATH_EVERY_S."""
    assert fitted.linearised is not None
    machine = fitted.wanted[0].run.machine
    run = predictable(fitted, 2, cache)
    means = {
        "initial": unknowns.prior(machine)[0],
        "N2": fitted.fits[1].mean,
        "N1+N2": join(machine, fitted.linearised, [0, 1]).mean,
    }
    ways = {name: held_out.way(machine, run, mean) for name, mean in means.items()}
    return {
        body: {
            "measured": _thinned(ways["initial"][k][:, [0, 1, 2]]),
            **{name: _thinned(way[k][:, [0, 3, 4]]) for name, way in ways.items()},
        }
        for k, body in enumerate(("tractor", "implement"))
    }


def _thinned(way: Array) -> list[list[float]]:
    """[north, east] to a centimetre, from the first place on."""
    kept = np.flatnonzero(np.diff(way[:, 0] // PATH_EVERY_S, prepend=-1.0))
    return [[round(float(x), 2) for x in row] for row in way[kept, 1:]]


def _rounded(value: Any) -> Any:
    """Floats to DIGITS digits."""
    if isinstance(value, dict):
        return {key: _rounded(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [_rounded(inner) for inner in value]
    if isinstance(value, float) and math.isfinite(value):
        return float(f"{value:.{DIGITS}g}")
    return value


def as_text(found: dict[str, Any]) -> str:
    """JSON with a line for each row, so that a change shows which number it is."""
    parts = []
    for key, rows in found.items():
        if isinstance(rows, dict):
            parts.append(f" {json.dumps(key)}: {json.dumps(rows)}")
            continue
        lines = ",\n".join(f"  {_row(row)}" for row in rows)
        parts.append(f" {json.dumps(key)}: [\n{lines}\n ]")
    return "{\n" + ",\n".join(parts) + "\n}\n"


def _row(row: dict[str, Any]) -> str:
    if "subsets" not in row:
        return json.dumps(row)
    head = {key: value for key, value in row.items() if key != "subsets"}
    subsets = ",\n".join(f"    {json.dumps(subset)}" for subset in row["subsets"])
    return f'{json.dumps(head)[:-1]}, "subsets": [\n{subsets}\n   ]}}'


def main(arguments: Sequence[str] | None = None) -> None:
    """Write the file beside this module, or into the folder given."""
    parser = argparse.ArgumentParser(description="The numbers of chapter 7 from logs")
    parser.add_argument("--to", type=Path, default=FILE.parent, metavar="FOLDER")
    parser.add_argument("--cache", type=Path, default=cache_folder() / "chapter7", metavar="FOLDER")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="processes (2)")
    given = parser.parse_args(arguments)
    text = as_text(numbers(given.cache, given.jobs))
    given.to.mkdir(parents=True, exist_ok=True)
    (given.to / FILE.name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
