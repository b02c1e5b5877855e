"""What soil and tyres are found to be by calibrated machine files, against by files that are right.

    python bench/calibrated_soil.py [--keep DONE.jsonl] [--rigs 6] [--minutes 60]

Takes the calibrated files that bench/calibration.py has kept. Each rig is driven once more, another way
(random steering on the same soil, another seed of all noise), and the product runs over the frames of that
twice: by the calibrated file, and by one that has the true places, angles, zeros and latencies. Masses,
heights and where the CGs are stay as the file says, in both.
"""

import argparse
import json
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from calibration import CACHE, KeptLines, file_numbers, true_numbers
from estimation_study import fitted_at_once, numbers
from numpy.typing import NDArray

from tilth.estimator import fold
from tilth.estimator.calibration.changes import Changes, Linkage, applied
from tilth.estimator.calibration.drive import MOUNTS
from tilth.replay.readers.any_log import frames
from tilth.schemas.flow import PARAMETERS, Estimate
from tilth.schemas.machine import Machine, Quantity
from tilth.simulator.packaged import packaged_file
from tilth.simulator.scenario import Spatial, as_json, from_json, parse_scenario
from tilth.simulator.simulate import SimulationInput, simulate_to

Array = NDArray[np.float64]

SEED: Final = 500  # added to that of the rig
METHODS: Final = ("pem", "tracker")
END_NS: Final = 60_000_000_000
DRIVE: Final = """
seconds = 240.0
speed = [[60.0, 4.5], [60.0, 3.0]]
steering = [[12.0, 0.0], [108.0, "random"]]
[soil]
grip = 0.7
rolling = 0.06
[ground]
slope_deg = 1.5
downhill_deg = 60.0
"""


def log_of(plant: str, rig_seed: int) -> tuple[Path, dict[str, Any]]:
    """The other drive of the rig of a log of bench/calibration.py."""
    machine, text = packaged_file()
    scenario = replace(parse_scenario(DRIVE), rig_seed=rig_seed)
    if plant == "spatial":
        scenario = replace(scenario, plant="spatial", spatial=Spatial(draw=True))
    scenario = from_json(as_json(scenario))
    path = CACHE / f"soil-{plant}-{rig_seed}.mcap"
    if not path.exists():
        part = CACHE / f"part-soil-{plant}-{rig_seed}.mcap"
        for old in CACHE.glob(f"{part.name}*"):
            old.unlink()
        source = SimulationInput(machine, text, scenario, DRIVE, SEED + rig_seed, scenario.seconds)
        simulate_to(source, part, lambda what, at_s: None)
        for made in CACHE.glob(f"{part.name}*"):
            made.rename(CACHE / made.name.removeprefix("part-"))
    truth: dict[str, Any] = json.loads(Path(f"{path}.truth.json").read_text(encoding="utf-8"))
    return path, truth


def right_file(truth: dict[str, Any]) -> Machine:
    """The machine file as a laboratory would give it."""
    file = packaged_file().machine
    true, said = true_numbers(truth, file), file_numbers(file, file)
    by = {name: true[name] - said[name] for name in true}
    delay = [truth["nuisances"][f"latency_{mount.value}"] for mount in MOUNTS]
    receivers = {r.mount: r for r in file.receiver}
    changes = Changes(
        delay=np.array([t - receivers[m].latency.value for t, m in zip(delay, MOUNTS, strict=True)]),
        forward=np.array([by["lever_t"], by["lever_i"]]),
        lateral_offset=np.array([by["aside_t"], by["aside_t"] + by["aside_i"]]),
        pair=np.array([by["pair_t"], by["pair_i"]]), hitch=np.array([by["c"], by["d"]]),
        wheel_zero=true["wheel_zero"], wheel_gain=math.exp(true["wheel_gain"]),
        roll_zero=np.array([true[f"roll_zero_{mount.value}"] for mount in MOUNTS]), linkage=Linkage(),
    )  # fmt: skip
    return _sure(applied(file, changes))


def _sure(machine: Machine) -> Machine:
    def known(body: Any, key: str) -> Any:
        length = Quantity(value=getattr(body, key).value, sd=0.002)
        return body.model_copy(update={key: length, "pair_yaw_sd": 0.02, "lever_sd": 0.002})

    wheel = machine.wheel_angle.model_copy(
        update={
            "zero": Quantity(value=machine.wheel_angle.zero.value, sd=0.01),
            "gain": Quantity(value=1.0, sd=0.001),
        }
    )
    receivers = [
        r.model_copy(
            update={
                "survey_sd": 0.002, "latency": Quantity(value=r.latency.value, sd=0.005),
                "roll_zero": Quantity(value=r.roll_zero.value if r.roll_zero else 0.0, sd=0.02),
            }
        )
        for r in machine.receiver
    ]  # fmt: skip
    return machine.model_copy(
        update={
            "tractor": known(machine.tractor, "c"), "implement": known(machine.implement, "d"),
            "receiver": receivers, "wheel_angle": wheel,
        }
    )  # fmt: skip


