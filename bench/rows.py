"""What do straight rows tell? Drives of rigs of the fleet under autosteers of different make, each fit judged
by the bound of its drive.

    python bench/rows.py [--row usual] [--count 12] [--first 0] [--minutes 2] [--processes 1]
                         [--keep rows.jsonl] [--summary]

Drive k is of rig k of simulator/fleet.py, whose owner's file the fit is given; make of the autosteer, plant
and roughness of the ground go round by `cell_of`. The bound and the own share are those of the true drive
(studies/rows/bound.py, own_share.py). What is done is kept, a line each, and not done again.

Three rows go on from there. `hours` drives blocks of ten minutes, each on other ground, until --minutes are
over, and each is fitted from the posterior of the one before, as the daemon does. That takes hours. What the
method does with blocks, its drift, its test of a change and what it publishes, is linear in what each tells:
so in `ten_hours` the row that was driven stands for all of them by its information, each errs by chance as
that says, and the model errs in all alike. `held_out` drives 30 s of another row and of a headland turn,
and follows the implement's way from the true start with what was fitted, with the true parameters, and with
those of the file.

z is an error over its sd, both of natural logarithms. An sd more than 10 % below the bound is a fault. Of
each drive: error (sd, bound) of the six in %, rms of the wheel angle and of what is the steering's own in it,
and its share: by another drive without ground, by past innovations at the truth, and as the fit says.
"""

import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

import numpy as np
import spatial_rows
from estimation_study import Driven, poses_and_segments
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
)
from held_out import Way, distances
from numpy.typing import NDArray

sys.path.append(str(Path(__file__).resolve().parents[1]))

from studies.rows.bound import bound_of, together
from studies.rows.own_share import own_of
from studies.rows.study import longest
from tilth.analysis.fit.rig import fitted_rig
from tilth.estimator.filters import unknowns
from tilth.estimator.filters.unknowns import SIX
from tilth.estimator.methods import pem, rows
from tilth.estimator.record.record import TICK_NS, WHEEL_ANGLE, Record, Segment, concatenate
from tilth.estimator.results.method_state import drifted
from tilth.schemas.flow import PARAMETERS
from tilth.schemas.machine import Machine
from tilth.schemas.machine_toml import parse_machine
from tilth.simulator.drive import drive
from tilth.simulator.fleet import FleetRig, drawn, ground_of, headlands_of, scenario_of
from tilth.simulator.fleet_files import owners_text, true_machine
from tilth.simulator.scenario import Autosteer, CannotBeDriven, Fieldwork, RowSteering, Scenario

Array = NDArray[np.float64]
Result = dict[str, Any]
"""Of `follow`: one line of JSON."""

NAME: Final = "rows"
BEGIN_S: Final = 5.0  # of a drive, before which nothing is used
SETTLING_S: Final = 10.0  # of the bound, besides; the fit needs less
SHORT_S: Final = (25.0, 15.0)  # of a short row, and of the way to the next, which is left out
SEGMENT_S: Final = 0.2
FAULT: Final = 0.9  # least published sd over the bound
REACH: Final = (0.92, 0.98, 0.25, 0.85, 0.4, 1.5)
"""Pooled from, to and |mean z|; of each the least share, largest |mean z|, and median sd over the bound."""
REACH_TEXT: Final = (
    "pooled 92 to 98 % hold, mean z ± 0.25; each ≥ 85 %, ± 0.4; sd ≤ 1.5 times the bound, none < 0.9"
)
OVER_BOUND: Final = 1.3  # of hours: sd, at most, over the bound with the model's part
LEAST_SD: Final = 0.03  # or this
MOST_S: Final = 0.3  # of processor, for a fit of two minutes
HELD_OUT: Final = "held_out"
HOURS: Final = "hours"
PIECES: Final = "ten_hours"
TEN_HOURS: Final = 60  # blocks
MAKES: Final[tuple[Literal["pid", "valve", "pursuit"], ...]] = ("pid", "valve", "pursuit")
PLANTS: Final[tuple[Literal["planar", "spatial"], ...]] = ("planar", "spatial")
GROUNDS: Final = (0.005, 0.010, 0.015)  # m, rms


