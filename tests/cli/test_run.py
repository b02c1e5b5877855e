"""tilth run: wrong use."""

from pathlib import Path

import pytest
from loopback import (
    machine_text,
)

from tilth.cli import main

VIRTUAL = '[[bus]]\nname = "can0"\ninterface = "virtual"\nchannel = "tilth-daemon"\n\n'
COMMAND = """
import sys
sys.modules["asammdf"] = None  # two seconds of import for reading files
from tilth.cli import main
raise SystemExit(main())
"""


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (None, ["cannot be read", "no such file"]),
        ("[machine\n", ["not a TOML file"]),
        (VIRTUAL.replace("virtual", "virtul"), ['bus can0: interface = "virtul"', 'did you mean "virtual"?']),
        (VIRTUAL.replace("channel", "chanel"), ["chanel", "channel"]),
    ],
)
@pytest.mark.parametrize("command", ["run", "check"])
def test_a_wrong_machine_file_is_one_sentence_and_exit_status_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str, text: str | None, words: list[str]
) -> None:
    file = tmp_path / "m.toml"
    if text is not None:
        file.write_text(machine_text(tmp_path / "logs", text) if text.startswith("[[bus]]") else text)
    assert main([command, str(file)]) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and all(word in err for word in words)
    assert not (tmp_path / "logs").exists()


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ([], "COMMAND"),
        (["rum"], "run"),
        (["run"], "MACHINE.toml"),
        (["run", "--sec", "x"], ""),
        *(
            ([command, "m.toml", "--seconds", n], "above zero")
            for command in ("run", "check")
            for n in ("nan", "-1")
        ),
    ],
)
def test_wrong_use_is_one_line(words: list[str], expected: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(words)
    out, err = capsys.readouterr()
    assert end.value.code == 2 and out == "" and err.count("\n") == 1 and expected in err and "--help" in err
