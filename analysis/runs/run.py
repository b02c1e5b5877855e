"""Runs of the daemon, opened for analysis: what was measured, computed and noted, as arrays.

    run, = tilth.analysis.open("logs/2026-05-04_0801_001.mcap")
    run.poses["tractor_yaw_rate_radps"]

A file is read when something of it is asked for. A log that holds no poses, as those of other programs do, is
replayed first, and the replayed log is kept (replayed.py).
"""

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Final

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.records import Metadata
from numpy.typing import NDArray

from tilth.analysis.runs.given_once import check_given_once
from tilth.analysis.runs.kept import Progress, Say, no_progress, silent
from tilth.analysis.runs.log_file import DAEMON_RUN, LogFile
from tilth.analysis.runs.reading import ChannelReader, RunClock, indexed_topics
from tilth.analysis.runs.replayed import replayed
from tilth.analysis.runs.table import Table, joined
from tilth.logger.log.mcap_file import DAMAGE, MAGIC
from tilth.logger.log.mcap_summary import metadata_bodies
from tilth.replay.glance import FileState, brief
from tilth.replay.readers.any_log import MCAP, open_log
from tilth.replay.readers.log import EmptyLog, ForeignLog
from tilth.replay.readers.rig import machine_in
from tilth.replay.simulated import REPLAY, SAID, simulated_by
from tilth.schemas.channels import CHANNEL
from tilth.schemas.flow import EventKind
from tilth.schemas.machine import Machine
from tilth.schemas.machine_toml import MachineFile
from tilth.schemas.proto import tilth_pb2 as pb
from tilth.schemas.readable import readable

MARK: Final = EventKind.MARK  # kind of the events that an operator makes
RECOMMENDED: Final = "recommended"


@dataclass
class Run:
    """One run: the files of one start of the daemon, or one log of another program.

    Times are seconds since `start_ns`, the first record of the run, and UTC in seconds since 1970, NaN where
    it is not known.
    """

    id: str
    sources: tuple[Path, ...]  # as given
    files: tuple[LogFile, ...]  # in order; a replayed log where the sources hold no poses
    machine_file: MachineFile
    note: str = ""
    say: Say = silent  # takes sentences about what cannot be read
    reader: ChannelReader = field(init=False)

    @property
    def machine(self) -> Machine:
        """What the machine file says."""
        return self.machine_file.machine

    def __post_init__(self) -> None:
        clocks = [file.metadata["clock"] for file in self.files if "clock" in file.metadata]
        ahead = clocks[-1].get("utc_minus_t_ns", "") if clocks else ""
        self.reader = ChannelReader(
            [file.path for file in self.files],
            RunClock(self.start_ns, int(ahead) if ahead.lstrip("-").isdecimal() else self._dated()),
            say=self.say,
        )

    def _dated(self) -> int | None:
        """0 where log times are UTC by themselves, as logs of other programs have it."""
        return 0 if self.start_ns > _2000_NS else None

    @property
    def start_ns(self) -> int:
        return self.files[0].first_ns

    @property
    def duration_s(self) -> float:
        return (self.files[-1].last_ns - self.start_ns) * 1e-9

    @property
    def replayed(self) -> bool:
        """Whether the results are not those that were recorded."""
        return any(file.path not in self.sources for file in self.files)

    @property
    def whole(self) -> bool:
        """Whether no file was cut off."""
        return all(file.whole for file in self.files)

    @property
    def simulated(self) -> str:
        """What simulated it; "" where a tractor drove."""
        return simulated_by(self.sources)

    @property
    def software(self) -> Mapping[str, str]:
        """Versions of what recorded the run."""
        return self.files[0].metadata.get("tilth", {})

    @cached_property
    def poses(self) -> Table:
        """Both bodies, five times a second: positions of the centres of gravity, headings, velocities."""
        return self.table("/pose")

    @cached_property
    def events(self) -> Table:
        """What happened: `kind` and `text`, with the place where that matters."""
        found = self.table("/event")
        if not self.replayed:
            return found
        both = joined([found, self.marks])
        return both.where(np.argsort(both.t_s, kind="stable"))

    @cached_property
    def marks(self) -> Table:
        """The events that an operator made; of a log that was replayed those in the log itself."""
        found = self.table("/event")
        if self.replayed:
            own = [path for path in self.sources if is_mcap(path)]
            found = ChannelReader(own, self.reader.clock).table("/event")
        return found.where(found["kind"] == MARK)

    def measurements(self, kind: str) -> Table:
        """Of all sensors. kind: position, velocity, heading, yaw_rate, attitude, fix, time, wheel_angle,
        hand_wheel_angle, curvature, vehicle_speed, address_claim. Raises KeyError."""
        return self.table(f"/measurement/{kind}")

    def estimates(self, method: str = RECOMMENDED) -> Table:
        """As published. method: recommended, steady_state, tracker, pem, pem_two_step. Raises KeyError."""
        return self.table("/soil_tire" if method == RECOMMENDED else f"/soil_tire/{method}")

    def nuisances(self, method: str = RECOMMENDED) -> Table:
        """What was learned beside the six: `<name>` and `<name>_sd`, SI, NaN until it is published first."""
        topic = "/soil_tire" if method == RECOMMENDED else f"/soil_tire/{method}"
        messages = [pb.SoilTireEstimate.FromString(data) for _, data in self.reader.payloads(topic)]
        names = dict.fromkeys(row.name for message in messages for row in message.nuisances)
        columns: dict[str, NDArray[np.float64]] = {
            "t_s": np.array([(message.t_ns - self.start_ns) * 1e-9 for message in messages])
        }
        for name in names:
            columns[name], columns[f"{name}_sd"] = (np.full(len(messages), np.nan) for _ in range(2))
        for k, message in enumerate(messages):
            for row in message.nuisances:
                columns[row.name][k], columns[f"{row.name}_sd"][k] = row.value, row.sd
        return Table(columns, {"t_s": "s"})

    def table(self, topic: str) -> Table:
        """Any row of schemas.channels.CHANNELS that has columns. Raises KeyError, OSError."""
        if topic not in CHANNEL or topic.startswith("/drawing"):
            raise KeyError(f"{topic}: there are {', '.join(topics())}")
        return self.reader.table(topic)


