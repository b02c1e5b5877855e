"""The recorded drive that the demo's page shows first."""

from contextlib import closing

from tilth.replay.recorded import RecordedRun
from tilth.replay.simulated import simulated_by
from tilth.simulator import first_drive


def test_the_recorded_drive_is_small_and_says_that_it_is_simulated() -> None:
    path = first_drive.path()
    assert path.stat().st_size <= 1_000_000
    assert simulated_by([path]) == "tilth demo"
    with closing(RecordedRun([path])) as run:
        assert run.has_poses and run.length_ns > 60e9 and not run.text
        assert {row.topic for row in run.after(-1)} == first_drive.SHOWN
