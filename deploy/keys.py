"""Keys for a shared network: who hears a machine's daemon, who orders something of it, and nobody else.

A folder holds the authority (ca.pem, ca.key) and one Zenoh configuration file per party, certificates inside:
daemon.json for the recorder, or for a router in front of it (router.py), <name>.json for each person or
program. daemon.json is the register as well: its `metadata.tilth` says who has been let in and who was put
out again.
"""

import base64
import json
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any, Final

from tilth.deploy.certificates import HostError, issue, new_authority
from tilth.logger.zenoh.session import REGION
from tilth.schemas.readable import reason_of

DAEMON: Final = "daemon"
ROLES: Final = ("operator", "reader")
PORT: Final = 7447
MOST_SESSIONS: Final = 256
"""That may be open at a time. Zenoh has no limit for each key: so many that one key does not take them all by
mistake, and so few that the daemon has file handles left for its log."""
DAYS: Final = 3 * 365
# Keys that change something, not for readers.
ORDERS: Final = (
    "mark",
    "accept",
    "implement",
    "load",
    "report/make",
    "experiment/order",
    "calibration/order",
)
# Of who prompts a driver, beside the daemon.
PROMPTED: Final = ("experiment", "experiment/order", "calibration", "calibration/order")
_NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")
_LARGEST: Final = 1_048_576  # bytes of one message that the daemon takes in; a mark has a few hundred

# What goes through the daemon's session, seen from the daemon. What no rule allows is refused.
_ASK: Final = ("declare_subscriber", "query", "liveliness_query", "declare_liveliness_subscriber")
_TELL: Final = ("put", "delete", "reply", "liveliness_token", "declare_queryable")

# Nobody is looked for, nobody is told where others are, and nobody may ask the session about itself.
_ALONE: Final[Mapping[str, Any]] = {
    "mode": "peer",
    "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
    "adminspace": {"enabled": False},
}

