"""Plays the results of a recorded run in their order, as fast as is asked for. It reads files, but no clock.

Times `now_s` are of any clock that does not step, and are given with each call. `at_ns` is the place in the
run, as in recorded.py.
"""

from collections.abc import Iterator
from enum import StrEnum
from typing import Final

from tilth.replay.offline import LONGEST_WAIT_S
from tilth.replay.recorded import Recorded, RecordedRun

SLOWEST: Final = 1.0  # times real time
FASTEST: Final = 100.0


class PlayState(StrEnum):
    """The words of tilth.PlayerState."""

    IDLE = "idle"  # no run is open
    PREPARING = "preparing"
    PAUSED = "paused"
    PLAYING = "playing"
    ENDED = "ended"
    FAILED = "failed"


class RunPlayer:
    """Of one run; at its beginning, paused."""

    def __init__(self, run: RecordedRun) -> None:
        self.run = run
        self.state = PlayState.PAUSED
        self.rate = 1.0
        self.jumps = 0
        self._zero_s, self._zero_ns = 0.0, 0  # a time of the clock, and where the run was then
        self._t_minus_at_ns = 0  # of the last result that was handed out
        self._coming: Iterator[Recorded] = iter(())
        self._next: Recorded | None = None

    def at_ns(self, now_s: float) -> int:
        """The place in the run."""
        if self.state != PlayState.PLAYING:
            return self._zero_ns
        at_ns = self._zero_ns + int((now_s - self._zero_s) * 1e9 * self.rate)
        return max(0, min(at_ns, self.run.length_ns))

    def t_ns(self, now_s: float) -> int:
        """The log's time there."""
        return self.at_ns(now_s) + self._t_minus_at_ns

    def play(self, now_s: float) -> list[Recorded]:
        """Go on; from the beginning where it has ended. What is to be published at once."""
        state = self.seek(0, now_s) if self.state == PlayState.ENDED else []
        self._hold(now_s)
        self.state = PlayState.PLAYING
        return state

    def pause(self, now_s: float) -> None:
        self._hold(now_s)
        if self.state == PlayState.PLAYING:
            self.state = PlayState.PAUSED

    def set_rate(self, rate: float, now_s: float) -> None:
        """Raises ValueError in a person's words."""
        if not SLOWEST <= rate <= FASTEST:
            raise ValueError(f"a speed of {rate:g}: give {SLOWEST:g} to {FASTEST:g} times real time")
        self._hold(now_s)
        self.rate = rate

    def seek(self, at_ns: int, now_s: float) -> list[Recorded]:
        """Go there and go on as before. The last of each topic up to there, to be published at once."""
        if self.state == PlayState.ENDED:
            self.state = PlayState.PAUSED
        self._zero_s, self._zero_ns = now_s, max(0, min(at_ns, self.run.length_ns))
        self.jumps += 1
        self._coming = self.run.after(self._zero_ns)
        self._next = next(self._coming, None)
        state = self.run.before(self._zero_ns)
        known = state[-1] if state else self._next
        if known is not None:
            self._t_minus_at_ns = known.t_ns - known.at_ns
        return state

    def due(self, now_s: float) -> list[Recorded]:
        """What has come since the last call, in order. Silences over LONGEST_WAIT_S are not waited for."""
        if self.state != PlayState.PLAYING:
            return []
        found = []
        at_ns = self.at_ns(now_s)
        while self._next is not None and self._next.at_ns <= at_ns:
            found.append(self._next)
            self._next = next(self._coming, None)
        if found:
            self._t_minus_at_ns = found[-1].t_ns - found[-1].at_ns
        if self._next is None:
            self._zero_ns, self.state = self.run.length_ns, PlayState.ENDED
        elif self._next.at_ns - at_ns > LONGEST_WAIT_S * 1e9:
            self._zero_s, self._zero_ns = now_s, self._next.at_ns
        return found

    def _hold(self, now_s: float) -> None:
        """From here on count anew."""
        self._zero_ns, self._zero_s = self.at_ns(now_s), now_s
