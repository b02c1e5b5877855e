"""A child process: what it is told, what it answers, and how it ends.

All that works beside the recorder or beside a screen is one: fits, compiling, reports, estimates of a live
calibration, the virtual tractors of the demos. Lines go in by stdin and come out by stdout; what it says on
stderr is kept for the sentence about its end. Nothing here waits in a thread of its own: whoever wants an
answer takes turns.
"""

import json
import math
import os
import re
import selectors
import signal
import subprocess
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from typing import IO, Any, Final

from tilth.logger.priority import stand_behind

LARGEST: Final = 16_000_000  # bytes of a line, or of a whole answer
TAIL: Final = 8192  # bytes of stderr that are kept
ENDING_S: Final = 10.0  # how long one that was asked to end may take
TICK_S: Final = 0.1  # how often it is looked whether one has ended whose pipes others hold open
MOMENT_S: Final = 0.01  # the same, of one that is about to end
CHUNK: Final = 65536  # bytes, of a pipe
STOPPED: Final = "it was stopped"
NO_ANSWER: Final = "it ended without an answer"
OUT_OF_MEMORY: Final = "it was killed, most likely since this computer has too little memory for it"
_CRASHES: Final = {signal.SIGSEGV, signal.SIGBUS, signal.SIGABRT, signal.SIGFPE, signal.SIGILL}
_OWN_NAME: Final = re.compile(r"^tilth [a-z]+: ")


class JobEnded(Exception):
    """There is no answer, nor will there be one; a sentence says why."""