# A router passes on between the recorder and all others.
_ROUTER: Final[Mapping[str, Any]] = {
    "mode": "router",
    "gateway": {
        "south": [{"filters": [{"region_names": [REGION]}]}, {"filters": [{"modes": ["peer", "client"]}]}]
    },
}
_PATIENT: Final[Mapping[str, Any]] = {
    "timeout_ms": -1,  # go on trying in the background
    "exit_on_failure": False,
    "retry": {"period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 2.0},
}


class KeysError(Exception):
    """What is wrong with the folder or the names, and what to do, in one sentence."""


@dataclass(frozen=True, slots=True)
class Party:
    """One that has a key. until: last day of its certificate, ISO 8601."""

    name: str
    role: str
    until: str


@dataclass(frozen=True, slots=True)
class Register:
    """Who may do what. hosts: how the daemon's computer is called or addressed. recorder: where a router
    finds it, on loopback; none where it takes the keys itself."""

    machine: str
    prefix: str
    hosts: tuple[str, ...]
    port: int = PORT
    parties: tuple[Party, ...] = ()
    revoked: tuple[str, ...] = ()
    recorder: tuple[str, ...] = ()

    @property
    def base(self) -> str:
        return f"{self.prefix}/{self.machine}"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all parties."""
        return tuple(party.name for party in self.parties)


def make(folder: Path, register: Register, now: datetime) -> list[Path]:
    """A new authority and the daemon's key. Returns the files written. Raises KeysError, OSError."""
    if (folder / "ca.key").exists() or (folder / "daemon.json").exists():
        raise KeysError(f"{folder} holds keys already, and none is overwritten; name another folder")
    if not register.hosts:
        raise KeysError("say how others reach the daemon's computer: --host 192.168.1.10, or its name")
    authority = new_authority(f"tilth {register.machine}", now)
    content = _daemon_content(authority, register)
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    _write_new(folder / "ca.key", authority[0])
    _write_new(folder / "ca.pem", authority[1])
    return [folder / "ca.key", folder / "ca.pem", _write_daemon(folder, register, content)]


def admit(folder: Path, people: Sequence[tuple[str, str]], now: datetime, days: int = DAYS) -> list[Path]:
    """Keys for further (name, role), and the daemon's list with them. Returns the files written.

    Raises KeysError: no name twice, nor one that was revoked, for its old key would be let in again.
    """
    register = read_register(folder)
    for name, _ in people:
        if not _NAME.fullmatch(name) or name in (DAEMON, "ca"):
            raise KeysError(f'"{name}": give a name of letters, digits, dot, dash and underscore')
        if name in register.revoked:
            raise KeysError(f'"{name}" was revoked and its old key may still be about; name it {name}-2')
        if name in register.names or [other for other, _ in people].count(name) > 1:
            raise KeysError(f'"{name}" has a key already, and none is overwritten; see --renew and --revoke')
    new = [Party(name, role, _day(now, days)) for name, role in people]
    return _issue_parties(folder, replace(register, parties=(*register.parties, *new)), new, now, days)


def renew(folder: Path, names: Sequence[str], now: datetime, days: int = DAYS) -> list[Path]:
    """New certificates in place of old ones. Returns the files written. Raises KeysError."""
    register = read_register(folder)
    _must_have(register, names)
    parties = tuple(
        replace(party, until=_day(now, days)) if party.name in names else party for party in register.parties
    )
    renewed = [party for party in parties if party.name in names]
    return _issue_parties(folder, replace(register, parties=parties), renewed, now, days)


def revoke(folder: Path, names: Sequence[str]) -> list[Path]:
    """Take the names from the daemon's list: what they hold opens nothing once the daemon has the new file.

    Raises KeysError.
    """
    register = read_register(folder)
    _must_have(register, names)
    parties = tuple(party for party in register.parties if party.name not in names)
    changed = replace(register, parties=parties, revoked=(*register.revoked, *names))
    written = _write_daemon(folder, changed, _plain(folder / "daemon.json"))
    for name in names:
        (folder / f"{name}.json").unlink(missing_ok=True)
    return [written]


def read_register(folder: Path) -> Register:
    """Raises KeysError where there is none."""
    path = folder / "daemon.json"
    try:
        register = _plain(path)["metadata"]["tilth"]
        parties = tuple(Party(**row) for row in register["parties"])
        hosts, revoked = tuple(register["hosts"]), tuple(register["revoked"])
        recorder = tuple(register.get("recorder", ()))
        return Register(
            register["machine"], register["prefix"], hosts, register["port"], parties, revoked, recorder
        )
    except OSError as error:
        raise KeysError(f"{path}: {reason_of(error)}; make keys first, with --machine and --host") from None
    except (ValueError, LookupError, TypeError):
        raise KeysError(f"{path}: not written by tilth keys; name the folder that is") from None


def access_control(register: Register) -> dict[str, object]:
    """Zenoh's access control for the daemon's session: readers hear, operators give orders as well."""
    keys = [f"{register.base}/**"]
    rules = [
        _rule("ask", "allow", _ASK, "ingress", keys),
        _rule("tell", "allow", _TELL, "egress", keys),
        # Zenoh holds this rule against the very key only; a query on a wildcard comes through, and the daemon
        # takes none from one.
        _rule("no orders", "deny", ("query",), "ingress", [f"{register.base}/{key}" for key in ORDERS]),
        _rule("prompt", "allow", ("put", "reply", "declare_queryable"), "ingress",
              [f"{register.base}/{key}" for key in PROMPTED]),
        _rule("pass on", "allow", ("query",), "egress",
              [f"{register.base}/{key}" for key in PROMPTED if key in ORDERS]),
    ]  # fmt: skip
    may = {"operator": ["ask", "tell", "prompt", "pass on"], "reader": ["ask", "tell", "no orders"]}
    subjects, policies = [], []
    for role in ROLES:
        names = [party.name for party in register.parties if party.role == role]
        if names:  # an empty list would stand for everybody
            subjects.append({"id": role, "cert_common_names": names})
            policies.append({"rules": may[role], "subjects": [role]})
    if register.recorder:  # the only one that is not connected by TLS
        whole = _rule("whole", "allow", (*_ASK, *_TELL), "ingress", keys)
        rules.append(whole | {"flows": ["ingress", "egress"]})
        subjects.append({"id": "recorder", "link_protocols": ["tcp"]})
        policies.append({"rules": ["whole"], "subjects": ["recorder"]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def _rule(
    name: str, permission: str, messages: Sequence[str], flow: str, keys: list[str]
) -> dict[str, object]:
    what = {"id": name, "permission": permission, "messages": list(messages)}
    return {**what, "flows": [flow], "key_exprs": keys}


def _daemon_content(authority: tuple[bytes, bytes], register: Register) -> dict[str, object]:
    try:
        key, certificate = issue(authority, DAEMON, ("127.0.0.1", "localhost", *register.hosts), None)
    except HostError as error:
        raise KeysError(f"--host {error}") from None
    tls = {
        "root_ca_certificate_base64": _text(authority[1]),
        "listen_certificate_base64": _text(certificate),
        "listen_private_key_base64": _text(key),
        "enable_mtls": True,
        "close_link_on_expiration": True,
    }
    return {
        **_ALONE,
        **(_ROUTER if register.recorder else {}),
        "listen": {"endpoints": [f"tls/0.0.0.0:{register.port}"]},
        "connect": {"endpoints": list(register.recorder), **_PATIENT},
        "transport": {
            "unicast": {"max_sessions": MOST_SESSIONS},
            "link": {"tls": tls, "rx": {"max_message_size": _LARGEST}},
        },
        "metadata": {"tilth": {"role": DAEMON}},
    }


def _write_daemon(folder: Path, register: Register, content: dict[str, Any]) -> Path:
    content["metadata"]["tilth"] |= asdict(register)
    content["access_control"] = access_control(register)
    return _replace(folder / "daemon.json", content)


def _issue_parties(
    folder: Path, register: Register, parties: Sequence[Party], now: datetime, days: int
) -> list[Path]:
    """Write keys of these, and the daemon's list."""
    authority = ((folder / "ca.key").read_bytes(), (folder / "ca.pem").read_bytes())
    written = []
    for party in parties:
        pair = issue(authority, party.name, (), now + timedelta(days=days))
        content = _party_content(authority[1], pair, register, party)
        written.append(_replace(folder / f"{party.name}.json", content))
    return [*written, _write_daemon(folder, register, _plain(folder / "daemon.json"))]


def _party_content(
    ca: bytes, pair: tuple[bytes, bytes], register: Register, party: Party
) -> dict[str, object]:
    tls = {
        "root_ca_certificate_base64": _text(ca),
        "connect_private_key_base64": _text(pair[0]),
        "connect_certificate_base64": _text(pair[1]),
        "enable_mtls": True,
    }
    # This computer first: the recorder's own programs do without the network.
    hosts = ("127.0.0.1", *(host for host in register.hosts if host != "127.0.0.1"))
    return {
        **_ALONE,
        "listen": {"endpoints": []},
        "connect": {
            "endpoints": [f"tls/{f'[{host}]' if ':' in host else host}:{register.port}" for host in hosts],
            **_PATIENT,
        },
        "transport": {"link": {"tls": tls}},
        "metadata": {"tilth": asdict(party) | {"machine": register.machine, "prefix": register.prefix}},
    }


def _must_have(register: Register, names: Sequence[str]) -> None:
    for name in names:
        if name not in register.names:
            raise KeysError(f'"{name}" has no key here; there are {", ".join(register.names) or "none"}')


def _day(now: datetime, days: int) -> str:
    return f"{now + timedelta(days=days):%Y-%m-%d}"


def _text(pem: bytes) -> str:
    return base64.b64encode(pem).decode()


def _plain(path: Path) -> dict[str, Any]:
    content: dict[str, object] = json.loads(path.read_text(encoding="utf-8"))
    return content


def _write_new(path: Path, data: bytes) -> None:
    """Raises FileExistsError."""
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as stream:
        stream.write(data)


def _replace(path: Path, content: Mapping[str, Any]) -> Path:
    """Whole or not at all."""
    new_file = path.with_suffix(".new")
    new_file.unlink(missing_ok=True)
    _write_new(new_file, (json.dumps(content, indent=2) + "\n").encode())
    return new_file.replace(path)
