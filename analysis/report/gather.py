"""What a report tells of a run, gathered from its tables as plain data, SI. Nothing is judged here."""

from collections import Counter
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.analysis.report.curves import (
    METHODS,
    column_of,
    drive_curves,
    parameter_curves,
    path_curves,
)
from tilth.analysis.report.data import (
    Driving,
    EventFacts,
    FlagFacts,
    Gaps,
    LastEstimate,
    NuisanceFacts,
    PriorFacts,
    RunFacts,
    SegmentFacts,
    SensorFacts,
)
from tilth.analysis.report.document import plain
from tilth.analysis.report.origin import origin_of
from tilth.analysis.runs.run import RECOMMENDED, Run
from tilth.analysis.runs.segments import LONGEST_GAP_S, DrivenSegment, all_segments, tells
from tilth.analysis.runs.table import Table
from tilth.estimator.filters import unknowns
from tilth.schemas.flow import PARAMETERS, EventKind, Mount, Status

SOIL_CHANGE: Final = EventKind.SOIL_CHANGE
CONTRADICTION: Final = "contradiction"
STILL: Final = 0.2  # m/s: slower is standing
SPACINGS: Final = 4.0  # times the usual spacing, and SHORTEST_S: a gap of a sensor
SHORTEST_S: Final = 0.5
MOST_GAPS: Final = 5
POSE_S: Final = 0.2
_TOPICS: Final = (
    "/event",
    *(f"/measurement/{kind}" for kind in ("position", "fix", "wheel_angle")),
    *(
        "/soil_tire" if method == RECOMMENDED else f"/soil_tire/{method}"
        for method in (RECOMMENDED, *METHODS)
    ),
)


def facts_of(run: Run, given: Sequence[DrivenSegment] = ()) -> RunFacts:
    """Of one run. given: segments that are reported instead of those found."""
    run.reader.read_ahead(_TOPICS)
    poses = run.poses
    segments = tuple(given) or all_segments(poses, run.marks)
    estimates = {method: run.estimates(method) for method in METHODS}
    recommended = run.estimates(RECOMMENDED)
    found: RunFacts = plain({
        "id": run.id,
        "note": run.note,
        "duration_s": run.duration_s,
        "start_utc_s": _start_utc_s(run),
        "machine": {"name": run.machine.name, "prior": _prior(run)},
        "origin": origin_of(run),
        "driving": _driving(poses),
        "sensors": _sensors(run),
        "gaps": _gaps(poses.t_s, LONGEST_GAP_S),
        "flags": _flags(poses),
        "events": _events(run.events, poses),
        "segments": [_segment(k, one, run) for k, one in enumerate(segments, 1)],
        "estimates": {
            method: _last(table)
            for method, table in {RECOMMENDED: recommended, **estimates}.items()
            if table.rows
        },
        "nuisances": _nuisances(run),
        "skipped": sorted(what for what, count in run.reader.skipped.items() if count),
        "curves": {
            "path": path_curves(poses, segments),
            "drive": drive_curves(poses, run.duration_s),
            "parameters": parameter_curves(estimates),
        },
    })  # fmt: skip
    return found


def _start_utc_s(run: Run) -> float | None:
    """UTC of the run's beginning, by its first pose or event that knows it."""
    for table in (run.poses, run.events):
        known = np.flatnonzero(np.isfinite(table["utc_s"]))
        if known.size:
            return float(table["utc_s"][known[0]] - table.t_s[known[0]])
    return None


def _prior(run: Run) -> dict[str, PriorFacts]:
    tyres = (run.machine.tyres.front, run.machine.tyres.rear, run.machine.tyres.implement)
    values = [tyre.cornering_stiffness for tyre in tyres] + [tyre.relaxation_length for tyre in tyres]
    return {
        name: {"value": value, "log_sd": tyre.log_sd, "sd": value * tyre.log_sd}
        for name, value, tyre in zip(PARAMETERS, values, tyres * 2, strict=True)
    }


def _driving(poses: Table) -> Driving:
    """s: by the poses."""
    speed = poses["tractor_forward_velocity_mps"]
    dt = np.minimum(np.diff(poses.t_s, append=poses.t_s[-1:]), LONGEST_GAP_S)
    known = np.isfinite(speed)
    moving = known & (np.abs(speed) > STILL)
    latitude, longitude = poses["origin_latitude_deg"], poses["origin_longitude_deg"]
    return {
        "poses": poses.rows,
        "distance_m": float(np.sum(np.abs(speed[moving]) * dt[moving])),
        "moving_s": float(np.sum(dt[moving])),
        "still_s": float(np.sum(dt[known & ~moving])),
        "reverse_s": float(np.sum(dt[moving & (speed < 0)])),
        "median_speed_mps": float(np.median(np.abs(speed[moving]))) if np.any(moving) else None,
        "largest_speed_mps": float(np.max(np.abs(speed[known]))) if np.any(known) else None,
        "latitude_deg": float(latitude[0]) if poses.rows else None,
        "longitude_deg": float(longitude[0]) if poses.rows else None,
        "all_receivers_share": float(np.mean(poses["receivers"] == max(poses["receivers"], default=0)))
        if poses.rows
        else None,
    }


