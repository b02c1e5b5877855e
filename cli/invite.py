"""A QR code in the terminal that opens the page on a phone, once."""

import sys

import segno

from tilth.monitor.addresses import is_loopback, urls
from tilth.monitor.invitation import KEY, Invitation


def invite(host: str, port: int) -> Invitation | None:
    """None where only this computer reaches the page."""
    if is_loopback(host):
        return None
    shown = 0

    def show(word: str) -> None:
        nonlocal shown
        address = f"{urls('http', host, port)[0]}/?{KEY}={word}"
        if not shown:
            segno.make(address, error="l", boost_error=False).terminal(sys.stderr, border=2, compact=True)
        what = "for another one" if shown else "scan it with the phone, or open there"
        print(f"{what}: {address}  (lets in one phone, once)", file=sys.stderr, flush=True)
        shown += 1

    return Invitation(show)
