"""Words for the codes in a NAME."""

from collections.abc import Iterable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tilth.schemas import device_names
from tilth.schemas.device_names import (
    INDUSTRY_GROUPS,
    class_name,
    device,
    function_name,
    manufacturer_name,
    name_parts,
    name_words,
)

AGRICULTURE, MARINE = 2, 4


def test_a_receiver_of_the_demo() -> None:
    parts = name_parts(0xA00017000421E240)
    assert (parts["manufacturer"], parts["function"], parts["industry_group"]) == (33, 23, AGRICULTURE)
    assert device(0xA00017000421E240).startswith("John Deere, ")


@given(st.integers(0, 2**64 - 1))
def test_any_name_has_words_and_none_is_empty(name: int) -> None:
    assert device(name) and all(name_words(name).values())
    assert set(name_words(name)) <= {f"{key}_name" for key in (*name_parts(name), "device_class")}


@pytest.mark.parametrize("table", ["MANUFACTURERS", "FUNCTIONS", "INDUSTRY_GROUPS"])
def test_codes_fit_their_fields(table: str) -> None:
    codes: Iterable[int] = getattr(device_names, table)
    assert max(codes) < {"MANUFACTURERS": 2048, "FUNCTIONS": 256, "INDUSTRY_GROUPS": 8}[table]


def test_what_is_not_known_has_no_word() -> None:
    assert manufacturer_name(2047) == function_name(127, 0, 0) == class_name(127, AGRICULTURE) == ""
    assert MARINE in INDUSTRY_GROUPS
