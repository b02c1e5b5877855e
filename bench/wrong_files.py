"""Machine files that are wrong in one number: what becomes of each, on four drives; right files for hours.

    python bench/wrong_files.py changes [--drive NAME] [--fleet N] [--every N] [--out FILE]
    python bench/wrong_files.py right --hours H [--out FILE]

--fleet N: also on N rigs of the virtual fleet, whose right files are those of their owners, by turns on the
four drives. Right files of the fleet are rows of bench/fleet.py.

Results are lines of JSON in FILE; what is there is not done again. Each change ends as one of

refused      `parse_machine` says what is wrong
withdrawn    a contradiction that names the key or its group stands at the end, and no number
elsewhere    a contradiction stands, but its reason names another group
no number    nothing was ever given
right        every number is within 3 sd of the truth, and at most 1 sd further off than with the right file
beyond 1 sd  within 3 sd, but more than 1 sd further off
wrong        a number more than 3 sd off

and `early_s` says how many seconds a wrong number was out before it was withdrawn. `numbers` counts all that
were given, once a second and method, `beyond` those more than 4 of their sds from the truth: the harm done.
"""

import argparse
import copy
import itertools
import json
import math
import operator
import os
import sys
import time
import tomllib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any, Final

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from estimation_study import FAR, FIELD, METHODS, UNEVEN, Driven, followed, harm
from numpy.typing import NDArray

from tilth.estimator import fold
from tilth.estimator.diagnosis import diagnosis
from tilth.estimator.diagnosis.consistency import CONTRADICTION
from tilth.schemas.machine import Machine, MachineError
from tilth.schemas.machine_toml import parse_machine
from tilth.schemas.sentences import sentence
from tilth.simulator.drive import drive
from tilth.simulator.fleet import drawn, headlands_of, scenario_of
from tilth.simulator.fleet_files import owners_text, text_of, true_machine
from tilth.simulator.packaged import packaged_file
from tilth.simulator.scenario import (
    DrivenManoeuvre,
    Fieldwork,
    HeadlandTurn,
    Parameter,
    Scenario,
    Turns,
    parse_scenario,
)
from tilth.simulator.tractor import Truth

Array = NDArray[np.float64]
Raw = dict[str, Any]
FLEET: Final = "fleet-"  # before the number of a rig, as the name of a drive
PARKED: Final = (12.0, 0.0)
SOFT: Final[Mapping[Parameter, float]] = {
    "C_af": 120e3, "C_ar": 330e3, "C_ai": 100e3, "sigma_f": 0.9, "sigma_r": 1.2, "sigma_i": 0.8,
}  # fmt: skip
SECONDS: Final = 100.0
HEADLAND_TURNS: Final = (HeadlandTurn(18.0, 8.9), HeadlandTurn(6.1, 4.8))  # a U at 18 degrees, a loop at 32
DRIVES: Final = {
    "slope": Scenario(
        speed=(PARKED, (30.0, 3.5), (70.0, 4.5)), steering=Turns(angle_deg=(4.0, 7.0)), soil=FIELD,
        ground=replace(UNEVEN, slope_deg=5.0), other_traffic=False, seed=1,
    ),
    "random": Scenario(
        speed=(PARKED, (40.0, 4.5), (60.0, 3.5)), steering=DrivenManoeuvre("random"), soil=FIELD,
        ground=UNEVEN, other_traffic=False, seed=2,
    ),
    "soft": Scenario(
        speed=(PARKED, (30.0, 2.5), (70.0, 4.0)), steering=Turns(angle_deg=(6.0, 10.0), straight=(2.0, 5.0)),
        soil=replace(FIELD, parameters=SOFT), ground=UNEVEN, other_traffic=False, seed=3,
    ),
    "field": Scenario(
        speed=(PARKED, (88.0, 3.0)), steering=Fieldwork(length=60.0, turns=HEADLAND_TURNS),
        steering_limit_deg=32.5, soil=FIELD, ground=UNEVEN, other_traffic=False, seed=4,
    ),
}  # fmt: skip
"""All begin parked, as a rig does, and change their speed."""

