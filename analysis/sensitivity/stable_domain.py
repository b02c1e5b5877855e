"""Where in the range of two parameters rigs are unstable: counted, drawn and said in words."""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from tilth.analysis.sensitivity.answers import BoundaryLine, PairAnswer
from tilth.analysis.sensitivity.designs import Design, Grid, LogNormal
from tilth.estimator.models.family import Model
from tilth.estimator.models.linear_analysis import LINEAR_ANALYSIS, eigenvalues, system
from tilth.estimator.models.parameters import Rig

Array = NDArray[np.float64]
Counts = NDArray[np.int64]

SHOWN: Final = 6  # pairs
LINE: Final = 25  # points along each axis, of the line where the machine file's rig becomes unstable
_END: Final = 0.005  # of a normal distribution: where its outer levels end


class Corner(NamedTuple):
    """A part of the range of two parameters: from an end of each to a level. score: of how well it is the
    part where rigs are unstable, the harmonic mean of `unstable` and `holds`."""

    names: tuple[str, str]
    high: tuple[bool, bool]  # whether it is the upper end
    ends: tuple[float, float]  # SI: from there up, or up to there
    unstable: float  # share of its rigs
    holds: float  # share of all unstable rigs
    score: float


def edges(design: Design, k: int) -> Array:
    """Where the levels of a parameter begin and end, SI, (levels + 1,)."""
    if isinstance(design, LogNormal):
        parts = np.clip(np.arange(design.levels + 1) / design.levels, _END, 1.0 - _END)
        return np.asarray(design.median[k] * np.exp(np.sqrt(design.log_covariance[k][k]) * ndtri(parts)))
    low, high = design.box.low[k], design.box.high[k]
    if isinstance(design, Grid):
        at = np.linspace(low, high, design.levels)
        return np.concatenate([[low], (at[1:] + at[:-1]) / 2, [high]])
    return np.linspace(low, high, design.levels + 1)


def pair_answer(
    model: Model, rig: Rig, speed: float, design: Design, there: Counts, unstable: Counts
) -> list[PairAnswer]:
    """Of the pairs that tell most, the clearest first. there, unstable: (k, k, levels, levels)."""
    k = len(design.names)
    if not unstable.any():
        return []
    pairs = [(one, other) for one in range(k) for other in range(one + 1, k)]
    scores = {pair: _corner(design, *pair, there, unstable).score for pair in pairs}
    shown: list[PairAnswer] = []
    for one, other in sorted(pairs, key=lambda pair: -scores[pair])[:SHOWN]:
        shown.append({
            "names": [design.names[one], design.names[other]],
            "low_to_high": [edges(design, one).tolist(), edges(design, other).tolist()],
            "shares": [[None if np.isnan(share) else share for share in row]
                       for row in _shares(there[one, other], unstable[one, other]).tolist()],
            "line": _line(model, rig, speed, design, one, other),
        })  # fmt: skip
    return shown


def _shares(there: Counts, unstable: Counts) -> Array:
    with np.errstate(invalid="ignore"):
        return np.asarray(unstable / there)


def _line(model: Model, rig: Rig, speed: float, design: Design, one: int, other: int) -> BoundaryLine:
    first, second = (
        np.linspace(edges(design, k)[0], edges(design, k)[-1], LINE).tolist() for k in (one, other)
    )
    names = design.names[one], design.names[other]
    growth = [
        [_growth(model, rig._replace(**{names[0]: x, names[1]: y}), speed) for y in second] for x in first
    ]
    return {"at": [first, second], "growth": growth}


def _growth(model: Model, rig: Rig, speed: float) -> float:
    """Largest real part of the poles, 1/s; integrators aside, for the line would hang on their rounding."""
    poles = eigenvalues(system(model, rig, speed).a)
    moving = poles[np.abs(poles) > LINEAR_ANALYSIS.at_origin]
    return float(moving.real.max()) if len(moving) else -1.0


def clearest(design: Design, there: Counts, unstable: Counts) -> Corner | None:
    """The corner of two parameters' ranges that is best the part where rigs are unstable; None where none
    is, or there is one parameter only."""
    k = len(design.names)
    if not unstable.any() or k < 2:
        return None
    pairs = [(one, other) for one in range(k) for other in range(one + 1, k)]
    return max((_corner(design, *pair, there, unstable) for pair in pairs), key=lambda corner: corner.score)


def _corner(design: Design, one: int, other: int, there: Counts, unstable: Counts) -> Corner:
    total = int(unstable[one, other].sum())
    found = []
    for up in ((False, False), (False, True), (True, False), (True, True)):
        turned = tuple(slice(None, None, -1) if high else slice(None) for high in up)
        rigs, bad = (
            np.cumsum(np.cumsum(counts[one, other][turned], axis=0), axis=1) for counts in (there, unstable)
        )
        for i in range(design.levels):
            for j in range(design.levels):
                inside, holds = bad[i, j] / max(rigs[i, j], 1), bad[i, j] / total
                score = 2 * inside * holds / (inside + holds) if bad[i, j] else 0.0
                ends = _end(design, one, i, up[0]), _end(design, other, j, up[1])
                names = design.names[one], design.names[other]
                found.append(Corner(names, up, ends, float(inside), float(holds), float(score)))
    return max(found, key=lambda corner: corner.score)


def _end(design: Design, k: int, level: int, high: bool) -> float:
    """Where a corner of so many levels and one more ends; of a grid the value of its last level."""
    if isinstance(design, Grid):
        at = np.linspace(design.box.low[k], design.box.high[k], design.levels)
        return float(at[-1 - level] if high else at[level])
    found = edges(design, k)
    return float(found[-2 - level] if high else found[level + 1])
