"""What the estimators make of the virtual tractor, run by run: cases, and what is measured of each of them.

A case is a scenario, what is wrong with the machine file, and which errors are set instead of drawn. The
plant is the nonlinear model on uneven ground, with coloured position errors, latency and CAN frames; so
nothing here moves as the estimators' own model says. True stiffnesses are -dF/d alpha without slip.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from tilth.estimator import fold
from tilth.estimator.filters import scoring, unknowns
from tilth.estimator.filters.rig_setup import rig_setup
from tilth.estimator.filters.unknowns import AT, SIX
from tilth.estimator.methods.estimators import ROW
from tilth.estimator.record import record_builder
from tilth.estimator.record.record import Record, Segment, concatenate
from tilth.estimator.record.windows import WINDOWS
from tilth.schemas.flow import PARAMETERS, Estimate, Event, Pose, Publication, Status
from tilth.schemas.machine import Machine, Quantity
from tilth.schemas.sentences import event_sentence, sentence
from tilth.simulator.drive import drive
from tilth.simulator.scenario import (
    STEP_S,
    DrivenManoeuvre,
    Ground,
    Parameter,
    ReceiverLink,
    RowSteering,
    Scenario,
    Soil,
    SoilChange,
    SurveyErrors,
    Wheel,
)
from tilth.simulator.tractor import Truth
from tilth.simulator.traffic import host_clock, traffic

threadpool_limits(1)  # as fits have it in the product

Array = NDArray[np.float64]
Changed = Callable[[Machine], Machine]

FIELD: Final = Soil(grip=0.7, rolling=0.06)
UNEVEN: Final = Ground(roll_sd_deg=0.7, force_sd=0.015)
EXACT: Final = SurveyErrors(cg_sd=0.0, lever_sd=0.0, pair_sd_deg=0.0)
RANDOM: Final = Scenario(
    seconds=40.0, steering=DrivenManoeuvre("random"), soil=FIELD, ground=UNEVEN, other_traffic=False
)
DISSERTATION: Final[Mapping[Parameter, float]] = {
    "C_af": 90e3, "C_ar": 580e3, "C_ai": 62e3, "sigma_f": 1.5, "sigma_r": 1.9, "sigma_i": 1.1,
}  # fmt: skip
"""The combined estimate of Karkee (2009), chapter 7."""
STAR_FIRE: Final = 0xA00017000421E250  # NAME of a receiver at 5 Hz, and of one at 10 Hz
NMEA_2000: Final = 0xC07891000B002720
HIDDEN_M: Final = 0.03  # m, of a lever arm or a CG
DROP: Final = 0.7  # of all stiffnesses
METHODS: Final = ("recommended", "pem", "tracker", "steady_state")
FAR: Final = (4.0, 6.0)  # sds
CHANGE_S: Final = 62.0  # into the run, on a straight stretch
INFORMED: Final = math.radians(2.0)  # wheel angle from which on a manoeuvre is informative


def as_in_file(machine: Machine) -> Machine:
    return machine


@dataclass(frozen=True, slots=True)
class Case:
    """One way to drive, repeated with many seeds."""

    name: str
    scenario: Scenario
    believed: Changed = as_in_file  # change of the packaged machine in the file of the estimators
    driven: Changed = as_in_file  # further change, in the rig that is driven
    nuisances: Mapping[str, float] = field(default_factory=dict)  # of Truth, instead of what is drawn


def all_receivers(first_name: int, machine: Machine) -> Machine:
    """Every receiver of one make."""
    receivers = [r.model_copy(update={"name": first_name + k}) for k, r in enumerate(machine.receiver)]
    return machine.model_copy(update={"receiver": receivers})


def shifted_cgs(machine: Machine) -> Machine:
    """Both CGs HIDDEN_M further forward than the file says, with everything that is measured from them."""
    tractor, implement = machine.tractor, machine.implement

    def by(quantity: Quantity, change: float) -> Quantity:
        return quantity.model_copy(update={"value": quantity.value + change})

    shifted = {
        "tractor": tractor.model_copy(
            update={
                "a": by(tractor.a, -HIDDEN_M), "b": by(tractor.b, HIDDEN_M), "c": by(tractor.c, HIDDEN_M),
            }
        ),
        "implement": implement.model_copy(
            update={"d": by(implement.d, -HIDDEN_M), "e": by(implement.e, HIDDEN_M)}
        ),
        "receiver": [
            r.model_copy(update={"position": (r.position[0] - HIDDEN_M, *r.position[1:])})
            for r in machine.receiver
        ],
    }  # fmt: skip
    return machine.model_copy(update=shifted)


def left_kingpin_sensor(machine: Machine) -> Machine:
    """The wheel-angle sensor on the left kingpin, as the file says."""
    return machine.model_copy(
        update={
            "tractor": machine.tractor.model_copy(update={"kingpin_distance": 1.7}),
            "wheel_angle": machine.wheel_angle.model_copy(update={"kingpin": "left"}),
        }
    )


def _late(seconds: float) -> dict[str, float]:
    mounts = ("tractor_front", "tractor_rear", "implement_front", "implement_rear")
    return {f"latency_{mount}": seconds for mount in mounts}


_PAIR_YAW: Final = {"pair_tractor": math.radians(0.2), "pair_implement": math.radians(-0.2)}
_LEVERS: Final = {
    f"forward_{mount}": sign * HIDDEN_M
    for mount, sign in (
        ("tractor_front", 1), ("tractor_rear", 1), ("implement_front", -1), ("implement_rear", -1),
    )
}  # fmt: skip
_KNOWN: Final = {**_late(0.1), "wheel_zero": 0.0}
_SURVEYED: Final = replace(RANDOM, survey=EXACT, wheel=Wheel(zero_deg=0.0))
_SLOPE: Final = replace(UNEVEN, slope_deg=3.0)
_ALL: Final = replace(_SURVEYED, ground=_SLOPE, wheel=Wheel(zero_deg=0.5, gain=1.02))

HIDDEN: Final = (
    Case("none", _SURVEYED, nuisances=_KNOWN),
    Case("latency_0_ms", _SURVEYED, nuisances=_KNOWN | _late(0.0)),
    Case("latency_150_ms", _SURVEYED, nuisances=_KNOWN | _late(0.15)),
    Case("wheel_zero", _SURVEYED, nuisances=_KNOWN | {"wheel_zero": math.radians(0.5)}),
    Case("wheel_gain_up", _SURVEYED, nuisances=_KNOWN | {"wheel_gain": 1.02}),
    Case("wheel_gain_down", _SURVEYED, nuisances=_KNOWN | {"wheel_gain": 0.98}),
    Case("slope", replace(_SURVEYED, ground=_SLOPE), nuisances=_KNOWN),
    Case("pair_yaw", _SURVEYED, nuisances=_KNOWN | _PAIR_YAW),
    Case("levers", _SURVEYED, nuisances=_KNOWN | _LEVERS),
    Case("centres", _SURVEYED, driven=shifted_cgs, nuisances=_KNOWN),
    Case("kingpin", _SURVEYED, believed=left_kingpin_sensor, nuisances=_KNOWN),
    Case(
        "all_errors",
        _ALL,
        believed=left_kingpin_sensor,
        driven=shifted_cgs,
        nuisances=_late(0.15) | _PAIR_YAW | _LEVERS | {"wheel_gain": 1.02, "wheel_zero": math.radians(0.5)},
    ),
)
"""Errors that the machine file does not tell, one at a time and together; the others are nothing."""

_STEERED: Final = replace(RANDOM, seconds=75.0, steering=RowSteering(offset=3.0, heading_deg=15.0))
COVERAGE: Final = (
    Case("5_hz", replace(RANDOM, seconds=42.0), believed=partial(all_receivers, STAR_FIRE)),
    Case("10_hz", replace(RANDOM, seconds=42.0), believed=partial(all_receivers, NMEA_2000)),
    Case("drop_outs", replace(RANDOM, seconds=42.0, link=ReceiverLink(drop_out=0.05, jitter=0.005))),
    Case("automatic_steering", _STEERED),
)

SOIL_CHANGE: Final = Case(
    "soil_change",
    replace(
        RANDOM,
        seconds=105.0,
        steering=((58.0, None), (8.0, 0.0), (60.0, None)),
        soil=replace(FIELD, changes=(SoilChange(at_s=CHANGE_S, C_af=DROP, C_ar=DROP, C_ai=DROP),)),
    ),
)

STEPS: Final = Case(
    "three_steps",
    replace(
        RANDOM,
        seconds=106.0,
        steering=((5.0, 0.0), (30.0, 8.0), (5.0, 0.0), (30.0, -6.0), (5.0, 0.0), (31.0, 4.0)),
        soil=replace(FIELD, parameters=DISSERTATION),
    ),
    believed=partial(all_receivers, STAR_FIRE),
)

HELD_OUT: Final = Case("held_out", replace(RANDOM, seconds=72.0))

STRAIGHT: Final = Case(
    "straight_hour",
    replace(_STEERED, seconds=3690.0, steering=RowSteering(offset=5.0, heading_deg=20.0)),
)
ON_ROW_S: Final = 90.0  # the way onto the row is driven, and has been fitted

CASES: Final = {c.name: c for c in (*HIDDEN, *COVERAGE, SOIL_CHANGE, STEPS, HELD_OUT, STRAIGHT)}


# A run.


@dataclass(frozen=True, slots=True)
class Driven:
    """A run of a case."""

    machine: Machine  # the file of the estimators
    truth: Truth
    truth_machine: Machine

    @property
    def logs(self) -> Array:
        """The true logarithms, before any change, (6,)."""
        return np.log([self.truth.parameters[name] for name in PARAMETERS])

    def seconds_of(self, t_ns: int) -> float:
        """Seconds of the truth at an instant of the log's clock."""
        since = (t_ns - host_clock(self.truth)(0.0)) * 1e-9
        return since / (1.0 + self.truth.nuisances["clock_skew"])


