"""Another implement is hitched on than the machine file has, or one that nobody has described.

    python bench/other_implement.py lengths [--plant planar] [--count 5] [--first 601] [--estimates]
                                            [--varied]
    python bench/other_implement.py wrong [--plant planar] [--count 5] [--first 601] [--moving]

Rigs are of the fleet. Each stands for 12 s, not with --moving, then drives rows of 60 m at its speed with
headland turns at 2.5 m/s, on ground of 1 cm and a slope of 1 degree. `lengths`: the file has the tractor as
its owner knows it and the implement of schemas/undescribed.py. A line says by how much hitch to receivers
and hitch to axle are off, with one sd, 1, 2 and 5 minutes after it moves off, and when they are used;
--estimates lets estimators run, and says by how many sds what is recommended at the end is off; --varied
drives 10 minutes, every other one at 1.3 m/s, and says what is known after them too. `wrong`:
the file has the implement of another rig with the same receivers (`other`), or one that differs in one
number. A line says after how many seconds there is an event, and what it says.
"""

import math
import tomllib
from argparse import ArgumentParser
from collections.abc import Callable, Iterator
from itertools import count
from typing import Any, Final

from estimation_study import fitted_at_once

from tilth.estimator import fold
from tilth.estimator.diagnosis.strange_implement import found_lengths
from tilth.schemas.flow import PARAMETERS, Estimate, Event, FlagKind, Frame
from tilth.schemas.machine import Machine
from tilth.schemas.machine_toml import parse_machine
from tilth.schemas.sentences import event_sentence
from tilth.schemas.undescribed import GENERIC, SURVEY_SD, TYRES
from tilth.simulator.drive import drive
from tilth.simulator.fleet import FleetRig, drawn, ground_of, headlands_of, scenario_of
from tilth.simulator.fleet_files import owners_text, text_of, true_machine
from tilth.simulator.scenario import CannotBeDriven, Fieldwork, Scenario
from tilth.simulator.tractor import Truth
from tilth.simulator.traffic import traffic

Raw = dict[str, Any]
PARKED_S, SECONDS, WRONG_S, SLOW, CREEPING = 12.0, 325.0, 132.0, 2.5, 1.3
MINUTES: Final = (1, 2, 5)
VARIED_S, LAST = 625.0, 10
ANOTHER: Final = 50  # numbers further, the rig whose implement is in the file


def driven(
    rig: FleetRig, plant: str, seconds: float, parked_s: float = PARKED_S, varied: bool = False
) -> tuple[Truth, Iterator[Frame]]:
    """Raises CannotBeDriven."""
    going = [(seconds - parked_s, rig.speed)] if not varied else [(60.0, rig.speed), (60.0, CREEPING)] * 5
    steering = Fieldwork(length=60.0, turns=headlands_of(rig), turn_speed=min(SLOW, rig.speed))
    base = Scenario(
        seconds=seconds, seed=rig.seed, plant=plant,  # type: ignore[arg-type]
        speed=((parked_s, 0.0), *going) if parked_s else rig.speed,
        steering=steering,
        ground=ground_of(plant, 0.01, 1.0, 40.0), other_traffic=False,
    )  # fmt: skip
    machine = true_machine(rig)
    truth = drive(machine, rig.seed, seconds, scenario_of(rig, base))
    return truth, traffic(machine, truth)


def with_implement(own: Raw, implement: Raw, tyre: Raw, receivers: list[Raw]) -> Machine:
    """own: the tractor's file."""
    kept = [one for one in own["receiver"] if one["mount"].startswith("tractor")]
    tyres = own["tyres"] | {"implement": tyre}
    raw = own | {"implement": implement, "tyres": tyres, "receiver": [*kept, *receivers]}
    return parse_machine(text_of(raw), plausible=False)


def on_implement(raw: Raw) -> list[Raw]:
    return [one for one in raw["receiver"] if one["mount"].startswith("implement")]


# Lengths.


def undescribed(rig: FleetRig) -> Machine:
    """Receivers are where the implement of another rig has them."""
    other = tomllib.loads(owners_text(drawn(rig.seed + ANOTHER)))
    receivers = [one | {"survey_sd": SURVEY_SD} for one in on_implement(other)]
    return with_implement(tomllib.loads(owners_text(rig)), GENERIC, TYRES, receivers)


def lengths_of(rig: FleetRig, plant: str, estimates: bool, varied: bool) -> str:
    seconds, later = (VARIED_S, (LAST,)) if varied else (SECONDS, ())
    machine, (truth, frames) = undescribed(rig), driven(rig, plant, seconds, varied=varied)
    state = fold.initial(machine)
    state.ready = estimates
    marks, said, begun, start_ns = [*MINUTES, *later], list[str](), "", 0
    for frame in frames:
        start_ns = start_ns or frame.t_ns
        moved_s = (frame.t_ns - start_ns) * 1e-9 - PARKED_S
        if estimates:
            fitted_at_once(state, frame.t_ns)
        fold.step(state, frame)
        if estimates:
            fold.request_fits(state, frame.t_ns)
        if state.strange.used and not begun:
            begun = f"used after {moved_s:.0f} s"
        if marks and moved_s >= 60 * marks[0]:
            said.append(f"{marks.pop(0)} min: {off(rig, state)}")
    line = "; ".join([*said, begun or "never used"])
    return f"{line}{numbers(state, truth, rig.implement.mass) if estimates else ''}"


