"""Between the estimate and a controller's gains: bounds, a rate limit, freezing, a shadow mode.

    latest ─► usable? ─► certain enough? ─► within bounds of nominal ─► no faster than the rate ─► in force

Plain arithmetic with the time as an argument: the same in a simulation, in a test and in the loop.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tilth.client.latest import Latest
from tilth.schemas.flow import PARAMETERS

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """ratio: how far a parameter may be from nominal, as a factor up or down. per_s: how fast the natural
    logarithm of a parameter in force may move: 0.1 is 10 % a second. log_sd: a parameter that is less certain
    than this (sd of its logarithm) is not followed. doubt_sd: leave nominal only by what the data cannot do
    without: of the way to the estimate, so many of its own sd, all parameters together, are not gone. Three
    keep gains that are right where they are, whatever chance does to an estimate. shadow: say what would be
    used, put nominal in force."""

    ratio: float
    per_s: float
    log_sd: float = math.inf
    doubt_sd: float = 0.0
    shadow: bool = False

    def __post_init__(self) -> None:
        if not (math.isfinite(self.ratio) and self.ratio >= 1):
            raise ValueError(f"ratio = {self.ratio}: give a factor of 1 or more, such as 3")
        if not (math.isfinite(self.per_s) and self.per_s > 0):
            raise ValueError(f"per_s = {self.per_s}: give a rate above zero, such as 0.1")
        if not self.log_sd > 0:
            raise ValueError(f"log_sd = {self.log_sd}: give a limit above zero, or math.inf")
        if not (math.isfinite(self.doubt_sd) and self.doubt_sd >= 0):
            raise ValueError(f"doubt_sd = {self.doubt_sd}: give 0 or more, such as 3")


@dataclass(frozen=True, slots=True)
class InForce:
    """theta: what the gains are to be made from, shape (6,), N/rad and m. wanted: where it is going, or would
    in shadow mode. notes: of each of PARAMETERS, what holds it back; "" where it follows the estimate."""

    theta: Array
    wanted: Array
    notes: tuple[str, ...]


class Cautious:
    """Holds the parameters in force. Begins at nominal; each goes back there, at the rate, when it may not be
    used. One thread calls it."""

    def __init__(self, nominal: ArrayLike, limits: Limits) -> None:
        """nominal: shape (6,), as PARAMETERS, N/rad and m, all above zero."""
        values = np.array(nominal, dtype=float)
        if values.shape != (len(PARAMETERS),) or not (np.isfinite(values) & (values > 0)).all():
            raise ValueError("nominal: give six numbers above zero, in the order " + ", ".join(PARAMETERS))
        self.limits = limits
        self.frozen = False  # set it to hold what is in force, whatever is heard
        self._nominal = np.log(values)
        self._log = self._nominal.copy()
        self._t_s: float | None = None

    def step(self, latest: Latest, t_s: float) -> InForce:
        """What is in force at t_s, by any clock that never steps."""
        elapsed_s = 0.0 if self._t_s is None else max(t_s - self._t_s, 0.0)
        self._t_s = t_s
        wanted, notes = self._wanted(latest)
        if self.frozen:
            return InForce(self._in_force(), np.exp(wanted), ("frozen",) * len(PARAMETERS))
        most = self.limits.per_s * elapsed_s
        moves = np.clip(wanted - self._log, -most, most)
        self._log = self._log + moves
        late = np.abs(wanted - self._log) > 1e-9
        all_notes = tuple(
            "; ".join(filter(None, (note, "moving at the rate limit" if slow else "")))
            for note, slow in zip(notes, late, strict=True)
        )
        if self.limits.shadow:
            all_notes = tuple(
                "; ".join(filter(None, ("shadow: nominal is in force", note))) for note in all_notes
            )
        return InForce(self._in_force(), np.exp(wanted), all_notes)

    def _in_force(self) -> Array:
        return np.asarray(np.exp(self._nominal if self.limits.shadow else self._log))

    def _wanted(self, latest: Latest) -> tuple[Array, list[str]]:
        """Natural logarithms to move to, and for each what keeps it from the estimate."""
        off, notes = np.zeros(len(PARAMETERS)), list(latest.refusals)
        if latest.estimate is None:
            return self._nominal.copy(), notes
        covariance = np.reshape(latest.estimate.log_covariance, (-1, len(PARAMETERS)))
        for i, value in enumerate(latest.theta(np.exp(self._nominal)).tolist()):
            if notes[i]:
                continue
            sd = math.sqrt(covariance[i, i])
            if sd > self.limits.log_sd:
                notes[i] = f"too uncertain: {sd:.0%} where {self.limits.log_sd:.0%} is allowed"
                continue
            off[i] = math.log(value) - self._nominal[i]
        share, doubt_note = self._undoubted(off, covariance)
        span = math.log(self.limits.ratio)
        for i in np.flatnonzero(off).tolist():
            move = share * off[i]
            off[i] = min(max(move, -span), span)
            notes[i] = doubt_note
            if off[i] != move:
                value, held = np.exp(self._nominal[i] + np.array([move, off[i]])).tolist()
                notes[i] = f"held at {held:.4g}: {value:.4g} is beyond the bounds of nominal"
        return self._nominal + off, notes

    def _undoubted(self, off: Array, covariance: Array) -> tuple[float, str]:
        """How much of the way from nominal to go, and why not all of it. off: of the logarithms, (6,)."""
        used = np.flatnonzero(off)
        if not self.limits.doubt_sd or not len(used):
            return 1.0, ""
        block = covariance[np.ix_(used, used)]
        distance = math.sqrt(max(float(off[used] @ np.linalg.pinv(block, hermitian=True) @ off[used]), 0.0))
        share = max(0.0, 1.0 - self.limits.doubt_sd / distance) if distance else 0.0
        if share == 0.0:
            return share, f"nominal explains the data: the estimate is {distance:.1f} sd from it"
        return share, f"{share:.0%} of the way: the estimate is {distance:.0f} sd from nominal"
