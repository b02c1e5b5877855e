"""The measurements of a drive from logs by a machine file, the messages that may hold the wheel
angle, and the commands of an automatic steering."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from tilth.estimator.calibration.calibrate import CannotCalibrate
from tilth.estimator.pose.geometry import to_plane
from tilth.replay.readers.any_log import open_log
from tilth.replay.readers.log import EmptyLog, LogError
from tilth.replay.readers.rig import LEFT_OUT, NO_RECEIVER, Say, machine_in, on_buses_of
from tilth.replay.steering_commands import SteeringCommands
from tilth.replay.wheel_by_way import WheelMessages
from tilth.schemas.can_id import split
from tilth.schemas.decode import Decoder
from tilth.schemas.flow import Frame, Measurement, Origin, Position
from tilth.schemas.machine import Machine, MachineError

SHOWN_EVERY: Final = 8192  # frames
SECOND_NS: Final = 1_000_000_000
BESIDE_NS: Final = 2_000_000_000  # within which both are heard
POSITIONS: Final = (65267, 129025)  # messages of one frame that hold one
FEWEST_SECONDS: Final = 30  # of positions
FARTHEST_M: Final = 30.0  # between receivers of one rig


@dataclass(slots=True)
class OtherSender:
    """Of positions that the machine file does not name, about one a second."""

    bus: str
    words: str  # who it is
    last_ns: int = 0
    count: int = 0
    alone: int = 0  # of them, after the rig has gone silent in the same log
    metres: list[float] = field(default_factory=list)  # from a receiver of the rig

    @property
    def of_another_rig(self) -> str:
        """Why it stands on another rig; "" where it may be one more receiver of this one."""
        if len(self.metres) >= FEWEST_SECONDS and float(np.median(self.metres)) > FARTHEST_M:
            return f"{np.median(self.metres):.0f} m away from the rig most of the time"
        if self.alone >= FEWEST_SECONDS and self.alone > len(self.metres):
            return "heard after the rig's receivers have fallen silent"
        return ""


@dataclass(slots=True)
class LogHeard:
    """What logs hold for calibration."""

    measurements: list[Measurement] = field(default_factory=list)
    first_ns: int = 0
    last_ns: int = 0
    frames: int = 0
    messages: WheelMessages = field(default_factory=WheelMessages)
    commands: SteeringCommands = field(default_factory=SteeringCommands)
    strangers: dict[tuple[str, int], OtherSender] = field(default_factory=dict)  # by bus and address
    last_at: tuple[int, tuple[float, float]] | None = None  # of the rig in this log: ns, degrees north, east
    rig: bool = False  # whether a receiver of the rig was heard at all


def read(
    paths: Sequence[Path], machine: Machine, buses: Mapping[str, str], say: Say,
    progress: Callable[[int, int], None], *, growing: bool = False,
) -> LogHeard:  # fmt: skip
    """growing: the last one is still being written, so it has no end.

    Raises LogError, OSError, MachineError; CannotCalibrate where it is of two rigs.
    """
    heard, decoder = LogHeard(), Decoder(machine)
    for k, path in enumerate(paths):
        if any(path.samefile(other) for other in paths[:k]):
            raise CannotCalibrate(f"{path} is given twice")
    _check_same_receivers(paths)
    earlier: tuple[Path, int] | None = None
    whole, before = sum(path.stat().st_size for path in paths), 0
    for path in paths:
        log = open_log(path)
        heard.last_at = None
        with log.file:
            frames = (r for r in on_buses_of(machine, log, buses, say) if isinstance(r, Frame))
            for number, frame in enumerate(frames):
                if earlier is not None and not number:
                    _check_order(path, earlier, frame.t_ns)
                _take(heard, decoder, frame)
                if heard.frames % SHOWN_EVERY == 0:
                    progress(before + log.position(), whole)
        for text in log.lacks() if not (growing and path == paths[-1]) else ():
            say(f"{path}: {text}")
        if heard.last_at is None and len(paths) > 1:
            say(f"{path.name} does not count: {NO_RECEIVER}")
        before += log.size
        earlier = path, heard.last_ns
    if not heard.frames:
        left_out = ", whose buses are left out" if LEFT_OUT in buses.values() else ""
        raise EmptyLog(f"{paths[0]}: no frame is in it{left_out}")
    _check_one_rig(heard, machine, buses)
    return heard


def _take(heard: LogHeard, decoder: Decoder, frame: Frame) -> None:
    heard.first_ns = heard.first_ns or frame.t_ns
    heard.last_ns = frame.t_ns
    heard.frames += 1
    heard.messages.take(frame)
    heard.commands.take(frame)
    for measurement in decoder.measurements(frame):
        heard.measurements.append(measurement)
        if isinstance(measurement, Position) and measurement.origin.mount is not None:
            heard.rig = True
            heard.last_at = measurement.rx_ns, (measurement.latitude_deg, measurement.longitude_deg)
            # Its NAME may have been heard late: what it sent before was its own.
            heard.strangers.pop((measurement.origin.bus, measurement.origin.source), None)
    if frame.extended and split(frame.can_id).pgn in POSITIONS:
        _take_stranger(heard, decoder, frame)


def _take_stranger(heard: LogHeard, decoder: Decoder, frame: Frame) -> None:
    """Where a sender is that the machine file does not name."""
    origin = decoder.origin(frame.bus, frame.can_id & 0xFF)
    if origin.mount is not None:
        return
    other = heard.strangers.setdefault((origin.bus, origin.source), OtherSender(origin.bus, _words(origin)))
    if 0 <= frame.rx_ns - other.last_ns < SECOND_NS:
        return
    for message in Decoder().messages(frame):
        if "latitude_deg" not in message.values or "longitude_deg" not in message.values:
            continue
        here = float(message.values["latitude_deg"]), float(message.values["longitude_deg"])
        other.last_ns, other.words = frame.rx_ns, _words(origin)
        other.count += 1
        if heard.last_at is None:
            continue  # before the rig is heard nobody knows whose it is
        if abs(frame.rx_ns - heard.last_at[0]) > BESIDE_NS:
            other.alone += 1
        else:
            other.metres.append(math.hypot(*to_plane(heard.last_at[1], *here)))


def _words(origin: Origin) -> str:
    name = "" if origin.name is None else f" (NAME {origin.name:016X})"
    return f"address {origin.source} on {origin.bus}{name}"


def _check_one_rig(heard: LogHeard, machine: Machine, buses: Mapping[str, str]) -> None:
    """Raises CannotCalibrate."""
    others = [o for _, o in sorted(heard.strangers.items()) if o.of_another_rig]
    if not others:
        return
    said = ", ".join(f"{o.words}, {o.of_another_rig}" for o in others)
    theirs = {o.bus for o in others} - {r.bus for r in machine.receiver}
    in_log = {ours: name for name, ours in buses.items()}
    out = " ".join(f"--bus {in_log.get(bus, bus)}=" for bus in sorted(theirs))
    raise CannotCalibrate(
        f"two rigs are in this: the receivers at {said}, are none of the machine file; give the logs of one "
        "rig" + (f", or leave the other's bus out with {out}" if out else "")
    )


def _check_order(path: Path, before: tuple[Path, int], first_ns: int) -> None:
    if first_ns < before[1] - SECOND_NS:
        raise CannotCalibrate(
            f"{path} begins before {before[0]} ends: they are of two rigs, or of two computers on one; give "
            "the logs of one recorder in their order"
        )


def _check_same_receivers(paths: Sequence[Path]) -> None:
    """By the machine files in the logs, as far as there are any."""
    seen: dict[frozenset[tuple[str, int | None, int | None]], Path] = {}
    for path in paths:
        try:
            machine = machine_in([path], plausible=False).machine
        except (LogError, MachineError):
            continue
        seen.setdefault(frozenset((r.bus, r.name, r.source) for r in machine.receiver), path)
    if len(seen) > 1:
        one, other = list(seen.values())[:2]
        raise CannotCalibrate(
            f"{one} and {other} are of two rigs: by the machine files in them they have other receivers; "
            "give the logs of one"
        )
