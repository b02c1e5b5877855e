"""Opens a machine file and the DBC file that it names."""

import codecs
import re
import tomllib
from pathlib import Path

from tilth.schemas.invocation import command
from tilth.schemas.machine import MachineError
from tilth.schemas.machine_toml import MachineFile, parse_machine
from tilth.schemas.readable import reason_of

_UNFILLED = re.compile(r"[^#=]+=\s*# FILL IN")  # a line of `tilth discover`'s draft that has no value yet
_ANSI = "cp1252"  # as most tools for DBC files write them
_LOG_STARTS = (b"\x89MCAP", b"LOGG", b"MDF ")  # MCAP, BLF, MDF4


def read_machine(path: Path | str) -> MachineFile:
    """A machine file.

    Relative wheel_angle.dbc and zenoh.config count from the machine file's folder. Raises MachineError in one
    sentence.
    """
    path = Path(path)
    text = _text(path, "machine file")
    dbc = _dbc_name(text)
    dbc_text = None if dbc is None else _text(path.parent / dbc, "wheel_angle.dbc", otherwise=_ANSI)
    try:
        machine = parse_machine(text, dbc_text)
    except MachineError as error:
        raise MachineError(f"{path}: {_unfilled(text) or error}") from None
    if machine.zenoh.config is not None:
        zenoh = machine.zenoh.model_copy(update={"config": str(path.parent / machine.zenoh.config)})
        machine = machine.model_copy(update={"zenoh": zenoh})
    return MachineFile(machine, text)


def _unfilled(text: str) -> str:
    """Which lines of a draft are still to be filled in; "" if none."""
    lines = [n for n, line in enumerate(text.splitlines(), 1) if _UNFILLED.match(line)]
    if not lines:
        return ""
    place = f"line {lines[0]}" if len(lines) == 1 else f"line {lines[0]} and {len(lines) - 1} more"
    return f'{place} still marked "FILL IN"; write the value of each after its ='


def _dbc_name(text: str) -> str | None:
    """wheel_angle.dbc, where the text is good enough to say so; parse_machine explains what is wrong."""
    try:
        section = tomllib.loads(text).get("wheel_angle")
    except tomllib.TOMLDecodeError:
        return None
    name = section.get("dbc") if isinstance(section, dict) else None
    return name if isinstance(name, str) else None


def _text(path: Path, what: str, otherwise: str = "") -> str:
    """A file's text, without the mark that some editors put before it. otherwise: what it is if not UTF-8."""
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise MachineError(
            f"{path}: the {what} cannot be read ({reason_of(error)}); give the path of one that exists"
        ) from None
    if raw.startswith(_LOG_STARTS):
        raise MachineError(f"{path}: a log, not a {what}; to read it: {command('replay', str(path))}")
    if raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise MachineError(f"{path}: the {what} is UTF-16, not UTF-8 text; save it as UTF-8")
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        if not otherwise:
            raise MachineError(f"{path}: the {what} is not UTF-8 text; save it as UTF-8") from None
        text = raw.decode(otherwise, "replace")
    return text.replace("\r\n", "\n").replace("\r", "\n")