_2000_NS: Final = 946_684_800_000_000_000


def topics() -> list[str]:
    """The topics that have columns."""
    return [topic for topic in CHANNEL if not topic.startswith("/drawing")]


def open_runs(
    paths: str | Path | Sequence[str | Path],
    *,
    machine: tuple[Machine, str] | None = None,
    buses: Mapping[str, str] | None = None,
    progress: Progress = no_progress,
    say: Say = silent,
    cache: Path | None = None,
) -> tuple[Run, ...]:
    """The runs of logs of any kind, in the order of their first log; parts of a run become one.

    machine: a machine file and its text, where the logs hold none or another is to be used. buses: names in
    the logs -> names of the machine file. progress: takes (done, all) of bytes while a log is replayed. say:
    takes sentences for the user. cache: folder for what is kept. Raises LogError, MachineError, OSError.
    """
    rig = machine and MachineFile(*machine)
    given = [paths] if isinstance(paths, str | Path) else list(paths)
    groups: dict[str, list[tuple[Path, LogFile]]] = {}
    empty: EmptyLog | None = None
    for path in map(Path, given):
        try:
            file = _file_of(path, rig, buses or {}, progress, say, cache)
        except EmptyLog as error:
            empty = error
            if len(given) > 1:
                say(str(error))
            continue
        groups.setdefault(_run_key(path, file, groups), []).append((path, file))
    if not groups:
        raise empty or EmptyLog("no log was given")
    simulated = [path for files in groups.values() for path, _ in files if simulated_by([path])]
    if simulated:
        say(f"{', '.join(map(str, simulated))}: {SAID}")
    check_given_once([pair for files in groups.values() for pair in files])
    return tuple(_run(files, rig, say) for files in groups.values())


def _run_key(path: Path, file: LogFile, groups: Mapping[str, list[tuple[Path, LogFile]]]) -> str:
    """By which the parts of a run are known to be of it. A log that a replay or `simulate` wrote is a run by
    itself: their ids tell of a command, not of a start of the daemon."""
    run = file.metadata.get("run", {})
    key = f"{run.get('id', '')} {run.get('started_utc', '')}"
    parts = [_part(other) for _, other in groups.get(key, ())]
    is_part = bool(run.get("id")) and _part(file) not in parts
    return key if is_part and file.path == path and REPLAY not in file.metadata else f"{path} {len(groups)}"


def _run(files: list[tuple[Path, LogFile]], machine: MachineFile | None, say: Say) -> Run:
    files.sort(key=lambda pair: _part(pair[1]))
    found = machine or machine_in([file.path for _, file in files])
    run = files[0][1].metadata.get("run", {})
    return Run(
        _name(*files[0], run.get("id", "")),
        tuple(path for path, _ in files), tuple(file for _, file in files), found, run.get("note", ""), say,
    )  # fmt: skip


def _name(path: Path, file: LogFile, said: str) -> str:
    """What a run is called: what its log says, if that is for people; else as its files are."""
    if said and path == file.path and not DAEMON_RUN.fullmatch(said):
        return said
    return readable(path.stem.removesuffix(f"_{_part(file):03d}"))


def _part(file: LogFile) -> int:
    part = file.metadata.get("run", {}).get("part", "")
    return int(part) if part.isdecimal() else 0


def _file_of(
    path: Path,
    machine: MachineFile | None,
    buses: Mapping[str, str],
    progress: Progress,
    say: Say,
    cache: Path | None,
) -> LogFile:
    """The file to be read for a log: itself, or its replay. Raises LogError, MachineError, OSError."""
    log = open_log(path)
    log.file.close()
    if log.form == MCAP and machine is None and holds_poses(path):
        return read_file(path)
    return read_file(replayed(path, machine or machine_in([path]), buses, progress, say, cache))


def is_mcap(path: Path) -> bool:
    """Whether a log is one of Tilth's own, by its first bytes. Raises OSError."""
    with path.open("rb") as file:
        return file.read(len(MAGIC)) == MAGIC


def holds_poses(path: Path) -> bool:
    """Whether poses were recorded in one of Tilth's own logs, as far as it is whole. Raises OSError."""
    topics = indexed_topics(path)
    if topics:
        return "/pose" in topics.values()
    reader = ChannelReader([path], RunClock(0))
    return next(reader.payloads("/pose"), None) is not None


def read_file(path: Path) -> LogFile:
    """Raises OSError, ForeignLog."""
    found = brief(path)
    if found.state is FileState.NO_LOG:
        raise ForeignLog(f"{path}: no log of tilth")
    whole = found.state in (FileState.WHOLE, FileState.DAMAGED)
    return LogFile(path, _metadata(path), found.first_ns, found.last_ns, whole)


def _metadata(path: Path) -> dict[str, dict[str, str]]:
    """Metadata records by name: of several the first, but of the clock the last."""
    found: dict[str, dict[str, str]] = {}
    with path.open("rb") as file:
        for body in metadata_bodies(file, path.stat().st_size):
            try:
                record = Metadata.read(ReadDataStream(io.BytesIO(body)))
            except DAMAGE:
                continue
            if record.name == "clock":
                found[record.name] = record.metadata
            found.setdefault(record.name, record.metadata)
    return found
