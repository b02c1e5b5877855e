"""The data of a report: plain, SI, as they stand in its JSON; docs/report.md says what each key means."""

from typing import NotRequired, TypedDict

from tilth.analysis.fit.result import FitAnswer
from tilth.replay.estimates_json import ParameterEntry

Numbers = list[float | None]


class GapFacts(TypedDict):
    start_s: float
    seconds: float


class Gaps(TypedDict):
    """longest: some, the longest first."""

    count: int
    all_s: float
    longest: list[GapFacts]


class SensorFacts(TypedDict):
    """per_s: while it gave something. fix: share of each quality, of a receiver."""

    name: str
    count: int
    per_s: float
    alive_share: float
    gaps: Gaps
    fix: dict[str, float]


class Driving(TypedDict):
    """Distances and speeds by the tractor's forward velocity; degrees: where W has its origin."""

    poses: int
    distance_m: float
    moving_s: float
    still_s: float
    reverse_s: float
    median_speed_mps: float | None
    largest_speed_mps: float | None
    latitude_deg: float | None
    longitude_deg: float | None
    all_receivers_share: float | None


class FlagFacts(TypedDict):
    flag: str
    poses: int
    share: float
    seconds: float


class EventFacts(TypedDict):
    """x_m, y_m: of the tractor at that time, in W."""

    t_s: float
    utc_s: float | None
    kind: str
    text: str
    latitude_deg: float | None
    longitude_deg: float | None
    x_m: float | None
    y_m: float | None


class SegmentFacts(TypedDict):
    """tells: to what a fit of it could know parameters, in words."""

    number: int
    kind: str
    name: str
    start_s: float
    end_s: float
    speed_mps: float
    largest_angle_rad: float
    tells: list[str]


class PublishedParameter(ParameterEntry):
    age_s: float | None


class LastEstimate(TypedDict):
    """The last estimate of a method as it was published; log_covariance: 6 x 6."""

    t_s: float
    model: str
    rule: str
    determined: str
    advice: str
    rank: int
    window_s: float | None
    parameters: dict[str, PublishedParameter]
    log_covariance: list[list[float]] | None


class NuisanceFacts(TypedDict):
    """Beside what was assumed before."""

    name: str
    value: float
    sd: float
    prior: float
    prior_sd: float


class PriorFacts(TypedDict):
    """Of the machine file; sd in the unit of the value."""

    value: float
    log_sd: float
    sd: float


class MachineFacts(TypedDict):
    name: str
    prior: dict[str, PriorFacts]


class LogFacts(TypedDict):
    path: str
    bytes: int
    sha256: str


class OriginFacts(TypedDict):
    """cut: names of files without their end. recorded_with, reported_with: versions by name."""

    logs: list[LogFacts]
    whole: bool
    cut: list[str]
    replayed: bool
    machine_sha256: str
    recorded_with: dict[str, str]
    reported_with: dict[str, str]
    simulated: bool


class TrackFacts(TypedDict):
    """Of a CG in W, m; None breaks the line."""

    x: Numbers
    y: Numbers


class SegmentTrack(TrackFacts):
    number: int
    kind: str


class PathCurves(TypedDict):
    """segments: the tractor's way in each."""

    tractor: TrackFacts
    implement: TrackFacts
    segments: list[SegmentTrack]


class Envelope(TypedDict):
    """A curve and its 95 % band."""

    t_s: Numbers
    value: Numbers
    low: Numbers
    high: Numbers


class PublishedCurve(TypedDict):
    """usable: whether its status was `estimated`."""

    t_s: Numbers
    value: Numbers
    sd: Numbers
    usable: list[bool]


class Curves(TypedDict):
    """drive: by name of curves.SERIES. parameters: method -> parameter -> as published."""

    path: PathCurves
    drive: dict[str, Envelope]
    parameters: dict[str, dict[str, PublishedCurve]]


class RunFacts(TypedDict):
    """What a report tells of one run. estimates: by method, with "recommended". skipped: what could not be
    read."""

    id: str
    note: str
    duration_s: float
    start_utc_s: float | None
    machine: MachineFacts
    origin: OriginFacts
    driving: Driving
    sensors: list[SensorFacts]
    gaps: Gaps
    flags: list[FlagFacts]
    events: list[EventFacts]
    segments: list[SegmentFacts]
    estimates: dict[str, LastEstimate]
    nuisances: list[NuisanceFacts]
    skipped: list[str]
    curves: Curves


class HeldOutCell(TypedDict):
    """How parameters predict one run: validation.held_out.Cell; None: it could not be computed."""

    run: str
    held_out: bool
    tractor_m: float | None
    implement_m: float | None
    fit_percent: NotRequired[dict[str, float | None]]
    horizon_rms: NotRequired[dict[str, dict[str, float | None]]]
    gain: NotRequired[float | None]


class HeldOutSubset(TypedDict):
    """fitted: segments; none of them: the machine file's parameters. refused: why nothing is predicted."""

    fitted: list[str]
    cells: list[HeldOutCell]
    refused: str


class HeldOut(TypedDict):
    subsets: list[HeldOutSubset]


class TestFacts(TypedDict):
    """Of residuals. test: the class that held it, of checked.TESTS. outcome: passed, failed or undecided."""

    output: str
    outcome: str
    p_value: float | None
    sentence: str
    test: str


class ComplexTable(TypedDict):
    """[f][p]."""

    re: list[list[float]]
    im: list[list[float]]


class BandFacts(TypedDict):
    """95 %, [f][p]; rad/s or rad per rad, and rad."""

    gain_low: list[Numbers]
    gain_high: list[Numbers]
    phase_half: list[list[float]]


class CurveFacts(TypedDict):
    """Of a model, beside what was measured."""

    name: str
    response: ComplexTable
    sentence: str


class LoopFacts(TypedDict):
    sentence: str


class ResponseFacts(TypedDict):
    """A measured frequency response, as of response.MeasuredResponse: f frequencies of p outputs. reason: why
    there is nothing."""

    outputs: list[str]
    hz: list[float]
    value: ComplexTable
    band: BandFacts
    coherence: list[list[float]]
    excited: NotRequired[list[bool]]
    curves: list[CurveFacts]
    speed: NotRequired[float]
    notes: NotRequired[list[str]]
    reason: NotRequired[str]
    loop: NotRequired[LoopFacts | None]


class Answered(TypedDict):
    """What was computed of all runs; what cannot be computed is absent."""

    fit: NotRequired[FitAnswer]
    held_out: NotRequired[HeldOut]
    residuals: NotRequired[list[TestFacts]]
    response: NotRequired[ResponseFacts | None]


class Answers(Answered):
    """notes: why something is absent."""

    notes: list[str]


class ReportData(Answered):
    """All of it. command: that made it."""

    command: str
    runs: list[RunFacts]
    notes: NotRequired[list[str]]
