"""Run by priorities.sh in the place of the recorder, under the filter of its unit: prints JSON.

Starts what the recorder starts, the way it does; the kernels need not be there for that.
"""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

from tilth.logger import priority
from tilth.logger.compiling import Preparing
from tilth.logger.fitting import Worker
from tilth.schemas.machine_toml import parse_machine
from tilth.schemas.notices import Notice
from tilth.schemas.sentences import notice_sentence

SHOW = (
    "import os, pathlib; from tilth.cli.background import step_back; step_back(); "
    "print(os.getpriority(os.PRIO_PROCESS, 0), pathlib.Path('/proc/self/oom_score_adj').read_text())"
)
LONGEST_S = 600.0


def niceness(part: Worker | Preparing) -> int:
    """Of its process, once that is there."""
    deadline = time.monotonic() + LONGEST_S
    while time.monotonic() < deadline:
        if part._job is not None:
            time.sleep(0.5)  # it is set right after the start
            return os.getpriority(os.PRIO_PROCESS, part._job.pid)
        time.sleep(0.1)
    raise TimeoutError(f"{part} started no process")


def refusal(niceness: int) -> str:
    try:
        os.setpriority(os.PRIO_PROCESS, 0, niceness)
    except PermissionError as error:
        return error.strerror or ""
    return "not refused"


def main() -> None:
    said: list[str] = []
    machine = parse_machine(Path(sys.argv[1]).read_text(encoding="utf-8"))

    def report(kind: str, told: Notice) -> None:
        said.append(f"{kind}: {notice_sentence(told)}")

    worker = Worker(machine, report)
    worker.start()
    preparing = Preparing(machine, report)
    found: dict[str, object] = {"recorder": os.getpriority(os.PRIO_PROCESS, 0)}
    found |= {"fits": niceness(worker), "compiling": niceness(preparing)}
    found["forward"] = refusal(-15)
    done = subprocess.run([sys.executable, "-P", "-c", SHOW], capture_output=True, text=True, check=False)
    found["report"] = done.stdout.split() or done.stderr
    found["said"] = [text for text in said if "priority" in text]
    worker.close()
    preparing.close()
    sys.stdout.write(json.dumps(found | {"wanted": [priority.FITS, priority.COMPILING, priority.REPORTS]}))


if __name__ == "__main__":
    main()
