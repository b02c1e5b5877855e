"""How good are the estimates on rigs of any size? A fractional design of drives on the virtual fleet.

    python bench/fleet.py [--count 24] [--first 0] [--processes 1] [--keep FILE.jsonl] [--mass-sd SHARE]
                          [--summary]

Drive k is of rig k of simulator/fleet.py, and of cell k of bench/fleet_design.py: each 60 drives in a row are
all cells once, and fewer are nearly balanced. The file of each rig is its owner's; with
--mass-sd it is of one who has not weighed the implement: then give another FILE. What is done is kept in
FILE, a line each, and not done again; --first gives fresh rigs. `python bench/estimation.py fleet` prints the
same table.

Times count from when the wheels first turn beyond INFORMED. A file "has numbers" where C_af, C_ar and C_ai
are given with sds of 30 % at most. Numbers are judged as they were given last, though they may have been
withdrawn since. z is an error over its sd, both of natural logarithms.
"""

import argparse
import math
import os
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Final

import numpy as np
import spatial_rows
from estimation_study import Driven, first_informed, followed
from estimation_table import Bench, Line, Row, Z, figures, percents, table_of, wilson
from fleet_design import cell_of, scenario
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import Progress, TimeElapsedColumn

from tilth.estimator.diagnosis.consistency import CONTRADICTION
from tilth.logger.fitting import ONE_THREAD
from tilth.schemas.flow import PARAMETERS
from tilth.schemas.machine_toml import parse_machine
from tilth.simulator.drive import drive
from tilth.simulator.fleet import drawn
from tilth.simulator.fleet_files import owners_text, true_machine
from tilth.simulator.scenario import CannotBeDriven

Array = NDArray[np.float64]
Result = dict[str, Any]
"""Of `follow`: one line of JSON."""

NAME: Final = "fleet"
COUNT: Final = 240
METHODS: Final = ("recommended", "pem", "tracker", "steady_state")
GIVEN_SD: Final = 0.3  # of a number that counts as given
AFTER_S: Final = (60.0, 120.0)  # of driving since steering began
FIGURES: Final = ((0.92, 0.98), 0.25, (0.85, 1.15), 0.07, 0.10)  # held; mean z; sd of z; |ln| of C, of sigma
CELL: Final = (0.85, 30)  # a group of so many intervals of which fewer hold is to be explained
FAR: Final = (4.0, 6.0)  # sds


# One drive.


def follow(first: int, scale: float, mass_sd: float | None, k: int) -> Result:
    """Drive number first + k: what was published of it. scale: of its seconds, for a try. mass_sd: as of
    owners_text."""
    number = first + k
    rig, cell = drawn(number), cell_of(number)
    result: Result = {
        "row": NAME, "seed": k, "first": first, "scale": scale, "rig": number,
        "tractor": rig.tractor.kind, "implement": rig.implement.kind, "fill": rig.implement.fill,
        "duals": rig.tyres[1].twin_spacing > 0.0, "manoeuvre": cell.manoeuvre.name, "rms": cell.rms,
        "slope": cell.slope_deg, "plant": cell.plant, "mass_sd": mass_sd, "methods": {},
    }  # fmt: skip
    asked, machine = scenario(rig, cell), true_machine(rig, cell.manoeuvre.receivers)
    began = time.perf_counter()
    try:
        truth = drive(machine, rig.seed, scale * asked.seconds, asked)
    except CannotBeDriven as error:
        return result | {"undriven": str(error)}
    text = owners_text(rig, cell.manoeuvre.receivers, mass_sd=mass_sd)
    run = Driven(parse_machine(text), truth, machine)
    drove_s = time.perf_counter() - began
    heard = followed(run)
    steered_s = first_informed(heard.wheel, 0.0)
    ends = [steered_s + after for after in AFTER_S if steered_s + after <= truth.time[-1]]
    methods = {
        name: {
            "error": (rows[-1, 1:7] - heard.logs).tolist(),
            "sd": rows[-1, 7:13].tolist(),
            "last": _last(rows, heard.logs),
            "given": [_given(rows, end) for end in (*ends, math.inf)],  # and at the end of the drive
            "reasons": heard.reasons[name],
            "over_mass": heard.over_mass.get(name, (math.nan, math.nan)),
        }
        for name, rows in heard.series.items()
    }
    wrong = [text for _, kind, text in heard.events if kind == CONTRADICTION]
    return result | {
        "methods": methods, "contradictions": wrong, "refused": heard.refused, "drove_s": drove_s,
        "took_s": time.perf_counter() - began - drove_s, "drive_s": float(truth.time[-1]),
    }  # fmt: skip


def _last(rows: Array, logs: Array) -> list[list[float]]:
    """(error, sd) of each parameter as it was given last, (6, 2): what is withdrawn was out before."""
    given = np.isfinite(rows[:, 1:7])
    at = np.where(given.any(axis=0), len(rows) - 1 - np.argmax(given[::-1], axis=0), 0)
    return np.column_stack([rows[at, np.arange(1, 7)] - logs, rows[at, np.arange(7, 13)]]).tolist()  # type: ignore[no-any-return]


