"""Reasons and advice as records: what goes over the wire comes back as it was."""

from itertools import product

import pytest

from tilth.client.received import estimate_of
from tilth.schemas.channels import CHANNEL
from tilth.schemas.flow import PARAMETERS, Estimate, ParameterEstimate, Status
from tilth.schemas.proto import tilth_pb2 as pb
from tilth.schemas.reasons import Advice, AdviceKind, Code, Combination, Reason
from tilth.schemas.sentences import advice_sentence, sentence

OF, NUMBERS = ("pem", "tracker", "steady_state"), (0.1, 3.0, 16.3, 2.0)


def of_everything(reason: Reason | None, advice: Advice | None) -> Estimate:
    rows = tuple(ParameterEstimate(None, None, Status.UNESTIMATED, reason) for _ in PARAMETERS)
    ratio = Combination((1.0, -1.0, 0.0, 0.5, 0.0, 0.0), 0.2)
    return Estimate(
        7, "pem", "relaxation", rows, (), (None,) * 3, rule=reason, determined=(ratio,), advice=advice
    )


@pytest.mark.parametrize("code", Code)
def test_a_reason_comes_back_from_the_wire_with_its_numbers_and_causes(code: Code) -> None:
    reason = Reason(code, OF, NUMBERS, (Reason(Code.NO_RTK, OF, NUMBERS), Reason(Code.HELD)))
    sent = of_everything(reason, None)
    row = CHANNEL["/soil_tire"]
    heard = estimate_of(row.encode(sent), row.encoding)
    assert (
        heard.parameters == sent.parameters and heard.rule == reason and heard.determined == sent.determined
    )
    message = pb.SoilTireEstimate.FromString(row.encode(sent))
    assert message.parameters[0].reason == message.rule == sentence(reason)


@pytest.mark.parametrize("code", ["", "of_a_later_version", "wide"])
def test_words_stand_where_the_code_is_not_known_or_lacks_its_numbers(code: str) -> None:
    row = CHANNEL["/soil_tire"]
    message = pb.SoilTireEstimate.FromString(row.encode(of_everything(Reason(Code.NO_RTK), None)))
    message.parameters[0].why.CopyFrom(pb.Reason(code=code))
    message.parameters[0].reason = "in other words"
    heard = estimate_of(message.SerializeToString(), row.encoding)
    assert sentence(heard.parameters[0].reason) == "in other words"
    assert heard.parameters[1].reason == Reason(Code.NO_RTK)


@pytest.mark.parametrize(("kind", "many"), list(product(AdviceKind, (1, 2, 6))))
def test_advice_comes_back_and_has_words(kind: AdviceKind, many: int) -> None:
    some = (0.3,) * many
    advice = Advice(kind, PARAMETERS[:many], some, False, 1.5, "chirp", 10.0, 5.0, some, "sigma_r", 0.06)
    row = CHANNEL["/soil_tire"]
    assert estimate_of(row.encode(of_everything(None, advice)), row.encoding).advice == advice
    text = advice_sentence(advice)
    assert ("sigma_r" in text or kind is AdviceKind.TOO_SLOW) and "{" not in text
    assert ("chirp of 5°" in text) == (kind is AdviceKind.MANOEUVRE)
