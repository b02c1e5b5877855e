"""A season's table, read back for a map: what is told of, and what is left out."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from logs import MACHINE, MACHINE_TEXT
from soil_drives import driven, kept_season, one_soil

from tilth.analysis.season.kept_table import MapProblem, runs_in, stretches_of
from tilth.analysis.season.season import TABLE

pq = pytest.importorskip("pyarrow.parquet")
SOME = driven(one_soil, 0)[:5]


def test_stretches_come_back_as_they_were_told(tmp_path: Path) -> None:
    found = stretches_of(kept_season(tmp_path, {MACHINE.machine.name: SOME}))
    assert found.machine == MACHINE and not found.left_out and len(found.stretches) == 5
    for one, before in zip(found.stretches, SOME, strict=True):
        np.testing.assert_array_equal(one.path_deg, before.path_deg)
        np.testing.assert_array_equal(one.told.information, before.told.information)
        np.testing.assert_array_equal(one.told.vector, before.told.vector)
        np.testing.assert_array_equal(one.by_file, before.by_file)
    first = found.stretches[0].properties
    assert first["begin_utc"] == "2026-05-01T08:00:00Z" and first["C_af_informed"] > 0.9
    assert runs_in(found.stretches) == [MACHINE.machine.name]


@pytest.mark.parametrize("place", [[], [np.nan, 11.0], [91.0, 11.0], [48.0, 200.0]], ids=str)
def test_what_is_nowhere_on_earth_is_left_out_and_told(place: list[float], tmp_path: Path) -> None:
    lost = replace(SOME[0], path_deg=np.array([place]) if place else np.zeros((0, 2)))
    found = stretches_of(kept_season(tmp_path, {"rig": [lost, *SOME[1:]]}))
    assert len(found.stretches) == 4 and "place is unknown" in found.left_out[0]
    with pytest.raises(MapProblem, match="place is unknown"):
        stretches_of(kept_season(tmp_path, {"rig": [lost]}))


def test_one_of_several_machines_is_named_or_asked_for(tmp_path: Path) -> None:
    kept_season(tmp_path, {"one": SOME, "other": SOME[:2]}, text=MACHINE_TEXT)
    with pytest.raises(
        MapProblem, match=r"give --machine and --implement; there are: one, implement .*; other, implement"
    ):
        stretches_of(tmp_path)
    assert len(stretches_of(tmp_path, "other").stretches) == 2
    with pytest.raises(MapProblem, match=r"no such machine .* there are: one, implement"):
        stretches_of(tmp_path, "third")
    with pytest.raises(MapProblem, match="no such machine"):
        stretches_of(tmp_path, "one", "a plough")


def test_what_is_no_season_is_told(tmp_path: Path) -> None:
    with pytest.raises(MapProblem, match="no season in this folder; make it with `"):
        stretches_of(tmp_path)
    (tmp_path / TABLE).write_bytes(b"none")
    with pytest.raises(MapProblem, match="is damaged"):
        stretches_of(tmp_path)
    kept_season(tmp_path, {"rig": SOME})
    whole = pq.read_table(tmp_path / TABLE)
    pq.write_table(whole.replace_schema_metadata({"tilth.season": b'{"form": "1"}'}), tmp_path / TABLE)
    with pytest.raises(MapProblem, match="another version"):
        stretches_of(tmp_path)
    pq.write_table(whole.drop_columns(["vector"]), tmp_path / TABLE)
    with pytest.raises(MapProblem, match="is damaged"):
        stretches_of(tmp_path)
    kept_season(tmp_path, {"rig": []})
    with pytest.raises(MapProblem, match="nothing to map"):
        stretches_of(tmp_path)
