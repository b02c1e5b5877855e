"""How good are the estimates? The whole table of figures, each row by Monte Carlo with fixed seeds.

    python bench/estimation.py [ROW …] [--runs N] [--processes 2] [--json FILE] [--logs DIR]

Run k of a row has seed k, on whatever number of processes; a row alone takes a few minutes on two cores.
Six numbers in a row are those of C_af, C_ar, C_ai, sigma_f, sigma_r, sigma_i. `coverage` is the share of the
95 % intervals that hold the truth, with the 95 % interval of that share (Wilson); a bias is the mean error
over the published sd, and an sd is one of a natural logarithm. The plants: in linear_plant.py the estimators'
own model, in estimation_study.py the nonlinear one with frames, latency and coloured noise, and for rows that
begin with spatial_ that of simulator/spatial/, by the logs of spatial_logs.py. `fleet` is bench/fleet.py.
"""

import argparse
import math
import os
import platform
import time
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from dataclasses import asdict
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import estimation_runs as runs
import estimation_study
import fleet
import numpy as np
import spatial_rows
from estimation_runs import Linear, PeerResult
from estimation_study import CHANGE_S, COVERAGE, DROP, HIDDEN, Case, Followed
from estimation_table import Bench, Line, Row, append_line, coverage, figures, percents, table_of
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import Progress, TimeElapsedColumn
from spatial_logs import CACHE

from tilth.logger.fitting import ONE_THREAD

Array = NDArray[np.float64]

WITHIN = math.log(1.05)
STEERED = ("pem", "tracker")  # methods that learn from steering


# Rows.


def efficiency(kind: str, bench: Bench) -> list[Line]:
    """Error² over the diagonal of that run's bound (expected Fisher information at its truth, prior in)."""
    seconds = 30.0 * bench.scale
    made: list[Linear] = bench.each(partial(runs.linear, kind, seconds), 1000)
    error, sd = np.array([m.error for m in made]), np.array([m.sd for m in made])
    bound = np.array([m.bound for m in made])
    ratio = np.mean((error / bound) ** 2, axis=0)
    uncertain = np.std((error / bound) ** 2, axis=0) / math.sqrt(len(made))
    stuck = sum(not m.converged for m in made)
    return [
        Line("variance over the bound", figures(ratio), "≤ 1.10", bool(np.all(ratio <= 1.10)),
             ratio.tolist()),
        Line("  its standard error; worst run, sds of the bound",
             f"{figures(uncertain)}; {figures(np.abs(error / bound).max(axis=0), 1)}"),
        Line("  median of (error over bound)², over its expectation",
             figures(np.median((error / bound) ** 2, axis=0) / 0.4549)),
        Line("published sd over the bound", figures(np.mean(sd / bound, axis=0))),
        Line("bound, mean", percents(np.mean(bound, axis=0))),
        *coverage(error / sd, 0.93, 0.97),
        Line("fits that did not converge; iterations", f"{stuck}; {np.mean([m.steps for m in made]):.1f}"),
    ]  # fmt: skip


def nonlinear_coverage(case: Case, bench: Bench) -> list[Line]:
    made: list[Followed] = bench.each(partial(runs.follow, bench.case(case)), 100)
    lines = []
    for method in sorted({m for run in made for m in run.series} - {"recommended"}):
        z = np.array([_last(run, method) for run in made])
        lines += coverage(z, 0.90, name=method)
    return lines


def _last(run: Followed, method: str) -> Array:
    """Errors over sds of the last numbers of a method, (6,)."""
    if method not in run.series:
        return np.full(6, math.nan)
    last = run.series[method][-1]
    return np.asarray((last[1:7] - run.logs) / last[7:13], np.float64)


