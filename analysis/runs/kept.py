"""What is computed from a log and kept, so that it is computed once.

The name of what is kept tells of what it was made: the log's bytes, the machine file, the version.
"""

import contextlib
import hashlib
import json
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Final, TypeVar

import zstandard

from tilth.estimator.state_json import from_json_data, to_json_data
from tilth.logger.log import whole_file
from tilth.logger.log.derived import Derived
from tilth.logger.log.software import software
from tilth.schemas.log_settings import Log

Progress = Callable[[int, int], None]  # done, of all
Say = Callable[[str], None]
FORM: Final = 12  # of what is kept; grows when its meaning changes
SMALL_BYTES: Final = 20e6
_HEAD: Final = b"tilth kept 1\n"  # then the SHA-256 of all that follows
_DIGEST: Final = hashlib.sha256().digest_size
MOST_BYTES: Final = 10e9  # of all that is kept
_OURS: Final = re.compile(r"[0-9a-f]{32}(\.\d+)?\.\w+|sensitivity/[0-9a-f]{16}/\d+(\.npz|\.\d+\.unfinished)")

Kept = TypeVar("Kept")


def no_progress(done: int, of: int) -> None:
    """Shows nothing."""


def silent(text: str) -> None:
    """Says nothing."""


def cache_folder() -> Path:
    """Where things are kept unless a caller says otherwise."""
    base = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(base) if base else Path.home() / ".cache") / "tilth" / "analysis"


def caches(folder: Path, log: Log) -> Derived:
    """What is kept in a folder, which leaves as much of its disk free as the machine file says."""
    return Derived(folder, _OURS, MOST_BYTES, log.keep_free_megabytes * 1e6)


def has_room(folder: Path, log: Log) -> bool:
    """Whether something small may be kept there; the oldest is removed for it. Raises OSError."""
    return caches(folder, log).make_room(SMALL_BYTES)


def sha256_of(path: Path) -> str:
    """Of a file's bytes. Raises OSError."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def key_of(*parts: object) -> str:
    """Name of what is kept of these parts."""
    text = "\n".join(map(str, (FORM, software()["version"], *parts)))
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def load(path: Path, kind: type[Kept]) -> Kept | None:
    """What `store` wrote there; None where nothing is, or not to the byte what was written.

    It is data and no more: a file that somebody has prepared can be wrong, and runs nothing.
    """
    told = load_bytes(path)
    return None if told is None else expanded(told, kind)


def load_bytes(path: Path) -> bytes | None:
    """The same of `store_bytes`."""
    try:
        return _unsealed(path.read_bytes())
    except OSError:
        return None


def store(path: Path, found: object, log: Log) -> None:
    """Raises nothing: a cache that cannot be written costs time, no result. Nor is one on a full disk."""
    store_bytes(path, compressed(found), log)


def store_bytes(path: Path, told: bytes, log: Log) -> None:
    """As `store`."""
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        if has_room(path.parent, log):
            whole_file.write(path, _sealed(told))


def packed(found: object) -> bytes:
    """As `store` writes it."""
    return _sealed(compressed(found))


def unpacked(stored: bytes, kind: type[Kept]) -> Kept | None:
    """Of the bytes of `packed`; None of any others."""
    told = _unsealed(stored)
    return None if told is None else expanded(told, kind)


def compressed(found: object) -> bytes:
    """As JSON, without a digest."""
    return zstandard.compress(json.dumps(to_json_data(found)).encode(), 1)


def expanded(told: bytes, kind: type[Kept]) -> Kept | None:
    """Of the bytes of `compressed`; None of any others."""
    try:
        found: Kept = from_json_data(kind, json.loads(zstandard.decompress(told)))
    except (ValueError, RecursionError, zstandard.ZstdError):
        return None
    return found


def _sealed(told: bytes) -> bytes:
    return _HEAD + hashlib.sha256(told).digest() + told


def _unsealed(stored: bytes) -> bytes | None:
    told = stored[len(_HEAD) + _DIGEST :]
    return told if stored == _sealed(told) else None
