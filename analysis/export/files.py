"""The files that rows are written to: CSV and Parquet as they come, MAT when all are there.

Parquet needs pyarrow, which is an extra; it is imported when it is used.
"""

import contextlib
import importlib
import importlib.util
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from tilth.analysis.export.columns import (
    DATA,
    DOUBLE,
    INSTANT,
    TEXT,
    TRUTH,
    WHOLE,
    ExportColumn,
    ExportRows,
    Mask,
)
from tilth.schemas.invocation import installing

Facts = Mapping[str, object]
ROW_GROUP_BYTES: Final = 4 << 20  # at least
COLUMN_BYTES: Final = 1 << 16  # of a column, at least: each in each group costs a kilobyte until the end
MAT_BYTES: Final = 2 << 30  # of a variable; the format can say 4 GiB, and readers stop at 2
_ACTING: Final = (*"=+-@＝＋－＠\t\r\n", "'")  # with the wide forms of East Asian spreadsheets
_MAT_RESERVED: Final = ("units", "texts", "meta")
_MAT_WIDTH: Final = {DOUBLE: 8, WHOLE: 8, TRUTH: 8, TEXT: 4, DATA: 8, INSTANT: 0}  # bytes of a value


class ExportError(Exception):
    """It cannot be exported like this; one sentence that says what to do."""


class TableFile(Protocol):
    """A file that rows are written to. Every method may raise OSError."""

    def write(self, rows: ExportRows) -> None:
        """Add rows. Raises ExportError."""

    def close(self) -> None:
        """After the last row."""

    def abandon(self) -> None:
        """Instead of `close`, where it will be removed. Raises nothing."""


class CsvFile:
    """RFC 4180 in UTF-8: a header, CRLF, points in numbers, an empty cell for what is absent.

    Numbers have no exponent: PlotJuggler takes a column whose first number has one for texts.
    A text that a spreadsheet would take for a formula has an apostrophe before it, and so has one that begins
    with an apostrophe: to read a text as it was, take one away.
    """

    def __init__(self, path: Path, columns: Sequence[ExportColumn], facts: Facts) -> None:
        self._file = path.open("w", encoding="utf-8", newline="")
        self._line([column.name for column in columns])

    def _line(self, cells: Sequence[str]) -> None:
        self._file.write(",".join(map(_quoted, cells)) + "\r\n")

    def write(self, rows: ExportRows) -> None:
        cells = [
            _CELLS[column.kind](values, absent)
            for column, values, absent in zip(rows.columns, rows.values, rows.absent, strict=True)
        ]
        for line in map(",".join, zip(*cells, strict=True)):
            self._file.write(line + "\r\n")

    def close(self) -> None:
        self._file.close()

    def abandon(self) -> None:
        with contextlib.suppress(OSError):
            self._file.close()


def _quoted(text: str) -> str:
    text = f"'{text}" if text.startswith(_ACTING) else text
    return '"' + text.replace('"', '""') + '"' if any(mark in text for mark in '",\r\n') else text


def _doubles(values: NDArray[Any], absent: Mask | None) -> list[str]:
    return ["" if value != value else _decimal(value) for value in values.tolist()]


def _decimal(value: float) -> str:
    """The shortest that is read back to the same number."""
    text = repr(value)
    return np.format_float_positional(value, trim="0") if "e" in text else text


def _wholes(values: NDArray[Any], absent: Mask | None) -> list[str]:
    return _but(absent, list(map(str, values.tolist())))


def _truths(values: NDArray[Any], absent: Mask | None) -> list[str]:
    return _but(absent, ["true" if value else "false" for value in values.tolist()])


def _texts(values: NDArray[Any], absent: Mask | None) -> list[str]:
    return _but(absent, list(map(_quoted, values.tolist())))


def _utc(values: NDArray[Any], absent: Mask | None) -> list[str]:
    cells = np.char.add(np.datetime_as_string(values), "Z").tolist()
    return _but(np.isnat(values), cells)


def _hexadecimal(values: NDArray[Any], absent: Mask | None) -> list[str]:
    assert absent is not None
    ends = 2 * np.count_nonzero(~absent, axis=1)
    digits = values.tobytes().hex().upper()
    return [digits[16 * k : 16 * k + end] for k, end in enumerate(ends.tolist())]


def _but(absent: Mask | None, cells: list[str]) -> list[str]:
    if absent is not None:
        for k in np.flatnonzero(absent).tolist():
            cells[k] = ""
    return cells


_CELLS: Final[dict[str, Callable[[NDArray[Any], Mask | None], list[str]]]] = {
    DOUBLE: _doubles, WHOLE: _wholes, TRUTH: _truths, TEXT: _texts, INSTANT: _utc, DATA: _hexadecimal,
}  # fmt: skip


