"""A map as files that other software opens: GeoJSON (RFC 7946) and GeoParquet 1.1, both in OGC:CRS84."""

import json
import struct
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, Final

import numpy as np
from pyproj import CRS

from tilth.analysis.season.field_map import STIFFNESSES, MapFeature, MappedField
from tilth.analysis.season.kept_table import RigStretches
from tilth.analysis.season.table import require_parquet
from tilth.estimator.methods import place
from tilth.estimator.methods.estimators import rows_for
from tilth.estimator.warm_start import save_learned
from tilth.logger import warm_start_file
from tilth.logger.log import whole_file
from tilth.logger.log.software import software
from tilth.schemas.machine import Machine

DECIMALS: Final = 7  # of a degree: 11 mm
MEANING: Final = {
    "values": "cornering stiffness of a whole axle: C_af of the front axle, C_ar of the rear axle, C_ai of "
    "the implement's axle. The median, N/rad in files, and the standard deviation of its natural logarithm, "
    "_log_sd in files",
    "places": "a stretch is a polygon along the path of the implement's axle, as wide as its track; its "
    "values are those of each axle on its own path. A cell's values are those of each axle in that cell, "
    "whatever the heading",
    "time": "the field as it was in its last run; knowledge from earlier runs has faded by then, as it does "
    "in the cab",
    "informed": "share of the variance of the machine file's prior that a stretch alone removes, _informed "
    "in files",
    "left empty": "cells of which too little is known, or that are further from any path than soil is alike",
}
_TEXTS: Final = (
    "kind", *(f"{name}_{what}" for name in STIFFNESSES for what in ("status", "reason")),
    "begin_utc", "end_utc", "run", "method", "log", "logs_sha256",
)  # fmt: skip
_NUMBERS: Final = tuple(f"{name}{what}" for name in STIFFNESSES for what in ("", "_log_sd", "_informed"))


def facts_of(rig: RigStretches, cell_m: float) -> dict[str, Any]:
    """What holds for the whole of a map."""
    said = software()
    return {
        "machine": rig.machine_name, "implement": rig.implement, "cell_m": cell_m, **MEANING,
        "version": said["version"], "estimator": said["estimator"],
    }  # fmt: skip


def write_prior(path: Path, machine: Machine, of_field: MappedField) -> None:
    """What the rig's next run on a field begins from ([estimation] field_map): the memory by place, as a run
    keeps it. A new file, or nothing. Raises OSError."""
    estimators = {row.method: row.initial(machine) for row in rows_for(machine)}
    memory, windows = estimators[place.METHOD], list(of_field.windows)
    while len(windows) > place.PLACE.most_windows:
        windows = place.merged_nearest(windows)
    memory.windows, memory.origin_deg = windows, of_field.origin_deg
    memory.informed_ns = max(one.begin_ns for one in windows)
    learned = save_learned(machine, estimators, memory.informed_ns)
    whole_file.write(path, warm_start_file.text_of(machine, learned, memory.informed_ns).encode())


def _bounds(features: Sequence[MapFeature]) -> list[float]:
    """West, south, east, north."""
    places = np.concatenate([one.ring for one in features])
    return [*places.min(axis=0).tolist(), *places.max(axis=0).tolist()]


def write_geojson(path: Path, features: Sequence[MapFeature], facts: Mapping[str, Any]) -> None:
    """A new file, or nothing. Raises OSError."""

    def feature(one: MapFeature) -> dict[str, Any]:
        ring = np.round(one.ring, DECIMALS).tolist()
        properties = {"kind": one.kind, "field": one.field, **one.properties}
        return {
            "type": "Feature",
            "geometry": {"type": "Polygon", "coordinates": [ring]},
            "properties": properties,
        }

    whole = {
        "type": "FeatureCollection",
        "bbox": [round(one, DECIMALS) for one in _bounds(features)],
        "tilth": facts,
        "features": [feature(one) for one in features],
    }
    text = json.dumps(whole, allow_nan=False, separators=(",", ":"))  # escaped: any name of a file is text
    whole_file.write(path, f"{text}\n".encode(), replace=False)


def write_geoparquet(path: Path, features: Sequence[MapFeature], facts: Mapping[str, Any]) -> None:
    """A new file, or nothing. Raises NoParquet, OSError."""
    arrow, parquet = require_parquet(), import_module("pyarrow.parquet")
    geometry = {
        "encoding": "WKB", "geometry_types": ["Polygon"], "crs": CRS("OGC:CRS84").to_json_dict(),
        "orientation": "counterclockwise", "edges": "planar", "bbox": _bounds(features),
    }  # fmt: skip
    geo = {"version": "1.1.0", "primary_column": "geometry", "columns": {"geometry": geometry}}
    columns = {
        "field": arrow.array([one.field for one in features], arrow.int32()),
        **{name: _column(features, name, arrow.string()) for name in _TEXTS},
        **{name: _column(features, name, arrow.float64()) for name in _NUMBERS},
        "geometry": arrow.array([_wkb(one) for one in features], arrow.binary()),
    }
    metadata = {"geo": json.dumps(geo), "tilth": json.dumps(facts)}
    table = arrow.table(columns).replace_schema_metadata(metadata)
    with whole_file.whole(path) as part:
        parquet.write_table(table, part, compression="zstd")


def _column(features: Sequence[MapFeature], name: str, kind: Any) -> Any:
    arrow = import_module("pyarrow")
    return arrow.array([one.kind if name == "kind" else one.properties.get(name) for one in features], kind)


def _wkb(one: MapFeature) -> bytes:
    """A polygon of one ring, little-endian."""
    return struct.pack("<BIII", 1, 3, 1, len(one.ring)) + one.ring.astype("<f8").tobytes()
