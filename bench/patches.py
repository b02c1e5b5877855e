"""Does an interval hold at the place where it was published? Fields in patches with a wet end, drawn anew.

    python bench/patches.py [--count 8] [--first 0] [--minutes 12] [--one-soil] [--plant spatial]
                            [--processes 1] [--keep patches.jsonl] [--summary]

Drive k is of field k by `scenario_for`: patches of 20 to 60 m with an sd of 10 to 30 %, whose lengths along
and across and whose correlation between axles differ, and an end that is 30 to 50 % softer; rows in order, in
every other field beside a skipped one. The truth is what is under each axle at the instant of the estimate.
It is counted over passes and stretches of the patches' length: the seconds in one stretch count once
together. Rows and turns apart; median errors from the third pass on. The oracle is the memory itself, told of
the same windows, with the covariance that the field was drawn with in place of hypotheses. With --one-soil
the same drives have neither patches nor a wet end.
"""

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Final, Literal, get_args

import numpy as np
import spatial_rows
from estimation_study import Driven, followed
from estimation_table import (
    Bench,
    Line,
    Row,
    Z,
    drives_asked,
    drives_parser,
    figures,
    percents,
    print_rows,
)  # fmt: skip
from numpy.typing import NDArray
from scipy.special import j0

from tilth.estimator import fold
from tilth.estimator.filters.soil_field import AXLES, SoilMemory, Variogram, over_paths
from tilth.estimator.models.nonlinear import STATES
from tilth.schemas.flow import Estimate
from tilth.simulator.drive import drive
from tilth.simulator.ground import PATCH_BAND, axles_of, share
from tilth.simulator.packaged import packaged_file
from tilth.simulator.scenario import (
    STEP_S,
    Autosteer,
    Fieldwork,
    Ground,
    HeadlandTurn,
    Scenario,
    Soil,
    SoilChange,
)
from tilth.simulator.tractor import Truth

Array = NDArray[np.float64]
Result = dict[str, Any]
"""Of `follow`: one line of JSON."""

Plant = Literal["planar", "spatial"]
NAME: Final = "patches"
ROUGH: Final[Mapping[Plant, dict[str, Any]]] = {
    "planar": {"roll_sd_deg": 0.5, "force_sd": 0.008, "rut": True}, "spatial": {"rms": 0.01},
}  # fmt: skip
METHODS: Final = ("place", "pem", "recommended")
ORACLE: Final = "oracle"
WHERE: Final = ("rows", "turns")
HOLD: Final = 0.92
ERROR: Final = 0.15  # median, of C, from the third pass on
TURNED: Final = math.radians(20.0)  # from the direction of the rows
RUNNING_IN: Final = 2  # passes
SCORE: Final = 1.3  # mean interval score over the oracle's
AHEAD: Final = 0.2  # half an interval, of the factor common to the stiffnesses in the wet end
AHEAD_S: Final = 25.0  # before the wheels are there
AT: Final = {name: k for k, name in enumerate(STATES)}


def scenario_for(k: int, minutes: float, one_soil: bool = False, plant: Plant = "planar") -> Scenario:
    """Field k."""
    rng = np.random.default_rng([53, k])
    length, patch = rng.uniform(100.0, 180.0), rng.uniform(20.0, 60.0)
    wet = 1.0 - rng.uniform(0.3, 0.5)
    end = SoilChange(
        north=rng.uniform(0.6, 0.8) * length, east=0.0, towards_deg=rng.uniform(-30.0, 30.0), over=20.0,
        C_af=wet, C_ar=wet, C_ai=wet * rng.uniform(0.9, 1.1),
    )  # fmt: skip
    soil = Soil(
        grip=0.7, rolling=0.06, changes=(end,), patch_log_sd=rng.uniform(0.1, 0.3), patch_length=patch,
        patch_across=rng.uniform(0.5, 2.0), patch_common=rng.uniform(0.3, 1.0),
    )  # fmt: skip
    if one_soil:
        soil = replace(soil, changes=(), patch_log_sd=0.0)
    steered = Autosteer("pid") if k % 4 >= 2 else None
    turn, speed = HeadlandTurn((6.1, 12.2)[k % 2], 6.0), rng.uniform(2.8, 4.2)
    return Scenario(
        seconds=60.0 * minutes, plant=plant, speed=speed,
        steering=Fieldwork(length=length, turns=(turn,), autosteer=steered),
        ground=Ground(slope_deg=rng.uniform(0.0, 3.0), **ROUGH[plant]), soil=soil, other_traffic=False,
    )  # fmt: skip


