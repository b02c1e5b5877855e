"""The binary logs that python-can reads: BLF, MF4, and its own SQLite.

python-can gives float seconds; they are rounded to the microsecond, which is what survives in them.
Importing it takes two seconds (it loads asammdf), so that is done where it is needed.
"""

import logging
import sqlite3
import struct
import zlib
from collections.abc import Iterator
from io import BufferedReader
from typing import TYPE_CHECKING, BinaryIO, cast

from tilth.replay.readers.columns import bus_of
from tilth.replay.readers.log import NO_ZONE, UNREADABLE, ForeignLog, OpenLog, OtherKind, stamp_fault
from tilth.schemas.flow import Frame
from tilth.schemas.invocation import installing

if TYPE_CHECKING:
    import can

# What python-can's readers raise on a file that is cut or damaged.
_DAMAGE = (
    ValueError,
    LookupError,
    TypeError,
    NotImplementedError,
    OverflowError,
    EOFError,
    struct.error,
    zlib.error,
)
_LOCAL_TIME, _ZONE_TOLD = 1, 2  # time flags of an MF4 file


def _frame(message: "can.Message", shift_s: float = 0.0) -> Frame | str:
    """The frame of a message, or why it is none that a decoder wants."""
    if message.is_remote_frame:
        return "remote_frame"
    if len(message.data) > 8:
        return "can_fd_frame"
    if len(message.data) < message.dlc and not message.is_error_frame:
        return UNREADABLE
    t_ns = round((message.timestamp + shift_s) * 1e6) * 1000
    fault = stamp_fault(t_ns)
    if fault:
        return fault
    bus = bus_of("" if message.channel is None else str(message.channel))
    data = bytes(message.data)
    return Frame(
        t_ns, t_ns, bus, message.arbitration_id, message.is_extended_id, message.is_error_frame, data
    )


def blf(log: OpenLog, stream: BinaryIO) -> Iterator[Frame]:
    """Vector's BLF; one whose header tells more bytes than there are, or none at all, was cut."""
    import can
    from can.io.blf import BLFParseError

    class Reader(can.BLFReader):
        """python-can 4.6 reads an object of no length again and again, for ever."""

        def _parse_data(self, data: bytes) -> Iterator[can.Message]:
            end = _whole_objects(data)
            yield from super()._parse_data(data[:end])
            if end < len(data):
                raise BLFParseError("an object is shorter than its header")

    logging.getLogger("can.io.blf").setLevel(logging.ERROR)
    try:
        reader = Reader(stream)
        if reader.start_timestamp:
            log.remark(NO_ZONE)  # it is a SYSTEMTIME
        count = 0
        for message in reader:
            found = _frame(message)
            count += 1
            if isinstance(found, Frame):
                yield found
            else:
                log.skip(found)
    except (*_DAMAGE, BLFParseError):
        log.truncated = True
        return
    fewer = not log.packed and reader.file_size > log.size
    log.truncated = log.truncated or fewer or (count > 0 and reader.object_count == 0)


def _whole_objects(data: bytes) -> int:
    """Where a container's first object begins that is shorter than its header; else its length."""
    at = 0
    while (at := data.find(b"LOBJ", at, at + 8)) >= 0 and at + 16 <= len(data):
        length = int.from_bytes(data[at + 8 : at + 12], "little")
        if length < 16:
            return at
        at += length
    return len(data)


class _Incomplete(logging.Handler):
    """A logging handler that notices asammdf's message about a block that runs past the end of the file."""

    incomplete_block = False

    def emit(self, record: logging.LogRecord) -> None:
        self.incomplete_block = self.incomplete_block or "Incomplete block" in record.getMessage()


def mf4(log: OpenLog, stream: BinaryIO) -> Iterator[Frame]:
    """ASAM MF4 with CAN bus logging, finished or not; read as far as asammdf finds whole blocks."""
    try:
        import asammdf
        from asammdf.blocks.utils import MdfException, count_channel_groups
    except ImportError:
        raise ForeignLog(f"{log.path}: reading MF4 needs one package more: {installing('mf4')}") from None
    import can

    asammdf.set_global_option("raise_on_incomplete_blocks", False)
    ear = _Incomplete()
    logger = logging.getLogger("asammdf")
    logger.addHandler(ear)
    try:
        # Fails on a file without its index, as MDF4 would with far more noise.
        count_channel_groups(cast(BufferedReader, log.file))
        reader = can.MF4Reader(str(log.path))
        yield from _from_binary(log, reader, _start_shift_s(log, reader))
    except (*_DAMAGE, MdfException):
        raise OtherKind(f"{log.path}: an MF4 file whose index is missing or damaged") from None
    finally:
        logger.removeHandler(ear)
    log.truncated = log.truncated or ear.incomplete_block


def _start_shift_s(log: OpenLog, reader: "can.MF4Reader") -> float:
    """What to add to the times of a file that tells its start in local time, s.

    python-can takes that for this computer's. Where the file tells its zone, that is taken off; else the
    start is read as UTC.
    """
    header = reader._mdf.header
    flags = getattr(header, "time_flags", 0)
    if not flags & _LOCAL_TIME:
        return 0.0
    if flags & _ZONE_TOLD:
        start_s = header.abs_time / 1e9 - 60.0 * (header.tz_offset + header.daylight_save_time)
    else:
        log.remark(NO_ZONE)
        start_s = header.abs_time / 1e9
    return start_s - reader._start_timestamp


def sqlite(log: OpenLog, stream: BinaryIO) -> Iterator[Frame]:
    """python-can's SQLite database."""
    import can

    try:
        yield from _from_binary(log, can.SqliteReader(log.path))
    except sqlite3.Error:
        raise OtherKind(f"{log.path}: an SQLite file that python-can did not write") from None


def _from_binary(
    log: OpenLog, reader: "can.MF4Reader | can.SqliteReader", shift_s: float = 0.0
) -> Iterator[Frame]:
    """Frames up to the first damage, which is passed on where no frame came before it."""
    some = False
    with reader:
        try:
            for message in reader:
                found = _frame(message, shift_s)
                some = True
                if isinstance(found, Frame):
                    yield found
                else:
                    log.skip(found)
        except (*_DAMAGE, sqlite3.Error):
            if not some:
                raise
            log.truncated = True
