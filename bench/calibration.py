"""How well `tilth calibrate` does on wrong rigs: numbers within their sds, sds, structural faults, soil.

    python bench/calibration.py [--plant planar spatial fleet] [--logs 7] [--rigs 10] [--faults 10]
        [--first 0] [--keep DONE.jsonl] [--minutes 600]

Logs of examples/scenarios/calibration_drive.toml, of rigs that differ, are made once and kept in
~/.cache/tilth/calibration; those of `fleet` are of rigs of the virtual fleet, in space. A wrong rig is a
wrong machine file: the log is of the right one. Each is printed as soon as it is there; the table of the
issue comes at the end. What is done is kept in DONE.jsonl, a line each, and not done again, with the
calibrated machine files for bench/calibrated_soil.py.
"""

import argparse
import itertools
import json
import math
import pickle
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from tilth.analysis.calibration.reading import read
from tilth.analysis.calibration.run import reread
from tilth.estimator.calibration.calibrate import Calibration, CannotCalibrate, calibrate, look
from tilth.estimator.calibration.calibrated_file import calibrated_machine
from tilth.estimator.calibration.changes import Changes, Linkage, applied, heard_after, linkage_of
from tilth.estimator.calibration.drive import MOUNTS
from tilth.estimator.calibration.linkage import KINGPIN
from tilth.estimator.calibration.sought_numbers import SOUGHT
from tilth.estimator.calibration.verdict import IDENTIFIED, RigVerdict, verdict
from tilth.replay.readers.any_log import open_log
from tilth.schemas.decode import Decoder
from tilth.schemas.flow import Frame, Measurement
from tilth.schemas.machine import Machine
from tilth.schemas.machine_toml import parse_machine
from tilth.simulator.fleet import drawn, scenario_of
from tilth.simulator.fleet_files import owners_text, true_machine
from tilth.simulator.packaged import packaged_file
from tilth.simulator.scenario import Spatial, as_json, from_json, parse_scenario
from tilth.simulator.simulate import SimulationInput, simulate_to

Array = NDArray[np.float64]

FLEET: Final = "fleet"
CACHE: Final = Path.home() / ".cache" / "tilth" / "calibration"
ROOT: Final = Path(__file__).resolve().parents[1]
STRUCTURE: Final = (
    "none", "reversed_tractor", "reversed_implement", "bodies", "wheel_sign", "yaw_rate_sign", "roll_sign",
    "roll_corrected", "byte_order", "scale", "kingpin",
)  # fmt: skip
FOUND_AS: Final = {
    "reversed_tractor": "reversed_pair", "reversed_implement": "reversed_pair", "bodies": "swapped",
    "wheel_sign": "wheel_sign", "yaw_rate_sign": "yaw_rate_sign", "roll_sign": "roll_sign",
    "roll_corrected": "roll_corrected", "byte_order": "wheel_byte_order", "scale": "wheel_scale",
    "kingpin": KINGPIN,
}  # fmt: skip


def right_file(plant: str, seed: int) -> tuple[Machine, str]:
    """That of a log: the demo's, or one of the fleet with the true numbers and its owner's sds."""
    if plant != FLEET:
        return packaged_file()
    text = owners_text(drawn(seed), exact=True)
    return parse_machine(text), text


def log_of(plant: str, seed: int) -> tuple[Path, list[Measurement], dict[str, Any]]:
    """A log, what the right machine file makes of it, and what was true; made unless it is kept."""
    machine, text = right_file(plant, seed)
    path = CACHE / f"{plant}-{seed}.mcap"
    scenario_text = (ROOT / "examples/scenarios/calibration_drive.toml").read_text(encoding="utf-8")
    scenario = parse_scenario(scenario_text)
    if plant == "spatial":
        scenario = replace(scenario, plant="spatial", spatial=Spatial(draw=True))
    driven = None
    if plant == FLEET:
        rig = drawn(seed)
        driven, scenario = true_machine(rig), scenario_of(rig, replace(scenario, plant="spatial"))
    scenario = from_json(as_json(scenario))
    if not path.exists():
        CACHE.mkdir(parents=True, exist_ok=True)
        part = CACHE / f"part-{plant}-{seed}.mcap"
        for old in CACHE.glob(f"{part.name}*"):
            old.unlink()
        simulate_to(
            SimulationInput(machine, text, scenario, scenario_text, seed, scenario.seconds, driven), part,
            lambda what, at_s: None,
        )  # fmt: skip
        for made in CACHE.glob(f"{part.name}*"):
            made.rename(CACHE / made.name.removeprefix("part-"))
    kept = path.with_suffix(".measurements")
    if not kept.exists():
        decoder, found = Decoder(machine), list[Measurement]()
        log = open_log(path)
        with log.file:
            for record in log.records:
                if isinstance(record, Frame):
                    found += decoder.measurements(record)
        kept.write_bytes(pickle.dumps(found))
    truth = json.loads(Path(f"{path}.truth.json").read_text(encoding="utf-8"))
    return path, pickle.loads(kept.read_bytes()), truth


