"""A log that ends while the wheels still turn: what was driven up to there is fitted, and a replay does the
same."""

from pathlib import Path

import pytest
from drives import QUIET
from logs import MACHINE, MACHINE_TEXT, START_NS
from verified import verified

from tilth.estimator.methods import pem
from tilth.logger.guarded_fold import GuardedFold
from tilth.logger.log.mcap_log import LogWriter, RunPart
from tilth.replay.offline import ReplayOutputs, replay
from tilth.schemas.channels import FIT_TOPIC
from tilth.schemas.flow import FitOutcome
from tilth.schemas.machine_toml import MachineFile
from tilth.simulator.traffic import simulate

SEED, SECONDS = 3, 31.0


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("end") / "end.mcap"
    writer = LogWriter(path, MachineFile(MACHINE, MACHINE_TEXT), RunPart("run", 1, START_NS))
    for frame in simulate(MACHINE, SEED, SECONDS, QUIET):
        writer.frame(frame)
    writer.close()
    return path


def test_what_was_driven_before_the_end_is_fitted_once() -> None:
    fold = GuardedFold(MACHINE)
    for frame in simulate(MACHINE, SEED, SECONDS, QUIET):
        fold.take(frame)
    assert fold.state.estimators[pem.METHOD].fits == 0
    given = [publication.value for publication, _ in fold.finish()]
    outcomes = [value for value in given if isinstance(value, FitOutcome)]
    assert [(o.method, o.adopted, o.t_ns - o.asked_ns) for o in outcomes] == [(pem.METHOD, True, 0)]
    assert fold.state.estimators[pem.METHOD].fits == 1
    assert fold.faults == 0
    assert fold.finish() == []


@pytest.mark.long
def test_a_replay_of_what_a_replay_wrote_is_identical(log: Path, tmp_path: Path) -> None:
    again = tmp_path / "again.mcap"
    writer = LogWriter(again, MachineFile(MACHINE, MACHINE_TEXT), RunPart("run", 1, START_NS))
    summary = replay([log], MachineFile(MACHINE, MACHINE_TEXT), outputs=ReplayOutputs(writer=writer))
    writer.close()
    assert summary.estimates[pem.METHOD].excitation["fits"] == 1.0
    second = verified([again], MachineFile(MACHINE, MACHINE_TEXT))
    assert second.estimates == summary.estimates


@pytest.mark.long
def test_the_end_is_told_by_outcomes_before_their_time(log: Path, tmp_path: Path) -> None:
    fold = GuardedFold(MACHINE)
    for frame in simulate(MACHINE, SEED, SECONDS, QUIET):
        fold.take(frame)
    topics = [publication.topic for publication, _ in fold.finish()]
    assert topics[0] == FIT_TOPIC and f"/soil_tire/{pem.METHOD}" in topics
