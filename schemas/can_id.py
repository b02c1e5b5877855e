"""The 29-bit identifier of J1939, ISO 11783 and NMEA 2000, taken apart and put together.

    priority(3) | reserved(1) | data page(1) | PF(8) | PS(8) | source(8)

PF < 240 (PDU1): PS is the destination and no part of the PGN. PF >= 240 (PDU2): PS belongs to the PGN and the
message is for everybody (SAE J1939-21, 5.2).
"""

from typing import NamedTuple

BROADCAST = 255  # destination: everybody
NULL_ADDRESS = 254  # source of "cannot claim an address"


class CanId(NamedTuple):
    priority: int
    pgn: int
    source: int
    destination: int


def split(can_id: int) -> CanId:
    """Parts of a 29-bit identifier; further bits are ignored."""
    page_and_format = can_id >> 16 & 0x3FF
    specific = can_id >> 8 & 0xFF
    priority, source = can_id >> 26 & 7, can_id & 0xFF
    if page_and_format & 0xFF < 240:
        return CanId(priority, page_and_format << 8, source, specific)
    return CanId(priority, page_and_format << 8 | specific, source, BROADCAST)


def join(priority: int, pgn: int, source: int, destination: int = BROADCAST) -> int:
    """29-bit identifier. The destination counts only where the PGN is of the PDU1 kind."""
    specific = destination & 0xFF if pgn >> 8 & 0xFF < 240 else pgn & 0xFF
    return (priority & 7) << 26 | (pgn >> 8 & 0x3FF) << 16 | specific << 8 | source & 0xFF
