"""Opens the buses of the machine file, and explains why one cannot be opened.

For listening only, unless the file allows to ask for NAMEs.
"""

import difflib
import errno
import socket
from collections.abc import Mapping
from typing import Any

import can

from tilth.logger.can import claim_request, slcan, socketcan
from tilth.logger.can.port import LibraryPort, Port, Tally
from tilth.logger.clock import Clock
from tilth.schemas.machine import Bus, Machine, MachineError

# What makes an interface listen without acknowledging, where python-can can ask for it; nothing is sent then.
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


def check_interfaces(machine: Machine) -> None:
    """As `check_interface`, of all its buses."""
    for bus in machine.bus:
        check_interface(bus)


def check_interface(config: Bus) -> None:
    """Raises MachineError where python-can has no such interface: waiting will not help then."""
    if config.interface in can.VALID_INTERFACES:
        return
    near = difflib.get_close_matches(config.interface, can.VALID_INTERFACES, n=1)
    hint = f'did you mean "{near[0]}"?' if near else f"it knows {', '.join(sorted(can.VALID_INTERFACES))}"
    raise MachineError(
        f'bus {config.name}: interface = "{config.interface}" is not one of python-can; {hint}'
    )


def open_port(config: Bus, clock: Clock, tally: Tally) -> Port:
    """Open for listening. May take seconds and raise whatever the interface raises: see `why_not`.

    SocketCAN and slcan are read by our own ports; python-can reads every other interface, and these two where
    options are given that only it knows.
    """
    if config.interface == "socketcan" and not config.options:
        return socketcan.open_socketcan(config, clock, tally)
    if config.interface == "slcan" and slcan.is_plain(config):
        return slcan.open_slcan(config, clock, tally)
    if config.interface == "socketcan":
        socketcan.check(config)
    elif config.interface == "socketcand":
        _server_answers(config)
    quiet = {} if config.request_claims else LISTEN_ONLY.get(config.interface, {})
    arguments = {"bitrate": config.bitrate, **quiet, **config.options}
    bus = can.Bus(channel=config.channel, interface=config.interface, ignore_config=True, **arguments)
    port = LibraryPort(bus, config, clock, tally)
    if config.request_claims:
        request = can.Message(arbitration_id=claim_request.IDENTIFIER, data=claim_request.DATA)
        port.note = claim_request.ask(lambda: bus.send(request))
    return port


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


def _server_answers(config: Bus) -> None:
    # python-can tries for ten seconds without a pause.
    address = (str(config.options.get("host", "")), int(config.options.get("port", 0)))
    socket.create_connection(address, timeout=2.0).close()


def _first_line(text: str) -> str:
    return text.strip().splitlines()[0].rstrip(".") if text.strip() else "no reason given"
