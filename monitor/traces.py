"""What the page draws over time: the track, the steering and the estimates, as far as they are known.

The first item of every row is its time, s.
"""

from collections.abc import Iterable
from enum import IntEnum
from typing import Any, Final, NamedTuple

from tilth.monitor.history import History, Row
from tilth.monitor.page_estimate import row
from tilth.schemas.flow import FlagKind, known_flags

TRACE_S: Final = 0.5  # between points of the track
WORST: Final = frozenset(
    {
        FlagKind.LOST,
        FlagKind.NO_FIX,
        FlagKind.MISSING,
        FlagKind.NO_HEADING,
        FlagKind.DOUBTFUL,
        FlagKind.MOVED,
        FlagKind.SWAPPED,
        FlagKind.REPEATING,
        FlagKind.STANDS_STILL,
        FlagKind.CONTRADICTION,
    }
)
COLUMNS: Final[dict[str, tuple[str, ...]]] = {
    "estimates": ("t", "value", "within", "status"),
    "track": ("t", "tractor", "implement", "quality"),
    "steering": ("t", "wheel_angle"),
}
Fields = dict[str, Any]


class PoseQuality(IntEnum):
    GOOD = 0
    FLAGGED = 1
    BAD = 2  # a flag of WORST: something is lost or contradicts


def pose_quality(pose: Fields) -> int:
    """A PoseQuality, as the page's JSON has it."""
    flags = pose["flags"]
    if any(flag.kind in WORST for flag in known_flags(flags)):
        return PoseQuality.BAD
    return PoseQuality.FLAGGED if flags else PoseQuality.GOOD


class PoseRow(NamedTuple):
    """What is drawn of a pose: time in s, places in m north and east of the origin, wheel angle in rad."""

    t_s: float
    origin: tuple[float, float]  # degrees
    tractor: tuple[float, float] | None
    implement: tuple[float, float] | None
    quality: int
    wheel_angle: float | None


class EstimateRow(NamedTuple):
    """What is drawn of an estimate: time in s; the rest as of words.row."""

    t_s: float
    value: list[float | None]
    within: list[float | None]
    status: list[int]


def pose_row(pose: Fields) -> PoseRow:
    tractor, implement = (_place(pose.get(body) or {}) for body in ("tractor", "implement"))
    origin = (pose["origin_latitude_deg"], pose["origin_longitude_deg"])
    wheel_angle = pose.get("wheel_angle")
    wheel_angle = None if wheel_angle is None else round(wheel_angle, 4)
    return PoseRow(pose["t_ns"] * 1e-9, origin, tractor, implement, pose_quality(pose), wheel_angle)


def estimate_row(estimate: Fields) -> EstimateRow:
    return EstimateRow(estimate["t_ns"] * 1e-9, *row(estimate))


class Traces:
    """All of a drive, older rows thinned."""

    def __init__(self) -> None:
        self._histories = {name: History() for name in COLUMNS}
        self._added: dict[str, list[Row]] = {}
        self._origin: tuple[float, float] | None = None

    def add(self, one: PoseRow | EstimateRow) -> bool:
        """True where what is held is not what it was plus this."""
        if isinstance(one, EstimateRow):
            return self._add("estimates", tuple(one))
        anew = one.origin != self._origin
        if anew:
            self._origin = one.origin
            self._histories["track"] = History()
            self._added.pop("track", None)
        anew |= self._add("steering", (one.t_s, one.wheel_angle))
        rows = self._histories["track"].rows
        is_close = bool(rows) and 0 <= one.t_s - rows[-1][0] < TRACE_S
        if is_close or (one.tractor is None and one.implement is None):
            return anew
        return self._add("track", (one.t_s, one.tractor, one.implement, one.quality)) or anew

    def _add(self, name: str, one: Row) -> bool:
        history = self._histories[name]
        if history.rows and history.rows[-1][0] == one[0]:
            return False  # the same again, as an answer
        self._added.setdefault(name, []).append(one)
        return history.add(one)

    def added(self) -> dict[str, dict[str, list[Any]]]:
        """Columns of what was added since the last call."""
        added, self._added = self._added, {}
        return {name: _columns(rows, COLUMNS[name]) for name, rows in added.items()}

    def whole(self) -> dict[str, dict[str, list[Any]]]:
        """Columns of all."""
        return {name: _columns(self._histories[name].rows, names) for name, names in COLUMNS.items()}


def _place(body: Fields) -> tuple[float, float] | None:
    x, y = body.get("x"), body.get("y")
    return None if x is None or y is None else (round(x, 3), round(y, 3))


def _columns(rows: Iterable[Row], names: tuple[str, ...]) -> dict[str, list[Any]]:
    columns = list(zip(*rows, strict=True)) or [()] * len(names)
    return {name: list(column) for name, column in zip(names, columns, strict=True)}
