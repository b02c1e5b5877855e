"""A season of simulated days: how fast it is identified, and whether the intervals of its stretches hold.

    python bench/season.py make FOLDER [--hours 6] [--minutes 10] [--tractors N] [--processes 1]
    python bench/season.py run FOLDER [--workers 1 2] [--dask]
    python bench/season.py held OUT

`make` writes logs with the rig's own frames alone into FOLDER, a file for each day, the truth beside it; what
is there is not made again. A tractor of the virtual fleet pulls three implements, empty and full, on six
fields: 36 days, and then the same in another order. Each day it drives rows and headlands on a field whose
patches stay, on soil that is all day a little softer or firmer than usual. With --tractors so many others
drive in turn, a day each, since errors of one tractor's file are the same in all of its days. Keep FOLDER
outside of the repository.

`run` identifies it anew with so many workers in turn, into a folder that is removed afterwards, and once more
with nothing to do. `held` counts, of the season OUT that `tilth season FOLDER --out OUT` has made, in how
many stretches the true value lies within 95 %: of what the stretch tells alone, of what was known by then,
and of what the whole season says; and for each implement and load. The truth of a stretch is the mean of the
logarithm under each axle over its time.
"""

import argparse
import csv
import json
import math
import multiprocessing
import resource
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.schemas.flow import PARAMETERS, Mount
from tilth.schemas.machine_toml import parse_machine
from tilth.schemas.spread import WITHIN
from tilth.simulator.fleet import MOST_TOWED, FleetRig, drawn, headlands_of, loads_of, scenario_of
from tilth.simulator.fleet_files import owners_text, true_machine
from tilth.simulator.scenario import ORIGIN_DEG, Fieldwork, Ground, Parameter, Scenario, Soil, as_json
from tilth.simulator.simulate import SimulationInput, simulate_to

Array = NDArray[np.float64]
DAY_NS: Final = 86_400_000_000_000
DAY_SD: Final = 0.15  # of the logarithm of a day's stiffnesses
FIRST_RIG: Final = 700  # of the fleet; none that constants were chosen on
OTHERS_FIRST, OTHERS_STEP = 720, 10  # rigs of --tractors
IMPLEMENTS, LOADS, FIELDS = 3, 2, 6
EMPTY: Final = 0.45  # of an implement's full mass
STIFFNESSES: Final[tuple[Parameter, ...]] = ("C_af", "C_ar", "C_ai")


def rig_of(implement: int, full: bool, first: int = FIRST_RIG) -> FleetRig:
    """The tractor with one of the implements. Stiffness goes with load as the rig's tyres have it."""
    tractor, other = drawn(first), drawn(first + implement)
    share = 1.0 if full else EMPTY
    cart = other.implement
    share *= min(cart.full_mass, MOST_TOWED * tractor.tractor.mass) / cart.mass
    cart = cart._replace(mass=cart.mass * share, yaw_inertia=cart.yaw_inertia * share, fill=float(full))
    loads = loads_of(tractor.tractor, cart)
    tyres, parameters = [], dict(tractor.parameters)
    for k, before in enumerate((*tractor.tyres[:2], other.tyres[2])):
        ratio = loads[k] / before.load
        tyres.append(before._replace(load=loads[k], deflection=before.deflection * ratio))
        of = tractor if k < 2 else other
        parameters[STIFFNESSES[k]] = of.parameters[STIFFNESSES[k]] * ratio**tractor.load_exponent
    parameters["sigma_i"] = other.parameters["sigma_i"]
    places = {m: (tractor if m.body == "tractor" else other).places[m] for m in Mount}
    return replace(
        tractor, seed=first + 10 * implement + full, implement=cart, parameters=parameters, places=places,
        tyres=(tyres[0], tyres[1], tyres[2]),
    )  # fmt: skip


