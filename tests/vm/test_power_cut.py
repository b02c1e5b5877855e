"""The power is cut under write load, at many random instants: every file reads, and little is lost.

One machine is booted and killed while it writes; QEMU notes every write and every flush of its drive in
their order. A cut after any of them leaves what was flushed and, of what was not, any part. So every instant
gives a disk, and the kill one more; the file system is mended by its own means, its files finished and read.
"""

import os
import shutil
import struct
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from guest import CHECKOUT, boot, missing
from loopback import logged_frames
from write_load import MARK, NOW, SPACING_NS

from tilth.logger.log.recovery import finish

pytestmark = [pytest.mark.vm, pytest.mark.skipif(missing() != "", reason=missing())]
TOOLS = ("mkfs.ext4", "e2fsck", "debugfs")
SECTOR = 512
FIRST, SIZE = 2048, 48 << 20  # the file system: its first sector, its bytes
LAST = FIRST + SIZE // SECTOR  # the partition beside it
CUTS = int(os.environ.get("TILTH_CUTS", "30"))
ENOUGH = 1_200_000  # bytes noted by QEMU: some ten seconds
FLUSH, FUA, DISCARD = 1, 2, 4
PATH = f"{os.environ['PATH']}:/usr/sbin:/sbin"


@dataclass(frozen=True, slots=True)
class Write:
    """What reached the drive: where, what; flushed: everything before it is on the disk for good."""

    sector: int
    data: bytes
    flushed: bool


def logged(path: Path) -> Iterator[Write]:
    """The writes of a blklogwrites file, which has the format of dm-log-writes."""
    with path.open("rb") as file:
        magic, version, _, sector_size = struct.unpack("<QQQI", file.read(28))
        assert (magic, version) == (0x6A736677736872, 1)
        file.seek(sector_size)
        while len(head := file.read(sector_size)) == sector_size:
            sector, count, flags, _ = struct.unpack_from("<QQQQ", head)
            data = b"" if flags & DISCARD else file.read(count * sector_size)
            if not flags & DISCARD and len(data) < count * sector_size:
                return  # QEMU itself was killed while it noted this one
            scale = sector_size // SECTOR
            yield Write(sector * scale, data, bool(flags & (FLUSH | FUA)))


def new_drive(path: Path) -> None:
    """Two partitions, a file system in the first."""
    with path.open("wb") as file:
        file.truncate(LAST * SECTOR + (1 << 20))
        rows = [
            struct.pack("<B3sB3sII", 0, b"", 0x83, b"", start, count)
            for start, count in ((FIRST, SIZE // SECTOR), (LAST, 2048))
        ]
        file.seek(446)
        file.write(b"".join(rows).ljust(64, b"\0") + b"\x55\xaa")
    offset = f"offset={FIRST * SECTOR}"
    run("mkfs.ext4", "-q", "-F", "-E", offset, str(path), f"{SIZE >> 10}k")


def run(*command: str, good: tuple[int, ...] = (0,)) -> None:
    done = subprocess.run(command, capture_output=True, text=True, check=False, env={"PATH": PATH})
    assert done.returncode in good, f"{command}: {done.stdout}{done.stderr}"


def frames_on(disk: bytes, folder: Path) -> list[int]:
    """The number of every frame in the files of a file system, as the next start finds them."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    image = folder / "image"
    image.write_bytes(disk[FIRST * SECTOR : LAST * SECTOR])
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
    if lacking := [tool for tool in TOOLS if shutil.which(tool, path=PATH) is None]:
        pytest.skip(f"no {', '.join(lacking)}: apt-get install e2fsprogs")
    folder = tmp_path_factory.mktemp("drive")
    image, log = folder / "image", folder / "log"
    new_drive(image)
    log.touch()
    before = image.read_bytes()
    script = (
        "mkdir /mnt/disk && mount /dev/vda1 /mnt/disk && mkdir /mnt/disk/logs && sync && "
        f"python {CHECKOUT}/tests/vm/write_load.py /mnt/disk/logs /dev/vda2"
    )
    options = [
        *("-blockdev", f"driver=file,node-name=image,filename={image}"),
        *("-blockdev", f"driver=file,node-name=log,filename={log}"),
        *("-blockdev", "driver=blklogwrites,node-name=drive,file=image,log=log"),
        *("-device", "virtio-blk-pci,drive=drive"),
    ]
    with boot(["bash", "-c", script], folder / "out", options=options) as guest:
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


def disks(
    before: bytes, writes: list[Write], cuts: list[int], rng: np.random.Generator
) -> Iterator[tuple[int, bytes]]:
    """The disk as a cut before each of these writes leaves it."""
    safe, unsafe = bytearray(before), list[Write]()
    for number, write in enumerate(writes):
        if number in cuts:
            yield number, cut(safe, unsafe, rng)
        if write.flushed:
            for earlier in unsafe:
                put(safe, earlier)
            unsafe.clear()
        unsafe.append(write)


def put(disk: bytearray, write: Write) -> None:
    at = write.sector * SECTOR
    disk[at : at + len(write.data)] = write.data


def cut(safe: bytearray, unsafe: list[Write], rng: np.random.Generator) -> bytes:
    """What the power leaves: all that was flushed, and anything of the rest."""
    disk = bytearray(safe)
    for write in unsafe:
        retained = rng.choice(3)
        sectors = len(write.data) // SECTOR
        part = sectors if retained == 2 else int(rng.integers(sectors + 1)) if retained == 1 else 0
        put(disk, Write(write.sector, write.data[: part * SECTOR], False))
    return bytes(disk)
