"""Facts of runs that are written by hand, each once."""

import json
from pathlib import Path
from typing import Any

import pytest
from report_run import WrittenRun, write_run

from tilth.analysis.report.gather import facts_of
from tilth.analysis.runs.run import Run, open_runs


def opened(folder: Path, run: WrittenRun) -> Run:
    (found,) = open_runs(write_run(folder / "run.mcap", run))
    return found


@pytest.fixture(scope="session")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A run as WrittenRun has it by default."""
    return opened(tmp_path_factory.mktemp("report"), WrittenRun())


@pytest.fixture(scope="session")
def _facts(run: Run) -> str:
    return json.dumps(facts_of(run), allow_nan=False)


@pytest.fixture(scope="session")
def untouched(_facts: str) -> Any:
    """What a report tells of that run, which no test changes."""
    return json.loads(_facts)


@pytest.fixture
def facts(_facts: str) -> Any:
    """What a report tells of that run; a test may change it."""
    return json.loads(_facts)