def driven(packaged: Machine, case: Case, seed: int, seconds: float | None = None) -> Driven:
    """Drive a case."""
    machine = case.believed(packaged)
    real = case.driven(machine)
    scenario = case.scenario
    truth = drive(real, seed, seconds or scenario.seconds, scenario)
    return Driven(machine, replace(truth, nuisances=truth.nuisances | dict(case.nuisances)), real)


def poses_and_segments(run: Driven) -> list[tuple[Pose, Segment | None]]:
    """What an estimator is given in a run."""
    state, recording = fold.initial(run.machine), record_builder.initial(run.machine)
    return [
        (publication.value, record_builder.observe(recording, state.aligner, publication.value))
        for frame in traffic(run.truth_machine, run.truth)
        for publication in fold.step(state, frame)
        if isinstance(publication.value, Pose)
    ]


def segments(run: Driven) -> list[Segment]:
    """The record of a run, segment by segment."""
    return [segment for _, segment in poses_and_segments(run) if segment is not None]


def windows(some: list[Segment], length: int = WINDOWS.longest) -> list[Record]:
    """Windows of `length` consecutive segments that may be learned from."""
    made: list[list[Segment]] = []
    for segment in some:
        if segment.reason:
            continue
        if not segment.follows or not made or len(made[-1]) == length:
            made.append([])
        made[-1].append(segment)
    return [concatenate(window) for window in made if len(window) == length]


