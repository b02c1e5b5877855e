"""A run becomes a folder, whole or not at all; the examples of the page do what they say."""

import csv
import json
import math
import re
import shlex
import shutil
import subprocess
from itertools import pairwise
from pathlib import Path

import numpy as np
import polars
import pyarrow.parquet
import pyarrow.types
import pytest
from filled_log import filled_log
from logs import MACHINE_TEXT
from one_recording import file_size_limit
from paths import ROOT

from tilth.analysis.export.columns import rows_of
from tilth.analysis.export.export import ExportPlan, check, export, folders_of
from tilth.analysis.export.files import ExportError, ParquetFile
from tilth.analysis.export.naming import NAMES, TOPICS, choose
from tilth.analysis.runs.kept import sha256_of
from tilth.analysis.runs.run import Run, open_runs
from tilth.cli import main
from tilth.logger.log.software import software


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    path = tmp_path_factory.mktemp("log") / "run.mcap"
    filled_log(path, 300)  # 11 s
    (found,) = open_runs(path)
    return found


def test_all_channels_with_all_that_is_known(run: Run, tmp_path: Path) -> None:
    heard: list[tuple[int, int]] = []
    done = export(run, ExportPlan("parquet", NAMES), tmp_path / "r", lambda *at: heard.append(at))
    assert done.rows == {f"{name}.parquet": 300 for name in NAMES} and not done.skipped
    assert {path.name for path in (tmp_path / "r").iterdir()} == {*done.rows, "export.json"}
    assert heard == sorted(heard) and len({of for _, of in heard}) == 1 and heard[-1][0] > 0.8 * heard[-1][1]
    about = json.loads((tmp_path / "r" / "export.json").read_text())
    (source,) = about["sources"]
    assert source["sha256"] == sha256_of(run.sources[0]) and source["file"] == "run.mcap"
    assert about["machine"] == {"toml": MACHINE_TEXT, "sha256": run.machine_file.sha256}
    assert about["tilth"] == software()["version"]
    for name, topic in TOPICS.items():
        table = polars.read_parquet(tmp_path / "r" / f"{name}.parquet")
        rows = rows_of(run.table(topic))
        known = about["files"][f"{name}.parquet"]["columns"]
        empty = about["files"][f"{name}.parquet"]["empty"]
        assert table.columns == list(known) and known["of_run"]["kind"] == "text"
        assert {*table.columns, *empty} == {"of_run", *(column.name for column in rows.columns)}
        assert set(table["of_run"]) == {"r"}
        assert not any(table[column].is_null().all() for column in table.columns)
        for column, values in zip(rows.columns, rows.values, strict=True):
            if column.kind == "double" and column.name not in empty:
                np.testing.assert_array_equal(table[column.name].to_numpy().astype(float), values)
        schema = pyarrow.parquet.read_schema(tmp_path / "r" / f"{name}.parquet")
        in_file = json.loads(schema.metadata[b"tilth"])
        assert in_file["machine"] == about["machine"] and in_file["columns"] == known


@pytest.mark.parametrize("form", ["parquet", "csv"])
def test_no_column_is_empty_in_all_of_a_file(run: Run, tmp_path: Path, form: str) -> None:
    """Of a span in which some are, though not in the whole run; on a clock too."""
    for name, plan in (
        ("span", ExportPlan(form, ("soil_tire", "status", "can"), None, 0.0, 0.5)),
        ("clock", ExportPlan(form, choose(["pose", "status"], True), 100_000_000)),
    ):
        done = export(run, plan, tmp_path / name)
        about = json.loads((tmp_path / name / "export.json").read_text())["files"]
        for file in done.rows:
            path = tmp_path / name / file
            table = (
                polars.read_parquet(path) if form == "parquet" else polars.read_csv(path, infer_schema=False)
            )
            assert [one for one in table.columns if table[one].is_null().all()] == []
            assert not {*about[file]["empty"]} & {*table.columns}


