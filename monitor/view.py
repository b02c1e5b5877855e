"""What the page shows, as JSON: whole for a page that opens, and what is new ten times a second.

    {"whole": {…everything…}}  or  {"new": {…what changed since the last…}}

Both have the same fields; those of a kind of message are replaced by a later one, events are added.
"""

import json
import math
from collections import deque
from importlib.metadata import PackageNotFoundError, version
from typing import Any, Final, NamedTuple

from tilth.client.received import LONGEST as LONGEST_TEXT
from tilth.monitor.heard import Heard
from tilth.monitor.history import History
from tilth.schemas.flow import PARAMETERS
from tilth.schemas.invocation import command

EVENTS: Final = 100  # shown
SILENT_S: Final = 3.0  # of a daemon that lives: status and estimate come each second
TRACE_S: Final = 0.5  # between points of the track
WORST: Final = ("lost", "no_fix", "missing", "no_heading", "doubtful", "moved", "swapped", "repeating")
Fields = dict[str, Any]


def own_version() -> str:
    try:
        return version("tilth")
    except PackageNotFoundError:
        return "not installed"


class Turn(NamedTuple):
    text: str  # for pages that have all before it
    news: bool  # whether anything was heard; if not, it has ages and notes alone
    anew: bool  # it takes a whole one instead


class View:
    """One thread calls it; times are those of time.monotonic."""

    def __init__(self, heard: Heard, endpoint: str) -> None:
        self._heard = heard
        self._endpoint = endpoint
        self._version = own_version()
        self._began_s: float | None = None
        self._messages: dict[str, Fields] = {}
        self._said_s: dict[str, float] = {}
        self._events: deque[Fields] = deque(maxlen=EVENTS)
        self._estimates = History()
        self._track = History()
        self._origin: tuple[float, float] | None = None

    def whole(self, now_s: float) -> str:
        """For a page that opens, or that has to forget what it had."""
        fields = self._around(now_s) | self._messages
        fields["events"] = list(self._events)
        fields["estimates"] = _columns(self._estimates, ("t", "value", "log_sd", "status"))
        fields["track"] = _columns(self._track, ("t", "tractor", "implement", "quality"))
        return json.dumps({"whole": fields}, allow_nan=False)

    def turn(self, now_s: float) -> Turn:
        """Take what was heard."""
        if self._began_s is None:
            self._began_s = now_s
        anew = self._heard.choose(now_s)
        if anew:
            self._forget()
        messages, events = self._heard.take()
        for kind, (message, said_s) in messages.items():
            self._messages[kind] = message
            self._said_s[kind] = said_s
        if "soil_tire" in messages:
            anew |= self._estimates.add(_estimate_row(messages["soil_tire"][0]))
        if "pose" in messages:
            anew |= self._add_pose(messages["pose"][0])
        self._events.extend(events)
        fields = self._around(now_s) | {kind: message for kind, (message, _) in messages.items()}
        text = json.dumps({"new": fields | {"events": events}}, allow_nan=False)
        return Turn(text, bool(messages or events), anew)

    def _forget(self) -> None:
        self._messages.clear()
        self._said_s.clear()
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
        return self._track.add((t_s, *places, _quality(pose))) or anew

    def _around(self, now_s: float) -> Fields:
        """What is so whether anything was heard or not."""
        alive, names = self._heard.alive()
        followed = self._heard.followed
        return {
            "machine": followed.machine if followed else "",
            "simulated": bool(followed and followed.replay),
            "alive": alive,
            "age_s": {kind: _finite(now_s - said_s) for kind, said_s in self._said_s.items()},
            "notes": self._notes(now_s, alive, names),
        }

    def _notes(self, now_s: float, alive: bool, names: list[str]) -> list[str]:
        """What is wrong between the daemon and here, worst first, in sentences that say what to do."""
        followed = self._heard.followed
        if followed is None:
            waited_s = now_s - (self._began_s or now_s)
            if waited_s < 1.0:
                return []
            where = f"No daemon is heard at {self._endpoint}"
            return [f"{where}: start `{command('run')}` or `{command('demo')}`, or look at --connect."]
        name = followed.machine
        found = []
        age_s = min((now_s - said_s for said_s in self._said_s.values()), default=math.inf)
        if not alive:
            found.append(f"The daemon of {name} does not answer at {self._endpoint}. Waiting for it.")
        elif age_s > SILENT_S:
            found.append(
                f"The daemon of {name} is there but says nothing: the network, or the daemon, stalls."
            )
        told = self._messages.get("status", {}).get("version", "")
        if told and told != self._version:
            versions = f"The daemon is version {told}, this page {self._version}"
            found.append(f"{versions}: what only one of them knows is not shown.")
        others = [other for other in names if other != name]
        if others:
            found.append(f"Also here: {', '.join(others)[:LONGEST_TEXT]}. Choose with --machine.")
        refused = self._heard.refused()
        if refused:
            count, (why, _) = sum(refused.values()), max(refused.items(), key=lambda item: item[1])
            found.append(f"{count} messages could not be used, most of them: {why}.")
        return found


def _estimate_row(estimate: Fields) -> tuple[Any, ...]:
    """Time, then of each parameter value, sd of its logarithm, status."""
    n = len(PARAMETERS)
    covariance = estimate["log_covariance"]
    values, spread = [], []
    for i, row in enumerate(estimate["parameters"]):
        value, sd = row.get("value"), row.get("sd")
        variance = covariance[i * n + i] if len(covariance) == n * n else None
        log_sd = math.sqrt(variance) if variance is not None and variance > 0 else None
        if log_sd is None and value and sd:
            log_sd = sd / value
        usable = value is not None and log_sd is not None
        values.append(_short(value) if usable else None)
        spread.append(_short(log_sd) if usable else None)
    statuses = [row["status"] for row in estimate["parameters"]]
    return estimate["t_ns"] * 1e-9, values, spread, statuses


def _place(body: Fields) -> tuple[float, float] | None:
    x, y = body.get("x"), body.get("y")
    return None if x is None or y is None else (round(x, 3), round(y, 3))


def _quality(pose: Fields) -> int:
    """0 all is well, 1 flagged, 2 something is lost."""
    kinds = {flag.partition(":")[0] for flag in pose["flags"]}
    return 2 if kinds & set(WORST) else 1 if kinds else 0


def _columns(history: History, names: tuple[str, ...]) -> dict[str, list[Any]]:
    columns = zip(*history.rows, strict=True) if history.rows else ((),) * len(names)
    return {name: list(column) for name, column in zip(names, columns, strict=True)}


def _short(number: float | None) -> float | None:
    return None if number is None else float(f"{number:.5g}")


def _finite(number: float) -> float | None:
    return round(number, 2) if math.isfinite(number) else None
