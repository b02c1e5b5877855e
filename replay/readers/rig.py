"""Relates a log to a machine file: the machine file stored in a log, and the names of the buses."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from itertools import chain, islice
from pathlib import Path

from tilth.replay.readers.any_log import metadata, open_log
from tilth.replay.readers.log import EmptyLog, ForeignLog, OpenLog, Record
from tilth.replay.readers.mcap_reader import MACHINE
from tilth.schemas.flow import Frame
from tilth.schemas.machine import Machine, MachineError
from tilth.schemas.machine_toml import MachineFile, parse_machine

PEEKED = 2000  # records among which the buses of a log are looked for
NO_RECEIVER = "none of the machine file's receivers is heard in it"
LEFT_OUT = ""  # instead of a name of the machine file: the frames of that bus are left out

Say = Callable[[str], None]


def machine_in(paths: Sequence[Path], *, plausible: bool = True) -> MachineFile:
    """The machine file stored in the first of these logs that has one.

    plausible: as of parse_machine; False for what only reads, and estimates nothing.
    Raises LogError where none has one, MachineError.
    """
    cut: Path | None = None
    for path in paths:
        try:
            log = open_log(path)
        except EmptyLog:
            continue
        with closing(log.file):
            found = metadata(log).get(MACHINE, {})
            if log.truncated:
                cut = cut or path
        text = found.get("toml")
        if text is not None:
            try:
                machine = parse_machine(text, found.get("dbc") or None, plausible=plausible)
            except MachineError as error:
                raise MachineError(f"{path}: its own machine file: {error}; give --machine M.toml") from None
            return MachineFile(machine, text)
    if cut is not None:
        raise ForeignLog(f"{cut}: cut off before its machine file; give --machine M.toml")
    raise ForeignLog(f"{paths[0]}: no machine file is in this log; give --machine M.toml")


def on_buses_of(machine: Machine, log: OpenLog, given: Mapping[str, str], say: Say) -> Iterator[Record]:
    """Records of a log with the bus names of the machine file.

    `given` maps names of the log to names of the machine file, or to LEFT_OUT. Where it names none, a log
    with one bus (as far as its first PEEKED records show) is that of a machine file with one bus. Says what
    it did and what does not fit.
    """
    first = list(islice(log.records, PEEKED))
    heard = list(dict.fromkeys(record.bus for record in first if isinstance(record, Frame)))
    if unheard := [bus for bus in given if bus not in heard]:
        say(f"{log.path}: --bus names {', '.join(unheard)}; it begins with {', '.join(heard) or 'none'}")
    renames, said = _renames([bus.name for bus in machine.bus], heard, given)
    if said:
        say(f"{log.path}: {said}")
    records = chain(first, log.records)
    return _renamed(records, renames) if renames else records


def _renames(
    names: Sequence[str], heard: Sequence[str], given: Mapping[str, str]
) -> tuple[dict[str, str], str]:
    """{bus of the log: name of the machine file}, and what is to be said of it."""
    renames = {bus: name for bus, name in given.items() if bus != name}
    log_buses = [bus for bus in heard if given.get(bus) != LEFT_OUT]
    if set(given.values()) <= {LEFT_OUT} and len(log_buses) == len(names) == 1 and log_buses != names:
        renames[log_buses[0]] = names[0]
        return renames, f"its bus {log_buses[0]} is taken for {names[0]} of the machine file"
    if log_buses and not any(renames.get(bus, bus) in names for bus in log_buses):
        return renames, (
            f"has the buses {', '.join(log_buses)}, the machine file has {', '.join(names)}; say which is "
            "which with --bus LOG=MACHINE"
        )
    return renames, ""


def _renamed(records: Iterator[Record], renames: Mapping[str, str]) -> Iterator[Record]:
    for r in records:
        if not isinstance(r, Frame) or r.bus not in renames:
            yield r
        elif (name := renames[r.bus]) != LEFT_OUT:
            yield Frame(r.t_ns, r.rx_ns, name, r.can_id, r.extended, r.error, r.data)


def bus_names(pairs: Sequence[str], machine: Machine | None) -> dict[str, str]:
    """{name in the log: name in the machine file, or LEFT_OUT} of --bus LOG=MACHINE. Raises MachineError."""
    if pairs and machine is None:
        raise MachineError("--bus LOG=MACHINE needs --machine M.toml, whose buses it names")
    names = [bus.name for bus in machine.bus] if machine is not None else []
    found = {}
    for pair in pairs:
        theirs, equals, ours = pair.partition("=")
        if not equals or ours not in (*names, LEFT_OUT):
            raise MachineError(
                f"--bus {pair}: write LOG=MACHINE; the machine file has {', '.join(names)}; {theirs}= leaves "
                "the bus out"
            )
        found[theirs] = ours
    return found