def wrong_rig(rng: np.random.Generator) -> Changes:
    """As wrong as people are: uniform within the issue's limits."""
    return Changes(
        delay=np.full(4, rng.uniform(-0.1, 0.1)),
        forward=rng.uniform(-0.2, 0.2, 2),
        lateral_offset=rng.uniform(-0.2, 0.2, 2),
        pair=np.radians(rng.uniform(-3.0, 3.0, 2)),
        hitch=rng.uniform(-0.2, 0.2, 2),
        wheel_zero=math.radians(rng.uniform(-5.0, 5.0)),
        wheel_gain=math.exp(rng.uniform(-0.15, 0.15)),
        roll_zero=np.radians(rng.uniform(-3.0, 3.0, 4)),
        linkage=Linkage(curve=rng.uniform(-0.1, 0.1)),
    )


def structural(kind: str, machine: Machine, rng: np.random.Generator) -> Changes:
    """A file with one structural fault and small errors."""
    changes = replace(wrong_rig(rng), delay=np.full(4, rng.uniform(-0.05, 0.05)))
    one = int(rng.integers(4))
    signs = tuple(-1 if k == one else 1 for k in range(4))
    if kind == "reversed_tractor":
        return replace(changes, assignment=(1, 0, 2, 3))
    if kind == "reversed_implement":
        return replace(changes, assignment=(0, 1, 3, 2))
    if kind == "bodies":
        return replace(changes, assignment=[(2, 1, 0, 3), (2, 3, 0, 1), (0, 3, 2, 1), (3, 1, 2, 0)][one])
    if kind == "kingpin":
        place = ("left", "right")[one % 2]
        return replace(changes, linkage=linkage_of(machine, place))
    if kind == "wheel_sign":
        return replace(changes, wheel_sign=-1)
    if kind == "yaw_rate_sign":
        return replace(changes, yaw_rate_sign=signs)
    if kind == "roll_sign":
        return replace(changes, roll_sign=signs)
    if kind == "scale":
        return replace(changes, wheel_gain=float(rng.choice([0.1, 0.5, 2.0, 10.0])))
    return changes


def true_numbers(truth: dict[str, Any], machine: Machine) -> dict[str, float]:
    """What each number of a file must be so that it is right, as `file_numbers`."""
    told, rig = truth["nuisances"], {name: row["value"] for name, row in truth["rig"].items()}
    places = {}
    for body in ("tractor", "implement"):
        pair = {r.mount.value: np.array(r.position[:2]) for r in machine.receiver if r.mount.body == body}
        middle = np.mean(list(pair.values()), axis=0)
        cosine, sine = math.cos(told[f"pair_{body}"]), math.sin(told[f"pair_{body}"])
        for mount, at in pair.items():
            turned = middle + np.array([[cosine, -sine], [sine, cosine]]) @ (at - middle)
            own = np.array(
                [told[f"{axis}_{mount}"] - told[f"cg_{axis}_{body}"] for axis in ("forward", "right")]
            )
            places[mount] = turned + own
    delay = [told[f"latency_{mount.value}"] for mount in MOUNTS]
    return {
        **_of_places(places, rig["b"], rig["e"]),
        "c": rig["c"] - rig["b"],
        "d": rig["d"] + rig["e"],
        "wheel_zero": told["wheel_zero"],
        "wheel_gain": math.log(told["wheel_gain"]),
        "wheel_curve": 0.0,
        "ackermann": truth["vehicle"]["ackermann"] if "vehicle" in truth else 1.0,
        "latency": float(np.mean(delay)),  # the poses take the first of arrival times (pose/epoch_clock.py)
        **{f"roll_zero_{mount.value}": told[f"roll_zero_{mount.value}"] for mount in MOUNTS},
    }


def file_numbers(machine: Machine, right: Machine) -> dict[str, float]:
    """The same of a machine file. What tape and scale tell, a, b and e, stays as the file says: so levers,
    hitch and drawbar count from the axles. right: the file that reads the wheel angle as it is sent."""
    places = {r.mount.value: np.array(r.position[:2]) for r in machine.receiver}
    wheel, given = machine.wheel_angle, right.wheel_angle
    ratio = wheel.sign * wheel.scale / given.scale
    return {
        **_of_places(places, machine.tractor.b.value, machine.implement.e.value),
        "c": machine.tractor.c.value - machine.tractor.b.value,
        "d": machine.implement.d.value + machine.implement.e.value,
        "wheel_zero": math.radians(wheel.zero.value) / ratio,
        "wheel_gain": -math.log(abs(ratio)),
        "wheel_curve": wheel.curve.value,
        "ackermann": machine.tractor.ackermann.value,
        "latency": float(np.mean([r.latency.value for r in machine.receiver])),
        **{
            f"roll_zero_{r.mount.value}": math.radians(r.roll_zero.value if r.roll_zero else 0.0)
            for r in machine.receiver
        },
    }


