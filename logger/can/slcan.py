"""A serial CAN adapter that speaks LAWICEL's ASCII protocol ("slcan"), read in bulk.

python-can reads it one byte at a time: a system call for each, some 27 for a frame. Nothing here sends on the
bus: the commands are for the adapter.
"""

import errno
import os
import re
import termios
import time
from typing import NoReturn

from tilth.logger.can import claim_request
from tilth.logger.can.adapter_clock import AdapterClock
from tilth.logger.can.can_errors import ERRORS, ControllerState
from tilth.logger.can.port import StampedBy, Tally
from tilth.logger.clock import Clock
from tilth.schemas.flow import Frame
from tilth.schemas.machine import Bus

SETTLE_S = 2.0  # some adapters start anew when they are opened, as python-can's waits
OPTIONS = frozenset({"tty_baudrate", "listen_only", "rtscts", "sleep_after_open"})  # as python-can's
READ_BYTES = 4096  # what a terminal of Linux holds at most
LONGEST = 64  # no line of a frame, of CAN FD neither, is a multiple of this; more without an end is noise
_KILOBITS = (10, 20, 50, 100, 125, 250, 500, 800, 1000)  # per second, of the commands S0 to S8
# Identifier, length, the data and perhaps the adapter's stamp, ms.
_FRAME = re.compile(rb"(?:t([0-9A-Fa-f]{3})|[Tx]([01][0-9A-Fa-f]{7}))([0-8])([0-9A-Fa-f]{0,20})")
_STATUS = re.compile(rb"F([0-9A-Fa-f]{2})")
_ANSWER = re.compile(rb"|[zZ]|V[0-9A-Fa-f]{4}|N[0-9A-Za-z]{4}")
_STAMP_MS = 60_000  # where the adapter's clock begins anew
_MS = 1_000_000
# Bits of the answer to F: which rows of ERRORS they mean, or which state.
_ROWS = {row.name: row for row in ERRORS}
_FLAGS = ((0x01, "overrun"), (0x08, "overrun"), (0x80, "bus_error"))
_STATE_FLAGS = ((0x20, ControllerState.PASSIVE), (0x04, ControllerState.WARNING))


class SlcanPort:
    """An open adapter."""

    renewable = True  # a reset adapter receives nothing until it is opened again
    note = problem = ""

    def __init__(self, descriptor: int, config: Bus, clock: Clock, tally: Tally) -> None:
        self.descriptor = descriptor
        self.stamp = StampedBy.COMPUTER
        self._config = config
        self._clock = clock
        self._tally = tally
        self._rest = b""
        self._adapter: AdapterClock | None = None
        self._adapter_ms = 0

    def take(self, frames: list[Frame], most: int) -> int:
        try:
            data = os.read(self.descriptor, READ_BYTES)
        except BlockingIOError:
            return 0
        if not data:
            _hung_up()
        t_ns = self._clock.t_ns()
        *lines, self._rest = (self._rest + data).replace(b"\a", b"\r").split(b"\r")
        if len(self._rest) > 4 * LONGEST:
            self._tally.garbled += 1
            self._rest = b""
        name, match = self._config.name, _FRAME.fullmatch
        count = 0
        for line in lines:
            found = match(line)
            if found is None:
                count += self._other(line, t_ns)
                continue
            short, long, length, rest = found.groups()
            digits = 2 * (length[0] - 48)
            if len(rest) - digits not in (0, 4):
                self._tally.garbled += 1
                continue
            rx_ns = t_ns if len(rest) == digits else self._received_ns(int(rest[digits:], 16), t_ns)
            content = bytes.fromhex(rest[:digits].decode())
            frames.append(Frame(t_ns, rx_ns, name, int(long or short, 16), long is not None, False, content))
            count += 1
        return count

    def ask(self, t_ns: int) -> None:
        """The adapter's flags; the answer comes among the frames."""
        try:
            os.write(self.descriptor, b"F\r")
        except BlockingIOError:
            return

    def lost(self) -> int:
        return 0

    def close(self) -> None:
        try:
            os.write(self.descriptor, b"C\r")
        except OSError:  # it is gone
            pass
        finally:
            os.close(self.descriptor)

    def _received_ns(self, stamp_ms: int, t_ns: int) -> int:
        """The adapter's stamp on the clock of the run."""
        if self._adapter is None:
            self._adapter = AdapterClock()
            self.stamp = StampedBy.ADAPTER
        self._adapter_ms += (stamp_ms - self._adapter_ms) % _STAMP_MS
        return self._adapter.rx_ns(self._adapter_ms * _MS, t_ns)

    def _other(self, line: bytes, t_ns: int) -> int:
        """Take a line that holds no usable frame. Returns the number of frames in it."""
        tally, kind = self._tally, line[:1]
        if (status := _STATUS.fullmatch(line)) is not None:
            self._take_flags(int(status[1], 16), t_ns)
        elif kind in b"rR" and line:
            tally.remote_frames += 1
            return 1
        elif kind in b"dDbB" and line:
            tally.fd_frames += 1
            return 1
        elif _ANSWER.fullmatch(line) is None:
            tally.garbled += 1
        return 0

    def _take_flags(self, flags: int, t_ns: int) -> None:
        health = self._tally.health
        for name in {name for mask, name in _FLAGS if flags & mask}:
            health.count(t_ns, _ROWS[name])
        states = (state for mask, state in _STATE_FLAGS if flags & mask)
        health.set_state(t_ns, next(states, ControllerState.ACTIVE))


