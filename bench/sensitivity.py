"""How fast chapter 6 of the dissertation is computed, beside what one would write, and whether it is right.

    python bench/sensitivity.py [whole] [plain] [check] [memory] [dask] [--share 1.0] [--workers 2]

whole: the 10.5 million simulations of figure 6.10, or a share of them, as `tilth sensitivity --global` does
them. plain: simulations a second beside SALib's with scipy's solve_ivp or lsim, one process each, in one run.
check: 10,000 points of the grid beside matrix exponentials and a numpy loop. memory: the most that all
processes of the command take together, at several numbers of points. dask: a Dask cluster on this computer
beside the process pool, with 1, 2 and 4 workers, each started anew, in turn; the best of each counts.

What only one row needs is imported there: each process of the pool imports this file anew.
"""

import argparse
import math
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, Final

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command does

import numpy as np
import psutil
from timing import best

from tilth.analysis.sensitivity.designs import DISSERTATION, Design, Grid, Uniform
from tilth.analysis.sensitivity.local import SHARE
from tilth.analysis.sensitivity.outputs import STEP_S, WHEEL_ANGLE
from tilth.analysis.sensitivity.run_batches import GlobalPlan, part_of, run
from tilth.analysis.workers.dask import on_dask
from tilth.analysis.workers.parts import Parts, here
from tilth.estimator.models.family import model_named
from tilth.estimator.models.parameters import TABLE_7_2
from tilth.estimator.models.step_responses import FIELDS, packed_systems, step_changes

SECONDS: Final = {1.0: 30.0, 4.5: 6.0, 7.5: 3.0}  # simulated at each speed, m/s (Karkee 2009, 6.2.2)
CHECKED: Final = {1.0: 2000, 4.5: 4000, 7.5: 4000}  # points
TOGETHER: Final = 200  # of them
PARAMETERS: Final = len(DISSERTATION.names)
MACHINE: Final = Path(__file__).parents[1] / "deploy" / "machines" / "jd7930-parker500.toml"
POLL_S: Final = 0.05


def plan_of(speed: float, design: Design) -> GlobalPlan:
    return GlobalPlan("relaxation", TABLE_7_2, speed, SECONDS[speed], design)


def seconds_of(plan: GlobalPlan, parts: Parts) -> float:
    """Of a whole run with nothing kept before."""
    with tempfile.TemporaryDirectory() as folder:
        return best(lambda: run(plan, Path(folder), parts), 1)


def whole(share: float, workers: int) -> None:
    grid = Grid(DISSERTATION)
    design = grid if share >= 1.0 else Uniform(DISSERTATION, round(share * grid.size))
    total_s, total = 0.0, 0
    before_s = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    for speed in SECONDS:
        took = seconds_of(plan_of(speed, design), here(workers))
        count = design.size * (PARAMETERS + 1)
        total_s, total = total_s + took, total + count
        print(f"{speed:g} m/s: {count:,} simulations of {SECONDS[speed]:g} s in {took:.1f} s")
    busy_s = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before_s
    print(
        f"together {total:,} in {total_s:.1f} s by {workers} processes; {busy_s:.1f} s of processors' time, "
        f"{1e6 * busy_s / total:.1f} µs each"
    )


def plain() -> None:
    from sensitivity_plain import by_salib

    print(
        f"{'simulations a second, one process':34} {'tilth':>9} {'solve_ivp':>10} {'lsim':>8} {'ratios':>12}"
    )
    for speed in SECONDS:
        plan = plan_of(speed, Uniform(DISSERTATION, 2000))
        part_of(plan, 0, 8)  # compiled
        rates = [2000 * (PARAMETERS + 1) / best(partial(part_of, plan, 0, 2000), 3)]
        for how in ("solve_ivp", "lsim"):
            start = time.perf_counter()
            count, _ = by_salib(8 if speed < 4 else 24, speed, plan.samples, how)
            rates.append(count / (time.perf_counter() - start))
        ratios = f"{rates[0] / rates[1]:.0f}, {rates[0] / rates[2]:.0f}"
        said = f"{speed:g} m/s, {SECONDS[speed]:2g} s"
        print(f"{said:34} {rates[0]:9,.0f} {rates[1]:10,.0f} {rates[2]:8,.0f}"
              f" {ratios:>12}")  # fmt: skip


def differences(speed: float, count: int, seed: int = 1) -> np.ndarray:
    """Of the compiled loop's changes from the other integrator's, as shares of the largest of each output at
    a point, (count × 8 × 6,). Points of the grid."""
    from sensitivity_plain import by_exponentials

    grid = Grid(DISSERTATION)
    columns = np.array([FIELDS.index(name) for name in DISSERTATION.names])
    rows = np.random.default_rng(seed).choice(grid.size, count, replace=False)
    samples = round(SECONDS[speed] / STEP_S)
    found = []
    for first in range(0, count, TOGETHER):
        points = np.concatenate(
            [grid.points(row, row + 1) for row in rows[first : first + TOGETHER].tolist()]
        )
        rigs = np.tile(np.array([getattr(TABLE_7_2, name) for name in FIELDS]), (len(points), 1))
        rigs[:, columns] = points
        a, b = packed_systems(model_named("relaxation"), TABLE_7_2, rigs, columns, SHARE, speed)
        ours = np.zeros((len(points), PARAMETERS, 6))
        step_changes(a, b, WHEEL_ANGLE, speed, samples, STEP_S, ours)
        theirs = by_exponentials(points, speed, samples, SHARE)
        scale = np.abs(theirs).max(axis=1, keepdims=True)
        found.append((np.abs(ours - theirs) / scale).ravel())
    return np.concatenate(found)


