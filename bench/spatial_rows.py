"""The rows of bench/estimation.py on the spatial plant, and the ordinary field on both.

"Holds" is judged for each cell of a table, which is a parameter of a method: the row is false where the
number of intervals that hold is so low that one in a hundred such tables would have such a cell by chance,
were every share 95 %. C_ai is that over the implement's mass, which is told to ± 10 %.
"""

import json
import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import numpy as np
import spatial_runs
from estimation_table import Bench, Line, Row, Z, append_line, figures, percents
from numpy.typing import NDArray
from scipy.stats import binom
from spatial_logs import CHANGE_S, DROP, ROW

from tilth.estimator.diagnosis.consistency import CONTRADICTION
from tilth.schemas.flow import PARAMETERS

Array = NDArray[np.float64]
Result = dict[str, Any]
"""As spatial_runs.follow gives it."""

WANTED: Final = {"pem": 6, "tracker": 6, "steady_state": 3}  # numbers of each method
METHODS: Final = tuple(WANTED)
LEVEL: Final = 0.01  # of the test, for a whole table
POOLED: Final = (0.92, 0.98)
NAMES: Final = (*PARAMETERS[:2], "C_ai/m_i", *PARAMETERS[3:])
OVER_BOUND: Final = 1.3  # largest median of a published sd over the least possible one
LARGEST_MEAN: Final = 0.5  # of the errors, in sds
TURNS: Final = 3  # after which a field must have given its numbers
INFORMATIVE_S: Final = 8.0  # of driving after a change of soil
RATIO: Final = math.log(1.07)


@dataclass(frozen=True, slots=True)
class Reach:
    """What a row must reach besides intervals that hold: largest median of |error| of C and of sigma."""

    stiffness: float = math.inf
    length: float = math.inf


def results(bench: Bench, name: str) -> list[Result]:
    """Of all runs of a row, those that were kept before among them."""
    run = partial(
        spatial_runs.follow, bench.logs, name, bench.scale, held_out=name == "spatial_random",
        bounded=name in _PLAIN,
    )  # fmt: skip
    return bench.each(run, ROW[name].runs, kept(bench, name), partial(keep, bench))


def kept(bench: Bench, name: str, first: int | None = None) -> dict[int, Result]:
    """Seed -> result, of the runs that a file has; a line that was cut short is none. first: of the drives
    that count from this one only."""
    have: dict[int, Result] = {}
    if bench.kept is None or not bench.kept.exists():
        return have
    for line in bench.kept.read_text(encoding="utf-8").splitlines():
        try:
            made = json.loads(line)
        except ValueError:
            continue
        if (made.get("row"), made.get("first"), made.get("scale")) == (name, first, bench.scale):
            have[made["seed"]] = made
    return have


def keep(bench: Bench, made: Result) -> None:
    if bench.kept is not None:
        append_line(bench.kept, made)


# What holds.


def least_hits(n: int, cells: int) -> int:
    """Fewest intervals of n that must hold where a table has so many cells."""
    return int(binom.ppf(LEVEL / cells, n, 0.95)) if n else 0


def errors(made: list[Result], method: str, per_mass: bool = True) -> tuple[Array, Array]:
    """(errors, sds) of a method's last numbers, shapes (n, 6); not a number where there is none."""
    said = [run["methods"].get(method) for run in made]
    blank = {"error": [math.nan] * 6, "sd": [math.nan] * 6, "per_mass": [math.nan] * 2}
    error = np.array([(one or blank)["error"] for one in said])
    sd = np.array([(one or blank)["sd"] for one in said])
    if per_mass:
        error[:, 2], sd[:, 2] = np.array([(one or blank)["per_mass"] for one in said]).T
    return error, sd


def holding(title: str, z: Array, cells: int, names: Sequence[str]) -> list[Line]:
    """Whether intervals hold, pooled and each. z: errors over sds, (n, m), not a number where none is."""
    given, hits = np.isfinite(z).sum(axis=0), (np.abs(z) < Z).sum(axis=0)
    n, all_ = int(given.sum()), int(hits.sum())
    if n == 0:
        return [Line(f"{title}: 95 % intervals", "no number was given in any run", "", False)]
    least = [least_hits(int(k), cells) for k in given]
    each = "  ".join(
        f"{name} {h}/{k}{'' if h >= low else ' !'}"
        for name, h, k, low in zip(names, hits, given, least, strict=True)
        if k
    )
    low_n = f"≥ {max(least)} of {int(given.max())}"
    return [
        Line(
            f"{title}: 95 % intervals that hold, pooled", f"{100 * all_ / n:.1f} % of {n}", "92 to 98 %",
            POOLED[0] <= all_ / n <= POOLED[1], (all_ / n,),
        ),
        Line(
            f"{title}: each", each, low_n, bool(np.all(hits >= least)),
            (hits / np.maximum(given, 1)).tolist(),
        ),
    ]  # fmt: skip