def variogram(soil: Soil, length_m: float) -> Variogram:
    """What the field was drawn with: patches, and an end that is wet as if it began anywhere in a row of that
    length, with the variance that it has."""
    waves = 2 * np.pi / (soil.patch_length * PATCH_BAND ** np.linspace(0.0, 1.0, 200))
    metres = np.linspace(0.0, 4000.0, 8001)
    alike = np.array([j0(waves * at).mean() for at in metres])
    of_axles = np.full((AXLES, AXLES), soil.patch_common) + (1.0 - soil.patch_common) * np.eye(AXLES)
    toward, wet = 0.0, 0.0
    for end in soil.changes:
        beyond = 1.0 - (end.north or 0.0) / length_m
        toward, wet = math.radians(end.towards_deg), math.log(end.C_af) ** 2 * beyond * (1.0 - beyond)

    def covariance(apart: Array, _: float) -> Array:
        north, east = apart
        patches = np.interp(np.hypot(north, east / soil.patch_across), metres, alike)
        to_end = np.abs(north * math.cos(toward) + east * math.sin(toward))
        tiled = np.tile(of_axles, (apart.shape[1], apart.shape[4]))
        told = soil.patch_log_sd**2 * over_paths(patches) * tiled
        return np.asarray(told + wet * over_paths(np.exp(-2.0 * to_end / length_m)))

    return Variogram(1.0, soil.patch_length, covariance)


class Watch:
    """Asks at each estimate of the memory: what an oracle would say here, and what it says of the wet end."""

    def __init__(self, run: Driven, asked: Scenario) -> None:
        self._run, self._axles = run, axles_of(run.truth.rig, run.truth.states)
        assert isinstance(asked.steering, Fieldwork)
        self._soil = variogram(asked.soil, asked.steering.length)
        self._memory = SoilMemory([], np.ones(6))
        self._into = [at for end in asked.soil.changes for at in _into(end, run.truth, self._axles)]
        self.told: list[Array] = []  # (13,): time, six logarithms, their sds
        self.ahead: list[list[float]] = []
        """Error and sd of the common factor, and the oracle's, for each pass after the first."""

    def __call__(self, state: fold.State, estimate: Estimate) -> None:
        memory = state.estimators["place"]
        if estimate.method != "place" or memory.axles is None or not memory.windows:
            return
        if self._memory.windows is not memory.windows:
            self._memory = SoilMemory(memory.windows, memory.prior_sd, [self._soil])
        at = self._run.seconds_of(estimate.t_ns)
        here = self._memory.at(memory.axles)
        number = [math.nan if one.value is None else 0.0 for one in estimate.parameters]
        mean = memory.prior_mean[:6] + here.mean + number  # where the memory gives one
        self.told.append(np.concatenate([[at], mean, np.sqrt(np.diag(here.covariance))]))
        while len(self._into) > 1 and self._into[1] * STEP_S < at + AHEAD_S:
            now, there = round(at / STEP_S), self._into.pop(1)
            told: list[float] = []
            for soil in (memory.soil, self._memory):
                said = soil.at(memory.axles + self._axles[there] - self._axles[now])
                off = (
                    memory.prior_mean[:AXLES]
                    + said.mean[:AXLES]
                    - np.log(self._run.truth.soil[there, :AXLES])
                )
                told += [float(off.mean()), math.sqrt(said.covariance[:AXLES, :AXLES].mean())]
            self.ahead.append(told)


def _into(end: SoilChange, truth: Truth, axles: Array) -> list[int]:
    """Samples at which the rear axle comes to be wholly in the wet end."""
    inside = share(end, truth.time, axles)[:, 1] >= 1.0
    return (np.flatnonzero(np.diff(inside.astype(int)) > 0) + 1).tolist()


