"""Fits beside the loop: in time, late, lost; and that a replay uses each just where the live run did."""

from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from circle import demo_machine
from logs import MACHINE_TEXT as PACKAGED
from logs import Live, results_of

from tilth.estimator import pem
from tilth.estimator.estimators import ESTIMATORS
from tilth.estimator.plain import to_plain
from tilth.logger.fitting import UNDECIDED, InPlace, Retold, Worker
from tilth.logger.guarded_fold import GuardedFold
from tilth.logger.mcap_log import LogWriter, Run
from tilth.replay.compare import IDENTICAL, Comparison
from tilth.replay.driver import Outputs, replay
from tilth.replay.readers import open_log
from tilth.replay.readers_log import Logged
from tilth.replay.scenario import Manoeuvre, Scenario
from tilth.replay.tractor import drive
from tilth.replay.traffic import traffic
from tilth.schemas.channels import FIT_TOPIC
from tilth.schemas.flow import Frame
from tilth.schemas.proto.tilth_pb2 import FitOutcome

TWO_STEP = ("[zenoh]\n", "[estimation]\ntwo_step = true\n\n[zenoh]\n")  # so that two methods fit
MACHINE, MACHINE_TEXT = demo_machine(**dict([TWO_STEP])), PACKAGED.replace(*TWO_STEP)
SECOND = 1_000_000_000
GAP_S = 15.0  # into the drive: there a window closes, just long enough for a fit
END_S = GAP_S + 6.0
METHODS = tuple(row.method for row in ESTIMATORS if row.fitting)
LOST = "signal 9"


def without(rows: Iterable[Frame], after_s: float, until_s: float) -> list[Frame]:
    rows = list(rows)
    first_ns = rows[0].t_ns
    return [r for r in rows if not after_s <= (r.t_ns - first_ns) * 1e-9 < until_s]


@cache
def driven() -> list[Frame]:
    """A drive with a gap of a second; its fit is asked for, decided 3 s later and used."""
    scenario = Scenario(seconds=END_S, steering=Manoeuvre("random"), other_traffic=False)
    return without(traffic(MACHINE, drive(MACHINE, 3, END_S, scenario)), GAP_S, GAP_S + 1.0)


class Pocket:
    """Keeps the jobs. Whether fits are late is said beforehand: frames of a test come faster than any fit."""

    def __init__(self, worker: Worker | None, late: Container[str] = ()) -> None:
        self.jobs: dict[str, Any] = {}
        self.late = late
        self._worker = worker

    def ask(self, method: str, job: Any) -> None:
        self.jobs[method] = job

    def outcome(self, method: str, job: Any, t_ns: int) -> Any:
        return None if method in self.late else self.made(method, job)

    def made(self, method: str, job: Any) -> Any:
        assert self._worker is not None
        return self._worker.made(method, job)


@cache
def a_job() -> pem.Job:
    fitter = Pocket(None)
    fold = GuardedFold(MACHINE, fitter=fitter)
    for frame in driven():
        fold.take(frame)
        if fitter.jobs:
            break
    job = fitter.jobs[pem.METHOD]
    assert isinstance(job, pem.Job)
    return job


# The process


@pytest.fixture(scope="module")
def told() -> list[str]:
    return []


@pytest.fixture(scope="module")
def worker(told: list[str]) -> Iterator[Worker]:
    made = Worker(MACHINE, lambda kind, text: told.append(f"{kind}: {text}"))
    yield made
    made.close()


def test_the_process_makes_what_is_made_here(worker: Worker) -> None:
    found = worker.made(pem.METHOD, a_job())
    here = InPlace(MACHINE).made(pem.METHOD, a_job())
    # Not to the bit: here linear algebra has as many threads as there are cores.
    assert np.allclose(found.mean, here.mean, atol=1e-6)
    assert (found.iterations, found.rows, found.advice) == (here.iterations, here.rows, here.advice)
    assert to_plain(worker.made(pem.METHOD, replace(a_job(), asked_ns=9))) == to_plain(found)
    assert worker.seconds is not None and worker.seconds > 0.0


def test_what_is_not_ready_is_late_and_is_not_kept(worker: Worker) -> None:
    job = replace(a_job(), asked_ns=1)
    assert worker.outcome(pem.METHOD, job, 2) is None  # was never asked for
    worker.ask(pem.METHOD, job)
    assert worker.outcome(pem.METHOD, job, 2) is None
    again = replace(a_job(), asked_ns=3)
    assert worker.made(pem.METHOD, again) is not None
    assert worker.outcome(pem.METHOD, job, 4) is None
    assert worker.outcome(pem.METHOD, again, 4) is None  # taken


