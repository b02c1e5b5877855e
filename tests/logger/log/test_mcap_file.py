"""Finding records in a log file: by the index at its end, and without one."""

from pathlib import Path

import pytest
from mcap.opcode import Opcode
from report_run import WrittenRun, write_run

from tilth.logger.log.mcap_file import body_of, walk
from tilth.logger.log.mcap_summary import metadata_bodies, times_of
from tilth.replay.glance import brief, glance


def read_through(path: Path) -> list[bytes]:
    with path.open("rb") as file:
        places = walk(file, path.stat().st_size)
        return [body_of(file, place) for place in places if place.opcode == Opcode.METADATA]


@pytest.mark.parametrize("finish", [True, False])
def test_metadata_by_its_index_is_that_of_reading_through(tmp_path: Path, finish: bool) -> None:
    path = write_run(tmp_path / "a.mcap", WrittenRun(finish=finish))
    with path.open("rb") as file:
        found = list(metadata_bodies(file, path.stat().st_size))
    assert found == read_through(path) and len(found) >= 2


def test_an_index_that_points_elsewhere_is_not_believed(tmp_path: Path) -> None:
    path = write_run(tmp_path / "a.mcap")
    before = read_through(path)
    with path.open("rb") as file:
        (place, *_) = [p for p in walk(file, path.stat().st_size) if p.opcode == Opcode.METADATA_INDEX]
    data = bytearray(path.read_bytes())
    data[place.body : place.body + 8] = (17).to_bytes(8, "little")
    path.write_bytes(data)
    with path.open("rb") as file:
        assert list(metadata_bodies(file, len(data))) == before


def test_times_are_those_of_all_messages(tmp_path: Path) -> None:
    path = write_run(tmp_path / "a.mcap")
    whole, short = glance(path), brief(path)
    assert (short.state, short.first_ns, short.last_ns) == (whole.state, whole.first_ns, whole.last_ns)
    cut = write_run(tmp_path / "cut.mcap", WrittenRun(finish=False))
    with cut.open("rb") as file:
        assert times_of(file, cut.stat().st_size) is None
    assert brief(cut) == glance(cut) and brief(cut).last_ns > 0
