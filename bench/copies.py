"""Copies of one drive that mean the same: what differs in the numbers, and where the difference enters.

    python bench/copies.py [DRIVE …] [--copies NAME,…] [--out FILE]

A DRIVE is `planar:SEED` or `spatial:SEED`, drawn as the rows of bench/spatial_logs.py are, with the packaged
machine or that of `:MACHINE.toml` behind it, `fleet:RIG` as of bench/fleet.py, or LOG:MACHINE.toml. Its
copies are the same frames

at LATITUDE   at another place on Earth, so that degrees are rounded otherwise (1e-7°, 3 mm rms)
shifted       taken 3 ms later by the computer's clock
reordered     with frames of different senders that came within 2 ms of each other in another order

and, to see where a difference enters, pem's fits of the drive itself are made again with noise of a rounding
in its positions: windows, poses and all that is decided before a fit are then the same ("same windows").
With --starts each of pem's windows is also fitted from so many points, its prior's mean and others that are
drawn one prior sd of the six away: they must end in one place, or say that there are two.
Deviations are from the median of the other copies, in sds as published.
"""

import argparse
import json
import math
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import spatial_logs
from estimation_study import fitted_at_once, numbers
from fleet_design import cell_of, scenario
from numpy.typing import NDArray
from pyproj import Transformer

from tilth.estimator import fold
from tilth.estimator.filters.rig_setup import rig_setup
from tilth.estimator.filters.scoring import Posterior, maximise_posterior
from tilth.estimator.filters.unknowns import SIX
from tilth.estimator.methods import pem
from tilth.estimator.record.record import EAST, KIND, NORTH, VALUE, Record
from tilth.replay.readers.any_log import frames
from tilth.schemas import can_id
from tilth.schemas.flow import PARAMETERS, Estimate, Frame, Status
from tilth.schemas.machine import Machine
from tilth.schemas.machine_toml import parse_machine
from tilth.simulator.fleet import drawn
from tilth.simulator.fleet_files import owners_text, true_machine
from tilth.simulator.noise import generator
from tilth.simulator.scenario import Ground, Spatial
from tilth.simulator.traffic import simulate

Array = NDArray[np.float64]

SECONDS: Final = 91.0
END_NS: Final = 60_000_000_000  # by when after the last frame every fit is due
SHIFT_NS: Final = 3_000_000
NEAR_NS: Final = 2_000_000
ROUNDING_M: Final = 6_378_137.0 * math.radians(1e-7)
PLACES: Final = {
    "42": (42.0, -93.6), "-17": (-17.3, -63.1), "68": (68.2, 24.4), "0": (0.0, 37.0), "-45": (-45.1, 169.2),
}  # fmt: skip
USUAL: Final = ("as it is", "at 42", "at 68", "shifted", "reordered")
SINGLE: Final = {65267: (32, -210.0, False), 129025: (32, 0.0, True)}  # PGN: bits, offset, signed
FAST: Final = 129029  # its two words of 64 bits begin at bytes 7 and 15 of the payload
SPREAD_SD: Final = 0.3
METHODS: Final = ("pem", "tracker", "recommended")


# Copies.


def placed(given: Sequence[Frame], latitude: float, longitude: float) -> list[Frame]:
    """The same frames with all positions moved to another place on Earth, and rounded there."""
    out = list(given)
    found = [(k, pgn) for k, frame in enumerate(given) if frame.extended and (pgn := _pgn(frame)) in SINGLE]
    degrees = np.array([_degrees(given[k].data, pgn) for k, pgn in found])
    origin = degrees[np.argmax(np.all(np.abs(degrees) < [90.0, 180.0], axis=1))]
    move = _mover((float(origin[0]), float(origin[1])), (latitude, longitude))
    for (k, pgn), here in zip(found, degrees, strict=True):
        if np.all(np.abs(here) < [90.0, 180.0]):
            out[k] = replace(given[k], data=_with_degrees(pgn, *move(here[0], here[1])))
    for pieces, payload in _fast(given):
        at = [int.from_bytes(payload[b : b + 8], "little", signed=True) * 1e-16 for b in (7, 15)]
        if abs(at[0]) < 90.0 and abs(at[1]) < 180.0:
            words = (round(word * 1e16).to_bytes(8, "little", signed=True) for word in move(*at))
            payload = payload[:7] + b"".join(words) + payload[23:]
            for n, place in enumerate(pieces):
                piece = payload[:6] if n == 0 else payload[7 * n - 1 : 7 * n + 6]
                kept = 2 if n == 0 else 1
                data = given[place].data
                out[place] = replace(given[place], data=data[:kept] + piece + data[kept + len(piece) :])
    return out


