"""The machine file of a rig of the fleet: exact, or as a careful owner writes it.

A careful owner has taped lengths and antennas to 1 cm, weighed the tractor to 1 % and the implement to 4 %,
taken inertias to 5 % and heights of centres of gravity to 4 cm, and tells these sds; of the implement's mass
5 %. Of tyres he tells a rule of thumb over their load. Every other owner also tells tracks, heights of hitch
and pin to 1 cm, and how far the tyres give way, to 10 %. What he has written is one draw of the rig's seed.
"""

import json
import math
from collections.abc import Iterator, Mapping
from typing import Any, Final

import numpy as np

from tilth.schemas.flow import Mount
from tilth.schemas.machine import Machine
from tilth.schemas.machine_toml import parse_machine
from tilth.simulator import noise
from tilth.simulator.fleet import FleetRig
from tilth.simulator.noise import generator

TAPE: Final = 0.01  # m, sd of a length and of each coordinate of an antenna
TRACTOR_MASS: Final = (0.01, 0.01)  # sd of what is written, and as it is told; shares
IMPLEMENT_MASS: Final = (0.04, 0.05)
INERTIA: Final = (0.05, 0.05)
DEFLECTION: Final = 0.1  # of a tyre; a share
CG_HEIGHT: Final = 0.04  # m
DESCRIBED: Final = 0.5  # share of owners who tell what a machine file need not have
CORNERING: Final = 6.0  # 1/rad, rule of thumb: stiffness of an axle over its load
RELAXATION: Final = 1.6  # the same: relaxation length over radius
LIMIT: Final = 2.5  # sd; who is further off measures again
STAR_FIRE: Final = 0xA00017000421E250  # NAMEs of receivers at 5 Hz, and at 10 Hz
NMEA_2000: Final = 0xC07891000B002720

Raw = dict[str, Any]


def true_machine(rig: FleetRig, first_name: int = STAR_FIRE) -> Machine:
    """The machine as it is: what is driven."""
    return parse_machine(text_of(_raw(rig, first_name, np.zeros(NUMBERS), told=0.0)))


def owners_text(
    rig: FleetRig, first_name: int = STAR_FIRE, *, exact: bool = False, mass_sd: float | None = None
) -> str:
    """The machine file as TOML. first_name: NAME of the first receiver: STAR_FIRE or NMEA_2000. exact: with
    the true numbers, and the owner's sds. mass_sd: of the logarithm of the implement's mass, of an owner who
    has not weighed it; the inertia is reckoned from it, and both sds are told."""
    rng = generator(rig.seed, noise.FLEET_FILE)
    off = np.clip(rng.standard_normal(NUMBERS), -LIMIT, LIMIT) * (not exact)
    raw = _raw(rig, first_name, off, told=1.0)
    if mass_sd is not None:
        _guess_the_mass(raw["implement"], rig, mass_sd, float(off[IMPLEMENT_MASS_OFF]))
    if rng.random() < DESCRIBED:
        _describe(raw, rig, off[-DESCRIBING:])
    return text_of(raw)


IMPLEMENT_MASS_OFF: Final = 8  # which of what the owner measures it is
DESCRIBING: Final = 9  # of them in `_describe`
NUMBERS: Final = 11 + 3 * len(Mount) + DESCRIBING  # that the owner measures