def _of_places(places: dict[str, Array], b: float, e: float) -> dict[str, float]:
    front_t, rear_t, front_i, rear_i = (places[mount.value] for mount in MOUNTS)
    arms, middles = (front_t - rear_t, front_i - rear_i), ((front_t + rear_t) / 2, (front_i + rear_i) / 2)
    return {
        "pair_t": math.atan2(arms[0][1], arms[0][0]), "pair_i": math.atan2(arms[1][1], arms[1][0]),
        "aside_t": float(middles[0][1]), "aside_i": float(middles[1][1] - middles[0][1]),
        "lever_t": float(middles[0][0]) + b, "lever_i": float(middles[1][0]) + e,
    }  # fmt: skip


Errors = dict[str, tuple[float, float]]
"""Number -> (error, sd)."""


def one_rig(plant: str, log: int, rig: int) -> tuple[Calibration, RigVerdict, Errors, Machine]:
    """(found, judged, errors of what is told, the machine file as it is written)."""
    right, _ = right_file(plant, log)
    _, measurements, truth = log_of(plant, log)
    bad = wrong_rig(np.random.default_rng([17, rig]))
    wrong = applied(right, bad)
    found = calibrate(wrong, [heard_after(m, bad) for m in measurements], lambda what, share: None)
    judged = verdict(wrong, found)
    true, has = true_numbers(truth, right), file_numbers(found.machine, right)
    # The calibrated file says what its own numbers are; sds are those that are published.
    errors = {
        one.number.name: (has[one.number.name] - true[one.number.name], one.sd) for one in judged.numbers
    }
    return found, judged, errors, calibrated_machine(wrong, found, judged)


class KeptLines:
    """What is done, in a file of JSON lines, so that it can be interrupted and gone on with."""

    def __init__(self, path: Path, minutes: float) -> None:
        self._path, self._end = path, time.monotonic() + 60.0 * minutes
        lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
        self.lines: dict[tuple[Any, ...], dict[str, Any]] = {}
        for key, value in map(json.loads, lines):
            self.lines[tuple(key)] = value

    def of(self, *key: Any) -> dict[str, Any] | None:
        return self.lines.get(key)

    def delay(self) -> bool:
        """Whether nothing new is to be begun."""
        return time.monotonic() > self._end

    def add(self, what: str, plant: str, log: int, rig: int | str, value: dict[str, Any]) -> None:
        self._path.parent.mkdir(parents=True, exist_ok=True)
        with self._path.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps([[what, plant, log, rig], value]) + "\n")
        self.lines[what, plant, log, rig] = value


def numbers(plants: Sequence[str], logs: int, rigs: Sequence[int], kept: KeptLines) -> None:
    """Shares within 2 published sds and median sds; each rig on a log of its own as far as there are."""
    errors: dict[str, list[tuple[float, float]]] = defaultdict(list)
    for rig, plant in itertools.product(rigs, plants):
        line = kept.of("numbers", plant, rig % logs + 1, rig)
        if line is None and kept.delay():
            break
        if line is None:
            began = time.process_time()
            try:
                found, judged, mine, told = one_rig(plant, rig % logs + 1, rig)
            except CannotCalibrate as error:
                print(f"{plant} rig {rig}: refused: {error}", flush=True)
                continue
            line = {
                "seconds": time.process_time() - began, "p": judged.p, "errors": mine,
                "told": sum(one.status == IDENTIFIED for one in judged.numbers),
                "innovations": found.fit.residual,
                "settled": found.fit.settled, "faults": [fault.kind for fault in found.faults],
                "machine": told.model_dump(mode="json"),
            }  # fmt: skip
            kept.add("numbers", plant, rig % logs + 1, rig, line)
        off = {name: f"{error / sd:.1f}" for name, (error, sd) in line["errors"].items()}
        print(
            f"{plant} log {rig % logs + 1} rig {rig}: {line['seconds']:.0f} s, {line['told']} told, halves p "
            f"{line['p']:.2g}, innovations {line['innovations']:.2f}, settled {line['settled']}, "
            f"{line['faults']}, off {off}",
            flush=True,
        )
        for name, pair in line["errors"].items():
            errors[name].append(pair)
            errors[f"{plant} {name}"].append(pair)
    _table(errors)


