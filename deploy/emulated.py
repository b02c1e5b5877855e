"""An emulated ARMv8, for a computer that is none. Its Python runs on this checkout:

    apt-get install qemu-user-static mmdebstrap arch-test
    uv run python -m tilth.deploy.emulated /tmp/armv8 -m tilth.cli replay --verify LOG.mcap

The first call makes the folder /tmp/armv8, of Debian's packages and wheels. It computes as such a computer
does, twenty times slower. See README.md beside this file.
"""

import argparse
import os
import subprocess
import sys
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

HERE = Path(__file__).resolve().parent
DEBIAN: Final = "bookworm"
PYTHON: Final = "3.11"  # its own
WHEELS: Final = "aarch64-manylinux_2_28"  # that it can load, as uv names them
GLIBC: Final = range(36, 16, -1)  # 2.x, Debian's and older ones: which wheels it can load, as pip names them
REMEDY: Final = "apt-get install qemu-user-static mmdebstrap arch-test"
EMULATOR: Final = Path("/usr/lib/binfmt.d/qemu-aarch64.conf")  # how Linux is told of it
KNOWN: Final = f"""
told=/proc/sys/fs/binfmt_misc
test -e $told/qemu-aarch64 || {{ mount -t binfmt_misc none $told && cat {EMULATOR} >$told/register; }}
exec "$@"
"""
"""A shell's words: run a program while Linux knows the emulator, so that what it starts runs too."""


def main(words: Sequence[str] | None = None) -> int:
    """The exit status of what ran."""
    parser = argparse.ArgumentParser(prog="python -m tilth.deploy.emulated", description=__doc__)
    parser.add_argument("root", type=Path, help="where the emulated computer is, or is to be made")
    parser.add_argument("words", nargs=argparse.REMAINDER, help="of its Python; without any it is only made")
    args = parser.parse_args(words)
    try:
        make(args.root.resolve())
    except (OSError, subprocess.CalledProcessError) as error:
        sys.stderr.write(f"{error}; {REMEDY}\n")
        return 1
    return run(args.root.resolve(), *args.words).returncode if args.words else 0


def make(root: Path) -> None:
    """Debian's Python of that processor, and the packages of constraints.txt, as far as they are not there.
    Raises CalledProcessError, OSError."""
    if not (root / "usr/bin/python3").exists():
        packages = "--include=python3,ca-certificates,libstdc++6,libgomp1"
        debian: list[str | Path] = ["mmdebstrap", "--quiet", "--arch=arm64", "--variant=extract"]
        subprocess.run([*debian, packages, DEBIAN, root], check=True)
    needed, there = HERE / "constraints.txt", root / "constraints.txt"
    if not there.exists() or there.read_bytes() != needed.read_bytes():
        pip = ["uv", "pip", "install", "--quiet", "--python-platform", WHEELS, "--python-version", PYTHON]
        own = root / f"usr/local/lib/python{PYTHON}/dist-packages"
        ready_made: list[str | Path] = ["--only-binary", ":all:", "--target", own, "-r", needed]
        subprocess.run([*pip, *ready_made, "pip", "setuptools"], check=True)
        there.write_bytes(needed.read_bytes())


def python(root: Path) -> list[str | Path]:
    """Its first words: Python there, of this computer's files, and what it starts as well. Linux knows the
    emulator in a namespace of its own (6.7 or later), unless Debian has told it already."""
    namespace = ["unshare", "--map-root-user", "--mount", "sh", "-c", KNOWN, "sh"]
    return [*namespace, root / f"usr/bin/python{PYTHON}"]


def environment(root: Path) -> Mapping[str, str]:
    """That of a process there."""
    ours = {"QEMU_LD_PREFIX": str(root), "PYTHONDONTWRITEBYTECODE": "1", "OPENBLAS_NUM_THREADS": "1"}
    return os.environ | ours


def run(root: Path, *words: str | Path) -> subprocess.CompletedProcess[bytes]:
    """Run Python there on this checkout, with the compiled kernels that the checkout has for it."""
    of_checkout = {"PYTHONPATH": str(HERE.parent / ".typing")}
    return subprocess.run([*python(root), *words], env={**environment(root), **of_checkout}, check=False)


def wheels(root: Path, folder: Path, made_s: str) -> Path:
    """Tilth's wheel of this checkout, which keeps the kernels that are compiled for it, and those of
    constraints.txt, which are ready made. made_s: the time in it, s since 1970. Returns the folder. Raises
    CalledProcessError."""
    build = ["-m", "pip", "wheel", "--quiet", "--no-build-isolation", "--no-deps"]
    ours = {**environment(root), "SOURCE_DATE_EPOCH": made_s}
    ours |= {"PYTHONWARNINGS": "ignore"}  # setuptools', of each folder of data
    subprocess.run([*python(root), *build, "--wheel-dir", folder, HERE.parent], env=ours, check=True)
    (own,) = folder.glob("tilth-*.whl")
    with zipfile.ZipFile(own) as content:
        kernels = [name for name in content.namelist() if name.startswith("tilth/estimator/kernels/")]
        content.extractall(HERE.parent / ".typing", kernels)
    pip = ["uv", "tool", "run", "--python", PYTHON, "pip", "download", "--quiet", "--no-deps"]
    loads = [word for minor in GLIBC for word in ("--platform", f"manylinux_2_{minor}_aarch64")]
    pip += ["--only-binary", ":all:", "--python-version", PYTHON, *loads]
    subprocess.run([*pip, "--dest", folder, "-r", HERE / "constraints.txt"], check=True)
    return folder


if __name__ == "__main__":
    sys.exit(main())
