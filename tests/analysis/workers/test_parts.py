"""Parts of work by processes of this computer, some of which are killed."""

import os
import signal
from functools import partial
from pathlib import Path

import pytest

from tilth.analysis.workers.parts import LOST, LostPart, here


def squared(item: int) -> bytes:
    return str(item * item).encode()


def killed_at(folder: Path, once: int, always: int, item: int) -> bytes:
    """As the kernel does where memory is short."""
    tried = folder / f"tried{item}"
    if item == always or (item == once and not tried.exists()):
        tried.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return squared(item)


@pytest.mark.parametrize("workers", [1, 2])
def test_each_item_is_answered_once(workers: int) -> None:
    found = dict(here(workers)(squared, range(5)))
    assert found == {k: squared(k) for k in range(5)}
    assert not list(here(workers)(squared, []))


@pytest.mark.long
def test_a_process_that_is_killed_costs_its_part_a_try_and_the_others_nothing(tmp_path: Path) -> None:
    found = dict(here(2)(partial(killed_at, tmp_path, 1, 3), range(6)))
    lost = found.pop(3)
    assert isinstance(lost, LostPart) and str(lost) == LOST
    assert found == {k: squared(k) for k in (0, 1, 2, 4, 5)}


def test_who_goes_away_leaves_no_process() -> None:
    parts = here(2)(squared, range(100))
    next(parts)
    parts.close()
