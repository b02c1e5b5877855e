"""Decides which requests a server on this computer answers: none from a page of another origin.

Neither a page whose own name points here nor one in the same browser. A program that is no browser sends no
origin, and is answered.
"""

import ipaddress
import re
import socket
from collections.abc import Sequence
from typing import Final, NamedTuple

_PLACE: Final = r"(\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9._-]+)?(:[0-9]{1,5})?"  # name or address, and port
_HOST: Final = re.compile(_PLACE)
_ORIGIN: Final = re.compile(rf"null|[A-Za-z][A-Za-z0-9+.-]*://(?P<place>{_PLACE})")


class Refusal(NamedTuple):
    """An answer of HTTP."""

    status: int
    why: str


def refusal(hosts: Sequence[str], origins: Sequence[str], allowed: Sequence[str] = ()) -> Refusal | None:
    """Why a request with these headers `Host` and `Origin` is not for us; None where it is.

    allowed: origins that may ask although they are of somewhere else.
    """
    host = _HOST.fullmatch(hosts[0]) if len(hosts) == 1 else None
    if host is None:
        return Refusal(400, "say one Host, a name or an address, and perhaps a port")
    found = [_ORIGIN.fullmatch(origin) for origin in origins]
    if len(origins) > 1 or None in found:
        return Refusal(400, "say one Origin, such as http://localhost:8117, or none")
    name = (host[1] or "").lower().strip("[]")
    host_name = socket.gethostname().lower()
    if name not in ("localhost", host_name, f"{host_name}.local") and not _is_address(name):
        return Refusal(403, "ask by this computer's address or name")
    for origin, match in zip(origins, found, strict=True):
        same_origin = match is not None and match["place"] and match["place"].lower() == host[0].lower()
        if not (same_origin or origin.lower() in allowed):
            return Refusal(403, "asked by a page from elsewhere")
    return None


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True
