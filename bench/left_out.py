"""What comes of each effect that an estimator does not know: `pem` on the spatial plant, a part left out.

    python bench/left_out.py [--logs DIR] [--runs 12] [--processes 2] [--picture FILE.svg]

The logs are those of `bench/estimation.py spatial_random`: rigs, tyres, soil and sensors drawn anew for each
run, ground of 1 cm rms, 120 s of random steering of 6°. The product's own estimator runs on them, with the
unknowns of one effect held at the value that means "there is none".
"""

import argparse
import math
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Final, NamedTuple
from unittest import mock

import numpy as np
import spatial_logs
from numpy.typing import NDArray

from tilth.estimator import fold
from tilth.estimator.filters import unknowns
from tilth.estimator.filters.rig_setup import RigSetup, rig_setup
from tilth.estimator.filters.unknowns import AT, MASSES, NAMES, ROLL_ZEROS
from tilth.estimator.methods import pem
from tilth.estimator.record import record_builder
from tilth.estimator.record.record import Segment
from tilth.replay.readers.any_log import frames
from tilth.schemas.flow import PARAMETERS, Pose
from tilth.schemas.machine import Machine
from tilth.schemas.machine_toml import parse_machine

Array = NDArray[np.float64]
Given = list[tuple[Pose, Segment | None]]

ROW: Final = "spatial_random"
ROLL_MODES: Final = tuple(name for name in NAMES if name.startswith("roll_") and name not in ROLL_ZEROS)


@dataclass(frozen=True, slots=True)
class Effect:
    """What is left out: unknowns held at these values, and what becomes of the setup."""

    held: dict[str, float]
    setup: Callable[[RigSetup], RigSetup] = lambda setup: setup


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


def one(logs: Path, seed: int) -> dict[str, tuple[Array, Array]]:
    """Effect -> (errors of the six logarithms, their sds), of one run."""
    spatial_logs.make(logs, spatial_logs.ROW[ROW], seed)
    run = spatial_logs.read_run(logs, ROW, seed)
    machine = parse_machine(run.machine_text)
    poses = given(machine, run.log)
    truth = np.log([run.described["parameters"][name] for name in PARAMETERS])
    out = {}
    for name, effect in EFFECTS.items():
        logarithms, sd = learned(machine, poses, effect)
        out[name] = (logarithms - truth, sd)
    return out


class Outcome(NamedTuple):
    """Of one effect over all runs; arrays of the six."""

    moved: Array  # median change of the logarithms
    ratio: Array  # rms of error over sd
    holds: float  # share of the 95 % intervals


def outcomes(runs: list[dict[str, tuple[Array, Array]]]) -> dict[str, Outcome]:
    whole, out = np.array([run["nothing"][0] for run in runs]), {}
    for name in EFFECTS:
        errors, sds = (np.array([run[name][k] for run in runs]) for k in range(2))
        normal = errors / sds
        out[name] = Outcome(
            np.median(errors - whole, axis=0),
            np.sqrt(np.mean(normal**2, axis=0)),
            float(np.mean(np.abs(normal) < 1.96)),
        )
    return out


def draw(found: dict[str, Outcome], runs: int, to: Path) -> None:
    """A table in colours: effects by parameters, changes in per cent."""
    from matplotlib.figure import Figure

    rows = {name: outcome for name, outcome in found.items() if name != "nothing"}
    table = 100.0 * np.array([outcome.moved for outcome in rows.values()])
    figure = Figure(figsize=(7.2, 0.36 * len(rows) + 1.3), layout="constrained")
    axes = figure.subplots()
    axes.imshow(table, cmap="RdBu_r", vmin=-40.0, vmax=40.0, aspect="auto")
    axes.set_xticks(range(len(PARAMETERS)), PARAMETERS)
    axes.set_yticks(range(len(rows)), [f"without: {name}" for name in rows])
    axes.tick_params(length=0, top=True, labeltop=True, bottom=False, labelbottom=False)
    for (i, j), value in np.ndenumerate(table):
        axes.text(
            j, i, f"{value:+.0f}", ha="center", va="center", color="white" if abs(value) > 25 else "black"
        )
    axes.set_title(f"What each effect moves where it is not known, % (median of {runs} rigs)", fontsize=10)
    figure.savefig(to, metadata={"Date": None})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--logs", type=Path, default=spatial_logs.CACHE)
    parser.add_argument("--runs", type=int, default=12)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--picture", type=Path, help="an SVG of the table")
    options = parser.parse_args()
    with ProcessPoolExecutor(options.processes, get_context("spawn")) as pool:
        runs = list(pool.map(partial(one, options.logs), range(options.runs)))
    found = outcomes(runs)
    print(f"{options.runs} runs. Left out: median change of {', '.join(PARAMETERS)}, %; rms of error over sd")
    for name, (moved, ratio, holds) in found.items():
        changes = " ".join(f"{100.0 * value:+6.1f}" for value in moved)
        print(f"{name:28} {changes}   {' '.join(f'{x:5.2f}' for x in ratio)}   holds {100 * holds:.0f} %")
    if options.picture is not None:
        draw(found, options.runs, options.picture)
    assert all(math.isfinite(value) for run in runs for value in run["nothing"][0])


if __name__ == "__main__":
    main()
