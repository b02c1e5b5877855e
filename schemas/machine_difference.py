"""Which keys of two machine files differ, for a sentence that a person reads."""

from collections.abc import Iterator, Mapping
from typing import Any, Final

from tilth.schemas.ballast import as_told
from tilth.schemas.machine import Machine

TOLD: Final = 4  # keys; who needs more compares the files


def differing_keys(one: Machine, other: Machine) -> tuple[str, ...]:
    """Such as tractor.a and receiver[1].source, as the files name them, in their order."""
    first, second = (dict(_flat(as_told(machine).model_dump(), "")) for machine in (one, other))
    return tuple(key for key in {**first, **second} if first.get(key) != second.get(key))


def differing(one: Machine, other: Machine) -> str:
    """The first few, in words."""
    keys = differing_keys(one, other)
    if not keys:
        return "comments or the order of keys alone"
    more = f" and {len(keys) - TOLD} more" if len(keys) > TOLD else ""
    return ", ".join(keys[:TOLD]) + more


def _flat(value: Any, key: str) -> Iterator[tuple[str, Any]]:
    """(key, value) of all that has no keys below it. A length and its value are one key to a person."""
    if isinstance(value, Mapping):
        for name, inner in value.items():
            yield from _flat(inner, key if name == "value" else f"{key}.{name}".removeprefix("."))
    elif isinstance(value, list):
        for number, inner in enumerate(value, 1):
            yield from _flat(inner, f"{key}[{number}]")
    else:
        yield key, value
