"""Curves of a run, thinned to what a page can show: an hour's drive must not make a report of 100 MB.

Lists of numbers to six digits; None where there is nothing, which breaks a line.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from tilth.analysis.report.data import Envelope, PathCurves, PublishedCurve, TrackFacts
from tilth.analysis.runs.segments import LONGEST_GAP_S, DrivenSegment
from tilth.analysis.runs.table import Table
from tilth.schemas.flow import PARAMETERS, Status
from tilth.schemas.spread import WITHIN

Floats = NDArray[np.float64]

BUCKETS: Final = 500  # of a curve over time: two points in each
POINTS: Final = 400  # of a published number over time
OF_EXTENT: Final = 1 / 3000  # by so much of its extent a path may differ from what was driven
DIGITS: Final = 6
METHODS: Final = ("steady_state", "tracker", "pem")
SERIES: Final = (
    ("wheel_angle", "wheel_angle_rad", "sd_wheel_angle_rad"),
    ("speed", "tractor_forward_velocity_mps", "tractor_sd_velocity_mps"),
    ("articulation", "articulation_rad", "sd_articulation_rad"),
)
"""Name in the report, column of poses, column of its sd."""


def numbers(values: Any) -> list[float | None]:
    """To DIGITS digits; None where it is not finite."""
    flat = np.asarray(values, dtype=np.float64).tolist()
    return [float(f"{value:.{DIGITS}g}") if math.isfinite(value) else None for value in flat]


def path_curves(poses: Table, segments: Sequence[DrivenSegment]) -> PathCurves:
    """Of both CGs."""
    return {
        "tractor": _track(poses, "tractor"),
        "implement": _track(poses, "implement"),
        "segments": [
            {"number": k, "kind": one.kind, **_track(poses.between(one.start_s, one.end_s), "tractor")}
            for k, one in enumerate(segments, 1)
        ],
    }


def _track(poses: Table, body: str) -> TrackFacts:
    """Broken where poses are missing."""
    x, y = poses[f"{body}_x_m"], poses[f"{body}_y_m"]
    known = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
    if not known.size:
        return {"x": [], "y": []}
    tolerance = float(max(np.ptp(x[known]), np.ptp(y[known]))) * OF_EXTENT
    breaks = np.flatnonzero(np.diff(poses.t_s[known]) > LONGEST_GAP_S) + 1
    pieces: list[tuple[Floats, Floats]] = []
    for rows in np.split(known, breaks):
        kept = rows[simplified(x[rows], y[rows], tolerance)]
        pieces += [(x[kept], y[kept]), (np.array([np.nan]), np.array([np.nan]))]
    return {
        "x": numbers(np.concatenate([one[0] for one in pieces[:-1]])),
        "y": numbers(np.concatenate([one[1] for one in pieces[:-1]])),
    }


def simplified(x: Floats, y: Floats, tolerance: float) -> NDArray[np.intp]:
    """Numbers of the points of a line, [n], that are needed to stay within a tolerance of it.

    Source: Douglas and Peucker (1973).
    """
    keep = np.zeros(len(x), np.bool_)
    keep[[0, -1]] = True
    open_pieces = [(0, len(x) - 1)]
    while open_pieces:
        first, last = open_pieces.pop()
        if last - first < 2:
            continue
        dx, dy = x[last] - x[first], y[last] - y[first]
        ahead, lateral_offset = x[first + 1 : last] - x[first], y[first + 1 : last] - y[first]
        length = math.hypot(dx, dy)
        off = (
            np.abs(ahead * dy - lateral_offset * dx) / length
            if length > 0
            else np.hypot(ahead, lateral_offset)
        )
        if off.max() > tolerance:
            middle = first + 1 + int(np.argmax(off))
            keep[middle] = True
            open_pieces += [(first, middle), (middle, last)]
    return np.flatnonzero(keep)


def drive_curves(poses: Table, duration_s: float) -> dict[str, Envelope]:
    """By name of SERIES, SI."""
    return {
        name: _envelope(poses.t_s, poses[column], WITHIN * poses[sd], duration_s)
        for name, column, sd in SERIES
    }


def _envelope(t: Floats, value: Floats, half: Floats, duration_s: float) -> Envelope:
    """Least and largest of each bucket, in their order, with the band's outermost."""
    known = np.isfinite(value)
    t, value, half = t[known], value[known], np.nan_to_num(half[known])
    rows: list[tuple[float, float, float, float]] = []
    if t.size:
        bucket = np.minimum((t * (BUCKETS / max(duration_s, 1e-9))).astype(int), BUCKETS)
        breaks = np.diff(t) > LONGEST_GAP_S
        edges = np.flatnonzero((np.diff(bucket) > 0) | breaks) + 1
        for at in np.split(np.arange(t.size), edges):
            if rows and t[at[0]] - t[at[0] - 1] > LONGEST_GAP_S:
                rows.append((float(t[at[0] - 1]), math.nan, math.nan, math.nan))
            low, high = float(np.min(value[at] - half[at])), float(np.max(value[at] + half[at]))
            ends = sorted({int(at[np.argmin(value[at])]), int(at[np.argmax(value[at])])})
            rows += [(float(t[k]), float(value[k]), low, high) for k in ends]
    columns = np.array(rows, dtype=np.float64).reshape(-1, 4).T
    t_s, values, lows, highs = map(numbers, columns)
    return {"t_s": t_s, "value": values, "low": lows, "high": highs}


def column_of(parameter: str, what: str = "") -> str:
    """Of a table of estimates. what: "", sd, status, reason, age."""
    unit = {"": "_N_per_rad", "sd": "_N_per_rad"} if parameter.startswith("C_") else {"": "_m", "sd": "_m"}
    unit |= {"age": "_s"}
    return f"{parameter}{f'_{what}' if what else ''}{unit.get(what, '')}"


def parameter_curves(tables: Mapping[str, Table]) -> dict[str, dict[str, PublishedCurve]]:
    """method -> parameter -> as published; SI."""
    return {
        method: {name: _published(table, name) for name in PARAMETERS}
        for method, table in tables.items()
        if table.rows
    }


def _published(table: Table, name: str) -> PublishedCurve:
    rows = np.unique(np.linspace(0, table.rows - 1, min(POINTS, table.rows)).round().astype(int))
    usable = table[column_of(name, "status")][rows] == Status.ESTIMATED
    return {
        "t_s": numbers(table.t_s[rows]),
        "value": numbers(table[column_of(name)][rows]),
        "sd": numbers(table[column_of(name, "sd")][rows]),
        "usable": usable.tolist(),
    }
