"""Builds tilth.Status, once a second, with every problem in a sentence."""

from collections.abc import Iterable, Mapping

from tilth.logger.can.live_bus import BusState, LiveBus
from tilth.logger.log.run_log import Recording
from tilth.schemas.proto import tilth_pb2 as pb
from tilth.schemas.readable import readable
from tilth.schemas.rejections import Rejection
from tilth.schemas.states import DeviceState, RunHealth

YOUNG_S = 2.0  # receivers send once a second at the slowest: before that, not heard is no problem
LOW_HOURS = 1.0  # of recording left
FRAME_BITS = 142  # of a frame of eight bytes with a long identifier, its usual stuffing and the gap after it
NOMINAL_BYTES_PER_S = 40_000.0  # 800 frames/s of four receivers and a full implement bus, with results

_RECEIVER_PROBLEMS: Mapping[str, str] = {
    DeviceState.WAITING: "not heard yet; check power, bus, and NAME (sent when it is switched on) or source",
    DeviceState.NO_DATA: "heard, but without a position; check antenna and corrections",
    DeviceState.LOST: "no longer heard; check power and plug",
}
_WHEEL_PROBLEMS: Mapping[str, str] = {
    DeviceState.WAITING: "not heard yet; check power, bus, and [wheel_angle] in the machine file",
    DeviceState.LOST: "no longer heard; check power and plug",
}
_GOOD_FIXES = ("rtk_fixed", "precise", "simulated", "")


def bus_status(bus: LiveBus, t_ns: int) -> pb.BusStatus:
    """The row of one bus at t_ns."""
    status = pb.BusStatus(
        name=bus.name,
        state=bus.state,
        frames=bus.traffic.frames,
        frames_per_s=bus.traffic.frames_per_s,
        reopened=max(bus.connection.opened - 1, 0),
        error_frames=bus.tally.error_frames,
        lost_frames=bus.traffic.lost,
        reason=bus.problem,
        stamp=bus.traffic.stamp or "",
        controller=bus.tally.health.state,
        errors=[pb.Count(reason=name, count=n) for name, n in bus.tally.health.counts.items()],
        failures=bus.outages.failures,
        silences=bus.outages.silences,
        load=min(bus.traffic.frames_per_s * FRAME_BITS / bus.config.bitrate, 1.0),
    )
    if bus.state is not BusState.OPEN:
        status.silent_s = (t_ns - bus.traffic.last_ns) * 1e-9
    return status


def log_status(status: pb.Status, recording: Recording) -> None:
    """Whether it is written, where, and how long there is room."""
    status.recording = recording.recording or recording.resting
    status.resting = recording.resting
    files = recording.files  # none yet while a busy disk makes the first one
    status.log_file = str(files[-1].absolute()) if recording.recording and files else ""
    status.log_bytes = recording.size_bytes
    if recording.free_bytes is not None:
        status.disk_free_bytes = recording.free_bytes
        status.hours_left = recording_hours(recording.free_bytes, recording.bytes_per_s)


def rejected(
    of_fold: Mapping[str, int], buses: Iterable[LiveBus], other: Mapping[str, int]
) -> dict[str, int]:
    """Reasons and counts of every layer."""
    counts = dict(of_fold)
    for bus in buses:
        tally = bus.tally
        for reason, count in (
            (Rejection.REMOTE, tally.remote_frames),
            (Rejection.CAN_FD, tally.fd_frames),
            (Rejection.GARBLED, tally.garbled),
        ):
            if count:
                counts[reason] = counts.get(reason, 0) + count
    return counts | {reason: count for reason, count in other.items() if count}


def health_of(status: pb.Status) -> RunHealth:
    """BAD where nothing is recorded, DEGRADED where there is a problem."""
    if not status.recording:
        return RunHealth.BAD
    return RunHealth.DEGRADED if status.problems else RunHealth.GOOD


def problems_of(status: pb.Status, buses: Iterable[LiveBus], recording: Recording, zenoh: str) -> list[str]:
    """What a person should do something about, worst first. zenoh: what is wrong with it, "" if nothing."""
    young = status.uptime_s < YOUNG_S
    found = [recording.problem] if recording.problem else []
    for bus in buses:
        if bus.problem and not (young and bus.untried):
            found.append(f"bus {bus.name} {bus.state}: {bus.problem}")
    found += [] if young else _sensor_problems(status)
    if zenoh:
        found.append(f"zenoh: {zenoh}")
    if status.HasField("hours_left") and status.hours_left < LOW_HOURS:
        minutes = status.hours_left * 60
        found.append(f"disk: {minutes:.0f} minutes of recording left; make room in {recording.folder}")
    return [readable(text) for text in found]  # they name folders


def _sensor_problems(status: pb.Status) -> list[str]:
    """One sentence for all receivers with the same problem: a dead bus has them all."""
    receivers: dict[str, list[str]] = {}
    for receiver in status.receivers:
        name = receiver.mount.replace("_", " ")
        if receiver.state == DeviceState.WAITING and receiver.source >= 0:
            continue  # it is heard, and may need some seconds to its first position
        if receiver.state in _RECEIVER_PROBLEMS:
            receivers.setdefault(_RECEIVER_PROBLEMS[receiver.state], []).append(name)
        elif receiver.fix not in _GOOD_FIXES:
            receivers.setdefault(f"fix is {receiver.fix}, no RTK; check corrections", []).append(name)
    found = [f"{', '.join(names)}: {problem}" for problem, names in receivers.items()]
    if status.wheel_angle.state in _WHEEL_PROBLEMS:
        found.append(f"wheel angle: {_WHEEL_PROBLEMS[status.wheel_angle.state]}")
    return found


def recording_hours(free_bytes: float, bytes_per_s: float | None = None) -> float:
    """Hours of recording that fit, at that rate, or at a nominal one where none is known."""
    return free_bytes / (bytes_per_s or NOMINAL_BYTES_PER_S) / 3600.0
