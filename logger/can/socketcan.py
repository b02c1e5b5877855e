"""SocketCAN read from a raw socket, in batches: exact stamps, exact losses, error frames.

python-can would give stamps rounded to a float's quarter of a microsecond, none of the adapter's, a buffer of
278 frames and no word of what that lost.
"""

import os
import socket
import struct
import time

from tilth.logger.can import can_link, claim_request, receive_buffer
from tilth.logger.can.adapter_clock import AdapterClock
from tilth.logger.can.can_errors import STATES
from tilth.logger.can.kernel_stamp import STAMP, TIMESTAMPNS, stamp_ns
from tilth.logger.can.port import ID_BITS, StampedBy, Tally
from tilth.logger.clock import OLDEST_NS, Clock
from tilth.schemas.flow import Frame
from tilth.schemas.machine import Bus

CAN_FRAME = struct.Struct("=IB3x8s")  # struct can_frame (linux/can.h): identifier with flags, length, data
EXTENDED, REMOTE, ERROR = 0x8000_0000, 0x4000_0000, 0x2000_0000
STAMPS_S = 0.02  # the kernel begins to stamp a little after it is asked to; until then it does so on reading
_FD_BYTES = 72  # struct canfd_frame

# Options and control messages of asm/socket.h and linux/net_tstamp.h, which Python does not name.
_TIMESTAMPING = 37
_RXQ_OVFL = 40
_OF_ADAPTER = 1 << 2 | 1 << 6  # SOF_TIMESTAMPING_RX_HARDWARE, _RAW_HARDWARE
_STAMPS = struct.Struct("@6l")  # three of them: software, none, adapter
_COUNT = struct.Struct("@I")
_CONTROL_BYTES = sum(socket.CMSG_SPACE(one.size) for one in (STAMP, _STAMPS, _COUNT))
# linux/can/raw.h
_SOL_CAN_RAW = 101
_ERR_FILTER = 2
_FD_FRAMES = 5


