"""After which silence a receiver is lost."""

from dataclasses import dataclass
from typing import Final

from tilth.estimator.tuning import tuned


@dataclass(frozen=True, slots=True)
class LostTuning:
    """The silence until what was told counts as told no more."""

    lost_ns: int = tuned(1_500_000_000, "ns", "without a usable position for so long a receiver is lost")


LOST: Final = LostTuning()


def lost(last_ns: int, now_ns: int) -> bool:
    """Whether what was last heard at last_ns is lost at now_ns."""
    return now_ns - last_ns > LOST.lost_ns
