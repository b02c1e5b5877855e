"""What a report says of how well an output is known."""

from typing import Any

import pytest

from tilth.analysis.sensitivity.uncertainty_page import apart, causes, in_words, known_to

PARAMETERS: Any = {"C_af": {"log_sd": 0.3}, "sigma_f": {"log_sd": 0.2}}


@pytest.mark.parametrize(
    ("half", "unit", "said"), [(0.123, "m", "± 0.12 m"), (0.123, "", "± 12 %"), (0.0, "m", "± 0")]
)
def test_half_an_interval(half: float, unit: str, said: str) -> None:
    assert known_to(half, unit).startswith(said)


def test_nothing_is_known_of_what_has_no_interval() -> None:
    assert "±" not in known_to(None, "m")


def test_causes_come_with_the_largest_first_and_small_ones_are_left_out() -> None:
    shares = {"C_af": 0.2, "sigma_f": 0.7, "C_ar": 0.01, "C_ai": None}
    output: Any = {"parameters": {name: {"share": share} for name, share in shares.items()}}
    assert causes(output) == "sigma_f 70 %, C_af 20 %"


@pytest.mark.parametrize(
    ("factor", "alone", "said"),
    [
        (None, {}, "nothing is needed"),
        (1.5, {}, "all sds may be 1.5 times as large"),
        (0.5, {"C_af": 0.1, "sigma_f": None}, "or, with the others as they are, C_af to ±20 %"),
        (0.5, {"C_af": 0.4, "sigma_f": None}, "one parameter alone does not bring it there"),
    ],
)
def test_what_must_be_known(factor: float | None, alone: dict[str, float | None], said: str) -> None:
    output: Any = {"wanted": {"half": 0.1, "factor": factor, "alone": alone}, "unit": "m"}
    assert said in in_words("the offset", output, PARAMETERS)


@pytest.mark.parametrize(
    ("half", "first_order", "far"),
    [(0.19, 1.3, True), (1.3, 0.19, True), (0.19, 0.2, False), (None, 1.0, False), (0.2, None, False)],
)
def test_a_first_order_that_is_far_off_is_told(
    half: float | None, first_order: float | None, far: bool
) -> None:
    output: Any = {"half": half, "first_order": first_order}
    assert ("take “known to” alone" in apart({"r_t": output})) == far
