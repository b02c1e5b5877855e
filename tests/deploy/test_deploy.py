"""From a wheel to a computer that records, and back: the installer for real, in a folder for a computer."""

import fcntl
import os
import platform
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from loopback import TEXT
from paths import ROOT
from setup_box import Box, without_tilth

from tilth.deploy import can_up
from tilth.deploy.install import HOTSPOT, KERNELS, Failed, _files_beside, adapter_rule
from tilth.schemas.machine_toml import parse_machine

SYSTEM = ROOT / "deploy" / "system"
UNITS = ("tilth.service", "tilth-can@.service", "tilth-page.service")
FOR_PHONES = ("tilth-take.service", "tilth-take.path", "tilth-hotspot.service")  # root's own, no server
# As `tilth calibrate` of f0c62115 (2026-11-25) wrote it, of its left_kingpin.toml and calibration_drive.toml.
OLDER_MACHINE = Path(__file__).with_name("older_machine.toml")
EXPOSED = 2.5  # of 10: the most that `systemd-analyze security` may find


@pytest.mark.long
def test_install_upgrade_roll_back_and_uninstall_keep_the_logs(tmp_path: Path, wheel: Path) -> None:
    box = Box(tmp_path, without_tilth(tmp_path / "needed"))
    machine = tmp_path / "machine.toml"
    machine.write_text(TEXT.replace('prefix = "tilth"', 'prefix = "tilth"\nconfig = "daemon.json"'))
    keys = tmp_path / "daemon.json"
    keys.write_text("{}")

    result = box.setup("upgrade", wheel)
    assert result.returncode == 1 and "nothing is installed yet" in result.stderr
    assert not box.root.exists()
    result = box.setup("install", wheel)
    assert result.returncode == 0 and "starts once it knows the rig" in result.stdout, result.stderr
    assert box.tilth("--help").returncode == 0 and not (box.root / KERNELS).exists()  # and is not started

    result = box.setup("machine", machine, "--keys", keys)
    assert result.returncode == 0, result.stderr
    assert "release 1) is current" in result.stdout and "not used" not in result.stdout
    assert (box.root / "etc/tilth/machine.toml").read_text() == machine.read_text()
    assert (box.root / "etc/tilth/daemon.json").stat().st_mode & 0o777 == 0o640
    assert box.tilth("--help").returncode == 0
    assert (box.root / KERNELS).is_dir() and "in advance failed" not in result.stdout + result.stderr
    for name in (*UNITS, *FOR_PHONES):
        assert (box.root / "etc/systemd/system" / name).read_text() == (SYSTEM / name).read_text()
    expect_a_page(box, tmp_path)
    log = box.root / "var/lib/tilth/logs/a.mcap"
    log.parent.mkdir(parents=True)
    log.write_text("a season")

    assert box.setup("rollback").returncode == 1  # there is none before
    installed = box.root / "etc/tilth/machine.toml"
    older = OLDER_MACHINE.read_text()
    installed.write_text(older.replace("kingpin_distance", "kingpin_place"))
    result = box.setup("upgrade", wheel)
    assert result.returncode == 1 and 'did you mean "kingpin_distance"' in result.stderr
    assert box.release("current") == "1" and not (box.root / "opt/tilth/releases/2").exists()
    installed.write_text(older)
    result = box.setup("upgrade", wheel)
    assert result.returncode == 0 and (box.release("current"), box.release("previous")) == ("2", "1")
    assert installed.read_text() == older
    for name, words in (
        ("bad.whl", "no wheel of Tilth"),
        ("empty", "give a wheel"),
        (
            "tilth-9.0.0-py3-none-linux_riscv64.whl",
            f"is for riscv64 and this computer is {platform.machine()}",
        ),
    ):
        bad = tmp_path / name
        bad.write_text("") if bad.suffix else bad.mkdir()
        result = box.setup("upgrade", bad)
        assert result.returncode == 1 and words in result.stderr
    installed.write_text(TEXT.replace("[tractor]", "[traktor]"))
    result = box.setup("rollback")
    assert result.returncode == 1 and 'did you mean "tractor"' in result.stderr
    assert (box.release("current"), box.release("previous")) == ("2", "1")
    assert {path.name for path in (box.root / "opt/tilth/releases").iterdir()} == {"1", "2"}
    installed.write_text(machine.read_text())
    assert box.setup("rollback").returncode == 0
    assert (box.release("current"), box.release("previous")) == ("1", "2")
    assert "current   1: tilth 0" in box.setup("status").stdout

    hotspot = box.root / HOTSPOT  # as `phone` makes it
    hotspot.parent.mkdir(parents=True)
    hotspot.touch()
    assert box.setup("uninstall").returncode == 0
    assert box.files() == {
        "etc/tilth/machine.toml", "etc/tilth/daemon.json", "var/lib/tilth/logs/a.mcap",
    }  # fmt: skip


