"""Makes the Debian package: `uv run python -m tilth.deploy.package OUT`, on a computer like those it is for.
For ARMv8 on a PC as well: `--armv8 FOLDER` has an emulated computer build (emulated.py). `--wheels` takes
wheels that were made before, of either.

It carries wheels of all that Tilth needs, compiled kernels among them, and the installer of install.py, which
the package's scripts call: no network is needed, and releases, roll-back and hardening stay one mechanism.
The same checkout gives the same bytes where the wheels are the same: times are those of the last commit.
"""

import argparse
import email.utils
import gzip
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from tilth.deploy import emulated

HERE = Path(__file__).resolve().parent
CHECKOUT = HERE.parent
SCRIPTS = ("postinst", "prerm", "postrm", "config")
HOME = "usr/lib/tilth"
ARCHITECTURES = {"x86_64": "amd64", "aarch64": "arm64"}  # as wheels and as Debian name them
ARMV8 = "for ARMv8, by an emulated computer that is there or is made there: half an hour at first"
CHANGES = """tilth ({version}) unstable; urgency=medium

  * What has changed is told in changelog.gz.

 -- Tilth <tilth@example.org>  {date}
"""


def main(words: Sequence[str] | None = None) -> int:
    """0 made, 1 a step failed (it has said why)."""
    parser = argparse.ArgumentParser(prog="python -m tilth.deploy.package", description=__doc__)
    parser.add_argument("out", type=Path, help="folder for tilth_VERSION_ARCHITECTURE.deb")
    parser.add_argument("--wheels", type=Path, help="folder with tilth's wheel and all others, made before")
    parser.add_argument("--armv8", type=Path, metavar="FOLDER", help=ARMV8)
    args = parser.parse_args(words)
    args.out.mkdir(parents=True, exist_ok=True)
    try:
        with tempfile.TemporaryDirectory() as made:
            wheels = args.wheels or gather(Path(made) / "wheels", args.armv8)
            print(debian_package(wheels, Path(made) / "tree", args.out))
    except (OSError, subprocess.CalledProcessError) as error:
        print(why(error), file=sys.stderr)
        return 1
    return 0


def why(error: OSError | subprocess.CalledProcessError) -> str:
    """Which step failed; it has said more itself."""
    if isinstance(error, OSError):
        needed = {"mmdebstrap": emulated.REMEDY, "dpkg-deb": "it takes Debian"}
        return f"{error}; {needed.get(str(error.filename), 'see README.md of deploy')}"
    step = [str(word) for word in error.cmd if "\n" not in str(word)]
    return f"{' '.join(step[:4])} … failed"


def gather(folder: Path, armv8: Path | None = None) -> Path:
    """Tilth's wheel from this checkout, and wheels of what it needs in the versions of constraints.txt.

    armv8: where an emulated computer is, or is to be made, which builds them. Raises CalledProcessError,
    OSError.
    """
    if armv8 is not None:
        emulated.make(armv8.resolve())
        return emulated.wheels(armv8.resolve(), folder, commit_s())
    environment = {**os.environ, "SOURCE_DATE_EPOCH": commit_s()}
    build: list[str | Path] = ["uv", "build", "--wheel", "--quiet", "--out-dir", folder, CHECKOUT]
    subprocess.run(build, check=True, env=environment)
    (own,) = folder.glob("tilth-*.whl")
    pip: list[str | Path] = ["uv", "tool", "run", "--python", sys.executable, "pip", "wheel", "--quiet"]
    constraints: list[str | Path] = ["--constraint", HERE / "constraints.txt"]
    subprocess.run([*pip, *constraints, "--wheel-dir", folder, own], check=True, env=environment)
    (folder / ".gitignore").unlink(missing_ok=True)
    return folder


def debian_package(wheels: Path, tree: Path, out: Path) -> Path:
    """The package of these wheels. Returns where it is. Raises CalledProcessError."""
    (own,) = wheels.glob("tilth-*.whl")
    version = f"{own.name.split('-')[1]}-1"
    made_s = commit_s()
    architecture = ARCHITECTURES[own.stem.partition("-linux_")[2]]
    shutil.copytree(wheels, tree / HOME / "wheels")
    _put(tree / HOME / "install.py", (HERE / "install.py").read_bytes(), 0o755)
    documents = tree / "usr/share/doc/tilth"
    _put(documents / "copyright", (HERE / "debian/copyright").read_bytes())
    changes = (CHECKOUT / "CHANGELOG.md").read_bytes()
    _put(documents / "changelog.gz", gzip.compress(changes, mtime=0))
    packed = CHANGES.format(version=version, date=email.utils.formatdate(int(made_s)))
    _put(documents / "changelog.Debian.gz", gzip.compress(packed.encode(), mtime=0))
    _put(tree / "usr/share/lintian/overrides/tilth", (HERE / "debian/overrides").read_bytes())
    for name in SCRIPTS:
        _put(tree / "DEBIAN" / name, (HERE / "debian" / name).read_bytes(), 0o755)
    _put(tree / "DEBIAN/templates", (HERE / "debian/templates").read_bytes())
    compiled = re.findall(r"-cp3(\d+)-cp3\1-", " ".join(path.name for path in wheels.iterdir()))
    minor = int(compiled[0]) if compiled else sys.version_info.minor  # of the Python that they are for
    control = (HERE / "debian/control").read_text(encoding="utf-8").format(
        version=version,
        architecture=architecture,
        kilobytes=sum(path.stat().st_size for path in tree.rglob("*") if path.is_file()) // 1024,
        python=f"3.{minor}",
        next_python=f"3.{minor + 1}~",
    )  # fmt: skip
    _put(tree / "DEBIAN/control", control.encode())
    for path in tree.rglob("*"):
        if path.is_dir():
            path.chmod(0o755)
        elif not path.is_symlink() and path.parent.name == "wheels":
            path.chmod(0o644)
    made = out / f"tilth_{version}_{architecture}.deb"
    said = ["dpkg-deb", "--root-owner-group", "-Zgzip", "-z1"]  # little: wheels are packed already
    environment = {**os.environ, "SOURCE_DATE_EPOCH": made_s}
    subprocess.run([*said, "--build", tree, made], check=True, stdout=subprocess.DEVNULL, env=environment)
    return made


def commit_s() -> str:
    """When the last commit was made, s since 1970: the times in what is made here."""
    return _said("git", "-C", str(CHECKOUT), "log", "-1", "--format=%ct")


def _said(*words: str) -> str:
    return subprocess.run(words, check=True, capture_output=True, text=True).stdout.strip()


def _put(path: Path, content: bytes, mode: int = 0o644) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    path.chmod(mode)


if __name__ == "__main__":
    sys.exit(main())
