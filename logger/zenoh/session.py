"""The daemon's Zenoh session: on this computer only, or on a shared network with keys."""

import json
import socket
from pathlib import Path
from typing import Final

import zenoh

from tilth.logger.zenoh.open_network import endpoints, is_local, setting, ways_in
from tilth.schemas.invocation import command
from tilth.schemas.machine import Machine, Zenoh
from tilth.schemas.readable import reason_of

ANSWERS_MS: Final = 500  # how long one that is asked who it is may take
REGION: Final = "recorder"
"""What Zenoh calls the recorder's part of a network: a router passes on between parts, not among the peers of
one."""


def open_session(machine: Machine) -> tuple[zenoh.Session, list[str], str]:
    """The session, where it listens, and what is unusual about it, "" if nothing is.

    Without zenoh.config and zenoh.open it speaks on loopback only. Raises zenoh.ZError, also
    where `refusal` has something to say.
    """
    config, notes = _local(machine.zenoh) if machine.zenoh.config is None else _shared(machine)
    if refused := _refusal(machine, config):
        raise zenoh.ZError(refused)
    if opened := _opened(config):
        notes.append(f"{opened}. All there may read, mark and speak in its name")
    wanted = endpoints(config, "listen")
    listen = [free_endpoint(endpoint) for endpoint in wanted]
    config.insert_json5("listen/endpoints", json.dumps(listen))
    if listen != wanted:
        notes.append(_beside_others(machine, config, wanted, listen))
    return zenoh.open(config), listen, "; ".join(notes)


def _beside_others(machine: Machine, config: zenoh.Config, wanted: list[str], listen: list[str]) -> str:
    """What to say where others have the port: who asks there, as marks do, is answered by them.

    A daemon of another machine is joined, so that this one is heard there as well, by its name. Two of one
    machine stay apart: they would speak on the same keys.
    """
    place = f"{', '.join(wanted)} is taken by another program"
    here = f"listening on {', '.join(listen)}"
    there = _living_at([one for one in wanted if one not in listen]) if machine.zenoh.config is None else []
    own = f"{machine.zenoh.prefix}/{machine.name}"
    if there and not any(one.removesuffix("/replay") == own for one in there):
        connect = endpoints(config, "connect") + [one for one in wanted if one not in listen]
        config.insert_json5("connect/endpoints", json.dumps(connect))
        return (
            f"{place}, by {' and '.join(there)}; {here}, and heard there too: several answer, so say with "
            "--machine whom marks, orders and queries are for"
        )
    whose = f", by {' and '.join(there)}" if there else ""
    return (
        f"{place}{whose}; {here}: marks, orders and queries go to the other one, unless given with "
        "--endpoint "
        f"{listen[0]} (mark, accept) or --connect (all others); if that is another run of this "
        "machine, end one: both publish the same keys"
    )


def _living_at(places: list[str]) -> list[str]:
    """Keys of the daemons that answer there, such as tilth/rig; none where nobody does, or not at once."""
    config = zenoh.Config()
    for key, value in (
        ("mode", "client"),
        ("scouting/multicast/enabled", False),
        ("connect/endpoints", places),
        ("connect/timeout_ms", ANSWERS_MS),
        ("connect/exit_on_failure", True),
    ):
        config.insert_json5(key, json.dumps(value))
    try:
        with zenoh.open(config) as session:
            replies = list(session.liveliness().get("**/alive", timeout=ANSWERS_MS * 1e-3))
    except zenoh.ZError:
        return []
    return sorted({str(reply.ok.key_expr).removesuffix("/alive") for reply in replies if reply.ok})


def refusal(machine: Machine) -> str:
    """Why there is to be no session although one could be had: everybody on the network would be let in, and
    the machine file does not say that this is meant. "" where that is not so; nothing is opened."""
    if machine.zenoh.config is None:
        return ""
    try:
        return _refusal(machine, _shared(machine)[0])
    except zenoh.ZError:
        return ""  # reported by the caller that opens it


def _refusal(machine: Machine, config: zenoh.Config) -> str:
    opened = "" if machine.zenoh.open else _opened(config)
    return opened and (
        f"{machine.zenoh.config} makes it {opened}. Make keys with `{command('keys')}`; if all may read, "
        "mark and speak in its name, say so in the machine file as well: [zenoh] open = true"
    )


def _opened(config: zenoh.Config) -> str:
    ways = ways_in(config)
    return f"open to everybody on this network: {'; '.join(ways)}" if ways else ""


def try_session(machine: Machine) -> str:
    """Open a session as a run would and close it; what is unusual about it, or "". Raises zenoh.ZError."""
    session, _, note = open_session(machine)
    session.close()
    return note


def why(error: zenoh.ZError) -> str:
    """Zenoh's own words in one line, without the place in its source."""
    return str(error).partition("\n")[0].partition(" at /")[0].rstrip(" .;")


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


def _local(settings: Zenoh) -> tuple[zenoh.Config, list[str]]:
    """For this computer only: endpoints that others could reach are left out unless `open` is set."""
    given = (*settings.listen, *settings.connect)
    refused = [one for one in given if not (settings.open or is_local(one)) and "/" in one]
    config = zenoh.Config()
    for key, value in (
        ("mode", "peer"),
        ("region_name", REGION),
        ("scouting/multicast/enabled", False),
        ("scouting/gossip/enabled", False),
        ("listen/endpoints", [one for one in settings.listen if one not in refused] or Zenoh().listen),
        ("connect/endpoints", [one for one in settings.connect if one not in refused]),
    ):
        config.insert_json5(key, json.dumps(value))
    if not refused:
        return config, []
    return config, [
        f"{', '.join(refused)} is not used, anybody on that network could read and answer; make "
        f"keys with `{command('keys')}` and name them as config in [zenoh], or say there open = true if "
        "that is meant"
    ]


def _shared(machine: Machine) -> tuple[zenoh.Config, list[str]]:
    """With the configuration that the machine file names."""
    path = str(machine.zenoh.config)
    try:
        Path(path).open("rb").close()
        config = zenoh.Config.from_file(path)
    except (OSError, zenoh.ZError) as error:
        reason = why(error) if isinstance(error, zenoh.ZError) else reason_of(error)
        raise zenoh.ZError(
            f"{path}: {reason}; give the daemon.json that `{command('keys')}` has made"
        ) from None
    made = (setting(config, "metadata") or {}).get("tilth", {})
    wanted = (machine.zenoh.prefix, machine.name)
    made_for = (made.get("prefix"), made.get("machine"))
    if made and made_for != wanted:
        return config, [
            f"{path} was made for {'/'.join(map(str, made_for))}, this is {'/'.join(wanted)}: nobody may "
            "hear it; make keys for this machine"
        ]
    return config, []
