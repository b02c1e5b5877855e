"""A log from a table of measurements: each column goes out as a message of a virtual sensor.

So nothing else has to know of tables: all commands take such a log as any other. Rows are instants; a value
that is missing in a row is not sent there. Positions, speeds and rates are NMEA 2000 messages, the wheel
angle is the message of the machine file. What a message rounds away is below what sensors measure: 1e-16° of
a position, 0.01 m/s of a speed, 1e-4 rad of an angle.
"""

import csv
import math
import re
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Final, TypeGuard

import numpy as np
from numpy.typing import NDArray
from pyproj import Transformer

from tilth.logger.log.mcap_log import LogWriter, RunPart
from tilth.logger.log.whole_file import whole
from tilth.schemas.decode import claim, encode, frames_of
from tilth.schemas.flow import Frame, Mount, Word
from tilth.schemas.invocation import installing
from tilth.schemas.machine import Machine, Receiver
from tilth.schemas.machine_toml import MachineFile
from tilth.schemas.wheel_angle import compile_sensor

Array = NDArray[np.float64]

_DEGREES: Final = {"deg": 1.0, "°": 1.0}
_ANGLES: Final = {"rad": 1.0, "deg": math.pi / 180.0, "°": math.pi / 180.0}
_RATES: Final = {"rad/s": 1.0, "deg/s": math.pi / 180.0, "°/s": math.pi / 180.0}
_LENGTHS: Final = {"m": 1.0, "ft": 0.3048}
_SPEEDS: Final = {"m/s": 1.0, "km/h": 1.0 / 3.6, "mph": 0.44704}
_TIMES: Final = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
QUANTITIES: Final[Mapping[str, Mapping[str, float]]] = {
    "latitude": _DEGREES, "longitude": _DEGREES, "east": _LENGTHS, "north": _LENGTHS,
    "speed": _SPEEDS, "course": _ANGLES, "heading": _ANGLES, "yaw_rate": _RATES, "roll": _ANGLES,
}  # fmt: skip
"""Of a receiver, with factors to the unit that is sent. Angles clockwise from north, right side down."""
_COLUMN: Final = re.compile(r"^(-?)\s*(.+?)\s*\[([^\[\]]+)\]$")
_FIRST_SOURCE: Final = 70  # address of the first receiver that the file gives none


class ImportProblem(Exception):
    """One sentence that says what to do."""


@dataclass(frozen=True, slots=True)
class TableMap:
    """Which column is what, with the factor to its unit in a message; a minus turns the sign."""

    time: tuple[str, float]
    start: datetime  # of time 0
    wheel_angle: tuple[str, float]
    receivers: Mapping[Mount, Mapping[str, tuple[str, float]]]
    origin: tuple[float, float] | None  # latitude and longitude of east = north = 0, degrees


def read_map(path: Path) -> TableMap:
    """A map file, such as docs/logs.md shows. Raises ImportProblem, OSError."""
    try:
        given = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ImportProblem(f"{path}: {error}") from None
    unknown = set(given) - {"time", "start", "wheel_angle", "receiver", "origin"}
    if unknown:
        raise ImportProblem(
            f"{path}: {sorted(unknown)[0]} is no key; there are time, start, wheel_angle, receiver, origin"
        )
    for key in ("time", "wheel_angle", "receiver"):
        if key not in given:
            raise ImportProblem(f"{path}: {key} is missing: {_EXAMPLES[key]}")
    start = given.get("start", datetime(2000, 1, 1, tzinfo=UTC))
    if not isinstance(start, datetime):
        raise ImportProblem(f"{path}: start is the date and time of time 0, such as 2009-06-01T12:00:00Z")
    receivers: dict[Mount, dict[str, tuple[str, float]]] = {}
    if not isinstance(given["receiver"], dict) or not given["receiver"]:
        raise ImportProblem(f"{path}: receiver: {_EXAMPLES['receiver']}")
    for name, columns in given["receiver"].items():
        if name not in {mount.value for mount in Mount} or not isinstance(columns, dict):
            raise ImportProblem(
                f"{path}: receiver.{name}: a receiver is one of {', '.join(mount.value for mount in Mount)}"
            )
        receivers[Mount(name)] = {
            key: _column(path, f"receiver.{name}.{key}", text, QUANTITIES.get(key))
            for key, text in columns.items()
        }
        if not ({"latitude", "longitude"} <= set(columns) or {"east", "north"} <= set(columns)):
            raise ImportProblem(f"{path}: receiver.{name} needs latitude and longitude, or east and north")
    origin = given.get("origin")
    if any("east" in columns for columns in receivers.values()) and not _is_place(origin):
        raise ImportProblem(
            f"{path}: east and north need the place of their zero: origin = [LATITUDE, LONGITUDE], degrees"
        )
    return TableMap(
        _column(path, "time", given["time"], _TIMES),
        start if start.tzinfo else start.replace(tzinfo=UTC),
        _column(path, "wheel_angle", given["wheel_angle"], _ANGLES),
        receivers,
        (float(origin[0]), float(origin[1])) if _is_place(origin) else None,
    )


