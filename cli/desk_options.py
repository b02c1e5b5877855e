"""What commands that ask models at a desk share: options, names, and the writing of a report."""

import argparse
import difflib
import math
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TypeVar

from tilth.analysis.report.document import DriveReport, as_json
from tilth.analysis.rig_report import SPEED_RANGE
from tilth.analysis.sensitivity.answers import Made
from tilth.analysis.sensitivity.outputs import NAMES, SPEEDS
from tilth.cli import WrongUse, exists, say
from tilth.estimator.models.family import MODELS
from tilth.estimator.models.manoeuvres import MANOEUVRES, manoeuvre_named
from tilth.logger.log.software import software
from tilth.schemas.machine_toml import MachineFile
from tilth.schemas.readable import reason_of

STEP = "step"  # of MANOEUVRES
Data = TypeVar("Data")  # of a report


def between(low: float, high: float, unit: str) -> Callable[[str], float]:
    """A type for argparse: a number from low to high."""

    def number(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"give a number from {low:g} to {high:g} {unit}, not {text}")
        return value

    return number


def add_speed_and_model(
    parser: argparse.ArgumentParser, speeds: Sequence[float], models: str = "relaxation"
) -> None:
    """The options of which speeds and models are asked for. speeds, models: those without them."""
    several = "may be given several times"
    parser.add_argument(
        "--speed", action="append", type=between(*SPEED_RANGE, "m/s"), metavar="M/S",
        help=f"{several} ({', '.join(map(str, speeds))})",
    )  # fmt: skip
    names = [model.name for model in MODELS]
    parser.add_argument("--model", action="append", choices=names, help=f"{several} ({models})")


def add_simulation(parser: argparse.ArgumentParser) -> None:
    """The options of which speeds, models and outputs are asked for."""
    add_speed_and_model(parser, SPEEDS)
    parser.add_argument(
        "--outputs", action="append", default=[], metavar="NAME,…", help=f"outputs: {', '.join(NAMES)} (all)"
    )


def add_input(parser: argparse.ArgumentParser) -> None:
    """The option of what the wheels do."""
    meanings = "; ".join(f"{row.name}: {row.meaning}" for row in MANOEUVRES)
    parser.add_argument(
        "--input",
        choices=[row.name for row in MANOEUVRES],
        default=STEP,
        help=f"manoeuvre of the wheels, to 10 degrees ({STEP}). {meanings}",
    )


def add_report(parser: argparse.ArgumentParser) -> None:
    """The options of where the answer goes, as `write_report` takes them."""
    parser.add_argument("--json", action="store_true", help="one JSON object to stdout")
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FILE.html",
        help="write a report with figures to this new file, and JSON beside it",
    )


def after(steering: str) -> str:
    """For people, what the wheels did."""
    if steering == STEP:
        return "after the wheels turned by 10°"
    return f"over a manoeuvre to 10°: {manoeuvre_named(steering).meaning}"


def share(text: str) -> float:
    """Of 0.1 or 10%: 0.1. Raises ValueError where it is not positive and finite."""
    value = float(text.removesuffix("%")) / (100.0 if text.endswith("%") else 1.0)
    if not (math.isfinite(value) and value > 0):
        raise ValueError
    return value


def names(option: str, given: Sequence[str], known: Sequence[str]) -> tuple[str, ...]:
    """Of an option that may be repeated and may hold several names between commas; all where it is not given.

    Raises WrongUse with the nearest right name.
    """
    words = [word.strip() for text in given for word in text.split(",") if word.strip()]
    for word in words:
        check_name(option, word, known)
    return tuple(dict.fromkeys(words)) or tuple(known)


def check_name(option: str, word: str, known: Iterable[str]) -> None:
    """Raises WrongUse with the nearest right name."""
    there = list(known)
    if word in there:
        return
    lower = {name.lower(): name for name in there}
    near = difflib.get_close_matches(word.lower(), lower, n=1, cutoff=0.5)
    hint = f'; did you mean "{lower[near[0]]}"?' if near else "."
    raise WrongUse(f"{option} {word}: there is no such name{hint} There are {', '.join(there)}")


def made_by(machine_file: MachineFile) -> Made:
    """What a report says of its origin."""
    return {"machine_sha256": machine_file.sha256, "software": software()}


def write_report(of: str, build: Callable[[Data], DriveReport], data: Data, out: Path) -> int:
    """Write the HTML file and the JSON beside it, both or none. The exit status: 1 where that fails.

    of: the command, for its words. Raises WrongUse where a file has come to be there meanwhile.
    """
    from tilth.analysis.report.writing import write  # matplotlib takes a second: only who writes pays

    report = build(data)
    try:
        written = write(report, as_json(report), out)
    except FileExistsError as error:
        raise exists(error.filename) from None
    except PermissionError:
        raise  # cli.main knows what to say
    except OSError as error:
        say(of, f"{error.filename or out}: {reason_of(error)}; nothing was written")
        return 1
    say(of, f"wrote {', '.join(map(str, written))}")
    return 0
