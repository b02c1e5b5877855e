"""The power is cut under write load, at many random instants: every file reads, and little is lost.

One machine is booted and killed while it writes; QEMU notes every write and every flush of its drive in
their order. A cut after any of them leaves what was flushed and, of what was not, any part. So every instant
gives a disk, and the kill one more; the file system is mended by its own means, its files finished and read.
"""

import os
import shutil
import sys
from pathlib import Path

import cut_drive
import numpy as np
import pytest
from cut_drive import FIRST, SECTOR, Write, disks, logged, new_drive, noted, run
from guest import CHECKOUT, boot, missing
from loopback import logged_frames
from write_load import MARK, NOW, SPACING_NS

from tilth.logger.log.recovery import finish

LACKING = missing() or cut_drive.missing()
pytestmark = [pytest.mark.vm, pytest.mark.skipif(LACKING != "", reason=LACKING)]
SIZE = 48 << 20  # bytes of the file system
CUTS = int(os.environ.get("TILTH_CUTS", "30"))
ENOUGH = 1_200_000  # bytes noted by QEMU: some ten seconds


def frames_on(disk: bytes, folder: Path) -> list[int]:
    """The number of every frame in the files of a file system, as the next start finds them."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    image = folder / "image"
    image.write_bytes(disk[FIRST * SECTOR :][:SIZE])
    run("e2fsck", "-p", str(image), good=(0, 1))
    run("debugfs", "-R", f"rdump /logs {folder}", str(image))
    found = []
    for path in sorted((folder / "logs").glob("*.mcap")):
        finish(path)
        found += [int.from_bytes(frame.data, "little") for frame in logged_frames(path)]
    return found


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> tuple[bytes, list[Write], bytes]:
    """The drive before, all that was written to it under load, and how the kill left it."""
    folder = tmp_path_factory.mktemp("drive")
    image, log = folder / "image", folder / "log"
    new_drive(image, SIZE)
    before = image.read_bytes()
    script = (
        "mkdir /mnt/disk && mount /dev/vda1 /mnt/disk && mkdir /mnt/disk/logs && sync && "
        f"python {CHECKOUT}/tests/vm/write_load.py /mnt/disk/logs /dev/vda2"
    )
    with boot(["bash", "-c", script], folder / "out", options=noted(image, log)) as guest:
        guest.until(lambda: log.stat().st_size > ENOUGH)
        guest.kill()
    return before, list(logged(log)), image.read_bytes()


def test_at_any_instant_a_cut_costs_less_than_a_second_and_no_file(
    drive: tuple[bytes, list[Write], bytes], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before, writes, remaining = drive
    rng = np.random.default_rng(7)
    collected = [
        (i, NOW.unpack_from(write.data)[1]) for i, write in enumerate(writes) if write.data[:8] == MARK
    ]
    begun = next(i for i, count in collected if count)
    cuts = [*sorted(rng.integers(begun, collected[-1][0], CUTS).tolist()), len(writes)]
    lost = []
    for number, disk in [*disks(before, writes, cuts[:-1], rng), (cuts[-1], remaining)]:
        numbers = frames_on(disk, tmp_path / "disk")
        assert numbers == list(range(len(numbers)))  # none is missing before the last
        given = next((count for i, count in collected if i >= number), collected[-1][1])
        lost.append((given - len(numbers)) * SPACING_NS * 1e-9)
    output = (
        f"{len(lost)} cuts within {collected[-1][1] * SPACING_NS * 1e-9:.0f} s: "
        f"lost at most {max(lost):.3f} s, "
        f"median {np.median(lost):.3f} s"
    )
    with capsys.disabled():
        sys.stdout.write(f"\n{output}\n")
    assert max(lost) < 1.0 and collected[-1][1] > 3000
