"""Commands on a real small disk, or on a read-only one: mounted in a namespace of their own.

As a script, within that namespace: small_disk.py FOLDER SIZE WORD…: mounts it, runs the words, prints JSON.
"""

import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import pytest

READ_ONLY: Final = "read-only"
TILTH: Final = (sys.executable, "-c", "import sys; from tilth.cli import main; sys.exit(main(sys.argv[1:]))")


@dataclass(frozen=True, slots=True)
class OnSmallDisk:
    status: int
    out: str
    err: str
    left: list[str]  # files on the disk at the end, by their paths there


def on_a_small_disk(folder: Path, size: str, *words: str | Path) -> OnSmallDisk:
    """size: as of mount; what the folder held before is out of sight then. READ_ONLY: the folder as it is,
    and nobody can write it. Skips where nobody may mount."""
    within = ["unshare", "--user", "--map-root-user", "--mount", sys.executable, __file__]
    try:
        done = subprocess.run(
            [*within, str(folder), size, *map(str, words)], capture_output=True, text=True, check=False
        )
    except FileNotFoundError:
        pytest.skip("no unshare: util-linux is not installed")
    if "unshare:" in done.stderr or "mount:" in done.stderr:
        pytest.skip(f"this computer lets nobody mount a small disk: {done.stderr.strip()}")
    assert done.returncode == 0, done.stderr
    return OnSmallDisk(**json.loads(done.stdout))


def _within(folder: Path, size: str, words: list[str]) -> None:
    if size == READ_ONLY:
        subprocess.run(["mount", "--bind", str(folder), str(folder)], check=True)
        subprocess.run(["mount", "-o", "remount,bind,ro", str(folder)], check=True)
    else:
        subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "disk", str(folder)], check=True)
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    left = sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())
    answer = {"status": done.returncode, "out": done.stdout, "err": done.stderr, "left": left}
    sys.stdout.write(json.dumps(answer))


if __name__ == "__main__":
    _within(Path(sys.argv[1]), sys.argv[2], sys.argv[3:])
