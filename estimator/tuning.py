"""Tuning constants with unit and meaning: one frozen record per component, beside its code.

    @dataclass(frozen=True, slots=True)
    class WindowTuning:
        longest: int = tuned(150, "segments", "of the longest window, 30 s")

    WINDOWS: Final = WindowTuning()

components.py finds the records, `tilth model --parameters` prints them. Constants of nature, layouts of
arrays and units are no tuning. A kernel cannot read a record: it reads a global that is one of its values.
"""

from collections.abc import Mapping
from dataclasses import field, fields
from typing import Any, NamedTuple, TypeVar

import numpy as np

T = TypeVar("T")


class Row(NamedTuple):
    """One constant of a record."""

    name: str
    value: Any  # number, or numbers in a tuple, an array or a mapping
    unit: str  # "1" of a share, a factor or a logarithm
    meaning: str


def tuned(value: T, unit: str, meaning: str) -> T:
    """A field of a record, with its value."""
    return field(default_factory=lambda: value, metadata={"unit": unit, "meaning": meaning})


def rows(record: Any) -> list[Row]:
    """Its constants, in the order of the code. Raises KeyError for a field that is not `tuned`."""
    return [
        Row(item.name, getattr(record, item.name), item.metadata["unit"], item.metadata["meaning"])
        for item in fields(record)
    ]


def plain(value: Any) -> Any:
    """A constant in types of JSON."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, tuple):
        return [plain(item) for item in value]
    return value.tolist() if isinstance(value, np.ndarray) else value
