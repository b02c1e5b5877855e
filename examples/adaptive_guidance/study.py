"""What live parameters are worth to guidance: `uv run python -m tilth.adaptive_guidance.study`.

A field is driven in lockstep by controllers that differ only in what they know of the soil, which is as the
machine file has it on the first half and 40 % softer on the second, or in patches with a wet end (`--part
patches`). Everything is from fixed seeds. Prints the tables of docs/guidance.md and writes its figure.
"""

import argparse
import math
import sys
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tilth.adaptive_guidance.controller import LIMITS
from tilth.adaptive_guidance.lockstep import EVERY, TimedEstimates, cross_track, run
from tilth.adaptive_guidance.plan import Work
from tilth.analysis import plots
from tilth.estimator.models.parameters import rig_of
from tilth.schemas.flow import PARAMETERS, Estimate, Status
from tilth.schemas.machine import Machine
from tilth.simulator.packaged import packaged_file
from tilth.simulator.scenario import STEP_S, Ground, Scenario, Soil, SoilChange

Array = NDArray[np.float64]

SEEDS: Final = (1, 2, 3)
WORK: Final = Work(rows=8, length=120.0, spacing=54.0, radius=20.0)
TIGHT: Final = replace(WORK, radius=12.0)
ONE_SOIL: Final = replace(WORK, rows_before=WORK.rows)  # it changes behind the last row
DITHER_DEG: Final = 0.3
SPEED: Final = 4.5  # m/s
SOFTER: Final = 0.6
SETTLED_S: Final = 10.0  # of the start that do not count
DRAWN_S: Final = 0.5  # between points of the figure
WRONG_SD: Final = 3.0
PATCHES: Final = (1, 2, 3, 4, 5)  # seeds of fields in patches
LANDS: Final = replace(WORK, spacing=42.0, radius=12.0, beside=6.0)  # as near as turns of that radius allow
STRAYED_S: Final = 15.0  # longer than the plan takes: on the first soft end the rig swings by a metre
LEARNED: Final = 2  # rows that are driven before it is counted
LEAST_GAP: Final = 0.1  # between fixed and all-knowing gains, that counts
KNOWN: Final = {
    "of the tractor's front axle": ("C_af",),
    "of its rear axle": ("C_ar",),
    "of both": ("C_af", "C_ar"),
    "of the implement": ("C_ai",),
}
MODES: Final = ("fixed", "adapting", "knowing")
COLOURS: Final = {"fixed": "#c0392b", "adapting": "#2471a3", "knowing": "#7f8c8d"}


class DrivenPath(NamedTuple):
    """One run: the implement's error over time."""

    time: Array  # s, (n,)
    error: Array  # m, (n,)
    row: NDArray[np.int64]  # of the plan there, below zero in a turn
    after: NDArray[np.bool_]  # whether the implement is on the soft half
    estimates: TimedEstimates
    rows: Estimate | None = None  # the last of the method rows


def scenario_of(machine: Machine, work: Work) -> Scenario:
    """Nominal soil, from half of the field on softer; ground that rolls and pushes."""
    nominal = dict(zip(PARAMETERS, rig_of(machine).theta.tolist(), strict=True))
    soft = SoilChange(
        north=0.0, east=middle(work), towards_deg=90.0, C_af=SOFTER, C_ar=SOFTER, C_ai=SOFTER
    )  # fmt: skip
    soil = Soil(parameters=nominal, changes=(soft,))  # type: ignore[arg-type]
    return Scenario(speed=SPEED, soil=soil, ground=Ground(roll_sd_deg=0.5, force_sd=0.01))


def patches_of(machine: Machine, work: Work, seed: int) -> Scenario:
    """Soil that is on average as the machine file has it, in patches, with an end that is softer."""
    rng, whole = np.random.default_rng([53, seed]), scenario_of(machine, work)
    wet = 1.0 - rng.uniform(0.3, 0.5)
    end = SoilChange(
        north=rng.uniform(0.5, 0.7) * work.length, east=0.0, towards_deg=rng.uniform(-30.0, 30.0), over=20.0,
        C_af=wet, C_ar=wet, C_ai=wet,
    )  # fmt: skip
    soil = replace(
        whole.soil, changes=(end,), patch_log_sd=rng.uniform(0.1, 0.3), patch_length=rng.uniform(20.0, 60.0),
        patch_across=rng.uniform(0.5, 2.0), patch_common=rng.uniform(0.3, 1.0),
    )  # fmt: skip
    return replace(whole, soil=soil)


def middle(work: Work) -> float:
    """Where the soil changes: half-way between two rows, m east."""
    before = work.rows / 2 if work.rows_before is None else work.rows_before
    return (before - 0.5) * work.spacing


