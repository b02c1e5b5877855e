"""`tilth sensitivity`: which parameters of a rig matter, for which output, at which speed."""

import argparse
import json
import sys
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import cast

from rich.console import Console
from rich.table import Table as RichTable

from tilth.analysis.sensitivity.answers import GlobalEntry, Made, SensitivityAnswer, SensitivityData, Values
from tilth.analysis.sensitivity.local_answer import (
    OVERALL,
    LocalQuestion,
    another_point,
    changed_curves,
    frequency_answer,
    local_answer,
)
from tilth.analysis.sensitivity.outputs import LONGEST, NAMES, SIX, SPEEDS, STEP, STEP_S
from tilth.analysis.sensitivity.slopes import MACHINE_PARAMETERS
from tilth.cli import WrongUse, as_given, check_out, say, say_unusual
from tilth.cli.desk_options import (
    add_input,
    add_report,
    add_simulation,
    after,
    between,
    made_by,
    names,
    write_report,
)
from tilth.cli.log_errors import log_errors
from tilth.cli.sensitivity_global import add_answers, add_global, design_of, show_global
from tilth.estimator.models.family import model_named
from tilth.estimator.models.parameters import Rig, rig_of
from tilth.logger.machine_file import read_machine
from tilth.schemas.invocation import command
from tilth.schemas.readable import reason_of

_say = partial(say, "sensitivity")


STEPS = ("1%", "exact")
ACROSS = 4  # columns of long names in a terminal


def add(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = subparsers.add_parser(
        "sensitivity",
        help="show how much each output of a rig depends on each parameter",
        description="Show how much each output of a rig changes with each parameter of its machine file, "
        "after the wheels turn by 10 degrees at once, or in another manoeuvre: per cent of the output "
        "for each per cent of the parameter.",
    )
    parser.add_argument("machine", type=Path, metavar="MACHINE.toml")
    add_simulation(parser)
    parser.add_argument(
        "--parameters",
        action="append",
        default=[],
        metavar="NAME,…",
        help=f"parameters: {', '.join(MACHINE_PARAMETERS)} (all)",
    )
    parser.add_argument(
        "--step", choices=STEPS, default=STEPS[0], help="the dissertation's step (1%%), or derivatives"
    )
    parser.add_argument(
        "--seconds",
        action="append",
        type=between(2 * STEP_S, LONGEST * STEP_S, "s"),
        metavar="N",
        help="duration of the simulation; once for all speeds, or once for each (twice the settling time)",
    )
    add_input(parser)
    add_global(parser)
    add_report(parser)


def run(args: argparse.Namespace) -> int:
    """1 where the rig is unstable at some of the speeds."""
    question = question_of(args)
    check_out(args.out)
    with log_errors():
        design = design_of(args)
    machine_file = read_machine(args.machine)
    machine = machine_file.machine
    say_unusual("sensitivity", machine)
    rig = rig_of(machine)
    if sys.stderr.isatty():
        _say("computing; this may take some seconds")
    try:
        local = local_answer(rig, question)
        answer = cast("SensitivityAnswer", {"machine": machine.machine.name, **local})
    except ValueError as error:
        raise WrongUse(str(error)) from None
    for one in answer["refused"]:
        _say(one["reason"])
    if design is not None:
        try:
            add_answers(answer, rig, design, args)
        except PermissionError:
            raise
        except OSError as error:
            _say(f"{error.filename or 'results'}: {reason_of(error)}; what was done is kept")
            return 1
    if args.json:
        print(json.dumps(answer, allow_nan=False))
    elif args.out is None:
        _show(answer)
    status = 1 if answer["refused"] else 0
    if args.out is not None:
        status = max(status, _write(args, answer, rig, question, made_by(machine_file)))
    return status


def question_of(args: argparse.Namespace) -> LocalQuestion:
    """Raises WrongUse."""
    speeds = tuple(dict.fromkeys(args.speed or SPEEDS))
    seconds = tuple(args.seconds or [None])
    if len(seconds) not in (1, len(speeds)):
        raise WrongUse(
            f"--seconds: given {len(seconds)} times for {len(speeds)} speeds; give it once, or once for each"
        )
    return LocalQuestion(
        tuple(model_named(name) for name in dict.fromkeys(args.model or ["relaxation"])),
        speeds,
        seconds * (len(speeds) if len(seconds) == 1 else 1),
        names("--outputs", args.outputs, NAMES),
        names("--parameters", args.parameters, MACHINE_PARAMETERS),
        args.step == "exact",
        args.input,
    )


def _write(
    args: argparse.Namespace,
    answer: SensitivityAnswer,
    rig: Rig,
    question: LocalQuestion,
    made: Made,
) -> int:
    from tilth.analysis.sensitivity.local_page import local_report

    data: SensitivityData = {
        **answer, "command": command("sensitivity", *_words(args)), "made": made,
        "another": {}, "curves": {}, "frequency": {},
    }  # fmt: skip
    for model in question.models:
        entries = [entry for entry in answer["speeds"] if entry["model"] == model.name]
        if not entries:
            continue
        speeds = [entry["speed"] for entry in entries]
        same = question._replace(
            models=(model,), speeds=tuple(speeds), seconds=tuple(entry["seconds"] for entry in entries)
        )
        data["another"][model.name] = another_point(rig, same)
        data["curves"][model.name] = changed_curves(rig, model, entries, question.steering)
        data["frequency"][model.name] = frequency_answer(rig, model, speeds, question.parameters)
    return write_report("sensitivity", local_report, data, args.out)


def _words(args: argparse.Namespace) -> list[str]:
    """The command line, as it would be given again."""
    words = [str(args.machine), *as_given(args, "speed", "model", "outputs", "parameters", "seconds")]
    if args.over_all:
        words += ["--global", *as_given(args, "points", "box", "from=log")]
        words += [] if args.indices else ["--no-indices"]
        words += as_given(args, "dask")
        words += ["--dask-tls", *args.dask_tls] if args.dask_tls else []
    words += as_given(args, "input") if args.input != STEP else []
    return words + as_given(args, "step", "out")


def _show(answer: SensitivityAnswer) -> None:
    console = Console(highlight=False)
    console.print(
        f"{answer['machine']}: per cent of the output for each per cent of the parameter "
        f"({'derivatives' if answer['step'] == 'exact' else 'a step of 1 %'}), {after(answer['input'])}"
    )
    for entry in answer["speeds"]:
        title = f"{entry['speed']:g} m/s, {entry['model']} model, {entry['seconds']:.3g} s"
        six = [name for name in entry["outputs"] if name in SIX]
        console.print(_table(title, entry["local"], [*six, OVERALL]))
        others = [name for name in entry["outputs"] if name not in SIX]
        for start in range(0, len(others), ACROSS):
            console.print(_table("", entry["local"], others[start : start + ACROSS]))
        if "global" in entry:
            show_global(console, cast("GlobalEntry", entry))


def _table(title: str, local: Mapping[str, Values], outputs: list[str]) -> RichTable:
    """The most important parameter first; those that do nothing are left out."""
    table = RichTable(title=title or None, title_justify="left")
    for heading in ("", *outputs):
        table.add_column(heading, overflow="fold", justify="right" if heading else "left")
    for name, row in sorted(local.items(), key=lambda pair: -(pair[1][OVERALL] or 0.0)):
        if any(row[output] for output in outputs):
            table.add_row(name, *("–" if row[one] is None else f"{row[one]:.3f}" for one in outputs))
    return table
