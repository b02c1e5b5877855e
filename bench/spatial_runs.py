"""One log of bench/spatial_logs.py through the product's estimators, and what is right of what they say.

Each fit is made when it is due, as `tilth replay` does with a log that has no recorded fits.
"""

import math
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import spatial_logs
from estimation_study import fitted, fitted_at_once, numbers, windows
from held_out import Way, distances
from numpy.typing import NDArray
from spatial_logs import DROP, ROW, LogRow, Run

from tilth.analysis.fit.rig import fitted_rig
from tilth.estimator import fold
from tilth.estimator.filters import likelihood, unknowns
from tilth.estimator.filters.rig_setup import rig_setup
from tilth.estimator.filters.unknowns import AT, SIX
from tilth.estimator.methods import pem
from tilth.estimator.models.parameters import Rig
from tilth.estimator.record import record_builder
from tilth.estimator.record.record import Record, Segment
from tilth.estimator.record.windows import WINDOWS
from tilth.replay.readers.any_log import frames
from tilth.schemas.flow import PARAMETERS, Estimate, Event, Pose, Publication
from tilth.schemas.machine import Machine
from tilth.schemas.machine_toml import parse_machine
from tilth.schemas.sentences import event_sentence, sentence
from tilth.simulator.scenario import Fieldwork, from_json

Array = NDArray[np.float64]

END_NS: Final = 60_000_000_000  # by when after the last frame every fit is due
THINNED_S: Final = 10.0  # between what is kept of a series
JITTER_S: Final = 0.0015  # mean of what a link adds to the latency: simulator/scenario.py
TURNING: Final = math.radians(12.0)  # wheel angle of a headland turn
TURN_GAP_S: Final = 30.0  # from turn to turn at least; more than a reversal takes


def follow(
    to: Path, name: str, scale: float, seed: int, held_out: bool = False, bounded: bool = False
) -> dict[str, object]:
    """Plain data of one run, for a line of JSON; the log is made if it is not there. scale: of its seconds,
    for a try. bounded: with the least sds that are possible, which takes a run of the filter for each fit."""
    row = ROW[name] if scale == 1.0 else replace(ROW[name], seconds=ROW[name].seconds * scale)
    spatial_logs.make(to, row, seed)
    run = spatial_logs.read_run(to, name, seed)
    machine = parse_machine(run.machine_text)
    began = time.perf_counter()
    heard = Heard(machine, run)
    heard.take_all(held_out)
    took_s = time.perf_counter() - began
    result = {"row": name, "seed": seed, "scale": scale, "took_s": took_s, "drive_s": row.seconds}
    result |= heard.result(row)
    if bounded:
        result["bound"] = heard.bound()
    if held_out:
        result["trajectory"] = held_out_errors(machine, run, heard.segments, scale)
    return result


