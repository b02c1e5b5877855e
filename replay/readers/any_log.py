"""Opens a log of CAN frames, whatever wrote it; its kind is found from its content, not from its name.

Frames come in file order and are never sorted. Their t_ns are the log's own stamps: nanoseconds since 1970
where it has a date, else since its zero; rx_ns is t_ns except in Tilth's own logs and in EBL. A bus has the
name it has in the log, with "_" for what a machine file cannot name, "can<channel>" where that is a number,
"can0" where there is none. Remote frames, CAN FD frames longer than 8 bytes and frames whose stamp is before
1970 or after 2262 are counted in `skipped`.
"""

import re
from collections.abc import Callable, Container, Iterator
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import BinaryIO, Final, NamedTuple

from mcap.writer import MCAP0_MAGIC

from tilth.replay.readers import can_logs, captures, ebl, mcap_reader, ros_log, stream, text
from tilth.replay.readers.gateway_text import SIGNAL_K
from tilth.replay.readers.log import EmptyLog, ForeignLog, OpenLog, OtherKind, Record, RunPlace
from tilth.replay.readers.table_text import KVASER_ROW, layout_of
from tilth.schemas.bus_name import bus_name
from tilth.schemas.flow import Frame
from tilth.schemas.readable import reason_of

_UTF_16 = (b"\xff\xfe", b"\xfe\xff")  # how a text in it begins
_SNIFFED = 64 * 1024  # bytes looked at, comments not counted

Reader = Callable[[OpenLog, BinaryIO], Iterator[Record]]


def frames(path: Path | str) -> Iterator[Frame]:
    """Frames of a log in file order. Raises LogError."""
    return (record for record in open_log(path).records if isinstance(record, Frame))


def open_log(path: Path | str, topics: Container[str] = ()) -> OpenLog:
    """A log ready to be read; of Tilth's own logs also the snapshots and the results logged on `topics`.

    Raises LogError, here or while its records are read.
    """
    path = Path(path)
    if path.is_dir():
        raise ForeignLog(f"{path}: a folder; give the log files in it")
    if path.exists() and not path.is_file():  # before it is opened: a pipe without a writer waits for one
        raise ForeignLog(f"{path}: a pipe or a device; give a file")
    try:
        file = path.open("rb")
    except OSError as error:
        raise ForeignLog(f"{path}: cannot be read ({reason_of(error)})") from None
    log = OpenLog(path, "", file, path.stat().st_size, topics=topics)
    try:
        log.packed = file.read(len(stream.PACKED)) == stream.PACKED
        kind = _kind(log)
        if log.packed and kind.by_path:
            raise ForeignLog(f"{path}: {kind.name} inside gzip; unpack it first")
    except BaseException:
        file.close()
        raise
    log.form = kind.name
    source = _stream(log) if log.packed or kind.line or kind.by_path else stream.before_zeros(log)
    log.records = _closing(log, kind.read(log, source))
    return log


def readable() -> str:
    """The kinds of log that can be read, in one sentence."""
    names = list(dict.fromkeys(kind.listed or kind.name for kind in KINDS))
    return f"tilth reads {', '.join(names[:-1])} and {names[-1]}, packed by gzip too"


def metadata(log: OpenLog) -> dict[str, dict[str, str]]:
    """Metadata records of one of Tilth's own logs; {} of any other. Ask before reading the records."""
    return mcap_reader.metadata(log) if log.form == MCAP else {}


def place(log: OpenLog) -> RunPlace:
    """The place of a log in its run. Ask before reading the records."""
    found = metadata(log).get("run", {})
    part = found.get("part", "")
    if not part.isdecimal():
        return RunPlace()
    return RunPlace((found.get("id", ""), found.get("started_utc", "")), int(part))


def _stream(log: OpenLog) -> BinaryIO:
    """The log's bytes from the first on, unpacked where gzip packed them."""
    log.file.seek(0)
    return stream.unpacked(log) if log.packed else log.file


def _closing(log: OpenLog, records: Iterator[Record]) -> Iterator[Record]:
    with log.file:
        try:
            first = next(records, None)
            if first is not None:
                records = chain([first], records)
                yield from records if log.form == MCAP else _renamed(log, records)
            elif not log.truncated:
                raise EmptyLog(f"{log.path}: no frame is in it")
        except OtherKind as error:
            raise ForeignLog(f"{error}; {readable()}") from None


def _renamed(log: OpenLog, records: Iterator[Record]) -> Iterator[Record]:
    """Of a log that another program wrote: with buses as a machine file can name them."""
    names: dict[str, str] = {}
    for record in records:
        if isinstance(record, Frame):
            name = names.get(record.bus)
            if name is None:
                if not names and log.form not in _SINCE_1970:
                    log.began(record.t_ns)
                name = names[record.bus] = bus_name(record.bus, names.values())
            if name != record.bus:
                record = replace(record, bus=name)
        yield record


class Kind(NamedTuple):
    """One kind of log: how it begins, or by what a line of it is known, and who reads it."""

    name: str
    read: Reader
    magics: tuple[bytes, ...] = ()
    line: Callable[[str], object] | None = None
    by_path: bool = False  # needs the file itself, not a stream
    listed: str = ""  # to a person, if not by its name


