"""What follows from the machine file alone is computed once for it, though it is asked for at each pose."""

from collections.abc import Callable
from functools import wraps
from typing import TypeVar

from tilth.schemas.machine import Machine

V = TypeVar("V")


def once_for_a_machine(function: Callable[[Machine], V]) -> Callable[[Machine], V]:
    """`function` of a machine file, which keeps its value for the file that it was last called with.

    Who calls it changes nothing of the value, nor do two threads that call it for different files.
    """
    last: tuple[Machine, V] | None = None

    @wraps(function)
    def remembering(machine: Machine) -> V:
        nonlocal last
        known = last
        if known is None or known[0] is not machine:
            last = known = (machine, function(machine))
        return known[1]

    return remembering
