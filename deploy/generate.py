"""Write what is generated from the tree: `python -m tilth.deploy.generate`, from a development install.

schemas/proto/tilth.proto → tilth_pb2.py and .pyi; schemas/machine.py → machine.schema.json.
"""

import json
import subprocess
import sys
from pathlib import Path

from tilth.schemas.machine import Machine

SCHEMAS = Path(__file__).resolve().parents[1] / "schemas"


def main() -> None:
    proto = SCHEMAS / "proto"
    command = ["-m", "grpc_tools.protoc", f"-I{proto}", f"--python_out={proto}", f"--pyi_out={proto}"]
    subprocess.run([sys.executable, *command, str(proto / "tilth.proto")], check=True)
    schema = json.dumps(Machine.model_json_schema(), indent=2) + "\n"
    (SCHEMAS / "machine.schema.json").write_text(schema)


if __name__ == "__main__":
    main()
