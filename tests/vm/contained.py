"""A root of its own under a systemd of its own, on this computer's kernel: at its speed, without CAN.

    with_systemd(["bash", "-e", "scenario.sh"], out)

Namespaces of processes, mounts, network and control groups; the root is this computer's own, under a file
system in memory, as in guest.py, whose machine runs the same scenarios. It takes root.
"""

import os
import shlex
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

HERE = Path(__file__).resolve().parent
TOOLS = ("unshare", "nsenter", "pgrep", "ip", "/lib/systemd/systemd")


def missing() -> str:
    """Why it cannot be had here; "" where it can."""
    absent = [tool for tool in TOOLS if shutil.which(tool) is None]
    if absent or os.geteuid() != 0:
        return f"no {', '.join(absent)}" if absent else "this takes root"
    tried = ["unshare", "--mount", "--cgroup", "--net", "mount", "-t", "cgroup2", "none", "/mnt"]
    done = subprocess.run(tried, capture_output=True, text=True, check=False)
    return done.stderr.strip()


def with_systemd(
    command: Sequence[str], out: Path, seconds: float = 1800.0, *, upper: Path | None = None
) -> None:
    """Run a command, $OUT in its environment; fails where it does, with what it said. upper: a drive of
    cut_drive.py that has what is changed of the root; else it is in memory."""
    script = HERE / "contained.sh"
    spaces = [
        "unshare",
        "--mount",
        "--pid",
        "--fork",
        "--kill-child",
        "--uts",
        "--ipc",
        "--net",
        "bash",
        "-e",
    ]
    environment = {**os.environ, "OUT": str(out), "HOME": "/root", "UPPER": str(upper or "")}
    with (out / "console.txt").open("wb") as console:
        done = subprocess.run(
            [*spaces, str(script), *command], stdout=console, stderr=console, env=environment,
            stdin=subprocess.DEVNULL, timeout=seconds, check=False,
        )  # fmt: skip
    said = (out / "console.txt").read_text(errors="replace")
    assert done.returncode == 0, f"{shlex.join(command)}\n{said[-4000:]}"
