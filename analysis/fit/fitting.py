"""Fits the segments of runs side by side on all cores, keeps each result, and joins them.

A segment that was fitted before, from the same log with the same machine file by the same version, is not
fitted again, nor are the same segments joined again: an interrupted fit goes on where it was.
"""

import math
import os
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, as_completed
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from itertools import pairwise
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from tilth.analysis.fit.agreement import groups
from tilth.analysis.fit.joint import Joint, Linearised, join, linearise
from tilth.analysis.fit.segment_fit import METHODS, TWO_STEP, SegmentFit, fit_segment
from tilth.analysis.fit.side_by_side import processes, side_by_side
from tilth.analysis.runs import segments
from tilth.analysis.runs.driven import Driven, identity
from tilth.analysis.runs.driving import driving
from tilth.analysis.runs.kept import cache_folder, key_of, load, store
from tilth.analysis.runs.run import Run
from tilth.analysis.runs.segments import DrivenSegment
from tilth.estimator.methods import pem
from tilth.estimator.pose.geometry import to_degrees, to_plane
from tilth.schemas.machine import Machine

Progress = Callable[[int, int], None]  # segments done, of all


class CannotFit(Exception):
    """One sentence that says what to do."""


class NoSteering(CannotFit):
    """Nothing was found of which something could be learned."""


@dataclass(frozen=True, slots=True)
class Wanted:
    """A segment of a run. log: which of the logs given it is in, from 1. number: which of all segments of its
    run, from 1, straight rows included."""

    run: Run
    log: int
    number: int
    segment: DrivenSegment

    @property
    def id(self) -> str:
        """A name among all: 2.34 is segment 34 of run 2."""
        return f"{self.log}.{self.number}"


@dataclass(frozen=True, slots=True)
class Fitted:
    """All that was asked for."""

    wanted: tuple[Wanted, ...]
    fits: tuple[SegmentFit, ...]  # of each
    told: tuple[int, ...]  # the segments of which pem has fitted something
    linearised: Linearised | None  # those; None where there is none
    joint: Joint | None
    groups: tuple[tuple[tuple[int, ...], Joint], ...] = ()
    """Where the segments do not agree: those that do among themselves, as indices of `wanted`, and each
    group's own posterior."""


def choose(
    runs: Sequence[Run], given: Sequence[tuple[int, float, float]] = (), kinds: Sequence[str] = (),
    marks: Sequence[str] = (),
) -> tuple[Wanted, ...]:  # fmt: skip
    """The segments to fit: those given, else those between marks, else all found with steering.

    given: (log, from 1; start, end in s of that log's run). kinds: only these. marks: only those between
    marks with such a name, as of a shell's files: * is anything. Raises CannotFit.
    """
    if given:
        seen = Counter[int]()
        found = []
        for log, start_s, end_s in given:
            seen[log] += 1
            found.append(_given(runs, log, seen[log], start_s, end_s))
    else:
        found = [one for log, run in enumerate(runs, 1) for one in _of_run(run, log, kinds, marks)]
    if not found:
        raise _nothing(runs, kinds, marks)
    return in_order(found)


def in_order(found: Sequence[Wanted]) -> tuple[Wanted, ...]:
    """Segments in the order of their driving. Raises CannotFit where two hold the same driving."""
    ordered = sorted(found, key=lambda wanted: (wanted.log, wanted.segment.start_s))
    for one, other in pairwise(ordered):
        shared_s = one.segment.end_s - other.segment.start_s if one.run is other.run else 0.0
        if shared_s > segments.LEAD_S + segments.QUIET_S:  # of straight driving that both may have
            raise CannotFit(
                f"the segments {one.segment.start_s:g}:{one.segment.end_s:g} and {other.segment.start_s:g}:"
                f"{other.segment.end_s:g} overlap; what both hold would count twice"
            )
    return tuple(ordered)


def _given(runs: Sequence[Run], log: int, number: int, start_s: float, end_s: float) -> Wanted:
    if not 1 <= log <= len(runs):
        raise CannotFit(f"--segment {log}:{start_s:g}:{end_s:g}: there are {len(runs)} runs")
    run = runs[log - 1]
    try:
        return Wanted(run, log, number, segments.between(run.poses, start_s, end_s))
    except ValueError as error:
        raise CannotFit(f"--segment {start_s:g}:{end_s:g}: {error}") from None


def _of_run(run: Run, log: int, kinds: Sequence[str], marks: Sequence[str]) -> list[Wanted]:
    return [
        Wanted(run, log, number, segment)
        for number, segment in enumerate(segments.all_segments(run.poses, run.marks), 1)
        if (segment.steers or segment.kind == segments.MARKED)
        and (not kinds or segment.kind in kinds)
        and (not marks or any(fnmatchcase(segment.name, pattern) for pattern in marks))
    ]


def _nothing(runs: Sequence[Run], kinds: Sequence[str], marks: Sequence[str]) -> CannotFit:
    if not any(run.poses.rows for run in runs):
        return CannotFit("there are no poses in these logs: `tilth verify` says which sensors were silent")
    if marks:
        names = [one.segment.name for log, run in enumerate(runs, 1) for one in _of_run(run, log, (), ())]
        known = "; ".join(dict.fromkeys(filter(None, names))) or "none with a name"
        return CannotFit(
            f"no marks begin and end a run that is called {' or '.join(marks)}; there are {known}"
        )
    what = f" of the kinds {', '.join(kinds)}" if kinds else ""
    return NoSteering(f"no driving with steering{what} was found, of which something could be learned")