def test_a_span_and_a_clock(run: Run, tmp_path: Path) -> None:
    plan = ExportPlan("parquet", ("pose", "can"), None, 2.0, 3.0)
    export(run, plan, tmp_path / "span")
    for name in ("pose", "can"):
        t_s = polars.read_parquet(tmp_path / "span" / f"{name}.parquet")["t_s"].to_numpy()
        assert len(t_s) == 27 and t_s.min() >= 2.0 and t_s.max() < 3.0
    on_clock = choose(["pose", "status"], True)
    done = export(run, ExportPlan("parquet", on_clock, 20_000_000, 2.0, 3.0), tmp_path / "clock")
    assert done.rows == {"clock.parquet": 50}
    table = polars.read_parquet(tmp_path / "clock" / "clock.parquet")
    poses = run.poses
    rows = np.searchsorted(poses.t_s, table["t_s"].to_numpy() + 1e-10) - 1
    np.testing.assert_array_equal(
        table["pose__tractor_heading_rad"].to_numpy().astype(float), poses["tractor_heading_rad"][rows]
    )
    assert table["pose__age_s"].to_numpy().max() < 0.038  # the row before 2 s counts
    about = json.loads((tmp_path / "clock" / "export.json").read_text())
    assert about["clock"] == {"period_s": 0.02, "oldest_s": {"pose": 0.5, "status": 3.0}}


def test_csv_is_as_plotjuggler_takes_it(run: Run, tmp_path: Path) -> None:
    """Beside its source: it splits lines before it looks at quotes, takes the delimiter that is there most
    often in the first, and the kind of a column from its first value."""
    export(run, ExportPlan("csv", NAMES), tmp_path / "r")
    for name in NAMES:
        text = (tmp_path / "r" / f"{name}.csv").read_bytes().decode()
        head, *lines = text.replace("line\nbreak", "line break").split("\r\n")[:-1]
        columns = head.split(",")
        assert columns[0] == "t_s" and len({*columns}) == len(columns) and not re.search(r"[;\t \"]", head)
        rows = [next(csv.reader([line])) for line in lines]
        assert {len(row) for row in rows} == {len(columns)}
        assert all(float(one[0]) <= float(other[0]) for one, other in pairwise(rows))
        for column, cells in zip(columns, zip(*rows, strict=True), strict=True):
            assert not [cell for cell in cells if re.fullmatch(r"[-+.\d]+e[-+]?\d+", cell)], column


def test_parquet_is_as_plotjuggler_takes_it(run: Run, tmp_path: Path) -> None:
    """Beside its source: it takes fields for columns, so none may have fields within, and sorts no more than
    a batch by time."""
    export(run, ExportPlan("parquet", NAMES), tmp_path / "r")
    for name in NAMES:
        table = pyarrow.parquet.read_table(tmp_path / "r" / f"{name}.parquet")
        kinds = [field.type for field in table.schema]
        assert not any(pyarrow.types.is_nested(kind) or pyarrow.types.is_dictionary(kind) for kind in kinds)
        t_s = table["t_s"].to_numpy()
        assert kinds[0] == pyarrow.float64() and not table["t_s"].null_count and (np.diff(t_s) >= 0.0).all()


CHECKED = """
function s = seconds(x)
    assert(isa(x, 'double') && iscolumn(x) && all(isfinite(x)));
    s = x;
end
function t = struct2table(s)
    assert(isscalar(s) && all(structfun(@rows, s) == rows(s.t_s)) && all(structfun(@ndims, s) == 2));
    assert(all(structfun(@(x) isnumeric(x) || islogical(x), s)));
    assert(all(cellfun(@(name) length(name) <= 63, fieldnames(s))));
    t = s;
end
function t = table2timetable(t, name, times)
    assert(strcmp(name, 'RowTimes') && isequal(size(times), [rows(t.t_s) 1]));
end
"""
"""What MATLAB asks of their arguments; Octave has none of the three."""