def _pgn(frame: Frame) -> int:
    return can_id.split(frame.can_id).pgn


def _degrees(data: bytes, pgn: int) -> tuple[float, float]:
    _, offset, signed = SINGLE[pgn]
    words = (int.from_bytes(data[b : b + 4], "little", signed=signed) for b in (0, 4))
    latitude, longitude = (word * 1e-7 + offset for word in words)
    return latitude, longitude


def _with_degrees(pgn: int, latitude: float, longitude: float) -> bytes:
    _, offset, signed = SINGLE[pgn]
    words = (round((degrees - offset) * 1e7) for degrees in (latitude, longitude))
    return b"".join(word.to_bytes(4, "little", signed=signed) for word in words)


def _mover(
    origin: tuple[float, float], there: tuple[float, float]
) -> Callable[[float, float], tuple[float, float]]:
    planes = (f"+proj=aeqd +lat_0={at[0]} +lon_0={at[1]} +datum=WGS84" for at in (origin, there))
    of = [Transformer.from_crs("EPSG:4326", plane, always_xy=True) for plane in planes]

    def move(latitude: float, longitude: float) -> tuple[float, float]:
        east, north = of[0].transform(longitude, latitude)
        longitude, latitude = of[1].transform(east, north, direction="INVERSE")
        return latitude, longitude

    return move


def _fast(given: Sequence[Frame]) -> Iterator[tuple[list[int], bytes]]:
    """(frames, payload) of each whole fast-packet position."""
    open_: dict[tuple[str, int, int], tuple[list[int], bytes, int]] = {}
    for k, frame in enumerate(given):
        if not frame.extended or _pgn(frame) != FAST or len(frame.data) < 8:
            continue
        key, first = (frame.bus, frame.can_id, frame.data[0] >> 5), frame.data[0] & 31 == 0
        if first:
            open_[key] = [k], frame.data[2:], frame.data[1]
        elif key in open_:
            places, payload, length = open_.pop(key)
            if frame.data[0] & 31 == len(places):
                open_[key] = [*places, k], payload + frame.data[1:], length
        if key in open_ and len(open_[key][1]) >= open_[key][2]:
            places, payload, length = open_.pop(key)
            yield places, payload[:length]


def shifted(given: Sequence[Frame], by_ns: int) -> list[Frame]:
    """The same frames by a clock that is ahead."""
    return [replace(frame, t_ns=frame.t_ns + by_ns, rx_ns=frame.rx_ns + by_ns) for frame in given]


def reordered(given: Sequence[Frame], seed: int) -> list[Frame]:
    """The same frames; of two neighbours of different senders within NEAR_NS, every second pair changes
    places, and times stay where they are."""
    rng, out, k = generator(seed, 1), list(given), 0
    while k + 1 < len(out):
        a, b = out[k], out[k + 1]
        near = b.t_ns - a.t_ns < NEAR_NS and a.bus == b.bus
        if near and a.can_id & 0xFF != b.can_id & 0xFF and rng.random() < 0.5:
            out[k] = replace(b, t_ns=a.t_ns, rx_ns=a.rx_ns)
            out[k + 1] = replace(a, t_ns=b.t_ns, rx_ns=b.rx_ns)
            k += 1
        k += 1
    return out


def copy_of(given: Sequence[Frame], name: str) -> list[Frame]:
    if name.startswith("at "):
        return placed(given, *PLACES[name[3:]])
    if name == "shifted":
        return shifted(given, SHIFT_NS)
    return reordered(given, 1) if name == "reordered" else list(given)


# Drives.


