"""Each code has words in each language, of the same values."""

import inspect
import re
from collections.abc import Callable, Mapping
from string import Formatter
from typing import Any

import pytest

from tilth.schemas.notices import NoticeCode
from tilth.schemas.reasons import Code, Reason
from tilth.schemas.sentences import MANOEUVRES, german, notices, reasons, sentence
from tilth.schemas.sentences.soil import SoilWord

TABLES: Mapping[str, Mapping[str, Mapping[Any, Any]]] = {
    "reasons": reasons.LANGUAGES, "diagnoses": reasons.DIAGNOSED, "notices": notices.LANGUAGES,
    "methods": reasons.METHODS,
}  # fmt: skip


@pytest.mark.parametrize("name", TABLES)
def test_each_code_has_words_in_each_language(name: str) -> None:
    languages = TABLES[name]
    assert set(languages) == {"en", "de"}
    for language, rows in languages.items():
        assert set(rows) == set(languages["en"]), language
        for code, words in rows.items():
            english = languages["en"][code]
            assert _needs(words) == _needs(english), (language, code)
            assert words, (language, code)


def _needs(words: str | Callable[..., str]) -> object:
    """What it is made of."""
    if callable(words):
        return [(row.name, row.default) for row in inspect.signature(words).parameters.values()]
    return sorted({f"{name}:{spec}" for _, name, spec, _ in Formatter().parse(words) if name})


def test_all_codes_are_there() -> None:
    assert set(reasons.LANGUAGES["de"]) | set(reasons.DIAGNOSED["de"]) == set(Code)
    assert set(notices.LANGUAGES["de"]) == set(NoticeCode)
    assert set(german.SOIL) == {str(word) for word in SoilWord}
    assert set(german.DRIVEN) == set(MANOEUVRES)


@pytest.mark.parametrize("code", Code)
def test_a_diagnosis_has_the_same_numbers_in_both(code: Code) -> None:
    """A German sentence says no number that the English one lacks."""
    reason = Reason(code, ("wheel_angle.scale", "receiver tractor_front", "pem"), (0.31, 0.52, 0.07, 0.03))
    said = {language: sentence(reason, language) for language in ("en", "de")}
    assert said["de"] and (said["de"] != said["en"] or code is Code.TEXT)
    numbers = {language: re.findall(r"\d+\.\d+", text) for language, text in said.items()}
    assert set(numbers["de"]) == set(numbers["en"]) or code is Code.LITTLE_OWN_STEERING
