"""`tilth logs`: list the runs in a log folder, mark those to be kept, add notes."""

import argparse
import json
import sys
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

from rich.console import Console
from rich.table import Table

from tilth.cli import WrongUse, say
from tilth.cli.offload import chosen
from tilth.logger.clock import DATED_NS, utc_text
from tilth.logger.log.mcap_log import SIMULATED
from tilth.logger.log.runs import Sidecar, StoredRun
from tilth.replay.glance import FileState, Glance, glance
from tilth.schemas.invocation import command
from tilth.schemas.readable import reason_of
from tilth.schemas.states import DeviceState

_say = partial(say, "logs")

COLUMNS = ("run", "began (UTC)", "length", "MB", "frames", "sensors", "faults and events", "state")

NOT_ALIVE = (
    (DeviceState.LOST, "lost"),
    (DeviceState.NO_DATA, "without data"),
    (DeviceState.WAITING, "never heard"),
)


def add(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = subparsers.add_parser(
        "logs",
        help="list the runs in a log folder, mark those to be kept, add notes",
        description="List the runs in a log folder with length, size, sensors alive at the end, and faults.",
    )
    parser.add_argument("folder", nargs="?", type=Path, default=Path("logs"), metavar="DIR", help="(logs)")
    parser.add_argument("--keep", metavar="RUN", help="mark a run, so that it is never deleted to make room")
    parser.add_argument("--release", metavar="RUN", help="remove that mark")
    parser.add_argument("--note", nargs=2, metavar=("RUN", "TEXT"), help="add a note to a run")
    parser.add_argument("--json", action="store_true", help="for programs")


def run(args: argparse.Namespace) -> int:
    changes: list[tuple[str | None, bool | None, str | None]] = []
    changes += [(args.keep, True, None), (args.release, False, None)]
    if args.note:
        changes.append((args.note[0], None, args.note[1]))
    names, status = [name for name, _, _ in changes if name], 0
    for name, keep, text in changes:
        if name is None:
            continue
        (one,) = chosen(args.folder, [name])
        sidecar = _sidecar(one)
        sidecar.keep = sidecar.keep if keep is None else keep
        sidecar.notes += [text] if text else []
        try:
            one.write_sidecar(sidecar)
        except OSError as error:
            why = f"{args.folder}: {reason_of(error)}; it cannot be noted there"
            _say(why)
            status = 1
    rows = [row for one in chosen(args.folder, names or None) if (row := _row(one)) is not None]
    if args.json:
        print(json.dumps([asdict(row) for row in rows], indent=1, ensure_ascii=False))
        return status
    table = Table(*COLUMNS, box=None, pad_edge=False)
    for row in rows:
        table.add_row(*_cells(row))
    Console(file=sys.stdout, width=None if sys.stdout.isatty() else 200).print(table)
    return status


def _sidecar(one: StoredRun) -> Sidecar:
    try:
        return one.sidecar()
    except ValueError as error:
        raise WrongUse(str(error)) from None


@dataclass(frozen=True, slots=True)
class RunRow:
    """What is told of a run, by all its files; in the order of the JSON."""

    run: str
    began: str  # UTC
    began_known: bool
    seconds: float  # the same as duration_s, by its older name
    duration_s: float
    bytes: int
    files: int
    missing_parts: list[int]
    frames: int
    alive: int
    sensors: int
    sensor_states: dict[str, str]
    lost: list[str]
    events: dict[str, int]
    unfinished: int
    damaged: list[str]
    recording: bool
    no_log: list[str]
    unreadable: list[str]
    copied: int
    simulated: bool
    keep: bool
    notes: list[str]


def _row(one: StoredRun) -> RunRow | None:
    """None where its files have gone since they were listed."""
    glances, size, unreadable = _glances(one)
    try:
        sidecar = one.sidecar()
    except (ValueError, OSError) as error:
        sidecar = Sidecar()
        unreadable.append(str(error))
    if not (glances or unreadable):
        return None
    dated = [found for found in glances.values() if found.last_ns]
    events: Counter[str] = sum((found.events for found in glances.values()), Counter())
    sensors = next((found.sensors for found in reversed(dated) if found.frames and found.sensors), {})
    first_ns = dated[0].first_ns + dated[-1].utc_minus_ns if dated else one.started_ns
    duration_s = (dated[-1].last_ns - dated[0].first_ns) * 1e-9 if dated else 0.0
    return RunRow(
        run=one.name,
        began=utc_text(first_ns) if first_ns else "",
        began_known=first_ns >= DATED_NS,
        seconds=duration_s,
        duration_s=duration_s,
        bytes=size,
        files=len(glances),
        missing_parts=one.missing_parts,
        frames=sum(found.frames for found in glances.values()),
        alive=sum(state == DeviceState.ALIVE for state in sensors.values()),
        sensors=len(sensors),
        sensor_states=sensors,
        lost=[name for name, state in sensors.items() if state != DeviceState.ALIVE],
        events=dict(events),
        unfinished=len(_named(glances, FileState.UNFINISHED)),
        damaged=_named(glances, FileState.DAMAGED),
        recording=bool(_named(glances, FileState.BEING_WRITTEN)),
        no_log=_named(glances, FileState.NO_LOG),
        unreadable=unreadable,
        copied=sum(name in sidecar.copied for name in glances),
        simulated=any(found.simulated for found in glances.values()),
        keep=sidecar.keep,
        notes=[*dict.fromkeys(found.note for found in dated if found.note), *sidecar.notes],
    )


def _glances(one: StoredRun) -> tuple[dict[str, Glance], int, list[str]]:
    """A look at each file by its name, bytes of all, and why some cannot be read."""
    glances: dict[str, Glance] = {}
    size, unreadable = 0, list[str]()
    for path in one.files:
        try:
            size += path.stat().st_size
            glances[path.name] = glance(path)
        except FileNotFoundError:  # the recorder renames a run, or makes room, at any time
            continue
        except OSError as error:  # of one file; the others are told
            unreadable.append(f"{path.name}: {reason_of(error)}")
    return glances, size, unreadable


def _named(glances: Mapping[str, Glance], state: FileState) -> list[str]:
    return [name for name, found in glances.items() if found.state == state]


def _cells(row: RunRow) -> list[str]:
    minutes, seconds = divmod(round(row.duration_s), 60)
    what = [
        f"{', '.join(names)} {word}"
        for state, word in NOT_ALIVE
        if (names := [name for name, now in row.sensor_states.items() if now == state])
    ]
    what += [f"{kind} {count}" for kind, count in sorted(row.events.items())]
    return [
        row.run, row.began if row.began_known else "not known",
        f"{minutes // 60}:{minutes % 60:02d}:{seconds:02d}",
        f"{row.bytes / 1e6:.1f}", str(row.frames), f"{row.alive}/{row.sensors}",
        ", ".join(what), ", ".join(_state(row)),
    ]  # fmt: skip


def _state(row: RunRow) -> list[str]:
    missing = ", ".join(map(str, row.missing_parts))
    state = (
        [SIMULATED] * row.simulated
        + ["recording"] * row.recording
        + [f"unfinished: {command('recover')}"] * bool(row.unfinished)
    )
    state += [f"{name} is damaged: {command('verify')}" for name in row.damaged]
    state += [f"part {missing} missing"] if missing else []
    state += [f"{name} is no log of tilth" for name in row.no_log] + row.unreadable
    copied = "copied" if row.copied == row.files else f"{row.copied} of {row.files} copied"
    return state + [copied] * bool(row.copied) + ["keep"] * row.keep + [f'"{n}"' for n in row.notes]
