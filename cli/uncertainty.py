"""`tilth uncertainty`: how well outputs of a rig are known, and what of that each parameter costs."""

import argparse
import json
import math
import sys
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

from rich.console import Console
from rich.table import Table as RichTable

from tilth.analysis.runs.run import Run, open_runs
from tilth.analysis.sensitivity.answers import UncertaintyAnswer, UncertaintyData
from tilth.analysis.sensitivity.knowledge import Knowledge, given, of_machine, of_run
from tilth.analysis.sensitivity.local_page import MEANINGS
from tilth.analysis.sensitivity.outputs import LONGEST, NAMES, OUTPUTS, SPEEDS, STEP, STEP_S
from tilth.analysis.sensitivity.propagation import DRAWS, UncertaintyQuestion, uncertainty_answer
from tilth.analysis.sensitivity.slopes import MACHINE_PARAMETERS
from tilth.analysis.sensitivity.uncertainty_page import (
    TOLD,
    WHICH,
    apart,
    causes,
    in_words,
    known_to,
    uncertainty_report,
)
from tilth.cli import WrongUse, as_given, at_least, check_out, say, say_unusual
from tilth.cli.desk_options import (
    add_input,
    add_report,
    add_simulation,
    after,
    between,
    check_name,
    made_by,
    names,
    share,
    write_report,
)
from tilth.cli.log_errors import log_errors
from tilth.estimator.models.family import model_named
from tilth.logger.machine_file import read_machine
from tilth.schemas.invocation import command
from tilth.schemas.machine_toml import MachineFile

_say = partial(say, "uncertainty")

FEWEST_DRAWS = 100
_UNITS = {output.name: output.unit for output in OUTPUTS}


