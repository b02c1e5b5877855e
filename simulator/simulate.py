"""A scenario to files: the log of its frames, and the truth beside it.

LOG             what a recorder would have taken: MCAP with the machine file, or candump -l text
LOG.truth.json  what the run is made from: parameters, rig, nuisances, events, units, and where it comes from
LOG.truth.csv   both bodies, wheel angle, slip and soil over time, on the clock of the log: COLUMNS
"""

import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import Any, Final, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.models.nonlinear import STATES
from tilth.estimator.models.parameters import RIG_PARAMETERS
from tilth.logger.log.mcap_log import SIMULATED, LogWriter, RunPart
from tilth.logger.log.software import software
from tilth.logger.log.whole_file import whole
from tilth.replay.simulated import TRUTH
from tilth.schemas.flow import PARAMETERS, Frame
from tilth.schemas.machine import Machine
from tilth.schemas.machine_toml import MachineFile
from tilth.schemas.readable import readable
from tilth.simulator.drive import drive
from tilth.simulator.ground import AXLES, crossings
from tilth.simulator.scenario import STEP_S, Scenario
from tilth.simulator.spatial.forces import TYRE_COLUMNS
from tilth.simulator.spatial.vehicle import WHEELS
from tilth.simulator.tractor import Truth
from tilth.simulator.traffic import host_clock, traffic

Array = NDArray[np.float64]

KEEP: Final = 2  # of the samples every other goes into the table: 50 a second
SHOWN: Final = 4096  # frames between two words on progress

Progress = Callable[[str, float], None]
"""Told what is being done and up to which second of the run."""


class Writer(Protocol):
    """Takes the frames of one file."""

    def frame(self, frame: Frame) -> None: ...

    def close(self) -> None: ...


class Candump:
    """Text as `candump -l` writes it, to the microsecond."""

    def __init__(self, path: Path) -> None:
        """Raises OSError; FileExistsError: a log is never overwritten."""
        self._stream = path.open("x", encoding="ascii")

    def frame(self, frame: Frame) -> None:
        seconds, nanoseconds = divmod(frame.t_ns, 1_000_000_000)
        identifier = f"{frame.can_id:08X}" if frame.extended else f"{frame.can_id:03X}"
        stamp = f"({seconds}.{nanoseconds // 1000:06d})"
        self._stream.write(f"{stamp} {frame.bus} {identifier}#{frame.data.hex().upper()}\n")

    def close(self) -> None:
        self._stream.close()


@dataclass(frozen=True, slots=True)
class SimulationInput:
    """What a run is simulated from, with the texts that go into its files."""

    machine: Machine
    machine_text: str
    scenario: Scenario
    scenario_text: str
    seed: int
    seconds: float
    driven: Machine | None = None  # what the machine is in truth, where its file errs

    @property
    def rig(self) -> Machine:
        """What is driven and sends."""
        return self.driven or self.machine


@dataclass(frozen=True, slots=True)
class Simulated:
    """What a simulation wrote."""

    truth: Truth
    frames: int
    files: tuple[Path, Path, Path]  # log, truth as JSON, truth as CSV


def _mcap(path: Path, source: SimulationInput) -> Writer:
    start_ns = source.scenario.utc_start_ns
    run = RunPart(f"simulated-{source.seed}", 1, start_ns, simulated="tilth simulate")
    writer = LogWriter(path, MachineFile(source.machine, source.machine_text), run)
    metadata = {"seed": str(source.seed), "seconds": str(source.seconds), "scenario": source.scenario_text}
    writer.metadata(SIMULATED, metadata)
    return writer


def _candump(path: Path, source: SimulationInput) -> Writer:
    return Candump(path)


WRITERS: Final = {".mcap": _mcap, ".log": _candump}
"""By the ending of the log's name."""


def files_of(log: Path) -> tuple[Path, Path, Path]:
    """Log, truth as JSON and truth as CSV."""
    return log, log.with_name(log.name + TRUTH), log.with_name(log.name + ".truth.csv")


