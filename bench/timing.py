"""Times a way to do something, the same for all benches."""

import time
from collections.abc import Callable


def best(way: Callable[[], object], rounds: int = 3) -> float:
    """Seconds, the least of so many rounds."""
    times = []
    for _ in range(rounds):
        start = time.perf_counter()
        way()
        times.append(time.perf_counter() - start)
    return min(times)
