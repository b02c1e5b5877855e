"""What is exported is what the messages say, of every channel and each field."""

import math

import numpy as np
import pytest
from filled_log import Filled, expected, filled_log
from logs import START_NS

from tilth.analysis.export.clock import ChannelSenders
from tilth.analysis.export.columns import (
    FRAMES,
    TEXT,
    ExportRows,
    followed,
    instants,
    rows_of,
    rows_of_frames,
)
from tilth.analysis.export.naming import TOPICS
from tilth.analysis.runs.reading import RunClock
from tilth.analysis.runs.run import Run, open_runs
from tilth.replay.readers.arrays import frame_parts
from tilth.schemas.flow import Frame, Status

Written = tuple[Run, Filled, list[Frame]]


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Written:
    path = tmp_path_factory.mktemp("log") / "run.mcap"
    sent, frames = filled_log(path)
    (run,) = open_runs(path)
    return run, sent, frames


def _cell(rows: ExportRows, name: str, k: int) -> object:
    """As a person reads it: None where nothing is."""
    place = [column.name for column in rows.columns].index(name)
    absent = rows.absent[place]
    value = rows.values[place][k]
    if absent is not None and bool(absent[k]) and rows.columns[place].kind != TEXT:
        return None
    if isinstance(value, float | np.floating):
        return None if math.isnan(value) else float(value)
    return value


@pytest.mark.parametrize("channel", TOPICS)
def test_every_field_of_every_message(written: Written, channel: str) -> None:
    run, sent, _ = written
    rows = rows_of(run.table(TOPICS[channel]))
    names = [column.name for column in rows.columns]
    assert len(set(names)) == len(names) and len(rows) == len(sent[TOPICS[channel]])
    read = set()
    for k, (t_ns, message) in enumerate(sent[TOPICS[channel]]):
        assert _cell(rows, "t_s", k) == (t_ns - START_NS) / 1e9
        for name, value in expected(TOPICS[channel], message).items():
            if name in names:
                told = Status(value).name.lower() if name.endswith("_status") else value
                assert _cell(rows, name, k) == told, (name, k)
                read.add(name)
    times = {"t_s", "utc_s", "utc", "rx_s", "load_t_ns"}
    assert set(names) - times <= read and (
        len(read) > 1 or channel in ("ready", "fit", "accepted", "addresses")
    )


def test_raw_frames(written: Written) -> None:
    run, _, frames = written
    buses: dict[str, int] = {}
    parts = [
        rows_of_frames(part, tuple(buses), run.reader.clock)
        for part in frame_parts(run.files[0].path, buses, {})
    ]
    rows = followed(parts)
    assert len(parts) > 3 and len(rows) == len(frames)
    for k, frame in enumerate(frames):
        cells = [_cell(rows, name, k) for name in ("bus", "id", "extended", "error", "length")]
        assert cells == [frame.bus, frame.can_id, frame.extended, frame.error, len(frame.data)]
        assert rows.values[-1][k][: len(frame.data)].tobytes() == frame.data
        absent = rows.absent[-1]
        assert absent is not None and np.count_nonzero(~absent[k]) == len(frame.data)
        assert _cell(rows, "rx_s", k) == (frame.rx_ns - START_NS) / 1e9


def test_units_and_frames_stand_at_the_columns(written: Written) -> None:
    run, _, _ = written
    found = {column.name: column for column in rows_of(run.poses).columns}
    wanted = {
        "tractor_x_m": ("m", "W"), "implement_heading_rad": ("rad", "W"),
        "origin_latitude_deg": ("deg", "WGS 84"),
        "tractor_lateral_velocity_mps": ("m/s", "T"), "implement_yaw_rate_radps": ("rad/s", "I"),
        "articulation_rad": ("rad", ""), "direction": ("", ""),
    }  # fmt: skip
    assert {name: (found[name].unit, found[name].frame) for name in wanted} == wanted
    assert {column.frame for column in found.values()} <= {"", *FRAMES}
    estimate = {column.name: column for column in rows_of(run.estimates()).columns}
    assert "unestimated, estimated" in estimate["C_af_status"].meaning
    assert estimate["bound_sigma_i"].kind == "double" and estimate["log_covariance_C_af_sigma_i"].unit == ""


def test_names_fit_into_mat_with_and_without_the_sender(written: Written) -> None:
    run, _, _ = written
    for channel, topic in TOPICS.items():
        table = run.table(topic)
        senders = ChannelSenders()
        senders.take(channel, table)
        names = [column.name for column in rows_of(table).columns]
        long = [f"{prefix}__{name}" for prefix in senders.named().values() for name in names]
        assert all(name.isidentifier() and len(name) <= 63 for name in names), channel
        assert all(name.isidentifier() for name in long)


def test_instants() -> None:
    found = instants(np.array([1_700_000_000.25, np.nan]))
    assert str(found[0]) == "2023-11-14T22:13:20.250000" and np.isnat(found[1])
    assert RunClock(5).utc_minus_ns is None
