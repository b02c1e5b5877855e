"""Checks configuration, buses, disk, clock and Zenoh before a run."""

import contextlib
import ctypes
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from zenoh import ZError

from tilth.logger import compiling
from tilth.logger.can.buses import Buses
from tilth.logger.can.live_bus import BusState, LiveBus
from tilth.logger.checks.devices import Devices
from tilth.logger.checks.finding import CheckFinding, Level
from tilth.logger.clock import YEARS, Clock
from tilth.logger.log.lock import lock
from tilth.logger.status import LOW_HOURS, recording_hours
from tilth.logger.warm_start_file import NotUsable, map_of
from tilth.logger.zenoh.session import refusal, try_session, why
from tilth.schemas.axle_loads import axle_loads
from tilth.schemas.machine import Machine
from tilth.schemas.notices import NoticeCode, notice
from tilth.schemas.plausible import GRAVITY, unusual
from tilth.schemas.readable import reason_of
from tilth.schemas.rule_of_thumb import IMPLEMENT_SHARE, TRACTOR_SHARE, yaw_inertia
from tilth.schemas.sentences import notice_sentence
from tilth.schemas.spread import plus_minus

TURN_S = 0.05
OPEN_S = 15.0  # some adapters take two seconds, a server that does not answer ten
NOT_SYNCHRONISED = 5  # TIME_ERROR of adjtimex(2)


def check(machine: Machine, folder: Path, seconds: float) -> list[CheckFinding]:
    """Open each bus and listen for so many seconds to who is there; try the disk, the clock and Zenoh.

    Raises MachineError where a run could not even begin.
    """
    clock = Clock()
    return [
        *_configuration(machine),
        *_field_map(machine, clock),
        *_listen(machine, clock, seconds),
        *_disk(folder, machine.log.keep_free_megabytes * 1e6),
        *_clock(clock),
        *_kernels(),
        _zenoh(machine),
    ]


def _configuration(machine: Machine) -> Iterator[CheckFinding]:
    mounts = ", ".join(receiver.mount.value.replace("_", " ") for receiver in machine.receiver)
    text = f"{machine.name}: buses: {', '.join(bus.name for bus in machine.bus)}; receivers: {mounts}"
    yield CheckFinding("configuration", Level.OK, text)
    yield CheckFinding("loads", Level.OK, _loads(machine))
    yield CheckFinding("yaw inertia", Level.OK, _inertias(machine))
    for rare in unusual(machine):
        yield CheckFinding("machine file", Level.WARNING, rare)


def _field_map(machine: Machine, clock: Clock) -> Iterator[CheckFinding]:
    if machine.estimation.field_map is None:
        return
    try:
        _, age_s = map_of(Path(machine.estimation.field_map), machine, clock.t_ns())
    except NotUsable as why_not:
        yield CheckFinding("field map", Level.WARNING, f"{why_not}; without it the run begins without a map")
    else:
        text = f"{machine.estimation.field_map}: last driven {age_s / 86_400.0:.1f} days ago"
        yield CheckFinding("field map", Level.OK, text)


def _inertias(machine: Machine) -> str:
    """What a rule of thumb says beside the file's, of which no tape can tell."""
    tractor, implement = machine.tractor, machine.implement
    bodies = (
        ("tractor", tractor, tractor.wheelbase, TRACTOR_SHARE),
        ("implement", implement, implement.d.value + implement.e.value, IMPLEMENT_SHARE),
    )
    told = []
    for name, body, length, share in bodies:
        rule, said = yaw_inertia(body.mass.value, length, share), body.yaw_inertia
        told.append(
            f"{name} {plus_minus(said.value, said.sd, bare=True)}, "
            f"by rule of thumb {plus_minus(rule.value, rule.sd, bare=True)}"
        )
    return f"kg m^2, 95 %: {'; '.join(told)}"


def _loads(machine: Machine) -> str:
    """What a scale would show, at rest on level ground."""
    tractor, implement = machine.tractor, machine.implement
    mass = tractor.mass.value, implement.mass.value
    axles = axle_loads(
        tractor.a.value,
        tractor.b.value,
        tractor.c.value,
        implement.d.value,
        implement.e.value,
        *mass,
        GRAVITY,
    )
    shown = [f"{kilograms:.0f} kg" for kilograms in (*mass, *(load / GRAVITY for load in axles))]
    ballast = [
        f"{sum(each.mass.value for each in section.ballast):.0f} kg of ballast on the {body}"
        for body, section in (("tractor", tractor), ("implement", implement))
        if section.ballast
    ]
    counted = f" (with {' and '.join(ballast)})" if ballast else ""
    return (
        f"tractor {shown[0]}, implement {shown[1]}{counted}; on a scale the front axle stands at {shown[2]}, "
        f"the rear one at {shown[3]}, the implement's at {shown[4]}"
    )


def _listen(machine: Machine, clock: Clock, seconds: float) -> Iterator[CheckFinding]:
    # The findings come from the state of the buses, not from what has happened to them.
    buses = Buses(machine.bus, clock, lambda kind, told: None)
    devices = Devices(machine)
    began_ns = opened_ns = clock.t_ns()
    try:
        over = False
        while not over:
            # What came while a busy computer kept this from looking is read at the end.
            over = clock.t_ns() - opened_ns >= seconds * 1e9
            for frame in buses.read(TURN_S):
                devices.take(frame)
            if (
                any(bus.connection.opening for bus in buses.live_buses)
                and opened_ns - began_ns < OPEN_S * 1e9
            ):
                opened_ns, over = clock.t_ns(), False
        findings = [_bus(bus, (clock.t_ns() - opened_ns) * 1e-9) for bus in buses.live_buses]
    finally:
        buses.close()
    yield from findings
    if any(bus.traffic.frames for bus in buses.live_buses):
        yield from devices.findings()


