"""Published values: the product's own table is the dissertation's, units and tyres count, wrong files "
"say what."""

import math

import pytest
from fit_answer import answer

from studies.dissertation import field_tables
from tilth.analysis.fit.published_values import PublishedError, beside, own, parsed
from tilth.schemas.flow import PARAMETERS

ENTRY = """
[source.me]
reference = "Me, My tyres, 2026"
[[entry]]
title = "clay"
source = "me"
"""


def test_the_own_table_is_what_the_study_of_the_dissertation_has() -> None:
    all_runs, second, initial, chapter_5, *hitched = own()
    for entry, numbers in ((second, field_tables.SECOND), (initial, (220, 486, 167, 1.1, 1.5, 1.1))):
        assert [entry.values[name][0] for name in PARAMETERS] == pytest.approx(
            [1e3 * value for value in numbers[:3]] + list(numbers[3:])
        )
        assert {sd for _, sd in entry.values.values()} == {None}
    values, sds = field_tables.ESTIMATES[(1, 2, 3)]
    assert [entry[0] for entry in all_runs.values.values()] == pytest.approx(
        [1e3 * value for value in values[:3]] + list(values[3:])
    )
    assert [entry[1] for entry in all_runs.values.values()] == pytest.approx(
        [1e3 * sd for sd in sds[:3]] + list(sds[3:])
    )
    assert chapter_5.values["sigma_r"] == (1.0, None)
    assert [round(one.values["C_ai"][0], -3) for one in hitched] == [26e3, 194e3]
    assert all(one.source and one.where and one.how for one in own())


@pytest.mark.parametrize(
    ("line", "name", "expected"),
    [
        ('C_af = { value = 90, sd = 5, unit = "kN/rad" }', "C_af", (90e3, 5e3)),
        ('per = "tyre"\nC_af = { value = 45, sd = 5, unit = "kN/rad" }', "C_af", (90e3, 10e3)),
        ('C_ar = { value = 1000, unit = "N/deg" }', "C_ar", (1000 * 180 / math.pi, None)),
        ('per = "tyre"\nsigma_i = { value = 800, unit = "mm" }', "sigma_i", (0.8, None)),
    ],
)
def test_units_and_tyres_count(line: str, name: str, expected: tuple[float, float | None]) -> None:
    (entry,) = parsed(ENTRY + line)
    assert entry.values[name] == pytest.approx(expected) and entry.source == "Me, My tyres, 2026"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("x = [", "no TOML"),
        ("", r"give \[\[entry\]\]"),
        (ENTRY, r"entry\[1\]: no parameter; give some of C_af"),
        (ENTRY + "C_af = 90", r"entry\[1\].C_af: give \{ value = 1.5"),
        (ENTRY + 'C_af = { value = 90, unit = "m" }', "units are kN/rad, N/rad"),
        (ENTRY + 'C_af = { value = -1, unit = "kN/rad" }', "-1 is no number above zero"),
        (ENTRY + 'C_af = { value = 90, sd = true, unit = "kN/rad" }', "True is no number above zero"),
        (ENTRY + 'C_aff = { value = 90, unit = "kN/rad" }', "C_aff: no such key; there are title"),
        (ENTRY.replace('source = "me"', 'source = "you"'), r"give \[source.you\] with its reference"),
        (ENTRY.replace('title = "clay"', "title = 3"), "title: give a text"),
        (ENTRY + 'per = "wheel"', 'per: give "axle" or "tyre"'),
    ],
)
def test_a_wrong_file_says_where_and_what(text: str, says: str) -> None:
    with pytest.raises(PublishedError, match=says):
        parsed(text)


def test_a_fit_stands_beside_each() -> None:
    (entry,) = parsed(
        ENTRY + 'C_af = { value = 100, sd = 10, unit = "kN/rad" }\nsigma_i = { value = 1, unit = "m" }'
    )
    stiffness, length = beside(answer({"C_af": 2e5}), entry)
    assert stiffness.ratio == pytest.approx(2.0)
    assert stiffness.apart == pytest.approx(math.log(2.0) / math.hypot(0.1, 0.1))
    assert length.apart is None and length.ratio == pytest.approx(1.0)
    assert beside(answer() | {"joint": None}, entry) == ()
