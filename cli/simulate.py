"""`tilth simulate`: a scenario driven by the virtual tractor, its frames as a log, the truth beside it, or in
real time on a bus."""

import argparse
import json
import math
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path

from rich.console import Console

from tilth.cli import WrongUse, say, say_unusual
from tilth.cli.progress_bar import bars
from tilth.logger.can.lean_can import import_can
from tilth.logger.machine_file import read_machine
from tilth.schemas.invocation import command
from tilth.schemas.machine import Machine
from tilth.schemas.machine_toml import parse_machine
from tilth.schemas.readable import reason_of
from tilth.simulator.drive import drive
from tilth.simulator.fleet import drawn, scenario_of
from tilth.simulator.fleet_files import owners_text, true_machine
from tilth.simulator.packaged import packaged_file
from tilth.simulator.scenario import (
    CannotBeDriven,
    Scenario,
    ScenarioError,
    as_json,
    check_mounts,
    parse_scenario,
)
from tilth.simulator.simulate import WRITERS, Simulated, SimulationInput, files_of, simulate_to
from tilth.simulator.spatial.engine import NotInstalled, check_installed

_say = partial(say, "simulate")


def add(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = subparsers.add_parser(
        "simulate",
        help="drive a scenario: write its log and the true values, or send it on a bus",
        description="Drive a scenario file (examples/scenarios/ has some) on the simulator that it names, "
        "and write the frames that a recorder would have received; LOG.truth.json and LOG.truth.csv "
        "contain the true values. Or send them in real time on a bus without receivers; docs/buses.md "
        "says which.",
    )
    parser.add_argument("scenario", type=Path, metavar="SCENARIO.toml")
    where = parser.add_mutually_exclusive_group(required=True)
    where.add_argument("--out", type=Path, metavar="LOG", help="new file: .mcap, or .log for candump text")
    where.add_argument(
        "--bus",
        action="append",
        default=[],
        metavar="INTERFACE:CHANNEL[,key=value…]",
        help="send in real time on this bus, such as socketcan:vcan0; once for each bus of the machine file",
    )
    parser.add_argument("--send", action="store_true", help="send also on a bus outside this computer")
    parser.add_argument("--seed", type=int, metavar="N", help="choose another rig and drive (the file's)")
    parser.add_argument("--seconds", type=float, metavar="N", help="duration of the drive (the file's)")
    rigs = parser.add_mutually_exclusive_group()
    rigs.add_argument(
        "--machine", type=Path, metavar="M.toml", help="machine file (the scenario's, or the packaged one)"
    )
    rigs.add_argument(
        "--fleet",
        type=int,
        metavar="N",
        help="rig N of the virtual fleet; its machine file becomes LOG.machine.toml",
    )
    parser.add_argument(
        "--json", action="store_true", help="one JSON object to stdout, everything else to stderr"
    )


def run(args: argparse.Namespace) -> int:
    source = _source(args)
    if args.bus:
        return _on_buses(args, source)
    if args.send:
        raise WrongUse("--send is of --bus; a log is not sent")
    _check_out(args.out)
    beside = _fleet_file(args)
    say_unusual("simulate", source.machine)
    with ExitStack() as stack:
        steps = bars(stack)
        try:
            simulated = simulate_to(source, args.out, lambda what, at_s: steps(what, at_s, source.seconds))
            if beside is not None:
                with beside.open("x", encoding="utf-8") as stream:
                    stream.write(source.machine_text)
        except ValueError as error:
            raise _not_driven(args.scenario, error) from None
        except OSError as error:
            _say(f"{error.filename or args.out}: {reason_of(error)}")
            return 1
    _tell(source, simulated, args.json, beside)
    return 0


def _fleet_file(args: argparse.Namespace) -> Path | None:
    """Where the owner's machine file of a rig of the fleet goes. Raises WrongUse."""
    if args.fleet is None:
        return None
    path: Path = args.out.with_name(args.out.name + ".machine.toml")
    if path.exists():
        raise WrongUse(f"{path}: exists; a file is never overwritten, give another name")
    return path


def _on_buses(args: argparse.Namespace, source: SimulationInput) -> int:
    """1 where it was not sent, or not to its end."""
    import_can()  # before the others, which import it too
    from tilth.cli.discover import parse_buses
    from tilth.logger.can.bus_opening import check_interface
    from tilth.simulator.on_a_bus import CannotSend, send, stays_here

    given, names = parse_buses(args.bus), [bus.name for bus in source.machine.bus]
    if len(given) != len(names):
        raise WrongUse(f"--bus: {len(given)} given, the machine file has {len(names)}: {', '.join(names)}")
    for bus in given:
        check_interface(bus)
        if not (args.send or stays_here(bus)):
            raise WrongUse(
                f"--bus {bus.interface}:{bus.channel} leaves this computer; on a tractor's bus this would be "
                "taken for its receivers. Give --send if it is a bus of your own on a bench"
            )
    with ExitStack() as stack:
        steps = bars(stack)
        scenario = replace(source.scenario, clock_offset_s=0.0)
        try:
            truth = drive(
                source.rig, source.seed, source.seconds, scenario,
                progress=lambda at_s: steps("driving", at_s, source.seconds),
            )  # fmt: skip
        except ValueError as error:
            raise _not_driven(args.scenario, error) from None
    try:
        sent = send(source.rig, truth, dict(zip(names, given, strict=True)), _say)
    except CannotSend as error:
        _say(str(error))
        return 1
    if args.json:
        counts = {"seed": source.seed, "seconds": source.seconds, "frames": sent.frames, "late": sent.late}
        print(json.dumps({**counts, "stopped": sent.stopped, "parameters": truth.parameters}))
    _say(f"{sent.frames} frames sent" + (f", {sent.late} of them late" if sent.late else ""))
    if sent.stopped:
        _say(f"stopped: {sent.stopped}")
    return int(bool(sent.stopped))


def _not_driven(scenario: Path, error: ValueError) -> WrongUse:
    if isinstance(error, CannotBeDriven):
        return WrongUse(f"{scenario}: {error}")
    return WrongUse(f"this machine cannot be driven: {error}")


def _source(args: argparse.Namespace) -> SimulationInput:
    """What is asked for. Raises WrongUse, MachineError."""
    try:
        text = args.scenario.read_text(encoding="utf-8-sig")
        scenario = parse_scenario(text)
        machine, machine_text, driven = _machine(args, scenario)
        check_mounts(scenario, [receiver.mount for receiver in machine.receiver])
    except ScenarioError as error:
        raise WrongUse(f"{args.scenario}: {error}") from None
    except (OSError, UnicodeDecodeError) as error:
        reason = reason_of(error) if isinstance(error, OSError) else "not UTF-8 text"
        raise WrongUse(
            f"{args.scenario}: cannot be read ({reason}); give a scenario file, as in examples/scenarios"
        ) from None
    if scenario.plant == "spatial":
        try:
            check_installed()
        except NotInstalled as error:
            raise WrongUse(f"{args.scenario}: {error}") from None
    seed = scenario.seed if args.seed is None else args.seed
    seconds = scenario.seconds if args.seconds is None else args.seconds
    if seed < 0:
        raise WrongUse(f"--seed {seed}: give a whole number from 0 up")
    if not (math.isfinite(seconds) and 0 < seconds <= 86_400):
        raise WrongUse(f"--seconds {seconds:g}: give a number above zero, a day at most")
    if args.fleet is not None:
        scenario = scenario_of(drawn(args.fleet), scenario)
        text = as_json(scenario)
    return SimulationInput(machine, machine_text, scenario, text, seed, seconds, driven)


def _machine(args: argparse.Namespace, scenario: Scenario) -> tuple[Machine, str, Machine | None]:
    """The machine file and its text; and, where it errs, the machine as it is."""
    if args.fleet is not None:
        if args.fleet < 0:
            raise WrongUse(f"--fleet {args.fleet}: give a whole number from 0 up")
        rig = drawn(args.fleet)
        text = owners_text(rig)
        return parse_machine(text), text, true_machine(rig)
    named = args.machine or (scenario.machine and args.scenario.parent / scenario.machine)
    if named is not None:
        machine, text = read_machine(named)
        return machine, text, None
    machine, text = packaged_file()
    return machine, text, None


def _check_out(log: Path) -> None:
    if log.suffix not in WRITERS:
        raise WrongUse(f"--out {log}: the ending says what is written; give {' or '.join(WRITERS)}")
    for path in files_of(log):
        if path.exists():
            raise WrongUse(f"{path}: exists; a log is never overwritten, give another name")
    if not log.parent.is_dir():
        raise WrongUse(f"--out {log}: there is no folder {log.parent}")


def _tell(source: SimulationInput, simulated: Simulated, json_only: bool, beside: Path | None) -> None:
    log, described, table = simulated.files
    if json_only:
        counts = {"seed": source.seed, "seconds": source.seconds, "frames": simulated.frames}
        files = {"log": str(log), "truth": str(described), "table": str(table)}
        files |= {} if beside is None else {"machine": str(beside)}
        print(json.dumps({**counts, **files, "parameters": simulated.truth.parameters}))
        return
    console = Console()
    if source.scenario.purpose:
        console.print(source.scenario.purpose, highlight=False)
    console.print(f"{simulated.frames} frames of {source.seconds:g} s, seed {source.seed}", highlight=False)
    machine = [] if log.suffix == ".mcap" else ["--machine", str(beside or "M.toml")]
    owners = [] if beside is None else [("Owner: ", beside)]
    for what, path in (("Log:   ", log), ("Truth: ", described), ("       ", table), *owners):
        console.print(f"{what} {path}", soft_wrap=True, highlight=False)
    console.print(f"Replay: {command('replay', str(log), *machine)}", soft_wrap=True, highlight=False)
