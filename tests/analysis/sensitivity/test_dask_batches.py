"""On a real Dask cluster: a scheduler and workers in processes of their own, one killed, one that hangs."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from tilth.analysis.sensitivity import run_batches
from tilth.analysis.sensitivity.dask_batches import DaskProblem, check_versions, on_dask, versions
from tilth.analysis.sensitivity.designs import DISSERTATION, Uniform
from tilth.analysis.sensitivity.run_batches import GlobalPlan, here, run
from tilth.estimator.models.parameters import TABLE_7_2

pytestmark = pytest.mark.long


pytest.importorskip("distributed")
PLAN = GlobalPlan("relaxation", TABLE_7_2, 7.5, 3.0, Uniform(DISSERTATION, 24_000))
QUIET = {"OPENBLAS_NUM_THREADS": "1", "DASK_DISTRIBUTED__WORKER__MEMORY__SPILL": "false"}


class Cluster:
    """A scheduler, and workers that are started one by one."""

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        self._folder, self._stack = folder, stack
        self._file = folder / "scheduler.json"
        self.scheduler = self._start("dask_scheduler", "--port", "0", "--no-dashboard", "--no-show")
        deadline = time.monotonic() + 60.0
        while not self._is_up():
            assert time.monotonic() < deadline and self.scheduler.poll() is None
            os.sched_yield()
        self.workers: list[subprocess.Popen[bytes]] = []

    def _is_up(self) -> bool:
        try:  # the file is there before what is written into it
            return bool(self.address)
        except (FileNotFoundError, json.JSONDecodeError):
            return False

    @property
    def address(self) -> str:
        return str(json.loads(self._file.read_text(encoding="utf-8"))["address"])

    def work(self, count: int) -> None:
        for _ in range(count):
            words = (
                "--no-nanny",
                "--nthreads",
                "1",
                "--no-dashboard",
                "--local-directory",
                str(self._folder),
            )
            self.workers.append(self._start("dask_worker", *words))

    def _start(self, module: str, *words: str) -> subprocess.Popen[bytes]:
        log = self._stack.enter_context((self._folder / f"{module}{time.monotonic_ns()}").open("wb"))
        process = subprocess.Popen(
            [sys.executable, "-m", f"distributed.cli.{module}", "--scheduler-file", str(self._file), *words],
            stdout=log, stderr=log, env={**os.environ, **QUIET},
        )  # fmt: skip
        self._stack.callback(process.wait)
        self._stack.callback(process.kill)
        return process


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    folder = tmp_path / "cluster"
    folder.mkdir()
    with ExitStack() as stack:
        yield Cluster(folder, stack)


def test_four_workers_of_which_one_dies_and_one_hangs(
    cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same to the last digit as here; the batches of both are computed by others."""
    monkeypatch.setattr(run_batches, "LANE_SAMPLES", 300 * 1000)  # 24 batches
    cluster.work(4)

    def trouble(done: int, of: int) -> None:
        if done == 2:
            cluster.workers[0].kill()
            cluster.workers[1].send_signal(signal.SIGSTOP)

    try:
        found, _ = run(PLAN, tmp_path / "dask", on_dask(cluster.address, hung_s=5.0), progress=trouble)
    finally:
        cluster.workers[1].send_signal(signal.SIGCONT)
    alone, _ = run(PLAN, tmp_path / "here", here(1))
    for x, y in zip((*found.every, *found.stable), (*alone.every, *alone.stable), strict=True):
        np.testing.assert_array_equal(x, y)


def test_a_cluster_that_ends_keeps_what_was_done(
    cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run_batches, "LANE_SAMPLES", 300 * 1000)
    cluster.work(1)

    def end(done: int, of: int) -> None:
        if done == 3:
            for process in (*cluster.workers, cluster.scheduler):
                process.kill()

    with pytest.raises(DaskProblem, match="kept"):
        run(PLAN, tmp_path / "kept", on_dask(cluster.address, hung_s=5.0), progress=end)
    assert len(list((tmp_path / "kept").rglob("*.npz"))) >= 3


def test_no_scheduler(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tilth.analysis.sensitivity.dask_batches.ANSWER_S", 0.5)
    with pytest.raises(DaskProblem, match=r"no Dask scheduler answers at tcp://127\.0\.0\.1:1"):
        run(PLAN, tmp_path, on_dask("tcp://127.0.0.1:1"))


@pytest.mark.parametrize("address", ["nonsense", "host:8786", "tcp://host", ""])
def test_what_is_no_address(address: str, tmp_path: Path) -> None:
    with pytest.raises(DaskProblem, match="no address of a Dask scheduler; give one such as"):
        run(PLAN, tmp_path, on_dask(address))


def test_a_scheduler_without_workers(
    cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tilth.analysis.sensitivity.dask_batches.ANSWER_S", 6.0)
    with pytest.raises(DaskProblem, match="has no worker"):
        run(PLAN, tmp_path, on_dask(cluster.address))


def test_workers_of_another_version_are_refused() -> None:
    mine = versions()
    check_versions(mine, {"tcp://a": dict(mine)})
    with pytest.raises(DaskProblem, match=r"the worker tcp://b has numpy 1\.0, here is"):
        check_versions(mine, {"tcp://a": dict(mine), "tcp://b": {**mine, "numpy": "1.0"}})


def test_without_dask(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(DaskProblem, match=r"pip install tilth\[dask\]"):
        run(PLAN, tmp_path, on_dask("tcp://127.0.0.1:1"))
