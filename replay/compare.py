"""Compares what a replay computes with what was logged live: byte for byte where the arithmetic is the same,
else each number within its tolerance and all else equal (schemas/tolerances.py)."""

import itertools
import math
from collections import deque
from collections.abc import Iterator, Mapping
from typing import Any, Final, NamedTuple

from google.protobuf.message import Message as ProtoMessage

from tilth.logger.log.software import computed_elsewhere
from tilth.replay.readers.log import Logged
from tilth.schemas.channels import CHANNEL, CHANNELS, without_wording
from tilth.schemas.notices import OF_FOLD, NoticeCode
from tilth.schemas.proto import tilth_pb2 as pb
from tilth.schemas.tolerances import OF_SD, TOLERANCES, apart

EVENT: Final = "/event"
IDENTICAL: Final = frozenset(channel.topic for channel in CHANNELS if channel.identical)
COMPARED: Final = IDENTICAL | {EVENT}
"""Of events, those that the fold makes; all others are of a daemon, or of a person."""
CODES: Final = frozenset(NoticeCode)

LONGEST_VALUE: Final = 200  # characters of it that are shown

_Row = tuple[int, bytes]  # t_ns, payload


class FieldDifference(NamedTuple):
    """A field whose value is not the one that was logged."""

    field: str  # with the topic and the fields round it
    was: str
    now: str
    amount: float = math.inf  # as tolerances.apart; infinite for what is no number
    tolerance: float = 0.0

    def __str__(self) -> str:
        far = f", beyond the {self.tolerance:g} that another computer may differ by" if self.tolerance else ""
        return f"{self.field} was {self.was}, is {self.now}{far}"


class Comparison:
    """Takes results from both sides in their order; `difference` is the first one, in a sentence.

    Topic by topic: how results of several frames interleave in the file is not compared. A frame and its
    results stand in one file, so that nothing waits beyond the end of a log. Behind a gap nothing can be
    compared until a stored state tells what the fold was: `unverifiable` counts those results. Events of logs
    that have no codes, or others than this version, are not compared.
    """

    def __init__(self) -> None:
        self.compared = 0
        self.difference = ""
        self.unverifiable = 0
        self.elsewhere = ""  # what there was other where logs were recorded; "": nothing
        self.to_the_byte = 0  # of those compared
        self.ties = 0  # fits whose logged result was used, since the one here is as good
        self.turned = 0  # decisions of the log that were used though rounding turns them here
        self.largest: FieldDifference | None = None  # of those within their tolerance, beside that tolerance
        self._exact = True
        self._on_track = True
        self._any_live = False  # whether a result was in the logs
        self._topics = set(COMPARED)
        self._live: dict[str, deque[_Row]] = {topic: deque() for topic in COMPARED}
        self._again: dict[str, deque[_Row]] = {topic: deque() for topic in COMPARED}

    def recorded_by(self, software: Mapping[str, str]) -> bool:
        """What follows was computed by this (metadata "tilth" of its log). Whether that is elsewhere."""
        other = computed_elsewhere(software)
        self._exact = not other
        self.elsewhere = self.elsewhere or other
        return bool(other)

    def logged(self, row: Logged) -> None:
        """Take a result that was logged live."""
        if row.topic == EVENT and not self._tells(row.data):
            return
        self._any_live = self._any_live or row.topic in self._topics
        if not self._on_track:
            self.unverifiable += row.topic in self._topics
            return
        self._take(row.topic, (row.t_ns, row.data), self._live, self._again)

    def recomputed(self, topic: str, t_ns: int, data: bytes) -> None:
        """Take a result of the replay."""
        if topic in self._topics and self._on_track and (topic != EVENT or _of_fold(data)):
            self._take(topic, (t_ns, data), self._again, self._live)

    def _tells(self, data: bytes) -> bool:
        """Whether a logged event is one of the fold's."""
        code = pb.Event.FromString(data).notice.code
        if code not in CODES:
            self._topics.discard(EVENT)
            self._again[EVENT].clear()
            self._live[EVENT].clear()
        return EVENT in self._topics and _of_fold(data)

    def lose_track(self) -> None:
        """Messages are missing in the log: frames, results, or what else enters the fold."""
        if self._on_track:
            self.finish(truncated=True)
        self._on_track = False

    def find_track(self) -> None:
        """The fold goes on from a state that was stored live."""
        self._on_track = True

    def finish(self, truncated: bool) -> None:
        """At the end of each log. One that was cut may lack results of its last frames."""
        for topic in sorted(COMPARED):
            live, again = self._live[topic], self._again[topic]
            if live and not self.difference:
                self.difference = f"{topic}: logged at {_seconds(live[0][0])}, not computed again"
            if again and not self.difference and not self._any_live:
                self.difference = "these logs hold no results, so there is nothing to compare with"
            if again and not self.difference and not truncated:
                self.difference = f"{topic}: computed for {_seconds(again[0][0])}, not in the log"
            live.clear()
            again.clear()

    def _take(
        self,
        topic: str,
        row: _Row,
        waiting_here: dict[str, deque[_Row]],
        waiting_there: dict[str, deque[_Row]],
    ) -> None:
        if self.difference:
            return
        waiting = waiting_there[topic]
        if not waiting:
            waiting_here[topic].append(row)
            return
        self.compared += 1
        opposite = waiting.popleft()
        if row == opposite:
            self.to_the_byte += 1
            return
        live, again = (row, opposite) if waiting_here is self._live else (opposite, row)
        self.difference = self._weigh(topic, live, again)

    def _weigh(self, topic: str, live: _Row, again: _Row) -> str:
        """The difference in a sentence; "" where only words for people differ, or no more than may."""
        if live[0] != again[0]:
            return f"{topic}: logged at {_seconds(live[0])}, computed again for {_seconds(again[0])}"
        message = CHANNEL[topic].message
        one, other = (without_wording(message.FromString(data)) for _, data in (live, again))
        if isinstance(one, pb.FitOutcome) and not (self._exact and one.result):  # older logs have none
            for name, outcome in itertools.product(("result", "job_sha256"), (one, other)):
                outcome.ClearField(name)
        for found in _deviations(one, other):
            if self._exact or not found.amount <= found.tolerance:
                return f"{topic} at {_seconds(live[0])}: {found}"
            least = self.largest
            if least is None or found.amount * least.tolerance > least.amount * found.tolerance:
                self.largest = found._replace(field=f"{topic} {found.field}")
        same = one.SerializeToString() == other.SerializeToString()
        if same or not self._exact:
            return ""
        return f"{topic} at {_seconds(live[0])}: same values in other bytes"