def driven(
    machine: Machine, seed: int, mode: str, work: Work = WORK, patches: bool = False, **options: object
) -> DrivenPath:
    """patches: whether the field is in patches; `after` is then after the first LEARNED rows. options: of
    lockstep.run. Raises RuntimeError where a run did not come to its end."""
    scenario = patches_of(machine, work, seed) if patches else scenario_of(machine, work)
    line, truth, trace = run(machine, seed, scenario, work, mode, **options)  # type: ignore[arg-type]
    if trace.refused or trace.ended != "done":
        raise RuntimeError(f"the steering refused {trace.refused}; the run ended: {trace.ended}")
    error, at = cross_track(line, truth)
    row = line.row[at]
    after = truth.implement.y[::EVERY] > middle(work)
    if patches:
        after = (np.abs(row) >= LEARNED) & (at < len(line.row) - 20)  # behind which it brakes
    return DrivenPath(truth.time[::EVERY], error, row, after, trace.estimates, trace.rows)


def rms(runs: Iterable[DrivenPath], after: bool, turn: bool) -> float:
    """Of all samples of runs, m; not a number where there are none."""
    squares = [
        r.error[(r.time > SETTLED_S) & (r.after == after) & ((r.row < 0) == turn)] ** 2 for r in runs
    ]  # fmt: skip
    every = np.concatenate(squares)
    return float(np.sqrt(np.mean(every))) if len(every) else np.nan


PARTS: Final = ((False, False), (False, True), (True, False), (True, True))
"""(after, turn)"""


def wrong(
    estimates: TimedEstimates, machine: Machine, changed_s: float, direction: int, sign: float
) -> TimedEstimates:
    """Estimates that are off the truth by WRONG_SD along a principal direction of their own covariance.

    changed_s: from when on they speak of the soft soil.
    """
    nominal = np.log(rig_of(machine).theta)
    moved = []
    for at, estimate in estimates:
        if estimate.log_covariance and all(p.status is Status.ESTIMATED for p in estimate.parameters):
            truth = nominal + (np.log([SOFTER] * 3 + [1.0] * 3) if at > changed_s else 0.0)
            variances, axes = np.linalg.eigh(np.reshape(estimate.log_covariance, (6, 6)))
            off = sign * WRONG_SD * np.sqrt(variances[direction]) * axes[:, direction]
            estimate = _with(estimate, np.exp(truth + off))
        moved.append((at, estimate))
    return moved


def _with(estimate: Estimate, values: Array) -> Estimate:
    rows = zip(estimate.parameters, values.tolist(), strict=True)
    return replace(estimate, parameters=tuple(replace(p, value=v) for p, v in rows))


def learned_s(estimates: TimedEstimates, machine: Machine) -> float:
    """When an estimate first spoke of the soft soil: its C_af and C_ar below the middle of both soils."""
    half = np.sqrt(SOFTER) * rig_of(machine).theta
    for at, estimate in estimates:
        values = [p.value for p in estimate.parameters[:2]]
        if all(v is not None and v < h for v, h in zip(values, half, strict=False)):
            return at
    return np.inf


