"""A table of which the ordinary run takes a sample; `pytest -m long` takes the rest."""

from collections.abc import Container, Iterable
from typing import Any

import pytest


def sampled(rows: Iterable[Any], ordinary: Container[Any]) -> list[Any]:
    """The rows, for parametrize. ordinary: those that fail where the code is wrong; the others have the same
    code and seconds each."""
    return [row if row in ordinary else pytest.param(row, marks=pytest.mark.long) for row in rows]
