"""Segments that a user gives: [N:]A:B, seconds from the start of the N-th log, the first if not said."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

from tilth.analysis.runs.run import Run
from tilth.analysis.runs.segments import MARKED, DrivenSegment, between

MOST_FITTED: Final = 4
"""Segments of a run that are fitted unless more are asked for: those with the largest wheel angles, in their
order. A day of headland turns would take hours, and what was published all the way is in the log. Runs of a
plan of experiments are few, and all are fitted."""
ALL: Final = 1_000_000


def of_a_plan(segment: DrivenSegment) -> bool:
    """Whether it is between two marks of `tilth experiment`."""
    return segment.kind == MARKED and segment.name.startswith("experiment ")


class GivenTimes(NamedTuple):
    """log: from 1."""

    log: int
    start_s: float
    end_s: float


def given_times(text: str) -> GivenTimes:
    """Raises ValueError with what is right."""
    parts = text.split(":")
    try:
        log = int(parts[0]) if len(parts) == 3 else 1
        start_s, end_s = map(float, parts[-2:])
        if len(parts) not in (2, 3) or log < 1 or not 0 <= start_s < end_s < float("inf"):
            raise ValueError
    except ValueError:
        raise ValueError(
            f"{text}: give seconds since it began, such as 12:42, or 2:12:42 of the second one"
        ) from None
    return GivenTimes(log, start_s, end_s)


def given_segments(run: Run, logs: Sequence[Path], given: Sequence[GivenTimes]) -> tuple[DrivenSegment, ...]:
    """Those of one run. logs: as the user gave them. Raises ValueError: no poses at such times."""
    found = []
    for times in given:
        path = logs[times.log - 1]
        if path not in run.sources:
            continue
        file = run.files[run.sources.index(path)]
        later_s = (file.first_ns - run.start_ns) * 1e-9
        try:
            found.append(between(run.poses, times.start_s + later_s, times.end_s + later_s))
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None
    return tuple(found)
