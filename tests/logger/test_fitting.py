"""Fits beside the loop: in time, late, lost; and that a replay uses each just where the live run did."""

import json
import os
import signal
import time
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
from loopback import PATIENCE_S

from tilth.estimator.methods import pem, rows, two_step
from tilth.estimator.methods.estimators import ESTIMATORS
from tilth.estimator.record.windows import AWAITED, OPEN
from tilth.estimator.snapshot import NotRestorable
from tilth.estimator.state_json import to_json_data
from tilth.logger.fit_worker import as_text, in_order, job_sha256, rehearsals
from tilth.logger.fitting import GIVEN_UP, LATE, UNDECIDED, InPlace, ReplayedFits, Worker
from tilth.logger.guarded_fold import GIVE_UP_NS, GuardedFold
from tilth.logger.job import OUT_OF_MEMORY
from tilth.logger.log.mcap_log import LogWriter, RunPart
from tilth.logger.log.software import software
from tilth.replay.compare import IDENTICAL, Comparison
from tilth.replay.offline import ReplayOutputs, replay
from tilth.replay.readers.any_log import open_log
from tilth.replay.readers.log import Logged
from tilth.schemas import flow
from tilth.schemas.channels import FIT_TOPIC
from tilth.schemas.flow import Frame
from tilth.schemas.machine import Machine
from tilth.schemas.machine_toml import MachineFile
from tilth.schemas.proto.tilth_pb2 import Event, FitOutcome, SoilTireEstimate
from tilth.schemas.sentences import event_sentence, notice_sentence
from tilth.simulator.drive import drive
from tilth.simulator.scenario import DrivenManoeuvre, Scenario
from tilth.simulator.traffic import traffic

pytestmark = pytest.mark.long


TWO_STEP = ("[zenoh]\n", "[estimation]\ntwo_step = true\n\n[zenoh]\n")  # so that two methods fit
MACHINE, MACHINE_TEXT = demo_machine(**dict([TWO_STEP])), PACKAGED.replace(*TWO_STEP)
SECOND = 1_000_000_000
GAP_S = 15.0  # into the drive: there a window closes, just long enough for a fit
END_S = GAP_S + 6.0
METHODS = tuple(row.method for row in ESTIMATORS if row.fitting and row.method != "rows")
"""Rows have no fit before two minutes."""
BUSY_S = 0.3  # by which a fit is late


def without(rows: Iterable[Frame], after_s: float, until_s: float) -> list[Frame]:
    rows = list(rows)
    first_ns = rows[0].t_ns
    return [r for r in rows if not after_s <= (r.t_ns - first_ns) * 1e-9 < until_s]


@cache
def driven() -> list[Frame]:
    """A drive with a gap of a second; its fit is asked for, decided 3 s later and used."""
    scenario = Scenario(seconds=END_S, steering=DrivenManoeuvre("random"), other_traffic=False)
    return without(traffic(MACHINE, drive(MACHINE, 3, END_S, scenario)), GAP_S, GAP_S + 1.0)


MADE: dict[tuple[str, str], Any] = {}


class Pocket:
    """Keeps the jobs. Whether fits are late is said beforehand: frames of a test come faster than any fit."""

    def __init__(self, worker: Worker | None, late: Container[str] = (), by_s: float | None = BUSY_S) -> None:
        """late: methods whose fits are so late; None: they are lost."""
        self.jobs: dict[str, Any] = {}
        self.late = late
        self.by_s = by_s
        self._first: dict[str, int] = {}
        self._worker = worker

    def ask(self, method: str, job: Any) -> None:
        self.jobs[method] = job

    def outcome(self, method: str, job: Any, t_ns: int, awaited: bool = False) -> Any:
        if method in self.late:
            if self.by_s is None:
                return None
            if t_ns < self._first.setdefault(method, t_ns) + self.by_s * SECOND:
                return LATE
        return self.made(method, job)

    def use(self, machine: Machine) -> None:
        raise AssertionError("nothing is accepted here")

    def made(self, method: str, job: Any) -> Any:
        assert self._worker is not None
        known = (method, json.dumps(to_json_data(job)))
        if known not in MADE:  # most runs here are of the same drive
            MADE[known] = self._worker.made(method, job)
        return MADE[known]


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
def events() -> list[str]:
    return []


