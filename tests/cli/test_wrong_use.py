"""Wrong use of the commands: one line that says what to do, exit status 2, and nothing begun."""

import os
import shutil
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest
from logs import MACHINE_FILE, some_frames, write_mcap
from loopback import PATIENCE_S

from tilth.cli import COMMANDS, RECORDERS, main
from tilth.schemas.invocation import command

NOWHERE = "tcp/127.0.0.1:1"
ROWS: list[tuple[list[str], str]] = [
    ([], "required: COMMAND; see "),
    (["frob"], "there is no command frob. "),
    (["run", "MACHINE", "--seconds", "x"], "--seconds: x: give a number above zero"),
    (["run", "MACHINE", "--seconds", "nan"], "--seconds: nan: give a number above zero"),
    (["run", "FOLDER"], "a folder; give the path of the machine file"),
    (["run", "FOREIGN"], "not a TOML file"),
    (["run", "OTHER"], "title: no such key. Allowed here: machine, implements, tractor"),
    (["demo", "--host", "nonsense"], "demo: --host nonsense: name or service not known; give an address of"),
    (["demo", "--guidance", "--host", "203.0.113.1"], "give an address of this computer, or 0.0.0.0"),
    (["demo", "--log", "foreign.bin"], "foreign.bin: there is no such folder; make it"),
    (["demo", "--fast", "--guidance", "--log", "foreign.bin"], "foreign.bin: there is no such folder"),
    (["check", "none.toml"], "none.toml: the machine file cannot be read"),
    (["logs", "none"], "none: no such folder; name the one that the logs are in"),
    (["logs", "FOLDER", "--keep", "x"], "no run is in it; name the folder that the logs are in"),
    (["offload", "FOLDER", "--log", "none"], "none: no such folder; name the one"),
    (["offload", "none"], "none: no such folder; mount the stick"),
    (["verify", "none.mcap"], "none.mcap: no such file or directory; give the files of a run"),
    (["mark", "x", "--endpoint", NOWHERE], f"reached at {NOWHERE}; is `"),
    (["accept", "--endpoint", NOWHERE], f"reached at {NOWHERE}; is `"),
    (["mark", "x", "--endpoint", "rubbish"], "tilth run` running? An endpoint looks like"),
    (["monitor", "--port", "0", "--connect", "rubbish"], "rubbish: not an endpoint; one looks like tcp/"),
    (["monitor", "--port", "0", "--config", "FOREIGN"], "give a Zenoh configuration, or a key of"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("words", "expected"), ROWS, ids=lambda v: " ".join(v) if isinstance(v, list) else ""
)
def test_one_line_says_what_to_do(
    words: list[str],
    expected: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder").mkdir()
    (tmp_path / "foreign.bin").write_bytes(b"not a log, not a machine\n")
    (tmp_path / "other.toml").write_text('title = "of another program"\n')
    places = {
        "MACHINE": str(MACHINE_FILE),
        "FOLDER": "folder",
        "FOREIGN": "foreign.bin",
        "OTHER": "other.toml",
    }
    try:
        status: object = main([places.get(word, word) for word in words])
    except SystemExit as end:  # argparse
        status = end.code
    out, err = capsys.readouterr()
    assert status == 2 and out == ""
    assert expected in err and err.startswith("tilth") and err.count("\n") == 1
    assert {path.name for path in tmp_path.iterdir()} == {"folder", "foreign.bin", "other.toml"}


@pytest.mark.parametrize("name", [name for name, _ in COMMANDS])
def test_every_command_explains_itself(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main([name, "--help"])
    out, err = capsys.readouterr()
    assert end.value.code == 0 and err == "" and out.startswith(f"usage: {command(name)}")


def test_commands_start_without_what_few_of_them_need() -> None:
    """Each would take a third of a second or more before the first word."""
    names = [name for name, _ in COMMANDS]
    code = "import importlib, sys\n"
    code += f"for name in {RECORDERS}: importlib.import_module(f'tilth.cli.{{name}}')\n"
    code += "assert 'tilth.estimator.fold' not in sys.modules\n"
    code += f"for name in {names}: importlib.import_module(f'tilth.cli.{{name}}')\n"
    slow = {"asammdf", "llvmlite", "matplotlib", "numba", "pandas", "polars", "scipy.optimize", "scipy.stats"}
    code += f"print({slow | {'can', 'sympy'}} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"


WITHOUT_PRIVILEGE = ["setpriv", "--bounding-set=-dac_override,-dac_read_search"]  # even root


def test_logs_of_somebody_else_are_no_traceback(tmp_path: Path) -> None:
    begin = [*WITHOUT_PRIVILEGE, "--inh-caps=-dac_override,-dac_read_search"] if os.geteuid() == 0 else []
    if begin and shutil.which("setpriv") is None:
        pytest.skip("root may read everything, and there is no setpriv here")
    start = "import sys; from tilth.cli import main; "
    start += "sys.exit([main(['logs', folder]) for folder in sys.argv[1:]] != [0, 2])"
    run = write_mcap(tmp_path / "rig_20261121T080000Z_001.mcap", some_frames(10))
    sibling = run.with_name("rig_20261121T080000Z.json")
    closed = tmp_path / "closed"
    closed.mkdir()
    for path in (sibling, closed):
        path.touch()
        path.chmod(0)
        if begin:
            os.chown(path, 65534, 65534)
    words = [*begin, sys.executable, "-c", start, str(tmp_path), str(closed)]
    ended = subprocess.run(words, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    closed.chmod(0o700)
    assert ended.returncode == 0, ended.stderr
    assert [line.partition(",")[0] for line in ended.stderr.splitlines()] == [
        f"tilth logs: {closed}: you may not; ask for access"
    ]
    assert run.stem[:-4] in ended.stdout and "ermission denied" in ended.stdout  # it hides no run


def test_it_says_its_version(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["--version"])
    assert end.value.code == 0 and capsys.readouterr().out == f"tilth {version('tilth')}\n"


@pytest.mark.parametrize(
    ("word", "says"),
    [("chek", "did you mean check?"), ("Replay", "did you mean replay?"), ("zzz", "no command zzz. ")],
)
def test_a_slip_is_told_what_was_meant(word: str, says: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left:
        main([word])
    assert left.value.code == 2 and says in capsys.readouterr().err
