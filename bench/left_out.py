"""What comes of each effect that an estimator does not know: `pem` on the spatial plant, a part left out.

    python bench/left_out.py [--logs DIR] [--runs 12] [--processes 2] [--size light …] [--out FILE]
                             [--only TEXT …] [--picture FILE.svg]

Rigs of three sizes (`SIZES`); tyres, soil and sensors are drawn anew for each run, ground of 1 cm rms, random
steering of 6° for a minute. The product's own estimator runs on them, with the unknowns of one effect held at
the value that means "there is none", or with another log of the same seed, on a plant that has what no
estimator knows. What an effect moves is beside the row `beside` of the same run: the same plant, nothing left
out. Lines of JSON in FILE are not done again.
"""

import argparse
import json
from collections.abc import Callable, Collection, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Final, NamedTuple
from unittest import mock

import numpy as np
import spatial_logs
from numpy.typing import NDArray
from spatial_logs import LogRow

from tilth.estimator import fold
from tilth.estimator.filters import unknowns
from tilth.estimator.filters.rig_setup import RigSetup, rig_setup
from tilth.estimator.filters.unknowns import AT, MASSES, NAMES, ROLL_ZEROS
from tilth.estimator.methods import pem
from tilth.estimator.models.parameters import TABLE_5_1
from tilth.estimator.record import record_builder
from tilth.estimator.record.record import Segment
from tilth.replay.readers.any_log import frames
from tilth.schemas.axle_loads import axle_loads
from tilth.schemas.flow import PARAMETERS, Pose
from tilth.schemas.machine import Machine
from tilth.schemas.machine_toml import parse_machine
from tilth.schemas.plausible import GRAVITY
from tilth.simulator.scenario import Scenario, Spatial

Array = NDArray[np.float64]
Given = list[tuple[Pose, Segment | None]]
Run = dict[str, tuple[Array, Array]]
"""Of an effect: errors of the six logarithms, their sds."""
Known = dict[tuple[str, int], Run]
"""Of a size and a seed."""

ROLL_MODES: Final = tuple(name for name in NAMES if name.startswith("roll_") and name not in ROLL_ZEROS)


SECONDS: Final = 60.0
KEYS: Final = {"tractor": "a b c mass yaw_inertia cg_height", "implement": "d e mass yaw_inertia cg_height"}


def _size(
    name: str, tractor: str, implement: str, deflection: tuple[float, ...], track: tuple[float, float, float]
) -> LogRow:
    """Of tractor and implement as in `KEYS`; deflections and tracks, m, of front, rear and implement."""
    rig: dict[str, dict[str, float]] = {
        body: dict(zip(KEYS[body].split(), map(float, values.split()), strict=True))
        for body, values in (("tractor", tractor), ("implement", implement))
    }
    t, i = rig["tractor"], rig["implement"]
    loads = axle_loads(t["a"], t["b"], t["c"], i["d"], i["e"], t["mass"], i["mass"], GRAVITY)
    for axle, load, coefficient in zip(("front", "rear", "implement"), loads, (7.0, 8.0, 5.0), strict=True):
        rig[f"tyres.{axle}"] = {"cornering_stiffness": coefficient * load}
    each = tuple(load / 2 / pressed_in for load, pressed_in in zip(loads, deflection, strict=True))
    of_size = Spatial(draw=True, vertical_stiffness=(each[0], each[1], each[2]), track=track)
    return LogRow(name, 12, SECONDS, lambda seed, have: {"spatial": of_size}, rig=rig)