def day_of(day: int, first: int = FIRST_RIG) -> tuple[FleetRig, int]:
    """The rig of a day, and the number of its field. first: the tractor's number in the fleet."""
    days = IMPLEMENTS * LOADS * FIELDS
    order = np.random.default_rng([56, day // days]).permutation(days)
    rest, field = divmod(int(order[day % days]), FIELDS)
    return rig_of(rest // LOADS, bool(rest % LOADS), first), field


def scenario_for(rig: FleetRig, field: int, day: int, minutes: float) -> Scenario:
    """Fieldwork of one day."""
    of_field, rng = np.random.default_rng([57, field]), np.random.default_rng([56, 0, day])
    latitude, longitude = ORIGIN_DEG
    length, slope = float(of_field.uniform(100, 200)), float(of_field.uniform(0, 3))
    plain = scenario_of(
        rig,
        Scenario(
            seconds=60.0 * minutes, speed=float(rng.uniform(2.5, 4.0)), speed_sd=0.1, other_traffic=False,
            steering=Fieldwork(length=length, turns=headlands_of(rig)),
            ground=Ground(slope_deg=slope, roll_sd_deg=0.6, force_sd=0.01, rut=True),
            soil=Soil(patch_log_sd=0.1, patch_length=40.0, patch_seed=field), clock_offset_s=0.0,
            utc_start_ns=Scenario().utc_start_ns + day * DAY_NS,
            origin_deg=(latitude + 0.02 * field, longitude),
        ),
    )  # fmt: skip
    factor = math.exp(DAY_SD * float(rng.standard_normal()))
    usual = plain.soil.parameters
    assert usual is not None
    of_day = {name: value * (factor if name.startswith("C_") else 1.0) for name, value in usual.items()}
    return replace(plain, soil=replace(plain.soil, parameters=of_day))


def made(task: tuple[Path, int, float, int]) -> None:
    """Write one log, unless it is there."""
    folder, day, minutes, first = task
    log = folder / f"day{day:03d}.mcap"
    if log.exists():
        return
    folder.mkdir(parents=True, exist_ok=True)
    rig, field = day_of(day, first)
    scenario, text = scenario_for(rig, field, day, minutes), owners_text(rig)
    load = "full" if rig.implement.fill else "empty"
    text = text.replace(f"fleet-{rig.seed}", f"fleet-{first}")
    text = text.replace("[implement]", f'[implement]\nname = "{rig.implement.kind}-{load}"', 1)
    source = SimulationInput(
        parse_machine(text),
        text,
        scenario,
        as_json(scenario),
        56_000 + day,
        scenario.seconds,
        true_machine(rig),
    )
    simulate_to(source, log)
    print(log, f"rig {rig.seed}, field {field}", flush=True)


def make(folder: Path, hours: float, minutes: float, tractors: int, processes: int) -> None:
    numbers = [OTHERS_FIRST + OTHERS_STEP * k for k in range(tractors)] or [FIRST_RIG]
    days = range(round(60.0 * hours / minutes))
    tasks = [(folder, day, minutes, numbers[day % len(numbers)]) for day in days]
    with multiprocessing.get_context("spawn").Pool(processes) as pool:
        pool.map(made, tasks, chunksize=1)


def identify(folder: Path, out: Path, *by: str) -> tuple[float, float, float]:
    """(seconds by the clock, of the processor, MB of the largest process), all processes of the command.
    by: who computes."""
    words = ["season", str(folder), "--out", str(out), *by, "--json"]
    start = "import sys; from tilth.cli import main; sys.exit(main())"
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run([sys.executable, "-c", start, *words], check=True, stdout=subprocess.DEVNULL)
    took, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return took, cpu, after.ru_maxrss / 1e3


def run(folder: Path, numbers: list[int], dask: bool) -> None:
    with tempfile.TemporaryDirectory(dir=folder.parent) as beside, ExitStack() as stack:
        ways = [(f"{n} workers", ("--workers", str(n))) for n in numbers]
        if dask:
            from distributed import LocalCluster

            cluster = LocalCluster(
                n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address="127.0.0.1:0"
            )  # type: ignore[no-untyped-call]
            stack.enter_context(cluster)
            by_dask = ("--dask", cluster.scheduler_address)
            ways.append(("2 workers of Dask, whose processors are not counted", by_dask))
        tables = set()
        for name, by in ways:
            out = Path(beside) / name.split(",")[0]
            took, cpu, megabytes = identify(folder, out, *by)
            hours = json.loads((out / "season.json").read_text())["seconds"] / 3600
            again, _, _ = identify(folder, out, *by)
            print(
                f"{name}: {hours:.2f} h of driving in {took:.0f} s, {cpu:.0f} s of the processor: "
                f"{3600 * hours / cpu:.1f} × real time a core, {3600 * hours / took:.1f} × by the clock; "
                f"largest process {megabytes:.0f} MB; once more with nothing to do {again:.1f} s; "
                f"{sum(file.stat().st_size for file in out.rglob('*') if file.is_file()) / 1e6:.1f} MB kept",
                flush=True,
            )
            tables.add((out / "stretches.parquet").read_bytes())
        print("the tables are the same bytes" if len(tables) == 1 else "THE TABLES DIFFER")


def truth_of(log: Path) -> tuple[Array, Array]:
    """(t_ns (n,), logarithms of the six under their axles (n, 6))."""
    with log.with_name(log.name + ".truth.csv").open() as stream:
        rows = csv.reader(stream)
        head = next(rows)
        at = [head.index(name) for name in ("t_ns", *PARAMETERS)]
        values = [[float(row[k]) for k in at] for k_row, row in enumerate(rows) if k_row % 10 == 0]
    table = np.array(values)
    return table[:, 0], np.log(table[:, 1:])


def held(out: Path) -> None:
    import pyarrow.compute as pc
    import pyarrow.parquet as pq

    table = pq.read_table(out / "stretches.parquet").filter(pc.field("kind") == "stretch")
    lasts = (table["end_utc"].to_numpy() - table["begin_utc"].to_numpy()).astype(np.float64)  # turns too, ns
    rows = table.to_pylist()
    truths: dict[str, tuple[Array, Array]] = {}
    scores: dict[tuple[str, str], list[float]] = {}
    by_implement: dict[str, dict[str, list[float]]] = {}
    for row, lasts_ns in zip(rows, lasts.tolist(), strict=True):
        if row["status"] != "estimated":
            continue
        if row["log"] not in truths:
            truths[row["log"]] = truth_of(Path(row["log"]))
        t_ns, logs = truths[row["log"]]
        begin = row["begin_ns"]
        true = logs[(t_ns >= begin) & (t_ns <= begin + lasts_ns)].mean(axis=0)
        for way in ("alone", "forward", "season"):
            covariance = np.array(row[f"{way}_log_covariance"]).reshape(6, 6)
            for k, name in enumerate(PARAMETERS):
                if row[name] is not None:
                    off = math.log(row[f"{way}_{name}"]) - true[k]
                    scores.setdefault((way, name), []).append(off / math.sqrt(covariance[k, k]))
                    scores.setdefault((f"{way} sd", name), []).append(math.sqrt(covariance[k, k]))
                    of = by_implement.setdefault(row["implement"], {}).setdefault(f"{way} {name}", [])
                    of.append(scores[way, name][-1])
    print(f"{len(rows)} stretches, {sum(row['status'] == 'estimated' for row in rows)} with numbers")
    for way in ("alone", "forward", "season"):
        cells = [
            f"{name} {100 * np.mean(np.abs(z) <= WITHIN):.0f} % of {len(z)} (median sd "
            f"{100 * np.median(scores[f'{way} sd', name]):.0f} %, error over sd {np.sqrt(np.mean(z**2)):.2f})"
            for name in PARAMETERS
            if (z := np.array(scores.get((way, name), []))).size
        ]
        every = np.concatenate([np.array(scores.get((way, name), [])) for name in PARAMETERS])
        print(f"{way}: {100 * np.mean(np.abs(every) <= WITHIN):.1f} % of {len(every)}; " + ", ".join(cells))
    for implement, of_one in sorted(by_implement.items()):
        told = (f"{what} {np.sum(np.abs(z) <= WITHIN)} of {len(z)}" for what, z in of_one.items())
        print(f"{implement}: " + ", ".join(told))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    ways = parser.add_subparsers(dest="what", required=True)
    making = ways.add_parser("make")
    making.add_argument("folder", type=Path)
    making.add_argument("--hours", type=float, default=6.0)
    making.add_argument("--minutes", type=float, default=10.0, help="of a day")
    making.add_argument("--tractors", type=int, default=0, help="so many others instead, in turn")
    making.add_argument("--processes", type=int, default=1)
    running = ways.add_parser("run")
    running.add_argument("folder", type=Path)
    running.add_argument("--workers", type=int, nargs="+", default=[1, 2])
    running.add_argument("--dask", action="store_true", help="and by a Dask cluster of this computer")
    ways.add_parser("held").add_argument("out", type=Path)
    args = parser.parse_args()
    if args.what == "make":
        make(args.folder, args.hours, args.minutes, args.tractors, args.processes)
    elif args.what == "run":
        run(args.folder, args.workers, args.dask)
    else:
        held(args.out)


if __name__ == "__main__":
    main()
