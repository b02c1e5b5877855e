"""Estimates of a live calibration: `tilth calibrate LOG… --json` in a process of its own, behind all else.

So what watches live imports no desk, and an estimate that takes a minute costs neither the daemon nor the
driver anything.
"""

import math
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from tilth.client.calibration.shown import ComputedSoFar
from tilth.estimator.calibration.initial_guess import INITIAL_GUESS
from tilth.estimator.calibration.stage_words import progress
from tilth.estimator.calibration.stages import TICK_S, StageFold
from tilth.logger.job import Job, JobEnded
from tilth.schemas.invocation import in_background

LEAST_S: Final = (
    INITIAL_GUESS.least_driven_s + 5.0
)  # of driving, before the first: the estimate misses ends of stretches
EVERY_S: Final = 120.0  # of driving, between two
SOON_S: Final = 20.0  # the same, as long as the drive tells nothing: such an answer takes seconds


class BackgroundEstimates:
    """At most one at a time. `turn` it; `so_far` says how it stands."""

    def __init__(self, options: Sequence[str]) -> None:
        """options: of `tilth calibrate`, such as --machine M.toml."""
        self.so_far = ComputedSoFar()
        self._options = list(options)
        self._computing: Job | None = None
        self._began_s = 0.0
        self._used_s = 0.0  # of driving, when the last one began
        self._next_s = LEAST_S  # of driving, when the next one begins
        self._complete = 0  # stages when the last one began
        self._asked = False
        self._told = "Nothing has been computed yet."

    def ask(self) -> None:
        """One begins as soon as it can."""
        self._asked = True

    def turn(self, fold: StageFold, logs: Sequence[Path]) -> None:
        """Take what is ready; begin what is due."""
        driven_s = fold.tally.moving * TICK_S
        if self._computing is not None:
            if self._computing.alive:
                took = time.monotonic() - self._began_s
                self.so_far.text = f"Computing with {self._used_s:.0f} s of driving, for {took:.0f} s now."
                return
            self._take(self._computing)
        complete = sum(one.complete for one in progress(fold))
        stage = complete > self._complete and driven_s > self._used_s >= LEAST_S
        if self._asked or driven_s >= self._next_s or stage:
            self._begin(logs, driven_s, complete)
        elif self._next_s < math.inf:
            left_s = math.ceil(self._next_s - driven_s)
            self.so_far.text = f"{self._told} The next estimate begins after {left_s} s more of driving."

    def close(self) -> None:
        """Ends it."""
        if self._computing is not None:
            self._computing.close()
            self._computing = None
            self.so_far.busy, self.so_far.text = False, self._told

    def _begin(self, logs: Sequence[Path], driven_s: float, complete: int) -> None:
        self._asked = False
        self._began_s, self._used_s, self._complete = time.monotonic(), driven_s, complete
        self._next_s = driven_s + EVERY_S
        words = in_background("calibrate", *map(str, logs), *self._options, "--json")
        if not words:
            self._next_s = math.inf
            self.so_far.text = "This program cannot compute beside itself; finish, and it is computed then."
            return
        try:
            self._computing = Job(words)
        except JobEnded as why:
            self._told = f"The estimate failed: {why}."
            return
        self.so_far.busy = True

    def _take(self, computed: Job) -> None:
        took = time.monotonic() - self._began_s
        try:
            found = computed.json()
        except JobEnded as why:
            self._told = f"The estimate failed: {why}."
            return
        finally:
            self.close()
        self.so_far.answer = found
        if found.get("refused"):
            self._next_s = max(self._used_s + SOON_S, LEAST_S)
        what = "Nothing could be told yet" if found.get("refused") else "Computed"
        self._told = f"{what} by {self._used_s:.0f} s of driving; it took {took:.0f} s."
