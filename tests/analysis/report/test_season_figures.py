"""Figures of a season: what their axes show."""

from itertools import combinations

import matplotlib
import numpy as np
import pytest
from matplotlib.patches import Rectangle
from matplotlib.text import Text

from tilth.analysis.report.figure_look import LOOK
from tilth.analysis.report.season_figures import MOST_DAYS_NAMED, calendar, field_map, soils


def test_many_machines_fit_into_the_calendars_legend() -> None:
    """A contractor's fifty; the bars of a day still add up to all of its hours."""
    rigs = [{"name": f"tractor {k}", "hours": [1.0 + k]} for k in range(50)]
    (axes,) = calendar({"days": ["2026-05-01"], "rigs": rigs}).axes
    _, names = axes.get_legend_handles_labels()
    assert names[0] == "tractor 49" and names[-1] == "44 others" and len(names) == 7
    heights = [bar.get_height() for bar in axes.patches if isinstance(bar, Rectangle)]
    assert sum(heights) == sum(range(1, 51))


def test_the_calendar_adds_up_the_machines_of_a_day_and_names_few_days() -> None:
    days = [f"2026-05-{day:02d}" for day in range(1, 31)]
    data = {"days": days, "rigs": [{"name": name, "hours": [2.0] * 30} for name in ("one", "two")]}
    with matplotlib.rc_context(LOOK):
        (axes,) = calendar(data).axes
    top = axes.transData.transform((0, 4.0))[1]
    assert max(bar.get_window_extent().y1 for bar in axes.patches) == pytest.approx(top)
    assert len(axes.get_xticks()) <= MOST_DAYS_NAMED


def test_soils_have_a_panel_for_each_stiffness_in_the_order_of_driving() -> None:
    points = [{"at": k, "low": 8e4, "value": 1e5 + 1e3 * k, "high": 1.2e5} for k in range(5)]
    data = {"parameters": {"C_af": points, "C_ai": points[:2]}, "days": [{"day": "2026-05-01", "at": 0}]}
    with matplotlib.rc_context(LOOK):
        panels = soils(data).axes
    assert [panel.get_ylabel() for panel in panels] == [
        "front axle\nC_αf, kN/rad", "implement's axle\nC_αi, kN/rad",
    ]  # fmt: skip
    shown = np.asarray(panels[0].lines[0].get_ydata(), dtype=np.float64)
    np.testing.assert_allclose(shown, np.arange(100.0, 105.0))


def test_a_map_shows_value_and_uncertainty_with_north_up_and_little_contrast_where_all_is_alike() -> None:
    flat = {"mean": [[11.5, 11.5, None], [11.5, 11.51, 11.5]], "sd": [[0.1, 0.1, None], [0.1, 0.1, 0.1]]}
    data = {
        "extent": [0.0, 30.0, 0.0, 20.0], "parameters": {"C_af": flat}, "ways": [[[5.0, 5.0], [25.0, 15.0]]],
        "outline": [[5.0, 5.0], [25.0, 15.0], [5.0, 5.0]],
    }  # fmt: skip
    with matplotlib.rc_context(LOOK):
        value, sd, *_ = field_map(data).axes
    (shown,), (uncertain,) = value.images, sd.images
    assert tuple(shown.get_extent()) == (0.0, 30.0, 0.0, 20.0) and shown.origin == "lower"
    low, high = shown.get_clim()
    assert high / low == pytest.approx(np.exp(0.2), rel=1e-3)
    assert uncertain.get_clim() == pytest.approx((7.5, 12.5))
    assert {text.get_text() for text in value.texts} == {"", "5 m", "N"}


@pytest.mark.parametrize(("wide_m", "tall_m"), [(60, 400), (800, 60), (200, 200), (30, 30)])
def test_words_of_a_map_do_not_overlap_whatever_the_shape_of_the_field(wide_m: int, tall_m: int) -> None:
    logs = np.random.default_rng(0).uniform(11.0, 13.0, (tall_m // 10, wide_m // 10)).tolist()
    shown = {"mean": logs, "sd": logs}
    way = [[0.0, 0.0], [wide_m, tall_m]]
    data = {
        "extent": [0.0, wide_m, 0.0, tall_m], "parameters": dict.fromkeys(("C_af", "C_ar", "C_ai"), shown),
        "ways": [way], "outline": way,
    }  # fmt: skip
    with matplotlib.rc_context(LOOK):
        figure = field_map(data)
        figure.draw_without_rendering()
    texts = [one for one in figure.findobj(Text) if isinstance(one, Text)]
    words = [one for one in texts if any(map(str.isalpha, one.get_text()))]  # ticks have none
    boxes = [(one.get_text(), one.get_window_extent()) for one in words]
    assert len(boxes) == 14  # titles and labels of six panels, scale, north
    assert [(a, b) for (a, one), (b, other) in combinations(boxes, 2) if one.overlaps(other)] == []
