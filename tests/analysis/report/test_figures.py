"""Figures: drawn from plain data, the same bytes each time, one font size, colours for all eyes."""

import re
from collections.abc import Callable
from itertools import combinations
from typing import Any
from xml.etree import ElementTree

import matplotlib
import numpy as np
import pytest
from matplotlib.figure import Figure
from report_parts import everything

from tilth.analysis.report import figures
from tilth.analysis.report.document import ReportFigure, figures_of
from tilth.analysis.report.figure_look import FONT_PT, LOOK, METHOD_LINES, floats, plain_ticks
from tilth.analysis.report.gather import SOIL_CHANGE
from tilth.analysis.report.sections import report_of

pytestmark = pytest.mark.long


NOWHERE: dict[str, list[float]] = {"x": [], "y": []}


@pytest.fixture
def all_figures(facts: Any) -> dict[str, ReportFigure]:
    report = report_of(everything() | {"runs": [facts], "command": ""})
    return {figure.kind: figure for figure in figures_of(report)}


def drawn(figure: ReportFigure) -> Figure:
    with matplotlib.rc_context(LOOK):
        return figures.DRAWINGS[figure.kind](figure.data)


def test_every_kind_is_drawn(all_figures: dict[str, ReportFigure]) -> None:
    assert set(all_figures) == set(figures.DRAWINGS)
    for figure in all_figures.values():
        text = figures.svg(figure)
        ElementTree.fromstring(text)
        assert text == figures.svg(figure) and "<dc:date>" not in text
        made = figures.pdf(figure)
        assert made.startswith(b"%PDF") and made == figures.pdf(figure) and b"CreationDate" not in made


def test_one_font_size_and_a_page_width(all_figures: dict[str, ReportFigure]) -> None:
    for figure in all_figures.values():
        sizes = set(re.findall(r"font: (?:\w+ )*([\d.]+)px", figures.svg(figure, text=True)))
        assert sizes <= {f"{FONT_PT:g}", "5.6"}, figure.kind  # 5.6: an index
        assert drawn(figure).get_size_inches()[0] <= 7.2


def test_units_stand_on_the_axes(all_figures: dict[str, ReportFigure]) -> None:
    labels = {
        kind: {
            text for axes in drawn(all_figures[kind]).axes for text in (axes.get_xlabel(), axes.get_ylabel())
        }
        for kind in ("drive", "parameters", "response", "intervals")
    }
    assert {"wheel angle, °", "speed, km/h", "articulation, °", "time, s"} <= labels["drive"]
    assert any("kN/rad" in one for one in labels["parameters"]) and any(
        one.endswith(", m") for one in labels["intervals"]
    )
    assert {"gain, dB", "phase, °", "coherence", "frequency, Hz"} <= labels["response"]


def test_the_map_is_north_up_with_a_scale(all_figures: dict[str, ReportFigure]) -> None:
    (axes,) = drawn(all_figures["path"]).axes
    track = axes.lines[0]
    assert np.nanmax(track.get_xdata()) == pytest.approx(
        np.nanmax(floats(all_figures["path"].data["tractor"]["y"]))
    )
    texts = [one.get_text() for one in axes.texts]
    assert "N" in texts and "20 m" in texts and "1" in texts
    assert axes.get_aspect() == 1.0


@pytest.mark.parametrize(("north", "east"), [(1.0, 1.0), (8.0, 1.0), (1.0, 8.0), (0.05, 0.05)])
def test_scale_and_north_stand_below_all_that_is_driven_and_marked(
    all_figures: dict[str, ReportFigure], north: float, east: float
) -> None:
    """The events at the lowest places, in the corners too, with their numbers."""
    way = {"x": [0.0, 0.0, 100.0 * north, 100.0 * north], "y": [0.0, 100.0 * east, 100.0 * east, 0.0]}
    events = [{"number": k, "x": x, "y": y} for k, (x, y) in enumerate(zip(way["x"], way["y"], strict=True))]
    data = {"tractor": way, "implement": NOWHERE, "segments": [], "events": events, "soil_changes": []}
    with matplotlib.rc_context(LOOK):
        figure = figures.DRAWINGS["path"](data)
        figure.canvas.draw()
    (axes,) = figure.axes
    scale = [one for one in axes.texts if one.get_text() == "N" or one.get_text().endswith(" m")]
    marked = [one for one in axes.texts if one.get_text().isdigit()]
    assert len(scale) == 2 and len(marked) == 4
    highest = max(one.get_window_extent().y1 for one in scale)
    lowest = min(one.get_window_extent().y0 for one in marked)
    assert highest < lowest


