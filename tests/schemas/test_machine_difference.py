"""Two machine files that differ: by which keys, as a person wrote them."""

import pytest
from logs import MACHINE, MACHINE_TEXT

from tilth.schemas.machine_difference import differing, differing_keys
from tilth.schemas.machine_toml import parse_machine


@pytest.mark.parametrize(
    ("old", "new", "keys"),
    [
        ("a = 1.7", "a = 1.75", ("tractor.a",)),
        ("a = 1.7", "a = { value = 1.7, sd = 0.5 }", ("tractor.a.sd",)),
        ('name = "A00017000421E240"', "source = 60", ("receiver[1].name", "receiver[1].source")),
        ("a = 1.7", "a = 1.7  # measured again", ()),
    ],
)
def test_the_keys_that_differ_are_named(old: str, new: str, keys: tuple[str, ...]) -> None:
    assert old in MACHINE_TEXT
    other = parse_machine(MACHINE_TEXT.replace(old, new, 1))
    assert differing_keys(MACHINE, other) == differing_keys(other, MACHINE) == keys
    assert differing(MACHINE, other) == (", ".join(keys) or "comments or the order of keys alone")


def test_of_many_the_first_are_told() -> None:
    other = MACHINE.model_copy(update={"receiver": MACHINE.receiver[:1]})
    said = differing(MACHINE, other)
    assert said.startswith("receiver[2].mount, receiver[2].bus, ") and said.endswith(" more")
    assert len(said) < 200
