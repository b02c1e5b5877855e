"""Does a map say something true? Simulated fields, driven, identified and mapped as a user does.

    python bench/map_truth.py FOLDER [--count 2] [--first 0] [--minutes 20] [--autosteer pid]

Field k has two soils, with all stiffnesses 45 % lower beyond a line, which lies along the rows in even fields
and across them in odd ones, and a wet hollow, a strip of 40 m across the rows where they are 40 % lower. The
same drive on one soil is its twin. In the rows a regulator steers that only answers the ground, so they tell
nothing, or an autosteer. Counted are numbers of cells whose 95 % interval has the truth of the
middle of the cell, and how far the map's boundary of the two soils is from the true one. Logs and seasons
are kept in FOLDER; what is there is not made again.
"""

import argparse
import math
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from season import FIRST_RIG, identify, rig_of, scenario_for

from tilth.analysis.season.field_map import MappedField, fields_of, mapped
from tilth.analysis.season.kept_table import MapProblem, stretches_of
from tilth.estimator.pose.geometry import to_degrees, to_plane
from tilth.schemas.machine_toml import parse_machine
from tilth.schemas.spread import WITHIN
from tilth.simulator.fleet_files import owners_text, true_machine
from tilth.simulator.ground import share
from tilth.simulator.scenario import Autosteer, Fieldwork, Parameter, Scenario, SoilChange, as_json
from tilth.simulator.simulate import SimulationInput, simulate_to

Array = NDArray[np.float64]
FIRM: Final = 0.55  # of the stiffnesses of the other soil
WET: Final = 0.6
C: Final[tuple[Parameter, ...]] = ("C_af", "C_ar", "C_ai")
BESIDE_M: Final = 40.0  # from the boundary, along which it is looked for
STEP_M: Final = 0.5  # to which the true one is found


def changes(k: int) -> tuple[SoilChange, ...]:
    """Two soils and a wet hollow. Rows run to north, each next one to the east."""
    across, wet, dry = (dict.fromkeys(C, factor) for factor in (FIRM, WET, 1.0 / WET))
    towards = 90.0 if k % 2 == 0 else 0.0
    return (
        SoilChange(north=110.0, east=45.0, towards_deg=towards, over=2.0, **across),
        SoilChange(north=35.0, east=0.0, over=10.0, **wet),
        SoilChange(north=75.0, east=0.0, over=10.0, **dry),
    )


def made(
    folder: Path, k: int, minutes: float, one_soil: bool, autosteer: Any = None
) -> tuple[Path, Scenario]:
    """A folder with the log of a drive, and its scenario."""
    rig = rig_of(0, True)
    asked = scenario_for(rig, k, k, minutes)
    soil = replace(asked.soil, patch_log_sd=0.0, patch_seed=None, changes=() if one_soil else changes(k))
    assert isinstance(asked.steering, Fieldwork)
    steering = replace(asked.steering, length=140.0, autosteer=Autosteer(autosteer) if autosteer else None)
    scenario = replace(asked, soil=soil, steering=steering)
    logs = folder / "-".join([f"field{k}", *filter(None, [autosteer, "one" if one_soil else ""])])
    log = logs / "day.mcap"
    if not log.exists():
        logs.mkdir(parents=True, exist_ok=True)
        text = owners_text(rig).replace(f"fleet-{rig.seed}", f"fleet-{FIRST_RIG}")
        true = true_machine(rig)
        source = SimulationInput(
            parse_machine(text), text, scenario, as_json(scenario), 57_000 + k, scenario.seconds, true
        )
        simulate_to(source, log)
    return logs, scenario


def truth_at(scenario: Scenario, found: MappedField, places: Array) -> Array:
    """Logarithms of the stiffnesses at places, (n, 2), of the map's plane: (n, 3)."""
    usual = scenario.soil.parameters
    assert usual is not None
    moved = np.array([
        to_plane(scenario.origin_deg, *to_degrees(found.origin_deg, north, east))
        for north, east in places.tolist()
    ])  # fmt: skip
    axles = np.repeat(moved[:, None], 3, axis=1)
    log = np.tile(np.log([usual[name] for name in C]), (len(places), 1))
    for change in scenario.soil.changes:
        log += share(change, 0.0, axles) * np.log([getattr(change, name) for name in C])
    return log


