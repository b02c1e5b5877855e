"""Segments that a user gives."""

from pathlib import Path

import pytest

from tilth.analysis.report.given import GivenTimes, given_segments, given_times
from tilth.analysis.runs.run import Run


def test_times() -> None:
    assert given_times("12:42") == GivenTimes(1, 12.0, 42.0)
    assert given_times("2:0.5:9") == GivenTimes(2, 0.5, 9.0)


@pytest.mark.parametrize(
    "text", ["", "12", "42:12", "a:b", "0:1:2", "-1:5", "1:2:3:4", "1:inf", "nan:3", "1.5:2:3"]
)
def test_wrong_times(text: str) -> None:
    with pytest.raises(ValueError, match="give seconds"):
        given_times(text)


def test_of_the_log_that_is_meant(run: Run) -> None:
    logs = [Path("other.mcap"), *run.sources]
    (found,) = given_segments(run, logs, [GivenTimes(1, 0.0, 5.0), GivenTimes(2, 12.0, 20.0)])
    assert (found.start_s, found.end_s) == (12.0, 20.0)
    with pytest.raises(ValueError, match=r"run\.mcap: no poses between 70 and 80 s"):
        given_segments(run, logs, [GivenTimes(2, 70.0, 80.0)])
