"""Write what is generated from the tree: `python -m tilth.deploy.generate`, from a development install.

schemas/proto/tilth.proto → tilth_pb2.py and .pyi; schemas/machine.py → machine.schema.json; uv.lock →
deploy/constraints.txt, the versions that a recorder is installed with; deploy/motion_equations.py →
estimator/models/generated/rolling_kernels.py; deploy/observation_equations.py →
estimator/filters/generated/observation_kernels.py; schemas/sentences/ → docs/codes.md;
schemas/proto/tilth.proto's comments → docs/wire.md.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

from tilth.deploy import codes_page, motion_equations, observation_equations, wire_page
from tilth.schemas.machine import Machine

ROOT: Final = Path(__file__).resolve().parents[1]
PROTO: Final = "schemas/proto"
EXPORT: Final = "uv export --frozen --no-dev --no-hashes --no-header --no-annotate --no-emit-project --quiet"


def generated(root: Path) -> Iterator[tuple[str, bytes]]:
    """(path below root, what has to be in it) of each generated file of a tree."""
    with tempfile.TemporaryDirectory() as folder:
        command = ["-m", "grpc_tools.protoc", f"-I{root / PROTO}"]
        command += [f"--python_out={folder}", f"--pyi_out={folder}", str(root / PROTO / "tilth.proto")]
        subprocess.run([sys.executable, *command], check=True)
        for path in sorted(Path(folder).iterdir()):
            yield f"{PROTO}/{path.name}", path.read_bytes()
    yield "schemas/machine.schema.json", (json.dumps(Machine.model_json_schema(), indent=2) + "\n").encode()
    for equations in (motion_equations, observation_equations):
        yield equations.TARGET, equations.source().encode()
    yield codes_page.TARGET, codes_page.text().encode()
    yield wire_page.TARGET, wire_page.text().encode()
    exported = subprocess.run([*EXPORT.split(), "--directory", str(root)], capture_output=True, check=True)
    yield "deploy/constraints.txt", exported.stdout


def main(words: Sequence[str] | None = None, root: Path = ROOT) -> int:
    """1 where --check finds a file that is not current."""
    parser = argparse.ArgumentParser(
        prog="python -m tilth.deploy.generate",
        description="Write the files that are generated from the tree, and say which of them have changed.",
    )
    parser.add_argument(
        "--check", action="store_true", help="write nothing; exit status 1 if one would change"
    )
    args = parser.parse_args(words)
    status = 0
    for name, content in generated(root):
        path = root / name
        if path.exists() and path.read_bytes() == content:
            continue
        print(f"{name}: {'not current' if args.check else 'written'}")
        if args.check:
            status = 1
        else:
            path.write_bytes(content)
    return status


if __name__ == "__main__":
    sys.exit(main())