class SocketCanPort:
    """A raw CAN socket; or any socket of datagrams that hold a struct can_frame, for tests where the kernel
    has no CAN."""

    renewable = False  # what happens to an interface comes as an error

    def __init__(self, one: socket.socket, clock: Clock, tally: Tally, config: Bus) -> None:
        self.descriptor = one.fileno()
        self.stamp = StampedBy.KERNEL
        self._socket = one
        self._name = config.name
        self._clock = clock
        self._tally = tally
        self._config = config
        self._lost = 0
        self._empty_ns = clock.t_ns()
        self._error: OSError | None = None  # raised when what waited has been read
        self._adapter: AdapterClock | None = None
        self.note = self.problem = ""
        self._mixed = False  # a frame came without the adapter's stamp after others with it
        one.setblocking(False)
        if not receive_buffer.enlarge(one):
            self.note = (
                "the kernel allows only a small receive buffer; sysctl net.core.rmem_max="
                f"{receive_buffer.RECEIVE_BYTES} makes room"
            )
        one.setsockopt(socket.SOL_SOCKET, TIMESTAMPNS, 1)
        one.setsockopt(socket.SOL_SOCKET, _TIMESTAMPING, _OF_ADAPTER)
        one.setsockopt(socket.SOL_SOCKET, _RXQ_OVFL, 1)

    def take(self, frames: list[Frame], most: int) -> int:
        receive, monotonic, unpack = self._socket.recvmsg, time.monotonic_ns, CAN_FRAME.unpack
        clock, name, tally = self._clock, self._name, self._tally
        offset_ns = clock.offset_ns
        ahead_ns = clock.wall_ahead_ns()
        for count in range(most):
            try:
                packed, control, _, _ = receive(_FD_BYTES, _CONTROL_BYTES)
            except BlockingIOError:
                self._empty_ns = monotonic() + offset_ns
                if self._error is not None:
                    raise self._error from None
                return count
            except OSError as error:
                self._postpone(error)
                continue
            t_ns = monotonic() + offset_ns
            if len(packed) != CAN_FRAME.size:
                tally.fd_frames += len(packed) == _FD_BYTES
                tally.garbled += len(packed) != _FD_BYTES
                continue
            flagged, length, data = unpack(packed)
            rx_ns = t_ns
            if len(control) == 1 and control[0][1] == TIMESTAMPNS and self._adapter is None:  # nearly always
                rx_ns = stamp_ns(control[0][2]) - ahead_ns
            elif control:
                rx_ns = self._stamped_ns(control, t_ns, ahead_ns, flagged & ERROR != 0)
            if not 0 <= t_ns - rx_ns <= OLDEST_NS:
                rx_ns = clock.rx_ns(rx_ns, t_ns, self._empty_ns)
            if flagged & (ERROR | REMOTE) and not self._take_flagged(t_ns, flagged, data):
                continue
            extended, error_frame = flagged & EXTENDED != 0, flagged & ERROR != 0
            frames.append(Frame(t_ns, rx_ns, name, flagged & ID_BITS, extended, error_frame, data[:length]))
        return most

    def _postpone(self, error: OSError) -> None:
        """The socket reports an error before the frames that came before it: read those first."""
        if self._error is not None:
            raise error
        self._error = error

    def _take_flagged(self, t_ns: int, flagged: int, data: bytes) -> bool:
        """Count an error frame or a remote frame; whether it belongs in the log."""
        if not flagged & ERROR:
            self._tally.remote_frames += 1
            return False
        self._tally.error_frames += 1
        self._tally.health.hear(t_ns, flagged & ID_BITS, data)
        return True

    def ask(self, t_ns: int) -> None:
        """Query bit rate and state of the interface: no error frame reports what was so before."""
        link = can_link.ask(str(self._config.channel))
        if link is None:
            return
        self._tally.health.set_state(t_ns, STATES[link.state] if link.state < len(STATES) else None)
        self.problem = ""
        wanted = self._config.bitrate
        if link.bitrate and link.bitrate != wanted:
            self.problem = (
                f"the interface runs at {link.bitrate} bit/s, the machine file says {wanted}; correct one"
            )
        if not link.restart_ms:
            self.note = "after bus-off it would stay off; bring it up with restart-ms 100"

    def lost(self) -> int:
        self._lost = max(self._lost, receive_buffer.dropped(self._socket))
        return self._lost

    def close(self) -> None:
        self._socket.close()

    def _stamped_ns(
        self, control: list[tuple[int, int, bytes]], t_ns: int, ahead_ns: int, error: bool
    ) -> int:
        """rx_ns from control messages, the adapter's stamp first. Also updates the count of losses."""
        kernel_ns, adapter_ns = t_ns, 0
        for _, kind, data in control:
            if kind == TIMESTAMPNS:
                kernel_ns = stamp_ns(data) - ahead_ns
            elif kind == _TIMESTAMPING:
                *_, seconds, nanoseconds = _STAMPS.unpack(data)
                adapter_ns = seconds * 1_000_000_000 + nanoseconds
            elif kind == _RXQ_OVFL:
                (self._lost,) = _COUNT.unpack(data)
        if self._mixed or error:  # what the driver makes up has no stamp of the adapter's
            return kernel_ns
        if adapter_ns:
            self._adapter = self._adapter or AdapterClock()
            self.stamp = StampedBy.ADAPTER
            return self._adapter.rx_ns(adapter_ns, kernel_ns)
        if self._adapter is not None:  # two kinds of stamp in one stream are worse than the coarser one
            self._mixed, self._adapter, self.stamp = True, None, StampedBy.KERNEL
        return kernel_ns


def open_socketcan(config: Bus, clock: Clock, tally: Tally) -> SocketCanPort:
    """Raises OSError: no such interface, it is down, the kernel has no CAN."""
    one = socket.socket(socket.AF_CAN, socket.SOCK_RAW | socket.SOCK_CLOEXEC, socket.CAN_RAW)
    try:
        one.setsockopt(_SOL_CAN_RAW, _ERR_FILTER, ID_BITS)
        one.setsockopt(_SOL_CAN_RAW, _FD_FRAMES, 1)  # to count them
        port = SocketCanPort(one, clock, tally, config)
        time.sleep(STAMPS_S)  # nothing tells when it has begun
        _bind(one, config)
        port.ask(clock.t_ns())
        if config.request_claims:
            port.note = claim_request.ask(lambda: ask_for_claims(one)) or port.note
    except BaseException:
        one.close()
        raise
    return port


def ask_for_claims(one: socket.socket) -> None:
    """Raises OSError."""
    data = claim_request.DATA
    one.send(CAN_FRAME.pack(claim_request.IDENTIFIER | EXTENDED, len(data), data))


def check(config: Bus) -> None:
    """Raises OSError as `open_socketcan`. python-can leaves a socket behind where there is no interface, and
    hears nothing where it is down."""
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW | socket.SOCK_CLOEXEC, socket.CAN_RAW) as one:
        _bind(one, config)


def _bind(one: socket.socket, config: Bus) -> None:
    one.bind((str(config.channel),))
    number = one.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
    if number:  # the interface is down
        raise OSError(number, os.strerror(number))
