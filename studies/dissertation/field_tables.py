"""Tables 7.3 to 7.6 of the dissertation beside those of the virtual tractor, from chapter7.json.

Stiffnesses in kN/rad, lengths in m; ± is a standard deviation, as there.
"""

import json
from collections.abc import Iterable, Iterator, Sequence
from itertools import chain
from pathlib import Path
from statistics import median
from typing import Any, Final, NamedTuple

from studies.dissertation.compared import number, table
from tilth.schemas.spread import interval

FILE: Final = Path(__file__).with_name("chapter7.json")
PLANTS: Final = ("planar", "spatial")
FIELDS: Final = ("first", "second")
UNITS: Final = (1e3, 1e3, 1e3, 1.0, 1.0, 1.0)
DECIMALS: Final = (0, 0, 0, 1, 1, 1)
FINER: Final = (0, 0, 0, 2, 2, 2)  # decimals of ours
NEAR_M: Final = 0.20  # what is wanted of a held-out prediction

# In print.
INITIAL: Final = (220, 490, 170, 1.0, 1.5, 1.0)
FIRST: Final = (100, 540, 90, 1.0, 2.6, 1.3)
SECOND: Final = (120, 650, 100, 0.7, 0.9, 0.5)
INITIAL_ERRORS: Final = ((24, 37), (57, 25), (50, 21))  # of N1, N2, N3: tractor, implement, m
N2_ERRORS: Final = ((2.0, 1.9), (0.2, 0.2), (1.5, 1.1))
RUNS: Final = ((1,), (2,), (3,), (1, 2), (1, 3), (2, 3), (1, 2, 3))
ESTIMATES: Final = {
    (1,): ((90, 600, 70, 1.5, 2.1, 1.3), (6, 40, 5, 0.4, 0.4, 0.9)),
    (2,): ((100, 550, 90, 1.0, 2.6, 1.7), (10, 70, 10, 0.8, 0.7, 1.0)),
    (3,): ((90, 560, 60, 2.1, 1.3, 0.8), (7, 40, 5, 1.0, 0.5, 0.6)),
    (1, 2): ((90, 590, 70, 1.4, 2.2, 1.5), (5, 40, 5, 0.4, 0.3, 0.7)),
    (1, 3): ((90, 580, 59, 1.6, 1.8, 1.0), (5, 30, 5, 0.4, 0.3, 0.5)),
    (2, 3): ((90, 550, 60, 1.4, 1.8, 1.0), (5, 40, 5, 0.6, 0.4, 0.5)),
    (1, 2, 3): ((90, 580, 62, 1.5, 1.9, 1.1), (5, 30, 5, 0.3, 0.3, 0.4)),
}
"""Table 7.5: runs -> values and sds."""
ERRORS: Final = {
    (1, 2): ((0.29, 0.53), (1.12, 0.93), (0.05, 0.53)),
    (1, 3): ((0.19, 0.49), (1.34, 1.11), (0.09, 0.61)),
    (2, 3): ((0.84, 0.96), (0.54, 0.43), (0.19, 0.33)),
    (1, 2, 3): ((0.45, 0.45), (0.83, 0.76), (0.05, 0.23)),
}
"""Table 7.6: runs fitted -> on N1, N2, N3: tractor, implement, m."""

Numbers = dict[str, Any]
Pairs = Sequence[Sequence[float]]


def read(path: Path = FILE) -> Numbers:
    """What chapter7.py wrote. Raises OSError."""
    found: Numbers = json.loads(path.read_text(encoding="utf-8"))
    return found