def _bus(bus: LiveBus, seconds: float) -> CheckFinding:
    what = f"bus {bus.name}"
    if bus.state is BusState.FAILED:
        return CheckFinding(what, Level.PROBLEM, bus.reason)
    if bus.traffic.frames == 0:
        text = f"silent for {seconds:.1f} s; check that its devices are on, the bit rate, the plug"
        return CheckFinding(what, Level.PROBLEM, bus.unusable or text)
    text = f"{bus.traffic.frames} frames in {seconds:.1f} s ({bus.traffic.frames / seconds:.0f}/s)"
    if bus.tally.error_frames:
        text += f", {bus.tally.error_frames} of them error frames; check bitrate, termination and wiring"
        return CheckFinding(what, Level.PROBLEM, text)
    return CheckFinding(what, Level.OK, text)


def _disk(folder: Path, keep_free: float) -> Iterator[CheckFinding]:
    """`run` makes the folder; here its nearest existing parent must do."""
    place = next(parent for parent in (folder.absolute(), *folder.absolute().parents) if parent.exists())
    try:
        with tempfile.TemporaryFile(dir=place) as trial:
            trial.write(b"tilth")
            trial.flush()
            began = time.monotonic()
            os.fsync(trial.fileno())
            took_s = time.monotonic() - began
            locked = lock(trial.fileno())
    except OSError as error:
        yield CheckFinding(
            "log folder",
            Level.PROBLEM,
            f"{folder}: not writable ({reason_of(error)}); give another with --log or log.folder",
        )
        return
    yield CheckFinding("log folder", Level.OK, f"{folder}: writable, a sync takes {took_s * 1e3:.0f} ms")
    if not locked:
        unlocked = notice(NoticeCode.UNLOCKED, folder=str(folder))
        yield CheckFinding("log folder", Level.NOTE, notice_sentence(unlocked))
    free = shutil.disk_usage(place).free
    hours = recording_hours(max(0.0, free - keep_free))
    text = f"{free / 1e9:.1f} GB free, about {hours:.0f} hours of recording"
    if hours < LOW_HOURS:
        yield CheckFinding("disk", Level.PROBLEM, f"{text}; make room")
    else:
        yield CheckFinding("disk", Level.OK, text)


def _clock(clock: Clock) -> Iterator[CheckFinding]:
    relation = clock.relation()
    year = time.gmtime(relation.realtime_ns // 1_000_000_000).tm_year
    text = time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime(relation.realtime_ns // 1_000_000_000))
    if year not in YEARS:
        yield CheckFinding(
            "clock",
            Level.PROBLEM,
            f"{text} cannot be; set the clock, or the logs get wrong names and dates",
        )
    elif clock.step_ns(relation):
        yield CheckFinding(
            "clock", Level.PROBLEM, f"{text}, set anew while this check ran; wait until it is right"
        )
    else:
        yield CheckFinding("clock", Level.OK, text)
    if not time.get_clock_info("monotonic").monotonic:
        yield CheckFinding(
            "clock", Level.PROBLEM, "this system has no clock that runs evenly; use another computer"
        )
    synchronised = _synchronised()
    if synchronised is False:
        note = "not synchronised by NTP: dates in the log are as good as the computer's own clock"
        yield CheckFinding("time source", Level.NOTE, note)
    elif synchronised:
        yield CheckFinding("time source", Level.OK, "synchronised by NTP")


def _synchronised() -> bool | None:
    """What the kernel knows of it; None where it cannot be asked."""
    with contextlib.suppress(OSError, AttributeError):
        ask = ctypes.CDLL(None).adjtimex
        answer = int(ask(ctypes.create_string_buffer(512)))  # struct timex of zeros: ask, change nothing
        return None if answer < 0 else answer != NOT_SYNCHRONISED
    return None


def _kernels() -> Iterator[CheckFinding]:
    if not compiling.compiles():
        return
    if not_kept := compiling.why_not_kept():
        yield CheckFinding("kernels", Level.PROBLEM, not_kept)
        return
    from tilth.estimator import kernel_store  # numba's compiler, which takes a second

    yield CheckFinding("kernels", Level.OK, f"compiled once, kept in {kernel_store.folder()}")
    if why_anew := kernel_store.lacking():
        yield CheckFinding("kernels", Level.NOTE, why_anew)


def _zenoh(machine: Machine) -> CheckFinding:
    if refused := refusal(machine):
        return CheckFinding("zenoh", Level.PROBLEM, refused)
    try:
        note = try_session(machine)
    except ZError as error:
        return CheckFinding(
            "zenoh",
            Level.PROBLEM,
            f"no session: {why(error)}; correct [zenoh], or run with --no-zenoh",
        )
    if note:
        return CheckFinding("zenoh", Level.NOTE, note)
    if machine.zenoh.config is not None:
        return CheckFinding(
            "zenoh", Level.OK, f"only for this computer and who has a key, by {machine.zenoh.config}"
        )
    return CheckFinding("zenoh", Level.OK, f"listens on {', '.join(machine.zenoh.listen)}")
