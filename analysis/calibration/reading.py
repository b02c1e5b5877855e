"""The measurements of a drive from logs by a machine file, and the messages that may hold the wheel angle."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from tilth.replay.readers.any_log import open_log
from tilth.replay.readers.log import EmptyLog
from tilth.replay.readers.rig import Say, on_buses_of
from tilth.replay.wheel_by_way import WheelMessages
from tilth.schemas.decode import Decoder
from tilth.schemas.flow import Frame, Measurement, Position
from tilth.schemas.machine import Machine

SHOWN_EVERY: Final = 8192  # frames


@dataclass(slots=True)
class LogHeard:
    """What logs hold for calibration."""

    measurements: list[Measurement] = field(default_factory=list)
    first_ns: int = 0
    last_ns: int = 0
    frames: int = 0
    messages: WheelMessages = field(default_factory=WheelMessages)
    strangers: dict[str, int] = field(
        default_factory=dict
    )  # senders of positions that the file does not name


def read(
    paths: Sequence[Path], machine: Machine, buses: Mapping[str, str], say: Say,
    progress: Callable[[int, int], None],
) -> LogHeard:  # fmt: skip
    """Raises LogError, OSError, MachineError."""
    heard, decoder = LogHeard(), Decoder(machine)
    whole, before = sum(path.stat().st_size for path in paths), 0
    for path in paths:
        log = open_log(path)
        with log.file:
            for record in on_buses_of(machine, log, buses, say):
                if isinstance(record, Frame):
                    _take(heard, decoder, record)
                    if heard.frames % SHOWN_EVERY == 0:
                        progress(before + log.position(), whole)
        before += log.size
    if not heard.frames:
        raise EmptyLog(f"{paths[0]}: no frame is in it")
    return heard


def _take(heard: LogHeard, decoder: Decoder, frame: Frame) -> None:
    heard.first_ns = heard.first_ns or frame.t_ns
    heard.last_ns = frame.t_ns
    heard.frames += 1
    heard.messages.take(frame)
    for measurement in decoder.measurements(frame):
        heard.measurements.append(measurement)
        if isinstance(measurement, Position) and measurement.origin.mount is None:
            name = f"address {measurement.origin.source} on {measurement.origin.bus}"
            heard.strangers[name] = heard.strangers.get(name, 0) + 1
