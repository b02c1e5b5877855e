"""A map as a picture and a page."""

import re
from pathlib import Path

import numpy as np
import pytest
from logs import MACHINE
from soil_drives import driven, two_soils

from tilth.analysis.season.field_map import MappedField, mapped
from tilth.analysis.season.kept_table import RigStretches
from tilth.analysis.season.map_page import drawn, told_of, write_page, write_picture


@pytest.fixture(scope="module")
def field() -> MappedField:
    return mapped(2, MACHINE, driven(two_soils, 0)[:20])


def test_a_figure_has_each_cell_where_it_is(field: MappedField) -> None:
    data = drawn(field)
    west, east, south, north = data["extent"]
    values = np.array(data["parameters"]["C_ai"]["mean"])
    assert values.shape == ((north - south) / 10.0, (east - west) / 10.0)
    assert np.isfinite(values).sum() == len(field.grid)
    for corner, mean in zip(field.grid, field.mean, strict=True):
        assert values[round((corner[0] - south) / 10.0), round((corner[1] - west) / 10.0)] == mean[2]


def test_a_page_is_one_file_that_needs_nothing_else(field: MappedField, tmp_path: Path) -> None:
    rig = RigStretches("<tractor>", "drill", MACHINE, (), ("3 stretches are not in the map",))
    write_page(tmp_path / "m.html", rig, [field], "tilth map")
    text = (tmp_path / "m.html").read_text(encoding="utf-8")
    assert "&lt;tractor&gt;" in text and "<script" not in text and "3 stretches are not" in text
    assert not re.search(r'(?:href|src)="(?!#|data:)', text)
    assert "20 stretches of 1 run" in told_of(field) and "Field 2" in text


def test_a_picture_is_written_once(field: MappedField, tmp_path: Path) -> None:
    write_picture(tmp_path / "m.png", field)
    assert (tmp_path / "m.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(FileExistsError):
        write_picture(tmp_path / "m.png", field)