def boundary_off(scenario: Scenario, found: MappedField) -> list[float]:
    """How far from the true boundary the map's is, line of cells by line of cells across it, m; inf where
    the map shows none there."""
    edge = scenario.soil.changes[0]
    axis = 1 if edge.towards_deg == 90.0 else 0  # along which it is crossed
    logs, off = found.mean.mean(axis=1), list[float]()
    for along in np.unique(found.grid[:, 1 - axis]):
        line = np.flatnonzero((found.grid[:, 1 - axis] == along) & np.isfinite(logs))
        line = line[np.argsort(found.grid[line, axis])]
        if not len(line):
            continue
        at = found.grid[line, axis] + found.cell_m / 2.0
        fine = np.full((int(np.ptp(at) / STEP_M) + 1, 2), along + found.cell_m / 2.0)
        fine[:, axis] = at[0] + STEP_M * np.arange(len(fine))
        truth = truth_at(replace(scenario, soil=replace(scenario.soil, changes=(edge,))), found, fine)[:, 0]
        inside = truth < (truth.max() + truth.min()) / 2.0
        if np.ptp(truth) < 0.5 * abs(math.log(FIRM)):
            continue
        true_at = float(fine[np.argmax(inside), axis])
        near = np.abs(at - true_at) <= BESIDE_M
        at, value = at[near], logs[line][near]
        if len(at) < 4:
            continue
        between = (value[0] + value[-1]) / 2.0
        crosses = np.flatnonzero((value[:-1] >= between) & (value[1:] < between))
        if value[0] - value[-1] < 0.3 * abs(math.log(FIRM)) or not len(crosses):
            off.append(math.inf)
            continue
        j = crosses[np.argmin(np.abs(at[crosses] - true_at))]
        part = (value[j] - between) / (value[j] - value[j + 1])
        off.append(float(at[j] + part * (at[j + 1] - at[j]) - true_at))
    return off


def told(name: str, scenario: Scenario, found: MappedField) -> str:
    true = truth_at(scenario, found, found.grid + found.cell_m / 2.0)
    off, has = found.mean - true, np.isfinite(found.mean)
    inside = (np.abs(off) <= WITHIN * found.sd)[has]
    text = (
        f"{name}: {len(found.stretches)} stretches, {len(found.grid)} cells, {has.sum()} numbers, "
        f"{100 * inside.mean():.0f} % hold, median error {100 * np.median(np.abs(off[has])):.0f} %, "
        f"sd {100 * np.median(found.sd[has]):.0f} %"
    )
    each = [np.isfinite(found.mean[:, k]) for k in range(len(C))]
    text += "; hold " + ", ".join(
        f"{name} {100 * np.mean(np.abs(off[has, k]) <= WITHIN * found.sd[has, k]):.0f} % of {has.sum()}"
        for k, (name, has) in enumerate(zip(C, each, strict=True))
    )
    spread = np.nanmax(np.abs(found.mean - np.nanmean(found.mean, axis=0)) / found.sd)
    text += f"; largest difference from its mean {spread:.1f} sd, soil changed {len(found.changed)} times"
    if scenario.soil.changes:
        edge = np.array(boundary_off(scenario, found))
        shown = np.abs(edge[np.isfinite(edge)])
        text += (
            f"; boundary shown in {len(shown)} of {len(edge)} lines, within 5 m in {np.sum(shown <= 5.0)}, "
            f"median {np.median(shown) if len(shown) else math.nan:.0f} m off"
        )
    return text


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--count", type=int, default=2, help="fields")
    parser.add_argument("--first", type=int, default=0, help="number of the first field")
    parser.add_argument("--autosteer", help="make: pid, valve, pursuit")
    parser.add_argument("--minutes", type=float, default=20.0, help="of each drive")
    args = parser.parse_args()
    for k in range(args.first, args.first + args.count):
        for one_soil in (False, True):
            logs, scenario = made(args.folder, k, args.minutes, one_soil, args.autosteer)
            out = args.folder / f"{logs.name}-season"
            identify(logs, out, "--workers", "1")
            try:
                rig: Any = stretches_of(out)
            except MapProblem as problem:
                print(f"{logs.name}: {problem}", flush=True)
                continue
            for number, of in enumerate(fields_of(rig.stretches), 1):
                print(told(logs.name, scenario, mapped(number, rig.machine, of)), flush=True)


if __name__ == "__main__":
    main()
