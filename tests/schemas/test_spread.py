"""What people are told of an uncertainty is the range of 95 %, everywhere."""

import math
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from paths import ROOT

from tilth.schemas.spread import half_width, interval, of_logarithm, plus_minus, share

FOLDERS = ("schemas", "estimator", "logger", "replay", "client", "monitor", "cli", "examples")
ALLOWED = ("{real}", "{real:.2f}", "amplitude_deg")  # a pair of eigenvalues, an angle of the wheels


@pytest.mark.parametrize(
    ("expected", "text"),
    [
        (plus_minus(1.2, 0.07, "s"), "1.20 ± 0.14 s (95 %)"),
        (plus_minus(-3.0, 0.0), "-3 ± 0 (95 %)"),
        (plus_minus(0.5, 100.0), "0 ± 196 (95 %)"),
        (of_logarithm(220.0, 10.0, "kN/rad"), "220 ± 20 kN/rad (95 %)"),
        (of_logarithm(220.0, 90.0, "kN/rad"), "220 (99 … 491) kN/rad (95 %)"),
        (of_logarithm(0.8, 0.3, "m"), "0.80 (0.38 … 1.67) m (95 %)"),
        (half_width(0.018, "m"), "±0.035 m (95 %)"),
        (share(0.02), "±3.9 % (95 %)"),
        (share(0.1), "±20 % (95 %)"),
        (share(0.4), "-54 … +119 % (95 %)"),
        (share(0.02, 0.4), "±3.9 %, -54 … +119 % (95 %)"),
    ],
)
def test_in_words(expected: str, text: str) -> None:
    assert expected == text


def test_so_many_draws_are_inside() -> None:
    rng = np.random.default_rng(0)
    for log_sd in (0.05, 0.5):
        low, high = interval(200.0, log_sd)
        drawn = 200.0 * np.exp(log_sd * rng.standard_normal(20_000))
        assert np.mean((low < drawn) & (drawn < high)) == pytest.approx(0.95, abs=0.005)


@settings(derandomize=True, max_examples=200, deadline=None)
@given(st.floats(1e-6, 1e7), st.floats(0.0, 5.0))
def test_a_positive_value_has_a_positive_range(value: float, log_sd: float) -> None:
    text = of_logarithm(value, value * log_sd)
    numbers = [float(word) for word in re.findall(r"\d[\d.]*(?:e[+-]?\d+)?", text)]
    assert text.endswith("(95 %)") and all(math.isfinite(number) for number in numbers)
    if "±" in text:
        assert numbers[1] <= numbers[0]


def test_nobody_writes_a_range_by_hand() -> None:
    """A ± beside a number that is made while it runs comes from the one place that says 95 %."""
    by_hand = []
    for folder in FOLDERS:
        for path in (ROOT / folder).rglob("*.py"):
            lines = path.read_text(encoding="utf-8").splitlines()
            by_hand += [
                f"{path.relative_to(ROOT)}:{number}: {line.strip()}"
                for number, line in enumerate(lines, 1)
                if re.search(r"±\s*\{|±\"|1\.96", line) and path.name != "spread.py"
            ]
    assert [line for line in by_hand if not any(word in line for word in ALLOWED)] == []
