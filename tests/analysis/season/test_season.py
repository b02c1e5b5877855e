"""A season from logs to its table: what failed, what is done once, and what a kill leaves."""

import errno
import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from logs import MACHINE, OTHER_TEXT, SECOND, START_NS, some_frames, write_mcap
from recorded import cut, recorded

from tilth.analysis.runs.kept import load
from tilth.analysis.season.identified import Identified
from tilth.analysis.season.page import report_of, write_summary
from tilth.analysis.season.season import DONE, RUNS, SUMMARY, TABLE, Season, SeasonProblem, finish, season
from tilth.analysis.season.stretches import UNCONFIRMED, UNDATED
from tilth.analysis.workers.parts import LOST, LostPart, Parts, here
from tilth.estimator.filters.unknowns import SIX, prior
from tilth.logger.log import whole_file
from tilth.schemas.flow import PARAMETERS

pq = pytest.importorskip("pyarrow.parquet")
IN_PLACE = lambda longest_s: here(1)  # noqa: E731


def made(*paths: Path, out: Path, retry: bool = False, parts: Any = IN_PLACE) -> Season:
    found = season([str(path) for path in paths], out, parts, retry=retry)
    if found.rows is not None:
        write_summary(found, "tilth season")
        finish(found)
    return found


def rows_of(out: Path) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = pq.read_table(out / TABLE).to_pylist()
    return rows


@pytest.fixture
def logs(tmp_path: Path) -> Path:
    """Three runs of which nothing can be learned, and a file that is no log."""
    folder = tmp_path / "logs"
    folder.mkdir()
    for k in range(3):
        write_mcap(folder / f"day{k}.mcap", some_frames(30 + k), run=f"r{k}")
    (folder / "bad.mcap").write_bytes(b"none")
    return folder


