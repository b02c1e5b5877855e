"""Lets in who types the code of the computer's label; nobody before, also not from this computer itself.

A code has 40 bits or more. One try a second from each computer, and a few a second of all, leave no way to
find it by trying: 2^40 of them take more than a thousand years.
"""

import hashlib
import hmac
import secrets
import time
from collections.abc import Callable
from functools import cached_property
from typing import Final

LETTERS: Final = "0123456789ABCDEFGHJKMNPQRSTVWXYZ"  # none looks like another, and people mistake none
SHORTEST: Final = 8
LONGEST: Final = 64
EACH_S: Final = 1.0  # between two tries of one computer
MOST: Final = 20  # tries of all in that time
ENTERED: Final = "tilth_entered"  # the cookie
REMEMBERED_S: Final = 30 * 86400  # by the phone
_ALIKE: Final = str.maketrans("OIL", "011", " -")


class TooSoon(Exception):
    """Raised for a try that is not looked at."""


def as_read(text: str) -> str:
    """A code as it is compared: however it was typed."""
    return text.upper().translate(_ALIKE)


def new_code() -> str:
    """Two groups of four, for people."""
    drawn = "".join(secrets.choice(LETTERS) for _ in range(SHORTEST))
    return f"{drawn[:4]}-{drawn[4:]}"


class EntryCode:
    """One code."""

    def __init__(self, code: str, now_s: Callable[[], float] = time.monotonic) -> None:
        """Raises ValueError for a code that is too short to keep anybody out."""
        self._code, self._now_s = as_read(code).encode(), now_s
        if len(self._code) < SHORTEST or not set(as_read(code)) <= set(LETTERS):
            raise ValueError(f"a code has {SHORTEST} letters and digits or more")
        self._tries: dict[str, float] = {}

    @cached_property
    def _seal(self) -> bytes:
        """A cookie holds also after a restart, and is worth nothing to who would find the code by trying."""
        return hashlib.scrypt(self._code, salt=b"tilth entry", n=2**14, r=8, p=1)

    def knows(self, cookie: str) -> bool:
        """Whether that is of somebody who has brought this code, to this server or one before it."""
        return secrets.compare_digest(cookie.encode(), self._sealed(cookie.partition(".")[0]).encode())

    def _sealed(self, drawn: str) -> str:
        return f"{drawn}.{hmac.new(self._seal, drawn.encode(), hashlib.sha256).hexdigest()}"

    def take(self, client: str, text: str) -> str:
        """The cookie for who brings the code; "" for a wrong one. Raises TooSoon."""
        now_s = self._now_s()
        self._tries = {one: then_s for one, then_s in self._tries.items() if now_s - then_s < EACH_S}
        if client in self._tries or len(self._tries) >= MOST:
            raise TooSoon
        self._tries[client] = now_s
        if not secrets.compare_digest(as_read(text[: 2 * LONGEST]).encode(), self._code):
            return ""
        return self._sealed(secrets.token_urlsafe(24))