SIZES: Final = {
    "light": _size(
        "light", "1.35 1.0 1.7 5000 10000 1.0", "3.0 0.1 2000 3000 1.0", (0.06, 0.06, 0.05), (1.6, 1.6, 1.7)
    ),
    "usual": LogRow("usual", 12, SECONDS),
    "heavy": _size(
        "heavy", "1.85 1.3 2.3 12000 48000 1.2", "4.5 0.4 10000 36000 1.4", (0.08,) * 3, (1.8, 1.7, 2.1)
    ),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Plant:
    """Of another log of the same seed."""

    folder: str
    scenario: Callable[[Scenario], Scenario] = lambda scenario: scenario
    further_forward: float = 0.0  # m, by which the implement's CG is ahead of where its file says


def _wheel(folder: str, **keys: Any) -> Plant:
    return Plant(folder, lambda asked: replace(asked, wheel=replace(asked.wheel, **keys)))


def _rolling(share: float) -> Plant:
    return Plant(f"rolling_{share:g}", lambda asked: replace(asked, soil=replace(asked.soil, rolling=share)))


def _no_ellipse(asked: Scenario) -> Scenario:
    return replace(asked, spatial=replace(asked.spatial, combined=False))


def _uphill(asked: Scenario) -> Scenario:
    """The rig starts northwards, and random steering keeps it about so."""
    return replace(asked, ground=replace(asked.ground, slope_deg=3.0, downhill_deg=180.0))


def _uphill_without_ellipse(asked: Scenario) -> Scenario:
    return _uphill(_no_ellipse(asked))


PULL_3, PULL_10 = _rolling(0.03), _rolling(0.10)


@dataclass(frozen=True, slots=True)
class Effect:
    """What is left out: unknowns held at these values, and what becomes of the setup; or what the plant of
    another log has that no estimator knows."""

    held: dict[str, float] = field(default_factory=dict)
    setup: Callable[[RigSetup], RigSetup] = lambda setup: setup
    plant: Plant | None = None
    beside: str = "nothing"


def stiff(setup: RigSetup) -> RigSetup:
    """Bodies that nothing leans: everything is at the ground, but for the antennas."""
    return setup._replace(
        rig=setup.rig._replace(h_t=0.0, h_i=0.0, h_h=0.0),
        roll=setup.roll._replace(pivot_height=0.0, k_f=1e30),
    )


def level(setup: RigSetup) -> RigSetup:
    return setup._replace(bank_sd=1e-4)


def exact_speed(setup: RigSetup) -> RigSetup:
    return setup._replace(speed_sd=1e-4)


def exponent(value: float) -> Callable[[RigSetup], RigSetup]:
    """The load exponent, which is 0.8 for all rigs and no unknown."""
    return lambda setup: setup._replace(rig=setup.rig._replace(load_exponent=value))


def one_rig(setup: RigSetup) -> RigSetup:
    """Tracks of the dissertation's tractor for all."""
    tracks = {name: getattr(TABLE_5_1, name) for name in ("w_f", "w_r", "w_i")}
    return setup._replace(rig=setup.rig._replace(**tracks))


EFFECTS: Final = {
    "nothing": Effect({}),
    "bodies roll on their tyres": Effect(dict.fromkeys((*ROLL_MODES, "camber"), 0.0), stiff),
    "cross slope": Effect({}, level),
    "zeros of roll sensors": Effect(dict.fromkeys(ROLL_ZEROS, 0.0)),
    "rolls are late": Effect({"roll_late_t": 0.0, "roll_late_i": 0.0}),
    "camber thrust": Effect({"camber": 0.0}),
    "wheels of an axle slip each by itself": Effect({"two_track": 0.0}),
    "tyre curve": Effect({"curvature": 0.0}),
    "relaxation falls with slip": Effect({"shrink": 0.0}),
    "rolling resistance": Effect({"rolling": 0.0}),
    "zero of the wheel angle": Effect({"wheel_zero": 0.0}),
    "gain of the wheel angle": Effect({"wheel_gain": 0.0}),
    "error of the measured speed": Effect({}, exact_speed),
    "latency of receivers": Effect({"latency": 0.0}),
    "yaw of antenna pairs": Effect({"pair_t": 0.0, "pair_i": 0.0}),
    "pull at the hitch's height": Effect({"roll_hitch": -0.5}),
    "heights of CGs as told": Effect({"roll_cg_t": 0.0, "roll_cg_i": 0.0}),
    "front axle's tilt as usual": Effect({"roll_front": 0.0}),
    "tracks of one rig for all": Effect(setup=one_rig),
    "roll stiffnesses as usual": Effect({"roll_k_t": 0.0, "roll_k_i": 0.0}),
    "load exponent 0.5 for 0.8": Effect(setup=exponent(0.5)),
    "load exponent 1 for 0.8": Effect(setup=exponent(1.0)),
    "plant: wheel sensor has 0.15° of play": Effect(plant=_wheel("play", dead_band_deg=0.15)),
    "plant: its gain bends by 1 % at 30°": Effect(plant=_wheel("bent", curve=0.02)),
    "plant: traction takes no side force": Effect(plant=Plant("no_ellipse", _no_ellipse)),
    "plant: 3° uphill": Effect(plant=Plant("uphill", _uphill)),
    "plant: 3° uphill, without that": Effect(
        plant=Plant("uphill_no_ellipse", _uphill_without_ellipse),
        beside="plant: traction takes no side force",
    ),
    "plant: cart's load 0.15 m forward": Effect(plant=Plant("tongue", further_forward=0.15)),
    "plant: rolling resistance 3 %": Effect(plant=PULL_3),
    "pull, at 3 %": Effect({"rolling": 0.0}, plant=PULL_3, beside="plant: rolling resistance 3 %"),
    "plant: rolling resistance 10 %": Effect(plant=PULL_10),
    "pull, at 10 %": Effect({"rolling": 0.0}, plant=PULL_10, beside="plant: rolling resistance 10 %"),
    "masses as told": Effect(dict.fromkeys((NAMES[k] for k in MASSES), 0.0)),
}


def given(machine: Machine, log: Path) -> Given:
    """What the estimators are given over a log."""
    state, recording = fold.initial(machine), record_builder.initial(machine)
    state.ready = False  # estimators of the fold itself are not needed
    out: Given = []
    for frame in frames(log):
        for publication in fold.step(state, frame):
            if isinstance(publication.value, Pose):
                pose = publication.value
                out.append((pose, record_builder.observe(recording, state.aligner, pose)))
    return out


def learned(machine: Machine, poses: Given, effect: Effect) -> tuple[Array, Array]:
    """(logarithms of the six, their sds) at the end, with an effect left out."""
    whole = unknowns.prior

    def prior(told: Machine) -> tuple[Array, Array]:
        mean, sd = whole(told)
        for name, value in effect.held.items():
            mean[AT[name]], sd[AT[name]] = value, 0.0
        return mean, sd

    with (
        mock.patch.object(unknowns, "prior", prior),
        mock.patch.object(pem, "rig_setup", lambda told: effect.setup(rig_setup(told))),
    ):
        state = pem.initial(machine)
        for pose, segment in poses:
            pem.take(state, machine, pose, segment)
            fit_now(state, machine, pose.t_ns)
        pem.finish(state)
        fit_now(state, machine, poses[-1][0].t_ns)
    return state.mean[:6], np.sqrt(np.diag(state.covariance)[:6])


def fit_now(state: pem.PemState, machine: Machine, t_ns: int) -> None:
    job = pem.request_fit(state, t_ns)
    if job is not None:
        pem.adopt(state, machine, pem.fit(machine, job), t_ns)


def one(logs: Path, to: Path, wanted: Collection[str], job: tuple[str, int]) -> None:
    """Write the errors of a run of a size, with each wanted effect that is not there yet."""
    size, seed = job
    drives: dict[Plant | None, tuple[Machine, Given, Array]] = {}
    there = known(to).get(job, {})
    for name, effect in EFFECTS.items():
        if name in there or name not in wanted:
            continue
        if effect.plant not in drives:
            drives[effect.plant] = driven(logs, SIZES[size], effect.plant, seed)
        machine, poses, truth = drives[effect.plant]
        logarithms, sd = learned(machine, poses, effect)
        row = {"size": size, "seed": seed, "effect": name}
        row |= {"errors": (logarithms - truth).tolist(), "sds": sd.tolist()}
        with to.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")


def known(path: Path) -> Known:
    """What was written of each run."""
    out: Known = {}
    for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else ():
        row = json.loads(line)
        run = out.setdefault((row["size"], row["seed"]), {})
        run[row["effect"]] = (np.array(row["errors"]), np.array(row["sds"]))
    return out


def driven(logs: Path, row: LogRow, plant: Plant | None, seed: int) -> tuple[Machine, Given, Array]:
    """(machine file, what estimators are given, logarithms of the true six) of a run."""
    if plant is not None:
        row = replace(
            row,
            name=f"{row.name}_{plant.folder}",
            plant=plant.scenario,
            further_forward=plant.further_forward,
        )
    spatial_logs.make(logs, row, seed)
    run = spatial_logs.read_run(logs, row.name, seed)
    machine = parse_machine(run.machine_text)
    truth = np.log([run.described["parameters"][name] for name in PARAMETERS])
    return machine, given(machine, run.log), truth


class Outcome(NamedTuple):
    """Of one effect over all runs; arrays of the six."""

    moved: Array  # median change of the logarithms
    ratio: Array  # rms of error over sd
    holds: float  # share of the 95 % intervals


def outcomes(runs: list[Run]) -> dict[str, Outcome]:
    """Of the effects that all of the runs have."""
    out = {}
    for name, effect in EFFECTS.items():
        if not all(name in run and effect.beside in run for run in runs):
            continue
        whole = np.array([run[effect.beside][0] for run in runs])
        errors, sds = (np.array([run[name][k] for run in runs]) for k in range(2))
        normal = errors / sds
        out[name] = Outcome(
            np.median(errors - whole, axis=0),
            np.sqrt(np.mean(normal**2, axis=0)),
            float(np.mean(np.abs(normal) < 1.96)),
        )
    return out


def draw(found: Mapping[str, dict[str, Outcome]], runs: int, to: Path) -> None:
    """Tables in colours, one for each size: effects by parameters, changes in per cent."""
    from matplotlib.figure import Figure

    names = [name for name in EFFECTS if name != "nothing" and all(name in of for of in found.values())]
    figure = Figure(figsize=(3.4 + 3.2 * len(found), 0.36 * len(names) + 1.3), layout="constrained")
    for axes, (size, of) in zip(np.atleast_1d(figure.subplots(1, len(found))), found.items(), strict=True):
        table = 100.0 * np.array([of[name].moved for name in names])
        axes.imshow(table, cmap="RdBu_r", vmin=-40.0, vmax=40.0, aspect="auto")
        axes.set_xticks(range(len(PARAMETERS)), PARAMETERS, fontsize=8)
        axes.set_yticks(range(len(names)), names if size == next(iter(found)) else [""] * len(names))
        axes.tick_params(length=0, top=True, labeltop=True, bottom=False, labelbottom=False)
        for (i, j), value in np.ndenumerate(table):
            colour = "white" if abs(value) > 25 else "black"
            axes.text(j, i, f"{value:+.0f}", ha="center", va="center", color=colour, fontsize=8)
        axes.set_xlabel(f"{size} rig")
    figure.suptitle(f"What each effect moves where it is left out, % (median of {runs} rigs)", fontsize=10)
    figure.savefig(to, metadata={"Date": None})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--logs", type=Path, default=spatial_logs.CACHE)
    parser.add_argument("--runs", type=int, default=12, help="of each size")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--size", nargs="*", choices=tuple(SIZES), default=tuple(SIZES))
    parser.add_argument("--only", nargs="*", default=[""], help="effects whose names have one of these")
    parser.add_argument("--out", type=Path, default=spatial_logs.CACHE / "left_out.jsonl")
    parser.add_argument("--picture", type=Path, help="an SVG of the table")
    options = parser.parse_args()
    options.out.parent.mkdir(parents=True, exist_ok=True)
    wanted = [name for name in EFFECTS if any(text in name for text in options.only)]
    wanted += {EFFECTS[name].beside for name in wanted}.difference(wanted)
    jobs = [(size, seed) for seed in range(options.runs) for size in options.size]
    with ProcessPoolExecutor(options.processes, get_context("spawn")) as pool:
        list(pool.map(partial(one, options.logs, options.out, wanted), jobs))
    rows = known(options.out)
    found = {size: outcomes([rows[size, k] for k in range(options.runs)]) for size in options.size}
    print(f"{options.runs} runs. Left out: median change of {', '.join(PARAMETERS)}, %; rms of error over sd")
    for size, of in found.items():
        for name, (moved, ratio, holds) in of.items():
            changes = " ".join(f"{100.0 * value:+6.1f}" for value in moved)
            worst = " ".join(f"{x:5.2f}" for x in ratio)
            print(f"{size:6} {name:38} {changes}   {worst}   holds {100 * holds:.0f} %")
    if options.picture is not None:
        draw(found, options.runs, options.picture)


if __name__ == "__main__":
    main()
