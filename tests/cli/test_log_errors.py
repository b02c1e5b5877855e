"""Errors of logs and files: one sentence, one exit status, for every command."""

import argparse
import errno
import os
import signal
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import pytest

from tilth.cli import CommandFailed, main
from tilth.cli.log_errors import log_errors
from tilth.replay.readers.log import EmptyLog, ForeignLog

CASES: list[tuple[Exception, int, str]] = [
    (EmptyLog("a.log: an empty file"), 1, "a.log: an empty file"),
    (ForeignLog("a.log: not a log"), 2, "a.log: not a log"),
    (FileNotFoundError(errno.ENOENT, "No such file or directory", "a.log"), 2, "a.log: no such file or "),
    (OSError(errno.EIO, "Input/output error", "a.log"), 1, "a.log: input/output error; nothing was written"),
    (OSError(errno.ENOSPC, "No space left on device"), 1, "out: no space left on device; nothing was"),
]


@pytest.mark.parametrize(("error", "status", "words"), CASES, ids=lambda value: type(value).__name__)
def test_an_error_is_a_sentence_and_a_status(error: Exception, status: int, words: str) -> None:
    with pytest.raises(CommandFailed) as failed, log_errors("out", "nothing was written"):
        raise error
    assert failed.value.status == status and words in str(failed.value)


@pytest.mark.parametrize("kind", [PermissionError, BrokenPipeError, KeyboardInterrupt, ValueError])
def test_what_is_said_elsewhere_passes(kind: type[BaseException]) -> None:
    with pytest.raises(kind), log_errors():
        raise kind


def _killed(args: argparse.Namespace) -> int:
    """As the kernel ends a process where memory runs out."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        pool.submit(signal.raise_signal, signal.SIGKILL).result()
    return 0


def test_a_process_that_the_kernel_ends_is_a_sentence(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("tilth.cli.logs.run", _killed)
    assert main(["logs", os.devnull]) == 1
    assert "was killed, most likely since memory ran out; give fewer logs" in capsys.readouterr().err
