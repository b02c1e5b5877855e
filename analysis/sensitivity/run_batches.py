"""The dissertation's global measure (Karkee 2009, 6.2.2.2), in batches that are kept on disk.

At each point of a design (the dissertation's: the grid of table 6.2) the sensitivity of each output to each
parameter is computed as at the nominal point, and their mean (6.17). Each finished batch is a file: who is
interrupted begins again with what is not there. Points whose answer grows without end are counted, also by
where they lie in two parameters at once, and kept apart.
"""

import hashlib
import io
import os
import zlib
from collections.abc import Callable
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from tilth.analysis.sensitivity import accumulators
from tilth.analysis.sensitivity.accumulators import Kept
from tilth.analysis.sensitivity.designs import Design, LogNormal, checked
from tilth.analysis.sensitivity.local import SHARE
from tilth.analysis.sensitivity.outputs import (
    NAMES,
    SIX,
    STEP,
    STEP_S,
    STILL,
    WHEEL_ANGLE,
    case_of,
    measured,
    respond,
)
from tilth.analysis.sensitivity.slopes import scaled
from tilth.analysis.workers.parts import LostPart, Parts
from tilth.estimator.models.family import model_named
from tilth.estimator.models.linear_analysis import eigenvalues, system
from tilth.estimator.models.parameters import Rig
from tilth.estimator.models.step_responses import FIELDS, growth, packed_systems, step_changes

Array = NDArray[np.float64]
Done = Callable[[int, int], None]  # (batches done, of)
LANE_SAMPLES: Final = 6_000_000  # points times samples of a batch: a second or two
LARGER: Final = 5  # times as much in a batch of a large design
BATCHES: Final = 64  # of a design, or more, before its batches grow
MOST_POINTS: Final = 20_000  # of a batch, for its memory
SLOW_POINTS: Final = 50  # of a batch without the compiled loop: a second or two
TOGETHER: Final = 1024  # points whose matrices are in memory at once
MADE_WITH: Final = 2  # raise it when the measure changes: batches kept before are then computed anew
OVERALL: Final = "overall"


