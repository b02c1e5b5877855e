"""What is counted of a bus, and what is reported of it once only."""

from dataclasses import dataclass
from typing import cast

import pytest

from tilth.logger.can.live_bus import RENEW_MOST_NS, RENEW_NS, Connection, LiveBus, Outages, Traffic
from tilth.logger.can.port import Port
from tilth.schemas.machine import Bus


@dataclass
class Dropping:
    """As much of a port as is asked here."""

    dropped: int = 0
    renewable: bool = True

    def lost(self) -> int:
        return self.dropped


def test_losses_go_on_over_a_new_port_that_counts_from_zero() -> None:
    traffic, port = Traffic(), Dropping(dropped=3)
    assert traffic.count_lost(cast(Port, port)) == 3 and traffic.count_lost(cast(Port, port)) == 0
    traffic.port_released()
    assert traffic.count_lost(cast(Port, Dropping(dropped=2))) == 2 and traffic.lost == 5


def test_a_rate_is_that_since_the_last_count() -> None:
    traffic = Traffic(frames=100)
    traffic.count_rate(2.0)
    assert traffic.frames_per_s == 50.0
    traffic.frames = 110
    traffic.count_rate(1.0)
    assert traffic.frames_per_s == 10.0


def test_error_frames_are_no_sign_that_the_bus_works() -> None:
    traffic = Traffic(frames=5)
    assert traffic.data_has_come(error_frames=0)
    traffic.frames = 7
    assert not traffic.data_has_come(error_frames=2)


def test_a_silent_bus_is_renewed_ever_more_rarely() -> None:
    connection, silent_ns, waits = Connection(port=cast(Port, Dropping())), 0, []
    for _ in range(6):
        waits.append(connection.renew_ns - silent_ns)
        silent_ns = connection.renew_ns
        assert not connection.wants_renewing(silent_ns - 1) and connection.wants_renewing(silent_ns)
    assert waits[:2] == [RENEW_NS, 2 * RENEW_NS] and waits[-1] == RENEW_MOST_NS
    connection.works()
    assert connection.renew_ns == RENEW_NS
    connection.port = cast(Port, Dropping(renewable=False))
    assert not connection.wants_renewing(silent_ns)


def test_one_failure_counts_once_and_each_reason_is_news_once() -> None:
    outages = Outages()
    for reason, news in (("unplugged", True), ("unplugged", False), ("no driver", True)):
        outages.begin_failure(10)
        assert outages.is_news(reason) is news
    assert outages.failures == 1 and outages.down_ns == 10
    outages.end_failure()
    outages.begin_failure(20)
    assert outages.failures == 2 and outages.is_news("no driver")
    assert outages.is_first("note") and not outages.is_first("note")


@pytest.mark.parametrize("kind", ["opened", "failed"])
def test_a_bus_is_untried_until_its_first_opening_has_ended(kind: str) -> None:
    bus = LiveBus(Bus(name="can0", interface="virtual", channel="x"))
    assert bus.untried
    if kind == "opened":
        bus.connection.adopt(cast(Port, Dropping()), 1)
    else:
        bus.outages.begin_failure(1)
    assert not bus.untried