def simulate_to(
    source: SimulationInput, log: Path, progress: Progress = lambda what, seconds: None
) -> Simulated:
    """Drive a scenario and write its three files; the same source gives the same bytes. All three or none.

    Raises OSError, FileExistsError before anything is written; ValueError where the machine is none that can
    be driven, CannotBeDriven, which is one too, where the scenario asks too much of it; KeyError where the
    log's name has no ending of WRITERS.
    """
    make, files = WRITERS[log.suffix], files_of(log)
    for path in files:
        if path.exists():
            raise FileExistsError(f"{path} exists")
    truth = drive(
        source.rig, source.seed, source.seconds, source.scenario,
        progress=lambda seconds: progress("driving", seconds),
    )  # fmt: skip
    with ExitStack() as stack:
        part, *beside = (stack.enter_context(whole(path)) for path in files)
        writer = stack.enter_context(closing(make(part, source)))
        _write_truth(source, truth, files, beside)
        count = 0
        start_ns = host_clock(truth)(0.0)
        for count, frame in enumerate(traffic(source.rig, truth), start=1):
            writer.frame(frame)
            if count % SHOWN == 0:
                progress("frames", (frame.t_ns - start_ns) * 1e-9)
    return Simulated(truth, count, files)


# The truth.


class Column(NamedTuple):
    """One column of the table; `of` gives its samples, shape (n,)."""

    name: str
    unit: str
    meaning: str
    of: Callable[[Truth], Array]


_OF_A_BODY: Final = (
    ("x", "m", "CG north of the origin", "x"),
    ("y", "m", "CG east of the origin", "y"),
    ("psi", "rad", "heading, clockwise from north, not wrapped", "heading"),
    ("u", "m/s", "velocity of the CG forward", "forward_velocity"),
    ("v", "m/s", "velocity of the CG to the right", "lateral_velocity"),
    ("r", "rad/s", "yaw rate, turning right", "yaw_rate"),
    ("phi", "rad", "roll, right side down", "roll"),
    ("theta", "rad", "pitch, nose up", "pitch"),
)


def _bodies() -> Iterator[Column]:
    for body in ("tractor", "implement"):
        for name, unit, meaning, key in _OF_A_BODY:
            yield Column(f"{name}_{body[0]}", unit, f"{meaning}, {body}", attrgetter(f"{body}.{key}"))


def _axles() -> Iterator[Column]:
    for axle in AXLES:
        name = f"alpha_{axle[0]}"
        yield Column(name, "rad", f"slip angle, {axle} axle", _column("states", STATES.index(name)))
    for k, name in enumerate(PARAMETERS):
        unit = "N/rad" if name.startswith("C_") else "m"
        yield Column(name, unit, "on the soil under its axle", _column("soil", k))


def _column(key: str, k: int) -> Callable[[Truth], Array]:
    def of(truth: Truth) -> Array:
        samples: Array = getattr(truth, key)[:, k]
        return samples

    return of


COLUMNS: Final = (
    *_bodies(),
    Column("delta", "rad", "mean wheel angle of the front axle, turned right", attrgetter("wheel_angle")),
    *_axles(),
)
"""Of LOG.truth.csv, after t_ns: the log's clock, as Frame.t_ns and Pose.t_ns."""


def _wheels() -> Iterator[Column]:
    for k, wheel in enumerate(WHEELS):
        for name, unit, meaning in _OF_A_WHEEL:
            yield Column(
                f"{name}_{wheel}", unit, f"{meaning}, {wheel.replace('_', ' ')}", _tyre_column(k, name)
            )


def _tyre_column(k: int, name: str) -> Callable[[Truth], Array]:
    def of(truth: Truth) -> Array:
        assert truth.space is not None
        samples: Array = truth.space.motion.tyres[:, k, TYRE_COLUMNS.index(name)]
        return samples

    return of


