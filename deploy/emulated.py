"""An emulated ARMv8, for a computer that is none. Its Python runs on this checkout:

    apt-get install qemu-user-static mmdebstrap arch-test
    uv run python -m tilth.deploy.emulated /tmp/armv8 -m tilth.cli replay --verify LOG.mcap

The first call makes the folder /tmp/armv8, of Debian's packages and wheels, in a few minutes. It computes as
such a computer does, twenty times slower. See README.md beside this file.
"""

import argparse
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

HERE = Path(__file__).resolve().parent
EMULATOR: Final = "qemu-aarch64-static"
DEBIAN: Final = "bookworm"
PYTHON: Final = "3.11"  # its own
WHEELS: Final = "aarch64-manylinux_2_28"  # that it can load, as uv names them


def main(words: Sequence[str] | None = None) -> int:
    """The exit status of what ran."""
    parser = argparse.ArgumentParser(prog="python -m tilth.deploy.emulated", description=__doc__)
    parser.add_argument("root", type=Path, help="where the emulated computer is, or is to be made")
    parser.add_argument("words", nargs=argparse.REMAINDER, help="of its Python; without any it is only made")
    args = parser.parse_args(words)
    try:
        make(args.root.resolve())
    except (OSError, subprocess.CalledProcessError) as error:
        sys.stderr.write(f"{error}; apt-get install qemu-user-static mmdebstrap arch-test\n")
        return 1
    return run(args.root.resolve(), *args.words).returncode if args.words else 0


def make(root: Path) -> None:
    """Debian's Python of that processor, and the packages of constraints.txt, as far as they are not there.
    Raises CalledProcessError, OSError."""
    if not (root / "usr/bin/python3").exists():
        packages = "--include=python3,ca-certificates,libstdc++6,libgomp1"
        debian: list[str | Path] = ["mmdebstrap", "--quiet", "--arch=arm64", "--variant=extract"]
        subprocess.run([*debian, packages, DEBIAN, root], check=True)
    if not (root / "packages/numba").exists():
        pip = ["uv", "pip", "install", "--quiet", "--python-platform", WHEELS, "--python-version", PYTHON]
        needed: list[str | Path] = [
            "--target",
            root / "packages",
            "-r",
            HERE / "constraints.txt",
            "setuptools",
        ]
        subprocess.run([*pip, *needed], check=True)


def run(root: Path, *words: str) -> subprocess.CompletedProcess[bytes]:
    """Run Python there on this checkout, with the compiled kernels that the checkout has for it."""
    ours = {
        "QEMU_LD_PREFIX": str(root),  # of processes that it starts as well, where binfmt knows the emulator
        "PYTHONPATH": f"{HERE.parent / '.typing'}:{root / 'packages'}",
        "PYTHONDONTWRITEBYTECODE": "1",
        "OPENBLAS_NUM_THREADS": "1",
    }
    python: list[str | Path] = [EMULATOR, root / f"usr/bin/python{PYTHON}"]
    return subprocess.run([*python, *words], env=os.environ | ours, check=False)


if __name__ == "__main__":
    sys.exit(main())
