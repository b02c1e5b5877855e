"""The run at a glance: its sentences and tables."""

from typing import Any

from tilth.analysis.report.document import ReportFigure, ReportTable, ReportText, parts_of
from tilth.analysis.report.glance import MOST_ROWS, at_a_glance, contradicted, glance_section


def tables(run: Any) -> dict[str, list[list[str]]]:
    parts = parts_of((glance_section(run, "r"),))
    return {
        part.id: [[cell.text for cell in row] for row in part.rows]
        for part in parts
        if isinstance(part, ReportTable)
    }


def texts(run: Any) -> str:
    return " ".join(
        part.text for part in parts_of((glance_section(run, "r"),)) if isinstance(part, ReportText)
    )


def test_when_where_and_how_far(facts: Any) -> None:
    assert texts(facts).startswith(
        "On 2023-11-14 from 22:13:20 UTC, for 60 s at 52.00000° N, 5.00000° E, with jd7930-parker500."
    )
    facts["driving"] |= {"latitude_deg": -33.5, "longitude_deg": -70.25}
    assert "33.50000° S, 70.25000° W" in texts(facts)
    numbers = dict(tables(facts)["r-numbers"])
    assert numbers["distance driven"] == "240 m" and numbers["median speed while driving"] == "14.4 km/h"
    assert at_a_glance(facts) == "field-1: 240 m in 60 s; found: 1 × step."


def test_a_run_that_does_not_know_utc(facts: Any) -> None:
    facts["start_utc_s"] = None
    assert "On a day that the log does not know" in texts(facts)


def test_sensors_with_their_gaps(facts: Any) -> None:
    facts["sensors"][3] |= {
        "alive_share": 0.9,
        "gaps": {"count": 1, "all_s": 6.0, "longest": [{"start_s": 20.0, "seconds": 6.0}]},
    }
    row = tables(facts)["r-sensors"][3]
    assert row == ["receiver, implement rear", "90.0 %", "5.0", "1", "6.0 s at 20.0 s", "rtk_fixed 100 %"]


def test_shares_are_never_rounded_to_all_or_nothing(facts: Any) -> None:
    facts["driving"]["all_receivers_share"] = 0.9999
    assert dict(tables(facts)["r-numbers"])["poses with all receivers"] == "> 99.9 %"
    facts["flags"] = [{"flag": "late:tractor_front", "poses": 1, "share": 1e-4, "seconds": 0.2}]
    assert tables(facts)["r-flags"] == [["late:tractor_front", "1", "< 0.1 %"]]


def test_segments_and_what_they_tell(facts: Any) -> None:
    (row,) = tables(facts)["r-segments"]
    assert row[:2] == ["1", "step"] and row[5] == "+8.0°" and row[6].startswith("C_af ±10 %, C_ar")
    facts["segments"][0] |= {"kind": "marked", "name": "trial 2", "tells": []}
    (row,) = tables(facts)["r-segments"]
    assert row[1] == "marked: trial 2" and row[6] == "nothing of the six"


def test_events_have_the_numbers_of_the_map(facts: Any) -> None:
    (row,) = tables(facts)["r-events"]
    assert row[0] == "1" and row[3] == "mark"
    (figure, *_) = (
        part for part in parts_of((glance_section(facts, "r"),)) if isinstance(part, ReportFigure)
    )
    assert [event["number"] for event in figure.data["events"]] == [1] and len(
        figure.data["soil_changes"]
    ) == 1
    (change,) = tables(facts)["r-soil"]
    assert change[1:3] == ["52.000000", "5.0000000"]


def test_a_long_list_of_events_says_what_is_left_out(facts: Any) -> None:
    facts["events"] = [dict(facts["events"][0]) for _ in range(MOST_ROWS + 3)]
    assert len(tables(facts)["r-events"]) == MOST_ROWS
    assert "3 more events stand in the JSON file only." in texts(facts)


def test_contradictions(facts: Any) -> None:
    facts["flags"] = [{"flag": "contradiction:tractor.c", "poses": 30, "share": 0.1, "seconds": 6.0}]
    assert contradicted(facts) == [("tractor.c", 0.1)]
