"""Makes the logs of the spatial rows of bench/estimation.py, once for all of them.

    python bench/spatial_logs.py [ROW …] [--seeds 0-7] [--to DIR] [--processes 2]

DIR/ROW/SEED/ holds

run.log              the frames, candump text, without those that nobody wants
run.log.truth.json   as `tilth simulate` writes it: parameters, nuisances, what was drawn, machine file
truth.npz            time (n,), s of UTC since the start; states (n, 13); wheel (n,), rad; 50 a second

A folder appears when it is whole; one that was made from another scenario or machine file is made anew, any
other is left alone. A seed has the same rig, soil, ground and sensors in every row, but for what the row is
about. The scenario draws most of it (simulator/scenario.py), `Drawn` the rest.
"""

import argparse
import json
import os
import shutil
import tempfile
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from estimation_study import NMEA_2000, STAR_FIRE
from rich.progress import Progress, TimeElapsedColumn
from wrong_files import packaged

from tilth.estimator.rig.adjustments import Amount
from tilth.estimator.rig.numbers import changed
from tilth.schemas.machine_toml import parse_machine
from tilth.simulator.fleet import drawn as drawn_rig
from tilth.simulator.fleet import headlands_of, scenario_of
from tilth.simulator.fleet_files import owners_text, text_of, true_machine
from tilth.simulator.noise import generator, within
from tilth.simulator.scenario import (
    DrivenManoeuvre,
    Fieldwork,
    Ground,
    HeadlandTurn,
    RollSensor,
    Scenario,
    Soil,
    SoilChange,
    Spatial,
    SurveyErrors,
    Wheel,
    as_json,
    from_json,
)
from tilth.simulator.simulate import SimulationInput, files_of, simulate_to

CACHE: Final = Path.home() / ".cache" / "tilth" / "spatial_logs"
LOG: Final = "run.log"
STREAM: Final = 101  # of generators, here
KEEP: Final = 2  # of the truth's samples every other is kept: 50 a second
HEAVY: Final = 8000.0  # kg
DROP: Final = 0.7  # of all stiffnesses, on other soil
CHANGE_S: Final = 92.0  # into the run, on a straight stretch
STEPS_DEG: Final = np.array([8.0, -6.0, 4.0])  # about, as in examples/scenarios/step_runs.toml
LEAD_S, STEP_S, GAP_S = 5.0, 30.0, 15.0  # of each step run: straight, turning, and not recorded after it
FIRST_S: Final = 5.0  # before the first step run, recorded
TURNS: Final = (HeadlandTurn(18.0, 8.9), HeadlandTurn(6.1, 4.8), HeadlandTurn(6.1, 5.0, reversal=True))
"""A U at 18 degrees of the wheels, a loop at 32, and one with a reversal."""
LARGEST_DEG: Final = 32.5  # of the wheels, in a turn


class Drawn(NamedTuple):
    """What no scenario draws; the same for a seed in every row."""

    heights: tuple[float, float]  # m, of both CGs, as the machine file says
    gain: float  # of the wheel-angle sensor
    waves: tuple[float, float]  # m, shortest and longest of the ground
    rolling: float
    grip: float  # of the planar plant; the spatial one draws its own
    steps_deg: tuple[float, float, float]
    length: float  # m, of rows
    turn_speed: float  # m/s
    speeds: tuple[tuple[float, float], ...]  # s, m/s
    first_turn: int  # of TURNS


def drawn(seed: int) -> Drawn:
    rng = generator(seed, STREAM)
    side = float(rng.choice([-1.0, 1.0]))
    sizes = rng.uniform(0.85, 1.15, 3) * STEPS_DEG * side
    return Drawn(
        (float(rng.uniform(0.9, 1.3)), float(rng.uniform(0.9, 1.5))),
        1.0 + 0.02 * float(within(rng, 1)[0]),
        (float(rng.uniform(0.5, 2.0)), float(rng.uniform(10.0, 40.0))),
        float(rng.uniform(0.02, 0.10)),
        float(rng.uniform(0.5, 0.9)),
        tuple(sizes.tolist()),
        float(rng.uniform(200.0, 400.0)),
        float(rng.uniform(1.5, 2.2)),
        tuple((float(rng.uniform(60.0, 240.0)), float(rng.uniform(2.0, 4.0))) for _ in range(8)),
        int(rng.integers(len(TURNS))),
    )