def test_the_first_of_two_methods_does_not_take_the_others_place(worker: Worker) -> None:
    job = replace(a_job(), asked_ns=5)
    worker.ask(pem.METHOD, job)
    worker.ask("nobody", job)
    assert worker.made(pem.METHOD, job) is not None
    assert worker.made("nobody", job) is None


NO_RECORD: Any = None


def test_a_fit_that_cannot_be_made_is_told_and_ends_nobody(worker: Worker, told: list[str]) -> None:
    told.clear()
    assert worker.made(pem.METHOD, replace(a_job(), asked_ns=7, record=NO_RECORD)) is None
    assert told == ["fit: a fit of pem failed: AttributeError: 'NoneType' object has no attribute 'rows'"]
    assert InPlace(MACHINE).made(pem.METHOD, replace(a_job(), record=NO_RECORD)) is None
    assert worker.made(pem.METHOD, replace(a_job(), asked_ns=8)) is not None


def kill(worker: Worker) -> None:
    process = worker._process
    assert process is not None
    process.kill()
    process.wait()


def test_a_process_that_dies_takes_one_fit_with_it(worker: Worker, told: list[str]) -> None:
    told.clear()
    kill(worker)
    assert worker.made(pem.METHOD, replace(a_job(), asked_ns=11)) is None
    assert len(told) == 1 and LOST in told[0]
    assert worker.made(pem.METHOD, replace(a_job(), asked_ns=12)) is not None


def test_in_a_replay_it_takes_none() -> None:
    said: list[str] = []
    worker = Worker(MACHINE, lambda kind, text: said.append(text), patient=True)
    try:
        assert worker.made(pem.METHOD, a_job()) is not None
        kill(worker)
        assert worker.made(pem.METHOD, replace(a_job(), asked_ns=1)) is not None
        assert said == []
    finally:
        worker.close()


def test_a_fit_that_never_ends_is_given_up_at_the_next(worker: Worker, told: list[str]) -> None:
    told.clear()
    worker.ask(pem.METHOD, replace(a_job(), asked_ns=21, record=_endless()))
    while worker._busy == 0:
        continue
    assert worker.made(pem.METHOD, replace(a_job(), asked_ns=22)) is not None
    assert len(told) == 1 and LOST in told[0]


def _endless() -> Any:
    """A window of hours: minutes of work."""
    record = a_job().record
    rows = record.rows.repeat(300, axis=0)
    return replace(record, rows=rows, ticks=record.ticks.repeat(300, axis=0))


def test_an_end_in_the_middle_of_a_fit_waits_for_nothing() -> None:
    said: list[str] = []
    worker = Worker(MACHINE, lambda kind, text: said.append(text))
    worker.ask(pem.METHOD, replace(a_job(), record=_endless()))
    worker.close()
    assert worker._process is None
    assert said == []


# Live is replay


def record(folder: Path, rows: Sequence[Frame], fitter: Pocket, cuts: Callable[[GuardedFold], bool]) -> Live:
    """As the daemon does: a new file before each frame at which `cuts` says so."""
    fold = GuardedFold(MACHINE, fitter=fitter)
    paths: list[Path] = []
    results = 0
    writer: LogWriter | None = None
    for row in rows:
        if writer is None or cuts(fold):
            snapshot = fold.renew() if writer is not None else None
            if writer is not None:
                writer.close()
            paths.append(folder / f"r_{len(paths) + 1:03d}.mcap")
            writer = LogWriter(paths[-1], MACHINE, MACHINE_TEXT, Run("r", len(paths), rows[0].t_ns))
            if snapshot is not None:
                writer.snapshot(row.t_ns, snapshot)
        writer.frame(row)
        for publication, data in fold.take(row):
            writer.message(publication.topic, publication.t_ns, data)
            results += 1
    assert writer is not None
    writer.close()
    assert fold.faults == 0
    return Live(list(rows), paths, results)


class Once:
    """Cuts at the first frame after each stage of the one fit: asked for, decided, used."""

    def __init__(self) -> None:
        self.stage = 0

    def __call__(self, fold: GuardedFold) -> bool:
        own = fold.state.estimators[pem.METHOD]
        reached = (own.job is not None, own.decided != 0, own.fits + own.late > 0)
        if self.stage < 3 and reached[self.stage]:
            self.stage += 1
            return True
        return False


def replayed(paths: Sequence[Path]) -> tuple[str, list[str]]:
    comparison = Comparison()
    said: list[str] = []
    replay(paths, MACHINE, MACHINE_TEXT, outputs=Outputs(comparison=comparison), say=said.append)
    assert comparison.compared > 0
    return comparison.difference, said