def _given(rows: Array, end: float) -> bool:
    """Whether C_af, C_ar and C_ai are given at a time, s. rows: as Followed.series."""
    at = int(np.searchsorted(rows[:, 0], end, side="right")) - 1
    return at >= 0 and bool(np.all(rows[at, 7:10] <= GIVEN_SD))  # what is not a number is not


# All of them.


def row(first: int, bench: Bench, mass_sd: float | None = None) -> list[Line]:
    """The lines of the table; drives that a file has are not made again."""
    have = {
        seed: made for seed, made in spatial_rows.kept(bench, NAME).items() if made["first"] == first
    }  # fmt: skip
    made = bench.each(
        partial(follow, first, bench.scale, mass_sd), COUNT, have, partial(spatial_rows.keep, bench)
    )
    return lines_of(made)


def lines_of(made: Sequence[Result]) -> list[Line]:
    lines = list[Line]()
    for method in METHODS:
        error, sd = _numbers(made, method)
        lines += _figures(method, error, sd)
    lines += [line for method in METHODS for line in _over_mass(made, method)]
    lines += _right_files(made)
    for of in ("manoeuvre", "plant", "rms", "slope", "tractor", "implement", "duals"):
        lines += _groups(made, of)
    return [*lines, *_far(made), *spatial_rows.reasons(made), *_others(made)]


def _numbers(made: Sequence[Result], method: str) -> tuple[Array, Array]:
    """Errors and sds of the numbers as they were given last, (n, 6); not a number where none ever was."""
    blank = {"last": [[math.nan] * 2] * 6}
    said = np.array([one["methods"].get(method, blank)["last"] for one in made], np.float64)
    return said.reshape(-1, 6, 2)[..., 0], said.reshape(-1, 6, 2)[..., 1]


def _figures(method: str, error: Array, sd: Array) -> Iterator[Line]:
    """Of each parameter, and of all."""
    (least, most), mean, (narrow, wide), stiffness, length = FIGURES
    for k, name in enumerate((*PARAMETERS, "all six")):
        chosen = slice(None) if name == "all six" else slice(k, k + 1)
        off, z = error[:, chosen].ravel(), (error / sd)[:, chosen].ravel()
        given = np.isfinite(z)
        n, hits = int(given.sum()), int(np.sum(np.abs(z[given]) < Z))
        if n == 0:
            yield Line(f"{method} {name}", "no number")
            continue
        z, middle = z[given], float(np.median(np.abs(off[given])))
        low, high = wilson(hits, n)
        far = [int(np.sum(np.abs(z) > limit)) for limit in FAR]
        spread = float(np.std(z, ddof=1)) if n > 1 else math.nan
        small = middle <= (stiffness if k < 3 else length) or name == "all six"
        yield Line(
            f"{method} {name}",
            f"{hits}/{n} hold, {100 * hits / n:.0f} % ({100 * low:.0f} to {100 * high:.0f}); "
            f"z {np.mean(z):+.2f} ± {spread:.2f}; |ln| {percents([middle])}; > 4: {far[0]}, > 6: {far[1]}",
            f"92–98 %; ± 0.25, 0.85–1.15{'' if name == 'all six' else f'; ≤ {7 if k < 3 else 10} %'}",
            bool(
                least <= hits / n <= most and abs(np.mean(z)) <= mean and narrow <= spread <= wide and small
            ),
            (hits / n, float(np.mean(z)), spread, middle, *far),
        )


def _over_mass(made: Sequence[Result], method: str) -> Iterator[Line]:
    """C_ai over the implement's mass, as given last."""
    said = [one["methods"][method]["over_mass"] for one in made if method in one["methods"]]
    error, sd = np.array(said or [[math.nan] * 2], np.float64).T
    error, sd = error[np.isfinite(error)], sd[np.isfinite(error)]
    if (n := len(error)) == 0:
        yield Line(f"{method} C_ai/m_i", "no number")
        return
    z = error / sd
    hits, middle = int(np.sum(np.abs(z) < Z)), float(np.median(np.abs(error)))
    yield Line(
        f"{method} C_ai/m_i",
        f"{hits}/{n} hold, {100 * hits / n:.0f} %; z {np.mean(z):+.2f}, furthest {np.abs(z).max():.1f}; "
        f"|ln| {percents([middle])}; sd {percents([float(np.median(sd))])}",
        "holds", hits / n >= FIGURES[0][0], (hits / n, float(np.mean(z)), middle),
    )  # fmt: skip


