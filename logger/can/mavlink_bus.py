"""A CAN bus behind a MAVLink autopilot, as a bus of python-can: `interface = "mavlink"`.

The autopilot forwards what it hears on one of its CAN ports for five seconds after each request
(MAV_CMD_CAN_FORWARD), so that is repeated; nothing else is ever sent, and nothing on the CAN bus.
"""

import select
import socket
import time
from collections import deque
from typing import Any, Final

import can
from pymavlink.dialects.v20 import common

from tilth.logger.can import receive_buffer
from tilth.logger.can.kernel_stamp import STAMP, TIMESTAMPNS, stamp_ns
from tilth.logger.can.socketcan import ERROR, EXTENDED, REMOTE
from tilth.schemas.mavlink import udp_address

ASK_S: Final = 1.0
_LATE: Final = 128  # of 256 sequence numbers: so far behind is overtaken, not lost
_V2: Final = 0xFD


class MavlinkBus(can.BusABC):
    """Listens only. Frames have the kernel's stamp of the datagram that brought them."""

    def __init__(
        self, channel: Any, bitrate: int = 0, can_filters: Any = None, can_bus: int = 1, system: int = 0
    ) -> None:
        """channel: udpin:HOST:PORT where the autopilot sends to, or udpout:HOST:PORT where it waits.
        can_bus: of the autopilot, from 1. system: its number; 0 for whichever answers. bitrate is the
        autopilot's matter. Raises ValueError, OSError."""
        address = udp_address(str(channel))
        if not 1 <= can_bus <= 255 or not 0 <= system <= 255:
            raise ValueError(f"can_bus = {can_bus}, system = {system}: give 1 to 255, and 0 to 255")
        self.channel_info = f"CAN {can_bus} of the autopilot at {channel}"
        self.messages_lost = 0  # of the autopilot's, of any kind, by their sequence numbers
        self._can_bus, self._system = can_bus, system
        self._frames: deque[can.Message] = deque()
        self._sequence: dict[tuple[int, int], int] = {}  # of who forwards frames
        self._requested_s = float("-inf")
        self._codec = common.MAVLink(self, 255, common.MAV_COMP_ID_ONBOARD_COMPUTER)
        self._codec.robust_parsing = True
        family, kind, _, _, where = socket.getaddrinfo(address.host, address.port, type=socket.SOCK_DGRAM)[0]
        self._udp = socket.socket(family, kind)
        try:
            self._udp.setblocking(False)
            self._udp.setsockopt(socket.SOL_SOCKET, TIMESTAMPNS, 1)
            receive_buffer.enlarge(self._udp)
            self._listening = address.listening
            self._peer: Any = None if address.listening else where  # an address of sockets
            if address.listening:
                self._udp.bind(where)
            super().__init__(channel, can_filters)
        except BaseException:
            self._udp.close()
            raise

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        raise can.CanOperationError("this bus only listens")

    def fileno(self) -> int:
        return -1  # a datagram is no frame: who waits for the socket would wake for all the telemetry

    def shutdown(self) -> None:
        super().shutdown()
        self._udp.close()

    def write(self, packed: bytes) -> None:
        """What the codec calls."""
        try:
            self._udp.sendto(packed, self._peer)
        except ConnectionRefusedError:  # the autopilot is off: it is asked again
            return

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        end_s = None if timeout is None else time.monotonic() + timeout
        while not self._frames:
            self._ask()
            try:
                packed, control, _, peer = self._udp.recvmsg(65535, socket.CMSG_SPACE(STAMP.size))
            except ConnectionRefusedError:
                continue
            except BlockingIOError:
                remaining_s = ASK_S if end_s is None else min(end_s - time.monotonic(), ASK_S)
                if remaining_s <= 0:
                    return None, False
                select.select([self._udp], [], [], remaining_s)
                continue
            stamp_s = stamp_ns(control[0][2]) * 1e-9 if control else 0.0
            self._codec.buf, self._codec.buf_index = bytearray(), 0  # half a message before it stays so
            for message in self._codec.parse_buffer(packed) or ():
                if message.get_type() != "BAD_DATA":
                    self._peer = peer if self._listening else self._peer
                    self._take(message, stamp_s)
        return self._frames.popleft(), False

    def _ask(self) -> None:
        now_s = time.monotonic()
        if self._peer is None or now_s - self._requested_s < ASK_S:
            return
        self._requested_s = now_s
        command = common.MAV_CMD_CAN_FORWARD
        self._codec.command_long_send(self._system, 0, command, 0, self._can_bus, 0, 0, 0, 0, 0, 0)

    def _take(self, message: Any, stamp_s: float) -> None:
        kind = message.get_type()
        packed = message.get_msgbuf()
        sequence, *sender = packed[4:7] if packed[0] == _V2 else packed[2:5]
        whom = (sender[0], sender[1])
        if self._system not in (0, whom[0]):
            return
        if whom in self._sequence:
            self._count(whom, sequence)
        if kind in ("CAN_FRAME", "CANFD_FRAME") and message.bus == self._can_bus - 1:
            self._sequence.setdefault(whom, sequence)
            self._frames.append(
                can.Message(
                    timestamp=stamp_s,
                    arbitration_id=message.id & ~(EXTENDED | REMOTE | ERROR),
                    is_extended_id=bool(message.id & EXTENDED) or message.id & 0x1FFF_FFFF > 0x7FF,
                    is_remote_frame=bool(message.id & REMOTE),
                    is_error_frame=bool(message.id & ERROR),
                    is_fd=kind == "CANFD_FRAME",
                    data=bytes(message.data[: message.len]),
                )
            )
        elif kind == "COMMAND_ACK" and message.command == common.MAV_CMD_CAN_FORWARD and message.result:
            reason = common.enums["MAV_RESULT"][message.result].name.removeprefix("MAV_RESULT_").lower()
            raise can.CanOperationError(f"the autopilot does not forward CAN {self._can_bus}: {reason}")

    def _count(self, whom: tuple[int, int], sequence: int) -> None:
        missing = (sequence - self._sequence[whom] - 1) % 256
        if missing < _LATE:
            self.messages_lost += missing
            self._sequence[whom] = sequence
        else:
            self.messages_lost = max(self.messages_lost - 1, 0)