GROUPS: Final = {
    "places": ("tractor.a", "tractor.b", "tractor.c", "implement.d", "implement.e", "position", "lengths"),
    "names": ("position", "name", "tractor.c", "implement.d"),
    "wheel": ("wheel_angle",),
    "time": ("latency", "delay", "position"),
    "mass": ("mass", "inertia"),
    "roll": ("roll_corrected", "position", "cg_height"),
    "tyres": ("tyre", "stiffness"),
    "sds": ("sd", "receiver"),
}
"""What a reason must name for a key of this group."""


@dataclass(frozen=True)
class FileChange:
    name: str
    group: str
    apply: Callable[[Raw], None]
    scaled: tuple[float, float] = (1.0, 1.0)
    """Of the tractor's and the implement's masses: only C over mass shows."""


def packaged() -> Raw:
    """The demo's file with every number that it may hold written out."""
    return written_out(tomllib.loads(packaged_file().text))


def written_out(raw: Raw) -> Raw:
    """Every number that it may hold, as `numbers` names them."""
    for body in ("tractor", "implement"):
        raw[body] |= {"cg_sd": 0.02, "pair_yaw_sd": 0.2}
    for receiver in raw["receiver"]:
        receiver |= {
            "survey_sd": receiver.get("survey_sd", 0.02),
            "position_sd": 0.025, "velocity_sd": 0.05, "yaw_rate_sd": 0.3, "roll_sd": 0.5,
            "heading_sd": 0.5, "latency": {"value": 0.1, "sd": 0.05},
            "roll_corrected": receiver.get("roll_corrected", False),
        }  # fmt: skip
    raw["wheel_angle"] |= {
        "offset": 0.0, "sign": 1, "gain": {"value": 1.0, "sd": 0.02}, "sd": 0.1,
    }  # fmt: skip
    return raw


# The changes.

TIMES: Final = {
    "x -1": -1.0, "x 0.5": 0.5, "x 2": 2.0, "x 57.3": 57.3, "/ 57.3": 1 / 57.3, "x 1000": 1e3, "/ 1000": 1e-3,
}  # fmt: skip
PLUS: Final = {"length": ("+ 1 m", 1.0), "angle": ("+ 5 deg", 5.0)}


def numbers() -> Iterator[tuple[tuple[str | int, ...], str, str]]:
    """(path, group, unit) of every number."""
    for key in ("a", "b", "c"):
        yield ("tractor", key), "places", "length"
    for key in ("d", "e"):
        yield ("implement", key), "places", "length"
    for body in ("tractor", "implement"):
        yield (body, "mass"), "mass", "mass"
        yield (body, "yaw_inertia"), "mass", "inertia"
        yield (body, "cg_height"), "roll", "length"
        yield (body, "cg_sd"), "sds", "sd"
        yield (body, "pair_yaw_sd"), "sds", "sd"
    yield ("implement", "mass", "sd"), "sds", "sd"
    for axle in ("front", "rear", "implement"):
        for key in ("cornering_stiffness", "relaxation_length", "log_sd"):
            yield ("tyres", axle, key), "tyres", "tyre"
    for k in range(4):
        yield ("receiver", k, "position", 0), "places", "length"
        yield ("receiver", k, "position", 1), "places", "length"
        yield ("receiver", k, "position", 2), "roll", "length"
        yield ("receiver", k, "latency"), "time", "time"
        yield ("receiver", k, "latency", "sd"), "sds", "sd"
        for key in ("survey_sd", "position_sd", "velocity_sd", "yaw_rate_sd", "roll_sd", "heading_sd"):
            yield ("receiver", k, key), "sds", "sd"
    for key, unit in (
        ("scale", "scale"), ("offset", "angle"), ("zero", "angle"), ("gain", "scale"), ("delay", "time"),
        ("sign", "sign"), ("bits", "count"), ("start_byte", "count"), ("not_available", "count"),
    ):  # fmt: skip
        yield ("wheel_angle", key), "wheel", unit
    for path in (("wheel_angle", "zero", "sd"), ("wheel_angle", "gain", "sd"), ("wheel_angle", "sd")):
        yield path, "sds", "sd"