@pytest.fixture(scope="module")
def worker(events: list[str]) -> Iterator[Worker]:
    made = Worker(MACHINE, lambda kind, told: events.append(f"{kind}: {notice_sentence(told)}"))
    yield made
    made.close()


def test_the_process_makes_what_is_made_here(worker: Worker) -> None:
    found = worker.made(pem.METHOD, a_job())
    assert to_json_data(InPlace(MACHINE).made(pem.METHOD, a_job())) == to_json_data(found)
    assert to_json_data(worker.made(pem.METHOD, replace(a_job(), asked_ns=9))) == to_json_data(found)
    assert worker.seconds is not None and worker.seconds > 0.0


def test_rows_are_compiled_last() -> None:
    """They tell nothing before two minutes; turns and the method of the dissertation are wanted sooner."""
    fits = in_order(MACHINE)
    assert [fitting.fit for fitting in fits] == [pem.fit, two_step.fit, rows.fit]
    assert rehearsals(MACHINE)[: len(fits)] == [fitting.rehearse_alone for fitting in fits]


def test_what_is_not_ready_is_late_and_is_not_kept_for_another(worker: Worker) -> None:
    job = replace(a_job(), asked_ns=1)
    assert worker.outcome(pem.METHOD, job, 2) is None  # was never asked for
    worker.ask(pem.METHOD, job)
    assert worker.outcome(pem.METHOD, job, 2) is LATE
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


def test_a_fit_that_cannot_be_made_is_told_and_ends_nobody(worker: Worker, events: list[str]) -> None:
    events.clear()
    assert worker.made(pem.METHOD, replace(a_job(), asked_ns=7, record=NO_RECORD)) is None
    assert events == ["fit: a fit of pem failed: AttributeError: 'NoneType' object has no attribute 'rows'"]
    assert InPlace(MACHINE).made(pem.METHOD, replace(a_job(), record=NO_RECORD)) is None
    assert worker.made(pem.METHOD, replace(a_job(), asked_ns=8)) is not None


def test_a_process_that_dies_takes_one_fit_with_it(worker: Worker, events: list[str]) -> None:
    events.clear()
    assert worker._job is not None
    os.kill(worker._job.pid, signal.SIGKILL)
    assert worker.made(pem.METHOD, replace(a_job(), asked_ns=11)) is None
    again = "its process is started again for the next"
    assert events == [f"fit: a fit of pem failed: {OUT_OF_MEMORY}; {again}"]
    assert worker.made(pem.METHOD, replace(a_job(), asked_ns=12)) is not None


def test_a_fit_that_never_ends_is_given_up_at_the_next(worker: Worker, events: list[str]) -> None:
    events.clear()
    worker.ask(pem.METHOD, replace(a_job(), asked_ns=21, record=_endless()))
    while worker._busy == 0:
        continue
    assert worker.made(pem.METHOD, replace(a_job(), asked_ns=22)) is not None
    assert len(events) == 1 and GIVEN_UP in events[0]


def _endless() -> Any:
    """A window of hours: minutes of work."""
    record = a_job().record
    rows = record.rows.repeat(300, axis=0)
    return replace(record, rows=rows, ticks=record.ticks.repeat(300, axis=0))


def test_an_end_in_the_middle_of_a_fit_waits_for_nothing() -> None:
    messages: list[str] = []
    worker = Worker(MACHINE, lambda kind, told: messages.append(notice_sentence(told)))
    worker.ask(pem.METHOD, replace(a_job(), record=_endless()))
    worker.close()
    deadline = time.monotonic() + PATIENCE_S  # a busy computer may take longer to end it than `close` waits
    while worker._job is not None and time.monotonic() < deadline:
        continue
    assert worker._job is None
    assert messages == []


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
            writer = LogWriter(
                paths[-1], MachineFile(MACHINE, MACHINE_TEXT), RunPart("r", len(paths), rows[0].t_ns)
            )
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
    """Cuts at the first frame after each stage of the one fit: asked for, late, decided, used."""

    def __init__(self) -> None:
        self.stage = 0

    def __call__(self, fold: GuardedFold) -> bool:
        ours = fold.state.estimators[pem.METHOD]
        decided = ours.decided not in (OPEN, AWAITED)
        used = ours.fits + ours.late > 0
        known = decided or used
        reached = (ours.job is not None or known, ours.decided == AWAITED or known, known, used)
        before, self.stage = self.stage, max(self.stage, sum(reached))
        return self.stage > before


