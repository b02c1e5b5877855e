"""The kernel's stamp of a datagram or a CAN frame, as a control message of recvmsg (asm/socket.h)."""

import struct
from typing import Final

TIMESTAMPNS: Final = 35  # socket option and kind of the control message, which Python does not name
STAMP: Final = struct.Struct("@2l")  # s, ns


def stamp_ns(data: bytes) -> int:
    """Realtime, ns, of a control message of kind TIMESTAMPNS."""
    seconds, nanoseconds = STAMP.unpack(data)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)
