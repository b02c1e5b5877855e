"""Runs a command behind all else that the computer does: `python -P -m tilth.cli.background report …`, or as
a child that ends with who has started it (logger/child.py).

With the lowest priority, and the first to end where memory runs out. So a report of a run costs the recorder
nothing that it needs.
"""

import contextlib
import sys
from pathlib import Path
from typing import Final

from tilth.cli import main
from tilth.logger.priority import REPORTS, stand_behind

FIRST_TO_END: Final = "1000"


def step_back() -> None:
    """As far as this system has such things."""
    stand_behind(REPORTS)  # who started it has said why not
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(FIRST_TO_END, encoding="ascii")


if __name__ == "__main__":
    step_back()
    sys.exit(main())