def _set(raw: Raw, path: tuple[str | int, ...], how: Callable[[float], float]) -> None:
    node: Any = raw
    for part in path[:-1]:
        node = node[part]
    old = node[path[-1]]
    if isinstance(old, dict):
        node[path[-1]] = old | {"value": how(old["value"])}
    else:
        new = how(old)
        node[path[-1]] = int(new) if isinstance(old, int) and new == int(new) else new


def _exchange(raw: Raw, one: tuple[Any, ...], other: tuple[Any, ...]) -> None:
    def place(path: tuple[Any, ...]) -> tuple[Any, Any]:
        node: Any = raw
        for part in path[:-1]:
            node = node[part]
        return node, path[-1]

    (a, i), (b, j) = place(one), place(other)
    a[i], b[j] = b[j], a[i]


def changes() -> Iterator[FileChange]:
    """Every change that does something, in a fixed order."""
    for path, group, unit in numbers():
        name = ".".join(map(str, path))
        ways: dict[str, Callable[[float], float]] = {
            how: partial(operator.mul, factor) for how, factor in TIMES.items()
        }
        if unit in PLUS:
            how, more = PLUS[unit]
            ways[how] = partial(operator.add, more)
        for how, way in ways.items():
            before = packaged()
            after = copy.deepcopy(before)
            _set(after, path, way)
            if after != before:
                yield FileChange(f"{name} {how}", group, partial(_set, path=path, how=way))
    yield from _exchanges()
    for k in range(4):
        yield FileChange(f"receiver.{k}.roll_corrected not", "roll", partial(_exchange_roll, receiver=k))
    for factor in (0.5, 2.0):
        of_all = partial(_all_masses, factor=factor)
        yield FileChange(f"all masses and inertias x {factor}", "mass", of_all, (factor, factor))


def _exchanges() -> Iterator[FileChange]:
    two = list(itertools.combinations(range(4), 2))
    axles = itertools.combinations(("front", "rear", "implement"), 2)
    pairs: list[tuple[tuple[Any, ...], tuple[Any, ...], str]] = [
        *((("receiver", i, "name"), ("receiver", j, "name"), "names") for i, j in two),
        *((("receiver", i, "position"), ("receiver", j, "position"), "places") for i, j in two),
        *((("receiver", k, "position", 0), ("receiver", k, "position", 1), "places") for k in range(4)),
        *((("tractor", i), ("tractor", j), "places") for i, j in itertools.combinations("abc", 2)),
        (("implement", "d"), ("implement", "e"), "places"),
        (("tractor", "c"), ("implement", "d"), "places"),
        *((("tractor", k), ("implement", k), "mass") for k in ("mass", "yaw_inertia")),
        *((("tyres", i), ("tyres", j), "tyres") for i, j in axles),
    ]
    for one, other, group in pairs:
        name = f"{'.'.join(map(str, one))} <> {'.'.join(map(str, other))}"
        before = packaged()
        after = copy.deepcopy(before)
        _exchange(after, one, other)
        if after != before:
            yield FileChange(name, group, partial(_exchange, one=one, other=other))


def _exchange_roll(raw: Raw, receiver: int) -> None:
    one = raw["receiver"][receiver]
    one["roll_corrected"] = not one["roll_corrected"]


def _all_masses(raw: Raw, factor: float) -> None:
    for body in ("tractor", "implement"):
        for key in ("mass", "yaw_inertia"):
            _set(raw, (body, key), partial(operator.mul, factor))


# The drives.


@dataclass(frozen=True)
class RightDrive:
    """A drive, with the file that is right of it."""

    raw: Raw
    machine: Machine  # as it is
    scenario: Scenario


