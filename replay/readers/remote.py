"""Logs on storage that is no disk of this computer: S3 and what else fsspec knows, as s3://bucket/folder."""

import hashlib
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any, Final, NamedTuple

from tilth.replay.readers.log import ForeignLog
from tilth.schemas.invocation import installing
from tilth.schemas.readable import reason_of

_URL: Final = re.compile(r"([a-z][a-z0-9+.-]+)://")
_VERSION: Final = ("ETag", "LastModified", "etag", "md5Hash", "mtime", "created")  # what storage tells of it


class RemoteFile(NamedTuple):
    """A file of such storage."""

    url: str
    size: int  # bytes
    changed: int  # a number of its own for each version


def is_remote(path: str) -> bool:
    """Whether it is the address of storage elsewhere."""
    return _URL.match(path) is not None


def files_at(url: str) -> list[RemoteFile]:
    """Of a folder and of those in it; a file itself. Raises ForeignLog where they cannot be listed."""
    with _told(url):
        system, root = import_module("fsspec.core").url_to_fs(url, use_listings_cache=False)
        if not root.strip("/"):
            raise ForeignLog(f"{url}: names no bucket")
        found: dict[str, dict[str, Any]] = system.find(root, detail=True)
        if not found:
            raise ForeignLog(f"{url}: nothing is there")
        return [
            RemoteFile(system.unstrip_protocol(name), int(info.get("size") or 0), _version(info))
            for name, info in sorted(found.items())
        ]


def _version(info: dict[str, Any]) -> int:
    told = repr([(key, str(info[key])) for key in _VERSION if key in info])
    return int.from_bytes(hashlib.sha256(told.encode()).digest()[:7], "big")


def fetched(url: str, folder: Path) -> Path:
    """A copy of a file in a folder. Raises ForeignLog where it cannot be read, OSError where not kept."""
    to = folder / re.sub(r"[^\w.-]", "_", url.rsplit("/", 1)[-1])
    with _told(url):
        system, name = import_module("fsspec.core").url_to_fs(url, use_listings_cache=False)
        source = system.open(name, "rb")
    with source, to.open("xb") as copy:
        while True:
            with _told(url):
                block = source.read(1 << 22)
            if not block:
                return to
            copy.write(block)


@contextmanager
def at_hand(path: str) -> Iterator[Path]:
    """A file as one of this computer: itself, or a copy that is removed afterwards. Raises ForeignLog,
    OSError."""
    if not is_remote(path):
        yield Path(path)
        return
    with tempfile.TemporaryDirectory(prefix="tilth-") as folder:
        yield fetched(path, Path(folder))


@contextmanager
def _told(url: str) -> Iterator[None]:
    """What went wrong with storage, in a sentence. Raises ForeignLog."""
    try:
        yield
    except ForeignLog:
        raise
    except ImportError:
        raise ForeignLog(f"{url}: this needs one package more: {installing('s3')}") from None
    except FileNotFoundError:
        raise ForeignLog(f"{url}: is not there") from None
    except PermissionError:
        raise ForeignLog(f"{url}: reading it is not allowed; look at the credentials") from None
    except OSError as error:
        raise ForeignLog(_unread(url, reason_of(error) if error.errno else str(error))) from None
    except Exception as error:  # each kind of storage has errors of its own
        raise ForeignLog(_unread(url, str(error))) from None


def _unread(url: str, why: str) -> str:
    return f"{url}: cannot be read ({' '.join(why.split())}); look at network, address and credentials"
