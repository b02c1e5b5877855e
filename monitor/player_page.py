"""Recorded runs as the page lists them and orders them to be played: JSON of messages of a player."""

import math
from typing import Final

from tilth.client.received import Refused, estimate_of, text
from tilth.monitor.daemon_data import DaemonData
from tilth.monitor.json_safe import plain
from tilth.monitor.page_estimate import row
from tilth.schemas.flow import PARAMETERS
from tilth.schemas.proto import tilth_pb2 as pb

ORDERS: Final = frozenset({"open", "play", "pause", "seek", "rate"})
MOST_RUNS: Final = 2000
MOST_PLACES: Final = 1000
LARGEST: Final = 1e12  # number that a page may send
_ENCODING: Final = "application/protobuf;tilth.SoilTireEstimate"
Fields = dict[str, object]


def order_of(said: Fields) -> pb.PlayerOrder:
    """What a page has sent. Raises ValueError in a person's words."""
    kind, run = said.get("order"), said.get("run", "")
    if not isinstance(kind, str) or kind not in ORDERS or not isinstance(run, str):
        raise ValueError("an order is open, play, pause, seek or rate")
    at_s, rate = (_number(said.get(name, 0.0)) for name in ("at_s", "rate"))
    return pb.PlayerOrder(kind=kind, run=run[:200], at_s=at_s, rate=rate)


def _number(said: object) -> float:
    """Raises ValueError."""
    if isinstance(said, int | float) and not isinstance(said, bool) and abs(said) < LARGEST:
        return float(said)
    raise ValueError("a time and a rate are numbers")


def runs_of(daemon_data: DaemonData) -> list[Fields]:
    """Not in the loop's own thread. Raises Refused."""
    return [_run(one) for one in daemon_data.ask_player("runs", pb.RunListings).rows[:MOST_RUNS]]


def places_of(daemon_data: DaemonData) -> Fields:
    """Not in the loop's own thread. Raises Refused."""
    found = daemon_data.ask_player("places", pb.Places)
    rows = [
        {"at_s": _finite(one.at_s), "t_ns": one.t_ns, "kind": text(one.kind), "text": text(one.text)}
        for one in found.rows[:MOST_PLACES]
    ]
    return {"run": text(found.run), "places": rows}


def _run(one: pb.RunListing) -> Fields:
    found: Fields = {
        "name": text(one.name),
        "began": text(one.began),
        "length_s": _finite(one.length_s),
        "machine": text(one.machine),
        "notes": [text(note) for note in one.notes[:20]],
        "state": text(one.state),
        "simulated": one.simulated,
        "learned": _learned(one.learned) if one.HasField("learned") else [],
    }
    place = (one.latitude_deg, one.longitude_deg)
    if one.HasField("latitude_deg") and one.HasField("longitude_deg") and all(map(math.isfinite, place)):
        found["place"] = place
    return found


def _learned(estimate: pb.SoilTireEstimate) -> list[Fields]:
    """The parameters that were estimated, as words.row has them."""
    try:
        estimate_of(estimate.SerializeToString(), _ENCODING)
        rows = zip(PARAMETERS, *row(plain(estimate)), strict=True)
    except Refused:
        return []
    names = ("name", "value", "within", "status")
    return [dict(zip(names, one, strict=True)) for one in rows if one[1] is not None]


def _finite(number: float) -> float:
    return number if math.isfinite(number) else 0.0
