"""How soon the watch names what has been moved during field work, and how often it is wrong when nothing was.

    python bench/watch.py moved [--seeds 0-39] [--row fleet_field] [--faults 2] [--keep DONE.jsonl]
    python bench/watch.py still [--seeds 0-39] [--row fleet_field] [--keep DONE.jsonl]

Uses the fields of bench/spatial_logs.py, of both plants and of the virtual fleet, or one of them. moved: in
each log one thing at a time is moved by editing frames from the sixth minute on: a receiver by 10 cm forward
or to the right, a pair by 1 degree (its front receiver to the side), the wheels' sensor by 1 degree. Prints
how long it takes to the event, and how often the event names it. still: the same logs as they are, and after
each spatial field the other rows of the same rig: slope, rough and flat ground, other soil, other speeds.
Prints hours, false events, and the limit below which their rate is with 95 %.
--keep: what is done is kept there, a line each, and not done again.
"""

import argparse
import itertools
import json
import math
import os
import struct
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import spatial_logs
from scipy.stats import chi2
from spatial_logs import CACHE, ROW, Run, seeds_of

from tilth.estimator import fold
from tilth.estimator.diagnosis import watch
from tilth.estimator.rig.numbers import PAIRS, WHEEL
from tilth.replay.readers.any_log import frames
from tilth.schemas.flow import Event, EventKind, Frame, Mount, Pose
from tilth.schemas.machine import Machine
from tilth.schemas.machine_toml import parse_machine
from tilth.schemas.sentences import event_sentence

FIELDS: Final = ("spatial_field", "planar_field", "fleet_field")
MORE: Final = tuple(f"spatial_{name}" for name in ("slope", "3cm", "soil", "flat", "3ms", "random"))
AT_S: Final = 360.0  # when it happens
SIZE: Final = 0.1  # m
ANGLE: Final = math.radians(1.0)
LIMIT_S: Final = 600.0  # within which it is to be found
EQUATOR, SQUARED = 6378137.0, 0.00669438  # of WGS 84: radius, m, and eccentricity squared
POSITIONS: Final = {65267: "<II", 129025: "<ii"}  # PGN -> latitude and longitude, 1e-7 degrees
CLAIM: Final = 60928
POSE_S: Final = 0.2
PAUSE_NS: Final = 1_000_000_000  # between logs that are driven one after the other


class Fault(NamedTuple):
    """What is moved. names: any of which the event may begin with."""

    title: str
    names: tuple[str, ...]
    shifts: dict[str, tuple[float, float]]  # mount -> forward, right, m
    slip: float = 0.0  # of the wheels' sensor, rad


def faults(machine: Machine, sign: float) -> list[Fault]:
    """All of them. sign: 1 or -1."""
    found = []
    for receiver in machine.receiver:
        mount, pair = receiver.mount.value, f"pair_{receiver.mount.body}"
        found.append(Fault("receiver 10 cm forward", (mount,), {mount: (sign * SIZE, 0.0)}))
        found.append(Fault("receiver 10 cm to the right", (mount, pair), {mount: (0.0, sign * SIZE)}))
    place = {receiver.mount: receiver.position[0] for receiver in machine.receiver}
    for front, pair in zip((Mount.TRACTOR_FRONT, Mount.IMPLEMENT_FRONT), PAIRS, strict=True):
        span = place[front] - place[Mount(front.value.replace("front", "rear"))]
        shift = {front.value: (0.0, sign * ANGLE * span)}
        found.append(Fault("pair 1 degree", (front.value, pair), shift))
    found.append(Fault("wheels' sensor 1 degree", (WHEEL,), {}, sign * ANGLE))
    return found


def edited(run: Run, machine: Machine, fault: Fault) -> Iterator[Frame]:
    """The frames of a run, with the fault from AT_S on."""
    arrays = spatial_logs.truth_arrays(run.folder)
    named = {receiver.name: receiver.mount.value for receiver in machine.receiver}
    mounts: dict[int, str] = {}  # by source address
    for frame in frames(run.log):
        pgn, source = frame.can_id >> 8 & 0x3FFFF, frame.can_id & 0xFF
        late = run.seconds_of(frame.t_ns) >= AT_S
        if pgn & 0x3FF00 == CLAIM:
            mounts[source] = named.get(int.from_bytes(frame.data, "little"), "")
        elif late and fault.slip and frame.can_id == machine.wheel_angle.id:
            frame = replace(frame, data=slipped(frame.data, machine, fault.slip))
        elif late and pgn in POSITIONS and (shift := fault.shifts.get(mounts.get(source, ""))):
            column = 3 if mounts[source].startswith("implement") else 2
            heading = np.interp(run.seconds_of(frame.t_ns), arrays["time"], arrays["states"][:, column])
            data = moved(frame.data, POSITIONS[pgn], shift, float(heading), run.described["origin_deg"][0])
            frame = replace(frame, data=data)
        yield frame


