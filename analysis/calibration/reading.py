"""The measurements of a drive from logs, by a machine file; its wheel angle where that is read wrongly."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from tilth.replay.readers.any_log import open_log
from tilth.replay.readers.log import EmptyLog
from tilth.replay.readers.rig import Say, on_buses_of
from tilth.replay.wheel_search import WheelCandidate, candidates
from tilth.schemas.decode import Decoder
from tilth.schemas.flow import Frame, Measurement, Mount, Position, YawRate
from tilth.schemas.machine import Machine, WheelAngle

SHOWN_EVERY: Final = 8192  # frames
LIKELY: Final = 0.6  # correlation of a word with the yaw rate, at all speeds together


@dataclass(slots=True)
class LogHeard:
    """What logs hold for calibration."""

    measurements: list[Measurement] = field(default_factory=list)
    first_ns: int = 0
    last_ns: int = 0
    frames: int = 0
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
    for measurement in decoder.measurements(frame):
        heard.measurements.append(measurement)
        if isinstance(measurement, Position) and measurement.origin.mount is None:
            name = f"address {measurement.origin.source} on {measurement.origin.bus}"
            heard.strangers[name] = heard.strangers.get(name, 0) + 1


def wheel_candidate(
    paths: Sequence[Path], machine: Machine, buses: Mapping[str, str], heard: LogHeard
) -> WheelCandidate | None:
    """Where in the message that the file names the wheel angle stands, by the tractor's turn rates; None
    where no word of it goes with them."""
    given = machine.wheel_angle
    if given.id is None:
        return None
    yaw = [
        (m.rx_ns, m.yaw_rate)
        for m in heard.measurements
        if isinstance(m, YawRate) and m.origin.mount in (Mount.TRACTOR_FRONT, Mount.TRACTOR_REAR)
    ]
    times, data = [], []
    for path in paths:
        log = open_log(path)
        with log.file:
            for record in on_buses_of(machine, log, buses, lambda text: None):
                if isinstance(record, Frame) and _is_of(record, given):
                    times.append(record.rx_ns)
                    data.append(record.data)
    if not times:
        return None
    found = list(candidates(given.bus, given.id, given.extended, times, data, yaw))
    best = max(found, key=lambda one: abs(one.yaw_correlation or 0.0), default=None)
    return best if best is not None and abs(best.yaw_correlation or 0.0) >= LIKELY else None


def _is_of(frame: Frame, given: WheelAngle) -> bool:
    same = frame.bus == given.bus and frame.extended == given.extended
    return same and given.id is not None and (frame.can_id ^ given.id) & given.mask == 0


def reading_as(machine: Machine, candidate: WheelCandidate) -> Machine:
    """The machine file with the word of the candidate for its wheel angle."""
    update = {
        "byte_order": candidate.byte_order, "start_byte": candidate.start_byte, "start_bit": None, "bits": 16,
        "signed": candidate.signed,
    }  # fmt: skip
    return machine.model_copy(update={"wheel_angle": machine.wheel_angle.model_copy(update=update)})