def is_plain(config: Bus) -> bool:
    """Whether this can open it: a terminal of this computer, no option but those of OPTIONS."""
    return set(config.options) <= OPTIONS and "://" not in str(config.channel)


def open_slcan(config: Bus, clock: Clock, tally: Tally) -> SlcanPort:
    """Takes SETTLE_S. Raises OSError (no such adapter, no permission), ValueError (a rate it cannot have)."""
    path, _, given = str(config.channel).partition("@")
    speed = int(given or config.options.get("tty_baudrate", 115_200))
    if config.bitrate not in [1000 * kilobits for kilobits in _KILOBITS]:
        rates = ", ".join(f"{kilobits}000" for kilobits in _KILOBITS)
        raise ValueError(f"an slcan adapter has no bit rate {config.bitrate}; it has {rates}")
    descriptor = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        _set_up(descriptor, speed, bool(config.options.get("rtscts", False)))
        # Many an adapter starts anew when it is opened, deaf until then, and nothing tells when it is ready.
        time.sleep(float(config.options.get("sleep_after_open", SETTLE_S)))
        os.write(descriptor, b"\r\rC\r")  # an unfinished command before it is ended, an open channel closed
        termios.tcflush(descriptor, termios.TCIFLUSH)
        listen = bool(config.options.get("listen_only", not config.request_claims))
        os.write(
            descriptor, b"S%d\r%s\r" % (_KILOBITS.index(config.bitrate // 1000), b"L" if listen else b"O")
        )
        if config.request_claims:
            length, data = len(claim_request.DATA), claim_request.DATA.hex().upper()
            os.write(descriptor, b"T%08X%d%s\r" % (claim_request.IDENTIFIER, length, data.encode()))
    except BaseException:
        os.close(descriptor)
        raise
    return SlcanPort(descriptor, config, clock, tally)


def _set_up(descriptor: int, speed: int, handshake: bool) -> None:
    """A raw terminal of that speed."""
    number = getattr(termios, f"B{speed}", None)
    if number is None:
        raise ValueError(f"a serial port has no speed {speed}; 115200, 921600, 1000000, 2000000 are usual")
    control = termios.CS8 | termios.CREAD | termios.CLOCAL | (termios.CRTSCTS if handshake else 0)
    characters = termios.tcgetattr(descriptor)[6]
    characters[termios.VMIN], characters[termios.VTIME] = 1, 0  # with 0, nothing to read looks like the end
    attributes = [termios.IGNPAR, 0, control, 0, number, number, characters]
    termios.tcsetattr(descriptor, termios.TCSANOW, attributes)


def _hung_up() -> NoReturn:
    raise OSError(errno.ENODEV, "the adapter has hung up")
