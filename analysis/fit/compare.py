"""Two answers of `tilth fit` beside each other: what differs beyond chance.

The two may be of two logs, days, machine files or versions. They are taken for independent: where they share
data or the errors of one machine, they differ less than the intervals say.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc  # scipy.stats takes a second to import

from tilth.analysis.fit.result import FitAnswer, JointAnswer
from tilth.analysis.runs.nuisance_words import WORDS, nuisance_value
from tilth.schemas.flow import PARAMETERS
from tilth.schemas.spread import interval

SAME: Final = (
    "Both give the same numbers to the last digit: they are of one drive. That says nothing of how well a "
    "second drive would agree."
)
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


def compare(first: FitAnswer, second: FitAnswer) -> FitComparison:
    """first, second: as result.as_json gives them. Raises NotComparable."""
    one, other = _joint(first, "first"), _joint(second, "second")
    same = one == other
    both = [name for name in PARAMETERS if _value(one, name) and _value(other, name)]
    shared = [name for name in one["nuisances"] if name in other["nuisances"]]
    tried = len(both) + len(shared)
    whole = np.array(one["log_covariance"], np.float64) + np.array(other["log_covariance"], np.float64)
    at = [PARAMETERS.index(name) for name in both]
    parameters, nuisances = list[Difference](), list[Difference]()
    for name, k in zip(both, at, strict=True):
        values = _value(one, name), _value(other, name)
        ratio = values[1] / values[0]
        parameters.append(_difference(name, values, math.log(ratio), math.sqrt(whole[k, k]), tried))
    for name in shared:
        a, b = one["nuisances"][name], other["nuisances"][name]
        sd = math.hypot(a["sd"], b["sd"])  # of a difference of two independent numbers
        nuisances.append(_difference(name, (a["value"], b["value"]), b["value"] - a["value"], sd, tried))
    change = np.array([found.change for found in parameters])
    found = float(change @ np.linalg.solve(whole[np.ix_(at, at)], change)) if both else 0.0
    p = float(chdtrc(len(both), found)) if both else 1.0
    missing = tuple(name for name in PARAMETERS if name not in both)
    reasons = (a["parameters"][name]["reason"] for name in missing for a in (one, other))
    why = next((f" ({reason})" for reason in reasons if reason), "")
    sentence = SAME if same else _sentence(parameters, nuisances, (found, len(both), p), why)
    told = tuple(parameters), tuple(nuisances)
    return FitComparison(*told, found, len(both), p, missing, sentence)


def _joint(answer: FitAnswer, which: str) -> JointAnswer:
    """Raises NotComparable."""
    if not answer["joint"]:
        raise NotComparable(f"the {which} has no joint estimate: none of its segments told anything")
    return answer["joint"]


def _value(joint: JointAnswer, name: str) -> float:
    """0 where there is none."""
    return joint["parameters"][name]["value"] or 0.0


def _difference(name: str, values: tuple[float, float], change: float, sd: float, tried: int) -> Difference:
    p = math.erfc(abs(change) / sd / math.sqrt(2.0)) if sd > 0.0 else float(change == 0.0)
    return Difference(name, *values, change, sd, p, p < BEYOND / tried)


def _sentence(
    parameters: Sequence[Difference], nuisances: Sequence[Difference], six: tuple[float, int, float], why: str
) -> str:
    """six: chi-square, degrees of freedom and p. why: a parameter is not given by both."""
    found, dof, p = six
    if not dof:
        return f"Neither gives a parameter that the other gives, too{why}."
    spread = f"chi-square {found:.1f} with {dof} degrees of freedom, p = {p:.2g}"
    told = [
        f"{one.name} × {math.exp(one.change):.2f} ({low:.2f} to {high:.2f})"
        for one in parameters
        for low, high in [interval(math.exp(one.change), one.sd)]
        if one.beyond_chance
    ]
    told += [
        f"{WORDS[one.name].words} ({one.name}) from {nuisance_value(one.name, one.first)} to "
        f"{nuisance_value(one.name, one.second)}"
        for one in nuisances
        if one.beyond_chance
    ]
    if not told and p >= BEYOND:
        return f"Nothing differs beyond chance ({spread})."
    if not told:
        return f"The six together differ beyond chance, no one of them alone ({spread})."
    return f"Beyond chance differ: {'; '.join(told)} ({spread} of the six together)."
