"""`tilth decode`: the messages of a log, one a line."""

import argparse
import errno
import json
import sys
import textwrap
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from contextlib import closing
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

from tilth.cli import add_bus_names, buses_of, log_path, say
from tilth.cli.decode_summary import CLAIM, Summary, name_text, short
from tilth.cli.unread import tell_unread
from tilth.estimator.snapshot import NotRestorable, restore_decoder
from tilth.logger.machine_file import read_machine
from tilth.replay.readers.any_log import open_log
from tilth.replay.readers.log import LogError, OpenLog, Record
from tilth.replay.readers.rig import machine_in, on_buses_of
from tilth.replay.turn_rates import TurnRates
from tilth.schemas.can_id import BROADCAST
from tilth.schemas.decode import Decoder, Unread
from tilth.schemas.device_names import device, name_words
from tilth.schemas.flow import Frame, Message
from tilth.schemas.machine import Machine
from tilth.schemas.machine_toml import MachineFile
from tilth.schemas.pgn_table import PGNS
from tilth.schemas.proto.tilth_pb2 import Snapshot
from tilth.schemas.readable import reason_of
from tilth.schemas.rejections import Rejection
from tilth.schemas.sentences import rejection_sentence

_say = partial(say, "decode")

_YEAR_NS = 365 * 86_400_000_000_000  # stamps below it are no dates


@dataclass(slots=True)
class _Decoding:
    """The decoder and what has come of it so far."""

    machine: Machine | None
    sha256: str  # of the machine file; "" where there is none
    decoder: Decoder
    turn_rates: TurnRates = field(default_factory=TurnRates)
    count: Counter[str] = field(default_factory=Counter)
    rejected: Counter[str] = field(default_factory=Counter)  # reason -> count, of the readers and decoders
    before: Counter[str] = field(default_factory=Counter)  # of decoder.rejected, when the decoder was taken
    unread: Counter[Unread] = field(default_factory=Counter)  # frames that were not decoded

    def take_up(self, log: OpenLog, stored: Snapshot) -> None:
        """Know what the daemon knew when it stored its state: who has which address."""
        if stored.machine_sha256 != self.sha256:
            return
        try:
            decoder = restore_decoder(self.machine, stored.state_json)
        except NotRestorable as why_not:
            _say(f"{log.path}: its stored state is not used: {why_not}; continuing without it")
            return
        self.close_counts()
        self.decoder = decoder
        self.before = Counter(decoder.rejected)

    def close_counts(self) -> None:
        """Once for each decoder, at its end."""
        self.unread.update(self.decoder.unread)
        rejected = Counter(self.decoder.rejected)
        for reason, number in (rejected - self.before).items():
            self.rejected[reason] += number
        self.before = rejected