def _raw(rig: FleetRig, first_name: int, off: np.ndarray, told: float) -> Raw:
    """Sections and keys. off: errors in sds, (NUMBERS,). told: factor on the sds that are written."""
    errors = iter(off.tolist())

    def length(true: float) -> Raw:
        return {"value": round(true + TAPE * next(errors), 4), "sd": TAPE * told}

    def share(true: float, sds: tuple[float, float]) -> Raw:
        value = true * (1.0 + sds[0] * next(errors))
        return {"value": round(value, 2), "sd": round(sds[1] * told * value, 2)}

    def height(true: float) -> Raw:
        return {"value": round(true + CG_HEIGHT * next(errors), 3), "sd": CG_HEIGHT * told}

    t, i = rig.tractor, rig.implement
    return {
        "machine": {"name": f"fleet-{rig.seed}"},
        "tractor": {
            "a": length(t.a), "b": length(t.b), "c": length(t.c), "mass": share(t.mass, TRACTOR_MASS),
            "yaw_inertia": share(t.yaw_inertia, INERTIA), "cg_height": height(t.cg_height),
        },
        "implement": {
            "d": length(i.d), "e": length(i.e), "mass": share(i.mass, IMPLEMENT_MASS),
            "yaw_inertia": share(i.yaw_inertia, INERTIA), "cg_height": height(i.cg_height),
        },
        "tyres": {
            axle: {
                "cornering_stiffness": round(CORNERING * tyre.load, -2),
                "relaxation_length": round(RELAXATION * tyre.radius, 2),
                "log_sd": 0.7,
            }
            for axle, tyre in zip(("front", "rear", "implement"), rig.tyres, strict=True)
        },
        "bus": [{"name": "can0", "interface": "socketcan", "channel": "can0"}],
        "receiver": [
            {
                "mount": str(mount.value),
                "bus": "can0",
                "name": f"{first_name + k:016X}",
                "position": [round(at + TAPE * next(errors), 3) for at in place],
                "survey_sd": TAPE if told else 0.0,
                "roll_corrected": rig.roll_corrected and mount.body == "tractor",
            }
            for k, (mount, place) in enumerate(rig.places.items())
        ],
        "wheel_angle": {
            "bus": "can0", "id": 0x18FF0B15, "byte_order": "big", "start_byte": 0, "scale": 0.01,
            "not_available": 0x7FFF, "zero": {"value": 0.0, "sd": 0.5}, "delay": 0.01,
        },
    }  # fmt: skip


def _guess_the_mass(implement: Raw, rig: FleetRig, sd: float, off: float) -> None:
    """off: error in sds."""
    factor = math.exp(sd * off)
    for key, true in (("mass", rig.implement.mass), ("yaw_inertia", rig.implement.yaw_inertia)):
        share = sd if key == "mass" else math.hypot(sd, INERTIA[1])
        implement[key] = {"value": round(true * factor, 2), "sd": round(share * true * factor, 2)}


def _describe(raw: Raw, rig: FleetRig, off: np.ndarray) -> None:
    """Add what a machine file need not have. off: errors in sds, (DESCRIBING,)."""
    errors = iter(off.tolist())

    def taped(true: float) -> Raw:
        return {"value": round(max(true + TAPE * next(errors), TAPE), 3), "sd": TAPE}

    rear = rig.tyres[1]
    outer = taped(rear.track + 2 * rear.twin_spacing)
    raw["tractor"] |= {
        "hitch_height": taped(rig.tractor.hitch_height),
        "pivot_height": taped(rig.tractor.pin_height),
        "suspended_front_axle": rig.tractor.suspension is not None,
    }
    for axle, tyre in zip(("front", "rear", "implement"), rig.tyres, strict=True):
        by = tyre.deflection * (1.0 + DEFLECTION * next(errors))
        pressed_in = {"value": round(by, 4), "sd": round(DEFLECTION * by, 4)}
        raw["tyres"][axle] |= {"track": taped(tyre.track), "deflection": pressed_in}
        raw["tyres"][axle] |= {"dual_track": outer} if tyre.twin_spacing else {}


def text_of(raw: Mapping[str, Any]) -> str:
    """Sections and keys as TOML."""
    return "\n".join(_lines(raw)) + "\n"


def _lines(raw: Mapping[str, Any]) -> Iterator[str]:
    for name, part in raw.items():
        if name == "tyres":
            tables = [(f"[tyres.{axle}]", tyre) for axle, tyre in part.items()]
        elif isinstance(part, list):
            tables = [(f"[[{name}]]", item) for item in part]
        else:
            tables = [(f"[{name}]", part)]
        for head, rows in tables:
            yield head
            yield from (f"{key} = {_value(value)}" for key, value in rows.items())


def _value(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key} = {_value(one)}" for key, one in value.items()) + " }"
    return json.dumps(value)  # numbers, texts, lists and booleans are written alike
