"""Machine files that are wrong in one number: what becomes of each, on four drives; right files for hours.

    python bench/wrong_files.py changes [--drive NAME] [--fleet N] [--every N] [--out FILE]
    python bench/wrong_files.py right --hours H [--fleet] [--out FILE]

--fleet N: also on N rigs of the virtual fleet, whose right files are those of their owners, by turns on the
four drives; of `right`: only on rigs of it, in the cells of bench/fleet_design.py.

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
from importlib import resources
from pathlib import Path
from typing import Any, Final

os.environ.setdefault("OMP_NUM_THREADS", "1")

from estimation_study import fitted_at_once
from fleet_design import cell_of
from fleet_design import scenario as scenario_in

from tilth.estimator import fold
from tilth.estimator.diagnosis import diagnosis
from tilth.estimator.diagnosis.consistency import CONTRADICTION
from tilth.schemas.decode import Decoder
from tilth.schemas.flow import PARAMETERS, Estimate, Event, Frame, Measurement, Publication, Status
from tilth.schemas.machine import Machine, MachineError
from tilth.schemas.machine_toml import parse_machine
from tilth.schemas.sentences import event_sentence, sentence
from tilth.simulator.fleet import drawn, headlands_of, scenario_of
from tilth.simulator.fleet_files import owners_text, text_of, true_machine
from tilth.simulator.scenario import (
    DrivenManoeuvre,
    Fieldwork,
    Ground,
    HeadlandTurn,
    Parameter,
    Scenario,
    Soil,
    Turns,
    parse_scenario,
)
from tilth.simulator.simulate import PACKAGED
from tilth.simulator.tractor import draw
from tilth.simulator.traffic import simulate

Raw = dict[str, Any]
FLEET: Final = "fleet-"  # before the number of a rig, as the name of a drive
PARKED: Final = (12.0, 0.0)
UNEVEN: Final = Ground(roll_sd_deg=0.7, force_sd=0.015)
FIELD: Final = Soil(grip=0.7, rolling=0.06)
SOFT: Final[Mapping[Parameter, float]] = {
    "C_af": 120e3,
    "C_ar": 330e3,
    "C_ai": 100e3,
    "sigma_f": 0.9,
    "sigma_r": 1.2,
    "sigma_i": 0.8,
}
SECONDS: Final = 100.0
BEYOND_SD: Final = 4.0  # a number that is further off is harm
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
    scaled: tuple[float, float] = (
        1.0,
        1.0,
    )  # of the tractor's and the implement's masses: only C over mass shows


def packaged() -> Raw:
    """The demo's file with every number that it may hold written out."""
    text = resources.files("tilth.deploy").joinpath(PACKAGED).read_text(encoding="utf-8")
    return written_out(tomllib.loads(text))


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
    "x -1": -1.0,
    "x 0.5": 0.5,
    "x 2": 2.0,
    "x 57.3": 57.3,
    "/ 57.3": 1 / 57.3,
    "x 1000": 1e3,
    "/ 1000": 1e-3,
}
PLUS: Final = {"length": ("+ 1 m", 1.0), "angle": ("+ 5 deg", 5.0)}
_GEOMETRY: Final = [*(f"tractor.{k}" for k in ("a", "b", "c")), "implement.d", "implement.e"]


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
        yield FileChange(
            f"all masses and inertias x {factor}",
            "mass",
            partial(_all_masses, factor=factor),
            (factor, factor),
        )