def _sizes(title: str, error: Array, sd: Array, reach: Reach) -> list[Line]:
    """Mean error in sds, median of |error| and median sd of a method."""
    if not np.isfinite(error).any():
        return []
    chosen = np.isfinite(error).any(axis=0)
    z = np.full((1, 6), math.nan)
    z[0, chosen] = np.nanmean((error / sd)[:, chosen], axis=0)
    middle, off = np.full(6, math.nan), np.full(6, math.nan)
    middle[chosen] = np.nanmedian(sd[:, chosen], axis=0)
    off[chosen] = np.nanmedian(np.abs(error[:, chosen]), axis=0)
    most = np.array([reach.stiffness] * 3 + [reach.length] * 3)
    asked = bool(np.isfinite(most).any())
    wanted = f"C ≤ {100 * reach.stiffness:.0f} %, sigma ≤ {100 * reach.length:.0f} %" if asked else ""
    held = bool(np.all((off <= most)[chosen])) if asked else None
    return [
        Line(
            f"{title}: mean error over sd", figures(z[0]), f"≤ {LARGEST_MEAN}",
            bool(np.all(np.abs(z[0, chosen]) <= LARGEST_MEAN)), z[0].tolist(),
        ),
        Line(f"{title}: |error|, median", percents(off), wanted, held, off.tolist()),
        Line(f"{title}: published sd, median", percents(middle), values=middle.tolist()),
    ]  # fmt: skip


def _nuisances(title: str, made: list[Result], method: str) -> list[Line]:
    """Whether each unknown that is no tyre's holds."""
    said = [run["methods"].get(method, {}).get("nuisances", {}) for run in made]
    names = sorted({name for one in said for name in one})
    if not names:
        return []
    z = np.array([[np.divide(*one.get(name, (math.nan, 1.0))) for name in names] for one in said])
    return holding(f"{title}, others", z, len(METHODS) * len(names), names)[1:]


def judged(made: list[Result], reach: Reach) -> list[Line]:
    """The lines that all rows have."""
    lines = []
    for method in METHODS:
        error, sd = errors(made, method)
        lines += holding(method, error / sd, len(METHODS) * 6, NAMES)
        lines += _sizes(method, error, sd, reach)
        whole, whole_sd = errors(made, method, per_mass=False)
        lines += holding(f"{method}, C_ai itself", (whole / whole_sd)[:, 2:3], 1, ("C_ai",))[1:]
        lines += _nuisances(method, made, method)
    return [*lines, *reasons(made), _contradictions(made), _speed(made)]


def reasons(made: Sequence[Result]) -> Iterator[Line]:
    """Why there is no number, of each method the most frequent."""
    for method in METHODS:
        said = Counter(
            reason
            for run in made
            if method in run["methods"]
            for k, reason in enumerate(run["methods"][method]["reasons"][: WANTED[method]])
            if not math.isfinite(run["methods"][method]["error"][k])
        )
        if said:
            (reason, n), *_ = said.most_common(1)
            all_ = WANTED[method] * len(made)
            yield Line(f"{method}: no number, most often because", f"{n} of {all_}: {reason}")


def _contradictions(made: list[Result]) -> Line:
    bad = [run["seed"] for run in made if any(kind == CONTRADICTION for _, kind, _ in run["events"])]
    seeds = f", seeds {', '.join(map(str, bad))}" if bad else ""
    return Line("right files contradicted", f"{len(bad)} of {len(made)}{seeds}", "0", not bad)


def _speed(made: list[Result]) -> Line:
    rate = np.median([run["drive_s"] / run["took_s"] for run in made])
    return Line("replayed, times real time, median", f"{rate:.0f}", values=(float(rate),))


# Rows.


def plain(name: str, reach: Reach, bench: Bench) -> list[Line]:
    made = results(bench, name)
    return [*judged(made, reach), *_over_bound(made), *_held_out(made)]


def _over_bound(made: list[Result]) -> list[Line]:
    """Published sds of `pem` over what its own model allows at best; runs of older code have no bound."""
    found = [run for run in made if np.all(np.isfinite(run.get("bound", [math.nan])))]
    _, sd = errors(found, "pem")
    if not len(found) or not np.isfinite(sd).any():
        return []
    ratio = np.nanmedian(sd / np.array([run["bound"] for run in found]), axis=0)
    return [
        Line(
            f"pem: published sd over the bound, median of {len(found)}", figures(ratio), f"≤ {OVER_BOUND}",
            bool(np.all(ratio <= OVER_BOUND)), ratio.tolist(),
        )
    ]  # fmt: skip


def _held_out(made: list[Result]) -> list[Line]:
    """The way on from a fit, where a row has it."""
    off = np.array([run["trajectory"] for run in made if run.get("trajectory")])
    if not len(off):
        return []
    middle, worse = np.median(off, axis=0), np.quantile(off, 0.9, axis=0)
    return [
        Line(
            "RMSE over 30 s that were not fitted, tractor and implement, median", f"{figures(middle[:2])} m",
            "≤ 0.20 m", bool(np.all(middle[:2] <= 0.20)), middle.tolist(),
        ),
        Line("  of nine in ten runs no more than", f"{figures(worse[:2])} m"),
        Line("  with the measured roll taken for a slope, median", f"{figures(middle[2:4])} m"),
        Line("  with the true parameters and the true zero, median", f"{figures(middle[4:])} m"),
    ]  # fmt: skip


