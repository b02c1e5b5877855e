"""The power is cut in the middle of an upgrade: the old release or the new one records, and no log is lost.

A computer upgrades while it records, on a drive that notes its writes (cut_drive.py); a cut at each instant
gives a disk, which starts again under a systemd of its own. Half of the cuts are within the switch of
releases, a small part of what is written. The computer is this one's kernel, in namespaces
(contained.py), and by hand the virtual machine:
`TILTH_CUTS=20 pytest -m "vm or vm_systemd" -n 0 tests/vm/test_upgrade_cut.py`.
"""

import collections
import itertools
import os
import shutil
import sys
import sysconfig
import zipfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from pathlib import Path

import contained
import cut_drive
import guest
import numpy as np
import pytest
from cut_drive import Write, alone, disks, first, link, logged, new_drive, noted, noted_here
from loopback import logged_frames, machine_text, udp_bus
from releases import release_of

LACKING = guest.missing() or contained.missing() or cut_drive.missing() or cut_drive.missing_here()
pytestmark = pytest.mark.skipif(LACKING != "", reason=LACKING)
HERE = Path(__file__).parent
PORT = 47111  # in a network of its own
CUTS = int(os.environ.get("TILTH_CUTS", "2"))
SIZE = 400 << 20  # bytes of what is changed of the root
LOST = 150  # frames of three seconds: half a second, and what a busy computer adds


def scenario(*words: str) -> list[str]:
    environment = ["env", f"NEEDED={sysconfig.get_path('purelib')}", f"PORT={PORT}"]
    return [*environment, "bash", "-ex", str(HERE / "upgrade.sh"), *words]


def here(image: Path, log: Path, out: Path) -> None:
    with noted_here(image, log) as drive:
        contained.with_systemd(scenario("cut"), out, upper=drive)


def in_the_machine(image: Path, log: Path, out: Path) -> None:
    command = ["bash", "-x", str(HERE / "with_systemd.sh"), *scenario("cut")]
    with guest.boot(command, out, options=noted(image, log), upper="/dev/vda1") as machine:
        machine.finish()


def is_of(wheel: Path, release: Path) -> bool:
    """Whether all of it is there, to the byte; what says its version aside."""
    with zipfile.ZipFile(wheel) as content:
        names = [name for name in content.namelist() if name.startswith("tilth/")]
        return all((release / name).read_bytes() == content.read(name) for name in names)


def writes_of_the_switch(before: Path, writes: list[Write]) -> range:
    """From where the release before becomes the new one's keeper, by a new link, until the new one has
    started and is its own. before: as of first."""
    keeper = "/files/opt/tilth/keeper"
    link_before = link(before, keeper)
    ended = first(before, writes, lambda system: link(system, keeper)[1] == "releases/2")
    begun = first(before, writes[:ended], lambda system: link(system, keeper) != link_before)
    return range(begun, ended + 1)


@pytest.mark.parametrize(
    "upgraded",
    [pytest.param(here, marks=pytest.mark.vm), pytest.param(in_the_machine, marks=pytest.mark.vm_systemd)],
)
def test_after_a_cut_at_any_instant_a_whole_release_records_and_no_log_is_lost(
    upgraded: Callable[[Path, Path, Path], None],
    tmp_path: Path,
    wheel: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out, image, log = tmp_path / "out", tmp_path / "image", tmp_path / "log"
    out.mkdir()
    (out / "machine.toml").write_text(machine_text(tmp_path, udp_bus("can0", PORT)))
    for name, version in (("old", "1.0.0"), ("new", "2.0.0")):
        release_of(wheel, tmp_path / name, version).rename(out / f"{name}.deb")
    new_drive(image, SIZE)
    contained.with_systemd(scenario("installed"), out, upper=image)
    earlier = {path.name: path.read_bytes() for path in (out / "logs").iterdir()}
    assert earlier
    before = image.read_bytes()

    samples = list[
        tuple[int, int]
    ]()  # bytes of QEMU's log, frames that were sent by then; while it is upgraded
    with ThreadPoolExecutor(1) as pool:
        job = pool.submit(upgraded, image, log, out)
        while not wait([job], 0.02).done:
            if (out / "begun").exists() and not (out / "ended").exists():
                sent = int.from_bytes((out / "sent").read_bytes(), "little")
                samples.append((log.stat().st_size, sent))
        job.result()
    writes = list(logged(log))
    places = list(itertools.accumulate(512 + len(write.data) for write in writes))

    switch = writes_of_the_switch(alone(before, tmp_path / "before"), writes)
    rng = np.random.default_rng(11)
    of_switch = rng.choice(switch, CUTS // 2, replace=False)
    anywhere = np.searchsorted(places, rng.integers(samples[0][0], samples[-1][0], CUTS - len(of_switch)))
    cuts = sorted({*of_switch.tolist(), *anywhere.tolist()})
    lost, versions = list[int](), collections.Counter[str]()
    for number, disk in disks(before, writes, cuts, rng):
        image.write_bytes(disk)
        for folder in ("logs", "release"):
            shutil.rmtree(out / folder, ignore_errors=True)
        contained.with_systemd(scenario("started", "again" if number == max(cuts) else ""), out, upper=image)
        assert is_of(wheel, out / "release")
        versions[(out / "current").read_text().strip().rpartition("/")[2]] += 1
        for name, data in earlier.items():
            assert (out / "logs" / name).read_bytes() == data
        recorded = 0
        for path in sorted((out / "logs").glob("*.mcap")):
            numbers = [int.from_bytes(frame.data, "little") for frame in logged_frames(path)]
            if numbers:  # none is missing within a recording
                recorded = numbers[-1] + 1
                assert numbers == list(range(numbers[0], recorded))
        if "tilth-1.0.0" in (out / "current").read_text():  # else nobody has recorded between the two
            lost.append(next(sent for size, sent in samples if size >= places[number - 1]) - recorded)
    assert "tilth-2.0.0" in (out / "again").read_text()  # what was begun can be ended
    within = f"{sum(number in switch for number in cuts)} within the {len(switch)} writes of the switch"
    output = f"{dict(versions)} after cuts, {within}; frames lost at most {max(lost, default=0)}"
    with capsys.disabled():
        sys.stdout.write(f"\n{output}\n")
    assert set(versions) <= {"tilth-1.0.0.dist-info", "tilth-2.0.0.dist-info"} and max(lost, default=0) < LOST
