"""The kernel's receive buffer of a socket: make it large, ask what it has dropped."""

import array
import contextlib
import os
import socket
import stat

RECEIVE_BYTES = 4 * 1024 * 1024  # the default holds 278 CAN frames: 150 ms of one full 250 kbit/s bus
_SO_RCVBUFFORCE = 33
_SO_MEMINFO = 55  # nine unsigned 32-bit numbers, the last counts what was dropped (linux/sock_diag.h)
_MEMINFO_BYTES = 9 * 4


def enlarge(one: socket.socket) -> bool:
    """Let the kernel keep some seconds of frames while the loop is busy; False where it allows only less."""
    for option in (_SO_RCVBUFFORCE, socket.SO_RCVBUF):  # the first goes over the limit, with privilege
        with contextlib.suppress(OSError):
            one.setsockopt(socket.SOL_SOCKET, option, RECEIVE_BYTES)
            break
    return one.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) >= RECEIVE_BYTES


def dropped(one: socket.socket) -> int:
    """Messages that the kernel threw away because nobody took them in time; 0 where it does not say.

    The counter that SO_RXQ_OVFL attaches to the next message, without waiting for one. Of a stream it counts
    packets that TCP has sent again since: nothing is lost.
    """
    if one.type == socket.SOCK_STREAM:
        return 0
    try:
        numbers = array.array("I", one.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, _MEMINFO_BYTES))
    except OSError:
        return 0
    return numbers[-1] if len(numbers) == _MEMINFO_BYTES // 4 else 0


def socket_of(descriptor: int) -> socket.socket | None:
    """A second handle on the socket behind a descriptor, None where it is no socket."""
    if not stat.S_ISSOCK(os.fstat(descriptor).st_mode):
        return None
    return socket.socket(fileno=os.dup(descriptor))
