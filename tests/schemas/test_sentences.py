"""Sentences of codes: every code has one."""

import string

import pytest

from tilth.estimator.models.manoeuvres import MANOEUVRES as DRIVABLE
from tilth.schemas.reasons import Code, Combination, Reason, text_reason
from tilth.schemas.sentences import (
    DIAGNOSES,
    MANOEUVRES,
    SENTENCES,
    combination_words,
    sentence,
)

OF, NUMBERS = ("pem", "tracker", "steady_state"), (0.1, 3.0, 16.3, 2.0)


def filled(code: Code) -> Reason:
    """A reason with all that its sentence may want."""
    return Reason(code, OF, NUMBERS)


@pytest.mark.parametrize("code", Code)
def test_every_code_has_a_sentence(code: Code) -> None:
    text = sentence(filled(code))
    assert text == text.strip() and not text.endswith(".") and "{" not in text
    assert text or code is Code.TEXT


def test_no_two_codes_say_the_same() -> None:
    assert len(set(map(sentence, map(filled, Code)))) == len(Code)
    assert SENTENCES.keys() | DIAGNOSES.keys() == set(Code) and not SENTENCES.keys() & DIAGNOSES.keys()


@pytest.mark.parametrize("code", SENTENCES)
def test_a_sentence_wants_nothing_that_a_reason_has_not(code: Code) -> None:
    fields = {name for _, name, _, _ in string.Formatter().parse(SENTENCES[code]) if name}
    assert {name.partition("[")[0] for name in fields} <= {
        "of",
        "n",
        "keys",
        "seconds",
        "others",
        "others_and",
    }


def test_why_nothing_is_learned_now_and_what_contradicts() -> None:
    now = Reason(Code.NO_STEADY_TURN_YET, because=(Reason(Code.NO_RTK),))
    assert sentence(now) == "no steady turn yet (now: no RTK fix)"
    findings = tuple(map(text_reason, ("one?", "two?")))
    contradicted = Reason(Code.CONTRADICTED, because=tuple(filter(None, findings)))
    assert sentence(contradicted) == "the data contradict the machine file: one?; two?"
    assert sentence(None) == "" and text_reason("") is None
    assert sentence(Reason(Code.NOT_CONFIRMED)).count("(") == 0
    assert "(tractor.a, implement.d)" in sentence(Reason(Code.NOT_CONFIRMED, ("tractor.a", "implement.d")))


def test_what_is_advised_can_be_driven() -> None:
    assert set(MANOEUVRES) <= {row.name for row in DRIVABLE}


@pytest.mark.parametrize(
    ("exponents", "text"),
    [
        ((1.0, 0, 0, 0, 0, 0), "C_af"),
        ((-1.0, 0, 0, 0, 0, 0), "C_af"),
        ((1.0, -1.0, 0, 0, 0, 0), "C_af/C_ar"),
        ((1.0, -1.0, -0.5, 0, 0, 0.3), "C_af·sigma_i^0.3/(C_ar·C_ai^0.5)"),
    ],
)
def test_a_combination_in_words(exponents: tuple[float, ...], text: str) -> None:
    assert combination_words(Combination(exponents, 0.04)) == f"{text} ±7.8 % (95 %)"
