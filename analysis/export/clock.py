"""All channels on one clock: at each tick the last row of each sender that is not too old.

Nothing is interpolated or averaged, so a heading that goes round is never wrong, and a gap stays a gap. Times
are reckoned in whole ns: a pose of an instant belongs to the tick of that instant.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilth.analysis.export.columns import (
    DOUBLE,
    INSTANT,
    ExportColumn,
    ExportRows,
    Mask,
    followed,
    rows_of,
    times,
)
from tilth.analysis.export.naming import age_s
from tilth.analysis.runs.reading import RunClock
from tilth.analysis.runs.table import Table

LATEST_NS: Final = 2_000_000_000  # that a row stands in the log after its instant; a pose waits for 0.5 s
TICKS: Final = 2048  # written at once
MOST_TICKS: Final = 1 << 31
AGE: Final = "age_s"
_DIVIDER: Final = "__"  # between sender and column; no channel has it in its name
_OF_SENDER: Final = frozenset({"bus", "source", "name", "mount", "pgn", "sid"})
_LEFT_OUT: Final = _OF_SENDER | {"t_s", "utc_s", "utc"}


class ChannelSender(NamedTuple):
    """Whose values of a channel one column holds; only measurements have several senders."""

    channel: str
    who: str = ""  # mount, or bus and address
    pgn: int = 0


@dataclass(frozen=True, slots=True)
class Ticks:
    """first to last, of so many ns since the run began."""

    period_ns: int
    first: int
    last: int  # the one after the last

    def __len__(self) -> int:
        return max(0, self.last - self.first)


def ticks_of(period_ns: int, from_s: float, until_s: float, duration_s: float) -> Ticks:
    """Those from from_s until before until_s, as long as the run lasts; 0 is the run's first record."""
    first, end = (-(-round(t * 1e9) // period_ns) for t in (from_s, min(until_s, duration_s + 1e-9)))
    return Ticks(period_ns, first, end)


@dataclass(slots=True)
class ChannelSenders:
    """Found in a first pass: who sends what, and the columns of each channel."""

    found: dict[ChannelSender, tuple[ExportColumn, ...]] = field(default_factory=dict)

    def take(self, channel: str, table: Table) -> None:
        """Look at rows."""
        columns: tuple[ExportColumn, ...] | None = None
        for sender in dict.fromkeys(_senders(channel, table)):
            if sender not in self.found:
                columns = columns or rows_of(table).but(_LEFT_OUT).columns
                self.found[sender] = columns

    def named(self) -> dict[ChannelSender, str]:
        """What the columns of each begin with; with the PGN where one sends a quantity in several."""
        names = {}
        for sender in sorted(self.found):
            several = sum(sender[:2] == other[:2] for other in self.found) > 1
            words = [sender.channel, sender.who, str(sender.pgn) if several else ""]
            names[sender] = "_".join(filter(None, words))
        return names


def _senders(channel: str, table: Table) -> list[ChannelSender]:
    """Of each row."""
    if "mount" not in table or "pgn" not in table:
        return [ChannelSender(channel)] * table.rows
    rows = zip(*(table[name].tolist() for name in ("mount", "bus", "source", "pgn")), strict=True)
    known: dict[Any, ChannelSender] = {}
    found = []
    for row in rows:
        if row not in known:
            mount, bus, source, pgn = row
            who = re.sub(r"[^A-Za-z0-9]", "_", mount or f"{bus}_{source}")
            known[row] = ChannelSender(channel, who, pgn)
        found.append(known[row])
    return found


@dataclass(slots=True)
class _HeldRows:
    """Rows of one sender that a tick to come may need, in the order of their times."""

    columns: tuple[ExportColumn, ...]
    age_ns: int
    t_ns: NDArray[np.int64]
    rows: ExportRows | None = None

    def add(self, t_ns: NDArray[np.int64], rows: ExportRows) -> None:
        parts = [rows] if self.rows is None else [self.rows, rows]
        self.t_ns = np.concatenate([self.t_ns, t_ns])
        self.rows = followed(parts)
        if np.any(np.diff(self.t_ns) < 0):
            order = np.argsort(self.t_ns, kind="stable")
            self.t_ns, self.rows = self.t_ns[order], self.rows.take(order)

    def at(self, tick_ns: NDArray[np.int64]) -> tuple[list[NDArray[Any]], list[Mask | None]]:
        """Age and columns at ticks."""
        n = len(tick_ns)
        if self.rows is None or not len(self.rows):
            made = [_nothing(column.kind, n) for column in self.columns]
            gap = np.ones(n, np.bool_)
            return [np.full(n, np.nan), *made], [None, *(_mask(c.kind, gap) for c in self.columns)]
        row = np.searchsorted(self.t_ns, tick_ns, side="right") - 1
        age = tick_ns - self.t_ns[row]
        gap = (row < 0) | (age > self.age_ns)
        taken = self.rows.take(row)
        values: list[NDArray[Any]] = [np.where(gap, np.nan, age / 1e9)]
        masks: list[Mask | None] = [None]
        for column, value, absent in zip(taken.columns, taken.values, taken.absent, strict=True):
            values.append(np.where(gap, np.nan, value) if column.kind == DOUBLE else value)
            masks.append(_mask(column.kind, gap if absent is None else gap | absent))
        self._forget(int(row[-1]))
        return values, masks

    def _forget(self, row: int) -> None:
        """What no later tick needs."""
        if row > 0 and self.rows is not None:
            self.t_ns, self.rows = self.t_ns[row:], self.rows.take(np.arange(row, len(self.rows)))


def _mask(kind: str, gap: Mask) -> Mask | None:
    return None if kind in (DOUBLE, INSTANT) else gap


def _nothing(kind: str, n: int) -> NDArray[Any]:
    types: Mapping[str, Any] = {DOUBLE: np.float64, "whole": np.int64, "truth": np.bool_, "text": object}
    return np.full(n, {DOUBLE: np.nan, "text": ""}.get(kind, 0), types[kind])


class ClockTable:
    """The second pass: takes tables as they are read, gives the rows of ticks as soon as all is read that
    belongs to them."""

    def __init__(self, senders: ChannelSenders, ticks: Ticks, clock: RunClock) -> None:
        self._ticks, self._clock = ticks, clock
        self._names = senders.named()
        self._held = {
            sender: _HeldRows(
                senders.found[sender], round(age_s(sender.channel) * 1e9), np.zeros(0, np.int64)
            )
            for sender in self._names
        }
        self._next = ticks.first
        self._round: set[str] = set()  # channels since all were read up to the same place
        self._read_ns = 0
        self.late = 0  # rows that came after the ticks they belong to
        self.columns = self._columns()

    def _columns(self) -> tuple[ExportColumn, ...]:
        found = list(times(np.zeros(0), self._clock).columns)
        for sender, name in self._names.items():
            age = ExportColumn(AGE, DOUBLE, "s", meaning="since the row's instant")
            for column in (age, *self._held[sender].columns):
                found.append(replace(column, name=f"{name}{_DIVIDER}{column.name}", optional=True))
        return tuple(found)

    def take(self, channel: str, table: Table) -> Iterator[ExportRows]:
        """Add rows of a channel. A channel that comes again has been read further, as all others have."""
        if channel in self._round:
            yield from self._until((self._read_ns - LATEST_NS) // self._ticks.period_ns)
            self._round.clear()
        self._round.add(channel)
        t_ns = np.rint(table.t_s * 1e9).astype(np.int64)
        self._read_ns = max(self._read_ns, int(t_ns.max(initial=0)))
        if self._next > self._ticks.first:
            self.late += int(np.count_nonzero(t_ns <= (self._next - 1) * self._ticks.period_ns))
        rows = rows_of(table).but(_LEFT_OUT)
        senders = _senders(channel, table)
        for sender in dict.fromkeys(senders):
            its = np.array([one is sender or one == sender for one in senders])
            self._held[sender].add(t_ns[its], rows.take(its))

    def end(self) -> Iterator[ExportRows]:
        """The ticks that are left."""
        yield from self._until(self._ticks.last)

    def _until(self, tick: int) -> Iterator[ExportRows]:
        """The ticks before this one."""
        last = min(tick, self._ticks.last)
        while self._next < last:
            stop = min(last, self._next + TICKS)
            yield self._rows(np.arange(self._next, stop, dtype=np.int64) * self._ticks.period_ns)
            self._next = stop

    def _rows(self, tick_ns: NDArray[np.int64]) -> ExportRows:
        own = times(tick_ns / 1e9, self._clock)
        values, absent = list(own.values), list(own.absent)
        for held in self._held.values():
            more, masks = held.at(tick_ns)
            values += more
            absent += masks
        return ExportRows(self.columns, tuple(values), tuple(absent))


def ages(names: Sequence[str]) -> dict[str, float]:
    """Channel -> how old its values may be, s."""
    return {name: age_s(name) for name in names}
