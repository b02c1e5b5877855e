"""Maps of made-up fields: beside the truth, on stretches left out, and what an outline looks like."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from logs import MACHINE
from numpy.typing import NDArray
from soil_drives import ORIGIN_DEG, boundary, driven, one_soil, true_of, two_soils, wet_hollow

from tilth.analysis.season import field_map
from tilth.analysis.season.field_map import (
    MOST_WINDOWS,
    REACH_M,
    MapFeature,
    MappedField,
    along,
    fields_of,
    mapped,
    memory_of,
    window_of,
)
from tilth.analysis.season.kept_table import MapProblem, PlacedStretch
from tilth.estimator.filters import unknowns
from tilth.schemas.spread import WITHIN

Array = NDArray[np.float64]
MEAN, SD = (part[:3] for part in unknowns.prior(MACHINE))
TYRE = MACHINE.tyres.implement


def shifted(one: PlacedStretch, north: float, east: float) -> PlacedStretch:
    """On a sphere, which is right to a percent."""
    return replace(
        one, path_deg=one.path_deg + np.array([north, east / math.cos(math.radians(48.0))]) / 111_195.0
    )


def crossings(found: MappedField) -> Array:
    """How far to the east of the true boundary the map has it, for each row of cells, m."""
    logs, middle = found.mean.mean(axis=1), found.grid + found.cell_m / 2.0
    between, off = np.percentile(logs, (10, 90)).mean(), []
    for north in np.unique(middle[(middle[:, 0] > 0.0) & (middle[:, 0] < 150.0), 0]):
        row = middle[:, 0] == north
        east, value = middle[row, 1], logs[row]
        k = int(np.flatnonzero((value[:-1] < between) & (value[1:] >= between))[0])
        share = (between - value[k]) / (value[k + 1] - value[k])
        off.append(east[k] + share * (east[k + 1] - east[k]) - float(boundary(north)))
    return np.array(off)


@pytest.mark.parametrize("seed", range(3))
def test_a_boundary_is_found_within_five_metres(seed: int) -> None:
    off = crossings(mapped(1, MACHINE, driven(two_soils, seed)))
    assert len(off) == 15
    assert np.mean(np.abs(off) <= 5.0) >= 0.9 and np.mean(np.abs(off)) < 2.5


@pytest.mark.parametrize("seed", range(3))
def test_a_field_of_one_soil_shows_one(seed: int) -> None:
    found = mapped(1, MACHINE, driven(one_soil, seed))
    assert not found.changed and len(found.grid) > 100
    assert np.max(np.abs(found.mean - found.mean.mean(axis=0)) / found.sd) < WITHIN
    assert np.max(found.sd) < 0.2 < np.min(SD)


@pytest.mark.parametrize("soil", [two_soils, wet_hollow, one_soil], ids=lambda soil: soil.__name__)
def test_intervals_hold_on_stretches_left_out(soil: Callable[[Array, Array], Array]) -> None:
    within = []
    for seed in (0, 1):
        stretches, of_rig = driven(soil, seed), 0.1 * np.random.default_rng(seed).standard_normal()
        for left_out in range(3):
            kept = [
                window_of(MACHINE, ORIGIN_DEG, one) for k, one in enumerate(stretches) if k % 3 != left_out
            ]
            memory, _ = memory_of([("day0", kept)], unknowns.prior(MACHINE)[1])
            for one in stretches[left_out::3]:
                at = memory.at(window_of(MACHINE, ORIGIN_DEG, one).path)
                off = at.mean[:3] - true_of(one, soil) - of_rig
                within += (np.abs(off) <= WITHIN * np.sqrt(np.diag(at.covariance)[:3])).tolist()
    assert len(within) == 360 and np.mean(within) > 0.92


def of_kind(found: MappedField, kind: str) -> list[MapFeature]:
    return [one for one in found.features if one.kind == kind]


def test_stretches_and_cells_have_numbers_or_reasons_and_what_nobody_informed_is_empty() -> None:
    stretches = driven(two_soils, 0)[:6]
    found = mapped(4, MACHINE, stretches)
    cells, ways = of_kind(found, "cell"), of_kind(found, "stretch")
    assert len(ways) == 6 and len(cells) == len(found.grid) > 0
    assert all(one.field == 4 for one in found.features)
    assert ways[0].properties["run"] == "day0" and ways[0].properties["C_af"] > 0.0
    way = np.concatenate(found.ways)
    middle = found.grid + found.cell_m / 2.0
    reach = np.linalg.norm(middle[:, None] - way[None], axis=2).min(axis=1)
    assert np.max(reach) <= REACH_M + 2.5  # half of what is between two places of a way
    told = replace(stretches[0].told, information=np.zeros((6, 6)), vector=np.zeros(6))
    empty = mapped(1, MACHINE, [replace(one, told=told) for one in stretches])
    assert not of_kind(empty, "cell")
    first = of_kind(empty, "stretch")[0].properties
    assert first["C_ai"] is None and first["C_ai_status"] == "unestimated" and first["C_ai_reason"]


def test_a_field_is_as_uncertain_as_errors_of_the_machine_file_make_it() -> None:
    stretches, by_file = driven(two_soils, 0)[:6], np.diag([0.04, 0.01, 0.02, 0.0, 0.0, 0.0])
    right = mapped(4, MACHINE, stretches).features
    doubted = mapped(4, MACHINE, [replace(one, by_file=by_file) for one in stretches]).features
    both = [
        (one.properties[f"{name}_log_sd"], other.properties[f"{name}_log_sd"], by_file[k, k])
        for one, other in zip(right, doubted, strict=True)
        for k, name in enumerate(("C_af", "C_ar", "C_ai"))
    ]
    known = [(sd, wider, added) for sd, wider, added in both if sd is not None and wider is not None]
    assert len(known) > 20
    for sd, wider, added in known:
        assert wider == pytest.approx(math.hypot(sd, math.sqrt(added)))


def test_soil_that_has_changed_with_time_is_told_and_the_map_is_of_after() -> None:
    before = driven(one_soil, 0, of_rig=0.0)[::2]
    later = driven(lambda north, east: one_soil(north, east) - 0.8, 1, of_rig=0.0)[::2]
    after = [replace(one, run="day9") for one in later]
    found = mapped(1, MACHINE, [*before, *after])
    assert found.changed == ("day9",)
    assert np.mean(found.mean - MEAN) == pytest.approx(-0.6, abs=0.1)
    assert not mapped(1, MACHINE, [*before, *(replace(one, run="day9") for one in before)]).changed


def test_what_was_told_fades_from_run_to_run_as_in_the_cab() -> None:
    """A field is as it was when it was last driven."""
    told = driven(one_soil, 0)[:12]
    (last,) = [replace(one, run="day9") for one in driven(one_soil, 1)[-1:]]
    sds = []
    for days in (0, 1, 9):
        later = replace(last, begin_utc_ns=days * 86_400 * 10**9)
        found = mapped(1, MACHINE, [*told, later])
        sds.append(of_kind(found, "stretch")[0].properties["C_af_log_sd"] or 1.0)
        assert of_kind(found, "stretch")[-1].properties["C_af_log_sd"] < 0.2
    assert sds[0] < sds[1] < sds[2]


def test_many_windows_become_fewer_and_tell_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    assert MOST_WINDOWS > 60
    whole = mapped(1, MACHINE, driven(one_soil, 2))
    monkeypatch.setattr(field_map, "MOST_WINDOWS", 30)
    fewer = mapped(1, MACHINE, driven(one_soil, 2))
    assert np.mean(fewer.mean) == pytest.approx(np.mean(whole.mean), abs=0.02)
    assert len(fewer.stretches) == 60


def test_fields_are_told_apart_by_the_gap_between_them() -> None:
    one = driven(one_soil, 0)[::7]
    for gap, count in ((200.0, 1), (500.0, 2), (40_000.0, 2)):
        other = [shifted(each, 150.0 + gap, 0.0) for each in one]
        parts = fields_of([*other, *one])
        assert [len(part) for part in parts] == ([2 * len(one)] if count == 1 else [len(one)] * 2)
        assert parts[0][0] is other[0]


def test_too_many_cells_are_refused() -> None:
    first = driven(one_soil, 0)[0]
    far = [shifted(first, 290.0 * k, 0.0) for k in range(30)]
    with pytest.raises(MapProblem, match="larger --cell"):
        mapped(1, MACHINE, [*far, *(shifted(one, 0.0, 8000.0) for one in far)], 1.0)


WAYS = st.lists(st.tuples(st.floats(-80, 80), st.floats(-80, 80)), min_size=1, max_size=6).map(np.array)


@settings(max_examples=60, deadline=None)
@given(WAYS)
def test_an_outline_is_closed_simple_and_counterclockwise(way: Array) -> None:
    ring = along(way, TYRE)
    assert np.array_equal(ring[0], ring[-1]) and len(ring) >= 4 and np.all(np.isfinite(ring))
    assert field_map._area(ring) > 0.0 and field_map._is_simple(ring[:-1])


def test_a_straight_way_has_the_axles_width() -> None:
    way = np.stack([np.linspace(0.0, 40.0, 6), np.zeros(6)], axis=1)
    track = replace_track(1.9)
    assert field_map._area(along(way, track)) == pytest.approx(40.0 * 1.9)
    assert field_map._area(along(way, replace_track(None))) == pytest.approx(80.0)


def replace_track(track_m: float | None) -> object:
    track = None if track_m is None else {"value": track_m, "sd": 0.01}
    return type(TYRE).model_validate({**TYRE.model_dump(), "track": track, "dual_track": None})


def test_the_other_axles_are_ahead_of_the_implements_in_line() -> None:
    one = driven(one_soil, 0)[0]
    path = window_of(MACHINE, ORIGIN_DEG, one).path
    tractor, implement = MACHINE.tractor, MACHINE.implement
    behind = tractor.c.value - tractor.b.value + implement.d.value + implement.e.value
    assert np.allclose(path[:, 1] - path[:, 2], [behind, 0.0], atol=1e-3)
    base = tractor.a.value + tractor.b.value
    assert math.isclose(float(path[0, 0, 0] - path[0, 1, 0]), base, abs_tol=1e-3)
