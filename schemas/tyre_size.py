"""What is printed on the side of a tyre, and how stiff that lets expect it upright."""

import re
from typing import Final, NamedTuple

INCH: Final = 0.0254  # m

_METRIC: Final = re.compile(
    r"^(?:VF|IF|CFO)?\s*(\d{3,4})/(\d{2,3})\s*(?:R|B|D|-)\s*(\d{2}(?:\.\d)?)", re.IGNORECASE
)
_INCHES: Final = re.compile(r"^(\d{1,2}(?:\.\d{1,2})?)\s*(?:R|B|-|/)\s*(\d{2}(?:\.\d)?)", re.IGNORECASE)
_AS_WIDE: Final = (4.0, 45.0)  # inches
_RIMS: Final = (10.0, 54.0)  # inches


class TyreSize(NamedTuple):
    """Of a tyre that is new and not loaded."""

    width: float  # of its section, m
    rim: float  # diameter of the rim, m


def tyre_size(text: str) -> TyreSize:
    """Of "520/85R42", "VF 650/65 R42", "18.4R38", "18.4-38" or "550/60-22.5". What follows the size, as load
    index and speed, is not read.

    Raises ValueError, a sentence, for what is no size.
    """
    if metric := _METRIC.match(text.strip()):
        size = TyreSize(float(metric[1]) / 1e3, float(metric[3]) * INCH)
    elif inches := _INCHES.match(text.strip()):
        size = TyreSize(float(inches[1]) * INCH, float(inches[2]) * INCH)
    else:
        size = TyreSize(0.0, 0.0)
    if not (
        _AS_WIDE[0] <= size.width / INCH <= _AS_WIDE[1] and _RIMS[0] <= round(size.rim / INCH, 6) <= _RIMS[1]
    ):
        raise ValueError(
            f'size = "{text}": give what is printed on the side of the tyre, such as "520/85R42", "18.4R38" '
            'or "550/60-22.5"'
        )
    return size


def upright_stiffness(size: TyreSize, pressure: float) -> float:
    """Of one new tyre on hard ground, N/m. pressure: bar.

    Lines and Murphy (1991), The stiffness of agricultural tractor tyres, Journal of Terramechanics 28:
    measured tyres are within a fifth of it.
    """
    width, rim = size.width / INCH, size.rim / INCH
    return 1e3 * (172.0 - 1.77 * rim + 0.34 * width * rim * pressure)