def off(rig: FleetRig, state: fold.State) -> str:
    file, true, found = state.file, rig.implement, found_lengths(state.strange, state.file)
    ahead = [one.position[0] for one in file.receiver if one.mount.body == "implement"]
    there = [place[0] for mount, place in rig.places.items() if mount.body == "implement"]
    drawbar = file.implement.d.value + file.implement.e.value + found.hitch + found.axle - true.d - true.e
    hitch = file.implement.d.value + found.hitch - sum(ahead) / 2 - (true.d - sum(there) / 2)
    return (
        f"receivers {100 * hitch:+.1f} \u00b1 {100 * found.hitch_sd:.1f}, "
        f"axle {100 * drawbar:+.1f} \u00b1 {100 * found.drawbar_sd:.1f} cm"
    )


def numbers(state: fold.State, truth: Truth, mass: float) -> str:
    best: Estimate = state.estimates[fold.RECOMMENDED]
    told = []
    for name, one in zip(PARAMETERS, best.parameters, strict=True):
        if one.value is not None and one.sd is not None:
            z = math.log(one.value / truth.parameters[name]) / (one.sd / one.value)
            told.append(f"{name} {z:+.1f} of {one.sd / one.value:.0%}")
    value, sd = best.per_mass[2] if best.per_mass else None, best.per_mass_sd[2] if best.per_mass_sd else None
    if value is not None and sd is not None:
        z = math.log(value / (truth.parameters["C_ai"] / mass)) / (sd / value)
        told.append(f"C_ai over mass {z:+.1f} of {sd / value:.0%}")
    return f"; {best.method}: {', '.join(told) or 'no number'}"


# A wrong one.


def other(own: Raw, another: Raw) -> Machine:
    return with_implement(own, another["implement"], another["tyres"]["implement"], on_implement(another))


def moved(forward: float = 0.0, apart: float = 0.0, drawbar: float = 0.0) -> Callable[[Raw, Raw], Machine]:
    """In the file its receivers are further forward, or further apart, or its drawbar is longer, m."""

    def change(own: Raw, _: Raw) -> Machine:
        d = own["implement"]["d"]
        implement = own["implement"] | {"d": d | {"value": d["value"] + drawbar}}
        receivers = [
            one | {"position": [x + forward + apart * ("front" in one["mount"]), *others]}
            for one in on_implement(own)
            for x, *others in (one["position"],)
        ]
        return with_implement(own, implement, own["tyres"]["implement"], receivers)

    return change


WRONG: Final[dict[str, Callable[[Raw, Raw], Machine]]] = {
    "right": moved(), "other": other, "apart + 0.2 m": moved(apart=0.2),
    "forward + 0.5 m": moved(forward=0.5), "drawbar + 0.5 m": moved(drawbar=0.5),
    "drawbar + 0.2 m": moved(drawbar=0.2),
}  # fmt: skip
TELLING: Final = (FlagKind.CONTRADICTION, FlagKind.MOVED, FlagKind.SWAPPED)


def wrong_of(rig: FleetRig, plant: str, make: Callable[[Raw, Raw], Machine], parked_s: float) -> str:
    own, another = (tomllib.loads(owners_text(one)) for one in (rig, drawn(rig.seed + ANOTHER)))
    state = fold.initial(make(own, another))
    start_ns = 0
    for frame in driven(rig, plant, WRONG_S, parked_s)[1]:
        start_ns = start_ns or frame.t_ns
        for publication in fold.step(state, frame):
            if isinstance(publication.value, Event) and publication.value.kind in TELLING:
                at_s = (frame.t_ns - start_ns) * 1e-9
                return f"after {at_s:.0f} s: {publication.value.kind}: {event_sentence(publication.value)}"
    return f"nothing in {WRONG_S:.0f} s; confirmed: {state.diagnosis.confirmed}"


def main() -> None:
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("lengths", "wrong"))
    parser.add_argument("--plant", choices=("planar", "spatial"), default="planar")
    parser.add_argument("--count", type=int, default=5)
    parser.add_argument("--first", type=int, default=601)
    parser.add_argument("--estimates", action="store_true")
    parser.add_argument("--varied", action="store_true")
    parser.add_argument("--moving", action="store_true")
    args = parser.parse_args()
    parked_s = 0.0 if args.moving else PARKED_S
    done = 0
    for seed in count(args.first):
        if done == args.count:
            return
        rig = drawn(seed)
        try:
            if args.what == "lengths":
                told = lengths_of(rig, args.plant, args.estimates, args.varied)
                print(f"{seed} {args.plant}: {told}", flush=True)
            else:
                for name, make in WRONG.items():
                    print(
                        f"{seed} {args.plant} {name:15} {wrong_of(rig, args.plant, make, parked_s)}",
                        flush=True,
                    )
        except CannotBeDriven:
            continue
        done += 1


if __name__ == "__main__":
    main()
