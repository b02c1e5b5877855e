"""Batches: the same with any number of processes, and after an interruption."""

import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tilth.analysis.sensitivity import run_batches
from tilth.analysis.sensitivity.accumulators import mean
from tilth.analysis.sensitivity.designs import DISSERTATION, Grid, LogNormal, Uniform, grid
from tilth.analysis.sensitivity.global_answer import global_answer
from tilth.analysis.sensitivity.local import local_sensitivities, overall
from tilth.analysis.sensitivity.outputs import SIX, Unstable
from tilth.analysis.sensitivity.run_batches import GlobalPlan, Part, pairs, part_of, run
from tilth.analysis.sensitivity.slopes import VARIED
from tilth.analysis.workers.parts import here
from tilth.estimator.models.family import model_named
from tilth.estimator.models.parameters import TABLE_7_2

PLAN = GlobalPlan("relaxation", TABLE_7_2, 7.5, 0.5, Grid(DISSERTATION, 2))  # 256 points


def _same(a: Part, b: Part) -> None:
    for x, y in zip((*a.every, *a.stable, *a[2:]), (*b.every, *b.stable, *b[2:]), strict=True):
        np.testing.assert_array_equal(x, y)


def test_two_processes_find_what_one_finds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_batches, "LANE_SAMPLES", 50 * 100)  # three batches
    one, _ = run(PLAN, tmp_path / "one", here(1))
    seen: list[tuple[int, int]] = []
    two, already = run(PLAN, tmp_path / "two", here(2), progress=lambda *at: seen.append(at))
    _same(one, two)
    assert (already, seen[0], seen[-1]) == (0, (0, 3), (3, 3))


def test_an_interrupted_run_goes_on_where_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_batches, "LANE_SAMPLES", 50 * 64)

    def stop(done: int, of: int) -> None:
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(PLAN, tmp_path, here(1), progress=stop)
    went_on, already = run(PLAN, tmp_path, here(1))
    assert already == 2
    whole, already = run(PLAN, tmp_path / "other", here(1))
    assert already == 0
    _same(went_on, whole)
    assert not list(tmp_path.rglob("*.unfinished"))


DAMAGE: dict[str, Callable[[bytes], bytes]] = {
    "cut": lambda stored: stored[: len(stored) // 2],
    "flipped": lambda stored: stored[:300] + bytes([stored[300] ^ 1]) + stored[301:],
    "zeros": lambda stored: bytes(len(stored)),
    "empty": lambda stored: b"",
    "of others": lambda stored: pickle.dumps([1, 2]),
}


@pytest.mark.parametrize("what", DAMAGE)
def test_a_damaged_batch_is_made_again(what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_batches, "LANE_SAMPLES", 50 * 128)
    whole, _ = run(PLAN, tmp_path, here(1))
    path = next(tmp_path.rglob("0.npz"))
    path.write_bytes(DAMAGE[what](path.read_bytes()))
    again, already = run(PLAN, tmp_path, here(1))
    assert already == 1
    _same(again, whole)


def test_the_answer_is_the_mean_of_the_local_ones() -> None:
    """Held to the overall local sensitivity at each stable corner, one by one."""
    plan = PLAN._replace(seconds=0.2)
    part = part_of(plan, 116, 140)
    found, unstable = [], 0
    relaxation = model_named("relaxation")
    for at in grid(DISSERTATION, 116, 140, 2):
        rig = TABLE_7_2._replace(**dict(zip(DISSERTATION.names, at.tolist(), strict=True)))
        try:
            local = local_sensitivities(relaxation, rig, 7.5, seconds=0.2, parameters=VARIED)
        except Unstable:
            unstable += 1
        else:
            found.append(overall(local.step))
    assert part.unstable[0, 0].sum() == unstable > 0
    overalls = mean(part.stable).reshape(8, 7)[:, 0]
    np.testing.assert_allclose(overalls, np.mean(found, axis=0), rtol=1e-7)


def test_the_answer_names_the_side_that_is_unstable() -> None:
    answer: Any = global_answer(PLAN, part_of(PLAN, 0, PLAN.design.size))
    assert 0 < answer["unstable_share"] < 0.5
    assert "C_af high" in answer["unstable_where"] and "C_ar low" in answer["unstable_where"]
    for row in answer["global"].values():
        assert row["q05"] < row["median"] < row["q95"]


def test_a_full_disk_leaves_nothing_half_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if not Path("/dev/full").exists():
        pytest.skip("no /dev/full here")
    opened = Path.open
    monkeypatch.setattr(Path, "open", lambda self, *args: opened(Path("/dev/full"), *args))
    with pytest.raises(OSError, match=f"No space.*{tmp_path.name}"):
        run(PLAN._replace(seconds=0.05), tmp_path, here(1))
    assert not list(tmp_path.rglob("*.npz"))


NARROW = LogNormal(("C_af", "C_ar"), (220e3, 486e3), ((0.04, 0.01), (0.01, 0.09)), 300)


@pytest.mark.parametrize("design", [Uniform(DISSERTATION, 300), NARROW])
def test_random_points(design: Uniform | LogNormal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same from one batch and from several; every point is in a level."""
    plan = PLAN._replace(design=design, seconds=0.2)
    whole = part_of(plan, 0, 300)
    monkeypatch.setattr(run_batches, "LANE_SAMPLES", 20 * 128)
    parts, _ = run(plan, tmp_path, here(1))
    np.testing.assert_array_equal(parts.every.bins, whole.every.bins)
    np.testing.assert_allclose(mean(parts.every), mean(whole.every), rtol=1e-12)
    levels = design.levels_of(0, 300)
    assert levels.min() == 0 and levels.max() == design.levels - 1
    assert np.all(np.abs(np.bincount(levels[:, 0]) - 60) < 25)


def test_what_no_linear_model_has_is_refused(tmp_path: Path) -> None:
    design = NARROW._replace(names=("C_af", "h_t"))
    with pytest.raises(ValueError, match="h_t: no parameter of the linear models"):
        run(PLAN._replace(design=design), tmp_path, here(1))


def test_without_the_compiled_loop_it_is_the_same() -> None:
    """The way that has any model, output and steering, asked for what both have."""
    plan = PLAN._replace(seconds=0.2)
    slow = plan._replace(outputs=(*SIX, "cross_track"))
    assert plan.quick and not slow.quick
    one, two = part_of(plan, 110, 124), part_of(slow, 110, 124)
    for quick, whole in ((one.every, two.every), (one.stable, two.stable)):
        rows = mean(whole).reshape(8, 8)
        np.testing.assert_allclose(mean(quick).reshape(8, 7)[:, 1:], rows[:, 1:7], rtol=1e-6, atol=1e-9)
    np.testing.assert_array_equal(one.unstable, two.unstable)


def test_pairs_are_counted_at_their_levels() -> None:
    found = pairs(np.array([[0, 1], [0, 1], [2, 0]]), 3)
    assert found[0, 1, 0, 1] == found[1, 0, 1, 0] == 2 and found[0, 1, 2, 0] == 1
    assert np.diagonal(found[0, 0]).tolist() == [2, 0, 1] and found[0, 0].sum() == 3


def test_memory_does_not_grow_with_the_design() -> None:
    for seconds in (0.02, 3.0, 30.0):
        for size in (1000, 10**6, 10**9):
            batch = PLAN._replace(seconds=seconds, design=Uniform(DISSERTATION, size)).batch
            assert 1 <= batch <= run_batches.MOST_POINTS
