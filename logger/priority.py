"""How far processes stand behind the recorder, which comes first."""

import os
from typing import Final

from tilth.schemas.readable import reason_of

FITS: Final = 10  # niceness; greater stands further behind
COMPILING: Final = 5  # on a busy computer more would be for ever
REPORTS: Final = 19


def stand_behind(niceness: int, process: int = 0) -> str:
    """Give a process (its id; 0: this one) that niceness, whatever the recorder's own is; one that has more
    keeps it. Why that cannot be, "" where it can.

    Best right after its start: threads that it has by then keep theirs.
    """
    try:
        wanted = max(niceness, os.getpriority(os.PRIO_PROCESS, process))
        os.setpriority(os.PRIO_PROCESS, process, wanted)
    except ProcessLookupError:  # it has ended already, which is told elsewhere
        return ""
    except OSError as error:
        return reason_of(error)
    return ""
