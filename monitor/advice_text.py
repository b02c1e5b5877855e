"""Reads the advice of an estimate, which goes over the wire as a sentence, into a record."""

import re
from enum import Enum, auto
from typing import Final, NamedTuple

from tilth.estimator.models.manoeuvres import MANOEUVRES, Manoeuvre, manoeuvre_named
from tilth.schemas.flow import PARAMETERS

_NUMBER: Final = r"(\d+(?:\.\d+)?)"
_NAMES: Final = re.compile("|".join(map(re.escape, PARAMETERS)))
_TOO_SLOW: Final = re.compile(rf"nothing can be learned below {_NUMBER} m/s")
_TURN: Final = manoeuvre_named("turn").called.removeprefix("a ").partition("{")[0]
_NEXT_TURN: Final = re.compile(rf"; the next {re.escape(_TURN)}.* would bring ({_NAMES.pattern}) to ")


class AdviceKind(Enum):
    NONE = auto()  # no sentence, or one that is not understood
    TOO_SLOW = auto()  # nothing can be learned below `speed`
    NOT_AT_THIS_SPEED = auto()  # no manoeuvre is mild enough at this speed
    NOTHING_HELPS = auto()  # every manoeuvre would tell little more
    MANOEUVRE = auto()


class Advice(NamedTuple):
    kind: AdviceKind
    parameters: tuple[str, ...] = ()  # of PARAMETERS, that are known least
    speed: float = 0.0  # m/s, for TOO_SLOW
    manoeuvre: Manoeuvre | None = None  # for MANOEUVRE
    seconds: str = ""  # how long it takes; as it was written
    degrees: str = ""  # of the front wheels; as it was written
    turn_tells: str = ""  # the parameter that the next headland turn tells most of


NO_ADVICE: Final = Advice(AdviceKind.NONE)


def parse_advice(text: str) -> Advice:
    """The sentences of `advise` in estimator/results/advice.py."""
    if (too_slow := _TOO_SLOW.fullmatch(text)) is not None:
        return Advice(AdviceKind.TOO_SLOW, speed=float(too_slow[1]))
    start, _, rest = text.partition("; ")
    names = tuple(_NAMES.findall(start))
    found_turn = _NEXT_TURN.search(rest)
    turn = found_turn[1] if found_turn else ""
    if not names:
        return NO_ADVICE
    if not rest:
        return Advice(AdviceKind.NOT_AT_THIS_SPEED, names)
    if rest.startswith("no "):
        return Advice(AdviceKind.NOTHING_HELPS, names, turn_tells=turn)
    for manoeuvre in MANOEUVRES:
        found = re.match(_sentence(manoeuvre), rest) if manoeuvre.driven else None
        if found is not None:
            return Advice(AdviceKind.MANOEUVRE, names, 0.0, manoeuvre, found[1], found[2], turn)
    return NO_ADVICE


def _sentence(manoeuvre: Manoeuvre) -> str:
    """How the advice begins that names this manoeuvre, as a pattern with its seconds and degrees."""
    before, after = map(re.escape, manoeuvre.called.split("{:g}"))
    return rf"{_NUMBER} s of {before}{_NUMBER}{after} would "
