"""The common clock: the last row of each sender that is not too old, and nothing else."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tilth.analysis.export.clock import ChannelSenders, ClockTable, Ticks, ticks_of
from tilth.analysis.export.columns import ExportRows, followed
from tilth.analysis.runs.reading import RunClock
from tilth.analysis.runs.table import Table

CLOCK = RunClock(0, 1_700_000_000_000_000_000)
Parts = list[tuple[str, Table]]


def _poses(t_s: list[float], heading: list[float] | None = None) -> Table:
    values: list[Any] = heading or [float(k) for k in range(len(t_s))]
    t = np.array(t_s)
    return Table({"t_s": t, "utc_s": t, "tractor_heading_rad": np.array(values)}, {"t_s": "s"})


def _angles(t_s: list[float], senders: list[tuple[str, int, int]]) -> Table:
    """senders: mount, source, PGN of each row."""
    mounts, sources, pgns = zip(*senders, strict=True)
    n = len(t_s)
    return Table(
        {
            "t_s": np.array(t_s), "bus": np.full(n, "can 0", object), "source": np.array(sources),
            "mount": np.array(mounts, object), "pgn": np.array(pgns), "repeat": np.array([True] * n),
            "count": np.arange(n), "text": np.array([f"row {k}" for k in range(n)], object),
        },
        missing={"count": np.arange(n) % 2 == 1},
    )  # fmt: skip


def _on_clock(parts: Parts, ticks: Ticks) -> tuple[ExportRows, ClockTable]:
    senders = ChannelSenders()
    for channel, table in parts:
        senders.take(channel, table)
    made = ClockTable(senders, ticks, CLOCK)
    rows = [row for channel, table in parts for row in made.take(channel, table)]
    return followed([*rows, *made.end()]), made


def test_a_value_holds_until_it_is_too_old() -> None:
    rows, _ = _on_clock([("pose", _poses([0.2, 0.4, 2.0]))], ticks_of(100_000_000, 0.0, 9.0, 2.2))
    np.testing.assert_array_equal(rows.named("t_s"), np.arange(23) / 10)
    wanted = np.full(23, np.nan)
    wanted[2:4], wanted[4:10], wanted[20:] = 0, 1, 2  # 0.5 s old at 0.9 s
    np.testing.assert_array_equal(rows.named("pose__tractor_heading_rad"), wanted)
    age = rows.named("pose__age_s")
    assert np.isnan(age[[0, 10, 19]]).all() and age[9] == 0.5 and age[4] == 0.0
    assert str(rows.named("utc")[5]) == "2023-11-14T22:13:20.500000"


def test_a_heading_that_goes_round_is_never_between() -> None:
    headings = [3.13, -3.13, 3.14, -3.14]
    rows, _ = _on_clock(
        [("pose", _poses([0.0, 0.2, 0.4, 0.6], headings))], ticks_of(7_000_000, 0.0, 9.0, 0.7)
    )
    assert set(rows.named("pose__tractor_heading_rad").tolist()) == set(headings)


def test_each_sender_has_its_own_columns_and_its_pgn_where_it_has_several() -> None:
    rows_by = [("tractor_front", 28, 1), ("", 21, 3), ("tractor_front", 99, 1), ("", 21, 4)]
    table = _angles([0.0, 0.05, 0.1, 0.15], rows_by)
    rows, _ = _on_clock([("measurement_wheel_angle", table)], ticks_of(50_000_000, 0.0, 9.0, 1.0))
    names = [column.name for column in rows.columns]
    one = "measurement_wheel_angle_tractor_front"  # whatever address it claims
    others = [f"measurement_wheel_angle_can_0_21_{pgn}" for pgn in (3, 4)]
    ends = ["age_s", "repeat", "count", "text"]
    assert names == ["t_s", "utc_s", "utc", *(f"{who}__{end}" for who in (*others, one) for end in ends)]
    assert rows.named(f"{one}__count")[:4].tolist() == [0, 0, 2, 2]
    absent = dict(zip(names, rows.absent, strict=True))
    gaps = absent[f"{others[0]}__text"]
    assert gaps is not None and np.flatnonzero(~gaps).tolist() == list(range(1, 12))
    missing = absent[f"{others[0]}__count"]
    assert missing is not None and missing.all()  # it was absent in the row itself


def _brute(t_s: NDArray[Any], ticks_ns: NDArray[Any], age_s: float) -> list[int]:
    """Row at each tick, -1 for a gap."""
    t_ns = np.rint(t_s * 1e9).astype(int)
    found = []
    for tick in ticks_ns.tolist():
        rows = [k for k in range(len(t_ns)) if t_ns[k] <= tick]
        last = max(rows, key=lambda k: (t_ns[k], k), default=-1)
        found.append(last if last >= 0 and tick - t_ns[last] <= age_s * 1e9 else -1)
    return found


@pytest.mark.parametrize("seed", range(6))
def test_in_parts_it_is_what_all_at_once_gives(seed: int) -> None:
    rng = np.random.default_rng(seed)
    pose = np.sort(np.round(rng.uniform(0, 60, 150), 2))
    status = np.sort(np.round(rng.uniform(0, 60, 20), 2))
    parts: Parts = []
    for edge in range(0, 60, 4):
        of_pose = pose[(pose >= edge) & (pose < edge + 4)]
        of_status = status[(status >= edge) & (status < edge + 4)]
        numbers = np.searchsorted(pose, of_pose).astype(float)
        # they come up to 1.5 s after their instant
        late = np.argsort(of_pose + rng.uniform(0, 1.5, len(of_pose)), kind="stable")
        parts.append(("pose", _poses(of_pose[late].tolist(), numbers[late].tolist())))
        if of_status.size:
            parts.append(("status", _poses(of_status.tolist())))
    ticks = ticks_of(130_000_000, 3.0, 57.0, 60.0)
    rows, made = _on_clock(parts, ticks)
    tick_ns = np.arange(ticks.first, ticks.last) * 130_000_000
    assert len(rows) == len(ticks) and made.late == 0
    wanted = [pose[k] if k >= 0 else np.nan for k in _brute(pose, tick_ns, 0.5)]
    got = rows.named("pose__tractor_heading_rad")
    np.testing.assert_array_equal([np.nan if np.isnan(k) else pose[int(k)] for k in got], wanted)
    gaps = np.array(_brute(status, tick_ns, 3.0)) < 0
    np.testing.assert_array_equal(np.isnan(rows.named("status__age_s")), gaps)
    assert gaps.any() and np.isnan(wanted).any()


def test_rows_that_come_too_late_are_counted() -> None:
    parts: Parts = [("pose", _poses(t_s)) for t_s in ([0.0, 10.0], [20.0], [1.0], [21.0])]
    rows, made = _on_clock(parts, ticks_of(1_000_000_000, 0.0, 99.0, 22.0))
    assert made.late == 1 and len(rows) == 23
    assert np.flatnonzero(~np.isnan(rows.named("pose__age_s"))).tolist() == [0, 10, 20, 21]


def test_ticks() -> None:
    assert ticks_of(20_000_000, 0.0, 1.0, 50.0) == Ticks(20_000_000, 0, 50)
    assert ticks_of(20_000_000, 0.01, 1.01, 50.0) == Ticks(20_000_000, 1, 51)
    assert len(ticks_of(20_000_000, 0.0, 99.0, 0.1)) == 6  # the last at the run's end
    assert len(ticks_of(20_000_000, 3.0, 99.0, 0.1)) == 0
