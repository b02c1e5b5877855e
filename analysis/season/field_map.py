"""A map of each field of a season: the memory by place (estimator/methods/place.py) over all of its
stretches, asked along each stretch and in cells between them.

A field is as it was when it was last driven: what was told ages as in the cab, and a run that tells of
another soil than was expected is a change in time. The memory in the cab keeps 32 windows; a
field here up to MOST_WINDOWS, and beyond that the two that are nearest become one, as there.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby, pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, KDTree, QhullError

from tilth.analysis.season.identified import IMPLEMENT_AXLE
from tilth.analysis.season.kept_table import MapProblem, PlacedStretch
from tilth.estimator.filters import unknowns
from tilth.estimator.filters.soil_field import AXLES, SoilMemory, SoilWindow
from tilth.estimator.filters.unknowns import SIX
from tilth.estimator.methods import pem
from tilth.estimator.methods.place import PLACE, axles_in_line, merged_nearest
from tilth.estimator.pose.geometry import to_degrees, to_plane
from tilth.estimator.results.reporting import is_supported
from tilth.schemas.flow import PARAMETERS, Status
from tilth.schemas.machine import Machine
from tilth.schemas.reasons import Code, Reason
from tilth.schemas.sentences import sentence

Array = NDArray[np.float64]

STIFFNESSES: Final = PARAMETERS[:AXLES]
STRETCH, CELL = "stretch", "cell"
CELL_M: Final = 10.0
GAP_M: Final = 300.0  # between two fields
REACH_M: Final = 50.0  # from a way, or less where soil is alike over less: further off a cell stays empty
STEP_M: Final = 5.0  # between places of a way, to which distances are measured
MOST_WINDOWS: Final = 3 * PLACE.most_windows
MOST_CELLS: Final = 100_000
AT_ONCE: Final = 256  # cells
STANDING_M: Final = 1e-3  # between two places of a way that are one
WIDTH_M: Final = 2.0  # of an axle whose track nobody has measured
EARTH_M: Final = 6_371_000.0


@dataclass(frozen=True, slots=True)
class MapFeature:
    """A stretch or a cell. ring: longitude and latitude, degrees, (n, 2): closed, counterclockwise."""

    kind: str
    field: int
    ring: Array
    properties: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class MappedField:
    """north and east, m, from the origin. grid: south-west corners of its cells (n, 2); mean, sd: of the
    stiffnesses' logarithms there (n, 3), NaN where there is no number."""

    number: int
    origin_deg: tuple[float, float]  # latitude and longitude
    stretches: tuple[PlacedStretch, ...]
    ways: tuple[Array, ...]  # of the implement's axle
    outline: Array  # (n, 2)
    cell_m: float
    grid: Array
    mean: Array
    sd: Array
    features: tuple[MapFeature, ...]
    changed: tuple[str, ...]  # runs since which the soil is another one
    windows: tuple[SoilWindow, ...]  # of the memory


def fields_of(stretches: Sequence[PlacedStretch]) -> list[list[PlacedStretch]]:
    """By field, in the order of the first stretch of each: ways that are GAP_M apart are of two."""
    corner = GAP_M / 6.0  # places are rounded to such a grid: the gap is meant to a third or so
    places, of = list[Array](), list[int]()
    for k, one in enumerate(stretches):
        latitude, longitude = np.radians(one.path_deg).T
        around = np.cos(latitude)
        ball = np.stack([around * np.cos(longitude), around * np.sin(longitude), np.sin(latitude)], axis=1)
        places.append(np.unique(np.round(EARTH_M * ball / corner), axis=0) * corner)
        of += [k] * len(places[-1])
    nodes, which = np.unique(np.concatenate(places), axis=0, return_inverse=True)
    pairs = KDTree(nodes).query_pairs(GAP_M, output_type="ndarray") + len(stretches)
    links = np.concatenate([pairs, np.stack([of, which.ravel() + len(stretches)], axis=1)])
    size = len(stretches) + len(nodes)
    graph = coo_array((np.ones(len(links)), (links[:, 0], links[:, 1])), shape=(size, size))
    labels = connected_components(graph, directed=False)[1][: len(stretches)].tolist()
    return [
        [one for one, own in zip(stretches, labels, strict=True) if own == label]
        for label in dict.fromkeys(labels)
    ]


def window_of(machine: Machine, origin_deg: tuple[float, float], one: PlacedStretch) -> SoilWindow:
    """A stretch as the memory by place keeps it: of the way of the implement's axle, which is what a season's
    table has, the other two axles are ahead in line."""
    way = np.array([to_plane(origin_deg, *place) for place in one.path_deg.tolist()])
    ahead = np.gradient(way, axis=0) if len(way) > 1 else np.zeros((1, 2))
    path = []
    for place, (north, east) in zip(way, ahead.tolist(), strict=True):
        line = axles_in_line(machine, math.atan2(east, north))
        path.append(place + line - line[IMPLEMENT_AXLE])
    return SoilWindow(one.method, one.begin_utc_ns, 0, np.array(path), one.told)


