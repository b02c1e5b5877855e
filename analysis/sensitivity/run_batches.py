"""The dissertation's global measure (Karkee 2009, 6.2.2.2), in batches that are kept on disk.

At each point of a design (the dissertation's: the grid of table 6.2) the overall sensitivity to each
parameter (6.17) is computed as at the nominal point. Each finished batch is a file: who is interrupted begins
again with what is not there. Points whose answer grows without end are counted and kept apart.
"""

import hashlib
import os
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import closing
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.analysis.sensitivity import accumulators
from tilth.analysis.sensitivity.accumulators import Kept, mean, quantile, spread
from tilth.analysis.sensitivity.designs import Design, LogNormal, checked
from tilth.analysis.sensitivity.local import SHARE
from tilth.analysis.sensitivity.outputs import STEP_S, STILL, WHEEL_ANGLE
from tilth.estimator.models.family import model_named
from tilth.estimator.models.parameters import Rig
from tilth.estimator.models.step_responses import FIELDS, growth, packed_systems, step_changes

Done = Callable[[int, int], None]  # (batches done, of)
LANE_SAMPLES: Final = 12_000_000  # points times samples of a batch: some seconds
MADE_WITH: Final = 1  # raise it when the measure changes: batches kept before are then computed anew


class GlobalPlan(NamedTuple):
    """What is computed. rig: gives what is not varied. seconds: simulated at each point."""

    model: str
    rig: Rig
    speed: float  # m/s
    seconds: float
    design: Design

    @property
    def samples(self) -> int:
        """Of a simulation."""
        return round(self.seconds / STEP_S)

    @property
    def batch(self) -> int:
        """Points of a batch."""
        return max(1, LANE_SAMPLES // self.samples)


class Part(NamedTuple):
    """Of some points: all, those that are stable, and how many are not at each level of each parameter."""

    every: Kept
    stable: Kept
    unstable: NDArray[np.int64]  # (k, levels)


def part_of(plan: GlobalPlan, start: int, stop: int) -> Part:
    """Of the points start to stop - 1."""
    columns = np.array([FIELDS.index(name) for name in plan.design.names])
    rigs = np.tile(
        np.array([getattr(plan.rig, name) for name in FIELDS], dtype=np.float64), (stop - start, 1)
    )
    rigs[:, columns] = plan.design.points(start, stop)
    a, b = packed_systems(model_named(plan.model), plan.rig, rigs, columns, SHARE, plan.speed)
    shares = np.zeros((stop - start, len(columns), 6))
    step_changes(a, b, WHEEL_ANGLE, plan.speed, plan.samples, STEP_S, shares)
    overall = shares.mean(axis=2) / SHARE
    grows = growth(a[:, 0]) > STILL
    levels = plan.design.levels_of(start, stop)[grows]
    unstable = np.stack([np.bincount(column, minlength=plan.design.levels) for column in levels.T])
    return Part(accumulators.of(overall), accumulators.of(overall[~grows]), unstable)


Parts = Callable[[GlobalPlan, Sequence[int]], Generator[tuple[int, Part], None, None]]
"""Of a plan and where its batches start: (start, its part) of each, as they are ready."""


def here(workers: int) -> Parts:
    """By so many processes of this computer."""
    return partial(_here, workers)


def _here(workers: int, plan: GlobalPlan, starts: Sequence[int]) -> Generator[tuple[int, Part], None, None]:
    if workers == 1:
        for start in starts:
            yield start, part_of(plan, start, end_of(plan, start))
        return
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        waiting = {pool.submit(part_of, plan, start, end_of(plan, start)): start for start in starts}
        try:
            for future in as_completed(waiting):
                yield waiting.pop(future), future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def run(
    plan: GlobalPlan, folder: Path, parts: Parts, *, progress: Done = lambda done, of: None
) -> tuple[Part, int]:
    """(of all points, batches that were there already). Raises OSError, ValueError, and what `parts` does."""
    design = plan.design
    if not isinstance(design, LogNormal):
        checked(design.box)
    missing_fields = [name for name in design.names if name not in FIELDS]
    if missing_fields:
        raise ValueError(f"{', '.join(missing_fields)}: no parameter of the linear models")
    kept = folder / hashlib.sha256(repr((MADE_WITH, plan, LANE_SAMPLES)).encode()).hexdigest()[:16]
    kept.mkdir(parents=True, exist_ok=True)
    starts = range(0, plan.design.size, plan.batch)
    files = [kept / f"{start}.npz" for start in starts]
    missing = [start for start, file in zip(starts, files, strict=True) if not file.exists()]
    already = len(files) - len(missing)
    progress(already, len(files))
    with closing(parts(plan, missing)) as found:
        for done, (start, part) in enumerate(found, already + 1):
            _keep(part, start, kept)
            progress(done, len(files))
    total = _read(files[0])
    for file in files[1:]:
        part = _read(file)
        total = Part(
            accumulators.merged(total.every, part.every),
            accumulators.merged(total.stable, part.stable),
            total.unstable + part.unstable,
        )
    return total, already


def end_of(plan: GlobalPlan, start: int) -> int:
    """Where the batch that starts there ends."""
    return min(start + plan.batch, plan.design.size)


def _keep(part: Part, start: int, folder: Path) -> None:
    """Write a batch under its final name once it is whole."""
    unfinished = folder / f"{start}.{os.getpid()}.unfinished"
    try:
        with unfinished.open("wb") as file:
            np.savez_compressed(file, *part.every, *part.stable, part.unstable)
        unfinished.replace(folder / f"{start}.npz")
    except OSError:
        unfinished.unlink(missing_ok=True)
        raise


def _read(file: Path) -> Part:
    with np.load(file) as stored:
        arrays = [stored[f"arr_{k}"] for k in range(11)]
    return Part(Kept(*arrays[:5]), Kept(*arrays[5:10]), arrays[10])


def global_answer(plan: GlobalPlan, part: Part) -> dict[str, Any]:
    """For JSON: overall sensitivity to each parameter over all points, and over the stable ones."""
    count = int(part.unstable[0].sum())
    return {
        "speed": plan.speed,
        "points": plan.design.size,
        "simulations": plan.design.size * (len(plan.design.names) + 1),
        "unstable_share": count / plan.design.size,
        "global": _numbers(plan, part.every),
        "global_stable": _numbers(plan, part.stable),
        "unstable_by_level": {
            name: (row / (plan.design.size / plan.design.levels)).tolist()
            for name, row in zip(plan.design.names, part.unstable, strict=True)
        },
        "unstable_where": _where(plan, part),
    }


def _numbers(plan: GlobalPlan, kept: Kept) -> dict[str, Any]:
    columns = {
        "mean": mean(kept),
        "sd": spread(kept),
        "median": quantile(kept, 0.5),
        "q05": quantile(kept, 0.05),
        "q95": quantile(kept, 0.95),
    }
    return {
        name: {key: _or_none(float(values[k])) for key, values in columns.items()}
        for k, name in enumerate(plan.design.names)
    }


def _or_none(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _where(plan: GlobalPlan, part: Part) -> str:
    """Which parameters make rigs unstable, and which side of their range."""
    total = part.unstable[0].sum()
    if not total:
        return "no point of the box is unstable"
    said = []
    for name, row in zip(plan.design.names, part.unstable, strict=True):
        if max(row[0], row[-1]) >= 2 * min(row[0], row[-1]):
            said.append(f"{name} {'high' if row[-1] > row[0] else 'low'}")
    return f"unstable: {', '.join(said)}" if said else "unstable points lie all over the box"
