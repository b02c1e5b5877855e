"""Maps as files: GeoJSON beside RFC 7946, and GeoParquet 1.1 read back."""

import csv
import json
import re
import shutil
import struct
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from logs import MACHINE
from soil_drives import ORIGIN_DEG, degrees_apart_m, driven, two_soils

from tilth.analysis.season.field_map import STIFFNESSES, MapFeature, mapped
from tilth.analysis.season.kept_table import RigStretches
from tilth.analysis.season.map_files import facts_of, write_geojson, write_geoparquet

RIG = RigStretches("tractor", "drill", MACHINE, (), ())
FACTS = facts_of(RIG, 10.0)


@pytest.fixture(scope="module")
def features() -> tuple[MapFeature, ...]:
    return mapped(1, MACHINE, driven(two_soils, 0)[:20]).features


def doubled_area(ring: Any) -> float:
    x, y = np.array(ring).T
    return float(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]))


def test_geojson_is_closed_counterclockwise_and_within_its_bounds(
    features: tuple[MapFeature, ...], tmp_path: Path
) -> None:
    write_geojson(tmp_path / "m.geojson", features, FACTS)
    whole = json.loads((tmp_path / "m.geojson").read_bytes())
    assert whole["type"] == "FeatureCollection" and "crs" not in whole
    west, south, east, north = whole["bbox"]
    assert west < ORIGIN_DEG[1] < east and south < ORIGIN_DEG[0] < north
    assert {one["properties"]["kind"] for one in whole["features"]} == {"stretch", "cell"}
    for one, made in zip(whole["features"], features, strict=True):
        assert one["type"] == "Feature" and one["geometry"]["type"] == "Polygon"
        (ring,) = one["geometry"]["coordinates"]
        assert ring[0] == ring[-1] and len(ring) >= 4 and doubled_area(ring) > 0.0
        assert all(west <= x <= east and south <= y <= north for x, y in ring)
        assert all(round(x, 7) == x and round(y, 7) == y for x, y in ring)
        assert degrees_apart_m(np.array(ring)[:, ::-1], made.ring[:, ::-1]) < 0.01
    assert whole["tilth"]["machine"] == "tractor" and "implement's axle" in whole["tilth"]["places"]


def test_geoparquet_says_where_it_is_and_reads_back(features: tuple[MapFeature, ...], tmp_path: Path) -> None:
    pq = pytest.importorskip("pyarrow.parquet")
    write_geoparquet(tmp_path / "m.parquet", features, FACTS)
    table = pq.read_table(tmp_path / "m.parquet")
    geo = json.loads(table.schema.metadata[b"geo"])
    assert geo["version"] == "1.1.0" and geo["primary_column"] == "geometry"
    column = geo["columns"]["geometry"]
    assert column["encoding"] == "WKB" and column["geometry_types"] == ["Polygon"]
    assert column["crs"]["id"] == {"authority": "OGC", "code": "CRS84"}
    assert column["orientation"] == "counterclockwise"
    assert not table.schema.field("geometry").metadata  # an extension type here hides the CRS from some
    for wkb, made in zip(table["geometry"].to_pylist(), features, strict=True):
        assert struct.unpack_from("<BIII", wkb) == (1, 3, 1, len(made.ring))
        np.testing.assert_array_equal(np.frombuffer(wkb, "<f8", offset=13).reshape(-1, 2), made.ring)
    rows = table.to_pylist()
    assert [row["C_af"] for row in rows] == [one.properties["C_af"] for one in features]
    assert rows[0]["run"] == "day0" and rows[-1]["run"] is None and rows[-1]["kind"] == "cell"
    assert json.loads(table.schema.metadata[b"tilth"]) == FACTS


@pytest.mark.skipif(shutil.which("ogr2ogr") is None, reason="needs GDAL's programs: apt install gdal-bin")
def test_gdal_which_qgis_opens_files_with_has_all_of_it_at_its_place(
    features: tuple[MapFeature, ...], tmp_path: Path
) -> None:
    """GDAL of Debian has no driver for Parquet."""
    write_geojson(tmp_path / "m.geojson", features, FACTS)
    about = subprocess.run(
        ["ogrinfo", "-ro", "-so", "-al", "m.geojson"],
        cwd=tmp_path,
        check=True,
        capture_output=True,
        text=True,
    )
    assert f"Feature Count: {len(features)}" in about.stdout and "Geometry: Polygon" in about.stdout
    assert 'ID["EPSG",4326]' in about.stdout and not about.stderr
    assert re.findall(r"^Layer name: (.*)$", about.stdout, re.M) == ["m"]
    kinds = dict(re.findall(r"^(\w+): (\w+) \(", about.stdout, re.M))
    assert kinds["field"] == "Integer" and {kinds["kind"], kinds["run"], kinds["C_af_status"]} == {"String"}
    assert {kinds[f"{name}{what}"] for name in STIFFNESSES for what in ("", "_log_sd")} == {"Real"}
    assert {kinds["begin_utc"], kinds["end_utc"]} == {"DateTime"}
    made = ["-f", "CSV", "-lco", "GEOMETRY=AS_WKT", "m.csv", "m.geojson"]
    subprocess.run(["ogr2ogr", *made], cwd=tmp_path, check=True, capture_output=True)
    with (tmp_path / "m.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    for row, one in zip(rows, features, strict=True):
        ring = np.array(re.findall(r"[-\d.]+", row["WKT"]), dtype=np.float64).reshape(-1, 2)
        assert degrees_apart_m(ring[:, ::-1], one.ring[:, ::-1]) < 0.01
        stiffness = one.properties["C_af"]
        assert row["C_af"] == "" if stiffness is None else float(row["C_af"]) == pytest.approx(stiffness)
        assert row["kind"] == one.kind


def test_what_is_there_stays(features: tuple[MapFeature, ...], tmp_path: Path) -> None:
    (tmp_path / "m.geojson").write_text("mine")
    with pytest.raises(FileExistsError):
        write_geojson(tmp_path / "m.geojson", features, FACTS)
    assert (tmp_path / "m.geojson").read_text() == "mine"