def merged(runs: Sequence[int]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Values and sds of runs together by 7.20 and 7.21: means weighted by variances."""
    rows = [ESTIMATES[(k,)] for k in runs]
    weights = [[sd**-2 for sd in sds] for _, sds in rows]
    whole = [sum(column) for column in zip(*weights, strict=True)]
    means = [
        sum(w[k] * values[k] for w, (values, _) in zip(weights, rows, strict=True)) / whole[k]
        for k in range(6)
    ]
    return tuple(means), tuple(w**-0.5 for w in whole)


def of_group(found: Numbers, plant: str, field: str, manoeuvre: str) -> dict[tuple[int, ...], Numbers]:
    """Runs fitted, () for the machine file's parameters -> the row."""
    (group,) = (
        one for one in found["groups"]
        if (one["plant"], one["field"], one["manoeuvre"]) == (plant, field, manoeuvre)
    )  # fmt: skip
    return {tuple(row["runs"]): row for row in group["subsets"]}


def named(runs: Sequence[int]) -> str:
    """Such as N1 + N2."""
    return " + ".join(f"N{k}" for k in runs)


def _plain(values: Iterable[float], decimals: Sequence[int]) -> list[str]:
    return [number(value, k) for value, k in zip(values, decimals, strict=True)]


def _spread(values: Iterable[float], sds: Iterable[float], decimals: Sequence[int]) -> list[str]:
    both = zip(_plain(values, decimals), _plain(sds, decimals), strict=True)
    return [f"{value} ± {sd}" for value, sd in both]


def _ours(row: Numbers, truth: Sequence[float]) -> list[str]:
    """Values and sds; what does not hold the truth within 95 % is marked, what is not estimated a dash."""
    cells = []
    for k, (value, sd) in enumerate(zip(row["values"], row["sds"], strict=True)):
        if value is None:
            cells.append("–")
            continue
        text = f"{number(value / UNITS[k], FINER[k])} ± {number(sd / UNITS[k], FINER[k])}"
        cells.append(text if holds(value, sd, truth[k]) else f"{text} !")
    return cells


def holds(value: float, sd: float, truth: float) -> bool:
    """Whether the truth is within the 95 % of a log-normal estimate."""
    low, high = interval(value, sd / value)
    return low <= truth <= high


def _in_units(values: Sequence[float]) -> list[float]:
    return [value / unit for value, unit in zip(values, UNITS, strict=True)]


HEAD: Final = ("C_αf", "C_αr", "C_αi", "σ_f", "σ_r", "σ_i")


def table_7_3(found: Numbers) -> str:
    """Initial values, and one step run of each field."""
    rows = [["initial, printed", *_plain(INITIAL, DECIMALS)]]
    for field, printed in zip(FIELDS, (FIRST, SECOND), strict=True):
        truth = found["truth"][field]
        rows.append([f"{field} field, printed", *_plain(printed, DECIMALS)])
        rows.append([f"{field} field, simulated with", *_plain(_in_units(truth), DECIMALS)])
        for plant in PLANTS:
            row = of_group(found, plant, field, "steps")[(2,)]
            rows.append([f"{field} field, ours, {plant}", *_ours(row, truth)])
    return table(("", *HEAD), rows)


def _errors(cells: Pairs, runs: Sequence[int] | None, digits: int = 2) -> list[str]:
    """Tractor / implement on N1, N2, N3; bold where held out. runs: None where all are, and none is."""
    texts = [" / ".join(number(value, digits) for value in pair) for pair in cells]
    held = [runs is not None and k not in runs for k in (1, 2, 3)]
    return [f"**{text}**" if bold else text for text, bold in zip(texts, held, strict=True)]


def table_7_4(found: Numbers) -> str:
    """Predictions by the initial parameters and by those of N2."""
    rows = [
        ["initial, printed", *_errors(INITIAL_ERRORS, None, 0)],
        *([f"initial, ours, {plant}", *_errors(_steps(found, plant)[()]["cells"], None, 1)]
          for plant in PLANTS),
        ["N2, printed", *_errors(N2_ERRORS, (2,), 1)],
        *([f"N2, ours, {plant}", *_errors(_steps(found, plant)[(2,)]["cells"], (2,))] for plant in PLANTS),
    ]  # fmt: skip
    return table(("tractor / implement, m", "N1", "N2", "N3"), rows)


def _steps(found: Numbers, plant: str) -> dict[tuple[int, ...], Numbers]:
    """The three runs N1, N2 and N3."""
    return of_group(found, plant, "first", "steps")


def table_7_5(found: Numbers) -> str:
    """Step runs of the first field, alone and together."""
    truth = found["truth"]["first"]
    rows = [["simulated with", *_plain(_in_units(truth), DECIMALS)]]
    for runs in RUNS:
        rows.append([f"{named(runs)}, printed", *_spread(*ESTIMATES[runs], DECIMALS)])
        if len(runs) > 1:
            rows.append([f"{named(runs)}, by 7.20, 7.21", *_spread(*merged(runs), FINER)])
        for plant in PLANTS:
            rows.append([f"{named(runs)}, ours, {plant}", *_ours(_steps(found, plant)[runs], truth)])
    return table(("", *HEAD), rows)


def table_7_6(found: Numbers) -> str:
    """Predictions by runs together."""
    rows = []
    for runs, printed in ERRORS.items():
        rows.append([f"{named(runs)}, printed", *_errors(printed, runs)])
        for plant in PLANTS:
            cells = _steps(found, plant)[runs]["cells"]
            rows.append([f"{named(runs)}, ours, {plant}", *_errors(cells, runs)])
    return table(("tractor / implement, m", "N1", "N2", "N3"), rows)


# What the print does not have: whether intervals hold, and what held-out predictions miss.


class Estimates(NamedTuple):
    """Rows of estimates with what is true of each."""

    name: str
    rows: list[tuple[Numbers, Sequence[float]]]


def estimates(found: Numbers, plant: str) -> list[Estimates]:
    """By how many runs they are from."""
    groups = [one for one in found["groups"] if one["plant"] == plant]
    rows = [(row, found["truth"][one["field"]]) for one in groups for row in one["subsets"] if row["runs"]]
    sizes = [(f"{n} run" + "s" * (n > 1), [r for r in rows if len(r[0]["runs"]) == n]) for n in (1, 2, 3)]
    nine = [(row, found["truth"][row["field"]]) for row in found["wholes"] if row["plant"] == plant]
    return [Estimates(*one) for one in (*sizes, ("9 runs", nine))]


def coverage_table(found: Numbers) -> str:
    """How many of the estimates' 95 % intervals hold the truth."""
    rows = []
    for plant in PLANTS:
        for name, group in estimates(found, plant):
            columns = [
                [holds(row["values"][k], row["sds"][k], truth[k])
                 for row, truth in group if row["values"][k] is not None]
                for k in range(6)
            ]  # fmt: skip
            every = list(chain.from_iterable(columns))
            share = f"{number(100 * sum(every) / len(every), 0)} %"
            rows.append([f"{plant}, {name}", *(f"{sum(one)} of {len(one)}" for one in columns), share])
    return table(("", *HEAD, "together"), rows)


def states(found: Numbers, plant: str) -> tuple[int, int]:
    """Of the six of each single run: how many are estimated, of all."""
    values = [value for row, _ in estimates(found, plant)[0].rows for value in row["values"]]
    return sum(value is not None for value in values), len(values)


def disagreeing(found: Numbers, plant: str) -> tuple[int, int]:
    """Of what is joined: how often the runs do not agree (p < 0.01), of all."""
    rows = [row for group in estimates(found, plant)[1:] for row, _ in group.rows]
    return sum(row["p"] < 0.01 for row in rows), len(rows)


def held_out_errors(found: Numbers, plant: str, size: int, body: int) -> list[float]:
    """Of predictions of runs that were not among the `size` runs that were fitted, of their manoeuvre, m."""
    return [
        cell[body]
        for one in found["groups"] if one["plant"] == plant
        for row in one["subsets"] if len(row["runs"]) == size
        for k, cell in enumerate(one_by_one(row), 1) if k not in row["runs"]
    ]  # fmt: skip


def one_by_one(row: Numbers) -> Iterator[Sequence[float]]:
    """(tractor, implement) on each run of the group, m."""
    yield from row["cells"]


def across(found: Numbers, plant: str, body: int) -> list[float]:
    """Of predictions of chirps and random steering by the step runs of their field, m."""
    return [cell[body] for one in found["wholes"] if one["plant"] == plant for cell in one["steps_predict"]]


def prediction_table(found: Numbers) -> str:
    """Held-out predictions over all groups of three runs."""
    rows = []
    for plant in PLANTS:
        kinds = (
            ("by the initial values", 0, held_out_errors), ("by one run", 1, held_out_errors),
            ("by two runs", 2, held_out_errors),
        )  # fmt: skip
        lists = [(name, [of(found, plant, size, body) for body in (0, 1)]) for name, size, of in kinds]
        lists.append(("chirps and random steering by steps", [across(found, plant, b) for b in (0, 1)]))
        true = [cell for one in found["groups"] if one["plant"] == plant for cell in one.get("by_truth", ())]
        if true:
            lists.append(("by all that is true", [[cell[b] for cell in true] for b in (0, 1)]))
        for name, bodies in lists:
            rows.append([f"{plant}, {name}", str(len(bodies[0])), *map(_quantiles, bodies), _near(bodies)])
    return table(("", "runs predicted", "tractor, m", "implement, m", f"≤ {NEAR_M:.2f} m"), rows)


def _quantiles(errors: Sequence[float]) -> str:
    return f"{number(median(errors), 2)} ({number(min(errors), 2)} to {number(max(errors), 2)})"


def _near(bodies: Sequence[Sequence[float]]) -> str:
    every = list(chain.from_iterable(bodies))
    return f"{sum(e <= NEAR_M for e in every)} of {len(every)}"
