"""On a real Dask cluster: a scheduler and workers in processes of their own, one killed, one that hangs."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID
from logs import some_frames, write_mcap
from loopback import until

from tilth.analysis.season.season import TABLE, season
from tilth.analysis.sensitivity import run_batches
from tilth.analysis.sensitivity.designs import DISSERTATION, Uniform
from tilth.analysis.sensitivity.run_batches import GlobalPlan, run
from tilth.analysis.workers.dask import (
    Certificates,
    DaskProblem,
    caution,
    check_versions,
    on_dask,
    versions,
)
from tilth.analysis.workers.parts import here
from tilth.deploy.certificates import new_authority
from tilth.estimator.models.parameters import TABLE_7_2

pytestmark = pytest.mark.long


pytest.importorskip("distributed")
PLAN = GlobalPlan("relaxation", TABLE_7_2, 7.5, 3.0, Uniform(DISSERTATION, 8_000))
BEGAN = datetime(2026, 1, 1, tzinfo=UTC)  # certificates
COMPUTE = ("tilth.analysis.sensitivity.run_batches", "tilth.analysis.season.identified")
QUIET = {"OPENBLAS_NUM_THREADS": "1", "DASK_DISTRIBUTED__WORKER__MEMORY__SPILL": "false"}


class Cluster:
    """A scheduler, and workers that are started one by one."""

    def __init__(self, folder: Path, stack: ExitStack, words: Sequence[str] = ()) -> None:
        """words: for the scheduler and each worker."""
        self._folder, self._stack, self._words = folder, stack, words
        self._file = folder / "scheduler.json"
        self.scheduler = self._start("dask_scheduler", "--port", "0", "--no-dashboard", "--no-show")
        until(self._is_up)
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
        """So many workers, once all are there and could begin at once: none is late since it imports."""
        for _ in range(count):
            words = (
                "--no-nanny",
                "--nthreads",
                "1",
                "--no-dashboard",
                "--local-directory",
                str(self._folder),
                *(word for module in COMPUTE for word in ("--preload", module)),
            )
            self.workers.append(self._start("dask_worker", *words))
        until(
            lambda: sum("Registered to" in log.read_text() for log in self._folder.glob("*worker*")) == count
        )

    def _start(self, module: str, *words: str) -> subprocess.Popen[bytes]:
        log = self._stack.enter_context((self._folder / f"{module}{time.monotonic_ns()}").open("wb"))
        process = subprocess.Popen(
            [sys.executable, "-m", f"distributed.cli.{module}", "--scheduler-file", str(self._file),
             *words, *self._words],
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


def test_three_workers_of_which_one_dies_and_one_hangs(
    cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same to the last digit as here; the batches of both are computed by others."""
    monkeypatch.setattr(run_batches, "LANE_SAMPLES", 100 * 1000)  # 24 batches
    cluster.work(3)

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
    monkeypatch.setattr(run_batches, "LANE_SAMPLES", 100 * 1000)
    cluster.work(1)

    def end(done: int, of: int) -> None:
        if done == 3:
            for process in (*cluster.workers, cluster.scheduler):
                process.kill()

    with pytest.raises(DaskProblem, match="kept"):
        run(PLAN, tmp_path / "kept", on_dask(cluster.address, hung_s=5.0), progress=end)
    assert len(list((tmp_path / "kept").rglob("*.npz"))) >= 3


def certified(folder: Path, name: str, authority: tuple[bytes, bytes] | None = None) -> Certificates:
    """Of both uses, as Dask's ends are server and client at once; signed by an authority, else by its own."""
    authority = authority or new_authority("another", BEGAN)
    signer = serialization.load_pem_private_key(authority[0], None)
    assert isinstance(signer, ec.EllipticCurvePrivateKey)
    issuer, key = x509.load_pem_x509_certificate(authority[1]), ec.generate_private_key(ec.SECP256R1())
    made = (
        x509.CertificateBuilder(issuer.subject, x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)]))
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(BEGAN)
        .not_valid_after(BEGAN + timedelta(days=20 * 365))
        .sign(signer, hashes.SHA256())
    )
    files = Certificates(*(str(folder / f"{name}.{part}") for part in ("ca", "pem", "key")))
    private = key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    contents = (authority[1], made.public_bytes(serialization.Encoding.PEM), private)
    for file, content in zip(files, contents, strict=True):
        Path(file).write_bytes(content)
    return files