_OF_A_WHEEL: Final = (
    ("load", "N", "of the tyre"),
    ("across", "N", "side force to the right"),
    ("elevation", "m", "of the ground under the tyre, upwards"),
)
SPATIAL_COLUMNS: Final = tuple(_wheels())
"""Further ones of a spatial run."""


def columns_of(truth: Truth) -> tuple[Column, ...]:
    """Of LOG.truth.csv."""
    return COLUMNS if truth.space is None else COLUMNS + SPATIAL_COLUMNS


def _write_truth(
    source: SimulationInput, truth: Truth, files: tuple[Path, Path, Path], parts: Sequence[Path]
) -> None:
    """parts: what becomes the two files of the truth."""
    log, _, named = files
    described, table = parts
    text = json.dumps(_description(source, truth, log, named), indent=1, ensure_ascii=False)
    described.write_text(readable(text) + "\n", encoding="utf-8")
    columns = columns_of(truth)
    values = np.column_stack([column.of(truth)[::KEEP] for column in columns]).tolist()
    with table.open("x", encoding="ascii") as stream:
        stream.write(",".join(["t_ns", *(column.name for column in columns)]) + "\n")
        t_ns_at = host_clock(truth)
        row = "%d" + ",%.9g" * len(columns) + "\n"
        for at_s, numbers in zip(truth.time[::KEEP].tolist(), values, strict=True):
            stream.write(row % (t_ns_at(at_s), *numbers))


def _description(source: SimulationInput, truth: Truth, log: Path, table: Path) -> dict[str, object]:
    """All of LOG.truth.json."""
    return {
        "purpose": source.scenario.purpose,
        "log": log.name,
        "parameters": truth.parameters,
        "rig": {
            row.name: {"value": value, "unit": row.unit, "meaning": row.meaning}
            for row, value in zip(RIG_PARAMETERS, truth.rig, strict=True)
        },
        **_space(truth),
        "nuisances": truth.nuisances,  # SI; named in simulator/tractor.py
        "events": sorted(_events(truth), key=lambda event: (event["t_ns"], event["what"])),
        "origin_deg": truth.scenario.origin_deg,
        "utc_start_ns": truth.scenario.utc_start_ns,
        "table": {
            "file": table.name,
            "period_s": KEEP * STEP_S,
            "columns": {
                "t_ns": {"unit": "ns", "meaning": "the log's clock, as the frames' stamps"},
                **{c.name: {"unit": c.unit, "meaning": c.meaning} for c in columns_of(truth)},
            },
        },
        "source": {
            "seed": source.seed,
            "seconds": source.seconds,
            "scenario": source.scenario_text,
            "machine": source.machine_text,
            "software": software(),
        },
    }


def _space(truth: Truth) -> dict[str, object]:
    """What the rig of a spatial run is made of, as drawn."""
    if truth.space is None:
        return {}
    vehicle = truth.space.vehicle
    return {"vehicle": {**vehicle._asdict(), "masses": vehicle.masses._asdict()}}


def _events(truth: Truth) -> Iterator[dict[str, object]]:
    """What happens to receivers and soil, each with the times of its beginning and end on the log's clock."""
    end_s, t_ns_at = float(truth.time[-1]), host_clock(truth)

    def event(what: str, start_s: float, until_s: float, **more: Any) -> dict[str, object]:
        times = {"t_ns": t_ns_at(start_s), "end_ns": t_ns_at(min(until_s, end_s))}
        return {"what": what, **times, **more}

    for fault in truth.scenario.faults:
        if fault.start_s < end_s:
            yield event(fault.kind, fault.start_s, fault.end_s, mount=fault.mount.value)
    for claim in truth.scenario.reclaims:
        if claim.at_s < end_s:
            yield event("reclaim", claim.at_s, claim.at_s, mount=claim.mount.value, source=claim.source)
    for number, axle, start_s, until_s in crossings(
        truth.scenario.soil.changes, truth.rig, truth.time, truth.states
    ):
        yield event("soil", start_s, until_s, change=number, axle=axle)
