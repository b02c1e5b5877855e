"""Work in parts that do not depend on each other, on the cores of this computer; `dask.py` does the same on a
cluster, with the same results.

A part is a function of one item, which gives bytes: packed where they are computed, so that little is sent.
"""

from collections.abc import Callable, Generator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from functools import partial
from typing import Any, Final, Protocol, TypeVar

from tilth.analysis.fit.side_by_side import processes

Item = TypeVar("Item")

ALONE: Final = 2  # tries of a part in a process of its own
LOST: Final = "the process that computed it was ended, twice: by hand, or since there was too little memory"


class LostPart(Exception):
    """A part was not computed; one sentence that says why."""


Found = Generator[tuple[Item, bytes | LostPart], None, None]
"""(item, what its part gave) of each, as they are ready."""


class Parts(Protocol):
    """Who computes."""

    def __call__(self, part: Callable[[Item], bytes], items: Sequence[Item]) -> Found[Item]:
        """Of a function and its items, which can be pickled."""
        ...


def here(workers: int) -> Parts:
    """By so many processes of this computer."""
    return partial(_here, workers)


def _here(workers: int, part: Callable[[Any], bytes], items: Sequence[Any]) -> Found[Any]:
    if workers == 1:
        for item in items:
            yield item, part(item)
        return
    left = list(items)
    while left:
        begun: list[Any] = []
        try:
            yield from _in_a_pool(min(workers, len(left)), part, left, begun)
        except BrokenProcessPool:  # all in it are lost, and nobody says whose process it was
            for item in begun:
                left.remove(item)
                yield item, _alone(part, item)


def _in_a_pool(workers: int, part: Callable[[Any], bytes], left: list[Any], begun: list[Any]) -> Found[Any]:
    """left: loses what is done. begun: what is computed now. Raises BrokenProcessPool."""
    with processes(workers, "spawn") as pool:
        waiting: dict[Future[bytes], Any] = {}
        coming = iter(list(left))
        while True:
            for item in coming:
                waiting[pool.submit(part, item)] = item
                begun.append(item)
                if len(waiting) >= workers:
                    break
            if not waiting:
                return
            for future in wait(waiting, return_when=FIRST_COMPLETED).done:
                found = future.result()
                item = waiting.pop(future)
                begun.remove(item)
                left.remove(item)
                yield item, found


def _alone(part: Callable[[Any], bytes], item: Any) -> bytes | LostPart:
    """In a process of its own: that it was lost with others says nothing of it."""
    for _ in range(ALONE):
        with suppress(BrokenProcessPool), processes(1, "spawn") as pool:
            return pool.submit(part, item).result()
    return LostPart(LOST)
