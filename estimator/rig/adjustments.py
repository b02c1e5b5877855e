"""How a machine file changes by one number of the rig: the functions that the rows of `numbers.py` hold.

Amounts are SI. Nothing is checked for what cannot be.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

from tilth.estimator.tuning import tuned
from tilth.schemas.flow import Mount
from tilth.schemas.machine import Machine, Quantity, Receiver

SHORTEST_LATENCY_S: Final = 0.0


@dataclass(frozen=True, slots=True)
class AdjustmentTuning:
    """What a machine file is taken to know."""

    least_survey: float = tuned(0.002, "m", "least sd of a survey, however well the drive tells it")
    roll_zero_sd: float = tuned(math.degrees(0.01), "°", "of a roll zero that the file does not give")


ADJUSTMENT: Final = AdjustmentTuning()


class Amount(NamedTuple):
    """By how much a number is more than the file says, and how well it is known then."""

    by: float
    sd: float | None = None  # None: as the file says
    besides: bool = False  # sd is that of `by`, besides what the file says; else it is in its place


Change = Callable[[Machine, Amount], Machine]
Reader = Callable[[float], float]


def _same(value: float) -> float:
    return value


def _sd(stated: float, amount: Amount, to_file: Reader = _same) -> float:
    if amount.sd is None:
        return stated
    return math.hypot(stated, to_file(amount.sd)) if amount.besides else to_file(amount.sd)


def updated(machine: Machine, section: str, **keys: Any) -> Machine:
    """With other keys in a section."""
    return machine.model_copy(update={section: getattr(machine, section).model_copy(update=keys)})


def added(section: str, key: str, to_file: Reader = _same) -> Change:
    """A key to which the amount is added. to_file: from SI to the unit of the file."""

    def change(machine: Machine, amount: Amount) -> Machine:
        stated: Quantity = getattr(getattr(machine, section), key)
        value = stated.value + to_file(amount.by)
        return updated(machine, section, **{key: Quantity(value=value, sd=_sd(stated.sd, amount, to_file))})

    return change


def scaled(section: str, key: str) -> Change:
    """A key that is multiplied; the amount is a natural logarithm."""

    def change(machine: Machine, amount: Amount) -> Machine:
        stated: Quantity = getattr(getattr(machine, section), key)
        value = stated.value * math.exp(amount.by)
        return updated(
            machine, section, **{key: Quantity(value=value, sd=_sd(stated.sd, amount, lambda sd: value * sd))}
        )

    return change


def wheel_speed_factor(machine: Machine, amount: Amount) -> Machine:
    """by: the factor itself, since the file may have none."""
    return updated(machine, "tractor", wheel_speed_factor=Quantity(value=amount.by, sd=amount.sd or 0.0))


def wheel_gain(machine: Machine, amount: Amount) -> Machine:
    """by: the natural logarithm of reading over true angle. It goes into the scale; `gain` has the sd.

    x = sign (raw scale + offset) - zero, degrees.
    """
    wheel, factor = machine.wheel_angle, math.exp(amount.by)
    keys: dict[str, object] = {}
    if amount.sd is not None:
        keys["gain"] = Quantity(value=wheel.gain.value, sd=wheel.gain.value * amount.sd)
    if factor != 1.0:
        keys["zero"] = Quantity(value=wheel.zero.value / factor, sd=wheel.zero.sd)
        if wheel.lookup is not None:
            keys["lookup"] = [(reading, angle / factor) for reading, angle in wheel.lookup]
        elif wheel.pgn is not None:
            keys["lookup"] = [(-90.0, -90.0 / factor), (90.0, 90.0 / factor)]
        else:
            keys |= {"scale": wheel.scale / factor, "offset": wheel.offset / factor}
    return updated(machine, "wheel_angle", **keys)


# Receivers.


def _with(machine: Machine, change: Callable[[Receiver], dict[str, object]]) -> Machine:
    """change: of a receiver, to its keys that change."""
    return machine.model_copy(update={"receiver": [r.model_copy(update=change(r)) for r in machine.receiver]})


def of_receiver(mount: Mount, change: Callable[[Receiver, Amount], dict[str, object]]) -> Change:
    """change: to the keys of that receiver that change."""
    return lambda machine, amount: _with(machine, lambda r: change(r, amount) if r.mount is mount else {})


def _moved(r: Receiver, forward: float, right: float) -> tuple[float, float, float]:
    return (r.position[0] + forward, r.position[1] + right, r.position[2])


def forward(r: Receiver, amount: Amount) -> dict[str, object]:
    """One receiver, m."""
    return {"position": _moved(r, amount.by, 0.0), "survey_sd": _sd(r.survey_sd, amount)}


def right(r: Receiver, amount: Amount) -> dict[str, object]:
    """One receiver, m."""
    return {"position": _moved(r, 0.0, amount.by), "survey_sd": _sd(r.survey_sd, amount)}


def latency(r: Receiver, amount: Amount) -> dict[str, object]:
    """One receiver, s; none is earlier than its measurement."""
    value = max(r.latency.value + amount.by, SHORTEST_LATENCY_S)
    return {"latency": Quantity(value=value, sd=_sd(r.latency.sd, amount))}


def roll_zero(r: Receiver, amount: Amount) -> dict[str, object]:
    """One receiver, rad. A file that gives none keeps none where none is found."""
    if r.roll_zero is None and amount.by == 0.0:
        return {}
    stated = r.roll_zero or Quantity(value=0.0, sd=ADJUSTMENT.roll_zero_sd)
    value = stated.value + math.degrees(amount.by)
    return {"roll_zero": Quantity(value=value, sd=_sd(stated.sd, amount, math.degrees))}


def all_late(machine: Machine, amount: Amount) -> Machine:
    """All receivers, s."""
    return _with(machine, lambda r: latency(r, amount))


def pair_forward(body: str) -> Change:
    """Both receivers of a body, m."""

    def change(machine: Machine, amount: Amount) -> Machine:
        sd = {} if amount.sd is None else {"lever_sd": amount.sd}
        moved = _with(
            machine, lambda r: {"position": _moved(r, amount.by, 0.0)} if r.mount.body == body else {}
        )
        return updated(moved, body, **sd)

    return change


def pair_right(body: str) -> Change:
    """Both receivers of a body, m."""

    def of(r: Receiver, amount: Amount) -> dict[str, object]:
        if r.mount.body != body:
            return {}
        sd = r.survey_sd if amount.sd is None else max(_sd(r.survey_sd, amount), ADJUSTMENT.least_survey)
        return {"position": _moved(r, 0.0, amount.by), "survey_sd": sd}

    return lambda machine, amount: _with(machine, lambda r: of(r, amount))


def _middle(machine: Machine, body: str) -> tuple[float, float]:
    places = [r.position for r in machine.receiver if r.mount.body == body]
    return sum(p[0] for p in places) / len(places), sum(p[1] for p in places) / len(places)


def pair_turned(body: str) -> Change:
    """Both receivers of a body about the middle between them, rad, clockwise."""

    def change(machine: Machine, amount: Amount) -> Machine:
        middle = _middle(machine, body)
        cosine, sine = math.cos(amount.by), math.sin(amount.by)

        def of(r: Receiver) -> dict[str, object]:
            if r.mount.body != body:
                return {}
            x, y = r.position[0] - middle[0], r.position[1] - middle[1]
            turned = (cosine - 1.0) * x - sine * y, sine * x + (cosine - 1.0) * y
            keys: dict[str, object] = {"position": _moved(r, *turned)}
            if amount.besides:
                keys["survey_sd"] = math.hypot(r.survey_sd, (amount.sd or 0.0) * abs(x))
            return keys

        known = amount.sd is not None and not amount.besides
        sd = {"pair_yaw_sd": math.degrees(amount.sd or 0.0)} if known else {}
        return updated(_with(machine, of), body, **sd)

    return change


def pair_longer(body: str) -> Change:
    """From rear to front receiver of a body, m."""

    def change(machine: Machine, amount: Amount) -> Machine:
        middle = _middle(machine, body)

        def of(r: Receiver) -> dict[str, object]:
            x, y = r.position[0] - middle[0], r.position[1] - middle[1]
            length = math.hypot(x, y)
            if r.mount.body != body or length == 0.0:
                return {}
            share = amount.by / (2.0 * length)
            return {"position": _moved(r, share * x, share * y)}

        return _with(machine, of)

    return change
