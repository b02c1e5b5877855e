"""`tilth export`: what it says and its exit status; wrong input is one sentence and leaves nothing."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from filled_log import filled_log
from logs import MACHINE_FILE, messages, some_frames, write_mcap, write_with_can
from one_recording import file_size_limit
from sampled import sampled
from small_disk import TILTH, on_a_small_disk

from tilth.cli import main

WITHOUT_PRIVILEGE = ["setpriv", "--bounding-set=-dac_override,-dac_read_search"]  # even root
RUN = "rig_20231114T221320Z"
CSV = ["export", "LOG", "--to", "csv", "--out", "OUT"]
ROWS: list[tuple[list[str], int, str]] = [
    (["export", "LOG", "--to", "xls", "--out", "OUT"], 2, "choose from 'parquet', 'csv', 'mat'"),
    (["export", "LOG", "--to", "csv"], 2, "required: --out"),
    ([*CSV, "--channels", "pose,posse"], 2, "--channels posse: no such channel; pose?"),
    ([*CSV, "--channels", "can", "--clock", "1s"], 2, "can has no values that hold for a while"),
    ([*CSV, "--clock", "20"], 2, "--clock: 20: give a time with its unit, such as 20ms or 1s"),
    ([*CSV, "--clock", "0ms"], 2, "0ms: give a time with its unit"),
    ([*CSV, "--from", "3", "--until", "2"], 2, "--from 3 is not before --until 2"),
    ([*CSV, "--from", "-1"], 2, "-1: give seconds since the run began, from 0 up"),
    ([*CSV, "--until", "nan"], 2, "nan: give seconds since the run began"),
    ([*CSV, "--from", "99"], 2, f"{RUN} lasts 1.4 s; --from 99 is behind its end"),
    ([*CSV, "--from", "0.001", "--until", "0.002"], 2, "nothing is in it there; nothing written"),
    (["export", "LOG", "--to", "csv", "--out", "FILE"], 2, "--out file: no folder; give one, or a new name"),
    (["export", "LOG", "--to", "csv", "--out", "FILE/x"], 2, "can be made in it (not a dir"),
    (["export", "LOG", "--to", "csv", "--out", "/proc"], 2, "no folder can be made in it"),
    (["export", "LOG", "--to", "csv", "--out", "THERE"], 2, f"there/{RUN}: exists; nothing is"),
    (["export", "none", "--to", "csv", "--out", "OUT"], 2, "none: cannot be read (no such file or dir"),
    (["export", "FILE", "--to", "csv", "--out", "OUT"], 2, "file: not a log of CAN frames that"),
    (["export", "EMPTY", "--to", "csv", "--out", "OUT"], 1, "empty: an empty file; no frame is in it"),
    (["export", "CANDUMP", "--to", "csv", "--out", "OUT"], 2, "no machine file is in this log; give --mach"),
    ([*CSV, "--machine", "none.toml"], 2, "none.toml: the machine file cannot be read"),
    ([*CSV, "--bus", "x=y"], 2, "--bus x=y: write LOG=MACHINE; the machine file has can0"),
]  # fmt: skip


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path.parent / "cache"))
    filled_log(tmp_path / "log.mcap")
    (tmp_path / "file").write_text("of another program\n")
    (tmp_path / "empty").touch()
    (tmp_path / "there" / RUN).mkdir(parents=True)
    write_with_can(tmp_path / "candump.log", messages(50))
    return tmp_path


@pytest.mark.parametrize(
    ("words", "status", "said"), ROWS, ids=lambda v: " ".join(v) if isinstance(v, list) else ""
)
def test_one_sentence_and_nothing_left(
    folder: Path, words: list[str], status: int, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    before = {*folder.rglob("*")}
    places = {"LOG": "log.mcap", "CANDUMP": "candump.log", "OUT": "out", "FILE": "file", "EMPTY": "empty"}
    places |= {"THERE": "there", "FILE/x": "file/x"}
    try:
        ended: object = main([places.get(word, word) for word in words])
    except SystemExit as end:  # argparse
        ended = end.code
    out, err = capsys.readouterr()
    assert ended == status and out == "" and said in err.splitlines()[-1], err
    assert {*folder.rglob("*")} == before


@pytest.mark.parametrize("form", sampled(("parquet", "csv", "mat"), ("csv",)))
def test_a_real_full_disk(folder: Path, tmp_path_factory: pytest.TempPathFactory, form: str) -> None:
    disk = tmp_path_factory.mktemp("disk")
    words: list[str | Path] = ["export", folder / "log.mcap", "--to", form, "--out", disk / "out"]
    made = on_a_small_disk(disk, "16k", *TILTH, *words)
    assert made.status == 1 and "no space left on device; nothing is left of it" in made.err, made
    assert made.left == [] and "Traceback" not in made.err


def test_a_file_that_may_not_grow_is_a_sentence(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with file_size_limit(5_000):
        assert main(["export", "log.mcap", "--to", "csv", "--out", "out"]) == 1
    assert "file too large; nothing is left of it" in capsys.readouterr().err and not Path("out").exists()


def test_a_folder_of_somebody_else(folder: Path) -> None:
    closed = folder / "closed"
    closed.mkdir(mode=0o555)
    begin = [*WITHOUT_PRIVILEGE, "--inh-caps=-dac_override,-dac_read_search"] if os.geteuid() == 0 else []
    if begin:
        os.chown(closed, 65534, 65534)
    start = "import sys; from tilth.cli import main; sys.exit(main(sys.argv[1:]))"
    words = [*begin, sys.executable, "-c", start, "export", "log.mcap", "--to", "csv", "--out", str(closed)]
    ended = subprocess.run(words, capture_output=True, text=True, timeout=120, check=False)
    assert ended.returncode == 2 and "you may not; ask for access" in ended.stderr, ended.stderr


def test_parts_become_one_run_and_runs_have_folders(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    filled_log(folder / "part2.mcap", seed=4, part=2)
    filled_log(folder / "other.mcap", seed=5, run="other")
    logs = ["part2.mcap", "other.mcap", "log.mcap"]
    assert main(["export", *logs, "--to", "csv", "--out", "out", "--channels", "pose,can", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)["runs"]
    assert [(run["folder"], run["rows"]["pose.csv"]) for run in said] == [
        (f"out/{RUN}", 80),
        ("out/other", 40),
    ]
    t_s = [float(line.split(",")[0]) for line in Path(f"out/{RUN}/can.csv").read_text().splitlines()[1:]]
    assert len(t_s) == 80 and t_s == sorted(t_s)
    assert main(["export", "other.mcap", "--to", "csv", "--out", "again", "--channels", "pose"]) == 0
    assert capsys.readouterr().out == "again/other: pose.csv (40 rows)\n"


def test_a_cut_log_is_said_and_exported(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content = Path("log.mcap").read_bytes()
    Path("cut.mcap").write_bytes(content[: len(content) * 2 // 3])
    assert main(["export", "cut.mcap", "--to", "csv", "--out", "out", "--channels", "pose"]) == 1
    out, err = capsys.readouterr()
    assert err == f"tilth export: {RUN}: 1 file cut off; the rest is exported\n" and "pose.csv" in out


def test_a_log_of_another_program_is_replayed_first(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--machine", str(MACHINE_FILE), "--bus", "can1=can0", "--to", "csv", "--out", "out"]
    assert main(["export", "candump.log", *words]) == 0
    assert capsys.readouterr().out.startswith("out/candump: ") and Path("out/candump/can.csv").exists()


def test_what_a_log_lacks_is_told_with_what_there_is(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_mcap(folder / "frames.mcap", some_frames(300))
    assert main(["export", "frames.mcap", "--to", "csv", "--out", "out", "--channels", "pose"]) == 2
    assert "frames: pose: not in it; there are can\n" in capsys.readouterr().err