def outcomes(paths: Sequence[Path]) -> dict[str, bool]:
    logged = results_of(paths, frozenset({FIT_TOPIC})).get(FIT_TOPIC, [])
    told = [FitOutcome.FromString(row.data) for row in logged]
    assert len(told) == len(METHODS)
    return {outcome.method: outcome.adopted for outcome in told}


@pytest.mark.parametrize(
    ("late", "gap"), [((), False), ((pem.METHOD,), False), (METHODS[1:], False), (METHODS, True)]
)
def test_a_run_with_a_fit_gives_its_own_bytes_again(
    tmp_path: Path, worker: Worker, late: tuple[str, ...], gap: bool
) -> None:
    rows = without(driven(), GAP_S + 1.5, GAP_S + 5.5) if gap else driven()  # fits are due in the gap
    live = record(tmp_path, rows, Pocket(worker, late), Once())
    assert len(live.parts) == 4
    assert outcomes(live.parts) == {method: method not in late for method in METHODS}
    assert replayed(live.parts) == ("", [])
    for part in live.parts[1:3] if not gap else ():
        assert replayed([part]) == ("", [])


@pytest.fixture(scope="module")
def in_time(tmp_path_factory: pytest.TempPathFactory, worker: Worker) -> Path:
    """A log in one file."""
    return record(tmp_path_factory.mktemp("in"), driven(), Pocket(worker), lambda fold: False).parts[0]


@pytest.fixture(scope="module")
def late(tmp_path_factory: pytest.TempPathFactory, worker: Worker) -> Path:
    """Of the same drive; no fit was ready."""
    return record(
        tmp_path_factory.mktemp("late"), driven(), Pocket(worker, METHODS), lambda fold: False
    ).parts[0]


def test_the_outcome_stands_right_after_the_frame_at_which_it_was_decided(in_time: Path) -> None:
    rows = list(open_log(in_time, IDENTICAL).records)
    at = next(k for k, row in enumerate(rows) if isinstance(row, Logged) and row.topic == FIT_TOPIC)
    told = rows[at]
    before = [row for row in rows[:at] if isinstance(row, Frame)][-2:]
    assert isinstance(told, Logged)
    outcome = FitOutcome.FromString(told.data)
    assert before[0].t_ns < outcome.asked_ns + pem.LATENCY_NS <= before[1].t_ns == told.t_ns == outcome.t_ns
    used, first = rows[at + 1 : at + 3]  # at the next frame
    assert isinstance(used, Frame)
    assert isinstance(first, Logged) and first.topic == "/soil_tire/pem"


def test_the_same_run_twice_and_another_with_its_stamps(late: Path, in_time: Path) -> None:
    assert outcomes([late]) == dict.fromkeys(METHODS, False)
    assert replayed([late, late, in_time, late])[0] == ""


def test_where_the_log_says_nothing_fits_are_in_time(tmp_path: Path) -> None:
    silent = tmp_path / "silent.mcap"
    writer = LogWriter(silent, MACHINE, MACHINE_TEXT, Run("s", 1, 0))
    for row in driven():
        writer.frame(row)
    writer.close()
    found = replay([silent], MACHINE, MACHINE_TEXT).estimates[pem.METHOD]
    assert (found.excitation["fits"], found.excitation["late"]) == (1.0, 0.0)


def test_a_log_of_its_own_is_waited_for_until_the_next_frame() -> None:
    retold = Retold(MACHINE, lambda kind, text: None)
    job = a_job()
    try:
        assert retold.outcome(pem.METHOD, job, 10) is not None
        retold.own = True
        assert retold.outcome(pem.METHOD, job, 10) is UNDECIDED
        assert retold.outcome(pem.METHOD, job, 10) is UNDECIDED
        retold.tell(pem.METHOD, job.asked_ns, False)
        assert retold.outcome(pem.METHOD, job, 10) is None
        assert retold.outcome(pem.METHOD, job, 20) is UNDECIDED
        assert retold.outcome(pem.METHOD, job, 21) is not None
    finally:
        retold.close()


def test_a_fault_between_asking_and_using_forgets_the_fit() -> None:
    fitter = Pocket(None)
    fold = GuardedFold(MACHINE, fitter=fitter)
    rows = iter(driven())
    while not fitter.jobs:
        fold.take(next(rows))
    fold.state.aligner = None  # type: ignore[assignment]
    for row in rows:
        assert not [p for p, _ in fold.take(row) if p.topic == FIT_TOPIC]
    assert fold.faults == 1