def slipped(data: bytes, machine: Machine, angle: float) -> bytes:
    """A wheel-angle frame that says an angle more."""
    raw = int.from_bytes(data[:2], "big", signed=True)
    if raw == machine.wheel_angle.not_available:
        return data
    steps = round(math.degrees(angle) / machine.wheel_angle.scale)
    return (raw + steps).to_bytes(2, "big", signed=True) + data[2:]


def moved(data: bytes, layout: str, shift: tuple[float, float], heading: float, latitude_deg: float) -> bytes:
    """A position frame of a receiver that is elsewhere. shift: forward, right, m, of a body at `heading`."""
    north = shift[0] * math.cos(heading) - shift[1] * math.sin(heading)
    east = shift[0] * math.sin(heading) + shift[1] * math.cos(heading)
    across = 1.0 - SQUARED * math.sin(math.radians(latitude_deg)) ** 2
    per_latitude = math.radians(1e-7) * EQUATOR * (1.0 - SQUARED) / across**1.5
    per_longitude = math.radians(1e-7) * EQUATOR / math.sqrt(across) * math.cos(math.radians(latitude_deg))
    steps = round(north / per_latitude), round(east / per_longitude)
    return struct.pack(
        layout, *(old + new for old, new in zip(struct.unpack(layout, data), steps, strict=True))
    )


def one_after_the_other(runs: Iterable[Run]) -> Iterator[Frame]:
    """The frames of several runs, as of one."""
    shift_ns, end_ns = 0, 0
    for run in runs:
        for k, frame in enumerate(frames(run.log)):
            if k == 0 and end_ns:
                shift_ns = end_ns + PAUSE_NS - frame.t_ns
            end_ns = frame.t_ns + shift_ns
            yield replace(frame, t_ns=end_ns, rx_ns=frame.rx_ns + shift_ns)


class Watched(NamedTuple):
    """What came of some frames."""

    events: list[tuple[int, tuple[str, ...], str]]  # t_ns, names, text
    watched_s: float  # from when on there is enough to compare with
    tick_us: float  # processor time of the watch per tick of 20 ms


def watch_over(machine: Machine, given: Iterable[Frame]) -> Watched:
    """The fold without its estimators, which the watch does not need."""
    state = fold.initial(machine)
    state.ready = False
    events, poses, watched, spent = [], 0, 0, 0.0
    observe = watch.observe

    def timed(*args: Any) -> Any:
        nonlocal spent
        began = time.process_time()
        found = observe(*args)
        spent += time.process_time() - began
        return found

    setattr(watch, "observe", timed)  # noqa: B010 - to know what it costs, no more
    try:
        for frame in given:
            for publication in fold.step(state, frame):
                value = publication.value
                if isinstance(value, Pose):
                    poses += 1
                    blocks = state.diagnosis.watch.old_blocks + len(state.diagnosis.watch.blocks)
                    watched += blocks >= watch.WATCH.least_before + watch.WATCH.since[0]
                elif (
                    isinstance(value, Event)
                    and value.kind == EventKind.MOVED
                    and "accept it" in event_sentence(value)
                ):
                    moved = state.diagnosis.watch.moved
                    names = tuple(moved[-1].names) if moved else ()
                    events.append((value.t_ns, names, event_sentence(value)))
    finally:
        setattr(watch, "observe", observe)  # noqa: B010
    return Watched(events, watched * POSE_S, 1e5 * spent / max(poses, 1))


# Faults.


