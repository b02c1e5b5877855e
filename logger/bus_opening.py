"""How a bus of the machine file becomes an open python-can bus that only listens, and why it could not."""

import array
import contextlib
import difflib
import errno
import os
import socket
import stat
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import can

from tilth.schemas.machine import Bus, MachineError

RECEIVE_BYTES = 4 * 1024 * 1024  # the default holds 278 CAN frames: 150 ms of one full 250 kbit/s bus
_SO_RCVBUFFORCE = 33
_SO_MEMINFO = 55  # nine unsigned 32-bit numbers, the last counts what was dropped (linux/sock_diag.h)
_MEMINFO_BYTES = 9 * 4
_NETWORKS = Path("/sys/class/net")
_IFF_UP = 1

# What makes an interface listen without acknowledging, where python-can can ask for it; nothing is ever sent.
# The machine file's own options go over these.
LISTEN_ONLY: Mapping[str, Mapping[str, Any]] = {
    "kvaser": {"driver_mode": False},
    "neovi": {"receive_own_messages": False},
    "nixnet": {"listen_only": True},
    "pcan": {"state": can.BusState.PASSIVE},
    "slcan": {"listen_only": True},
    "vector": {"listen_only": True},
}

_ADVICE: Mapping[int, str] = {
    errno.ENODEV: "plug the adapter in, or correct channel; `ip link` lists what there is",
    errno.ENXIO: "plug the adapter in, or correct channel",
    errno.ENOENT: "plug the adapter in, or correct channel",
    errno.ENETDOWN: "bring it up: ip link set {channel} up type can bitrate {bitrate}",
    errno.EAFNOSUPPORT: "this kernel has no CAN; load the modules can and can_raw, or use another interface",
    errno.ECONNREFUSED: "start the server, or correct host and port",
    errno.EACCES: "allow this user to open it (often: the group dialout)",
    errno.EPERM: "allow this user to open it",
    errno.EADDRINUSE: "choose another port",
}


def check_interface(config: Bus) -> None:
    """Raises MachineError where python-can has no such interface: waiting will not help then."""
    if config.interface in can.VALID_INTERFACES:
        return
    near = difflib.get_close_matches(config.interface, can.VALID_INTERFACES, n=1)
    hint = f'did you mean "{near[0]}"?' if near else f"it knows {', '.join(sorted(can.VALID_INTERFACES))}"
    raise MachineError(
        f'bus {config.name}: interface = "{config.interface}" is not one of python-can; {hint}'
    )


def open_bus(config: Bus) -> can.BusABC:
    """Open for listening. May take seconds and raise whatever the interface raises: see `why_not`."""
    probe = _PROBES.get(config.interface)
    if probe is not None:
        probe(config)
    arguments = {"bitrate": config.bitrate, **LISTEN_ONLY.get(config.interface, {}), **config.options}
    bus = can.Bus(channel=config.channel, interface=config.interface, ignore_config=True, **arguments)
    descriptor = readable(bus)
    if descriptor is not None:
        enlarge_buffer(descriptor)
    return bus


def why_not(error: BaseException, config: Bus) -> str:
    """One sentence on an error of opening or reading, with what to do about it."""
    cause: BaseException | None = error
    number = None
    while cause is not None and number is None:
        number = getattr(cause, "errno", None) or getattr(cause, "error_code", None)
        cause = cause.__cause__
    text = getattr(error, "strerror", None) or str(error) or type(error).__name__
    advice = _ADVICE.get(number or 0, "check interface, channel and options, and the adapter itself")
    place = f"{config.interface} {config.channel}"
    return f"{place}: {_first_line(text)}; {advice.format(channel=config.channel, bitrate=config.bitrate)}"


def readable(bus: can.BusABC) -> int | None:
    """A descriptor that a selector can wait for, where the bus has one."""
    try:
        descriptor = bus.fileno()
    except NotImplementedError:
        # The socketcand bus keeps its socket to itself; there is only the one.
        sockets = [value for value in vars(bus).values() if isinstance(value, socket.socket)]
        descriptor = sockets[0].fileno() if len(sockets) == 1 else -1
    return descriptor if descriptor >= 0 else None


def enlarge_buffer(descriptor: int) -> None:
    """Let the kernel keep about two seconds of frames while the loop is busy; as much as it allows."""
    with _as_socket(descriptor) as twin:
        if twin is None:
            return
        for option in (socket.SO_RCVBUF, _SO_RCVBUFFORCE):  # the second goes over the limit, with privilege
            with contextlib.suppress(OSError):
                twin.setsockopt(socket.SOL_SOCKET, option, RECEIVE_BYTES)


def dropped(descriptor: int) -> int:
    """Frames that the kernel threw away because nobody read them in time; 0 where it does not say."""
    with _as_socket(descriptor) as twin:
        if twin is None:
            return 0
        try:
            numbers = array.array("I", twin.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, _MEMINFO_BYTES))
        except OSError:
            return 0
        return numbers[-1] if len(numbers) == _MEMINFO_BYTES // 4 else 0


@contextlib.contextmanager
def _as_socket(descriptor: int) -> Iterator[socket.socket | None]:
    """A second handle on the socket, None where the descriptor is none."""
    if not stat.S_ISSOCK(os.fstat(descriptor).st_mode):
        yield None
        return
    with socket.socket(fileno=os.dup(descriptor)) as twin:
        yield twin


def _interface_is_up(config: Bus) -> None:
    """python-can leaves a socket behind where there is none, and hears nothing where it is down."""
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW):
        pass  # raises where the kernel has no CAN
    flags = _NETWORKS / str(config.channel) / "flags"
    if not flags.exists():
        raise OSError(errno.ENODEV, "there is no such interface")
    if not int(flags.read_text(), 16) & _IFF_UP:
        raise OSError(errno.ENETDOWN, "the interface is down")


def _server_answers(config: Bus) -> None:
    # python-can tries for ten seconds without a pause.
    address = (str(config.options.get("host", "")), int(config.options.get("port", 0)))
    socket.create_connection(address, timeout=2.0).close()


_PROBES: Mapping[str, Callable[[Bus], None]] = {
    "socketcan": _interface_is_up,
    "socketcand": _server_answers,
}


def _first_line(text: str) -> str:
    return text.strip().splitlines()[0].rstrip(".") if text.strip() else "no reason given"