def machine_of(kept: dict[str, Any]) -> Machine:
    """Of a line of bench/calibration.py, which has NAMEs as numbers."""
    for receiver in kept["receiver"]:
        if isinstance(receiver["name"], int):
            receiver["name"] = f"{receiver['name']:016X}"
    return Machine.model_validate(kept)


def found_by(machine: Machine, log: Path) -> dict[str, list[float]]:
    """Method -> six logarithms and their sds at the end, not a number where it says none."""
    state, last, t_ns = fold.initial(machine), dict[str, Estimate](), 0

    def take(publications: Any) -> None:
        last.update({p.value.method: p.value for p in publications if isinstance(p.value, Estimate)})

    for frame in frames(log):
        t_ns = frame.t_ns
        take(fitted_at_once(state, t_ns))
        take(fold.step(state, frame))
        fold.request_fits(state, t_ns)
    take(fitted_at_once(state, t_ns + END_NS))
    fold.finish(state)
    fold.request_fits(state, t_ns)
    take(fitted_at_once(state, t_ns + END_NS))
    return {method: list(numbers(last[method])) for method in METHODS if method in last}


def rigs(kept: KeptLines, most: int) -> Iterator[tuple[str, int, int, dict[str, Any]]]:
    """(plant, log, rig, line), plants in turn, each log once."""
    lines = [(key, line) for key, line in kept.lines.items() if "machine" in line]
    once: dict[tuple[str, int], tuple[str, int, int, dict[str, Any]]] = {}
    for (_, plant, log, rig), line in lines:
        once.setdefault((plant, log), (plant, log, rig, line))
    yield from list(once.values())[:most]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--keep", type=Path, default=CACHE / "done.jsonl")
    parser.add_argument("--rigs", type=int, default=6)
    parser.add_argument("--minutes", type=float, default=math.inf, help="after which nothing new is begun")
    args = parser.parse_args()
    kept = KeptLines(args.keep, args.minutes)
    rows: dict[str, list[Array]] = {method: [] for method in METHODS}
    for plant, log, rig, line in rigs(kept, args.rigs):
        done = kept.of("soil", plant, log, rig)
        if done is None and kept.delay():
            break
        if done is None:
            path, truth = log_of(plant, log)
            logs = [math.log(truth["parameters"][name]) for name in PARAMETERS]
            done = {
                "true": logs, "calibrated": found_by(machine_of(line["machine"]), path),
                "right": found_by(right_file(truth), path),
            }  # fmt: skip
            kept.add("soil", plant, log, rig, done)
        for method in METHODS:
            by, right = (np.array(done[how].get(method, [])) for how in ("calibrated", "right"))
            if len(by) != 12 or len(right) != 12:
                print(f"{plant} log {log} rig {rig} {method}: says nothing")
                continue
            shift, ratio = (by[:6] - right[:6]) / right[6:], by[6:] / right[6:]
            rows[method].append(np.array([shift, ratio, (by[:6] - done["true"]) / by[6:]]))
            print(
                f"{plant} log {log} rig {rig} {method}: sds over those by the right file "
                f"{np.round(ratio, 2)}, shift in its sds {np.round(shift, 2)}",
                flush=True,
            )
    for method, found in rows.items():
        if found:
            _table(method, np.array(found))


def _table(method: str, found: Array) -> None:
    """found: (rigs, 3, 6)."""
    print(f"{method}, {len(found)} rigs")
    print("| parameter | median of sd over sd | mean shift, sd | rms shift, sd | error / sd, rms |")
    print("|---|---|---|---|---|")
    for k, name in enumerate(PARAMETERS):
        shift, ratio, error = (column[np.isfinite(column)] for column in found[:, :, k].T)
        if len(shift):
            print(
                f"| {name} | {np.median(ratio):.2f} | {np.mean(shift):.2f} | "
                f"{np.sqrt(np.mean(shift**2)):.2f} | {np.sqrt(np.mean(error**2)):.2f} |"
            )


if __name__ == "__main__":
    main()