def add(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = subparsers.add_parser(
        "uncertainty",
        help="show how well the outputs of a rig are known",
        description="Show how well each output of a rig is known, given the uncertainty of its parameters, "
        "and how much each parameter contributes. The wheels turn by 10 degrees at once, or in another "
        "manoeuvre.",
    )
    parser.add_argument("machine", type=Path, metavar="MACHINE.toml")
    source = parser.add_mutually_exclusive_group()
    source.add_argument(
        "--from",
        dest="log",
        type=Path,
        metavar="LOG",
        help="use the log's last estimates, with their correlations, instead of the machine file",
    )
    source.add_argument(
        "--sd",
        action="append",
        default=[],
        metavar="NAME=SD",
        help="treat only this parameter as uncertain, with this sd: a share (C_af=10%%) or in SI units; "
        "may be repeated",
    )
    parser.add_argument(
        "--correlation",
        action="append",
        default=[],
        metavar="A,B=R",
        help="correlation of two parameters of --sd, from -1 to 1; may be repeated",
    )
    parser.add_argument(
        "--want",
        action="append",
        default=[],
        metavar="OUTPUT=HALF",
        help="wanted half-width of the 95 %% interval of an output (off_tracking=0.04, r_t=5%%): says how "
        "well each parameter must be known for it; may be repeated",
    )
    _add_simulation(parser)
    add_report(parser)


def _add_simulation(parser: argparse.ArgumentParser) -> None:
    """What is simulated, and how often."""
    add_simulation(parser)
    parser.add_argument(
        "--seconds",
        type=between(2 * STEP_S, LONGEST * STEP_S, "s"),
        metavar="N",
        help="duration of the simulation (twice the settling time)",
    )
    add_input(parser)
    parser.add_argument(
        "--draws",
        type=at_least(FEWEST_DRAWS),
        default=DRAWS,
        metavar="N",
        help=f"number of random rigs at each speed ({DRAWS})",
    )


def run(args: argparse.Namespace) -> int:
    """1 where the rig is unstable at some of the speeds, or the log cannot be read."""
    check_out(args.out)
    machine_file = read_machine(args.machine)
    machine = machine_file.machine
    say_unusual("uncertainty", machine)
    try:
        with log_errors():
            known = _known(args, of_machine(machine), machine_file)
        if not known.names:
            raise WrongUse("the machine file says of nothing how well it is known; give --sd NAME=SD")
        if sys.stderr.isatty():
            _say("computing; this may take a minute")
        answer = uncertainty_answer(known, _question(args))
    except ValueError as error:
        raise WrongUse(str(error)) from None
    for one in answer["refused"]:
        _say(one["reason"])
    if args.json:
        print(json.dumps({"machine": machine.name, **answer}, allow_nan=False))
    elif args.out is None:
        _show(machine.name, answer)
    status = 1 if answer["refused"] else 0
    if args.out is not None:
        data: UncertaintyData = {
            "machine": machine.name,
            **answer,
            "command": command("uncertainty", *_words(args)),
            "made": made_by(machine_file),
        }
        status = max(status, write_report("uncertainty", uncertainty_report, data, args.out))
    return status


def _known(args: argparse.Namespace, base: Knowledge, machine: MachineFile) -> Knowledge:
    """Raises WrongUse, ValueError, LogError, OSError."""
    if args.correlation and not args.sd:
        raise WrongUse("--correlation needs --sd of both parameters")
    if args.log is not None:
        return of_run(_run_of(args.log, machine))
    if not args.sd:
        return base
    sds = {}
    for name, value, relative in _pairs("--sd", args.sd, MACHINE_PARAMETERS):
        one = value if relative else value / getattr(base.rig, name)
        sds[name] = math.sqrt(math.log1p(one**2))
    return given(base, sds, [_correlation(text, sds) for text in args.correlation])


def _run_of(log: Path, machine: MachineFile) -> Run:
    """The last run of a log, with its estimates by that machine file. Raises LogError, OSError."""
    *_, run = open_runs([log], say=_say)
    if run.machine_file.sha256 != machine.sha256:
        _say(f"{log} was made with another machine file; it is replayed with {machine.machine.machine.name}")
        *_, run = open_runs([log], machine=machine, say=_say)
    return run


def _pairs(option: str, texts: Sequence[str], known: Sequence[str]) -> list[tuple[str, float, bool]]:
    """(name, number, whether it was in per cent) of NAME=NUMBER."""
    found = []
    for text in texts:
        name, _, number = text.partition("=")
        check_name(option, name, known)
        try:
            found.append((name, share(number), number.endswith("%")))
        except ValueError:
            raise WrongUse(
                f"{option} {text}: give NAME=NUMBER or NAME=NUMBER%, a number above zero"
            ) from None
    return found


def _correlation(text: str, sds: Mapping[str, float]) -> tuple[str, str, float]:
    both, _, number = text.partition("=")
    one, _, other = both.partition(",")
    for name in (one, other):
        check_name("--correlation", name, sds)
    try:
        value = float(number)
    except ValueError:
        value = math.nan
    if not -1.0 < value < 1.0 or one == other:
        raise WrongUse(f"--correlation {text}: give A,B=R with two names and R between -1 and 1")
    return one, other, value


def _question(args: argparse.Namespace) -> UncertaintyQuestion:
    speeds = tuple(dict.fromkeys(args.speed or SPEEDS))
    wanted = {}
    for name, value, relative in _pairs("--want", args.want, NAMES):
        if relative == bool(_UNITS[name]):
            how = f"in {_UNITS[name]}" if _UNITS[name] else "in per cent (5%)"
            raise WrongUse(f"--want {name}: give it {how}")
        wanted[name] = value
    return UncertaintyQuestion(
        tuple(model_named(name) for name in dict.fromkeys(args.model or ["relaxation"])),
        speeds,
        (args.seconds,) * len(speeds),
        names("--outputs", args.outputs, NAMES),
        wanted,
        args.draws,
        args.input,
    )


def _words(args: argparse.Namespace) -> list[str]:
    """The command line, as it would be given again."""
    options = "from=log", "sd", "correlation", "want", "speed", "model", "outputs"
    words = [str(args.machine), *as_given(args, *options)]
    words += as_given(args, "input") if args.input != STEP else []
    return words + as_given(args, "seconds", "draws", "out")


def _show(name: str, answer: UncertaintyAnswer) -> None:
    console = Console(highlight=False)
    console.print(f"{name}, with what {answer['source']} knows, {after(answer['input'])}")
    for entry in answer["speeds"]:
        title = f"{entry['speed']:g} m/s, {entry['model']} model, {entry['seconds']:.3g} s"
        table = RichTable(title=title, title_justify="left")
        for heading in ("", "known to, 95 %", "first order", "of that variance"):
            table.add_column(heading, overflow="fold")
        for name, output in entry["outputs"].items():
            first = known_to(output["first_order"], output["unit"])
            words = f"{name}, {TOLD[name]}" if TOLD[name] != name.replace("_", " ") else TOLD[name]
            table.add_row(words, known_to(output["half"], output["unit"]), first, causes(output))
        console.print(table)
        if told := apart(entry["outputs"]):
            console.print(told)
        if entry["unstable_share"] > 0:
            console.print(f"{100 * entry['unstable_share']:.1f} % of the rigs drawn are unstable, left out.")
        for name, output in entry["outputs"].items():
            if "wanted" in output:
                console.print(in_words(name, output, answer["parameters"]))
    console.print(WHICH)
    names = ", ".join(f"{name}: {MEANINGS[name]}" for name in answer["parameters"])
    console.print(f"Parameters: {names}.")
