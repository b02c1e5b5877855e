"""Live against replay: words for people are no part of identity, everything else is."""

import math
from collections.abc import Callable

import pytest

from tilth.replay.compare import Comparison
from tilth.replay.readers.log import Logged
from tilth.schemas.channels import CHANNEL, WORDING
from tilth.schemas.flow import PARAMETERS, Estimate, ParameterEstimate, Status
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
