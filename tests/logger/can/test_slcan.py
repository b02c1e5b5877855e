"""The serial adapter: a pseudo-terminal stands in for it, and the test plays the adapter's part."""

import contextlib
import os
import threading
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from loopback import until

from tilth.logger.can.bus_opening import open_port, why_not
from tilth.logger.can.buses import Buses
from tilth.logger.can.port import LibraryPort, Tally
from tilth.logger.can.slcan import SlcanPort
from tilth.logger.clock import Clock
from tilth.schemas.flow import Frame
from tilth.schemas.machine import Bus
from tilth.schemas.sentences import notice_sentence

FULL_RATE = 1908  # frames/s with 8 bytes on a full bus of 250 kbit/s


class Adapter:
    """The device's end of a serial line, and the name under which it is found."""

    def __init__(self, folder: Path) -> None:
        self.name = folder / "ttyCAN"
        self.plug()

    def plug(self) -> None:
        self.master, slave = os.openpty()
        tty.setraw(slave)
        os.set_blocking(self.master, False)
        self.name.symlink_to(os.ttyname(slave))
        os.close(slave)

    def pull(self) -> None:
        self.name.unlink()
        os.close(self.master)

    def say(self, text: bytes) -> None:
        assert os.write(self.master, text) == len(text)

    def received(self) -> bytes:
        text = b""
        with contextlib.suppress(OSError):  # nothing more, or the other end is closed
            while True:
                text += os.read(self.master, 4096)
        return text

    def hear(self, end: bytes) -> None:
        """Until that is the last it was told, but for being asked for its flags before it."""
        told = [b""]
        until(
            lambda: told[0].endswith(end) or told[0].replace(b"F\r", b"").endswith(end),
            lambda: told.append(told.pop() + self.received()),
        )

    def config(self, **options: str | float | bool) -> Bus:
        given = {"sleep_after_open": 0.0, **options}
        return Bus(name="serial", interface="slcan", channel=str(self.name), options=given)


@pytest.fixture
def adapter(tmp_path: Path) -> Iterator[Adapter]:
    adapter = Adapter(tmp_path)
    yield adapter
    with contextlib.suppress(OSError):
        os.close(adapter.master)


class Open:
    """An open port and what it gave."""

    def __init__(self, adapter: Adapter) -> None:
        self.tally = Tally()
        self.clock = Clock()
        port = open_port(adapter.config(), self.clock, self.tally)
        assert isinstance(port, SlcanPort)
        self.port = port
        self.frames: list[Frame] = []

    def take(self) -> int:
        return self.port.take(self.frames, 32)

    def take_until(self, condition: Callable[[], bool]) -> None:
        """A pty gives what was said a little later, and may give it in pieces."""
        until(condition, self.take)


@pytest.fixture
def line(adapter: Adapter) -> Iterator[Open]:
    line = Open(adapter)
    yield line
    line.port.close()


def test_it_is_told_its_rate_and_to_listen_only(adapter: Adapter, line: Open) -> None:
    adapter.hear(b"C\rS5\rL\r")
    line.port.ask(line.clock.t_ns())
    adapter.hear(b"F\r")


def test_each_kind_of_line(adapter: Adapter, line: Open) -> None:
    adapter.say(b"\r\az\rV1013\rNA123\r")  # answers
    adapter.say(b"T18FF000180011223344556677\rt7FF0\rt1231AB\rx1FFFFFFF1ff\r")
    adapter.say(b"r1232\rR18FF00014\rd12391122\r")
    adapter.say(b"T18FF00018001122\rT28FF00010\rt1239\rhello\rt12 10 \r")
    taken = [line.take()]
    tally = line.tally  # a pty may give it in pieces, what is garbled last
    until(lambda: sum(taken) == 4 + 3 and tally.garbled == 5, lambda: taken.append(line.take()))
    assert [(f.can_id, f.extended, f.data.hex()) for f in line.frames] == [
        (0x18FF0001, True, "0011223344556677"),
        (0x7FF, False, ""),
        (0x123, False, "ab"),
        (0x1FFFFFFF, True, "ff"),
    ]
    assert (tally.remote_frames, tally.fd_frames, tally.garbled) == (2, 1, 5)
    assert line.take() == 0 and line.port.stamp == "computer"


def test_a_line_may_come_in_pieces_and_noise_without_an_end_is_dropped(adapter: Adapter, line: Open) -> None:
    for piece in (b"T18FF0001", b"2AB", b"CD", b"\r"):
        adapter.say(piece)
        line.take()
    line.take_until(lambda: len(line.frames) == 1)
    adapter.say(b"\xff" * 1000)
    line.take()
    adapter.say(b"\rt0010\r")
    line.take_until(lambda: len(line.frames) == 2)
    assert [f.data for f in line.frames] == [b"\xab\xcd", b""] and line.tally.garbled == 1


