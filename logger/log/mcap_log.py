"""One MCAP file: raw frames, what was computed from them, and all that is needed to understand it years on.

Topics: /can/<bus> (tilth.CanFrame), the rows of schemas.channels.CHANNELS, /snapshot (tilth.Snapshot).
log_time is the clock's t_ns; publish_time of a frame is its rx_ns. Metadata: machine, tilth, run, clock.
File order is processing order. Used by the daemon (through run_log.py) and by `tilth replay --out`.
"""

import contextlib
import os
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from enum import StrEnum
from pathlib import Path
from typing import IO, cast

from google.protobuf.descriptor import Descriptor
from google.protobuf.message import Message as ProtoMessage
from mcap.writer import CompressionType, Writer

from tilth.logger.clock import Clock, boot_id, utc_text
from tilth.logger.log.lock import lock
from tilth.logger.log.software import software
from tilth.schemas.channels import CHANNEL, file_descriptor_set
from tilth.schemas.flow import Frame, Publication
from tilth.schemas.machine_toml import MachineFile
from tilth.schemas.proto import tilth_pb2 as pb

CAN_TOPIC = "/can/"
SNAPSHOT_TOPIC = "/snapshot"
SIMULATED = "simulated"  # key of the metadata record "run"; absent where a tractor drove


class ClockReason(StrEnum):
    """Why a metadata record "clock" is written; the words stand in it as `why`."""

    START = "start"
    NEW_FILE = "new file"
    STEP = "step"  # the computer's clock was set
    ROTATION = "rotation"  # the file ends, its run goes on in the next one
    IGNITION_OFF = "ignition off"
    NO_ROOM = "no room"
    SLOW_DISK = "the disk does not keep up"
    END = "end"


@dataclass(frozen=True, slots=True)
class RunPart:
    """Which run a file belongs to and the place it has there."""

    id: str
    part: int  # from 1
    started_ns: int  # t_ns of the run's start
    note: str = ""  # what the operator says of it
    simulated: str = ""  # what drove instead of a tractor: a command


class LogWriter:
    """Writes one file. Every method may raise OSError; a file that did so is spoilt beyond its last flush."""

    def __init__(
        self, path: Path, machine_file: MachineFile, run: RunPart, stream: IO[bytes] | None = None
    ) -> None:
        """stream: takes the bytes instead of a file made here. Raises FileExistsError: a log is never
        overwritten."""
        self.path = path
        self.frames = 0
        self.flushed_bytes = 0
        self._machine_sha256, machine = machine_file.sha256, machine_file.machine
        self._stream: IO[bytes] = _new_file(path) if stream is None else stream
        self._writer = Writer(
            self._stream,
            chunk_size=machine.log.chunk_kilobytes * 1024,
            compression=CompressionType.ZSTD,
            enable_data_crcs=True,
        )
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._raw = pb.CanFrame()
        self._writer.start(profile="", library=f"tilth {software()['version']}")
        self.metadata("machine", _machine_metadata(machine_file))
        self.metadata("tilth", software())
        run_metadata = {"id": run.id, "part": str(run.part), "started_utc": utc_text(run.started_ns)}
        told = {"note": run.note, SIMULATED: run.simulated}
        self.metadata("run", run_metadata | {key: text for key, text in told.items() if text})

    def frame(self, frame: Frame) -> None:
        """Log a raw frame."""
        raw = self._raw
        raw.rx_ns = frame.rx_ns
        raw.can_id = frame.can_id
        raw.extended = frame.extended
        raw.error = frame.error
        raw.data = frame.data
        channel = self._channels.get(frame.bus) or self._can_channel(frame.bus)
        self._writer.add_message(channel, frame.t_ns, raw.SerializeToString(), frame.rx_ns)
        self.frames += 1

    def publications(self, publications: Iterable[Publication]) -> None:
        """Encode and log; for who needs the bytes as well there is `message`."""
        for publication in publications:
            data = CHANNEL[publication.topic].encode(publication.value)
            self.message(publication.topic, publication.t_ns, data)

    def message(self, topic: str, t_ns: int, data: bytes) -> None:
        """Log the bytes of one publication; `topic` is a row of CHANNELS."""
        channel = self._channels.get(topic) or self._register(topic, topic, CHANNEL[topic].message)
        self._writer.add_message(channel, t_ns, data, t_ns)

    def snapshot(self, t_ns: int, state_json: str) -> None:
        """Log the fold's state as it is before the next frame."""
        snapshot = pb.Snapshot(t_ns=t_ns, machine_sha256=self._machine_sha256, state_json=state_json)
        channel = self._register(SNAPSHOT_TOPIC, SNAPSHOT_TOPIC, pb.Snapshot)
        self._writer.add_message(channel, t_ns, snapshot.SerializeToString(), t_ns)

    def clocks(self, clock: Clock, why: ClockReason) -> None:
        """Log what the computer's clocks and the receivers say. utc_minus_t_ns is the best that is known of
        UTC: it added to a t_ns gives UTC."""
        numbers = {key: str(value) for key, value in asdict(clock.relation()).items()}
        numbers["utc_minus_t_ns"] = str(clock.correction_ns)
        if clock.gnss_ahead_ns is not None:
            numbers["gnss_utc_minus_t_ns"] = str(clock.gnss_ahead_ns)
        self.metadata("clock", {"why": why, "boot_id": boot_id(), **numbers})

    def metadata(self, name: str, data: Mapping[str, str]) -> None:
        """Write a metadata record."""
        self._writer.add_metadata(name, dict(data))

    def flush(self) -> None:
        """Close the chunk and hand all bytes to the operating system; whoever wants them on disk syncs."""
        self._writer.flush()
        self.flushed_bytes = self._stream.tell()

    def finish(self) -> None:
        """Write the index; the file is whole then."""
        self._writer.finish()
        self._stream.flush()
        self.flushed_bytes = self._stream.tell()

    def close(self) -> None:
        """Finish, sync and close."""
        with self._stream as stream:
            self.finish()
            os.fsync(stream.fileno())

    def abandon(self) -> None:
        """Give up a file that can no longer be written: what is on disk stays, readable to its last chunk."""
        # What the buffer still holds cannot be written either: that is why the file is abandoned.
        with contextlib.suppress(OSError):
            self._stream.close()

    def _can_channel(self, bus: str) -> int:
        # Bus names cannot begin with "/", so that topics and bus names share one table.
        return self._register(bus, CAN_TOPIC + bus, pb.CanFrame)

    def _register(self, key: str, topic: str, message: type[ProtoMessage]) -> int:
        name = message.DESCRIPTOR.full_name
        if name not in self._schemas:
            data = file_descriptor_set(cast(Descriptor, message.DESCRIPTOR))
            self._schemas[name] = self._writer.register_schema(name, "protobuf", data)
        channel = self._writer.register_channel(topic, "protobuf", self._schemas[name])
        self._channels[key] = channel
        return channel


def _new_file(path: Path) -> IO[bytes]:
    stream = path.open("xb")
    lock(stream.fileno())  # nobody takes it for one that was left unfinished
    return stream


def _machine_metadata(of: MachineFile) -> dict[str, str]:
    dbc = of.machine.dbc_text or ""
    return {"name": of.machine.name, "toml": of.text, "dbc": dbc, "sha256": of.sha256}
