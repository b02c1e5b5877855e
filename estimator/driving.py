"""How fast a rig must drive for what: one scale of speeds for all that looks at driving."""

from dataclasses import dataclass
from typing import Final

from tilth.estimator.tuning import tuned


@dataclass(frozen=True, slots=True)
class DrivingTuning:
    """Speeds, slowest first."""

    standstill: float = tuned(0.15, "m/s", "up to here a repeated position is still right")
    moving: float = tuned(0.3, "m/s", "from here on the rig goes forwards or backwards")
    creep: float = tuned(0.7, "m/s", "up to here no latency shifts a point by more than a survey's error")
    under_way: float = tuned(1.0, "m/s", "from here on every sensor's reading moves, and filters learn")
    cruise: float = tuned(1.5, "m/s", "from here on paths tell directions and times, and slip exceeds noise")


DRIVING: Final = DrivingTuning()
