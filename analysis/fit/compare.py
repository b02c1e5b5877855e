"""Two answers of `tilth fit` beside each other: what differs beyond chance.

The two may be of two logs, days, machine files or versions. They are taken for independent: where they share
data or the errors of one machine, they differ less than the intervals say.
"""

import math
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc  # scipy.stats takes a second to import

from tilth.schemas.flow import PARAMETERS
from tilth.schemas.spread import interval

Array = NDArray[np.float64]

BEYOND: Final = 0.01
"""Smaller than this is beyond chance. For one number among k the limit is divided by k (Bonferroni)."""


class NotComparable(Exception):
    """One sentence that says what to do."""


@dataclass(frozen=True, slots=True)
class Difference:
    """Of one number: the second answer less the first, of the six as a ratio."""

    name: str
    first: float  # N/rad, m, or SI of a nuisance
    second: float
    change: float  # of the six the natural logarithm of second over first; else second - first
    sd: float  # of the change
    p: float  # of a larger change by chance, two-sided
    beyond_chance: bool


@dataclass(frozen=True, slots=True)
class FitComparison:
    """What two joint fits say of each other."""

    parameters: tuple[Difference, ...]
    nuisances: tuple[Difference, ...]
    chi2: float  # of the six together
    dof: int
    p: float
    missing: tuple[str, ...]  # of the six, which one of both does not give
    sentence: str

    @property
    def differ(self) -> bool:
        """Whether anything differs beyond chance."""
        rows = (*self.parameters, *self.nuisances)
        return self.p < BEYOND or any(one.beyond_chance for one in rows)


def compare(first: dict[str, Any], second: dict[str, Any]) -> FitComparison:
    """first, second: as result.as_json gives them. Raises NotComparable."""
    for which, answer in (("first", first), ("second", second)):
        if not answer.get("joint"):
            raise NotComparable(f"the {which} has no joint estimate: none of its segments told anything")
    one, other = first["joint"], second["joint"]
    both = [k for k, name in enumerate(PARAMETERS) if all(_value(a, name) is not None for a in (one, other))]
    covariances = [np.array(a["log_covariance"], np.float64) for a in (one, other)]
    whole: Array = covariances[0] + covariances[1]
    change = np.array([math.log(_value(other, PARAMETERS[k]) / _value(one, PARAMETERS[k])) for k in both])
    shared = set(one["nuisances"]) & set(other["nuisances"])
    tried = len(both) + len(shared)
    parameters = tuple(
        _difference(PARAMETERS[k], _value(one, PARAMETERS[k]), _value(other, PARAMETERS[k]), float(by),
                    math.sqrt(whole[k, k]), tried)
        for k, by in zip(both, change, strict=True)
    )  # fmt: skip
    nuisances = tuple(
        _difference(name, a["value"], b["value"], b["value"] - a["value"], _both(a["sd"], b["sd"]), tried)
        for name, a in one["nuisances"].items()
        if name in shared
        for b in [other["nuisances"][name]]
    )
    found = float(change @ np.linalg.solve(whole[np.ix_(both, both)], change)) if both else 0.0
    p = float(chdtrc(len(both), found)) if both else 1.0
    missing = tuple(name for k, name in enumerate(PARAMETERS) if k not in both)
    reasons = (a["parameters"][name]["reason"] for name in missing for a in (one, other))
    why = next((f" ({reason})" for reason in reasons if reason), "")
    sentence = _sentence(parameters, nuisances, found, len(both), p, why)
    return FitComparison(parameters, nuisances, found, len(both), p, missing, sentence)


def as_json(found: FitComparison) -> dict[str, Any]:
    """As it stands in JSON."""
    return asdict(found)


def _both(sd: float, other: float) -> float:
    """Of a difference of two independent numbers."""
    return math.hypot(sd, other)


def _value(joint: dict[str, Any], name: str) -> Any:
    return joint["parameters"][name]["value"]


def _difference(name: str, first: float, second: float, change: float, sd: float, tried: int) -> Difference:
    p = math.erfc(abs(change) / sd / math.sqrt(2.0)) if sd > 0.0 else float(change == 0.0)
    return Difference(name, first, second, change, sd, p, p < BEYOND / tried)


def _sentence(
    parameters: tuple[Difference, ...], nuisances: tuple[Difference, ...], found: float, dof: int, p: float,
    why: str,
) -> str:  # fmt: skip
    """why: a parameter is not given by both."""
    if not dof:
        return f"Neither gives a parameter that the other gives, too{why}."
    spread = f"chi-square {found:.1f} with {dof} degrees of freedom, p = {p:.2g}"
    told = [
        f"{one.name} × {math.exp(one.change):.2f} ({low:.2f} to {high:.2f})"
        for one in parameters
        for low, high in [interval(math.exp(one.change), one.sd)]
        if one.beyond_chance
    ]
    told += [f"{one.name} from {one.first:.3g} to {one.second:.3g}" for one in nuisances if one.beyond_chance]
    if not told and p >= BEYOND:
        return f"Nothing differs beyond chance ({spread})."
    if not told:
        return f"The six together differ beyond chance, no one of them alone ({spread})."
    return f"Beyond chance differ: {'; '.join(told)} ({spread} of the six together)."
