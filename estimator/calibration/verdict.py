"""Is it good, and why not? Each number with what was known before, what the drive told, twice from halves,
and what it costs the six parameters of soil and tyres."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from tilth.estimator.calibration import sought_numbers
from tilth.estimator.calibration.calibrate import Calibration
from tilth.estimator.calibration.drive import MOUNTS
from tilth.estimator.calibration.initial_guess import INITIAL_GUESS, DrivingCoverage
from tilth.estimator.calibration.joint import Half
from tilth.estimator.calibration.sought_numbers import BY_LIKELIHOOD, SOUGHT
from tilth.estimator.filters.unknowns import AT, SIX
from tilth.estimator.rig.numbers import CIRCLE, FOLD, ROW, WEAVE, RigNumber
from tilth.estimator.tuning import tuned
from tilth.schemas.flow import PARAMETERS
from tilth.schemas.machine import Machine

Array = NDArray[np.float64]

IDENTIFIED, WEAKLY_IDENTIFIED, NOT_IDENTIFIABLE = "told", "rough", "not told"


@dataclass(frozen=True, slots=True)
class VerdictTuning:
    """How well a number must be known."""

    enough_s: float = tuned(15.0, "s", "of a way of driving")
    one_way_sd: float = tuned(math.radians(0.2), "rad", "of the yaw of pairs by a slope of 2° one way")
    disagree: float = tuned(0.01, "1", "p of the halves' difference, of one number")
    identifiable: float = tuned(0.5, "1", "of the prior sd: a larger sd says that the drive tells nothing")


VERDICT: Final = VerdictTuning()


@dataclass(frozen=True, slots=True)
class NumberVerdict:
    """One number. SI; `moved` is on top of what the file said."""

    number: RigNumber
    moved: float
    sd: float
    halves: tuple[float, float] | None  # moved by each half of the drive
    p: float | None  # that halves differ by so much by chance
    status: str  # told | rough | not told

    @property
    def why_not(self) -> str:
        """What would tell it better, "" where it is told."""
        if self.status == IDENTIFIED:
            return ""
        tape = "" if self.number.tape == "none" else f"; or {self.number.tape}"
        return f"{self.number.drive}{tape}"


@dataclass(frozen=True, slots=True)
class RigVerdict:
    """Of a calibration."""

    numbers: tuple[NumberVerdict, ...]
    chi2: float  # of all halves that can be compared
    dof: int
    p: float
    soil: dict[
        str, tuple[float, float]
    ]  # parameter -> (sd of its logarithm by this drive, share from the numbers)
    sentences: tuple[str, ...]

    @property
    def good(self) -> bool:
        """Whether every number is told as well as wanted, and the halves agree."""
        return all(one.status == IDENTIFIED for one in self.numbers) and self.p >= VERDICT.disagree


def verdict(machine: Machine, found: Calibration) -> RigVerdict:
    """machine: as it was read."""
    further = _not_in_the_fit(found)
    numbers = tuple(_number_verdict(found, number, further) for number in SOUGHT if _heard(found, number))
    zs = [_z(one, found) for one in numbers if one.halves is not None]
    chi2, dof = float(sum(z * z for z in zs)), len(zs)
    p = float(chdtrc(dof, chi2)) if dof else 1.0
    soil = soil_cost(found.fit.covariance, found.machine, numbers)
    return RigVerdict(numbers, chi2, dof, p, soil, tuple(_sentences(numbers, p, found)))


def _heard(found: Calibration, number: RigNumber) -> bool:
    place = number.name.removeprefix("roll_zero_")
    names = [mount.value for mount in MOUNTS]
    return place not in names or found.rolls.heard[names.index(place)]


def _number_verdict(found: Calibration, number: RigNumber, further: Mapping[str, float]) -> NumberVerdict:
    """further: as _not_in_the_fit gives it."""
    name, fit = number.name, found.fit
    moved, halves, p = found.moved[name], None, None
    if name in BY_LIKELIHOOD:
        k = AT[name]
        scale = dict(zip(BY_LIKELIHOOD, sought_numbers.slopes(found.machine).tolist(), strict=True))[name]
        sd = math.hypot(scale * math.sqrt(fit.covariance[k, k]), number.floor_sd, further[name])
        if fit.halves is not None:
            one, other = (moved + scale * (half.mean[k] - fit.mean[k]) for half in fit.halves)
            halves = (float(one), float(other))
            p = math.erfc(abs(_difference(fit.halves, k)) / math.sqrt(2.0))
    elif name == "aside_t":
        sd = math.hypot(found.lateral_offset_sd, number.floor_sd)
    elif name == "wheel_curve":
        sd = found.curve_sd
    elif name == "ackermann":
        k = AT["parallel"]
        sd = math.hypot(math.sqrt(fit.covariance[k, k]), number.floor_sd)
    else:
        sd = float(found.roll_sd[[m.value for m in MOUNTS].index(name.removeprefix("roll_zero_"))])
    status = (
        IDENTIFIED
        if sd <= number.wanted_sd
        else WEAKLY_IDENTIFIED
        if sd <= VERDICT.identifiable * number.prior_sd
        else NOT_IDENTIFIABLE
    )
    return NumberVerdict(number, moved, sd, halves, p, status)


def _not_in_the_fit(found: Calibration) -> dict[str, float]:
    """Number -> sd, SI, of what the fit has no unknown for: by how much receivers are later than each other,
    and the tractor's receivers aside."""
    covariance, slopes = found.fit.covariance, sought_numbers.slopes(found.machine)
    # Who is late looks like further back, at one speed; with it goes what the fit takes these places for.
    way = found.speed * float(found.delay_sd[2])
    places = {"lever_t": way / 2.0, "lever_i": way / 2.0, "c": way, "d": way}
    at = [BY_LIKELIHOOD.index(name) for name in places]
    all_rows = [AT[name] for name in BY_LIKELIHOOD]
    rows = [all_rows[k] for k in at]
    moved = np.linalg.solve(covariance[np.ix_(rows, rows)], covariance[np.ix_(rows, all_rows)])
    sds = slopes * np.sqrt((np.array(list(places.values())) / slopes[at]) ** 2 @ moved**2)
    further = dict(zip(BY_LIKELIHOOD, sds.tolist(), strict=True))
    others = {
        "c": found.hitch_sd[0], "d": found.hitch_sd[1],
        "latency": float(np.linalg.norm(found.delay_sd)) / 2.0,
        "aside_i": 0.5 * found.lateral_offset_sd,  # folded, one body's looks like the other's
    }  # fmt: skip
    if found.coverage.weaved < VERDICT.enough_s:
        others |= {
            number.name: math.hypot(others.get(number.name, 0.0), number.not_weaved_sd)
            for number in SOUGHT
            if number.not_weaved_sd
        }
    if _one_way(found.coverage):
        others |= {"pair_t": VERDICT.one_way_sd, "pair_i": VERDICT.one_way_sd}
    return further | {name: math.hypot(further[name], sd) for name, sd in others.items()}