def drive_named(name: str) -> tuple[Machine, list[Frame]]:
    kind, _, rest = name.partition(":")
    if kind == "fleet":
        rig, cell = drawn(int(rest)), cell_of(int(rest))
        asked, receivers = scenario(rig, cell), cell.manoeuvre.receivers
        driven = simulate(true_machine(rig, receivers), rig.seed, asked.seconds, asked)
        return parse_machine(owners_text(rig, receivers)), list(driven)
    if kind not in ("planar", "spatial"):
        return parse_machine(Path(rest).read_text(encoding="utf-8")), list(frames(Path(kind)))
    number, _, file = rest.partition(":")
    seed = int(number)
    source = spatial_logs.source_of(replace(spatial_logs.ROW["spatial_random"], seconds=SECONDS), seed)
    machine, asked = source.machine, source.scenario
    if file:
        machine = parse_machine(Path(file).read_text(encoding="utf-8"))
    if kind == "planar":
        ground = Ground(roll_sd_deg=0.7, force_sd=0.015)
        asked = replace(asked, plant="planar", ground=ground, spatial=Spatial())
    return machine, list(simulate(machine, seed, SECONDS, asked))


# Results.


@dataclass(frozen=True, slots=True)
class Fitted:
    """One of pem's fits."""

    begin_s: float  # of the window, since the drive's first frame
    length_s: float
    iterations: int
    refused: str
    mean: list[float]  # (6,)
    sd: list[float]


@dataclass(slots=True)
class Copy:
    """What a copy gave."""

    name: str
    logs: dict[str, list[float]]  # method -> (6,) as published at the end, nan without
    sds: dict[str, list[float]]
    statuses: dict[str, list[int]]
    inside: dict[str, list[float]]  # method -> (12,) logarithms and sds of its state, published or not
    fits: list[Fitted]
    first_s: float  # when pem first gave a number, nan if never
    reason: str
    took_s: float


def followed(machine: Machine, given: Sequence[Frame], name: str) -> tuple[Copy, list[pem.Job]]:
    """A copy through the fold, each fit made when it is due."""
    began, state, jobs, fits = time.perf_counter(), fold.initial(machine), [], []
    last: dict[str, Estimate] = {}
    first_s, first_ns = math.nan, given[0].t_ns

    def take(publications: Sequence[Any]) -> None:
        nonlocal first_s
        for publication in publications:
            if isinstance(publication.value, Estimate):
                last[publication.value.method] = publication.value
        told = last["pem"].parameters if "pem" in last else ()
        if math.isnan(first_s) and any(p.status is Status.ESTIMATED for p in told):
            first_s = (last["pem"].t_ns - first_ns) * 1e-9

    def request(t_ns: int) -> None:
        for method, job in fold.request_fits(state, t_ns):
            if method == "pem":
                jobs.append(job)

    def adopt(t_ns: int) -> None:
        before = state.estimators["pem"].last
        take(fitted_at_once(state, t_ns))
        made = state.estimators["pem"].last
        if made is not before and made is not None:
            fits.append(_fitted(jobs[-1], made, first_ns))

    for frame in given:
        adopt(frame.t_ns)
        take(fold.step(state, frame))
        request(frame.t_ns)
    end_ns = given[-1].t_ns
    adopt(end_ns + END_NS)
    fold.finish(state)
    request(end_ns)
    adopt(end_ns + END_NS)
    last = dict(fold.estimates_now(state))
    made = {m: numbers(e) for m, e in last.items() if m in METHODS}
    inside = {}
    for method in ("pem", "tracker"):
        of = state.estimators[method]
        inside[method] = [*of.mean[SIX].tolist(), *np.sqrt(np.diag(of.covariance)[SIX]).tolist()]
    return Copy(
        name,
        {m: x[:6] for m, x in made.items()}, {m: x[6:] for m, x in made.items()},
        {m: [int(p.status) for p in last[m].parameters] for m in made},
        inside, fits, first_s, str(last["recommended"].parameters[0].reason), time.perf_counter() - began,
    ), jobs  # fmt: skip


def _fitted(job: pem.Job, made: pem.Fit, first_ns: int) -> Fitted:
    return Fitted(
        (job.record.t_ns - first_ns) * 1e-9, len(job.record.ticks) * 0.02, made.iterations,
        str(made.refused or ""), made.mean[SIX].tolist(), np.sqrt(np.diag(made.covariance)[SIX]).tolist(),
    )  # fmt: skip


