"""How good are the estimates on rigs of any size? A fractional design of drives on the virtual fleet.

    python bench/fleet.py [--count 24] [--others 2] [--first 0] [--processes 1] [--keep FILE]
                          [--summary]

Drive k is of rig k of simulator/fleet.py, and of cell k of bench/fleet_design.py: each 60 drives in a row are
all cells once, and fewer are nearly balanced. The file of each rig is its owner's. Further rows are of the
first of these drives: with the file of an owner who has not weighed the implement, and with one that has a
wrong number (`wrong_number`). What is done is kept in FILE, a line each, and not done again: it may be
stopped at any time, and --summary prints all tables of what is there; --first gives fresh rigs.
`python bench/estimation.py fleet` prints the first table. What else the fleet is asked: bench/wrong_files.py,
watch.py and calibration.py with --fleet.

Times count from when the wheels first turn beyond INFORMED. A file "has numbers" where C_af, C_ar, and C_ai
or C_ai over the implement's mass, are given with sds of 30 % at most. Numbers are judged as they were given
last, though they may have been withdrawn since. z is an error over its sd, both of natural logarithms.
"""

import math
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final

import numpy as np
import spatial_rows
from estimation_study import FAR, METHODS, Driven, first_informed, followed, harm
from estimation_table import (
    Bench,
    Line,
    Row,
    Z,
    drives_asked,
    drives_parser,
    figures,
    percents,
    print_rows,
    wilson,
)
from fleet_design import cell_of, scenario
from numpy.typing import NDArray

from tilth.estimator.diagnosis.consistency import CONTRADICTION
from tilth.estimator.diagnosis.open_numbers import HYPOTHESES
from tilth.estimator.rig.adjustments import Amount, scaled
from tilth.estimator.rig.numbers import changed
from tilth.schemas.flow import PARAMETERS
from tilth.schemas.machine import Machine
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
GIVEN_SD: Final = 0.3  # of a number that counts as given
AFTER_S: Final = (60.0, 120.0)  # of driving since steering began
FIGURES: Final = ((0.92, 0.98), 0.25, (0.85, 1.15), 0.07, 0.10)  # held; mean z; sd of z; |ln| of C, of sigma
AS_GOOD: Final = 1.1  # times the median error of the best method
HARM: Final = 1 / 500  # of the numbers given under wrong files may be beyond FAR[0]
WRONG_BY: Final = (0.3, 1.5)  # from, to: of the sds by which people are wrong
CELL: Final = (0.85, 30)  # a group of so many intervals of which fewer hold is to be explained


@dataclass(frozen=True, slots=True)
class FileKind:
    """Who wrote the machine files of a row."""

    reach: str
    mass_sd: float | None = None  # as of owners_text
    wrong: bool = False


OTHERS: Final = {
    f"{NAME}, implement's mass told to 10 %": FileKind("per_mass holds", 0.1),
    f"{NAME}, implement's mass told to 50 %": FileKind("per_mass holds", 0.5),
    f"{NAME}, wrong files": FileKind("at most 1 number in 500 beyond 4 sd", wrong=True),
}
"""Further rows by their names."""
OWNERS: Final = FileKind("")


# One drive.


