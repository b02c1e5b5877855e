"""Titles of PGNs, known or a manufacturer's own."""

import pytest

from tilth.schemas.pgn_table import PGNS
from tilth.schemas.pgn_titles import is_proprietary, title_of


@pytest.mark.parametrize("row", PGNS, ids=lambda row: f"{row.pgn}-{row.manufacturer}")
def test_a_message_that_is_decoded_has_the_title_of_its_row(row: object) -> None:
    pgn, title, manufacturer = (getattr(row, name) for name in ("pgn", "title", "manufacturer"))
    assert title_of(pgn) == title or (manufacturer is not None and is_proprietary(pgn))


@pytest.mark.parametrize(
    ("pgn", "own"),
    [(61183, False), (61184, True), (61185, False), (65279, False), (65280, True), (65535, True),
     (126719, False), (126720, True), (130815, False), (130816, True), (131071, True), (131072, False)],
)  # fmt: skip
def test_ranges_that_a_manufacturer_uses_as_it_likes(pgn: int, own: bool) -> None:
    assert is_proprietary(pgn) is own
    assert title_of(pgn).startswith("a manufacturer's own") is own


def test_what_is_not_known_has_no_title() -> None:
    assert title_of(1) == ""
