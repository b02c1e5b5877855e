"""One run of each row of estimation_study.py: functions of a seed, for processes of their own."""

import os
import pickle
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import estimation_study
import held_out
import linear_plant
import numpy as np
import plain_aeroid
import plain_filterpy
import plain_least_squares
import plain_statsmodels
from estimation_study import Case, Fitted, Followed
from numpy.typing import NDArray
from timing import best

from tilth.estimator.filters import scoring, unknowns
from tilth.estimator.filters.unknowns import AT, NOISE, SIX
from tilth.estimator.methods import pem
from tilth.estimator.methods.estimators import ROW
from tilth.estimator.models.parameters import rig_of
from tilth.estimator.record.record import Segment
from tilth.estimator.record.windows import WINDOWS
from tilth.logger.fitting import ONE_THREAD
from tilth.schemas.flow import Pose
from tilth.simulator.packaged import packaged_file

Array = NDArray[np.float64]
MACHINE: Final = packaged_file().machine

ROW_WINDOWS = 6
ROW_DEGREES = 1.8  # 0.4 degrees root mean square
ROUNDS = 7

COLD = """
import pickle, sys, time
began = time.perf_counter()
from tilth.estimator.methods import pem
machine, job = pickle.load(open(sys.argv[1], "rb"))
imported = time.perf_counter()
pem.fit(machine, job)
print(imported - began, time.perf_counter() - imported)
"""


@dataclass(frozen=True, slots=True)
class Linear:
    """A fit of one record of the linear plant; logarithms, shapes (6,)."""

    error: Array
    sd: Array
    bound: Array
    steps: int
    converged: bool


@dataclass(frozen=True, slots=True)
class PeerResult:
    """What one way of estimating gave of one record."""

    error: Array
    sd: Array
    seconds: float


def linear(kind: str, seconds: float, seed: int) -> Linear:
    run = linear_plant.plant(rig_of(MACHINE), seed, kind, seconds)
    mean, covariance = linear_plant.prior(MACHINE)
    found = scoring.maximise_posterior(
        linear_plant.record_of(run), linear_plant.setup(MACHINE), mean, covariance
    )
    return Linear(
        found.mean[SIX] - np.log(run.rig.theta),
        np.sqrt(np.diag(found.covariance)[SIX]),
        np.sqrt(np.diag(linear_plant.bound(run, covariance))),
        found.iterations,
        found.converged,
    )


def merged_rows(seconds: float, seed: int) -> Linear:
    """Windows of row following on one rig, the posterior of each is the prior of the next; noise levels start
    again."""
    first = linear_plant.plant(rig_of(MACHINE), seed, "row", seconds, ROW_DEGREES)
    setup, (mean, before) = linear_plant.setup(MACHINE), linear_plant.prior(MACHINE)
    noise, covariance = before[NOISE, NOISE].copy(), before
    chosen = [unknowns.AT[name] for name in linear_plant.UNKNOWN]
    whole, steps, converged = np.linalg.inv(before[np.ix_(chosen, chosen)]), 0, True
    for k in range(ROW_WINDOWS):
        again = linear_plant.plant(rig_of(MACHINE), 1000 * (k + 1) + seed, "row", seconds, ROW_DEGREES)
        run = again._replace(rig=first.rig, zero=first.zero)
        found = scoring.maximise_posterior(linear_plant.record_of(run), setup, mean, covariance)
        mean, covariance = found.mean, found.covariance
        covariance[NOISE, :] = covariance[:, NOISE] = 0.0
        covariance[NOISE, NOISE] = noise
        mean[NOISE] = linear_plant.prior(MACHINE)[0][NOISE]
        whole = whole + linear_plant.information(run)
        steps, converged = steps + found.iterations, converged and found.converged
    bound = np.sqrt(np.diag(np.linalg.inv(whole))[SIX])
    sd = np.sqrt(np.diag(covariance)[SIX])
    return Linear(mean[SIX] - np.log(first.rig.theta), sd, bound, steps, converged)


def window(case: Case, count: int, length: int, seed: int) -> Fitted | None:
    return estimation_study.window_of(MACHINE, case, seed, count, length)


def mean_bound(case: Case, made: list[Fitted]) -> Array:
    """Of the mean information of the runs, (6,)."""
    information = np.mean([m.information for m in made], axis=0)
    return estimation_study.bound_of(information, case.believed(MACHINE))


def trajectory(case: Case, length: int, seed: int) -> tuple[float, ...] | None:
    return held_out.trajectory_error(MACHINE, case, seed, length)


def follow(case: Case, seed: int) -> Followed:
    return estimation_study.followed(estimation_study.driven(MACHINE, case, seed))


# Other programs on the same record.


