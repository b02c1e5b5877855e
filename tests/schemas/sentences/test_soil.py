"""Words of the soil: soft, firm or as usual only where all of the interval says so."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tilth.schemas import spread
from tilth.schemas.flow import Status
from tilth.schemas.sentences.soil import FIRM, SOFT, USUAL, soil_words


@pytest.mark.parametrize(
    ("ratio", "sd", "status", "word"),
    [
        (0.6, 0.1, 1, "soft"), (0.6, 0.25, 1, "between soft and usual"), (0.88, 0.001, 1, "soft"),
        (0.91, 0.001, 1, "as usual"), (1.0, 0.1, 1, "as usual"), (1.0, 0.25, 1, "known roughly"),
        (1.09, 0.001, 1, "as usual"), (1.2, 0.01, 1, "firm"), (1.2, 0.1, 1, "as usual"),
        (2.0, 0.5, 1, "between usual and firm"), (0.6, 0.1, 0, "not known yet"),
        (0.6, 0.1, 2, "not known now"),
        (0.6, 0.1, 3, "withdrawn"), (None, None, 1, "not known yet"),
    ],
)  # fmt: skip
def test_how_the_soil_holds_the_tyres(ratio: float | None, sd: float | None, status: int, word: str) -> None:
    value = None if ratio is None else 200e3 * ratio
    within = None if sd is None else spread.WITHIN * sd
    assert soil_words(value, within, status, 200e3)["word"] == word
    if word not in ("withdrawn", "not known now"):
        assert soil_words(value, within, status, None)["word"] == "not known yet"  # of no rig


@settings(derandomize=True, deadline=None)
@given(st.floats(0.01, 100.0), st.floats(1e-4, 3.0))
def test_a_word_is_said_only_where_all_of_the_interval_agrees(ratio: float, within: float) -> None:
    low, high = ratio * math.exp(-within), ratio * math.exp(within)
    word = soil_words(ratio, within, Status.ESTIMATED, 1.0)["word"]
    assert (word == "soft") == (high < SOFT) and (word == "firm") == (low > FIRM)
    assert word != "as usual" or USUAL[0] <= low <= high <= USUAL[1]
