"""Opens a log of CAN frames, whatever wrote it; the kind is told by its content, not by its name.

Frames come in file order and are never sorted. Their t_ns are the log's own stamps: nanoseconds since 1970
where it has a date, else since its zero; rx_ns is t_ns except in Tilth's own logs. A bus is called what the
log calls it, "can<channel>" where that is a number, "can0" where nothing is said. Remote frames and CAN FD
frames longer than 8 bytes are counted in `skipped`.
"""

import gzip
import re
import zlib
from collections.abc import Callable, Container, Iterator
from pathlib import Path
from typing import BinaryIO, cast

from mcap.writer import MCAP0_MAGIC

from tilth.replay import canboat_text, mcap_reader, readers_can
from tilth.replay.readers_log import READABLE, EmptyLog, ForeignLog, Log, Place, Record
from tilth.schemas.flow import Frame

_SNIFFED = 64 * 1024  # bytes looked at: comments before the first frame may be long
_ASC = re.compile(r"(date\s+\w+\s+\S|base\s+(hex|dec)|begin\s+triggerblock)", re.IGNORECASE)
_CSV = "timestamp,arbitration_id,extended,remote,error,dlc,data"

Reader = Callable[[Log, BinaryIO], Iterator[Record]]


def frames(path: Path | str) -> Iterator[Frame]:
    """Frames of a log in file order. Raises LogError."""
    return (record for record in open_log(path).records if isinstance(record, Frame))


def open_log(path: Path | str, topics: Container[str] = ()) -> Log:
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
        raise ForeignLog(f"{path}: cannot be read ({(error.strerror or str(error)).lower()})") from None
    log = Log(path, "", file, path.stat().st_size, topics)
    try:
        stream, head = _unpacked(log)
        log.form, read = _kind(log, head)
        if stream is not file and read in _BY_PATH:
            raise ForeignLog(f"{path}: {log.form} inside gzip; unpack it first")
    except BaseException:
        file.close()
        raise
    log.records = _closing(log, read(log, stream))
    return log


def metadata(log: Log) -> dict[str, dict[str, str]]:
    """Metadata records of one of Tilth's own logs; {} of any other. Ask before reading the records."""
    return mcap_reader.metadata(log) if log.form == MCAP else {}


def place(log: Log) -> Place:
    """The place of a log in its run. Ask before reading the records."""
    found = metadata(log).get("run", {})
    part = found.get("part", "")
    if not part.isdecimal():
        return Place()
    return Place((found.get("id", ""), found.get("started_utc", "")), int(part))


def _unpacked(log: Log) -> tuple[BinaryIO, bytes]:
    """The log's bytes, unpacked where gzip packed them, and the first of them."""
    if log.size == 0:
        raise EmptyLog(f"{log.path}: an empty file; no frame is in it")
    packed = log.file.read(2) == b"\x1f\x8b"
    log.file.seek(0)
    stream = cast(BinaryIO, gzip.GzipFile(fileobj=log.file)) if packed else log.file
    try:
        head = stream.read(_SNIFFED)
    except (EOFError, OSError, zlib.error):
        raise ForeignLog(f"{log.path}: a damaged gzip file; {READABLE}") from None
    stream.seek(0)
    return stream, head


def _closing(log: Log, records: Iterator[Record]) -> Iterator[Record]:
    with log.file:
        first = next(records, None)
        if first is not None:
            yield first
            yield from records
        elif not log.truncated:
            raise EmptyLog(f"{log.path}: no frame is in it")


def _mcap(log: Log, stream: BinaryIO) -> Iterator[Record]:
    return mcap_reader.records(log)


def _lines(log: Log, stream: BinaryIO) -> Iterator[Record]:
    with readers_can.text(stream) as lines:
        yield from canboat_text.frames(lines, log)


MCAP = "MCAP"
_BINARY: tuple[tuple[bytes, str, Reader], ...] = (
    (MCAP0_MAGIC, MCAP, _mcap),
    (b"LOGG", "BLF", readers_can.blf),
    (b"MDF     ", "MF4", readers_can.mf4),
    (b"UnFinMF ", "MF4", readers_can.mf4),
    (b"SQLite format 3\0", "SQLite", readers_can.sqlite),
)
_BY_PATH = (_mcap, readers_can.mf4, readers_can.sqlite)  # need the file itself, not a stream


def _kind(log: Log, head: bytes) -> tuple[str, Reader]:
    """What kind of log begins with `head`, and how it is read."""
    for magic, name, reader in _BINARY:
        if head.startswith(magic):
            return name, reader
    if MCAP0_MAGIC.startswith(head):  # cut off within its first eight bytes
        return MCAP, _mcap
    if b"\0" not in head:
        lines = head.decode("utf-8", "replace").splitlines()
        found = _text_kind(lines, log.path.suffixes)
        if found is not None:
            return found
        if all(not line.strip() or line.startswith("#") for line in lines):
            raise EmptyLog(f"{log.path}: nothing but comments; no frame is in it")
    raise ForeignLog(f"{log.path}: not a log of CAN frames that is known here; {READABLE}")


def _text_kind(lines: list[str], suffixes: list[str]) -> tuple[str, Reader] | None:
    for line in lines:
        form = canboat_text.form_of(line)
        if form is not None:
            return form, _lines
        if _ASC.match(line):
            return "ASC", readers_can.asc
        if line.startswith(";$FILEVERSION") or (line.startswith(";") and ".trc" in suffixes):
            return "TRC", readers_can.trc
        if line.strip() == _CSV:
            return "CSV", readers_can.csv
    return None
