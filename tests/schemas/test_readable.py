"""Texts from outside: nothing of them reaches a terminal as a command, and what can be shown stays."""

import os

from hypothesis import given
from hypothesis import strategies as st

from tilth.schemas.readable import readable


@given(st.text())
def test_what_is_shown_has_an_encoding_and_no_control(text: str) -> None:
    shown = readable(text)
    shown.encode()
    assert not any((ord(c) < 32 and c not in "\t\n") or 127 <= ord(c) < 160 for c in shown)
    assert readable(shown) == shown


@given(st.binary(min_size=1))
def test_so_has_a_file_of_any_name(name: bytes) -> None:
    readable(os.fsdecode(name)).encode()


def test_what_can_be_shown_stays() -> None:
    assert readable("können 測試 a\tb\n") == "können 測試 a\tb\n"
    assert readable("caf\udce9 \x1b[31mred") == r"caf\udce9 \x1b[31mred"