@dataclass(frozen=True, slots=True)
class LogRow:
    """The runs of a row. changes: keys of Scenario that differ from `base`, of a seed."""

    name: str
    runs: int  # seeds of the row
    seconds: float
    changes: Callable[[int, Drawn], Mapping[str, Any]] = lambda seed, have: {}
    rms: float = 0.01  # m, of the ground
    heavy: bool = False  # whether the implement weighs HEAVY
    receivers: int = STAR_FIRE  # NAME of the first: at 5 or 10 Hz
    fleet: bool = False  # whether each seed is a rig of simulator/fleet.py
    gaps: tuple[tuple[float, float], ...] = ()  # s of the run, not recorded
    informed_s: float = 0.0  # from when on what is learned is of another soil
    rig: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)  # what its machine file has instead
    plant: Callable[[Scenario], Scenario] = lambda scenario: scenario  # last change of what is driven
    further_forward: float = 0.0  # m, by which the implement's CG is ahead of where its file says


def base(row: LogRow, seed: int, have: Drawn) -> Scenario:
    """Random steering on the spatial plant."""
    scenario = Scenario(
        seconds=row.seconds,
        seed=seed,
        plant="spatial",
        speed=4.5,
        steering=DrivenManoeuvre("random", 6.0),
        ground=Ground(rms=row.rms, waves=have.waves),
        soil=Soil(grip=have.grip, rolling=have.rolling),
        spatial=Spatial(draw=True),
        survey=SurveyErrors(cg_height_sd=0.05),
        wheel=Wheel(gain=have.gain),
        roll_sensor=RollSensor(draw=True),
        other_traffic=False,
    )
    return row.plant(replace(scenario, **row.changes(seed, have)))


def machine_of(row: LogRow, seed: int, have: Drawn) -> str:
    """Text of the machine file: the packaged one with other receivers, heights and, at times, implement."""
    raw = _with_heights(packaged(), have)
    for k, receiver in enumerate(raw["receiver"]):
        receiver["name"] = f"{row.receivers + k:016X}"
    if row.heavy:
        implement = raw["implement"]
        implement["yaw_inertia"] *= HEAVY / implement["mass"]["value"]
        implement["mass"] = {"value": HEAVY, "sd": HEAVY / 10}
    for section, values in row.rig.items():
        first, _, second = section.partition(".")
        (raw[first][second] if second else raw[first]).update(values)
    return text_of(raw)


def _with_heights(raw: dict[str, Any], have: Drawn) -> dict[str, Any]:
    for body, height in zip(("tractor", "implement"), have.heights, strict=True):
        raw[body]["cg_height"] = round(height, 2)
    return raw


def _sloping(seed: int, have: Drawn) -> Mapping[str, Any]:
    downhill = 90.0 if seed % 2 == 0 else -90.0
    return {"ground": Ground(rms=0.01, waves=have.waves, slope_deg=4.0, downhill_deg=downhill)}


def _steps(seed: int, have: Drawn) -> Mapping[str, Any]:
    segments: list[tuple[float, float]] = [(FIRST_S, 0.0)]
    for degrees in have.steps_deg:
        segments += [(LEAD_S, 0.0), (STEP_S, degrees), (GAP_S, 0.0)]
    return {"steering": tuple(segments)}


def _gaps() -> tuple[tuple[float, float], ...]:
    whole = LEAD_S + STEP_S + GAP_S
    ends = [FIRST_S + k * whole for k in (1, 2)]
    return tuple((end - GAP_S, end) for end in ends)


def _field(seed: int, have: Drawn) -> Mapping[str, Any]:
    turns = TURNS[have.first_turn :] + TURNS[: have.first_turn]
    work = Fieldwork(length=round(have.length), turns=turns, turn_speed=have.turn_speed)
    return {"steering": work, "speed": have.speeds, "steering_limit_deg": LARGEST_DEG}


