"""tilth foxglove: wrong use, and the extra that it needs."""

import sys

import pytest

from tilth.cli import main
from tilth.schemas.invocation import installing

pytest.importorskip("foxglove", reason="the extra foxglove is not installed")


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("--port", "65536"), "give a number from 0 to 65535"),
        (("--host", "203.0.113.1", "--port", "0"), "give others"),
        (("--connect", "nonsense"), "one looks like"),
        (("--machine", "a/b"), "give its name in the machine file"),
    ],
)
def test_wrong_use_is_told_in_one_line(
    words: tuple[str, ...], expected: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(("foxglove", *words)) == 2
    error = capsys.readouterr().err
    assert expected in error and error.count("\n") == 1


def test_without_the_extra_it_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "foxglove", None)
    monkeypatch.delitem(sys.modules, "tilth.monitor.foxglove_server", raising=False)
    assert main(("foxglove",)) == 2
    error = capsys.readouterr().err
    assert installing("foxglove") in error and error.count("\n") == 1
