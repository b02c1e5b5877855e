"""A season's rows as a Parquet file: the same rows give the same bytes."""

import json
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from tilth.analysis.season.identified import share_learned
from tilth.analysis.season.merging import SixKnown
from tilth.analysis.season.stretches import SeasonRow
from tilth.estimator.filters import unknowns
from tilth.estimator.filters.unknowns import SIX
from tilth.logger.log import whole_file
from tilth.logger.log.software import software
from tilth.schemas.flow import PARAMETERS
from tilth.schemas.invocation import installing
from tilth.schemas.readable import readable

FORM: Final = 4  # of the table; grows when a column changes its meaning, or what is beside them
FACTS, MACHINES = "tilth.season", "tilth.machines"  # keys of the metadata
TEXT, NUMBER, WHOLE, NUMBERS, TRUTH, UTC = "text", "number", "whole", "numbers", "truth", "utc"


class NoParquet(Exception):
    """pyarrow is not installed; one sentence that says what to do."""


class RowColumn(NamedTuple):
    """of: its value of a row; None: there is none."""

    name: str
    kind: str
    unit: str
    meaning: str
    of: Callable[[SeasonRow], object]


def _of_run(get: Callable[[Any], object]) -> Callable[[SeasonRow], object]:
    return lambda row: None if row.run is None else get(row.run)


def _of_stretch(get: Callable[[Any], object]) -> Callable[[SeasonRow], object]:
    return lambda row: None if row.stretch is None else get(row.stretch)


def _values(get: Callable[[SeasonRow], SixKnown | None], k: int) -> Callable[[SeasonRow], object]:
    def value(row: SeasonRow) -> object:
        six = get(row)
        return None if six is None else float(np.exp(six.mean[k]))

    return value


def _covariance(get: Callable[[SeasonRow], SixKnown | None]) -> Callable[[SeasonRow], object]:
    def value(row: SeasonRow) -> object:
        six = get(row)
        return None if six is None else six.covariance.ravel().tolist()

    return value


def _said(k: int) -> tuple[RowColumn, ...]:
    """Of one parameter: value and sd where it has a number, status, reason."""
    name, unit = PARAMETERS[k], _unit(PARAMETERS[k])

    def number(row: SeasonRow, sd: bool) -> object:
        if row.known is None or row.known.reasons[k]:
            return None
        value = float(np.exp(row.known.six.mean[k]))
        return value * float(np.sqrt(row.known.six.covariance[k, k])) if sd else value

    return (
        RowColumn(name, NUMBER, unit, "by the whole season, if it has a number", lambda r: number(r, False)),
        RowColumn(f"{name}_sd", NUMBER, unit, "its standard deviation", lambda r: number(r, True)),
        RowColumn(f"{name}_status", TEXT, "", "", lambda r: r.known and r.known.statuses[k].name.lower()),
        RowColumn(f"{name}_reason", TEXT, "", "why it has none", lambda r: r.known and r.known.reasons[k]),
        RowColumn(
            f"{name}_informed", NUMBER, "1", "share of the prior's variance that this stretch alone removes",
            lambda row: _informed(row, name),
        ),
    )  # fmt: skip


def _informed(row: SeasonRow, name: str) -> float | None:
    if row.stretch is None or row.run is None or row.run.machine is None:
        return None
    return share_learned(row.stretch.information, unknowns.prior(row.run.machine)[1][SIX])[name]


def _unit(name: str) -> str:
    return "N/rad" if name.startswith("C_") else "m"


