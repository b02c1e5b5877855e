"""Texts from outside as people can read them: marks, and names of files, which are bytes on a disk."""

import re
from typing import Final

_ILLEGIBLE: Final = re.compile(r"[^\t\n -~\xa0-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def readable(text: object) -> str:
    r"""What no terminal, page or figure can show is written as Python would write it: caf\udce9, \x1b."""
    return _ILLEGIBLE.sub(lambda found: ascii(found[0])[1:-1], str(text))


def reason_of(error: OSError) -> str:
    """Why the system refuses, as a part of a sentence."""
    return (error.strerror or str(error)).lower()