def _fleet_field(seed: int, have: Drawn) -> Mapping[str, Any]:
    work = Fieldwork(
        length=round(have.length), turns=headlands_of(drawn_rig(seed)), turn_speed=have.turn_speed
    )
    return {"steering": work, "speed": have.speeds}


def _planar_field(seed: int, have: Drawn) -> Mapping[str, Any]:
    ground = Ground(roll_sd_deg=0.7, force_sd=0.015)
    return {**_field(seed, have), "plant": "planar", "ground": ground, "spatial": Spatial()}


def _soil(seed: int, have: Drawn) -> Mapping[str, Any]:
    change = SoilChange(at_s=CHANGE_S, C_af=DROP, C_ar=DROP, C_ai=DROP)
    soil = Soil(grip=have.grip, rolling=have.rolling, changes=(change,))
    return {"steering": ((CHANGE_S - 4.0, None), (8.0, 0.0), (60.0, None)), "soil": soil}


FIELD_S: Final = 1200.0
ROWS: Final = (
    LogRow("spatial_random", 200, 120.0),
    LogRow("spatial_flat", 40, 120.0, rms=0.0),
    LogRow("spatial_3cm", 40, 120.0, rms=0.03),
    LogRow("spatial_10hz", 40, 120.0, receivers=NMEA_2000),
    LogRow("spatial_3ms", 40, 120.0, lambda seed, have: {"speed": 3.0}),
    LogRow("spatial_8t", 40, 120.0, heavy=True),
    LogRow("spatial_slope", 40, 120.0, _sloping),
    LogRow("spatial_steps", 40, FIRST_S + 3 * (LEAD_S + STEP_S + GAP_S) - GAP_S + 0.5, _steps, gaps=_gaps()),
    LogRow("spatial_field", 40, FIELD_S, _field),
    LogRow("planar_field", 40, FIELD_S, _planar_field),
    LogRow("fleet_field", 40, FIELD_S, _fleet_field, fleet=True),
    LogRow("spatial_soil", 40, CHANGE_S + 63.0, _soil, informed_s=CHANGE_S),
)
ROW: Final = {row.name: row for row in ROWS}


# One run.


def folder_of(to: Path, row: str, seed: int) -> Path:
    return to / row / f"{seed:04d}"


def source_of(row: LogRow, seed: int) -> SimulationInput:
    have = drawn(seed)
    if row.fleet:
        rig = drawn_rig(seed)
        scenario, text = scenario_of(rig, base(row, seed, have)), owners_text(rig, row.receivers)
        driven = true_machine(rig, row.receivers)
        told = as_json(scenario)
        return SimulationInput(parse_machine(text), text, scenario, told, seed, row.seconds, driven)
    scenario, text = base(row, seed, have), machine_of(row, seed, have)
    machine = parse_machine(text)
    behind, forward = Amount(-row.further_forward), Amount(row.further_forward)
    moved = changed(machine, {"d": behind, "e": forward, "lever_i": behind}) if row.further_forward else None
    return SimulationInput(machine, text, scenario, as_json(scenario), seed, row.seconds, moved)


def is_there(folder: Path, source: SimulationInput) -> bool:
    """Whether the folder was made from this."""
    try:
        made = json.loads(files_of(folder / LOG)[1].read_text(encoding="utf-8"))["source"]
        scenario = from_json(made["scenario"])  # not its text: a key that is new since then is no other one
    except (OSError, ValueError, KeyError):
        return False
    wanted = (source.scenario, source.machine_text, source.seconds)
    return (scenario, made["machine"], made["seconds"]) == wanted


def make(to: Path, row: LogRow, seed: int) -> bool:
    """Make one run unless it is there; whether it was made."""
    folder, source = folder_of(to, row.name, seed), source_of(row, seed)
    if is_there(folder, source):
        return False
    folder.parent.mkdir(parents=True, exist_ok=True)
    fresh = Path(tempfile.mkdtemp(prefix=f".{seed:04d}-", dir=folder.parent))
    try:
        _fill(fresh, row, source)
        shutil.rmtree(folder, ignore_errors=True)
        try:
            fresh.rename(folder)
        except OSError:  # another process was faster
            if not is_there(folder, source):
                raise
    finally:
        shutil.rmtree(fresh, ignore_errors=True)
    return True