def _one_way(coverage: DrivingCoverage) -> bool:
    """Whether hardly any straight driving has some in nearly the other direction."""
    there = coverage.directions
    back = sum(np.roll(there, 4 + k) for k in (-1, 0, 1))
    return float(np.minimum(there, back).sum()) < VERDICT.enough_s


def _difference(halves: tuple[Half, Half], k: int) -> float:
    """Sds by which halves differ."""
    one, other = halves
    variance = float(one.covariance[k, k] + other.covariance[k, k])
    return float(one.mean[k] - other.mean[k]) / math.sqrt(variance) if variance > 0.0 else 0.0


def _z(one: NumberVerdict, found: Calibration) -> float:
    assert found.fit.halves is not None
    return _difference(found.fit.halves, AT[one.number.name])


def soil_cost(
    covariance: Array, machine: Machine, numbers: Sequence[NumberVerdict]
) -> dict[str, tuple[float, float]]:
    """Parameter -> (sd of its logarithm from this drive, how much of it is the numbers' own uncertainty).
    Each number has the sd that is published: what the model leaves out of it moves the six as well.

    covariance: of the fit, (n, n). machine: after the changes.
    """
    rows = [AT[name] for name in BY_LIKELIHOOD]
    mine = covariance[np.ix_(rows, rows)]
    moved = np.linalg.solve(mine, covariance[rows][:, SIX]).T  # the six by the numbers, (6, r)
    sds = {one.number.name: one.sd for one in numbers}
    per = dict(zip(BY_LIKELIHOOD, np.abs(sought_numbers.slopes(machine)).tolist(), strict=True))
    published = np.array([sds.get(name, 0.0) / per[name] for name in BY_LIKELIHOOD])
    further = moved**2 @ np.maximum(published**2 - np.diag(mine), 0.0)
    shares = np.sqrt(np.diag(moved @ mine @ moved.T) + further)
    whole = np.sqrt(np.diag(covariance)[SIX] + further)
    return {name: (float(whole[k]), float(shares[k])) for k, name in enumerate(PARAMETERS)}


def _not_covered(coverage: DrivingCoverage, delay_sd: Array) -> Iterator[str]:
    """What would have told more, by the ways of driving that are missing."""
    if min(coverage.left, coverage.right) < VERDICT.enough_s:
        side = "left" if coverage.left < coverage.right else "right"
        yield f"Hardly a turn to the {side}: zero and scale of the wheel are told less well; {CIRCLE}."
    if _one_way(coverage):
        yield f"Straight driving in one direction only: a slope is taken for yaw of the pairs; {ROW}."
    if float(delay_sd.max()) >= INITIAL_GUESS.delay_sd:
        yield f"Nearly one speed all the way: a late receiver looks like one further back; {WEAVE}."
    if coverage.weaved < VERDICT.enough_s:
        yield f"Turns were sharp and slow: latencies, levers and hitch are told less well; {WEAVE}."
    if coverage.folded < VERDICT.enough_s:
        yield f"The implement hardly folded: hitch and drawbar are not told apart; {FOLD}."


def _sentences(numbers: tuple[NumberVerdict, ...], p: float, found: Calibration) -> list[str]:
    good = sum(one.status == IDENTIFIED for one in numbers)
    said = [f"{good} of {len(numbers)} numbers are known as well as is wanted."]
    without = [one.number.words for one in numbers if one.status == NOT_IDENTIFIABLE]
    if without:
        said.append(f"The drive does not tell: {', '.join(without)}. These stay as the file has them.")
    if p < VERDICT.disagree:
        said.append(
            "The halves of the drive do not agree: something moved on the way, or the ground is too rough."
        )
    elif found.fit.halves is not None:
        said.append("Both halves of the drive give the same numbers within their intervals.")
    said += list(_not_covered(found.coverage, found.delay_sd))
    if not found.fit.settled:
        said.append("The search has not settled; take the numbers with care, and drive again.")
    if not found.rolls.signs_told:
        said.append("Level ground: the signs of rolls were not told; on a slope of 2° they would be.")
    return said