@cache
def named(name: str) -> RightDrive:
    """One of DRIVES, or "fleet-N": rig N of the fleet on one of them."""
    if name in DRIVES:
        return RightDrive(packaged(), parse_machine(text_of(packaged())), DRIVES[name])
    number = int(name.removeprefix(FLEET))
    rig, scenario = drawn(number), list(DRIVES.values())[number % len(DRIVES)]
    if isinstance(scenario.steering, Fieldwork):
        scenario = replace(scenario, steering=replace(scenario.steering, turns=headlands_of(rig)))
    raw = written_out(tomllib.loads(owners_text(rig)))
    return RightDrive(raw, true_machine(rig), scenario_of(rig, replace(scenario, seed=number)))


@cache
def driven(name: str) -> Truth:
    one = named(name)
    return drive(one.machine, one.scenario.seed, SECONDS, one.scenario)


@dataclass
class SeenFlags:
    """What came of one drive with one file."""

    rows: dict[str, Array]  # of METHODS, as Followed.series
    logs: Array  # (6,) true logarithms, as far as this file can show them
    reasons: list[str]  # contradictions that stand at the end
    first: tuple[float, str]  # the first contradiction: s, sentence

    def z(self, method: str) -> Array:
        """Errors over sds, (m, 6)."""
        rows = self.rows[method]
        return np.asarray((rows[:, 1:7] - self.logs) / rows[:, 7:13], np.float64)


def seen(name: str, raw: Raw, scaled: tuple[float, float] = (1.0, 1.0)) -> SeenFlags:
    """Raises MachineError."""
    states = list[fold.State]()
    run = Driven(parse_machine(text_of(raw)), driven(name), named(name).machine)
    heard = followed(run, lambda state, estimate: states.append(state))
    said = [(at_s, text) for at_s, kind, text in heard.events if kind == CONTRADICTION]
    return SeenFlags(
        {method: heard.series[method] for method in METHODS if method in heard.series},
        heard.logs + np.log([scaled[0], scaled[0], scaled[1], 1.0, 1.0, 1.0]),
        [sentence(one.reason) for one in diagnosis.contradictions(states[-1].diagnosis)] if states else [],
        said[0] if said else (math.nan, ""),
    )


# What becomes of a change.


@cache
def right(name: str) -> SeenFlags:
    return seen(name, named(name).raw)


def outcome(name: str, change: FileChange) -> dict[str, Any]:
    """One line of the table."""
    raw = copy.deepcopy(named(name).raw)
    change.apply(raw)
    line: dict[str, Any] = {"drive": name, "change": change.name, "group": change.group}
    try:
        result = seen(name, raw, change.scaled)
    except MachineError as error:
        return line | {"outcome": "refused", "reason": str(error)}
    except Exception as error:  # a fault is an outcome too, and the rest must go on
        return line | {"outcome": "fault", "reason": f"{type(error).__name__}: {error}"}
    worst, further, early_s = _worst(result, right(name))
    given, beyond = np.sum([harm(rows, result.logs) for rows in result.rows.values()], axis=0)
    line |= {
        "worst": worst, "further": further, "early_s": early_s, "first_s": result.first[0],
        "first": result.first[1], "numbers": int(given), "beyond": int(beyond),
    }  # fmt: skip
    if result.reasons:
        is_named = any(part in reason for reason in result.reasons for part in GROUPS[change.group])
        return line | {
            "outcome": "withdrawn" if is_named else "elsewhere", "reason": "; ".join(result.reasons),
        }  # fmt: skip
    if not given:
        return line | {"outcome": "no number"}
    if worst > 3.0 and further > 0.0:
        return line | {"outcome": "wrong"}
    return line | {"outcome": "right" if further <= 1.0 else "beyond 1 sd"}