def test_an_adapters_stamps_are_used_over_their_wrap(adapter: Adapter, line: Open) -> None:
    """A frame each second, read up to 50 ms late: what the reading adds is taken off again."""
    begin_ns = line.clock.offset_ns
    for number in range(100):
        line.clock.offset_ns = begin_ns + number * 1_000_000_000 + number % 6 * 10_000_000
        adapter.say(b"t0010%04X\r" % (number * 1000 % 60_000))
        line.take_until(lambda: len(line.frames) > number)  # noqa: B023  # called at once
    apart_ns = np.diff([frame.rx_ns for frame in line.frames])
    assert line.port.stamp == "adapter" and apart_ns == pytest.approx(1_000_000_000, abs=2_000_000)
    assert all(frame.rx_ns <= frame.t_ns for frame in line.frames)


def test_the_adapters_flags_are_errors(adapter: Adapter, line: Open) -> None:
    for flags in (b"F00\r", b"F09\r", b"F24\r", b"F04\r", b"F00\r"):
        adapter.say(flags)
    health = line.tally.health
    line.take_until(lambda: health.counts.get("recovered", 0) > 0)
    assert health.counts == {"overrun": 1, "passive": 1, "warning": 1, "recovered": 1}
    assert health.state == "active" and health.problem == ""


def test_options_that_only_python_can_knows_go_to_it(adapter: Adapter) -> None:
    port = open_port(adapter.config(timeout=0.001), Clock(), Tally())
    assert isinstance(port, LibraryPort)
    port.close()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"bitrate": 123_000}, "no bit rate 123000; it has 10000, 20000"),
        ({"channel": "/nowhere/ttyACM0"}, "plug the adapter in"),
        ({"options": {"tty_baudrate": 77}}, "no speed 77"),
    ],
)
def test_why_it_cannot_be_opened(adapter: Adapter, change: dict[str, object], words: str) -> None:
    config = adapter.config().model_copy(update=change)
    with pytest.raises((OSError, ValueError)) as caught:
        open_port(config, Clock(), Tally())
    assert words in why_not(caught.value, config)


def test_a_full_bus_comes_through_without_loss(adapter: Adapter) -> None:
    """Paced like the bus, as far as the terminal has room."""
    seconds, clock = 1.5, Clock()
    events: list[str] = []
    buses = Buses([adapter.config()], clock, lambda kind, told: events.append(notice_sentence(told)))
    (live,) = buses.live_buses
    until(lambda: live.connection.port is not None, lambda: buses.read(0.01))
    count = int(FULL_RATE * seconds)

    def play() -> None:
        began = time.monotonic()
        for number in range(count):
            wait = began + number / FULL_RATE - time.monotonic()
            if wait > 0:
                time.sleep(wait)
            os.write(adapter.master, b"T18FF00018%016X\r" % number)

    os.set_blocking(adapter.master, True)
    player = threading.Thread(target=play)
    player.start()
    frames: list[Frame] = []
    until(lambda: live.traffic.frames >= count, lambda: _more(buses, frames))
    player.join()
    buses.close()
    assert [int(f.data.hex(), 16) for f in frames] == list(range(count))
    assert live.tally.garbled == 0
    assert "serial: its frames are stamped by this program, as it reads them" in events


def _more(buses: Buses, frames: list[Frame]) -> None:
    frames += buses.read(0.05)


def test_pulled_and_plugged_in_again_it_is_opened_again(adapter: Adapter) -> None:
    events: list[str] = []
    buses = Buses([adapter.config()], Clock(), lambda kind, told: events.append(notice_sentence(told)))
    (live,) = buses.live_buses
    frames: list[Frame] = []
    until(lambda: live.connection.port is not None, lambda: _more(buses, frames))
    adapter.say(b"t0010\r")
    until(lambda: len(frames) == 1, lambda: _more(buses, frames))
    adapter.pull()
    until(lambda: live.state == "failed", lambda: _more(buses, frames))
    assert (
        live.connection.attempt == 1
    )  # by what reading said, not by its silence: that would have opened it afresh
    until(lambda: "plug the adapter in" in live.problem, lambda: _more(buses, frames))
    adapter.plug()
    until(lambda: live.connection.port is not None, lambda: _more(buses, frames))
    adapter.say(b"t0020\r")
    until(lambda: len(frames) == 2, lambda: _more(buses, frames))
    buses.close()
    adapter.hear(b"C\rS5\rL\rC\r")  # told again what it forgot; closed at the end
    assert live.outages.failures == 1 and live.connection.opened == 2
    assert any("works again after" in text and "(failure 1, opening 2)" in text for text in events)


def test_noise_on_the_line_is_never_more_than_noise(adapter: Adapter, line: Open) -> None:
    rng = np.random.default_rng(3)
    good = b"T18FF000181122334455667788\r"
    alphabet = np.frombuffer(b"Ttrdx0123456789ABCDEFabcdef\r\r\r\a +_-\xff\0", np.uint8)
    for _ in range(2000):
        text = bytearray(good)
        for at in rng.integers(0, len(good), 2):
            text[at] = rng.choice(alphabet)
        adapter.say(bytes(text))
        line.take()
    adapter.say(b"\r" + good + b"t0070\r")
    line.take_until(lambda: line.frames[-1].can_id == 7)
    assert line.frames[-2].data.hex() == "1122334455667788" and line.tally.garbled > 100
    assert all(len(frame.data) <= 8 and frame.can_id <= 0x1FFFFFFF for frame in line.frames)
