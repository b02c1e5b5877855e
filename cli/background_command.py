"""A `tilth` command in a process of its own, beside a command that a person looks at."""

import os
import signal
import subprocess
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from typing import Final

LONGEST: Final = 4_000_000  # bytes of an answer
ENDING_S: Final = 10.0


class BackgroundCommand:
    """Begins at once. What it prints is kept in files, so it never waits for a reader."""

    def __init__(self, words: Sequence[str]) -> None:
        self._out, self._said = tempfile.TemporaryFile(), tempfile.TemporaryFile()  # noqa: SIM115
        self._process = subprocess.Popen(
            words, stdin=subprocess.DEVNULL, stdout=self._out, stderr=self._said, start_new_session=True
        )

    @property
    def over(self) -> bool:
        return self._process.poll() is not None

    def printed(self) -> tuple[str, list[str]]:
        """(its answer, lines that it said on stderr)."""
        for file in (self._out, self._said):
            file.seek(0)
        answer, said = (file.read(LONGEST).decode(errors="replace") for file in (self._out, self._said))
        return answer, [line for line in said.splitlines() if line.strip()]

    def close(self) -> None:
        """Ends it, and what it has started."""
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGTERM)
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(ENDING_S)
        self._out.close()
        self._said.close()
