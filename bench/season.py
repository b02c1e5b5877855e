"""A season of simulated days: how fast it is identified, and whether the intervals of its stretches hold.

    python bench/season.py make FOLDER [--hours 2] [--minutes 10] [--rigs 2]
    python bench/season.py run FOLDER [--workers 1 2]
    python bench/season.py held FOLDER OUT

`make` writes logs with the rigs' own frames alone into FOLDER, one folder for each rig of the virtual fleet,
the truth beside each; what is there is not made again. Each day a rig drives rows and headlands on a field in
patches, on soil that is all day a little softer or firmer than usual. Keep FOLDER outside of the repository.

`run` identifies it anew with so many workers in turn, into a folder that is removed afterwards, and once more
with nothing to do. `held` counts in how many stretches the true value lies within 95 %: of what the stretch
tells alone, of what was known by then, and of what the whole season says. The truth of a stretch is the mean
of the logarithm under each axle over its time.
"""

import argparse
import math
import multiprocessing
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from tilth.schemas.machine_toml import parse_machine
from tilth.simulator.fleet import drawn, headlands_of, scenario_of
from tilth.simulator.fleet_files import owners_text, true_machine
from tilth.simulator.scenario import Fieldwork, Ground, Scenario, Soil, as_json
from tilth.simulator.simulate import SimulationInput, simulate_to

DAY_NS: Final = 86_400_000_000_000
DAY_SD: Final = 0.15  # of the logarithm of a day's stiffnesses
FIRST_RIG: Final = 700  # of the fleet; none that constants were chosen on


def scenario_for(rig_number: int, day: int, minutes: float) -> Scenario:
    """Fieldwork of one rig on one day."""
    rig, rng = drawn(FIRST_RIG + rig_number), np.random.default_rng([56, rig_number, day])
    plain = scenario_of(
        rig,
        Scenario(
            seconds=60.0 * minutes, speed=float(rng.uniform(2.5, 4.0)), speed_sd=0.1, other_traffic=False,
            steering=Fieldwork(length=float(rng.uniform(100, 200)), turns=headlands_of(rig)),
            ground=Ground(slope_deg=float(rng.uniform(0, 3)), roll_sd_deg=0.6, force_sd=0.01, rut=True),
            soil=Soil(patch_log_sd=0.1, patch_length=40.0), clock_offset_s=0.0,
            utc_start_ns=Scenario().utc_start_ns + day * DAY_NS,
        ),
    )  # fmt: skip
    factor = math.exp(DAY_SD * float(rng.standard_normal()))
    usual = plain.soil.parameters
    assert usual is not None
    of_day = {name: value * (factor if name.startswith("C_") else 1.0) for name, value in usual.items()}
    return replace(plain, soil=replace(plain.soil, parameters=of_day))


def made(task: tuple[Path, int, int, float]) -> None:
    """Write one log, unless it is there."""
    folder, rig_number, day, minutes = task
    log = folder / f"rig{rig_number}" / f"day{day:03d}.mcap"
    if log.exists():
        return
    log.parent.mkdir(parents=True, exist_ok=True)
    scenario, rig = scenario_for(rig_number, day, minutes), drawn(FIRST_RIG + rig_number)
    text = owners_text(rig)
    source = SimulationInput(
        parse_machine(text), text, scenario, as_json(scenario), 56_000 + 100 * rig_number + day,
        scenario.seconds, true_machine(rig),
    )  # fmt: skip
    simulate_to(source, log)
    print(log, flush=True)


def make(folder: Path, hours: float, minutes: float, rigs: int, processes: int) -> None:
    days = round(60.0 * hours / minutes / rigs)
    tasks = [(folder, rig, day, minutes) for day in range(days) for rig in range(rigs)]
    with multiprocessing.get_context("spawn").Pool(processes) as pool:
        pool.map(made, tasks, chunksize=1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("what", choices=("make",))
    parser.add_argument("folder", type=Path)
    parser.add_argument("--hours", type=float, default=2.0)
    parser.add_argument("--minutes", type=float, default=10.0, help="of a day")
    parser.add_argument("--rigs", type=int, default=2)
    parser.add_argument("--processes", type=int, default=1)
    args = parser.parse_args()
    make(args.folder, args.hours, args.minutes, args.rigs, args.processes)


if __name__ == "__main__":
    main()
