"""What is printed on tyres, and the stiffness that follows."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tilth.schemas.tyre_size import INCH, tyre_size, upright_stiffness


@pytest.mark.parametrize(
    ("text", "width", "rim"),
    [
        ("520/85R42", 0.52, 42.0),
        ("520/85 R 42 157A8", 0.52, 42.0),
        ("VF650/65R42", 0.65, 42.0),
        ("IF 710/70 R42 173D", 0.71, 42.0),
        ("550/60-22.5", 0.55, 22.5),
        ("18.4R38", 18.4 * INCH, 38.0),
        ("18.4-38", 18.4 * INCH, 38.0),
        (" 7.50-16", 7.5 * INCH, 16.0),
        ("30.5L-32", None, None),
        ("385/65R22.5", 0.385, 22.5),
    ],
)
def test_what_is_printed(text: str, width: float | None, rim: float | None) -> None:
    if width is None or rim is None:
        with pytest.raises(ValueError, match="printed on the side"):
            tyre_size(text)
        return
    assert tyre_size(text) == pytest.approx((width, rim * INCH))


@given(st.text(max_size=12))
def test_any_text_is_a_size_or_a_sentence(text: str) -> None:
    try:
        size = tyre_size(text)
    except ValueError as error:
        assert text in str(error)
    else:
        assert 0.1 <= size.width <= 1.2 and 0.25 <= size.rim <= 1.4


def test_stiffness_is_that_of_measured_tyres() -> None:
    """Lines and Murphy (1991): 200 to 500 kN/m, growing with the pressure by their law."""
    rear = tyre_size("18.4R38")
    assert 300e3 < upright_stiffness(rear, 1.0) < 400e3
    assert upright_stiffness(rear, 1.6) - upright_stiffness(rear, 1.0) == pytest.approx(
        0.6 * 0.34e3 * 18.4 * 38
    )