class Job:
    """Begins at once. Only `kill` may be called from a thread other than the one that made it.

    It has a process group of its own: Ctrl-C in the terminal is not for it, and what it has started ends with
    it. The words of logger/child.py make it end with this process, and with the thread that made it.
    """

    def __init__(
        self,
        words: Sequence[str],
        lines: Sequence[bytes] | None = None,
        *,
        niceness: int | None = None,
        environment: Mapping[str, str] | None = None,
        longest_s: float = math.inf,
        aloud: bool = False,
    ) -> None:
        """Raises JobEnded where it cannot be started.

        lines: what it is told first; None: it is never told anything. niceness: as in logger/priority.py.
        environment: in addition to this process's. longest_s: then it is killed, at the next turn. aloud:
        what it says on stderr is not kept but goes where that of this process goes.
        """
        told = subprocess.DEVNULL if lines is None else subprocess.PIPE
        said = None if aloud else subprocess.PIPE
        try:
            self._process = subprocess.Popen(
                words, bufsize=0, stdin=told, stdout=subprocess.PIPE, stderr=said, process_group=0,
                env={**os.environ, **(environment or {})},
            )  # fmt: skip
        except OSError as error:
            reason = (error.strerror or str(error)).lower()
            raise JobEnded(f"{error.filename or words[0]}: {reason}") from None
        self.pid = self._process.pid
        self.not_behind = "" if niceness is None else stand_behind(niceness, self.pid)  # why not
        self.stopped = ""  # why it was ended from here
        self._until_s = time.monotonic() + longest_s
        self._longest_s = longest_s
        self._untold, self._heard, self._said = bytearray(), bytearray(), bytearray()
        self._silent = False  # nothing more can be heard
        self._lock = threading.RLock()
        self._streams = selectors.DefaultSelector()
        for stream, take in ((self._process.stdout, self._hear), (self._process.stderr, self._heed)):
            if stream is not None:
                os.set_blocking(stream.fileno(), False)
                self._streams.register(stream, selectors.EVENT_READ, take)
        if self._process.stdin is not None:
            os.set_blocking(self._process.stdin.fileno(), False)
        for line in lines or ():
            self.send(line)

    def send(self, line: bytes) -> None:
        """Tell it a line. What its pipe cannot hold is told by and by, while an answer is waited for."""
        stdin = self._process.stdin
        if stdin is None or stdin.closed:  # it has ended, which its answer tells
            return
        if not self._untold:
            self._streams.register(stdin, selectors.EVENT_WRITE, self._tell)
        self._untold += line + b"\n"
        self._turn(0.0)

    def next(self, wait_s: float = math.inf) -> bytes | None:
        """The next line that it says; None if there is none in time. Raises JobEnded."""
        until_s = time.monotonic() + wait_s
        self._turn(0.0)
        while (end := self._heard.find(b"\n")) < 0:
            if self._silent:
                raise JobEnded(self.end() or NO_ANSWER)
            left_s = until_s - time.monotonic()
            if left_s <= 0.0:
                return None
            self._turn(left_s)
        line = bytes(self._heard[:end])
        del self._heard[: end + 1]
        return line

    def lines(self) -> Iterator[bytes]:
        """All that it says until its end, waited for. Raises JobEnded where it has failed."""
        while True:
            try:
                line = self.next()
            except JobEnded:
                break
            assert line is not None
            yield line
        if why := self.end():
            raise JobEnded(why)

    def json(self) -> Any:
        """What it prints in all, waited for. Raises JobEnded where that is no JSON."""
        why = self.end()
        try:
            return json.loads(self._heard)
        except ValueError:
            raise JobEnded(why or NO_ANSWER) from None

    @property
    def alive(self) -> bool:
        """Whether it goes on. What it says meanwhile is taken, so that it never waits for a reader."""
        self._turn(0.0)
        return not self._exited()

    def end(self) -> str:
        """Tell it no more and wait for its end: what has gone wrong, "" if nothing."""
        while not self._silent:
            if not self._untold:
                self._tell_no_more()
            self._turn(math.inf)
        if not self._exits_within(ENDING_S):
            self.kill("it said nothing more and did not end")
            self._exits_within(math.inf)
        self._turn(0.0)  # its last words on stderr, no more than a pipe holds
        return self.stopped or _words(self._process.returncode, self._said.decode(errors="replace"))

    def kill(self, why: str = STOPPED) -> None:
        """End it at once, with all that it has started; from any thread. why: what `end` says then."""
        self._signal(signal.SIGKILL, why)

    def close(self) -> None:
        """It may end in its own way, but soon. Nothing of it is left."""
        if self._streams.get_map() is None:  # closed before
            return
        self._tell_no_more()
        self._signal(signal.SIGTERM, STOPPED)
        if not self._exits_within(ENDING_S):
            self.kill()
            self._exits_within(math.inf)
        self._streams.close()
        for stream in (self._process.stdout, self._process.stderr):
            if stream is not None:
                stream.close()

    def _turn(self, wait_s: float) -> None:
        """Tell and hear what can be told and heard; waits a moment at most."""
        if time.monotonic() > self._until_s:
            self.kill(f"it was not ready within {_span(self._longest_s)}")
        ready = self._streams.select(min(wait_s, TICK_S))
        for key, _ in ready:
            key.data(key.fileobj)
        self._silent = self._silent or (not ready and self._exited())

    def _tell(self, stdin: IO[bytes]) -> None:
        try:
            told = stdin.write(self._untold) or 0
        except BrokenPipeError:
            self._tell_no_more()
            return
        del self._untold[:told]
        if not self._untold:
            self._streams.unregister(stdin)

    def _tell_no_more(self) -> None:
        stdin = self._process.stdin
        if stdin is None or stdin.closed:
            return
        if self._untold:
            self._streams.unregister(stdin)
            self._untold.clear()
        stdin.close()

    def _hear(self, stdout: IO[bytes]) -> None:
        self._silent = self._take(stdout, self._heard)
        if len(self._heard) > LARGEST:
            self.kill(f"it said more than {LARGEST * 1e-6:.0f} MB")

    def _heed(self, stderr: IO[bytes]) -> None:
        self._take(stderr, self._said)
        del self._said[:-TAIL]

    def _take(self, stream: IO[bytes], into: bytearray) -> bool:
        """Whether it has come to its end."""
        some = stream.read(CHUNK)
        into += some or b""
        if some == b"":
            self._streams.unregister(stream)
        return some == b""

    def _exits_within(self, seconds: float) -> bool:
        until_s = time.monotonic() + seconds
        while not self._exited():
            if time.monotonic() > until_s:
                return False
            self._turn(MOMENT_S)
        return True

    def _exited(self) -> bool:
        with self._lock:
            before = self._process.returncode
            if before is None and self._process.poll() is not None:
                self._signal_group(signal.SIGKILL)  # what it has left behind
            return self._process.returncode is not None

    def _signal(self, number: signal.Signals, why: str) -> None:
        with self._lock:  # once its end has been taken, its id is that of another process
            if not self._exited():
                self.stopped = self.stopped or why
                self._signal_group(number)

    def _signal_group(self, number: signal.Signals) -> None:
        with suppress(ProcessLookupError, PermissionError):  # none is left; on macOS it says so of zombies
            os.killpg(self.pid, number)


def _span(seconds: float) -> str:
    return f"{seconds:g} s" if seconds < 120.0 else f"{seconds / 60.0:.0f} minutes"


def _words(status: int, said: str) -> str:
    """What has ended a process with this exit status and these last words on stderr; "" where it has done
    its work."""
    by = status - 128 if status > 128 else -status  # of who was started by a shell, or by itself
    if by == signal.SIGKILL:
        return OUT_OF_MEMORY
    if by in _CRASHES:
        return f"it crashed ({signal.Signals(by).name})"
    if by > 0 and by in set(signal.Signals):
        return f"it was ended by {signal.Signals(by).name}"
    if not status:
        return ""
    lines = [line for line in said.splitlines() if line.strip()]
    return _OWN_NAME.sub("", lines[-1])[:500] if lines else f"it ended with status {status}"