def memory_of(runs: Sequence[tuple[str, list[SoilWindow]]], prior_sd: Array) -> tuple[SoilMemory, list[str]]:
    """What all runs tell of a field, and since which of them the soil is another one. runs: name and windows,
    in the order of driving. prior_sd: (n,)."""
    kept, changed, epoch = list[SoilWindow](), list[str](), 0
    for name, told in runs:
        soil = SoilMemory(tuple(kept), prior_sd)
        after = SoilMemory([*kept, *(replace(one, epoch=epoch) for one in told)], prior_sd)
        if soil.surprise(after) < PLACE.unexpected:
            epoch += 1
            changed.append(name)
        for one in told:
            kept.append(replace(one, epoch=epoch))
            if len(kept) > MOST_WINDOWS:
                kept = merged_nearest(kept)
    return SoilMemory(kept, prior_sd), changed


def mapped(
    number: int, machine: Machine, stretches: Sequence[PlacedStretch], cell_m: float = CELL_M
) -> MappedField:
    """A field. Raises MapProblem where it has too many cells."""
    first = stretches[0].path_deg[0].tolist()
    origin_deg = (first[0], first[1])
    windows = [window_of(machine, origin_deg, one) for one in stretches]
    prior_mean, prior_sd = unknowns.prior(machine)
    pairs = groupby(zip(stretches, windows, strict=True), key=lambda pair: pair[0].run)
    runs = [(run, [window for _, window in of]) for run, of in pairs]
    soil, changed = memory_of(runs, prior_sd)
    masses = pem.of_masses(np.diag(prior_sd**2))[SIX, SIX][:AXLES, :AXLES]
    by_file = stretches[-1].by_file[:AXLES, :AXLES]  # a field is as in its last run, and so is the file
    ways = tuple(window.path[:, IMPLEMENT_AXLE] for window in windows)
    reach_m = min(max(soil.at(windows[0].path).length_m, cell_m), REACH_M)
    grid = _cells(ways, cell_m, reach_m)
    mean, sd = np.zeros((len(grid), AXLES)), np.zeros((len(grid), AXLES))
    for k in range(0, len(grid), AT_ONCE):
        at, covariance = soil.around(grid[k : k + AT_ONCE] + cell_m / 2.0)
        mean[k : k + AT_ONCE] = prior_mean[:AXLES] + at
        sd[k : k + AT_ONCE] = np.sqrt(np.diagonal(covariance + masses + by_file, axis1=1, axis2=2))
    known = np.array(
        [[is_supported(False, one, of) for one, of in zip(row, prior_sd, strict=False)] for row in sd]
    ).reshape(sd.shape)
    any_known = known.any(axis=1)
    grid, mean, sd, known = (part[any_known] for part in (grid, mean, sd, known))
    features = []
    for one, window, way in zip(stretches, windows, ways, strict=True):
        there = soil.at(window.path)
        sds = np.sqrt(np.diag(there.covariance)[:AXLES] + np.diag(masses) + np.diag(one.by_file)[:AXLES])
        said = _said(prior_mean[:AXLES] + there.mean[:AXLES], sds, prior_sd)
        ring = _degrees(origin_deg, along(way, machine.tyres.implement))
        features.append(MapFeature(STRETCH, number, ring, {**said, **one.properties}))
    square = cell_m * np.array([[0, 0], [0, 1], [1, 1], [1, 0], [0, 0]])  # north, east
    for corner, logs, sds in zip(grid, mean, sd, strict=True):
        ring = _degrees(origin_deg, corner + square)
        features.append(MapFeature(CELL, number, ring, _said(logs, sds, prior_sd)))
    blank = np.where(known, 0.0, np.nan)
    return MappedField(
        number, origin_deg, tuple(stretches), ways, _outline(ways), cell_m, grid, mean + blank, sd + blank,
        tuple(features), tuple(changed), tuple(soil.windows),
    )  # fmt: skip


def _said(logs: Array, sds: Array, prior_sd: Array) -> dict[str, Any]:
    """Of the stiffnesses, as live: a number where it is known well enough, else the reason."""
    said: dict[str, Any] = {}
    for name, log, sd, own in zip(STIFFNESSES, logs.tolist(), sds.tolist(), prior_sd.tolist(), strict=False):
        given = is_supported(False, sd, own)
        said[name] = math.exp(log) if given else None
        said[f"{name}_log_sd"] = sd if given else None
        said[f"{name}_status"] = (Status.ESTIMATED if given else Status.UNESTIMATED).name.lower()
        said[f"{name}_reason"] = None if given else sentence(Reason(Code.WIDE, numbers=(sd,)))
    return said