def main() -> None:
    """Print the tables of the study, or one of them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--figure", type=Path, help="write the figure here")
    parser.add_argument(
        "--part", choices=("main", "known", "wrong", "doubt", "patches", "dither"), help="only this table"
    )
    args = parser.parse_args()
    machine = packaged_file().machine
    if args.part in TABLES:
        TABLES[args.part](machine)
        return
    runs: dict[str, list[DrivenPath]] = {
        mode: [driven(machine, s, mode) for s in SEEDS] for mode in MODES[::2]
    }
    _say("| RMS of the implement's error, cm | rows before | turns before | rows after | turns after |")
    _say("|---|---|---|---|---|")
    for name in MODES[::2]:
        _line(name, runs[name])
    if args.part in (None, "main", "wrong"):
        runs["adapting"] = [driven(machine, s, "adapting") for s in SEEDS]
        _line("adapting", runs["adapting"])
    if args.part in (None, "known"):
        for name, known in KNOWN.items():
            _line(
                f"knows the stiffness {name} only",
                [driven(machine, s, "knowing", known=known) for s in SEEDS],
            )
    if args.part in (None, "wrong"):
        _wrong_table(machine, runs)
    if args.figure and "adapting" in runs:
        draw({mode: runs[mode][0] for mode in MODES}, args.figure)


def _wrong_table(machine: Machine, runs: dict[str, list[DrivenPath]]) -> None:
    estimates, fixed = runs["adapting"][0].estimates, [runs["fixed"][0]]
    changed = learned_s(estimates, machine)
    _say(f"\nEstimates off by {WRONG_SD:g} sd, seed {SEEDS[0]}; error over that with nominal gains:\n")
    _say("| direction | rows before | turns before | rows after | turns after |\n|---|---|---|---|---|")
    for direction in range(6):
        for sign in (1.0, -1.0):
            estimates = wrong(estimates, machine, changed, direction, sign)
            made = [driven(machine, SEEDS[0], "adapting", estimates=estimates)]
            ratios = [rms(made, *part) / rms(fixed, *part) for part in PARTS]
            cells = " | ".join(f"{ratio:.2f}" for ratio in ratios)
            _say(f"| {direction + 1}{'+' if sign > 0 else '-'} | {cells} |")


def _doubt_table(machine: Machine) -> None:
    """What it is worth not to go the last of the way to an estimate, also on a field of tighter turns."""
    _say("| RMS of the implement's error, cm | rows before | turns before | rows after | turns after |")
    _say("|---|---|---|---|---|")
    trusting = replace(LIMITS, doubt_sd=0.0)
    for name, mode, work, limits in (
        ("adapting without doubt", "adapting", WORK, trusting),
        ("fixed, turns of 12 m", "fixed", TIGHT, LIMITS),
        ("adapting, turns of 12 m", "adapting", TIGHT, LIMITS),
        ("adapting without doubt, turns of 12 m", "adapting", TIGHT, trusting),
    ):
        _line(name, [driven(machine, s, mode, work, limits=limits) for s in SEEDS])


def _patches_table(machine: Machine) -> None:
    """Fields in patches, after the second row: how much of the gap to all-knowing gains is recovered."""
    _say("| seed, where | fixed | adapting | knowing, cm | of the gap recovered |\n|---|---|---|---|---|")
    every: list[list[DrivenPath]] = [[], [], []]
    for seed in PATCHES:
        for runs, mode in zip(every, MODES, strict=True):
            runs.append(driven(machine, seed, mode, LANDS, patches=True, slack_s=STRAYED_S))
        _recovered(str(seed), [runs[-1:] for runs in every])
    _recovered("all", every)


def _recovered(name: str, runs: list[list[DrivenPath]]) -> None:
    """runs: of each of MODES."""
    for where, turn in (("rows", False), ("turns", True)):
        fixed, adapting, knowing = (rms(each, True, turn) for each in runs)
        counts = fixed - knowing >= LEAST_GAP * fixed
        share = f"{(fixed - adapting) / (fixed - knowing):.0%}" if counts else "no gap"
        cells = " | ".join(f"{100 * each:.1f}" for each in (fixed, adapting, knowing))
        _say(f"| {name}, {where} | {cells} | {share} |")


def _dither_table(machine: Machine) -> None:
    """On one soil: what a dither costs in rows, and what rows tell with it."""
    _say("| dither, deg | rows, cm | steering of its own in rows: rms, deg; share | sd of C in rows, % |")
    _say("|---|---|---|---|")
    for degrees in (0.0, DITHER_DEG):
        one = driven(machine, SEEDS[0], "adapting", ONE_SOIL, dither=math.radians(degrees))
        own = None if one.rows is None else one.rows.own_steering
        told = "-" if own is None else f"{math.degrees(own.rms):.2f}; {own.share:.0%}"
        variances = () if one.rows is None else one.rows.log_covariance[:15:7]  # the diagonal's first three
        cells = " ".join(f"{100 * math.sqrt(variance):.0f}" for variance in variances)
        _say(f"| {degrees:g} | {100 * rms([one], False, False):.1f} | {told} | {cells} |")


TABLES: Final = {"doubt": _doubt_table, "patches": _patches_table, "dither": _dither_table}
"""Those that need no runs of others."""


def _line(name: str, runs: list[DrivenPath]) -> None:
    _say(f"| {name} | " + " | ".join(f"{100 * rms(runs, *part):.1f}" for part in PARTS) + " |")


def _say(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def draw(runs: dict[str, DrivenPath], path: Path) -> None:
    """The implement's error over time, one line for each controller; turns are shaded."""
    with plots.look():
        figure = Figure(figsize=(10.0, 3.6), layout="constrained")
        axes = figure.subplots()
    for name, one in runs.items():
        _, at = np.unique(np.floor(one.time / DRAWN_S), return_index=True)
        axes.plot(one.time[at], 100 * one.error[at], color=COLOURS[name], label=name, linewidth=1.0)
    first = next(iter(runs.values()))
    turn = np.concatenate([[0], (first.row < 0).astype(int), [0]])
    for begin, end in zip(np.flatnonzero(np.diff(turn) > 0), np.flatnonzero(np.diff(turn) < 0), strict=True):
        axes.axvspan(begin * EVERY * STEP_S, end * EVERY * STEP_S, color="#eeeeee", linewidth=0)
    changed = float(first.time[np.argmax(first.after)])
    axes.axvline(changed, color="black", linewidth=0.8, linestyle="--")
    axes.annotate(" soil 40 % softer", (changed, axes.get_ylim()[1]), va="top")
    axes.set(xlabel="time, s (turns shaded)", ylabel="implement off its line, cm")
    axes.margins(x=0.0)
    axes.legend(loc="upper left", frameon=False, ncols=3)
    plots.save(figure, path)


if __name__ == "__main__":
    main()
