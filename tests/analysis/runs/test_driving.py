"""A run's driving as the estimators take it: what the fold gave live, whole or in parts; kept."""

import math
from pathlib import Path

import numpy as np
import pytest
from recorded import recorded

import tilth.analysis
from tilth.analysis.runs import driven
from tilth.analysis.runs import driving as module
from tilth.analysis.runs.driven import Driven
from tilth.analysis.runs.driving import driving
from tilth.analysis.runs.kept import packed

pytestmark = pytest.mark.long


def rows(found: tuple[Driven, ...]) -> np.ndarray:
    return np.concatenate([at.segment.record.rows for at in found if at.segment is not None])


def test_poses_are_those_that_were_recorded(tmp_path: Path) -> None:
    (run,) = tilth.analysis.open(recorded().parts)
    done: list[tuple[int, int]] = []
    found = driving(run, lambda *at: done.append(at), tmp_path)
    assert [at.t_ns for at in found] == [round(t * 1e9) + run.start_ns for t in run.poses.t_s]
    assert [at.pose.tractor.heading for at in found] == run.poses["tractor_heading_rad"].tolist()
    usable = [at for at in found if at.segment is not None and not at.segment.reason]
    assert len(usable) > 200 and done and done[-1][0] <= done[-1][1]


def test_times_that_are_asked_for_are_given_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(driven, "BLOCK", 50)
    (run,) = tilth.analysis.open(recorded().parts)
    whole = driving(run, cache=tmp_path)
    times = [at.t_ns for at in whole]
    for first, last in ((0, 0), (7, 7), (48, 52), (49, 49), (50, 120), (0, len(times) - 1)):
        wanted = driving(run, cache=tmp_path, between_ns=(times[first], times[last]))
        assert packed(wanted) == packed(whole[first : last + 1])
    assert driving(run, cache=tmp_path, between_ns=(times[-1] + 1, math.inf)) == ()


def test_parts_give_what_the_whole_gives(tmp_path: Path) -> None:
    (whole,), (parts,) = (tilth.analysis.open(recorded(count).parts) for count in (1, 3))
    one, other = (driving(run, cache=tmp_path) for run in (whole, parts))
    assert len(one) == len(other) and np.array_equal(rows(one), rows(other))


def test_a_part_alone_knows_its_receivers(tmp_path: Path) -> None:
    (run,) = tilth.analysis.open(recorded(3).parts[2])
    assert len(driving(run, cache=tmp_path)) > 60


def test_it_is_kept_and_a_damaged_one_is_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (run,) = tilth.analysis.open(recorded(3).parts[1])
    first = driving(run, cache=tmp_path)
    (kept,) = tmp_path.iterdir()
    with monkeypatch.context() as patch:
        patch.setattr(module, "_drive", lambda *_: pytest.fail("made again"))
        assert len(driving(run, cache=tmp_path)) == len(first)
    kept.write_bytes(kept.read_bytes()[:100])
    assert len(driving(run, cache=tmp_path)) == len(first)


def test_a_cache_that_cannot_be_written_costs_no_result(tmp_path: Path) -> None:
    in_the_way = tmp_path / "file"
    in_the_way.write_text("")
    (run,) = tilth.analysis.open(recorded(3).parts[1])
    assert driving(run, cache=in_the_way / "cache")
