"""How the unknowns beside the six are written for people."""

import math

import pytest

from tilth.analysis.runs.nuisance_words import WORDS, nuisance_text, nuisance_value
from tilth.estimator.filters.unknowns import NAMES
from tilth.schemas.flow import PARAMETERS
from tilth.schemas.machine import Machine


def test_every_unknown_has_words() -> None:
    assert set(WORDS) == set(NAMES[len(PARAMETERS) :])


def test_the_keys_exist_in_the_machine_file() -> None:
    for row in WORDS.values():
        if row.key:
            section, name = row.key.split(".")
            kind = Machine.model_fields[section].annotation
            inner = getattr(kind, "__args__", (kind,))[0]
            assert name in inner.model_fields, row.key  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("name", "value", "sd", "text"),
    [
        ("wheel_zero", 0.01, 0.001, "0.57 ± 0.11 °"),
        ("latency", 0.02, 0.005, "20.0 ± 9.8 ms"),
        ("wheel_gain", 0.0, 0.02, "1.000 ± 0.039"),
        ("push_t", -3.0, 0.3, "0.050 (0.028 … 0.090) m/s²"),
        ("lever_t", 0.012, 0.01, "12 ± 20 mm"),
        ("rolling", 0.04, 0.01, "0.040 ± 0.020"),
    ],
)
def test_nuisances_in_peoples_units(name: str, value: float, sd: float, text: str) -> None:
    assert nuisance_text(name, value, sd) == text
    first, unit = text.split()[0], "" if text[-1].isdigit() else text.split()[-1]
    alone = nuisance_value(name, value)
    assert float(alone.removeprefix("× ").split()[0]) == pytest.approx(
        float(first), rel=0.02
    ) and alone.endswith(unit)


def test_a_ratio_says_that_it_is_one_and_of_what() -> None:
    assert nuisance_value("roll_k_t", math.log(0.63)) == "× 0.63"
    assert (
        "Nm per rad of lean" in WORDS["roll_k_t"].words and "track and deflection" in WORDS["roll_k_i"].words
    )
