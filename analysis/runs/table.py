"""Columns of one channel: numpy arrays by name, with units in the names and time in seconds and UTC."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

Values = NDArray[Any]
TEXTS: Final = np.dtype(object)


@dataclass(frozen=True, slots=True)
class Table(Mapping[str, Values]):
    """n rows in the order of the log. A text that is absent is "", a float NaN; of whole numbers that are
    absent `missing` says which.

    >>> table = Table({"t_s": np.array([0.0, 0.2]), "count": np.array([3, 0])}, units={"t_s": "s"})
    >>> len(table.t_s), table["count"].tolist(), table.units["t_s"]
    (2, [3, 0], 's')
    """

    columns: Mapping[str, Values]  # each [n] or [n, width]
    units: Mapping[str, str] = field(default_factory=dict)  # of columns that have one
    missing: Mapping[str, NDArray[np.bool_]] = field(default_factory=dict)  # [n], of whole numbers

    def __getitem__(self, name: str) -> Values:
        try:
            return self.columns[name]
        except KeyError:
            raise KeyError(f"{name}: there are {', '.join(self.columns)}") from None

    def __iter__(self) -> Iterator[str]:
        return iter(self.columns)

    def __len__(self) -> int:
        """Columns, as of every mapping; `rows` counts the rows."""
        return len(self.columns)

    @property
    def rows(self) -> int:
        return len(next(iter(self.columns.values()), ()))

    @property
    def t_s(self) -> NDArray[np.float64]:
        """[n], s since the run began."""
        return self.columns["t_s"]

    def where(self, chosen: Values) -> "Table":
        """The rows of a mask or of numbers of rows."""
        return Table(
            {name: values[chosen] for name, values in self.columns.items()},
            self.units,
            {name: absent[chosen] for name, absent in self.missing.items()},
        )

    def between(self, start_s: float, end_s: float) -> "Table":
        """The rows from start_s until before end_s, s since the run began."""
        return self.where((self.t_s >= start_s) & (self.t_s < end_s))


def joined(parts: Sequence[Table]) -> Table:
    """One table of parts that follow each other and have the same columns."""
    first = parts[0]
    if len(parts) == 1:
        return first
    return Table(
        {name: np.concatenate([part[name] for part in parts]) for name in first},
        first.units,
        {name: np.concatenate([part.missing[name] for part in parts]) for name in first.missing},
    )
