"""`tilth map`: a map of the fields of a season."""

import argparse
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from tilth.cli import WrongUse, as_given, at_least, check_folder, say
from tilth.cli.desk_options import between
from tilth.cli.log_errors import log_errors
from tilth.schemas.invocation import command

if TYPE_CHECKING:
    from tilth.analysis.season.field_map import MappedField
    from tilth.analysis.season.kept_table import RigStretches

ENDINGS = (".geojson", ".parquet", ".png", ".html", ".json")
_say = partial(say, "map")


def add(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = subparsers.add_parser(
        "map",
        help="draw a map of the fields of a season",
        description="Make a map from the results of `season` in DIR: how the soil holds each axle of one "
        "tractor with its implement, and how sure that is, along each stretch and in cells between the "
        "stretches.",
    )
    parser.add_argument("season", type=Path, metavar="DIR", help="the season's folder")
    parser.add_argument(
        "--out",
        type=Path,
        required=True,
        metavar="FILE",
        help=f"a new file that ends in {', '.join(ENDINGS)}; the last is for [estimation] field_map",
    )
    parser.add_argument("--machine", metavar="NAME", help="choose one of several machines")
    parser.add_argument(
        "--implement", metavar="NAME", help="choose one of several implements, by the start of its name"
    )
    parser.add_argument("--field", type=at_least(1, "number of a field"), metavar="N", help="this field only")
    parser.add_argument(
        "--cell", type=between(1.0, 100.0, "m"), default=10.0, metavar="M", help="size of a cell in m (10)"
    )


def run(args: argparse.Namespace) -> int:
    """Always 0."""
    ending = args.out.suffix.lower()
    if ending not in ENDINGS:
        raise WrongUse(f"--out {args.out}: give a name that ends in {', '.join(ENDINGS)}")
    if args.out.exists():
        raise WrongUse(f"{args.out}: exists; a map is never overwritten, give another name")
    check_folder(args.out.parent)
    from threadpoolctl import threadpool_limits

    from tilth.analysis.season.field_map import fields_of, mapped  # wrong use is told before these imports
    from tilth.analysis.season.kept_table import MapProblem, stretches_of
    from tilth.analysis.season.map_page import told_of
    from tilth.analysis.season.table import NoParquet

    with log_errors(args.out, "nothing was written"):
        try:
            rig = stretches_of(args.season, args.machine, args.implement)
            parts = list(enumerate(fields_of(rig.stretches), 1))
            if args.field is not None and args.field > len(parts):
                raise WrongUse(f"--field {args.field}: the fields are numbered 1 to {len(parts)}")
            if ending in (".png", ".json") and args.field is None and len(parts) > 1:
                raise WrongUse(
                    f"a {ending} is of one field, and there are {len(parts)}: give --field N; "
                    "an .html shows all"
                )
            wanted = [part for part in parts if args.field in (None, part[0])]
            with threadpool_limits(1):  # two that wait for each other take four times the processor's time
                fields = [mapped(number, rig.machine, of, args.cell) for number, of in wanted]
        except (MapProblem, NoParquet) as error:
            raise WrongUse(str(error)) from None
        for text in (*rig.left_out, *map(told_of, fields)):
            _say(text)
        _write(args, ending, rig, fields)
    _say(f"wrote {args.out}")
    return 0


def _write(args: argparse.Namespace, ending: str, rig: "RigStretches", fields: list["MappedField"]) -> None:
    from tilth.analysis.season.map_files import facts_of, write_geojson, write_geoparquet, write_prior
    from tilth.analysis.season.map_page import (
        write_page,
        write_picture,
    )  # with matplotlib, which takes a second

    facts, features = facts_of(rig, args.cell), [one for field in fields for one in field.features]
    if ending == ".geojson":
        write_geojson(args.out, features, facts)
    elif ending == ".parquet":
        write_geoparquet(args.out, features, facts)
    elif ending == ".json":
        write_prior(args.out, rig.machine, fields[0])
    elif ending == ".png":
        write_picture(args.out, rig, fields[0])
    else:
        words = [str(args.season), *as_given(args, "out", "machine", "implement", "field", "cell")]
        write_page(args.out, rig, fields, command("map", *words))
