"""Everything that tells whether fitted parameters can be trusted, of what `tilth fit` has fitted."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tilth.analysis.fit.fitting import Fitted, driven_of
from tilth.analysis.fit.joint import join
from tilth.analysis.fit.rig import fitted_rig
from tilth.analysis.fit.segment_fit import FittedWindow
from tilth.analysis.fit.side_by_side import side_by_side
from tilth.analysis.response.response import DriveSamples, MeasuredResponse, measured_response
from tilth.analysis.runs.run import Run
from tilth.analysis.runs.segments import DrivenSegment
from tilth.analysis.validation import held_out, residuals
from tilth.analysis.validation.held_out import Predictable, Subset
from tilth.analysis.validation.residuals import InputTest, SizeTest, WhitenessTest
from tilth.estimator.filters import likelihood, unknowns
from tilth.estimator.filters.rig_setup import rig_setup
from tilth.estimator.filters.unknowns import AT
from tilth.estimator.models.parameters import Rig, rig_of
from tilth.estimator.record.record import (
    KIND,
    OFFSET,
    PLACE,
    TICK,
    TICK_NS,
    VELOCITY,
    WHEEL_ANGLE,
    YAW_RATE,
)
from tilth.schemas.flow import Mount
from tilth.schemas.machine import Machine

Array = NDArray[np.float64]

POSE_S: Final = 0.2
INITIAL, ESTIMATED, PREVIOUS = "machine file", "estimated", "previous"
"""Names of the model curves beside a measured response."""
_OUTPUTS: Final = (
    *((f"yaw rate of the {body}", YAW_RATE, k) for k, body in enumerate(("tractor", "implement"))),
    *((f"velocity at {mount.value.replace('_', ' ')}", VELOCITY, k) for k, mount in enumerate(Mount)),
)
_FEWEST: Final = 40  # innovations to test


def hold_out(fitted: Fitted, cache: Path | None = None) -> tuple[Subset, ...]:
    """Parameters of every subset of the segments, over every segment; () where none told anything.

    A single segment's parameters are those of its own fit; segments that do not agree have none together.
    """
    if fitted.linearised is None:
        return ()
    machine = fitted.wanted[0].run.machine
    runs: list[Predictable] = []
    places: dict[str, int] = {}  # id -> which of the linearised
    for at, k in enumerate(fitted.told):
        driven = driven_of(fitted.wanted[k], cache)
        run = held_out.predictable(machine, fitted.wanted[k].id, driven, fitted.fits[k].mean)
        if run is not None:
            runs.append(run)
            places[run.id] = at
    estimates: dict[tuple[str, ...], Array | str] = {}
    for ids in held_out.subsets(list(places)):
        joint = join(machine, fitted.linearised, [places[id] for id in ids])
        estimates[ids] = "these segments do not agree" if joint.refused.any() else joint.mean
    with side_by_side(len(runs) * len(estimates)) as each:
        return held_out.table(machine, runs, estimates, each)


@dataclass(frozen=True, slots=True)
class ResidualTests:
    """Of one output of one segment."""

    segment: str  # id
    output: str
    white: WhitenessTest
    by_wheel: InputTest
    size: SizeTest


def residual_tests(fitted: Fitted) -> tuple[ResidualTests, ...]:
    """Of the one-step predictions of each segment at its own fit, output by output."""
    found: list[ResidualTests] = []
    for k in fitted.told:
        machine, fit = fitted.wanted[k].run.machine, fitted.fits[k]
        for output, e, S, dt, wheel in _innovations(machine, fit.windows, fit.mean):
            z, id = e / np.sqrt(S), fitted.wanted[k].id
            what = f"{output} in segment {id}"
            white = residuals.whiteness(z, dt, what)
            by_wheel = residuals.input_independence(z, wheel, dt, what)
            found.append(ResidualTests(id, output, white, by_wheel, residuals.innovation_size(e, S, what)))
    return tuple(found)


def _innovations(
    machine: Machine, windows: Sequence[FittedWindow], mean: Array
) -> list[tuple[str, Array, Array, float, Array]]:
    """(output, innovations, their variances, s between them, wheel angle there) of the longest window."""
    window = max(windows, key=lambda one: len(one.record.ticks))
    point = mean.copy()
    point[unknowns.NOISE] = window.noise
    record, setup = window.record, rig_setup(machine)
    made = likelihood.innovations(record, setup, likelihood.first_state(record, setup), point)
    rows = record.rows
    settled = rows[:, TICK] >= likelihood.LIKELIHOOD.settling_ticks
    at_s = rows[:, TICK] * TICK_NS * 1e-9 + rows[:, OFFSET]
    found = []
    for output, kind, place in _OUTPUTS:
        chosen = (rows[:, KIND] == kind) & (rows[:, PLACE] == place) & settled
        if np.count_nonzero(chosen) < _FEWEST:
            continue
        ticks_s = np.arange(len(record.ticks)) * TICK_NS * 1e-9
        wheel: Array = np.interp(at_s[chosen], ticks_s, record.ticks[:, WHEEL_ANGLE])
        dt = float(np.median(np.diff(at_s[chosen]))) or POSE_S
        found.append((output, made.e[chosen], made.S[chosen], dt, wheel))
    return found


def response(
    run: Run,
    segments: Sequence[DrivenSegment],
    rigs: Mapping[str, Rig],
    wheel: tuple[float, float] = (0.0, 1.0),
) -> MeasuredResponse:
    """Frequency response over the segments of a run, from its poses.

    wheel: zero, rad, and gain of the wheel angle, as fitted.
    """
    poses = run.poses
    count = round((float(poses.t_s[-1]) - float(poses.t_s[0])) / POSE_S) + 1 if poses.rows else 0
    at = np.round((poses.t_s - poses.t_s[:1]) / POSE_S).astype(np.int64)
    columns = {
        "wheel": (poses["wheel_angle_rad"] - wheel[0]) / wheel[1],
        "r_t": poses["tractor_yaw_rate_radps"],
        "r_i": poses["implement_yaw_rate_radps"],
        "articulation": poses["articulation_rad"],
        "speed": poses["tractor_forward_velocity_mps"],
    }
    inside = np.zeros(poses.rows, np.bool_)
    for segment in segments:
        inside |= (poses.t_s >= segment.start_s) & (poses.t_s <= segment.end_s)
    sampled = {}
    for name, values in columns.items():
        sampled[name] = np.full(count, math.nan)
        sampled[name][at[inside]] = values[inside]
    outputs = {name: sampled[name] for name in ("r_t", "r_i", "articulation")}
    return measured_response(DriveSamples(POSE_S, sampled["wheel"], outputs, sampled["speed"]), rigs)


def responses(fitted: Fitted, previous: Array | None = None) -> dict[str, MeasuredResponse]:
    """Run -> its frequency response over all segments that were fitted, beside the machine file's model, the
    estimate's and, where given, [n] of unknowns.NAMES, that of earlier parameters."""
    if fitted.joint is None:
        return {}
    machine, mean = fitted.wanted[0].run.machine, fitted.joint.mean
    rigs = {INITIAL: rig_of(machine)}
    if not fitted.joint.refused.any():
        rigs[ESTIMATED] = fitted_rig(machine, mean)
    if previous is not None:
        rigs[PREVIOUS] = fitted_rig(machine, previous)
    wheel = float(mean[AT["wheel_zero"]]), math.exp(mean[AT["wheel_gain"]])
    found = {}
    for run in dict.fromkeys(wanted.run.id for wanted in fitted.wanted):
        of_run = [wanted for wanted in fitted.wanted if wanted.run.id == run]
        found[run] = response(of_run[0].run, [one.segment for one in of_run], rigs, wheel)
    return found
