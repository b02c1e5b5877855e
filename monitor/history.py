"""What a page shows that opens now: rows by time, the last minutes whole, the hours before them thinned."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, Final

Row = tuple[Any, ...]  # its first item is the time, s

RECENT_S: Final = 600.0  # of it nothing is left out
MOST: Final = 4000  # rows held, about: a page draws them many times a second


@dataclass(slots=True)
class History:
    """Rows in the order of time. `every_s`: how far apart the older ones are."""

    most: int = MOST
    recent_s: float = RECENT_S
    every_s: float = 1.0
    rows: list[Row] = field(default_factory=list)

    def add(self, row: Row) -> bool:
        """True where what is held is not what it was plus this row: older rows were thinned, or all dropped
        because time ran back (another drive)."""
        back = bool(self.rows) and row[0] < self.rows[-1][0]
        if back:
            self.rows.clear()
            self.every_s = 1.0
        self.rows.append(row)
        if len(self.rows) <= self.most:
            return back
        self._thin()
        return True

    def _thin(self) -> None:
        recent_from = self.rows[-1][0] - self.recent_s
        old = [row for row in self.rows if row[0] < recent_from]
        new = self.rows[len(old) :]
        if len(new) > self.most * 3 // 4:  # so many in so short a time: spare none of them
            old, new = self.rows, []
        old = list(_apart(old, self.every_s))
        while len(old) + len(new) > self.most * 3 // 4:
            self.every_s *= 2
            old = list(_apart(old, self.every_s))
        self.rows = old + new


def _apart(rows: Iterable[Row], every_s: float) -> Iterable[Row]:
    last_s = float("-inf")
    for row in rows:
        if row[0] - last_s >= every_s:
            last_s = row[0]
            yield row