class Heard:
    """What is published over a log. Times are s of the truth."""

    def __init__(self, machine: Machine, run: Run) -> None:
        self.machine, self.run = machine, run
        self.logs = np.log([run.described["parameters"][name] for name in PARAMETERS])
        self.series: dict[str, list[list[float]]] = {}
        self.last: dict[str, Estimate] = {}
        self.events: list[tuple[float, str, str]] = []
        self.segments: list[Segment] = []
        self.fitted: list[Record] = []  # what pem's fits were made of
        self.refused: dict[str, int] = {}
        self.learned: dict[str, Any] = {}  # method -> its state at the end

    def take_all(self, with_segments: bool) -> None:
        state, recording = fold.initial(self.machine), record_builder.initial(self.machine)
        t_ns = 0
        for frame in frames(self.run.log):
            t_ns = frame.t_ns
            publications = fitted_at_once(state, t_ns) + fold.step(state, frame)
            self._request(state, t_ns)
            for publication in publications:
                self._take(publication)
                if with_segments and isinstance(publication.value, Pose):
                    segment = record_builder.observe(recording, state.aligner, publication.value)
                    self.segments += [] if segment is None else [segment]
        last = fitted_at_once(state, t_ns + END_NS)
        fold.finish(state)
        self._request(state, t_ns)
        for publication in last + fitted_at_once(state, t_ns + END_NS):
            self._take(publication)
        self.refused, self.learned = (
            {code.value: n for code, n in state.record.refused.items()},
            state.estimators,
        )

    def _request(self, state: fold.State, t_ns: int) -> None:
        before = {id(job) for _, job, _ in fold.pending(state)}
        fold.request_fits(state, t_ns)
        asked = [job for _, job, _ in fold.pending(state) if id(job) not in before]
        self.fitted += [job.record for job in asked if isinstance(job, pem.Job)]

    def _take(self, publication: Publication) -> None:
        value = publication.value
        if isinstance(value, Estimate):
            at_s = self.run.seconds_of(publication.t_ns)
            self.series.setdefault(value.method, []).append([at_s, *numbers(value)])
            self.last[value.method] = value
        elif isinstance(value, Event):
            self.events.append((self.run.seconds_of(value.t_ns), value.kind, event_sentence(value)))

    def result(self, row: LogRow) -> dict[str, object]:
        after = np.zeros(6)
        after[:3] = math.log(DROP) if row.informed_s else 0.0
        methods = {name: self._method(name, self.logs + after, row) for name in self.series}
        return {
            "logs": self.logs.tolist(), "methods": methods, "events": self.events, "refused": self.refused,
            "turn_ends_s": turn_ends(self.run),
            "wheel_s": informative_times(self.run, row.informed_s) if row.informed_s else [],
        }  # fmt: skip

    def _method(self, name: str, logs: Array, row: LogRow) -> dict[str, object]:
        series = np.array(self.series[name])
        given = np.isfinite(series[:, 1:7])
        first = [float(series[np.argmax(g), 0]) if g.any() else math.nan for g in given.T]
        ends = [start + spatial_logs.GAP_S + 1.0 for start, _ in row.gaps]
        at_ends = [series[np.searchsorted(series[:, 0], end) - 1].tolist() for end in ends]
        error, sd = series[-1, 1:7] - logs, series[-1, 7:]
        return {
            "error": error.tolist(),
            "sd": sd.tolist(),
            "per_mass": self._per_mass(self.last[name], float(logs[2])),
            "nuisances": nuisance_errors(self.machine, self.run, self.last[name]),
            "first_s": first,
            "reasons": [sentence(p.reason) for p in self.last[name].parameters],
            "run_ends": at_ends,
            "series": thinned(series).tolist(),
            "whole": whole_near(series, row.informed_s) if row.informed_s else [],
        }

    def bound(self) -> list[float]:
        """Sds below which no estimator gets, (6,), by the product's own model: the expected information of
        what `pem` fitted, at the true values as far as they are its unknowns, and the prior. C_ai is over
        the mass."""
        if "pem" not in self.learned:
            return [math.nan] * 6
        point = self.learned["pem"].mean.copy()
        point[SIX] = self.logs
        for name, value in true_nuisances(self.machine, self.run).items():
            point[AT[name]] = value
        return list(map(float, bound_at(self.machine, self.fitted, point)))

    def _per_mass(self, told: Estimate, log_stiffness: float) -> list[float]:
        """(error, sd) of log C_ai over the implement's mass, as published."""
        value, sd = (*told.per_mass, *[None] * 3)[2], (*told.per_mass_sd, *[None] * 3)[2]
        if value is None or sd is None:
            return [math.nan, math.nan]
        true = log_stiffness - math.log(float(self.run.described["rig"]["m_i"]["value"]))
        return [math.log(value) - true, sd / value]


def bound_at(machine: Machine, records: list[Record], point: Array) -> Array:
    """Sds of the six, (6,), from the information of records at a point, (n,), and the prior. Noise levels
    are those of the point; masses are known, but for what they add to C_af and C_ar."""
    prior_mean, prior_sd = unknowns.prior(machine)
    known = np.diag(prior_sd**2)
    known[unknowns.MASSES, unknowns.MASSES] = 0.0
    setup, total, active = rig_setup(machine), np.zeros_like(known), np.flatnonzero(np.diag(known))
    for record in records:
        search = likelihood.search_of(record, setup, prior_mean, known)
        at = likelihood.evaluate(search, point, levels=True)
        found = likelihood.gradient_and_information(search, at, likelihood.scores_at(search, at))[1]
        total[np.ix_(active, active)] += found - search.prior_information
    whole = total[np.ix_(active, active)] + np.diag(prior_sd[active] ** -2.0)
    least = np.diag(np.linalg.inv(whole))[SIX] + np.diag(pem.of_masses(np.diag(prior_sd**2)))[SIX]
    least[2] -= prior_sd[AT["m_i"]] ** 2
    return np.asarray(np.sqrt(least), np.float64)


def thinned(series: Array) -> Array:
    """Rows at least THINNED_S apart; the last one always."""
    steps = np.floor(series[:, 0] / THINNED_S)
    return np.asarray(series[np.append(np.diff(steps) > 0.0, True)])


