"""The logs of one rig while a daemon writes the last of them: frames as soon as they are on the disk.

What calibration needs is not on Zenoh: there are poses, which are made with the very file that is to be found
wrong. The log holds each frame, also those of before somebody began to watch, and outlives whoever watches.
"""

import io
import math
import os
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Metadata

from tilth.logger.log.mcap_file import (
    DAMAGE,
    HEAD,
    MAGIC,
    MESSAGE,
    UNREADABLE,
    RecordPlace,
    body_of,
    is_finished,
    mended,
    next_record,
    place_at,
    unpacked,
    walk,
)
from tilth.logger.log.mcap_summary import summarised
from tilth.logger.log.runs import stored_runs
from tilth.replay.readers.any_log import open_log
from tilth.replay.readers.log import EmptyLog, OpenLog, Record
from tilth.replay.readers.mcap_reader import MACHINE, Channels
from tilth.replay.readers.rig import NO_RECEIVER, on_buses_of
from tilth.schemas.decode import Decoder
from tilth.schemas.flow import Frame, Measurement
from tilth.schemas.machine import Machine
from tilth.schemas.readable import readable

RECENT_NS: Final = 12 * 3600 * 1_000_000_000  # a run that began so long before the present one counts
DAMAGED: Final = "{}: damaged and left out: {}. All else counts."
AWAITED: Final = (
    "{}: its beginning is damaged, where it is said which frames are of which bus. What follows counts once "
    "this file has ended."
)
LOST: Final = "{}: overwritten, or not there any more. What had been read of it counts."
NO_MACHINE: Final = "{} does not count: it is damaged at its beginning, where its machine file stood."


@dataclass(slots=True)
class _Followed:
    """A file that counts, and what it is called now."""

    path: Path
    log: "GrowingLog"
    rig: bool = False  # whether one of the rig's receivers was heard in it


class GrowingLog:
    """One of Tilth's own files. It may be given another name meanwhile; it stays open."""

    def __init__(self, path: Path) -> None:
        """Raises OSError."""
        self._file = path.open("rb")
        self._log = OpenLog(path, "MCAP", self._file, os.fstat(self._file.fileno()).st_size)
        self._channels = Channels(self._log)
        self._learn_channels()  # of a whole file: its first chunk may be damaged
        self._at = len(MAGIC)
        self._looked_at = 0  # bytes of the file, when all of them had been read
        self.finished = False
        self.lost = False  # it is not the file any more that was read until now
        self.waits_for_end = False  # only the index at its end tells what the next chunk holds

    @property
    def read_to_end(self) -> bool:
        """Whether all that was in the file at the last call of `frames` has been read."""
        return self.finished or self._looked_at == self._log.size > 0

    @property
    def skipped(self) -> dict[str, int]:
        """What could not be read, and how often."""
        return dict(self._log.skipped)

    def frames(self) -> Iterator[Frame]:
        """Those that have been written since the last call."""
        try:
            yield from self._new_frames()
        except OSError:
            self.lost = True
            self._finish()

    def _new_frames(self) -> Iterator[Frame]:
        """Raises OSError."""
        if self.finished:
            return
        size = os.fstat(self._file.fileno()).st_size
        if size < self._at:
            raise OSError(f"shorter than what was read of it: {size} bytes")
        if size == self._looked_at:
            return
        self._log.size, self.waits_for_end = size, False
        while not self.finished and self._at < size:
            place = place_at(self._file, self._at, size) or mended(self._file, self._at, size)
            found = None if place is None else self._records(place)
            if place is not None and found is not None:
                self._at = place.end
                if place.opcode in (
                    Opcode.DATA_END,
                    Opcode.FOOTER,
                ):  # what follows tells where things are, and no frame
                    self._finish()
                yield from (record for record in found if isinstance(record, Frame))
            elif self.waits_for_end or not self._pass_over(place, size):
                break
        self._looked_at = size

    def _records(self, place: RecordPlace) -> list[Record] | None:
        """What a record holds; None where it is damaged, or waits_for_end. Raises OSError."""
        if place.opcode != Opcode.CHUNK:
            return [] if place.opcode <= Opcode.DATA_END or place.opcode == UNREADABLE else None
        try:
            data = unpacked(body_of(self._file, place))
            if self._log.skipped and not self._can_read(data):
                return None
            return self._channels.records(data)
        except DAMAGE:
            return None

    def _learn_channels(self) -> bool:
        """From the index at the end; False where there is none yet. Raises OSError."""
        found = list(summarised(self._file, self._log.size))
        for opcode, body in found:
            self._channels.definition(opcode, body)
        return bool(found)

    def _can_read(self, data: bytes) -> bool:
        """Whether all channels of a chunk are known, or as many as ever will be: a damaged one before it may
        have defined them."""
        used, start = set[int](), 0
        padded = data + bytes(MESSAGE.size)
        while start < len(data):
            opcode, length, channel, *_ = MESSAGE.unpack_from(padded, start)
            stop = start + HEAD.size + length
            if opcode == Opcode.MESSAGE:
                used.add(channel)
            else:
                self._channels.definition(opcode, data[start + HEAD.size : stop])
            start = stop
        if used <= self._channels.defined or self._learn_channels():
            return True
        self.waits_for_end = not is_finished(self._file, self._log.size)
        return not self.waits_for_end

    def _pass_over(self, place: RecordPlace | None, size: int) -> bool:
        """Go on behind damage, which is counted; False where a record may only not be written yet.

        place: of the record whose content is damaged; None where none is whole. A whole record behind it
        tells the one from the other: the daemon writes one after another.
        """
        at = next_record(self._file, self._at + 1, size)
        ends = at == size and is_finished(self._file, size)  # nothing more will come
        if place is not None and (place.end == size or place_at(self._file, place.end, size) is not None):
            at = min(at, place.end)  # its length is right
        elif at == size and not ends:
            return False
        self._log.skip("damaged_chunk")
        self._at = at
        if at == size and ends:
            self._finish()
        return True

    def _finish(self) -> None:
        self.finished = True
        self._file.close()

    def close(self) -> None:
        self._file.close()