def three_steps(bench: Bench) -> list[Line]:
    """As published after the third step, beside the bound of the three windows."""
    case = bench.case(estimation_study.STEPS)
    made: list[Followed] = bench.each(partial(runs.follow, case), 50)
    windows = [m for m in bench.each(partial(runs.window, case, 3, bench.window), 50) if m is not None]
    if not windows:
        return [Line("three windows", "no run had three")]
    bound = runs.mean_bound(case, windows)
    limit = np.maximum([0.025] * 3 + [0.08] * 3, 1.2 * bound)
    sd = np.nanmedian([run.series["pem"][-1][7:13] for run in made], axis=0)
    numbers = [int(np.sum([np.isfinite(_last(run, method)).all() for run in made])) for method in STEERED]
    lines = [
        Line("published sd, median", percents(sd), figures(100 * limit, 1) + " %", bool(np.all(sd <= limit)),
             sd.tolist()),
        Line("bound", percents(bound)),
        Line("runs with six numbers, " + " and ".join(STEERED), " and ".join(map(str, numbers))),
    ]  # fmt: skip
    for method in STEERED:
        lines += coverage(np.array([_last(run, method) for run in made]), 0.90, name=method)
    return lines


def trajectory(bench: Bench) -> list[Line]:
    case = bench.case(estimation_study.HELD_OUT)
    made = [m for m in bench.each(partial(runs.trajectory, case, bench.window), 50) if m is not None]
    if not made:
        return [Line("two windows", "no run had two")]
    rms = np.median(made, axis=0)
    worse = np.quantile(made, 0.9, axis=0)
    return [
        Line("RMSE over a window, tractor and implement, median", figures(rms[:2]) + " m", "≤ 0.20 m",
             bool(np.all(rms[:2] <= 0.20)), rms.tolist()),
        Line("  of nine in ten runs no more than", figures(worse[:2]) + " m"),
        Line("  with the true parameters, and the true zero", figures(rms[2:]) + " m"),
    ]  # fmt: skip


def hidden(case: Case, bench: Bench) -> list[Line]:
    case = bench.case(case)
    made = [m for m in bench.each(partial(runs.window, case, 1, bench.window), 32) if m is not None]
    if not made:
        return [Line("a window", "no run had one")]
    z, sd = np.array([m.error / m.sd for m in made]), np.mean([m.sd for m in made], axis=0)
    bias, wide = z.mean(axis=0), sd / runs.mean_bound(case, made)
    return [
        Line("bias", f"{figures(bias)} (± {1.96 / math.sqrt(len(made)):.2f}, 95 %)", "≤ 1 published sd",
             bool(np.all(np.abs(bias) <= 1.0)), bias.tolist()),
        Line("sd over the bound with these nuisances", figures(wide), "≤ 1.5", bool(np.all(wide <= 1.5)),
             wide.tolist()),
        Line("bias as a share", percents(np.mean([m.error for m in made], axis=0))),
        *coverage(z, 0.90),
    ]  # fmt: skip


def soil_change(bench: Bench) -> list[Line]:
    made: list[Followed] = bench.each(partial(runs.follow, bench.case(estimation_study.SOIL_CHANGE)), 100)
    informative = np.array([estimation_study.first_informed(run.wheel, CHANGE_S) for run in made])
    delays = np.array([_first_event(run, CHANGE_S) for run in made]) - informative
    early = sum(kind == "soil_change" and at < CHANGE_S for run in made for at, kind, _ in run.events)
    found = float(np.median(delays)) if np.all(np.isfinite(informative)) else math.inf
    lines = [
        Line("detected after the first informative manoeuvre, median", f"{found:.1f} s", "≤ 2 s",
             found <= 2.0, (found,)),
        Line("  of nine in ten; never; before it happened",
             f"{np.quantile(delays, 0.9):.1f} s; {int(np.sum(~np.isfinite(delays)))}; {early}"),
    ]  # fmt: skip
    for method in sorted({m for run in made for m in run.series} - {"recommended"}):
        settled = np.array([_settled(run, method) for run in made]) - informative
        jitter = np.nanmedian([_jitter(run, method) for run in made], axis=0) if made else np.zeros(2)
        middle = float(np.median(settled))
        lines += [
            Line(f"{method}: C_af and C_ar within 5 % for good, median", f"{middle:.1f} s", "≤ 10 s",
                 middle <= 10.0, (middle,)),
            Line(f"{method}: jitter of C_af, C_ar before", percents(jitter), "≤ 3 %",
                 bool(np.all(jitter <= 0.03)), jitter.tolist()),
            *coverage(np.array([_last_after(run, method) for run in made]), 0.90, name=method)[:2],
        ]  # fmt: skip
    return lines


