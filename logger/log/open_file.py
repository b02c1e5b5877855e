"""One file of a run while it is written."""

from typing import IO, cast

from tilth.logger.log.disk import Spool
from tilth.logger.log.mcap_log import LogWriter, RunPart
from tilth.schemas.log_settings import Log
from tilth.schemas.machine_toml import MachineFile


class OpenFile:
    """The writer of the format, and the spool that brings its bytes to the disk."""

    def __init__(self, spool: Spool, machine_file: MachineFile, run: RunPart, begun_ns: int) -> None:
        self.spool = spool
        self.writer = LogWriter(spool.path, machine_file, run, cast(IO[bytes], spool))
        self.begun_ns = begun_ns

    def age_ns(self, t_ns: int) -> int:
        """How long the file has been written at t_ns, ns."""
        return t_ns - self.begun_ns

    def is_due(self, t_ns: int, log: Log) -> bool:
        """Whether it is time for the next file."""
        large = self.writer.flushed_bytes >= log.rotate_megabytes * 1e6
        return large or self.age_ns(t_ns) >= log.rotate_minutes * 60e9

    def flush(self) -> None:
        """Hand all that was written to the disk's thread."""
        self.writer.flush()
        self.spool.send(self.writer.frames)

    def finish(self) -> None:
        """Write the index and close."""
        self.writer.finish()
        self.spool.send(self.writer.frames)
        self.spool.close()