def replayed(paths: Sequence[Path]) -> tuple[str, list[str]]:
    comparison = Comparison()
    messages: list[str] = []
    replay(
        paths,
        MachineFile(MACHINE, MACHINE_TEXT),
        outputs=ReplayOutputs(comparison=comparison),
        say=messages.append,
    )
    assert comparison.compared > 0
    return comparison.difference, messages


def outcomes(paths: Sequence[Path]) -> dict[str, list[FitOutcome]]:
    logged = results_of(paths, frozenset({FIT_TOPIC})).get(FIT_TOPIC, [])
    logged_outcomes = [FitOutcome.FromString(row.data) for row in logged]
    return {method: [one for one in logged_outcomes if one.method == method] for method in METHODS}


@pytest.mark.parametrize(
    ("late", "gap", "by_s"),
    [
        ((), False, BUSY_S),
        ((pem.METHOD,), False, BUSY_S),
        (METHODS[1:], False, None),
        (METHODS, True, BUSY_S),
    ],
    ids=["in time", "one late", "one lost", "all late in a gap"],
)
def test_a_run_with_a_fit_gives_its_own_bytes_again(
    tmp_path: Path, worker: Worker, late: tuple[str, ...], gap: bool, by_s: float | None
) -> None:
    rows = without(driven(), GAP_S + 1.5, GAP_S + 5.5) if gap else driven()  # fits are due in the gap
    live = record(tmp_path, rows, Pocket(worker, late, by_s), Once())
    awaits = by_s is not None and pem.METHOD in late
    assert len(live.parts) == (5 if awaits else 4)
    for method, logged_outcomes in outcomes(live.parts).items():
        *waits, last = [(one.adopted, one.awaited) for one in logged_outcomes]
        assert waits == [(False, True)] * (by_s is not None and method in late)
        assert last == (by_s is not None or method not in late, False)
        assert (logged_outcomes[-1].late_ns > 0) == bool(waits)
    assert replayed(live.parts) == ("", [])
    for part in live.parts[1:-1] if late == (pem.METHOD,) else ():
        assert replayed([part]) == ("", [])


def test_a_late_fit_is_used_says_by_how_much_and_the_next_window_follows_it(
    tmp_path: Path, late: Path, in_time: Path
) -> None:
    """What it learned is the same, and so is what it is worth; only the instant is another."""
    events = [Event.FromString(row.data).text for row in results_of([late], frozenset({"/event"}))["/event"]]
    (messages,) = [text for text in events if text.startswith("a fit was 0.3 s late")]
    assert "it is used from now on" in messages
    rows = results_of([late], frozenset({"/soil_tire/pem"}))["/soil_tire/pem"]
    after = SoilTireEstimate.FromString(rows[-1].data)
    excitation = {one.name: one.value for one in after.excitation}
    assert excitation["late"] == excitation["fits"] == 1.0
    assert excitation["late_s"] == pytest.approx(BUSY_S, abs=0.02)
    others = results_of([in_time], frozenset({"/soil_tire/pem"}))["/soil_tire/pem"]
    other = SoilTireEstimate.FromString(others[-1].data)
    assert [one.value for one in after.parameters] == [one.value for one in other.parameters]
    assert "late_s" not in {one.name for one in other.excitation}


def test_while_a_fit_is_late_no_other_is_asked_for_and_one_that_never_comes_is_given_up() -> None:
    fitter = Pocket(None, METHODS, 1e9)
    fold = GuardedFold(MACHINE, fitter=fitter)
    rows = driven()
    for row in rows:
        fold.take(row)
    ours = fold.state.estimators[pem.METHOD]
    job = ours.job
    assert ours.decided == AWAITED and job is fitter.jobs[pem.METHOD]
    ours.closed = job.record  # the next window
    assert pem.request_fit(ours, job.asked_ns + 40 * SECOND) is None and ours.closed is not None
    later = job.asked_ns + pem.PEM.latency_ns + GIVE_UP_NS
    assert fold.decided(later) == []
    (decided_fit,) = [p.value for p in fold.decided(later + 1) if p.value.method == pem.METHOD]  # type: ignore[union-attr]
    assert (decided_fit.adopted, decided_fit.awaited, decided_fit.late_ns) == (False, False, GIVE_UP_NS + 1)  # type: ignore[union-attr]
    told_of = [p.value for p, _ in fold.take(replace(rows[-1], t_ns=rows[-1].t_ns + 1))]
    assert any(
        "not ready 300 s after it was due and is abandoned" in event_sentence(v)
        for v in told_of
        if isinstance(v, flow.Event)
    )
    requested = pem.request_fit(ours, later + 2)
    assert requested is not None and ours.closed is None