def follow(first: int, minutes: float, one_soil: bool, plant: Plant, k: int) -> Result:
    """Field number first + k: what was published in it, beside the truth."""
    began, asked = time.perf_counter(), scenario_for(first + k, minutes, one_soil, plant)
    machine = packaged_file().machine
    truth = drive(machine, first + k, asked.seconds, asked)
    run = Driven(machine, truth, machine)
    watch = Watch(run, asked)
    heard = followed(run, watch)
    psi, north = truth.states[:, AT["psi_t"]], truth.states[:, AT["x_t"]]
    passes = np.cumsum(np.abs(np.diff(np.cos(psi) > 0.0, prepend=np.cos(psi[0]) > 0.0)))
    series = {**heard.series, ORACLE: np.array(watch.told)}
    methods = {}
    for method in (*METHODS, ORACLE):
        rows = series.get(method, ())
        told = np.asarray(rows) if len(rows) else np.zeros((0, 13))
        at = np.clip((told[:, 0] / STEP_S).round().astype(np.int64), 0, len(psi) - 1)
        methods[method] = {
            "error": (told[:, 1:7] - np.log(truth.soil[at])).tolist(),
            "sd": told[:, 7:13].tolist(),
            "turn": (np.abs(np.sin(psi[at])) > math.sin(TURNED)).tolist(),
            "pass": passes[at].tolist(),
            "stretch": np.floor(north[at] / asked.soil.patch_length).tolist(),
        }
    return {
        "row": name_of(one_soil, plant), "seed": k, "first": first, "scale": minutes, "field": first + k,
        "methods": methods, "ahead": watch.ahead,
        "changes": [at for at, kind, _ in heard.events if kind == "soil_change"],
        "patch_m": asked.soil.patch_length, "patch_sd": asked.soil.patch_log_sd,
        "took_s": time.perf_counter() - began,
    }  # fmt: skip


def name_of(one_soil: bool, plant: Plant) -> str:
    return NAME + (", one soil" if one_soil else "") + (", spatial" if plant == "spatial" else "")


def row(first: int, one_soil: bool, plant: Plant, bench: Bench) -> list[Line]:
    """The lines of the table; fields that a file has are not driven again."""
    run = partial(follow, first, bench.scale, one_soil, plant)
    have = spatial_rows.kept(bench, name_of(one_soil, plant), first)
    return lines_of(bench.each(run, 8, have, partial(spatial_rows.keep, bench)))


def lines_of(made: Sequence[Result]) -> list[Line]:
    methods, places = (*METHODS, ORACLE), list(enumerate(WHERE))
    return [
        *(line for method in methods for k, where in places for line in _lines(made, method, where, k)),
        *(line for k, where in places for line in _scores(made, where, k)),
        *_ahead(made),
        Line("soil_change was told, in each field", " ".join(str(len(one["changes"])) for one in made)),
    ]  # fmt: skip


def _ahead(made: Sequence[Result]) -> Iterator[Line]:
    told = np.array([each for one in made for each in one["ahead"]])
    if len(told):
        error, sd, error_oracle, sd_oracle = np.abs(told).T
        half = float(np.median(Z * sd))
        yield Line(
            f"wet end, {AHEAD_S:g} s ahead, {len(told)} passes after the first: half an interval of the "
            "common factor; median error", percents([half, float(np.median(error))], 0),
            "≤ 20 %", half <= AHEAD,
        )  # fmt: skip
        oracle = [float(np.median(Z * sd_oracle)), float(np.median(error_oracle))]
        yield Line("the same of the oracle", percents(oracle, 0))
        holds = float(np.mean(error < Z * sd))
        yield Line("wet end: intervals hold", percents([holds], 0), "≥ 92 %", holds >= HOLD)