def other_programs(seconds: float, seed: int) -> dict[str, PeerResult]:
    """Each way on one record of the linear plant, random steering."""
    run = linear_plant.plant(rig_of(MACHINE), seed, "random", seconds)
    record, (mean, covariance) = linear_plant.record_of(run), linear_plant.prior(MACHINE)
    setup, sd = linear_plant.setup(MACHINE), np.sqrt(np.diag(covariance))
    y, wheel = record.rows[:, 4].reshape(-1, 4), record.ticks[:, 0]
    sds = np.repeat(linear_plant.SDS, 2)
    white = linear_plant.white(rig_of(MACHINE))
    noise_mean = [*np.log(white), *np.log(linear_plant.SDS)]
    noise_sd = [*sd[NOISE][:3], sd[AT["s_yaw_rate"]], sd[AT["s_position"]]]
    data = (y, wheel, setup.geometry, linear_plant.SPEED)

    def own() -> tuple[Array, Array]:
        found = scoring.maximise_posterior(record, setup, mean, covariance)
        return found.mean[SIX], np.sqrt(np.diag(found.covariance)[SIX])

    ways: dict[str, Callable[[], tuple[Array, Array]]] = {
        "tilth": own,
        "scipy least_squares, output error": lambda: plain_least_squares.fit(*data, mean[:7], sd[:7], sds),
        "AeroID, output error": lambda: plain_aeroid.fit(*data, mean[:7], sd[:7], sds),
        "statsmodels MLEModel": lambda: plain_statsmodels.fit(
            *data, np.append(mean[:7], noise_mean), np.append(sd[:7], noise_sd)
        ),
        "filterpy EKF, noise levels known": lambda: plain_filterpy.track(
            *data, (mean[:7], sd[:7]), (white, sds)
        ),
    }
    own()  # compiled
    truth, made = np.log(run.rig.theta), {}
    for name, way in ways.items():
        began = time.perf_counter()
        logs, sd_logs = way()
        made[name] = PeerResult(logs - truth, sd_logs, time.perf_counter() - began)
    return made


# Times.


def speeds(scale: float) -> list[tuple[str, str, str, bool | None, tuple[float, ...]]]:
    """(figure, reached, to reach, whether held, values) of what takes time, on this computer as it is."""
    case, length = estimation_study.HELD_OUT, round(WINDOWS.longest * scale)
    run = estimation_study.driven(MACHINE, case, 1, max(40.0 * scale, 12.0))
    given = estimation_study.poses_and_segments(run)
    record = estimation_study.windows([segment for _, segment in given if segment is not None], length)[0]
    mean, sd = unknowns.prior(MACHINE)
    job = pem.Job(0, 0, record, mean, np.diag(sd**2))
    pem.fit(MACHINE, job)
    fit = best(lambda: pem.fit(MACHINE, job), ROUNDS)
    linear_run = linear_plant.plant(rig_of(MACHINE), 1, "random", 30.0 * scale)
    own, first = linear_plant.record_of(linear_run), linear_plant.prior(MACHINE)
    known = best(lambda: scoring.maximise_posterior(own, linear_plant.setup(MACHINE), *first), ROUNDS)
    imported, cold = _cold(job)
    rows = [
        ("fit of a window at 50 Hz, all nuisances", f"{1e3 * fit:.0f} ms", "≤ 250 ms", fit <= 0.25, (fit,)),
        ("fit of the linear plant, 12 unknowns", f"{1e3 * known:.0f} ms", "", None, (known,)),
        ("first fit of a new process, code kept on disk", f"{cold:.2f} s (import {imported:.2f} s)", "≤ 1 s",
         cold <= 1.0, (cold, imported)),
    ]  # fmt: skip
    if "tracker" in ROW:
        update = best(lambda: _track(given), ROUNDS) / (10 * len(given))
        rows.append(("tracker, per update of 20 ms", f"{1e6 * update:.1f} µs", "≤ 40 µs", update <= 40e-6,
                     (update,)))  # fmt: skip
    return rows


def _track(given: list[tuple[Pose, Segment | None]]) -> None:
    row = ROW["tracker"]
    state = row.initial(MACHINE)
    for pose, segment in given:
        row.take(state, MACHINE, pose, segment)


def _cold(job: pem.Job) -> tuple[float, float]:
    """(import, fit) of a new process, s."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "job"
        path.write_bytes(pickle.dumps((MACHINE, job)))
        made = subprocess.run(
            [sys.executable, "-c", COLD, str(path)],
            env={**os.environ, **ONE_THREAD}, capture_output=True, text=True, check=True,
        )  # fmt: skip
    imported, first = map(float, made.stdout.split())
    return imported, first
