"""One run of a season, identified: replayed with the one fold, and what each window of driving has told.

What a window adds to what was known before it is told apart from that (soil_field.Told), so runs can be
replayed in any order, on any computer, and are put together afterwards (merging.py).
"""

import math
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from tilth.analysis.runs.kept import packed
from tilth.estimator.filters.soil_field import SoilWindow, Told
from tilth.estimator.fold import RECOMMENDED, State
from tilth.estimator.methods import place
from tilth.estimator.methods.place import PlaceState
from tilth.estimator.pose.geometry import to_degrees
from tilth.estimator.record.record import TICK_NS, WHEEL_ANGLE, Record, U
from tilth.estimator.results import advice
from tilth.replay.offline import ReplayOutputs, ReplaySummary, replay
from tilth.replay.readers.log import LogError
from tilth.replay.readers.remote import at_hand
from tilth.schemas.flow import PARAMETERS, EventKind, FlagKind
from tilth.schemas.machine import MachineError
from tilth.schemas.machine_toml import MachineFile, parse_machine
from tilth.schemas.readable import readable, reason_of
from tilth.schemas.reasons import Code, Reason
from tilth.schemas.sentences import event_sentence, sentence

Array = NDArray[np.float64]

IMPLEMENT_AXLE: Final = 2  # of a path's axles
TOLD_EVENTS: Final = frozenset({
    EventKind.FAULT, EventKind.GAP, EventKind.CLOCK_STEP, EventKind.OTHER_CLOCK, EventKind.OTHER_TIME,
    EventKind.TWIN_NAME, EventKind.MOVED, EventKind.SOIL_CHANGE, FlagKind.CONTRADICTION,
})  # fmt: skip
"""Kinds for which a person may want to look at a run."""
MOST_EVENTS: Final = 50  # of a run


@dataclass(frozen=True, slots=True)
class RunTask:
    """A run to identify. key: what is kept of it has this name."""

    key: str
    paths: tuple[str, ...]  # or URLs
    machine_text: str
    dbc: str | None


@dataclass(frozen=True, slots=True)
class Stretch:
    """A window of driving that was fitted. Times are of the log's clock; degrees of the implement's axle."""

    method: str
    begin_ns: int
    end_ns: int
    seconds: float  # of driving
    metres: float  # from the end of the stretch before to its own
    speed: float  # mean, m/s
    wheel_rms: float  # of the wheel angle, rad
    path_deg: Array  # (points, 2), latitude and longitude; of pieces of rows one after the other
    information: Array  # (6, 6), of the six logarithms, by this stretch alone
    vector: Array  # (6,), information @ (what it says, less the prior's mean)
    model_sd: Array  # (6,), of errors of the model
    changed: bool = False  # it contradicts what was known before it
    refused: Code | None = None  # why nothing is learned of it
    pieces: tuple[Told, ...] = ()  # what pieces of it tell, each of an equal part of path_deg; together as it
    by_file: Array | None = None  # (6, 6): what errors that may still be in the machine file add, if known


@dataclass(frozen=True, slots=True)
class Identified:
    """What came of a run. failure: why nothing did, a sentence; "" where it went well."""

    failure: str = ""
    stretches: tuple[Stretch, ...] = ()
    frames: int = 0
    poses: int = 0
    seconds: float = 0.0  # that passed in the logs
    cpu_s: float = 0.0
    confirmed: bool = False  # the data confirm the machine file
    contradicted: tuple[str, ...] = ()
    moved: tuple[str, ...] = ()
    told: tuple[str, ...] = ()  # what the readers and the replay said
    events: tuple[tuple[str, str], ...] = ()  # (kind, sentence), the first of TOLD_EVENTS
    counted: dict[str, int] = field(default_factory=dict)  # kind -> events
    rejected: dict[str, int] = field(default_factory=dict)
    nothing: tuple[str, ...] = ()  # reasons, where no parameter has a number at the end


def identified(task: RunTask) -> bytes:
    """Identify one run; packed, as it is kept. It never raises: a run that fails is told in a sentence."""
    began_s, copies = time.process_time(), dict[str, str]()
    try:
        with ExitStack() as stack:
            for path in task.paths:
                copies[path] = str(stack.enter_context(at_hand(path)))
            found = _replayed(task, [Path(copy) for copy in copies.values()], began_s)
    except (LogError, MachineError) as error:
        text = str(error)
        for path, copy in copies.items():
            text = text.replace(copy, path)
        found = Identified(text)
    except OSError as error:
        found = Identified(f"{error.filename or task.paths[0]}: {reason_of(error)}")
    except Exception as error:  # the edge of a night: the next run goes on
        found = Identified(f"{task.paths[0]}: {type(error).__name__}: {error}")
    return packed(found)


