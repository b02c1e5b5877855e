"""`tilth discover`: listen to buses, or look into logs, and draft a machine file."""

import argparse
import contextlib
import json
import signal
import sys
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from types import FrameType

from pydantic import ValidationError

from tilth.cli import WrongUse, duration, say
from tilth.logger.log import whole_file
from tilth.replay.discover import BusDevice, BusSurvey, Findings, listen
from tilth.replay.machine_draft import described, draft
from tilth.replay.readers.any_log import open_log
from tilth.replay.readers.log import LogError
from tilth.replay.turn_rates import in_words
from tilth.schemas.bus_name import bus_name
from tilth.schemas.flow import Frame
from tilth.schemas.invocation import command
from tilth.schemas.machine import Bus
from tilth.schemas.readable import reason_of
from tilth.schemas.rule_of_thumb import TapedLengths, Weights, by_scale
from tilth.schemas.sentences import notice_sentence

_say = partial(say, "discover")

MOST_MESSAGES = 8
MOST_CANDIDATES = 5


def add(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = subparsers.add_parser(
        "discover",
        help="listen to a bus and draft a machine file",
        description="List the devices on these buses and draft a machine file. Drive a few turns "
        "meanwhile, so that the wheel angle shows. Nothing is ever sent.",
    )
    parser.add_argument(
        "logs", nargs="*", type=Path, metavar="LOG", help="recorded logs, instead of listening"
    )
    parser.add_argument(
        "--bus",
        action="append",
        default=[],
        metavar="INTERFACE:CHANNEL[,key=value…]",
        help="bus, such as socketcan:can0 or slcan:/dev/ttyUSB0,bitrate=250000; may be given several times",
    )
    parser.add_argument("--seconds", type=duration, default=30.0, metavar="N", help="how long to listen (30)")
    parser.add_argument(
        "--scale",
        type=_weights,
        metavar="FRONT,REAR,AXLE,TONGUE",
        help="weights in kg: the axles of the tractor alone, the implement's axle and its tongue; with "
        "--tape, the draft has masses, places of the CGs, and yaw inertias by a rule of thumb",
    )
    parser.add_argument(
        "--tape",
        type=_lengths,
        metavar="WHEELBASE,HITCH,DRAWBAR",
        help="lengths in m: wheelbase, rear axle to hitch, hitch to the implement's axle",
    )
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the draft to FILE, not to the screen")
    parser.add_argument(
        "--json", action="store_true", help="one JSON object to stdout, everything else to stderr"
    )


def run(args: argparse.Namespace) -> int:
    """1 where nothing was heard, or a log could not be read to its end."""
    if bool(args.bus) == bool(args.logs):
        raise WrongUse(
            "give --bus INTERFACE:CHANNEL to listen, such as --bus socketcan:can0, or logs to look into"
        )
    if (args.scale is None) != (args.tape is None):
        raise WrongUse("--scale and --tape belong together: give both")
    if args.out is not None and args.out.exists():
        raise WrongUse(f"{args.out}: exists; it is not overwritten, give another name")
    buses = parse_buses(args.bus)
    survey = BusSurvey()
    status = 0
    try:
        for frame in _logged(args.logs) if args.logs else _live_frames(buses, args.seconds):
            survey.take(frame)
    except LogError as error:
        _say(str(error))
        status = error.status
    findings = survey.findings()
    if not findings.frames:
        if not status:
            _say("no frame was heard; check that the devices are on, the channel and the bit rate")
        return status or 1
    measured = by_scale(args.scale, args.tape) if args.scale is not None else None
    _answer(args, findings, draft(findings, buses, measured))
    return status


def _weights(text: str) -> Weights:
    return Weights(*_numbers(text, Weights._fields))


def _lengths(text: str) -> TapedLengths:
    return TapedLengths(*_numbers(text, TapedLengths._fields))


def _numbers(text: str, names: Sequence[str]) -> list[float]:
    """argparse type: as many numbers above zero."""
    try:
        found = [float(one) for one in text.split(",")]
    except ValueError:
        found = []
    if len(found) != len(names) or not all(0.0 < one < 1e6 for one in found):
        raise argparse.ArgumentTypeError(f"{text}: give {len(names)} numbers above zero: {', '.join(names)}")
    return found


def _logged(logs: Sequence[Path]) -> Iterator[Frame]:
    for path in logs:
        log = open_log(path)
        yield from (record for record in log.records if isinstance(record, Frame))
        for text in log.lacks():
            _say(f"{path}: {text}")


def _live_frames(buses: Sequence[Bus], seconds: float) -> Iterator[Frame]:
    stopping = False

    def stop(signum: int, frame: FrameType | None) -> None:
        nonlocal stopping
        stopping = True

    signal.signal(signal.SIGINT, stop)
    _say(f"listening for {seconds:g} s; Ctrl-C ends it early")
    return listen(buses, seconds, lambda kind, told: _say(notice_sentence(told)), lambda: stopping)


def parse_buses(specifications: Sequence[str]) -> list[Bus]:
    """Buses of INTERFACE:CHANNEL[,key=value…]. Raises WrongUse."""
    buses: list[Bus] = []
    for given in specifications:
        place, *pairs = given.split(",")
        interface, colon, channel = place.partition(":")
        values: dict[str, str | int | float | bool] = {}
        for pair in pairs:
            key, equals, text = pair.partition("=")
            values[key] = _value(text)
            colon = colon and equals
        if not (interface and channel and colon):
            raise WrongUse(f"--bus {given}: write INTERFACE:CHANNEL[,key=value…], such as socketcan:can0")
        names = [bus.name for bus in buses]
        plain = bus_name(channel, names) == channel
        name = channel if plain else bus_name(f"can{len(buses)}", names)
        try:
            buses.append(Bus.model_validate({
                "name": bus_name(name, names), "interface": interface, "channel": channel,
                "bitrate": values.pop("bitrate", 250_000), "options": values,
            }))  # fmt: skip
        except ValidationError as error:
            raise WrongUse(f"--bus {given}: {error.errors()[0]['msg']}") from None
    return buses


def _value(text: str) -> str | int | float | bool:
    if text.lower() in ("true", "false"):
        return text.lower() == "true"
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def _answer(args: argparse.Namespace, findings: Findings, text: str) -> None:
    if args.out is not None:
        try:
            whole_file.write(args.out, text.encode(), replace=False)
        except OSError as error:
            raise WrongUse(f"--out {args.out}: {reason_of(error)}") from None
        then = command("check", str(args.out))
        _say(f"the draft is in {args.out}; fill in the lines marked FILL IN, then: {then}")
    if args.json:
        print(json.dumps(as_json(findings, text)))
        return
    # The draft alone is the output where it is sent into a file.
    with contextlib.redirect_stdout(sys.stderr if args.out is None else sys.stdout):
        _show(findings)
    if args.out is None:
        print(text)


def as_json(findings: Findings, text: str) -> dict[str, object]:
    return {
        "frames": findings.frames,
        "seconds": findings.seconds,
        "buses": list(findings.buses),
        "sources": [_source_as_json(source) for source in findings.sources],
        "receivers": [
            {"bus": r.bus, "source": r.source, "name": _name(r), "available": r.positions > 0}
            for r in findings.receivers
        ],
        "wheel_angles": [
            {
                "bus": c.bus, "id": c.can_id, "extended": c.extended, "start_byte": c.start_byte,
                "byte_order": c.byte_order, "signed": c.signed, "lowest": c.lowest, "highest": c.highest,
                "per_s": c.per_s, "smoothness": c.smoothness, "yaw_correlation": c.yaw_correlation,
                "likely": c.likely,
            }
            for c in findings.wheel_angles
        ],
        "machine_file": text,
    }  # fmt: skip


def _source_as_json(source: BusDevice) -> dict[str, object]:
    lag = source.turn_rate_lag
    return {
        "bus": source.bus,
        "source": source.source,
        "name": _name(source),
        "manufacturer": source.manufacturer,
        "manufacturer_name": source.manufacturer_name or None,
        "function": source.function,
        "positions": source.positions,
        "empty_positions": source.empty_positions,
        "turn_rate_lag_s": None if lag is None else {"value": lag[0], "sd": lag[1]},
        "messages": [
            {"pgn": m.pgn, "selector": m.selector, "title": m.title, "count": m.count, "per_s": m.per_s}
            for m in source.messages
        ],
    }


def _name(source: BusDevice) -> str | None:
    return None if source.name is None else f"{source.name:016X}"


def _show(findings: Findings) -> None:
    print(f"{findings.frames} frames in {findings.seconds:.1f} s")
    for source in findings.sources:
        name = f"NAME {_name(source)}" if source.name is not None else "no claim heard"
        print(f"\n{source.bus}  address {source.source:3} (0x{source.source:02X})  {name}  {_device(source)}")
        print(f"    {_messages(source)}")
        if source.turn_rate_lag is not None:
            print(f"    {in_words(source.turn_rate_lag)}")
    print("\nMay be the wheel angle:" if findings.wheel_angles else "\nNothing moves as a wheel angle does.")
    for candidate in findings.wheel_angles[:MOST_CANDIDATES]:
        print(f"    {described(candidate)}")
    print()


def _device(source: BusDevice) -> str:
    words = []
    if source.manufacturer is not None:
        words.append(source.manufacturer_name or f"manufacturer {source.manufacturer}")
    if source.function is not None:
        words.append(source.function_name or f"function {source.function}")
    if source.sends_positions:
        words.append("POSITIONS" if source.positions else 'positions, all "not available"')
    return ", ".join(words)


def _messages(source: BusDevice) -> str:
    often = sorted(source.messages, key=lambda message: message.per_s, reverse=True)
    words = []
    for m in often[:MOST_MESSAGES]:
        selector = "" if m.selector is None else f"/0x{m.selector:02X}"
        words.append(f"{m.pgn}{selector} " + (f"at {m.per_s:.3g}/s" if m.per_s else f"({m.count})"))
    return ", ".join(words) + (f", {len(often) - MOST_MESSAGES} more" if len(often) > MOST_MESSAGES else "")
