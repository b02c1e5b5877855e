"""A command that is called in this process: its exit status and what it says."""

from collections.abc import Callable

import pytest

from tilth.cli import main

Answer = Callable[..., tuple[int, str, str]]
"""(its words): status, stdout, stderr."""


def asked(capsys: pytest.CaptureFixture[str], command: str) -> Answer:
    def ask(*words: object) -> tuple[int, str, str]:
        try:
            status = main([command, *map(str, words)])
        except SystemExit as end:  # argparse
            status = int(str(end.code))
        captured = capsys.readouterr()
        return status, captured.out, captured.err

    return ask
