"""Logs on S3, of a server of this computer: what a season and the other commands make of them."""

import json
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from logs import some_frames, write_mcap

from tilth.analysis.season.season import TABLE
from tilth.cli import main
from tilth.replay.readers.log import ForeignLog
from tilth.replay.readers.remote import at_hand, files_at

pytestmark = pytest.mark.long
s3fs = pytest.importorskip("s3fs", reason="needs the extra s3")
moto_server = pytest.importorskip("moto.server", reason="needs moto, an S3 server")
pq = pytest.importorskip("pyarrow.parquet")


@pytest.fixture(scope="module")
def server() -> Iterator[str]:
    """Its address."""
    running = moto_server.ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    running.start()
    host, port = running.get_host_and_port()
    yield f"http://{host}:{port}"
    running.stop()


@pytest.fixture
def bucket(server: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """s3://farm: three days in folders, a file that is no log, a photo; as a file system."""
    for name, value in {
        "AWS_ENDPOINT_URL": server, "AWS_ACCESS_KEY_ID": "me", "AWS_SECRET_ACCESS_KEY": "secret",
        "AWS_DEFAULT_REGION": "us-east-1", "AWS_CONFIG_FILE": str(tmp_path / "none"),
    }.items():  # fmt: skip
        monkeypatch.setenv(name, value)
    s3fs.S3FileSystem.clear_instance_cache()
    system = s3fs.S3FileSystem()
    system.mkdir("farm")
    for k in range(3):
        log = write_mcap(tmp_path / f"day{k}.mcap", some_frames(30 + k), run=f"r{k}")
        system.put(str(log), f"farm/week/day{k}.mcap")
    system.pipe("farm/week/bad.mcap", b"none")
    system.pipe("farm/week/photo.jpg", b"none")
    yield system
    system.rm("farm", recursive=True)
    s3fs.S3FileSystem.clear_instance_cache()


def rows_of(out: Path) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = pq.read_table(out / TABLE).to_pylist()
    return rows


def test_a_season_on_s3_is_that_of_a_disk(
    bucket: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """But for the names of logs. What is done is not fetched again; what has changed is looked at anew."""
    out, here = tmp_path / "out", tmp_path / "here"
    words = ["season", "s3://farm/week", "--out", str(out), "--workers", "1"]
    assert main(words) == 0
    rows = rows_of(out)
    assert [row["log"] for row in rows] == [
        f"s3://farm/week/{n}.mcap" for n in ("day0", "day1", "day2", "bad")
    ]
    disk = [str(tmp_path / f"day{k}.mcap") for k in range(3)]
    assert main(["season", *disk, "--out", str(here), "--workers", "1"]) == 0
    of_disk = rows_of(here)
    assert [{**row, "log": ""} for row in rows[:3]] == [{**row, "log": ""} for row in of_disk]
    capsys.readouterr()
    assert main(words) == 0 and "nothing to do" in capsys.readouterr().err
    changed = write_mcap(tmp_path / "day9.mcap", some_frames(40), run="r9")
    bucket.put(str(changed), "farm/week/day0.mcap")
    assert main([*words, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["computed"] == 1


def test_an_unreadable_bucket_is_a_reason_and_the_rest_goes_on(
    bucket: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    day = str(tmp_path / "day0.mcap")
    assert main(["season", "s3://other/logs", day, "--out", str(out), "--workers", "1"]) == 0
    reasons = {row["log"]: row["reason"] for row in rows_of(out) if row["kind"] == "file"}
    assert list(reasons) == ["s3://other/logs"] and "not" in reasons["s3://other/logs"]
    capsys.readouterr()
    assert main(["season", "s3://other/logs", "--out", str(tmp_path / "none"), "--workers", "1"]) == 2
    assert "s3://other/logs: is not there" in capsys.readouterr().err


@pytest.mark.parametrize("url", ["s3://farm/nothing", "s3://", "s3://farm/week/day7.mcap", "nosuch://a/b"])
def test_what_is_not_there_is_a_sentence(bucket: Any, url: str) -> None:
    with pytest.raises(ForeignLog, match=f"^{url}: "), at_hand(url) as path:
        files_at(url)
        raise AssertionError(path)


def test_a_server_that_is_not_there_is_a_sentence(bucket: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://127.0.0.1:{free.getsockname()[1]}")
    monkeypatch.setenv("AWS_MAX_ATTEMPTS", "1")
    s3fs.S3FileSystem.clear_instance_cache()
    with pytest.raises(ForeignLog, match=r"^s3://farm: cannot be read"):
        files_at("s3://farm")


def test_other_commands_read_a_log_there(bucket: Any, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["decode", "s3://farm/week/day1.mcap"]) == 0
    assert "31 frames" in capsys.readouterr().err
    with pytest.raises(SystemExit) as ended:
        main(["decode", "s3://farm/week/day8.mcap"])
    assert ended.value.code == 2 and "s3://farm/week/day8.mcap: is not there" in capsys.readouterr().err
