"""What the page shows, as JSON: whole for a page that opens, and what is new ten times a second.

    {"whole": {…everything…}}  or  {"new": {…what changed since the last…}}

Both have the same fields; those of a kind of message are replaced by a later one, events are added.
"""

import json
import math
from collections import deque
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from importlib.metadata import PackageNotFoundError, version
from typing import Any, Final, NamedTuple

from tilth.client.received import LONGEST as LONGEST_TEXT
from tilth.client.received import Refused
from tilth.monitor.daemon_data import DaemonData
from tilth.monitor.overview import Overview, ask_overview
from tilth.monitor.page_estimate import page_estimate, priors
from tilth.monitor.traces import Traces, estimate_row, pose_quality, pose_row
from tilth.schemas.invocation import command

EVENTS: Final = 100  # shown
SILENT_S: Final = 3.0  # of a daemon that lives: status and estimate come each second
FIRST_DRIVE: Final = "first_drive"  # what is told of a recorded drive that is shown until a daemon is ready
OVER: Final = "over"  # what is told of a demo that has ended
WAIT_S: Final = 10.0  # a daemon that starts beside the page may take so long to its first word
Fields = dict[str, Any]


def installed_version() -> str:
    """Version of this package, for the comparison with the daemon's."""
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

    def __init__(self, daemon_data: DaemonData, endpoint: str) -> None:
        self._daemon_data = daemon_data
        self._endpoint = endpoint
        self._version = installed_version()
        self._began_s: float | None = None  # to wait for a first word
        self._messages: dict[str, Fields] = {}
        self._received_s: dict[str, float] = {}
        self._events: deque[Fields] = deque(maxlen=EVENTS)
        self._told: deque[tuple[str, Fields]] = deque()  # from beside, in any thread
        self._traces = Traces()
        self._asking = ThreadPoolExecutor(1, "tilth.overview")
        self._asked: Future[Overview] | None = None
        self._overview: Overview | None = None  # of the run that is played, if one is
        self._events_to_s = 0.0  # place in that run up to which its events are taken

    @property
    def has_overview(self) -> bool:
        """Of a run that is played: all its events are known; its place tells which of them are shown."""
        return self._overview is not None

    def last(self, kind: str) -> Fields | None:
        """The last message of that kind."""
        return self._messages.get(kind)

    def tell(self, kind: str, message: Fields) -> None:
        """Show that too, as if it had been heard; from any thread."""
        self._told.append((kind, message))

    def whole(self, now_s: float) -> str:
        """For a page that opens, or that has to forget what it had."""
        fields = self._around(now_s) | self._messages | self._traces.whole()
        fields["events"] = list(self._events)
        return json.dumps({"whole": fields}, allow_nan=False)

    def turn(self, now_s: float) -> Turn:
        """Take what was heard."""
        anew = self._daemon_data.choose(now_s)
        if anew:
            self._forget()
        if anew or self._began_s is None:
            self._began_s = now_s
        changed: Fields = {}
        events: list[Fields] = []
        heard = self._daemon_data.take()
        for kind, message, sent_s in heard:
            self._received_s[kind] = sent_s
            if kind == "event":
                if self._overview is None:  # it has them all; a network may drop what is published once
                    events.append(message)
                continue
            if kind == "player":
                if self._jumped(message):
                    anew, events = True, []
                events += self._passed(message["at_s"])
            anew |= self._take(kind, message)
            changed[kind] = self._messages[kind]
        told = bool(self._told)
        while self._told:
            kind, message = self._told.popleft()
            self._messages[kind] = changed[kind] = message
        self._events.extend(events)
        anew |= self._take_overview()
        if "soil_tire" in self._messages and ("soil_tire" in changed or "rig" in changed):
            changed["shown"] = page_estimate(self._messages["soil_tire"], self._messages.get("rig"))
            self._messages["shown"] = changed["shown"]
        changed |= self._traces.added() | {"events": events}
        text = json.dumps({"new": self._around(now_s) | changed}, allow_nan=False)
        return Turn(text, bool(heard) or told, anew)

    def _take(self, kind: str, message: Fields) -> bool:
        """Keep the last of each kind; what is drawn over time is kept longer. True as of Traces.add."""
        anew = False
        if kind == "rig":
            message = priors(message)
        elif kind == "soil_tire":
            anew = self._traces.add(estimate_row(message))
        elif kind == "pose":
            anew = self._traces.add(pose_row(message))
            message |= {"quality": pose_quality(message)}
        self._messages[kind] = message
        return anew

    def _jumped(self, player: Fields) -> bool:
        """Whether a player has gone to another place or run: what was heard before is of another time."""
        before = self._messages.get("player", {"run": "", "jumps": 0})
        if (player["run"], player["jumps"]) == (before["run"], before["jumps"]):
            return False
        if player["run"] != before["run"]:
            self._overview = self._asked = None
        self._forget(("rig", FIRST_DRIVE))
        if self._overview is None and self._asked is None and player["run"]:
            self._asked = self._asking.submit(ask_overview, self._daemon_data)
        self._go_to(player["at_s"])
        return True

    def _passed(self, at_s: float) -> list[Fields]:
        """Events of the run that is played between the place before and this one."""
        if self._overview is None:
            return []
        from_s, self._events_to_s = self._events_to_s, at_s
        return self._overview.events_between(from_s, at_s)

    def _take_overview(self) -> bool:
        if self._asked is None or not self._asked.done():
            return False
        asked, self._asked = self._asked, None
        player = self._messages.get("player", {"run": "", "at_s": 0.0})
        try:
            overview = asked.result()
        except Refused:
            return False  # it is asked for at the next jump
        if overview.run != player["run"]:
            return False
        self._overview = overview
        self._go_to(player["at_s"])
        return True

    def _go_to(self, at_s: float) -> None:
        """What a page would have that had heard the run up to there."""
        overview = self._overview
        self._traces = overview.traces(at_s) if overview is not None else Traces()
        self._events.clear()
        self._events_to_s = at_s
        if overview is not None:
            self._events.extend(overview.events_between(-math.inf, at_s))

    def _forget(self, but: Sequence[str] = ()) -> None:
        for kind in set(self._messages).difference(but):
            del self._messages[kind]
        self._received_s.clear()
        self._events.clear()
        self._traces = Traces()

    def _around(self, now_s: float) -> Fields:
        """What is so whether anything was heard or not."""
        alive, names = self._daemon_data.alive()
        followed = self._daemon_data.followed
        return {
            "machine": followed.machine if followed else "",
            "simulated": bool(followed and followed.replay),
            "alive": alive,
            "waiting": self._waiting(now_s),
            "age_s": self._ages(now_s),
            "notes": self._notes(now_s, alive, names),
        }

    def _ages(self, now_s: float) -> Fields:
        """s; of a run that is played, how old each message was at the place where it is."""
        player = self._messages.get("player")
        if player is None:
            return {kind: _finite(now_s - received_s) for kind, received_s in self._received_s.items()}
        t_ns = {
            kind: row["t_ns"] for kind, row in self._messages.items() if row.get("t_ns") and kind != "player"
        }
        return {kind: max(0.0, round((player["t_ns"] - at_ns) * 1e-9, 2)) for kind, at_ns in t_ns.items()}

    def _waiting(self, now_s: float) -> bool:
        """No status was heard yet, and it is too early to wonder."""
        if "player" in self._messages:
            return False
        return "status" not in self._received_s and (self._began_s is None or now_s - self._began_s < WAIT_S)

    def _notes(self, now_s: float, alive: bool, names: list[str]) -> list[str]:
        """What is wrong between the daemon and here, worst first, in sentences that say what to do."""
        followed = self._daemon_data.followed
        if self._waiting(now_s) or OVER in self._messages:
            return []
        if followed is None:
            where = f"No daemon is heard at {self._endpoint}"
            return [f"{where}: start `{command('run')}` or `{command('demo')}`, or look at --connect."]
        name = followed.machine
        found: list[str] = []
        if "player" in self._messages:
            return [] if alive else ["The player of recorded runs does not answer: start it again."]
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


def _finite(number: float) -> float | None:
    return round(number, 2) if math.isfinite(number) else None