@pytest.mark.skipif(shutil.which("octave-cli") is None, reason="no octave-cli: apt-get install octave")
def test_a_mat_file_is_a_timetable_in_one_line(run: Run, tmp_path: Path) -> None:
    export(run, ExportPlan("mat", NAMES), tmp_path / "r")
    page = (ROOT / "docs/export.md").read_text()
    matlab, octave = (
        re.findall(rf"^```{tongue}\n(.*)\n```", page, re.M)[0] for tongue in ("matlab", "octave")
    )
    script = f"1;{CHECKED}"
    for name in NAMES:
        script += matlab.replace("pose.mat", f"{name}.mat") + "\nassert(rows(T.t_s) == 300);\n"
    script += octave.partition(";")[0] + ";\nassert(isequal(size(S.tractor_yaw_rate_radps), [300 1]));\n"
    (tmp_path / "r" / "look.m").write_text(script + "printf('%d files\\n', " + f"{len(NAMES)});\n")
    words = ["octave-cli", "--no-gui", "--norc", "--quiet", "look.m"]
    ended = subprocess.run(
        words, cwd=tmp_path / "r", capture_output=True, text=True, timeout=120, check=False
    )
    assert ended.returncode == 0 and ended.stdout == f"{len(NAMES)} files\n", ended.stderr


def test_runs_of_one_name_get_folders_of_their_own(run: Run, tmp_path: Path) -> None:
    names = [path.name for path in folders_of([run, run, run], tmp_path)]
    assert names == [run.id, f"{run.id}_2", f"{run.id}_3"]
    (tmp_path / f"{run.id}_2").symlink_to("nowhere")
    with pytest.raises(ExportError, match="exists; nothing is overwritten"):
        folders_of([run, run], tmp_path)


@pytest.mark.parametrize("form", ["parquet", "csv", "mat"])
def test_a_full_disk_leaves_nothing(run: Run, tmp_path: Path, form: str) -> None:
    with file_size_limit(20_000), pytest.raises(OSError):
        export(run, ExportPlan(form, NAMES), tmp_path / "made" / "r")
    assert list(tmp_path.iterdir()) == []


def test_an_interrupt_leaves_nothing(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(*_: object) -> None:
        (part,) = tmp_path.iterdir()
        assert part.name.endswith(".part")
        raise KeyboardInterrupt

    monkeypatch.setattr(ParquetFile, "_flush", stop)
    with pytest.raises(KeyboardInterrupt):
        export(run, ExportPlan("parquet", ("pose",)), tmp_path / "r")
    assert list(tmp_path.iterdir()) == []


def test_what_would_give_nothing_is_refused_first(run: Run, tmp_path: Path) -> None:
    with pytest.raises(ExportError, match=r"lasts 11.1 s; --from 20 is behind its end"):
        check(run, ExportPlan("csv", NAMES, None, 20.0))
    with pytest.raises(ExportError, match="would give 11,063,036,778 rows; give a longer one"):
        check(run, ExportPlan("csv", ("pose",), 1))
    with pytest.raises(ExportError, match="nothing is in it there; nothing written"):
        export(run, ExportPlan("csv", ("pose",), None, 0.001, 0.002), tmp_path / "r")
    assert list(tmp_path.iterdir()) == []


def test_a_cut_log_is_exported_as_far_as_it_is_whole(run: Run, tmp_path: Path) -> None:
    content = run.sources[0].read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(content[: len(content) // 2])
    (part,) = open_runs(cut)
    check(part, ExportPlan("csv", ("pose",)))
    done = export(part, ExportPlan("csv", ("pose", "can"), None, 0.0, math.inf), tmp_path / "r")
    assert done.skipped == {"cut": 1} and 20 < done.rows["pose.csv"] < 300
    assert json.loads((tmp_path / "r" / "export.json").read_text())["skipped"] == {"cut": 1}


@pytest.mark.long
def test_the_examples_of_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    filled_log(tmp_path / "run.mcap", 300)
    monkeypatch.chdir(tmp_path)
    page = (ROOT / "docs" / "export.md").read_text()
    lines = re.findall(r"^tilth (export .*)$", page, re.M)
    assert len(lines) == 4
    for line in lines:
        assert main(shlex.split(line, comments=True)) == 0
    (angles,) = Path("angles").iterdir()
    assert {path.stem for path in angles.glob("*.mat")} == {
        "pose", "measurement_wheel_angle", "measurement_hand_wheel_angle",
    }  # fmt: skip
    (clock,) = Path("clock").iterdir()
    header = (clock / "clock.csv").read_text().partition("\n")[0]
    assert "pose__tractor_x_m" in header and "soil_tire__C_af_N_per_rad" in header
    assert len([*Path("tables").glob("*/*.csv")]) == len([*Path("parquet").glob("*/*.parquet")]) == len(NAMES)
