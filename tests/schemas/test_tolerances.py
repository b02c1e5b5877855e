"""Each number that a replay must give again has its tolerance, and no other field has one."""

from collections.abc import Iterator
from typing import Any

import pytest
from google.protobuf.descriptor import Descriptor

from tilth.schemas.channels import CHANNEL, CHANNELS
from tilth.schemas.tolerances import TOLERANCES, apart

TOPICS = [channel.topic for channel in CHANNELS if channel.identical or channel.topic == "/event"]


def messages(descriptor: Any) -> Iterator[Descriptor]:
    """A message and those within it."""
    queue, found = [descriptor], set[str]()
    while queue:
        one = queue.pop()
        if one.full_name not in found:
            found.add(one.full_name)
            yield one
            queue += [field.message_type for field in one.fields if field.message_type is not None]


ALL = [one for topic in TOPICS for one in messages(CHANNEL[topic].message.DESCRIPTOR)]
OWN = {one.name: one for one in ALL if one.full_name.startswith("tilth.")}
"""Of those of drawings only what Tilth draws has one."""


@pytest.mark.parametrize("name", sorted(OWN))
def test_every_floating_field_has_its_tolerance(name: str) -> None:
    floating = {field.name for field in OWN[name].fields if field.cpp_type == field.CPPTYPE_DOUBLE}
    assert floating == set(TOLERANCES.get(name, {}))


def test_a_tolerance_is_of_a_message_that_is_published_and_small() -> None:
    assert set(TOLERANCES) <= {one.name for one in ALL}
    assert all(0.0 < tolerance <= 1e-4 for row in TOLERANCES.values() for tolerance in row.values())


@pytest.mark.parametrize(
    ("one", "other", "sd", "expected"),
    [
        (0.5, 0.5 + 1e-6, None, 1e-6),
        (2e5, 2e5 + 0.2, None, 1e-6),
        (2e5, 2e5 + 0.2, 2e4, 1e-5),
        (0.5, 0.6, 0.0, 0.1),
        (-1.0, 1.0, None, 2.0),
    ],
)
def test_a_difference_is_in_the_unit_a_share_or_in_sds(
    one: float, other: float, sd: float | None, expected: float
) -> None:
    assert apart(one, other, sd) == pytest.approx(expected, rel=1e-3) == apart(other, one, sd)
