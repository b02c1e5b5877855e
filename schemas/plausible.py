"""Checks whether a machine file can describe a real rig: single numbers, and numbers against each other.

Impossible values are refused when the file is read; rare ones are reported by `tilth check` and at the start
of commands that estimate. Ranges of single values are in `limits`.
"""

import math
from collections.abc import Iterable, Iterator
from typing import Final

from tilth.schemas.axle_loads import axle_loads
from tilth.schemas.ballast import as_told
from tilth.schemas.limits import LIMITS, Doubt, KeyLimits, doubt_of, judged, meant, spread_judged, with_unit
from tilth.schemas.machine import Ballast, Implement, Machine, MachineError, Quantity, Receiver, Tractor, Tyre
from tilth.schemas.plausible_wheel import wheel_doubts
from tilth.schemas.tyre_size import tyre_size, upright_stiffness
from tilth.schemas.weighing import weighing_doubts

GRAVITY: Final = 9.80665  # m/s^2
COEFFICIENT: Final = (0.3, 40.0)  # cornering stiffness over axle load, 1/rad: beyond, it is no tyre
USUAL_COEFFICIENT: Final = (1.0, 30.0)
GYRATION: Final = {  # radius of gyration over wheelbase, or over hitch to axle: possible, usual
    "tractor": ((0.15, 1.3), (0.3, 0.9)),
    "implement": ((0.08, 3.0), (0.15, 1.5)),  # of a boom sprayer several times its length
}
BODIES: Final = ("tractor", "implement")
LIGHT_FRONT: Final = 0.1  # share of the tractor's weight
SHORTEST: Final = 0.3  # hitch to the implement's axle, m
MOST_BALLAST: Final = {  # over the mass of the body without it: possible, usual
    "tractor": (1.0, 0.5),
    "implement": (20.0, 6.0),  # of a tanker or a cart that is full
}
HEAVY_AXLE: Final = (0.02, 0.2), (0.04, 0.13)  # front axle over the tractor's mass: possible, usual
SIDE_BY_SIDE: Final = 0.3  # m: receivers may stand so far in a wrong order


def doubts(machine: Machine) -> list[Doubt]:
    """All impossible and rare values; the impossible ones first. Ballast is counted in, as `parse_machine`
    does; of single values those of the file are judged."""
    told = as_told(machine)
    found = [*_values(told), *_rig(told, machine), *_receivers(told), *wheel_doubts(told),
             *weighing_doubts(told)]  # fmt: skip
    return sorted(found, key=lambda doubt: not doubt.refused)


def refuse_impossible(machine: Machine) -> None:
    """Raises MachineError with the first thing that cannot be, and how many more there are."""
    found = [doubt.text for doubt in doubts(machine) if doubt.refused]
    if found:
        more = f" (and {len(found) - 1} more like this)" if found[1:] else ""
        raise MachineError(found[0] + more)


def unusual(machine: Machine) -> list[str]:
    """Rare values, a sentence each."""
    return [doubt.text for doubt in doubts(machine) if not doubt.refused]


# One by one.


def _values(machine: Machine) -> Iterator[Doubt]:
    sections: list[tuple[str, str, object]] = [
        ("tractor.{}", "tractor", machine.tractor),
        ("implement.{}", "implement", machine.implement),
        ("wheel_angle.{}", "wheel_angle", machine.wheel_angle),
        *((f"tyres.{axle}.{{}}", "tyres", tyre) for axle, tyre in _tyres(machine)),
        *((f"receiver {r.mount}: {{}}", "receiver", r) for r in machine.receiver),
        *((f"{name}.{{}}", "ballast", each) for _, name, each in _ballast(machine)),
    ]
    for name, kind, section in sections:
        for key in LIMITS:
            if key.startswith(f"{kind}.") and key.count(".") == 1:
                field = key.removeprefix(f"{kind}.")
                yield from _value(name.format(field), key, getattr(section, field))


def _value(name: str, key: str, given: Quantity | float | None) -> Iterator[Doubt]:
    if given is None:
        return
    value = given.value if isinstance(given, Quantity) else given
    if found := judged(name, key, value):
        yield found
    if isinstance(given, Quantity):
        yield from spread_judged(name, key, value, given.sd)


def _tyres(machine: Machine) -> list[tuple[str, Tyre]]:
    return [(axle, getattr(machine.tyres, axle)) for axle in ("front", "rear", "implement")]


def _ballast(machine: Machine) -> list[tuple[str, str, Ballast]]:
    """Of each: its body, and its name in the file."""
    return [
        (body, f"{body}.ballast[{number}]", each)
        for body in BODIES
        for number, each in enumerate(getattr(machine, body).ballast, 1)
    ]


# Against each other. What is impossible by itself has been said, and says nothing of what stands beside it.


