"""Parameters as published, what is not determined, and what differs from the machine file."""

from typing import Any

from tilth.analysis.report.document import WARNING, ReportFigure, ReportTable, ReportText, parts_of
from tilth.analysis.report.published import nuisances_section, published_section, values_table
from tilth.schemas.flow import PARAMETERS


def texts(section: Any, kind: str = "") -> list[str]:
    return [
        one.text
        for one in parts_of((section,))
        if isinstance(one, ReportText) and (not kind or one.kind == kind)
    ]


def test_recommended_values_with_intervals(facts: Any) -> None:
    table = values_table(facts, "r")
    assert [cell.text for cell in table.rows[0]] == [
        "C_af, cornering stiffness, front axle", "220 ± 26 kN/rad", "220 (56 … 868) kN/rad", "estimated", "–",
    ]  # fmt: skip
    assert (
        table.rows[5][1].text == "0.90 ± 0.11 m"
        and "Rule: fits of whole manoeuvres: the first of fits of whole manoeuvres that" in table.caption
    )


def test_what_is_not_determined_is_said_with_its_reason(facts: Any) -> None:
    for name in ("sigma_f", "sigma_i"):
        facts["estimates"]["recommended"]["parameters"][name] = {
            "value": None, "sd": None, "status": "unestimated", "reason": "more steering is needed",
        }  # fmt: skip
    section = published_section(facts, "r")
    assert texts(section, WARNING) == ["sigma_f and sigma_i: unestimated: more steering is needed."]
    assert any(t.startswith("What would help: sigma_i is not determined") for t in texts(section))
    figure = next(
        one for one in parts_of((section,)) if isinstance(one, ReportFigure) and one.kind == "correlation"
    )
    assert figure.data["names"] == ["C_af", "C_ar", "C_ai", "sigma_r"]
    table = next(one for one in parts_of((section,)) if isinstance(one, ReportTable))
    assert [cell.text for cell in table.rows[0]][4:] == ["unestimated", "1.50 ± 0.18", "unestimated"]


def test_a_stale_value_is_marked(facts: Any) -> None:
    facts["estimates"]["recommended"]["parameters"]["C_ai"]["status"] = "stale"
    table = next(one for one in parts_of((published_section(facts, "r"),)) if isinstance(one, ReportTable))
    assert table.rows[0][3].text == "170 ± 20 (stale)"


def test_correlations(facts: Any) -> None:
    figure = next(
        one for one in parts_of((published_section(facts, "r"),))
        if isinstance(one, ReportFigure) and one.kind == "correlation"
    )  # fmt: skip
    matrix = figure.data["matrix"]
    assert figure.data["names"] == list(PARAMETERS)
    assert all(abs(matrix[k][k] - 1.0) < 1e-12 for k in range(6)) and abs(matrix[0][1] - 0.2) < 1e-12
    assert "largest in size is 0.20" in figure.description


def test_what_differs_from_the_machine_file_is_named(facts: Any) -> None:
    section = nuisances_section(facts, "r")
    (told,) = texts(section, WARNING)
    assert told.startswith("Wheel-angle reading when straight (wheel_zero): 1.50 ± 0.24 °")
    assert "3.0 of its sd. Look at wheel_angle.zero." in told
    table = next(one for one in parts_of((section,)) if isinstance(one, ReportTable))  # type: ignore[arg-type]
    assert [row[0].text for row in table.rows] == ["wheel_zero", "latency", "rolling"]
    facts["nuisances"] = [one for one in facts["nuisances"] if one["name"] != "wheel_zero"]
    assert "Nothing differs" in texts(nuisances_section(facts, "r"))[0]


def test_a_number_that_the_machine_file_states_as_exact_has_no_distance(facts: Any) -> None:
    facts["nuisances"].append({"name": "m_t", "value": 0.0, "sd": 0.0, "prior": 0.0, "prior_sd": 0.0})
    section = nuisances_section(facts, "r")
    figure = next(one for one in parts_of((section,)) if isinstance(one, ReportFigure))  # type: ignore[arg-type]
    assert "m_t" not in [row["name"] for row in figure.data["rows"]]


def test_a_run_without_estimates(facts: Any) -> None:
    facts |= {"estimates": {}, "nuisances": []}
    assert "holds no estimates" in texts(published_section(facts, "r"))[0]
    assert nuisances_section(facts, "r") is None
