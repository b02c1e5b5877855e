"""Live against replay: words for people are no part of identity, everything else is."""

import math
from collections.abc import Callable

import pytest

from tilth.replay.compare import EVENT, Comparison
from tilth.replay.readers.log import Logged
from tilth.schemas.channels import CHANNEL, WORDING
from tilth.schemas.flow import PARAMETERS, Estimate, Event, EventKind, ParameterEstimate, Status
from tilth.schemas.notices import Notice, NoticeCode, in_words, notice
from tilth.schemas.proto import tilth_pb2 as pb
from tilth.schemas.reasons import Advice, AdviceKind, Code, Combination, Reason

TOPIC = "/soil_tire/pem"


def logged() -> pb.SoilTireEstimate:
    reason = Reason(Code.WIDE, numbers=(0.4,))
    rows = tuple(ParameterEstimate(None, None, Status.UNESTIMATED, reason) for _ in PARAMETERS)
    one = Combination((1.0, *[0.0] * 5), 0.1)
    advice = Advice(AdviceKind.NOTHING_HELPS, PARAMETERS[:1], (0.4,))
    estimate = Estimate(7, "pem", "relaxation", rows, (), (None,) * 3, determined=(one,), advice=advice)
    return pb.SoilTireEstimate.FromString(CHANNEL[TOPIC].encode(estimate))


def difference(change: Callable[[pb.SoilTireEstimate], object]) -> str:
    comparison, other = Comparison(), logged()
    change(other)
    comparison.logged(Logged(TOPIC, 7, logged().SerializeToString()))
    comparison.recomputed(TOPIC, 7, other.SerializeToString())
    comparison.finish(truncated=False)
    assert comparison.compared == 1
    return comparison.difference


@pytest.mark.parametrize(
    "change",
    [
        lambda other: setattr(other.parameters[2], "reason", "in other words"),
        lambda other: setattr(other, "advice", ""),
        lambda other: setattr(other, "rule", "another"),
        lambda other: other.determined.append("C_af"),
    ],
)
def test_other_words_are_no_difference(change: Callable[[pb.SoilTireEstimate], object]) -> None:
    assert difference(change) == ""


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda other: setattr(other.parameters[2].why, "code", "no_rtk"), "parameters[2].why.code"),
        (lambda other: other.parameters[2].why.numbers.append(0.1), "parameters[2].why.numbers"),
        (lambda other: setattr(other.advised, "seconds", math.nextafter(0.0, 1.0)), "advised.seconds"),
        (lambda other: setattr(other.combinations[0], "log_sd", 0.2), "combinations[0].log_sd"),
        (lambda other: setattr(other, "rank", 1), "rank"),
    ],
)
def test_another_code_or_number_is_one(change: Callable[[pb.SoilTireEstimate], object], named: str) -> None:
    assert named in difference(change)


def test_the_fields_that_are_words_are_there_and_texts() -> None:
    for name, fields in WORDING.items():
        descriptor = pb.DESCRIPTOR.message_types_by_name[name]
        assert all(descriptor.fields_by_name[field].type == 9 for field in fields)  # a string


SILENCE = notice(NoticeCode.SILENCE, silence_s=12.0)
DISK = notice(NoticeCode.DISK_TROUBLE, why="full")


def event(told: Notice, change: Callable[[pb.Event], object] = lambda sent: None) -> bytes:
    sent = pb.Event.FromString(CHANNEL[EVENT].encode(Event(7, EventKind.GAP, told)))
    change(sent)
    return sent.SerializeToString()


@pytest.mark.parametrize(
    ("live", "again", "named"),
    [
        ([event(SILENCE)], [event(SILENCE)], ""),
        ([event(SILENCE, lambda sent: setattr(sent, "text", "Funkstille"))], [event(SILENCE)], ""),
        ([event(DISK), event(SILENCE), event(in_words("a stone"))], [event(SILENCE)], ""),
        ([event(SILENCE)], [event(notice(NoticeCode.SILENCE, silence_s=13.0))], "number was 12.0, is 13.0"),
        ([event(SILENCE)], [event(notice(NoticeCode.STEPPED_BACK, by_s=12.0))], "notice.code"),
        ([event(SILENCE)], [event(SILENCE, lambda sent: setattr(sent, "kind", "moved"))], "kind"),
        ([event(SILENCE)], [], "not computed again"),
        ([event(DISK)], [event(SILENCE)], "not in the log"),
        ([event(SILENCE, lambda sent: sent.ClearField("notice"))], [event(SILENCE)], ""),  # an old log
        ([event(SILENCE, lambda sent: setattr(sent.notice, "code", "found"))], [event(SILENCE)], ""),
    ],
)
def test_events_of_the_fold_are_compared_without_their_words(
    live: list[bytes], again: list[bytes], named: str
) -> None:
    for live_first in (False, True):
        comparison = Comparison()
        comparison.logged(Logged(TOPIC, 7, logged().SerializeToString()))
        comparison.recomputed(TOPIC, 7, logged().SerializeToString())
        for data in live if live_first else ():
            comparison.logged(Logged(EVENT, 7, data))
        for data in again:
            comparison.recomputed(EVENT, 7, data)
        for data in () if live_first else live:
            comparison.logged(Logged(EVENT, 7, data))
        comparison.finish(truncated=False)
        assert named in comparison.difference and bool(named) == bool(comparison.difference)
