"""Lets in other computers that bring the word of a QR code: each word once, then a cookie stands for it.

This computer itself needs none. What is sent is not encrypted: who reads along in the network reads it too.
"""

import secrets
from collections.abc import Callable
from typing import Final

COOKIE: Final = "tilth_guest"
KEY: Final = "key"  # of the address in the code
GUESTS: Final = 16  # that are remembered; the first one is forgotten for another
ASK: Final = "scan the QR code in the terminal of the page's computer: each code lets in one phone"


class Invitation:
    """One word at a time."""

    def __init__(self, renewed: Callable[[str], None]) -> None:
        """renewed: told each word, the first one at once."""
        self._renewed = renewed
        self._guests: list[str] = []
        self._renew()

    def _renew(self) -> None:
        self._word = secrets.token_urlsafe(12)
        self._renewed(self._word)

    def knows(self, cookie: str) -> bool:
        """Whether that is of somebody who was let in."""
        return any(secrets.compare_digest(cookie.encode(), guest.encode()) for guest in self._guests)

    def take(self, word: str) -> str:
        """The cookie for who brings the word, which is worth nothing from now on; "" for a wrong one."""
        if not secrets.compare_digest(word.encode(), self._word.encode()):
            return ""
        guest = secrets.token_urlsafe(24)
        self._guests = [*self._guests, guest][-GUESTS:]
        self._renew()
        return guest
