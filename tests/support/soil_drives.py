"""Stretches of a made-up field for maps: rows of a rig on soil that any function of place says."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
from logs import MACHINE, MACHINE_TEXT
from numpy.typing import NDArray

from tilth.analysis.season.field_map import window_of
from tilth.analysis.season.identified import Identified, Stretch
from tilth.analysis.season.inventory import Inventory, SeasonRun, SeenFile
from tilth.analysis.season.kept_table import PlacedStretch
from tilth.analysis.season.season import TABLE
from tilth.analysis.season.stretches import driven as driven_runs
from tilth.analysis.season.stretches import rows_of
from tilth.analysis.season.table import write_table
from tilth.estimator.filters.soil_field import Told
from tilth.estimator.pose.geometry import to_degrees

Array = NDArray[np.float64]
Soil = Callable[[Array, Array], Array]  # of north and east, m: the logarithm over the machine file's

ORIGIN_DEG: Final = (48.0, 11.0)
LENGTH_M, ROW_M, ROWS, PARTS = 25.0, 8.0, 10, 6
ALONE_SD: Final = 0.08  # of a stretch
HERE: Final = {
    "begin_utc": "2026-05-01T08:00:00Z", "end_utc": "2026-05-01T08:00:20Z", "run": "day0",
    "method": "pem", "log": "day0.mcap", "logs_sha256": "a" * 64,
}  # fmt: skip


def two_soils(north: Array, east: Array) -> Array:
    """A straight boundary, along no row: 37 m to the east at 75 m to the north."""
    return np.where(east < boundary(north), -0.25, 0.25)


def boundary(north: Array) -> Array:
    return 37.0 + 0.2 * (north - 75.0)


def one_soil(north: Array, east: Array) -> Array:
    return np.full(np.shape(north), 0.2)


def wet_hollow(north: Array, east: Array) -> Array:
    return np.asarray(-0.5 * np.exp(-((north - 90.0) ** 2 + (east - 40.0) ** 2) / (2.0 * 25.0**2)))


def true_of(one: PlacedStretch, soil: Soil) -> Array:
    """Of each axle, on average over its way, (3,)."""
    path = window_of(MACHINE, ORIGIN_DEG, one).path
    return np.asarray(soil(path[..., 0], path[..., 1]).mean(axis=0))


def driven(soil: Soil, seed: int, *, of_rig: float = 0.1) -> list[PlacedStretch]:
    """Rows to north and back, stretch by stretch. of_rig: sd of what the machine file is off by."""
    rng = np.random.default_rng(seed)
    off, found = of_rig * rng.standard_normal(), list[PlacedStretch]()
    for row in range(ROWS):
        for part in range(PARTS):
            along = LENGTH_M * (part + np.linspace(0.0, 1.0, 6))
            north = along if row % 2 == 0 else PARTS * LENGTH_M - along
            path = np.array([to_degrees(ORIGIN_DEG, x, ROW_M * row) for x in north.tolist()])
            empty = Told(np.zeros((6, 6)), np.zeros(6), np.zeros(6))
            one = PlacedStretch("day0", "pem", len(found) + 1, path, empty, np.zeros((6, 6)), HERE)
            logs = np.zeros(6)
            logs[:3] = true_of(one, soil) + off + ALONE_SD * rng.standard_normal(3)
            information = np.diag([ALONE_SD**-2] * 3 + [0.0] * 3)
            found.append(replace(one, told=Told(information, information @ logs, np.zeros(6))))
    return found


def degrees_apart_m(a: Array, b: Array) -> float:
    """Largest distance of places in degrees (n, 2), latitude and longitude, on a sphere."""
    north, east = np.radians(a - b).T
    east = east * math.cos(math.radians(ORIGIN_DEG[0]))
    return float(6_371_000.0 * np.max(np.hypot(north, east)))


UTC_NS: Final = 1_777_622_400_000_000_000  # 2026-05-01T08:00:00Z


def kept_season(
    out: Path, machines: Mapping[str, Sequence[PlacedStretch]], *, text: str = MACHINE_TEXT
) -> Path:
    """The folder of a season of one run of each machine. machines: name -> its stretches."""
    texts, runs = {}, {}
    for k, (name, stretches) in enumerate(machines.items()):
        texts[f"sha{k}"] = (text.replace(f'name = "{MACHINE.machine.name}"', f'name = "{name}"', 1), None)
        begin_ns, end_ns = k * 10**13, (k + 1) * 10**13
        file = SeenFile(
            f"{name}.mcap", 1, 0, sha256=f"log{k}", first_ns=begin_ns, last_ns=end_ns - 10**12,
            utc_minus_ns=UTC_NS, machine=f"sha{k}",
        )  # fmt: skip
        told = [
            Stretch(
                one.method, begin_ns + n * 10**10, begin_ns + n * 10**10 + 10**9, 20.0, 30.0, 3.0, 0.1,
                one.path_deg, one.told.information, one.told.vector, one.told.model_sd, by_file=one.by_file,
            )
            for n, one in enumerate(stretches)
        ]  # fmt: skip
        runs[SeasonRun(name, (file,))] = Identified(stretches=tuple(told), confirmed=True)
    inventory = Inventory(tuple(runs), (), texts)
    out.mkdir(exist_ok=True)
    write_table(out / TABLE, rows_of(inventory, driven_runs(inventory, runs)), texts)
    return out