def with_a_fault(row: str, seed: int, number: int) -> tuple[str, str, float, bool, bool, float]:
    """(title, row, delay in s or infinite, named, false alarm before it, us per tick)."""
    run = spatial_logs.read_run(CACHE, row, seed)
    machine = parse_machine(run.machine_text)
    fault = faults(machine, 1.0 if seed // 2 % 2 == 0 else -1.0)[number]
    heard = watch_over(machine, edited(run, machine, fault))
    early = [event for event in heard.events if run.seconds_of(event[0]) < AT_S]
    later = [event for event in heard.events if run.seconds_of(event[0]) >= AT_S]
    if not later:
        return fault.title, row, math.inf, False, bool(early), heard.tick_us
    t_ns, names, _ = later[0]
    right = bool(set(fault.names) & set(names))
    return fault.title, row, run.seconds_of(t_ns) - AT_S, right, bool(early), heard.tick_us


def print_moved(results: list[tuple[str, str, float, bool, bool, float]]) -> None:
    for title in dict.fromkeys(result[0] for result in results):
        for row in FIELDS:
            own = [result for result in results if (result[0], result[1]) == (title, row)]
            if not own:
                continue
            delays = np.array([result[2] for result in own])
            found = delays[np.isfinite(delays)]
            late, wrong = int(np.sum(delays > LIMIT_S)), sum(not result[3] for result in own)
            middle, most = (np.median(found), found.max()) if len(found) else (np.nan, np.nan)
            print(
                f"{title:28} {row:14} {len(own):3} runs: median {middle:4.0f} s, largest {most:4.0f} s, "
                f"missed or after 10 min {late}, not named {wrong}"
            )
    early = sum(result[4] for result in results)
    cost = np.median([result[5] for result in results])
    print(f"events before anything was moved: {early}; processor time {cost:.0f} us per tick of 20 ms")


# Nothing moved.


def without(row: str, seed: int) -> tuple[str, float, float, list[str]]:
    """(row, hours watched, hours driven, texts of events)."""
    names = (row, *MORE) if row == "spatial_field" else (row,)
    runs = [spatial_logs.read_run(CACHE, name, seed) for name in names]
    driven_s = sum(ROW[name].seconds for name in names)
    heard = watch_over(parse_machine(runs[0].machine_text), one_after_the_other(runs))
    return row, heard.watched_s / 3600.0, driven_s / 3600.0, [text for _, _, text in heard.events]


def print_still(results: list[tuple[str, float, float, list[str]]]) -> None:
    total_hours, count = 0.0, 0
    for row in FIELDS:
        own = [result for result in results if result[0] == row]
        texts = [text for result in own for text in result[3]]
        hours, driven = sum(result[1] for result in own), sum(result[2] for result in own)
        print(f"{row} {len(own)} rigs, {driven:.1f} h driven, {hours:.1f} h watched: {len(texts)} events")
        print("".join(f"    {text}\n" for text in texts), end="")
        total_hours, count = total_hours + hours, count + len(texts)
    if total_hours:
        limit = chi2.ppf(0.95, 2 * (count + 1)) / 2 / total_hours
        print(f"{count} false in {total_hours:.1f} h: with 95 % fewer than one in {1 / limit:.1f} h")


def done(
    keep: Path | None, processes: int, work: Callable[..., Any], jobs: list[tuple[Any, ...]]
) -> list[Any]:
    """The results of all jobs: those that are kept, and the others, which are kept too."""
    kept: dict[str, object] = {}
    if keep is not None and keep.exists():
        kept = dict(json.loads(line) for line in keep.read_text(encoding="utf-8").splitlines())
    names = {json.dumps([work.__name__, *job]): job for job in jobs}
    with ProcessPoolExecutor(processes, get_context("spawn")) as pool:
        waiting = {pool.submit(work, *job): name for name, job in names.items() if name not in kept}
        for future in as_completed(waiting):
            kept[waiting[future]] = future.result()
            if keep is not None:
                with keep.open("a", encoding="utf-8") as stream:
                    stream.write(json.dumps([waiting[future], future.result()]) + "\n")
    return [kept[name] for name in names]


def main() -> None:
    parser = argparse.ArgumentParser(description="How soon the watch names what has been moved.")
    parser.add_argument("what", choices=("moved", "still"))
    parser.add_argument("--seeds", type=seeds_of, default=range(40), help="of each row, as 0-7")
    parser.add_argument("--row", choices=FIELDS, action="append", help="only these")
    parser.add_argument("--faults", type=int, default=2, help="of each log, in turn")
    parser.add_argument("--keep", type=Path, help="file of what is done")
    parser.add_argument("--processes", type=int, default=1)
    args = parser.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    each: list[tuple[Any, ...]] = [
        (row, seed) for seed, row in itertools.product(args.seeds, args.row or FIELDS)
    ]
    if args.what == "still":
        print_still(done(args.keep, args.processes, without, each))
        return
    first = spatial_logs.read_run(CACHE, *each[0])
    count = len(faults(parse_machine(first.machine_text), 1.0))
    jobs: list[tuple[Any, ...]] = [
        (row, seed, (args.faults * seed + k + 5 * FIELDS.index(row)) % count)
        for (row, seed), k in itertools.product(each, range(args.faults))
    ]
    print_moved(done(args.keep, args.processes, with_a_fault, jobs))


if __name__ == "__main__":
    main()
