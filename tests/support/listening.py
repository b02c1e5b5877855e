"""Buses with what they gave and reported, for the tests of them."""

from collections.abc import Callable

import can
from loopback import GROUP, until

from tilth.logger.can.bus_opening import open_port
from tilth.logger.can.buses import Buses
from tilth.logger.can.live_bus import LiveBus
from tilth.logger.can.port_threads import Opener
from tilth.logger.clock import Clock
from tilth.schemas.flow import Frame
from tilth.schemas.machine import Bus
from tilth.schemas.notices import Notice, NoticeCode
from tilth.schemas.sentences import notice_sentence


def udp(name: str, port: int) -> Bus:
    return Bus(name=name, interface="udp_multicast", channel=GROUP, options={"port": port, "hop_limit": 0})


def virtual(name: str) -> Bus:
    return Bus(name=name, interface="virtual", channel=f"tilth-{name}")


class Listening:
    """Buses, opened or failed, with what they gave and reported."""

    def __init__(
        self, *configs: Bus, serve: Callable[[], None] = lambda: None, opener: Opener = open_port
    ) -> None:
        self.serve = serve
        self.events: list[str] = []
        self.stamps: list[str] = []  # events that tell who stamps the frames
        self.frames: list[Frame] = []
        self.clock = Clock()
        self.buses = Buses(configs, self.clock, self._report, opener)
        self.settle()

    def _report(self, kind: str, told: Notice) -> None:
        rows = self.stamps if told.code is NoticeCode.BUS_STAMPED else self.events
        rows.append(f"{kind}: {notice_sentence(told)}")

    @property
    def live_buses(self) -> list[LiveBus]:
        return self.buses.live_buses

    def turn(self) -> None:
        self.serve()
        self.frames += self.buses.read(0.02)

    def until(self, condition: Callable[[], bool]) -> None:
        until(condition, self.turn)

    def until_frames(self, count: int) -> None:
        self.until(lambda: len(self.frames) == count)

    def settle(self) -> None:
        self.until(lambda: not any(live.connection.opening for live in self.live_buses))

    def watch(self, ahead_ns: int = 0) -> None:
        """As if so much time had gone by."""
        self.buses.watch(self.clock.t_ns() + ahead_ns)


def data_frame(number: int = 0) -> can.Message:
    return can.Message(arbitration_id=0x18FF0001, is_extended_id=True, data=number.to_bytes(8, "little"))