def _rig(told: Machine, driven: Machine) -> Iterator[Doubt]:
    """told: as in the file, driven: with ballast counted in."""
    tractor, implement = told.tractor, told.implement
    if not _possible("tractor", tractor, "abc") or not _possible("implement", implement, "de"):
        return
    wheelbase, towed = tractor.wheelbase, implement.d.value + implement.e.value
    if towed < SHORTEST:
        yield Doubt(
            f"implement.e = {implement.e.value:g} m: its axle would stand at the hitch or ahead of it", True
        )
        return
    if tractor.c.value < tractor.b.value:
        yield Doubt(
            f"tractor.c = {tractor.c.value:g} m: rare, the hitch stands ahead of the rear axle", False
        )
    if _possible("tractor", tractor, ("mass", "yaw_inertia")):
        yield from _gyration("tractor", tractor, wheelbase, "the wheelbase")
    if _possible("implement", implement, ("mass", "yaw_inertia")):
        yield from _gyration("implement", implement, towed, "the length from hitch to axle")
    if _possible("tractor", tractor, ("mass",)) and _possible("implement", implement, ("mass",)):
        yield from _carried(told, driven)
        yield from _standing(driven)


def _possible(kind: str, section: Tractor | Implement, keys: Iterable[str]) -> bool:
    for key in keys:
        low, high = LIMITS[f"{kind}.{key}"].range
        if not low <= getattr(section, key).value <= high:
            return False
    return True


def _gyration(name: str, section: Tractor | Implement, length: float, of_what: str) -> Iterator[Doubt]:
    """The yaw inertia against mass and size."""
    (low, high), usual = GYRATION[name]
    inertia, mass = section.yaw_inertia.value, section.mass.value

    def share(inertia: float) -> float:
        return math.sqrt(max(inertia, 0.0) / mass) / length

    if usual[0] <= share(inertia) <= usual[1]:
        return
    refused = not low <= share(inertia) <= high
    yield Doubt(
        f"{name}.yaw_inertia = {inertia:g} kg m^2: with its mass of {mass:g} kg the radius of gyration is "
        f"{share(inertia):.2g} times {of_what}, {_allowed(refused, (low, high), usual)}"
        + meant(inertia, "kg m^2", lambda value: usual[0] <= share(value) <= usual[1]),
        refused,
    )


def _allowed(refused: bool, possible: tuple[float, float], usual: tuple[float, float]) -> str:
    low, high = possible if refused else usual
    return f"must be {low:g} to {high:g}" if refused else f"{low:g} to {high:g} is usual"


def _carried(told: Machine, driven: Machine) -> Iterator[Doubt]:
    """Ballast: where it is, how much it is, and what the bodies weigh with it; the front axle's mass."""
    tractor, implement = told.tractor, told.implement
    behind = tractor.c.value - tractor.b.value
    reach = {
        "tractor": _place(-behind, 3.0, 1.5, tractor.wheelbase, 4.0, 2.0),
        "implement": _place(0.0, 10.0, 4.0, implement.d.value + implement.e.value, 1.0, 0.5),
    }
    for body, name, each in _ballast(told):
        row, ahead = reach[body], each.ahead_of_axle.value
        if not row.usual[0] <= ahead <= row.usual[1]:
            yield doubt_of(f"{name}.ahead_of_axle", ahead, row)
    for body in BODIES:
        bare, whole = getattr(told, body).mass.value, getattr(driven, body).mass.value
        (most, usual), more = MOST_BALLAST[body], whole - bare
        if more > usual * bare:
            refused = more > most * bare
            text = f"{body}.ballast: {more:g} kg in all, to {body}.mass = {bare:g} kg, which is without it; "
            wanted = f"at most {most if refused else usual:g} times that mass"
            yield Doubt(text + (f"must be {wanted}" if refused else f"rare, {wanted} is usual"), refused)
        for key in ("mass", "cg_height") if more else ():
            value = getattr(getattr(driven, body), key).value
            if found := judged(f"{body}.{key} with its ballast", f"{body}.{key}", value):
                yield found
    if (axle := tractor.front_axle_mass) is not None:
        share, (possible, common) = axle.value / tractor.mass.value, HEAVY_AXLE
        if not common[0] <= share <= common[1]:
            refused = not possible[0] <= share <= possible[1]
            yield Doubt(
                f"tractor.front_axle_mass = {axle.value:g} kg: that is {share:.2g} of the tractor's mass, "
                + _allowed(refused, possible, common),
                refused,
            )


