"""What is exported: rows of named columns, flat and of few kinds, so that each format says the same.

A list of numbers becomes a column each (`bound_C_af`), a NAME of a device 16 hexadecimal digits: as a number
it does not fit into what spreadsheets and data frames reckon with.
"""

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from tilth.analysis.runs.reading import RunClock
from tilth.analysis.runs.table import Table
from tilth.schemas.flow import PARAMETERS, Status
from tilth.schemas.frame_columns import FrameColumns

DOUBLE, WHOLE, TRUTH, TEXT, INSTANT, DATA = "double", "whole", "truth", "text", "instant", "bytes"
"""Kinds: float64, NaN where absent; int64; bool; texts; datetime64[us] of UTC; up to 8 bytes."""
WORLD, WGS84 = "W", "WGS 84"
FRAMES: Final = {
    WORLD: "world: x north, y east on the tangent plane at origin_latitude_deg, origin_longitude_deg; "
    "headings and courses clockwise from true north",
    "T": "tractor: origin its centre of gravity, x forward, y right, z down",
    "I": "implement: origin its centre of gravity, x forward, y right, z down",
    WGS84: "latitude, longitude and ellipsoidal height",
}
"""The same as docs/notation.md, for who has the file alone."""
_BODIES: Final = {"tractor": "T", "implement": "I"}
_IN_WORLD: Final = re.compile(r"(tractor_|implement_)?(x|y|sd_position|(sd_)?heading|course)(_|$)")
_ON_EARTH: Final = re.compile(r"(origin_)?(latitude|longitude|altitude)_")
_OF_BODY: Final = re.compile(r"(tractor|implement)_.*(velocity|yaw_rate|roll|pitch)")
_WORDS: Final = ", ".join(status.name.lower() for status in Status)
_STATUS: Final = re.compile(rf"({'|'.join(PARAMETERS)})_status")

Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class ExportColumn:
    """One column of a file."""

    name: str
    kind: str
    unit: str = ""  # SI, as in docs/notation.md
    frame: str = ""  # a row of FRAMES
    meaning: str = ""  # of codes
    optional: bool = False  # whether a whole number, a truth or a text of it may be absent


@dataclass(frozen=True, slots=True)
class ExportRows:
    """n rows. values: a [n] array each, DATA [n, 8]. absent: which of them are not there, [n] or [n, 8];
    where it is None all are there, or NaN says so."""

    columns: tuple[ExportColumn, ...]
    values: tuple[NDArray[Any], ...]
    absent: tuple[Mask | None, ...]

    def __len__(self) -> int:
        return len(self.values[0])

    def named(self, name: str) -> NDArray[Any]:
        """The values of a column. Raises StopIteration."""
        return next(v for c, v in zip(self.columns, self.values, strict=True) if c.name == name)

    def take(self, chosen: NDArray[Any]) -> "ExportRows":
        """The rows of a mask or of numbers of rows."""
        return ExportRows(
            self.columns,
            tuple(values[chosen] for values in self.values),
            tuple(None if absent is None else absent[chosen] for absent in self.absent),
        )

    def of_run(self, run: str) -> "ExportRows":
        """With the name of the run in each row: rows of several runs in one table stay apart."""
        names = np.full(len(self), run, object)
        column = ExportColumn("of_run", TEXT, meaning="folder of the run")
        return ExportRows((*self.columns, column), (*self.values, names), (*self.absent, None))

    def filled(self) -> frozenset[str]:
        """Names of columns that hold anything."""
        found = set()
        for column, values, absent in zip(self.columns, self.values, self.absent, strict=True):
            there = np.ones(len(self), np.bool_) if absent is None else ~absent
            if column.kind == DOUBLE:
                there &= np.isfinite(values) | np.isinf(values)
            elif column.kind == INSTANT:
                there &= ~np.isnat(values)
            elif column.kind == TEXT:
                there &= values.astype(np.bool_)
            if there.any():
                found.add(column.name)
        return frozenset(found)

    def but(self, names: frozenset[str]) -> "ExportRows":
        """Without these columns."""
        kept = [k for k, column in enumerate(self.columns) if column.name not in names]
        return ExportRows(
            tuple(self.columns[k] for k in kept),
            tuple(self.values[k] for k in kept),
            tuple(self.absent[k] for k in kept),
        )


def followed(parts: Sequence[ExportRows]) -> ExportRows:
    """Rows of the same columns, one part after the other."""
    first = parts[0]
    if len(parts) == 1:
        return first
    masks = [
        None if column[0] is None else np.concatenate([mask for mask in column if mask is not None])
        for column in zip(*(part.absent for part in parts), strict=True)
    ]
    values = [np.concatenate(column) for column in zip(*(part.values for part in parts), strict=True)]
    return ExportRows(first.columns, tuple(values), tuple(masks))