def test_bands_are_drawn_where_there_is_uncertainty(all_figures: dict[str, ReportFigure]) -> None:
    for kind, panels in (("drive", 3), ("parameters", 6), ("response", 2)):
        shown = drawn(all_figures[kind])
        assert sum(bool(axes.collections) for axes in shown.axes) >= panels, kind


def test_a_change_of_soil_and_a_stale_value_are_seen(facts: Any) -> None:
    facts["curves"]["parameters"]["pem"]["C_af"]["usable"][-5:] = [False] * 5
    report = report_of({"runs": [facts], "command": ""})
    figure = next(one for one in figures_of(report) if one.kind == "parameters")
    assert figure.data["soil_changes_s"] == [e["t_s"] for e in facts["events"] if e["kind"] == SOIL_CHANGE]
    lines = [line for line in drawn(figure).axes[0].lines if line.get_linestyle() == ":"]
    assert any(np.isfinite(np.asarray(line.get_ydata(), dtype=float)).sum() == 5 for line in lines)


@pytest.mark.parametrize(
    "change",
    [
        lambda facts: facts["curves"]["path"].update(tractor=NOWHERE, implement=NOWHERE, segments=[]),
        lambda facts: facts["curves"]["drive"]["wheel_angle"].update(t_s=[], value=[], low=[], high=[]),
        lambda facts: facts["curves"]["parameters"]["pem"]["C_af"].update(
            value=[None] * 41, sd=[None] * 41, usable=[False] * 41
        ),
        lambda facts: facts["segments"].clear(),
        lambda facts: facts.update(duration_s=4000.0),
    ],
)  # fmt: skip
def test_what_is_missing_is_not_drawn(facts: Any, change: Callable[[Any], Any]) -> None:
    change(facts)
    for figure in figures_of(report_of({"runs": [facts], "command": ""})):
        assert figures.inline(figure)


def test_methods_differ_by_more_than_colour() -> None:
    for one, other in combinations(METHOD_LINES.values(), 2):
        assert one["linestyle"] != other["linestyle"] and one["color"] != other["color"]


@pytest.mark.parametrize(
    ("low", "high"), [(50.0, 900.0), (0.9, 1.2), (210.0, 240.0), (0.01, 90.0), (1.0, 3.0)]
)
def test_a_logarithmic_axis_has_a_few_plain_numbers(low: float, high: float) -> None:
    axes = Figure().subplots()
    axes.set_xscale("log")
    axes.set_xlim(low, high)
    plain_ticks(axes.xaxis)
    labels = [label.get_text() for label in axes.get_xticklabels()]
    assert 2 <= len(labels) <= 12 and all(low <= float(label) <= high for label in labels)


@pytest.mark.parametrize(
    ("count", "on_map", "over_time"),
    [
        (4, range(1, 5), range(1, 5)),
        (40, range(1, 41), range(2, 41, 2)),
        (102, range(2, 103, 2), range(2, 103, 4)),
    ],
)
def test_segments_that_steer_have_numbers_first(
    all_figures: dict[str, ReportFigure], count: int, on_map: range, over_time: range
) -> None:
    kinds = ("row", "headland_turn")
    segments = [
        {"number": k, "kind": kinds[(k - 1) % 2], "start_s": k, "end_s": k + 1, "x": [k, k + 1], "y": [0, 0]}
        for k in range(1, count + 1)
    ]
    for kind, expected in (("path", on_map), ("drive", over_time)):
        data = {**all_figures[kind].data, "segments": segments, "events": []}
        figure = drawn(ReportFigure("a", kind, "", "", data))
        texts = [text.get_text() for axes in figure.axes[:1] for text in axes.texts]
        assert [int(text) for text in texts if text.isdigit()] == list(expected)
