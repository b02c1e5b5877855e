"""What in a Zenoh configuration lets in everybody who reaches this computer over a network.

Judged by what is configured, whoever wrote it: keys of `tilth keys`, mutual TLS or passwords of somebody's
own keep others out; TLS without a client's certificate does not.
"""

import contextlib
import ipaddress
import json
from typing import Any, Final

import zenoh

_HOST_AND_PORT: Final = ("tcp", "udp", "tls", "quic", "ws")  # protocols whose endpoints are HOST:PORT
_INSIDE: Final = ("unixsock-stream", "unixpipe")  # protocols that do not leave a computer
_CERTIFIED: Final = ("tls", "quic")
# Whom Zenoh connects to by itself, by its mode, where nothing else is said.
_SEEKS: Final = {
    "multicast": {"peer": ["router", "peer"], "client": ["router"]},
    "gossip": {"peer": ["router", "peer"]},
}


def is_local(endpoint: str) -> bool:
    """Whether only this computer can reach it."""
    protocol, _, address = endpoint.partition("#")[0].partition("?")[0].partition("/")
    if protocol not in _HOST_AND_PORT:
        return protocol in _INSIDE
    host = address.rpartition(":")[0].strip("[]")
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def ways_in(config: zenoh.Config) -> list[str]:
    """Each in words; none where only this computer or who has a key or password gets in."""
    password = setting(config, "transport/auth/usrpwd/dictionary_file") is not None
    certified = _CERTIFIED if setting(config, "transport/link/tls/enable_mtls") else ()
    verified = _CERTIFIED  # who connects to a router by TLS knows whom it speaks to
    listen, connect = endpoints(config, "listen"), endpoints(config, "connect")
    if _mode(config) == "client":
        listen = []  # it does not listen, whatever is written there
    ways = [
        f"it {does} {endpoint} without keys"
        for does, given, safe in (("listens on", listen, certified), ("connects to", connect, verified))
        for endpoint in given
        if not (is_local(endpoint) or password or endpoint.partition("/")[0] in safe)
    ]
    if _seeks(config, "multicast") and not (_mode(config) == "client" and connect):
        ways.append("it connects to whoever answers on the network; say scouting/multicast/enabled: false")
    if _seeks(config, "gossip") and not all(map(is_local, (*listen, *connect))):
        ways.append("it connects to whomever others name; say scouting/gossip/enabled: false")
    return ways


def endpoints(config: zenoh.Config, side: str) -> list[str]:
    """Of side listen or connect, for the mode that it has."""
    return list(_of_mode(config, f"{side}/endpoints") or [])


def setting(config: zenoh.Config, key: str) -> Any:
    """The value at a key of the configuration; None where there is none."""
    with contextlib.suppress(zenoh.ZError, ValueError):
        return json.loads(config.get_json(key))
    return None


def _mode(config: zenoh.Config) -> str:
    return str(setting(config, "mode") or "peer")


def _of_mode(config: zenoh.Config, key: str) -> Any:
    """Some settings may be given for each mode of their own."""
    value = setting(config, key)
    return value.get(_mode(config)) if isinstance(value, dict) else value


def _seeks(config: zenoh.Config, how: str) -> bool:
    """Whether it connects by itself to those whom it learns of by multicast or gossip."""
    whom = _of_mode(config, f"scouting/{how}/autoconnect")
    whom = _SEEKS[how].get(_mode(config)) if whom is None else whom
    return _of_mode(config, f"scouting/{how}/enabled") is not False and bool(whom)