def wrong_number(number: int) -> tuple[str, float]:
    """What the file of rig `number` has wrong, and by how much, SI: one of HYPOTHESES, whose last is m_t, the
    tractor's mass. Each comes once in 15 rigs in a row, and a step later in the next: by turns on all
    manoeuvres and grounds, whose numbers divide 15 (the wheels' scale had been wrong in chirps only)."""
    n = len(HYPOTHESES)
    rng, k = np.random.default_rng([52, number]), (number + number // n) % n
    amount = float(rng.choice([-1.0, 1.0]) * rng.uniform(*WRONG_BY) * HYPOTHESES[k].open_sd)
    return ("m_t" if k == len(HYPOTHESES) - 1 else HYPOTHESES[k].name), amount


def _with_wrong_number(machine: Machine, number: int) -> Machine:
    name, amount = wrong_number(number)
    if name == "m_t":
        return scaled("tractor", "mass")(machine, Amount(amount))
    return changed(machine, {name: Amount(amount)})


def follow(name: str, first: int, scale: float, k: int) -> Result:
    """Drive number first + k of a row: what was published of it. scale: of its seconds, for a try."""
    number, kind = first + k, OTHERS.get(name, OWNERS)
    rig, cell = drawn(number), cell_of(number)
    result: Result = {
        "row": name, "seed": k, "first": first, "scale": scale, "rig": number,
        "tractor": rig.tractor.kind, "implement": rig.implement.kind, "fill": rig.implement.fill,
        "duals": rig.tyres[1].twin_spacing > 0.0, "manoeuvre": cell.manoeuvre.name, "rms": cell.rms,
        "slope": cell.slope_deg, "plant": cell.plant, "methods": {},
    }  # fmt: skip
    asked, machine = scenario(rig, cell), true_machine(rig, cell.manoeuvre.receivers)
    began = time.perf_counter()
    try:
        truth = drive(machine, rig.seed, scale * asked.seconds, asked)
    except CannotBeDriven as error:
        return result | {"undriven": str(error)}
    file = parse_machine(owners_text(rig, cell.manoeuvre.receivers, mass_sd=kind.mass_sd))
    if kind.wrong:
        file, result = _with_wrong_number(file, number), result | {"wrong": wrong_number(number)}
    run = Driven(file, truth, machine)
    drove_s = time.perf_counter() - began
    heard = followed(run)
    steered_s = first_informed(heard.wheel, 0.0)
    ends = [steered_s + after for after in AFTER_S if steered_s + after <= truth.time[-1]]
    methods = {
        method: {
            "error": (rows[-1, 1:7] - heard.logs).tolist(),
            "sd": rows[-1, 7:13].tolist(),
            "last": _last(rows, heard.logs),
            "given": [_given(rows, end) for end in (*ends, math.inf)],  # and at the end of the drive
            "reasons": heard.reasons[method],
            "over_mass": heard.over_mass.get(method, (math.nan, math.nan)),
            "harm": harm(rows, heard.logs),
        }
        for method, rows in heard.series.items()
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
    """Whether C_af, C_ar, and C_ai or C_ai over the mass, are given at a time, s. rows: as Followed.series;
    what is not a number is not given."""
    at = int(np.searchsorted(rows[:, 0], end, side="right")) - 1
    if at < 0:
        return False
    front, rear, implement, over_mass = rows[at, [7, 8, 9, 13]] <= GIVEN_SD
    return bool(front and rear and (implement or over_mass))


# All of them.


def row(first: int, bench: Bench) -> list[Line]:
    """The lines of the table; drives that a file has are not made again."""
    return lines_of(_made(NAME, first, bench))


def another_row(name: str, first: int, count: int, bench: Bench) -> list[Line]:
    """The same of one of OTHERS, over fewer drives."""
    made = _made(name, first, replace(bench, runs=count))
    if OTHERS[name].wrong:
        return lines_of_wrong(made)
    return [
        *(line for method in METHODS for line in _over_mass(made, method)),
        *(line for method in METHODS for line in _figures(method, *_numbers(made, method))),
        *spatial_rows.reasons(made), *_others(made),
    ]  # fmt: skip


def _made(name: str, first: int, bench: Bench) -> list[Result]:
    have, keep = spatial_rows.kept(bench, name, first), partial(spatial_rows.keep, bench)
    return bench.each(partial(follow, name, first, bench.scale), COUNT, have, keep)


def lines_of(made: Sequence[Result]) -> list[Line]:
    lines = list[Line]()
    for method in METHODS:
        error, sd = _numbers(made, method)
        lines += _figures(method, error, sd)
    lines += _tails(made)
    lines += _recommended(made)
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


def _tails(made: Sequence[Result]) -> Iterator[Line]:
    """How many numbers of all methods are far off."""
    z = np.concatenate([np.abs(np.divide(*_numbers(made, method))).ravel() for method in METHODS])
    n, (far, very_far) = int(np.isfinite(z).sum()), (int(np.sum(z > limit)) for limit in FAR)
    yield Line(
        "beyond 4 and 6 sds, all methods", f"{far} and {very_far} of {n}", "≤ 1 in 1000; 0",
        far <= math.ceil(n / 1000) and very_far == 0, (far, very_far, n),
    )  # fmt: skip


def _recommended(made: Sequence[Result]) -> Iterator[Line]:
    """Beside each method, where both have a number: what is recommended must be as good as the best."""
    error, sd = _numbers(made, METHODS[0])
    for k, name in enumerate(PARAMETERS):
        said, held = list[str](), True
        for method in METHODS[1:]:
            other, other_sd = _numbers(made, method)
            both = np.isfinite(error[:, k]) & np.isfinite(other[:, k])
            if not both.any():
                continue
            pairs = ((error[both, k], sd[both, k]), (other[both, k], other_sd[both, k]))
            (mine, its), (hits, its_hits) = (
                [float(np.median(np.abs(off))) for off, _ in pairs],
                [int(np.sum(np.abs(off) < Z * wide)) for off, wide in pairs],
            )
            said.append(
                f"{percents([mine, its])} beside {method}, {hits} and {its_hits} of {both.sum()} hold"
            )
            held &= both.sum() < CELL[1] or (mine <= AS_GOOD * its and hits >= its_hits - 0.03 * both.sum())
        yield Line(f"recommended {name}: |ln|", "; ".join(said) or "no number", "as good as the best", held)


def lines_of_wrong(made: Sequence[Result]) -> list[Line]:
    """The harm that wrong files do, all numbers of all instants, and whether they are contradicted."""
    driven = [one for one in made if "undriven" not in one]
    counts = {
        method: np.sum([one["methods"][method]["harm"] for one in driven if method in one["methods"]], axis=0)
        for method in METHODS if any(method in one["methods"] for one in driven)
    }  # fmt: skip
    lines = [
        Line(
            f"{method}: numbers beyond {FAR[0]:g} sd", f"{beyond} of {n}", "≤ 1 in 500",
            bool(beyond <= HARM * n), (int(beyond), int(n)),
        )
        for method, (n, beyond) in counts.items()
    ]  # fmt: skip
    for one in driven:
        harm = {method: said["harm"][1] for method, said in one["methods"].items() if said["harm"][1]}
        name, amount = one["wrong"]
        lines.append(
            Line(
                f"rig {one['rig']}, {name} off by {amount:+.3g}",
                f"beyond: {harm or 'none'}; contradicted: {'; '.join(one['contradictions'][:1]) or 'no'}",
            )
        )
    return lines


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
    hours = sum(one.get("drive_s", 0.0) for one in made) / 3600.0
    yield Line(
        "right files contradicted", f"{len(bad)} of {len(made)} in {hours:.1f} h: rigs {bad}", "0", not bad
    )
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
    parser = drives_parser(__doc__, 24, "fleet.jsonl", f"drives; the whole design has {COUNT}")
    parser.add_argument(
        "--others", type=int, help="drives of each further row; 0: none (a tenth of --count, 1 at least)"
    )
    args = drives_asked(parser)
    others = max(args.count // 10, 1) if args.others is None else args.others
    rows = [
        Row(NAME, f"rigs from {args.first}; {REACH}", partial(row, args.first)),
        *(
            Row(name, f"rigs from {args.first}; {kind.reach}", partial(another_row, name, args.first, others))
            for name, kind in OTHERS.items() if others > 0
        ),
    ]  # fmt: skip
    print_rows(args, rows)


if __name__ == "__main__":
    main()
