"""Finds devices that smooth their turn rate, from heading and turn rate, without a machine file."""

import math
from dataclasses import dataclass, field
from typing import Final

from tilth.estimator.pose.turn_rate_lag import Lag, regress, time_constant, update_verdict
from tilth.estimator.rig.geometry import wrap
from tilth.schemas.flow import Message, Origin
from tilth.schemas.spread import plus_minus

INTERVAL_NS: Final = 2_000_000_000
LONGEST_NS: Final = 1_000_000_000  # between two turn rates, or from one to a heading
HEADING_SD: Final = math.radians(0.5)  # until the data tell it


@dataclass(slots=True)
class _TurnRateSender:
    origin: Origin
    lag: Lag = field(default_factory=Lag)
    heading: float = 0.0  # rad, where the interval began
    began_ns: int = 0  # 0: none has begun
    rate_ns: int = 0  # of the last turn rate; 0: none


class TurnRates:
    """`take` every message in its order, then ask who is `smoothed`."""

    def __init__(self) -> None:
        self._senders: dict[tuple[str, int], _TurnRateSender] = {}

    def take(self, message: Message) -> None:
        """Take a message with a heading, a turn rate or both."""
        heading, rate = message.values.get("heading_rad"), message.values.get("yaw_rate_radps")
        if heading is None and rate is None:
            return
        origin = message.origin
        sender = self._senders.setdefault((origin.bus, origin.source), _TurnRateSender(origin))
        sender.origin = origin
        if rate is not None:
            _turn(sender, message.rx_ns, float(rate))
        if heading is not None:
            _face(sender, message.rx_ns, float(heading))

    def smoothed(self) -> dict[tuple[str, int], tuple[float, float]]:
        """(bus, address) -> (time constant, its sd), s, of those whose turn rate is smoothed."""
        return {
            place: time_constant(sender.lag)
            for place, sender in sorted(self._senders.items())
            if sender.lag.smoothed
        }

    def sentences(self) -> list[str]:
        """The same, a sentence each."""
        return [
            f"address {source} on {bus}: {in_words(lag)}" for (bus, source), lag in self.smoothed().items()
        ]


def in_words(lag: tuple[float, float]) -> str:
    """(time constant, its sd), s, as a phrase."""
    return (
        f"its turn rate lags by {plus_minus(*lag, 's')} behind its heading: it is "
        "smoothed and will not be used; turn its smoothing off"
    )


def _turn(sender: _TurnRateSender, rx_ns: int, rate: float) -> None:
    lag = sender.lag
    apart_ns = rx_ns - sender.rate_ns
    if not 0 <= apart_ns <= LONGEST_NS:
        sender.began_ns = 0
    elif sender.began_ns:
        since_ns = rx_ns - max(sender.rate_ns, sender.began_ns)
        lag.integral += (lag.rate + rate) / 2 * since_ns * 1e-9
    lag.rate, sender.rate_ns = rate, rx_ns


def _face(sender: _TurnRateSender, rx_ns: int, heading: float) -> None:
    lag = sender.lag
    since_ns = rx_ns - sender.rate_ns
    if not sender.rate_ns or not 0 <= since_ns <= LONGEST_NS:
        sender.began_ns = 0
        return
    passed_ns = rx_ns - sender.began_ns
    if sender.began_ns and not 0 <= passed_ns <= 2 * INTERVAL_NS:
        sender.began_ns = 0
    if sender.began_ns and passed_ns < INTERVAL_NS:
        return
    if sender.began_ns:
        lag.integral += lag.rate * min(since_ns, passed_ns) * 1e-9
        regress(lag, wrap(heading - sender.heading), passed_ns * 1e-9, HEADING_SD)
        update_verdict(lag)
    sender.began_ns, sender.heading = rx_ns, heading
    lag.integral, lag.first_rate = 0.0, lag.rate