def _sensors(run: Run) -> list[SensorFacts]:
    """Each receiver of the machine file and the wheel-angle sensor: what it gave, and its gaps."""
    positions, fixes, angles = (run.measurements(kind) for kind in ("position", "fix", "wheel_angle"))
    rows = []
    for mount in Mount:
        if not any(receiver.mount is mount for receiver in run.machine.receiver):
            continue
        new = ~positions["repeat"].astype(bool)
        own = positions.where((positions["mount"] == mount.value) & new)
        fix = Counter(fixes["fix"][fixes["mount"] == mount.value].tolist())
        whole = sum(fix.values())
        shares = {str(name): count / whole for name, count in sorted(fix.items())}
        rows.append(_sensor(mount.value, own.t_s, run.duration_s, shares))
    return [*rows, _sensor("wheel_angle", angles.t_s, run.duration_s, {})]


def _sensor(name: str, t: NDArray[np.float64], duration_s: float, fix: dict[str, float]) -> SensorFacts:
    usual = float(np.median(np.diff(t))) if t.size > 1 else 0.0
    limit = max(SHORTEST_S, SPACINGS * usual)
    gaps = _gaps(np.concatenate([[0.0], t, [duration_s]]), limit)
    missing = gaps["all_s"]
    return {
        "name": name,
        "count": int(t.size),
        "per_s": float(t.size / (duration_s - missing)) if duration_s > missing else 0.0,
        "alive_share": max(0.0, 1.0 - missing / duration_s) if duration_s > 0 and t.size else 0.0,
        "gaps": gaps,
        "fix": fix,
    }


def _gaps(t: NDArray[np.float64], limit_s: float) -> Gaps:
    """Between times that follow each other: how many, s of all, the longest."""
    between = np.diff(t)
    found = np.flatnonzero(between > limit_s)
    longest = found[np.argsort(-between[found], kind="stable")][:MOST_GAPS]
    return {
        "count": int(found.size),
        "all_s": float(np.sum(between[found])),
        "longest": [{"start_s": float(t[k]), "seconds": float(between[k])} for k in longest],
    }


def _flags(poses: Table) -> list[FlagFacts]:
    """What was unusual about poses, the most frequent first."""
    counts: Counter[str] = Counter()
    for text, count in Counter(poses["flags"].tolist()).items():
        counts.update({flag: count for flag in str(text).split(", ") if flag})
    rows = sorted(counts.items(), key=lambda row: (-row[1], row[0]))
    return [{"flag": flag, "poses": n, "share": n / poses.rows, "seconds": n * POSE_S} for flag, n in rows]


def _events(events: Table, poses: Table) -> list[EventFacts]:
    """With the tractor's place at the time, m in W."""
    known = np.isfinite(poses["tractor_x_m"])
    t, x, y = poses.t_s[known], poses["tractor_x_m"][known], poses["tractor_y_m"][known]
    return [
        {
            "t_s": float(events.t_s[k]),
            "utc_s": float(events["utc_s"][k]),
            "kind": str(events["kind"][k]),
            "text": str(events["text"][k]),
            "latitude_deg": float(events["latitude_deg"][k]),
            "longitude_deg": float(events["longitude_deg"][k]),
            "x_m": float(np.interp(events.t_s[k], t, x)) if t.size else None,
            "y_m": float(np.interp(events.t_s[k], t, y)) if t.size else None,
        }
        for k in range(events.rows)
    ]


def _segment(number: int, segment: DrivenSegment, run: Run) -> SegmentFacts:
    return {
        "number": number,
        "kind": segment.kind,
        "name": segment.name,
        "start_s": segment.start_s,
        "end_s": segment.end_s,
        "speed_mps": segment.speed,
        "largest_angle_rad": segment.largest_angle,
        "tells": list(tells(segment, run.poses, run.machine)),
    }


def _last(table: Table) -> LastEstimate:
    """The last estimate of a method, as it was published."""
    row = {name: values[-1] for name, values in table.items()}
    covariance = np.asarray(row["log_covariance"])
    return {
        "t_s": row["t_s"],
        "model": row["model"],
        "rule": row["rule"],
        "determined": row["determined"],
        "advice": row["advice"],
        "rank": row["rank"],
        "window_s": row["window_s"],
        "parameters": {
            name: {
                "value": row[column_of(name)],
                "sd": row[column_of(name, "sd")],
                "status": Status(int(row[column_of(name, "status")])).name.lower(),
                "reason": row[column_of(name, "reason")],
                "age_s": row[column_of(name, "age")],
            }
            for name in PARAMETERS
        },
        "log_covariance": covariance.reshape(6, 6).tolist() if np.all(np.isfinite(covariance)) else None,
    }


def _nuisances(run: Run) -> list[NuisanceFacts]:
    """Of the last estimate that is recommended, beside what was assumed before."""
    table = run.nuisances()
    if not table.rows:
        return []
    mean, sd = unknowns.prior(run.machine)
    found: list[NuisanceFacts] = []
    for name in unknowns.NAMES:
        if name not in table or not np.isfinite(table[name][-1]):
            continue
        k = unknowns.AT[name]
        found.append({
            "name": name, "value": table[name][-1], "sd": table[f"{name}_sd"][-1],
            "prior": mean[k], "prior_sd": sd[k],
        })  # fmt: skip
    return found