def _exchanges() -> Iterator[FileChange]:
    pairs: list[tuple[tuple[Any, ...], tuple[Any, ...], str]] = []
    pairs += [
        (("receiver", i, "name"), ("receiver", j, "name"), "names") for i in range(4) for j in range(i + 1, 4)
    ]
    pairs += [
        (("receiver", i, "position"), ("receiver", j, "position"), "places")
        for i in range(4)
        for j in range(i + 1, 4)
    ]
    pairs += [(("receiver", k, "position", 0), ("receiver", k, "position", 1), "places") for k in range(4)]
    pairs += [(("tractor", i), ("tractor", j), "places") for i, j in (("a", "b"), ("a", "c"), ("b", "c"))]
    pairs += [
        (("implement", "d"), ("implement", "e"), "places"),
        (("tractor", "c"), ("implement", "d"), "places"),
    ]
    pairs += [(("tractor", k), ("implement", k), "mass") for k in ("mass", "yaw_inertia")]
    pairs += [
        (("tyres", i), ("tyres", j), "tyres")
        for i, j in (("front", "rear"), ("front", "implement"), ("rear", "implement"))
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


class ReplayedDecoder(Decoder):
    """Returns the stored measurements of a drive again, for changes of the file that do not affect
    decoding."""

    def __init__(self, machine: Machine, reported: list[list[Measurement]]) -> None:
        super().__init__(machine)
        self._measurements = iter(reported)

    def measurements(self, frame: Frame) -> list[Measurement]:
        return next(self._measurements)


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
def driven(name: str) -> tuple[list[Frame], list[list[Measurement]], dict[str, float]]:
    """(frames that give measurements with the right file, these measurements, true parameters)."""
    right_one = named(name)
    machine, scenario = right_one.machine, right_one.scenario
    decoder = Decoder(parse_machine(text_of(right_one.raw)))
    all_frames = list(simulate(machine, scenario.seed, SECONDS, scenario))
    reported = [list(decoder.measurements(frame)) for frame in all_frames]
    used = [k for k, some in enumerate(reported) if some]
    return (
        [all_frames[k] for k in used],
        [reported[k] for k in used],
        draw(machine, scenario.seed, scenario),
    )


@dataclass
class SeenFlags:
    """What came of one drive with one file."""

    given: dict[str, list[tuple[float, tuple[float, ...]]]]  # method -> (s, error over sd of each, or nan)
    reasons: list[str]  # contradictions that stand at the end
    off: dict[str, list[float | None]]  # method -> natural log of what it gave last over the truth
    first: str = ""  # the first contradiction, and when
    first_s: float = math.nan


def drive(name: str, raw: Raw, scaled: tuple[float, float] = (1.0, 1.0)) -> SeenFlags:
    """Raises MachineError."""
    machine = parse_machine(text_of(raw))
    frames, reported, truth = driven(name)
    state = fold.initial(machine)
    base = named(name).raw
    if raw["wheel_angle"] == base["wheel_angle"] and not _decoded_otherwise(raw, base):
        state.decoder = ReplayedDecoder(machine, reported)
    out: list[Publication] = []
    for frame in frames:
        out += fitted_at_once(state, frame.t_ns)
        out += fold.step(state, frame)
        fold.request_fits(state, frame.t_ns)
    masses = (scaled[0], scaled[0], scaled[1], 1.0, 1.0, 1.0)
    logs = [math.log(truth[p] * m) for p, m in zip(PARAMETERS, masses, strict=True)]
    result = SeenFlags({}, [sentence(one.reason) for one in diagnosis.contradictions(state.diagnosis)], {})
    for publication in out:
        at_s, value = (publication.t_ns - frames[0].t_ns) * 1e-9, publication.value
        if isinstance(value, Event) and value.kind == CONTRADICTION and not result.first:
            result.first, result.first_s = event_sentence(value), at_s
        if isinstance(value, Estimate) and value.method != "pem_two_step":
            result.given.setdefault(value.method, []).append((at_s, _errors(value, logs)))
            result.off[value.method] = _off(value, logs)
    return result


def _decoded_otherwise(raw: Raw, base: Raw) -> bool:
    keys = ("name", "position_sd", "velocity_sd", "yaw_rate_sd", "heading_sd", "roll_sd")
    return any(a[k] != b[k] for a, b in zip(raw["receiver"], base["receiver"], strict=True) for k in keys)


def _errors(estimate: Estimate, logs: list[float]) -> tuple[float, ...]:
    return tuple(
        (math.log(p.value) - log) / (p.sd / p.value)
        if p.status is Status.ESTIMATED and p.value is not None and p.sd
        else math.nan
        for p, log in zip(estimate.parameters, logs, strict=True)
    )


def _off(estimate: Estimate, logs: list[float]) -> list[float | None]:
    return [
        round(math.log(p.value) - log, 4) if p.status is Status.ESTIMATED and p.value else None
        for p, log in zip(estimate.parameters, logs, strict=True)
    ]


# What becomes of a change.


@cache
def right(name: str) -> SeenFlags:
    return drive(name, named(name).raw)


def outcome(name: str, change: FileChange) -> dict[str, Any]:
    """One line of the table."""
    raw = copy.deepcopy(named(name).raw)
    change.apply(raw)
    line: dict[str, Any] = {"drive": name, "change": change.name, "group": change.group}
    try:
        result = drive(name, raw, change.scaled)
    except MachineError as error:
        return line | {"outcome": "refused", "reason": str(error)}
    except Exception as error:  # a fault is an outcome too, and the rest must go on
        return line | {"outcome": "fault", "reason": f"{type(error).__name__}: {error}"}
    worst, further, early_s = _worst(result, right(name))
    line |= {
        "worst": worst,
        "further": further,
        "early_s": early_s,
        "first_s": result.first_s,
        "first": result.first,
        "off": result.off,
    } | _harm(result)
    if result.reasons:
        is_named = any(part in reason for reason in result.reasons for part in GROUPS[change.group])
        return line | {
            "outcome": "withdrawn" if is_named else "elsewhere",
            "reason": "; ".join(result.reasons),
        }
    if not any(math.isfinite(z) for rows in result.given.values() for _, zs in rows for z in zs):
        return line | {"outcome": "no number"}
    if worst > 3.0 and further > 0.0:
        return line | {"outcome": "wrong"}
    return line | {"outcome": "right" if further <= 1.0 else "beyond 1 sd"}


def _worst(result: SeenFlags, base: SeenFlags) -> tuple[float, float, float]:
    """(largest error at the end, how much further off than with the right file, s with a wrong one out)."""
    worst = further = 0.0
    wrong: set[int] = set()
    for method, rows in result.given.items():
        for at_s, zs in rows:
            others = _nearest(base.given.get(method, []), at_s)
            for z, other in zip(zs, others, strict=True):
                if math.isfinite(z) and abs(z) > 3.0 and not abs(z) < abs(other) + 1.0:
                    wrong.add(round(at_s))
        for z, other in zip(rows[-1][1], base.given[method][-1][1], strict=True):
            if math.isfinite(z):
                worst = max(worst, abs(z))
                more = abs(z) - abs(other) if math.isfinite(other) else abs(z) - 2.0
                further = max(further, more)
    return worst, further, float(len(wrong))


def _harm(result: SeenFlags) -> dict[str, int]:
    given = [abs(z) for rows in result.given.values() for _, zs in rows for z in zs if math.isfinite(z)]
    return {"numbers": len(given), "beyond": sum(z > BEYOND_SD for z in given)}


def _nearest(rows: list[tuple[float, tuple[float, ...]]], at_s: float) -> tuple[float, ...]:
    return min(rows, key=lambda row: abs(row[0] - at_s))[1]


# Right files, for hours.


def right_drives(of_the_fleet: bool) -> Iterator[tuple[str, RightDrive]]:
    """(name, drive) without end."""
    for number in itertools.count() if of_the_fleet else ():
        rig, cell = drawn(number), cell_of(number)
        first = cell.manoeuvre.receivers
        raw, machine = tomllib.loads(owners_text(rig, first)), true_machine(rig, first)
        yield f"fleet-{number}, {cell.manoeuvre.name}", RightDrive(raw, machine, scenario_in(rig, cell))
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
                "C_af": 220e3,
                "C_ar": 486e3,
                "C_ai": 167e3 * load**0.8,
                "sigma_f": 1.1,
                "sigma_r": 1.5,
                "sigma_i": 1.1,
            }
            other = {p: v * (soils[kind] if p.startswith("C") else 1.0) for p, v in base.items()}
            soil = replace(scenario.soil, parameters=other, grip=max(scenario.soil.grip, 0.6))
            ground = replace(scenario.ground, slope_deg=max(scenario.ground.slope_deg, slope))
            drawn = replace(scenario, soil=soil, ground=ground, seed=seed, other_traffic=False)
            yield f"{name}, {kind}, slope {ground.slope_deg:g}, load {load:g}, seed {seed}", drawn, load


