"""A run as the daemon logs it, of the drive of stage.py: rows of 37.5 s and half circles of 5.9 s between,
soil that holds less from its middle on, marks. Quick to write: nothing is estimated."""

from collections.abc import Iterator
from itertools import islice
from pathlib import Path

from logs import MACHINE, MACHINE_TEXT
from stage import ORDERS, drive, estimate, pose, status

from tilth.logger.clock import utc_text
from tilth.logger.log.mcap_log import LogWriter, RunPart
from tilth.logger.log.runs import STAMP
from tilth.schemas.channels import CHANNEL
from tilth.schemas.flow import Event, Frame
from tilth.schemas.machine_toml import MachineFile
from tilth.schemas.notices import in_words

SECOND = 1_000_000_000
START_NS = 1_795_248_000 * SECOND
FIRM, SOFT = 1.0, 0.6  # of the stiffnesses, before and after the middle
MARKS = ((20.0, "wet spot"), (75.0, "stone"))
TURN_S = 37.5  # where the first turn begins
EVERY_S = 43.4  # about: from one turn to the next


def logged(seconds: float, start_ns: int = START_NS) -> Iterator[tuple[str, int, bytes]]:
    """(topic, t_ns, data) of a run; the topic of a frame is ""."""
    marks = dict(MARKS)
    for tenth, point in enumerate(islice(drive(0.1), round(10 * seconds) + 1)):
        t_s = tenth / 10
        t_ns = start_ns + round(t_s * SECOND)
        yield "", t_ns, tenth.to_bytes(8, "little")
        yield "/pose", t_ns, CHANNEL["/pose"].encode(pose(t_ns, point, ""))
        if tenth % 10 == 0:
            scale = FIRM if t_s < seconds / 2 else SOFT
            yield "/soil_tire", t_ns, CHANNEL["/soil_tire"].encode(estimate(t_ns, t_s, scale, 100.0 + t_s))
            yield "/status", t_ns, status(t_ns, t_s, ORDERS).SerializeToString()
        if t_s in marks:
            yield (
                "/event",
                t_ns,
                CHANNEL["/event"].encode(Event(t_ns, "mark", in_words(marks[t_s]), 43.5, -83.4)),
            )


def write_run(
    folder: Path,
    seconds: float = 120.0,
    *,
    start_ns: int = START_NS,
    results: bool = True,
    parts: int = 1,
    finish: bool = True,
    name: str = MACHINE.name,
    note: str = "",
    text: str = MACHINE_TEXT,
) -> list[Path]:
    """results: all that is published, or frames alone. finish: else the last part has no end. text: of the
    machine file in it."""
    log = MACHINE.log.model_copy(update={"chunk_kilobytes": 16})
    machine = MACHINE.model_copy(
        update={"log": log, "machine": MACHINE.machine.model_copy(update={"name": name})}
    )
    text = text.replace(f'"{MACHINE.name}"', f'"{name}"')
    run = f"{name}_{utc_text(start_ns, STAMP)}"
    rows = list(logged(seconds, start_ns))
    each = -(-len(rows) // parts)
    paths = []
    for part in range(parts):
        path = folder / f"{run}_{part + 1:03d}.mcap"
        writer = LogWriter(path, MachineFile(machine, text), RunPart(f"id {run}", part + 1, start_ns, note))
        for topic, t_ns, data in rows[part * each : (part + 1) * each]:
            if not topic:
                writer.frame(Frame(t_ns, t_ns, "can0", 0x18FF0001, True, False, data))
            elif results:
                writer.message(topic, t_ns, data)
        if finish or part + 1 < parts:
            writer.close()
        else:
            writer.flush()
            writer.abandon()
        paths.append(path)
    return paths