class GlobalPlan(NamedTuple):
    """What is computed. rig: gives what is not varied. seconds: simulated at each point. outputs: whose
    sensitivities, and whose mean. steering: of MANOEUVRES, by name."""

    model: str
    rig: Rig
    speed: float  # m/s
    seconds: float
    design: Design
    outputs: tuple[str, ...] = SIX
    steering: str = STEP

    @property
    def samples(self) -> int:
        """Of a simulation."""
        return round(self.seconds / STEP_S)

    @property
    def batch(self) -> int:
        """Points of a batch."""
        least = LANE_SAMPLES // self.samples if self.quick else SLOW_POINTS
        wanted = min(max(self.design.size // BATCHES, least), LARGER * least, MOST_POINTS)
        return max(1, wanted)

    @property
    def quick(self) -> bool:
        """Whether the compiled loop has all that is asked for: the dissertation's outputs after a step, by a
        model with velocities."""
        has_velocities = model_named(self.model).states[:3] == SIX[:3]
        return self.steering == STEP and has_velocities and set(self.outputs) <= set(SIX)

    @property
    def measures(self) -> tuple[str, ...]:
        """Of each parameter: the mean over the outputs, then each output."""
        return (OVERALL, *self.outputs)


class Part(NamedTuple):
    """Of some points: all, those that are stable, and how many lie, and how many of them are unstable, at
    each two levels of each two parameters."""

    every: Kept  # of each parameter its plan.measures, in a row
    stable: Kept
    there: NDArray[np.int64]  # (k, k, levels, levels)
    unstable: NDArray[np.int64]  # (k, k, levels, levels)


def part_of(plan: GlobalPlan, start: int, stop: int) -> Part:
    """Of the points start to stop - 1."""
    measures = np.zeros((stop - start, len(plan.design.names), len(plan.measures)))
    grows = np.zeros(stop - start, dtype=bool)
    for first in range(0, stop - start, TOGETHER):
        rows = slice(first, min(first + TOGETHER, stop - start))
        shares, growing = _changes(plan, start + rows.start, start + rows.stop)
        measures[rows, :, 0], measures[rows, :, 1:] = shares.mean(axis=2) / SHARE, shares / SHARE
        grows[rows] = growing > STILL
    flat = measures.reshape(stop - start, -1)
    levels = plan.design.levels_of(start, stop)
    every = accumulators.of(flat)
    stable = accumulators.of(flat[~grows]) if grows.any() else every
    return Part(every, stable, pairs(levels, plan.design.levels), pairs(levels[grows], plan.design.levels))


def _changes(plan: GlobalPlan, start: int, stop: int) -> tuple[Array, Array]:
    """(change of each output as a share, (n, k, outputs); largest real part of the poles, 1/s, (n,))."""
    points = plan.design.points(start, stop)
    if not plan.quick:
        return _one_by_one(plan, points)
    columns = np.array([FIELDS.index(name) for name in plan.design.names])
    rigs = np.tile(np.array([getattr(plan.rig, name) for name in FIELDS], dtype=np.float64), (len(points), 1))
    rigs[:, columns] = points
    a, b = packed_systems(model_named(plan.model), plan.rig, rigs, columns, SHARE, plan.speed)
    shares = np.zeros((len(points), len(columns), 6))
    step_changes(a, b, WHEEL_ANGLE, plan.speed, plan.samples, STEP_S, shares)
    return shares[:, :, [SIX.index(name) for name in plan.outputs]], growth(a[:, 0])


def _one_by_one(plan: GlobalPlan, points: Array) -> tuple[Array, Array]:
    """The same, for any model, output and steering."""
    names = plan.design.names
    case = case_of(model_named(plan.model), plan.rig, plan.speed, plan.seconds, steering=plan.steering)
    columns = [NAMES.index(name) for name in plan.outputs]
    shares = np.zeros((len(points), len(names), len(columns)))
    grows = np.zeros(len(points))
    for at, point in enumerate(points.tolist()):
        rig = plan.rig._replace(**dict(zip(names, point, strict=True)))
        grows[at] = eigenvalues(system(case.model, rig, case.speed).a).real.max()
        with np.errstate(over="ignore", invalid="ignore"):  # of rigs whose answer grows
            reference = respond(case, rig)
            for k, name in enumerate(names):
                change = respond(case, scaled(rig, {name: 1 + SHARE})).minus(reference)
                shares[at, k] = measured(case, reference, change)[columns]
    return shares, grows


def pairs(levels: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """Points at each two levels of each two parameters, (k, k, count, count). levels: (n, k)."""
    k = levels.shape[1]
    found = np.zeros((k, k, count, count), np.int64)
    for one in range(k):
        for other in range(one, k):
            both = np.bincount(levels[:, one] * count + levels[:, other], minlength=count**2)
            found[one, other] = both.reshape(count, count)
            found[other, one] = found[one, other].T
    return found


def stored_part(plan: GlobalPlan, points: tuple[int, int]) -> bytes:
    """A batch as the file that is kept of it. points: the first, and the one after the last."""
    part = part_of(plan, *points)
    file = io.BytesIO()
    np.savez_compressed(file, *part.every, *part.stable, part.there, part.unstable)
    return file.getvalue()


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
    missing = [start for start, file in zip(starts, files, strict=True) if _kept_part(file) is None]
    already = len(files) - len(missing)
    progress(already, len(files))
    batches = [(start, end_of(plan, start)) for start in missing]
    with closing(parts(partial(stored_part, plan), batches)) as found:
        for done, ((start, _), stored) in enumerate(found, already + 1):
            if isinstance(stored, LostPart):
                raise stored
            _keep(stored, start, kept)
            progress(done, len(files))
    total = _read(files[0])
    for file in files[1:]:
        part = _read(file)
        total = Part(
            accumulators.merged(total.every, part.every),
            accumulators.merged(total.stable, part.stable),
            total.there + part.there,
            total.unstable + part.unstable,
        )
    return total, already


def end_of(plan: GlobalPlan, start: int) -> int:
    """Where the batch that starts there ends."""
    return min(start + plan.batch, plan.design.size)


def _keep(stored: bytes, start: int, folder: Path) -> None:
    """Write a batch under its final name once it is whole. Raises OSError that names the folder."""
    unfinished = folder / f"{start}.{os.getpid()}.unfinished"
    try:
        with unfinished.open("wb") as file:
            file.write(stored)
        unfinished.replace(folder / f"{start}.npz")
    except OSError as error:
        unfinished.unlink(missing_ok=True)
        raise OSError(error.errno, error.strerror, str(folder)) from None


def _kept_part(file: Path) -> Part | None:
    """None where it is not there, or not as it was written: each array in it has a checksum."""
    try:
        return _read(file) if file.is_file() else None
    except (OSError, ValueError, LookupError, EOFError, RuntimeError, BadZipFile, zlib.error):
        return None


def _read(file: Path) -> Part:
    with file.open("rb") as opened, np.load(opened, allow_pickle=False) as stored:
        arrays = [stored[f"arr_{k}"] for k in range(12)]
    return Part(Kept(*arrays[:5]), Kept(*arrays[5:10]), *arrays[10:])