def check_same_rig(runs: Sequence[Run]) -> None:
    """Raises CannotFit where the runs are of different machine files."""
    texts = {run.machine_file.sha256: run for run in runs}
    if len(texts) > 1:
        one, other, *_ = texts.values()
        raise CannotFit(
            f"{one.sources[0].name} ({one.machine.name}) and {other.sources[0].name} ({other.machine.name}) "
            "are of different machine files; fit them one by one, or give --machine M.toml for all"
        )


def fit_all(
    wanted: Sequence[Wanted], *, two_step: bool = False, jobs: int | None = None, cache: Path | None = None,
    progress: Progress = lambda done, of: None,
) -> Fitted:  # fmt: skip
    """Fit each and join them. jobs: processes, as many as there are cores if None. Raises LogError, OSError,
    CannotFit.

    From here on linear algebra has one thread, also in these processes, as in the daemon: several that wait
    for each other took 3 to 6 times the processor's time of a fit on a busy computer.
    """
    threadpool_limits(1)
    check_same_rig([one.run for one in wanted])
    machine = wanted[0].run.machine
    methods = (*METHODS, TWO_STEP) if two_step else METHODS
    if two_step:
        estimation = machine.estimation.model_copy(update={"two_step": True})
        machine = machine.model_copy(update={"estimation": estimation})
    folder = cache or cache_folder()
    names = [_name(one, methods) for one in wanted]
    stored = {k: load(folder / name, SegmentFit) for k, name in enumerate(names)}
    found = {k: fit for k, fit in stored.items() if fit is not None}
    progress(len(found), len(wanted))
    missing = [k for k in stored if k not in found]
    for k, fit in _fit_these(machine, wanted, missing, methods, jobs, cache):
        store(folder / names[k], fit, machine.log)
        found[k] = fit
        progress(len(found), len(wanted))
    fits = tuple(found[k] for k in stored)
    told = tuple(k for k, fit in enumerate(fits) if fit.windows)
    if not told:
        return Fitted(tuple(wanted), fits, (), None, None)
    between = [_distance(wanted[a], wanted[b]) for a, b in pairwise(told)]
    together = folder / f"{key_of(*(names[k] for k in told), *between)}.joint"
    linearised = load(together, Linearised)
    if linearised is None:
        with side_by_side(len(told), jobs) as each:
            linearised = linearise(machine, [fits[k] for k in told], between, each)
        store(together, linearised, machine.log)
    return _joined(machine, Fitted(tuple(wanted), fits, told, linearised, None))


def _joined(machine: Machine, fitted: Fitted) -> Fitted:
    """All together, and in groups where they do not agree."""
    assert fitted.linearised is not None
    linearised, told = fitted.linearised, fitted.told
    joint = join(machine, linearised)
    apart = () if joint.agreement.agrees else groups(machine, linearised.told, linearised.between_m)
    together = tuple((tuple(told[k] for k in rows), join(machine, linearised, rows)) for rows in apart)
    return replace(fitted, joint=joint, groups=together)


def _fit_these(
    machine: Machine, wanted: Sequence[Wanted], which: Sequence[int], methods: Sequence[str],
    jobs: int | None, cache: Path | None,
) -> Iterator[tuple[int, SegmentFit]]:  # fmt: skip
    """(which, its fit) as they are ready."""
    count = min(len(which), jobs or os.cpu_count() or 1)
    if count < 2:
        for k in which:
            yield k, fit_segment(machine, driven_of(wanted[k], cache), methods)
        return
    with processes(count) as pool:
        futures: Mapping[Future[SegmentFit], int] = {
            pool.submit(fit_segment, machine, driven_of(wanted[k], cache), methods): k for k in which
        }
        for future in as_completed(futures):
            yield futures[future], future.result()


def driven_of(one: Wanted, cache: Path | None) -> tuple[Driven, ...]:
    """The driving of a segment. Raises CannotFit where there is none."""
    start_ns = one.run.start_ns + round(one.segment.start_s * 1e9)
    end_ns = one.run.start_ns + round(one.segment.end_s * 1e9)
    found = driving(one.run, cache=cache, between_ns=(start_ns, end_ns))
    if not found:
        raise CannotFit(
            f"no poses between {one.segment.start_s:g} and {one.segment.end_s:g} s of {one.run.id}"
        )
    return found


def _distance(one: Wanted, other: Wanted) -> float:
    """m from the end of one segment to the end of the other: driven, or, between runs, as the crow flies."""
    if one.run is other.run:
        way = one.run.poses.between(one.segment.end_s, other.segment.end_s)
        steps = np.diff(way.t_s, prepend=way.t_s[:1])
        speed = np.nan_to_num(np.abs(way["tractor_forward_velocity_mps"]))
        return float(np.sum(speed * np.minimum(steps, segments.LONGEST_GAP_S)))
    return math.hypot(*to_plane(_end_deg(one), *_end_deg(other)))


def _end_deg(one: Wanted) -> tuple[float, float]:
    """Latitude and longitude of the tractor's CG at the end of a segment."""
    poses = one.run.poses
    last = max(int(np.searchsorted(poses.t_s, one.segment.end_s, "right")) - 1, 0)
    names = ("origin_latitude_deg", "origin_longitude_deg", "tractor_x_m", "tractor_y_m")
    rows = np.column_stack([poses[name][: last + 1] for name in names])
    known = rows[np.all(np.isfinite(rows), axis=1)]
    if not len(known):
        return 0.0, 0.0
    latitude, longitude, x, y = known[-1].tolist()
    return to_degrees((latitude, longitude), x, y)


def _name(one: Wanted, methods: Sequence[str]) -> str:
    files = [identity(file.path) for file in one.run.files]
    rig = one.run.machine_file.sha256
    times = f"{one.segment.start_s!r} {one.segment.end_s!r}"
    return f"{key_of(*files, rig, times, *methods, pem.METHOD)}.fit"