def check() -> None:
    for speed, count in CHECKED.items():
        apart = differences(speed, count)
        print(f"{speed:g} m/s: {count} points: apart by {apart.max():.1e} at most")


def memory(workers: int) -> None:
    for points in (10_000, 100_000, 1_000_000):
        words = ["--speed", "7.5", "--seconds", "3", "--global", "--points", str(points), "--json"]
        with tempfile.TemporaryDirectory() as folder:
            child = subprocess.Popen(
                [Path(sys.executable).with_name("tilth"), "sensitivity", MACHINE, *words,
                 "--workers", str(workers)],
                env={**os.environ, "XDG_CACHE_HOME": folder},
                stdout=subprocess.DEVNULL,
            )  # fmt: skip
            together, largest, count = 0, 0, 0
            while child.poll() is None:
                now = [_megabytes(one) for one in _family(child.pid)]
                together, largest, count = (
                    max(together, sum(now)),
                    max(largest, *now, 0),
                    max(count, len(now)),
                )
                time.sleep(POLL_S)
        print(f"{points:,} points: {together} MB in all {count} processes, {largest} MB in the largest")


def _family(pid: int) -> list[psutil.Process]:
    try:
        parent = psutil.Process(pid)
        return [parent, *parent.children(recursive=True)]
    except psutil.NoSuchProcess:
        return []


def _megabytes(process: psutil.Process) -> int:
    """What is its own, and its part of what it shares."""
    try:
        return int(process.memory_full_info().pss // 2**20)
    except (psutil.Error, FileNotFoundError):
        return 0


def with_dask(plan: GlobalPlan, workers: int) -> float:
    """On a cluster of this computer, whose workers have computed nothing before."""
    cluster_of: Any = import_module("distributed").LocalCluster
    with cluster_of(n_workers=workers, threads_per_worker=1, dashboard_address=None) as cluster:
        return seconds_of(plan, on_dask(cluster.scheduler_address))


def dask(points: int, rounds: int, counts: tuple[int, ...]) -> None:
    """Processors' time says more than the clock where a computer has other work."""
    plan = plan_of(7.5, Uniform(DISSERTATION, points))
    ways: dict[str, Callable[[GlobalPlan, int], float]] = {
        "pool": lambda plan, workers: seconds_of(plan, here(workers)),
        "Dask": with_dask,
    }
    clock = {(way, workers): math.inf for way in ways for workers in counts}
    busy = dict(clock)
    for _ in range(rounds):
        for workers in counts:
            for way, of in ways.items():
                before_s = busy_s()
                clock[way, workers] = min(clock[way, workers], of(plan, workers))
                busy[way, workers] = min(busy[way, workers], busy_s() - before_s)
    print(f"{points * (PARAMETERS + 1):,} simulations, {-(-points // plan.batch)} batches, best of {rounds}")
    print(
        f"{'workers':>8} {'pool s':>8} {'Dask s':>8} {'ratio':>7}   processors' time: pool s, Dask s, ratio"
    )
    for workers in counts:
        pool, cluster = clock["pool", workers], clock["Dask", workers]
        ours, theirs = busy["pool", workers], busy["Dask", workers]
        print(f"{workers:8} {pool:8.1f} {cluster:8.1f} {cluster / pool:7.2f}   {ours:24.1f} {theirs:7.1f} "
              f"{theirs / ours:6.2f}")  # fmt: skip


def busy_s() -> float:
    """Processors' time of this process and of those that it waited for."""
    parts = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(part.ru_utime + part.ru_stime for part in parts)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    rows = ("whole", "plain", "check", "memory", "dask")
    parser.add_argument("rows", nargs="*", help=f"of {', '.join(rows)} (all)")
    parser.add_argument("--share", type=float, default=1.0, help="of the 10.5 million")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--points", type=int, default=240_000, help="of the comparison with Dask")
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--counts", type=int, nargs="+", default=[1, 2, 4], help="workers, of the same")
    args = parser.parse_args()
    made: dict[str, Callable[[], None]] = {
        "whole": lambda: whole(args.share, args.workers),
        "plain": plain,
        "check": check,
        "memory": lambda: memory(args.workers),
        "dask": lambda: dask(args.points, args.rounds, tuple(args.counts)),
    }
    for row in args.rows or rows:
        if row not in made:
            parser.error(f"{row}: there is no such row; there are {', '.join(rows)}")
        print(f"-- {row}")
        made[row]()


if __name__ == "__main__":
    main()
