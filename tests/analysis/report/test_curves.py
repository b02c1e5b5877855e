"""Thinned curves: small, and nothing that matters is lost."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from tilth.analysis.report.curves import (
    BUCKETS,
    OF_EXTENT,
    SERIES,
    column_of,
    drive_curves,
    numbers,
    path_curves,
    simplified,
)
from tilth.analysis.runs.run import Run
from tilth.analysis.runs.table import Table
from tilth.schemas.flow import PARAMETERS


def poses(t: np.ndarray, **columns: np.ndarray) -> Table:
    nothing = np.zeros(len(t))
    places = [f"{body}_{axis}_m" for body in ("tractor", "implement") for axis in "xy"]
    names = [*places, *(name for _, value, sd in SERIES for name in (value, sd))]
    return Table({"t_s": t, **{name: columns.get(name, nothing) for name in names}})


def test_a_simplified_line_stays_within_its_tolerance() -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 5000)
    x, y = 100.0 * np.cos(angle), 60.0 * np.sin(2.0 * angle)
    kept = simplified(x, y, 0.1)
    assert kept[0] == 0 and kept[-1] == len(x) - 1 and len(kept) < 200
    nearest = np.full(len(x), np.inf)
    for a, b in pairwise(kept):
        along = np.linspace(0.0, 1.0, b - a + 1)
        off = np.hypot(
            x[a] + along * (x[b] - x[a]) - x[a : b + 1], y[a] + along * (y[b] - y[a]) - y[a : b + 1]
        )
        nearest[a : b + 1] = np.minimum(nearest[a : b + 1], off)
    assert np.median(nearest) < 0.1


def test_a_standing_rig_is_a_point() -> None:
    kept = simplified(np.zeros(50), np.zeros(50), 0.1)
    assert kept.tolist() == [0, 49]


def test_an_hour_keeps_its_extremes_in_few_points() -> None:
    t = np.arange(0.0, 3600.0, 0.2)
    angle = 0.05 * np.sin(t)
    angle[7777] = 0.4
    curve = drive_curves(poses(t, wheel_angle_rad=angle, sd_wheel_angle_rad=np.full(len(t), 0.01)), 3600.0)
    found: Any = curve["wheel_angle"]
    assert len(found["t_s"]) <= 2 * BUCKETS + 2
    assert max(found["value"]) == 0.4 and found["t_s"][found["value"].index(0.4)] == pytest.approx(
        t[7777], abs=0.01
    )
    assert max(found["high"]) == pytest.approx(0.4 + 1.96 * 0.01)
    assert all(
        low <= value <= high
        for low, value, high in zip(found["low"], found["value"], found["high"], strict=True)
    )


def test_a_gap_breaks_curves_and_paths() -> None:
    t = np.concatenate([np.arange(0.0, 10.0, 0.2), np.arange(30.0, 40.0, 0.2)])
    table = poses(t, tractor_x_m=t, implement_x_m=t)
    assert None in drive_curves(table, 40.0)["speed"]["value"]
    path = path_curves(table, [])
    assert path["tractor"]["x"] == [0.0, 9.8, None, 30.0, 39.8]


def test_places_that_are_not_known_are_left_out() -> None:
    t = np.arange(0.0, 10.0, 0.2)
    x = np.where(t < 5.0, np.nan, t)
    path = path_curves(poses(t, tractor_x_m=x, implement_x_m=np.full(len(t), np.nan)), [])
    assert path["tractor"]["x"] == [5.0, 9.8] and path["implement"] == {"x": [], "y": []}


def test_the_columns_of_parameters_exist(run: Run) -> None:
    table = run.estimates("pem")
    for name in PARAMETERS:
        assert all(column_of(name, what) in table for what in ("", "sd", "status", "reason", "age"))


def test_numbers_are_short_and_never_nan() -> None:
    assert numbers([1 / 3, np.nan, np.inf, 2.0]) == [0.333333, None, None, 2.0]
    assert OF_EXTENT < 1e-3
