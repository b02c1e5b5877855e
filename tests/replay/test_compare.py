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
    comparison, other = Comparison(), learned()
    change(other)
    comparison.logged(Logged(TOPIC, 7, learned().SerializeToString()))
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


def elsewhere(change: Callable[[pb.SoilTireEstimate], object]) -> Comparison:
    """Of a log that another kind of processor has written."""
    comparison, live, other = Comparison(), learned(), learned()
    comparison.recorded_by({"arithmetic": "banana"})
    change(other)
    comparison.logged(Logged(TOPIC, 7, live.SerializeToString()))
    comparison.recomputed(TOPIC, 7, other.SerializeToString())
    comparison.finish(truncated=False)
    assert "banana" in comparison.elsewhere and comparison.compared == 1
    return comparison


def learned() -> pb.SoilTireEstimate:
    """With numbers: C_af of 90 000 N/rad with an sd of 4000."""
    message = logged()
    message.parameters[0].value, message.parameters[0].sd, message.condition = 9e4, 4e3, 20.0
    message.nuisances.add(name="zero", value=1e-3, sd=2e-3)
    return message


@pytest.mark.parametrize(
    ("change", "largest"),
    [
        (lambda other: None, None),
        (lambda other: setattr(other.parameters[0], "value", 9e4 + 4e-2), (1e-5, "parameters[0].value")),
        (lambda other: setattr(other.parameters[0], "sd", 4e3 - 4e-3), (1e-6, "parameters[0].sd")),
        (lambda other: setattr(other.nuisances[0], "value", 1e-3 + 1e-8), (5e-6, "nuisances[0].value")),
        (lambda other: setattr(other, "condition", 20.0 * (1.0 + 1e-7)), (1e-7, "condition")),
        (lambda other: setattr(other.combinations[0], "log_sd", 0.1 + 1e-9), (1e-9, "log_sd")),
        (lambda other: setattr(other.parameters[2], "reason", "in other words"), None),
    ],
)
def test_elsewhere_a_number_may_differ_by_its_tolerance(
    change: Callable[[pb.SoilTireEstimate], object], largest: tuple[float, str] | None
) -> None:
    found = elsewhere(change)
    assert found.difference == ""
    if largest is None:
        assert found.largest is None
    else:
        assert found.largest is not None and found.largest.field.endswith(largest[1])
        assert found.largest.amount == pytest.approx(largest[0], rel=1e-3)
    assert difference(change) != "" or largest is None  # on the same processor nothing may


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda other: setattr(other.parameters[0], "value", 9e4 + 4.0), "parameters[0].value"),
        (lambda other: other.parameters[0].ClearField("value"), "parameters[0].value was 90000.0, is absent"),
        (lambda other: setattr(other.nuisances[0], "value", 1.1e-3), "nuisances[0].value"),
        (lambda other: setattr(other.nuisances[0], "value", math.nan), "nuisances[0].value"),
        (lambda other: other.bound.append(1.0), "bound"),
        (lambda other: setattr(other.parameters[0], "status", 3), "parameters[0].status"),
        (lambda other: setattr(other.parameters[2].why, "code", "no_rtk"), "parameters[2].why.code"),
        (lambda other: setattr(other, "rank", 1), "rank"),
        (lambda other: other.ClearField("advised"), "advised was there, is absent"),
        (lambda other: setattr(other, "t_ns", 8), "t_ns"),
    ],
)
def test_elsewhere_a_decision_is_equal_and_so_is_a_number_beyond(
    change: Callable[[pb.SoilTireEstimate], object], named: str
) -> None:
    assert named in elsewhere(change).difference


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