def _table(errors: dict[str, list[tuple[float, float]]]) -> None:
    print("| number | within 2 sd | median sd | wanted | rms error | rms error/sd, mean error/sd |")
    print("|---|---|---|---|---|---|")
    every: list[float] = []
    for number in SOUGHT:
        for key in (number.name, *(f"{plant} {number.name}" for plant in ("planar", "spatial", FLEET))):
            rows = np.array(errors.get(key, [])).reshape(-1, 2)
            if not len(rows):
                continue
            z = rows[:, 0] / rows[:, 1]
            every += z.tolist() if key == number.name else []
            per, unit = number.per_unit, number.unit
            sd, rms = np.median(rows[:, 1]) / per, np.sqrt(np.mean(rows[:, 0] ** 2)) / per
            print(
                f"| {key} | {np.mean(np.abs(z) <= 2):.0%} of {len(z)} | {sd:.3g} {unit} | "
                f"{number.wanted_sd / per:.3g} {unit} | {rms:.3g} {unit} | "
                f"{np.sqrt(np.mean(z**2)):.2f}, {np.mean(z):.2f} |"
            )
    if every:
        print(f"pooled: {np.mean(np.abs(every) <= 2):.1%} of {len(every)}")


def faults(plants: Sequence[str], logs: int, count: int, kept: KeptLines) -> None:
    """How often each structural fault is found, and what is found beside it."""
    for kind in STRUCTURE:
        hits, other, of = 0, list[str](), 0
        for plant in plants:
            for k in range(count):
                line = kept.of(kind, plant, k % logs + 1, k)
                if line is None and kept.delay():
                    continue
                if line is None:
                    path, measurements, _ = log_of(plant, k % logs + 1)
                    right, _ = right_file(plant, k % logs + 1)
                    line = {"kinds": sorted(set(_kinds(kind, k, right, path, measurements)))}
                    kept.add(kind, plant, k % logs + 1, k, line)
                kinds = set(line["kinds"])
                wanted = FOUND_AS.get(kind)
                of += 1
                hits += wanted in kinds if wanted else not kinds
                other += sorted(kinds - {wanted})
        print(f"{kind}: {hits} of {of}; beside it: {other}", flush=True)


def _found_in_log(path: Path, machine: Machine) -> list[str]:
    """What is structurally wrong, as `calibrate_logs` goes about it, without the numbers."""
    heard = read([path], machine, {}, lambda said: None, lambda done, of: None)
    try:
        return [fault.kind for fault in look(machine, heard.measurements)]
    except CannotCalibrate as error:
        better = reread(machine, heard, error)
        if better is None:
            raise
        described, fault, _ = better
        again = read([path], described, {}, lambda said: None, lambda done, of: None)
        return [fault.kind, *(one.kind for one in look(described, again.measurements))]


def _kinds(kind: str, k: int, right: Machine, path: Path, measurements: list[Measurement]) -> Iterator[str]:
    bad = structural(kind, right, np.random.default_rng([99, k, STRUCTURE.index(kind)]))
    wrong = applied(right, bad)
    if kind == "byte_order":
        wheel = right.wheel_angle.model_copy(update={"byte_order": "little"})
        machine = right.model_copy(update={"wheel_angle": wheel})
        yield from _found_in_log(path, machine)
        return
    if kind == "roll_corrected":
        one = k % 4
        corrected = tuple((not r.roll_corrected) if j == one else None for j, r in enumerate(right.receiver))
        wrong = applied(right, replace(bad, roll_corrected=corrected))
    try:
        yield from (fault.kind for fault in look(wrong, [heard_after(m, bad) for m in measurements]))
    except CannotCalibrate as error:
        yield from (fault.kind for fault in error.faults)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--plant", nargs="+", default=["planar", "spatial", FLEET])
    parser.add_argument("--logs", type=int, default=20)
    parser.add_argument("--rigs", type=int, default=10)
    parser.add_argument("--first", type=int, default=0, help="the rig to begin with")
    parser.add_argument("--faults", type=int, default=10)
    parser.add_argument("--keep", type=Path, default=CACHE / "done.jsonl", help="file of what is done")
    parser.add_argument("--minutes", type=float, default=math.inf, help="after which nothing new is begun")
    args = parser.parse_args()
    kept = KeptLines(args.keep, args.minutes)
    if args.faults:
        faults(args.plant, args.logs, args.faults, kept)
    if args.rigs:
        numbers(args.plant, args.logs, range(args.first, args.first + args.rigs), kept)


if __name__ == "__main__":
    main()