_EXAMPLES: Final = {
    "time": 'give its column and unit, such as time = "t [s]"',
    "wheel_angle": 'give its column and unit, positive to the right, such as wheel_angle = "delta [deg]"',
    "receiver": "give at least one: [receiver.tractor_front] with latitude and longitude, or east and north",
}


def _is_place(origin: object) -> TypeGuard[list[float]]:
    return (
        isinstance(origin, list) and len(origin) == 2 and all(isinstance(x, int | float) for x in origin)
        and abs(origin[0]) <= 90.0 and abs(origin[1]) <= 180.0
    )  # fmt: skip


def _column(path: Path, key: str, text: object, units: Mapping[str, float] | None) -> tuple[str, float]:
    if units is None:
        raise ImportProblem(f"{path}: {key} is nothing that is read; there are {', '.join(QUANTITIES)}")
    found = _COLUMN.match(text) if isinstance(text, str) else None
    if found is None:
        raise ImportProblem(f'{path}: {key}: give column and unit, such as "column [{next(iter(units))}]"')
    sign, name, unit = found.groups()
    if unit not in units:
        raise ImportProblem(f"{path}: {key}: the unit is one of {', '.join(units)}, not {unit}")
    return name, -units[unit] if sign else units[unit]


def read_table(path: Path) -> dict[str, Array]:
    """Columns by name, NaN where there is no number. Raises ImportProblem, OSError."""
    readers = {".csv": _csv, ".parquet": _parquet, ".mat": _mat}
    if path.suffix.lower() not in readers:
        raise ImportProblem(f"{path}: give a table that ends in {', '.join(readers)}")
    try:
        columns = readers[path.suffix.lower()](path)
    except (UnicodeDecodeError, csv.Error) as error:
        raise ImportProblem(f"{path}: no table in UTF-8: {error}") from None
    if not columns or not max(len(column) for column in columns.values()):
        raise ImportProblem(f"{path}: no rows are in it")
    return columns


def _csv(path: Path) -> dict[str, Array]:
    with path.open(encoding="utf-8-sig", newline="") as stream:
        head = stream.readline()
        stream.seek(0)
        rows = csv.DictReader(stream, delimiter=max(",;\t", key=head.count))
        names = [name.strip() for name in rows.fieldnames or []]
        rows.fieldnames = names
        found: dict[str, list[float]] = {name: [] for name in names}
        comma = ";" in head  # then numbers may have a decimal comma
        for row in rows:
            for name in names:
                found[name].append(_number(row[name] or "", comma))
    return {name: np.array(column) for name, column in found.items()}


def _number(text: str, comma: bool) -> float:
    try:
        return float(text.replace(",", ".") if comma else text)
    except ValueError:
        return math.nan


def _parquet(path: Path) -> dict[str, Array]:
    try:
        from pyarrow import parquet
    except ImportError:
        raise ImportProblem(f"{path}: this needs one package more: {installing('parquet')}") from None
    try:
        table = parquet.read_table(path)
    except (ValueError, OSError) as error:
        raise ImportProblem(f"{path}: {error}") from None
    return {
        name: np.asarray(table[name].to_numpy(zero_copy_only=False), np.float64)
        for name in table.column_names
        if table[name].type.num_fields == 0
        and str(table[name].type).startswith(("int", "uint", "float", "double"))
    }


def _mat(path: Path) -> dict[str, Array]:
    from scipy.io import loadmat

    try:
        found = loadmat(path)
    except NotImplementedError:
        raise ImportProblem(f"{path}: this is MATLAB's format 7.3; save it with -v7") from None
    except OSError:
        raise
    except Exception as error:  # scipy names no kind: whatever it is, it cannot be read
        raise ImportProblem(f"{path}: no MATLAB file: {error}") from None
    return {
        name: np.asarray(value, np.float64).ravel()
        for name, value in found.items()
        if isinstance(value, np.ndarray) and value.dtype.kind in "iuf" and value.size > 1
    }


@dataclass(frozen=True, slots=True)
class Imported:
    """What was written."""

    rows: int
    seconds: float
    frames: int


def import_table(table: Path, given: TableMap, machine_file: MachineFile, out: Path) -> Imported:
    """Write a log, which must not exist. Raises ImportProblem, OSError; then no log is left."""
    columns, machine = read_table(table), machine_file.machine
    mounts = {receiver.mount for receiver in machine.receiver}
    for mount in given.receivers:
        if mount not in mounts:
            raise ImportProblem(
                f"the machine file has no receiver {mount.value}: give it one, with its position"
            )
    _checked(table, columns, given)
    time = _scaled(table, columns, given.time)
    use = np.isfinite(time)
    if not use.any() or (np.diff(time[use]) <= 0.0).any():
        raise ImportProblem(f"{table}: the column {given.time[0]} must grow from row to row")
    start_ns = int(given.start.timestamp()) * 1_000_000_000 + given.start.microsecond * 1000
    frames = sorted(_frames(table, columns, given, machine, time, start_ns), key=lambda one: one.t_ns)
    run = RunPart(f"imported-{table.stem}", 1, start_ns, note=f"imported from {table.name}")
    with whole(out) as part, closing(LogWriter(part, machine_file, run)) as writer:
        for frame in frames:
            writer.frame(frame)
    return Imported(int(use.sum()), float(time[use][-1] - time[use][0]), len(frames))


