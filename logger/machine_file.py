"""Opens a machine file, and the files that it names: of implements, and DBC files."""

import codecs
import re
import tomllib
from collections.abc import Iterable
from pathlib import Path

from tilth.schemas.invocation import command
from tilth.schemas.machine import DBC_BREAK, MachineError
from tilth.schemas.machine_toml import DBC_SECTIONS, MachineFile, joined, parse_machine, section_of
from tilth.schemas.readable import reason_of
from tilth.schemas.undescribed import UNDESCRIBED, undescribed

_UNFILLED = re.compile(r"[^#=]+=\s*# FILL IN")  # a line of `tilth discover`'s draft that has no value yet
_ANSI = "cp1252"  # as most tools for DBC files write them
_LOG_STARTS = (b"\x89MCAP", b"LOGG", b"MDF ")  # MCAP, BLF, MDF4


def read_machine(path: Path | str) -> MachineFile:
    """A machine file; of a tractor with several implements TRACTOR.toml+NAME, with one of them.

    Relative wheel_angle.dbc, zenoh.config, estimation.field_map and implements.files count from the machine
    file's folder, implement.load.weighing.dbc from that of the file which has it. Raises MachineError in one
    sentence.
    """
    path, name = _parted(Path(path))
    rigs = read_rigs(path)
    if not name and len(rigs) == 1:
        return next(iter(rigs.values()))
    if name in rigs:
        return rigs[name]
    if not name:
        raise MachineError(f"{path}: {_one_of(rigs)}; say which, such as {path}+{next(iter(rigs))}")
    if "" in rigs:
        raise MachineError(f"{path}: it has no [implements], so there is no {name} among them")
    raise MachineError(f"{path}: no implement {name}; {_one_of(rigs)}")


def read_rigs(path: Path | str) -> dict[str, MachineFile]:
    """Each rig that a machine file describes, by the implement's name, in the order of its [implements], and
    UNDESCRIBED; one alone, by "", where it has none. Raises MachineError."""
    path = _parted(Path(path))[0]
    text = _text(path, "machine file")
    files = _told(text, "implements", "files")
    if not isinstance(files, list) or not files or not all(isinstance(file, str) for file in files):
        return {"": _machine(path, text)}  # which refuses, in words, what is none of these
    rigs: dict[str, MachineFile] = {}
    for of in (path.parent / file for file in files):
        own = _text(of, "file of an implement")
        try:
            if unfilled := _unfilled(own):
                raise MachineError(unfilled)
            whole = joined(text, own)
        except MachineError as error:
            raise MachineError(f"{of}: {error}") from None
        machine_file = _machine(path, whole, of)
        name = machine_file.machine.implement.name or ""
        if name == UNDESCRIBED:
            raise MachineError(f'{of}: name = "{name}" is that of an implement without a file; give another')
        if name in rigs:
            raise MachineError(f'{of}: name = "{name}" is that of another implement too; each needs its own')
        for other in rigs.values():
            own_units = set(machine_file.machine.implement.names)
            if twice := own_units & set(other.machine.implement.names):
                raise MachineError(
                    f"{of}: NAME {min(twice):016X} is in implement.names of {other.machine.implement.name} "
                    "too; it is of one control unit, so leave it out where it is not. What moves from one "
                    "implement to another belongs to neither"
                )
        rigs[name] = machine_file
    return rigs | _undescribed(path, text, path.parent / files[0])


def _undescribed(path: Path, tractor: str, of: Path) -> dict[str, MachineFile]:
    """The tractor with an implement that has no file. of: a file of one whose receivers it may have."""
    own = undescribed(_text(of, "file of an implement"))
    return {UNDESCRIBED: _machine(path, joined(tractor, own), of)}


def _machine(path: Path, text: str, of: Path | None = None) -> MachineFile:
    """of: the implement's file, where it has one."""
    dbc_text = _dbc_text(text, path, of)
    try:
        if _told(text, "implement", "name") and _told(text, "machine", "name") is None:
            raise MachineError("a file of an implement; give the tractor's, which names it in [implements]")
        machine = parse_machine(text, dbc_text)
    except MachineError as error:
        where = path if of is None else f"{path} with {of}"
        raise MachineError(f"{where}: {_unfilled(text) or error}") from None
    if machine.zenoh.config is not None:
        zenoh = machine.zenoh.model_copy(update={"config": str(path.parent / machine.zenoh.config)})
        machine = machine.model_copy(update={"zenoh": zenoh})
    if machine.estimation.field_map is not None:
        at = {"field_map": str(path.parent / machine.estimation.field_map)}
        machine = machine.model_copy(update={"estimation": machine.estimation.model_copy(update=at)})
    return MachineFile(machine, text)


def _dbc_text(text: str, path: Path, of: Path | None) -> str | None:
    """As Machine.dbc_text. of: the implement's file, where it has one."""
    try:
        raw = tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return None  # parse_machine explains what is wrong
    texts: list[str | None] = []
    for keys in DBC_SECTIONS:
        named = (section_of(raw, keys) or {}).get("dbc")
        folder = (of if of is not None and keys[0] == "implement" else path).parent
        texts.append(
            _text(folder / named, f"{'.'.join(keys)}.dbc", otherwise=_ANSI).replace(DBC_BREAK, " ")
            if isinstance(named, str) else None
        )  # fmt: skip
    return None if texts == [None] * len(texts) else DBC_BREAK.join(text or "" for text in texts)


def implement_of(path: Path | str) -> str:
    """The NAME of TRACTOR.toml+NAME; "" where there is none."""
    return _parted(Path(path))[1]


def _parted(path: Path) -> tuple[Path, str]:
    """Of TRACTOR.toml+NAME the file and the name; "" where it has none."""
    file, plus, name = path.name.rpartition("+")
    return (path.with_name(file), name) if plus and file.endswith(".toml") else (path, "")


def _one_of(rigs: Iterable[str]) -> str:
    return f"it pulls one of {', '.join(rigs)}"


def _unfilled(text: str) -> str:
    """Which lines of a draft are still to be filled in; "" if none."""
    lines = [n for n, line in enumerate(text.splitlines(), 1) if _UNFILLED.match(line)]
    if not lines:
        return ""
    place = f"line {lines[0]}" if len(lines) == 1 else f"line {lines[0]} and {len(lines) - 1} more"
    return f'{place} still marked "FILL IN"; write the value of each after its ='


def _told(text: str, section: str, key: str) -> object:
    """What a key says, where the text is good enough to say so; parse_machine explains what is wrong."""
    try:
        found = tomllib.loads(text).get(section)
    except tomllib.TOMLDecodeError:
        return None
    return found.get(key) if isinstance(found, dict) else None


def _text(path: Path, what: str, otherwise: str = "") -> str:
    """A file's text, without the mark that some editors put before it. otherwise: what it is if not UTF-8."""
    try:
        raw = path.read_bytes()
    except IsADirectoryError:
        raise MachineError(f"{path}: a folder; give the path of the {what}") from None
    except OSError as error:
        text = f"{path}: the {what} cannot be read ({reason_of(error)}); check the path"
        raise MachineError(text) from None
    if not raw.strip():
        raise MachineError(f"{path}: the {what} is empty")
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