def whole_near(series: Array, about_s: float) -> list[list[float]]:
    """The rows from 10 s before a time on, all of them."""
    return list(series[series[:, 0] > about_s - 10.0].tolist())


# What is true.


def true_nuisances(machine: Machine, run: Run) -> dict[str, float]:
    """By unknowns.NAMES, as they are defined there: what antennas, clocks and sensors add up to."""
    told, result = run.described["nuisances"], {}
    result["wheel_zero"] = told["wheel_zero"]
    result["wheel_gain"] = math.log(told["wheel_gain"] / machine.wheel_angle.gain.value)
    late = [told[f"latency_{r.mount}"] - r.latency.value for r in machine.receiver]
    result["latency"] = float(np.mean(late)) + JITTER_S
    lateral_offset = {}
    for body in ("tractor", "implement"):
        k, mounts = body[0], [r for r in machine.receiver if r.mount.body == body]
        place = np.array([r.position[0] for r in mounts])
        right = np.array([told[f"right_{r.mount}"] for r in mounts])
        # Two antennas: what moves them to either side turns the pair too.
        turned = (right[0] - right[-1]) / (place[0] - place[-1])
        result[f"pair_{k}"] = told[f"pair_{body}"] + float(turned)
        result[f"lever_{k}"] = float(np.mean([told[f"forward_{r.mount}"] for r in mounts]))
        result[f"cg_{k}"] = told[f"cg_forward_{body}"]
        result |= {f"roll_zero_{r.mount}": told[f"roll_zero_{r.mount}"] for r in mounts}
        for name, key in (("roll_late", "roll_delay"), ("rate_late", "turn_rate_delay")):
            result[f"{name}_{k}"] = float(np.mean([told[f"{key}_{r.mount}"] for r in mounts]))
        lateral_offset[body] = float(np.mean(right)) - told[f"cg_right_{body}"]
    result["sway"] = 0.0
    result["aside_i"] = lateral_offset["implement"] - lateral_offset["tractor"]
    return result


def nuisance_errors(machine: Machine, run: Run, said: Estimate) -> dict[str, list[float]]:
    """Name -> (error, sd) of what a method says of it."""
    true = true_nuisances(machine, run)
    return {
        name: [value - true[name], sd]
        for name, (value, sd) in said.nuisances.items()
        if name in true and sd > 0.0
    }


def turn_ends(run: Run) -> list[float]:
    """When each headland turn of a field is over, s."""
    if not isinstance(from_json(run.described["source"]["scenario"]).steering, Fieldwork):
        return []
    arrays = spatial_logs.truth_arrays(run.folder)
    times = arrays["time"][np.abs(arrays["wheel"]) > TURNING]
    if not len(times):
        return []
    last = np.append(np.diff(times) > TURN_GAP_S, True)
    return [float(t) for t in times[last]]


def informative_times(run: Run, after_s: float) -> list[float]:
    """Times after a change, s, at which the wheels were beyond 2 degrees."""
    arrays = spatial_logs.truth_arrays(run.folder)
    chosen = (arrays["time"] > after_s) & (np.abs(arrays["wheel"]) > math.radians(2.0))
    return [float(t) for t in arrays["time"][chosen][:: spatial_logs.KEEP]]


# The way on from a fit.


def held_out_errors(machine: Machine, run: Run, segments: list[Segment], scale: float) -> list[float] | None:
    """(tractor, implement), m, over a second window of 30 s by what the first one gave: on level ground, then
    with the measured roll taken for a slope, then level with the true rig. None without two windows."""
    length = round(WINDOWS.longest * scale)
    records = windows(segments, length)
    if len(records) < 2:
        return None
    logs = np.log([run.described["parameters"][name] for name in PARAMETERS])
    found = fitted(machine, logs, records[:1])
    true = Rig(**{name: entry["value"] for name, entry in run.described["rig"].items()})
    arrays: Mapping[str, Array] = spatial_logs.truth_arrays(run.folder)
    way, at_s = Way(arrays["time"], arrays["states"], true), run.seconds_of(records[1].t_ns)
    wheel = found.mean[AT["wheel_zero"]], math.exp(found.mean[AT["wheel_gain"]])
    told = run.described["nuisances"]
    own = fitted_rig(machine, found.mean)
    return [
        *distances(way, records[1], at_s, own, wheel, level=True),
        *distances(way, records[1], at_s, own, wheel),
        *distances(way, records[1], at_s, true, (told["wheel_zero"], told["wheel_gain"]), level=True),
    ]
