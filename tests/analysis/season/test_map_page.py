"""A map as a picture and a page."""

import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from chromium import with_browser
from logs import MACHINE
from soil_drives import driven, two_soils

from tilth.analysis.season.field_map import MappedField, mapped
from tilth.analysis.season.kept_table import RigStretches
from tilth.analysis.season.map_page import drawn, told_of, write_page, write_picture

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Locator


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
    assert "&lt;tractor&gt;" in text and text.count("<script") == 1 and "3 stretches are not" in text
    assert not re.search(r'(?:href|src)="(?!#|data:)', text)
    assert "20 stretches of 1 run, 1970-01-01, near" in told_of(field) and "Field 2" in text


@pytest.mark.browser
@with_browser
def test_the_panels_of_a_field_zoom_together_and_its_scale_with_them(
    browser: "Browser", field: MappedField, tmp_path: Path
) -> None:
    rig = RigStretches("tractor", "drill", MACHINE, (), ())
    write_page(tmp_path / "m.html", rig, [field, field], "tilth map")
    page = browser.new_page()
    told: list[str] = []
    page.on("pageerror", lambda error: told.append(str(error)))
    page.on("request", lambda request: told.append(request.url) if "m.html" not in request.url else None)
    page.goto((tmp_path / "m.html").as_uri())
    first, other = page.locator("figure").all()

    def shown(figure: "Locator") -> list[list[float]]:
        boxes = [one.get_attribute("viewBox") or "" for one in figure.locator("svg.frame").all()]
        return [[float(number) for number in box.split()] for box in boxes]

    def scale_m(figure: "Locator") -> float:
        return float((figure.locator("[id$='-scale'] text").text_content() or "").removesuffix(" m"))

    whole, length_m = shown(first), scale_m(first)
    assert len(whole) == 6
    first.get_by_label("Zoom in").click()
    near = shown(first)
    assert [one[2] / was[2] for one, was in zip(near, whole, strict=True)] == pytest.approx([0.5] * 6)
    assert scale_m(first) == length_m / 2.0 and shown(other) == whole
    box = first.locator("svg.frame").first.bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"])
    page.mouse.down()
    page.mouse.move(box["x"] + 0.6 * box["width"], box["y"] + 0.6 * box["height"])
    page.mouse.up()
    moved = [(one[0] - was[0], one[1] - was[1]) for one, was in zip(shown(first), near, strict=True)]
    assert moved[0][0] < -1.0 and moved[0][1] < -1.0 and np.ptp(moved, axis=0) == pytest.approx(0.0, abs=1e-6)
    first.get_by_label("Whole field").click()
    assert shown(first) == whole and scale_m(first) == length_m and not told


def test_a_picture_is_written_once(field: MappedField, tmp_path: Path) -> None:
    rig = RigStretches("tractor", "drill", MACHINE, (), ())
    write_picture(tmp_path / "m.png", rig, field)
    picture = (tmp_path / "m.png").read_bytes()
    assert picture.startswith(b"\x89PNG") and b"tractor, implement drill: field 2, 1970-01-01" in picture
    with pytest.raises(FileExistsError):
        write_picture(tmp_path / "m.png", rig, field)
