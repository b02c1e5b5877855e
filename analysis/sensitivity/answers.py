"""What `tilth sensitivity` and `tilth uncertainty` answer, as it stands in their JSON."""

import math
from typing import NotRequired, TypedDict

Values = dict[str, float | None]  # by output or parameter
Numbers = list[float | None]


class RefusedSpeed(TypedDict):
    """reason: why nothing is answered there, a sentence."""

    speed: float
    model: str
    reason: str


class Interval(TypedDict):
    """95 %."""

    value: float | None
    low: float | None
    high: float | None


class Effects(TypedDict):
    """Morris's."""

    size: float | None
    spread: float | None


class Indices(TypedDict):
    """Of one parameter. morris, dgsm_bound: only where rigs are of a box."""

    sobol_first: Interval
    sobol_total: Interval
    morris: NotRequired[Effects | None]
    dgsm_bound: NotRequired[float | None]


class IndexCounts(TypedDict):
    """lost: share of points that have no answer, or are compared with one that has none."""

    points: int
    lost: float


class IndicesAnswer(IndexCounts):
    """overall: parameter -> of the mean of the plan's outputs. outputs: output -> parameter."""

    overall: dict[str, Indices]
    outputs: dict[str, dict[str, Indices]]


class GlobalRow(TypedDict):
    """Sensitivities to one parameter over all rigs; with indices only where they were asked for. by_output:
    the same of each output."""

    mean: float | None
    sd: float | None
    median: float | None
    q05: float | None
    q95: float | None
    sobol_first: Interval | None
    sobol_total: Interval | None
    morris: Effects | None
    dgsm_bound: float | None
    by_output: "dict[str, GlobalRow]"


class Domain(TypedDict):
    """stable_domain.Corner, and in words."""

    text: str
    names: tuple[str, str]
    high: tuple[bool, bool]
    ends: tuple[float, float]
    unstable: float
    holds: float
    score: float


class BoundaryLine(TypedDict):
    """growth: 1/s, of the machine file's own rig with only these two changed; it is zero on the line."""

    at: list[list[float]]
    growth: list[list[float]]


class PairAnswer(TypedDict):
    """Of two parameters. low_to_high: edges of their levels. shares: of rigs that are unstable."""

    names: list[str]
    low_to_high: list[list[float]]
    shares: list[Numbers]
    line: BoundaryLine


GlobalAnswer = TypedDict(
    "GlobalAnswer",
    {
        "points": int,
        "simulations": int,
        "global_outputs": list[str],
        "unstable_share": float,
        "global": dict[str, GlobalRow],
        "global_stable": dict[str, GlobalRow],
        "unstable_by_level": dict[str, list[float]],
        "unstable_where": str,
        "unstable_domain": Domain | None,
        "unstable_pairs": list[PairAnswer],
        "indices": NotRequired[IndexCounts],
    },
)
"""Over many rigs, by parameter. global_stable: without indices, of stable points alone."""


class LocalEntry(TypedDict):
    """At one speed by one model. local: parameter -> output, and "overall" -> per cent of the output for each
    per cent of the parameter; None where there is none."""

    speed: float
    model: str
    seconds: float
    outputs: list[str]
    local: dict[str, Values]


class GlobalEntry(LocalEntry, GlobalAnswer):
    """The same, and over many rigs."""


class DesignAnswer(TypedDict):
    """Which rigs. low, high: of a box."""

    what: str
    names: list[str]
    points: int
    low: NotRequired[list[float]]
    high: NotRequired[list[float]]


class LocalAnswer(TypedDict):
    """step: "exact" or "1 %"."""

    step: str
    input: str
    speeds: list[LocalEntry]
    refused: list[RefusedSpeed]


class SensitivityAnswer(LocalAnswer):
    machine: str
    design: NotRequired[DesignAnswer]


class ChangedCurves(TypedDict):
    """Yaw rates of a rig and of one with a parameter changed, rad/s."""

    speed: float
    t_s: Numbers
    reference: Numbers
    changed: Numbers


class TransferSlopes(TypedDict):
    """By parameter over omega: per cent for each per cent; rad for each unit of the logarithm."""

    gain: dict[str, Numbers]
    phase: dict[str, Numbers]


class FrequencyEntry(TypedDict):
    """transfers: by output."""

    speed: float
    transfers: dict[str, TransferSlopes]


class FrequencyAnswer(TypedDict):
    """omega: rad/s."""

    omega: Numbers
    speeds: list[FrequencyEntry]


class Made(TypedDict):
    """Of what, and by which versions."""

    machine_sha256: str
    software: dict[str, str]


class SensitivityData(SensitivityAnswer):
    """Of a report. By model: the answer at another point; curves by the parameter that is changed."""

    command: str
    made: Made
    another: dict[str, LocalAnswer | None]
    curves: dict[str, dict[str, list[ChangedCurves]]]
    frequency: dict[str, FrequencyAnswer]


class AloneAnswer(TypedDict):
    """Where one parameter alone is not known: 95 %. share: of the variance, in the first order; of correlated
    parameters it may be negative."""

    low: float | None
    high: float | None
    share: float | None


class Growth(TypedDict):
    """Half of the 95 % interval where all sds are so many times as large."""

    factors: list[float]
    half: Numbers
    first_order: Numbers


class Histogram(TypedDict):
    edges: list[float]
    counts: list[int]


class WantedAnswer(TypedDict):
    """How well parameters must be known for an output to be known to ± half (95 %). factor: of all sds
    together. alone: log_sd if the others stay as they are; None where even an exact value is not enough.
    only: log_sd if nothing else were unknown."""

    half: float
    factor: float | None
    alone: Values
    only: Values


class OutputAnswer(TypedDict):
    """low, high: 95 %. half, first_order: half of that interval through the model, and in the first order."""

    unit: str
    low: float | None
    high: float | None
    half: float | None
    first_order: float | None
    parameters: dict[str, AloneAnswer]
    growth: Growth
    histogram: Histogram
    wanted: NotRequired[WantedAnswer]


class Assumed(TypedDict):
    median: float
    log_sd: float


class UncertaintyEntry(TypedDict):
    """At one speed by one model. unstable_share: of the rigs drawn, which have no outputs."""

    speed: float
    model: str
    seconds: float
    draws: int
    unstable_share: float
    outputs: dict[str, OutputAnswer]


class UncertaintyAnswer(TypedDict):
    """source: who knows the parameters, in words."""

    source: str
    input: str
    parameters: dict[str, Assumed]
    speeds: list[UncertaintyEntry]
    refused: list[RefusedSpeed]


class UncertaintyData(UncertaintyAnswer):
    """Of a report."""

    machine: str
    command: str
    made: Made


def finite(value: float) -> float | None:
    """For JSON: None where it is not finite."""
    return float(value) if math.isfinite(value) else None
