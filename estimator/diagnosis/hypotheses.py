"""What may have been moved, and how well each explains the difference between what was and what is.

A change adds `directions @ amounts` to the constants of information.py. Those of old samples, plus drift,
predict those of new samples. The generalized likelihood ratio of "this has changed" against "nothing has" is
largest for what fits best. Twice its logarithm is a chi-square in as many degrees of freedom as there are
amounts. There are at most two, so while nothing has changed it is above x with a chance of at most exp(-x).
"""

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.diagnosis.information import (
    AT,
    FORWARD,
    HITCH,
    LONGER,
    PAIR,
    InformationForm,
    Lengths,
    N,
    drift,
    lengths,
    prior_information,
    slopes_of,
)
from tilth.estimator.once import once_for_a_machine
from tilth.estimator.pose.aligner import MOUNTS
from tilth.estimator.rig.numbers import HYPOTHESES, PAIRS, WHEEL_SPEED, Hypothesis
from tilth.estimator.rig.residuals import LEVERS, pair_turn
from tilth.schemas.machine import Machine

Array = NDArray[np.float64]

SMALL: Final = 1e-9  # keeps a direction of which the samples tell nothing from a division by zero


@dataclass(frozen=True, slots=True)
class FaultSignature:
    """Something that may have been moved."""

    name: str  # a row of HYPOTHESES
    directions: Array  # (N, m): change of the constants by each of its m amounts, m or rad or s


class Explanation(NamedTuple):
    """How well a suspect explains new samples."""

    name: str
    log_ratio: float  # logarithm of the generalized likelihood ratio
    amounts: Array  # (m,)
    covariance: Array  # (m, m)


@once_for_a_machine
def hypotheses(machine: Machine) -> tuple[FaultSignature, ...]:
    """All of a machine file with four receivers."""
    rig = lengths(machine)
    moved = [_moved(rig, body) for body in (0, 1)]
    receivers = {
        mount.value: moved[k // 2][:, 2 * (k % 2) : 2 * (k % 2) + 2] for k, mount in enumerate(MOUNTS)
    }
    turns = pair_turn(rig.levers)[:, :, None]  # of both receivers about the middle between them, clockwise
    receivers |= {name: moved[body] @ turns[body] for body, name in enumerate(PAIRS)}
    return tuple(
        FaultSignature(row.name, receivers[row.name] if row.name in receivers else _alone(row))
        for row in HYPOTHESES
        if row.name != WHEEL_SPEED
    )


def _alone(row: Hypothesis) -> Array:
    """What samples tell of directly."""
    directions = np.zeros((N, 1))
    directions[AT[row.numbers[0]], 0] = row.sign
    return directions


def _moved(rig: Lengths, body: int) -> Array:
    """(N, 4): both receivers of a body, front first, each forward and right, m.

    What a receiver shows that was moved is what one shows whose place in the file is wrong the other way.
    """
    slopes = slopes_of(rig, np.zeros((2, 3)), np.zeros(2))
    out, hitch = np.zeros((N, 4)), slice(2 * body, 2 * body + 2)
    out[LONGER[body]] = -slopes.excess[body, LEVERS]
    out[HITCH[hitch]] = -slopes.hitch[body][:, LEVERS] * FORWARD[hitch, None]
    out[PAIR[body]] = -slopes.heading[body, LEVERS]
    return out


def _inverse(matrix: Array) -> Array:
    return np.asarray(np.linalg.inv(matrix), dtype=np.float64)


def posterior(evidence: InformationForm) -> tuple[Array, Array]:
    """(mean (N,), covariance (N, N)) of the constants."""
    covariance = _inverse(evidence.information + prior_information())
    return covariance @ evidence.vector, covariance


def judge(machine: Machine, mean: Array, covariance: Array, now: InformationForm) -> list[Explanation]:
    """Every suspect, the best explanation first.

    mean (N,), covariance (N, N): of the constants by samples before `now`, without drift.
    """
    kept = _kept(covariance, now)
    score, weight = kept @ (now.vector - now.information @ mean), kept @ now.information
    found = []
    for hypothesis in hypotheses(machine):
        d = hypothesis.directions
        spread = _inverse(d.T @ weight @ d + SMALL * np.eye(d.shape[1]))
        along = d.T @ score
        amounts = spread @ along
        found.append(Explanation(hypothesis.name, float(along @ amounts) / 2.0, amounts, spread))
    return sorted(found, key=lambda explanation: -explanation.log_ratio)


def _kept(covariance: Array, now: InformationForm) -> Array:
    """(N, N): what of new samples' information is left where the constants may drift."""
    return _inverse(np.eye(N) + now.information @ (covariance + drift()))


def isolability(machine: Machine, before: InformationForm, now: InformationForm) -> tuple[list[str], Array]:
    """(numbers of the rig [n], angles (n, n)), degrees, between what faults do to the whitened residuals of
    `now`, with the constants as well known as by `before`: 90 where they have nothing in common, near 0 where
    samples hardly tell one from the other."""
    _, covariance = posterior(before)
    weight = _kept(covariance, now) @ now.information
    names = [number for row in HYPOTHESES if row.name != WHEEL_SPEED for number in row.numbers]
    d = np.hstack([hypothesis.directions for hypothesis in hypotheses(machine)])
    inner = d.T @ weight @ d
    sizes = np.sqrt(np.diag(inner))
    return names, np.degrees(np.arccos(np.minimum(np.abs(inner / np.outer(sizes, sizes)), 1.0)))
