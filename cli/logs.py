"""`tilth logs`: list the runs in a log folder, mark those to be kept, add notes."""

import argparse
import json
import sys
from collections import Counter
from contextlib import suppress
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from tilth.cli import WrongUse
from tilth.cli.offload import chosen
from tilth.logger.clock import DATED_NS, utc_text
from tilth.logger.log.runs import Beside, StoredRun
from tilth.replay.glance import BEING_WRITTEN, NO_LOG, UNFINISHED, Glance, glance
from tilth.schemas.invocation import command

COLUMNS = ("run", "began (UTC)", "length", "MB", "frames", "sensors", "faults and events", "state")

NOT_ALIVE = (("lost", "lost"), ("no_data", "without data"), ("waiting", "never heard"))


def add(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = subparsers.add_parser(
        "logs",
        help="list the runs in a log folder, mark those to be kept, add notes",
        description="List the runs in a log folder with length, size, sensors alive at the end, and faults.",
    )
    parser.add_argument("folder", nargs="?", type=Path, default=Path("logs"), metavar="DIR", help="(logs)")
    parser.add_argument("--keep", metavar="RUN", help="mark it: it is never deleted to make room")
    parser.add_argument("--release", metavar="RUN", help="take that mark away")
    parser.add_argument("--note", nargs=2, metavar=("RUN", "TEXT"), help="add what you know of it")
    parser.add_argument("--json", action="store_true", help="for programs")


def run(args: argparse.Namespace) -> int:
    changes: list[tuple[str | None, bool | None, str | None]] = []
    changes += [(args.keep, True, None), (args.release, False, None)]
    if args.note:
        changes.append((args.note[0], None, args.note[1]))
    names = [name for name, _, _ in changes if name]
    for name, keep, text in changes:
        if name is None:
            continue
        (one,) = chosen(args.folder, [name])
        beside = _beside(one)
        beside.keep = beside.keep if keep is None else keep
        beside.notes += [text] if text else []
        one.note(beside)
    rows = [row for one in chosen(args.folder, names or None) if (row := _row(one)) is not None]
    if args.json:
        print(json.dumps(rows, indent=1, ensure_ascii=False))
        return 0
    table = Table(*COLUMNS, box=None, pad_edge=False)
    for row in rows:
        table.add_row(*_cells(row))
    Console(file=sys.stdout, width=None if sys.stdout.isatty() else 200).print(table)
    return 0


def _beside(one: StoredRun) -> Beside:
    try:
        return one.beside()
    except ValueError as error:
        raise WrongUse(str(error)) from None


def _row(one: StoredRun) -> dict[str, Any] | None:
    """What is told of a run, by all its files; None where they have gone since they were listed."""
    beside = _beside(one)
    told: dict[str, Glance] = {}
    size = 0
    for path in one.files:
        with suppress(FileNotFoundError):  # the recorder renames a run, or makes room, at any time
            size += path.stat().st_size
            told[path.name] = glance(path)
    if not told:
        return None
    seen = [found for found in told.values() if found.last_ns]
    states = Counter(found.state for found in told.values())
    events: Counter[str] = sum((found.events for found in told.values()), Counter())
    sensors = next((found.sensors for found in reversed(seen) if found.frames and found.sensors), {})
    first_ns = seen[0].first_ns + seen[-1].utc_minus_ns if seen else one.started_ns
    duration_s = (seen[-1].last_ns - seen[0].first_ns) * 1e-9 if seen else 0.0
    return {
        "run": one.name,
        "began": utc_text(first_ns) if first_ns else "",
        "began_known": first_ns >= DATED_NS,
        "seconds": duration_s,  # the same, by its older name
        "duration_s": duration_s,
        "bytes": size,
        "files": len(told),
        "missing_parts": one.missing_parts,
        "frames": sum(found.frames for found in told.values()),
        "alive": sum(state == "alive" for state in sensors.values()),
        "sensors": len(sensors),
        "sensor_states": sensors,
        "lost": [name for name, state in sensors.items() if state != "alive"],
        "events": dict(events),
        "unfinished": states[UNFINISHED],
        "recording": states[BEING_WRITTEN] > 0,
        "no_log": [name for name, found in told.items() if found.state == NO_LOG],
        "copied": sum(name in beside.copied for name in told),
        "keep": beside.keep,
        "notes": [*dict.fromkeys(found.note for found in seen if found.note), *beside.notes],
    }


def _cells(row: dict[str, Any]) -> list[str]:
    minutes, seconds = divmod(round(row["duration_s"]), 60)
    what = [
        f"{', '.join(names)} {word}"
        for state, word in NOT_ALIVE
        if (names := [name for name, now in row["sensor_states"].items() if now == state])
    ]
    what += [f"{kind} {count}" for kind, count in sorted(row["events"].items())]
    return [
        row["run"], row["began"] if row["began_known"] else "not known",
        f"{minutes // 60}:{minutes % 60:02d}:{seconds:02d}",
        f"{row['bytes'] / 1e6:.1f}", str(row["frames"]), f"{row['alive']}/{row['sensors']}",
        ", ".join(what), ", ".join(_state(row)),
    ]  # fmt: skip


def _state(row: dict[str, Any]) -> list[str]:
    missing = ", ".join(map(str, row["missing_parts"]))
    state = ["recording"] * row["recording"] + [f"unfinished: {command('recover')}"] * bool(row["unfinished"])
    state += [f"part {missing} missing"] if missing else []
    state += [f"{name} is {NO_LOG}" for name in row["no_log"]]
    copied = "copied" if row["copied"] == row["files"] else f"{row['copied']} of {row['files']} copied"
    return state + [copied] * bool(row["copied"]) + ["keep"] * row["keep"] + [f'"{n}"' for n in row["notes"]]