def _mcap(log: OpenLog, stream: BinaryIO) -> Iterator[Record]:
    return ros_log.frames(log) if ros_log.is_one(log) else mcap_reader.records(log)


_ASC = re.compile(r"(date\s.*\d:\d\d|base\s+(hex|dec)|begin\s+triggerblock)", re.IGNORECASE)
_TRC = re.compile(r";\$FILEVERSION|\s*\d+\)\s+\d+(?:\.\d+)?\s+\S")  # 1.0 begins with its comments
_CSV = re.compile(r"timestamp,arbitration_id,extended,remote,error,dlc,data\s*$")
_GVRET = re.compile(r'"?time ?stamp"?[,;\t]"?id"?[,;\t]"?extended', re.IGNORECASE)
_CANEDGE = re.compile(r'"?TimestampEpoch"?[,;\t|]', re.IGNORECASE)
_CL2000 = re.compile(r"timestamp(.)type\1id\1data", re.IGNORECASE)
_KVASER = re.compile(rf"\s*(Kvaser Memorator Log|Time\s+Chan\s+Identifier)|{KVASER_ROW.pattern}")
_BUSMASTER = re.compile(r"\*\*\*(BUSMASTER|PROTOCOL CAN|<Time>)")

MCAP: Final = "MCAP"
_SINCE_1970: Final = (text.FORMS[0].name, "CSV", "SQLite", "pcap", "pcapng", "EBL", ros_log.FORM)
KINDS: Final = (
    Kind(MCAP, _mcap, (MCAP0_MAGIC,), by_path=True, listed="its own .mcap logs"),
    *(Kind(form.name, text.lines, line=form.pattern.match) for form in text.FORMS if form.name),
    Kind("Signal K", text.lines, line=SIGNAL_K.match, listed="Signal K's log of raw data"),
    Kind("ASC", text.asc, line=_ASC.match),
    Kind("BLF", can_logs.blf, (b"LOGG",)),
    Kind("TRC", text.trc, line=_TRC.match),
    Kind("MF4", can_logs.mf4, (b"MDF     ", b"UnFinMF "), by_path=True),
    Kind("CSV", text.table, line=_CSV.match, listed="the CSV files of python-can"),
    Kind("SavvyCAN", text.table, line=_GVRET.match, listed="SavvyCAN (GVRET)"),
    Kind("CANedge", text.table, line=_CANEDGE.match),
    Kind("CL2000", text.table, line=_CL2000.match, listed="CL1000 to CL3000"),
    Kind("Kvaser Memorator", text.kvaser, line=_KVASER.match, listed="the text of a Kvaser Memorator"),
    Kind("BUSMASTER", text.table, line=_BUSMASTER.match, listed="BUSMASTER's log"),
    Kind("table", text.table, line=layout_of, listed="tables whose header names time, identifier and data"),
    Kind("SQLite", can_logs.sqlite, (b"SQLite format 3\0",), by_path=True, listed="its SQLite files"),
    Kind("pcap", captures.pcap, tuple(captures.PCAP), listed="pcap and pcapng of SocketCAN"),
    Kind("pcapng", captures.pcapng, (captures.PCAPNG,), listed="pcap and pcapng of SocketCAN"),
    Kind("EBL", ebl.ebl, (ebl.MAGIC,), listed="Actisense's EBL"),
)
_BY_NAME: Final = {kind.name: kind for kind in KINDS}


def _kind(log: OpenLog) -> Kind:
    """What kind of log this is."""
    if log.size == 0:
        raise EmptyLog(f"{log.path}: an empty file; no frame is in it")
    head = _stream(log).read(len(MCAP0_MAGIC) * 2)
    if log.packed and not head:
        raise ForeignLog(f"{log.path}: a gzip file that is damaged, or cut off at its head; {readable()}")
    for kind in KINDS:
        if head.startswith(kind.magics):
            return kind
    if MCAP0_MAGIC.startswith(head):  # cut off within its first eight bytes
        return _BY_NAME[MCAP]
    found = _text_kind(log)
    log.truncated = False  # what looking has found will be found again
    log.skipped.clear()
    return found


def _text_kind(log: OpenLog) -> Kind:
    """By the first lines of a text that are no comments."""
    if log.file.seek(0) == 0 and not log.packed and log.file.read(2) in _UTF_16:
        raise ForeignLog(f"{log.path}: text in UTF-16, as some Windows editors save it; save it as UTF-8")
    lines = stream.without_zeros(log, _stream(log))
    remaining = _SNIFFED
    comments = 0
    has_text = False
    while remaining > 0 and (line := lines.readline(_SNIFFED)):
        text = line.decode("utf-8-sig", "replace")
        for kind in KINDS:
            if kind.line is not None and kind.line(text):
                return kind
        if text.startswith(";") and ".trc" in log.path.suffixes:
            return _BY_NAME["TRC"]
        if text.isspace() or text.startswith("#"):
            comments += 1
        else:
            remaining -= len(line)
            has_text = True
    if has_text:
        raise ForeignLog(f"{log.path}: not a log of CAN frames that Tilth can read; {readable()}")
    what = "nothing but comments" if comments else "nothing but zero bytes, as a power cut leaves them"
    raise EmptyLog(f"{log.path}: {what}; no frame is in it")