def _worst(result: SeenFlags, base: SeenFlags) -> tuple[float, float, float]:
    """(largest error at the end, how much further off than with the right file, s with a wrong one out)."""
    worst = further = 0.0
    wrong: set[int] = set()
    for method, rows in result.rows.items():
        z, times = np.abs(result.z(method)), base.rows[method][:, 0]
        others = np.abs(base.z(method)[np.argmin(np.abs(times[:, None] - rows[:, 0]), axis=0)])
        far = (z > 3.0) & ~(z < others + 1.0)
        wrong.update(np.round(rows[far.any(axis=1), 0]).astype(int).tolist())
        more = z[-1] - np.where(np.isfinite(others[-1]), others[-1], 2.0)
        worst, further = (float(np.nanmax([most, *new])) for most, new in ((worst, z[-1]), (further, more)))
    return worst, further, float(len(wrong))


# Right files, for hours.


def right_drives() -> Iterator[tuple[str, RightDrive]]:
    """(name, drive) without end."""
    for name, scenario, load in right_scenarios():
        raw = packaged()
        raw["implement"]["mass"] = {"value": 2127.0 * load, "sd": 200.0}
        raw["implement"]["yaw_inertia"] = 6402.0 * load
        yield name, RightDrive(raw, parse_machine(text_of(raw)), scenario)


def right_scenarios() -> Iterator[tuple[str, Scenario, float]]:
    """(name, scenario, load on the implement's mass) without end: all scenarios, soils, slopes, loads."""
    folder = Path(__file__).resolve().parents[1] / "examples" / "scenarios"
    plain = [
        (path.stem, parse_scenario(path.read_text(encoding="utf-8")))
        for path in sorted(folder.glob("*.toml")) if path.stem not in ("swapped", "bad_day", "kingpin")
    ]  # fmt: skip
    soils = {"soft": 0.5, "as usual": 1.0, "hard": 1.7}
    for seed in range(1, 1000):
        for k, (name, scenario) in enumerate(plain):
            kind = list(soils)[(seed + k) % 3]
            slope, load = (0.0, 2.0, 4.0)[(seed + 2 * k) % 3], (1.0, 2.5)[(seed + k) % 2]
            base: dict[Parameter, float] = {
                "C_af": 220e3, "C_ar": 486e3, "C_ai": 167e3 * load**0.8,
                "sigma_f": 1.1, "sigma_r": 1.5, "sigma_i": 1.1,
            }  # fmt: skip
            other = {p: v * (soils[kind] if p.startswith("C") else 1.0) for p, v in base.items()}
            soil = replace(scenario.soil, parameters=other, grip=max(scenario.soil.grip, 0.6))
            ground = replace(scenario.ground, slope_deg=max(scenario.ground.slope_deg, slope))
            drawn = replace(scenario, soil=soil, ground=ground, seed=seed, other_traffic=False)
            yield f"{name}, {kind}, slope {ground.slope_deg:g}, load {load:g}, seed {seed}", drawn, load


def right_run(name: str, one: RightDrive, seconds: float) -> dict[str, Any]:
    """Contradictions that a right file raises on one drive."""
    truth = drive(one.machine, one.scenario.seed, seconds, one.scenario)
    heard = followed(Driven(parse_machine(text_of(one.raw)), truth, one.machine))
    rows = heard.series[METHODS[0]]
    given, lasted = np.isfinite(rows[:, 1:4]).any(axis=1), np.diff(rows[:, 0], append=rows[-1, 0])
    first_s = float(rows[np.argmax(given), 0]) if given.any() else math.nan
    return {
        "run": name, "seconds": seconds, "first_s": first_s,
        "withheld_s": float(lasted[~given & (rows[:, 0] > first_s)].sum()),
        "events": [(at_s, text) for at_s, kind, text in heard.events if kind == CONTRADICTION],
    }  # fmt: skip


# The table.


def _known(path: Path, key: str) -> set[str]:
    if not path.exists():
        return set()
    return {json.loads(line)[key] for line in path.read_text(encoding="utf-8").splitlines()}


def _one(job: tuple[str, int]) -> dict[str, Any]:
    name, k = job
    change = list(changes())[k]
    return outcome(name, change) | {"id": f"{name} {change.name}"}


def _hour(job: tuple[str, RightDrive, float]) -> dict[str, Any]:
    return right_run(*job)