def _first_event(run: Followed, after_s: float) -> float:
    return min(
        (at for at, kind, _ in run.events if kind == "soil_change" and at >= after_s), default=math.inf
    )


def _settled(run: Followed, method: str) -> float:
    """From when on C_af and C_ar stay within 5 % of what they are after the change, s."""
    rows = run.series.get(method, np.zeros((0, 13)))
    rows = rows[rows[:, 0] > CHANGE_S]
    off = np.abs(rows[:, 1:3] - run.logs[:2] - math.log(DROP))
    good = np.all(off < WITHIN, axis=1)  # what is not a number is not good
    if not len(good) or not good[-1]:
        return math.inf
    bad = np.flatnonzero(~good)
    return float(rows[bad[-1] + 1 if len(bad) else 0, 0])


def _jitter(run: Followed, method: str) -> Array:
    """Sd of log C_af and log C_ar in the last 20 s before the change, (2,)."""
    rows = run.series.get(method, np.zeros((0, 13)))
    rows = rows[(rows[:, 0] > CHANGE_S - 20.0) & (rows[:, 0] < CHANGE_S)]
    return np.asarray(np.std(rows[:, 1:3], axis=0)) if len(rows) else np.full(2, math.nan)


def _last_after(run: Followed, method: str) -> Array:
    z = _last(run, method)
    if method in run.series:
        z[:3] -= math.log(DROP) / run.series[method][-1][7:10]
    return z


def straight_hour(bench: Bench) -> list[Line]:
    """Means and sds at the end against those when the rig is on its row, and false alarms."""
    case = bench.case(estimation_study.STRAIGHT)
    made: list[Followed] = bench.each(partial(runs.follow, case), 6)
    hours = len(made) * case.scenario.seconds / 3600.0
    alarms = [(at, text) for run in made for at, kind, text in run.events if kind == "soil_change"]
    rate = 10.0 * len(alarms) / hours
    lines = [Line(f"false alarms in 10 h, of {hours:.1f} h", f"{rate:.1f}", "< 1", rate < 1.0, (rate,))]
    for method in sorted({m for run in made for m in run.series} - {"recommended"}):
        moves, grew, z = [], [], []
        for run in made:
            rows = run.series[method]
            began = rows[min(int(np.searchsorted(rows[:, 0], estimation_study.ON_ROW_S)), len(rows) - 1)]
            moves.append(np.abs(rows[:, 1:7] - began[1:7]).max(axis=0) / began[7:13])
            grew.append(rows[-1, 7:13] / began[7:13])
            z.append(_last(run, method))
        worst = np.array(moves).max(axis=0)
        if not np.any(np.isfinite(worst)):
            lines.append(Line(method, "gives no number"))
            continue
        held = bool(np.all(worst[np.isfinite(worst)] <= 1.0))
        lines += [
            Line(
                f"{method}: means move, of the sd at first, worst",
                figures(worst),
                "≤ 1",
                held,
                worst.tolist(),
            ),
            Line(f"{method}: sd at the end over that at first", figures(np.mean(grew, axis=0))),
            *coverage(np.array(z), 0.90, name=method)[:2],
        ]
    return lines


def merging(bench: Bench) -> list[Line]:
    made: list[Linear] = bench.each(partial(runs.merged_rows, 30.0 * bench.scale), 100)
    z = np.array([m.error / m.sd for m in made])
    ratio = np.mean([(m.error / m.bound) ** 2 for m in made], axis=0)
    return [
        *coverage(z, 0.93),
        Line("variance over the bound of all six together", figures(ratio)),
        Line("sd, median", percents(np.median([m.sd for m in made], axis=0))),
    ]


def speed(bench: Bench) -> list[Line]:
    return [Line(*row) for row in runs.speeds(bench.scale)]


