"""A bare computer: installed, started by its own systemd on real CAN, hung, badly upgraded, removed."""

import sysconfig
import zipfile
from pathlib import Path

import pytest
from guest import CHECKOUT, boot, missing
from loopback import logged_frames

pytestmark = [pytest.mark.vm_systemd, pytest.mark.skipif(missing() != "", reason=missing())]

HERE = Path(__file__).parent


def broken(wheel: Path, target: Path) -> Path:
    """A release that takes the machine file and then does not start."""
    with zipfile.ZipFile(wheel) as old, zipfile.ZipFile(target, "w") as new:
        for name in old.namelist():
            new.writestr(name, b"raise SystemExit(3)\n" if name == "tilth/cli/run.py" else old.read(name))
    return target


def test_from_a_bare_computer_to_recording_and_back(tmp_path: Path, wheel: Path) -> None:
    out = tmp_path / "out"
    for folder, made in (("good", wheel.read_bytes()), ("bad", broken(wheel, tmp_path / "w").read_bytes())):
        (out / folder).mkdir(parents=True)
        (out / folder / wheel.name).write_bytes(made)
    machine = (CHECKOUT / "deploy/machines/jd7930-parker500.toml").read_text()
    (out / "machine.toml").write_text(machine)
    environment = [
        "env",
        f"NEEDED={sysconfig.get_path('purelib')}",
        f"WHEEL={wheel.name}",
        f"CHECKOUT={CHECKOUT}",
    ]
    command = ["bash", "-x", str(HERE / "with_systemd.sh"), *environment]
    with boot([*command, "bash", "-ex", str(HERE / "bare_box.sh")], out) as guest:
        guest.finish()
    states = (out / "states").read_text()
    assert "User=tilth" in states and "StatusText=recording, " in states
    assert (out / "current").read_text() == "releases/1\n"
    # before the hang, after it, after the bad release, after the roll-back
    assert len((out / "logs").read_text().split()) >= 4
    frames = [f for path in sorted(out.glob("*.mcap")) for f in logged_frames(path)]
    assert [frame.can_id for frame in frames] == [0x123] * 20
