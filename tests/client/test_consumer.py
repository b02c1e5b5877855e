"""The examples of subscribers, run against the daemon's own Zenoh; those in Rust and C++ are built first."""

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from client_daemon import NAME, Publisher
from google.protobuf.descriptor import Descriptor
from loopback import PATIENCE_S
from paths import ROOT
from rust_build import build, in_rust

from tilth.schemas.proto import tilth_pb2 as pb

FOLDER = ROOT / "examples/consumer-rust"
IN_CPP = FOLDER.with_name("consumer-cpp")

PROTO = (FOLDER.parents[1] / "schemas/proto/tilth.proto").read_text(encoding="utf-8")
PYTHON = FOLDER.with_name("subscriber.py")


def in_cpp() -> Path:
    """Zenoh by zenoh-cpp where that is installed, else by cargo."""
    if missing := [tool for tool in ("cmake", "c++", "protoc", "cargo") if shutil.which(tool) is None]:
        pytest.skip(f"no {missing[0]} here: it builds the example")
    kept = os.environ.get("CARGO_TARGET_DIR") or str(FOLDER / "target")
    folder = Path(kept) / "consumer-cpp"  # perhaps of another checkout: --fresh
    build(["cmake", "--fresh", "-S", str(IN_CPP), "-B", str(folder)], ROOT)
    build(["cmake", "--build", str(folder)], ROOT)
    return folder / "tilth_consumer"


@pytest.fixture(scope="module", params=[lambda: in_rust(FOLDER), in_cpp], ids=["rust", "cpp"])
def consumer(request: pytest.FixtureRequest) -> Path:
    made: Callable[[], Path] = request.param
    return made()


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
        fresh = next(line for line in lines if re.match(r"C_af=2\S+; C_ar=4", line))
        assert fresh.startswith("C_af=200000.0000; C_ar=450000.0000;") and "sigma_i=0.7000" in fresh
        publisher.order(absent=True)
        assert any(re.match(r"C_af: (its value is none|no_value); C_ar: ", line) for line in lines)
        publisher.order(silent=True)
        assert any(re.match(r"C_af: (no estimate for|silence)", line) for line in lines)
        running.stdout.read()
        assert running.wait(PATIENCE_S) == 0


@pytest.mark.rust
def test_wrong_use_is_told(consumer: Path) -> None:
    result = subprocess.run([consumer], capture_output=True, text=True, check=False)
    assert result.returncode == 2 and "ENDPOINT" in result.stderr


@pytest.mark.rust
def test_the_ring_of_the_one_in_cpp_loses_nothing_under_the_thread_sanitizer() -> None:
    told = subprocess.run([in_cpp().with_name("ring_test")], capture_output=True, text=True, check=False)
    assert told.returncode == 0 and told.stdout == "1000000 values, 0 wrong\n", told.stderr[-2000:]


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


@pytest.mark.long  # it waits for three seconds
def test_the_one_in_python_says_what_is_heard_instead(publisher: Publisher) -> None:
    command = [sys.executable, str(PYTHON), publisher.endpoint, "tilth/another", "1"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as running:
        assert running.stderr is not None
        assert running.stderr.readline() == f"nothing from tilth/another; heard: tilth/{NAME}\n"
        running.kill()


@pytest.mark.parametrize("message", pb.DESCRIPTOR.message_types_by_name.values(), ids=lambda m: m.name)
def test_each_number_that_may_be_absent_says_so_where_it_is_read_first(message: Descriptor) -> None:
    """In tilth.proto: at the head, and at the field where a controller would take it for a value."""
    head, _, body = PROTO.partition("syntax")
    assert "optional" in head and "0.0" in head and "HasField" in head
    if message.name in ("BodyPose", "Pose", "Parameter", "SoilTireEstimate"):
        before, _, fields = body.partition(f"message {message.name} {{")
        assert "absent" in before.rpartition("}")[2] + fields.partition("\n}")[0]
