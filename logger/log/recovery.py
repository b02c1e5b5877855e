"""Finishes log files that a power cut, a crash or a full disk has left unfinished.

Only what Tilth wrote and what was cut: a file that is whole, or damaged in its middle, is never written to. A
copy gets the index; it takes the place of the original once it has been read back, and until then the
original stays as it was, whatever happens. The bytes of the record that was cut stay in the file, under a
record of a private kind (opcode 128) that every reader of MCAP passes over. Where `rescue` left out what
could not be read, an empty one stands, by which our readers know of the gap.
"""

import contextlib
import io
import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO, Final

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Metadata

from tilth.logger.log.disk import sync_folder
from tilth.logger.log.lock import grows, is_being_written, lock
from tilth.logger.log.mcap_file import (
    HEAD,
    HOLE,
    MAGIC,
    UNREADABLE,
    body_of,
    is_finished,
    names_tilth,
    place_at,
)
from tilth.logger.log.mcap_index import IndexedCopy
from tilth.logger.log.mcap_records import TILTH, McapRecords
from tilth.schemas.flow import EventKind
from tilth.schemas.invocation import command
from tilth.schemas.notices import NoticeCode, Report, notice

COPY: Final = ".recovering"  # behind a file's name: of the copy that is to take its place
_BLOCK: Final = 1 << 20
_LONGEST_HEADER: Final = 1 << 16
# Written anew, or of no use without what they were written for.
_NOT_COPIED: Final = frozenset({
    Opcode.MESSAGE_INDEX, Opcode.DATA_END, Opcode.STATISTICS, Opcode.CHUNK_INDEX, Opcode.ATTACHMENT_INDEX,
    Opcode.METADATA_INDEX, Opcode.SUMMARY_OFFSET, Opcode.FOOTER,
})  # fmt: skip
_COPIED: Final = frozenset(range(1, 256)) - _NOT_COPIED


class NoLog(Exception):
    """The file cannot be finished: it is none of ours, or another program is writing it."""


class Damaged(NoLog):
    """It is damaged in its middle, and was left as it is."""


@dataclass(frozen=True, slots=True)
class Finished:
    """What a file was like and what there is in it."""

    path: Path
    was_whole: bool
    messages: int
    first_ns: int  # log_time of the first and the last message; 0 where there is none
    last_ns: int
    utc_minus_ns: int  # what gives UTC, added to them, as far as it was known when the file ended
    unreadable_bytes: int  # still in the file, in records that readers pass over


def finish(path: Path) -> Finished:
    """Finish a file that was cut; one that is whole is not touched.

    Raises Damaged, NoLog, and OSError where it cannot be read or its copy not be written.
    """
    with _held(path) as file:
        size = os.fstat(file.fileno()).st_size
        written = _written(file, size)
        if written < len(MAGIC) and _head(file, written) == MAGIC[:written]:
            return _begun(path)
        records, found = _read(path, file, size)
        if not records.cut and not records.damaged:
            return found
        if records.damaged or (records.closed and written > records.tail):
            raise Damaged(f"{path}: {_what(records)}")
        kept = 0 if records.ends_in_index else max(0, written - records.tail)
        return _replaced(path, file, size, kept)


def rescue(path: Path, to: Path) -> Finished:
    """Write what can be read of a log of Tilth's to a new file; the log itself is only read.

    Raises NoLog, FileExistsError, OSError.
    """
    with _held(path) as file:
        size = os.fstat(file.fileno()).st_size
        _read(path, file, size)
        with to.open("xb"):
            pass  # nothing is overwritten
        try:
            return _copied(path, file, size, to, 0)
        except BaseException:
            to.unlink(missing_ok=True)
            raise