def test_with_certificates_and_only_with_those_of_the_authority(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run_batches, "LANE_SAMPLES", 1000 * 1000)
    authority = new_authority("authority", BEGAN)
    cluster_files, mine = (certified(tmp_path, name, authority) for name in ("cluster", "me"))
    stranger = certified(tmp_path, "stranger")._replace(ca=mine.ca)
    words = [
        word
        for pair in zip(("--tls-ca-file", "--tls-cert", "--tls-key"), cluster_files, strict=True)
        for word in pair
    ]
    (tmp_path / "cluster.d").mkdir()
    with ExitStack() as stack:
        cluster = Cluster(tmp_path / "cluster.d", stack, ["--protocol", "tls", "--host", "127.0.0.1", *words])
        cluster.work(1)
        assert cluster.address.startswith("tls://127.0.0.1:") and caution(cluster.address) == ""
        found, _ = run(PLAN, tmp_path / "dask", on_dask(cluster.address, mine))
        monkeypatch.setattr("tilth.analysis.workers.dask.ANSWER_S", 3.0)
        with pytest.raises(DaskProblem, match="do its certificates and these have one authority"):
            run(PLAN, tmp_path / "stranger", on_dask(cluster.address, stranger))
        with pytest.raises(DaskProblem, match=r"tls://host:8786 needs --dask-tls"):
            run(PLAN, tmp_path / "without", on_dask(cluster.address))
        plain = cluster.address.replace("tls", "tcp")
        with pytest.raises(DaskProblem, match="no Dask scheduler answers"):
            run(PLAN, tmp_path / "plain", on_dask(plain))
    alone, _ = run(PLAN, tmp_path / "here", here(1))
    for x, y in zip(found.every, alone.every, strict=True):
        np.testing.assert_array_equal(x, y)


@pytest.mark.parametrize("part", range(3))
@pytest.mark.parametrize("content", [None, b"no PEM"])
def test_certificates_that_are_none(part: int, content: bytes | None, tmp_path: Path) -> None:
    files = list(certified(tmp_path, "me"))
    Path(files[part]).unlink()
    if content is not None:
        Path(files[part]).write_bytes(content)
    with pytest.raises(DaskProblem, match=r"--dask-tls .*give CA, certificate and key, as PEM files"):
        run(PLAN, tmp_path / "out", on_dask("tls://127.0.0.1:1", Certificates(*files)))


@pytest.mark.parametrize(("address", "said"), [
    ("tcp://127.0.0.1:8786", False), ("tcp://localhost:8786", False), ("tcp://[::1]:8786", False),
    ("tls://10.0.0.1:8786", False), ("tcp://10.0.0.1:8786", True), ("tcp://host:8786", True),
    ("ws://host:8786", True),
])  # fmt: skip
def test_what_is_open_is_said(address: str, said: bool) -> None:
    assert ("runs what they like on all its computers" in caution(address)) == said


def test_no_scheduler(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tilth.analysis.workers.dask.ANSWER_S", 0.5)
    with pytest.raises(DaskProblem, match=r"no Dask scheduler answers at tcp://127\.0\.0\.1:1"):
        run(PLAN, tmp_path, on_dask("tcp://127.0.0.1:1"))


@pytest.mark.parametrize("address", ["nonsense", "host:8786", "tcp://host", ""])
def test_what_is_no_address(address: str, tmp_path: Path) -> None:
    with pytest.raises(DaskProblem, match="no address of a Dask scheduler; give one such as"):
        run(PLAN, tmp_path, on_dask(address))


def test_a_scheduler_without_workers(
    cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tilth.analysis.workers.dask.ANSWER_S", 6.0)
    with pytest.raises(DaskProblem, match="has no worker"):
        run(PLAN, tmp_path, on_dask(cluster.address))


def test_workers_of_another_version_are_refused() -> None:
    mine = versions()
    check_versions(mine, {"tcp://a": dict(mine)})
    with pytest.raises(DaskProblem, match=r"the worker tcp://b has numpy 1\.0, here is"):
        check_versions(mine, {"tcp://a": dict(mine), "tcp://b": {**mine, "numpy": "1.0"}})


def test_without_dask(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(DaskProblem, match=r"pip install 'tilth\[dask\]'|uv sync .*dask"):
        run(PLAN, tmp_path, on_dask("tcp://127.0.0.1:1"))


def test_a_season_gives_the_same_table_as_processes_though_a_worker_dies(
    cluster: Cluster, tmp_path: Path
) -> None:
    pytest.importorskip("pyarrow")
    for k in range(6):
        write_mcap(tmp_path / f"day{k}.mcap", some_frames(800 + k), run=f"r{k}")
    logs = sorted(tmp_path.glob("*.mcap"))
    cluster.work(2)

    def trouble(what: str, done: float, of: float) -> None:
        if what == "identifying" and 0 < done < of and cluster.workers[0].poll() is None:
            cluster.workers[0].kill()

    names, out = [str(log) for log in logs], tmp_path / "dask"
    season(names, out, lambda longest_s: on_dask(cluster.address, hung_s=5.0), progress=trouble)
    season(names, tmp_path / "here", lambda longest_s: here(2))
    assert (out / TABLE).read_bytes() == (tmp_path / "here" / TABLE).read_bytes()
