"""Parses the address of a MAVLink peer, written as ground stations do."""

from typing import NamedTuple


class UdpAddress(NamedTuple):
    listening: bool  # wait there for a peer, rather than send there
    host: str
    port: int


def udp_address(text: str) -> UdpAddress:
    """Of udpin:HOST:PORT or udpout:HOST:PORT. Raises ValueError in a person's words."""
    kind, _, place = text.partition(":")
    host, _, port = place.rpartition(":")
    if kind not in ("udpin", "udpout") or not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise ValueError(
            f"{text}: give udpout:HOST:PORT to send there, or udpin:HOST:PORT to wait there; a serial port "
            "is reached through mavlink-router or MAVProxy"
        )
    return UdpAddress(kind == "udpin", host.strip("[]"), int(port))
