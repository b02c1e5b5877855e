"""What a client may ask for at once: a fair share of the places that there are. Who is at the machine itself
is never kept out by others.

Who asks is a name: of a key, or of a computer. Everybody whom nobody can tell apart is one client, UNKNOWN.
"""

import ipaddress
from collections import Counter
from contextlib import AbstractContextManager, nullcontext
from typing import Any, Final

LOCAL: Final = "this computer"
UNKNOWN: Final = "an unknown client"


class Limiter:
    """Counts places. It is entered for each request, and left when that is answered."""

    def __init__(
        self, most: int, each: int, what: str = "requests", lock: AbstractContextManager[Any] | None = None
    ) -> None:
        """most: places of all others than LOCAL together. each: of one client, and those of LOCAL besides.
        lock: where several threads ask."""
        self._most, self._each, self._what = most, each, what
        self._lock: AbstractContextManager[Any] = nullcontext() if lock is None else lock
        self._held: Counter[str] = Counter()

    def enter(self, client: str) -> str:
        """Take a place: "", or why there is none, for the client."""
        with self._lock:
            if self._held[client] >= self._each:
                most = f"{self._each} are the most"
                return f"too many {self._what} at a time from {client}, {most}; try again soon"
            if client != LOCAL and self._others >= self._most:
                return f"too many {self._what} at a time, others have all {self._most} places; try again soon"
            self._held[client] += 1
            return ""

    def leave(self, client: str) -> None:
        """Give a place back."""
        with self._lock:
            self._held[client] -= 1
            if self._held[client] <= 0:
                del self._held[client]

    def in_the_way(self, client: str) -> str | None:
        """Whose place it is fair to take where `enter` gives none: the client's own, or that of who has so
        many that it keeps more than this one gets; None: of nobody."""
        with self._lock:
            if self._held[client] >= self._each:
                return client
            others = [(count, name) for name, count in self._held.items() if name not in (LOCAL, client)]
            most, name = max(others, default=(0, ""))
            return name if most > self._held[client] + 1 else None

    @property
    def _others(self) -> int:
        return self._held.total() - self._held[LOCAL]


def is_this_computer(address: str) -> bool:
    """Of an IP address."""
    try:
        found = ipaddress.ip_address(address.partition("%")[0])
    except ValueError:
        return False
    return (getattr(found, "ipv4_mapped", None) or found).is_loopback


def of_address(address: str) -> str:
    """The client at an IP address; "" is a socket of this computer."""
    return LOCAL if not address or is_this_computer(address) else address


def asked_by(asked: Any, session: Any) -> str:
    """Who asked a zenoh.Query of a zenoh.Session, by what it says of itself, as far as such a session is
    linked. Who says nothing is LOCAL where all links are of this computer."""
    links = {str(link.zid): link for link in session.info.links()}
    said = asked.source_info
    link = None if said is None else links.get(str(said.source_id.zid))
    if link is not None:
        return str(link.auth_identifier) if link.auth_identifier else of_address(_host(link.dst))
    return LOCAL if all(of_address(_host(link.dst)) == LOCAL for link in links.values()) else UNKNOWN


def _host(locator: object) -> str:
    """Of a locator as zenoh has it: tcp/127.0.0.1:7447."""
    return str(locator).partition("/")[2].rpartition(":")[0].strip("[]")