class ParquetFile:
    """Row groups of some megabytes, written as they are full; what is absent is null. What is known of the
    export stands in the schema's metadata under `tilth`, as JSON; unit and frame in the columns'."""

    def __init__(self, path: Path, columns: Sequence[ExportColumn], facts: Facts) -> None:
        self._arrow = importlib.import_module("pyarrow")
        fields = [
            self._arrow.field(column.name, self._type(column.kind), metadata=_field_metadata(column))
            for column in columns
        ]
        self._schema = self._arrow.schema(fields, metadata={"tilth": json.dumps(facts)})
        self._enough = max(ROW_GROUP_BYTES, COLUMN_BYTES * len(columns))
        self._waiting: list[Any] = []
        self._bytes = 0
        writer = importlib.import_module("pyarrow.parquet").ParquetWriter
        self._writer = writer(str(path), self._schema, compression="zstd", compression_level=1)

    def _type(self, kind: str) -> Any:
        arrow = self._arrow
        return {
            DOUBLE: arrow.float64(), WHOLE: arrow.int64(), TRUTH: arrow.bool_(), TEXT: arrow.string(),
            INSTANT: arrow.timestamp("us", tz="UTC"), DATA: arrow.binary(),
        }[kind]  # fmt: skip

    def write(self, rows: ExportRows) -> None:
        arrays = [
            self._array(column.kind, values, absent)
            for column, values, absent in zip(rows.columns, rows.values, rows.absent, strict=True)
        ]
        self._waiting.append(self._arrow.Table.from_arrays(arrays, schema=self._schema))
        self._bytes += self._waiting[-1].nbytes
        if self._bytes >= self._enough:
            self._flush()

    def _array(self, kind: str, values: NDArray[Any], absent: Mask | None) -> Any:
        arrow = self._arrow
        if kind == DATA:
            assert absent is not None
            ends = np.concatenate([[0], np.cumsum(np.count_nonzero(~absent, axis=1))]).astype(np.int32)
            buffers = [None, arrow.py_buffer(ends), arrow.py_buffer(values[~absent])]
            return arrow.Array.from_buffers(arrow.binary(), len(values), buffers)
        return arrow.array(values, self._type(kind), mask=absent, from_pandas=kind == DOUBLE)

    def _flush(self) -> None:
        if self._waiting:
            self._writer.write_table(self._arrow.concat_tables(self._waiting).combine_chunks())
        self._waiting, self._bytes = [], 0

    def close(self) -> None:
        self._flush()
        self._writer.close()

    def abandon(self) -> None:
        with contextlib.suppress(OSError):
            self._writer.close()


def _field_metadata(column: ExportColumn) -> dict[str, str] | None:
    known = {"unit": column.unit, "frame": column.frame, "meaning": column.meaning}
    return {key: value for key, value in known.items() if value} or None


class MatFile:
    """MAT 5: a variable [n, 1] for each column. The format needs whole ones: they are kept until the end.

    Whole numbers and truths that can be absent are doubles with NaN. A text is a number from 1 up into the
    cells of `texts.<column>`, 0 where it is empty. `data` is [n, 8]. `units` and `meta` say the rest.
    """

    def __init__(self, path: Path, columns: Sequence[ExportColumn], facts: Facts) -> None:
        self._path, self._facts = path, facts
        self._columns = [column for column in columns if column.kind != INSTANT]
        assert not {column.name for column in columns} & set(_MAT_RESERVED)
        self._parts: dict[str, list[NDArray[Any]]] = {column.name: [] for column in self._columns}
        self._texts: dict[str, dict[str, int]] = {
            column.name: {} for column in self._columns if column.kind == TEXT
        }
        self._rows = 0

    def write(self, rows: ExportRows) -> None:
        self._rows += len(rows)
        for column, values, absent in zip(rows.columns, rows.values, rows.absent, strict=True):
            if self._rows * _MAT_WIDTH[column.kind] >= MAT_BYTES:
                raise ExportError(
                    f"{self._path.name}: {column.name} would have {self._rows} rows and more, which is too "
                    "large for MAT; choose less with --channels, --from and --until, or use --to parquet"
                )
            if column.kind != INSTANT:
                self._parts[column.name].append(self._values(column, values, absent))

    def _values(self, column: ExportColumn, values: NDArray[Any], absent: Mask | None) -> NDArray[Any]:
        if column.kind == TEXT:
            return self._codes(self._texts[column.name], values, absent)
        if column.optional:
            found = values.astype(np.float64)
            if absent is not None:
                found[absent] = np.nan
            return found
        return values

    def _codes(self, known: dict[str, int], values: NDArray[Any], absent: Mask | None) -> NDArray[Any]:
        if absent is not None:
            values = np.where(absent, "", values)
        return np.array(
            [known.setdefault(text, len(known) + 1) if text else 0 for text in values.tolist()], np.uint32
        )

    def close(self) -> None:
        whole: dict[str, object] = {}
        for name, parts in self._parts.items():
            whole[name] = np.concatenate(parts)
            parts.clear()
        whole["units"] = {column.name: column.unit for column in self._columns}
        if self._texts:
            cells = {name: np.array([*known], object) for name, known in self._texts.items()}
            whole["texts"] = cells
        whole["meta"] = _plain({**self._facts, "json": json.dumps(self._facts)})
        from scipy.io import savemat  # importing it takes a fifth of a second, so only where it is needed

        savemat(self._path, whole, appendmat=False, format="5", long_field_names=True, oned_as="column")

    def abandon(self) -> None:
        self._parts.clear()


def _plain(value: Any) -> Any:
    """As MAT has it: a list is a cell array, None an empty matrix; names of fields begin with a letter."""
    if isinstance(value, Mapping):
        return {name.replace(" ", ""): _plain(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        cells = np.empty(len(value), object)
        cells[:] = [_plain(item) for item in value]
        return cells
    return np.zeros((0, 0)) if value is None else value


FORMATS: Final[dict[str, Callable[[Path, Sequence[ExportColumn], Facts], TableFile]]] = {
    "parquet": ParquetFile,
    "csv": CsvFile,
    "mat": MatFile,
}
"""Name, which is also the ending -> what writes it."""


def check_installed(form: str) -> None:
    """Raises ExportError with the command that installs what is missing."""
    if form == "parquet" and importlib.util.find_spec("pyarrow") is None:
        raise ExportError(f"--to parquet needs one package more: {installing('parquet')}")
