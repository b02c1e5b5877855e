"""What was before the place where a recorded run is played, for the page: asked of the player once."""

from bisect import bisect_right
from dataclasses import dataclass, field
from typing import Final

from tilth.client.received import Refused, estimate_of
from tilth.monitor.daemon_data import MESSAGES, DaemonData
from tilth.monitor.in_german import add_german
from tilth.monitor.json_safe import plain
from tilth.monitor.traces import EstimateRow, PoseRow, Traces, estimate_row, pose_row
from tilth.schemas.proto import tilth_pb2 as pb

_ENCODING: Final = "application/protobuf;tilth.{}"
Fields = dict[str, object]


@dataclass(slots=True)
class Overview:
    """Rows and events of a run in their order, each with its place in the run, s."""

    run: str
    at_s: list[float] = field(default_factory=list)  # of the rows
    rows: list[PoseRow | EstimateRow] = field(default_factory=list)
    events: list[tuple[float, Fields]] = field(default_factory=list)

    def traces(self, at_s: float) -> Traces:
        """As if the run had been heard up to there."""
        traces = Traces()
        for row in self.rows[: bisect_right(self.at_s, at_s)]:
            traces.add(row)
        traces.added()
        return traces

    def events_between(self, from_s: float, to_s: float) -> list[Fields]:
        """Later than the first, up to the second with it."""
        return [event for place_s, event in self.events if from_s < place_s <= to_s]


def ask_overview(daemon_data: DaemonData) -> Overview:
    """Not in the loop's own thread. Raises Refused."""
    places = daemon_data.ask_player("overview", pb.Places)
    found = Overview(places.run)
    for row in places.rows:
        try:
            message = MESSAGES[row.kind].FromString(row.data)
            if row.kind == "event":
                found.events.append(
                    (row.at_s, add_german("event", plain(message), row.data, _ENCODING.format("Event")))
                )
                continue
            if row.kind == "soil_tire":
                estimate_of(row.data, _ENCODING.format("SoilTireEstimate"))
                drawn: PoseRow | EstimateRow = estimate_row(plain(message))
            else:
                drawn = pose_row(plain(message))
        except (Refused, ValueError, KeyError, TypeError):
            continue  # a log of another version; what is played is counted
        found.at_s.append(row.at_s)
        found.rows.append(drawn)
    return found