def _scores(made: Sequence[Result], where: str, turn: int) -> Iterator[Line]:
    """Mean interval scores of the stiffnesses, over the oracle's: width of 95 %, and 40 times how far the
    truth is outside (Gneiting and Raftery 2007)."""
    scores = {}
    for method in (*METHODS, ORACLE):
        each = []
        for one in made:
            told = one["methods"][method]
            of_turn = np.array(told["turn"], dtype=bool) == bool(turn)
            error, sd = (np.reshape(told[key], (-1, 6)).astype(float)[of_turn, :3] for key in ("error", "sd"))
            each.append(2 * Z * sd + 40.0 * np.maximum(np.abs(error) - Z * sd, 0.0))
        pooled = np.concatenate(each)
        scores[method] = np.nanmean(pooled, axis=0) if np.isfinite(pooled).any() else np.full(3, math.nan)
    for method in METHODS:
        over = scores[method] / scores[ORACLE]
        yield Line(
            f"{method}, {where}: mean interval score of C over the oracle's", figures(over), f"≤ {SCORE}",
            bool(over.mean() <= SCORE) if method != "pem" else None, over.tolist(),
        )  # fmt: skip


def _means(values: Array) -> Array:
    """Mean of each column, over what is a number; not a number where there is none."""
    given = np.isfinite(values)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.where(given, values, 0.0).sum(axis=0) / given.sum(axis=0))


def _lines(made: Sequence[Result], method: str, where: str, turn: int) -> Iterator[Line]:
    held, errors, sds = list[Array](), list[Array](), list[Array]()
    fields, off = list[Array](), list[Array]()
    for one in made:
        told = one["methods"][method]
        if not told["error"]:
            continue
        error, sd = (np.array(told[key], dtype=np.float64) for key in ("error", "sd"))
        passes, of_turn = np.array(told["pass"]), np.array(told["turn"]) == bool(turn)
        before = len(held)
        cells = np.column_stack([passes, np.array(told["stretch"])])
        for cell in np.unique(cells[of_turn], axis=0):
            inside = of_turn & np.all(cells == cell, axis=1)
            given = np.isfinite(error[inside])
            share = np.sum(np.abs(error[inside]) < Z * sd[inside], axis=0) / np.maximum(given.sum(axis=0), 1)
            held.append(np.where(given.any(axis=0), share, math.nan))
        fields.append(_means(np.reshape(held[before:], (-1, 6))))
        off.append(_means((error / sd)[of_turn]))
        later = of_turn & (passes >= RUNNING_IN)
        errors.append(np.abs(error[later]))
        sds.append(sd[later])
    if not held or np.all(np.isnan(held)):
        yield Line(f"{method}, {where}", "no number was given")
        return
    shares = np.nanmean(held, axis=0)
    judged = method != "pem" and method != ORACLE
    cells_given = int(np.isfinite(held).any(axis=1).sum())
    yield Line(
        f"{method}, {where}: 95 % intervals hold, {cells_given} stretches", percents(shares, 0), "≥ 92 %",
        bool(np.all(shares >= HOLD)) if judged else None, shares.tolist(),
    )  # fmt: skip
    # Stretches of a field share its rig and its soil: only fields are independent.
    by_field = np.array(fields)
    spread = _means((by_field - _means(by_field)) ** 2)
    error_of = np.sqrt(spread / np.maximum(np.isfinite(by_field).sum(axis=0) - 1, 1))
    if len(by_field) > 1:
        name = f"{method}, {where}: standard error of that, by fields"
        yield Line(name, percents(error_of, 0), values=error_of.tolist())
    shift = _means(np.array(off))
    yield Line(f"{method}, {where}: mean error over sd, by fields", figures(shift), values=shift.tolist())
    error, sd = (np.nanmedian(np.concatenate(each), axis=0) for each in (errors, sds))
    yield Line(
        f"{method}, {where}: median |error| from the third pass", percents(error, 0), "C ≤ 15 %",
        bool(np.all(error[:3] <= ERROR)) if judged else None, error.tolist(),
    )  # fmt: skip
    yield Line(f"{method}, {where}: median sd", percents(sd, 0), values=sd.tolist())


def main() -> None:
    parser = drives_parser(__doc__, 8, "patches.jsonl", "fields")
    parser.add_argument("--minutes", type=float, default=12.0, help="of each drive")
    parser.add_argument("--one-soil", action="store_true", help="without patches and wet end")
    parser.add_argument("--plant", choices=get_args(Plant), default="planar")
    args = drives_asked(parser)
    name = name_of(args.one_soil, args.plant)
    rows = [Row(name, "≥ 92 % hold", partial(row, args.first, args.one_soil, args.plant))]
    print_rows(args, rows, args.minutes, 150)


if __name__ == "__main__":
    main()