def _scaled(table: Path, columns: Mapping[str, Array], column: tuple[str, float]) -> Array:
    name, factor = column
    if name not in columns:
        raise ImportProblem(f"{table}: there is no column {name}; there are {', '.join(columns)}")
    return columns[name] * factor


def _checked(table: Path, columns: Mapping[str, Array], given: TableMap) -> None:
    """Raises ImportProblem for a column that is missing, or longer or shorter than the time."""
    rows = len(_scaled(table, columns, given.time))
    for column in (given.wheel_angle, *(one for of in given.receivers.values() for one in of.values())):
        if len(_scaled(table, columns, column)) != rows:
            raise ImportProblem(f"{table}: the columns {given.time[0]} and {column[0]} differ in length")


def _frames(
    table: Path, columns: Mapping[str, Array], given: TableMap, machine: Machine, time: Array, start_ns: int
) -> Iterator[Frame]:
    sensor, bus = compile_sensor(machine), machine.wheel_angle.bus
    angles, delay_s = _scaled(table, columns, given.wheel_angle), machine.wheel_angle.delay
    for at_s, angle in zip(time.tolist(), angles.tolist(), strict=True):
        if math.isfinite(at_s) and math.isfinite(angle):
            t_ns = start_ns + round((at_s + delay_s) * 1e9)
            try:
                data = sensor.data(angle)
            except ValueError as error:
                raise ImportProblem(f"{table}: at {at_s:g} s: {error}") from None
            yield Frame(t_ns, t_ns, bus, sensor.can_id, sensor.extended, False, data)
    for k, receiver in enumerate(machine.receiver):
        if receiver.mount in given.receivers:
            source = _FIRST_SOURCE + k if receiver.source is None else receiver.source
            found = {
                key: _scaled(table, columns, column)
                for key, column in given.receivers[receiver.mount].items()
            }
            yield from _of_a_receiver(receiver, source, _placed(found, given.origin), time, start_ns)


def _placed(found: dict[str, Array], origin: tuple[float, float] | None) -> dict[str, Array]:
    """With latitude and longitude instead of east and north."""
    if "east" not in found or origin is None:
        return found
    plane = f"+proj=aeqd +lat_0={origin[0]!r} +lon_0={origin[1]!r} +ellps=WGS84"
    there = Transformer.from_crs(plane, "EPSG:4326", always_xy=True)
    longitude, latitude = there.transform(found.pop("east"), found.pop("north"))
    return {**found, "latitude": np.asarray(latitude), "longitude": np.asarray(longitude)}


def _of_a_receiver(
    receiver: Receiver, source: int, found: Mapping[str, Array], time: Array, start_ns: int
) -> Iterator[Frame]:
    def sent(t_ns: int, pgn: int, payload: bytes, sequence: int = 0) -> Iterator[Frame]:
        for can_id, data in frames_of(pgn, payload, source, sequence=sequence):
            yield Frame(t_ns, t_ns, receiver.bus, can_id, True, False, data.ljust(8, b"\xff"))

    if receiver.name is not None:
        yield from sent(
            start_ns + round(time[np.isfinite(time)][0] * 1e9) - 1_000_000, 60928, claim(receiver.name)
        )
    for k, at_s in enumerate(time.tolist()):
        now = {key: float(column[k]) for key, column in found.items() if math.isfinite(column[k])}
        if not math.isfinite(at_s):
            continue
        epoch_ns = start_ns + round(at_s * 1e9)
        t_ns, sid = epoch_ns + round(receiver.latency.value * 1e9), k % 253
        if {"latitude", "longitude"} <= set(now):
            place = {"latitude_deg": now["latitude"], "longitude_deg": now["longitude"]}
            position: dict[str, Word] = {
                "fix": "rtk_fixed",
                "utc_ns": epoch_ns,
                "satellites": 19,
                "hdop": 0.7,
                **place,
            }
            yield from sent(t_ns, 129029, encode(129029, position, sid=sid), k % 8)
        if {"speed", "course"} <= set(now):
            course = now["course"] % math.tau
            motion: dict[str, Word] = {
                "speed_mps": now["speed"],
                "course_rad": course,
                "heading_reference": "true",
            }
            yield from sent(t_ns, 129026, encode(129026, motion, sid=sid))
        if "heading" in now:
            heading: dict[str, Word] = {"heading_rad": now["heading"] % math.tau, "heading_reference": "true"}
            yield from sent(t_ns, 127250, encode(127250, heading, sid=sid))
        if "yaw_rate" in now:
            yield from sent(t_ns, 127251, encode(127251, {"yaw_rate_radps": now["yaw_rate"]}, sid=sid))
        if "roll" in now:
            yield from sent(t_ns, 127257, encode(127257, {"roll_rad": now["roll"]}, sid=sid))
