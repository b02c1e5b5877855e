"""Counts of a run under way, and its summary at the end."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

from tilth.schemas.flow import Estimate, Frame


@dataclass(slots=True)
class LoopCounts:
    """Of the daemon's loop."""

    started_ns: int
    frames: int = 0
    first_frame_ns: int | None = None
    last_frame_ns: int | None = None
    clock_steps: int = 0
    _longest_turn_ns: int = 0  # since it was last asked for

    def took(self, frames: Sequence[Frame]) -> None:
        if frames:
            self.frames += len(frames)
            self.last_frame_ns = frames[-1].t_ns
            if self.first_frame_ns is None:
                self.first_frame_ns = frames[0].t_ns

    def turned(self, took_ns: int) -> None:
        self._longest_turn_ns = max(self._longest_turn_ns, took_ns)

    def take_longest_turn_s(self) -> float:
        """The longest turn since the last call."""
        longest_s, self._longest_turn_ns = self._longest_turn_ns * 1e-9, 0
        return longest_s


@dataclass(frozen=True, slots=True)
class RunSummary:
    """What a run did."""

    started_ns: int
    ended_ns: int
    first_frame_ns: int | None
    last_frame_ns: int | None
    frames: int
    measurements: int
    poses: int
    rejected: dict[str, int]
    estimates: dict[str, Estimate]  # method -> the last
    log_files: tuple[Path, ...]
    recorded: int  # frames in the log
    not_recorded: int  # frames that came while the log could not be written
    lost: int  # frames that the kernel dropped, as far as it says
    bad_stamps: int
    faults: int  # of the estimators
    problems: tuple[str, ...]  # at the end

    @property
    def seconds(self) -> float:
        return (self.ended_ns - self.started_ns) * 1e-9

    def after(self, earlier: Self) -> Self:
        """Of both runs, of which this one is the later."""
        counts = {key: getattr(self, key) + getattr(earlier, key) for key in _COUNTS}
        first_ns = earlier.first_frame_ns
        return replace(
            self,
            started_ns=earlier.started_ns,
            first_frame_ns=self.first_frame_ns if first_ns is None else first_ns,
            last_frame_ns=earlier.last_frame_ns if self.last_frame_ns is None else self.last_frame_ns,
            rejected=dict(Counter(self.rejected) + Counter(earlier.rejected)),
            log_files=(*earlier.log_files, *self.log_files),
            **counts,
        )


_COUNTS = "frames", "measurements", "poses", "recorded", "not_recorded", "lost", "bad_stamps", "faults"