def opening_machine(path: Path) -> str | None:
    """The text of the machine file at the beginning of a log of Tilth's; None where it is not there, not yet,
    or damaged. Raises OSError."""
    with path.open("rb") as file:
        for place in walk(file, path.stat().st_size):
            if place.opcode == Opcode.CHUNK:
                return None
            if place.opcode == Opcode.METADATA:
                body = body_of(file, place)
                try:
                    record = Metadata.read(ReadDataStream(io.BytesIO(body)))
                except DAMAGE:
                    continue
                if record.name == MACHINE:
                    text: str | None = record.metadata.get("toml")
                    return text
    return None


def _has_chunk(path: Path) -> bool:
    """Whether frames stand in it, which a machine file comes before. Raises OSError."""
    size = path.stat().st_size
    with path.open("rb") as file:
        return any(place.opcode == Opcode.CHUNK for place in walk(file, size))


class FollowedLogs:
    """Which logs count, and what is measured in them, each file once and in order.

    Those of the run that the daemon writes, of later ones, and of runs that began up to RECENT_NS before it;
    all with the daemon's machine file.
    """

    def __init__(
        self, machine: Machine, given: Sequence[Path], buses: Mapping[str, str], begun: Path
    ) -> None:
        """given: logs of earlier driving, of any kind. begun: the file that the daemon writes.

        Raises LogError where it holds no machine file yet, OSError.
        """
        text = opening_machine(begun)
        if text is None:
            raise EmptyLog(f"{begun}: nothing is in it yet; begin once the daemon records")
        self._notes: list[str] = []
        self._machine, self._text, self._buses = machine, text, buses
        self._decoder = Decoder(machine)
        self._written: dict[
            Path, dict[str, int]
        ] = {}  # folder -> runs that the daemon named, and their begin
        self._files: dict[tuple[int, int], _Followed] = {}  # by device and inode: names change
        self._looked: set[tuple[int, int]] = set()
        self._named: set[Path] = set()
        self._given: list[Path] = []
        self.writes(begun)
        self._given = [path for path in given if _key(path) not in self._files]
        self._earlier = list(self._given)  # not read yet
        self._without_rig: list[Path] = []  # of those that were given

    @property
    def notes(self) -> list[str]:
        """What does not count, in sentences."""
        found = list(self._notes)
        for one in self._files.values():
            if one.log.lost:
                found.append(LOST.format(readable(one.path.name)))
            elif one.log.waits_for_end:
                found.append(AWAITED.format(readable(one.path.name)))
            elif count := sum(one.log.skipped.values()):
                found.append(DAMAGED.format(readable(one.path.name), count))
        found += [f"{readable(path.name)} does not count: {NO_RECEIVER}." for path in self._silent()]
        return found

    @property
    def paths(self) -> list[Path]:
        """Of the logs that count, as they are called now."""
        silent = self._silent()
        found = [*self._given, *(one.path for one in self._files.values())]
        return [path for path in found if path not in silent]

    def _silent(self) -> list[Path]:
        """Earlier logs that were read without one of the rig's receivers. In the one that the daemon writes
        they may still come."""
        earlier = list(self._files.values())[:-1]
        files = [one.path for one in earlier if not one.rig and one.log.read_to_end]
        return [*self._without_rig, *files]

    def writes(self, path: Path) -> None:
        """The daemon has named a file that it writes: its folder is looked through again."""
        if path in self._named or not path.exists():
            return
        run = next((run for run in stored_runs(path.parent) if path in run.files), None)
        if run is None:  # somebody gave it another name
            self._look(path)
            return
        self._named.add(path)
        self._written.setdefault(path.parent, {})[run.name] = run.started_ns
        self.rescan()

    def rescan(self) -> None:
        """Take up parts that have been begun, and new names, in folders that are known."""
        for folder, written in self._written.items():
            # A computer that does not know the time yet gives its run none: only what it names counts then.
            first_ns = next((t_ns for t_ns in written.values() if t_ns), math.inf) - RECENT_NS
            for run in stored_runs(folder):
                if run.name in written or run.started_ns >= first_ns:
                    for path in run.files:
                        self._look(path)

    def measurements(self) -> Iterator[Measurement]:
        """Those that have come since the last call. Raises LogError, of logs that were given."""
        while self._earlier:
            yield from self._of_given(self._earlier.pop(0))
        for one in list(self._files.values()):
            for frame in one.log.frames():
                for measurement in self._decoder.measurements(frame):
                    one.rig = one.rig or measurement.origin.mount is not None
                    yield measurement

    def close(self) -> None:
        for one in self._files.values():
            one.log.close()

    def _of_given(self, path: Path) -> Iterator[Measurement]:
        log, rig = open_log(path), False
        with log.file:
            for record in on_buses_of(self._machine, log, self._buses, self._notes.append):
                if isinstance(record, Frame):
                    for measurement in self._decoder.measurements(record):
                        rig = rig or measurement.origin.mount is not None
                        yield measurement
        if not rig:
            self._without_rig.append(path)

    def _look(self, path: Path) -> None:
        """Whether a file counts; said once where it does not."""
        try:
            key = _key(path)
            if key in self._files:
                self._files[key].path = path
                return
            if key in self._looked or any(path.samefile(one) for one in self._given):
                return
            if any(
                one.path == path for one in self._files.values()
            ):  # finished: its copy has taken its place
                self._looked.add(key)
                return
            text = opening_machine(path)
            if text is None and not _has_chunk(path):
                return  # not yet
            self._looked.add(key)
            if text is None:
                self._notes.append(NO_MACHINE.format(readable(path.name)))
            elif text == self._text:
                self._files[key] = _Followed(path, GrowingLog(path))
            else:
                self._notes.append(_other(path, text, self._machine))
        except OSError:
            return  # removed or renamed meanwhile: it is found again by its new name


def _key(path: Path) -> tuple[int, int]:
    """Raises OSError."""
    found = path.stat()
    return found.st_dev, found.st_ino


def _other(path: Path, text: str, machine: Machine) -> str:
    try:
        name = str(tomllib.loads(text)["machine"]["name"])
    except (tomllib.TOMLDecodeError, KeyError, TypeError):
        name = ""
    if name and name != machine.name:
        return f"{readable(path.name)} does not count: it is of another rig, {name}."
    return (
        f"{readable(path.name)} does not count: it was written with another machine file. To go on with that "
        "one, start this command anew."
    )
