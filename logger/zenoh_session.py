"""The daemon's Zenoh session: on this computer only, or on a shared network with keys."""

import contextlib
import ipaddress
import json
import socket
from pathlib import Path
from typing import Any

import zenoh

from tilth.schemas.machine import Machine, Zenoh

_HOST_AND_PORT = ("tcp", "udp", "tls", "quic", "ws")  # protocols whose endpoints are HOST:PORT
_INSIDE = ("unixsock-stream", "unixpipe")  # protocols that do not leave a computer


def open_session(machine: Machine) -> tuple[zenoh.Session, list[str], str]:
    """The session, where it listens, and what is unusual about it, "" if nothing is.

    Without zenoh.config it speaks on loopback only. Raises zenoh.ZError.
    """
    config, note = _loopback(machine.zenoh) if machine.zenoh.config is None else _shared(machine)
    wanted: list[str] = _told(config, "listen/endpoints") or []
    listen = [free_endpoint(endpoint) for endpoint in wanted]
    config.insert_json5("listen/endpoints", json.dumps(listen))
    taken = (
        f"{', '.join(wanted)} is taken by another program; listening on {', '.join(listen)}; "
        "if that is another run of this machine, end one: both publish the same keys"
    )
    notes = [note] * bool(note) + [taken] * (listen != wanted)
    return zenoh.open(config), listen, "; ".join(notes)


def try_session(machine: Machine) -> str:
    """Open a session as a run would and close it; what is unusual about it, or "". Raises zenoh.ZError."""
    session, _, note = open_session(machine)
    session.close()
    return note


def why(error: zenoh.ZError) -> str:
    """Zenoh's own words in one line, without the place in its source."""
    return str(error).partition("\n")[0].partition(" at /")[0].rstrip(" .;")


def is_local(endpoint: str) -> bool:
    """Whether only this computer can reach it."""
    protocol, _, address = endpoint.partition("/")
    if protocol not in _HOST_AND_PORT:
        return protocol in _INSIDE
    host = address.rpartition(":")[0].strip("[]")
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def free_endpoint(endpoint: str) -> str:
    """The endpoint with a port that nobody uses now, where it is TCP or TLS and its own is taken."""
    protocol, _, address = endpoint.partition("/")
    host, _, port = address.rpartition(":")
    if protocol not in ("tcp", "tls") or not port.isdigit():
        return endpoint
    family = socket.AF_INET6 if host.startswith("[") else socket.AF_INET
    for wanted in (int(port), 0):
        with socket.socket(family) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((host.strip("[]"), wanted))
            except OSError:
                continue
            return f"{protocol}/{host}:{probe.getsockname()[1]}"
    return endpoint


def _loopback(settings: Zenoh) -> tuple[zenoh.Config, str]:
    """For this computer: what others could reach is left out."""
    listen = [endpoint for endpoint in settings.listen if is_local(endpoint) or "/" not in endpoint]
    connect = [endpoint for endpoint in settings.connect if is_local(endpoint) or "/" not in endpoint]
    open_to_all = [one for one in (*settings.listen, *settings.connect) if one not in (*listen, *connect)]
    config = zenoh.Config()
    for key, value in (
        ("mode", "peer"),
        ("scouting/multicast/enabled", False),
        ("scouting/gossip/enabled", False),
        ("listen/endpoints", listen or Zenoh().listen),
        ("connect/endpoints", connect),
    ):
        config.insert_json5(key, json.dumps(value))
    if not open_to_all:
        return config, ""
    return config, (
        f"{', '.join(open_to_all)} is not used, anybody on that network could read and answer; make keys "
        "with `tilth keys` and name them as config in [zenoh]"
    )


def _shared(machine: Machine) -> tuple[zenoh.Config, str]:
    """With the keys that the machine file names."""
    path = str(machine.zenoh.config)
    try:
        Path(path).open("rb").close()
        config = zenoh.Config.from_file(path)
    except (OSError, zenoh.ZError) as error:
        reason = why(error) if isinstance(error, zenoh.ZError) else (error.strerror or str(error)).lower()
        raise zenoh.ZError(f"{path}: {reason}; give the daemon.json that `tilth keys` has made") from None
    told = (_told(config, "metadata") or {}).get("tilth", {})
    wanted = (machine.zenoh.prefix, machine.name)
    made_for = (told.get("prefix"), told.get("machine"))
    if told and made_for != wanted:
        return config, (
            f"{path} was made for {'/'.join(map(str, made_for))}, this is {'/'.join(wanted)}: nobody may "
            "hear it; make keys for this machine"
        )
    return config, ""


def _told(config: zenoh.Config, key: str) -> Any:
    """What the configuration says there, None where nothing."""
    with contextlib.suppress(zenoh.ZError, ValueError):
        return json.loads(config.get_json(key))
    return None
