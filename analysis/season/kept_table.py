"""What a season has left in its table, read back: the stretches of one tractor with one implement."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.analysis.season.identified import share_learned
from tilth.analysis.season.season import TABLE
from tilth.analysis.season.stretches import STRETCH, DrivenRig
from tilth.analysis.season.table import FACTS, FORM, MACHINES, require_parquet
from tilth.estimator.filters import unknowns
from tilth.estimator.filters.soil_field import AXLES, Told
from tilth.estimator.filters.unknowns import SIX
from tilth.logger.clock import utc_text
from tilth.schemas.flow import PARAMETERS
from tilth.schemas.invocation import command
from tilth.schemas.machine import Machine, MachineError
from tilth.schemas.machine_toml import parse_machine

Array = NDArray[np.float64]

_COLUMNS: Final = (
    "kind", "machine", "implement", "rig_sha256", "run", "log", "method", "latitude_deg", "longitude_deg",
    "alone_C_af", "information", "vector", "pieces_information",
    "pieces_vector", "model_sd",
    "by_file", "together", "logs_sha256", "machine_sha256",
)  # fmt: skip
_TIMES: Final = ("begin_utc", "end_utc")


class MapProblem(Exception):
    """There is nothing to map; one sentence that says what to do."""


@dataclass(frozen=True, slots=True)
class PlacedStretch:
    """A stretch with its place."""

    run: str
    method: str
    begin_utc_ns: int
    path_deg: Array  # (points, 2), latitude and longitude of the implement's axle
    told: Told
    by_file: Array  # (6, 6), covariance that errors which may still be in the machine file add
    properties: Mapping[str, Any]  # of its row, for a map


class RigStretches(NamedTuple):
    """Of one tractor with one implement, in the order of driving."""

    machine_name: str
    implement: str
    machine: Machine
    stretches: tuple[PlacedStretch, ...]
    left_out: tuple[str, ...]  # sentences


def stretches_of(out: Path, machine: str | None = None, implement: str | None = None) -> RigStretches:
    """Those of the season's folder that can be mapped. machine, implement: names, or how the latter begins,
    where there are several. Raises MapProblem, NoParquet, OSError."""
    rows, machines = _read(out)
    rows = [row for row in rows if row["kind"] == STRETCH]
    rigs = list(dict.fromkeys(_rig(row) for row in rows if row["rig_sha256"]))
    if not rigs:
        raise MapProblem(
            f"{out}: no stretch of driving was fitted in this season, so there is nothing to map"
        )
    rig = _chosen(rigs, machine, implement)
    own = [row for row in rows if row["rig_sha256"] and _rig(row) == rig]
    used = [row for row in own if row["together"] and row["alone_C_af"] is not None]
    placed = [row for row in used if _has_place(row)]
    left_out = []
    if len(used) < len(own):
        left_out.append(
            f"{len(own) - len(used)} stretches are not in the map: they, or their runs, are not combined "
            "with others; season.html says why"
        )
    if len(placed) < len(used):
        left_out.append(f"{len(used) - len(placed)} stretches are not in the map: their place is unknown")
    if not placed:
        said = "; ".join(left_out)
        raise MapProblem(f"no stretch of {_label(rigs, rig)} can be mapped: {said}")
    text = machines.get(placed[-1]["machine_sha256"])
    try:
        if text is None:
            raise MachineError("is not in the table")
        parsed = parse_machine(*text)
    except MachineError as error:
        raise MapProblem(f"{out / TABLE}: the machine file of {rig.machine}: {error}") from None
    return RigStretches(
        rig.machine, rig.implement, parsed, tuple(_stretches(placed, parsed)), tuple(left_out)
    )


def _read(out: Path) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    arrow, path = require_parquet(), out / TABLE
    again = f"make it with `{command('season', 'LOGS', '--out', str(out))}`"
    if not path.exists():
        raise MapProblem(f"{out}: no season in this folder; {again}")
    parquet = import_module("pyarrow.parquet")
    try:
        metadata = parquet.read_schema(path).metadata or {}
        form = int(json.loads(metadata.get(FACTS.encode(), b"{}")).get("form", 0))
        if form != FORM:
            raise MapProblem(f"{path}: another version of tilth has written it; {again} again")
        table = parquet.read_table(path, columns=[*_COLUMNS, *_TIMES])
        machines = json.loads(metadata[MACHINES.encode()])
    except (arrow.ArrowInvalid, ValueError, KeyError):
        raise MapProblem(f"{path}: is no table of a season, or is damaged; {again} again") from None
    for name in _TIMES:  # ns, of which Python's own times have none
        table = table.set_column(table.column_names.index(name), name, table[name].cast(arrow.int64()))
    rows: list[dict[str, Any]] = table.to_pylist()
    return rows, machines


def _rig(row: Mapping[str, Any]) -> DrivenRig:
    return DrivenRig(row["machine"], row["implement"], row["rig_sha256"])


def _label(rigs: Sequence[DrivenRig], rig: DrivenRig) -> str:
    """How a rig is called: by its hash, too, where that alone tells it apart."""
    alike = sum((one.machine, one.implement) == (rig.machine, rig.implement) for one in rigs) > 1
    return f"{rig.machine}, implement {rig.implement}" + (f" [{rig.sha256[:8]}]" if alike else "")


def _chosen(rigs: Sequence[DrivenRig], machine: str | None, implement: str | None) -> DrivenRig:
    """The rig that is meant. Raises MapProblem."""
    meant = [
        one
        for one in rigs
        if machine in (None, one.machine)
        and (implement is None or one.implement.startswith(implement) or one.sha256[:8] == implement)
    ]
    if len(meant) == 1:
        return meant[0]
    there = "; ".join(_label(rigs, one) for one in meant or rigs)
    if meant:
        raise MapProblem(
            f"a map is of one tractor with one implement: give --machine and --implement; there are: {there}"
        )
    raise MapProblem(f"no such machine with such an implement is in this season; there are: {there}")


def _has_place(row: Mapping[str, Any]) -> bool:
    """On the Earth."""
    path = np.array([row["latitude_deg"] or [], row["longitude_deg"] or []], dtype=np.float64)
    return bool(path.size and np.all(np.abs(path) <= [[90.0], [180.0]]))


def _stretches(rows: Sequence[Mapping[str, Any]], machine: Machine) -> Iterator[PlacedStretch]:
    """Of each row, or of each of its pieces."""
    prior_sd = unknowns.prior(machine)[1][SIX]
    for row in rows:
        path = np.stack([row["latitude_deg"], row["longitude_deg"]], axis=1)
        pieces = "pieces_" if row["pieces_vector"] else ""
        vectors = np.reshape(row[f"{pieces}vector"], (-1, 6))
        informations = np.reshape(row[f"{pieces}information"], (-1, 6, 6))
        model_sd, by_file = np.array(row["model_sd"]), np.reshape(row["by_file"], (6, 6))
        ways = np.split(path, len(vectors))
        for information, vector, way in zip(informations, vectors, ways, strict=True):
            shares = share_learned(information, prior_sd)
            properties = {
                **{f"{name}_informed": shares[name] for name in PARAMETERS[:AXLES]},
                **{name: row[name] and utc_text(row[name]) for name in _TIMES},
                **{name: row[name] for name in ("run", "method", "log", "logs_sha256")},
            }
            told = Told(information, vector, model_sd)
            begin_ns = row["begin_utc"] or 0
            yield PlacedStretch(row["run"], row["method"], begin_ns, way, told, by_file, properties)


def runs_in(stretches: Sequence[PlacedStretch]) -> list[str]:
    """Their names."""
    return list(dict.fromkeys(one.run for one in stretches))