def _replayed(task: RunTask, paths: Sequence[Path], began_s: float) -> Identified:
    machine_file = MachineFile(parse_machine(task.machine_text, task.dbc), task.machine_text)
    heard = _HeardFits()
    said: list[str] = []
    with advice.unread():
        summary = replay(paths, machine_file, outputs=ReplayOutputs(fit=heard.take), say=said.append)
    told = [event for event in summary.events if event.kind in TOLD_EVENTS]
    counted: dict[str, int] = {}
    for event in told:
        counted[event.kind] = counted.get(event.kind, 0) + 1
    stretches = (replace(one, by_file=summary.by_file.get(one.method)) for one in heard.stretches)
    return Identified(
        "", tuple(stretches), summary.frames, summary.poses, summary.duration_ns * 1e-9,
        time.process_time() - began_s, summary.confirmed, tuple(summary.contradicted), tuple(summary.moved),
        tuple(dict.fromkeys(map(readable, said))),
        tuple((event.kind, event_sentence(event)) for event in told[:MOST_EVENTS]), counted,
        summary.rejected, _nothing(summary),
    )  # fmt: skip


def _nothing(summary: ReplaySummary) -> tuple[str, ...]:
    last = summary.estimates.get(RECOMMENDED)
    if last is None or any(one.value is not None for one in last.parameters):
        return ()
    return tuple(dict.fromkeys(sentence(one.reason) for one in last.parameters if one.reason))


class _HeardFits:
    """The stretches of a run, as its fits come: a block of rows that is fitted again replaces what it told
    before, and no second of driving is told of twice, as in the memory by place."""

    def __init__(self) -> None:
        self._kept: list[tuple[list[SoilWindow], Stretch]] = []

    @property
    def stretches(self) -> list[Stretch]:
        """In the order of driving."""
        return sorted((one for _, one in self._kept), key=lambda one: (one.end_ns, one.begin_ns))

    def take(self, state: State, method: str, made: Any) -> None:
        memory, job = state.estimators.get(place.METHOD), state.estimators[method].job
        if memory is None or job is None or made is None or not hasattr(made, "told"):
            return
        self._forget_reset(memory)
        records, windows = place.records_of(job), place.windows_of(memory, job, made)
        again = (method, records[0].t_ns)
        self._kept = [(of, one) for of, one in self._kept if (one.method, one.begin_ns) != again]
        if windows and made.refused is None:
            stay = place.beside(self._windows, windows[0], place.in_rows(memory, windows[0], records))
            if stay is None:
                return  # this driving is told of already
            still = {id(w) for w in stay}
            self._kept = [(of, one) for of, one in self._kept if not of or id(of[0]) in still]
        elif made.refused is None:
            return  # nobody knows where it was
        self._kept.append((windows, self._stretch(memory, method, records, windows, made)))

    @property
    def _windows(self) -> list[SoilWindow]:
        return [window for windows, _ in self._kept for window in windows]

    def _forget_reset(self, memory: PlaceState) -> None:
        """The fold has given up all that was learned by then, since the machine file was wrong."""
        windows = self._windows
        last = (windows[-1].method, windows[-1].begin_ns) if windows else None
        if last and last not in {(w.method, w.begin_ns) for w in memory.windows[-1:]}:
            self._kept.clear()

    def _stretch(
        self,
        memory: PlaceState,
        method: str,
        records: Sequence[Record],
        windows: Sequence[SoilWindow],
        made: Any,
    ) -> Stretch:
        ticks = np.concatenate([record.ticks for record in records])
        path = np.zeros((0, 2))
        if windows and memory.origin_deg is not None:
            places = [place for window in windows for place in window.path[:, IMPLEMENT_AXLE].tolist()]
            path = np.array([to_degrees(memory.origin_deg, x, y) for x, y in places])
        told = made.told if windows else None
        return Stretch(
            method, records[0].t_ns, records[-1].end_ns, len(ticks) * TICK_NS * 1e-9,
            self._metres(memory, records[-1].end_ns), float(np.mean(ticks[:, U])),
            float(np.sqrt(np.mean(ticks[:, WHEEL_ANGLE] ** 2))), path,
            told.information if told else np.zeros((6, 6)), told.vector if told else np.zeros(6),
            told.model_sd if told else np.zeros(6), bool(made.changed), made.refused,
            tuple(window.told for window in windows if len(windows) > 1),
        )  # fmt: skip

    def _metres(self, memory: PlaceState, end_ns: int) -> float:
        """Driven since the end of the stretch before, as far back as the way is kept."""
        before_ns = max((one.end_ns for _, one in self._kept), default=0)
        way = [point.axles[1] for point in memory.track if before_ns <= point.t_ns <= end_ns]
        steps = np.diff(np.array(way), axis=0) if len(way) > 1 else np.zeros((0, 2))
        return float(np.sum(np.hypot(steps[:, 0], steps[:, 1])))


def reason_sentence(code: Code) -> str:
    """Why a stretch is not used."""
    return sentence(Reason(code))


def share_learned(information: Array, prior_sd: Array) -> Mapping[str, float]:
    """What a stretch alone takes off the prior's variance of each of the six. prior_sd: (6,)."""
    known = prior_sd > 0.0
    precision = information[np.ix_(known, known)] + np.diag(prior_sd[known] ** -2.0)
    left = np.zeros(6)
    left[known] = np.diag(np.linalg.inv(precision)) / prior_sd[known] ** 2
    return {
        name: max(0.0, 1.0 - share) if math.isfinite(share) else 0.0
        for name, share in zip(PARAMETERS, left.tolist(), strict=True)
    }