def _of_fold(event: bytes) -> bool:
    return pb.Event.FromString(event).notice.code in OF_FOLD


def _deviations(live: ProtoMessage, again: ProtoMessage, within: str = "") -> Iterator[FieldDifference]:
    """The fields that differ, also of the messages within."""
    for field in live.DESCRIPTOR.fields:
        a, b = getattr(live, field.name), getattr(again, field.name)
        alike = _present(live, field) == _present(again, field)
        if alike and a == b:
            continue
        name = within + field.name
        if field.is_repeated and len(a) == len(b):
            for index, (x, y) in enumerate(zip(a, b, strict=True)):
                if x != y:
                    yield from _values(live, field, f"{name}[{index}]", x, y)
        elif alike and not field.is_repeated:
            yield from _values(live, field, name, a, b)
        else:
            yield FieldDifference(name, _formatted(live, field, a), _formatted(again, field, b))


def _values(message: ProtoMessage, field: Any, name: str, live: Any, again: Any) -> Iterator[FieldDifference]:
    if isinstance(live, ProtoMessage):
        yield from _deviations(live, again, name + ".")
    elif isinstance(live, float):
        tolerance = TOLERANCES.get(field.containing_type.name, {}).get(field.name, 0.0)
        sd = getattr(message, "sd", None) if tolerance == OF_SD else None
        yield FieldDifference(name, repr(live), repr(again), apart(live, again, sd), tolerance)
    else:
        yield FieldDifference(name, repr(live)[:LONGEST_VALUE], repr(again)[:LONGEST_VALUE])


def _present(message: ProtoMessage, field: Any) -> bool:
    return message.HasField(field.name) if field.has_presence else True


def _formatted(message: ProtoMessage, field: Any, value: Any) -> str:
    if not _present(message, field):
        return "absent"
    if field.is_repeated:
        return f"{len(value)} long"
    return "there" if isinstance(value, ProtoMessage) else repr(value)


def _seconds(t_ns: int) -> str:
    return f"{t_ns // 1_000_000_000}.{t_ns % 1_000_000_000:09d} s"
