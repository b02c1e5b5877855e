"""Counts what was recorded and what was lost."""

from tilth.logger.log.disk import Spool
from tilth.logger.log.open_file import OpenFile

SAMPLE_NS = 20_000_000_000  # of recording before its rate is believed


class RecordedCounts:
    """Counts over the files that are no longer written. A file that was finished may still wait for the disk:
    its frames count as recorded until it turns out that they are not."""

    def __init__(self) -> None:
        self.frames = 0  # recorded
        self.missed = 0  # frames that came while nothing could be recorded, or were in what was not written
        self._bytes = 0
        self._recorded_ns = 0
        self._waiting: list[tuple[Spool, int]] = []  # finished, not yet on the disk; and its frames

    def finished(self, file: OpenFile, t_ns: int) -> None:
        """A file was finished at t_ns."""
        self._add_written(file, t_ns)
        self.frames += file.writer.frames
        self._waiting.append((file.spool, file.writer.frames))

    def failed(self, file: OpenFile, t_ns: int) -> None:
        """A file could not be written to its end: what is on the disk is all that there will be."""
        self._add_written(file, t_ns)
        self.frames += file.spool.safe_frames
        self.missed += file.writer.frames - file.spool.safe_frames

    def _add_written(self, file: OpenFile, t_ns: int) -> None:
        self._bytes += file.writer.flushed_bytes
        self._recorded_ns += file.age_ns(t_ns)

    def take_closed(self, at_end: bool) -> list[Spool]:
        """Finished files of which it has turned out since what became of them; at_end: of all of them, also
        those that the disk never took."""
        closed = [each for each in self._waiting if at_end or each[0].closed]
        self._waiting = [each for each in self._waiting if each not in closed]
        for spool, frames in closed:
            self.missed += frames - spool.safe_frames
            self.frames -= frames - spool.safe_frames
        return [spool for spool, _ in closed]

    def size_bytes(self, file: OpenFile | None) -> int:
        """Of all that was recorded, flushed. file: the one that is written."""
        return self._bytes + (file.writer.flushed_bytes if file else 0)

    def bytes_per_s(self, file: OpenFile | None, t_ns: int) -> float | None:
        """While it recorded; None while it is too young to tell."""
        recorded_ns = self._recorded_ns + (file.age_ns(t_ns) if file else 0)
        return self.size_bytes(file) / recorded_ns * 1e9 if recorded_ns > SAMPLE_NS else None
