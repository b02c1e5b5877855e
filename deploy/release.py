"""Makes a release: `uv run python -m tilth.deploy.release OUT --key minisign.key`, on a computer like those
it is for; with `--armv8 FOLDER` also for ARMv8, by an emulated computer (emulated.py).

OUT then has all that a person puts where releases are had: Tilth's wheel and Debian package for each kind of
processor, what they are made of (SBOM, CycloneDX), notes.md from the newest section of CHANGELOG.md,
SHA256SUMS; and with --key signatures of packages and sums. The same checkout, wheels and key give the same
bytes.
"""

import argparse
import hashlib
import json
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
import uuid
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from tilth.deploy.package import ARMV8, CHECKOUT, commit_s, debian_package, gather, why

SUMS: Final = "SHA256SUMS"
_SECTION: Final = re.compile(r"## (?P<version>\S+), (?P<date>.+)\n(?P<notes>(?:(?!## ).*\n?)*)")


class NotReady(Exception):
    """Why this checkout is no release yet, and what to do."""


def main(words: Sequence[str] | None = None) -> int:
    """0 made, 1 a step failed or something is missing."""
    parser = argparse.ArgumentParser(prog="python -m tilth.deploy.release", description=__doc__)
    parser.add_argument("out", type=Path, help="a new folder")
    parser.add_argument("--key", type=Path, help="minisign's secret key; without it nothing is signed")
    parser.add_argument(
        "--wheels", type=Path, action="append", metavar="FOLDER",
        help="tilth's wheel and all others, made before; once for each kind of processor",
    )  # fmt: skip
    parser.add_argument("--armv8", type=Path, metavar="FOLDER", help=f"also {ARMV8}")
    args = parser.parse_args(words)
    try:
        with tempfile.TemporaryDirectory() as made:
            folder = Path(made)
            wheels = args.wheels or [gather(folder / "wheels")]
            if args.armv8 is not None:
                wheels.append(gather(folder / "armv8", args.armv8))
            release(args.out, wheels, folder, args.key)
    except NotReady as error:
        print(f"release: {error}", file=sys.stderr)
        return 1
    except (OSError, subprocess.CalledProcessError) as error:
        print(why(error), file=sys.stderr)
        return 1
    return 0


def release(out: Path, wheels: Sequence[Path], folder: Path, key: Path | None) -> None:
    """Make all of it. folder: for what is needed meanwhile. Raises NotReady, CalledProcessError."""
    project = tomllib.loads((CHECKOUT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    version = str(project["version"])
    notes = notes_of((CHECKOUT / "CHANGELOG.md").read_text(encoding="utf-8"), version)
    if out.exists() and any(out.iterdir()):
        raise NotReady(f"{out} is not empty; give a new folder")
    if key is not None and shutil.which("minisign") is None:
        raise NotReady("no minisign: apt-get install minisign")
    out.mkdir(parents=True, exist_ok=True)
    packages = []
    for number, each in enumerate(wheels):
        (own,) = each.glob("tilth-*.whl")
        if own.name.split("-")[1] != version:
            raise NotReady(f"{own.name} is not of {version}; build the wheels anew")
        shutil.copyfile(own, out / own.name)
        packages.append(debian_package(each, folder / f"tree{number}", out))
    (out / f"tilth-{version}.cdx.json").write_text(bill_of_materials(), encoding="utf-8")
    (out / "notes.md").write_text(notes, encoding="utf-8")
    sums = ((path.name, hashlib.sha256(path.read_bytes()).hexdigest()) for path in sorted(out.iterdir()))
    (out / SUMS).write_text("".join(f"{digest}  {name}\n" for name, digest in sums), encoding="utf-8")
    if key is not None:
        files = [*packages, out / SUMS]
        subprocess.run(["minisign", "-S", "-s", key, "-t", f"tilth {version}", "-m", *files], check=True)
    print("\n".join(str(path) for path in sorted(out.iterdir())))


def notes_of(changelog: str, version: str) -> str:
    """The newest section. Raises NotReady where it is of another version, has no date yet or says nothing."""
    newest = _SECTION.search(changelog)
    if newest is None or newest["version"] != version:
        raise NotReady(f"CHANGELOG.md does not begin with {version}; write what its users notice")
    if re.fullmatch(r"\d{4}-\d\d-\d\d", newest["date"]) is None:
        raise NotReady(f'CHANGELOG.md: "{version}, {newest["date"]}": write the date, such as 2026-11-29')
    if not newest["notes"].strip():
        raise NotReady(f"CHANGELOG.md says nothing of {version}; write what its users notice")
    return newest["notes"].strip() + "\n"


def bill_of_materials() -> str:
    """Of the lock file, by uv; with the time of the commit and a number that follows from it."""
    asked: list[str | Path] = ["uv", "export", "--quiet", "--project", CHECKOUT, "--locked", "--no-dev"]
    asked += ["--format", "cyclonedx1.5"]
    said = subprocess.run(asked, check=True, capture_output=True, text=True).stdout
    bill = json.loads(said)
    bill["metadata"]["timestamp"] = datetime.fromtimestamp(int(commit_s()), UTC).isoformat()
    del bill["serialNumber"]  # uv draws one each time
    bill["serialNumber"] = uuid.uuid5(uuid.NAMESPACE_URL, json.dumps(bill, sort_keys=True)).urn
    return json.dumps(bill, indent=2) + "\n"


if __name__ == "__main__":
    sys.exit(main())