def right_run(name: str, one: RightDrive, seconds: float) -> dict[str, Any]:
    """Contradictions that a right file raises on one drive."""
    machine = parse_machine(text_of(one.raw))
    state, began, first_s, withheld_s, last_ns = fold.initial(machine), 0, math.nan, 0.0, 0
    events: list[tuple[float, str]] = []
    for frame in simulate(one.machine, one.scenario.seed, seconds, one.scenario):
        began = began or frame.t_ns
        out = fitted_at_once(state, frame.t_ns) + fold.step(state, frame)
        fold.request_fits(state, frame.t_ns)
        stiffnesses = state.estimates[fold.RECOMMENDED].parameters[:3]
        given = any(p.status is Status.ESTIMATED for p in stiffnesses)
        if given and math.isnan(first_s):
            first_s = (frame.t_ns - began) * 1e-9
        if not given and math.isfinite(first_s):
            withheld_s += (frame.t_ns - last_ns) * 1e-9
        last_ns = frame.t_ns
        events += [
            ((p.t_ns - began) * 1e-9, event_sentence(p.value))
            for p in out if isinstance(p.value, Event) and p.value.kind == CONTRADICTION
        ]  # fmt: skip
    return {
        "run": name, "seconds": seconds, "first_s": first_s, "withheld_s": withheld_s,
        "events": events,
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
    print(f"{numbers} numbers given, {beyond} of them beyond {BEYOND_SD:g} sd")
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
    for name, one in right_drives(bool(args.fleet)):
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