def make_named(to: Path, name: str, seed: int) -> bool:
    """`make`, for another process."""
    return make(to, ROW[name], seed)


def _fill(folder: Path, row: LogRow, source: SimulationInput) -> None:
    made = simulate_to(source, folder / LOG)
    log, _, table = made.files
    table.unlink()  # truth.npz is smaller, and read at once
    truth = made.truth
    np.savez_compressed(
        folder / "truth.npz",
        time=truth.time[::KEEP], states=truth.states[::KEEP], wheel=truth.wheel_angle[::KEEP],
    )  # fmt: skip
    if row.gaps:
        _cut(log, row.gaps)


def _cut(log: Path, gaps: Iterable[tuple[float, float]]) -> None:
    """Leave out the frames of stretches, s after the first frame."""
    lines = log.read_text(encoding="ascii").splitlines(keepends=True)
    stamps = np.array([float(line[1 : line.index(")")]) for line in lines])
    kept = np.ones(len(lines), bool)
    for start, end in gaps:
        kept &= (stamps - stamps[0] < start) | (stamps - stamps[0] >= end)
    log.write_text("".join(line for line, keep in zip(lines, kept, strict=True) if keep), encoding="ascii")


# Reading them.


class Run(NamedTuple):
    """One run of a row, as it was written."""

    folder: Path
    described: Mapping[str, Any]  # run.log.truth.json

    @property
    def log(self) -> Path:
        return self.folder / LOG

    @property
    def machine_text(self) -> str:
        return str(self.described["source"]["machine"])

    def seconds_of(self, t_ns: int) -> float:
        """Seconds of the truth at an instant of the log's clock."""
        told = self.described["nuisances"]
        since = (t_ns - self.described["utc_start_ns"]) * 1e-9 - told["clock_offset"]
        return float(since / (1.0 + told["clock_skew"]))


def read_run(to: Path, row: str, seed: int) -> Run:
    """Raises OSError where it was not made."""
    folder = folder_of(to, row, seed)
    return Run(folder, json.loads(files_of(folder / LOG)[1].read_text(encoding="utf-8")))


@cache
def truth_arrays(folder: Path) -> Mapping[str, Any]:
    """What truth.npz holds."""
    with np.load(folder / "truth.npz") as arrays:
        return dict(arrays)


# The command.


def seeds_of(text: str) -> range:
    """Of "7" or "0-7", both ends in. Raises ValueError."""
    first, _, last = text.partition("-")
    seeds = range(int(first), int(last or first) + 1)
    if not seeds:
        raise ValueError(f"no seed from {first} to {last}")
    return seeds


def main() -> None:
    parser = argparse.ArgumentParser(description="Logs of the spatial rows of bench/estimation.py.")
    parser.add_argument("row", nargs="*", help=", ".join(ROW))
    parser.add_argument("--seeds", type=seeds_of, help="of each row, as 0-7; all that the row has")
    parser.add_argument("--to", type=Path, default=CACHE, help=f"folder, {CACHE}")
    parser.add_argument("--processes", type=int, default=2)
    args = parser.parse_args()
    if unknown := set(args.row) - set(ROW):
        parser.error(f"no such row: {', '.join(sorted(unknown))}")
    jobs = [(ROW[name], seed) for name in args.row or ROW for seed in args.seeds or range(ROW[name].runs)]
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    columns = (*Progress.get_default_columns(), TimeElapsedColumn())
    pool = ProcessPoolExecutor(args.processes, get_context("spawn"))
    with pool, Progress(*columns) as progress, suppress(KeyboardInterrupt):
        task = progress.add_task("runs", total=sum(row.seconds for row, _ in jobs))
        waiting = {pool.submit(make_named, args.to, row.name, seed): (row, seed) for row, seed in jobs}
        for done in as_completed(waiting):
            row, seed = waiting[done]
            done.result()
            progress.update(task, advance=row.seconds, description=f"{row.name} {seed}")


if __name__ == "__main__":
    main()
