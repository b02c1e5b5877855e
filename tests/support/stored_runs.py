"""Runs in a log folder."""

from pathlib import Path

from logs import MACHINE, MACHINE_TEXT, some_frames, write_mcap
from loopback import numbered

from tilth.logger.clock import Clock
from tilth.logger.log.mcap_log import ClockReason, LogWriter, RunPart
from tilth.logger.log.runs import StoredRun, stored_runs
from tilth.schemas.channels import CHANNEL
from tilth.schemas.flow import Event
from tilth.schemas.machine_toml import MachineFile
from tilth.schemas.notices import in_words
from tilth.schemas.proto import tilth_pb2 as pb

NAME = "rig_20260301T080000Z"


def part(folder: Path, number: int = 1, name: str = NAME, finish: bool = True) -> Path:
    folder.mkdir(exist_ok=True)
    path = folder / f"{name}_{number:03d}.mcap"
    return write_mcap(path, some_frames(300, number), finish=finish)


def only(folder: Path) -> StoredRun:
    (run,) = stored_runs(folder)
    return run


def drive(folder: Path, *, lost_rear: bool = False) -> list[Path]:
    """Two parts of a run with two sensors, statuses, a mark and a stepped clock."""
    folder.mkdir()
    clock, paths = Clock(), []
    rows = numbered(6000)
    for number in (1, 2):
        path = folder / f"{NAME}_{number:03d}.mcap"
        writer = LogWriter(
            path, MachineFile(MACHINE, MACHINE_TEXT), RunPart("id", number, rows[0].t_ns, "clay, dry")
        )
        writer.clocks(clock, ClockReason.START if number == 1 else ClockReason.NEW_FILE)
        for i, row in enumerate(rows[3000 * (number - 1) : 3000 * number], 3000 * (number - 1)):
            writer.frame(row)
            if i % 100 == 0 and not 1500 < i < 2700:
                writer.message("/gnss/tractor_front", row.t_ns, b"")
            if i % 10 == 0:
                writer.message("/measurement/wheel_angle", row.t_ns, b"")
            if i % 1000 == 999:
                status = pb.Status(t_ns=row.t_ns, uptime_s=1.0 + i * 1e-3)
                status.buses.add(name="can0", lost_frames=3 if lost_rear and i > 4000 else 0)
                status.receivers.add(mount="tractor_front", state="alive")
                status.receivers.add(mount="tractor_rear", state="lost" if lost_rear else "alive")
                status.wheel_angle.state = "alive"
                writer.message("/status", row.t_ns, status.SerializeToString())
        if number == 1:
            mark = Event(rows[2999].t_ns, "mark", in_words("stone"))
            writer.message("/event", mark.t_ns, CHANNEL["/event"].encode(mark))
            clock.offset_ns -= 5_000_000_000
            writer.clocks(clock, ClockReason.STEP)
        writer.close()
        paths.append(path)
    return paths