def test_a_run_that_gives_nothing_and_a_bad_file_are_rows_with_reasons(logs: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    found = made(logs, out=out)
    assert found.computed == 3
    rows = rows_of(out)
    assert [(row["kind"], row["status"]) for row in rows] == [("run", "unestimated")] * 3 + [
        ("file", "invalid")
    ]
    assert all(row["reason"] for row in rows)
    assert rows[0]["machine"] == MACHINE.machine.name and len(rows[0]["logs_sha256"]) == 64
    page = (out / SUMMARY).read_text(encoding="utf-8")
    assert "<p>Runs that deserve a look: 3. Files that are not used: 1.</p>" in page
    assert page.index('id="look-at"') < page.index('id="days"')  # what to do comes before what was found
    assert (
        page.count("<td><time>") == 2 * 3 and "<time>" in page[page.index('id="days"') :]
    )  # days stay whole


def test_what_is_done_is_not_done_again(logs: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    made(logs, out=out)
    table = (out / TABLE).read_bytes()
    again = made(logs, out=out)
    assert again.rows is None and (out / TABLE).read_bytes() == table
    write_mcap(logs / "day9.mcap", some_frames(40), run="r9")
    assert made(logs, out=out).computed == 1
    (out / DONE).unlink()
    assert made(logs, out=out).computed == 0
    other = tmp_path / "other"
    made(logs, out=other)
    assert (other / TABLE).read_bytes() == (out / TABLE).read_bytes()
    assert not list(out.rglob("*.part"))


def _failing(fails: Sequence[str], longest_s: float) -> Parts:
    """As `here`, but some runs are lost."""

    def parts(part: Any, items: Sequence[Any]) -> Any:
        for item in items:
            lost = any(name in str(item.paths[0]) for name in fails)
            yield item, LostPart(LOST) if lost else part(item)

    return parts


def test_a_run_that_fails_is_a_row_and_is_tried_again_when_asked(logs: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    made(logs, out=out, parts=partial(_failing, ["day1"]))
    rows = [row for row in rows_of(out) if row["kind"] == "run"]
    assert [row["status"] for row in rows].count("invalid") == 1
    assert LOST in [row["reason"] for row in rows]
    assert made(logs, out=out).rows is None
    again = made(logs, out=out, retry=True)
    assert again.computed == 1 and again.done["failed"] == 0


def test_an_error_nobody_thought_of_is_the_runs_reason(
    logs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*args: object, **more: object) -> None:
        raise ZeroDivisionError("float division by zero")

    monkeypatch.setattr("tilth.analysis.season.identified.replay", broken)
    made(logs, out=tmp_path / "out")
    assert "ZeroDivisionError" in rows_of(tmp_path / "out")[0]["reason"]


def test_a_full_disk_costs_what_is_kept_and_no_result(
    logs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The table still fits."""
    write, out = whole_file.write, tmp_path / "out"

    def full(path: Path, data: bytes, **more: Any) -> None:
        if path.parent.name == RUNS:
            raise OSError(errno.ENOSPC, "No space left on device", str(path))
        write(path, data, **more)

    monkeypatch.setattr(whole_file, "write", full)
    found = made(logs, out=out)
    assert "space" in found.not_kept and len(rows_of(out)) == 4 and not (out / DONE).exists()
    monkeypatch.undo()
    assert made(logs, out=out).computed == 3


def test_two_seasons_do_not_write_into_one_folder(logs: Path, tmp_path: Path) -> None:
    def second(longest_s: float) -> Parts:
        with pytest.raises(SeasonProblem, match="another season"):
            season([str(logs)], tmp_path / "out", IN_PLACE)
        return here(1)

    made(logs, out=tmp_path / "out", parts=second)


CART = OTHER_TEXT.replace("[implement]", '[implement]\nname = "cart"', 1)


@pytest.mark.parametrize(
    ("texts", "name"),
    [
        ((OTHER_TEXT, OTHER_TEXT.replace("mass = 9391.0", "mass = 9000.0")), MACHINE.machine.name),
        ((CART, CART.replace("d = 3.62", "d = 4.10")), f"{MACHINE.machine.name}+cart"),
    ],
    ids=["two machines", "two implements"],
)
def test_rigs_of_one_name_are_kept_apart_and_told_of(
    texts: tuple[str, str], name: str, tmp_path: Path
) -> None:
    assert texts[0] != texts[1]
    for k, text in enumerate(texts):
        write_mcap(tmp_path / f"{k}.mcap", some_frames(30 + k), run=str(k), text=text)
    found = made(tmp_path, out=tmp_path / "out")
    assert found.runs is not None and found.runs[0].rig != found.runs[1].rig
    told = " ".join(text for one in found.runs for text in one.look)
    assert "kept apart" in told and f"two machines have the name {name}" in told


def test_a_run_whose_clock_is_of_1970_is_told_of_and_the_rest_goes_on(logs: Path, tmp_path: Path) -> None:
    frames = [
        replace(f, t_ns=f.t_ns - START_NS + SECOND, rx_ns=f.rx_ns - START_NS + SECOND)
        for f in some_frames(40)
    ]
    write_mcap(logs / "a_clock.mcap", frames, run="clock")
    found = made(logs, out=tmp_path / "out")
    assert found.runs is not None
    assert [one.run.name for one in found.runs] == ["day0", "day1", "day2", "a_clock"]
    assert [UNDATED in one.look for one in found.runs] == [False] * 3 + [True]
    runs = [row for row in rows_of(tmp_path / "out") if row["kind"] == "run"]
    assert [row["begin_utc"] is None for row in runs] == [False] * 3 + [True]


@pytest.mark.long
def test_a_drive_in_parts_and_one_that_was_cut(tmp_path: Path) -> None:
    """The same driving, once as two parts of a run and once cut: each gives stretches with values, places
    and covariances; two processes give the bytes of one."""
    live = recorded(2)
    out = tmp_path / "out"
    found = made(*live.parts, out=out)
    rows = rows_of(out)
    assert found.done["runs"] == 1 and [row["kind"] for row in rows] == ["stretch"] * len(rows) and rows
    for row in rows:
        assert len(row["latitude_deg"]) == len(row["longitude_deg"]) == 6
        for way in ("alone", "forward", "season"):
            assert (row[f"{way}_log_covariance"] is None) == (row["by_file"] is None)
        if row["by_file"] is None:
            assert row["reason"] == UNCONFIRMED or not row["together"]
            continue
        covariance = np.array(row["season_log_covariance"]).reshape(6, 6)
        assert np.all(np.diag(covariance) <= prior(MACHINE)[1][SIX] ** 2 * 1.3)
        assert row["reason"] == "" or not row["together"]
    assert any(row[name] for row in rows for name in PARAMETERS[:3])
    other = tmp_path / "two"
    season([str(part) for part in live.parts], other, lambda longest_s: here(2))
    assert (other / TABLE).read_bytes() == (out / TABLE).read_bytes()
    of_cut = made(cut(), out=tmp_path / "cut")
    assert "cut off" in " ".join(text for one in of_cut.runs or () for text in one.look)
    assert "Season" in report_of(found, "x").title


START = "import sys; from tilth.cli import main; sys.exit(main())"


def _started(logs: Path, out: Path) -> subprocess.Popen[bytes]:
    words = ["season", str(logs), "--out", str(out), "--workers", "2"]
    return subprocess.Popen([sys.executable, "-c", START, *words], start_new_session=True)


CUTS = int(os.environ.get("TILTH_SEASON_CUTS", "3"))


@pytest.mark.long
def test_the_table_is_the_same_where_all_that_nobody_reads_is_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    unread, read = tmp_path / "unread", tmp_path / "read"
    made(*recorded().parts, out=unread)
    monkeypatch.setattr("tilth.analysis.season.identified.advice.unread", nullcontext)
    made(*recorded().parts, out=read)
    assert any(row["kind"] == "stretch" for row in rows_of(read))
    assert (unread / TABLE).read_bytes() == (read / TABLE).read_bytes()


@pytest.mark.long
def test_killed_at_random_instants_it_ends_with_the_same_table(tmp_path: Path) -> None:
    """By SIGKILL of all its processes. TILTH_SEASON_CUTS: how often."""
    logs, whole = tmp_path / "logs", tmp_path / "whole"
    logs.mkdir()
    for k in range(3):
        write_mcap(logs / f"day{k}.mcap", some_frames(3000 + k), run=f"r{k}")
    path = write_mcap(logs / "cut.mcap", some_frames(400, seed=1), finish=False)
    path.write_bytes(path.read_bytes()[:-40])
    began = time.monotonic()
    assert _started(logs, whole).wait(300) == 0
    took_s = time.monotonic() - began
    rng, kills = np.random.default_rng(56), 0
    while kills < CUTS:
        out = tmp_path / f"out{kills}"
        while kills < CUTS:
            process = _started(logs, out)
            try:
                process.wait(float(rng.uniform(0.1, took_s)))
                break
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
                kills += 1
        assert _started(logs, out).wait(300) == 0
        assert (out / TABLE).read_bytes() == (whole / TABLE).read_bytes()
        for kept in (out / RUNS).iterdir():
            assert load(kept, Identified) is not None
        assert not list(out.rglob("*.part"))