class Cell(NamedTuple):
    """What drive k is of, besides its rig."""

    make: Literal["pid", "valve", "pursuit"]
    plant: Literal["planar", "spatial"]
    rms: float


def cell_of(k: int) -> Cell:
    """Each 18 drives in a row are all cells once."""
    return Cell(MAKES[k // 2 % 3], PLANTS[k % 2], GROUNDS[(k // 2 + k // 6) % 3])


Change = Callable[[int, Scenario], Scenario]


def _steered(scenario: Scenario, **keys: Any) -> Scenario:
    assert isinstance(scenario.steering, RowSteering) and scenario.steering.autosteer
    return replace(
        scenario, steering=replace(scenario.steering, autosteer=replace(scenario.steering.autosteer, **keys))
    )


def _sloping(k: int, scenario: Scenario) -> Scenario:
    downhill = 90.0 if k % 2 == 0 else -90.0
    return replace(scenario, ground=replace(scenario.ground, slope_deg=3.0, downhill_deg=downhill))


ROWS: Final[dict[str, Change]] = {
    "usual": lambda k, scenario: scenario,
    "short": lambda k, scenario: scenario,  # whose fit is given short rows of it
    "manual": lambda k, scenario: _steered(scenario, make="manual"),
    "play": lambda k, scenario: replace(scenario, wheel=replace(scenario.wheel, dead_band_deg=0.15)),
    "drift": lambda k, scenario: replace(scenario, wheel=replace(scenario.wheel, zero_drift_degps=0.3 / 600)),
    "slope": _sloping,
    "nothing_own": lambda k, scenario: _steered(scenario, own=0.0),
    "held_out": lambda k, scenario: scenario,  # after which what was found is tried
    "hours": lambda k, scenario: scenario,
    "ten_hours": lambda k, scenario: scenario,  # after which it stands for all blocks of them
    "limit_cycle": lambda k, scenario: _steered(scenario, make="valve", own=0.0, slack_deg=0.1),
    "dither": lambda k, scenario: _steered(scenario, own=0.0, dither_deg=0.3),
}
"""What differs from the usual row, of drive k."""


class Fit(NamedTuple):
    """What a method says of a row."""

    mean: Array  # (n,), of unknowns.NAMES
    covariance: Array  # (n, n), without errors of the model
    sd: Array  # (6,)
    own_share: float
    refused: str | None  # why the method would not use it


def fit(machine: Machine, records: list[Record]) -> Fit:
    """By the method that is judged, as it publishes it: without a number where it withholds one."""
    state = rows.initial(machine)
    found = rows.fit(machine, rows.Job(0, records[-1].end_ns, records, False, state.mean, state.covariance))
    sd = np.sqrt(np.diag(found.covariance)[:6] + state.model_sd**2)
    return Fit(found.mean, found.covariance, sd, found.own_share, found.refused)


# One drive.


def scenario_for(row: str, number: int, minutes: float) -> tuple[FleetRig, Scenario]:
    """The rig and the scenario of drive `number`."""
    rig, cell = drawn(number), cell_of(number)
    base = Scenario(
        seconds=60.0 * minutes + BEGIN_S + SETTLING_S,
        seed=number,
        plant=cell.plant,
        speed=rig.speed,
        steering=RowSteering(position_sd=0.008, autosteer=Autosteer(cell.make)),
        ground=ground_of(cell.plant, cell.rms, 0.0),
        other_traffic=False,
    )
    return rig, ROWS[row](number, scenario_of(rig, base))


def usable_of(run: Driven) -> list[Segment]:
    """The row that was driven."""
    made = poses_and_segments(run)
    return longest([segment for pose, segment in made if run.seconds_of(pose.t_ns) >= BEGIN_S])


def follow(row: str, first: int, minutes: float, k: int) -> Result:
    """Drive number first + k: what is said of it, and what can be."""
    number = first + k
    rig, asked = scenario_for(row, number, minutes)
    cell, began = cell_of(number), time.perf_counter()
    result: Result = {
        "row": f"{NAME} {row}", "seed": k, "first": first, "scale": minutes, "rig": number,
        "speed": rig.speed, "make": cell.make, "plant": cell.plant, "rms": cell.rms,
    }  # fmt: skip
    machine, file = true_machine(rig), parse_machine(owners_text(rig))
    try:
        truth = drive(machine, number, asked.seconds, asked)
    except CannotBeDriven as error:
        return result | {"undriven": str(error)}
    whole = (BEGIN_S, asked.seconds)
    least = bound_of(machine, truth, whole, file)
    own = own_of(machine, truth, whole)
    run = Driven(file, truth, machine)
    usable = usable_of(run)
    made_s = time.perf_counter() - began
    count, every = (round(s / SEGMENT_S) for s in (SHORT_S[0], sum(SHORT_S)))
    short = [usable[k : k + count] for k in range(0, len(usable) - count + 1, every)]
    began = time.process_time()
    said = fit(file, [concatenate(each) for each in (short if row == "short" else [usable])])
    fit_s = time.process_time() - began
    if row == PIECES:
        times, metres = BLOCK_MINUTES / minutes, rig.speed * 60.0 * BLOCK_MINUTES
        result["blocks"] = in_pieces(file, said.covariance, times, metres, TEN_HOURS, number)
    if row == HELD_OUT:
        result |= {"ways": ways_on(rig, asked, file, said.mean)}
    return result | {
        "error": (said.mean[:6] - run.logs).tolist(), "sd": said.sd.tolist(), "bound": least.sd.tolist(),
        "step": least.step.tolist(), "said_share": said.own_share, "refused": said.refused,
        "unexplained": least.unexplained, "wheel_deg": own.driven_deg, "own_deg": own.own_deg,
        "share": own.share, "seconds": SEGMENT_S * len(usable) - SETTLING_S, "made_s": made_s,
        "fit_s": fit_s,
    }  # fmt: skip


# What comes after it.


def ways_on(rig: FleetRig, row: Scenario, file: Machine, found: Array) -> dict[str, list[float]]:
    """rms distance of the implement from its true way, m, over WAY_S of another row and of a headland turn:
    with the six that were found, those that are true, and those that the file says, all else as it is. found:
    (n,) of unknowns.NAMES."""
    machine, way = true_machine(rig), {}
    field = Fieldwork(length=40.0, turns=headlands_of(rig), position_sd=0.008, autosteer=Autosteer("pid"))
    for name, steering, seconds in (("row", row.steering, 2 * WAY_S), ("turn", field, 4 * WAY_S)):
        asked = replace(row, seed=row.seed + ANOTHER, seconds=seconds, steering=steering)
        truth = drive(machine, asked.seed, seconds, asked)
        run = Driven(file, truth, machine)
        usable = usable_of(run)
        count = round(WAY_S / SEGMENT_S)
        parts = [concatenate(usable[k : k + count]) for k in range(0, len(usable) - count + 1, 10)]
        record = max(parts, key=lambda part: float(np.ptp(part.ticks[:, WHEEL_ANGLE])))
        true, at_s = Way(truth.time, truth.states, truth.rig), run.seconds_of(record.t_ns)
        wheel = truth.nuisances["wheel_zero"], truth.nuisances["wheel_gain"]
        made = [fitted_rig(file, point) for point in (found, unknowns.prior(file)[0])]
        by_six = [truth.rig._replace(**{name: getattr(one, name) for name in PARAMETERS}) for one in made]
        rigs = by_six[0], truth.rig, by_six[1]
        way[name] = [distances(true, record, at_s, one, wheel, level=True)[1] for one in rigs]
    return way


WAY_S: Final = 30.0
ANOTHER: Final = 1_000_000  # on the seed, of another drive of the same rig


def follow_hours(first: int, minutes: float, k: int) -> Result:
    """Drive number first + k, block after block."""
    number, began = first + k, time.perf_counter()
    rig, asked = scenario_for("usual", number, min(minutes, BLOCK_MINUTES))
    result: Result = {"row": f"{NAME} {HOURS}", "seed": k, "first": first, "scale": minutes, "rig": number}
    machine, file = true_machine(rig), parse_machine(owners_text(rig))
    state, bounds, whole, out = rows.initial(file), [], (BEGIN_S, asked.seconds), []
    for block in range(1, max(1, round(minutes / BLOCK_MINUTES)) + 1):
        asked = replace(asked, seed=number + ANOTHER * block)
        try:
            truth = drive(machine, asked.seed, asked.seconds, asked)
        except CannotBeDriven as error:
            return result | {"undriven": str(error)}
        bounds.append(bound_of(machine, truth, whole, file))
        run = Driven(file, truth, machine)
        usable = usable_of(run)
        record = concatenate(usable)
        state.before_m += rig.speed * len(record.ticks) * TICK_NS * 1e-9
        known = drifted(state, state.before_covariance, state.before_m)
        state.job = rows.Job(0, record.end_ns, [record], True, state.before_mean.copy(), known)
        made = rows.fit(file, state.job)
        rows.adopt(state, file, made, record.end_ns)
        sd, least = np.sqrt(np.diag(rows.published_covariance(state))), together(bounds)
        refused = made.refused and made.refused.value
        out.append(of_block(state.mean[:6] - run.logs, sd, least, refused, made.changed))
    return result | {"blocks": out, "made_s": time.perf_counter() - began}


def of_block(error: Array, sd: Array, bound: Array, refused: str | None, changed: bool) -> Result:
    """What is said after a block, of the six."""
    return {
        "error": error.tolist(), "sd": sd.tolist(), "bound": bound.tolist(), "refused": refused,
        "changed": changed,
    }  # fmt: skip


def in_pieces(
    machine: Machine, row: Array, times: float, metres: float, count: int, seed: int
) -> list[Result]:
    """What the method says after each of `count` blocks of so many metres.

    row: (n, n), the covariance after a row from the prior of the machine file; a block tells `times` as much.
    """
    state, rng = rows.initial(machine), np.random.default_rng(seed)
    model_sd = np.full(6, rows.TUNING.model_sd)
    covariance = pem.with_known_masses(state.covariance)
    active = np.flatnonzero(np.diag(covariance) > 0.0)
    at, prior = np.ix_(active, active), np.linalg.inv(covariance[np.ix_(active, active)])
    sizes, axes = np.linalg.eigh(np.linalg.inv((row - pem.of_masses(state.covariance))[at]) - prior)
    told = times * (axes * np.maximum(sizes, 0.0)) @ axes.T  # filters differ: not less than nothing
    by_chance = axes * np.sqrt(times * np.maximum(sizes, 0.0))
    true, mean, out = np.sqrt(np.diag(covariance)[active]) * rng.standard_normal(len(active)), 0.0, []
    found = true.copy()
    found[SIX] += model_sd * rng.standard_normal(6)
    for block in range(1, count + 1):
        known = drifted(state, covariance, metres if block > 1 else 0.0)
        covariance = known.copy()
        covariance[at] = np.linalg.inv(np.linalg.inv(known[at]) + told)
        off = told @ (found - mean) + by_chance @ rng.standard_normal(len(active))
        moved = covariance[at] @ off
        mean = mean + moved
        chi_square = pem.contradiction(moved[SIX], known[SIX, SIX], covariance[SIX, SIX], model_sd)
        sd = np.sqrt(np.diag(covariance)[SIX] + model_sd**2)
        bound = np.sqrt(np.diag(np.linalg.inv(prior + block * told))[SIX])
        changed = chi_square > rows.TUNING.change_chi_square
        out.append(of_block((mean - true)[SIX], sd, bound, None, changed))
    return out


BLOCK_MINUTES: Final = 10.0


# The table.


def row(name: str, first: int, bench: Bench) -> list[Line]:
    """The lines of the table; drives that a file has are not made again."""
    have, usual = (spatial_rows.kept(bench, f"{NAME} {each}", first) for each in (name, "usual"))
    if name == HOURS:
        made = bench.each(
            partial(follow_hours, first, bench.scale), 6, have, partial(spatial_rows.keep, bench)
        )
        return hours_lines(made)
    run = partial(follow, name, first, bench.scale)
    made = bench.each(run, 12, have, partial(spatial_rows.keep, bench))
    if name == PIECES:
        return hours_lines(made)
    return lines_of(made, {} if name == "usual" else usual)


def hours_lines(made: Sequence[Result]) -> list[Line]:
    """What is said after the first block, half of them, and at the end. made: each with its `blocks`."""
    driven = [one["blocks"] for one in made if "blocks" in one]
    used = [blocks for blocks in driven if not all(block["refused"] for block in blocks)]
    lines = [
        Line("could not be driven", f"rigs {[one['rig'] for one in made if 'blocks' not in one]}"),
        Line("withheld", f"{len(driven) - len(used)} of {len(driven)}"),
    ]
    if not used:
        return lines
    for name, at in (("first block", 0), ("half of them", len(used[0]) // 2), ("end", -1)):
        error, sd, bound = (
            np.array([blocks[at][key] for blocks in used]) for key in ("error", "sd", "bound")
        )
        z = error / sd
        over = sd / np.maximum(OVER_BOUND * np.hypot(bound, rows.TUNING.model_sd), LEAST_SD)
        sizes = "; ".join(
            percents(np.median(np.abs(each), axis=0).tolist(), 0) for each in (error, sd, bound)
        )
        lines.append(Line(
            name,
            f"{int(np.sum(np.abs(z) < Z))} of {z.size} hold, z {np.mean(z):+.2f} ± {np.std(z):.2f}, largest "
            f"{np.abs(z).max():.1f}; |error|, sd, bound: {sizes}; sd over its limit, largest: "
            + percents(over.max(axis=0).tolist(), 0),
            "92 %; sd ≤ 1.3 times bound with the model's part, or 3 %",
            bool(np.mean(np.abs(z) < Z) >= REACH[0] and np.all(over <= 1.0)), (float(np.mean(z)),),
        ))  # fmt: skip
    changes = sum(block["changed"] for blocks in used for block in blocks)
    figure = f"{changes} in {sum(map(len, used))} blocks"
    return [*lines, Line("false changes of soil", figure, "0", changes == 0, (changes,))]


def lines_of(made: Sequence[Result], usual: Mapping[int, Result] | None = None) -> list[Line]:
    """usual: seed -> the same drives without what is special of these, as far as there are such."""
    driven = [one for one in made if "error" in one and not one["refused"]]
    withheld = [one for one in made if "error" in one and one["refused"]]
    lines = [
        Line("could not be driven", f"rigs {[one['rig'] for one in made if 'error' not in one]}"),
        Line("withheld", f"rigs {[one['rig'] for one in withheld]}"),
        *_drives(withheld),
    ]
    if not driven:
        return lines
    for name in ("all", *MAKES, *PLANTS):
        chosen = [one for one in driven if name in ("all", one["make"], one["plant"])]
        lines += _held(name, chosen)
    lines += _seconds(driven)
    return [*lines, *_each(driven), *_over_usual(driven, usual or {}), *_ways(driven), *_drives(driven)]


def _array(made: Sequence[Result], key: str) -> Array:
    return np.array([one[key] for one in made], np.float64).reshape(len(made), -1)


def _held(name: str, made: Sequence[Result]) -> Iterator[Line]:
    if not made:
        return
    z = _array(made, "error") / _array(made, "sd")
    hits, mean = int(np.sum(np.abs(z) < Z)), float(np.mean(z))
    share, (least, most, far) = hits / z.size, REACH[:3]
    held = least <= share <= most and abs(mean) <= far if name == "all" else None
    yield Line(
        f"{name}: 95 % intervals that hold",
        f"{hits} of {z.size}; z {mean:+.2f} ± {np.std(z):.2f}, largest {np.abs(z).max():.1f}",
        "92 to 98 %; ± 0.25" if name == "all" else "", held, (share, mean),
    )  # fmt: skip


def _seconds(made: Sequence[Result]) -> Iterator[Line]:
    """Of processor, for two minutes. The first fit of a process waits for its compiled code besides."""
    took = [120.0 * one["fit_s"] / one["seconds"] for one in made if "fit_s" in one]
    if took:
        middle = float(np.median(took))
        figure = f"median {middle:.2f} s of processor, {min(took):.2f} to {max(took):.2f}"
        yield Line("two minutes are fitted in", figure, f"≤ {MOST_S} s", middle <= MOST_S, (middle,))


def _each(made: Sequence[Result]) -> Iterator[Line]:
    error, sd, bound, step = (_array(made, key).T for key in ("error", "sd", "bound", "step"))
    least, far, wide = REACH[3:]
    for name, off, wide_by, allowed, one_step in zip(PARAMETERS, error, sd, bound, step, strict=True):
        z, over = off / wide_by, wide_by / allowed
        hits, mean, middle = int(np.sum(np.abs(z) < Z)), float(np.mean(z)), float(np.median(over))
        faults = int(np.sum(over < FAULT))
        sizes = percents([float(np.median(each)) for each in (np.abs(off), wide_by, allowed)], 0)
        from_truth = float(np.sqrt(np.mean((one_step / allowed) ** 2)))
        yield Line(
            name,
            f"{hits}/{len(z)} hold, z {mean:+.2f}; |error|, sd, bound: {sizes}; sd over bound {middle:.2f}, "
            f"{faults} < {FAULT}; a step from the truth: {from_truth:.2f} of the bound",
            "≥ 85 %; ± 0.4; ≤ 1.5; 0",
            hits >= least * len(z) and abs(mean) <= far and middle <= wide and faults == 0,
            (hits / len(z), mean, middle, from_truth),
        )


def _over_usual(made: Sequence[Result], usual: Mapping[int, Result]) -> Iterator[Line]:
    both = [one for one in made if "sd" in usual.get(one["seed"], {})]
    if both:
        over = _array(both, "sd") / _array([usual[one["seed"]] for one in both], "sd")
        middle, most = np.median(over, axis=0), float(over.max())
        yield Line(
            "sds over those of the same usual rows", f"{figures(middle.tolist())}, largest {most:.2f}",
            "≤ 1.5",
            bool(np.all(middle <= REACH[-1])), (most,),
        )  # fmt: skip


def _ways(made: Sequence[Result]) -> Iterator[Line]:
    for name in ("row", "turn"):
        way = np.array([one["ways"][name] for one in made if "ways" in one]).reshape(-1, 3)
        if len(way):
            found, true, told = (float(np.sqrt(np.mean(each**2))) for each in way.T)
            over = float(np.median(way[:, 0] / way[:, 1]))
            yield Line(
                f"implement's way, 30 s of a {name}",
                f"rms over {len(way)} drives {found:.2f} m; true parameters {true:.2f}, file's {told:.2f}; "
                f"over the true ones' {found / true:.2f}, median {over:.2f}; file's {told / true:.2f}",
                "≤ 1.15", found <= 1.15 * true, (found, true, told),
            )  # fmt: skip


def _drives(made: Sequence[Result]) -> Iterator[Line]:
    for one in made:
        error, sd, bound = (100 * np.array(one[key]) for key in ("error", "sd", "bound"))
        shown = "  ".join(f"{e:+.0f} ({s:.0f}, {b:.0f})" for e, s, b in zip(error, sd, bound, strict=True))
        yield Line(
            f"{one['rig']} {one['make']}, {one['plant']}, {100 * one['rms']:g} cm, {one['speed']:.1f} m/s",
            f"{shown}; wheel {one['wheel_deg']:.2f}°, own {one['own_deg']:.2f}°; shares "
            + figures([one[key] for key in ("share", "unexplained", "said_share")])
            + (f"; withheld: {one['refused']}" if one["refused"] else ""),
        )


def main() -> None:
    parser = drives_parser(__doc__, 12, "rows.jsonl")
    parser.add_argument("--row", choices=ROWS, default="usual")
    parser.add_argument("--minutes", type=float, default=2.0, help="of row that count, of each drive")
    args = drives_asked(parser)
    title = Row(f"{NAME} {args.row}", REACH_TEXT, partial(row, args.row, args.first))
    print_rows(args, [title], args.minutes, 230)


if __name__ == "__main__":
    main()
