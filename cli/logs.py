"""`tilth logs`: list the runs in a log folder, mark those to be kept, add notes."""

import argparse
import json
import sys
from collections import Counter
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from tilth.cli import WrongUse
from tilth.cli.offload import chosen
from tilth.logger.clock import utc_text
from tilth.logger.recovery import unfinished
from tilth.logger.runs import Beside, StoredRun
from tilth.replay.survey import glance
from tilth.schemas.invocation import command

COLUMNS = ("run", "began (UTC)", "length", "MB", "frames", "sensors", "faults and events", "state")


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
    busy = set(unfinished(args.folder)) if args.folder.is_dir() else set()
    rows = [_row(one, busy) for one in chosen(args.folder, names or None)]
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


def _row(one: StoredRun, unfinished_files: set[Path]) -> dict[str, Any]:
    beside = _beside(one)
    told = [found for path in one.files if (found := glance(path)) is not None]
    events: Counter[str] = sum((each.events for each in told), Counter())
    worst = min(told, key=lambda each: each.alive - each.sensors, default=None)
    copied = sum(path.name in beside.copied for path in one.files)
    first = told[0].first_ns + told[-1].utc_minus_ns if told else one.started_ns
    return {
        "run": one.name,
        "began": utc_text(first) if first else "",
        "seconds": sum((each.last_ns - each.first_ns) * 1e-9 for each in told),
        "bytes": sum(path.stat().st_size for path in one.files),
        "files": len(one.files),
        "frames": sum(each.frames for each in told),
        "alive": worst.alive if worst else 0,
        "sensors": worst.sensors if worst else 0,
        "lost": list(worst.lost) if worst else [],
        "events": dict(events),
        "unfinished": sum(path in unfinished_files for path in one.files),
        "recording": len(one.files) - len(told) > sum(path in unfinished_files for path in one.files),
        "copied": copied,
        "keep": beside.keep,
        "notes": [*({each.note for each in told} - {""}), *beside.notes],
    }


def _cells(row: dict[str, Any]) -> list[str]:
    minutes, seconds = divmod(round(row["seconds"]), 60)
    what = [f"{', '.join(row['lost'])} lost"] if row["lost"] else []
    what += [f"{kind} {count}" for kind, count in sorted(row["events"].items())]
    state = ["recording"] * row["recording"] + [f"unfinished: {command('recover')}"] * bool(row["unfinished"])
    copied = "copied" if row["copied"] == row["files"] else f"{row['copied']} of {row['files']} copied"
    state += ([copied] if row["copied"] else []) + ["keep"] * row["keep"] + [f'"{n}"' for n in row["notes"]]
    return [
        row["run"], row["began"], f"{minutes // 60}:{minutes % 60:02d}:{seconds:02d}",
        f"{row['bytes'] / 1e6:.1f}", str(row["frames"]), f"{row['alive']}/{row['sensors']}",
        ", ".join(what), ", ".join(state),
    ]  # fmt: skip