def field(name: str, bench: Bench) -> list[Line]:
    """An ordinary field: also when the numbers are there."""
    made = results(bench, name)
    lines = []
    for method, wanted in WANTED.items():
        soon = [_soon(run, method, wanted) for run in made]
        lines.append(
            Line(
                f"{method}: {wanted} numbers within {TURNS} turns", f"{sum(soon)} of {len(made)} runs", "all",
                all(soon),
            )
        )  # fmt: skip
    return [*lines, *judged(made, Reach(0.08, 0.15))]


def _soon(run: Result, method: str, wanted: int) -> bool:
    """Whether so many numbers have been given by the end of TURNS turns, and what a fit takes."""
    first = run["methods"].get(method, {}).get("first_s", [math.nan] * 6)[:wanted]
    ends = run["turn_ends_s"]
    return len(ends) >= TURNS and all(t <= ends[TURNS - 1] + 10.0 for t in first)


def steps(bench: Bench) -> list[Line]:
    """Three runs of one step each: also what is there after each of them."""
    made = results(bench, "spatial_steps")
    lines = []
    for method in METHODS:
        said = [run["methods"].get(method) for run in made]
        for k in range(len(ROW["spatial_steps"].gaps)):
            rows = np.array([one["run_ends"][k] for one in said if one])
            if not len(rows):
                continue
            truth = np.array([run["logs"] for run, one in zip(made, said, strict=True) if one])
            given = int(np.isfinite(rows[:, 1:7]).any(axis=1).sum())
            lines.append(Line(f"{method}: a number after run {k + 1}", f"{given} of {len(made)}", "all",
                              given == len(made)))  # fmt: skip
            z = (rows[:, 1:7] - truth) / rows[:, 7:]
            lines += holding(f"{method}, after run {k + 1}", z, len(METHODS) * 6, PARAMETERS)
    return [*lines, *judged(made, Reach())]


def soil(bench: Bench) -> list[Line]:
    """Delay of the event, and how well the change is found."""
    made = results(bench, "spatial_soil")
    told = [[at for at, kind, _ in run["events"] if kind == "soil_change"] for run in made]
    first = np.array([run["wheel_s"][0] if run["wheel_s"] else math.nan for run in made])
    delays = np.array([min((t for t in at if t >= CHANGE_S), default=math.inf) for at in told]) - first
    early = sum(t < CHANGE_S for at in told for t in at)
    middle, worse = float(np.median(delays)), np.quantile(delays, 0.9, method="higher")
    never = int(np.sum(~np.isfinite(delays)))
    lines = [
        Line(
            "noticed after the first turn that could tell, median", f"{middle:.1f} s", "≤ 2 s",
            middle <= 2.0, (middle,),
        ),
        Line("  of nine in ten; never; before it happened", f"{worse:.1f} s; {never}; {early}"),
    ]  # fmt: skip
    for method in METHODS:
        ratios = np.array([_ratio_error(run, method) for run in made])
        off = np.median(np.where(np.isfinite(ratios), np.abs(ratios), math.inf), axis=0)
        figure = f"{method}: ratio of C_af, C_ar off after {INFORMATIVE_S:.0f} s, median"
        held = bool(np.all(off <= RATIO))
        lines.append(Line(figure, percents(np.expm1(off)), "≤ 7 %", held, off.tolist()))
    return [*lines, *judged(made, Reach())]


def _ratio_error(run: Result, method: str) -> Array:
    """Logarithm of what a method says of C_af and C_ar after over before, less the true one, (2,)."""
    rows = np.array(run["methods"].get(method, {}).get("whole", []), np.float64).reshape(-1, 13)
    enough = round(INFORMATIVE_S / 0.04)  # `wheel_s` has 25 times a second
    before, wheel = rows[rows[:, 0] < CHANGE_S], run["wheel_s"]
    if len(wheel) < enough or not len(before):
        return np.full(2, math.nan)
    after = rows[(rows[:, 0] > CHANGE_S) & (rows[:, 0] <= wheel[enough - 1])]
    if not len(after):
        return np.full(2, math.nan)
    return np.asarray(after[-1, 1:3] - before[-1, 1:3] - math.log(DROP))


HOLDS: Final = "92 to 98 % pooled; each by its test; mean error ≤ 0.5 sd"
_PLAIN: Final[dict[str, Reach]] = {
    "spatial_random": Reach(0.07, 0.12),
    **dict.fromkeys(
        ("spatial_flat", "spatial_3cm", "spatial_10hz", "spatial_3ms", "spatial_8t", "spatial_slope"), Reach()
    ),
}
_OTHERS: Final[dict[str, Callable[[Bench], list[Line]]]] = {
    "spatial_steps": steps,
    "spatial_field": partial(field, "spatial_field"),
    "planar_field": partial(field, "planar_field"),
    "spatial_soil": soil,
}
ROWS: Final = (
    *(Row(name, HOLDS, partial(plain, name, reach)) for name, reach in _PLAIN.items()),
    *(Row(name, HOLDS, make) for name, make in _OTHERS.items()),
)