def _right_files(made: Sequence[Result]) -> Iterator[Line]:
    """How many files have numbers; a drive that is shorter does not count."""
    instants = [f"{after:.0f} s after steering began" for after in AFTER_S]
    for k, (instant, least) in enumerate(zip((*instants, "at the end"), (0.97, 0.99, 0.99), strict=True)):
        for method in ("recommended", "pem", "tracker"):
            said = [one["methods"][method]["given"] for one in made if method in one["methods"]]
            ended = k == len(AFTER_S)
            counted = [given[-1] if ended else given[k] for given in said if ended or len(given) > k + 1]
            n, hits = len(counted), sum(counted)
            if n:
                asked = method == "recommended"
                yield Line(
                    f"right files with numbers of {method}, {instant}",
                    f"{hits} of {n}, {100 * hits / n:.0f} %", f"≥ {100 * least:.0f} %" if asked else "",
                    hits / n >= least if asked else None, (hits / n,),
                )  # fmt: skip


def _groups(made: Sequence[Result], of: str) -> Iterator[Line]:
    """Intervals that hold by one property of the drives, all six parameters together."""
    for value in sorted({one[of] for one in made}):
        some = [one for one in made if one[of] == value]
        said, low = [], False
        for method in METHODS:
            error, sd = _numbers(some, method)
            z = (error / sd)[np.isfinite(error / sd)]
            hits = int(np.sum(np.abs(z) < Z))
            low |= len(z) >= CELL[1] and hits / max(len(z), 1) < CELL[0]
            said.append(f"{method} {hits}/{len(z)}" + (f" ({100 * hits / len(z):.0f} %)" if len(z) else ""))
        yield Line(f"{of} {value}, {len(some)} drives", ", ".join(said), "≥ 85 % where n ≥ 30", not low)


def _far(made: Sequence[Result]) -> Iterator[Line]:
    """Each number that is far off, and of which drive."""
    for one in made:
        for method, said in one["methods"].items():
            error, sd = np.array(said["last"]).T
            for name, off, z in zip(PARAMETERS, error, error / sd, strict=True):
                if abs(z) > FAR[0]:
                    where = (
                        f"{one['manoeuvre']}, {one['plant']}, {100 * one['rms']:.0f} cm, {one['slope']:g}°"
                    )
                    rig = f"rig {one['rig']} ({one['tractor']}, {one['implement']})"
                    yield Line(
                        f"far off: {method} {name}",
                        f"{z:+.1f} sd, {100 * math.expm1(off):+.0f} %; {rig}; {where}",
                    )


def _others(made: Sequence[Result]) -> Iterator[Line]:
    undriven = [one["rig"] for one in made if "undriven" in one]
    wrong = Counter(text for one in made for text in one.get("contradictions", []))
    bad = [one["rig"] for one in made if one.get("contradictions")]
    yield Line("right files contradicted", f"{len(bad)} of {len(made)}: rigs {bad}", "0", not bad)
    for text, n in wrong.most_common(3):
        yield Line("  most often", f"{n}: {text}")
    if undriven:
        yield Line("could not be driven", f"rigs {undriven}")
    took = [one["took_s"] for one in made if "took_s" in one]
    yield Line(
        "processor time of a drive, median", f"{figures([float(np.median(took))], 0)} s" if took else "–"
    )


REACH: Final = "92 to 98 % hold; mean z ± 0.25, its sd 0.85 to 1.15; numbers in 97 of 100"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=24, help=f"drives; the whole design has {COUNT}")
    parser.add_argument("--first", type=int, default=0, help="number of the first rig and cell")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--keep", type=Path, default=Path("fleet.jsonl"), help="file of what is done")
    parser.add_argument(
        "--mass-sd", type=float, help="of the logarithm of the implement's mass in each file: 0.1 or 0.5"
    )
    parser.add_argument("--summary", action="store_true", help="only read what is there")
    args = parser.parse_args()
    if args.count < 1 or args.first < 0 or args.processes < 1:
        parser.error("give a count and processes above zero, and no negative --first")
    os.environ.update(dict(ONE_THREAD.items()))  # of the processes that are started below
    console = Console(width=None if Console().is_terminal else 170)
    bench = Bench(args.count, kept=args.keep)
    began = time.perf_counter()
    if args.summary:
        made = [one for one in spatial_rows.kept(bench, NAME).values() if one["first"] == args.first]
        lines = lines_of(made)
    else:
        columns = (*Progress.get_default_columns(), TimeElapsedColumn())
        with (
            ProcessPoolExecutor(args.processes, get_context("spawn")) as pool,
            Progress(*columns, console=console, transient=True) as progress,
        ):
            lines = row(args.first, replace(bench, pool=pool, progress=progress), args.mass_sd)
    title = Row(NAME, REACH, partial(row, args.first))
    took = f"{time.perf_counter() - began:.0f} s"
    console.print(
        table_of(title, lines, f"rigs {args.first} to {args.first + args.count - 1}, {took}; {REACH}")
    )


if __name__ == "__main__":
    main()
