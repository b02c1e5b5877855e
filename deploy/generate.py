"""Write what is generated from the tree: `python -m tilth.deploy.generate`, from a development install.

schemas/proto/tilth.proto → tilth_pb2.py and .pyi; schemas/machine.py → machine.schema.json; uv.lock →
deploy/constraints.txt, the versions that a recorder is installed with; deploy/motion_equations.py →
estimator/models/rolling_kernels.py.
"""

import json
import subprocess
import sys
from pathlib import Path

from tilth.deploy import motion_equations
from tilth.schemas.machine import Machine

ROOT = Path(__file__).resolve().parents[1]
SCHEMAS = ROOT / "schemas"
EXPORT = "uv export --frozen --no-dev --no-hashes --no-header --no-annotate --no-emit-project --quiet"


def main() -> None:
    proto = SCHEMAS / "proto"
    command = ["-m", "grpc_tools.protoc", f"-I{proto}", f"--python_out={proto}", f"--pyi_out={proto}"]
    subprocess.run([sys.executable, *command, str(proto / "tilth.proto")], check=True)
    schema = json.dumps(Machine.model_json_schema(), indent=2) + "\n"
    (SCHEMAS / "machine.schema.json").write_text(schema)
    (ROOT / motion_equations.TARGET).write_text(motion_equations.source())
    exported = subprocess.run([*EXPORT.split(), "--directory", str(ROOT)], capture_output=True, check=True)
    (ROOT / "deploy" / "constraints.txt").write_bytes(exported.stdout)


if __name__ == "__main__":
    main()