def test_a_state_in_which_fits_could_not_be_awaited_is_refused_with_a_reason() -> None:
    fold = GuardedFold(MACHINE)
    for row in driven()[:2000]:
        fold.take(row)
    plain = json.loads(fold.renew())
    again = GuardedFold(MACHINE, json.dumps(plain))
    assert again.renew() == fold.renew()
    del plain["estimators"]["pem"]["late_ns"]
    with pytest.raises(NotRestorable, match="PemState: late_ns is missing"):
        GuardedFold(MACHINE, json.dumps(plain))
    del plain["version"]
    with pytest.raises(NotRestorable, match="another version"):
        GuardedFold(MACHINE, json.dumps(plain))


@pytest.fixture(scope="module")
def in_time(tmp_path_factory: pytest.TempPathFactory, worker: Worker) -> Path:
    """A log in one file."""
    return record(tmp_path_factory.mktemp("in"), driven(), Pocket(worker), lambda fold: False).parts[0]


@pytest.fixture(scope="module")
def late(tmp_path_factory: pytest.TempPathFactory, worker: Worker) -> Path:
    """Of the same drive; no fit was ready in time."""
    return record(
        tmp_path_factory.mktemp("late"), driven(), Pocket(worker, METHODS), lambda fold: False
    ).parts[0]


def test_the_outcome_stands_right_after_the_frame_at_which_it_was_decided(in_time: Path) -> None:
    rows = list(open_log(in_time, IDENTICAL).records)
    at = next(k for k, row in enumerate(rows) if isinstance(row, Logged) and row.topic == FIT_TOPIC)
    logged_fit = rows[at]
    before = [row for row in rows[:at] if isinstance(row, Frame)][-2:]
    assert isinstance(logged_fit, Logged)
    outcome = FitOutcome.FromString(logged_fit.data)
    assert (
        before[0].t_ns
        < outcome.asked_ns + pem.PEM.latency_ns
        <= before[1].t_ns
        == logged_fit.t_ns
        == outcome.t_ns
    )
    used, first = rows[at + 1 : at + 3]  # at the next frame
    assert isinstance(used, Frame)
    assert isinstance(first, Logged) and first.topic == "/soil_tire/pem"


def test_the_same_run_twice_and_another_with_its_stamps(late: Path, in_time: Path) -> None:
    assert all(len(fits) == 2 for fits in outcomes([late]).values())
    assert replayed([late, late, in_time])[0] == ""


def test_where_the_log_says_nothing_fits_are_in_time(tmp_path: Path) -> None:
    silent = tmp_path / "silent.mcap"
    writer = LogWriter(silent, MachineFile(MACHINE, MACHINE_TEXT), RunPart("s", 1, 0))
    for row in driven():
        writer.frame(row)
    writer.close()
    found = replay([silent], MachineFile(MACHINE, MACHINE_TEXT)).estimates[pem.METHOD]
    assert (found.excitation["fits"], found.excitation["late"]) == (1.0, 0.0)


def test_a_log_of_its_own_is_waited_for_until_the_next_frame() -> None:
    replayed = ReplayedFits(MACHINE, lambda kind, told: None)
    job = a_job()
    assert replayed.outcome(pem.METHOD, job, 10) is not None
    replayed.holds_outcomes = True
    assert replayed.outcome(pem.METHOD, job, 10) is UNDECIDED
    assert replayed.outcome(pem.METHOD, job, 10) is UNDECIDED
    replayed.add_outcome(flow.FitOutcome(10, pem.METHOD, job.asked_ns, False))
    assert replayed.outcome(pem.METHOD, job, 10) is None
    assert replayed.outcome(pem.METHOD, job, 20) is UNDECIDED
    assert replayed.outcome(pem.METHOD, job, 21) is not None
    replayed.add_outcome(flow.FitOutcome(30, pem.METHOD, job.asked_ns, False, True))
    assert replayed.outcome(pem.METHOD, job, 30) is LATE
    assert replayed.outcome(pem.METHOD, job, 99, True) is UNDECIDED
    replayed.add_outcome(flow.FitOutcome(99, pem.METHOD, job.asked_ns, True))
    assert replayed.outcome(pem.METHOD, job, 99, True) is not None


