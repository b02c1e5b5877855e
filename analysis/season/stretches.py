"""The rows of a season's table: each stretch of driving with what is known there, each run and file that gave
none with the reason."""

import hashlib
import itertools
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from tilth.analysis.season.identified import Identified, Stretch, reason_sentence
from tilth.analysis.season.inventory import Inventory, SeasonRun
from tilth.analysis.season.merging import MergedStretch, SixKnown, merged
from tilth.estimator.filters import unknowns
from tilth.estimator.filters.unknowns import SIX
from tilth.estimator.results.reporting import is_supported
from tilth.schemas.flow import PARAMETERS, Status
from tilth.schemas.machine import Machine, MachineError
from tilth.schemas.machine_difference import differing
from tilth.schemas.machine_toml import parse_machine
from tilth.schemas.reasons import Code, Reason
from tilth.schemas.sentences import sentence

STRETCH, RUN, FILE = "stretch", "run", "file"
UNDATED: Final = "its time is unknown, since the clock was never set, so it is not combined with other runs"
UNCONFIRMED: Final = (
    "the data have not confirmed the machine file by the end of the run: drive longer, with turns, or "
    "measure the rig more exactly"
)
NO_STRETCH: Final = "no stretch of this driving could be fitted"


@dataclass(frozen=True, slots=True)
class DrivenRig:
    """A tractor with an implement, as machine files describe them: receivers may have changed."""

    machine: str  # its name
    implement: str  # in words
    sha256: str  # of what is said of tractor, implement and tyres


@dataclass(slots=True)
class DrivenRun:
    """A run with what came of it."""

    run: SeasonRun
    found: Identified
    machine: Machine | None = None
    rig: DrivenRig | None = None
    apart: str = ""  # why it is not put together with others; "" where it is
    look: list[str] = field(default_factory=list)  # why it deserves a look

    @property
    def begins_ns(self) -> int:
        """UTC; 0 where nobody knows."""
        return self.run.utc_ns or 0

    @property
    def ends_ns(self) -> int:
        """UTC of the last message; 0 where nobody knows."""
        return self.begins_ns and self.begins_ns + round(max(self.seconds, self._by_files_s) * 1e9)

    @property
    def _by_files_s(self) -> float:
        return (self.run.files[-1].last_ns - self.run.files[0].first_ns) * 1e-9

    @property
    def seconds(self) -> float:
        """Of recording."""
        return self.found.seconds or max(self._by_files_s, 0.0)


@dataclass(frozen=True, slots=True)
class SaidOfSix:
    """What the table says of the six of a stretch; each in the order of flow.PARAMETERS."""

    six: SixKnown
    statuses: tuple[Status, ...]
    reasons: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class SeasonRow:
    """A stretch, or a run or a file that gave none. run: None of a file. known: None without a stretch."""

    kind: str
    status: Status
    reason: str
    path: str  # of the (first) log
    run: DrivenRun | None = None
    stretch: Stretch | None = None
    merged: MergedStretch | None = None
    known: SaidOfSix | None = None


def rig_of(machine: Machine) -> DrivenRig:
    """By what moves it."""
    parts = (machine.tractor, machine.implement, machine.tyres)
    said = [part.model_dump(mode="json", exclude={"name", "names"}) for part in parts]
    sha256 = hashlib.sha256(json.dumps(said, sort_keys=True).encode()).hexdigest()
    implement = machine.implement
    words = f"{implement.mass.value:.0f} kg, d = {implement.d.value:.2f} m"
    if implement.name:
        words = f"{implement.name} ({words})"
    return DrivenRig(machine.machine.name, words, sha256)


def driven(inventory: Inventory, found: Mapping[SeasonRun, Identified]) -> list[DrivenRun]:
    """Runs in order, each with its rig, and whether it is put together with others."""
    runs = [DrivenRun(run, found[run]) for run in inventory.runs]
    for one in runs:
        text = inventory.machines.get(one.run.machine)
        if text is not None:
            try:
                one.machine = parse_machine(*text)
            except MachineError:
                continue  # it is the run's failure
            one.rig = rig_of(one.machine)
    for one in runs:
        one.apart = _apart(one)
        one.look = _look(one)
    _tell_one_name(runs)
    return runs


def _apart(one: DrivenRun) -> str:
    found = one.found
    if found.failure:
        return found.failure
    if found.contradicted:
        why = "; ".join(found.contradicted)
        return f"the data contradict the machine file: {why}"
    if not found.confirmed:
        return UNCONFIRMED
    return "" if one.begins_ns else UNDATED