_WAYS: Final[dict[str, tuple[str, Callable[[SeasonRow], SixKnown | None]]]] = {
    "alone": ("by machine file and stretch alone", lambda row: row.merged.alone if row.merged else None),
    "forward": ("by all up to the stretch", lambda row: row.merged.forward if row.merged else None),
    "season": ("by the whole season, smoothed", lambda row: row.merged.smoothed if row.merged else None),
}
COLUMNS: Final[tuple[RowColumn, ...]] = (
    RowColumn("kind", TEXT, "", "stretch; or run or file that gave none", lambda row: row.kind),
    RowColumn("machine", TEXT, "", "its name", _of_run(lambda one: one.rig and one.rig.machine)),
    RowColumn("implement", TEXT, "", "in words", _of_run(lambda one: one.rig and one.rig.implement)),
    RowColumn("rig_sha256", TEXT, "", "of what is said of tractor, implement and tyres",
           _of_run(lambda one: one.rig and one.rig.sha256)),
    RowColumn("run", TEXT, "", "its name", _of_run(lambda one: one.run.name)),
    RowColumn("log", TEXT, "", "the run's first log, or the file", lambda row: readable(row.path)),
    RowColumn("begin_utc", UTC, "", "empty where nobody knows", lambda row: _utc(row, "begin_ns")),
    RowColumn("end_utc", UTC, "", "empty where nobody knows", lambda row: _utc(row, "end_ns")),
    RowColumn("begin_ns", WHOLE, "ns", "on the log's clock", _of_stretch(lambda one: one.begin_ns)),
    RowColumn("method", TEXT, "", "that has fitted it", _of_stretch(lambda one: one.method)),
    RowColumn("seconds", NUMBER, "s", "of driving", _of_stretch(lambda one: one.seconds)),
    RowColumn("metres", NUMBER, "m", "since the stretch before", _of_stretch(lambda one: one.metres)),
    RowColumn("speed", NUMBER, "m/s", "mean", _of_stretch(lambda one: one.speed)),
    RowColumn("wheel_rms", NUMBER, "rad", "of the wheel angle", _of_stretch(lambda one: one.wheel_rms)),
    RowColumn("latitude_deg", NUMBERS, "degrees", "path of the implement's axle, WGS 84",
           _of_stretch(lambda one: one.path_deg[:, 0].tolist())),
    RowColumn("longitude_deg", NUMBERS, "degrees", "path of the implement's axle, WGS 84",
           _of_stretch(lambda one: one.path_deg[:, 1].tolist())),
    *(column for k in range(len(PARAMETERS)) for column in _said(k)),
    *(
        column
        for way, (meaning, get) in _WAYS.items()
        for column in (
            *(
                RowColumn(f"{way}_{name}", NUMBER, _unit(name), f"median {meaning}", _values(get, k))
                for k, name in enumerate(PARAMETERS)
            ),
            RowColumn(f"{way}_log_covariance", NUMBERS, "1", f"of the logarithms {meaning}, 6 × 6 by rows",
                   _covariance(get)),
        )
    ),
    RowColumn("information", NUMBERS, "1", "of the logarithms, by this alone, 6 × 6 by rows",
           _of_stretch(lambda one: one.information.ravel().tolist())),
    RowColumn("vector", NUMBERS, "1", "information times (what it says less the machine file's logarithm)",
           _of_stretch(lambda one: one.vector.tolist())),
    RowColumn("pieces_information", NUMBERS, "1", "the same of pieces of the path, in order, each of "
           "as many of its points; empty: it is one piece",
           _of_stretch(lambda one: [x for told in one.pieces for x in told.information.ravel().tolist()])),
    RowColumn("pieces_vector", NUMBERS, "1", "the same of these pieces",
           _of_stretch(lambda one: [x for told in one.pieces for x in told.vector.tolist()])),
    RowColumn("model_sd", NUMBERS, "1", "of the logarithms, errors of the model, as in other stretches",
           _of_stretch(lambda one: one.model_sd.tolist())),
    RowColumn("by_file", NUMBERS, "1", "of the logarithms, what errors that may still be in the machine file "
           "add, 6 × 6 by rows; empty while nobody knows",
           _of_stretch(lambda one: None if one.by_file is None else one.by_file.ravel().tolist())),
    RowColumn("changed", TRUTH, "", "it contradicted what was known", _of_stretch(lambda one: one.changed)),
    RowColumn("together", TRUTH, "", "it is put together with other runs",
           _of_run(lambda one: not one.apart)),
    RowColumn("status", TEXT, "", "estimated where one of the six has a number",
           lambda row: row.status.name.lower()),
    RowColumn("reason", TEXT, "", "", lambda row: row.reason),
    RowColumn("logs_sha256", TEXT, "", "of the run's logs, in order",
           _of_run(lambda one: " ".join(file.sha256 for file in one.run.files))),
    RowColumn("machine_sha256", TEXT, "", "of the machine file", _of_run(lambda one: one.run.machine)),
)  # fmt: skip


def _utc(row: SeasonRow, which: str) -> int | None:
    """ns since 1970."""
    if row.run is None or not row.run.begins_ns:
        return None
    if row.stretch is None:
        return row.run.begins_ns if which == "begin_ns" else row.run.ends_ns
    at_ns: int = getattr(row.stretch, which)
    return at_ns + (row.run.run.files[0].utc_minus_ns or 0)


def require_parquet() -> Any:
    """pyarrow. Raises NoParquet."""
    try:
        return import_module("pyarrow")
    except ImportError:
        raise NoParquet(f"a season's table needs one package more: {installing('parquet')}") from None


def write_table(
    path: Path, rows: Sequence[SeasonRow], machines: Mapping[str, tuple[str, str | None]]
) -> None:
    """All of it or nothing. machines: SHA-256 -> text and, where there is one, DBC file; the metadata keep
    those of the rows. Raises NoParquet, OSError."""
    arrow = require_parquet()
    parquet = import_module("pyarrow.parquet")
    types = {
        TEXT: arrow.string(), NUMBER: arrow.float64(), WHOLE: arrow.int64(), TRUTH: arrow.bool_(),
        NUMBERS: arrow.list_(arrow.float64()), UTC: arrow.timestamp("ns", "UTC"),
    }  # fmt: skip
    fields = [
        arrow.field(c.name, types[c.kind], metadata={"unit": c.unit, "meaning": c.meaning}) for c in COLUMNS
    ]
    said = software()
    facts = {"form": str(FORM), **{key: said[key] for key in ("version", "estimator", "numpy", "numba")}}
    of_rows = sorted({row.run.run.machine for row in rows if row.run is not None} & set(machines))
    texts = json.dumps({sha256: machines[sha256] for sha256 in of_rows})
    schema = arrow.schema(fields, metadata={FACTS: json.dumps(facts, sort_keys=True), MACHINES: texts})
    table = arrow.table(
        [arrow.array([c.of(row) for row in rows], types[c.kind]) for c in COLUMNS], schema=schema
    )
    with whole_file.whole(path, replace=True) as part:
        parquet.write_table(table, part, compression="zstd")
