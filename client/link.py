"""A Zenoh session that hears one daemon: it opens at once, and connects as soon and as often as it can."""

import json
import re
from pathlib import Path
from typing import Final

import zenoh

ENDPOINT: Final = "tcp/127.0.0.1:7447"
_NAME: Final = re.compile(r"[A-Za-z0-9_.-]+")
_RETRY: Final = {"period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 2.0}


def base_key(machine: str, prefix: str, replay: bool) -> str:
    """What every key of a machine begins with. Raises ValueError."""
    if not _NAME.fullmatch(machine):
        raise ValueError(f"machine = {machine!r}: give its name in the machine file, like jd7930-parker500")
    if not all(map(_NAME.fullmatch, prefix.split("/"))):
        raise ValueError(f"prefix = {prefix!r}: give the prefix in the machine file, such as tilth")
    return "/".join((prefix, machine, *(("replay",) if replay else ())))


def open_session(endpoint: str = ENDPOINT, config: Path | None = None) -> zenoh.Session:
    """config: a Zenoh configuration file instead (certificates, several routers); endpoint is not used then.

    A daemon that is not there yet is no error. Raises ValueError in a person's words.
    """
    try:
        if config is not None:
            return zenoh.open(zenoh.Config.from_file(str(config)))
        settings = zenoh.Config()
        for key, value in (
            ("mode", "peer"),
            ("scouting/multicast/enabled", False),
            ("scouting/gossip/enabled", False),
            ("listen/endpoints", []),
            ("connect/endpoints", [endpoint]),
            ("connect/timeout_ms", -1),  # try as long as it lives …
            ("connect/exit_on_failure", False),  # … behind the back of who opens it
            ("connect/retry", _RETRY),
        ):
            settings.insert_json5(key, json.dumps(value))
        return zenoh.open(settings)
    except zenoh.ZError as error:
        what = endpoint if config is None else config
        why = str(error).partition("\n")[0].partition(" at /")[0].rstrip(" .;")
        raise ValueError(f"{what}: {why}; an endpoint looks like {ENDPOINT}") from None


def living(session: zenoh.Session, prefix: str = "tilth") -> list[str]:
    """What the keys begin with of the daemons that are heard now, then of replays and simulations."""
    found = [str(reply.ok.key_expr) for reply in session.liveliness().get(f"{prefix}/**/alive") if reply.ok]
    bases = {key.removesuffix("/alive") for key in found}
    return sorted(bases, key=lambda base: (base.endswith("/replay"), base))
