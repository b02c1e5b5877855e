"""Copies finished runs to another place, reads every copy back, and notes which files have one.

A copy grows under <name>.partial and gets its name when it has been compared: what bears the name is whole.
What an interrupted copy left behind is compared and gone on from.
"""

import contextlib
import errno
import hashlib
import os
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from tilth.logger.log import recovery, whole_file
from tilth.logger.log.disk import sync_folder
from tilth.logger.log.lock import is_being_written
from tilth.logger.log.mcap_file import is_finished
from tilth.logger.log.runs import Copied, StoredRun
from tilth.schemas.readable import reason_of

_BLOCK = 1 << 20
_READ_ONLY = (errno.EROFS, errno.EACCES, errno.EPERM)


class CannotCopy(Exception):
    """In words; the files that were copied before are noted."""


@dataclass(frozen=True, slots=True)
class Done:
    """What became of a run."""

    copied: int  # files
    there: int  # that had been copied before
    not_copied: tuple[str, ...]  # why each other file was not
    damaged: tuple[str, ...] = ()  # what is wrong with files that were copied as they are
    not_noted: str = ""  # why it cannot be noted beside the run that it was copied


def offload(run: StoredRun, to: Path, progress: Callable[[str], None] = lambda text: None) -> Done:
    """Copy the files of a run that have no copy there. Raises CannotCopy, and ValueError as `run.sidecar`."""
    there, not_noted = 0, ""
    not_copied: list[str] = []
    damaged: list[str] = []
    copies: dict[str, Copied] = {}
    sidecar = run.sidecar()
    for path in run.files:
        try:
            if _is_there(path, sidecar.copied.get(path.name), to):
                there += 1
                continue
            why_not = _unready(path, damaged)
        except OSError as error:
            why_not = f"{path}: {reason_of(error)}"
        if why_not:
            not_copied.append(why_not)
            continue
        progress(path.name)
        copies[path.name] = copy(path, to)
        sidecar = run.sidecar()  # somebody may have added to it meanwhile
        sidecar.copied |= copies
        try:
            run.write_sidecar(sidecar)
        except OSError as error:  # a card that is full, or read-only: its runs are saved all the same
            not_noted = f"{run.folder}: {reason_of(error)}"
    if copies:
        with _in_words(to):
            whole_file.write(to / run.sidecar_path.name, sidecar.text.encode())
    return Done(len(copies), there, tuple(not_copied), tuple(damaged), not_noted)


def _is_there(path: Path, known: Copied | None, to: Path) -> bool:
    size = path.stat().st_size
    if known is None or (known.size, known.to) != (size, str(to)):
        return False
    return _has_size(to / path.name, size)


def copy(path: Path, to: Path) -> Copied:
    """One file, compared. Raises CannotCopy."""
    target, partial = to / path.name, to / f"{path.name}.partial"
    with _in_words(to), path.open("rb") as source:
        size = os.fstat(source.fileno()).st_size
        if not target.exists():
            if shutil.disk_usage(to).free + _size(partial) < size + _BLOCK:
                raise CannotCopy(f"{to}: no room for {path.name}, {size / 1e6:.0f} MB; make room, then go on")
            with partial.open("ab") as file:
                os.truncate(partial, _same(source, partial))
                source.seek(_size(partial))
                shutil.copyfileobj(source, file, _BLOCK)
                file.flush()
                os.fsync(file.fileno())
        wanted = _sha256(path)
        found = _sha256(target if target.exists() else partial)
        if found != wanted:
            if target.exists():
                raise CannotCopy(f"{target}: another file of that name is there; give another folder")
            partial.unlink()
            raise CannotCopy(f"{target}: what was written is not what is read back; use another disk")
        if not target.exists():
            partial.rename(target)
            sync_folder(to)
    return Copied(size, wanted, str(to))


def _unready(path: Path, damaged: list[str]) -> str:
    """Why a file cannot be copied yet; one that was left unfinished is finished first, where it can be
    written: else its copy is as it is. Raises OSError.

    damaged: gets what is wrong with one that is damaged, which is copied to the byte.
    """
    with path.open("rb") as file:
        if is_finished(file, path.stat().st_size):
            return ""
        recorded = is_being_written(file)
    try:
        recovery.finish(path)
    except recovery.Damaged as error:
        damaged.append(str(error))
    except recovery.NoLog as error:
        return str(error)
    except OSError as error:
        return "" if error.errno in _READ_ONLY and not recorded else f"{path}: {error.strerror}"
    return ""


def _same(source: BinaryIO, partial: Path) -> int:
    """Number of bytes at the start of an interrupted copy that are right, in whole blocks."""
    right = 0
    with partial.open("rb") as file:
        while (block := file.read(_BLOCK)) and block == source.read(len(block)):
            right += len(block)
    return right


def _sha256(path: Path) -> str:
    """Of what is on the disk, not in memory."""
    with path.open("rb") as file:
        with contextlib.suppress(OSError):
            os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
        return hashlib.file_digest(file, "sha256").hexdigest()


def _size(path: Path) -> int:
    return path.stat().st_size if path.exists() else 0


def _has_size(path: Path, size: int) -> bool:
    try:
        return path.stat().st_size == size
    except OSError:
        return False


@contextlib.contextmanager
def _in_words(to: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        place = error.filename or to
        raise CannotCopy(f"{place}: {reason_of(error)}; then go on") from None
