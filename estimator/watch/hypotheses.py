"""What may have been moved, and how well each explains the difference between what was and what is.

A change adds `directions @ amounts` to the constants of information.py. Those of old samples, plus drift,
predict those of new samples. The likelihood ratio of "this has changed" against "nothing has" is a chi-square
in as many degrees of freedom as there are amounts, largest for what fits best.
"""

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.once import once_for_a_machine
from tilth.estimator.pose.aligner import MOUNTS
from tilth.estimator.watch.information import (
    CRAB,
    DELAY,
    HITCH,
    LENGTH,
    ZERO,
    InformationForm,
    Lengths,
    N,
    drift,
    lengths,
    prior_information,
)
from tilth.schemas.machine import Machine

Array = NDArray[np.float64]

SMALL: Final = 1e-9  # keeps a direction of which the samples tell nothing from a division by zero
WHEEL: Final = "wheel_angle"
DRAWBAR: Final = "drawbar"
PAIRS: Final = ("pair_tractor", "pair_implement")
LATENCIES: Final = tuple(f"latency_{mount.value}" for mount in MOUNTS)


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """Something that may have been moved."""

    name: str  # a mount, or one of PAIRS, WHEEL, DRAWBAR, LATENCIES
    directions: Array  # (N, m): change of the constants by each of its m amounts, m or rad or s


class Explanation(NamedTuple):
    """How well a suspect explains new samples."""

    name: str
    chi_square: float  # by how much it makes them fit better
    amounts: Array  # (m,)
    covariance: Array  # (m, m)


@once_for_a_machine
def hypotheses(machine: Machine) -> tuple[Hypothesis, ...]:
    """All of a machine file with four receivers."""
    rig = lengths(machine)
    found = [Hypothesis(mount.value, _moved(rig, k)) for k, mount in enumerate(MOUNTS)]
    found += [Hypothesis(name, _turned(rig, body)) for body, name in enumerate(PAIRS)]
    found += [_one(WHEEL, ZERO), _one(DRAWBAR, HITCH + 2)]
    return (*found, *(_one(name, DELAY + k) for k, name in enumerate(LATENCIES)))


def _one(name: str, at: int) -> Hypothesis:
    directions = np.zeros((N, 1))
    directions[at, 0] = 1.0
    return Hypothesis(name, directions)


def _moved(rig: Lengths, k: int) -> Array:
    """A receiver: forward and right, m."""
    body, front = k // 2, k % 2 == 0
    sign = 1.0 if front else -1.0
    out = np.zeros((N, 2))
    out[LENGTH + body, 0], out[HITCH + 2 * body, 0] = sign, 0.5
    out[HITCH + 2 * body + 1, 1], out[CRAB + body, 1] = rig.shares[k], -sign / rig.spans[body]
    return out


def _turned(rig: Lengths, body: int) -> Array:
    """Both receivers of a body about the middle between them, rad, clockwise."""
    half = rig.spans[body] / 2
    return (_moved(rig, 2 * body) - _moved(rig, 2 * body + 1))[:, 1:] * half


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
    allowed = covariance + drift()
    kept = np.linalg.inv(np.eye(N) + now.information @ allowed)
    score, weight = kept @ (now.vector - now.information @ mean), kept @ now.information
    found = []
    for hypothesis in hypotheses(machine):
        d = hypothesis.directions
        spread = _inverse(d.T @ weight @ d + SMALL * np.eye(d.shape[1]))
        along = d.T @ score
        amounts = spread @ along
        found.append(Explanation(hypothesis.name, float(along @ amounts), amounts, spread))
    return sorted(found, key=lambda explanation: -explanation.chi_square)
