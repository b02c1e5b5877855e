"""`tilth check`: what is wrong before a run."""

import argparse
import json
from dataclasses import asdict
from pathlib import Path

from tilth.cli import duration
from tilth.logger.machine_file import read_machine
from tilth.schemas.rule_of_thumb import DRAWING


def add(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = subparsers.add_parser(
        "check",
        help="check everything before a run",
        description="Check configuration, buses, disk, clock and Zenoh before a run.",
    )
    parser.add_argument("machine", type=Path, metavar="MACHINE.toml")
    parser.add_argument("--json", action="store_true", help="one JSON object on stdout")
    parser.add_argument(
        "--seconds", type=duration, default=2.0, metavar="N", help="how long to listen to the buses (2)"
    )
    parser.add_argument(
        "--log", type=Path, metavar="DIR", help="log folder, instead of the one in the machine file"
    )


def run(args: argparse.Namespace) -> int:
    """1 where there is a problem."""
    machine = read_machine(args.machine).machine
    from tilth.logger.can.bus_opening import check_interfaces

    check_interfaces(machine)
    if not args.json:
        print(DRAWING, flush=True)
    from tilth.logger.checks.check import check  # with the estimators, which take a second
    from tilth.logger.checks.finding import Level

    findings = check(machine, args.log or Path(machine.log.folder), args.seconds)
    fine = all(finding.state is not Level.PROBLEM for finding in findings)
    if args.json:
        print(json.dumps({"ok": fine, "checks": [asdict(finding) for finding in findings]}))
    else:
        for finding in findings:
            print(f"{finding.state.upper():8} {finding.what}: {finding.text}")
    return 0 if fine else 1