def test_a_fit_of_a_replay_is_made_meanwhile_and_a_failure_is_told() -> None:
    events: list[str] = []
    replayed = ReplayedFits(MACHINE, lambda kind, told: events.append(f"{kind}: {notice_sentence(told)}"))
    replayed.ask(pem.METHOD, a_job())
    under_way = replayed._asked[pem.METHOD]
    replayed.ask(pem.METHOD, a_job())
    assert replayed._asked[pem.METHOD] is under_way
    assert replayed.made(pem.METHOD, a_job()) is under_way[1].result()
    assert replayed.made(pem.METHOD, replace(a_job(), record=NO_RECORD)) is None
    assert events == ["fit: a fit of pem failed: AttributeError: 'NoneType' object has no attribute 'rows'"]


def test_a_fault_between_asking_and_using_forgets_the_fit() -> None:
    fitter = Pocket(None)
    fold = GuardedFold(MACHINE, fitter=fitter)
    rows = iter(driven())
    while not fitter.jobs:
        fold.take(next(rows))
    fold.state.record = None  # type: ignore[assignment]
    for row in rows:
        assert not [p for p, _ in fold.take(row) if p.topic == FIT_TOPIC]
    assert fold.faults == 1


@pytest.fixture(scope="module")
def fit_of_a_job() -> tuple[pem.Job, pem.Fit]:
    job = a_job()
    return job, pem.fit(MACHINE, job)


@pytest.mark.parametrize(
    ("log", "verified", "of_this_job", "used"),
    [({}, False, True, True), ({}, False, False, False), ({}, True, True, False),
     ({"estimator": "other"}, False, True, False), ({"libc": "musl 1"}, False, True, False)],
    ids=["its own", "of another job", "verified", "of other code", "of other arithmetic"],
)  # fmt: skip
def test_a_result_of_the_log_is_used_where_it_would_be_the_same(
    fit_of_a_job: tuple[pem.Job, pem.Fit], log: dict[str, str], verified: bool, of_this_job: bool, used: bool
) -> None:
    replayed, (job, fit) = ReplayedFits(MACHINE, lambda kind, told: None), fit_of_a_job
    replayed.recorded_by(software() | log, verified)
    text = as_text(replace(fit, iterations=99))
    key = job_sha256(MACHINE if of_this_job else demo_machine(), job)
    replayed.ask(pem.METHOD, job)
    replayed.add_outcome(flow.FitOutcome(9, pem.METHOD, job.asked_ns, True, result=text, job_sha256=key))
    assert replayed.outcome(pem.METHOD, job, 9).iterations == (99 if used else fit.iterations)
    assert replayed.ties == 0


@pytest.mark.parametrize(
    ("six_sd", "other_sd", "changed", "tie", "ties"),
    [(1e-7, 1e-7, False, False, 0), (0.09, 0.09, False, False, 1), (0.11, 0.0, False, False, None),
     (0.0, 0.9, False, False, 1), (0.0, 1.1, False, False, None), (0.0, 0.0, True, False, None),
     (5.0, 5.0, True, True, 1), (5.0, 5.0, False, True, None)],
)  # fmt: skip
def test_elsewhere_a_fit_that_is_as_good_goes_on_from_the_logged_one(
    fit_of_a_job: tuple[pem.Job, pem.Fit],
    six_sd: float,
    other_sd: float,
    changed: bool,
    tie: bool,
    ties: int | None,
) -> None:
    replayed, (job, here) = ReplayedFits(MACHINE, lambda kind, told: None), fit_of_a_job
    sds = np.sqrt(np.diag(here.covariance))
    moved = np.where(np.arange(len(sds)) < 6, six_sd, other_sd) * sds
    there = replace(here, mean=here.mean + moved, changed=changed, tie=tie)
    replayed.recorded_by(software() | {"libc": "musl 1"}, verified=True)
    replayed.add_outcome(flow.FitOutcome(9, pem.METHOD, job.asked_ns, True, result=as_text(there)))
    used = replayed.outcome(pem.METHOD, job, 9)
    assert as_text(used) == as_text(here if ties is None else there)
    assert replayed.ties == (ties or 0)