def rows_of(table: Table) -> ExportRows:
    """The rows of a channel's table."""
    found = [made for name in table for made in _columns(table, name)]
    columns, values, absent = zip(*found, strict=True)
    return ExportRows(columns, values, absent)


def rows_of_frames(part: FrameColumns, buses: Sequence[str], clock: RunClock) -> ExportRows:
    """Raw frames: `id` is the identifier of 11 or, if `extended`, 29 bits."""
    t_s = (part.t_ns - clock.start_ns) / 1e9
    utc_s = (
        np.full(len(t_s), np.nan) if clock.utc_minus_ns is None else (part.t_ns + clock.utc_minus_ns) / 1e9
    )
    columns = (
        *_TIMES, ExportColumn("rx_s", DOUBLE, "s"), ExportColumn("bus", TEXT), ExportColumn("id", WHOLE),
        ExportColumn("extended", TRUTH), ExportColumn("error", TRUTH), ExportColumn("length", WHOLE, "byte"),
        ExportColumn("data", DATA),
    )  # fmt: skip
    values = (
        t_s, utc_s, instants(utc_s), (part.rx_ns - clock.start_ns) / 1e9,
        np.array(buses, object)[part.bus] if buses else np.zeros(0, object), part.can_id.astype(np.int64),
        part.extended, part.error, part.length.astype(np.int64), part.data,
    )  # fmt: skip
    behind = np.arange(8) >= part.length[:, None]
    return ExportRows(columns, values, (*(None,) * (len(columns) - 1), behind))


_TIMES: Final = (
    ExportColumn("t_s", DOUBLE, "s", meaning="since the run began"),
    ExportColumn("utc_s", DOUBLE, "s", meaning="UTC, since 1970"),
    ExportColumn("utc", INSTANT, meaning="UTC"),
)


def times(t_s: NDArray[np.float64], clock: RunClock) -> ExportRows:
    """The three columns of time, of seconds since the run began."""
    ahead = clock.utc_minus_ns
    utc_s = np.full(len(t_s), np.nan) if ahead is None else (clock.start_ns + ahead) / 1e9 + t_s
    return ExportRows(_TIMES, (t_s, utc_s, instants(utc_s)), (None,) * len(_TIMES))


def instants(utc_s: NDArray[np.float64]) -> NDArray[np.datetime64]:
    """Seconds since 1970 to microseconds; NaT where they are not known."""
    known = np.isfinite(utc_s)
    found = np.full(len(utc_s), "NaT", "datetime64[us]")
    found[known] = np.rint(utc_s[known] * 1e6).astype(np.int64).view("datetime64[us]")
    return found


_Made = tuple[ExportColumn, NDArray[Any], Mask | None]


def _columns(table: Table, name: str) -> Iterator[_Made]:
    values, unit, absent = table[name], table.units.get(name, ""), table.missing.get(name)
    column = ExportColumn(name, DOUBLE, unit, _frame(name), optional=absent is not None)
    if values.ndim > 1:
        for k, label in enumerate(_labels(values.shape[1])):
            yield replace(column, name=f"{name}_{label}"), values[:, k], None
    elif name == "utc_s":
        yield _TIMES[1], values, None
        yield _TIMES[2], instants(values), None
    elif name in ("t_s", "rx_s"):  # to the nanosecond that they were
        yield replace(column, meaning="since the run began"), np.round(values, 9), None
    elif values.dtype == np.float64:
        yield column, values, None
    elif values.dtype == np.uint64:
        digits = _each(lambda number: f"{number:016X}", values)
        if absent is not None:
            digits[absent] = ""
        yield replace(column, kind=TEXT, meaning="hexadecimal"), digits, absent
    elif values.dtype == object:
        yield replace(column, kind=TEXT), values, None
    elif _STATUS.fullmatch(name):
        yield replace(column, kind=TEXT, meaning=_WORDS), _each(_status_word, values), absent
    else:
        yield replace(column, kind=TRUTH if values.dtype == np.bool_ else WHOLE), values, absent


def _status_word(code: int) -> str:
    """Such as: estimated; the number where this version knows none."""
    return Status(code).name.lower() if code in {int(status) for status in Status} else str(code)


def _each(text: Callable[[Any], str], values: NDArray[Any]) -> NDArray[Any]:
    """Texts of values that often repeat."""
    found, codes = np.unique(values, return_inverse=True)
    return np.array([text(value) for value in found.tolist()] or [""], object)[codes]


def _labels(width: int) -> list[str]:
    """Of the numbers of a list: the six parameters, or each with each."""
    one: list[str] = list(PARAMETERS)
    return one if width == len(one) else [f"{a}_{b}" for a in one for b in one]


def _frame(name: str) -> str:
    if _ON_EARTH.match(name):
        return WGS84
    if _IN_WORLD.match(name):
        return WORLD
    found = _OF_BODY.match(name)
    return _BODIES[found[1]] if found else ""