def test_a_machine_file_of_an_older_release_says_what_it_said() -> None:
    machine = parse_machine(OLDER_MACHINE.read_text())
    tractor, sensor, receiver = machine.tractor, machine.wheel_angle, machine.receiver[0]
    found = (tractor.c, sensor.zero, sensor.curve, sensor.gain, receiver.latency)
    assert [(each.value, each.sd) for each in found] == [
        (2.1347, 0.016), (-0.0961, 0.015), (0.004335937, 0.0086), (1.0, 0.0061), (0.143, 0.005),
    ]  # fmt: skip
    assert (sensor.kingpin, sensor.scale, tractor.kingpin_distance) == ("left", 0.009973109, 1.7)


def expect_a_page(box: Box, tmp_path: Path) -> None:
    """With a label; what it saves is taken as soon as no run is recorded."""
    stick = tmp_path / "label.toml"
    result = box.setup("phone", stick)
    assert result.returncode == 0 and "page        port 8117, code " in result.stdout, result.stderr
    assert (box.root / "etc/tilth/label.toml").read_text() == stick.read_text()
    installed, log = box.root / "etc/tilth/machine.toml", box.root / "var/lib/tilth/logs/now.mcap"
    before, saved = installed.read_text(), tmp_path / "saved" / "machine.toml"
    saved.parent.mkdir()
    saved.write_text(before)
    assert "in use already" in box.setup("take", saved).stdout
    saved.write_text(before.replace("jd7930-parker500", "other"))
    log.parent.mkdir(parents=True)
    with log.open("w") as stream:
        fcntl.flock(stream, fcntl.LOCK_EX)
        result = box.setup("take", saved)
        assert result.returncode == 75 and "is being recorded" in result.stderr
    assert installed.read_text() == before
    for text, says in (
        ("[tractor", "does not take the machine file"),
        ("#" * 2_000_000, "is no machine file"),
    ):
        bad = tmp_path / "bad.toml"
        bad.write_text(text)
        result = box.setup("take", bad)
        assert result.returncode == 1 and says in result.stderr, result.stderr
    link = tmp_path / "link.toml"
    link.symlink_to(saved)
    assert box.setup("take", link).returncode == 1 and installed.read_text() == before
    result = box.setup("take", saved)
    assert result.returncode == 0, result.stderr
    kept = installed.with_name("machine.toml.before")
    assert (installed.read_text(), kept.read_text()) == (saved.read_text(), before)
    kept.replace(installed)
    shutil.rmtree(log.parent)
    (box.root / "etc/tilth/label.toml").unlink()