def _standing(machine: Machine) -> Iterator[Doubt]:
    """Each axle's load, and its tyres against it."""
    tractor, implement = machine.tractor, machine.implement
    loads = axle_loads(
        tractor.a.value, tractor.b.value, tractor.c.value, implement.d.value, implement.e.value,
        tractor.mass.value, implement.mass.value, GRAVITY,
    )  # fmt: skip
    if min(loads) <= 0.0:
        axle = ("tractor's front", "tractor's rear", "implement's")[loads.index(min(loads))]
        text = f"the {axle} axle would stand off the ground: check a, b, c, d, e{_with_ballast(machine)}"
        yield Doubt(text, True)
        return
    share = loads[0] / (tractor.mass.value * GRAVITY)
    if share < LIGHT_FRONT:
        text = (
            f"the tractor's front axle carries {100 * share:.0f} % of its weight: rare, it would hardly steer"
        )
        yield Doubt(f"{text}; check a, b, c, d, e{_with_ballast(machine)}", False)
    for (axle, tyre), load in zip(_tyres(machine), loads, strict=True):
        yield from _stiffness(axle, tyre.cornering_stiffness, load)
        yield from _pressed_in(axle, tyre, load)


def _with_ballast(machine: Machine) -> str:
    """What loads follow from besides lengths, for a sentence."""
    return ", masses and ballast" if _ballast(machine) else " and both masses"


def _stiffness(axle: str, stiffness: float, load: float) -> Iterator[Doubt]:
    low, high = LIMITS["tyres.cornering_stiffness"].range
    coefficient = stiffness / load
    if not low <= stiffness <= high or USUAL_COEFFICIENT[0] <= coefficient <= USUAL_COEFFICIENT[1]:
        return
    refused = not COEFFICIENT[0] <= coefficient <= COEFFICIENT[1]
    yield Doubt(
        f"tyres.{axle}.cornering_stiffness = {stiffness:g} N/rad: that is {coefficient:.2g} per rad of "
        f"the axle's load of {load / 1e3:.3g} kN, {_allowed(refused, COEFFICIENT, USUAL_COEFFICIENT)}"
        + meant(
            stiffness, "N/rad", lambda value: USUAL_COEFFICIENT[0] <= value / load <= USUAL_COEFFICIENT[1]
        ),
        refused,
    )


def _pressed_in(axle: str, tyre: Tyre, load: float) -> Iterator[Doubt]:
    """By how much, as size and pressure let expect."""
    if tyre.size is None or tyre.pressure is None:
        return
    wheels = 2 if tyre.dual_track is None else 4
    pressed_in = load / wheels / upright_stiffness(tyre_size(tyre.size), tyre.pressure)
    row = LIMITS["tyres.deflection"]
    if not row.usual[0] <= pressed_in <= row.usual[1]:
        yield Doubt(
            f"tyres.{axle}: by size and pressure its load of {load / 1e3:.3g} kN presses the tyres in by "
            f"{1e3 * pressed_in:.0f} mm, {1e3 * row.usual[0]:g} to {1e3 * row.usual[1]:g} is usual; check "
            "size, pressure and masses",
            False,
        )


# Where receivers stand.


def _receivers(machine: Machine) -> Iterator[Doubt]:
    tractor, implement = machine.tractor, machine.implement
    reach = {  # of each body, for forward, right and up: what is possible and what is usual
        "tractor": (
            _place(-tractor.c.value, 3.0, 0.5, tractor.a.value, 4.0, 1.5),
            KeyLimits(-4.0, 4.0, (-1.6, 1.6), "m"),
            KeyLimits(0.3, 7.0, (1.0, 4.5), "m"),
        ),
        "implement": (
            _place(-implement.e.value, 15.0, 6.0, implement.d.value, 1.0, 0.5),
            KeyLimits(-20.0, 20.0, (-4.0, 4.0), "m"),
            KeyLimits(0.1, 10.0, (0.3, 6.0), "m"),
        ),
    }
    for receiver in machine.receiver:
        words = ("forward", "right", "up")
        for word, value, row in zip(words, receiver.position, reach[receiver.mount.body], strict=True):
            if not row.usual[0] <= value <= row.usual[1]:
                yield doubt_of(f"receiver {receiver.mount}: position, {word}", value, row)
    for body in reach:
        pair = [r for r in machine.receiver if r.mount.body == body]
        yield from _order(sorted(pair, key=lambda r: r.mount))  # "…_front" before "…_rear"


def _place(
    back: float, behind: float, usually_behind: float, front: float, ahead: float, usually_ahead: float
) -> KeyLimits:
    """Along a body from `back` to `front`, and so much further behind and ahead, m."""
    usual = (round(back - usually_behind, 3), round(front + usually_ahead, 3))
    return KeyLimits(round(back - behind, 3), round(front + ahead, 3), usual, "m")


def _order(pair: list[Receiver]) -> Iterator[Doubt]:
    if len(pair) != 2:
        return
    front, rear = pair
    behind = rear.position[0] - front.position[0]
    lateral_offset = abs(front.position[1] - rear.position[1])
    if behind <= 0.0:
        return
    text = (
        f"receiver {front.mount}: position, forward = {with_unit(front.position[0], 'm')}: stands behind "
        f"{rear.mount}, which is at {rear.position[0]:g}; are the two exchanged?"
    )
    yield Doubt(text, behind > max(lateral_offset, SIDE_BY_SIDE))
