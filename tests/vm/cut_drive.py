"""A drive whose power is cut: QEMU notes every write and every flush in their order, so every instant gives a
disk. A cut leaves what was flushed and, of what was not, any part.

The drive is a machine's (noted), or a file of this computer's (noted_here): a machine is slow.
"""

import bisect
import os
import re
import shutil
import struct
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

TOOLS = ("mkfs.ext4", "e2fsck", "debugfs")
SECTOR = 512
FIRST = 2048  # of the file system; the partition beside it comes after
FLUSH, FUA, DISCARD = 1, 2, 4
PATH = f"{os.environ['PATH']}:/usr/sbin:/sbin"


def missing() -> str:
    """Why no drive can be made here; "" where one can."""
    absent = [tool for tool in TOOLS if shutil.which(tool, path=PATH) is None]
    return f"no {', '.join(absent)}: apt-get install e2fsprogs" if absent else ""


def missing_here() -> str:
    """Why a file of this computer's can be no drive; "" where it can."""
    absent = [path for path in ("/dev/fuse", "/dev/loop-control") if not Path(path).exists()]
    absent += [tool for tool in ("qemu-storage-daemon",) if shutil.which(tool) is None]
    return f"no {', '.join(absent)}" if absent else ""


def new_drive(path: Path, size: int) -> None:
    """Two partitions, an ext4 of that many bytes in the first."""
    last = FIRST + size // SECTOR
    with path.open("wb") as file:
        file.truncate(last * SECTOR + (1 << 20))
        rows = [
            struct.pack("<B3sB3sII", 0, b"", 0x83, b"", start, count)
            for start, count in ((FIRST, size // SECTOR), (last, 2048))
        ]
        file.seek(446)
        file.write(b"".join(rows).ljust(64, b"\0") + b"\x55\xaa")
    run("mkfs.ext4", "-q", "-F", "-E", f"offset={FIRST * SECTOR}", str(path), f"{size >> 10}k")


def noted(image: Path, log: Path) -> list[str]:
    """QEMU's options for a machine's drive that notes what is written."""
    return [*_noting(image, log), "-device", "virtio-blk-pci,drive=drive"]


@contextmanager
def noted_here(image: Path, log: Path) -> Iterator[Path]:
    """The file that is the drive."""
    drive = image.with_name(f"{image.name}-noted")
    drive.touch()
    export = f"type=fuse,id=export,node-name=drive,mountpoint={drive},writable=on"
    told = log.with_name("storage-daemon")
    words = ["qemu-storage-daemon", *_noting(image, log), "--export", export, "--pidfile", str(told)]
    with subprocess.Popen([word.replace("-blockdev", "--blockdev") for word in words]) as daemon:
        try:
            while not told.exists():  # written when the drive is there
                assert daemon.poll() is None, "no drive of a file here"
            yield drive
        finally:
            daemon.terminate()


def _noting(image: Path, log: Path) -> list[str]:
    log.touch()
    return [
        *("-blockdev", f"driver=file,node-name=image,filename={image}"),
        *("-blockdev", f"driver=file,node-name=log,filename={log}"),
        *("-blockdev", "driver=blklogwrites,node-name=drive,file=image,log=log"),
    ]


def run(*command: str, good: tuple[int, ...] = (0,)) -> str:
    done = subprocess.run(command, capture_output=True, text=True, check=False, env={"PATH": PATH})
    assert done.returncode in good, f"{command}: {done.stdout}{done.stderr}"
    return done.stdout


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


def first(before: Path, writes: list[Write], is_so: Callable[[Path], bool]) -> int:
    """How many writes it takes until something is so of the file system, and remains so: it is asked of one
    whose journal has been replayed. before: the file system, `alone`."""
    work = before.with_name("work")

    def after(count: int) -> bool:
        run("cp", "--sparse=always", str(before), str(work))
        with work.open("r+b") as file:
            for write in (write for write in writes[:count] if write.data):  # a flush alone has none
                file.seek((write.sector - FIRST) * SECTOR)
                file.write(write.data)
        run("e2fsck", "-p", "-E", "journal_only", str(work), good=(0, 1))
        return is_so(work)

    return bisect.bisect_left(range(len(writes) + 1), True, key=after)


def alone(drive: bytes, path: Path) -> Path:
    """The file system of a drive, as a file."""
    path.write_bytes(drive[FIRST * SECTOR : -(1 << 20)])
    return path


def link(system: Path, path: str) -> tuple[str, str]:
    """Inode and target of a symbolic link of a file system."""
    said = run("debugfs", "-R", f"stat {path}", str(system))
    found = re.search(r'Inode: (\d+) .*Fast link dest: "(.*?)"', said, re.DOTALL)
    assert found is not None, said
    return found[1], found[2]


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
