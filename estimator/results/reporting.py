"""From a method's posterior to its published estimate: which parameters have a number, its age and status."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.estimator.filters.unknowns import AT, NAMES, SIX, UNKNOWNS
from tilth.estimator.results import advice
from tilth.estimator.results.advice import ADVICE
from tilth.estimator.results.method_state import SixState
from tilth.estimator.ties import exceeds, within
from tilth.estimator.tuning import tuned
from tilth.schemas.flow import Estimate, ParameterEstimate, Status
from tilth.schemas.machine import Machine
from tilth.schemas.reasons import Advice, Code, Combination, Reason

Array = NDArray[np.float64]

MODEL: Final = "relaxation"


@dataclass(frozen=True, slots=True)
class ReportingTuning:
    """Which numbers are published."""

    publish_ns: int = tuned(1_000_000_000, "ns", "between two estimates of a method")
    stale_s: float = tuned(300.0, "s", "without anything learned for so long an estimate is stale")
    withdrawn: float = tuned(0.6, "1", "posterior over prior sd, above which a number is withdrawn")
    largest_deviation: float = tuned(4.5, "sd", "of the prior: a value further from its mean is no tyre's")
    rank_gain: float = tuned(3.0, "1", "information over the prior's, for a direction to be determined")
    worst_condition: float = tuned(1e9, "1", "of what the data determine; beyond, it is rounding that speaks")


REPORTING: Final = ReportingTuning()


def condition_number(eigenvalues: NDArray[np.floating[Any]]) -> float | None:
    """Largest over smallest of an information's, relative to the prior's; None where a direction is not
    determined at all: before any data all are rounding."""
    largest, smallest = float(eigenvalues.max()), float(eigenvalues.min())
    least = max(largest / REPORTING.worst_condition, ADVICE.least_information)
    return largest / smallest if exceeds(smallest, least) else None


def age_s(informed_ns: int, t_ns: int) -> float | None:
    """Time since it last learned from data, s; None if it never did."""
    return (t_ns - informed_ns) * 1e-9 if informed_ns else None


def is_supported(has_number: bool, sd_log: float, prior_sd: float) -> bool:
    """Whether a logarithm's sd is small enough for a number, with hysteresis: has_number, whether it had
    one."""
    return within(sd_log, (REPORTING.withdrawn if has_number else ADVICE.supported) * prior_sd)


def stale_reason(code: Code, seconds: float | None) -> Reason | None:
    """Why numbers are stale after so many seconds of what the code says."""
    return Reason(code, numbers=(seconds,)) if seconds is not None and seconds > REPORTING.stale_s else None


def parameter(
    log: float, sd_log: float, has_number: bool, age: float | None, missing: Reason, stale: Reason | None
) -> ParameterEstimate:
    """One parameter. missing: reason if there is no number; stale: reason if the number is stale."""
    if age is None or not has_number:
        return ParameterEstimate(None, None, Status.UNESTIMATED, missing, age)
    value = math.exp(log)
    if stale:
        return ParameterEstimate(value, value * sd_log, Status.STALE, stale, age)
    return ParameterEstimate(value, value * sd_log, Status.ESTIMATED, None, age)


OVER: Final = ("m_t", "m_t", "m_i")
"""Over which mass each stiffness is published as well, by names of the unknowns."""
_KEYS: Final = {"m_t": "tractor.mass", "m_i": "implement.mass"}


class PerMass(NamedTuple):
    """Cornering stiffnesses over the mass of their body, N/(rad kg), with their sds; (3,) of each."""

    values: tuple[float | None, ...]
    sds: tuple[float | None, ...]


def per_mass(
    machine: Machine, logs: Sequence[float], log_sds: Sequence[float], given: Sequence[bool]
) -> PerMass:
    """logs: of the stiffnesses. log_sds: of those over the masses, without what is not known of the masses.
    given: which of them have numbers."""
    masses = (machine.tractor.mass.value, machine.tractor.mass.value, machine.implement.mass.value)
    values = tuple(
        math.exp(log) / mass if has else None for log, mass, has in zip(logs, masses, given, strict=True)
    )
    sds = tuple(None if v is None else v * sd for v, sd in zip(values, log_sds, strict=True))
    return PerMass(values, sds)


def log_sds_over_masses(covariance: Array, of_masses: Sequence[float]) -> list[float]:
    """Sds of the logarithms of the three stiffnesses over the masses. covariance: of the published
    logarithms; of_masses: (3,), what of each variance is not known of the mass."""
    variances = np.diag(covariance)[:3].tolist()
    return [math.sqrt(max(own - mass, 0.0)) for own, mass in zip(variances, of_masses, strict=True)]


def of_the_mass(k: int, mass_sd: float, over_sd: float) -> Reason:
    """Why a stiffness has no number where it has one over the mass. Both sds of logarithms."""
    return Reason(Code.OF_THE_MASS, (_KEYS[OVER[k]],), (mass_sd, over_sd))


def nothing_yet(code: Code, now: Code | None) -> Reason:
    """The reason of a parameter while a method has not learned anything. now: why it does not learn now."""
    return Reason(code, because=(Reason(now),) if now else ())


def nuisance_sd(name: str, variance: float, prior_sd: float, moved: float) -> float:
    """Published sd of an unknown that is no tyre's. variance: what noise and the prior leave; without any the
    machine file states the value as exact, and the sd is zero. moved: from the prior's mean.

    It is not above the prior's, but where a doubted one has moved further than half of that: what goes
    beyond is rather an error of the model.
    """
    if variance <= 0.0:
        return 0.0
    sd = math.sqrt(variance)
    row = UNKNOWNS[AT[name]]
    said = min(math.hypot(sd, row.model_sd), max(prior_sd, sd))
    return math.hypot(said, max(abs(moved) - prior_sd / 2.0, 0.0)) if row.doubted else said


class _OfData(NamedTuple):
    """What the data alone tell of the six."""

    eigenvalues: Array  # (6,), of their information over the prior's
    bound: tuple[float, ...]  # as Estimate.bound
    determined: tuple[Combination, ...]


@lru_cache(maxsize=8)  # that of a fit stays the same until the next one
def _of_data(covariance: bytes, prior_sd: bytes, told: bool) -> _OfData:
    """covariance: (6, 6), reported. told: whether anything was learned, of which somebody reads all."""
    prior = np.frombuffer(prior_sd)
    information = advice.information_of(np.frombuffer(covariance).reshape(6, 6), prior)
    eigenvalues = np.array(advice.eigenvalues(information, prior))
    if not told:
        return _OfData(eigenvalues, (), ())
    bound = tuple(math.inf if b is None else b for b in advice.bound(information, prior))
    return _OfData(eigenvalues, bound, advice.determined(information, prior))


def six_parameter_estimate(
    state: SixState, machine: Machine, t_ns: int, method: str, covariance: Array, nothing: Code,
    excitation: dict[str, float], advised: Advice | None, stale: Reason | None, today: Array | None = None,
) -> Estimate:  # fmt: skip
    """The estimate at t_ns of a method that learns all six logarithms.

    covariance: (6, 6), the reported one, with the whole variance of the masses. nothing: why there is no
    number while nothing has been learned. stale: why the numbers are stale. today: (6, 6), without what a map
    of the field has told, which alone gives no number.
    """
    prior_sd, sds = state.prior_sd[SIX], np.sqrt(np.diag(covariance))
    by_today = sds if today is None else np.sqrt(np.diag(today))
    age = age_s(state.informed_ns, t_ns)
    of_data = _of_data(covariance.tobytes(), prior_sd.tobytes(), age is not None and advice.is_read())
    parameters = []
    of_masses = [float(state.prior_sd[AT[name]] ** 2) for name in OVER]
    over_sds = log_sds_over_masses(covariance, of_masses)
    over = [
        age is not None and is_supported(had, sd, own)
        for had, sd, own in zip(state.has_number, over_sds, prior_sd[:3].tolist(), strict=False)
    ]
    for k in range(6):
        state.has_number[k] = age is not None and is_supported(state.has_number[k], by_today[k], prior_sd[k])
        too_wide = Reason(Code.WIDE, numbers=(float(by_today[k]),))
        if k < 3 and over[k]:
            too_wide = of_the_mass(k, float(state.prior_sd[AT[OVER[k]]]), over_sds[k])
        missing = nothing_yet(nothing, state.reason) if age is None else too_wide
        parameters.append(parameter(state.mean[k], float(sds[k]), state.has_number[k], age, missing, stale))
    active = np.flatnonzero(np.diag(state.covariance) > 0.0)
    moved = state.mean - state.prior_mean
    masses = per_mass(machine, state.mean[:3].tolist(), over_sds, over)
    return Estimate(
        t_ns=t_ns,
        method=method,
        model=MODEL,
        parameters=tuple(parameters),
        log_covariance=tuple(covariance.ravel().tolist()),
        per_mass=masses.values,
        per_mass_sd=masses.sds,
        nuisances={
            NAMES[k]: (
                float(state.mean[k]),
                nuisance_sd(NAMES[k], state.covariance[k, k], state.prior_sd[k], float(moved[k])),
            )
            for k in active
            if k > 5
        },
        rank=int(np.sum(of_data.eigenvalues > REPORTING.rank_gain)),
        condition=condition_number(of_data.eigenvalues),
        excitation=excitation,
        window_s=state.window_s,
        determined=of_data.determined,
        bound=of_data.bound,
        advice=advised,
    )