def _all(jobs: list[Any], work: Callable[[Any], dict[str, Any]], path: Path, processes: int) -> None:
    began = time.monotonic()
    with path.open("a", encoding="utf-8") as out, ProcessPoolExecutor(processes) as pool:
        for k, line in enumerate(pool.map(work, jobs, chunksize=4), 1):
            print(json.dumps(line), file=out, flush=True)
            remaining_s = (time.monotonic() - began) / k * (len(jobs) - k)
            print(f"\r{k} of {len(jobs)}, {remaining_s / 60:.0f} min left ", end="", file=sys.stderr)


def summary(path: Path) -> None:
    """The share of each outcome, and every line that should not be."""
    lines = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    for drive_name in (*dict.fromkeys(line["drive"] for line in lines), None):
        some = [line for line in lines if drive_name in (None, line["drive"])]
        counts = Counter(line["outcome"] for line in some)
        shares = ", ".join(f"{kind} {n} ({100 * n / len(some):.1f} %)" for kind, n in counts.most_common())
        print(f"{drive_name or 'all'}: {len(some)}: {shares}")
    numbers, beyond = (sum(line.get(key, 0) for line in lines) for key in ("numbers", "beyond"))
    print(f"{numbers} numbers given, {beyond} of them beyond {FAR[0]:g} sd")
    for line in lines:
        if line["outcome"] in ("wrong", "elsewhere", "beyond 1 sd", "fault") or line.get("early_s"):
            far = f"worst {line.get('worst', math.nan):.1f}, further {line.get('further', math.nan):.1f}"
            said = line.get("reason", line.get("first", ""))[:90]
            print(f"{line['outcome']:12} {line['id']}: {far}, early {line.get('early_s', 0):.0f} s; {said}")


def summary_right(path: Path) -> None:
    lines = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    hours = sum(line["seconds"] for line in lines) / 3600.0
    wrong = [line for line in lines if line["events"]]
    sure = sorted(line["first_s"] for line in lines if math.isfinite(line["first_s"]))
    print(f"{hours:.1f} h in {len(lines)} drives; contradictions in {len(wrong)}")
    if sure:
        print(
            f"a stiffness in {len(sure)} of them, after {sure[len(sure) // 2]:.0f} s (median), "
            f"{sure[-1]:.0f} s at most"
        )
        after = sum(line["seconds"] - line["first_s"] for line in lines if math.isfinite(line["first_s"]))
        print(f"then none for {100 * sum(line['withheld_s'] for line in lines) / after:.2f} % of the time")
    for line in wrong:
        print(f"  {line['run']}: {line['events'][0]}")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("row", choices=("changes", "right"))
    parser.add_argument("--drive", choices=tuple(DRIVES), action="append")
    parser.add_argument("--fleet", type=int, nargs="?", const=1, default=0, help="rigs of the fleet")
    parser.add_argument("--every", type=int, default=1, help="only each N-th change, on all drives")
    parser.add_argument("--hours", type=float, default=20.0)
    parser.add_argument("--seconds", type=float, default=180.0, help="of each right drive")
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--summary", action="store_true", help="only read what is there")
    args = parser.parse_args()
    path = args.out or Path(f"wrong_files_{args.row}.jsonl")
    if args.row == "changes":
        every = [
            (name, k, f"{name} {c.name}")
            for k, c in list(enumerate(changes()))[:: args.every]
            for name in (*(args.drive or DRIVES), *(f"{FLEET}{number}" for number in range(args.fleet)))
        ]
        done = _known(path, "id")
        jobs = [(name, k) for name, k, known in every if known not in done]
        if not args.summary:
            _all(jobs, _one, path, args.processes)
        summary(path)
        return
    done, rows, remaining = _known(path, "run"), [], args.hours * 3600.0
    for name, one in right_drives():
        if remaining <= 0.0:
            break
        remaining -= args.seconds
        if name not in done:
            rows.append((name, one, args.seconds))
    if not args.summary:
        _all(rows, _hour, path, args.processes)
    summary_right(path)


if __name__ == "__main__":
    main()
