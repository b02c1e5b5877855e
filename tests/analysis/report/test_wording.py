"""How numbers are written for people."""

import pytest

from tilth.analysis.report import nuisance_words, wording
from tilth.analysis.report.nuisance_words import WORDS, nuisance_text
from tilth.analysis.report.wording import NOTHING
from tilth.estimator.filters.unknowns import NAMES
from tilth.replay.estimates_json import ParameterEntry
from tilth.schemas.flow import PARAMETERS
from tilth.schemas.machine import Machine

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
    assert nuisance_words.WORDS[name].form