def deviations(logs: Array, sds: Array) -> Array:
    """(k, 6) logarithms and sds of copies: each from the median of the others, in the median of the sds."""
    out = np.full(logs.shape, np.nan)
    for k in range(len(logs)):
        others = np.delete(logs, k, axis=0)
        with np.errstate(all="ignore"):
            good = np.sum(np.isfinite(others), axis=0) > 0
            middle = np.where(good, np.nanmedian(np.where(good, others, 0.0), axis=0), np.nan)
            out[k] = (logs[k] - middle) / np.nanmedian(np.where(np.isfinite(sds), sds, np.nan), axis=0)
    return out


# The same windows, with noise of a rounding.


def same_windows(machine: Machine, jobs: Sequence[pem.Job], seed: int) -> list[pem.Fit]:
    """pem's fits of these jobs' windows, with positions that are rounded otherwise."""
    rng, made = generator(seed, 2), []
    for job in jobs:
        rows = job.record.rows.copy()
        which = np.isin(rows[:, KIND], (NORTH, EAST)) if seed else np.zeros(len(rows), bool)
        rows[which, VALUE] += ROUNDING_M * rng.uniform(-0.5, 0.5, int(which.sum()))
        made.append(pem.fit(machine, replace(job, record=Record(job.record.t_ns, job.record.ticks, rows))))
    return made


def from_points(machine: Machine, jobs: Sequence[pem.Job], count: int) -> list[list[Posterior]]:
    """Of each window, the ends of searches from so many points."""
    made, setup = list[list[Posterior]](), rig_setup(machine)
    for job in jobs:
        known = pem.with_known_masses(job.covariance)
        sds, ends = np.sqrt(np.diag(known)), list[Posterior]()
        for seed in range(count):
            start = job.mean.copy()
            start[SIX] += min(seed, 1) * generator(seed, 3).standard_normal(6) * sds[SIX]
            ends.append(maximise_posterior(job.record, setup, job.mean, known, start=start))
        made.append(ends)
    return made


# What is printed.


@dataclass(frozen=True, slots=True)
class Summary:
    """How far copies are apart."""

    within: float  # share of the numbers within SPREAD_SD
    furthest: float  # sd
    numbers: int
    statuses: int  # of six parameters, which have not the same status in all copies


def summary_of(logs: Array, sds: Array, statuses: NDArray[np.int64] | None = None) -> Summary:
    off = np.abs(deviations(logs, sds))
    off = off[np.isfinite(off)]
    differ = 0 if statuses is None else int(np.sum(np.ptp(statuses, axis=0) > 0))
    within, furthest = (float(np.mean(off <= SPREAD_SD)), float(off.max())) if len(off) else (1.0, 0.0)
    return Summary(within, furthest, len(off), differ)


def tell(drive: str, copies: Sequence[Copy], again: Sequence[Sequence[pem.Fit]]) -> dict[str, Summary]:
    """Prints what a drive's copies gave; returns the summaries."""
    made: dict[str, Summary] = {}
    print(f"\n{drive}")
    for copy in copies:
        fits = "; ".join(
            f"{f.begin_s:.1f}+{f.length_s:.0f} s {f.iterations} steps{' ' + f.refused if f.refused else ''}"
            for f in copy.fits
        )
        print(f"  {copy.name:10s} first {copy.first_s:5.1f} s, {copy.took_s:.0f} s; {fits}; {copy.reason}")
    for method in METHODS:
        logs, sds = (np.array([getattr(c, name)[method] for c in copies]) for name in ("logs", "sds"))
        made[method] = summary_of(logs, sds, np.array([c.statuses[method] for c in copies]))
        _tell(method, made[method], deviations(logs, sds))
    for method in ("pem", "tracker"):
        both = np.array([c.inside[method] for c in copies])
        name = f"{method}, inside"
        made[name] = summary_of(both[:, :6], both[:, 6:])
        _tell(name, made[name], deviations(both[:, :6], both[:, 6:]))
    for k in range(len(again[0]) if again else 0):
        logs = np.array([fits[k].mean[SIX] for fits in again])
        sds = np.array([np.sqrt(np.diag(fits[k].covariance)[SIX]) for fits in again])
        name = f"window {k}, same windows"
        made[name] = summary_of(logs, sds)
        _tell(name, made[name], deviations(logs, sds))
        print(f"{'':22s}{[f'{f[k].iterations} {f[k].refused or chr(32)}'.strip() for f in again]}")
    return made