@dataclass(frozen=True, slots=True)
class Fitted:
    """What windows of a run gave, each fit beginning with what the one before left."""

    error: Array  # (6,) logarithms less the true ones
    sd: Array  # (6,) as they would be published
    information: Array  # (n, n) of unknowns.NAMES, of all the windows, without the prior
    mean: Array  # (n,)
    fits: int
    nuisance: dict[str, tuple[float, float]]


def fitted(machine: Machine, logs: Array, records: list[Record]) -> Fitted:
    """The posterior of the first record is the prior of the next; noise levels start again with each.

    logs: true logarithms, shape (6,)."""
    setup = rig_setup(machine)
    prior_mean, prior_sd = unknowns.prior(machine)
    mean, covariance = prior_mean, np.diag(prior_sd**2)
    information = np.zeros_like(covariance)
    for record in records:
        found = scoring.maximise_posterior(record, setup, mean, covariance)
        information += found.information
        mean, covariance = found.mean, found.covariance
    sd = np.sqrt(np.diag(covariance))
    nuisance = {name: (float(mean[k]), float(sd[k])) for name, k in AT.items() if k > 5 and sd[k] > 0}
    return Fitted(mean[SIX] - logs, sd[SIX], information, mean, len(records), nuisance)


def bound_of(information: Array, machine: Machine) -> Array:
    """Sds of the six logarithms that no estimator of this record and this prior gets below, (6,)."""
    prior_sd = unknowns.prior(machine)[1]
    free = np.flatnonzero(prior_sd > 0.0)
    whole = information[np.ix_(free, free)] + np.diag(prior_sd[free] ** -2.0)
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(whole))[SIX]), np.float64)


