"""Tables of a rig say what its report says."""

import io
import re

import pytest
from rich.console import Console

from tilth.analysis.rig_report import LINEAR, Drive, rig_report
from tilth.analysis.rig_tables import rig_in_words, rig_tables
from tilth.estimator.models.parameters import TABLE_5_1, TABLE_7_2, Rig


@pytest.mark.parametrize("rig", [TABLE_5_1, TABLE_7_2])
def test_every_model_and_speed_has_its_row(rig: Rig) -> None:
    report = rig_report(rig, LINEAR, (1.0, 4.5), Drive(seconds=2.0))
    console = Console(width=200, file=io.StringIO(), record=True)
    for part in rig_tables("a rig", report):
        console.print(part)
    text = console.export_text()
    for model in LINEAR:
        assert re.search(rf"^ *{model.name} +1\.0 ", text, re.M), text
    assert "nan" not in text.lower().split() and "None" not in text


def test_words_follow_the_rig() -> None:
    said = [rig_in_words("a rig", rig_report(rig, LINEAR, (4.5,), Drive(seconds=2.0)))
            for rig in (TABLE_7_2, TABLE_7_2._replace(m_t=2.0 * TABLE_7_2.m_t))]  # fmt: skip
    assert said[0] != said[1] and f"{TABLE_7_2.m_t:.0f}" in said[0].replace(",", "")
