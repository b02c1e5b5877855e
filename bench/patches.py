"""Does an interval hold at the place where it was published? Fields in patches with a wet end, drawn anew.

    python bench/patches.py [--count 8] [--first 0] [--minutes 12] [--processes 1]
                            [--keep patches.jsonl] [--summary]

Drive k is of field k by `scenario_for`: patches of 20 to 60 m with an sd of 10 to 30 %, whose lengths along
and across and whose correlation between axles differ, and an end that is 30 to 50 % softer; rows in order, in
every other field beside a skipped one. The truth is what is under each axle at the instant of the estimate.
It is counted over passes and stretches of the patches' length: the seconds in one stretch count once
together. Rows and turns apart; median errors from the third pass on.
"""

import math
import time
from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any, Final

import estimation_runs
import numpy as np
import spatial_rows
from estimation_study import Driven, followed
from estimation_table import Bench, Line, Row, Z, drives_asked, drives_parser, percents, print_rows
from numpy.typing import NDArray

from tilth.estimator.models.nonlinear import STATES
from tilth.simulator.drive import drive
from tilth.simulator.scenario import (
    STEP_S,
    Autosteer,
    Fieldwork,
    Ground,
    HeadlandTurn,
    Scenario,
    Soil,
    SoilChange,
)

Array = NDArray[np.float64]
Result = dict[str, Any]
"""Of `follow`: one line of JSON."""

NAME: Final = "patches"
METHODS: Final = ("place", "pem", "recommended")
WHERE: Final = ("rows", "turns")
HOLD: Final = 0.92
ERROR: Final = 0.15  # median, of C, from the third pass on
TURNED: Final = math.radians(20.0)  # from the direction of the rows
RUNNING_IN: Final = 2  # passes
AT: Final = {name: k for k, name in enumerate(STATES)}


def scenario_for(k: int, minutes: float) -> Scenario:
    """Field k."""
    rng = np.random.default_rng([53, k])
    length, patch = rng.uniform(100.0, 180.0), rng.uniform(20.0, 60.0)
    wet = 1.0 - rng.uniform(0.3, 0.5)
    end = SoilChange(
        north=rng.uniform(0.6, 0.8) * length, east=0.0, towards_deg=rng.uniform(-30.0, 30.0), over=20.0,
        C_af=wet, C_ar=wet, C_ai=wet * rng.uniform(0.9, 1.1),
    )  # fmt: skip
    soil = Soil(
        grip=0.7, rolling=0.06, changes=(end,), patch_log_sd=rng.uniform(0.1, 0.3), patch_length=patch,
        patch_across=rng.uniform(0.5, 2.0), patch_common=rng.uniform(0.3, 1.0),
    )  # fmt: skip
    steered = Autosteer("pid") if k % 4 >= 2 else None
    turn = HeadlandTurn((6.1, 12.2)[k % 2], 6.0)
    return Scenario(
        seconds=60.0 * minutes, speed=rng.uniform(2.8, 4.2),
        steering=Fieldwork(length=length, turns=(turn,), autosteer=steered),
        ground=Ground(slope_deg=rng.uniform(0.0, 3.0), roll_sd_deg=0.5, force_sd=0.008, rut=True), soil=soil,
        other_traffic=False,
    )  # fmt: skip


def follow(first: int, minutes: float, k: int) -> Result:
    """Field number first + k: what was published in it, beside the truth."""
    began, asked = time.perf_counter(), scenario_for(first + k, minutes)
    machine = estimation_runs.machine()
    truth = drive(machine, first + k, asked.seconds, asked)
    heard = followed(Driven(machine, truth, machine))
    psi, north = truth.states[:, AT["psi_t"]], truth.states[:, AT["x_t"]]
    passes = np.cumsum(np.abs(np.diff(np.cos(psi) > 0.0, prepend=np.cos(psi[0]) > 0.0)))
    methods = {}
    for method in METHODS:
        told = heard.series.get(method, np.zeros((0, 13)))
        at = np.clip((told[:, 0] / STEP_S).round().astype(np.int64), 0, len(psi) - 1)
        methods[method] = {
            "error": (told[:, 1:7] - np.log(truth.soil[at])).tolist(),
            "sd": told[:, 7:13].tolist(),
            "turn": (np.abs(np.sin(psi[at])) > math.sin(TURNED)).tolist(),
            "pass": passes[at].tolist(),
            "stretch": np.floor(north[at] / asked.soil.patch_length).tolist(),
        }
    return {
        "row": NAME, "seed": k, "first": first, "scale": minutes, "field": first + k, "methods": methods,
        "patch_m": asked.soil.patch_length, "patch_sd": asked.soil.patch_log_sd,
        "took_s": time.perf_counter() - began,
    }  # fmt: skip


def row(first: int, bench: Bench) -> list[Line]:
    """The lines of the table; fields that a file has are not driven again."""
    have = spatial_rows.kept(bench, NAME, first)
    made = bench.each(partial(follow, first, bench.scale), 8, have, partial(spatial_rows.keep, bench))
    return lines_of(made)


def lines_of(made: Sequence[Result]) -> list[Line]:
    return [
        line for method in METHODS for k, where in enumerate(WHERE) for line in _lines(made, method, where, k)
    ]


def _lines(made: Sequence[Result], method: str, where: str, turn: int) -> Iterator[Line]:
    held, errors, sds = list[Array](), list[Array](), list[Array]()
    for one in made:
        told = one["methods"][method]
        if not told["error"]:
            continue
        error, sd = (np.array(told[key], dtype=np.float64) for key in ("error", "sd"))
        passes, of_turn = np.array(told["pass"]), np.array(told["turn"]) == bool(turn)
        cells = np.column_stack([passes, np.array(told["stretch"])])
        for cell in np.unique(cells[of_turn], axis=0):
            inside = of_turn & np.all(cells == cell, axis=1)
            given = np.isfinite(error[inside])
            share = np.sum(np.abs(error[inside]) < Z * sd[inside], axis=0) / np.maximum(given.sum(axis=0), 1)
            held.append(np.where(given.any(axis=0), share, math.nan))
        later = of_turn & (passes >= RUNNING_IN)
        errors.append(np.abs(error[later]))
        sds.append(sd[later])
    if not held or np.all(np.isnan(held)):
        yield Line(f"{method}, {where}", "no number was given")
        return
    shares = np.nanmean(held, axis=0)
    judged = method == "place"
    cells_given = int(np.isfinite(held).any(axis=1).sum())
    yield Line(
        f"{method}, {where}: 95 % intervals hold, {cells_given} stretches", percents(shares, 0), "≥ 92 %",
        bool(np.all(shares >= HOLD)) if judged else None, shares.tolist(),
    )  # fmt: skip
    error, sd = (np.nanmedian(np.concatenate(each), axis=0) for each in (errors, sds))
    yield Line(
        f"{method}, {where}: median |error| from the third pass", percents(error, 0), "C ≤ 15 %",
        bool(np.all(error[:3] <= ERROR)) if judged else None, error.tolist(),
    )  # fmt: skip
    yield Line(f"{method}, {where}: median sd", percents(sd, 0), values=sd.tolist())


def main() -> None:
    parser = drives_parser(__doc__, 8, "patches.jsonl", "fields")
    parser.add_argument("--minutes", type=float, default=12.0, help="of each drive")
    args = drives_asked(parser)
    print_rows(args, [Row(NAME, "≥ 92 % hold", partial(row, args.first))], args.minutes, 150)


if __name__ == "__main__":
    main()
