"""Ballast and tanks: what they make of the mass, CG and inertia that a machine file tells of a body without.

`as_driven` counts them in, once, when the file is read; all that computes with a rig uses its totals.
`as_told` takes them out again, for sentences about the file and for writing it.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

from tilth.schemas.machine import Ballast, Implement, Machine, Tractor
from tilth.schemas.quantity import Quantity

DIGITS: Final = 9  # after the point: what was told comes back as it was told
ROUNDED: Final = 1e-12  # of a variance: less is left of it by rounding alone


class Body(NamedTuple):
    """Numbers that ballast changes, SI, and their sds."""

    mass: Quantity
    ahead: float  # m, of the CG ahead of the rear axle, or of the implement's axle
    cg_sd: float  # m, of that
    height: Quantity
    yaw_inertia: Quantity


def as_driven(machine: Machine) -> Machine:
    """With ballast counted in, of a machine file as it was read. Its lists of ballast stay, to be told."""
    return _changed(machine, 1.0)


def carrying(machine: Machine, mass: Quantity) -> Machine:
    """A machine whose implement carries a mass, kg, in its [implement.load]. machine: where it is empty, with
    ballast counted in."""
    load = machine.implement.load
    if load is None:
        return machine
    return _changed(machine, 1.0, {"implement": [load.model_copy(update={"mass": mass})]})


def as_told(machine: Machine) -> Machine:
    """A machine file as it was read, of one with ballast counted in."""
    return _rounded(machine, _changed(machine, -1.0))


def _changed(machine: Machine, sign: float, of: Mapping[str, Sequence[Ballast]] | None = None) -> Machine:
    """sign: 1 counts ballast in, -1 takes it out. of: by body; None: that of the file."""
    update: dict[str, object] = {}
    forward = {}
    for name, section in (("tractor", machine.tractor), ("implement", machine.implement)):
        if ballast := section.ballast if of is None else of.get(name):
            old = _body(section)
            new = _with(old, ballast, sign)
            forward[name] = new.ahead - old.ahead
            update[name] = section.model_copy(update=_keys(section, new, forward[name]))
    if not update:
        return machine
    update["receiver"] = [
        r.model_copy(update={"position": (r.position[0] - forward.get(r.mount.body, 0.0), *r.position[1:])})
        for r in machine.receiver
    ]
    return machine.model_copy(update=update)


def _body(section: Tractor | Implement) -> Body:
    ahead = section.b if isinstance(section, Tractor) else section.e
    return Body(section.mass, ahead.value, section.cg_sd, section.cg_height, section.yaw_inertia)


def _with(body: Body, ballast: Sequence[Ballast], sign: float) -> Body:
    """With further masses, or without them: by moments, and Steiner's theorem. A mass that is known less well
    than others makes the place of the CG as uncertain."""
    masses = [sign * each.mass.value for each in ballast]
    total = body.mass.value + sum(masses)
    parts = list(zip(masses, ballast, strict=True))
    ahead, height = (
        (body.mass.value * own + sum(mass * at for mass, at in places)) / total
        for own, places in (
            (body.ahead, [(mass, each.ahead_of_axle.value) for mass, each in parts]),
            (body.height.value, [(mass, each.height.value) for mass, each in parts]),
        )
    )
    inertia = body.yaw_inertia.value + body.mass.value * (body.ahead - ahead) ** 2
    inertia += sum(mass * ((each.ahead_of_axle.value - ahead) ** 2 + _own(each)) for mass, each in parts)
    mass_sd = _summed(body.mass.sd, [each.mass.sd for each in ballast], sign)
    # What is uncertain is always about the CG of all together, and over the mass of all.
    whole = (total, ahead, height) if sign > 0 else (body.mass.value, body.ahead, body.height.value)
    bare = (body.mass.value, body.ahead, body.height.value) if sign > 0 else (total, ahead, height)
    bare_sd = body.mass.sd if sign > 0 else mass_sd
    share = bare[0] / whole[0]
    cg = [(bare[1] - whole[1]) * bare_sd / whole[0]]
    up = [(bare[2] - whole[2]) * bare_sd / whole[0]]
    yaw = [(bare[1] - whole[1]) ** 2 * bare_sd]
    for each in ballast:
        off = each.ahead_of_axle.value - whole[1]
        cg += [off * each.mass.sd / whole[0], each.mass.value / whole[0] * each.ahead_of_axle.sd]
        up += [(each.height.value - whole[2]) * each.mass.sd / whole[0]]
        up += [each.mass.value / whole[0] * each.height.sd]
        yaw += [(off**2 + _own(each)) * each.mass.sd, 2 * each.mass.value * off * each.ahead_of_axle.sd]
    # A height without an sd is one that nobody knows (priors.cg_height), and stays so.
    before, after = (share, 1.0) if sign > 0 else (1.0, share)
    height_sd = _summed(before * body.height.sd, up, sign) / after if body.height.sd else 0.0
    return Body(
        Quantity(value=total, sd=mass_sd),
        ahead,
        _summed(before * body.cg_sd, cg, sign) / after,
        Quantity(value=height, sd=height_sd),
        Quantity(value=inertia, sd=_summed(body.yaw_inertia.sd, yaw, sign)),
    )


def inertia_sd_over_mass(section: Tractor | Implement, ballast: Sequence[Ballast]) -> float:
    """Sd of the yaw inertia, kg m^2, of a body whose mass is taken as known. A mass that is known badly
    brings inertia with it, so the inertia over the mass of all is known better than either.

    section: with `ballast` counted in, some of its masses or all.
    """
    body = _body(section)
    over_mass = body.yaw_inertia.value / body.mass.value
    variance = body.yaw_inertia.sd**2
    for each in ballast:
        brought = (each.ahead_of_axle.value - body.ahead) ** 2 + _own(each)
        variance += ((brought - over_mass) ** 2 - brought**2) * each.mass.sd**2
    return math.sqrt(max(variance, 0.0))


def _own(ballast: Ballast) -> float:
    """Square of its radius of gyration about its own vertical axis, m^2, as of a block."""
    return (ballast.length**2 + ballast.width**2) / 12


def _summed(own: float, others: Sequence[float], sign: float) -> float:
    """Of independent errors: with the others, or without them."""
    variance = own**2 + sign * sum(sd**2 for sd in others)
    return math.sqrt(variance) if variance > ROUNDED * own**2 else 0.0


def _keys(section: Tractor | Implement, new: Body, forward: float) -> dict[str, object]:
    """forward: m, by which the CG moves."""
    backward = {"a": -forward, "b": forward, "c": forward}
    by = backward if isinstance(section, Tractor) else {"d": -forward, "e": forward}
    lengths = {key: getattr(section, key) for key in by}
    moved = {key: Quantity(value=told.value + by[key], sd=told.sd) for key, told in lengths.items()}
    others = {"mass": new.mass, "yaw_inertia": new.yaw_inertia, "cg_height": new.height, "cg_sd": new.cg_sd}
    return {**moved, **others}


def _rounded(machine: Machine, told: Machine) -> Machine:
    """told: of `machine`; without what the arithmetic has left over in numbers that differ."""
    if told is machine:
        return told

    def plain(value: object) -> object:
        if isinstance(value, Quantity):
            return Quantity(value=round(value.value, DIGITS), sd=round(value.sd, DIGITS))
        return round(value, DIGITS) if isinstance(value, float) else value

    sections = {}
    for name in ("tractor", "implement"):
        section = getattr(told, name)
        keys = {key: plain(getattr(section, key)) for key in type(section).model_fields}
        sections[name] = section.model_copy(update=keys) if section.ballast else section
    places = [
        r.model_copy(update={"position": tuple(round(at, DIGITS) for at in r.position)})
        for r in told.receiver
    ]
    return told.model_copy(update=sections | {"receiver": places})
