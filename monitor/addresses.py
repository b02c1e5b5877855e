"""Where a server on this computer listens, and can be reached, for people who type it into a phone."""

import fcntl
import ipaddress
import socket
import struct
from typing import Final

_SIOCGIFADDR: Final = 0x8915  # netdevice(7): the IPv4 address of an interface
_IN_IFREQ: Final = slice(20, 24)
EVERYWHERE: Final = ("0.0.0.0", "::")


def urls(scheme: str, host: str, port: int) -> list[str]:
    """Of a server that listens there; where that is every address, one of each network of this computer."""
    hosts = (network_addresses() or ["127.0.0.1"]) if host in EVERYWHERE else [host]
    return [f"{scheme}://{f'[{one}]' if ':' in one else one}:{port}" for one in hosts]


def listening_socket(host: str, port: int) -> socket.socket:
    """Raises OSError where the port is taken or the address is not of this computer."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listener = socket.socket(family)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((host, port))
        listener.listen()  # from now on a browser is served, if not at once
    except OSError:
        listener.close()
        raise
    return listener


def network_addresses() -> list[str]:
    """IPv4 addresses of this computer, one of each interface that is up and has one, loopback left out."""
    found = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        for _, name in socket.if_nameindex():
            try:
                answer = fcntl.ioctl(asking, _SIOCGIFADDR, struct.pack("256s", name.encode()[:15]))
            except OSError:
                continue  # it has none
            found.append(socket.inet_ntoa(answer[_IN_IFREQ]))
    return [one for one in found if not ipaddress.ip_address(one).is_loopback]


def is_loopback(host: str) -> bool:
    """Whether what listens there is reached from this computer alone."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
