"""Text of NMEA 2000 gateways and of canboat, one frame or message a line.

    2021-08-06-11:45:30.505,2,127237,5,255,8,80,15,00,40,1f,ff,7f,ff   plain: priority, PGN, source,
    2026-08-09T13:42:55.841473308-07:00,6,126720,7,10,6,a3,99,…        destination, length, bytes
    14:23:39.128 R 0DF20D4B 01 00 54 FA FF FF FF FF                    raw: time of day, identifier
    A173321.107 23FF7 1F513 012F3070002F30709F                         Actisense's N2K ASCII: time of day,
                                                                       source, destination, priority, PGN
    !PDGY,127250,2,3,255,481.734,2C20AAAAAAE=                          iKonvert: PGN, priority, source,
                                                                       destination, its own clock, base64
    1471172400153;A;2016-07-16T12:00:00.000Z,2,130306,…                Signal K: any of these, with its own
                                                                       time, ms, and what kind it is

A line of more than 8 bytes is a message that the gateway has assembled: one Frame with long data.
"""

import base64
import re
from typing import Final

from tilth.replay.readers.text_clock import SECOND, TIME, ZONE, TextClock, nanoseconds, time_ns
from tilth.schemas import can_id
from tilth.schemas.flow import Frame

BUS: Final = "can0"  # none of these lines names its bus

_LAST_PGN = 0x3FFFF  # canboat numbers what gateways say of themselves beyond
_TIME = ("h", "m", "s", "fraction")

PLAIN: Final = re.compile(
    rf"(?P<date>\d{{4}}-\d\d-\d\d)[-T Z]{TIME}{ZONE},(?P<priority>[0-7]),(?P<pgn>\d{{1,8}}),"
    r"(?P<source>\d{1,3}),(?P<destination>\d{1,3}),(?P<length>\d{1,4})(?P<data>(?:,[0-9A-Fa-f]{2})*),?\s*$"
)
RAW: Final = re.compile(
    rf"{TIME} [RT] (?P<id>[01][0-9A-Fa-f]{{7}})(?P<data>(?: [0-9A-Fa-f]{{2}}){{0,8}})\s*$"
)
N2K_ASCII: Final = re.compile(
    rf"A{TIME} (?P<from>[0-9A-Fa-f]{{1,5}}) (?P<pgn>[0-9A-Fa-f]{{4,6}})"
    r"(?P<data>(?: ?[0-9A-Fa-f]{2})*)\s*$"
)
IKONVERT: Final = re.compile(
    r"!PDGY,(?P<pgn>\d{1,8}),(?P<priority>[0-7]),(?P<source>\d{1,3}),(?P<destination>\d{1,3}),"
    r"(?P<s>\d{1,10})\.(?P<ms>\d{1,9}),(?P<data>[A-Za-z0-9+/=]*)\s*$"
)
IKONVERT_STATUS: Final = re.compile(r"(?:\$PDGY,[^$!]*|!PDGY,\d{1,8},\d{1,3},[A-Za-z0-9+/=]*)\s*$")
"""What it says of itself, and what it was given to send: that tells no source."""
SIGNAL_K: Final = re.compile(r"\d{13};\w{1,20};")
"""What Signal K's log of raw data puts before what it has heard: when, and what that is."""
NMEA_0183: Final = re.compile(r"(?:\\[^\\]*\\)?[$!](?!PDGY)[A-Z0-9]{4,8},[^$]*$|\{.*\}\s*$")
"""Sentences of NMEA 0183 and Signal K's own messages, which such a log holds too."""


def plain_line(match: re.Match[str], clock: TextClock) -> Frame | str:
    t_ns = clock.on(match["date"], time_ns(*match.group(*_TIME)), match["zone"])
    priority, pgn, source, destination, length = map(
        int, match.group("priority", "pgn", "source", "destination", "length")
    )
    data = bytes.fromhex(match["data"].replace(",", ""))
    if length != len(data) and pgn <= _LAST_PGN:
        raise ValueError("a length that does not fit")
    return _message(t_ns, priority, pgn, source, destination, data)


def raw_line(match: re.Match[str], clock: TextClock) -> Frame | str:
    t_ns = clock.at(time_ns(*match.group(*_TIME)))
    return Frame(t_ns, t_ns, BUS, int(match["id"], 16), True, False, bytes.fromhex(match["data"]))


def n2k_ascii_line(match: re.Match[str], clock: TextClock) -> Frame | str:
    t_ns = clock.at(time_ns(*match.group(*_TIME)))
    packed = int(match["from"], 16)
    data = bytes.fromhex(match["data"])
    return _message(t_ns, packed & 7, int(match["pgn"], 16), packed >> 12, packed >> 4 & 0xFF, data)


def ikonvert_line(match: re.Match[str], clock: TextClock) -> Frame | str:
    """Milliseconds are a whole number without leading zeros: 482.36 is followed by 482.117."""
    ms = match["ms"]
    t_ns = int(match["s"]) * SECOND + (int(ms) * 1_000_000 if len(ms) <= 3 else nanoseconds(ms))
    priority, pgn, source, destination = map(int, match.group("priority", "pgn", "source", "destination"))
    return _message(t_ns, priority, pgn, source, destination, base64.b64decode(match["data"], validate=True))


def other_line(match: re.Match[str], clock: TextClock) -> Frame | str:
    return "other_event"


def ikonvert_status(match: re.Match[str], clock: TextClock) -> Frame | str:
    return "gateway_message"


def _message(t_ns: int, priority: int, pgn: int, source: int, destination: int, data: bytes) -> Frame | str:
    if pgn > _LAST_PGN:
        return "gateway_message"
    if source > 255 or destination > 255:
        raise ValueError("an address that is none")
    return Frame(t_ns, t_ns, BUS, can_id.join(priority, pgn, source, destination), True, False, data)