@contextlib.contextmanager
def _held(path: Path) -> Iterator[BinaryIO]:
    """The file, which nobody else takes meanwhile. Raises NoLog where it is being written, or none."""
    if path.exists() and not path.is_file():  # a pipe would be waited for
        raise NoLog(f"{path}: a folder, a pipe or a device; give a file")
    with path.open("rb") as file:
        try:
            written = not lock(file.fileno()) and grows(file)
        except BlockingIOError:
            written = True
        if written:
            raise NoLog(f"{path}: is being recorded; it is whole when that run has ended")
        yield file


def unfinished(folder: Path) -> list[Path]:
    """Logs of tilth in the folder that want finishing and are not being written, oldest name first."""
    found: list[Path] = []
    if not folder.is_dir():
        return found
    for path in sorted(folder.glob("*.mcap")):
        try:
            if not path.is_file():  # a pipe of that name would be waited for
                continue
            with path.open("rb") as file:
                size = file.seek(0, io.SEEK_END)
                if not is_finished(file, size) and not is_being_written(file) and is_ours(file, size):
                    found.append(path)
        except OSError:  # it will be found again
            continue
    return found


def finish_all(folder: Path, report: Report, ours: Callable[[], Sequence[Path]] = tuple) -> None:
    """Finish what earlier runs could not, and report it of each file. ours: what this program writes
    itself."""
    for copy in folder.glob(f"*{COPY}"):  # of a file that was finished or removed meanwhile
        if not copy.with_suffix("").exists():
            copy.unlink(missing_ok=True)
    for path in unfinished(folder):
        if path in ours():
            continue
        try:
            done = finish(path)
        except FileNotFoundError:  # deleted meanwhile to make room
            continue
        except Exception as error:  # whatever lies there, those after it are finished
            report(EventKind.LOG, notice(NoticeCode.UNFINISHED, file=path.name, why=str(error)))
        else:
            report(EventKind.LOG, notice(NoticeCode.FINISHED, file=path.name, messages=done.messages))


def is_ours(file: BinaryIO, size: int) -> bool:
    """Whether tilth began to write it; a file of which nothing reached the disk may be."""
    file.seek(0)
    head = file.read(_LONGEST_HEADER)
    if not head.strip(b"\0"):
        return True
    if not head.startswith(MAGIC):  # cut within it
        return MAGIC.startswith(head[: len(MAGIC)].rstrip(b"\0"))
    place = place_at(file, len(MAGIC), size)
    if place is not None and place.opcode == Opcode.HEADER:
        return names_tilth(body_of(file, place))
    opcode, length = HEAD.unpack_from(head.ljust(len(MAGIC) + HEAD.size, b"\0"), len(MAGIC))
    cut = opcode == HOLE or length > size - len(MAGIC) - HEAD.size
    return cut or TILTH in head  # within its first record; that is damaged


def _what(records: McapRecords) -> str:
    """What is wrong with a file that is left as it is, and what can be done."""
    faults = [str(fault) for fault in records.faults] or [f"more follows its end, at byte {records.tail:,}"]
    more = f" and at {len(faults) - 1} places more" if len(faults) > 1 else ""
    return (
        f"{faults[0]}{more}; it is left as it is, and `{command('recover')} FILE --out NEW.mcap` writes what "
        "can be read"
    )


def _read(path: Path, file: BinaryIO, size: int) -> tuple[McapRecords, Finished]:
    """Read all of a file, every checksum verified. Raises NoLog, OSError."""
    if _head(file, len(MAGIC)) != MAGIC:
        raise NoLog(f"{path}: is no MCAP file")
    with Path(os.devnull).open("wb") as nowhere:
        records, found = _transferred(path, file, size, nowhere, 0)
    if not records.is_tilths and (found.messages or not is_ours(file, size)):
        raise NoLog(f"{path}: is no log of tilth, and is left as it is; what wrote it may finish it")
    return records, found


