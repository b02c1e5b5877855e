"""What readers of each format find: the values, what is absent, units, where it comes from."""

import csv
import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import duckdb
import numpy as np
import pandas
import polars
import pyarrow.parquet
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.io import loadmat

from tilth.analysis.export import files
from tilth.analysis.export.columns import (
    DATA,
    DOUBLE,
    INSTANT,
    TEXT,
    TRUTH,
    WHOLE,
    ExportColumn,
    ExportRows,
    instants,
)
from tilth.analysis.export.files import FORMATS, CsvFile, ExportError, MatFile, ParquetFile, check_installed

COLUMNS = (
    ExportColumn("t_s", DOUBLE, "s", meaning="since the run began"),
    ExportColumn("utc", INSTANT),
    ExportColumn("x_m", DOUBLE, "m", "W"),
    ExportColumn("rank", WHOLE),
    ExportColumn("sid", WHOLE, optional=True),
    ExportColumn("ready", TRUTH),
    ExportColumn("text", TEXT),
    ExportColumn("data", DATA),
)
TEXTS = ("", "wet", 'said "so", twice', "line\r\nbreak", "grün")
FACTS = {
    "run": "r",
    "machine": {"toml": "title = 'ü'\n"},
    "sources": [{"file": "a", "sha256": "0f"}],
    "utc": None,
}


def _rows(first: int, n: int) -> ExportRows:
    k = np.arange(first, first + n)
    length = k % 9
    data = np.where(np.arange(8) < length[:, None], (k[:, None] + np.arange(8)) % 256, 0).astype(np.uint8)
    return ExportRows(
        COLUMNS,
        (
            k / 10, instants(np.where(k % 4 == 1, np.nan, 1_700_000_000 + k / 10)),
            np.where(k % 3 == 0, np.nan, k * 0.1 + 1e-9), k.astype(np.int64), k.astype(np.int64),
            k % 2 == 0, np.array([TEXTS[i % 5] for i in k], object), data,
        ),
        (None, None, None, None, k % 3 == 1, None, None, np.arange(8) >= length[:, None]),
    )  # fmt: skip


def _written(folder: Path, form: str) -> Path:
    path = folder / f"table.{form}"
    file = FORMATS[form](path, COLUMNS, FACTS)
    for first in range(0, 60, 20):
        file.write(_rows(first, 20))
    file.close()
    return path


def _wanted() -> list[dict[str, Any]]:
    return [
        {
            "t_s": k / 10,
            "utc": None if k % 4 == 1 else pandas.Timestamp(1_700_000_000_000 + k * 100, unit="ms", tz="UTC"),
            "x_m": None if k % 3 == 0 else k * 0.1 + 1e-9,
            "rank": k,
            "sid": None if k % 3 == 1 else k,
            "ready": k % 2 == 0,
            "text": TEXTS[k % 5],
            "data": bytes((k + i) % 256 for i in range(k % 9)),
        }
        for k in range(60)
    ]


def test_parquet_in_polars_pandas_and_duckdb(tmp_path: Path) -> None:
    path = _written(tmp_path, "parquet")
    assert polars.read_parquet(path).to_dicts() == _wanted()
    frame = pandas.read_parquet(path)
    assert list(frame.columns) == [column.name for column in COLUMNS]
    for name in frame.columns:
        values = [None if value is pandas.NaT or value != value else value for value in frame[name]]
        assert values == [row[name] for row in _wanted()], name
    query = "select sum(x_m), count(sid), max(octet_length(data)), min(epoch_ms(utc)) from read_parquet(?)"
    total, sids, longest, first_ms = duckdb.execute(query, [str(path)]).fetchall()[0]
    assert total == pytest.approx(sum(row["x_m"] or 0 for row in _wanted()))  # absent is null, not NaN
    assert (sids, longest, first_ms) == (40, 8, 1_700_000_000_000)


def test_parquet_says_units_and_where_it_comes_from(tmp_path: Path) -> None:
    schema = pyarrow.parquet.read_schema(_written(tmp_path, "parquet"))
    assert json.loads(schema.metadata[b"tilth"]) == FACTS
    assert schema.field("x_m").metadata == {b"unit": b"m", b"frame": b"W"}
    assert schema.field("t_s").metadata == {b"unit": b"s", b"meaning": b"since the run began"}
    assert schema.field("rank").metadata is None


def test_parquet_is_written_as_it_comes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "ROW_GROUP_BYTES", 1)
    monkeypatch.setattr(files, "COLUMN_BYTES", 1)
    path = tmp_path / "a.parquet"
    file = ParquetFile(path, COLUMNS, FACTS)
    sizes = []
    for first in range(0, 60, 20):
        file.write(_rows(first, 20))
        sizes.append(path.stat().st_size)
    file.close()
    assert pyarrow.parquet.ParquetFile(path).num_row_groups == 3 and sizes == sorted(set(sizes))


def test_csv_is_that_of_rfc_4180(tmp_path: Path) -> None:
    path = _written(tmp_path, "csv")
    assert path.read_bytes().startswith(
        b"t_s,utc,x_m,rank,sid,ready,text,data\r\n0.0,2023-11-14T22:13:20.000000Z,,"
    )
    with path.open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream, strict=True))
    for row, wanted in zip(rows, _wanted(), strict=True):
        assert float(row["t_s"]) == wanted["t_s"] and row["rank"] == str(wanted["rank"])
        assert (float(row["x_m"]) if row["x_m"] else None) == wanted["x_m"]
        assert (int(row["sid"]) if row["sid"] else None) == wanted["sid"]
        assert row["ready"] == str(wanted["ready"]).lower() and row["text"] == wanted["text"]
        assert bytes.fromhex(row["data"]) == wanted["data"]
        assert (pandas.Timestamp(row["utc"]) if row["utc"] else None) == wanted["utc"]


