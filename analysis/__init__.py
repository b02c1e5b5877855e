"""From logs to answers. `open` gives the runs of logs, with all that is in them as arrays.

Imported when it is first used: drawing a figure needs no log.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tilth.analysis.runs.run import open_runs as open

__all__ = ["open"]


def __getattr__(name: str) -> Any:
    if name != "open":
        raise AttributeError(f"module {__name__} has no {name}")
    from tilth.analysis.runs.run import open_runs

    return open_runs