@pytest.mark.cold
def test_the_first_start_finds_the_kernels_compiled(tmp_path: Path, wheel: Path) -> None:
    """Where the unit lets the recorder look for them."""
    box = Box(tmp_path, without_tilth(tmp_path / "needed"), kernels=True)
    machine = tmp_path / "machine.toml"
    machine.write_text(TEXT)
    result = box.setup("install", wheel, "--machine", machine)
    assert result.returncode == 0 and "compiling" not in result.stdout  # the wheel carries them
    unit = (SYSTEM / "tilth.service").read_text()
    assert f"Environment=NUMBA_CACHE_DIR=/{KERNELS} " in unit and "CacheDirectory=tilth\n" in unit
    logs = str(tmp_path / "logs")
    done = box.tilth("run", str(machine), "--log", logs, "--no-zenoh", "--plain", "--seconds", "1")
    assert "recording, " in done.stdout and "compil" not in done.stdout + done.stderr
    assert box.setup("uninstall").returncode == 0 and not (box.root / KERNELS).exists()


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="no systemd-analyze")
@pytest.mark.parametrize("name", [*UNITS, *FOR_PHONES])
def test_systemd_understands_the_unit_and_finds_little_exposed(name: str, tmp_path: Path) -> None:
    for unit in (*UNITS, *FOR_PHONES):  # what they start is not here
        text = (SYSTEM / unit).read_text()
        (tmp_path / unit).write_text(re.sub("(?m)^ExecStart=[^ ]*", "ExecStart=/bin/true", text))
    done = subprocess.run(
        ["systemd-analyze", "verify", "--recursive-errors=no", str(tmp_path / name)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0 and done.stderr == ""
    if name in FOR_PHONES:
        return
    score = ["systemd-analyze", "security", "--offline=true", f"--threshold={EXPOSED * 10:.0f}"]
    done = subprocess.run([*score, str(tmp_path / name)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


def test_the_unit_starts_what_the_installer_puts_there() -> None:
    text = (SYSTEM / "tilth.service").read_text()
    assert "ExecStart=/opt/tilth/current/bin/tilth run /etc/tilth/machine.toml" in text
    assert "Type=notify" in text and "User=tilth" in text and "WatchdogSec=60" in text


def test_the_installed_versions_are_those_of_the_lock_file() -> None:
    lock = (ROOT / "uv.lock").read_text()
    pins = [line.partition(" ;")[0] for line in (ROOT / "deploy/constraints.txt").read_text().splitlines()]
    assert len(pins) > 30
    for pin in pins:
        name, _, version = pin.partition("==")
        assert f'name = "{name}"\nversion = "{version}"' in lock, (
            "run `python -m tilth.deploy.generate` after a change of uv.lock"
        )


@pytest.mark.parametrize(
    ("properties", "condition"),
    [
        (
            {"ID_SERIAL_SHORT": "0042", "ID_PATH": "pci-0"},
            'ENV{ID_SERIAL_SHORT}=="0042", ATTR{dev_port}=="1"',
        ),
        ({"ID_PATH": "pci-0:usb-1.2"}, 'ENV{ID_PATH}=="pci-0:usb-1.2", ATTR{dev_port}=="1"'),
    ],
)
def test_an_adapter_keeps_its_name(properties: dict[str, str], condition: str) -> None:
    rule = adapter_rule(properties, "1", "can_tractor")
    assert condition in rule and rule.endswith('NAME="can_tractor"\n')


def test_an_adapter_that_nothing_tells_apart_is_refused(tmp_path: Path) -> None:
    with pytest.raises(Failed, match="neither serial number nor path"):
        adapter_rule({}, "0", "can_tractor")
    for words, output in (
        (("can0", "can7"), "the kernel gives such names itself"),
        (("can0", "../x"), "letters, digits and underscores"),
        (("nothing9", "can_tractor"), "no such interface"),
    ):
        done = Box(tmp_path, tmp_path).setup("adapter", *words)
        assert done.returncode == 1 and output in done.stderr


MACHINE = '[[bus]]\ninterface = "socketcan"\nchannel = "can0"\nbitrate = 500000\n'


@pytest.mark.parametrize(
    ("words", "text", "status", "expected"),
    [
        (["can7"], MACHINE, 0, "can7 is no socketcan [[bus]]"),
        (["can0"], MACHINE.replace("500000", '"fast"'), 1, "give bits per second, such as 250000"),
        (["can0"], MACHINE.replace("500000", "0"), 1, "give bits per second"),
        (["can0"], "[[bus", 1, "machine.toml: "),
        (["can0"], None, 1, "no such file"),
        (["can0"], MACHINE, 1, "can0: "),  # there is none here
        ([], MACHINE, 2, "usage"),
    ],
)
def test_what_keeps_a_bus_down_is_said(
    words: list[str],
    text: str | None,
    status: int,
    expected: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = tmp_path / "machine.toml"
    if text is not None:
        path.write_text(text)
    if words == ["can0"] and Path("/sys/class/net/can0").exists():
        pytest.skip("this computer has a can0")
    assert can_up.main([*words, str(path)]) == status
    out, err = capsys.readouterr()
    assert expected in out + err


def test_the_bit_rate_is_the_machine_files() -> None:
    machine = {
        "bus": [{"interface": "slcan", "channel": "can0"}, {"interface": "socketcan", "channel": "can0"}]
    }
    assert can_up.bitrate_of("can0", machine) == 250_000
    machine["bus"][1]["bitrate"] = 500_000  # type: ignore[assignment]
    assert can_up.bitrate_of("can0", machine) == 500_000
    assert can_up.bitrate_of("can1", machine) is None and can_up.bitrate_of("can0", {}) is None


OUTSIDE = (
    "../x.dbc", "../../cron.d/x", "a/x.dbc", "./x.dbc", "..", ".", "", ".hidden.dbc", "machine.toml",
    "daemon.json", "a/../x.dbc", "link.dbc", "pipe.dbc", "folder.dbc", "none.dbc", "x.dbc/",
)  # fmt: skip


@pytest.mark.parametrize("name", OUTSIDE)
def test_a_machine_file_names_no_other_place_for_root_to_write(name: str, tmp_path: Path) -> None:
    """Nor one to read: a link would bring what only root may see where others may."""
    folder = tmp_path / "stick"
    folder.mkdir()
    for other in (folder / "x.dbc", tmp_path / "x.dbc", folder / "daemon.json", folder / ".hidden.dbc"):
        other.write_text("VERSION")
    (folder / "a").mkdir()
    (folder / "a/x.dbc").write_text("VERSION")
    (folder / "link.dbc").symlink_to(tmp_path / "x.dbc")
    (folder / "folder.dbc").mkdir()
    os.mkfifo(folder / "pipe.dbc")
    machine = folder / "machine.toml"
    machine.write_text(f'[machine]\nname = "rig"\n[wheel_angle]\ndbc = "{name}"\nsignal = "angle"\n')
    result = Box(tmp_path, tmp_path).setup("install", tmp_path / "none.whl", "--machine", machine)
    assert result.returncode == 1 and "beside the machine file" in result.stderr, result.stderr
    assert not (tmp_path / "root").exists()


def test_a_plain_name_beside_the_machine_file_goes_with_it(tmp_path: Path) -> None:
    machine = tmp_path / "rig.toml"
    for name in ("wheel angle.dbc", "cart.toml"):
        (tmp_path / name).write_text("")
    (tmp_path / "tank.toml").write_text('[implement.load.weighing]\ndbc = "wheel angle.dbc"')
    for text, found in (
        ('[wheel_angle]\ndbc = "wheel angle.dbc"', ["wheel angle.dbc"]),
        ('[implements]\nfiles = ["cart.toml", "wheel angle.dbc"]', ["cart.toml", "wheel angle.dbc"]),
        ('[implements]\nfiles = ["tank.toml"]', ["tank.toml", "wheel angle.dbc"]),
        ('[implement.load.weighing]\ndbc = "wheel angle.dbc"', ["wheel angle.dbc"]),
        ('[wheel_angle]\ndbc = "/usr/share/x.dbc"', []),  # the service's user reads it there
        ("[wheel_angle]\ndbc = 3", []),  # the machine file is refused for it
        ("wheel_angle = 3", []),
        ("", []),
    ):
        machine.write_text(text)
        assert _files_beside(machine) == [tmp_path / name for name in found]
    machine.write_text("[wheel")
    with pytest.raises(Failed, match=r"rig.toml: "):
        _files_beside(machine)