def add(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    parser = subparsers.add_parser(
        "decode",
        help="print the messages of a log, one per line; on a terminal, a summary",
        description="Print the messages of a log, one per line; on a terminal, a summary of who sent what "
        "and how often. At the end, report on stderr what was not decoded.",
        epilog=_decoded(),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("logs", nargs="+", type=log_path, metavar="LOG", help="read in the order given")
    parser.add_argument(
        "--machine",
        type=Path,
        metavar="M.toml",
        help="machine file that describes the sensors; a log of tilth contains it",
    )
    add_bus_names(parser)
    shown = parser.add_mutually_exclusive_group()
    shown.add_argument("--json", action="store_true", help="one JSON object per line")
    shown.add_argument(
        "--lines", action="store_true", help="the messages instead of the summary, also on a terminal"
    )


def _decoded() -> str:
    """What is decoded, for --help."""
    lines = ["decoded, with the keys of --json:"]
    for row in PGNS:
        selector = "" if row.selector is None else f" (selector 0x{row.selector:02X})"
        lines.append(f"  {row.pgn:<6} {row.title}{selector}")
        keys = ", ".join([*row.signals, *(group.key for group in row.groups)])
        lines += textwrap.wrap(keys, 96, initial_indent=" " * 9, subsequent_indent=" " * 9)
    lines.append("and the wheel-angle sensor of the machine file, whatever its message.")
    return "\n".join(lines)


def run(args: argparse.Namespace) -> int:
    machine_file = _machine(args)
    machine = machine_file and machine_file.machine
    buses = buses_of(args, machine)
    decoding = _Decoding(machine, machine_file.sha256 if machine_file else "", Decoder(machine))
    summary = Summary()
    line = _json_line if args.json else _text_line
    if sys.stdout.isatty() and not (args.json or args.lines):
        line = summary.take
    status = 0
    for path in args.logs:
        try:
            log = open_log(path)
            with closing(log.file):
                _decode(log, _records(log, machine, buses), decoding, line)
                _tell_end(log, decoding.rejected)
        except LogError as error:
            _say(str(error))
            status = max(status, error.status)
        except BrokenPipeError:  # main knows what to do
            raise
        except OSError as error:
            if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):  # of what is written
                raise
            _say(f"{path}: {reason_of(error)}")
            status = max(status, 1)
    decoding.close_counts()
    if summary.rows:
        summary.show()
    _tell_counts(decoding.count, decoding.rejected)
    for text in decoding.turn_rates.sentences():
        _say(text)
    tell_unread(decoding.unread, decoding.decoder, _say)
    return status


def _machine(args: argparse.Namespace) -> MachineFile | None:
    """The machine file given, else the one in the logs, if any. Raises MachineError."""
    if args.machine is not None:
        return read_machine(args.machine)
    try:
        return machine_in(args.logs, plausible=False)
    except LogError:
        return None  # without one all that needs none is decoded


def _records(log: OpenLog, machine: Machine | None, buses: Mapping[str, str]) -> Iterable[Record]:
    return log.records if machine is None else on_buses_of(machine, log, buses, _say)


def _decode(
    log: OpenLog, records: Iterable[Record], decoding: _Decoding, line: Callable[[Message], str]
) -> None:
    write = sys.stdout.write
    count = decoding.count
    for record in records:
        if isinstance(record, Frame):
            count["frames"] += 1
            for message in decoding.decoder.messages(record):
                count["messages"] += 1
                decoding.turn_rates.take(message)
                write(line(message))
        elif isinstance(record, Snapshot):
            decoding.take_up(log, record)


def _json_line(message: Message) -> str:
    origin = message.origin
    row: dict[str, object] = {
        "t_ns": message.t_ns,
        "bus": origin.bus,
        "source": origin.source,
        "name": name_text(message),
        "pgn": message.pgn,
        "title": message.title,
        "priority": message.priority,
        "destination": message.destination,
        **message.values,
        **message.groups,
    }
    if message.sid is not None:
        row["sid"] = message.sid
    if message.pgn == CLAIM and origin.name is not None:
        row |= name_words(origin.name)
    if message.dropped:
        row["dropped"] = {
            key: {"value": value, "reason": Rejection.OUT_OF_RANGE} for key, value in message.dropped.items()
        }
    if message.reason is not None:
        row["reason"] = message.reason
    if message.repeat:
        row["repeat"] = True
    return json.dumps(row) + "\n"


def _text_line(message: Message) -> str:
    words = [f"{word}={short(value)}" for word, value in message.values.items()]
    words += [f"{key}=[{len(rows)}]" for key, rows in message.groups.items() if rows]
    words += [f"({key}={short(value)}: {Rejection.OUT_OF_RANGE})" for key, value in message.dropped.items()]
    origin = message.origin
    if message.pgn == CLAIM and origin.name is not None:
        words.append(f"({device(origin.name)})")
    if message.destination != BROADCAST:
        words.append(f"(to {message.destination})")
    if message.reason is not None and not (message.reason == Rejection.OUT_OF_RANGE and message.dropped):
        words.append(f"({message.reason})")
    if message.repeat:
        words.append("(repeated)")
    who = f"{origin.bus:<8} {origin.source:>3} {name_text(message) or '-':<16}"
    return f"{_time(message.t_ns)}  {who}  {message.pgn:>6}  {message.title}: {'  '.join(words)}\n"


def _time(t_ns: int) -> str:
    seconds, fraction = divmod(t_ns, 1_000_000_000)
    if t_ns < _YEAR_NS:
        return f"{seconds:>6}.{fraction // 1000:06d}"
    date = datetime.fromtimestamp(seconds, UTC)
    return f"{date:%Y-%m-%d %H:%M:%S}.{fraction // 1000:06d}"


def _tell_end(log: OpenLog, rejected: Counter[str]) -> None:
    for reason, number in log.skipped.items():
        rejected[reason] += number
    if log.truncated:
        _say(f"{log.path}: cut off; decoded as far as it is whole")
    for text in ([log.note] if log.note else []) + log.told_damage():
        _say(f"{log.path}: {text}")


def _tell_counts(count: Counter[str], rejected: Counter[str]) -> None:
    _say(f"{count['frames']} frames, {count['messages']} messages")
    for reason, number in sorted(rejected.items()):
        _say(f"rejected {rejection_sentence(reason)}: {number}")
