"""Files that are there whole or not at all, and reading those in which anything may lie."""

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

LARGEST: Final = 64 << 20  # bytes of what we keep for ourselves; more is none of ours


@contextmanager
def whole(path: Path, *, replace: bool = False) -> Iterator[Path]:
    """A name beside the path, to be written: the path's own when all went well; else nothing of it stays.

    replace: a file that is there by then is replaced; else this raises FileExistsError, at once where it is
    there already, and OSError where what was written cannot be brought to the disk.
    """
    if not replace and os.path.lexists(path):
        raise FileExistsError(17, "exists", str(path))
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    part.unlink(missing_ok=True)
    try:
        yield part
        if not part.exists():  # the caller had nothing to say
            return
        descriptor = os.open(part, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
        if replace:
            part.replace(path)
        else:
            _name(part, path)
    except OSError as error:
        if error.filename == str(part):  # whoever reads of it knows the path
            error.filename = str(path)
        raise
    finally:
        part.unlink(missing_ok=True)


def write(path: Path, data: bytes, *, replace: bool = True, mode: int = 0o666) -> None:
    """All or nothing, whatever happens to disk and power. mode: less the process's umask. Raises OSError."""
    with whole(path, replace=replace) as part:
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
        with os.fdopen(os.open(part, flags, mode), "wb") as stream:
            stream.write(data)


def read(path: Path) -> bytes:
    """What a file holds that may be anything by now. Never waits. Raises OSError, also where it is no file or
    too large to be one of ours."""
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
    with os.fdopen(descriptor, "rb") as stream:
        found = os.fstat(descriptor)
        if not stat.S_ISREG(found.st_mode):
            raise OSError(None, "is no file", str(path))
        if found.st_size > LARGEST:
            raise OSError(None, f"is too large, {found.st_size / 1e6:.0f} MB", str(path))
        return stream.read(LARGEST)


def _name(part: Path, path: Path) -> None:
    try:
        os.link(part, path)  # raises where that name is taken by now
    except FileExistsError:
        raise
    except OSError:  # a file system without links
        if os.path.lexists(path):
            raise FileExistsError(17, "exists", str(path)) from None
        part.rename(path)
