"""A table of a recorded drive gives the drive's numbers; a wrong one is told what is wrong."""

import csv
import io
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recorded import recorded, shared_cache
from scipy.io import savemat

from tilth.analysis.runs.run import open_runs
from tilth.cli import main
from tilth.replay.readers.any_log import frames
from tilth.schemas.decode import Decoder

MAP = """
time = "t [ms]"
start = 2026-05-04T10:00:00Z
wheel_angle = "-left [deg]"
"""
RECEIVER = """
[receiver.{mount}]
latitude = "{mount}.lat [deg]"
longitude = "{mount}.lon [deg]"
speed = "{mount}.v [km/h]"
course = "{mount}.course [deg]"
yaw_rate = "{mount}.r [deg/s]"
roll = "{mount}.roll [deg]"
"""
COLUMNS = (
    ("latitude_deg", "lat", 1.0), ("longitude_deg", "lon", 1.0), ("speed_mps", "v", 3.6),
    ("course_rad", "course", 180.0 / np.pi), ("yaw_rate_radps", "r", 180.0 / np.pi),
    ("roll_rad", "roll", 180.0 / np.pi),
)  # fmt: skip

Call = Callable[..., tuple[int, str, str]]


@pytest.fixture
def call(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Call:
    monkeypatch.setenv("XDG_CACHE_HOME", str(shared_cache()))

    def run(*words: str | Path) -> tuple[int, str, str]:
        status = main([*map(str, words)])
        out, err = capsys.readouterr()
        return status, out, err

    return run


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, dict[str, Any]]:
    """Machine file and map of a recorded drive, and its measurements as columns."""
    folder = tmp_path_factory.mktemp("table")
    log = recorded().parts[0]
    (run,) = open_runs([log])
    (folder / "m.toml").write_text(run.machine_file.text)
    mounts = {receiver.name: receiver for receiver in run.machine.receiver}
    text = MAP + "".join(RECEIVER.format(mount=receiver.mount.value) for receiver in mounts.values())
    (folder / "map.toml").write_text(text)
    decoder, rows = Decoder(run.machine), dict[int, dict[str, float]]()
    began: dict[int | None, int] = {}
    for frame in frames(log):
        for message in decoder.messages(frame):
            receiver = mounts.get(message.origin.name)
            late_s = run.machine.wheel_angle.delay if receiver is None else receiver.latency.value
            if receiver is None or message.pgn in (
                65267,
                129025,
            ):  # a clump of messages begins with the place
                began[message.origin.name] = round(1e-6 * message.t_ns - 1e3 * late_s)
            if message.pgn == 129029 or message.origin.name not in began:
                continue
            row = rows.setdefault(began[message.origin.name], {})
            if receiver is not None:
                for key, name, scale in COLUMNS:
                    if isinstance(value := message.values.get(key), float):
                        row[f"{receiver.mount.value}.{name}"] = scale * value
            elif "wheel_angle_rad" in message.values:
                row["left"] = -np.degrees(float(message.values["wheel_angle_rad"]))
    first, names = min(rows), sorted({name for row in rows.values() for name in row})
    times = sorted(rows)
    columns = {name: np.array([rows[t].get(name, np.nan) for t in times]) for name in names}
    return folder / "m.toml", folder / "map.toml", {"t": np.array(times, float) - first, **columns}


def as_csv(columns: dict[str, Any], delimiter: str = ",") -> str:
    out = io.StringIO()
    writer = csv.writer(out, delimiter=delimiter)
    writer.writerow(columns)
    for row in zip(*columns.values(), strict=True):
        cells = ["" if np.isnan(x) else repr(float(x)) for x in row]
        writer.writerow([cell.replace(".", ",") for cell in cells] if delimiter == ";" else cells)
    return out.getvalue()


