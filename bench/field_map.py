"""What is a map of the field worth in the cab? Seconds after a headland until the tyres are known to 5 %.

    python bench/field_map.py [--count 4] [--first 60] [--minutes 6] [--one-soil]

Each field of bench/patches.py is driven twice, a day apart, on soil that is all day a little softer or firmer
(10 %). Of the first day the memory by place is kept, as `tilth map` writes it. The second day is followed
twice: without anything of the first, and with its map ([estimation] field_map). Counted from when the rig is
back in a row after a headland to the first instant at which what was published for C_af, C_ar and C_ai is
within the limit of what is under each axle, or to the next headland.
"""

import argparse
import math
from dataclasses import replace
from typing import Final, get_args

import numpy as np
from estimation_study import Driven, followed
from numpy.typing import NDArray
from patches import TURNED, scenario_for

from tilth.estimator import fold
from tilth.estimator.models.nonlinear import STATES
from tilth.estimator.warm_start import SavedPosterior, save_learned
from tilth.schemas.flow import Estimate
from tilth.schemas.machine import Machine
from tilth.schemas.spread import WITHIN
from tilth.simulator.drive import drive
from tilth.simulator.packaged import packaged_file
from tilth.simulator.scenario import STEP_S, Parameter

Array = NDArray[np.float64]
DAY_S: Final = 86_400.0
DAY_SD: Final = 0.1  # of the logarithm of a day's stiffnesses
LIMITS: Final = (0.05, 0.10)
METHODS: Final = ("tracker", "place", "recommended")
PSI: Final = list(STATES).index("psi_t")


def day(machine: Machine, k: int, number: int, minutes: float, one_soil: bool) -> Driven:
    """Day number 0 or 1 on field k."""
    asked = scenario_for(k, minutes, one_soil)
    asked = replace(asked, rig_seed=k, soil=replace(asked.soil, patch_seed=k))
    usual = drive(machine, k, 1.0, asked).parameters
    factor = math.exp(DAY_SD * float(np.random.default_rng([58, k, number]).standard_normal()))
    of_day: dict[Parameter, float] = {
        name: usual[name] * (factor if name.startswith("C_") else 1.0) for name in get_args(Parameter)
    }
    asked = replace(asked, soil=replace(asked.soil, parameters=of_day))
    return Driven(machine, drive(machine, 1000 * number + k, asked.seconds, asked), machine)


def map_of(run: Driven) -> SavedPosterior:
    """The memory by place at the end of a day."""
    states: list[fold.State] = []

    def hear(state: fold.State, estimate: Estimate) -> None:
        states[:] = [state]

    followed(run, hear)
    state = states[0]
    return save_learned(state.machine, state.estimators, state.latest_ns)["place"]


def told(run: Driven, field_map: SavedPosterior | None) -> dict[str, Array]:
    """Method -> (m, 8): time, whether after the last headland, logarithms less the truth and sds of C."""
    machine = run.machine
    if field_map is not None:
        estimation = machine.estimation.model_copy(update={"field_map": "of the field"})
        machine = machine.model_copy(update={"estimation": estimation})
    state = fold.initial(machine)
    if field_map is not None:
        assert fold.use_map(state, field_map, DAY_S, run.truth.scenario.utc_start_ns) is None
    series = followed(replace(run, machine=machine), state=state).series
    found = {}
    for method in METHODS:
        rows = series.get(method, np.zeros((0, 14)))
        at = np.clip((rows[:, 0] / STEP_S).round().astype(np.int64), 0, len(run.truth.soil) - 1)
        off = rows[:, 1:4] - np.log(run.truth.soil[at, :3])
        found[method] = np.column_stack([rows[:, 0], off, rows[:, 7:10]])
    return found


def headlands(run: Driven) -> list[tuple[float, float]]:
    """When the rig is back in a row, and when that ends, s."""
    turning = np.abs(np.sin(run.truth.states[:, PSI])) > math.sin(TURNED)
    begins = np.flatnonzero(turning[:-1] & ~turning[1:]) + 1
    ends = np.flatnonzero(~turning[:-1] & turning[1:]) + 1
    return [
        (b * STEP_S, float(min(ends[ends > b], default=len(turning))) * STEP_S)
        for b in begins.tolist()
        if min(ends[ends > b], default=len(turning)) - b > 500
    ]


def line(name: str, found: list[tuple[Array, float, float]]) -> str:
    """found: of each headland what was told, and when the row began and ended."""
    cells = []
    for limit in LIMITS:
        waits = []
        for rows, begin, end in found:
            within = rows[(rows[:, 0] >= begin) & (rows[:, 0] < end)]
            good = within[np.all(np.abs(within[:, 1:4]) <= limit, axis=1), 0]
            waits.append(good[0] - begin if len(good) else math.inf)
        reached = [wait for wait in waits if math.isfinite(wait)]
        median = float(np.median(waits))
        cells.append(f"{100 * limit:.0f} % in {len(reached)} of {len(waits)}, median {median:.1f} s")
    rows = np.concatenate([r[(r[:, 0] >= b) & (r[:, 0] < e)] for r, b, e in found])
    has = np.isfinite(rows[:, 1:4])
    error = np.nanmedian(np.abs(rows[:, 1:4]), axis=0) if has.any() else np.full(3, math.nan)
    inside = np.abs(rows[:, 1:4]) <= WITHIN * rows[:, 4:7]
    held = inside.sum() / max(int(has.sum()), 1)
    words = " ".join(f"{100 * each:.0f}" for each in error)
    given = f"numbers {100 * has.mean():.0f} % of the time, of which {100 * held:.0f} % hold"
    return f"{name}: {'; '.join(cells)}; median error {words} %; {given}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--count", type=int, default=4, help="fields")
    parser.add_argument("--first", type=int, default=60, help="number of the first")
    parser.add_argument("--minutes", type=float, default=6.0, help="of each day")
    parser.add_argument("--one-soil", action="store_true", help="without patches and wet end")
    args = parser.parse_args()
    machine = packaged_file().machine
    ways: dict[str, list[tuple[Array, float, float]]] = {}
    for k in range(args.first, args.first + args.count):
        first, later = (day(machine, k, number, args.minutes, args.one_soil) for number in (0, 1))
        of_field = map_of(first)
        for way, field_map in (("without", None), ("with", of_field)):
            found = told(later, field_map)
            for method in METHODS:
                of_method = ways.setdefault(f"{method}, {way}", [])
                of_method += [(found[method], *row) for row in headlands(later)]
        print(f"field {k}: {len(headlands(later))} headlands", flush=True)
        for name, each in sorted(ways.items()):
            print("   ", line(name, each), flush=True)


if __name__ == "__main__":
    main()