def window_of(
    packaged: Machine, case: Case, seed: int, count: int = 1, length: int = WINDOWS.longest
) -> Fitted | None:
    """The first windows of a run, fitted; None where the run has fewer."""
    run = driven(packaged, case, seed)
    records = windows(segments(run), length)[:count]
    return fitted(run.machine, run.logs, records) if len(records) == count else None


# Through the fold, as the daemon does it.


@dataclass(frozen=True, slots=True)
class Followed:
    """What was published in a run. Times are s of the truth."""

    logs: Array  # (6,) true logarithms before any change
    series: dict[str, Array]
    """Method -> (m, 14): time, six logarithms, their sds, sd of log C_ai/m_i; not a number: no number."""
    events: list[tuple[float, str, str]]  # (time, kind, text)
    wheel: Array  # (n,) rad, true wheel angle at samples STEP_S apart
    refused: dict[str, int]  # reason -> stretches
    reasons: dict[str, list[str]]  # method -> why there is no number at the end, (6,)
    over_mass: dict[str, tuple[float, float]]  # method -> error of log C_ai/m_i as given last, and its sd


def followed(
    run: Driven,
    watch: Callable[[fold.State, Estimate], None] | None = None,
    state: fold.State | None = None,
) -> Followed:
    """A run through the fold; each fit is there when it is due. watch: is told of each estimate as it is
    published. state: that it begins from."""
    state = state or fold.initial(run.machine)
    series: dict[str, list[list[float]]] = {}
    events, last, over_mass = [], dict[str, Estimate](), dict[str, tuple[float, float]]()
    true_log = float(run.logs[2]) - math.log(run.truth.rig.m_i)
    for frame in traffic(run.truth_machine, run.truth):
        publications = fitted_at_once(state, frame.t_ns) + fold.step(state, frame)
        fold.request_fits(state, frame.t_ns)
        for publication in publications:
            value = publication.value
            if isinstance(value, Estimate):
                last[value.method] = value
                if watch is not None:
                    watch(state, value)
                ratio, sd = (*value.per_mass, *[None] * 3)[2], (*value.per_mass_sd, *[None] * 3)[2]
                log_sd = math.nan if ratio is None or sd is None else sd / ratio
                if ratio is not None and math.isfinite(log_sd):
                    over_mass[value.method] = math.log(ratio) - true_log, log_sd
                row = [run.seconds_of(value.t_ns), *numbers(value), log_sd]
                series.setdefault(value.method, []).append(row)
            elif isinstance(value, Event):
                events.append((run.seconds_of(value.t_ns), value.kind, event_sentence(value)))
    tables = {method: np.array(rows) for method, rows in series.items()}
    return Followed(
        run.logs,
        tables,
        events,
        run.truth.wheel_angle,
        {code.value: n for code, n in state.record.refused.items()},
        {name: [sentence(p.reason) for p in one.parameters] for name, one in last.items()},
        over_mass,
    )


def fitted_at_once(state: fold.State, t_ns: int) -> list[Publication]:
    """What comes of the fits that are due at t_ns, which are made here and now."""
    out: list[Publication] = []
    for method, job, due_ns in fold.pending(state):
        fitting = ROW[method].fitting
        if t_ns >= due_ns and fitting is not None:
            out += fold.adopt(state, t_ns, method, fitting.fit(state.machine, job))
    return out


def numbers(estimate: Estimate) -> list[float]:
    """Six logarithms and their sds; not a number where there is none, (12,)."""
    sds = np.sqrt(np.diag(np.reshape(estimate.log_covariance, (6, 6))))
    logs = [
        math.log(p.value) if p.value and p.status in (Status.ESTIMATED, Status.STALE) else math.nan
        for p in estimate.parameters
    ]
    return [*logs, *np.where(np.isfinite(logs), sds, math.nan).tolist()]


def first_informed(wheel: Array, after_s: float) -> float:
    """When the wheels first turn beyond INFORMED after a time, s; infinite if never."""
    from_ = round(after_s / STEP_S)
    beyond_limit = np.flatnonzero(np.abs(wheel[from_:]) > INFORMED)
    return (from_ + int(beyond_limit[0])) * STEP_S if len(beyond_limit) else math.inf


def harm(rows: Array, logs: Array) -> tuple[int, int]:
    """(numbers that were given, those of them beyond FAR[0]), all instants counted. rows: as
    Followed.series; logs: true logarithms, (6,)."""
    z = np.abs((rows[:, 1:7] - logs) / rows[:, 7:13])
    return int(np.isfinite(z).sum()), int(np.sum(z > FAR[0]))