def _tell(name: str, found: Summary, off: Array) -> None:
    worst = np.nanmax(np.abs(np.nan_to_num(off)), axis=0)
    each = " ".join(f"{PARAMETERS[k]} {worst[k]:.2f}" for k in range(6))
    differ = f", {found.statuses} differ in status" if found.statuses else ""
    differ += f", along {flat_direction(off)}" if found.furthest > SPREAD_SD else ""
    share = f"{found.within:4.0%} within {SPREAD_SD}"
    print(f"  {name:24s} {share}, furthest {found.furthest:.2f} sd ({each}){differ}")


def tell_points(ends: Sequence[Sequence[Posterior]]) -> Summary:
    """Prints where searches from several points have ended; of all windows, those that say they are two
    apart."""
    off = list[float]()
    for k, window in enumerate(ends):
        if any(one.two_places for one in window):
            print(f"  window {k}: says that there are two places")
            continue
        good = [one for one in window if one.converged]
        logs = np.array([one.mean[SIX] for one in good]).reshape(-1, 6)
        sds = np.array([np.sqrt(np.diag(one.covariance)[SIX]) for one in good]).reshape(-1, 6)
        if len(good) < len(window):
            print(f"  window {k}: {len(window) - len(good)} of {len(window)} searches did not converge")
        if len(good) > 1:
            made = deviations(logs, sds)
            off += np.abs(made[np.isfinite(made)]).tolist()
            _tell(f"window {k}, from points", summary_of(logs, sds), made)
    within = float(np.mean(np.array(off) <= SPREAD_SD)) if off else 1.0
    return Summary(within, max(off, default=0.0), len(off), 0)


def flat_direction(off: Array) -> str:
    """Along which direction of the six, in sds, copies differ most; off: (k, 6) as `deviations`."""
    direction = np.linalg.svd(np.nan_to_num(off))[2][0]
    return " ".join(f"{w:+.1f} {p}" for w, p in zip(direction, PARAMETERS, strict=True) if abs(w) > 0.2)


def main(words: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description="copies of one drive that mean the same")
    parser.add_argument("drives", nargs="*", default=["planar:1", "spatial:1"], metavar="DRIVE")
    parser.add_argument("--copies", default=",".join(USUAL), help="separated by commas (%(default)s)")
    parser.add_argument("--again", type=int, default=5, help="fits of the same windows (%(default)s)")
    parser.add_argument("--starts", type=int, default=0, help="points from which windows are fitted")
    parser.add_argument("--out", type=Path, help="a line of JSON for each drive")
    args = parser.parse_args(words)
    found: list[dict[str, Summary]] = []
    starts: list[Summary] = []
    for drive in args.drives:
        machine, given = drive_named(drive)
        copies, first_jobs = [], list[pem.Job]()
        for name in args.copies.split(","):
            copy, jobs = followed(machine, copy_of(given, name), name)
            copies.append(copy)
            first_jobs = first_jobs or jobs
        again = [same_windows(machine, first_jobs, seed) for seed in range(args.again)]
        found.append(tell(drive, copies, again))
        if args.starts > 1:
            starts.append(tell_points(from_points(machine, first_jobs, args.starts)))
        sys.stdout.flush()
        if args.out:
            with args.out.open("a", encoding="utf-8") as out:
                json.dump({"drive": drive, "copies": [asdict(copy) for copy in copies]}, out)
                out.write("\n")
    print("\nall drives")
    for name in (*METHODS, "pem, inside", "tracker, inside"):
        _total(name, [made[name] for made in found])
    _total("from points", starts)
    _total("same windows", [s for made in found for n, s in made.items() if n.endswith("same windows")])


def _total(name: str, found: Sequence[Summary]) -> None:
    count = sum(s.numbers for s in found)
    within = sum(s.within * s.numbers for s in found) / max(count, 1)
    furthest, differ = max((s.furthest for s in found), default=0.0), sum(s.statuses for s in found)
    share = f"{within:4.0%} of {count} within {SPREAD_SD}"
    print(f"  {name:24s} {share}, furthest {furthest:.2f} sd, {differ} statuses")


if __name__ == "__main__":
    main()
