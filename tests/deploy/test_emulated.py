"""A log that this computer has recorded is verified on an emulated ARMv8."""

import json
import platform
import shutil
import tempfile
from pathlib import Path

import pytest
from logs import MACHINE, record

from tilth.deploy import emulated
from tilth.simulator.traffic import simulate

ROOT = Path(tempfile.gettempdir()) / "tilth-armv8"  # kept: it takes minutes to make


@pytest.mark.elsewhere
@pytest.mark.skipif(
    shutil.which(emulated.EMULATOR) is None, reason="no qemu: apt-get install qemu-user-static"
)
@pytest.mark.skipif(shutil.which("mmdebstrap") is None, reason="apt-get install mmdebstrap arch-test")
def test_another_kind_of_processor_gives_the_same(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Where the checkout has no kernels of ARMv8 yet, they are compiled first: an hour."""
    live = record(tmp_path, list(simulate(MACHINE, 3, 30.0)), 1)
    emulated.make(ROOT)
    done = emulated.run(ROOT, "-m", "tilth.cli", "replay", "--verify", "--json", str(live.parts[0]))
    found = json.loads(capfd.readouterr().out)["verify"]
    assert (done.returncode, found["difference"], found["compared"]) == (0, None, live.results)
    assert f"{platform.machine()}, here aarch64" in found["recorded_elsewhere"]
