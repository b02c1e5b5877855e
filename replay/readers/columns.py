"""Columns of tables and fields of messages that hold CAN frames: what they are called, and what they mean."""

import re
from functools import lru_cache
from typing import Final, Literal

from tilth.schemas.flow import Frame

Role = Literal[
    "time", "bus", "id", "extended", "remote", "error", "flags", "type", "dlc", "length", "data", "byte"
]
NAMES: Final[dict[Role, str]] = {  # role -> names in plain lower-case letters
    "bus": "bus buschannel channel chan ch canchannel canbus interface port network",
    "id": "id canid arbitrationid arbid identifier messageid msgid frameidentifier idhex iddec canidhex",
    "extended": "extended isextended isextendedid extendedid ide ext xtd eff",
    "remote": "remote isremote isremoteframe remoteframe rtr isrtr",
    "error": "error iserror iserrorframe errorframe err",
    "flags": "flags flag",
    "type": "type idtype frametype",
    "dlc": "dlc datalengthcode",
    "length": "len length datalength datalen size bytecount",
    "data": "data databytes payload datahex datafield",
}
_ROLES: Final[dict[str, Role]] = {name: role for role, names in NAMES.items() for name in names.split()}
_TIME: Final = re.compile(
    r"(?:time(?:stamps?|offset|epoch)?|timestampepoch|epoch|epochtime|unixtime|(?:abs|rel|system)time|datetime)"
    r"(?:in)?(ns|nanoseconds?|us|usec|microseconds?|ms|msec|milliseconds?|s|secs?|seconds?)?"
)
_UNITS: Final = {  # by their first three letters
    "ns": 1, "nan": 1, "us": 1_000, "use": 1_000, "mic": 1_000,
    "ms": 1_000_000, "mse": 1_000_000, "mil": 1_000_000, "s": 1_000_000_000, "sec": 1_000_000_000,
}  # fmt: skip
_BYTE: Final = re.compile(r"(?:d|b|db|data|byte|databyte)\d{1,2}")
_YES: Final = frozenset((
    "1", "true", "t", "yes", "y", "x", "ext", "extended", "29", "29bit", "ide",
    "wahr", "vrai", "vero", "verdadero", "verdadeiro", "waar",  # as spreadsheets save it
))  # fmt: skip
_NO: Final = frozenset((
    "", "0", "false", "f", "no", "n", "s", "std", "standard", "11", "11bit", "-",
    "falsch", "faux", "falso", "onwaar",
))  # fmt: skip
_FD_BYTES: Final = {9: 12, 10: 16, 11: 20, 12: 24, 13: 32, 14: 48, 15: 64}  # DLC -> bytes
LAST_ID: Final = 0x1FFFFFFF


def plain(name: str) -> str:
    return re.sub("[^a-z0-9]", "", re.sub("[µμ\ufffd]", "u", name.lower()))


@lru_cache(maxsize=1024)
def role_of(name: str) -> Role | None:
    """What a column or field of this name holds."""
    bare = plain(name)
    if _TIME.fullmatch(bare):
        return "time"
    return _ROLES.get(bare) or ("byte" if _BYTE.fullmatch(bare) else None)


def unit_ns(name: str) -> int:
    """Nanoseconds of the unit that a column of times names; 0 where it names none."""
    match = _TIME.fullmatch(plain(name))
    return _UNITS[match[1][:3]] if match and match[1] else 0


def is_so(cell: str) -> bool:
    """Raises ValueError for what is neither yes nor no."""
    word = cell.strip().lower()
    if word in _YES:
        return True
    if word in _NO:
        return False
    raise ValueError("neither yes nor no")


def frame_of(
    times: tuple[int, int],  # t_ns, rx_ns
    bus: str,
    identifier: int,
    data: bytes,
    *,
    extended: bool = False,
    remote: bool = False,
    error: bool = False,
    dlc: int | None = None,
    length: int | None = None,
) -> Frame | str:
    """The frame, or why it is none that a decoder wants; data beyond its length are left out.

    An identifier may carry the flags of linux/can.h. Raises ValueError where the data do not fit.
    """
    if identifier < 0 or (length or 0) < 0 or (dlc or 0) < 0:
        raise ValueError("a number below zero")
    if identifier > LAST_ID:
        extended, remote = bool(identifier & 0x80000000), bool(identifier & 0x40000000)
        error = error or bool(identifier & 0x20000000)
        if identifier > 0xFFFFFFFF or not (extended or remote or error):
            raise ValueError("an identifier that is none")
        identifier &= LAST_ID
    if remote and not error:
        return "remote_frame"
    told = _bytes_of(dlc, len(data)) if length is None else length
    if told is not None and not error:
        if told > 8:
            return "can_fd_frame"
        if len(data) < told:
            raise ValueError("a length that does not fit")
        data = data[:told]
    if len(data) > 8:
        return "can_fd_frame"
    return Frame(*times, bus, identifier, extended or error or identifier > 0x7FF, error, data)


def _bytes_of(dlc: int | None, there: int) -> int | None:
    """That a data length code stands for, where so many are there."""
    if dlc is None or dlc <= 8:
        return dlc
    return _FD_BYTES.get(dlc, dlc) if there > 8 else 8


def bus_of(channel: str) -> str:
    """The bus of a channel as a log calls it."""
    return f"can{int(channel)}" if channel.isdecimal() else channel or "can0"
