"""Is another load of the implement told from other soil, and do intervals hold? Drives drawn anew.

    python bench/loads.py [--count 12] [--first 0] [--row told] [--fleet] [--plant spatial]

Each drive of 110 s turns to and fro, with soil, rig and sensors by its seed; at 60 s something changes,
over 5 s. Rows: `told`, unloading from 8.5 t to 2.1 t that the operator says, n = 0.7; `unsaid`, the same
where nobody says the load at any time; `soil`, all stiffnesses × 0.6 with a load that nobody says; `linear`,
as `unsaid` with n = 1; `stop`, as `unsaid`, but unloaded within a stop of 30 s; `pause` and `gate`, a stop of
30 and of 8 s in which nothing changes. One line for each drive: events of load and of soil after the change,
how far what is recommended for C_ai over the mass is off just before the change, 20 s after it (after a stop,
of driving) and at the end, in published sds, with the sds of C_af and C_ar over the tractor's mass; and the
furthest of the numbers given for C_af, C_ar and C_ai. --fleet: rigs of the fleet with implements of 1 to 3 t,
which carry three times as much, instead of the packaged rig; numbers of rigs that are not so light are left
out. --plant spatial: bodies and tyres in space, which follow their loads of themselves, on 1 cm rms.
"""

import math
from argparse import ArgumentParser
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final, Literal, NamedTuple, get_args

import numpy as np
from estimation_study import FIELD, UNEVEN, fitted_at_once

from tilth.estimator import fold
from tilth.schemas.flow import PARAMETERS, Carried, Estimate, Event, EventKind, LoadSource, Publication
from tilth.schemas.machine import Machine
from tilth.schemas.machine_toml import parse_machine
from tilth.simulator.fleet import MOST_TOWED, drawn, scenario_of
from tilth.simulator.fleet_files import owners_text, true_machine
from tilth.simulator.packaged import packaged_file
from tilth.simulator.scenario import Ground, LoadChange, Scenario, Soil, SoilChange, Spatial
from tilth.simulator.tractor import draw
from tilth.simulator.traffic import simulate

AT_S, TAKES_S, SECONDS, LATER_S = 60.0, 5.0, 110.0, 20.0
FULL, EMPTY = 4.0, 2127.0  # factor on the empty implement's mass; that of the packaged rig, kg
LIGHT = 3000.0  # kg, of the fleet's implements
CART: Final = (
    "\n[implement.load]\nmass = {mass}\nahead_of_axle = 0.1\nheight = 1.2\nlength = 5.3\nwidth = 2.8\n"
)
WHEELS: Final = ((2.0, 0.0), (7.0, 12.0), (4.0, 0.0), (7.0, -10.0), (2.0, 0.0), (6.0, 14.0), (6.0, -14.0))
SOFTER: Final = {"C_af": 0.6, "C_ar": 0.6, "C_ai": 0.6}


Plant = Literal["planar", "spatial"]


class Case(NamedTuple):
    exponent: float
    unloads: bool = True
    softens: bool = False
    said: bool = False
    stop_s: float = 0.0

    @property
    def over_s(self) -> float:
        """When the change is over, and the rig drives."""
        return AT_S + (self.stop_s or TAKES_S)


ROWS: Final = {
    "told": Case(0.7, said=True), "unsaid": Case(0.7), "linear": Case(1.0),
    "soil": Case(0.7, unloads=False, softens=True), "stop": Case(0.7, stop_s=30.0),
    "pause": Case(0.7, unloads=False, stop_s=30.0), "gate": Case(0.7, unloads=False, stop_s=8.0),
}  # fmt: skip


class LoadedRig(NamedTuple):
    believed: str  # its machine file
    driven: Machine
    empty: float  # kg, of the implement
    scenario: Scenario
    parameters: Sequence[float]  # C_af, C_ar, C_ai with the empty one


def packaged(case: Case, seed: int, plant: Plant) -> LoadedRig:
    (machine, text), drive = packaged_file(), scenario(case, plant)
    theta = draw(machine, seed, drive)
    return LoadedRig(text, machine, EMPTY, drive, [theta[name] for name in PARAMETERS[:3]])


def of_fleet(case: Case, seed: int, plant: Plant) -> LoadedRig | None:
    """None where its implement is no light one, or too heavy for the tractor when it is full."""
    rig = drawn(seed)
    mass = rig.implement.mass
    if mass > LIGHT or FULL * mass > MOST_TOWED * rig.tractor.mass:
        return None
    drive = scenario_of(rig, scenario(case, plant))
    drive = replace(drive, spatial=replace(drive.spatial, load_exponent=_exponent(case, plant)))
    theta = [rig.parameters["C_af"], rig.parameters["C_ar"], rig.parameters["C_ai"]]
    return LoadedRig(owners_text(rig), true_machine(rig), mass, drive, theta)


def scenario(case: Case, plant: Plant) -> Scenario:
    of_change = case.exponent if plant == "planar" else LoadChange(0.0, FULL).exponent
    loads = [LoadChange(0.0, FULL, exponent=of_change)]
    soil = FIELD
    if case.unloads:
        begins_s = AT_S + case.stop_s / 3.0  # when it has come to a stop
        loads.append(LoadChange(begins_s, 1.0 / FULL, (case.stop_s or 3.0 * TAKES_S) / 3.0, of_change))
    if case.softens:
        soil = Soil(FIELD.grip, FIELD.rolling, changes=(SoilChange(at_s=AT_S, over=TAKES_S, **SOFTER),))
    seconds = SECONDS + case.stop_s
    stops = ((AT_S, 4.0), (case.stop_s, 0.0), (seconds, 4.0)) if case.stop_s else 4.0
    return Scenario(
        seconds=seconds, plant=plant, speed=stops, steering=WHEELS, soil=soil, loads=tuple(loads),
        ground=UNEVEN if plant == "planar" else Ground(rms=0.01), other_traffic=False,
        spatial=Spatial(load_exponent=_exponent(case, plant)),
    )  # fmt: skip


