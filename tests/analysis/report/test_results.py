"""Fits, predictions, tests of residuals and responses: sections of plain data, and none without data."""

import math
from typing import Any

import pytest
from report_parts import WHY, fit, held_out, residuals, response

from tilth.analysis.report.answered import TABLE_ROWS, drawn, response_section
from tilth.analysis.report.checked import held_out_section, residuals_section
from tilth.analysis.report.document import HELD_OUT, ReportFigure, ReportTable, ReportText, parts_of
from tilth.analysis.report.fitted import fit_section


def table(section: Any) -> ReportTable:
    return tables(section)[0]


def tables(section: Any) -> list[ReportTable]:
    return [one for one in parts_of((section,)) if isinstance(one, ReportTable)]


def texts(section: Any) -> list[str]:
    return [one.text for one in parts_of((section,)) if isinstance(one, ReportText)]


def test_fits_by_segment_and_together() -> None:
    section = fit_section(fit())
    rows = [[cell.text for cell in row] for row in table(section).rows]
    assert [row[0] for row in rows] == ["s1", "s2", "s3", "all together"]
    assert rows[0][1:5] == ["30.0", "58.0", "step", "231 ± 54"] and rows[3][4] == "220 ± 22"
    assert rows[2][9] == "unestimated"
    assert texts(section)[0] == "The segments agree within their uncertainty."
    assert f"sigma_i of s3: {WHY}." in texts(section)


def test_fits_without_a_joint_one() -> None:
    section = fit_section(fit() | {"joint": None, "agreement": None})
    assert section is not None and [one.id for one in section.sections] == ["fit-published"]
    assert len(table(section).rows) == 3


def test_held_out_cells_are_marked_in_words() -> None:
    rows = table(held_out_section(held_out())).rows
    assert [cell.mark == HELD_OUT for cell in rows[0][1:]] == [False, False, True, True, True, True]
    assert all((cell.mark == HELD_OUT) == ("held out" in cell.text) for row in rows for cell in row)
    assert rows[2][0].text == "s1, s2, s3" and rows[0][3].value == pytest.approx(0.41)
    assert "3 predictions of drives that were not fitted" in texts(held_out_section(held_out()))[0]


def test_outputs_are_shown_in_their_units_where_they_were_looked_at() -> None:
    assert len(tables(held_out_section(held_out()))) == 1
    found = held_out()
    found["subsets"][-1]["cells"][0] |= {
        "fit_percent": {"yaw_rate": 95.5, "heading": None},
        "horizon_rms": {"1": {"yaw_rate": math.radians(0.4)}, "5": {"yaw_rate": math.radians(0.5)}},
        "gain": 875.0,
    }
    _, outputs = tables(held_out_section(found))
    assert outputs.columns[2:] == (
        "fit of yaw rate, %", "yaw rate 1 s ahead, °/s", "yaw rate 5 s ahead, °/s", "log-likelihood gain",
    )  # fmt: skip
    assert [cell.value for cell in outputs.rows[0][2:]] == pytest.approx([95.5, 0.4, 0.5, 875.0])
    assert outputs.rows[0][0].text == "all" and len(outputs.rows) == 1


@pytest.mark.parametrize(("together_m", "told"), [(0.2, "averages out"), (0.9, "whether the segments agree")])
def test_it_says_why_all_together_predict_better_or_worse_than_one(together_m: float, told: str) -> None:
    found = held_out()
    for subset in found["subsets"]:
        for cell in subset["cells"]:
            if cell["held_out"] and len(subset["fitted"]) == 2:
                cell["tractor_m"] = together_m
    (_, words) = texts(held_out_section(found))
    assert told in words and f"{together_m:.2f} m by that of all others" in words
    del found["subsets"][1]
    assert len(texts(held_out_section(found))) == 1


def test_a_prediction_that_failed_has_no_number() -> None:
    found = held_out()
    found["subsets"][0]["cells"][1] |= {"tractor_m": None, "implement_m": None}
    assert table(held_out_section(found)).rows[0][3].text == "– (held out)"


def test_segments_that_do_not_agree_predict_nothing_and_stand_in_groups() -> None:
    found = held_out()
    found["subsets"].append({"fitted": ["s1", "s2"], "cells": [], "refused": "these segments do not agree"})
    section = held_out_section(found)
    assert len(table(section).rows) == len(table(held_out_section(held_out())).rows)
    assert "Nothing is predicted from segments that do not agree: s1, s2." in texts(section)
    told = fit()
    told["groups"] = [
        {**told["joint"], "segments": ["s1", "s2"], "name": "s1 to s2"},
        {**told["joint"], "segments": ["s3"], "name": "s3"},
    ]
    names = [row[0].text for row in table(fit_section(told)).rows]
    assert names[-2:] == ["together: s1 to s2", "all together"] and "together: s3" not in names


def test_published_values_stand_beside_the_fit_with_their_sources() -> None:
    section = fit_section(fit())
    assert section is not None
    (beside,) = (one for one in section.sections if one.id == "fit-published")
    rows = table(beside).rows
    assert (
        rows[0][0].text == "this fit"
        and rows[1][1].text == "90.0 ± 9.8"
        and rows[1][7].text.startswith("Table")
    )
    assert any("Iowa State University" in text for text in texts(beside))


def test_residuals() -> None:
    section = residuals_section(residuals())
    failed, why = texts(section)
    assert failed == "Not passed: r_t (one step ahead: independent of the wheel angle)."
    assert "another test than the one under Frequency response" in why
    assert [row[3].text for row in table(section).rows] == ["0.300", "< 0.001", "–"]


def test_the_response_in_decibel_and_degrees() -> None:
    first: Any = drawn(response())["outputs"][0]
    assert first["gain_db"][0] == pytest.approx(20 * math.log10(0.9), abs=0.1)
    assert first["gain_low_db"][-1] is None and first["phase_deg"][-1] == pytest.approx(-180.0, abs=20.0)
    assert all(abs(a - b) < 90 for a, b in zip(first["phase_deg"], first["phase_deg"][1:], strict=False))
    assert first["models"][0]["gain_db"][0] == pytest.approx(first["gain_db"][0] + 20 * math.log10(0.8))
    section = response_section(response())
    figures = [one for one in parts_of((section,)) if isinstance(one, ReportFigure)]  # type: ignore[arg-type]
    assert [one.id for one in figures] == ["response-r_t", "response-r_i"]
    assert len(table(section).rows) == TABLE_ROWS and table(section).rows[-1][2].text.startswith("−∞ … ")


def test_only_what_is_excited_is_shown() -> None:
    found = response()
    found["excited"] = [hz < 1.0 for hz in found["hz"]]
    assert max(drawn(found)["hz"]) < 1.0


def test_a_response_that_could_not_be_measured_says_why() -> None:
    section = response_section(response() | {"reason": "nobody steers", "hz": []})
    assert texts(section) == ["Not measured: nobody steers."]


@pytest.mark.parametrize("section", [fit_section, held_out_section, residuals_section, response_section])
def test_nothing_without_data(section: Any) -> None:
    assert section(None) is None
