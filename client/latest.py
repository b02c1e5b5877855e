"""What a controller may use at this moment, by a rule for what is too old that it had to choose."""

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tilth.estimator.models.family import model_named
from tilth.estimator.models.parameters import Rig
from tilth.schemas.flow import PARAMETERS, Estimate, Status
from tilth.schemas.reasons import Code
from tilth.schemas.sentences import sentence

Array = NDArray[np.float64]

_N: Final = len(PARAMETERS)


@dataclass(frozen=True, slots=True, kw_only=True)
class Staleness:
    """Both in seconds, neither with a default: only the controller knows what its loop can bear.

    silence_s: how old the last estimate may be. One comes each second while all is well; 3 is a usual choice.
    data_s: how long ago the data may have informed a parameter. Soil changes with the place: at 2 m/s, 300 s
    are 600 m. `math.inf` says that an estimate of this morning will do.
    """

    silence_s: float
    data_s: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.silence_s) and self.silence_s > 0):
            raise ValueError(f"silence_s = {self.silence_s}: give seconds above zero; 3 is a usual choice")
        if not self.data_s > 0:
            raise ValueError(f"data_s = {self.data_s}: give seconds above zero, or math.inf")


class RefusalCode(StrEnum):
    """Why the client itself refuses; other codes are the daemon's (schemas.reasons.Code)."""

    NOTHING_HEARD = "nothing_heard"
    SIMULATION_ONLY = "simulation_only"  # heard is only a simulation or a replay of this machine
    SILENCE = "silence"  # no estimate for longer than silence_s
    AGE_UNKNOWN = "age_unknown"  # of the estimate: a daemon of another version
    OLD_DATA = "old_data"  # data informed it longer ago than data_s
    DATA_AGE_UNKNOWN = "data_age_unknown"


class ParameterRefusal(NamedTuple):
    """Why a parameter may not be used. The code is for programs, the text for people; neither has an age in
    it, so both stay the same while nothing changes."""

    code: str  # of RefusalCode or schemas.reasons.Code, or a status; "" where it may be used
    text: str


_USABLE: Final = ParameterRefusal("", "")


@dataclass(frozen=True, slots=True)
class Latest:
    """The last estimate, judged at the moment of asking."""

    estimate: Estimate | None  # as published; None before the first
    age_s: float  # of the estimate by this computer's own clock and what is known of its way; inf before
    judged: tuple[ParameterRefusal, ...]  # of each of PARAMETERS

    @property
    def refusals(self) -> tuple[str, ...]:
        """Of each of PARAMETERS: why it may not be used, in words, "" where it may."""
        return tuple(one.text for one in self.judged)

    @property
    def codes(self) -> tuple[str, ...]:
        """The same as codes: of RefusalCode, or the daemon's (docs/codes.md)."""
        return tuple(one.code for one in self.judged)

    @property
    def data_ages_s(self) -> tuple[float, ...]:
        """Of each of PARAMETERS: how long ago data informed it; inf where that is not known."""
        rows = (None,) * _N if self.estimate is None else self.estimate.parameters
        return tuple(math.inf if row is None or row.age_s is None else row.age_s + self.age_s for row in rows)

    @property
    def usable(self) -> tuple[bool, ...]:
        """Of each of PARAMETERS."""
        return tuple(not one.code for one in self.judged)

    @property
    def reason(self) -> str:
        """Why not all may be used, "" where all may."""
        names: dict[str, list[str]] = {}
        for name, refusal in zip(PARAMETERS, self.refusals, strict=True):
            if refusal:
                names.setdefault(refusal, []).append(name)
        return "; ".join(f"{', '.join(of)}: {refusal}" for refusal, of in names.items())

    def theta(self, nominal: ArrayLike) -> Array:
        """What may be used, and `nominal` elsewhere: shape (6,), as PARAMETERS, N/rad and m."""
        values = np.array(nominal, dtype=float)
        if self.estimate is not None:
            for i, parameter in enumerate(self.estimate.parameters):
                if not self.judged[i].code and parameter.value is not None:
                    values[i] = parameter.value
        return values

    def log_covariance(self, nominal: ArrayLike) -> Array:
        """Covariance of the natural logarithms of `theta`, shape (6, 6): the estimate's block for what may be
        used, that of `nominal` (shape (6, 6)) for the rest, nothing between the two."""
        covariance = np.array(nominal, dtype=float)
        if covariance.shape != (_N, _N):
            raise ValueError(f"nominal has shape {covariance.shape}, not (6, 6)")
        used = np.array(self.usable)
        covariance[np.not_equal.outer(used, used)] = 0.0
        if self.estimate is not None and used.any():
            block = np.ix_(used, used)
            covariance[block] = np.reshape(self.estimate.log_covariance, (_N, _N))[block]
        return covariance


class Linear(NamedTuple):
    """x' = A x + B w for small motions about straight running at one speed; see estimator.models.family."""

    A: Array  # (n, n)
    B: Array  # (n, m)
    states: tuple[str, ...]
    inputs: tuple[str, ...]


def linear(rig: Rig, theta: ArrayLike, u: float, model: str = "relaxation") -> Linear:
    """The matrices of a rig with these soil-tyre parameters (shape (6,)) at forward speed u (m/s).

    model: of estimator.models.family.MODELS. Raises ValueError where there is no such model, or where it does
    not hold at that speed.
    """
    row = model_named(model)
    values = dict(zip(PARAMETERS, np.asarray(theta, dtype=float).tolist(), strict=True))
    if not math.isfinite(u) or (u == 0 and not row.at_rest):
        raise ValueError(f"u = {u}: the {model} model does not hold there")
    return Linear(*row.matrices(rig._replace(**values), u), row.states, row.inputs)


def judge(estimate: Estimate | None, age_s: float, rule: Staleness, instead: str = "") -> Latest:
    """What the rule leaves of an estimate that is so old. instead: what is heard where there is none."""
    if estimate is None:
        code = RefusalCode.SIMULATION_ONLY if instead else RefusalCode.NOTHING_HEARD
        return Latest(None, math.inf, (ParameterRefusal(code, instead or "nothing has been heard yet"),) * _N)
    if age_s > rule.silence_s:
        known = math.isfinite(age_s)
        cause = f"no estimate for over {rule.silence_s:g} s" if known else "how old it is cannot be known"
        code = RefusalCode.SILENCE if known else RefusalCode.AGE_UNKNOWN
        text = f"{cause}: the daemon, its buses or the network have stopped"
        return Latest(estimate, age_s, (ParameterRefusal(code, text),) * _N)
    return Latest(estimate, age_s, tuple(_refusal(estimate, i, age_s, rule) for i in range(_N)))


def _refusal(estimate: Estimate, i: int, age_s: float, rule: Staleness) -> ParameterRefusal:
    parameter = estimate.parameters[i]
    if parameter.status is not Status.ESTIMATED:
        status, reason = parameter.status.name.lower(), parameter.reason
        code = status if reason is None or reason.code is Code.TEXT else reason.code.value
        return ParameterRefusal(code, f"{status}: {sentence(reason)}")
    if math.isinf(rule.data_s):
        return _USABLE
    if parameter.age_s is None:
        return ParameterRefusal(RefusalCode.DATA_AGE_UNKNOWN, "it does not say when data last informed it")
    if parameter.age_s + age_s <= rule.data_s:
        return _USABLE
    return ParameterRefusal(RefusalCode.OLD_DATA, f"stale: data last informed it over {rule.data_s:g} s ago")
