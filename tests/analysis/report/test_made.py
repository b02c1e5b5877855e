"""What the report says first, and how it was made."""

from typing import Any

from tilth.analysis.report.document import WARNING, ReportTable, ReportText, parts_of
from tilth.analysis.report.made import made_section, short_section, warnings_of


def test_a_sound_run_has_no_warning(facts: Any) -> None:
    assert warnings_of(facts) == []


def test_what_makes_results_doubtful_comes_first(facts: Any) -> None:
    facts["flags"] = [{"flag": "contradiction:tractor.c", "poses": 30, "share": 0.6, "seconds": 6.0}]
    facts["origin"] |= {"simulated": True, "whole": False, "cut": ["a.mcap"]}
    facts |= {"skipped": ["cut", "damaged_chunk"], "start_utc_s": None}
    facts["events"] += [{**facts["events"][0], "kind": "fault"}, {**facts["events"][0], "kind": "fault"}]
    facts["estimates"]["recommended"]["parameters"]["C_af"]["status"] = "invalid"
    found = warnings_of(facts)
    for text, words in zip(
        found,
        ("tractor.c, in 60 %", "Simulated", "a.mcap has no end", "Damaged parts", "UTC", "2 events “fault”",
         "(invalid): C_af."),
        strict=True,
    ):  # fmt: skip
        assert words in text and text.endswith(".") and not text.endswith("..")
    parts = short_section([facts]).parts
    assert [part.text for part in parts if isinstance(part, ReportText) and part.kind == WARNING] == found
    assert isinstance(parts[0], ReportText) and parts[0].kind == WARNING


def test_sums_versions_and_the_command(facts: Any) -> None:
    section = made_section({"runs": [facts], "command": "tilth report 'a b.mcap'"})
    assert isinstance(section.parts[0], ReportText) and section.parts[0].text.endswith(
        "tilth report 'a b.mcap'"
    )
    cells = [
        cell.text
        for part in parts_of((section,))
        if isinstance(part, ReportTable)
        for row in part.rows
        for cell in row
    ]
    assert facts["origin"]["machine_sha256"] in cells and facts["origin"]["logs"][0]["sha256"] in cells
    assert any("numpy" in cell for cell in cells) and "as recorded, by tilth 0.1.0" in cells
    facts["origin"] |= {"replayed": True, "recorded_with": {}}
    again = made_section({"runs": [facts], "command": ""})
    rows = [row for part in again.parts if isinstance(part, ReportTable) for row in part.rows]
    assert any(cell.text == "replayed for this report" for row in rows for cell in row)
