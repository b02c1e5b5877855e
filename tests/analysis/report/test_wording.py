"""How numbers are written for people."""

import pytest

from tilth.analysis.report import wording
from tilth.analysis.report.wording import NOTHING
from tilth.replay.estimates_json import ParameterEntry

UNKNOWN: ParameterEntry = {"value": None, "sd": None, "status": "invalid", "reason": ""}


@pytest.mark.parametrize(
    ("told", "text"),
    [
        (wording.parameter_text("C_af", 220e3, 10e3, True), "220 ± 20 kN/rad"),
        (wording.parameter_text("sigma_r", 1.5, 0.5), "1.50 (0.78 … 2.88)"),
        (wording.parameter_text("C_af", None, None), NOTHING),
        (wording.number(0.0456), "0.0456"),
        (wording.number(0.0), "0.00"),
        (wording.number(1234567.0), "1 234 567"),
        (wording.number(None), NOTHING),
        (wording.fixed(2.345, 1, "m/s"), "2.3 m/s"),
        (wording.probability(2e-5), "< 0.001"),
        (wording.degrees(-0.1), "-5.7°"),
        (wording.seconds(59.6), "60 s"),
        (wording.seconds(3725.0), "1 h 02 min"),
        (wording.seconds(185.0), "3 min 05 s"),
        (wording.distance(999.0), "999 m"),
        (wording.distance(12345.0), "12.35 km"),
        (wording.many(1, "gap"), "1 gap"),
        (wording.listed(["a", "b", "c"]), "a, b and c"),
        (wording.listed([]), ""),
        (wording.clock(1_700_000_000.0), "22:13:20"),
        (wording.parameter_cell("C_ai", UNKNOWN).text, "invalid"),
    ],
)
def test_texts(told: str, text: str) -> None:
    assert told == text