def _exponent(case: Case, plant: Plant) -> float | None:
    """Of the plant in space, whose tyres follow their loads all the time."""
    return case.exponent if plant == "spatial" else None


def words(case: Case, empty: float) -> Iterator[tuple[float, Carried]]:
    """What the operator says, and when, s."""
    if case.said:
        full = (FULL - 1.0) * empty
        yield 0.0, Carried(0, full, 0.05 * full, LoadSource.OPERATOR)
        yield AT_S + TAKES_S, Carried(0, 0.0, 0.01 * full, LoadSource.OPERATOR)


def driven(case: Case, seed: int, rig: LoadedRig) -> str:
    """One line of what came of a drive."""
    cart = CART.format(mass=(FULL - 1.0) * rig.empty)
    machine = parse_machine(rig.believed + cart, plausible=False)
    truth = np.log(rig.parameters)
    truth[2] += case.exponent * math.log(FULL)
    after = truth + (math.log(0.6) if case.softens else 0.0)
    after[2] -= case.exponent * math.log(FULL) if case.unloads else 0.0
    state, out, said = fold.initial(machine), list[Publication](), list(words(case, rig.empty))
    start_ns = 0
    for frame in simulate(rig.driven, seed, rig.scenario.seconds, rig.scenario):
        start_ns = start_ns or frame.t_ns
        while said and (frame.t_ns - start_ns) * 1e-9 >= said[0][0]:
            word = said.pop(0)[1]
            out += fold.carry_load(state, Carried(frame.t_ns, word.mass, word.sd, word.source))
        out += fitted_at_once(state, frame.t_ns)
        out += fold.step(state, frame)
        fold.request_fits(state, frame.t_ns)

    def at_s(publication: Publication) -> float:
        return (publication.t_ns - start_ns) * 1e-9

    told = [p.value for p in out if isinstance(p.value, Event) and at_s(p) > AT_S]
    events = [e.notice.code for e in told if e.kind in (EventKind.LOAD, EventKind.SOIL_CHANGE)]
    found = ", ".join(code for code in events if code != "load_told") or "nothing"
    best = [(at_s(p), p.value) for p in out if p.topic == "/soil_tire" and isinstance(p.value, Estimate)]
    full, mass = math.log(FULL * rig.empty), math.log(rig.empty * (1.0 if case.unloads else FULL))
    later_s = LATER_S + (case.over_s if case.stop_s else AT_S)
    shown = []
    for name, begin_s, true in (
        ("before", AT_S - 2.0, truth[2] - full),
        ("after 20 s", later_s, after[2] - mass),
        ("end", rig.scenario.seconds - 2.0, after[2] - mass),
    ):
        one = next(e for s, e in best if s > begin_s)
        z, sd, error = over_mass(one, true)
        others = ", ".join(f"{_sd(one, k):.0%}" for k in range(2))
        shown.append(f"{name} {z:+.2f} sds of {sd:.0%}, {error:+.0%} off ({others})")
    off = [number(e, k, after[k]) for s, e in best if s > case.over_s for k in range(3)]
    before = [number(e, k, truth[k]) for s, e in best if s < AT_S for k in range(3)]
    numbers = [z for z in (*before, *off) if math.isfinite(z)]
    worst = max(numbers, key=abs, default=math.nan)
    return f"found: {found}. Over the mass: {'; '.join(shown)}; furthest number {worst:+.2f}"


def over_mass(estimate: Estimate, truth: float) -> tuple[float, float, float]:
    """C_ai over the mass: error in sds, sd, error of the logarithm; not a number where there is none."""
    sd = _sd(estimate, 2)
    error = math.nan if math.isnan(sd) else math.log(estimate.per_mass[2] or math.nan) - truth
    return error / sd, sd, error


def _sd(estimate: Estimate, k: int) -> float:
    """Of the logarithm of a stiffness over the mass."""
    told = dict(enumerate(zip(estimate.per_mass, estimate.per_mass_sd, strict=False)))
    value, sd = told.get(k, (None, None))
    return math.nan if value is None or sd is None else sd / value


def number(estimate: Estimate, k: int, truth: float) -> float:
    one = estimate.parameters[k]
    if one.value is None or one.sd is None:
        return math.nan
    return (math.log(one.value) - truth) / (one.sd / one.value)


def main() -> None:
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=12)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--row", choices=ROWS, action="append")
    parser.add_argument("--fleet", action="store_true")
    parser.add_argument("--plant", choices=get_args(Plant), default="planar")
    args = parser.parse_args()
    make = of_fleet if args.fleet else packaged
    for seed in range(args.first, args.first + args.count):
        for name in args.row or ROWS:
            rig = make(ROWS[name], seed, args.plant)
            if rig is not None:
                print(f"{name:7} {seed:3}  {driven(ROWS[name], seed, rig)}", flush=True)


if __name__ == "__main__":
    main()