@settings(max_examples=60)
@example(
    texts=[
        "=cmd|' /C calc'!A0",
        "+1",
        "-1",
        "@SUM(1)",
        "\t=1",
        "\r=1",
        "\n=1",
        "＝1",
        "'quoted",
        "''",
        "",
        "a=b",
    ]
)
@given(texts=st.lists(st.text(max_size=12), min_size=1, max_size=8))
def test_no_text_in_csv_is_a_formula_and_each_can_be_read_back(
    texts: list[str], tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.mktemp("csv") / "a.csv"
    columns = (ExportColumn("x_m", DOUBLE, "m"), ExportColumn("text", TEXT))
    x = -1.5 - np.arange(len(texts))
    file = CsvFile(path, columns, FACTS)
    file.write(ExportRows(columns, (x, np.array(texts, object)), (None, None)))
    file.close()
    with path.open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream, strict=True))
    assert [float(row["x_m"]) for row in rows] == x.tolist()
    assert not any(row["text"].startswith(tuple("=+-@＝＋－＠\t\r\n")) for row in rows)
    assert [row["text"].removeprefix("'") for row in rows] == texts


@given(values=st.lists(st.floats(allow_nan=False), min_size=1, max_size=20))
def test_numbers_in_csv_are_the_same_and_have_no_exponent(
    values: list[float], tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.mktemp("csv") / "a.csv"
    columns = (ExportColumn("x", DOUBLE),)
    file = CsvFile(path, columns, FACTS)
    file.write(ExportRows(columns, (np.array(values),), (None,)))
    file.close()
    _, *cells = path.read_text(encoding="utf-8").split()
    assert [float(cell) for cell in cells] == values
    assert not any("e" in cell for cell in cells)


def test_mat_in_scipy(tmp_path: Path) -> None:
    found = loadmat(_written(tmp_path, "mat"), simplify_cells=True)
    wanted = _wanted()
    for name in ("t_s", "x_m", "sid"):
        got = [row[name] if row[name] is not None else np.nan for row in wanted]
        np.testing.assert_array_equal(found[name], np.array(got, float), err_msg=name)
    assert found["rank"].dtype == np.int64 and found["rank"].tolist() == list(range(60))
    cells = ["", *found["texts"]["text"]]
    assert [cells[code] for code in found["text"]] == [row["text"] for row in wanted]
    for row, data in zip(wanted, found["data"], strict=True):
        assert data.tobytes().startswith(row["data"]) and not any(data[len(row["data"]) :])
    assert found["units"]["x_m"] == "m" and found["meta"]["machine"]["toml"] == "title = 'ü'\n"
    assert json.loads(found["meta"]["json"]) == FACTS and "utc" not in found


OCTAVE = """
load('table.mat');
assert(isequal(size(t_s), [60 1]));
assert(abs(t_s(11) - 1.0) < 1e-12 && isnan(x_m(1)) && abs(x_m(2) - 0.100000001) < 1e-15);
assert(isa(rank, 'int64') && rank(60) == 59 && isnan(sid(2)) && sid(3) == 2);
assert(strcmp(texts.text{text(2)}, 'wet') && text(1) == 0);
assert(isequal(double(data(3, 1:2)), [2 3]) && strcmp(units.x_m, 'm'));
assert(strcmp(meta.sources{1}.sha256, '0f') && ! isempty(strfind(meta.machine.toml, 'title')));
printf('all as written\\n');
"""


def test_mat_in_octave(tmp_path: Path) -> None:
    octave = shutil.which("octave-cli")
    if octave is None:
        pytest.skip("no octave-cli: apt-get install octave")
    _written(tmp_path, "mat")
    (tmp_path / "look.m").write_text(OCTAVE)
    words = [octave, "--no-gui", "--norc", "--quiet", "look.m"]
    ended = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False)
    assert ended.returncode == 0 and ended.stdout == "all as written\n", ended.stderr


def test_a_variable_too_large_for_mat_is_refused_before_anything_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(files, "MAT_BYTES", 30 * 8)
    file = MatFile(tmp_path / "a.mat", COLUMNS, FACTS)
    file.write(_rows(0, 20))
    with pytest.raises(
        ExportError, match=r"a.mat: t_s .* 40 rows .* --channels, --from and --until, or use --to parq"
    ):
        file.write(_rows(20, 20))
    file.abandon()
    assert list(tmp_path.iterdir()) == []


def test_without_pyarrow_it_says_what_installs_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(
        ExportError, match=r"one package more: (pip install 'tilth\[parquet\]'|uv sync .*parquet)"
    ):
        check_installed("parquet")
    check_installed("csv")


def test_a_csv_that_is_given_up_is_closed(tmp_path: Path) -> None:
    file = CsvFile(tmp_path / "a.csv", COLUMNS, FACTS)
    file.write(_rows(0, 3))
    file.abandon()
    with pytest.raises(ValueError, match="closed"):
        file.write(_rows(0, 3))
