"""The examples of subscribers, run against the daemon's own Zenoh; the one in Rust is built first."""

import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from client_daemon import NAME, Publisher
from google.protobuf.descriptor import Descriptor
from loopback import PATIENCE_S
from paths import ROOT

from tilth.schemas.proto import tilth_pb2 as pb

FOLDER = ROOT / "examples/consumer-rust"

PROTO = (FOLDER.parents[1] / "schemas/proto/tilth.proto").read_text(encoding="utf-8")
PYTHON = FOLDER.with_name("subscriber.py")


@pytest.fixture(scope="module")
def consumer() -> Path:
    """CARGO_TARGET_DIR, where it is set, keeps what was built for the next time."""
    if shutil.which("cargo") is None:
        pytest.skip("no cargo here: install Rust to build the example")
    command = ["cargo", "build", "--locked", "--message-format=json"]
    built = subprocess.run(command, cwd=FOLDER, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr[-3000:]
    (last,) = (line for line in built.stdout.splitlines() if '"executable":"' in line)
    return Path(last.partition('"executable":"')[2].partition('"')[0])


@pytest.fixture
def publisher() -> Iterator[Publisher]:
    with Publisher() as one:
        yield one


@pytest.mark.rust
def test_it_reads_what_the_daemon_publishes_and_knows_when_that_is_too_old(
    consumer: Path, publisher: Publisher
) -> None:
    command = [str(consumer), publisher.endpoint, f"tilth/{NAME}", "12"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as running:
        assert running.stdout is not None
        lines = iter(running.stdout)
        fresh = next(line for line in lines if "nothing has been heard" not in line)
        assert fresh.startswith("C_af=200000.0000; C_ar=450000.0000;") and "sigma_i=0.7000" in fresh
        publisher.order(absent=True)
        assert any(line.startswith("C_af: its value is none; C_ar: its value is none;") for line in lines)
        publisher.order(silent=True)
        assert any("C_af: no estimate for" in line for line in lines)
        running.stdout.read()
        assert running.wait(PATIENCE_S) == 0


@pytest.mark.rust
def test_wrong_use_is_told(consumer: Path) -> None:
    result = subprocess.run([consumer], capture_output=True, text=True, check=False)
    assert result.returncode == 2 and "ENDPOINT" in result.stderr


def test_the_one_in_python_takes_what_is_absent_for_no_number(publisher: Publisher) -> None:
    base = f"tilth/{NAME}"
    command = [sys.executable, str(PYTHON), publisher.endpoint, base, "100"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as running:
        assert running.stdout is not None
        lines = iter(running.stdout)
        assert next(lines).startswith("C_af=2e+05 sd=2e+04 ESTIMATED 0.5 s; C_ar=4.5e+05 sd=4.5e+04 ")
        publisher.order(absent=True)
        absent = next(line for line in lines if "nan" in line)
        assert absent.startswith("C_af=nan sd=nan ESTIMATED nan s; C_ar=nan ") and "=0" not in absent
        running.kill()
    result = subprocess.run([sys.executable, PYTHON], capture_output=True, text=True, check=False)
    assert result.returncode == 2 and "ENDPOINT" in result.stderr


@pytest.mark.parametrize("message", pb.DESCRIPTOR.message_types_by_name.values(), ids=lambda m: m.name)
def test_each_number_that_may_be_absent_says_so_where_it_is_read_first(message: Descriptor) -> None:
    """In tilth.proto: at the head, and at the field where a controller would take it for a value."""
    head, _, body = PROTO.partition("syntax")
    assert "optional" in head and "0.0" in head and "HasField" in head
    if message.name in ("BodyPose", "Pose", "Parameter", "SoilTireEstimate"):
        text = body.partition(f"message {message.name} {{")[2].partition("\n}")[0]
        assert "absent" in text
