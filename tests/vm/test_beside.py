"""What a frame costs the recorder, beside candump and python-can's own logger. By hand: it is printed."""

import sys
from pathlib import Path

import pytest
from guest import boot, missing
from loopback import machine_text

pytestmark = [pytest.mark.vm_systemd, pytest.mark.skipif(missing() != "", reason=missing())]
BUS = '[[bus]]\nname = "can0"\ninterface = "socketcan"\nchannel = "vcan0"\nbitrate = 250000\n\n'


def test_beside_candump_and_python_can(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Printed, not judged: nothing here has the speed of hardware. Each has every frame."""
    (tmp_path / "machine.toml").write_text(machine_text(tmp_path, BUS))
    command, two = ["bash", "-e", "tests/vm/beside.sh"], ("-smp", "2")  # else the three have no time to spare
    with boot(command, tmp_path, options=two) as guest:
        guest.finish()
    rows = {}
    for line in (tmp_path / "cpu").read_text().splitlines():
        name, ticks, frames = line.split()
        rows[name] = int(ticks) * 10_000 / int(frames)  # us
        assert int(frames) >= 4000
    ours = rows["tilth"]
    words = [f" {name} {cost:.0f} us ({cost / ours:.2f} of ours)" for name, cost in rows.items()]
    with capsys.disabled():
        sys.stdout.write(f"\nCPU for each frame on an emulated processor:{','.join(words)}\n")
