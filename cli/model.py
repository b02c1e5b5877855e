"""`tilth model`: what the models say of a rig before it is driven."""

import argparse
import json
import math
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console

from tilth.analysis.rig_report import LINEAR, SPEEDS, Drive, rig_report
from tilth.analysis.rig_tables import rig_tables
from tilth.cli import WrongUse, say, say_unusual
from tilth.cli.desk_options import add_speed_and_model, between
from tilth.estimator.components import components
from tilth.estimator.models.family import model_named
from tilth.estimator.models.identifiability import SENSOR_SETS
from tilth.estimator.models.manoeuvres import MANOEUVRES, manoeuvre_named
from tilth.estimator.models.parameters import Rig, rig_of
from tilth.estimator.tuning import Row, plain, rows
from tilth.logger.machine_file import read_machine
from tilth.schemas.readable import reason_of

_say = partial(say, "model")


def add(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = subparsers.add_parser(
        "model",
        help="show how a rig moves, and what a drive can reveal about its tyres",
        description="Show, before a rig is driven, how it turns, settles and responds to steering, what a "
        "regulator can make of it, and how well a manoeuvre can reveal its tyres' parameters.",
    )
    drive = Drive()
    parser.add_argument("machine", type=Path, nargs="?", metavar="MACHINE.toml")
    parser.add_argument(
        "--parameters",
        action="store_true",
        help="list the estimators' tuning constants instead, with unit and meaning; needs no MACHINE",
    )
    add_speed_and_model(parser, SPEEDS, "kinematic, dynamic and relaxation")
    parser.add_argument(
        "--manoeuvre",
        choices=[row.name for row in MANOEUVRES],
        default=drive.manoeuvre.name,
        help=f"manoeuvre to learn the tyres ({drive.manoeuvre.name})",
    )
    parser.add_argument(
        "--sensors",
        choices=list(SENSOR_SETS),
        default=drive.sensors,
        help=f"what is measured ({drive.sensors})",
    )
    parser.add_argument(
        "--wheel-angle",
        type=between(0.1, 20.0, "degrees"),
        default=math.degrees(drive.amplitude),
        metavar="DEG",
        help="wheel angle of the manoeuvre (5)",
    )
    parser.add_argument(
        "--seconds",
        type=between(2.0, 300.0, "s"),
        default=drive.seconds,
        metavar="N",
        help="duration of the manoeuvre (30)",
    )
    parser.add_argument("--json", action="store_true", help="one JSON object to stdout")
    parser.add_argument(
        "--plot",
        type=Path,
        metavar="FILE",
        help="also draw it to FILE (.svg, .png or .pdf), which is overwritten",
    )


def run(args: argparse.Namespace) -> int:
    """Always 0."""
    if args.parameters:
        _list_parameters(args.json)
        return 0
    if args.machine is None:
        raise WrongUse("name the machine file of the rig, or ask for --parameters")
    machine = read_machine(args.machine).machine
    say_unusual("model", machine)
    rig = rig_of(machine)
    models = [model_named(name) for name in dict.fromkeys(args.model or [])] or list(LINEAR)
    speeds = list(dict.fromkeys(args.speed or SPEEDS))
    amplitude = math.radians(args.wheel_angle)
    drive = Drive(manoeuvre_named(args.manoeuvre), args.sensors, amplitude, args.seconds)
    if args.plot is not None:
        _plot(args.plot, machine.machine.name, rig, [model.name for model in models], speeds)
    report = rig_report(rig, models, speeds, drive)
    if args.json:
        print(json.dumps({"machine": machine.name, **report}, allow_nan=False))
        return 0
    console = Console(highlight=False)
    for part in rig_tables(machine.machine.name, report):
        console.print(part)
    return 0


def _list_parameters(as_json: bool) -> None:
    if as_json:
        constants = [
            {"component": component.name} | row._asdict() | {"value": plain(row.value)}
            for component in components()
            for row in rows(component.record)
        ]
        print(json.dumps({"parameters": constants}, allow_nan=False))
        return
    for component in components():
        print(f"{component.name}: {type(component.record).__doc__}")
        for row in rows(component.record):
            print(f"  {row.name:28} {_shown(row.value)}{_unit(row)}")
            print(f"  {'':28} {row.meaning}")
        print()


def _unit(row: Row) -> str:
    if row.unit == "1":
        return ""
    return f" {row.unit}" + (f" ({math.degrees(row.value):.4g}°)" if row.unit == "rad" else "")


def _shown(value: Any) -> str:
    """A constant for a reader: 2.5, "0.1, 0.3" or "north 0.1, east 0.3"."""
    value = plain(value)
    if isinstance(value, dict):
        return ", ".join(f"{key} {_shown(item)}" for key, item in value.items())
    if isinstance(value, list):
        return ", ".join(map(_shown, value))
    return f"{value:_}" if isinstance(value, int) else f"{value:.4g}"


def _plot(path: Path, name: str, rig: Rig, models: list[str], speeds: list[float]) -> None:
    from tilth.analysis import plots, rig_plot  # matplotlib takes a second: only who plots pays for it

    if path.suffix.lower() not in plots.FORMATS:
        raise WrongUse(f"--plot {path}: give a name that ends in {', '.join(plots.FORMATS)}")
    if len(speeds) > rig_plot.MOST_SPEEDS:
        raise WrongUse(
            f"--plot {path}: a figure has room for {rig_plot.MOST_SPEEDS} speeds, not {len(speeds)}"
        )
    try:
        rig_plot.draw_rig(name, rig, [model_named(model) for model in models], speeds, path)
    except OSError as error:
        raise WrongUse(f"--plot {path}: {reason_of(error)}; give another path") from None
    _say(f"drew {path}")
