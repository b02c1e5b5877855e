"""What the operator has accepted: values that the watch found, in place of those of the machine file."""

import math
from collections.abc import Iterable, Sequence
from typing import Final

from tilth.estimator.watch.hypotheses import DRAWBAR, PAIRS, WHEEL
from tilth.schemas.flow import Accepted, Mount
from tilth.schemas.machine import Machine, Quantity, Receiver
from tilth.schemas.spread import plus_minus

WHEEL_SPEED: Final = "wheel_speed"  # its amounts: wheel-based over ground speed at no slip, now and before
KNOWN: Final = (*(mount.value for mount in Mount), *PAIRS, WHEEL, DRAWBAR, WHEEL_SPEED)
"""All that may be found moved, and accepted."""


def corrected(machine: Machine, accepted: Iterable[Accepted]) -> Machine:
    """The machine file with the accepted values. Raises ValueError for what it does not have."""
    for one in accepted:
        machine = _corrected(machine, one)
    return machine


def _corrected(machine: Machine, one: Accepted) -> Machine:
    if one.what == WHEEL:
        zero, (angle,), (sd,) = machine.wheel_angle.zero, one.amounts, one.sds
        slipped = Quantity(value=zero.value + math.degrees(angle), sd=math.hypot(zero.sd, math.degrees(sd)))
        wheel = machine.wheel_angle.model_copy(update={"zero": slipped})
        return machine.model_copy(update={"wheel_angle": wheel})
    if one.what == WHEEL_SPEED:
        factor = Quantity(value=one.amounts[0], sd=one.sds[0])
        tractor = machine.tractor.model_copy(update={"wheel_speed_factor": factor})
        return machine.model_copy(update={"tractor": tractor})
    if one.what == DRAWBAR:
        (amount,), (sd,) = one.amounts, one.sds
        d = machine.implement.d
        d = Quantity(value=d.value - amount, sd=math.hypot(d.sd, sd))
        return machine.model_copy(update={"implement": machine.implement.model_copy(update={"d": d})})
    if one.what in PAIRS:
        (angle,), (sd,) = one.amounts, one.sds
        front, rear = _pair(machine, PAIRS.index(one.what))
        half = (front.position[0] - rear.position[0]) / 2
        moved = {front.mount: (0.0, angle * half, sd * half), rear.mount: (0.0, -angle * half, sd * half)}
        return _with_receivers(machine, moved)
    if one.what not in KNOWN:
        raise ValueError(f"{one.what} is nothing that can be accepted")
    forward, right = one.amounts
    return _with_receivers(machine, {Mount(one.what): (forward, right, max(one.sds))})


def _pair(machine: Machine, body: int) -> tuple[Receiver, Receiver]:
    """Front and rear receiver."""
    by_mount = {receiver.mount: receiver for receiver in machine.receiver}
    front, rear = (by_mount[mount] for mount in tuple(Mount)[2 * body : 2 * body + 2])
    return front, rear


def _with_receivers(machine: Machine, moved: dict[Mount, tuple[float, float, float]]) -> Machine:
    """moved: forward, right, sd, m."""
    receivers = []
    for receiver in machine.receiver:
        if receiver.mount in moved:
            forward, right, sd = moved[receiver.mount]
            x, y, z = receiver.position
            sd = math.hypot(receiver.survey_sd, sd)
            update = {"position": (x + forward, y + right, z), "survey_sd": sd}
            receiver = receiver.model_copy(update=update)
        receivers.append(receiver)
    return machine.model_copy(update={"receiver": receivers})


def in_words(what: str, amounts: Sequence[float], sds: Sequence[float]) -> str:
    """Such as: tractor_front has been moved 0.10 ± 0.03 m (95 %) forward and …"""
    if what in (WHEEL, *PAIRS):
        angle = plus_minus(math.degrees(amounts[0]), math.degrees(sds[0]), "°")
        if what == WHEEL:
            return f"the wheels' sensor has slipped by {angle}: wheel_angle.zero"
        return f"the pair on the {what.removeprefix('pair_')} has been turned by {angle}"
    if what == WHEEL_SPEED:
        return _tyres_in_words(amounts, sds)
    if what == DRAWBAR:
        return f"the drawbar is {plus_minus(-amounts[0], sds[0], 'm')} longer: implement.d or tractor.c"
    forward, right = (plus_minus(a, sd, "m") for a, sd in zip(amounts, sds, strict=True))
    return f"{what} has been moved {forward} forward and {right} to the right"


def _tyres_in_words(factors: Sequence[float], sds: Sequence[float]) -> str:
    (now, before), relative = factors, [sd / factor for sd, factor in zip(sds, factors, strict=True)]
    larger = plus_minus(100.0 * (before / now - 1.0), 100.0 * math.hypot(*relative), "%")
    return f"the tyres' radius has changed by {larger}: tractor.wheel_speed_factor"


def key_of(what: str) -> str:
    """The key of the machine file that it changes."""
    if what == WHEEL:
        return "wheel_angle.zero"
    if what == WHEEL_SPEED:
        return "tractor.wheel_speed_factor"
    if what == DRAWBAR:
        return "implement.d or tractor.c"
    return f"receiver.{what}.position"


def line_of(machine: Machine, what: str) -> str:
    """What to write into the machine file, with the values that `machine` has."""
    if what == WHEEL:
        zero = machine.wheel_angle.zero
        return f"[wheel_angle] zero = {{ value = {zero.value:.2f}, sd = {zero.sd:.2f} }}"
    factor = machine.tractor.wheel_speed_factor
    if what == WHEEL_SPEED and factor is not None:
        return f"[tractor] wheel_speed_factor = {{ value = {factor.value:.4f}, sd = {factor.sd:.4f} }}"
    if what == DRAWBAR:
        d = machine.implement.d
        return f"[implement] d = {{ value = {d.value:.3f}, sd = {d.sd:.3f} }}"
    mounts = _pair(machine, PAIRS.index(what)) if what in PAIRS else [_one(machine, what)]
    return "; ".join(map(_receiver_line, mounts))


def _receiver_line(receiver: Receiver) -> str:
    position = ", ".join(f"{x:.3f}" for x in receiver.position)
    return f"{receiver.mount.value} position = [{position}], survey_sd = {receiver.survey_sd:.3f}"


def acceptance(machine: Machine, accepted: Accepted) -> str:
    """For the event; machine: with the value."""
    what = in_words(accepted.what, accepted.amounts, accepted.sds)
    return f"accepted: {what}; for the machine file: {line_of(machine, accepted.what)}"


def _one(machine: Machine, mount: str) -> Receiver:
    return next(receiver for receiver in machine.receiver if receiver.mount.value == mount)