def _transferred(
    path: Path, file: BinaryIO, size: int, out: BinaryIO, kept: int
) -> tuple[McapRecords, Finished]:
    """Write what can be read of a file, and an index. kept: bytes at its end that are kept unread."""
    records = McapRecords(file, size, _COPIED, every_byte=True)
    copy, utc_minus_ns, unread = IndexedCopy(out, records.definitions), 0, kept
    for place, data in records:
        if place.opcode == Opcode.CHUNK:
            copy.chunk(body_of(file, place), data)
        elif place.opcode == HOLE:
            copy.record(UNREADABLE, b"")  # tells readers of the copy that something is missing here
            unread += place.end - place.start
        else:
            body = data[HEAD.size :]
            copy.record(place.opcode, body)
            if place.opcode == Opcode.METADATA:
                utc_minus_ns = _utc_minus_ns(body, utc_minus_ns)
    if kept:
        file.seek(records.tail)
        copy.record(UNREADABLE, file.read(kept))
    copy.finish()
    whole = not records.cut and not records.damaged
    unread += records.covered
    return records, Finished(
        path, whole, copy.counts.total(), copy.first_ns, copy.last_ns, utc_minus_ns, unread
    )


def _utc_minus_ns(metadata: bytes, before: int) -> int:
    """By a record of the clocks; that of before by another one."""
    found = Metadata.read(ReadDataStream(io.BytesIO(metadata)))
    if found.name != "clock":
        return before
    try:
        return int(found.metadata.get("utc_minus_t_ns", "0"))
    except ValueError:
        return before


def _replaced(path: Path, file: BinaryIO, size: int, kept: int) -> Finished:
    """Put a copy with its index in the place of a file that was cut. Raises NoLog, OSError."""
    original = Path(os.path.realpath(path))
    copy = original.with_name(original.name + COPY)
    if shutil.disk_usage(original.parent).free < size + _BLOCK:
        raise NoLog(
            f"{path}: there is no room for a copy, {size / 1e6:.1f} MB, which finishing it takes; make room. "
            "It is left as it is"
        )
    try:
        done = _copied(path, file, size, copy, kept)
        now = os.fstat(file.fileno())
        if not now.st_nlink:
            raise FileNotFoundError(None, "it was removed meanwhile", str(path))
        with contextlib.suppress(PermissionError):
            os.chown(copy, now.st_uid, now.st_gid)
        copy.chmod(now.st_mode & 0o7777)
        copy.replace(original)
        sync_folder(original.parent)
    finally:
        copy.unlink(missing_ok=True)
    return done


def _copied(path: Path, file: BinaryIO, size: int, to: Path, kept: int) -> Finished:
    """Write what can be read to a file and read that back. Raises NoLog, OSError."""
    with to.open("wb") as out:
        _, found = _transferred(path, file, size, out, kept)
        out.flush()
        os.fsync(out.fileno())
        with contextlib.suppress(OSError):  # what is read back comes from the disk
            os.posix_fadvise(out.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
    with to.open("rb") as copy:
        again = McapRecords(copy, to.stat().st_size, every_byte=True)
        for _ in again:
            pass
        if again.cut or again.damaged:
            raise NoLog(f"{path}: its copy is not what was written; it is left as it is, use another disk")
    return replace(found, was_whole=False)


def _begun(path: Path) -> Finished:
    """Finish a file of which nothing reached the disk, in place: there is nothing to lose, and the recorder
    that may have made it just now goes on with it."""
    with path.open("r+b") as out:
        out.truncate()
        copy = IndexedCopy(out)
        copy.finish()
        out.flush()
        os.fsync(out.fileno())
    return Finished(path, False, 0, 0, 0, 0, 0)


def _head(file: BinaryIO, length: int) -> bytes:
    file.seek(0)
    return file.read(length)


def _written(file: BinaryIO, size: int) -> int:
    """Where the zeros begin that a power cut has left at its end. Raises OSError."""
    while size:
        start = max(0, size - _BLOCK)
        file.seek(start)
        block = file.read(size - start).rstrip(b"\0")
        if block:
            return start + len(block)
        size = start
    return 0