def _tell_one_name(runs: Sequence[DrivenRun]) -> None:
    """Two machines, or two implements, that have one name."""
    by_name: dict[str, list[DrivenRun]] = {}
    for one in runs:
        if one.machine is not None:
            by_name.setdefault(one.machine.rig, []).append(one)
    for name, same in by_name.items():
        of_time = [one for one in same if one.begins_ns]
        for before, one in itertools.pairwise(of_time):
            if one.begins_ns < before.ends_ns and not one.found.failure:
                twin = f"it was driven while {before.run.name} was: two machines have the name {name}"
                one.apart = one.apart or twin
                one.look.append(
                    f"{twin}, or one log holds a part of the other; give each machine its own name"
                )
        for before, one in itertools.pairwise(same):
            if before.rig != one.rig and before.machine is not None and one.machine is not None:
                one.look.append(
                    f"{before.run.name} has the same name {name}, and its machine file differs in "
                    f"{differing(before.machine, one.machine)}; the two are kept apart"
                )


def _look(one: DrivenRun) -> list[str]:
    """Why a person should look at a run."""
    found = one.found
    told = [one.apart] if one.apart else []
    if not one.begins_ns:
        told.append(UNDATED)
    told += [f"something has moved: {text}" for text in found.moved]
    told += [file.told for file in one.run.files if file.told]
    told += list(found.told)
    told += [f"{count} × {kind}" for kind, count in sorted(found.counted.items()) if kind != "soil_change"]
    if not found.failure and not found.stretches:
        told += [NO_STRETCH, *found.nothing]
    return list(dict.fromkeys(told))


def rows_of(inventory: Inventory, runs: Sequence[DrivenRun]) -> list[SeasonRow]:
    """In the order of the runs; files that were left out come last."""
    known = _put_together(runs)
    rows: list[SeasonRow] = []
    for at, one in enumerate(runs):
        path = one.run.files[0].path
        if one.found.failure or not one.found.stretches:
            reason = one.found.failure or "; ".join(dict.fromkeys([NO_STRETCH, *one.found.nothing]))
            status = Status.INVALID if one.found.failure else Status.UNESTIMATED
            rows.append(SeasonRow(RUN, status, reason, path, one))
            continue
        rows += [_row(one, path, known.get((at, k)), k) for k in range(len(one.found.stretches))]
    rows += [SeasonRow(FILE, Status.INVALID, why, path) for path, why in inventory.left_out]
    return rows


def _put_together(runs: Sequence[DrivenRun]) -> dict[tuple[int, int], MergedStretch]:
    """(run, stretch) -> what is known there. Each rig has a season of its own; what is put together with
    nothing is a season by itself."""
    seasons: dict[object, list[int]] = {}
    for at, one in enumerate(runs):
        if one.rig is not None and one.machine is not None and one.found.stretches:
            seasons.setdefault(at if one.apart else one.rig, []).append(at)
    known: dict[tuple[int, int], MergedStretch] = {}
    for members in seasons.values():
        places, stretches, pauses = list[tuple[int, int]](), list[Stretch](), list[float]()
        ended_ns = 0
        for at in members:
            for k, stretch in enumerate(runs[at].found.stretches):
                if stretch.refused is not None:
                    continue
                ahead = runs[at].run.files[0].utc_minus_ns or 0
                first = not places or places[-1][0] != at
                pause_s = max(0.0, (stretch.begin_ns + ahead - ended_ns) * 1e-9) if first and places else 0.0
                ended_ns = stretch.end_ns + ahead
                places.append((at, k))
                stretches.append(stretch)
                pauses.append(pause_s)
        machine = runs[members[-1]].machine
        assert machine is not None
        known.update(zip(places, merged(machine, stretches, pauses), strict=True))
    return known


def _row(one: DrivenRun, path: str, known: MergedStretch | None, k: int) -> SeasonRow:
    stretch = one.found.stretches[k]
    if known is None or one.machine is None:
        reason = reason_sentence(stretch.refused) if stretch.refused else one.apart
        return SeasonRow(STRETCH, Status.INVALID, reason, path, one, stretch)
    if one.found.contradicted:
        return SeasonRow(STRETCH, Status.INVALID, one.apart, path, one, stretch, known)
    if stretch.by_file is None:  # live there is no number either, and intervals would be too narrow
        return SeasonRow(STRETCH, Status.UNESTIMATED, one.apart or UNCONFIRMED, path, one, stretch)
    said = _said(one.machine, known.smoothed)
    given = Status.ESTIMATED in said.statuses
    status = Status.ESTIMATED if given else Status.UNESTIMATED
    reason = one.apart or ("" if given else said.reasons[0])
    return SeasonRow(STRETCH, status, reason, path, one, stretch, known, said)


def _said(machine: Machine, six: SixKnown) -> SaidOfSix:
    """Which of the six have a number, as live."""
    prior_sd = unknowns.prior(machine)[1][SIX]
    statuses, reasons = [], []
    for sd, own in zip(np.sqrt(np.diag(six.covariance)).tolist(), prior_sd.tolist(), strict=True):
        given = is_supported(False, sd, own)
        statuses.append(Status.ESTIMATED if given else Status.UNESTIMATED)
        reasons.append("" if given else sentence(Reason(Code.WIDE, numbers=(sd,))))
    assert len(statuses) == len(PARAMETERS)
    return SaidOfSix(six, tuple(statuses), tuple(reasons))