def other_programs(bench: Bench) -> list[Line]:
    """The same linear data, random steering, in one run; times as ratios to the fit of this package."""
    made: list[dict[str, PeerResult]] = bench.each(partial(runs.other_programs, 30.0 * bench.scale), 40)
    tilth_error = np.array([run["tilth"].error for run in made])
    lines = []
    for name in made[0]:
        error, sd = np.array([r[name].error for r in made]), np.array([r[name].sd for r in made])
        took = np.median([r[name].seconds for r in made])
        ratio = np.median([r[name].seconds / r["tilth"].seconds for r in made])
        rms = np.sqrt(np.mean(error**2, axis=0) / np.mean(tilth_error**2, axis=0))
        lines += [
            Line(
                f"{name}: time of 30 s, and over tilth's", f"{took:.3f} s; {ratio:.1f}", values=(took, ratio)
            ),
            Line(f"{name}: root mean square error over tilth's", figures(rms), values=rms.tolist()),
            *coverage(error / sd, 0.93, 0.97, name=name)[:2],
        ]
    return lines


ROWS: tuple[Row, ...] = (
    *(
        Row(
            f"efficiency_{kind}",
            "variance ≤ 1.10 of the bound; 93 to 97 % covered",
            partial(efficiency, kind),
        )
        for kind in ("step", "chirp", "random")
    ),
    *(Row(f"coverage_{c.name}", "≥ 90 % covered", partial(nonlinear_coverage, c)) for c in COVERAGE),
    Row("three_steps", "sd ≤ 2.5 and 8 %, or 1.2 of the bound", three_steps),
    Row("trajectory", "≤ 0.20 m", trajectory),
    *(Row(f"hidden_{c.name}", "bias ≤ 1 sd; sd ≤ 1.5 of the bound", partial(hidden, c)) for c in HIDDEN),
    Row("soil_change", "≤ 2 s; ≤ 10 s; jitter ≤ 3 %", soil_change),
    Row("straight_hour", "means move ≤ 1 sd; < 1 false alarm in 10 h", straight_hour),
    Row("merging", "≥ 93 % covered", merging),
    Row("speed", "≤ 40 µs; ≤ 250 ms; ≤ 1 s", speed),
    Row("plain", "", other_programs),
    *spatial_rows.ROWS,
    Row(fleet.NAME, fleet.REACH, partial(fleet.row, 0)),
)


# The command.


def main() -> None:
    parser = argparse.ArgumentParser(description="The figures of the estimators.")
    parser.add_argument("row", nargs="*", help=", ".join(row.name for row in ROWS))
    parser.add_argument("--runs", type=int, help="of each row, instead of its own number")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument(
        "--json",
        type=Path,
        help="file for numbers, a line for each run of a spatial row and for each row; "
        "runs that it has are not made again",
    )
    parser.add_argument("--logs", type=Path, default=CACHE, help="folder of bench/spatial_logs.py")
    args = parser.parse_args()
    unknown = set(args.row) - {row.name for row in ROWS}
    if unknown or (args.runs or 1) < 1 or args.processes < 1:
        parser.error(f"no such row: {', '.join(sorted(unknown))}" if unknown else "give numbers above zero")
    os.environ.update(dict(ONE_THREAD.items()))  # of the processes that are started below
    console = Console(width=None if Console().is_terminal else 150)
    console.print(f"{os.cpu_count()} cores, {args.processes} processes, Python {platform.python_version()}")
    for row in (row for row in ROWS if not args.row or row.name in args.row):
        with ExitStack() as stack:
            pool = stack.enter_context(ProcessPoolExecutor(args.processes, get_context("spawn")))
            progress = stack.enter_context(
                Progress(
                    *Progress.get_default_columns(), TimeElapsedColumn(), console=console, transient=True
                )
            )
            bench = Bench(args.runs, pool, progress, logs=args.logs, kept=args.json)
            began = time.perf_counter()
            lines = row.make(bench)
            seconds = time.perf_counter() - began
        n = bench.made[0] if bench.made else 1
        console.print(table_of(row, lines, f"N {n}, seeds 0 to {n - 1}, {seconds:.0f} s; {row.reach}"))
        if args.json:
            report = {"figures": row.name, "runs": n, "seconds": seconds, "lines": list(map(asdict, lines))}
            append_line(args.json, report)


if __name__ == "__main__":
    main()
