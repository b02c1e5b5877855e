"""Answers what the soil is like where the rig is not: a get on <prefix>/<machine>/soil_tire/place/at."""

import math
import threading
from collections.abc import Callable
from typing import Final

import zenoh

from tilth.schemas.channels import CHANNEL
from tilth.schemas.flow import Estimate
from tilth.schemas.limiter import Limiter

KEY: Final = "soil_tire/place/at"
MOST: Final = 8  # that are answered at once
EACH: Final = 4  # of them, of one client
FURTHEST: Final = 100_000.0  # m, from the origin of the poses' plane
_CHANNEL: Final = CHANNEL["/soil_tire/place"]


class PlaceAhead:
    """`take` it as an answer of the sink, in its threads."""

    def __init__(self, estimate_at: Callable[[float, float], Estimate]) -> None:
        """estimate_at: of x and y, m; changes nothing."""
        self._estimate_at = estimate_at
        self._limiter = Limiter(MOST, EACH, "places asked for", threading.Lock())

    def take(self, query: zenoh.Query, client: str) -> None:
        """Answer with a SoilTireEstimate, or with why not. client: who asks."""
        if "*" in str(query.key_expr):
            return
        if refused := self._limiter.enter(client):
            query.reply_err(refused)
            return
        try:
            place = _place(query.parameters)
            if place is None:
                query.reply_err(f"give x and y of a place, m, within 100 km: {KEY}?x=12.5;y=-3")
                return
            data = _CHANNEL.encode(self._estimate_at(*place))
            query.reply(query.key_expr, data, encoding=zenoh.Encoding(_CHANNEL.encoding))
        finally:
            self._limiter.leave(client)


def _place(parameters: zenoh.Parameters) -> tuple[float, float] | None:
    try:
        x, y = (float(parameters.get(name) or math.nan) for name in "xy")
    except ValueError:
        return None
    return (x, y) if math.hypot(x, y) <= FURTHEST else None
