"""What the page shows, as JSON: whole for a page that opens, and what is new ten times a second.

    {"whole": {…everything…}}  or  {"new": {…what changed since the last…}}

Both have the same fields; those of a kind of message are replaced by a later one, events are added.
"""

import json
import math
from collections import deque
from enum import IntEnum
from importlib.metadata import PackageNotFoundError, version
from typing import Any, Final, NamedTuple

from tilth.client.received import LONGEST as LONGEST_TEXT
from tilth.monitor.daemon_data import DaemonData
from tilth.monitor.history import History
from tilth.monitor.words import page_estimate, priors, row
from tilth.schemas.flow import FlagKind, known_flags
from tilth.schemas.invocation import command

EVENTS: Final = 100  # shown
SILENT_S: Final = 3.0  # of a daemon that lives: status and estimate come each second
WAIT_S: Final = 10.0  # a daemon that starts beside the page may take so long to its first word
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
        FlagKind.CONTRADICTION,
    }
)
Fields = dict[str, Any]


def installed_version() -> str:
    """Version of this package, for the comparison with the daemon's."""
    try:
        return version("tilth")
    except PackageNotFoundError:
        return "not installed"


class PoseQuality(IntEnum):
    GOOD = 0
    FLAGGED = 1
    BAD = 2  # a flag of WORST: something is lost or contradicts


class Turn(NamedTuple):
    text: str  # for pages that have all before it
    news: bool  # whether anything was heard; if not, it has ages and notes alone
    anew: bool  # it takes a whole one instead


class View:
    """One thread calls it; times are those of time.monotonic."""

    def __init__(self, daemon_data: DaemonData, endpoint: str) -> None:
        self._daemon_data = daemon_data
        self._endpoint = endpoint
        self._version = installed_version()
        self._began_s: float | None = None  # to wait for a first word
        self._messages: dict[str, Fields] = {}
        self._received_s: dict[str, float] = {}
        self._events: deque[Fields] = deque(maxlen=EVENTS)
        self._estimates = History()
        self._track = History()
        self._origin: tuple[float, float] | None = None

    def whole(self, now_s: float) -> str:
        """For a page that opens, or that has to forget what it had."""
        fields = self._around(now_s) | self._messages
        fields["events"] = list(self._events)
        fields["estimates"] = _columns(self._estimates, ("t", "value", "within", "status"))
        fields["track"] = _columns(self._track, ("t", "tractor", "implement", "quality"))
        return json.dumps({"whole": fields}, allow_nan=False)

    def turn(self, now_s: float) -> Turn:
        """Take what was heard."""
        anew = self._daemon_data.choose(now_s)
        if anew:
            self._forget()
        if anew or self._began_s is None:
            self._began_s = now_s
        messages, events = self._daemon_data.take()
        changed = {kind: message for kind, (message, _) in messages.items()}
        self._received_s |= {kind: received_s for kind, (_, received_s) in messages.items()}
        if "rig" in changed:
            changed["rig"] = priors(changed["rig"])
        if "soil_tire" in changed:
            estimate = changed["soil_tire"]
            anew |= self._estimates.add((estimate["t_ns"] * 1e-9, *row(estimate)))
        if "pose" in changed:
            changed["pose"] |= {"quality": _quality(changed["pose"])}
            anew |= self._add_pose(changed["pose"])
        self._messages |= changed
        if "soil_tire" in self._messages and ("soil_tire" in changed or "rig" in changed):
            changed["shown"] = page_estimate(self._messages["soil_tire"], self._messages.get("rig"))
            self._messages |= changed
        self._events.extend(events)
        text = json.dumps({"new": self._around(now_s) | changed | {"events": events}}, allow_nan=False)
        return Turn(text, bool(messages or events), anew)

    def _forget(self) -> None:
        self._messages.clear()
        self._received_s.clear()
        self._events.clear()
        self._estimates, self._track = History(), History()

    def _add_pose(self, pose: Fields) -> bool:
        origin = (pose["origin_latitude_deg"], pose["origin_longitude_deg"])
        anew = origin != self._origin
        if anew:
            self._origin = origin
            self._track = History()
        t_s = pose["t_ns"] * 1e-9
        rows = self._track.rows
        if rows and 0 <= t_s - rows[-1][0] < TRACE_S:
            return anew
        places = [_place(pose.get(body) or {}) for body in ("tractor", "implement")]
        if places == [None, None]:
            return anew
        return self._track.add((t_s, *places, pose["quality"])) or anew

    def _around(self, now_s: float) -> Fields:
        """What is so whether anything was heard or not."""
        alive, names = self._daemon_data.alive()
        followed = self._daemon_data.followed
        return {
            "machine": followed.machine if followed else "",
            "simulated": bool(followed and followed.replay),
            "alive": alive,
            "waiting": self._waiting(now_s),
            "age_s": {kind: _finite(now_s - received_s) for kind, received_s in self._received_s.items()},
            "notes": self._notes(now_s, alive, names),
        }

    def _waiting(self, now_s: float) -> bool:
        """No status was heard yet, and it is too early to wonder."""
        return "status" not in self._received_s and (self._began_s is None or now_s - self._began_s < WAIT_S)

    def _notes(self, now_s: float, alive: bool, names: list[str]) -> list[str]:
        """What is wrong between the daemon and here, worst first, in sentences that say what to do."""
        followed = self._daemon_data.followed
        if self._waiting(now_s):
            return []
        if followed is None:
            where = f"No daemon is heard at {self._endpoint}"
            return [f"{where}: start `{command('run')}` or `{command('demo')}`, or look at --connect."]
        name = followed.machine
        found = []
        age_s = min((now_s - received_s for received_s in self._received_s.values()), default=math.inf)
        if not alive:
            found.append(f"The daemon of {name} does not answer at {self._endpoint}. Waiting for it.")
        elif age_s > SILENT_S:
            found.append(
                f"The daemon of {name} is there but says nothing: the network, or the daemon, stalls."
            )
        daemon_version = self._messages.get("status", {}).get("version", "")
        if daemon_version and daemon_version != self._version:
            versions = f"The daemon is version {daemon_version}, this page {self._version}"
            found.append(f"{versions}: what only one of them knows is not shown.")
        others = [other for other in names if other != name]
        if others:
            found.append(f"Also here: {', '.join(others)[:LONGEST_TEXT]}. Choose with --machine.")
        refused = self._daemon_data.refused()
        if refused:
            count, (why, _) = sum(refused.values()), max(refused.items(), key=lambda item: item[1])
            found.append(f"{count} messages could not be used, most of them: {why}.")
        return found


def _place(body: Fields) -> tuple[float, float] | None:
    x, y = body.get("x"), body.get("y")
    return None if x is None or y is None else (round(x, 3), round(y, 3))


def _quality(pose: Fields) -> int:
    """A PoseQuality, as the page's JSON has it."""
    flags = pose["flags"]
    if any(flag.kind in WORST for flag in known_flags(flags)):
        return PoseQuality.BAD
    return PoseQuality.FLAGGED if flags else PoseQuality.GOOD


def _columns(history: History, names: tuple[str, ...]) -> dict[str, list[Any]]:
    columns = zip(*history.rows, strict=True) if history.rows else ((),) * len(names)
    return {name: list(column) for name, column in zip(names, columns, strict=True)}


def _finite(number: float) -> float | None:
    return round(number, 2) if math.isfinite(number) else None