@pytest.mark.long
def test_a_table_gives_the_numbers_of_its_drive(
    call: Call, drive: tuple[Path, Path, dict[str, Any]], tmp_path: Path
) -> None:
    """Of CSV; the same frames of MAT, whose names have no dots."""
    machine, given, columns = drive
    (tmp_path / "drive.csv").write_text(as_csv(columns, ";"))
    savemat(tmp_path / "drive.mat", {name.replace(".", "_"): column for name, column in columns.items()})
    renamed = tmp_path / "map.toml"
    renamed.write_text(re.sub(r"\.(lat|lon|v|course|r|roll) ", r"_\1 ", given.read_text()))
    logs = []
    for table, names in ((tmp_path / "drive.csv", given), (tmp_path / "drive.mat", renamed)):
        logs.append(table.with_name(f"{table.suffix[1:]}.mcap"))
        rest = ("--map", names, "--machine", machine, "--out", logs[-1], "--json")
        status, told, _ = call("import", table, *rest)
        assert status == 0 and json.loads(told)["seconds"] == pytest.approx(1e-3 * columns["t"][-1])
    assert list(frames(logs[0])) == list(frames(logs[1]))
    out = logs[0]
    (one,), (same,) = open_runs([out]), open_runs([recorded().parts[0]])
    assert one.machine.name == same.machine.name
    answers = [
        json.loads(call("fit", log, "--segment", "4:27", "--json")[1]) for log in (recorded().parts[0], out)
    ]
    for name in ("C_af", "C_ar", "C_ai"):
        first, second = (answer["runs"][0]["parameters"][name] for answer in answers)
        assert abs(second["value"] - first["value"]) < 0.6 * first["sd"]


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('"t [ms]"', '"t"', 'time: give column and unit, such as "column [s]"'),
        ('"t [ms]"', '"t [h]"', "time: the unit is one of s, ms, us, ns, not h"),
        ('"t [ms]"', '"u [ms]"', "there is no column u; there are t, "),
        ('"t [ms]"', '"-t [ms]"', "must grow from row to row"),
        ("wheel_angle", "wheel", "wheel is no key"),
        ("[receiver.tractor_front]", "[receiver.cab]", "receiver.cab: a receiver is one of tractor_front"),
        ("latitude", "height", "height is nothing that is read"),
        (
            'latitude = "tractor_front.lat [deg]"',
            'east = "x [m]"',
            "needs latitude and longitude, or east and north",
        ),
        ("start = 2026", "start = 'x' # 2026", "start is the date and time of time 0"),
        ("time =", "time", "Expected '=' after a key"),
    ],
)
def test_a_wrong_map_is_told(
    old: str, new: str, says: str, call: Call, drive: tuple[Path, Path, dict[str, Any]], tmp_path: Path
) -> None:
    machine, given, columns = drive
    table, wrong, out = tmp_path / "drive.csv", tmp_path / "wrong.toml", tmp_path / "drive.mcap"
    table.write_text(as_csv({name: column[:200] for name, column in columns.items()}))
    wrong.write_text(given.read_text().replace(old, new, 1))
    status, _, err = call("import", table, "--map", wrong, "--machine", machine, "--out", out)
    assert status == 2 and says in err and not out.exists()


def test_what_is_no_table(call: Call, drive: tuple[Path, Path, dict[str, Any]], tmp_path: Path) -> None:
    machine, given, _ = drive
    rest = ("--map", given, "--machine", machine, "--out", tmp_path / "drive.mcap")
    for name, content, says in (
        ("a.txt", b"t\n1\n", "give a table that ends in .csv, .parquet, .mat"),
        ("b.csv", b"t,left\n", "no rows are in it"),
        ("c.mat", b"nothing at all, " * 20, "no MATLAB file"),
        ("d.csv", "t,left\n1,2\n".encode("utf-16"), "no table in UTF-8"),
    ):  # fmt: skip
        (tmp_path / name).write_bytes(content)
        status, _, err = call("import", tmp_path / name, *rest)
        assert status == 2 and says in err, name
    assert call("import", tmp_path / "none.csv", *rest)[0] == 2
    savemat(tmp_path / "e.mat", {"t": np.arange(9.0), "left": np.zeros(8), "place": np.zeros(9)})
    given.with_name("short.toml").write_text(
        'time = "t [s]"\nwheel_angle = "left [rad]"\n[receiver.tractor_front]\n'
        'latitude = "place [deg]"\nlongitude = "place [deg]"\n'
    )
    status, _, err = call("import", tmp_path / "e.mat", "--map", given.with_name("short.toml"), *rest[2:])
    assert status == 2 and "the columns t and left differ in length" in err
    given.with_name("none.toml").write_text('time = "t [s]"\nwheel_angle = "left [rad]"\nreceiver = 3\n')
    status, _, err = call("import", tmp_path / "e.mat", "--map", given.with_name("none.toml"), *rest[2:])
    assert status == 2 and "receiver: give at least one" in err
    assert not any(path.suffix in (".mcap", ".part") for path in tmp_path.iterdir())
