"""The consumer in a second language, built and run against the daemon's own Zenoh."""

import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from client_daemon import NAME, Publisher
from loopback import PATIENCE_S

FOLDER = Path(__file__).resolve().parents[1] / "examples/consumer-rust"

pytestmark = [
    pytest.mark.rust,
    pytest.mark.skipif(
        shutil.which("cargo") is None, reason="no cargo here: install Rust to build the example"
    ),
]


@pytest.fixture(scope="module")
def consumer() -> Path:
    """CARGO_TARGET_DIR, where it is set, keeps what was built for the next time."""
    command = ["cargo", "build", "--locked", "--message-format=json"]
    built = subprocess.run(command, cwd=FOLDER, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr[-3000:]
    (last,) = (line for line in built.stdout.splitlines() if '"executable":"' in line)
    return Path(last.partition('"executable":"')[2].partition('"')[0])


@pytest.fixture
def publisher() -> Iterator[Publisher]:
    with Publisher() as one:
        yield one


def test_it_reads_what_the_daemon_publishes_and_knows_when_that_is_too_old(
    consumer: Path, publisher: Publisher
) -> None:
    command = [str(consumer), publisher.endpoint, f"tilth/{NAME}", "12"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as running:
        assert running.stdout is not None
        lines = iter(running.stdout)
        fresh = next(line for line in lines if "nothing has been heard" not in line)
        assert fresh.startswith("C_af=200000.0000; C_ar=450000.0000;") and "sigma_i=0.7000" in fresh
        publisher.order(silent=True)
        assert any("C_af: no estimate for" in line for line in lines)
        running.stdout.read()
        assert running.wait(PATIENCE_S) == 0


def test_wrong_use_is_told(consumer: Path) -> None:
    told = subprocess.run([consumer], capture_output=True, text=True, check=False)
    assert told.returncode == 2 and "ENDPOINT" in told.stderr
