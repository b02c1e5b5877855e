"""Words of advice, and of what is determined (`schemas/reasons.py`)."""

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

from tilth.schemas.fields import KMH
from tilth.schemas.flow import PARAMETERS
from tilth.schemas.reasons import Advice, AdviceKind, Combination
from tilth.schemas.spread import share


class ManoeuvreWords(NamedTuple):
    """called: its name, with a place for the degrees; driven: the instruction to a driver."""

    called: str
    driven: str


MANOEUVRES: Final[Mapping[str, ManoeuvreWords]] = {
    "step": ManoeuvreWords(
        "a turn held at {degrees:g}°", "hold a turn for {seconds:g} s, wheels to about {degrees:g}°"
    ),
    "steps": ManoeuvreWords(
        "turns of {degrees:g}° to one side and the other",
        "turn to one side and the other, three seconds each, for {seconds:g} s, wheels to about {degrees:g}°",
    ),
    "chirp": ManoeuvreWords(
        "a chirp of {degrees:g}°",
        "weave the steering gently left and right, slow then quick, for {seconds:g} s, "
        "wheels to about {degrees:g}°",
    ),
    "turn": ManoeuvreWords(
        "a headland turn at {degrees:g}° or more",
        "turn at the headland with the wheels at {degrees:g}° or more",
    ),
}
"""Of estimator.models.manoeuvres.MANOEUVRES, those that may be advised."""


def advice_sentence(advice: Advice | None) -> str:
    """What is not determined, and which manoeuvre would help most, by how much; "" for none."""
    if advice is None:
        return ""
    if advice.kind is AdviceKind.TOO_SLOW:
        return f"nothing can be learned below {advice.speed / KMH:.3g} km/h"
    it = "it" if len(advice.parameters) == 1 else "them"
    parts = [_open(advice)]
    if advice.kind is AdviceKind.NOTHING_HELPS:
        parts.append(f"no {advice.seconds:g} s of steering at this speed would help much")
    elif advice.kind is AdviceKind.MANOEUVRE:
        called = MANOEUVRES[advice.manoeuvre].called.format(degrees=advice.degrees)
        parts.append(f"{advice.seconds:g} s of {called} would bring {it} to {share(*advice.after)}")
    if advice.turn_tells:
        parts.append(f"the next headland turn would bring {advice.turn_tells} to {share(advice.turn_after)}")
    return "; ".join(parts)


def _open(advice: Advice) -> str:
    names = listed(advice.parameters)
    if len(advice.parameters) == len(PARAMETERS):
        return f"none of {names} is determined"
    if advice.determined:
        state = "is known least"
    else:
        state = f"{'is' if len(advice.parameters) == 1 else 'are'} not determined"
    return f"{names} {state}: {share(*advice.log_sds)}"


def listed(names: Sequence[str]) -> str:
    """Such as: one, two and three."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def combination_words(one: Combination) -> str:
    """Such as: C_af/C_ar ±12 % (95 %)."""
    above = [_power(n, w) for n, w in zip(PARAMETERS, one.exponents, strict=True) if w > 0]
    below = [_power(n, -w) for n, w in zip(PARAMETERS, one.exponents, strict=True) if w < 0]
    above, below = (above, below) if above else (below, above)
    text = "·".join(above)
    if below:
        text = f"{text}/{below[0]}" if len(below) == 1 else f"{text}/({'·'.join(below)})"
    return f"{text} {share(one.log_sd)}"


def _power(name: str, exponent: float) -> str:
    return name if exponent == 1.0 else f"{name}^{exponent:.1f}"
