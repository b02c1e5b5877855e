"""A log that holds no results is replayed once, and what fits ask for comes of that one fold too."""

from dataclasses import replace
from pathlib import Path

import pytest
from cart import CART, LOAD_TEXT
from logs import MACHINE, MACHINE_TEXT, write_candump

from tilth.analysis.runs import driving as module
from tilth.analysis.runs.driving import driving
from tilth.analysis.runs.kept import packed
from tilth.analysis.runs.run import Run, open_runs
from tilth.schemas.flow import FlagKind
from tilth.simulator.traffic import simulate


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def run(cache: Path) -> Run:
    log = write_candump(cache / "x.log", simulate(MACHINE, 1, 20.0))
    (found,) = open_runs(log, machine=(MACHINE, MACHINE_TEXT), cache=cache / "kept")
    return found


def test_its_driving_is_what_a_fold_without_estimators_gives(
    run: Run, cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    alone = driving(run, cache=tmp_path)
    monkeypatch.setattr(module, "_drive", lambda *_: pytest.fail("driven a second time"))
    found = driving(run, cache=cache / "kept")
    assert len(found) > 80 and any(at.segment is not None for at in found)
    # Only estimators find what a flag of a contradicted file tells; no method reads it.
    told = [
        replace(
            at,
            pose=replace(at.pose, flags=tuple(f for f in at.pose.flags if f.kind != FlagKind.CONTRADICTION)),
        )
        for at in found
    ]
    assert packed(tuple(told)) == packed(alone)


def test_that_of_a_rig_whose_load_may_change_under_way_is_made_when_it_is_asked_for(tmp_path: Path) -> None:
    log = write_candump(tmp_path / "x.log", simulate(MACHINE, 1, 2.0))
    (run,) = open_runs(log, machine=(CART, MACHINE_TEXT + LOAD_TEXT), cache=tmp_path / "kept")
    assert run.poses.rows
    assert [path.suffix for path in (tmp_path / "kept").iterdir()] == [".mcap"]
    assert len(driving(run, cache=tmp_path / "kept")) == run.poses.rows