def _cells(ways: Sequence[Array], cell_m: float, reach_m: float) -> Array:
    """South-west corners of the cells whose middles are in reach of a way, (n, 2). Raises MapProblem."""
    near = KDTree(np.concatenate([_dense(way) for way in ways]))
    low, high = near.mins - reach_m, near.maxes + reach_m
    first, last = np.floor(low / cell_m).astype(int), np.ceil(high / cell_m).astype(int)
    count = int(np.prod(last - first, dtype=np.float64))
    if count > MOST_CELLS:
        raise MapProblem(f"cells of {cell_m:g} m are {count} in one field; give a larger --cell")
    corners = np.stack(np.meshgrid(*map(np.arange, first, last), indexing="ij"), axis=-1).reshape(-1, 2)
    grid = corners * cell_m
    return np.asarray(grid[near.query(grid + cell_m / 2.0)[0] <= reach_m], np.float64)


def _dense(way: Array) -> Array:
    """Places along a way, at most STEP_M apart."""
    parts = [way[:1]]
    for begin, end in pairwise(way):
        count = max(1, math.ceil(math.dist(begin, end) / STEP_M))
        parts.append(begin + np.linspace(0.0, 1.0, count + 1)[1:, None] * (end - begin))
    return np.concatenate(parts)


def along(way: Array, tyre: Any) -> Array:
    """What an axle of this track has driven over: a ring of north and east, closed, counterclockwise as seen
    on a map. Where the way crosses itself, as in the rows of a block, the hull of it."""
    width = (tyre.dual_track or tyre.track).value if tyre.track is not None else WIDTH_M
    way = way[np.concatenate([[True], np.linalg.norm(np.diff(way, axis=0), axis=1) > STANDING_M])]
    if len(way) < 2:
        half = width / 2.0
        return np.asarray(
            way[0] + half * np.array([[-1, -1], [-1, 1], [1, 1], [1, -1], [-1, -1]]), np.float64
        )
    ahead = np.diff(way, axis=0)
    ahead = np.concatenate([ahead[:1], ahead, ahead[-1:]]) / np.maximum(1e-9, _lengths(ahead))
    ahead = ahead[:-1] + ahead[1:]
    ahead /= np.maximum(1e-9, np.linalg.norm(ahead, axis=1, keepdims=True))
    right = width / 2.0 * np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)  # of north and east
    ring = np.concatenate([way + right, (way - right)[::-1]])
    if not _is_simple(ring):
        ring = _hull(ring)
    ring = np.concatenate([ring, ring[:1]])
    return np.asarray(ring if _area(ring) > 0.0 else ring[::-1], np.float64)


def _lengths(ahead: Array) -> Array:
    lengths = np.linalg.norm(ahead, axis=1, keepdims=True)
    return np.concatenate([lengths[:1], lengths, lengths[-1:]])


def _area(ring: Array) -> float:
    """Of a closed ring of north and east: positive where it is counterclockwise as seen on a map."""
    north, east = ring.T
    return float(np.sum(east[:-1] * north[1:] - east[1:] * north[:-1]) / 2.0)


def _is_simple(ring: Array) -> bool:
    """Whether no two sides of it cross."""
    a, b = ring, np.roll(ring, -1, axis=0)

    def side(p: Array, q: Array, r: Array) -> Array:
        return np.asarray(np.sign((q - p)[..., 0] * (r - p)[..., 1] - (q - p)[..., 1] * (r - p)[..., 0]))

    p, q, r, s = a[:, None], b[:, None], a[None, :], b[None, :]
    cross = (side(p, q, r) * side(p, q, s) < 0) & (side(r, s, p) * side(r, s, q) < 0)
    return not cross.any()


def _hull(places: Array) -> Array:
    """Corners of the convex hull."""
    return np.asarray(places[ConvexHull(places).vertices], np.float64)


def _outline(ways: Sequence[Array]) -> Array:
    """Of a field: the hull of its ways, closed."""
    places = np.concatenate(ways)
    try:
        hull = _hull(places)
    except QhullError:  # they are all in line
        hull = places
    return np.concatenate([hull, hull[:1]])


def _degrees(origin_deg: tuple[float, float], ring: Array) -> Array:
    """Longitude and latitude of north and east."""
    return np.array([to_degrees(origin_deg, north, east)[::-1] for north, east in ring.tolist()])
