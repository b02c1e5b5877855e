"""What an operator says of the implement's load: full, half, empty, unknown, or a mass such as 6.2 t."""

import math
import re
from typing import Final

from tilth.schemas.flow import Carried, LoadSource
from tilth.schemas.machine import Load, Machine

LEVELS: Final = {"full": (1.0, 0.05), "half": (0.5, 0.15), "empty": (0.0, 0.01)}
"""Word -> share of what a full one carries, and its sd over that."""
GUESSED: Final = 0.05  # sd of a mass that somebody tells, over it: of a weigh ticket, or of a tank's level
BEYOND: Final = 1.2  # most that is carried, over what a full one does
_MASS: Final = re.compile(r"([0-9]*[.,]?[0-9]+) *(t|kg)")
_SAY: Final = "say full, half, empty, unknown, or a mass with its unit, such as 6.2 t or 6200 kg"


def said_of_load(machine: Machine, text: str, t_ns: int) -> Carried | str:
    """What is said, or why that cannot be, in words. machine: with the empty implement."""
    load = machine.implement.load
    if load is None:
        name = machine.implement.name or "this implement"
        return (
            f"the machine file does not say what {name} can carry: add [implement.load] with mass (when "
            "it is full), ahead_of_axle and height"
        )
    if text == "unknown":
        return of_nobody(machine, load, t_ns)
    if text in LEVELS:
        share, sd = LEVELS[text]
        return Carried(t_ns, share * load.mass.value, sd * load.mass.value, LoadSource.OPERATOR)
    if (told := _MASS.fullmatch(text)) is None:
        return f"{text} is no load: {_SAY}"
    mass = float(told[1].replace(",", ".")) * (1e3 if told[2] == "t" else 1.0)
    if mass > BEYOND * load.mass.value:
        return (
            f"{mass / 1e3:.1f} t is more than it carries when it is full ({load.mass.value / 1e3:.1f} t), "
            "and than its tyres are meant for. Say what it carries, without its own mass; if it does carry "
            "that, correct implement.load.mass in the machine file"
        )
    return Carried(t_ns, mass, max(GUESSED * mass, LEVELS["empty"][1] * load.mass.value), LoadSource.OPERATOR)


def log_range(machine: Machine, load: Load) -> float:
    """Logarithm of the full implement's mass over that of the empty one."""
    return math.log1p(load.mass.value / machine.implement.mass.value)


def of_nobody(machine: Machine, load: Load, t_ns: int) -> Carried:
    """What it carries where nobody has said it: all is possible. machine: with the empty implement."""
    own, widest = machine.implement.mass.value, log_range(machine, load)
    middle = own * math.exp(widest / 2.0)
    return Carried(t_ns, middle - own, middle * widest / math.sqrt(12.0), LoadSource.NOBODY)
